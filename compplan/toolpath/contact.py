"""Contact of a process and its axes: share of the wrench, cutting length, path frame and TCP frame.

The origin of the path frame is the tool tip. z is the tool axis (tip to spindle), x the feed direction projected
perpendicular to z, and y = z x x points to the left of the feed direction in a view from the spindle.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.toolpath import Toolpath

#: Frame in which a wrench is expressed.
Frame = Literal["part", "base", "tool", "path"]
#: Least component of the direction of a move along the tool axis for a retract.
STEEP = 0.71
#: Least component of the direction of a move perpendicular to the tool axis that defines x of the path frame.
ASIDE = 1e-6
#: Sine of the angle between the tool axis and x of the TCP frame below which they count as parallel.
SIDE = float(np.sin(np.radians(1.0)))


class ForceTable(StrictTable):
    """Keys of every force model: its name in a job."""

    model: str


class ContactTable(ForceTable):
    """Keys of every model whose wrench acts in contact and is zero in rapid moves.

    ramp_mm is the length over which the wrench grows from 0 after contact.
    """

    ramp_mm: float = Field(default=0.0, ge=0.0)


class PathForceTable(ForceTable):
    """Keys of every model whose wrench is expressed in path axes and follows from the path alone."""

    follows_feed: ClassVar[bool] = False  #: Whether the force depends on the actual feed.

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench on the tool at every waypoint in contact, path axes. Shape (n, 6). [N, N m]"""
        raise NotImplementedError

    def describe(self, nominal: Toolpath) -> list[str]:
        """Return the sources of its numbers and its assumptions, one sentence each."""
        return []


def path_axes(nominal: Toolpath) -> Array:
    """Return the axes of the path frame at every waypoint as columns; a plunge takes x from an adjacent move.

    Shape (n, 3, 3).
    """
    travel = _move_directions(nominal)
    across = travel - np.sum(travel * nominal.axis, axis=1, keepdims=True) * nominal.axis
    known = np.linalg.norm(across, axis=1) > ASIDE
    cutting = known & ~nominal.rapid
    chosen = cutting if cutting.any() else known
    if not chosen.any():
        return tool_axes(nominal, None) * np.array([1.0, -1.0, -1.0])
    return turn_about_axis(across[last_set(chosen)], -nominal.axis)


def lateral_share(nominal: Toolpath) -> Array:
    """Return the component of each move perpendicular to the tool axis: 0 in a plunge or a retract. Shape (n,)."""
    return np.asarray(np.linalg.norm(np.cross(_move_directions(nominal), nominal.axis), axis=1))


def find_retracts(nominal: Toolpath) -> NDArray[np.bool_]:
    """Find the moves that retract the tool, more along its axis than across it. Shape (n,)."""
    travel = _move_directions(nominal)
    rise = np.einsum("ni,ni->n", travel, nominal.axis)
    return np.asarray(rise > STEEP * np.linalg.norm(travel, axis=1))


def last_set(flags: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the last flagged row up to each row; before the first flagged row, the first one. Shape (n,)."""
    rows = np.flatnonzero(flags) if flags.any() else np.zeros(1, dtype=int)
    return np.asarray(rows[np.maximum(np.searchsorted(rows, np.arange(len(flags)), side="right") - 1, 0)])


def _move_directions(nominal: Toolpath) -> Array:
    """Return the direction of the move that ends at each waypoint, 0 at rest. Shape (n, 3)."""
    steps = np.diff(nominal.position, axis=0)
    travel = np.vstack([steps[:1], steps])
    return np.asarray(travel / np.maximum(np.linalg.norm(travel, axis=1, keepdims=True), 1e-300))


def turn_about_axis(x: Array, axis: Array) -> Array:
    """Return rotations (n, 3, 3) with z = -axis (axis: from tip to spindle) and x as near to `x` as possible."""
    z = -axis
    x = x - np.einsum("ni,ni->n", z, x)[:, None] * z
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return np.stack([x, np.cross(z, x), z], axis=2)


def tool_axes(nominal: Toolpath, tool_x: Array | None) -> Array:
    """Return the axes of the TCP frame as columns: z out of the tool, x the projection of `tool_x` normal to z.

    Shape (n, 3, 3).
    """
    wanted = np.array([1.0, 0.0, 0.0]) if tool_x is None else np.asarray(tool_x, dtype=np.float64)
    beside = np.linalg.norm(np.cross(nominal.axis, wanted), axis=1, keepdims=True) > 1e-6
    return turn_about_axis(np.where(beside, wanted, [0.0, 1.0, 0.0]), nominal.axis)


def check_tool_x(nominal: Toolpath, tool_x: Array, file: Path | None = None) -> None:
    """Refuse an x of the TCP frame, base axes (3,), that is parallel to the tool axis of a path in the base frame."""
    wanted = tool_x / np.linalg.norm(tool_x)
    along = np.flatnonzero(np.linalg.norm(np.cross(nominal.axis, wanted), axis=1) < SIDE)
    if len(along):
        message = (
            f"points along the tool axis at {len(along)} of {len(nominal)} waypoints, the first is {along[0]}: x of "
            "the TCP frame cannot; name a direction across the axis, or let rotate_about_tool_axis be true"
        )
        raise InputError(message, file=file, where="plan.tool_x" if file else None)


def contact_share(nominal: Toolpath, ramp: float) -> Array:
    """Return the share of the wrench that acts: 0 in rapid moves, growing after contact over `ramp` [m]. Shape (n,)."""
    length, n = nominal.arc_length, len(nominal)
    share = np.where(nominal.rapid, 0.0, 1.0)
    index = np.arange(n)
    # contact: the last waypoint reached by a rapid move, or the first waypoint
    contact = np.maximum.accumulate(np.where(nominal.rapid, index, 0))
    if ramp > 0.0:
        share *= np.clip((length - length[contact]) / ramp, 0.0, 1.0)
    return share


def cutting_progress(nominal: Toolpath) -> Array:
    """Return the cutting length up to every waypoint, without rapid moves. Shape (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.where(nominal.rapid[1:], 0.0, nominal.steps))])
