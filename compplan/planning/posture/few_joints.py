"""Where a plan starts on a robot of four or five joints: the tool leaves it no choice but the branch.

Five joints choose tip and direction of the tool. Four choose the tip and how the tool is turned about its axis, which
they keep where it points (palletisers, arms like a SCARA): a path asks for that direction, and what leans the tool
under load stays.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.trace import reach_tip_and_axis
from compplan.robot import Array
from compplan.statics.ik import Arm, middle_of_limits

#: Starts that are tried for the first waypoint, drawn between the joint limits, and rounds that follow the path.
SEEDS, ROUNDS = 200, 40
#: Limits that stand for missing ones where starts are drawn. [rad or m]
WIDEST = float(np.pi)
#: A joint that moves more than this from one waypoint to the next has changed its branch. [rad or m]
BRANCH = 0.35


def follow_path(
    arm: Arm, position: Array, rotation: Array, *, spin_free: bool = True
) -> tuple[Array, NDArray[np.bool_]]:
    """Find joint positions that put the unloaded tool's tip and axis on a path, along one branch.

    Args:
        arm: The arm.
        position: Wanted tips, base frame. Shape (n, 3). [m]
        rotation: Frames whose z is the wanted direction out of the tool. Shape (n, 3, 3).
        spin_free: Whether the tool may turn about its axis.

    Returns:
        Joint positions (n, nq) [rad or m], and which waypoints are not reached within the limits (n,).

    """
    robot, n = arm.robot, len(position)
    low, high = np.maximum(robot.lower, -WIDEST), np.minimum(robot.upper, WIDEST)
    seeds = low + (high - low) * np.random.default_rng(0).random((SEEDS, robot.nq))
    seeds[0] = middle_of_limits(robot)
    reach = partial(reach_tip_and_axis, arm, spin_free=spin_free)
    found, reached = reach(seeds, np.tile(position[0], (SEEDS, 1)), np.tile(rotation[0], (SEEDS, 1, 1)))
    room = np.minimum(found - robot.lower, robot.upper - found).min(axis=1)
    if not (reached & (room >= 0)).any():
        return np.tile(seeds[0], (n, 1)), np.ones(n, bool)
    q = np.tile(found[int(np.where(reached, room, -np.inf).argmax())], (n, 1))
    q, reached = reach(q, position, rotation)
    for _ in range(ROUNDS):
        off = np.r_[False, np.abs(np.diff(q, axis=0)).max(axis=1) > BRANCH] | ~reached
        off[0] = False
        if not off.any():
            break
        first = int(np.flatnonzero(off)[0])
        q[first:] = q[first - 1]
        q[first:], reached[first:] = reach(q[first:], position[first:], rotation[first:])
    outside = ((q < robot.lower - 1e-9) | (q > robot.upper + 1e-9)).any(axis=1)
    return q, ~reached | outside
