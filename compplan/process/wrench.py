"""The predicted process wrench along a toolpath: what the environment does to the tool, at the tip, base axes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Union

import numpy as np
from pydantic import Field

from compplan.errors import InputError, ShapeError
from compplan.io.tables import Array
from compplan.process.cutting import CuttingForce, CuttingTable
from compplan.process.force_models import FORCE_MODELS
from compplan.process.force_models.columns import ColumnsProcess
from compplan.process.force_models.constant import ConstantProcess
from compplan.process.force_models.file import FileProcess, read_wrench
from compplan.toolpath.contact import (
    ASIDE,
    ForceTable,
    Frame,
    PathForceTable,
    contact_share,
    path_axes,
    tool_axes,
    travel_across,
)
from compplan.toolpath.toolpath import Toolpath

if TYPE_CHECKING:
    Process = ForceTable
else:
    Process = Annotated[Union[tuple(model.table for model in FORCE_MODELS.values())], Field(discriminator="model")]  # noqa: UP007


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
                raise _tell_no_force(nominal.source)
            return np.zeros((len(nominal), 6))
        return nominal.wrench
    if isinstance(process, ConstantProcess):
        wrench = np.tile([*process.force_N, *process.moment_Nm], (len(nominal), 1))
        _check_travel(process.frame, wrench, nominal)
        wrench = _turn(wrench, _axes(process.frame, nominal, rotations, tool_x))
        if process.during_rapid:
            return wrench
    elif isinstance(process, FileProcess):
        wrench = read_wrench(process, nominal, folder or Path(), rows_at)
        _check_travel(process.frame, wrench, nominal)
        wrench = _turn(wrench, _axes(process.frame, nominal, rotations, tool_x))
    elif isinstance(process, CuttingTable):
        if cutting is None:
            raise ShapeError(f"process {process.model!r} needs the engagement of its path")
        return _turn(cutting.wrench(nominal), path_axes(nominal))
    elif isinstance(process, PathForceTable):
        wrench = process.wrench_along(nominal)
        _check_travel("path", wrench, nominal)
        wrench = _turn(wrench, path_axes(nominal))
    else:
        raise ShapeError(f"the table of force model {process.model!r} is of no kind that has a force")
    return wrench * contact_share(nominal, getattr(process, "ramp_mm", 0.0) * 1e-3)[:, None]


def _tell_no_force(source: str) -> InputError:
    """Say that neither the toolpath nor the job tells a force, and what does."""
    table = source.lower().endswith(".csv")
    known = "missing column fx_N" if table else "no force is given along this path"
    message = (
        f"{known}, expected columns fx_N fy_N fz_N in a CSV, or a table [process] with another model in the job; "
        f"compplan init NEW.toml --toolpath {Path(source).name or 'PATH'} writes a job with one, and "
        'process = { model = "columns", required = false } plans without a force'
    )
    return InputError(message, file=source or None, where=1 if table else None)


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


def _check_travel(frame: Frame, wrench: Array, nominal: Toolpath) -> None:
    """Refuse a force along or beside the travel on a path that only plunges: which way that is, nobody knows.

    The wrench, shape (n, 6) [N, N m], is in the axes of `frame`.
    """
    cut = ~nominal.rapid
    if frame != "path" or not (cut & (np.abs(wrench[:, [0, 1, 3, 4]]).max(axis=1) > 0.0)).any():
        return
    if not (cut & (travel_across(nominal) > ASIDE)).any():
        message = (
            "the force has a part along or beside the travel, and no cutting move goes across the tool axis: it has no "
            'direction; for drilling give model = "drill", or a constant force with frame = "part"'
        )
        raise InputError(message, where="process")


def _turn(wrench: Array, axes: Array) -> Array:
    """Express a wrench in base axes. Shape (n, 6)."""
    stacked = axes if axes.ndim == 3 else axes[None]
    return np.hstack(
        [
            np.einsum("nij,nj->ni", np.broadcast_to(stacked, (len(wrench), 3, 3)), part)
            for part in (wrench[:, :3], wrench[:, 3:])
        ]
    )
