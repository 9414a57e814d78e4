"""Cut surface: the lowest move at each column of the stock, and its exact height.

A coarse map stores the lowest move so far for each column. To evaluate a position, the heights of the moves of its four
columns are computed from their geometry at the position itself. Walls are therefore where the cutter left them, not at
lines of the grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.process.engagement import Cutter

#: Greatest number of cells of the map, and cells across a cutter's radius.
MOST_CELLS, CELLS_A_RADIUS = 12_000_000, 8.0
#: Length above which moves are entered in pieces, in radii.
LONGEST_PIECE = 4.0
#: Of two moves that are equally low at a column, the nearer one is stored. The floor map stores the lowest move, except
#: for rounding. The wall map stores moves that pass near, even if they are some hundredths of a millimetre higher than
#: others of their pass, as the moves of a deflected tool are.
LEVEL_LEAN, WALL_LEAN = 1e-6, 0.02
#: Length of path between two moves above which they belong to different passes, in radii.
PASS = 1.5
#: Thickness below which material is ignored. [m]
NOTHING = 1e-9
#: Length of the pieces of moves of an inclined tool, in radii.
LEANING_PIECE = 0.5
#: Positions along a sloped move at which a rounded cutter is evaluated.
STATIONS = (-1.0, -0.5, 0.0, 0.5, 1.0)


def lowest_reach(cutter: Cutter, place: Array, start: Array, end: Array, axis_penalty: float = 0.0) -> Array:
    """Return the lowest height of the cutter's surface at places during a move; infinite where it does not pass.

    At a place c the cutter at p(t) = start + t (end - start) has the height z(t) + h(|c - p(t)|), h its profile.
    Exact for level moves, plunges, flat and ball end mills; a corner radius on a slope is evaluated at five t across
    the place. Shapes (..., 2), (..., 3), (..., 3) -> (...). [m]

    `axis_penalty` is the height added per metre from the axis, to rank moves that are equally low. [1]
    """
    way_x, way_y = end[..., 0] - start[..., 0], end[..., 1] - start[..., 1]
    off_x, off_y = place[..., 0] - start[..., 0], place[..., 1] - start[..., 1]
    square = way_x * way_x + way_y * way_y
    still = square < 1e-18
    along = (off_x * way_x + off_y * way_y) / np.where(still, 1.0, square)
    rise = end[..., 2] - start[..., 2]
    if not (np.abs(rise) > 1e-12).any():
        t = np.minimum(np.maximum(along, 0.0), 1.0)
        distance = np.hypot(off_x - t * way_x, off_y - t * way_y)
        return np.asarray(start[..., 2] + cutter.height(distance) + axis_penalty * distance)
    aside = off_x * off_x + off_y * off_y - along * along * square
    run = np.sqrt(np.where(still, 1.0, square))
    room = np.sqrt(np.maximum(cutter.radius**2 - aside, 0.0)) / run
    if cutter.round:
        slope = rise / run
        stations: tuple[Array | float, ...] = (-slope / np.sqrt(1.0 + slope * slope),)
    else:
        stations = (-1.0, 1.0) if cutter.even else STATIONS
    lowest = np.full(np.shape(along), np.inf)
    for station in stations:
        t = np.minimum(np.maximum(along + station * room * (1.0 - 1e-12), 0.0), 1.0)
        t = np.where(still, rise < 0.0, t)
        distance = np.hypot(off_x - t * way_x, off_y - t * way_y)
        lowest = np.minimum(lowest, start[..., 2] + t * rise + cutter.height(distance) + axis_penalty * distance)
    return lowest


@dataclass(frozen=True)
class MoveMap:
    """Stored moves at each column of a map."""

    axis_penalty: float  #: Height added per metre from the axis of a move. [1]
    height: Array  #: Lowest height of the column, with `axis_penalty`. Shape (a, b). [m]
    owner: NDArray[np.int32]  #: Move with this height, -1 for none. Shape (a, b).
    before: NDArray[np.int32]  #: Former owner of another pass, the latest one, -1 for none. Shape (a, b).

    def store(self, flat: NDArray[np.int_], z: Array, moves: NDArray[np.int_], length: Array, apart: float) -> None:
        """Store moves at the columns that they cut lower.

        `flat` is the index of a column, `z` its height in a move, with `axis_penalty`, `moves` the moves, shape (c,).
        `length` is the path length up to each move; moves over `apart` from each other are of different passes. [m]
        """
        height, owner, before = (grid.reshape(-1) for grid in (self.height, self.owner, self.before))
        better = z < height[flat]
        flat, z, moves = flat[better], z[better], moves[better]
        former = owner[flat]
        np.minimum.at(height, flat, z)
        won = z <= height[flat]
        other = won & (former >= 0) & (length[moves] - length[former] > apart)
        before[flat[other]] = former[other]
        owner[flat[won]] = moves[won]


@dataclass(frozen=True)
class CutSurface:
    """Map of the cut surface: `cut` enters moves, `lowest` evaluates positions."""

    cutter: Cutter  #: The cutter.
    start: Array  #: Start of the tip in each move. Shape (m, 3). [m]
    end: Array  #: End of the tip in each move. Shape (m, 3). [m]
    origin: Array  #: Position of the first column. Shape (2,). [m]
    cell: float  #: Distance of columns. [m]
    floor: MoveMap  #: The lowest move at each column.
    wall: MoveMap  #: The nearest move of those that are about as low, which forms the walls around.
    #: Axes of the tool at the end of each move as columns, None for an upright tool. Shape (m, 3, 3).
    tilt: Array | None = None

    @cached_property
    def path_length(self) -> Array:
        """Path length up to the end of each move. Shape (m,). [m]"""
        return np.asarray(np.cumsum(np.linalg.norm(self.end - self.start, axis=1)))

    def cut(self, moves: NDArray[np.int_]) -> None:
        """Enter moves into the map."""
        if not len(moves):
            return
        start, end = self.start[moves], self.end[moves]
        length = np.linalg.norm(end[:, :2] - start[:, :2], axis=1)
        round_or_upright = self.tilt is None or self.cutter.round
        piece = (LONGEST_PIECE if round_or_upright else LEANING_PIECE) * self.cutter.radius
        pieces = np.maximum(np.ceil(length / piece), 1.0).astype(int)
        item = np.repeat(np.arange(len(moves)), pieces)
        number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        a, b = (_between(start, end, item, (number + i) / pieces[item]) for i in (0, 1))
        leans: list[Array] = []
        if self.tilt is not None:
            first, last = self.tilt[np.maximum(moves - 1, 0), :, 2], self.tilt[moves, :, 2]
            leans = [_between(first, last, item, (number + i) / pieces[item]) for i in (0, 1)]
            if self.cutter.round:  # a ball depends only on its centre
                up = np.array([0.0, 0.0, 1.0])
                a, b, leans = a + self.cutter.corner * (leans[0] - up), b + self.cutter.corner * (leans[1] - up), []
        reach = self._margin(leans)
        low = np.minimum(a, b)[:, :2] - reach - self.origin
        high = np.maximum(a, b)[:, :2] + reach - self.origin
        shape = np.array(self.floor.height.shape)
        first_cell = np.clip(np.ceil(low / self.cell).astype(int), 0, shape)
        after = np.clip(np.floor(high / self.cell).astype(int) + 1, 0, shape)
        box, cells = expand_boxes(first_cell, after)
        if not len(box):
            return
        place, flat = self.origin + cells * self.cell, cells[:, 0] * shape[1] + cells[:, 1]
        for each in (self.floor, self.wall):
            if not leans:
                z = lowest_reach(self.cutter, place, a[box], b[box], each.axis_penalty)
            else:
                ends = ((a, leans[0]), (b, leans[1]))
                z = np.minimum(*(leaning_reach(self.cutter, place, p[box], v[box], each.axis_penalty) for p, v in ends))
            each.store(flat, z, moves[item[box]], self.path_length, PASS * self.cutter.radius)

    def _margin(self, axes: list[Array]) -> float:
        """Return the lateral reach of an inclined tool from its tip. [m]"""
        sideways = max((float(np.abs(v[:, :2]).max()) for v in axes), default=0.0)
        return self.cutter.radius + self.cutter.flute * sideways

    def uncut(self, point: Array, before: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Return which points are not removed by moves before a given index. Shapes (s, 3) and (s,), to (s,)."""
        left, owner = np.ones(len(point), dtype=bool), self._owners(point[:, :2])
        fresh = (owner >= 0) & (owner < before)
        fresh[1:] &= owner[1:] != owner[:-1]
        k, sample = np.nonzero(fresh)
        left[sample[self.gap(point[sample], owner[k, sample].astype(int)) < NOTHING]] = False
        return left

    def gap(self, point: Array, moves: NDArray[np.int_]) -> Array:
        """Return the height of moves above points, along the tool axis. Shapes (s, 3) and (s,), to (s,). [m]

        Relative to the tool, a point is assumed to move on a straight line; valid for small moves and rotations.
        """
        start, end = self.start[moves], self.end[moves]
        if self.tilt is None:
            return lowest_reach(self.cutter, point[:, :2], start, end) - point[:, 2]
        begin = np.einsum("sij,si->sj", self.tilt[np.maximum(moves - 1, 0)], start - point)
        stop = np.einsum("sij,si->sj", self.tilt[moves], end - point)
        return lowest_reach(self.cutter, np.zeros((len(point), 2)), begin, stop)

    def lowest(self, place: Array) -> Array:
        """Return the lowest height cut so far at places; infinite where nothing was cut. Shape (...) from (..., 2)."""
        owner = self._owners(place.reshape(-1, 2))
        fresh = owner >= 0
        fresh[1:] &= owner[1:] != owner[:-1]
        k, sample = np.nonzero(fresh)
        moves, z = owner[k, sample], np.full(owner.shape, np.inf)
        z[k, sample] = lowest_reach(self.cutter, place.reshape(-1, 2)[sample], self.start[moves], self.end[moves])
        return np.asarray(z.min(axis=0).reshape(place.shape[:-1]))

    def _owners(self, place: Array) -> NDArray[np.int32]:
        """Return the stored moves of the columns around places, in order. Shape (o, s) from (s, 2)."""
        columns = self.floor.owner.shape[1]
        first = np.floor((place - self.origin) / self.cell).astype(int)
        first = np.clip(first, 0, np.array(self.floor.owner.shape) - 2)
        corner = (first[:, 0] * columns + first[:, 1]) + np.array([[0], [1], [columns], [columns + 1]])
        grids = (self.floor.owner, self.wall.owner, self.wall.before)
        return np.sort(np.concatenate([grid.reshape(-1)[corner] for grid in grids]), axis=0)


def _between(first: Array, last: Array, item: NDArray[np.int_], share: Array) -> Array:
    return np.asarray(first[item] + share[:, None] * (last - first)[item])


def leaning_reach(cutter: Cutter, place: Array, tip: Array, axis: Array, axis_penalty: float) -> Array:
    """Return approximate heights of an inclined cutter at places; infinite off the cutter, see `lowest_reach`.

    Shapes (s, 2), (s, 3), (s, 3) -> (s,). [m]
    """
    off = place - tip[:, :2]
    along, up = np.einsum("si,si->s", off, axis[:, :2]), np.maximum(axis[:, 2], 0.02)
    square, tilt = np.einsum("si,si->s", off, off) - along**2, np.maximum(1.0 - up**2, 1e-12)
    root = np.sqrt(np.maximum((along * up) ** 2 - tilt * (square - cutter.radius**2), 0.0))
    low, high = (along * up - root) / tilt, (along * up + root) / tilt
    z = np.maximum(low, -along / up)
    passes = z <= high
    aside = _stand_off(z, along, up, square, tilt)
    for _ in range(0 if cutter.even else 2):
        z = z + np.maximum(cutter.height(np.minimum(aside, cutter.radius)) - along - up * z, 0.0) / up
        aside = _stand_off(z, along, up, square, tilt)
    passes &= aside <= cutter.radius * (1.0 + 1e-6)
    return np.asarray(np.where(passes, tip[:, 2] + z + axis_penalty * aside, np.inf))


def _stand_off(z: Array, along: Array, up: Array, square: Array, tilt: Array) -> Array:
    """Return the distance from an inclined axis at heights above its tip. Shape (s,). [m]"""
    return np.asarray(np.sqrt(np.maximum(tilt * z**2 - 2.0 * along * up * z + square, 0.0)))


def tilt_axes(axis: Array) -> Array:
    """Return frames as columns, rotated by the smallest angle that aligns z with the axis. Shape (n, 3, 3)."""
    x, y, z = axis.T
    share = 1.0 / np.maximum(1.0 + z, 1e-9)
    return np.stack([
        np.stack([1.0 - x * x * share, -x * y * share, x], axis=1),
        np.stack([-x * y * share, 1.0 - y * y * share, y], axis=1),
        np.stack([-x, -y, z], axis=1),
    ], axis=1)  # fmt: skip


def build_cut_surface(
    cutter: Cutter, start: Array, end: Array, stock: Array, axis: Array | None = None
) -> CutSurface | None:
    """Return an empty map of the stock within reach of the path, None if the path does not reach the stock.

    `start` and `end` are the tips of moves, shape (m, 3), `stock` the box around it, shape (2, 2) [m], `axis` the tool
    axis at the end of each move, None for an upright tool.
    """
    tilt = None if axis is None else tilt_axes(axis)
    sideways = 0.0 if axis is None else float(np.abs(axis[:, :2]).max())
    margin = 1.5 * cutter.radius + cutter.flute * sideways
    bounds = np.stack([np.maximum(stock[0], end[:, :2].min(axis=0) - margin),
                       np.minimum(stock[1], end[:, :2].max(axis=0) + margin)])  # fmt: skip
    if (bounds[1] <= bounds[0]).any():
        return None
    size = np.maximum(bounds[1] - bounds[0], 1e-6)
    cell = max(cutter.radius / CELLS_A_RADIUS, float(np.sqrt(np.prod(size) / MOST_CELLS)))
    shape = tuple((np.ceil(size / cell).astype(int) + 2).tolist())
    floor, wall = (
        MoveMap(axis_penalty, np.full(shape, np.inf), np.full(shape, -1, np.int32), np.full(shape, -1, np.int32))
        for axis_penalty in (LEVEL_LEAN, WALL_LEAN)
    )
    return CutSurface(cutter, start, end, bounds[0] - 0.5 * cell, cell, floor, wall, tilt)


def expand_boxes(first: NDArray[np.int_], after: NDArray[np.int_]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """List the cells of boxes of a grid, from a first cell to the one after the last, shape (m, 2).

    Returns the box index of each cell, shape (c,), and the cell, shape (c, 2).
    """
    size = np.maximum(after - first, 0)
    count = size[:, 0] * size[:, 1]
    item = np.repeat(np.arange(len(first)), count)
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    number = np.arange(count.sum()) - start[item]
    width = np.maximum(size[item, 1], 1)
    return item, np.column_stack([first[item, 0] + number // width, first[item, 1] + number % width])
