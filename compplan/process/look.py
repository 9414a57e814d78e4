"""What a cutter is held against at every waypoint, and where it crashes: rapid moves, shank and holder in material."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.process.cutter import Cutter
from compplan.process.engagement import outward_speed
from compplan.process.stock import StockColumns
from compplan.process.wake import NOTHING, Wake

#: Outward speed as a share of the feed below which the surface only slides. A tool's own floor is none of it.
SLIDES = 1e-6
#: A crash is deeper than this, in radii; rapid moves are looked at in so many places at most; a move goes sideways from
#: this share of its length across the axis on.
SKIN, MOST_STATIONS, SIDEWAYS = 0.02, 2000, 0.1


@dataclass(frozen=True)
class Crashes:
    """What meets material that it cannot cut; n waypoints.

    Attributes:
        rapid: Rapid moves that go through material. Shape (n,).
        shank: Waypoints at which the tool above its edges meets material. Shape (n,).
        holder: Waypoints at which its holder does, or on the rapid way to which. Shape (n,).

    """

    rapid: NDArray[np.bool_]
    shank: NDArray[np.bool_]
    holder: NDArray[np.bool_]

    @classmethod
    def none(cls, count: int) -> Crashes:
        """Return none at all, to be marked."""
        return cls(*(np.zeros(count, dtype=bool) for _ in range(3)))


@dataclass(frozen=True)
class Above:
    """What of a tool stands above its edges.

    Attributes:
        shank: Height above the tip from which on the tool, as wide as before, has no edges; None: not looked at. [m]
        holder: Heights above the tip and radii of the holder, from its nose up. Shape (h, 2). [m]

    """

    shank: float | None = None
    holder: Array | None = None


@dataclass(frozen=True)
class Look:
    """Holds the cutter's surface against what is left of the stock."""

    cutter: Cutter
    wake: Wake
    stock: StockColumns
    position: Array
    start: Array
    frame: Array
    travel: Array
    turning: Array | None
    run_from: NDArray[np.int_]

    def fill(self, rows: NDArray[np.int_], moves: NDArray[np.int_], depth: NDArray[np.float32]) -> None:
        """Write the engaged shares of some waypoints, the moves of the same chunk taken in their order."""
        raise NotImplementedError

    def mark_rapid(self, rows: NDArray[np.int_], moves: NDArray[np.int_], crashes: NDArray[np.bool_]) -> None:
        """Mark rapid moves whose cutter goes through material on its way."""
        box = self.stock.bounds()
        reach = self.cutter.radius + (0.0 if self.wake.tilt is None else self.cutter.flute)
        low, high = (pick(self.start[rows], self.position[rows]) for pick in (np.minimum, np.maximum))
        near = (low[:, :2] < box[1, :2] + reach).all(axis=1) & (high[:, :2] > box[0, :2] - reach).all(axis=1)
        near &= low[:, 2] < box[1, 2] + (0.0 if self.wake.tilt is None else reach)
        rho = np.append(np.repeat([0.5, 1.0 - SKIN], 8), 0.0) * self.cutter.radius
        turn = np.append(np.tile(np.arange(8) * np.pi / 4.0, 2), 0.0)
        up = self.cutter.height(rho) + SKIN * self.cutter.radius
        ring = np.stack([rho * np.cos(turn), rho * np.sin(turn), up], axis=1)
        for row in rows[near]:
            way = self.position[row] - self.start[row]
            count = int(np.clip(np.ceil(np.linalg.norm(way) / (0.5 * self.cutter.radius)), 1, MOST_STATIONS))
            tips = self.start[row] + np.linspace(0.0, 1.0, count + 1)[1:, None] * way
            points = (tips[:, None] + ring @ self.frame[row].T).reshape(-1, 3)
            crashes[row] = self._stand(points, np.full(len(points), row), moves[moves < row]).any()

    def mark_shank(
        self, rows: NDArray[np.int_], moves: NDArray[np.int_], shank: float, crashes: NDArray[np.bool_]
    ) -> None:
        """Mark waypoints at which what stands above the edges meets material ahead."""
        rows = rows[self.travel[rows, 0] > SIDEWAYS]
        turn = np.radians([-75.0, -40.0, 0.0, 40.0, 75.0])
        round_axis = np.stack([np.cos(turn), np.sin(turn)], axis=1) * self.cutter.radius
        ring = np.column_stack([round_axis, np.full(len(turn), shank + SKIN * self.cutter.radius)])
        points = self.position[rows, None] + np.einsum("rij,kj->rki", self.frame[rows], ring)
        row = np.repeat(rows, len(turn))
        meets = self._stand(points.reshape(-1, 3), self.run_from[row], moves)
        np.logical_or.at(crashes, row, meets)

    def mark_holder(
        self, rows: NDArray[np.int_], moves: NDArray[np.int_], holder: Array, crashes: NDArray[np.bool_]
    ) -> None:
        """Mark waypoints at which a holder meets material, or on the way to which, where the move is long."""
        skin = SKIN * self.cutter.radius
        turn = np.arange(16) * np.pi / 8.0
        height, radius = holder[0]
        nose = [(share * radius, height + skin) for share in (0.4, 0.7)]
        rings = np.array([*nose, *((max(r - skin, 0.0), h + skin) for h, r in _divide(holder, 0.5 * radius))])
        points = np.concatenate([np.stack([r * np.cos(turn), r * np.sin(turn), np.full(16, h)], axis=1)
                                 for r, h in rings])  # fmt: skip
        box = self.stock.bounds()
        reach = float(np.hypot(*holder.max(axis=0)))
        lift = height if self.wake.tilt is None else -reach
        rows = rows[np.minimum(self.start[rows, 2], self.position[rows, 2]) + lift < box[1, 2]]
        for row in rows:
            way = self.position[row] - self.start[row]
            count = int(np.clip(np.ceil(np.linalg.norm(way) / (0.5 * radius)), 1, MOST_STATIONS))
            tips = self.start[row] + np.linspace(0.0, 1.0, count + 1)[1:, None] * way
            near = (tips[:, :2] < box[1, :2] + reach).all(axis=1) & (tips[:, :2] > box[0, :2] - reach).all(axis=1)
            tips = tips[near & (tips[:, 2] + lift < box[1, 2])]
            if len(tips):
                place = (tips[:, None] + points @ self.frame[row].T).reshape(-1, 3)
                crashes[row] = self._stand(place, np.full(len(place), row + 1), moves[moves <= row]).any()

    def _stand(self, point: Array, before: NDArray[np.int_], moves: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Tell which points stand in what the moves before some number left. Shape (s,)."""
        solid = self._in_stock(point)
        solid[solid] = self.wake.uncut(point[solid], before[solid])
        for move in moves:
            some = np.flatnonzero(solid & (before > move))
            if len(some):
                solid[some] = self.wake.gap(point[some], np.full(len(some), move)) >= NOTHING
        return np.asarray(solid)

    def _in_stock(self, point: Array) -> NDArray[np.bool_]:
        """Tell which points stand in the stock as it was before the first move. Shape (s,)."""
        solid = point[:, 2] < self.stock.crest(point[:, :2])
        bottom, top = self.stock.interval(point[solid, :2])
        solid[solid] = (point[solid, 2] < top - NOTHING) & (point[solid, 2] >= bottom)
        return np.asarray(solid)

    def may_touch(self, rows: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Tell where the cutter is near enough to the stock. Shape (r,)."""
        box, tip, reach = self.stock.bounds(), self.position[rows], self.cutter.radius
        low = tip[:, 2]
        if self.wake.tilt is not None:
            low = low - reach
            reach = reach + self.cutter.flute
        beside = (tip[:, :2] > box[0, :2] - reach) & (tip[:, :2] < box[1, :2] + reach)
        return np.asarray(beside.all(axis=1) & (low < box[1, 2]))

    def _outward(self, rows: NDArray[np.int_], angles: Array) -> NDArray[np.bool_]:
        turning = None if self.turning is None else self.turning[rows]
        return outward_speed(self.cutter.slices, self.travel[rows], angles, turning) > SLIDES

    def _list_before(self, row: NDArray[np.int_], moves: NDArray[np.int_], live: NDArray[np.bool_]) -> tuple[
        NDArray[np.int_], NDArray[np.int_]
    ]:
        """List pairs of a sample and a move of the chunk that came before it."""
        if not len(row) or self.run_from[row[-1]] <= moves[0]:  # runs begin in order, as rows do
            return row[:0], moves[:0]
        before = np.searchsorted(moves, self.run_from[row], side="left") * live
        sample = np.repeat(np.arange(len(row)), before)
        return sample, moves[np.arange(before.sum()) - np.repeat(np.cumsum(before) - before, before)]


def _divide(profile: Array, apart: float) -> list[tuple[float, float]]:
    """Return a profile's points, and points between them that are no farther apart."""
    found = [(float(profile[0, 0]), float(profile[0, 1]))]
    for a, b in itertools.pairwise(profile):
        count = max(int(np.ceil(np.linalg.norm(b - a) / apart)), 1)
        found += [tuple(a + (k + 1) / count * (b - a)) for k in range(count)]
    return found
