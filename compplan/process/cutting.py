"""Cutting with a rotating cutter along a path: what a job says of cutter, material and stock, and the force from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.process.cutter import Cutter
from compplan.process.engagement import Engagement
from compplan.process.engagement_search import find_engagement
from compplan.process.materials import MATERIALS, Coefficients, CoefficientTable
from compplan.process.milling import MillingShape, shape_milling
from compplan.process.stock import StockColumns
from compplan.process.stock_table import Cut, StockTable, read_stock, take_away, triangulate_stock, view_along
from compplan.toolpath.contact import ForceTable
from compplan.toolpath.toolpath import Toolpath, interpolate

#: Lean of the tool axis from its mean from which on a note tells it. [deg]
LEANS = 30.0
#: Feeds a tooth that are taken for true. [mm]
FEED_PER_TOOTH = (1e-5, 3.0)


class CuttingTable(ForceTable):
    """Keys of every rotating cutter; the spindle turns clockwise, seen from the spindle."""

    diameter_mm: float = Field(ge=0.05, le=500.0)
    teeth: int = Field(default=2, ge=1, le=60)
    spindle_rpm: float = Field(gt=0.0, le=2e5)
    material: str | None = None
    coefficients: CoefficientTable | None = None
    stock: StockTable | None = None
    stock_top_mm: float | None = None

    @field_validator("material")
    @classmethod
    def _check_name(cls, value: str | None) -> str | None:
        if value is not None and value not in MATERIALS:
            raise ValueError(f"is {value!r}, choose from {list(MATERIALS)}, or give coefficients")
        return value

    @model_validator(mode="after")
    def _check_material(self) -> CuttingTable:
        if (self.material is None) == (self.coefficients is None):
            raise ValueError(f"needs one of coefficients and material, choose from {list(MATERIALS)}")
        if self.stock is not None and self.stock_top_mm is not None:
            raise ValueError("stock_top_mm and stock both state the end of the stock, choose one")
        return self

    @property
    def resistance(self) -> Coefficients:
        """Coefficients of the material."""
        return MATERIALS[str(self.material)] if self.coefficients is None else self.coefficients.coefficients()

    @property
    def uncertainty(self) -> float:
        """Relative standard deviation of the level."""
        return self.resistance.uncertainty

    def feed_per_tooth(self, feed: Array) -> Array:
        """Return the feed a tooth [m] from the feed [m/s]."""
        return np.asarray(feed / (self.spindle_rpm / 60.0 * self.teeth))

    def cutter(self) -> Cutter:
        """Return the cutter's shape."""
        raise NotImplementedError

    def shape(self, found: Engagement) -> MillingShape:
        """Return what each coefficient contributes to the mean wrench, from the engagement."""
        return shape_milling(found, self.teeth, self.resistance.exponent)

    def describe(self, found: Engagement, cuts: NDArray[np.bool_]) -> list[str]:
        """Say what is odd about how this cutter is used; `cuts` are the waypoints that remove material."""
        return []


@dataclass(frozen=True)
class CuttingBench:
    """Cutter, stock and path as they are held against each other; r waypoints of the path."""

    cutter: Cutter  #: The cutter.
    stock: StockColumns  #: The stock, seen along the tool axis.
    position: Array  #: Tips, seen along the tool axis. Shape (r, 3). [m]
    R_view: Array  #: Axes of that view as columns, part frame. Shape (3, 3).
    axis: Array  #: Tool axes in that view. Shape (r, 3).


@dataclass(frozen=True)
class CuttingForce:
    """The engagement of a job's path and the force that follows from it at any feed; r waypoints of the path."""

    process: CuttingTable  #: What the job says.
    bench: CuttingBench  #: Cutter, stock and path.
    arc: Array  #: Length along the path. Shape (r,). [m]
    rapid: NDArray[np.bool_]  #: Moves that do not cut. Shape (r,).
    engagement: Engagement  #: What the cutter touches.
    shape: MillingShape  #: What each coefficient contributes.
    notes: tuple[str, ...]  #: What a user should know.

    def wrench(self, nominal: Toolpath) -> Array:
        """Return the mean wrench at any division of the path, at its feed, path axes. Shape (n, 6). [N, N m]"""
        where = nominal.arc_length
        columns = np.concatenate([self.shape.cutting, self.shape.edge, self.shape.curved], axis=1)
        shape = interpolate(where, self.arc, columns.reshape(len(self.arc), -1)).reshape(-1, 12, 6)
        per_tooth = self.process.feed_per_tooth(nominal.feed)
        wrench = MillingShape(shape[:, :3], shape[:, 3:6], shape[:, 6:]).wrench(self.process.resistance, per_tooth)
        return np.asarray(wrench * ~nominal.rapid[:, None])

    def leave(self) -> Any:
        """Return what is left of the stock as a closed mesh, part frame [m], see `triangulate_stock`."""
        bench = self.bench
        mesh = triangulate_stock(take_away(bench.stock, [Cut(bench.cutter, bench.position, bench.axis, ~self.rapid)]))
        mesh.vertices = mesh.vertices @ bench.R_view.T
        return mesh


def prepare_cutting(
    process: CuttingTable, toolpath: Toolpath, stock_top: float | None, job: Path,
    before: Sequence[tuple[CuttingTable, Toolpath]] = (),
) -> CuttingForce:  # fmt: skip
    """Work out the engagement of a job's path.

    Args:
        process: What the job says.
        toolpath: The path as it is planned, part frame.
        stock_top: Height of the stock's top where the job gives no stock, part frame. [m]
        job: The job file; the names of meshes are relative to it.
        before: What cut the same stock before, in order: what the job says of each, and its path, part frame.

    Raises:
        InputError: If stock, cutter and path do not go together.
    """
    cutter, cutting = process.cutter(), ~toolpath.rapid
    axis = toolpath.axis[cutting].mean(axis=0) if cutting.any() else np.array([0.0, 0.0, 1.0])
    axis /= max(float(np.linalg.norm(axis)), 1e-12)
    R_view = view_along(axis)
    position, axes = toolpath.position @ R_view, toolpath.axis @ R_view
    stock, notes = read_stock(process.stock, cutter, toolpath, stock_top, R_view, job)
    size = np.ptp(stock.bounds(), axis=0)[:2].max()
    if 2.0 * cutter.radius > size:
        message = (f"is {process.diameter_mm:g}, larger than the stock, which is {1e3 * size:.4g} mm across the tool "
                   "axis; give the stock that is cut")  # fmt: skip
        raise InputError(message, file=job, where="process.diameter_mm")
    stock = take_away(stock, [Cut(p.cutter(), t.position @ R_view, t.axis @ R_view, ~t.rapid) for p, t in before])
    found = find_engagement(cutter, position, cutting, stock, axis=axes)
    if before and not found.touches.any():
        notes.append("This tool touches no stock: earlier tools left none on its path.")
    elif not found.touches.any():
        low, high = 1e3 * (stock.bounds() @ R_view.T)
        message = (f"no cutting move meets the stock, which reaches from {_place(np.minimum(low, high))} to "
                   f"{_place(np.maximum(low, high))} mm, while the path goes from "
                   f"{_place(1e3 * toolpath.position.min(axis=0))} to {_place(1e3 * toolpath.position.max(axis=0))} mm "
                   "(part frame)")  # fmt: skip
        raise InputError(message, file=job, where="process.stock")
    notes += _describe_lean(axes[cutting]) + _describe_cut(process, toolpath, found, job)
    shape = process.shape(found)
    bench = CuttingBench(cutter, stock, position, R_view, axes)
    return CuttingForce(process, bench, toolpath.arc_length, toolpath.rapid, found, shape, tuple(notes))


def _describe_lean(axes: Array) -> list[str]:
    """Say where the axis leans so far that columns along its mean miss what stands beneath the tool."""
    lean = float(np.degrees(np.arccos(np.clip(axes[:, 2], -1.0, 1.0)).max(initial=0.0)))
    if lean <= LEANS:
        return []
    return [f"The tool axis leans by up to {lean:.3g} deg from its mean, along which the stock is seen: beyond "
            f"{LEANS:g} deg material under overhangs may be missed."]  # fmt: skip


def _describe_cut(process: CuttingTable, toolpath: Toolpath, found: Engagement, job: Path) -> list[str]:
    """Say where coefficients come from, and what is odd about the cut."""
    resistance, notes = process.resistance, []
    name = process.material or "coefficients"
    scatter = f"+- {100 * resistance.uncertainty:.3g} % (assumed)"
    notes.append(f"Cutting coefficients ({name}): {resistance.source}; {scatter}.")
    touches = found.touches & ~toolpath.rapid
    chip = 1e3 * process.feed_per_tooth(toolpath.feed[touches])
    if len(chip) and not (FEED_PER_TOOTH[0] <= chip.min() and chip.max() <= FEED_PER_TOOTH[1]):
        message = (f"feed a tooth is {chip.min():.3g} to {chip.max():.3g} mm, {FEED_PER_TOOTH[0]:g} to "
                   f"{FEED_PER_TOOTH[1]:g} mm is allowed; check feed, spindle_rpm and teeth")  # fmt: skip
        raise InputError(message, file=job, where="process.spindle_rpm")
    low, high = resistance.valid_chip_mm
    if len(chip) and (chip.max() > high or chip.max() < low):
        notes.append(f"Feed a tooth of up to {chip.max():.3g} mm lies outside the range of the coefficients, "
                     f"{low:g} to {high:g} mm.")  # fmt: skip
    notes += process.describe(found, ~toolpath.rapid)
    return notes


def _place(position: Array) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in position) + ")"
