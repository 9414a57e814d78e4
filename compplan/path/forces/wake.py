"""What is left of the stock: which move last lowered each column, and how low it went there exactly.

A coarse map keeps for each column the lowest move so far. A question about a place looks up the moves of its four
columns and works out from their geometry how low they went at the place itself, so that walls stand where the cutter
left them, not where the grid has its lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.files.tables import Array
from compplan.path.forces.cutter import Cutter
from compplan.path.forces.stock import expand_boxes

#: Cells of the map at most, and cells across a cutter's radius.
MOST_CELLS, CELLS_A_RADIUS = 12_000_000, 8.0
#: Moves that are longer than this are entered in pieces, in radii.
LONGEST_PIECE = 4.0
#: Of two moves that are equally low at a column the one that passes nearer owns it: it reaches the walls around; so it
#: does where it stands higher by a thousandth of a millimetre, as a tool that gives way does along one pass.
LEAN = 2e-4
#: A column that is lowered by more than this is on another level. [m]
LEVEL = 5e-6
#: Places along a sloped move at which a rounded cutter is looked at.
STATIONS = (-1.0, -0.5, 0.0, 0.5, 1.0)


def lowest_reach(cutter: Cutter, place: Array, start: Array, end: Array, lean: float = 0.0) -> Array:
    """Return how low the cutter goes at places in a move; infinite where it does not pass.

    At a place c the cutter at p(t) = start + t (end - start) stands at z(t) + h(|c - p(t)|), h its profile. Exact for
    level moves, plunges, flat and ball end mills; a rounded corner on a slope is taken at five t across the place.

    Args:
        cutter: The cutter, its axis along z.
        place: Shape (..., 2). [m]
        start: Tip where the move begins. Shape (..., 3). [m]
        end: Tip where it ends. Shape (..., 3). [m]
        lean: What each metre from the axis counts as height, to rank moves that are equally low. [1]

    Returns:
        Shape (...). [m]

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
        return np.asarray(start[..., 2] + cutter.height(distance) + lean * distance)
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
        lowest = np.minimum(lowest, start[..., 2] + t * rise + cutter.height(distance) + lean * distance)
    return lowest


@dataclass(frozen=True)
class Wake:
    """The map of what was cut; `cut` enters moves, `lowest` asks for places.

    Args:
        cutter: The cutter.
        start: Tips where moves begin. Shape (m, 3). [m]
        end: Tips where they end. Shape (m, 3). [m]
        origin: Place of the first column. Shape (2,). [m]
        cell: Distance of columns. [m]
        height: How low each column was cut. Shape (a, b). [m]
        owner: The move that did it, -1 for none. Shape (a, b).
        above: The move that had lowered it before, on a higher level, -1 for none: walls above a step. Shape (a, b).

    """

    cutter: Cutter
    start: Array
    end: Array
    origin: Array
    cell: float
    height: Array
    owner: NDArray[np.int32]
    above: NDArray[np.int32]

    def cut(self, moves: NDArray[np.int_]) -> None:
        """Enter moves into the map."""
        if not len(moves):
            return
        start, end = self.start[moves], self.end[moves]
        length = np.linalg.norm(end[:, :2] - start[:, :2], axis=1)
        pieces = np.maximum(np.ceil(length / (LONGEST_PIECE * self.cutter.radius)), 1.0).astype(int)
        item = np.repeat(np.arange(len(moves)), pieces)
        number = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        way = end - start
        a = start[item] + (number / pieces[item])[:, None] * way[item]
        b = start[item] + ((number + 1) / pieces[item])[:, None] * way[item]
        low = np.minimum(a, b)[:, :2] - self.cutter.radius - self.origin
        high = np.maximum(a, b)[:, :2] + self.cutter.radius - self.origin
        shape = np.array(self.height.shape)
        first = np.clip(np.ceil(low / self.cell).astype(int), 0, shape)
        after = np.clip(np.floor(high / self.cell).astype(int) + 1, 0, shape)
        box, cells = expand_boxes(first, after)
        if not len(box):
            return
        z = lowest_reach(self.cutter, self.origin + cells * self.cell, a[box], b[box], LEAN)
        flat = cells[:, 0] * shape[1] + cells[:, 1]
        better = z < self.height.reshape(-1)[flat]
        flat, z, box = flat[better], z[better], box[better]
        height, owner, above = (grid.reshape(-1) for grid in (self.height, self.owner, self.above))
        before, former = height[flat], owner[flat]
        np.minimum.at(height, flat, z)
        won = z <= height[flat]
        deeper = won & (before - z > LEVEL) & (former >= 0)
        above[flat[deeper]] = former[deeper]
        owner[flat[won]] = moves[item[box[won]]]

    def lowest(self, place: Array) -> Array:
        """Return how low the cutter went so far at places; infinite where it never was. Shape (...) from (..., 2)."""
        shape = np.array(self.height.shape)
        first = np.clip(np.floor((place - self.origin) / self.cell).astype(int), 0, shape - 2)
        seen: list[Array] = []
        lowest = np.full(place.shape[:-1], np.inf)
        corners = [(first[..., 0] + i, first[..., 1] + j) for i in (0, 1) for j in (0, 1)]
        for owner in [grid[corner] for grid in (self.owner, self.above) for corner in corners]:
            fresh = owner >= 0
            for other in seen:
                fresh &= owner != other
            seen.append(owner)
            if fresh.any():
                moves = owner[fresh]
                z = lowest_reach(self.cutter, place[fresh], self.start[moves], self.end[moves])
                lowest[fresh] = np.minimum(lowest[fresh], z)
        return lowest


def build_wake(cutter: Cutter, start: Array, end: Array, bounds: Array) -> Wake:
    """Return an empty map.

    Args:
        cutter: The cutter.
        start: Tips where moves begin. Shape (m, 3). [m]
        end: Tips where they end. Shape (m, 3). [m]
        bounds: Box that holds every place that may be asked for. Shape (2, 2). [m]

    """
    size = np.maximum(bounds[1] - bounds[0], 1e-6)
    cell = max(cutter.radius / CELLS_A_RADIUS, float(np.sqrt(np.prod(size) / MOST_CELLS)))
    shape = tuple((np.ceil(size / cell).astype(int) + 2).tolist())
    owner, above = (np.full(shape, -1, dtype=np.int32) for _ in range(2))
    return Wake(cutter, start, end, bounds[0] - 0.5 * cell, cell, np.full(shape, np.inf), owner, above)
