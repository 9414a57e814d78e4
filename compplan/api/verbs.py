"""The functions `compplan.plan`, `post`, `compare`, `diagnose`, `learn`: from files, arrays or DataFrames to a result.

Commands of the same names call them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from compplan.api.given import Table, make_job, make_post_job

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.job.job import Job
    from compplan.learning.part import LearnedPart
    from compplan.planning.compare import Comparison
    from compplan.planning.result import Plan
    from compplan.robot import Robot

Progress = Callable[[str], None]


def _no_progress(text: str) -> None:
    return None


@dataclass(frozen=True)
class Posted:
    """Result of `compplan.post` for a CAM file."""

    plans: tuple[Plan, ...]  #: One plan for each operation (tool); a single plan if the file calls one tool.
    folder: Path  #: Folder of all written files.
    files: tuple[Path, ...]  #: The files written.

    @property
    def status(self) -> str:
        """Worst status of the plans: "solved", "infeasible" or "not_confirmed"."""
        from compplan.reporting.operations import worst_status

        return worst_status(self.plans)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the plans, one sentence each."""
        return tuple(dict.fromkeys(note for plan in self.plans for note in plan.notes))


def plan(
    job: Any, *, robot: str | Path | Robot | None = None, out: str | Path | None = None,
    progress: Progress = _no_progress, **tables: Any,
) -> Plan:  # fmt: skip
    """Plan a path: posture, corrected joint positions and their times, with an independent check.

        plan = cp.plan("paths/isf_cone.toml")
        plan = cp.plan("part.nc", robot="kuka_kr240", part=(1800, 0, 700), process={"model": "milling", ...})
        plan = cp.plan({"position_mm": xyz, "feed_mm_s": 20.0}, robot="ur10", part=(600, 0, 200))
        print(plan); plan.plot(); plan.to_frame(); cp.write_plan(plan, "out")

    Args:
        job: A job: the TOML file, a `Job`, or its sections; or a path: a CAM file or CSV, a `Toolpath`, a DataFrame, or
            columns by name with units in the names.
        robot: Name of a shipped robot, a robot folder, or a `Robot`; it replaces the job's, and is required for a path.
        out: Folder for the files that the command of this name writes; left out: none.
        progress: Called with the current step as text; an exception raised in it ends the call.
        tables: Sections of the job, such as `plan={"tolerance_mm": 0.05}`; their keys replace those of the job.
            `part=(x, y, z)` or `(x, y, z, rx, ry, rz)` in mm and deg, `output="krl"` for a program.

    Returns:
        The plan. Its `status` is "infeasible" or "not_confirmed" if it does not meet the requirements.

    Raises:
        InputError: If job, path or robot are not valid, or the part is out of reach.
    """
    from compplan.job.operations import require_single_operation
    from compplan.planning.plan import plan_job
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    result = note_programs(plan_job(require_single_operation(make_job(job, robot, tables)), progress=progress))
    if out is not None:
        result, _ = deliver_plan(result, out)
    return result


def post(
    camfile: str | Path, *, robot: str | Path | None = None, part: Table | Sequence[float] | None = None,
    program: str | Sequence[str] = (), profile: str | Path | None = None, tool: Table | None = None,
    tools: Table | Sequence[Mapping[str, Any]] | None = None, process: Table | None = None,
    cam: Table | None = None, plan: Table | None = None, output: Table | None = None, out: str | Path | None = None,
) -> Posted:  # fmt: skip
    """Read a CAM file, plan it and write its programs: one plan and program for each tool in the file.

        done = cp.post("part.nc", robot="kuka_kr240", part=[1800, 0, 700], program="krl",
                       tool={"frame": "pendant", "position_mm": [0, 0, 250]})

    Args:
        camfile: The CAM file.
        robot: Name of a shipped robot, or path of a robot folder.
        part: Part frame in the robot base: X Y Z [mm], of six numbers also a rotation vector [deg]; or section [part].
        program: Language, or languages.
        profile: TOML file with defaults of the shop; robot, part and program may be left out if it states them.
        tool: Section [tool] of a job; left out: the robot folder's TCP.
        tools: For a file that calls several tools: list [[tool]] or section [tools] of a job, or a tool table's file.
        process: Section [process] of a job; left out: no force is predicted.
        cam: Section [cam] of a job: options for reading the file.
        plan: Section [plan] of a job: strategy, tolerance, posture.
        output: Section [output] of a job: signals (io), templates.
        out: Folder to write to; default: "out".

    Raises:
        InputError: If an argument is not valid; nothing is written then.
    """
    folder = Path("out" if out is None else out)
    job = make_post_job(
        camfile, robot=robot, part=part, program=program, profile=profile, tools=tools, tool=tool, process=process,
        cam=cam, plan=plan, output=output, job_file=folder.absolute() / f"{Path(camfile).stem}.toml",
    )  # fmt: skip
    return plan_operations(job, folder)


def plan_operations(job: Job, folder: Path, note: str = "", progress: Progress = _no_progress) -> Posted:
    """Plan a job, one plan for each of its tools, and write the results; `note` is added to the first plan."""
    from compplan.job.operations import split_job
    from compplan.planning.checks import state_notes
    from compplan.planning.plan import plan_job
    from compplan.reporting.operations import deliver_operations
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    plans: list[Plan] = []
    for one in split_job(job):
        result = note_programs(plan_job(one, progress=progress))
        plans.append(result.add_checks(state_notes([note]), first=True) if note and not plans else result)
        progress("95 % band: where the true tip is")
        _ = plans[-1].error_band
    progress("write: programs, joints.csv, report.html")
    if len(plans) == 1:
        done, files = deliver_plan(plans[0], folder)
        return Posted((done,), folder, tuple(files))
    read, files = deliver_operations(plans, folder, job.name or job.file.stem)
    return Posted(tuple(read), folder, tuple(files))


def compare(
    job: Any, *, robot: str | Path | Robot | None = None, out: str | Path | None = None,
    progress: Progress = _no_progress, **tables: Any,
) -> Comparison:  # fmt: skip
    """Compare all strategies on a path: their deviations on the robot as modelled, and on robots with model errors.

        comparison = cp.compare("paths/circle_500mm.toml")
        print(comparison); comparison.plot(); comparison.to_frame()

    Args:
        job: As for `compplan.plan`.
        robot: As for `compplan.plan`.
        out: Folder for the files that the command of this name writes; left out: none.
        progress: Called with the current step as text; an exception raised in it ends the call.
        tables: Sections of the job; their keys replace those of the job.

    Returns:
        The comparison.

    Raises:
        InputError: If job, path or robot are not valid, or the part is out of reach.
    """
    from compplan.job.operations import require_single_operation
    from compplan.reporting.compare import write_comparison
    from compplan.studies.job_study import compare_job

    result = compare_job(require_single_operation(make_job(job, robot, tables)), announce=progress)
    if out is not None:
        write_comparison(result, out)
    return result


def diagnose(
    measurements: Any, robot: str | Path | Robot, *, register: Sequence[str] = (), without: Sequence[str] = (),
    tool: Table | None = None, target_offset_mm: Sequence[float] | None = None,
    instrument: str | Path | None = None, assume_ok: bool = False,
    out: str | Path | None = None, progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:  # fmt: skip
    """Diagnose measurements of a robot: identify its errors with their size, and update the robot model.

        diagnosis = cp.diagnose("measurements.csv", "kuka_kr270")
        diagnosis = cp.diagnose({"q_deg": q, "position_mm": xyz}, "my_robot", register=("base",))
        print(diagnosis); diagnosis.plot(); cp.plan("job.toml", robot=diagnosis.updated)

    Args:
        measurements: A measurement log: the CSV file, a `Campaign`, a DataFrame, or columns by name with units in the
            names.
        robot: Name of a shipped robot, a robot folder, or a `Robot`.
        register: Unknown frames, "base" and/or "tool"; they are fitted in every candidate model.
        without: Names of effects (listed by `compplan diagnose --help`) to leave out of the candidates.
        tool: The tool that was mounted, as [tool] of a job, or its TOML file.
        target_offset_mm: The measured point in the TCP frame; left out: the TCP. Shape (3,). [mm]
        instrument: TOML file of an instrument for other data than positions: socket, probe, dial gauge, ball bar.
        assume_ok: Whether to continue despite a plausibility question about the log.
        out: Folder for the files that the command of this name writes; left out: none.
        progress: Called with the current step as text; an exception raised in it ends the call.

    Returns:
        The diagnosis; `updated` is the robot with the updated model.

    Raises:
        InputError: If a file is not valid, the log raises a plausibility question, or it has too few rows.
    """
    result, _ = diagnose_measured(
        measurements, robot, register=register, without=without, assume_ok=assume_ok, progress=progress, tool=tool,
        target_offset_mm=target_offset_mm, instrument=instrument,
    )  # fmt: skip
    if out is not None:
        from compplan.reporting.diagnosis import deliver_diagnosis

        deliver_diagnosis(result, Path(out), progress)
    return result


def diagnose_measured(
    measurements: Any, robot: str | Path | Robot, *, register: Sequence[str], without: Sequence[str], assume_ok: bool,
    progress: Progress, self_test: bool = False, **measured: Any,
) -> tuple[Diagnosis, list[str]]:  # fmt: skip
    """Diagnose as `diagnose` does, with a check of the log for a self-test; also return the assumed answers."""
    from compplan.api.measured import choose_frames, read_measured, resolve_questions
    from compplan.diagnosis.campaign_diagnosis import diagnose_campaign
    from compplan.diagnosis.self_test import check_self_test
    from compplan.effects import EFFECTS
    from compplan.errors import UnknownNameError

    for name in without:
        if name not in EFFECTS:
            raise UnknownNameError("effect", name, list(EFFECTS))
    mounted, campaign = read_measured(measurements, robot, **measured)
    if self_test:
        check_self_test(campaign)
    frames = choose_frames(register, campaign)
    progress("questions")
    questions = resolve_questions(mounted, campaign, frames, assume_ok)
    return diagnose_campaign(mounted, campaign, register=frames, without=without, progress=progress), questions


def learn(
    job: Any, measured: Any, robot: str | Path | Robot, *, frame: Literal["part", "base"] = "part",
    align: Literal["datum", "best_fit"] | None = None, sigma_mm: float | None = None,
    instrument: str | Path | None = None, mesh: str | Path | None = None, reach_mm: float | None = None,
    assume_ok: bool = False, out: str | Path | None = None, progress: Progress = _no_progress,
) -> LearnedPart:  # fmt: skip
    """Learn from measured points of a cut part: the corrected program of the next part, and the updated robot model.

        update = cp.learn("job.toml", "part1.csv", "my_robot", out="part2")
        print(update); update.plot()

    Args:
        job: The job that the part was cut with, as for `compplan.plan`.
        measured: Points of the attained tool tip, x_mm y_mm z_mm, and s_mm and sigma_mm if known: a file, a DataFrame,
            or columns by name.
        robot: Robot folder that the part's program was planned with; it holds earlier updates from this path.
        frame: Frame of the points.
        align: "datum": the points are used in their frame; "best_fit": a rigid motion of all points is fitted and
            removed; left out: as "datum", with a question if such a motion is most of the measured deviation.
        sigma_mm: Standard deviation of points whose file has none; assumed if left out. [mm]
        instrument: TOML file of the instrument; its sigma_mm is used if `sigma_mm` is left out.
        mesh: Nominal surface of the part, STL or PLY in mm, in the frame of the points; they count along its normals.
        reach_mm: Greatest distance of that surface from the path of the tip; left out: from the job's cutter. [mm]
        assume_ok: Whether to continue despite a plausibility question about the points.
        out: Folder for the files that the command of this name writes; left out: none.
        progress: Called with the current step as text; an exception raised in it ends the call.

    Returns:
        The model update, with the plans before and after.

    Raises:
        InputError: If a file is not valid, or too few of the points are on the cut.
    """
    from compplan.errors import InputError
    from compplan.learning.measured_path import reach_of
    from compplan.learning.part import learn_from_part
    from compplan.measurement.instrument import read_instrument
    from compplan.measurement.part_points import read_surface
    from compplan.reporting.learn import write_learning

    if frame not in ("part", "base"):
        raise InputError(f"frame is {frame!r}, choose from ['part', 'base']")
    checked = make_job(job)
    if instrument is not None and sigma_mm is None:
        sigma_mm = read_instrument(Path(instrument)).instrument.sigma_mm
    reach = reach_of(checked.process) if reach_mm is None else reach_mm * 1e-3
    result = learn_from_part(
        checked, robot, measured, in_base=frame == "base", align=align,
        sigma=None if sigma_mm is None else sigma_mm * 1e-3, sure=assume_ok,
        surface=None if mesh is None else read_surface(Path(mesh), reach), announce=progress,
    )  # fmt: skip
    if out is not None:
        write_learning(result, Path(out))
    return result
