"""A first place for a part that nobody has placed yet: amid the places from which the arm reaches its whole path.

Nothing is optimised (that is `compplan place`): places in the vertical plane through the base are tried, and the one
that lies the deepest among those that are reached is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.job.job import Job
from compplan.job.loading import load_nominal
from compplan.planning.posture.initial_branches import read_request
from compplan.planning.posture.place import Rater
from compplan.robot import Array, Robot

#: Distances and heights of the path's middle that are tried, as shares of the length of the stretched links.
OUT, UP = np.linspace(0.15, 0.85, 11), np.linspace(-0.2, 0.5, 8)
#: Where it is put before an arm without a closed form of inverse kinematics, which is slow to try; shares of the same.
ASSUMED = np.array([0.45, 0.0, 0.15])
#: Places are given in steps of this. [m]
ROUND = 0.01


@dataclass(frozen=True)
class FirstPlace:
    """A place, and whether the arm was tried there.

    Attributes:
        position: Origin of the part, base frame. Shape (3,). [m]
        tried: Whether the arm was found to reach stations of the path there.

    """

    position: Array
    tried: bool


def find_first_place(job: Job, robot: Robot) -> FirstPlace | None:
    """Find a position of the part in whose surroundings the arm reaches its path; None where none is found.

    Args:
        job: The job; where its part stands does not matter.
        robot: The robot with its tool.

    Raises:
        InputError: If the toolpath cannot be read as the job has it.

    """
    nominal = load_nominal(job)
    cut = nominal.position[~nominal.rapid]
    middle = 0.5 * (cut.min(axis=0) + cut.max(axis=0))
    here = job.T_base_part[:3, 3]
    rater = Rater(robot, read_request(job, robot).settings)
    if rater.arm.solver is None:
        return FirstPlace(_round(here + ASSUMED * robot.longest_reach - middle), tried=False)
    out, up = (robot.longest_reach * shares for shares in (OUT, UP))
    places = np.stack(np.meshgrid(out, [0.0], up, indexing="ij"), axis=-1).reshape(-1, 3)
    bound = rater.rate(nominal, job.tool_x_base, job.T_base_part[:3, :3], places - middle).reshape(len(OUT), len(UP))
    reached = np.isfinite(bound)
    if not reached.any():
        return None
    from scipy.ndimage import distance_transform_edt

    depth = distance_transform_edt(np.pad(reached, 1))[1:-1, 1:-1]
    best = min(np.argwhere(depth == depth.max()).tolist(), key=lambda cell: float(bound[tuple(cell)]))
    return FirstPlace(_round(here + np.array([out[best[0]], 0.0, up[best[1]]]) - middle), tried=True)


def _round(place: Array) -> Array:
    return np.asarray(np.round(place / ROUND) * ROUND)
