"""What was measured: poses of the tool under known loads, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compplan.errors import ShapeError
from compplan.robot import Array

#: Assumed where a log states no standard deviation: they set the weight of orientation against position to begin with;
#: both are then replaced by what the residuals say.
ASSUMED_SIGMA_POSITION = 5e-5
ASSUMED_SIGMA_ROTATION = 1e-4


@dataclass(frozen=True)
class Observations:
    """Measured rows, SI. NaN is a missing value.

    Attributes:
        q: Commanded joint positions; motor-side readings, or link-side ones where `link_side`. Shape (n, nq). [rad, m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        position: Measured point. Shape (n, 3). [m]
        rotation: Measured orientation of the TCP frame as matrices, or None. Shape (n, 3, 3).
        sigma_position: Standard deviation per axis. Shape (n,). [m]
        sigma_rotation: Standard deviation per axis. Shape (n,). [rad]
        link_side: Rows whose q are link-side readings (modes U2 and L2): actuators add no deflection. Shape (n,).
        target: Index of the measured point on the tool. Shape (n,).
        row: Row of the log, counted from 0. Shape (n,).
        encoder: Link-side minus motor-side reading of each joint, or None. Shape (n, nq). [rad, m]
        sigma_encoder: Standard deviation of such a difference. [rad, m]
    """

    q: Array
    wrench: Array
    position: Array
    rotation: Array | None
    sigma_position: Array
    sigma_rotation: Array
    link_side: NDArray[np.bool_]
    target: NDArray[np.int_]
    row: NDArray[np.int_]
    encoder: Array | None = None
    sigma_encoder: float = 1e-5

    def __len__(self) -> int:
        return len(self.q)

    def take(self, rows: NDArray) -> Observations:  # type: ignore[type-arg]
        """Take some rows, by index or mask."""
        picked = {
            f.name: getattr(self, f.name)[rows]
            for f in fields(self)
            if f.name != "sigma_encoder" and getattr(self, f.name) is not None
        }
        return replace(self, **picked)


def make_observations(
    q: ArrayLike,
    wrench: ArrayLike,
    position: ArrayLike,
    rotation: ArrayLike | None = None,
    *,
    sigma_position: ArrayLike | None = None,
    sigma_rotation: ArrayLike | None = None,
    link_side: ArrayLike = False,
    target: ArrayLike = 0,
    encoder: ArrayLike | None = None,
    sigma_encoder: float = 1e-5,
) -> Observations:
    """Make observations from arrays.

    Args:
        q: Commanded joint positions. Shape (n, nq). [rad, m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (6,). [N, N m]
        position: Measured point. Shape (n, 3). [m]
        rotation: Measured orientation of the TCP frame as matrices. Shape (n, 3, 3).
        sigma_position: Standard deviation per axis; 0.05 mm is assumed if left out. Scalar or shape (n,). [m]
        sigma_rotation: Standard deviation per axis; 0.1 mrad is assumed if left out. Scalar or shape (n,). [rad]
        link_side: Rows whose q are link-side readings. Scalar or shape (n,).
        target: Index of the measured point. Scalar or shape (n,).
        encoder: Link-side minus motor-side readings. Shape (n, nq). [rad, m]
        sigma_encoder: Standard deviation of such a difference. [rad, m]

    Raises:
        ShapeError: If an array does not have the shape above.
    """
    joints = np.atleast_2d(np.asarray(q, float))
    n = len(joints)
    load, place = np.asarray(wrench, float), np.asarray(position, float)
    if load.shape not in ((6,), (n, 6)):
        raise ShapeError(f"wrench has shape {load.shape}, expected ({n}, 6) or (6,)")
    if place.shape != (n, 3):
        raise ShapeError(f"position has shape {place.shape}, expected ({n}, 3)")
    turned = None if rotation is None else np.asarray(rotation, float)
    if turned is not None and turned.shape != (n, 3, 3):
        raise ShapeError(f"rotation has shape {turned.shape}, expected ({n}, 3, 3)")
    extra = None if encoder is None else np.asarray(encoder, float)
    if extra is not None and extra.shape != joints.shape:
        raise ShapeError(f"encoder has shape {extra.shape}, expected {joints.shape}")
    sigma_p = ASSUMED_SIGMA_POSITION if sigma_position is None else sigma_position
    sigma_r = ASSUMED_SIGMA_ROTATION if sigma_rotation is None else sigma_rotation
    return Observations(
        q=joints,
        wrench=np.broadcast_to(load, (n, 6)),
        position=place,
        rotation=turned,
        sigma_position=np.broadcast_to(np.asarray(sigma_p, float), (n,)),
        sigma_rotation=np.broadcast_to(np.asarray(sigma_r, float), (n,)),
        link_side=np.broadcast_to(np.asarray(link_side, bool), (n,)),
        target=np.broadcast_to(np.asarray(target, int), (n,)),
        row=np.arange(n),
        encoder=extra,
        sigma_encoder=sigma_encoder,
    )
