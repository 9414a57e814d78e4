"""Direction of a straight tool on the flange, from z of the folder's TCP frame."""

from __future__ import annotations

import itertools

import numpy as np

from compplan.robot.model import Array, Robot
from compplan.robot.pose import follow_joints

#: Components of a direction below this count as zero.
NOTHING = 1e-6


def mounted_tool(robot: Robot) -> Array:
    """Return the pose of the TCP frame in the flange frame. Shape (4, 4). [m]"""
    beyond = itertools.dropwhile(lambda joint: joint.parent != robot.flange, robot.joints)
    return follow_joints(robot.flange, list(beyond), {})[robot.tcp]


def outward_axis(robot: Robot) -> Array:
    """Return the direction of a straight tool in flange axes: z of the folder's TCP. Shape (3,)."""
    axis = mounted_tool(robot)[:3, 2]
    return np.asarray(np.where(np.abs(axis) < NOTHING, 0.0, axis))


def name_axis(axis: Array) -> str:
    """Format a direction: "x", "-z", or its components."""
    k = int(np.abs(axis).argmax())
    if abs(axis[k]) > 1.0 - NOTHING:
        return f"{'-' if axis[k] < 0 else ''}{'xyz'[k]}"
    return f"({', '.join(f'{value:.3g}' for value in axis)})"


def find_hand(robot: Robot) -> Array:
    """Return the flange in the frame of the last moving joint. Shape (3,). [m]"""
    pose = np.eye(4)
    for joint in robot.joints:
        pose = np.eye(4) if joint.actuated else pose @ joint.placement
        if joint.child == robot.flange:
            break
    return np.asarray(pose[:3, 3])
