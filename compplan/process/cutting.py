"""Milling and drilling force along a path: parameters of a job, and the mean wrench at every waypoint.

An edge slice at angle u (from the travel to the left) has a chip thickness h = f v.n + f^2 c / 2 (f: feed a tooth, v:
direction of travel, n: outward normal) [Altintas2012, generalised to any profile]. The second term follows from the
surface of the tooth before, which is a feed behind and has curvature c along the travel. So a tooth cuts up to
v.n = -f c / 2. Near the tip of a ball this adds a few per cent of the edge force; on a side it adds half a per cent and
is neglected. The spindle turns clockwise, seen from the spindle. The force on the slice is F_t (z x r) - F_r n - F_a e,
e along the edge towards the spindle: a positive axial coefficient pulls the tool out. The mean of a turn with N teeth,

    w = N / (2 pi) * sum over slices and angles of (K h^(1 - m) + K_edge) * length * du,

is linear in the coefficients; their columns are stored, to first order in f c. Valid for many turns a waypoint, evenly
spaced teeth, and chips thin compared with the cutter's radius. The thinning of chips at the surface of an earlier pass
is neglected. Path axes: x travel across the axis, z the tool axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import OneOf
from compplan.process.engagement import ROWS, Cutter, Engagement, Slices
from compplan.process.engagement_search import find_engagement
from compplan.process.materials import MATERIALS, Coefficients, CoefficientTable
from compplan.process.stock import Cut, StockColumns, StockTable, read_stock, take_away, view_along
from compplan.toolpath.contact import ForceTable
from compplan.toolpath.toolpath import Toolpath, interpolate

#: Inclination of the tool axis from its mean above which a note is written. [deg]
MOST_INCLINATION = 30.0
#: Width of the stock, as a share of that of the path, below which its unit may be wrong (assumed: an inch is 25.4 mm).
LEAST_STOCK = 0.1
#: Valid range of the feed a tooth. [mm]
FEED_PER_TOOTH = (1e-5, 3.0)
#: The full edge force acts where the edge moves outwards by at least this share of the feed, and from this feed a tooth
#: on [m]; below, it decreases linearly to zero (assumed): no ploughing on a floor that the tool only slides over, or at
#: rest. With a smaller share the force of vertical ramps jumps within micrometres, which no arm can follow at feed.
PLOUGHS, PLOUGHING_FEED = 0.004, 1e-5
#: Least outward speed, as a share of the feed, in curvature terms: in the cut and behind it.
STEEP, STEEP_BEHIND = 0.01, 0.002


@dataclass(frozen=True)
class MillingShape:
    """Geometry of the mean wrench: the factor of each coefficient."""

    #: Per 1 N/mm^2 (tangential, radial, axial) at a feed a tooth of 1 mm, then per 1 N/mm of an edge. Shape (n, 6, 6).
    straight: Array
    curved: Array  #: Increase of `straight` per mm of feed a tooth, by the curved path of a tooth. Shape (n, 6, 6).

    def wrench(self, coefficients: Coefficients, feed_per_tooth: Array) -> Array:
        """Return the mean wrench on the tool's tip at a feed a tooth [m], path axes. (n,) -> (n, 6) [N, N m]"""
        size = np.array([*coefficients.cutting, *coefficients.edge])
        return np.asarray(np.einsum("c,ncw->nw", size, self.columns(coefficients.exponent, feed_per_tooth)))

    def columns(self, exponent: tuple[float, float, float], feed_per_tooth: Array) -> Array:
        """Return the factor of each coefficient, cutting then edge ones, at a feed. Shape (n, 6, 6)."""
        feed = np.maximum(feed_per_tooth * 1e3, 0.0)[:, None]
        ploughing = np.clip(feed_per_tooth / PLOUGHING_FEED, 0.0, 1.0)[:, None].repeat(3, axis=1)
        by_size = np.concatenate([feed ** (1.0 - np.array(exponent)), ploughing], axis=1)
        return np.asarray(by_size[:, :, None] * (self.straight + feed[:, :, None] * self.curved))


def shape_milling(found: Engagement, teeth: int, exponent: tuple[float, float, float]) -> MillingShape:
    """Compute the mean wrench per unit of each coefficient; `exponent` is Kienzle's for each direction."""
    edge, angle = found.cutter.slices, found.angles
    at_low, by_rise = (part.reshape(3, -1, 6) for part in edge_wrenches(edge, angle))
    straight, curved = np.zeros((len(found), 6, 6)), np.zeros((len(found), 6, 6))
    turn = teeth / len(angle)  # N / (2 pi) du
    length = edge.length * 1e3
    for first in range(0, len(found), ROWS):
        rows = slice(first, first + ROWS)
        share = found.depth[rows].astype(np.float64)
        some = np.flatnonzero(share.any(axis=(1, 2)))
        if not len(some):
            continue
        share, here = share[some], first + some
        weight, curvature = turn * share * length[:, None], 1e-3 * found.curvature(angle, here)
        out, step = found.engaged_speed(angle, here)
        ploughs = weight * np.minimum(out / PLOUGHS, 1.0)
        behind = _find_behind(weight, out, curvature, step)
        halves = 0.5 * share
        chips = {m: weight * (out if m == 0.0 else out ** (1.0 - m)) for m in set(exponent)}
        growth = 0.5 * curvature / np.maximum(out, STEEP)
        for c, m in enumerate(exponent):
            more = (1.0 - m) * growth * chips[m]
            for target, k, part in ((straight, c, chips[m]), (curved, c, more), (straight, 3 + c, ploughs),
                                    (curved, 3 + c, behind)):  # fmt: skip
                low, rise = part.reshape(len(some), -1), (halves * part).reshape(len(some), -1)
                target[here, k] = low @ at_low[c] + rise @ by_rise[c]
    return MillingShape(straight, curved)


def _find_behind(weight: Array, out: Array, curvature: Array, step: Array) -> Array:
    """Return the additional engagement of slices behind the line of zero outward speed, per mm of feed. (n, k, m).

    It is the integral of half the curvature over that line, distributed to the bins next to it: bins slower than
    `step`, the change of speed across a bin, have weights that fall linearly to zero there.
    """
    wide = np.maximum(step, STEEP_BEHIND)
    return np.asarray(weight * curvature / wide * np.maximum(1.0 - out / wide, 0.0))


def edge_wrenches(edge: Slices, angle: Array) -> tuple[Array, Array]:
    """Return the wrench at the tip of a unit force (tangential, radial, axial) on slices at angles.

    First for a force at the lower end of each slice, then its change up to the upper end. Shapes (3, k, m, 6).
    """
    k, m = len(edge), len(angle)
    out, up = edge.normal[:, 0], edge.normal[:, 1]
    cos, sin = np.broadcast_to(np.cos(angle), (k, m)), np.broadcast_to(np.sin(angle), (k, m))
    ones = np.ones((k, m))
    along = np.stack([-sin, cos, 0.0 * ones], axis=-1)
    normal = np.stack([out[:, None] * cos, out[:, None] * sin, up[:, None] * ones], axis=-1)
    upward = np.stack([-up[:, None] * cos, -up[:, None] * sin, out[:, None] * ones], axis=-1)
    force = np.stack([along, -normal, -upward])
    arm = np.stack([edge.radius[:, None] * cos, edge.radius[:, None] * sin, edge.low[:, None] * ones], axis=-1)
    rise = np.zeros((k, m, 3))
    rise[:, :, 2] = edge.rise[:, None]
    at_low = np.concatenate([force, np.cross(arm[None], force)], axis=-1)
    by_rise = np.concatenate([np.zeros_like(force), np.cross(rise[None], force)], axis=-1)
    return at_low, by_rise


class CuttingTable(ForceTable):
    """Keys of all rotating cutters; the spindle turns clockwise, viewed from the spindle."""

    diameter_mm: float = Field(ge=0.05, le=500.0)
    teeth: int = Field(default=2, ge=1, le=60)
    spindle_rpm: float = Field(gt=0.0, le=2e5)
    material: Annotated[str, OneOf(tuple(MATERIALS))] | None = None
    coefficients: CoefficientTable | None = None
    stock: StockTable | None = None
    stock_top_mm: float | None = None

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
        """Relative standard deviation of the force level."""
        return self.resistance.uncertainty

    def feed_per_tooth(self, feed: Array) -> Array:
        """Return the feed a tooth [m] from the feed [m/s]."""
        return np.asarray(feed / (self.spindle_rpm / 60.0 * self.teeth))

    def cutter(self) -> Cutter:
        """Return the cutter's shape."""
        raise NotImplementedError

    def shape(self, found: Engagement) -> MillingShape:
        """Return the factor of each coefficient in the mean wrench, from the engagement."""
        return shape_milling(found, self.teeth, self.resistance.exponent)

    def describe(self, found: Engagement, cuts: NDArray[np.bool_]) -> list[str]:
        """Return notes on an unusual use of this cutter; `cuts` are the waypoints that remove material."""
        return []


@dataclass(frozen=True)
class CuttingForce:
    """Engagement along a job's path and the resulting force at any feed; r waypoints of the path."""

    process: CuttingTable  #: Parameters from the job.
    stock: StockColumns  #: Stock in the view along the tool axis.
    R_view: Array  #: Axes of that view as columns, part frame. Shape (3, 3).
    arc: Array  #: Length along the path. Shape (r,). [m]
    rapid: NDArray[np.bool_]  #: Moves that do not cut. Shape (r,).
    engagement: Engagement  #: Engagement of the cutter.
    shape: MillingShape  #: Factor of each coefficient.
    notes: tuple[str, ...]  #: Notes for the user.

    def wrench(self, nominal: Toolpath) -> Array:
        """Return the mean wrench at any division of the path, at its feed, path axes. Shape (n, 6). [N, N m]"""
        where = nominal.arc_length
        columns = np.concatenate([self.shape.straight, self.shape.curved], axis=1)
        shape = interpolate(where, self.arc, columns.reshape(len(self.arc), -1)).reshape(-1, 12, 6)
        per_tooth = self.process.feed_per_tooth(nominal.feed)
        wrench = MillingShape(shape[:, :6], shape[:, 6:]).wrench(self.process.resistance, per_tooth)
        return np.asarray(wrench * ~nominal.rapid[:, None])


def prepare_cutting(
    process: CuttingTable, toolpath: Toolpath, stock_top: float | None, job: Path,
    before: Sequence[tuple[CuttingTable, Toolpath]] = (),
) -> CuttingForce:  # fmt: skip
    """Compute the engagement along a job's path.

    Args:
        process: Parameters from the job.
        toolpath: The planned path, part frame.
        stock_top: Height of the stock's top for a job without stock, part frame. [m]
        job: The job file; the names of meshes are relative to it.
        before: Earlier cuts of the same stock, in order: parameters from the job, and path in the part frame.

    Raises:
        InputError: If stock, cutter and path do not match.
    """
    cutter, cutting = process.cutter(), ~toolpath.rapid
    axis = toolpath.axis[cutting].mean(axis=0) if cutting.any() else np.array([0.0, 0.0, 1.0])
    axis /= max(float(np.linalg.norm(axis)), 1e-12)
    R_view = view_along(axis)
    position, axes = toolpath.position @ R_view, toolpath.axis @ R_view
    stock, notes = read_stock(process.stock, cutter, toolpath, stock_top, R_view, job)
    size = np.ptp(stock.box, axis=0)[:2].max()
    mesh = process.stock is not None and process.stock.mesh is not None
    unit = f"; is its unit right (process.stock.unit, now {process.stock.unit})?" if process.stock and mesh else ""
    if 2.0 * cutter.radius > size:
        message = (f"is {process.diameter_mm:g}, larger than the stock, which is {1e3 * size:.4g} mm across the tool "
                   f"axis{unit or '; give the stock that is cut'}")  # fmt: skip
        raise InputError(message, file=job, where="process.diameter_mm")
    cuts = [Cut(p.cutter(), t.position @ R_view, t.axis @ R_view, ~t.rapid) for p, t in before]
    stock, left_out = take_away(stock, cuts)
    notes += left_out
    if unit and size < LEAST_STOCK * np.ptp(position[cutting], axis=0)[:2].max(initial=0.0):
        notes.append(f"The stock is only {1e3 * size:.3g} mm across, far less than the path{unit}")
    found = find_engagement(cutter, position, cutting, stock, axis=axes)
    if before and not found.touches.any():
        notes.append("This tool touches no stock: earlier tools left none on its path.")
    elif not found.touches.any():
        low, high = 1e3 * (stock.box @ R_view.T)
        message = (f"no cutting move meets the stock, which reaches from {_place(np.minimum(low, high))} to "
                   f"{_place(np.maximum(low, high))} mm, while the path goes from "
                   f"{_place(1e3 * toolpath.position.min(axis=0))} to {_place(1e3 * toolpath.position.max(axis=0))} mm "
                   f"(part frame){unit}")  # fmt: skip
        raise InputError(message, file=job, where="process.stock")
    notes += _describe_lean(axes[cutting]) + _describe_cut(process, toolpath, found, job)
    shape = process.shape(found)
    return CuttingForce(process, stock, R_view, toolpath.arc_length, toolpath.rapid, found, shape, tuple(notes))


def _describe_lean(axes: Array) -> list[str]:
    """Return a note where the tool axis inclines so far from its mean that columns miss material under the tool."""
    lean = float(np.degrees(np.arccos(np.clip(axes[:, 2], -1.0, 1.0)).max(initial=0.0)))
    if lean <= MOST_INCLINATION:
        return []
    return [f"The tool axis leans by up to {lean:.3g} deg from its mean, along which the stock is seen: beyond "
            f"{MOST_INCLINATION:g} deg material under overhangs may be missed."]  # fmt: skip


def _describe_cut(process: CuttingTable, toolpath: Toolpath, found: Engagement, job: Path) -> list[str]:
    """Return notes on the source of the coefficients, and on unusual cuts."""
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
