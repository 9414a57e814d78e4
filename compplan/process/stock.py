"""Stock: a block or a closed mesh, represented as columns from a bottom to a top along one direction.

Material removed by earlier cutters is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.meshes import load_mesh
from compplan.io.provenance import note_input
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable, Vector3
from compplan.process.cut_surface import CutSurface, build_cut_surface, expand_boxes
from compplan.process.engagement import Cutter
from compplan.toolpath.toolpath import Toolpath

#: Greatest number of cells of a mesh's height map.
MESH_CELLS = 4_000_000
#: Grid cells that are rasterised at once.
CELLS_AT_ONCE = 1_000_000
#: Greatest size of stock; larger meshes are in millimetres but were read in metres. [m]
LARGEST = 20.0
#: Relative difference of volume between a mesh and its columns above which a note is written.
HOLLOW = 0.02
#: Extent of stock of unknown shape beyond the path, in diameters.
BEYOND = 2.0
#: Columns of a mesh in a radius of the cutter.
MESH_COLUMNS = 8.0
#: Inclination from the columns below which a tool axis counts as upright. [rad]
UPRIGHT = 1e-6
#: Cutting moves that are entered at once.
MOVES_AT_ONCE = 64

Corner = Annotated[tuple[Vector3, Vector3], Field(strict=False)]


class StockColumns(Protocol):
    """Stock in a view along a direction: every column is solid from a bottom to a top."""

    def interval(self, place: Array) -> tuple[Array, Array]:
        """Return bottom and top of the columns at places across the direction; empty where top < bottom.

        Shape (..., 2) -> (...) twice. [m]
        """

    @property
    def box(self) -> Array:
        """The box around it, rows lowest and highest. Shape (2, 3). [m]"""


@dataclass(frozen=True)
class Block:
    """A box; its half spaces n x <= c are in the frame of the view."""

    normal: Array  #: Shape (6, 3).
    offset: Array  #: Shape (6,). [m]
    box: Array  #: See `StockColumns`. Shape (2, 3). [m]

    def interval(self, place: Array) -> tuple[Array, Array]:
        """Return bottom and top of the columns, see `StockColumns`."""
        low, high = np.full(place.shape[:-1], -np.inf), np.full(place.shape[:-1], np.inf)
        beside = np.zeros(place.shape[:-1], dtype=bool)
        for n, c in zip(self.normal, self.offset, strict=True):
            left = c
            for k in (0, 1):
                left = left - n[k] * place[..., k] if n[k] else left
            if n[2] > 1e-9:
                high = np.minimum(high, left / n[2])
            elif n[2] < -1e-9:
                low = np.maximum(low, left / n[2])
            else:
                beside |= left < 0.0
        high[beside] = -np.inf
        return low, high


@dataclass(frozen=True)
class HeightMap:
    """Columns of a mesh on a grid, with bilinear interpolation between four neighbours."""

    origin: Array  #: Position of the first cell's centre. Shape (2,). [m]
    cell: float  #: Distance of columns. [m]
    low: Array  #: Bottom of each column, +inf for an empty one. Shape (a, b). [m]
    high: Array  #: Top of each column, -inf for an empty one. Shape (a, b). [m]
    box: Array  #: See `StockColumns`. Shape (2, 3). [m]

    def interval(self, place: Array) -> tuple[Array, Array]:
        """Return bottom and top of the columns, see `StockColumns`."""
        at = (place - self.origin) / self.cell
        limit = np.array(self.high.shape)
        first = np.clip(np.floor(at).astype(int), 0, limit - 2)
        share = at - first
        inside = ((at >= -0.5) & (at <= limit - 0.5)).all(axis=-1)
        share = np.clip(share, 0.0, 1.0)
        near = np.clip(np.rint(at).astype(int), 0, limit - 1)
        found = []
        for grid, none in ((self.low, np.inf), (self.high, -np.inf)):
            nearest = grid[near[..., 0], near[..., 1]]
            corner = [grid[first[..., 0] + i, first[..., 1] + j] for i in (0, 1) for j in (0, 1)]
            weight = [(1 - share[..., 0]) * (1 - share[..., 1]), (1 - share[..., 0]) * share[..., 1],
                      share[..., 0] * (1 - share[..., 1]), share[..., 0] * share[..., 1]]  # fmt: skip
            whole = np.isfinite(corner).all(axis=0)
            smooth = sum(w * np.where(np.isfinite(c), c, 0.0) for w, c in zip(weight, corner, strict=True))
            found.append(np.where(inside, np.where(whole, smooth, nearest), none))
        return found[0], found[1]


def build_block(low: Array, high: Array, R_view: Array) -> Block:
    """Return a box of the part frame, from its lowest to its highest corner [m], in a view along a direction.

    The columns of `R_view` are the axes of the view in the part frame, the direction last.
    """
    normal = np.vstack([np.eye(3), -np.eye(3)])
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    seen = corners @ R_view
    box = np.stack([seen.min(axis=0), seen.max(axis=0)])
    return Block(normal @ R_view, np.concatenate([high, -np.asarray(low)]), box)


def read_mesh(file: Path, unit: str, where: str, job: Path) -> Any:
    """Read a closed mesh of the stock, in metres, part frame; refuse one that is missing, unreadable or open."""
    if not file.is_file():
        raise InputError(f"no file {file}", file=job, where=where)
    mesh = load_mesh(file, unit)
    note_input(file, file.read_bytes())
    size = float(np.ptp(mesh.vertices, axis=0).max())
    if not size <= LARGEST:
        message = f"is {size:.4g} m large as a mesh in {unit}, at most {LARGEST:g} m is allowed: check the unit"
        raise InputError(message, file=file)
    mesh.merge_vertices()
    if not mesh.is_watertight:
        once = int((np.bincount(mesh.edges_unique_inverse) != 2).sum())
        raise InputError(f"is an open mesh ({once} edges without a second triangle), it must be closed", file=file)
    if mesh.volume < 0.0:  # its normals point inwards
        mesh.invert()
    return mesh


def build_height_map(mesh: Any, R_view: Array, cell: float) -> tuple[HeightMap, str]:
    """Return a closed mesh as columns along a direction, and a note if they fill hollows of the mesh.

    `R_view` as in `build_block`; `cell` is the wanted distance of columns. [m]
    """
    corner = (np.asarray(mesh.vertices) @ R_view)[np.asarray(mesh.faces)]
    low, high = corner.min(axis=(0, 1)), corner.max(axis=(0, 1))
    cell = max(cell, float(np.sqrt(np.prod(high[:2] - low[:2]) / MESH_CELLS)))
    shape = np.maximum(np.ceil((high[:2] - low[:2]) / cell).astype(int), 2)
    origin = low[:2] + 0.5 * ((high[:2] - low[:2]) - (shape - 1) * cell)
    tops, bottoms = np.full(shape, -np.inf), np.full(shape, np.inf)
    at = (corner[:, :, :2] - origin) / cell
    first = np.clip(np.ceil(at.min(axis=1) - 1e-9).astype(int), 0, shape)
    after = np.clip(np.floor(at.max(axis=1) + 1e-9).astype(int) + 1, 0, shape)
    slab = max(CELLS_AT_ONCE // int(shape[1]), 1)
    for row in range(0, int(shape[0]), slab):  # some rows of the grid at a time
        low_cell, high_cell = first.copy(), after.copy()
        low_cell[:, 0], high_cell[:, 0] = (np.clip(cells[:, 0], row, row + slab) for cells in (first, after))
        _raster(at, corner[:, :, 2], low_cell, high_cell, tops, bottoms)
    full = np.isfinite(tops)
    bottoms[~full] = np.inf
    volume = float((tops - bottoms)[full].sum() * cell**2)
    note = ""
    if abs(volume / mesh.volume - 1.0) > HOLLOW:
        held = f"{volume * 1e9:.4g} mm3, the stock's mesh {mesh.volume * 1e9:.4g} mm3"
        note = f"Columns along the tool axis hold {held}: hollows and undercuts count as solid."
    box = np.array([[*origin, bottoms[full].min()], [*(origin + cell * (shape - 1)), tops[full].max()]])
    return HeightMap(origin, cell, bottoms, tops, box), note


def _raster(at: Array, z: Array, first: NDArray[np.int_], after: NDArray[np.int_], tops: Array, bottoms: Array) -> None:
    """Rasterise triangles into a height map: each column gets its highest and its lowest crossing.

    Corners `at` are in cells of the grid, shape (m, 3, 2), their heights in `z`, shape (m, 3) [m]. Each triangle is
    evaluated from its first cell to the one after the last, shape (m, 2). `tops` and `bottoms` are changed in place.
    """
    item, place = expand_boxes(first, after)
    if not len(item):
        return
    a, b, c = at[item, 0], at[item, 1], at[item, 2]
    area = _cross(b - a, c - a)
    flat = np.abs(area) < 1e-12
    area = np.where(flat, 1.0, area)
    v, w = _cross(place - a, c - a) / area, _cross(b - a, place - a) / area
    inside = ~flat & (v >= -1e-9) & (w >= -1e-9) & (v + w <= 1.0 + 1e-9)
    item, place, v, w = item[inside], place[inside], v[inside], w[inside]
    z = z[item]
    height = z[:, 0] + v * (z[:, 1] - z[:, 0]) + w * (z[:, 2] - z[:, 0])
    np.maximum.at(tops, (place[:, 0], place[:, 1]), height)
    np.minimum.at(bottoms, (place[:, 0], place[:, 1]), height)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


class StockTable(StrictTable):
    """[process.stock]: stock in the part frame: `block_mm` (two corners), or `mesh`, a closed STL, PLY or OBJ file."""

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
    """Path of a cutter through stock; n waypoints, in the frame of the view."""

    cutter: Cutter  #: The cutter.
    position: Array  #: Tips. Shape (n, 3). [m]
    axis: Array  #: Tool axes, tip to spindle. Shape (n, 3).
    cutting: NDArray[np.bool_]  #: Whether the move that ends here removes material. Shape (n,).


@dataclass(frozen=True)
class CutStock:
    """Stock minus the cut of a cutter with its axis along the columns."""

    before: StockColumns  #: Stock before the cut.
    surface: CutSurface  #: Surface left by the cutter.

    def interval(self, place: Array) -> tuple[Array, Array]:
        """Return bottom and top of the columns, see `StockColumns`."""
        low, high = self.before.interval(place)
        return low, np.minimum(high, self.surface.lowest(place))

    @property
    def box(self) -> Array:
        """The box around the stock before."""
        return self.before.box


def take_away(stock: StockColumns, cuts: Sequence[Cut]) -> tuple[StockColumns, list[str]]:
    """Return the stock after cuts one after the other, and notes on assumptions.

    Cuts with an axis that is not along the columns are left out.
    """
    left_out = 0
    for cut in cuts:
        axis = cut.axis[cut.cutting]
        if np.abs(axis[:, :2]).max(initial=0.0) > UPRIGHT or axis[:, 2].min(initial=1.0) <= 0.0:
            left_out += 1
            continue
        start = np.vstack([cut.position[:1], cut.position[:-1]])
        surface = build_cut_surface(cut.cutter, start, cut.position, stock.box[:, :2], None)
        if surface is None:
            continue
        moves = np.flatnonzero(cut.cutting & (np.linalg.norm(cut.position - start, axis=1) > 0.0))
        for part in np.array_split(moves, max(len(moves) // MOVES_AT_ONCE, 1)):
            surface.cut(part)
        stock = CutStock(stock, surface)
    said = (f"The cuts of {left_out} earlier operations lie along another tool axis: they are left out of the stock"
            " (assumed).")  # fmt: skip
    return stock, [said] if left_out else []


def view_along(axis: Array) -> Array:
    """Return axes with the tool axis as the third; those of the part if the tool axis is its z. Shape (3, 3)."""
    if axis[2] > 1.0 - 1e-12:
        return np.eye(3)
    x = np.cross([0.0, 1.0, 0.0], axis) if abs(axis[1]) < 0.9 else np.cross(axis, [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def read_stock(
    table: StockTable | None, cutter: Cutter, toolpath: Toolpath, top: float | None, R_view: Array, job: Path
) -> tuple[StockColumns, list[str]]:
    """Return the stock in the view along the tool axis, and notes on assumptions.

    `top` is the height of the stock's top for a job without stock, part frame [m], `R_view` as in `build_block`.

    Raises:
        InputError: If there is neither stock nor its top, or the mesh is not valid.
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
