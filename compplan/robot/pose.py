"""Poses as matrices, shape (4, 4) [m]: from position and rotation, from a twist, of a joint that has moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from compplan.robot.model import Array, Joint


def build_pose(position: ArrayLike, rotation: ArrayLike) -> Array:
    """Return the pose of a position, shape (3,) [m], and a rotation matrix, shape (3, 3)."""
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = position, rotation
    return pose


def apply_twist(twist: Array) -> Array:
    """Return the pose of a shift and a rotation vector. Shape (6,). [m, rad]"""
    return build_pose(twist[:3], Rotation.from_rotvec(twist[3:]).as_matrix())


def move_joint(joint: Joint, q: float) -> Array:
    """Return how the child frame of a joint has moved at q; a fixed joint does not. [rad or m]"""
    pose = np.eye(4)
    if joint.kind == "prismatic":
        pose[:3, 3] = q * joint.axis
    elif joint.kind == "revolute":
        pose[:3, :3] = Rotation.from_rotvec(q * joint.axis).as_matrix()
    return pose
