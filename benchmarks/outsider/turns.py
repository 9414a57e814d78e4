"""Rotations and vectors, batched over the rows of a campaign."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Rng = np.random.Generator

DEGREE = np.pi / 180
GRAVITY = np.array([0.0, 0.0, -9.81])
AXES = dict(zip("xyz", np.eye(3), strict=True))


def turn_about(axis: Array, angle: ArrayLike) -> Array:
    """Rotation matrices about one constant unit axis by angles of shape (...) [rad]. Shape (..., 3, 3)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def turn_by(vectors: ArrayLike) -> Array:
    """Rotation matrices of rotation vectors of shape (..., 3) [rad]. Shape (..., 3, 3)."""
    w = np.asarray(vectors, float)
    angle = np.linalg.norm(w, axis=-1)
    x, y, z = np.moveaxis(w / np.maximum(angle, 1e-300)[..., None], -1, 0)
    K = np.zeros((*w.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 0] = -z, y, z
    K[..., 1, 2], K[..., 2, 0], K[..., 2, 1] = -x, -y, x
    angle = angle[..., None, None]
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def rotation_vectors(R: Array) -> Array:
    """Rotation vectors of rotation matrices, good up to pi. Shape (n, 3). [rad]"""
    return Rotation.from_matrix(R).as_rotvec()


def turn_rpy(angles: ArrayLike) -> Array:
    """Rotation matrix of a URDF roll, pitch and yaw [rad]. Shape (3, 3)."""
    roll, pitch, yaw = np.asarray(angles, float)
    return turn_about(AXES["z"], yaw) @ turn_about(AXES["y"], pitch) @ turn_about(AXES["x"], roll)


def rotate(R: Array, vectors: Array) -> Array:
    """Vectors turned by rotation matrices, row by row. Shape (n, 3)."""
    return np.einsum("...ij,...j->...i", R, vectors)


def transpose(R: Array) -> Array:
    """The inverses of rotation matrices. Shape (n, 3, 3)."""
    return np.swapaxes(R, 1, 2)


def dot(a: Array, b: Array) -> Array:
    """Scalar products of the rows. Shape (n,)."""
    return (a * b).sum(-1)


def repeat(vector: ArrayLike, rows: int) -> Array:
    """One vector (or one a row already) for every row. Shape (rows, 3)."""
    return np.broadcast_to(np.asarray(vector, float), (rows, 3))


def unit(rng: Rng) -> Array:
    """A random direction. Shape (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
