"""Follow a path by local inverse kinematics: tip and tool axis on the path by the least joint motion.

The ladder graph covers the configurations of an arm of six joints, and extra axes on a grid. Arms of fewer joints, and
arms of seven joints with a start posture in the job, are solved from waypoint to waypoint.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array
from compplan.statics.ik import Arm, middle_of_limits, reach_tip_and_axis
from compplan.toolpath.toolpath import Toolpath, interpolate, select_even

#: Waypoints that are solved one after the other; those between start from linear interpolation.
STATIONS = 500
#: Random starts for the first waypoint, and joint limits of their range where a joint has none. [rad or m]
SEEDS, WIDEST = 200, float(np.pi)


def follow_path(
    arm: Arm, nominal: Toolpath, rotation: Array, *, spin_free: bool, most_step: float, start: Array | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """Find joint positions with tip and axis of the unloaded tool on a path, each waypoint from the one before.

    `rotation` (n, 3, 3): frames whose z is the required direction out of the tool; `start` (nq,): joint positions near
    the first waypoint, searched if left out. Returns joint positions (n, nq) [rad or m], and which waypoints are not
    reached within the limits or only by a jump: a joint motion above `most_step` between waypoints of a cut.
    """
    n, robot = len(nominal), arm.robot
    start = _search_start(arm, nominal.position[0], rotation[0], spin_free=spin_free) if start is None else start
    if start is None:
        return np.tile(middle_of_limits(robot), (n, 1)), np.ones(n, bool)
    rows = select_even(np.arange(n), STATIONS)
    stations, q = np.empty((len(rows), robot.nq)), np.clip(start, robot.lower, robot.upper)[None]
    for k, row in enumerate(rows):
        found, reached = reach_tip_and_axis(arm, q, nominal.position[[row]], rotation[[row]], spin_free=spin_free,
                                            every_joint=True, draw=k > 0)  # fmt: skip
        q = found if reached.all() else q
        stations[k] = q[0]
    path = interpolate(np.arange(n), rows, stations)
    path, reached = reach_tip_and_axis(arm, path, nominal.position, rotation, spin_free=spin_free, every_joint=True)
    return path, ~reached | find_jumps_along(path, nominal, most_step)


def find_jumps_along(q: Array, nominal: Toolpath, most_step: float) -> NDArray[np.bool_]:
    """Return which waypoints of a cut require a jump of a joint."""
    jumps = np.zeros(len(q), bool)
    jumps[1:] = np.abs(np.diff(q, axis=0)).max(axis=1) > most_step
    return jumps & ~nominal.rapid


def _search_start(arm: Arm, position: Array, rotation: Array, *, spin_free: bool) -> Array | None:
    """Search joint positions that reach the first waypoint, farthest from the joint limits of many starts, or None."""
    robot = arm.robot
    low, high = np.maximum(robot.lower, -WIDEST), np.minimum(robot.upper, WIDEST)
    seeds = low + (high - low) * np.random.default_rng(0).random((SEEDS, robot.nq))
    seeds[0] = middle_of_limits(robot)
    wanted = np.tile(position, (SEEDS, 1)), np.tile(rotation, (SEEDS, 1, 1))
    found, reached = reach_tip_and_axis(arm, seeds, *wanted, spin_free=spin_free)
    room = np.where(reached, np.minimum(found - robot.lower, robot.upper - found).min(axis=1), -np.inf)
    return None if room.max() < 0.0 else np.asarray(found[int(room.argmax())])
