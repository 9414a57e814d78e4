"""Which limits a command leaves: hard ones are joint positions, the correction, and the reach of the arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import Command, PlanTask
from compplan.robot import Array
from compplan.statics.chain import locate_frames

#: A joint this near to its limit stands at it. [rad or m]
AT_LIMIT = 1e-6
#: A correction this near to its limit stands at it. [m]
AT_CORRECTION = 1e-6
#: What stops a waypoint that stands at no limit.
OUT_OF_REACH = "reach of the arm"


def check_limits(task: PlanTask, q: Array, facts: Mapping[str, Any] | None = None) -> Command:
    """Make a command of joint positions, and name the waypoints that leave a limit or that the arm does not reach."""
    outside = np.maximum(task.robot.lower - q, q - task.robot.upper)
    too_far = measure_correction(task, q) > task.max_correction + AT_CORRECTION
    failing = np.flatnonzero(task.missed | (outside > 1e-9).any(axis=1) | (too_far & task.compensated))
    failures = name_failures(task, q, failing)
    return Command(q, "infeasible" if failures else "solved", failures, facts=facts or {})


def measure_correction(task: PlanTask, q: Array) -> Array:
    """Return the distance of the unloaded tip from the path. Shape (n,). [m]."""
    tip = np.empty((len(q), 3))
    for start in range(0, len(q), 4096):
        rows = slice(start, start + 4096)
        tip[rows] = locate_frames(task.chain, q[rows]).tcp_position
    return np.asarray(np.linalg.norm(tip - task.position, axis=1))


def name_failures(task: PlanTask, q: Array, failing: NDArray[np.int_]) -> dict[int, str]:
    """Name the limit that stops each failing waypoint: a joint's position limit, the correction limit, or the reach."""
    if not len(failing):
        return {}
    robot = task.robot
    at_lower, at_upper = q[failing] <= robot.lower + AT_LIMIT, q[failing] >= robot.upper - AT_LIMIT
    far = measure_correction(task, q)[failing] > task.max_correction - 2 * AT_CORRECTION
    names = {}
    for k, waypoint in enumerate(failing.tolist()):
        stopping = [
            f"{side} position limit of {robot.joint_names[j]}"
            for side, at in (("lower", at_lower), ("upper", at_upper))
            for j in np.flatnonzero(at[k])
        ]
        if far[k] and task.compensated[waypoint]:
            stopping.append("correction limit")
        names[waypoint] = ", ".join(stopping) or OUT_OF_REACH
    return names
