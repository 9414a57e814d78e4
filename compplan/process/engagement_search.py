"""Search for the engagement of a cutter: its surface is compared with the stock that remained before the move.

For a flat end mill with a fixed axis, the height of the material is evaluated at each angle. For other cutters, or a
changing axis, points of the edge are tested for material; a bisection locates the end of the material between two
points with different results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.process.cut_surface import NOTHING, CutSurface, build_cut_surface, lowest_reach
from compplan.process.engagement import Cutter, Engagement, middle_angles, outward_span
from compplan.process.stock import UPRIGHT, StockColumns
from compplan.toolpath.contact import last_set

#: Angles round the axis, a multiple of 4. The force of a bin acts at its middle; the force of a half engaged bin at the
#: end of an arc is therefore rotated by a quarter of a bin, 1.9 degrees: an error of 3 % of a bin's force.
ANGLES = 48
#: Moves that are computed together, for flat cutters and for others.
CHUNK, EDGE_CHUNK = 16, 48
#: Bisection steps for the end of an arc, for flat cutters and for others.
BISECTIONS, ARC_HALVINGS = 9, 5
#: Greatest error of the end of a slice's engaged part, in radii; determines the bisection steps for the longest slice.
END_ERROR = 2e-3
#: Angles within a partly engaged bin of a lower surface.
STRIPS = 2
#: Ratio of engaged shares of neighbouring bins below which the smaller one is beyond the end of an arc: a film removed
#: from a floor is not part of the cut at a wall.
THIN = 0.25
#: Cosine of the angle between moves above which they are on one straight line.
STRAIGHT = 1.0 - 1e-12
#: Total change of direction below which earlier moves cannot have cut material ahead of the cutter. [rad]
SAME_WAY = float(np.radians(15.0))
#: Outward speed, as a share of the feed, below which the surface only slides, as on the floor that the tool cuts.
SLIDES = 1e-6
#: Length of side slices for tests by points, in radii, and their greatest number.
SIDE_SLICE, MOST_SIDE_SLICES = 0.25, 24

#: Bins (waypoint, slice, angle), and their engaged shares.
Bins = tuple[NDArray[np.int_], ...]
Shares = NDArray[np.float32]


def find_engagement(
    cutter: Cutter, position: Array, cutting: NDArray[np.bool_], stock: StockColumns, axis: Array | None = None
) -> Engagement:
    """Compute the engagement at every waypoint of a path through stock; zero in rapid moves.

    Args:
        cutter: The cutter.
        position: Tips, in a frame whose third axis is along the stock's columns. Shape (n, 3). [m]
        cutting: Whether the move that ends here removes material (rapid moves do not). Shape (n,).
        stock: The stock before the first move, same frame.
        axis: Tool axis, tip to spindle; left out: the third axis of the frame. Shape (n, 3).
    """
    n = len(position)
    axis = None if axis is None or np.abs(axis[:, :2]).max() < UPRIGHT else axis
    start = np.vstack([position[:1], position[:-1]])
    step, moving = _list_steps(position)
    frame, travel = _frame_path(step, axis)
    turning = None if axis is None else _turn_axis(step, axis, frame, cutter)
    by_points = axis is not None or not cutter.even
    cutter = _cut_side(cutter, position, cutting, stock, axis) if by_points else cutter
    found = Engagement(cutter, np.zeros((n, len(cutter.slices), ANGLES), dtype=np.float32), travel, turning)
    surface = build_cut_surface(cutter, start, position, stock.box[:, :2], axis)
    if surface is None:
        return found
    run_from = _find_runs(step, axis) if by_points else _straight_from(step, np.linalg.norm(step, axis=1))
    kind = _PointEdge if by_points else _FlatEdge
    solver = kind(found, surface, stock, position, start, frame, run_from)
    removing = cutting & moving
    removing[0] = False
    chunk = EDGE_CHUNK if by_points else CHUNK
    for first in range(0, n, chunk):
        rows = np.arange(first, min(first + chunk, n))
        moves = rows[removing[rows]]
        solver.fill(rows[cutting[rows]], moves)
        surface.cut(moves)
    return found


def _list_steps(position: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the move that ends at each waypoint (at rest, the move before), and whether the tool moves."""
    step = np.diff(position, axis=0, prepend=position[:1])
    step[0] = step[1] if len(position) > 1 else [1.0, 0.0, 0.0]
    moves = np.linalg.norm(step, axis=1) > 0.0
    return step[last_set(moves)], moves  # at rest the engagement of the last move remains


def _frame_path(step: Array, axis: Array | None) -> tuple[Array, Array]:
    """Return axes of the path as columns, (n, 3, 3), and the travel as (across, along) the tool axis, (n, 2).

    The first axis is the travel across the tool axis, kept in plunges; the third is the tool axis.
    """
    up = np.tile([0.0, 0.0, 1.0], (len(step), 1)) if axis is None else axis
    unit = step / np.maximum(np.linalg.norm(step, axis=1), 1e-300)[:, None]
    along = np.einsum("ni,ni->n", unit, up)
    across = unit - along[:, None] * up
    size = np.linalg.norm(across, axis=1)
    clear = size > 1e-6
    x = across[last_set(clear)] if clear.any() else np.tile([1.0, 0.0, 0.0], (len(step), 1))
    x = x - np.einsum("ni,ni->n", x, up)[:, None] * up
    x /= np.maximum(np.linalg.norm(x, axis=1), 1e-12)[:, None]
    return np.stack([x, np.cross(up, x), up], axis=2), np.column_stack([size, along])


def _turn_axis(step: Array, axis: Array, frame: Array, cutter: Cutter) -> Array:
    """Return the axis rotation per travel, along it and to its left; at most 1 / radius. Shape (n, 2). [rad/m]"""
    turn = np.diff(axis, axis=0, prepend=axis[:1]) / np.maximum(np.linalg.norm(step, axis=1), 1e-12)[:, None]
    turn *= np.minimum(1.0 / np.maximum(cutter.radius * np.linalg.norm(turn, axis=1), 1e-12), 1.0)[:, None]
    return np.einsum("ni,nij->nj", turn, frame[:, :, :2])


def _cut_side(
    cutter: Cutter, position: Array, cutting: NDArray[np.bool_], stock: StockColumns, axis: Array | None
) -> Cutter:
    """Return the cutter with its side divided into slices, up to the top of the stock."""
    room = stock.box[1, 2] - position[cutting, 2]
    if axis is not None:
        rise = np.clip(axis[cutting, 2], 0.05, 1.0)
        room = np.maximum(room, 0.0) / rise + cutter.radius * np.sqrt(1.0 - rise**2) / rise
    reach = float(np.clip(1.001 * room.max(initial=0.0), cutter.end, max(cutter.flute, cutter.end)))
    pieces = int(np.clip(np.ceil((reach - cutter.end) / (SIDE_SLICE * cutter.radius)), 1, MOST_SIDE_SLICES))
    return replace(cutter, flute=reach, pieces=pieces)


@dataclass(frozen=True)
class _EdgeSolver:
    """Comparison of the edge of a cutter with the stock that earlier moves left."""

    found: Engagement
    surface: CutSurface
    stock: StockColumns
    position: Array
    start: Array
    frame: Array
    run_from: NDArray[np.int_]

    @property
    def cutter(self) -> Cutter:
        return self.found.cutter

    def fill(self, rows: NDArray[np.int_], moves: NDArray[np.int_]) -> None:
        """Compute the engaged shares of some waypoints; moves of the same chunk count in their order."""
        raise NotImplementedError

    def _in_stock(self, point: Array) -> NDArray[np.bool_]:
        """Return which points are inside the stock before the first move. Shape (s,)."""
        solid = point[:, 2] < self.stock.box[1, 2]
        bottom, top = self.stock.interval(point[solid, :2])
        solid[solid] = (point[solid, 2] < top - NOTHING) & (point[solid, 2] >= bottom)
        return np.asarray(solid)

    def _list_before(
        self, row: NDArray[np.int_], moves: NDArray[np.int_], live: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """List pairs of a sample and an earlier move of the chunk."""
        if not len(row) or self.run_from[row[-1]] <= moves[0]:  # runs begin in order, like rows
            return row[:0], moves[:0]
        before = np.searchsorted(moves, self.run_from[row], side="left") * live
        sample = np.repeat(np.arange(len(row)), before)
        return sample, moves[np.arange(before.sum()) - np.repeat(np.cumsum(before) - before, before)]


class _FlatEdge(_EdgeSolver):
    """Engagement from the height of the material at each angle, for a flat cutter with a fixed axis."""

    def fill(self, rows: NDArray[np.int_], moves: NDArray[np.int_]) -> None:
        """Compute the engaged shares of some waypoints, see `_EdgeSolver`."""
        angles = middle_angles(ANGLES)
        out = self.found.speed(angles, rows) > SLIDES
        n, k, m = np.nonzero(out)
        share = self._share(rows[n], k, angles[m], moves)
        found = np.zeros(out.shape, dtype=np.float32)
        found[n, k, m] = share

        def reaches(place: Bins, more: Shares, less: Shares, angle: Array) -> NDArray[np.bool_]:
            n, k, _ = place
            middle_share = np.where(less > 0.0, 0.5 * (more + less), 0.0)
            return np.asarray(self._share(rows[n], k, angle, moves) > middle_share)

        _end_arcs(found, out, reaches, BISECTIONS)
        self.found.depth[rows] = np.clip(found, 0.0, 1.0)

    def _share(self, row: NDArray[np.int_], k: NDArray[np.int_], angle: Array, moves: NDArray[np.int_]) -> Array:
        """Return the engaged share of slices at angles. Shape (s,)."""
        edge, share = self.cutter.slices, np.zeros(len(row))
        along, across = np.cos(angle) * edge.radius[k], np.sin(angle) * edge.radius[k]
        tip, side = self.position[row], self.frame[row, :2, 0]
        place = np.stack([tip[:, 0] + along * side[:, 0] - across * side[:, 1],
                          tip[:, 1] + along * side[:, 1] + across * side[:, 0]], axis=1)  # fmt: skip
        bottom, top = self.stock.interval(place)
        low = tip[:, 2] + edge.low[k]
        live = np.flatnonzero(top - NOTHING > low)
        if not len(live):
            return share
        place, bottom, low, k, row = place[live], bottom[live], low[live], k[live], row[live]
        rise, swept = edge.rise[k], self.surface.lowest(place)
        top = np.minimum(top[live], swept)
        self._cut_in_chunk(row, place, low, top, moves)
        flat = rise < NOTHING
        part = np.minimum(top, low + rise) - np.maximum(bottom, low)
        side_share = np.where(part > NOTHING, np.clip(part / np.where(flat, 1.0, rise), 0.0, 1.0), 0.0)
        share[live] = np.where(flat, (top > low + NOTHING) & (bottom <= low), side_share)
        return share

    def _cut_in_chunk(
        self, row: NDArray[np.int_], place: Array, low: Array, top: Array, moves: NDArray[np.int_]
    ) -> None:
        """Lower the tops by earlier moves of the chunk, except those on the same straight line, which are behind."""
        if not len(moves):
            return
        sample, move = self._list_before(row, moves, top - NOTHING > low)
        if len(sample):
            reach = lowest_reach(self.cutter, place[sample], self.start[move], self.position[move])
            np.minimum.at(top, sample, reach)


class _PointEdge(_EdgeSolver):
    """Engagement from points of the edge, for all other cutters and for changing axes."""

    def _count_halvings(self, k: NDArray[np.int_]) -> int:
        """Return the number of bisection steps that locates the end of a slice's engaged part to `END_ERROR`."""
        longest = float(self.cutter.slices.length[k].max(initial=0.0)) / self.cutter.radius
        return int(np.ceil(np.log2(max(longest / END_ERROR, 4.0)))) - 1

    def fill(self, rows: NDArray[np.int_], moves: NDArray[np.int_]) -> None:
        """Compute the engaged shares of some waypoints, see `_EdgeSolver`."""
        angles = middle_angles(ANGLES)
        out = self.found.speed(angles, rows) > SLIDES
        lower = self.cutter.lower
        if lower.any():  # a slice moves outwards if one of its ends does
            speeds = self.found.lower_speeds(angles, rows)
            out[:, lower] = np.maximum(*speeds) > SLIDES
        tested = np.zeros((len(rows), out.shape[1] + 1, len(angles)), dtype=bool)
        tested[:, :-1] |= out
        tested[:, 1:] |= out
        place = self._place_knots(rows, angles)
        tested &= place[..., 2] < self.stock.box[1, 2]  # points above the stock are not tested
        n, j, m = np.nonzero(tested)
        tested[n, j, m] = self._uncut(place[n, j, m], rows[n], moves)
        low, high = tested[:, :-1] & out, tested[:, 1:] & out
        found = (low & high).astype(np.float32)
        straight = ~lower[:, None]
        n, k, m = np.nonzero((low ^ high) & straight)
        hit, start = partial(self._solid, rows[n], k, angles[m], moves), np.where(low[n, k, m], 0.0, 1.0)
        found[n, k, m] = _halve(hit, start, 1.0 - 2.0 * start, self._count_halvings(k))
        from_low, upright = low | ~high, np.abs(self.cutter.slices.normal[:, 1:]) < 1e-9

        def reaches(place: Bins, more: Shares, less: Shares, angle: Array) -> NDArray[np.bool_]:
            n, k, _ = place
            middle = np.where(from_low[place], 0.5 * (more + less), 1.0 - 0.5 * (more + less))
            return self._solid(rows[n], k, angle, moves, middle)

        # where the boundary is oblique, the middles of the bins are sufficient
        _end_arcs(found, out & straight, reaches, ARC_HALVINGS, upright | (found == 1.0))
        if lower.any():
            whole = low & high
            whole[:, lower] &= np.minimum(*speeds) > 0.0
            self._fill_lower(found, (rows, moves, angles), whole, low | high)
        self.found.depth[rows] = np.clip(found, 0.0, 1.0)

    def _fill_lower(
        self, found: NDArray[np.float32], where: tuple[NDArray[np.int_], NDArray[np.int_], Array],
        whole: NDArray[np.bool_], some: NDArray[np.bool_],
    ) -> None:  # fmt: skip
        """Compute the shares of partly engaged bins of the lower surface, as the mean of `STRIPS` angles in each.

        Both ends of a strip are located: where it begins to move outwards, and where the material ends. The remaining
        error is due to the curvature of these ends within a strip.
        """
        rows, moves, angles = where
        nearby = (some | np.roll(some, 1, axis=2) | np.roll(some, -1, axis=2)) & self.cutter.lower[:, None]
        steady = whole & np.roll(whole, 1, axis=2) & np.roll(whole, -1, axis=2)
        n, k, m = np.nonzero(nearby & ~steady)
        first = int(np.argmax(self.cutter.lower))
        total = np.zeros(len(n))
        for strip in range(STRIPS):
            off = ((strip + 0.5) / STRIPS - 0.5) * 2.0 * np.pi / len(angles)
            low, high = (speed[n, k - first, m] for speed in self.found.lower_speeds(angles + off, rows))
            begin, end = outward_span(low, high)
            live = np.flatnonzero(end > begin)
            at, slices, angle = rows[n[live]], k[live], angles[m[live]] + off
            span = end[live] - begin[live]
            ends = [self._solid(at, slices, angle, moves, side[live]) for side in (begin, end)]
            share = np.where(ends[0] & ends[1], span, 0.0)
            part = np.flatnonzero(ends[0] ^ ends[1])
            fix, sign = np.where(ends[0], begin[live], end[live])[part], np.where(ends[0], 1.0, -1.0)[part]
            hit = partial(self._solid, at[part], slices[part], angle[part], moves)
            share[part] = span[part] * _halve(hit, fix, sign * span[part], self._count_halvings(slices[part]))
            total[live] += share
        found[n, k, m] = total / STRIPS

    def _solid(
        self, row: NDArray[np.int_], k: NDArray[np.int_], angle: Array, moves: NDArray[np.int_], share: Array
    ) -> NDArray[np.bool_]:
        """Return which points of the edge are in material. Shape (s,)."""
        rho, height = self.cutter.edge_point(k, share)
        local = np.stack([rho * np.cos(angle), rho * np.sin(angle), height], axis=1)
        return self._uncut(self.position[row] + np.einsum("sij,sj->si", self.frame[row], local), row, moves)

    def _place_knots(self, rows: NDArray[np.int_], angles: Array) -> Array:
        """Return the positions of the ends of the slices at angles. Shape (r, k + 1, m, 3). [m]"""
        rho, height = self.cutter.slices.knots.T[:, :, None]
        ring = np.stack([rho * np.cos(angles), rho * np.sin(angles), np.broadcast_to(height, (len(rho), len(angles)))])
        place = self.frame[rows] @ ring.reshape(3, -1) + self.position[rows][:, :, None]
        return np.moveaxis(place, 1, -1).reshape(len(rows), *ring.shape[1:], 3)

    def _uncut(self, point: Array, row: NDArray[np.int_], moves: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Return which points are in the stock that moves before those of rows left. Shape (s,)."""
        solid = self._in_stock(point)
        solid[solid] = self.surface.uncut(point[solid], self.run_from[row[solid]])
        if len(moves):
            sample, move = self._list_before(row, moves, solid)
            if len(sample):
                solid[sample[self.surface.gap(point[sample], move) < NOTHING]] = False
        return np.asarray(solid)


def _end_arcs(
    found: NDArray[np.float32], out: NDArray[np.bool_],
    reaches: Callable[[Bins, Shares, Shares, Array], NDArray[np.bool_]], halvings: int,
    where: NDArray[np.bool_] | None = None,
) -> None:  # fmt: skip
    """Locate the ends of arcs: steps to a neighbour that moves outwards, but is engaged less than `THIN` of the bin.

    `reaches` returns from bins, shares of both, and angles, which angles are still engaged.
    """
    steady, angles, turn = found.copy(), middle_angles(ANGLES), 2.0 * np.pi / ANGLES
    for way in (1, -1):
        other = np.roll(steady, -way, axis=2)
        ends = (steady > 0.0) & (other < THIN * steady) & np.roll(out, -way, axis=2)
        place = np.nonzero(ends if where is None else ends & where)
        more, less = steady[place], other[place]
        turned = _halve(partial(reaches, place, more, less), angles[place[2]], way * turn, halvings)
        reach = (turned - 0.5).astype(np.float32)  # in bins, from the boundary
        n, k, m = place
        np.add.at(found, (n, k, m), np.minimum(reach, 0.0) * (more - less))
        np.add.at(found, (n, k, (m + way) % ANGLES), np.maximum(reach, 0.0) * (more - less))


def _halve(hit: Callable[[Array], NDArray[np.bool_]], start: Array, extent: Array | float, times: int) -> Array:
    """Locate by bisection the change from a hit, at the start, to none; as shares of the extent. Shape (count,)."""
    low, high = np.zeros(len(start)), np.ones(len(start))
    for _ in range(times if len(start) else 0):
        middle = 0.5 * (low + high)
        found = hit(start + extent * middle)
        low, high = np.where(found, middle, low), np.where(found, high, middle)
    return 0.5 * (low + high)


def _find_runs(step: Array, axis: Array | None) -> NDArray[np.int_]:
    """Return for each move the first one since which neither travel nor axis turned far. Shape (n,)."""
    turned = np.zeros(len(step))
    for way in (step, axis):
        if way is not None:
            unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-300)[:, None]
            turned[1:] += np.arccos(np.clip(np.einsum("ni,ni->n", unit[1:], unit[:-1]), -1.0, 1.0))
    total = np.cumsum(turned)
    return np.asarray(np.searchsorted(total, total - SAME_WAY))


def _straight_from(step: Array, size: Array) -> NDArray[np.int_]:
    """Return the first move of the straight line that each move continues. Shape (n,)."""
    unit = step / np.maximum(size, 1e-300)[:, None]
    turns = np.ones(len(step), dtype=bool)
    turns[1:] = np.einsum("ni,ni->n", unit[1:], unit[:-1]) < STRAIGHT
    return np.maximum.accumulate(np.where(turns, np.arange(len(step)), 0))
