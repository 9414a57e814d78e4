"""Base of the two ways to find the engaged part of a cutter's edge, see `compplan.process.engagement_search`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.process.cut_surface import NOTHING, CutSurface
from compplan.process.cutter import Cutter
from compplan.process.engagement import outward_speed
from compplan.process.stock import StockColumns

#: Outward speed as a share of the feed below which the surface only slides. A tool's own floor is none of it.
SLIDES = 1e-6


@dataclass(frozen=True)
class EdgeSolver:
    """Compares the edge of a cutter with what earlier moves left of the stock."""

    cutter: Cutter
    wake: CutSurface
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

    def _list_before(
        self, row: NDArray[np.int_], moves: NDArray[np.int_], live: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """List pairs of a sample and a move of the chunk that came before it."""
        if not len(row) or self.run_from[row[-1]] <= moves[0]:  # runs begin in order, as rows do
            return row[:0], moves[:0]
        before = np.searchsorted(moves, self.run_from[row], side="left") * live
        sample = np.repeat(np.arange(len(row)), before)
        return sample, moves[np.arange(before.sum()) - np.repeat(np.cumsum(before) - before, before)]
