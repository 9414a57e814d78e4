"""Compare D-optimal poses with random ones and with the dexterous postures of Dumas, on three robots.

Run: python benchmarks/pose_selection.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.identify.parameters import build_structure
from compplan.identify.plan_campaign import weigh_candidates
from compplan.measure.poses.determinant import choose_poses, compare_with_random
from compplan.measure.poses.pool import PoseCandidates, draw_candidates
from compplan.robot import Robot, load_robot
from compplan.robot.springs import own_springs
from compplan.statics.chain import build_chain
from compplan.statics.quality import find_characteristic_length, quality_of_poses

ROBOTS = ("kuka_kr270", "staubli_tx200", "kuka_kr240")
POSES, CANDIDATES = 20, 1500


def dexterous_candidates(robot: Robot, candidates: PoseCandidates, share: float = 0.25) -> NDArray[np.int_]:
    """Find the candidates in the most dexterous postures, as Dumas' zones choose them [Dumas2011, Table I].

    The Jacobian is taken over the length that makes the best of them most isotropic.

    Args:
        robot: The robot.
        candidates: The candidates.
        share: Share of the candidates that counts as dexterous.
    """
    chain = build_chain(robot)
    length = find_characteristic_length(chain, candidates.q)
    quality = quality_of_poses(chain, candidates.q, length)
    return np.flatnonzero(quality >= np.quantile(quality, 1 - share))


def main() -> None:
    for name in ROBOTS:
        robot = load_robot(name)
        candidates = draw_candidates(robot, CANDIDATES, seed=1)
        information = weigh_candidates(build_structure(robot, add=own_springs(robot)), candidates)
        limits = compare_with_random(information, POSES, seed=2)
        best = information.standard_errors(choose_poses(information, POSES, limits=limits))
        random = compare_with_random(information, POSES, draws=1000, seed=4)
        zone = compare_with_random(information, POSES, seed=3, allowed=dexterous_candidates(robot, candidates))
        print(f"\n{name}: {POSES} poses of {CANDIDATES}, 1 kN on a 0.3 m lever; standard errors in 1e-9 rad/(N m)")
        print(f"{'parameter':<14}{'D-optimal':>10}{'random':>10}{'zones':>10}{'D/random':>10}")
        for k, parameter in enumerate(information.parameters):
            row = np.array([best[k], random[k], zone[k]]) * 1e9
            print(f"{parameter.name:<14}{row[0]:>10.3f}{row[1]:>10.3f}{row[2]:>10.3f}{best[k] / random[k]:>10.2f}")
        geometric = np.exp([np.mean(np.log(errors)) for errors in (best, random, zone)])
        scaled = geometric * 1e9
        ratio = geometric[0] / geometric[1]
        print(f"{'geometric mean':<14}{scaled[0]:>10.3f}{scaled[1]:>10.3f}{scaled[2]:>10.3f}{ratio:>10.2f}")


if __name__ == "__main__":
    main()
