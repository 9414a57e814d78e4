"""Frames that a job states, read a second time: a place in millimetres, a rotation in one of the makers' words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from compplan.second.moves import Array, CannotTellError

#: Keys of a rotation.
ROTATIONS = ("rotation_deg", "abc_deg", "wpr_deg", "quaternion")


def turn(axis: int, degrees: float) -> Array:
    """Return the rotation about x, y or z. Shape (3, 3)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def rotate(vector: Array) -> Array:
    """Return the rotation of a rotation vector [rad], by Rodrigues. Shape (3, 3)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


def read_rotation(table: Mapping[str, Any]) -> Array:
    """Return the rotation that a table states. Shape (3, 3)."""
    stated = [key for key in ROTATIONS if key in table]
    if not stated:
        return np.eye(3)
    values = [float(value) for value in table[stated[0]]]
    if len(stated) > 1:
        raise CannotTellError(f"both {stated[0]} and {stated[1]}")
    if stated[0] == "rotation_deg":
        return rotate(np.radians(values))
    if stated[0] == "abc_deg":  # about z, the new y, the newest x
        return turn(2, values[0]) @ turn(1, values[1]) @ turn(0, values[2])
    if stated[0] == "wpr_deg":  # about the fixed x, y, z
        return turn(2, values[2]) @ turn(1, values[1]) @ turn(0, values[0])
    w, x, y, z = (value / math.hypot(*values) for value in values)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def read_frame(table: Mapping[str, Any], known: tuple[str, ...] = ()) -> tuple[Array, Array]:
    """Return the place [m] and the rotation of a frame that a table states.

    Args:
        table: The table.
        known: Further keys that say nothing of the frame.

    Raises:
        CannotTellError: If it has a key that is not known here.

    """
    other = set(table) - {"position_mm", *ROTATIONS, *known}
    if other:
        raise CannotTellError(f"the key {sorted(other)[0]}")
    return np.array(table.get("position_mm", (0.0, 0.0, 0.0)), float) * 1e-3, read_rotation(table)
