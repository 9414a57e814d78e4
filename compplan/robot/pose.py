"""Poses as matrices. Shape (4, 4). [m]"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from compplan.robot.model import Array, Joint

#: Greatest number of steps of the fit of a displacement, and its tolerance. [m, rad]
FIT_STEPS, SETTLED_FIT = 8, 1e-15
#: Least extent of points [m] and least ratio of extents that determine a rotation (assumed).
SMALLEST_SPREAD, FLATTEST = 5e-4, 1e-3


def build_pose(position: ArrayLike, rotation: ArrayLike) -> Array:
    """Return the pose of a position, shape (3,) [m], and a rotation matrix, shape (3, 3)."""
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = position, rotation
    return pose


def apply_twist(twist: Array) -> Array:
    """Return the pose of a shift and a rotation vector. Shape (6,). [m, rad]"""
    return build_pose(twist[:3], Rotation.from_rotvec(twist[3:]).as_matrix())


def move_joint(joint: Joint, q: ArrayLike) -> Array:
    """Return the motion of the child frame of a joint at positions q, shape (...) [rad or m]; shape (..., 4, 4)."""
    q = np.asarray(q, np.float64)
    pose = np.tile(np.eye(4), (*q.shape, 1, 1))
    if joint.kind == "prismatic":
        pose[..., :3, 3] = q[..., None] * joint.axis
    elif joint.kind == "revolute":
        pose[..., :3, :3] = Rotation.from_rotvec(q[..., None] * joint.axis).as_matrix()
    return pose


def follow_joints(base: str, joints: Sequence[Joint], value: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Locate the links of a chain from its base.

    Args:
        base: Link at the base.
        joints: The chain.
        value: Positions of actuated joints by name, 0 if left out. Shape (...) each. [rad or m]

    Returns:
        Pose of each link in the base. Shape (..., 4, 4), or (4, 4) if no joint moves it. [m]
    """
    poses: dict[str, Array] = {base: np.eye(4)}
    for joint in joints:
        position = np.asarray(value.get(joint.name, 0.0))
        if joint.mimic is not None:
            position = joint.mimic.multiplier * np.asarray(value.get(joint.mimic.joint, 0.0)) + joint.mimic.offset
        poses[joint.child] = poses[joint.parent] @ (joint.placement @ move_joint(joint, position))
    return poses


def fit_displacement(points: Array, moved: Array) -> Array:
    """Fit the rigid displacement between two sets of points (least squares).

    Rotations that the points do not determine are zero.

    Args:
        points: Points. Shape (k, 3). [m]
        moved: Displaced points, nearly rigid, small angle. Shape (k, 3). [m]

    Returns:
        Pose D with D points ~ moved. Shape (4, 4). [m]

    """
    found = np.eye(4)
    for _ in range(FIT_STEPS):
        here = points @ found[:3, :3].T + found[:3, 3]
        step = linear_displacement(here) @ (moved - here).ravel()
        middle, turn = here.mean(axis=0), Rotation.from_rotvec(step[3:]).as_matrix()
        found = build_pose(middle + step[:3] - turn @ middle, turn) @ found
        if np.abs(step).max() < SETTLED_FIT:
            break
    return found


def rigid_columns(place: Array, about: Array) -> Array:
    """Return motions of points by unit shifts along and turns about axes through a point. (k, 3, 6) [1, m/rad]

    place: shape (k, 3); about: shape (3,). [m]
    """
    turns = np.stack([np.cross(axis, place - about) for axis in np.eye(3)], axis=2)
    return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)


def linear_displacement(points: Array) -> Array:
    """Return the matrix from small motions of points to the best-fit shift of their mean and rotation vector.

    Args:
        points: Points. Shape (k, 3). [m]

    Returns:
        Shape (6, 3 k). [1, rad/m]

    """
    middle = points.mean(axis=0)
    turns = rigid_columns(points, middle)[:, :, 3:].reshape(-1, 3)
    shift = np.kron(np.full((1, len(points)), 1.0 / len(points)), np.eye(3))
    if np.abs(points - middle).max(initial=0.0) < SMALLEST_SPREAD:
        return np.vstack([shift, np.zeros((3, 3 * len(points)))])
    return np.vstack([shift, np.linalg.pinv(turns, rcond=FLATTEST)])


def see_position(position: Array, displacement: Array) -> Array:
    """Transform positions to the frame of a displaced part, D^-1 p. Shape (n, 3). [m]"""
    return np.asarray((position - displacement[:3, 3]) @ displacement[:3, :3])
