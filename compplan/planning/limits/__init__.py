"""Limits of the program, one file each: rows of the program, a check of a result, and one sentence.

A new limit is one file with a class that has what `Limit` has, and one line in `LIMITS`.
"""

from __future__ import annotations

from typing import Protocol

import casadi as ca

from compplan.planning.limits.acceleration import AccelerationLimit
from compplan.planning.limits.band import BandLimit
from compplan.planning.limits.correction import CorrectionLimit
from compplan.planning.limits.joint_range import JointRange
from compplan.planning.limits.pose import LoadedPose
from compplan.planning.limits.velocity import VelocityLimit
from compplan.planning.problem import Problem, Station
from compplan.robot import Array


class Limit(Protocol):
    """What the class of a limit offers; `str` says it in one line of mathematics."""

    @property
    def name(self) -> str:
        """What plan.json calls it."""
        ...

    @property
    def timed(self) -> bool:
        """Whether it speaks of the speed along the path."""
        ...

    @property
    def of_joints(self) -> bool:
        """Whether its rows are one a joint."""
        ...

    @property
    def numbers(self) -> Array | None:
        """Its own numbers at every station, which its rows find in `Station.numbers`, or None. Shape (k, c)."""
        ...

    def rows(self, station: Station) -> ca.SX:
        """Return the rows of one station. Shape (r)."""
        ...

    def bounds(self, problem: Problem) -> tuple[Array, Array]:
        """Return lower and upper bounds of the rows. Shapes (k, r)."""
        ...


#: Every limit by its name.
LIMITS: dict[str, type] = {
    "pose": LoadedPose,
    "joint_range": JointRange,
    "correction": CorrectionLimit,
    "velocity": VelocityLimit,
    "acceleration": AccelerationLimit,
    "band": BandLimit,
}

__all__ = [
    "LIMITS",
    "AccelerationLimit",
    "BandLimit",
    "CorrectionLimit",
    "JointRange",
    "Limit",
    "LoadedPose",
    "VelocityLimit",
]
