"""The stock as a cutter finds it: a block or a mesh as a job states it, less what cutters before took away."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable, Vector3
from compplan.process.cut_surface import NOTHING, CutSurface, build_cut_surface
from compplan.process.engagement import Cutter
from compplan.process.stock import LARGEST, HeightMap, StockColumns, build_block, build_height_map, read_mesh
from compplan.toolpath.toolpath import Toolpath

#: Stock without a known shape reaches this many diameters beyond the path.
BEYOND = 2.0
#: Columns of a mesh, to a radius of the cutter.
MESH_COLUMNS = 8.0
#: An axis that leans by less than this from the view stands. [rad]
UPRIGHT = 1e-6
#: Cutting moves that are entered at a time, columns of a stock that was cut at an angle, and layers.
MOVES_AT_ONCE, MOST_COLUMNS, MOST_LAYERS = 64, 40_000, 400
#: Columns thinner than this are none. [m]
THIN_COLUMN = 1e-6

Corner = Annotated[tuple[Vector3, Vector3], Field(strict=False)]


class StockTable(StrictTable):
    """[process.stock]: what is cut, part frame: `block_mm` (two corners), or `mesh`, a closed STL, PLY or OBJ file."""

    block_mm: Corner | None = None
    mesh: str | None = None
    unit: Literal["mm", "m", "inch"] = "mm"

    @model_validator(mode="after")
    def _check(self) -> StockTable:
        if (self.block_mm is None) == (self.mesh is None):
            raise ValueError("needs one of block_mm and mesh, not both")
        if self.block_mm is not None and not np.all(np.diff(self.block_mm, axis=0) > 0.0):
            raise ValueError("block_mm needs its lowest corner first, then its highest")
        if self.block_mm is not None and np.ptp(self.block_mm, axis=0).max() > 1e3 * LARGEST:
            size = np.ptp(self.block_mm, axis=0).max()
            raise ValueError(f"block_mm is {size:.4g} mm large, at most {1e3 * LARGEST:g} mm is allowed")
        return self


@dataclass(frozen=True)
class Cut:
    """A cutter that goes through stock; n waypoints, in the frame that the stock is seen in."""

    cutter: Cutter  #: The cutter.
    position: Array  #: Tips. Shape (n, 3). [m]
    axis: Array  #: Tool axes, tip to spindle. Shape (n, 3).
    cutting: NDArray[np.bool_]  #: Whether the move that ends here removes material. Shape (n,).


@dataclass(frozen=True)
class CutStock:
    """Stock less what a cutter took away whose axis stood along the columns."""

    before: StockColumns  #: The stock before.
    surface: CutSurface  #: What the cutter swept.

    def interval(self, place: Array) -> tuple[Array, Array]:
        """Return bottom and top of the columns, see `StockColumns`."""
        low, high = self.before.interval(place)
        return low, np.minimum(high, self.surface.lowest(place))

    def bounds(self) -> Array:
        """Return the box around the stock before, see `StockColumns`."""
        return self.before.bounds()


def take_away(stock: StockColumns, cuts: Sequence[Cut]) -> StockColumns:
    """Return what cutters leave of stock, one after the other.

    Exact where their axes stand along the columns. Elsewhere columns are asked in steps where they are solid, and take
    in what hangs over a hollow.
    """
    for cut in cuts:
        upright = bool(np.abs(cut.axis[cut.cutting][:, :2]).max(initial=0.0) < UPRIGHT
                       and cut.axis[cut.cutting][:, 2].min(initial=1.0) > 0.0)  # fmt: skip
        mean = cut.axis[cut.cutting].mean(axis=0) if cut.cutting.any() else np.array([0.0, 0.0, 1.0])
        turn = np.eye(3) if upright else view_along(mean / max(float(np.linalg.norm(mean)), 1e-12))
        surface = _sweep(cut, _turn_box(stock.bounds(), turn), turn, upright=upright)
        if surface is not None:
            stock = CutStock(stock, surface) if upright else _ask_columns(stock, surface, turn)
    return stock


def _turn_box(bounds: Array, turn: Array) -> Array:
    """Return the box around a box that is seen from other axes. Shape (2, 3)."""
    corners = np.array([[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1] for z in bounds[:, 2]]) @ turn
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def _sweep(cut: Cut, box: Array, turn: Array, *, upright: bool) -> CutSurface | None:
    """Return what a cutter sweeps within a box; None where it does not reach it."""
    position = cut.position @ turn
    start = np.vstack([position[:1], position[:-1]])
    surface = build_cut_surface(cut.cutter, start, position, box[:, :2], None if upright else cut.axis @ turn)
    if surface is None:
        return None
    moves = np.flatnonzero(cut.cutting & (np.linalg.norm(position - start, axis=1) > 0.0))
    for part in np.array_split(moves, max(len(moves) // MOVES_AT_ONCE, 1)):
        surface.cut(part)
    return surface


def _ask_columns(stock: StockColumns, surface: CutSurface, turn: Array) -> HeightMap:
    """Return stock less a sweep that is seen from other axes, as columns on a grid."""
    last = np.iinfo(np.int32).max

    def solid(place: Array, z: Array) -> NDArray[np.bool_]:
        low, high = stock.interval(place)
        some = (z >= low) & (z < high - NOTHING)
        point = np.column_stack([place[some], z[some]]) @ turn
        some[some] = surface.uncut(point, np.full(len(point), last))
        return some

    x, y, cell = _lay_grid(stock)
    place = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    bottom, top = stock.interval(place)
    there = top - bottom > THIN_COLUMN
    bounds = stock.bounds()
    layers = int(np.clip(np.ceil((bounds[1, 2] - bounds[0, 2]) / cell.min()), 2, MOST_LAYERS))
    ends = []
    for first, second in ((top, bottom), (bottom, top)):
        ends.append(np.full(len(place), np.nan))
        ends[-1][there] = _seek_end(solid, place[there], first[there], second[there], layers)
    high = np.where(np.isnan(ends[0]), -np.inf, ends[0]).reshape(len(x), len(y))
    low = np.where(np.isnan(ends[1]), np.inf, ends[1]).reshape(len(x), len(y))
    return HeightMap(np.array([x[0], y[0]]), cell, low, high)


def _seek_end(
    solid: Callable[[Array, Array], NDArray[np.bool_]], place: Array, first: Array, second: Array, layers: int
) -> Array:
    """Return where columns begin to be solid on the way from one end to the other; NaN where they never are."""
    found, left = np.full(len(place), np.nan), np.arange(len(place))
    for layer in range(layers):
        share = (layer + 0.5) / layers
        hit = solid(place[left], first[left] + share * (second - first)[left])
        rows = left[hit]
        left = left[~hit]
        near, far = np.full(len(rows), max((layer - 0.5) / layers, 0.0)), np.full(len(rows), share)
        for _ in range(8):
            middle = 0.5 * (near + far)
            hit = solid(place[rows], first[rows] + middle * (second - first)[rows])
            near, far = np.where(hit, near, middle), np.where(hit, middle, far)
        found[rows] = first[rows] + np.where(near == 0.0, 0.0, 0.5 * (near + far)) * (second - first)[rows]
    return found


def _lay_grid(stock: StockColumns) -> tuple[Array, Array, Array]:
    """Return a grid over stock of about MOST_COLUMNS, and its steps [m]. Shapes (a,), (b,), (2,)."""
    low, high = stock.bounds()[:, :2]
    size = high - low - 2.0 * NOTHING
    count = np.maximum(np.ceil(size / np.sqrt(np.prod(size) / MOST_COLUMNS)), 1.0).astype(int)
    x, y = (low[k] + NOTHING + size[k] * np.arange(count[k] + 1) / count[k] for k in (0, 1))
    return x, y, size / count


def view_along(axis: Array) -> Array:
    """Return axes whose third is the tool axis; the part's own where that is its z. Shape (3, 3)."""
    if axis[2] > 1.0 - 1e-12:
        return np.eye(3)
    x = np.cross([0.0, 1.0, 0.0], axis) if abs(axis[1]) < 0.9 else np.cross(axis, [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def read_stock(
    table: StockTable | None, cutter: Cutter, toolpath: Toolpath, top: float | None, R_view: Array, job: Path
) -> tuple[StockColumns, list[str]]:
    """Return the stock as it is seen along the tool axis, and what was assumed of it.

    `top` is the height of the stock's top where the job gives no stock, part frame [m], `R_view` as in `build_block`.

    Raises:
        InputError: If there is neither stock nor its top, or the mesh is not what it has to be.
    """
    if table is not None and table.block_mm is not None:
        return build_block(1e-3 * np.array(table.block_mm[0]), 1e-3 * np.array(table.block_mm[1]), R_view), []
    if table is not None:
        mesh = read_mesh(job.parent / str(table.mesh), table.unit, "process.stock.mesh", job)
        columns, note = build_height_map(mesh, R_view, cutter.radius / MESH_COLUMNS)
        return columns, [note] if note else []
    if top is None:
        message = "missing key: the force follows from the stock, give [process.stock] or the height of its top"
        raise InputError(message, file=job, where="process.stock_top_mm")
    reach = BEYOND * 2.0 * cutter.radius
    low, high = toolpath.position.min(axis=0) - reach, toolpath.position.max(axis=0) + reach
    low[2], high[2] = min(low[2], top - reach), top
    note = (f"No stock is given: a block below z = {1e3 * top:g} mm, {1e3 * reach:.3g} mm wider than the path, is "
            "assumed; the first pass cuts it in full, later ones what is left.")  # fmt: skip
    return build_block(low, high, R_view), [note]
