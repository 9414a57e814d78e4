"""The predicted process wrench along a toolpath: what the environment does to the tool, at the tip, base axes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Union, get_args

import numpy as np
from pydantic import Field, model_validator

from compplan.errors import InputError, ShapeError
from compplan.files.columns import FileColumn
from compplan.files.plugins import load_plugins
from compplan.files.tables import Array, read_table
from compplan.files.tomlfile import StrictTable, Vector3
from compplan.path.contact import (
    ContactTable,
    PathForceTable,
    contact_share,
    cutting_progress,
    path_axes,
    tool_axes,
    travel_across,
)
from compplan.path.forces.cutting import CuttingForce, CuttingTable, EndMillProcess
from compplan.path.forces.drilling import DrillProcess
from compplan.path.forces.friction_stir import FrictionStirProcess
from compplan.path.forces.grinding import GrindingProcess
from compplan.path.forces.sheet_forming import IsfRegressionProcess
from compplan.path.toolpath import WRENCH, Toolpath

Frame = Literal["part", "base", "tool", "path"]


class ColumnsProcess(StrictTable):
    """The wrench columns of the toolpath file, part axes; zero where the file has none but `required` is false."""

    model: Literal["columns"] = "columns"
    required: bool = True


class ConstantProcess(ContactTable):
    """The same wrench all along; `during_rapid` keeps it in rapid moves too (a dead weight)."""

    model: Literal["constant"]
    force_N: Vector3
    moment_Nm: Vector3 = (0.0, 0.0, 0.0)
    frame: Frame = "part"
    during_rapid: bool = False


class MillingProcess(PathForceTable):
    """Mean force of one revolution of an end mill with constant cutting coefficients, see `milling_wrench`.

    Above stock_top_mm (z of the part) there is no force, and less of it where the tool is in by less than depth_mm.
    """

    model: Literal["milling"]
    depth_mm: float = Field(gt=0.0)
    width_mm: float = Field(gt=0.0)
    diameter_mm: float = Field(gt=0.0)
    spindle_rpm: float = Field(gt=0.0)
    kc_N_mm2: float = Field(gt=0.0)
    radial_ratio: float = Field(default=0.4, ge=0.0)
    axial_ratio: float = 0.0
    material_side: Literal["left", "right"] = "right"
    stock_top_mm: float | None = None

    @model_validator(mode="after")
    def _check(self) -> MillingProcess:
        if self.width_mm > self.diameter_mm:
            raise ValueError(f"width_mm is {self.width_mm:g}, at most diameter_mm = {self.diameter_mm:g} is allowed")
        return self

    @property
    def follows_feed(self) -> bool:
        """Tell whether the force depends on the feed that is driven."""
        return True

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench of `milling_wrench` at the feed across the tool axis."""
        return milling_wrench(self, nominal.feed * travel_across(nominal))


class IsfProcess(PathForceTable):
    """Incremental sheet forming: the sheet pushes the tool up and away from the wall, more the further it goes.

    The axial force acts along the tool axis towards the spindle, the lateral force away from the wall that is formed
    (`wall_side`: on which side of the travel it stands, seen down the tool axis: "right" on a cone that is formed
    counter-clockwise from its rim inwards, so that the force points to its axis), the drag against the travel.
    All grow linearly along the cutting length, from `start_share` of the level given to the level itself.
    """

    model: Literal["isf"]
    axial_N: float = Field(ge=0.0)
    lateral_N: float = Field(default=0.0, ge=0.0)
    drag_N: float = Field(default=0.0, ge=0.0)
    start_share: float = Field(default=0.3, ge=0.0, le=1.0)
    wall_side: Literal["left", "right"] = "right"

    def wrench_along(self, nominal: Toolpath) -> Array:
        """Return the wrench of `isf_wrench`."""
        return isf_wrench(self, nominal)


class FileProcess(ContactTable):
    """A CSV file with fx_N .. mz_Nm: one row a waypoint, or any number of rows with s_mm, the length cut so far."""

    model: Literal["file"]
    file: str
    frame: Frame = "part"


OwnProcess = (
    ColumnsProcess
    | ConstantProcess
    | MillingProcess
    | EndMillProcess
    | DrillProcess
    | IsfProcess
    | IsfRegressionProcess
    | FrictionStirProcess
    | GrindingProcess
    | FileProcess
)
#: Every force model, by the name that a job gives it: those above, and what plug-ins add.
MODELS: dict[str, type[StrictTable]] = {
    get_args(table.model_fields["model"].annotation)[0]: table for table in get_args(OwnProcess)
}
MODELS.update(load_plugins("force_models", MODELS))

if TYPE_CHECKING:
    Process = Annotated[OwnProcess, Field(discriminator="model")]
else:
    Process = Annotated[Union[tuple(MODELS.values())], Field(discriminator="model")]  # noqa: UP007

FILE_COLUMNS = (
    FileColumn("s", "length"),
    *(FileColumn(name, "force", required=True) for name in WRENCH[:3]),
    *(FileColumn(name, "moment", group="moment") for name in WRENCH[3:]),
)


def predict_wrench(
    process: Process,
    nominal: Toolpath,
    *,
    R_base_part: Array | None = None,
    tool_x: Array | None = None,
    folder: Path | None = None,
    rows_at: Array | None = None,
    cutting: CuttingForce | None = None,
) -> Array:
    """Predict the wrench of the environment on the tool at every waypoint.

    Args:
        process: The model and its parameters.
        nominal: The toolpath in the base frame; its own wrench, base axes, is what the model "columns" uses.
        R_base_part: Part axes seen from the base, for wrenches in the part frame; default: the same axes. Shape (3, 3).
        tool_x: Where the x axis of the TCP frame points, base axes, for wrenches in the tool frame. Shape (3,).
        folder: Folder that a file name of the model is relative to.
        rows_at: Length along the path of each row of the toolpath file, for wrench files of one row a waypoint; the
            waypoints themselves if left out. Shape (r,). [m]
        cutting: The engagement of the path, for cutters that follow from it.

    Returns:
        The wrench at the tip, base axes, force first. Shape (n, 6). [N, N m]

    Raises:
        InputError: If the toolpath has no wrench columns, or a wrench file does not fit the toolpath.

    """
    rotations = np.eye(3) if R_base_part is None else R_base_part
    if isinstance(process, ColumnsProcess):
        if nominal.wrench is None:
            if process.required:
                message = "missing column fx_N: process.model = \"columns\" takes the wrench from the toolpath file"
                raise InputError(message, file=nominal.source or None, where=1)
            return np.zeros((len(nominal), 6))
        return nominal.wrench
    if isinstance(process, ConstantProcess):
        wrench = np.tile([*process.force_N, *process.moment_Nm], (len(nominal), 1))
        wrench = _turn(wrench, _axes(process.frame, nominal, rotations, tool_x))
        if process.during_rapid:
            return wrench
    elif isinstance(process, FileProcess):
        wrench = _read_wrench(process, nominal, folder or Path(), rows_at)
        wrench = _turn(wrench, _axes(process.frame, nominal, rotations, tool_x))
    elif isinstance(process, CuttingTable):
        if cutting is None:
            raise ShapeError(f"process {process.model!r} needs the engagement of its path")  # type: ignore[attr-defined]
        return _turn(cutting.wrench(nominal), path_axes(nominal))
    else:
        wrench = _turn(process.wrench_along(nominal), path_axes(nominal))
    return wrench * contact_share(nominal, process.ramp_mm * 1e-3, process.ramp_out_mm * 1e-3)[:, None]


def describe_process(process: Process, nominal: Toolpath, cutting: CuttingForce | None = None) -> tuple[str, ...]:
    """Say in a sentence each where a model's numbers come from and what was assumed."""
    if isinstance(process, CuttingTable):
        return () if cutting is None else cutting.notes
    return tuple(process.describe(nominal)) if isinstance(process, PathForceTable) else ()


def _axes(frame: Frame, nominal: Toolpath, R_base_part: Array, tool_x: Array | None) -> Array:
    """Return the axes of a wrench's frame, base axes. Shape (3, 3) or (n, 3, 3)."""
    if frame == "base":
        return np.eye(3)
    if frame == "part":
        return R_base_part
    return path_axes(nominal) if frame == "path" else tool_axes(nominal, tool_x)


def _turn(wrench: Array, axes: Array) -> Array:
    """Express a wrench in base axes. Shape (n, 6)."""
    stacked = axes if axes.ndim == 3 else axes[None]
    return np.hstack([np.einsum("nij,nj->ni", np.broadcast_to(stacked, (len(wrench), 3, 3)), part)
                      for part in (wrench[:, :3], wrench[:, 3:])])


def isf_wrench(process: IsfProcess, nominal: Toolpath) -> Array:
    """Return the wrench of incremental sheet forming, path axes, contact aside. Shape (n, 6) [N, N m]."""
    progress = cutting_progress(nominal)
    level = process.start_share + (1.0 - process.start_share) * progress / max(progress[-1], 1e-300)
    side = 1.0 if process.wall_side == "right" else -1.0
    return level[:, None] * np.array([-process.drag_N, side * process.lateral_N, process.axial_N, 0.0, 0.0, 0.0])


def milling_wrench(process: MillingProcess, feed: Array) -> Array:
    """Return the mean wrench of one revolution of an end mill, path axes.

    Valid for a spindle that turns clockwise seen from the spindle (M3) and many revolutions a waypoint. With the tooth
    at angle psi from the travel towards the left, chip thickness h = f cos(psi) (f: feed a tooth) and constant
    coefficients the force on the tool is F = N ap / (2 pi) * integral of h (kt z x r - kr r + ka z) over the
    engagement [Altintas2012], kt = kc, kr = radial_ratio kc, ka = axial_ratio kc (positive: towards the spindle).

    Args:
        process: Parameters; `material_side` right with M3 is climb milling.
        feed: Feed. Shape (n,). [m/s]

    Returns:
        Shape (n, 6). [N, N m]

    """
    radius = 0.5 * process.diameter_mm
    inner = float(np.arcsin(np.clip(process.width_mm / radius - 1.0, -1.0, 1.0)))
    low, high = (-0.5 * np.pi, inner) if process.material_side == "right" else (-inner, 0.5 * np.pi)
    cos_sin = 0.5 * (np.sin(high) ** 2 - np.sin(low) ** 2)
    cos_cos = 0.5 * (high - low) + 0.25 * (np.sin(2.0 * high) - np.sin(2.0 * low))
    cosine = np.sin(high) - np.sin(low)
    kr = process.radial_ratio
    shape = np.array([-cos_sin - kr * cos_cos, cos_cos - kr * cos_sin, process.axial_ratio * cosine, 0.0, 0.0,
                      radius * 1e-3 * cosine])
    feed_mm_rev = feed * 1e3 * 60.0 / process.spindle_rpm  # teeth times feed a tooth
    return (process.kc_N_mm2 * process.depth_mm * feed_mm_rev / (2.0 * np.pi))[:, None] * shape


def _read_wrench(process: FileProcess, nominal: Toolpath, folder: Path, rows_at: Array | None) -> Array:
    """Return the wrench of a file at every waypoint, in the frame of the file. Shape (n, 6)."""
    table = read_table(folder / process.file, FILE_COLUMNS)
    rows = np.column_stack([table.values[key] if key in table else np.zeros(len(table)) for key in WRENCH])
    if "s" not in table:
        at = nominal.arc_length if rows_at is None else rows_at
        if len(rows) != len(at):
            raise table.error(f"{len(rows)} rows, expected {len(at)}, one a waypoint; or add a column s_mm")
        return np.column_stack([np.interp(nominal.arc_length, at, column) for column in rows.T])
    s = table.values["s"]
    if len(s) < 2:
        raise table.error(f"{len(s)} rows, expected at least 2")
    back = np.flatnonzero(np.diff(s) <= 0.0)
    if len(back):
        raise table.error("s_mm does not grow here; rows must stand in the order of the path", int(back[0]) + 1)
    progress = cutting_progress(nominal)
    if s[0] > 1e-9 or s[-1] < progress[-1] - 1e-6:
        span = f"{s[0] * 1e3:g} to {s[-1] * 1e3:g} mm"
        raise table.error(f"s_mm covers {span}, the toolpath needs 0 to {progress[-1] * 1e3:g} mm")
    return np.column_stack([np.interp(progress, s, rows[:, column]) for column in range(6)])
