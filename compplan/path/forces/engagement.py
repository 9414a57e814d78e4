"""Where a cutter touches its stock at every waypoint: which slices of its edge, at which angles round its axis.

At the end of a move the cutter's surface, as far as it moves outwards there, is held against what was left of the
stock before the move. The angle u counts from the travel (its part across the axis) to the left, seen down the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.files.tables import Array
from compplan.path.contact import last_set
from compplan.path.forces.cutter import Cutter
from compplan.path.forces.stock import StockColumns
from compplan.path.forces.wake import Wake, build_wake, lowest_reach

#: Angles round the axis, a multiple of 4; moves that are looked at together; steps that find the edge of an arc.
ANGLES, CHUNK, BISECTIONS = 48, 16, 9
#: Outward speed as a share of the feed below which the surface only slides. A tool's own floor is none of it.
SLIDES = 1e-6
#: Material that is thinner than this is none. [m]
NOTHING = 1e-9
#: A bin that is engaged by less than this share of its neighbour's stands beyond the end of an arc: a film that a tool
#: takes off a floor is no part of the cut at a wall.
THIN = 0.25
#: Cosine of the angle between moves from which on they lie on one straight line.
STRAIGHT = 1.0 - 1e-12


@dataclass(frozen=True)
class Engagement:
    """What the cutter touches at n waypoints; k slices of its edge, m angles.

    Attributes:
        cutter: The cutter.
        depth: Engaged share of the slice (k) in the bin at the angle (m), 0 to 1. Shape (n, k, m).
        travel: Direction of the move that ends at the waypoint: across the axis, along it. Shape (n, 2).
        level: Height of the tip above the lowest point of the path, along the axis. Shape (n,). [m]

    """

    cutter: Cutter
    depth: NDArray[np.float32]
    travel: Array
    level: Array

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def angles(self) -> Array:
        """Middle of each bin. Shape (m,). [rad]"""
        return middle_angles(self.depth.shape[2])

    @cached_property
    def touches(self) -> NDArray[np.bool_]:
        """Waypoints where the cutter is in material. Shape (n,)."""
        return np.asarray(self.depth.any(axis=(1, 2)))

    @cached_property
    def axial(self) -> Array:
        """Axial depth: from the lowest to the highest engaged point of the edge. Shape (n,). [m]"""
        edge = self.cutter.slices
        whole = self.depth.max(axis=2)
        top = np.where(whole > 0.0, edge.low + whole * edge.rise, -np.inf).max(axis=1)
        bottom = np.where(whole > 0.0, edge.low, np.inf).min(axis=1)
        return np.where(self.touches, np.maximum(top - bottom, 0.0), 0.0)

    @cached_property
    def section(self) -> Array:
        """Area that the move sweeps through material: volume removed a length of path. Shape (n,). [m^2]"""
        edge = self.cutter.slices
        turn = 2.0 * np.pi / self.depth.shape[2]
        out = np.maximum(outward_speed(edge.normal, self.travel, self.angles), 0.0)
        return np.asarray(turn * np.einsum("nkm,nkm,k->n", self.depth, out, edge.radius * edge.length), np.float64)

    @cached_property
    def radial(self) -> Array:
        """Radial width: extent of the engaged surface across the travel. Shape (n,). [m]"""
        left, right = self._sides()
        return np.where(self.touches, np.maximum(left - right, 0.0), 0.0)

    @cached_property
    def arc(self) -> Array:
        """First and last engaged angle from the travel to the left, NaN in the air. Shape (n, 2). [rad]"""
        weight = self.depth.max(axis=1)
        half = np.pi / self.depth.shape[2]
        angle = (self.angles + np.pi) % (2.0 * np.pi) - np.pi
        order = np.argsort(angle)
        some = weight[:, order] > 0.0
        first = some.argmax(axis=1)
        last = some.shape[1] - 1 - some[:, ::-1].argmax(axis=1)
        rows = np.arange(len(self))
        share = weight[:, order] / np.maximum(weight.max(axis=1, keepdims=True), 1e-30)
        lowest = angle[order][first] + half - 2.0 * half * share[rows, first]
        highest = angle[order][last] - half + 2.0 * half * share[rows, last]
        arc = np.column_stack([lowest, highest])
        arc[~self.touches] = np.nan
        return arc

    def _sides(self) -> tuple[Array, Array]:
        """Return how far the engaged surface reaches to the left and to the right. Shapes (n,). [m]"""
        half = np.pi / self.depth.shape[2]
        knots = self.cutter.slices.knots[:, 0]
        left, right = np.full(len(self), -np.inf), np.full(len(self), np.inf)
        for k in range(self.depth.shape[1]):
            here = self.depth[:, k]
            whole = here.max(axis=1, keepdims=True)
            radius = knots[k] + whole[:, 0] * (knots[k + 1] - knots[k])
            # a bin that is engaged in part is so beside its engaged neighbour
            gap = 2.0 * half * (1.0 - here / np.maximum(whole, 1e-30))
            before, after = np.roll(here, 1, axis=1), np.roll(here, -1, axis=1)
            start = self.angles - half + np.where(after > before, gap, 0.0)
            end = self.angles + half - np.where(before > after, gap, 0.0)
            sines = np.stack([np.sin(start), np.sin(end)])
            some = here > 0.0
            left = np.maximum(left, np.where(some, radius[:, None] * sines.max(axis=0), -np.inf).max(axis=1))
            right = np.minimum(right, np.where(some, radius[:, None] * sines.min(axis=0), np.inf).min(axis=1))
        return left, right


def middle_angles(count: int) -> Array:
    """Return the middle of each of `count` bins of a turn. [rad]"""
    return np.asarray((np.arange(count) + 0.5) * (2.0 * np.pi / count), dtype=np.float64)


def outward_speed(normal: Array, travel: Array, angle: Array) -> Array:
    """Return how fast the surface moves outwards, as a share of the feed.

    Args:
        normal: Outward normal of each slice: away from the axis, along it. Shape (k, 2).
        travel: Direction of travel: across the axis, along it. Shape (n, 2).
        angle: Angle from the travel. Shape (m,). [rad]

    Returns:
        Shape (n, k, m).

    """
    across = travel[:, 0, None, None] * (normal[:, 0, None] * np.cos(angle))
    return np.asarray(across + travel[:, 1, None, None] * normal[:, 1, None])


def find_engagement(
    cutter: Cutter,
    position: Array,
    cutting: NDArray[np.bool_],
    stock: StockColumns,
    meant: Array | None = None,
) -> tuple[Engagement, NDArray[np.bool_]]:
    """Find the engagement at every waypoint of a path that cuts its way through stock.

    Args:
        cutter: The cutter; its axis is the third axis of the frame.
        position: Tips. Shape (n, 3). [m]
        cutting: Whether the move that ends here removes material (rapid moves do not). Shape (n,).
        stock: The stock before the first move, same frame.
        meant: Tips of the path, for a tool that gives way from it. Where it is then decides what it meets; its chips
            are those of the path's travel: that it drifts aside meanwhile is little beside the feed, but in a corner,
            and left out. Shape (n, 3). [m]

    Returns:
        The engagement, and the waypoints whose rapid move ends in material. Shape (n,).

    """
    n, edge = len(position), cutter.slices
    start = np.vstack([position[:1], position[:-1]])
    step, moving = _list_steps(position)
    size = np.linalg.norm(step, axis=1)
    travel, side = _split_travel(_list_steps(position if meant is None else meant)[0])
    bounds = stock.bounds()[:, :2]
    near = np.stack([position[:, :2].min(axis=0), position[:, :2].max(axis=0)])
    margin = 1.5 * cutter.radius
    area = np.stack([np.maximum(bounds[0], near[0] - margin), np.minimum(bounds[1], near[1] + margin)])
    depth = np.zeros((n, len(edge), ANGLES), dtype=np.float32)
    inside = np.zeros(n, dtype=bool)
    if (area[1] <= area[0]).any():
        return Engagement(cutter, depth, travel, position[:, 2] - position[:, 2].min()), inside
    wake = build_wake(cutter, start, position, area)
    look = _Look(cutter, wake, stock, position, start, travel, side, _straight_from(step, size))
    removing = cutting & moving
    removing[0] = False
    for first in range(0, n, CHUNK):
        rows = np.arange(first, min(first + CHUNK, n))
        moves = rows[removing[rows]]
        look.fill(rows[cutting[rows]], moves, depth)
        inside[rows[~cutting[rows]]] = look.meets(rows[~cutting[rows]])
        wake.cut(moves)
    return Engagement(cutter, depth, travel, position[:, 2] - position[:, 2].min()), inside


def _list_steps(position: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the move that ends at each waypoint, that before it where the tool rests, and whether it moves."""
    step = np.diff(position, axis=0, prepend=position[:1])
    step[0] = step[1] if len(position) > 1 else [1.0, 0.0, 0.0]
    moves = np.linalg.norm(step, axis=1) > 0.0
    return step[last_set(moves)], moves  # a tool that rests is engaged as it came


def _split_travel(step: Array) -> tuple[Array, Array]:
    """Return the direction of travel as (across, along) the axis, and across it as a unit vector; kept in plunges."""
    size = np.linalg.norm(step, axis=1)
    across = np.linalg.norm(step[:, :2], axis=1)
    unit = np.maximum(size, 1e-300)
    travel = np.column_stack([across / unit, step[:, 2] / unit])
    clear = across > 1e-6 * unit
    if not clear.any():
        return travel, np.tile([1.0, 0.0], (len(step), 1))
    last = last_set(clear)
    return travel, step[last, :2] / across[last, None]


@dataclass(frozen=True)
class _Look:
    """Holds the cutter's surface against what is left of the stock."""

    cutter: Cutter
    wake: Wake
    stock: StockColumns
    position: Array
    start: Array
    travel: Array
    side: Array
    straight_from: NDArray[np.int_]

    def fill(self, rows: NDArray[np.int_], moves: NDArray[np.int_], depth: NDArray[np.float32]) -> None:
        """Write the engaged shares of some waypoints, the moves of the same chunk taken in their order."""
        rows = rows[self._may_touch(rows)]
        if not len(rows):
            return
        edge, angles = self.cutter.slices, middle_angles(ANGLES)
        out = outward_speed(edge.normal, self.travel[rows], angles) > SLIDES
        n, k, m = np.nonzero(out)
        share = self._share(rows[n], k, angles[m], moves)
        found = np.zeros(out.shape, dtype=np.float32)
        found[n, k, m] = share
        turn, steady = 2.0 * np.pi / ANGLES, found.copy()
        # the ends of arcs: between a bin and one that could be engaged but is less than THIN so, the step is sought
        for way in (1, -1):
            other = np.roll(steady, -way, axis=2)
            n, k, m = np.nonzero((steady > 0.0) & (other < THIN * steady) & np.roll(out, -way, axis=2))
            if not len(n):
                continue
            more, less = steady[n, k, m], other[n, k, m]
            middle_share = np.where(less > 0.0, 0.5 * (more + less), 0.0)
            low, high = np.zeros(len(n)), np.ones(len(n))
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                hit = self._share(rows[n], k, angles[m] + way * turn * middle, moves) > middle_share
                low, high = np.where(hit, middle, low), np.where(hit, high, middle)
            reach = (0.5 * (low + high) - 0.5).astype(np.float32)  # in bins, from the boundary of the engaged bin
            np.add.at(found, (n, k, m), np.minimum(reach, 0.0) * (more - less))
            np.add.at(found, (n, k, (m + way) % ANGLES), np.maximum(reach, 0.0) * (more - less))
        depth[rows] = np.clip(found, 0.0, 1.0)

    def meets(self, rows: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Tell where the tip stands in material. Shape (r,)."""
        place = self.position[rows, :2]
        bottom, top = self.stock.interval(place)
        top = np.minimum(top, self.wake.lowest(place))
        z = self.position[rows, 2]
        return np.asarray((z < top - 1e-6) & (z > bottom - self.cutter.flute))

    def _may_touch(self, rows: NDArray[np.int_]) -> NDArray[np.bool_]:
        box = self.stock.bounds()
        position = self.position[rows]
        beside = (position[:, :2] > box[0, :2] - self.cutter.radius) & (
            position[:, :2] < box[1, :2] + self.cutter.radius
        )
        return np.asarray(beside.all(axis=1) & (position[:, 2] < box[1, 2]))

    def _share(self, row: NDArray[np.int_], k: NDArray[np.int_], angle: Array, moves: NDArray[np.int_]) -> Array:
        """Return the engaged share of slices at angles. Shape (s,)."""
        edge, share = self.cutter.slices, np.zeros(len(row))
        along, across = np.cos(angle) * edge.radius[k], np.sin(angle) * edge.radius[k]
        tip, side = self.position[row], self.side[row]
        place = np.stack([tip[:, 0] + along * side[:, 0] - across * side[:, 1],
                          tip[:, 1] + along * side[:, 1] + across * side[:, 0]], axis=1)  # fmt: skip
        bottom, top = self.stock.interval(place)
        low = tip[:, 2] + edge.low[k]
        live = np.flatnonzero(top - NOTHING > low)
        if not len(live):
            return share
        place, bottom, low, k, row = place[live], bottom[live], low[live], k[live], row[live]
        rise, swept = edge.rise[k], self.wake.lowest(place)
        if self.cutter.point < np.pi:  # a cone that follows itself down an axis meets a floor of its own slope
            swept = np.where(swept > low + 0.5 * rise + NOTHING, np.inf, swept)
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
        """Lower the tops by moves of the chunk that came before; those on the same straight line lie behind."""
        if not len(moves):
            return
        live = top - NOTHING > low
        before = np.searchsorted(moves, self.straight_from[row], side="left") * live
        if not before.any():
            return
        sample = np.repeat(np.arange(len(row)), before)
        move = moves[np.arange(before.sum()) - np.repeat(np.cumsum(before) - before, before)]
        reach = lowest_reach(self.cutter, place[sample], self.start[move], self.position[move])
        np.minimum.at(top, sample, reach)


def _straight_from(step: Array, size: Array) -> NDArray[np.int_]:
    """Return the first move of the straight line that each move goes on with. Shape (n,)."""
    unit = step / np.maximum(size, 1e-300)[:, None]
    turns = np.ones(len(step), dtype=bool)
    turns[1:] = np.einsum("ni,ni->n", unit[1:], unit[:-1]) < STRAIGHT
    return np.maximum.accumulate(np.where(turns, np.arange(len(step)), 0))
