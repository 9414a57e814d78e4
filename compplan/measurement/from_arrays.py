"""Logs made of arrays: poses that were computed, or read by a program of one's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from compplan.errors import ShapeError
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

#: Assumed where a log states no standard deviation: they set the weight of orientation against position to begin with;
#: both are then replaced by what the residuals say. [m, rad]
ASSUMED_SIGMA_POSITION, ASSUMED_SIGMA_ROTATION = 5e-5, 1e-4


def make_log(
    q: ArrayLike, wrench: ArrayLike, position: ArrayLike, rotation: ArrayLike | None = None, *,
    sigma: ArrayLike | None = None, sigma_rotation: ArrayLike | None = None, link_side: ArrayLike = False,
    encoder: ArrayLike | None = None,
) -> Campaign:  # fmt: skip
    """Make a log of settled poses from arrays.

    Args:
        q: Commanded joint positions. Shape (n, nq). [rad, m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6) or (6,). [N, N m]
        position: Measured point. Shape (n, 3). [m]
        rotation: Measured orientation of the TCP frame as matrices. Shape (n, 3, 3).
        sigma: Standard deviation of position per axis; 0.05 mm is assumed if left out. Scalar or shape (n,). [m]
        sigma_rotation: The same of orientation; 0.1 mrad is assumed if left out. Scalar or shape (n,). [rad]
        link_side: Rows whose q are link-side readings (modes U2 and L2). Scalar or shape (n,).
        encoder: Link-side minus motor-side readings. Shape (n, nq). [rad, m]

    Raises:
        ShapeError: If an array does not have the shape above.
    """
    joints = np.atleast_2d(np.asarray(q, float))
    n = len(joints)

    def shaped(name: str, value: ArrayLike | None, *allowed: tuple[int, ...]) -> Array | None:
        array = None if value is None else np.asarray(value, float)
        if array is not None and array.shape not in allowed:
            raise ShapeError(f"{name} has shape {array.shape}, expected {' or '.join(map(str, allowed))}")
        return None if array is None else np.broadcast_to(array, allowed[0])

    side = np.broadcast_to(np.asarray(link_side, bool), (n,))
    extra, place = shaped("encoder", encoder, joints.shape), shaped("position", position, (n, 3))
    load = shaped("wrench", wrench, (n, 6), (6,))
    assert place is not None and load is not None
    return Campaign(
        run=np.array(["static_1"] * n),
        q=joints,
        wrench=load,
        position=place,
        rotation=shaped("rotation", rotation, (n, 3, 3)),
        link=None if extra is None else joints + extra,
        sigma=shaped("sigma", ASSUMED_SIGMA_POSITION if sigma is None else sigma, (n,), ()),
        sigma_rotation=shaped(
            "sigma_rotation", ASSUMED_SIGMA_ROTATION if sigma_rotation is None else sigma_rotation, (n,), ()
        ),
        mode=np.where(side, "L2", "L1") if side.any() else None,
    )
