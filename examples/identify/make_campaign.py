"""Make the example campaign: a KR 270 whose joints are softer and stiffer than its folder says. Seed 7.

Run in the repository: python -m examples.identify.make_campaign
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.round_trip import simulate_observations
from compplan.identify.plan_campaign import plan_campaign
from compplan.identify.problem import IdentifyOptions
from compplan.robot import load_robot
from tests.observation_log import write_campaign_log

SEED = 7
FACTORS = (1.4, 0.7, 1.2, 0.8, 1.3, 0.9)


def main(folder: Path = Path(__file__).parent) -> None:
    """Write measurements.csv into a folder."""
    robot = load_robot("kuka_kr270")
    springs = [replace(s, compliance=s.compliance * f) for s, f in zip(robot.springs, FACTORS, strict=True)]
    truth = replace(robot, springs=tuple(springs))
    poses = plan_campaign(robot, IdentifyOptions(), 20, force=1000.0, lever=0.3, seed=SEED).poses
    q, wrench = np.repeat(poses.q, 2, axis=0), np.repeat(poses.wrench, 2, axis=0)
    wrench[::2] = 0.0  # every pose unloaded, then loaded
    write_campaign_log(simulate_observations(truth, q, wrench, seed=SEED), robot, folder / "measurements.csv")


if __name__ == "__main__":
    main()
