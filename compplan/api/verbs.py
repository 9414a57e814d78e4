"""The verbs `compplan.plan`, `compare`, `diagnose` and `learn`: from files, arrays or DataFrames to a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from compplan.api.given import make_job, take_robot

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.learning.part import LearnedPart
    from compplan.planning.compare import Comparison
    from compplan.planning.result import Plan
    from compplan.robot import Robot

Progress = Callable[[str], None]


def _say_nothing(text: str) -> None:
    return None


def plan(
    job: Any, *, robot: str | Path | Robot | None = None, out: str | Path | None = None,
    progress: Progress = _say_nothing, **tables: Any,
) -> Plan:  # fmt: skip
    """Plan a path: the posture, the corrected joint positions, their times, an independent check of them.

        plan = cp.plan("paths/isf_cone.toml")
        plan = cp.plan("part.nc", robot="kuka_kr240", part=(1800, 0, 700), process={"model": "milling", ...})
        plan = cp.plan({"position_mm": xyz, "feed_mm_s": 20.0}, robot="ur10", part=(600, 0, 200))
        print(plan); plan.plot(); plan.to_frame(); cp.write_plan(plan, "out")

    Args:
        job: A job: the TOML file, a `Job`, or its tables; or a path: a CAM file or CSV, a `Toolpath`, a DataFrame, or
            columns by name with units in the names.
        robot: Name of a shipped robot, a robot folder, or a `Robot`; it replaces the job's, a path needs one.
        out: Folder to write what the command of this name writes; nothing is written if left out.
        progress: Told what is being done; an exception raised in it ends the call.
        tables: Tables of the job, such as `plan={"tolerance_mm": 0.05}`; their keys replace those of the job.
            `part=(x, y, z)` or `(x, y, z, rx, ry, rz)` in mm and deg, `output="krl"` for a program.

    Returns:
        The plan. Its `status` is "infeasible" or "not_confirmed" where it is not what was asked for.

    Raises:
        InputError: If job, path or robot are not what they have to be, or the part is out of reach.
    """
    from compplan.job.operations import settle_job
    from compplan.planning.plan import plan_job
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    result = note_programs(plan_job(settle_job(make_job(job, robot, tables)), progress=progress))
    if out is not None:
        result, _ = deliver_plan(result, out)
    return result


def compare(
    job: Any, *, robot: str | Path | Robot | None = None, out: str | Path | None = None,
    progress: Progress = _say_nothing, **tables: Any,
) -> Comparison:  # fmt: skip
    """Compare every strategy on a path: what each leaves on the robot as modelled, and on robots that may be yours.

        comparison = cp.compare("paths/circle_500mm.toml")
        print(comparison); comparison.plot(); comparison.to_frame()

    Args:
        job: As `compplan.plan` takes it.
        robot: As `compplan.plan` takes it.
        out: Folder to write what the command of this name writes; nothing is written if left out.
        progress: Told what is being done; an exception raised in it ends the call.
        tables: Tables of the job; their keys replace those of the job.

    Returns:
        The comparison.

    Raises:
        InputError: If job, path or robot are not what they have to be, or the part is out of reach.
    """
    from compplan.job.operations import settle_job
    from compplan.reporting.compare import write_comparison
    from compplan.studies.job_study import compare_job

    result = compare_job(settle_job(make_job(job, robot, tables)), announce=progress)
    if out is not None:
        write_comparison(result, out)
    return result


def diagnose(
    measurements: Any, robot: str | Path | Robot, *, register: Sequence[str] = (), without: Sequence[str] = (),
    tool: Mapping[str, Any] | None = None, target_offset_mm: Sequence[float] | None = None,
    instrument: str | Path | None = None, assume_ok: bool = False,
    out: str | Path | None = None, progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:  # fmt: skip
    """Diagnose measurements of a robot: what is wrong with it, by how much, and a model that has learned it.

        diagnosis = cp.diagnose("measurements.csv", "kuka_kr270")
        diagnosis = cp.diagnose({"q_deg": q, "position_mm": xyz}, "my_robot", register=("base",))
        print(diagnosis); diagnosis.plot(); cp.plan("job.toml", robot=diagnosis.updated)

    Args:
        measurements: A measurement log: the CSV file, a `Campaign`, a DataFrame, or columns by name with units in the
            names.
        robot: Name of a shipped robot, a robot folder, or a `Robot`.
        register: Frames that no model can know, of "base" and "tool"; they are fitted in every model.
        without: Effects to leave out of the candidates.
        tool: The tool that was mounted, as [tool] of a job.
        target_offset_mm: The measured point in the TCP frame; left out: the TCP. Shape (3,). [mm]
        instrument: TOML file of an instrument that sees no positions: contacts, readings, ball bars.
        assume_ok: Whether to go on where the log raises a question.
        out: Folder to write what the command of this name writes; nothing is written if left out.
        progress: Told what is being done; an exception raised in it ends the call.

    Returns:
        The diagnosis; `updated` is the robot that has learned it.

    Raises:
        InputError: If a file is not what it has to be, the log raises a question, or it has too few rows.
    """
    import numpy as np

    from compplan.cli.measured import settle_questions
    from compplan.diagnosis.campaign_diagnosis import diagnose_campaign
    from compplan.effects import EFFECTS
    from compplan.errors import UnknownNameError
    from compplan.measurement.campaign import Campaign
    from compplan.measurement.instrument import read_instrument
    from compplan.measurement.reading import read_campaign

    for name in without:
        if name not in EFFECTS:
            raise UnknownNameError("effect", name, list(EFFECTS))
    mounted = take_robot(robot, tool)
    campaign = (
        measurements
        if isinstance(measurements, Campaign)
        else read_campaign(measurements, mounted, None if instrument is None else read_instrument(Path(instrument)))
    )
    if target_offset_mm is not None:
        campaign = replace(campaign, target_offset=np.asarray(target_offset_mm, float) * 1e-3)
    settle_questions(mounted, campaign, tuple(register), assume_ok, events=True)
    result = diagnose_campaign(mounted, campaign, register=register, without=without, progress=progress)
    if out is not None:
        from compplan.reporting.diagnosis import deliver_diagnosis

        deliver_diagnosis(result, Path(out), progress)
    return result


def learn(
    job: Any, measured: Any, robot: str | Path | Robot, *, frame: Literal["part", "base"] = "part",
    align: Literal["datum", "best_fit"] | None = None, out: str | Path | None = None,
    progress: Progress = _say_nothing,
) -> LearnedPart:  # fmt: skip
    """Learn from measured points of a cut part: the corrected program of the next one, and the robot as now known.

        update = cp.learn("job.toml", "part1.csv", "my_robot", out="part2")
        print(update); update.plot()

    Args:
        job: The job that the part was cut with, as `compplan.plan` takes it.
        measured: Points of the attained tool tip, x_mm y_mm z_mm, and s_mm and sigma_mm where they are known: a file, a
            DataFrame, or columns by name.
        robot: Robot folder that the part's program was planned with; what it learned on this path lies in it.
        frame: Frame of the points.
        align: "datum": the points stand where their frame says; "best_fit": a shift and turn of all is fitted and
            taken off; left out: as "datum", but where such a motion is most of what was measured it is asked about.
        out: Folder to write what the command of this name writes; nothing is written if left out.
        progress: Told what is being done; an exception raised in it ends the call.

    Returns:
        The model update, with the plans before and after.

    Raises:
        InputError: If a file is not what it has to be, or too few of the points are of the cut.
    """
    from compplan.errors import InputError
    from compplan.learning.part import learn_from_part
    from compplan.reporting.learn import write_learning

    if frame not in ("part", "base"):
        raise InputError(f"frame is {frame!r}, choose from ['part', 'base']")
    result = learn_from_part(make_job(job), robot, measured, in_base=frame == "base", align=align, announce=progress)
    if out is not None:
        write_learning(result, Path(out))
    return result
