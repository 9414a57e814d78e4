"""Loading of a job's files: toolpath as programmed, path to follow with its wrench, and the force along it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from compplan.errors import CompplanError, InputError
from compplan.io.notes import list_remarks, list_stops
from compplan.io.tables import Array
from compplan.job.job import Job
from compplan.process.cutting import CuttingTable, prepare_cutting
from compplan.process.engagement import Engagement
from compplan.process.force_law import ForceLaw, compare_zero, read_stock_top
from compplan.process.learned_force import LearnedForce, read_learned_force
from compplan.robot.folder import find_robot_folder
from compplan.toolpath.contact import path_axes
from compplan.toolpath.corners import KEPT, SLOWED, round_corners
from compplan.toolpath.operations import split_operations
from compplan.toolpath.reading import read_toolpath
from compplan.toolpath.toolpath import Toolpath, check_toolpath, place_toolpath, resample_toolpath

if TYPE_CHECKING:
    from compplan.process.fit import ForceFit

#: Default step of a toolpath file. [m]
FILE_STEP = 1e-3
#: Greatest force or moment of a process. [N, N m]
MOST_LOAD = 1e5


def load_toolpath(job: Job) -> Toolpath:
    """Return the job's toolpath as programmed, in the part frame.

    Raises:
        InputError: If the toolpath file is invalid.
    """
    if job.context.given is not None:
        return check_toolpath(job.context.given)
    if not isinstance(job.toolpath, str):
        with name_file(job.file, "toolpath"):
            return check_toolpath(job.toolpath.generate(), file=job.file)
    path = job_toolpath_file(job)
    feed = None if job.feed.constant_mm_s is None else job.feed.constant_mm_s * 1e-3
    toolpath = read_toolpath(path, cam=job.cam, feed=feed)
    refuse_unsettled(job)
    if job.cam.operation is None:
        _refuse_tools(job, toolpath)
    return toolpath


def job_toolpath_file(job: Job) -> Path:
    """Return the toolpath file of a job.

    Raises:
        InputError: If it is missing.
    """
    if not isinstance(job.toolpath, str):
        raise InputError("is computed, expected the name of a CAM file", file=job.file, where="toolpath")
    path = job.folder / job.toolpath
    if not path.is_file():
        raise InputError(f"no toolpath file {path}", file=job.file, where="toolpath")
    return path


def refuse_unsettled(job: Job) -> None:
    """Refuse a job with numbered tools but no selected operation.

    Raises:
        InputError: If it does.
    """
    if job.context.tools or job.tool_table is not None:
        message = "describes tools by number: split_job gives a job of each, require_single_operation that of [cam]"
        raise InputError(message, file=job.file, where="tool")


def _refuse_tools(job: Job, toolpath: Toolpath) -> None:
    """Refuse a file with several tools if only one is described."""
    tools = dict.fromkeys((operation.number, operation.tool) for operation in split_operations(toolpath))
    if len(tools) > 1:
        names, wanted = ", ".join(name for _, name in tools), " and ".join(f"number = {k}" for k, _ in tools)
        message = f"cuts with {names}, and the job describes one tool; write [[tool]] for {wanted}, or [cam] operation"
        raise InputError(message, file=job.file, where="toolpath")


def load_nominal(job: Job) -> Toolpath:
    """Return the divided toolpath in the base frame with the predicted wrench.

    Raises:
        InputError: If toolpath or process are invalid.
    """
    return load_path(job)[0]


def load_path(job: Job) -> tuple[Toolpath, ForceLaw]:
    """Return the path as `load_nominal`, and the force law with the level learned from parts.

    The path carries the predicted wrench, so that a learned force does not change the posture.

    Raises:
        InputError: If toolpath or process are invalid.
    """
    toolpath = load_toolpath(job)
    if job.feed.constant_mm_s is not None:
        toolpath = replace(toolpath, feed=np.where(toolpath.rapid, toolpath.feed, job.feed.constant_mm_s * 1e-3))
    rows_at, from_file = toolpath.arc_length, isinstance(job.toolpath, str)
    from_cam = job.context.given is None and isinstance(job.toolpath, str) and not job.toolpath.lower().endswith(".csv")
    top, note = read_stock_top(job.process, toolpath, from_cam=from_cam)
    step = job.sampling.max_step_mm
    max_step = step * 1e-3 if step is not None else FILE_STEP if from_file else np.inf
    if np.isfinite(max_step):
        toolpath = resample_toolpath(toolpath, max_step)
    toolpath = round_corners(toolpath, job.corner_tolerance, KEPT if job.feed.mode == "constant" else SLOWED)
    cutting = None
    if isinstance(job.process, CuttingTable):
        cutting = prepare_cutting(job.process, toolpath, top, job.file, _list_cuts_before(job, job.process))
        if from_cam and job.process.stock is not None:
            note = compare_zero(cutting, toolpath)
    nominal = place_toolpath(toolpath, job.T_base_part)
    law = ForceLaw(job.process, job.T_base_part, job.tool_x_base, job.folder, rows_at, top, cutting=cutting)
    with name_file(job.file):
        notes = law.describe(nominal)
    missing = 0 if cutting is None or job.cam.operation is None else job.cam.operation - 1 - len(job.context.before)
    if missing > 0:
        notes = (f"The cuts of {missing} earlier operations are left out of the stock (assumed): no [[tool]] describes "
                 "them.", *notes)  # fmt: skip
    note = " ".join(filter(None, [note, *list_remarks(notes)]))
    law = replace(law, note=note)
    with name_file(job.file):
        wrench = law.predict(nominal)
    _check_load(wrench, job)
    learned = find_learned_force(job)
    if learned is not None and wrench.any():
        law = replace(law, learned=learned, note=f"{note} {learned.words}.".strip())
        _check_load(law.predict(nominal), job)
    return replace(nominal, wrench=wrench, notes=(*nominal.notes, *list_stops(notes))), law


@contextmanager
def name_file(file: Path | None, where: str | None = None) -> Iterator[None]:
    """Add a file to errors without one, and a key to those without one, or the key given."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.message, file=file, where=where or error.where) from None


def _list_cuts_before(job: Job, process: CuttingTable) -> list[tuple[CuttingTable, Toolpath]]:
    """Return the earlier cuts in the same stock, part frame."""
    return [
        (one.process, resample_toolpath(load_toolpath(one), FILE_STEP)) for one in job.context.before
        if isinstance(one.process, CuttingTable)
        and (one.process.stock, one.process.stock_top_mm) == (process.stock, process.stock_top_mm)
    ]  # fmt: skip


def find_learned_force(job: Job) -> LearnedForce | None:
    """Return the force learned from parts: from the job, or from its robot folder."""
    if job.context.force is not None:
        return job.context.force[0]
    if job.context.mounted is not None:
        return read_learned_force(job.context.mounted.folder, job.process)
    try:
        folder = find_robot_folder(job.robot, job.folder)
    except CompplanError:  # reported when the robot is loaded
        return None
    return read_learned_force(folder, job.process)


def _check_load(wrench: Array, job: Job) -> None:
    size = np.nan_to_num(np.abs(wrench), nan=np.inf).max(axis=1)
    if (size > MOST_LOAD).any():
        row = int(np.argmax(size))
        message = f"force or moment of {size[row]:.4g} N or Nm at waypoint {row}, at most {MOST_LOAD:g}"
        raise InputError(message, file=job.file, where="process")


@dataclass(frozen=True)
class ForcePrediction:
    """The force along a job's path."""

    job: Job  #: The job.
    nominal: Toolpath  #: The path with its wrench, base frame.
    law: ForceLaw  #: Force law of the process.
    fit: ForceFit | None  #: The comparison with a log, or None.

    @property
    def wrench(self) -> Array:
        """The wrench on the tool at its tip, base axes. Shape (n, 6). [N, N m]"""
        return np.zeros((len(self.nominal), 6)) if self.nominal.wrench is None else self.nominal.wrench

    @property
    def local(self) -> Array:
        """The force in path axes. Shape (n, 3). [N]"""
        return np.asarray(np.einsum("nji,nj->ni", path_axes(self.nominal), self.wrench[:, :3]))

    @property
    def engagement(self) -> Engagement | None:
        """Engagement of the cutter along the path; None if the force model uses none."""
        return None if self.law.cutting is None else self.law.cutting.engagement

    @property
    def notes(self) -> list[str]:
        """Notes, one sentence each."""
        return [*self.nominal.notes, *([self.law.note] if self.law.note else [])]


def predict_forces(job: Job, log: Path | None = None) -> ForcePrediction:
    """Predict engagement and force along a job's path, and compare them with a log, if any.

    Raises:
        InputError: If toolpath, process or log are invalid.
    """
    from compplan.process.fit import fit_forces, read_force_log

    nominal, law = load_path(job)
    law = replace(law, learned=None)  # a log is compared with the model
    fit = None if log is None else fit_forces(read_force_log(log), law, nominal, log)
    return ForcePrediction(job, nominal, law, fit)
