"""Force law of a job: the wrench on the tool along any division of the toolpath, at any feed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from compplan.errors import InputError, ShapeError
from compplan.io.tables import Array
from compplan.process.cutting import CuttingForce, CuttingTable
from compplan.process.force_models.columns import ColumnsProcess
from compplan.process.force_models.constant import ConstantProcess
from compplan.process.force_models.file import FileProcess, read_wrench
from compplan.process.force_models.milling import MillingProcess
from compplan.process.learned_force import LearnedForce
from compplan.toolpath.contact import (
    ASIDE,
    ForceTable,
    Frame,
    PathForceTable,
    contact_share,
    lateral_share,
    path_axes,
    tool_axes,
)
from compplan.toolpath.toolpath import Toolpath

#: Least range of a CAM program above and below z = 0 for which z = 0 is assumed to be the stock's top. [m]
STOCK_ROOM = 1e-5
#: Distance of the stock's top from z = 0 of a CAM program below which no note is written; an allowance is common. [m]
ALLOWANCE = 5e-4


@dataclass(frozen=True)
class ForceLaw:
    """Wrench of the process on the tool, for a plan that subdivides the path and changes its feed."""

    process: ForceTable  #: The model and its parameters.
    #: Pose of the part frame in the base frame. Shape (4, 4). [m]
    T_base_part: Array = field(default_factory=lambda: np.eye(4))
    #: Direction of the TCP frame's x, base axes. Shape (3,).
    tool_x: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    folder: Path = Path()  #: Folder for relative file names of the model.
    rows_at: Array | None = None  #: Length along the path of each row of the toolpath file. Shape (r,). [m]
    stock_top: float | None = None  #: Height of the stock's top in the part frame, None if unknown. [m]
    note: str = ""  #: Note for the user.
    cutting: CuttingForce | None = None  #: Engagement along the path, for cutters with a force from engagement.
    learned: LearnedForce | None = None  #: Force correction learned from measured parts, or None.

    @property
    def follows_feed(self) -> bool:
        """Whether the force depends on the actual feed."""
        if isinstance(self.process, PathForceTable):
            return self.process.follows_feed
        return isinstance(self.process, CuttingTable)

    @property
    def turns_with_travel(self) -> bool:
        """Whether the force turns with the travel, and so jumps at a corner."""
        return turns_with_travel(self.process)

    @property
    def sudden(self) -> bool:
        """Whether the full force acts directly after contact."""
        return not self.always and not getattr(self.process, "ramp_mm", 0.0) > 0.0

    @property
    def abrupt(self) -> bool:
        """Whether the force is still acting at the end of a cut; one that depends on the feed vanishes at rest."""
        return not self.always and not self.follows_feed

    @property
    def always(self) -> bool:
        """Whether the wrench acts in rapid moves too (a dead weight)."""
        return isinstance(self.process, ConstantProcess) and self.process.during_rapid

    def predict(self, nominal: Toolpath, feed: Array | None = None) -> Array:
        """Predict the wrench of the environment on the tool at its tip, base axes. Shape (n, 6). [N, N m]

        `feed` is that of the move that ends at each waypoint; left out: the programmed feed. Shape (n,). [m/s]

        Raises:
            InputError: If the toolpath has no wrench columns, or a wrench file does not fit the toolpath.
        """
        wrench = self._model(nominal if feed is None else replace(nominal, feed=feed))
        if self.stock_top is not None and isinstance(self.process, MillingProcess):
            height = (nominal.position - self.T_base_part[:3, 3]) @ self.T_base_part[:3, 2]
            share = np.clip((self.stock_top - height) / (self.process.depth_mm * 1e-3), 0.0, 1.0)
            wrench = np.asarray(wrench * share[:, None])
        return wrench if self.learned is None else self.learned.correct(wrench, self.T_base_part[:3, :3])

    def _model(self, nominal: Toolpath) -> Array:
        """Return the wrench of the model, without the corrections by stock top and measured parts. Shape (n, 6)."""
        process = self.process
        frame: Frame = getattr(process, "frame", "path")
        if isinstance(process, ColumnsProcess):
            if nominal.wrench is None and process.required:
                raise _no_force_error(nominal.source)
            return np.zeros((len(nominal), 6)) if nominal.wrench is None else nominal.wrench
        if isinstance(process, CuttingTable):
            if self.cutting is None:
                raise ShapeError(f"process {process.model!r} needs the engagement of its path")
            return _turn(self.cutting.wrench(nominal), path_axes(nominal))
        if isinstance(process, ConstantProcess):
            local = np.tile([*process.force_N, *process.moment_Nm], (len(nominal), 1))
        elif isinstance(process, FileProcess):
            local = read_wrench(process, nominal, self.folder, self.rows_at)
        elif isinstance(process, PathForceTable):
            local = process.wrench_along(nominal)
        else:
            raise ShapeError(f"the table of force model {process.model!r} is of a kind without a force")
        _check_travel(frame, local, nominal)
        wrench = _turn(local, self._axes(frame, nominal))
        if self.always:
            return wrench
        return wrench * contact_share(nominal, getattr(process, "ramp_mm", 0.0) * 1e-3)[:, None]

    def _axes(self, frame: Frame, nominal: Toolpath) -> Array:
        """Return the axes of a wrench's frame, base axes. Shape (3, 3) or (n, 3, 3)."""
        if frame in ("base", "part"):
            return np.eye(3) if frame == "base" else self.T_base_part[:3, :3]
        return path_axes(nominal) if frame == "path" else tool_axes(nominal, self.tool_x)

    def describe(self, nominal: Toolpath) -> tuple[str, ...]:
        """Return notes on the sources and assumptions of the model, one sentence each."""
        if self.cutting is not None:
            return self.cutting.notes
        return tuple(self.process.describe(nominal)) if isinstance(self.process, PathForceTable) else ()


def read_stock_top(process: ForceTable, toolpath: Toolpath, *, from_cam: bool) -> tuple[float | None, str]:
    """Return the height of the stock's top: from the job, or z = 0 of a CAM program that moves above and below it.

    Returns:
        Height in the part frame [m] or None, and a sentence for the user if it was inferred, otherwise "".
    """
    if not isinstance(process, MillingProcess | CuttingTable) or getattr(process, "stock", None) is not None:
        return None, ""
    if process.stock_top_mm is not None:
        return process.stock_top_mm * 1e-3, ""
    if not from_cam or not _crosses_zero(toolpath):
        return None, ""
    return 0.0, "The stock's top is taken to be z = 0 of the CAM program (assumed); above it the tool carries no force."


def compare_zero(cutting: CuttingForce, toolpath: Toolpath) -> str:
    """Return a note if a given stock's top is not z = 0 of a CAM program that moves above and below it."""
    if cutting.R_view[2, 2] < 1.0 - 1e-12 or not _crosses_zero(toolpath):
        return ""
    top = float(cutting.stock.box[1, 2])
    if abs(top) <= ALLOWANCE:
        return ""
    return (
        f"The stock's top lies at z = {1e3 * top:.4g} mm, while z = 0 of a CAM program is by custom the top of the "
        "stock: compare the zeros of the two files; if they differ, depth and force are wrong."
    )


def _crosses_zero(toolpath: Toolpath) -> bool:
    height = toolpath.position[~toolpath.rapid, 2]
    return bool(len(height) and height.min() < -STOCK_ROOM and height.max() > STOCK_ROOM)


def turns_with_travel(process: ForceTable) -> bool:
    """Return whether the force of a process turns with the travel."""
    return not isinstance(process, ColumnsProcess) and getattr(process, "frame", "path") == "path"


def _no_force_error(source: str) -> InputError:
    """Build the error for a job and toolpath without a force, with the possible sources of one."""
    table = source.lower().endswith(".csv")
    known = "missing column fx_N" if table else "no force is given along this path"
    message = (
        f"{known}, expected columns fx_N fy_N fz_N in a CSV, or a section [process] with another model in the job; "
        f"compplan init NEW.toml --toolpath {Path(source).name or 'PATH'} writes a job with one, and "
        'process = { model = "columns", required = false } plans without a force'
    )
    return InputError(message, file=source or None, where=1 if table else None)


def _check_travel(frame: Frame, wrench: Array, nominal: Toolpath) -> None:
    """Refuse a force with a part along or across the travel on a path of plunges only, where travel has no direction.

    The wrench, shape (n, 6) [N, N m], is in the axes of `frame`.
    """
    cut = ~nominal.rapid
    if frame != "path" or not (cut & (np.abs(wrench[:, [0, 1, 3, 4]]).max(axis=1) > 0.0)).any():
        return
    if not (cut & (lateral_share(nominal) > ASIDE)).any():
        message = (
            "the force has a component along or across the travel, but no cutting move goes across the tool axis, so "
            'its direction is not defined; for drilling give model = "drill", or a constant force with frame = "part"'
        )
        raise InputError(message, where="process")


def _turn(wrench: Array, axes: Array) -> Array:
    """Express a wrench in base axes. Shape (n, 6)."""
    stacked = np.broadcast_to(axes, (len(wrench), 3, 3))
    return np.hstack([np.einsum("nij,nj->ni", stacked, wrench[:, k : k + 3]) for k in (0, 3)])
