"""The finished part beside the path: where the cutter goes into it, and how much it leaves on it.

Points of the part's surface, a share of the cutter's radius apart, are held against the cutter where it passes them
nearest in each move, by its own shape (they are looked for in balls along its axis): a point inside the cutter is cut
away (a gouge), the least distance of a point that the cutter passes is what is left on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.process.cutter import Cutter
from compplan.process.stock import read_mesh

#: Points of the part's surface stand so many radii apart, at most so many; moves are looked at in pieces of so many.
POINTS_APART, MOST_POINTS, PIECE = 0.2, 500_000, 0.5
#: Balls along the axis in which points are looked for stand so many radii apart.
BALLS_APART = 1.0
#: What is left beyond this, in radii, is not looked at: the cutter does not come there.
REACH = 0.25
#: Pieces of moves that are looked at together.
AT_ONCE = 200


class PartMeshTable(StrictTable):
    """[process.part]: the finished part, a closed mesh in the part frame, and how deep it may be cut into."""

    mesh: str
    unit: Literal["mm", "m", "inch"] = "mm"
    gouge_mm: float = Field(default=0.1, gt=0.0, le=100.0)


@dataclass(frozen=True)
class PartCheck:
    """The finished part beside a path of n waypoints.

    Attributes:
        clearance: Least distance of the cutter from the part on the way to each waypoint, negative inside it; NaN where
            it does not come near and in rapid moves. Shape (n,). [m]
        left: What stays on the points of its surface that the cutter passes, 0 or more. Shape (p,). [m]
        allowed: How deep it may be cut into. [m]

    """

    clearance: Array
    left: Array
    allowed: float

    @property
    def gouges(self) -> NDArray[np.bool_]:
        """Waypoints on the way to which the part is cut into. Shape (n,)."""
        return np.asarray(np.nan_to_num(self.clearance, nan=0.0) < -self.allowed)


def check_part(
    table: PartMeshTable, cutter: Cutter, position: Array, axis: Array, cutting: NDArray[np.bool_], R_view: Array,
    job: Path,
) -> PartCheck:  # fmt: skip
    """Hold the finished part against a path.

    Args:
        table: What the job says of it.
        cutter: The cutter.
        position: Tips, seen along the mean tool axis. Shape (n, 3). [m]
        axis: Tool axes in that view. Shape (n, 3).
        cutting: Whether the move that ends at the waypoint is a cut. Shape (n,).
        R_view: Axes of that view as columns, part frame. Shape (3, 3).
        job: The job file; the mesh's name is relative to it.

    Raises:
        InputError: If the mesh is not what it has to be.

    """
    mesh = read_mesh(job.parent / table.mesh, table.unit, "process.part.mesh", job)
    corner = (np.asarray(mesh.vertices) @ R_view)[np.asarray(mesh.faces)]
    centre = position + cutter.corner * axis
    start, end, up, number = _list_pieces(centre, axis, cutting, PIECE * cutter.radius)
    clearance = np.full(len(position), np.inf)
    sideways = float(np.abs(up[:, :2]).max(initial=0.0))
    high = float(np.ptp(corner[..., 2])) + cutter.radius
    aside = (1.0 + REACH) * cutter.radius + 0.5 * float(np.linalg.norm(end - start, axis=1).max(initial=0.0))
    reach = aside + sideways * high
    near = (corner[..., :2].max(axis=1) > end[:, :2].min(axis=0) - reach).all(axis=1)
    near &= (corner[..., :2].min(axis=1) < end[:, :2].max(axis=0) + reach).all(axis=1)
    point, normal = sample_triangles(corner[near], POINTS_APART * cutter.radius)
    left = np.full(len(point), np.inf)
    tree, middle = cKDTree(point), 0.5 * (start + end) - cutter.corner * up
    most = np.linalg.norm(np.ptp(corner, axis=(0, 1))) + cutter.radius
    room = np.minimum((corner[..., 2].max() - middle[:, 2] + aside) / np.maximum(up[:, 2], 1e-3), most)
    ball = float(np.hypot(aside, 0.5 * BALLS_APART * cutter.radius))
    balls = np.ceil(np.maximum(room, 0.0) / (BALLS_APART * cutter.radius)).astype(int)
    for first in range(0, len(end) if len(point) else 0, AT_ONCE):
        some = balls[first : first + AT_ONCE]
        piece = first + np.repeat(np.arange(len(some)), some)
        step = np.arange(len(piece)) - np.repeat(np.cumsum(some) - some, some)
        height = (step + 0.5) * BALLS_APART * cutter.radius + cutter.radius - aside
        found = tree.query_ball_point(middle[piece] + height[:, None] * up[piece], ball, return_sorted=False)
        piece = np.repeat(piece, np.fromiter(map(len, found), int, len(found)))
        chosen = np.fromiter(chain.from_iterable(found), int, len(piece))
        away, seen = _pass_by(cutter, start[piece], end[piece], up[piece], point[chosen], normal[chosen])
        np.minimum.at(clearance, number[piece[seen]], away[seen])
        np.minimum.at(left, chosen[seen], away[seen])
    clearance[~np.isfinite(clearance)] = np.nan
    return PartCheck(clearance, np.maximum(left[np.isfinite(left)], 0.0), 1e-3 * table.gouge_mm)


def _list_pieces(
    position: Array, axis: Array, cutting: NDArray[np.bool_], longest: float
) -> tuple[Array, Array, Array, NDArray[np.int_]]:
    """Return where pieces of the cuts begin and end, tool axes at their ends, and the waypoint they lead to."""
    rows = np.flatnonzero(cutting)
    before = np.maximum(rows - 1, 0)
    pieces = np.maximum(np.ceil(np.linalg.norm(position[rows] - position[before], axis=1) / longest), 1.0).astype(int)
    item = np.repeat(np.arange(len(rows)), pieces)
    number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    first, last = before[item], rows[item]
    share = [((number + k) / pieces[item])[:, None] for k in (0, 1)]
    start, end = (position[first] + s * (position[last] - position[first]) for s in share)
    up = axis[first] + share[1] * (axis[last] - axis[first])
    return start, end, up / np.linalg.norm(up, axis=1)[:, None], last


def _pass_by(
    cutter: Cutter, start: Array, end: Array, up: Array, point: Array, normal: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return how far points stand outside of cutters that pass them, and whether that counts. (s,)

    It does inside them, and within `REACH` where the points' surface faces them. Exact for balls, and for sides in
    level moves. A piece begins and ends where the middle of the cutter's corner does.
    """
    way = end - start
    share = np.einsum("si,si->s", point - start, way)
    share = np.clip(share / np.maximum(np.einsum("si,si->s", way, way), 1e-300), 0.0, 1.0)[:, None]
    off = point - start - share * way
    height = np.einsum("si,si->s", off, up)
    aside = off - height[:, None] * up
    rho = np.linalg.norm(aside, axis=1)
    away, out = measure_distance(cutter, rho, height + cutter.corner)
    near = np.flatnonzero((away >= 0.0) & (away < REACH * cutter.radius))
    slope = out[near, :1] * aside[near] / np.maximum(rho[near], 1e-12)[:, None] + out[near, 1:] * up[near]
    seen = away < 0.0
    seen[near] = np.einsum("si,si->s", slope, normal[near]) < 0.0
    return away, seen


def measure_distance(cutter: Cutter, rho: Array, height: Array) -> tuple[Array, Array]:
    """Return how far points stand outside of a cutter, negative inside, and the way out.

    Args:
        cutter: The cutter; its side goes on upwards.
        rho: Distance from the axis. Shape (s,). [m]
        height: Above the tip. Shape (s,). [m]

    Returns:
        Distance, shape (s,) [m], and the direction away from the axis and along it, shape (s, 2).

    """
    beside, below = rho - (cutter.radius - cutter.corner), cutter.corner - height
    if cutter.point < np.pi:
        half = 0.5 * cutter.point
        beside, below = rho - cutter.radius, rho * np.cos(half) - height * np.sin(half)
        under = np.array([np.cos(half), -np.sin(half)])
        away = np.maximum(beside, below)
        return away, np.where((beside > below)[:, None], np.array([1.0, 0.0]), under)
    round_corner = (beside > 0.0) & (below > 0.0)
    far = np.hypot(np.maximum(beside, 0.0), np.maximum(below, 0.0))
    away = np.where(round_corner, far, np.maximum(beside, below)) - cutter.corner
    flat = np.where((beside > below)[:, None], np.array([1.0, 0.0]), np.array([0.0, -1.0]))
    bent = np.column_stack([beside, -below]) / np.maximum(far, 1e-12)[:, None]
    return away, np.where(round_corner[:, None], bent, flat)


def sample_triangles(corner: Array, apart: float) -> tuple[Array, Array]:
    """Return points on triangles, edges included, about so far apart, and the normals there. Shapes (p, 3).

    Args:
        corner: Shape (t, 3, 3). [m]
        apart: Wanted distance; points are at most MOST_POINTS. [m]

    """
    if not len(corner):
        return np.zeros((0, 3)), np.zeros((0, 3))
    side = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    order = (np.argmax(side, axis=1)[:, None] + np.arange(3)) % 3  # the longest side first
    a, b, c = (np.take_along_axis(corner, order[:, k, None, None], axis=1)[:, 0] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    longest = side.max(axis=1)
    some = area > 1e-9 * longest**2
    a, b, c, normal, area, longest = (v[some] for v in (a, b, c, normal, area, longest))
    apart = max(apart, float(np.sqrt(area.sum() / MOST_POINTS)))
    rows = np.maximum(np.ceil(area / longest / apart), 1.0).astype(int) + 1
    item = np.repeat(np.arange(len(a)), rows)
    level = (np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows)) / (rows[item] - 1.0)
    count = np.ceil(longest[item] * (1.0 - level) / apart).astype(int) + 1
    line = np.repeat(np.arange(len(item)), count)
    share = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)) / np.maximum(count[line] - 1.0, 1.0)
    k, t = item[line], level[line][:, None]
    point = (1.0 - t) * (a[k] + share[:, None] * (b - a)[k]) + t * c[k]
    normal = normal[k] / area[k][:, None]
    small = longest[k] < apart  # a finer mesh than is asked for: one point stays in a cube, of those that look alike
    key = np.column_stack([np.floor(point / apart), np.rint(normal)])[small].astype(np.int64)
    kept = np.union1d(np.flatnonzero(~small), np.flatnonzero(small)[np.unique(key, axis=0, return_index=True)[1]])
    return point[kept], normal[kept]


def describe_part(found: PartCheck) -> dict[str, Any]:
    """Return what a summary says: the deepest gouge, where, at how many waypoints, and what is left. [mm]"""
    clearance = found.clearance
    summary: dict[str, Any] = {"gouge_allowed_mm": 1e3 * found.allowed, "gouged_waypoints": int(found.gouges.sum())}
    if np.isfinite(clearance).any():
        worst = int(np.nanargmin(clearance))
        summary |= {"deepest_mm": float(1e3 * max(-clearance[worst], 0.0)), "deepest_at": worst}
    if len(found.left):
        middle, most = np.quantile(found.left, [0.5, 0.95])
        summary["left_mm"] = {"median": float(1e3 * middle), "p95": float(1e3 * most),
                              "max": float(1e3 * found.left.max())}  # fmt: skip
    return summary
