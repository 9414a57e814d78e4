"""Planning commands: `plan`, `post`, `place`, `compare`, `forces`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from compplan.cli.options import (
    INPUT,
    CommandResult,
    keep_stated,
    make_command,
    make_job_command,
    out_folder,
    robot_instead,
    robot_option,
    take_cam_options,
)
from compplan.cli.terminal import show_progress
from compplan.controllers.writers import WRITERS
from compplan.errors import CompplanError, InfeasibleError, InputError
from compplan.io.tomlfile import check_table, read_named_table
from compplan.job.names import ONLINE, STRATEGIES
from compplan.process.force_models import FORCE_MODELS

if TYPE_CHECKING:
    from compplan.job.job import Job
    from compplan.planning.result import Plan


@make_job_command(out_folder, robot_instead, several=True)
def run_plan(job: Job, folder: Path) -> CommandResult:
    """Plan JOB: write plan.json, joints.csv, report.html and native programs.

    Example: compplan plan paths/isf_cone.toml --out out
    """
    from compplan.robot.folder import find_robot_folder

    name, note = f"learned_{job.file.stem}.csv", ""
    try:
        if (find_robot_folder(job.robot, job.folder) / name).is_file():
            note = "parts of this path were measured; only the program of compplan learn uses what they left over"
            note = f"{name} in the robot folder: {note}"
    except CompplanError:  # a missing robot is reported by the plan
        pass
    return carry_out(job, folder, note)


def carry_out(job: Job, folder: Path, note: str = "") -> CommandResult:
    """Plan a job, one plan for each of its tools, and write the results; `note` is added to the first plan."""
    from compplan.api.verbs import plan_operations
    from compplan.reporting.operations import describe_order, open_operations, summarise_operations
    from compplan.reporting.plan_summary import format_plan

    with show_progress() as announce:
        done = plan_operations(job, folder, note, announce)
    fault = explain_failures(done.plans)
    if len(done.plans) == 1:
        plan = done.plans[0]
        return CommandResult(plan.to_dict(), format_plan(plan, folder, done.files), fault)
    summary = summarise_operations(done.plans, job.name or job.file.stem)
    lines = [f"{'' if plan.job is None else plan.job.label}: {plan.verdict.sentence}" for plan in done.plans]
    if any(plan.job is not None and plan.job.output.programs for plan in done.plans):
        lines.append(describe_order(summary, done.files))
    return CommandResult(summary, open_operations(summary).format(folder, done.files, lines), fault)


def explain_failures(plans: Sequence[Plan]) -> InfeasibleError | None:
    """Return an error with the waypoints and limits of plans that are not solved; None if all are solved."""
    from compplan.reporting.operations import worst_status

    failing = [plan for plan in plans if plan.status != "solved"]
    if not failing:
        return None
    labels = [f"{plan.job.label}: " if plan.job is not None and len(plans) > 1 else "" for plan in failing]
    why = "; ".join(f"{label}{plan.explain_failures()}" for label, plan in zip(labels, failing, strict=True))
    waypoints = sorted(failing[0].command.failures) if len(plans) == 1 else []
    limits = sorted({limit for plan in failing for limit in plan.command.failures.values()})
    message = f"{why}; the best compromise is written, marked {worst_status(plans)}"
    return InfeasibleError(message, waypoints=waypoints, limits=limits)


#: Options of `post` by the tables and keys of its assumed job.
OPTIONS = {"toolpath": "CAMFILE"} | {
    name: f"--{name}" for name in ("robot", "part", "tool", "tools", "process", "cam", "plan", "output")
}


@make_command(
    click.argument("camfile", type=INPUT),
    click.option("--profile", metavar="FILE",
                 help="Shop profile (compplan init profile): options that it states may be left out here."),
    robot_option("A folder in robots/ or a path.", required=False),
    click.option("--part", metavar="X,Y,Z[,RX,RY,RZ] | FILE", help="Part frame, mm and rotation vector."),
    click.option("--tool", metavar="FILE", help="TOML file as [tool] of a job; left out: the robot folder's TCP."),
    click.option("--tools", metavar="FILE", help="Tools by T number: TOML with [[tool]], CSV, or a tool library of "
                 "Fusion, whose lengths count from the spindle that --tool describes."),
    click.option("--process", metavar="FILE", help="TOML file as [process] of a job; left out: no force is predicted."),
    click.option("--program", "programs", multiple=True,
                 help=f"Language, may be given more than once: {', '.join(WRITERS)}."),
    click.option("--cam", metavar="FILE", help="TOML file as [cam] of a job: how the file is read."),
    take_cam_options,
    click.option("--plan", metavar="FILE", help="TOML file as [plan] of a job: strategy, tolerance, posture."),
    click.option("--output", metavar="FILE", help="TOML file as [output] of a job: signals (io), templates, .."),
    out_folder,
)  # fmt: skip
def run_post(
    camfile: Path, profile: str | None, robot_name: str | None, part: str | None, tool: str | None, tools: str | None,
    process: str | None, programs: tuple[str, ...], cam: str | None, plan: str | None, output: str | None,
    folder: Path, **of_cam: Any,
) -> CommandResult:  # fmt: skip
    """Read CAMFILE, plan it and write the programs, plan.json, joints.csv and report.html.

    Example: compplan post part.nc --robot kuka_kr240 --part 1800,0,700 --program krl --out out
    """
    from compplan.api.given import make_post_job, read_table
    from compplan.job.output import OutputTable

    stated = keep_stated(**of_cam)
    of_file = {**({} if cam is None else read_named_table(cam, "cam")[0]), **stated} if stated else cam
    job_file = folder.absolute() / f"{camfile.stem}.toml"
    place = None if part is None else _read_part(part)
    note = "No --process is given: no force is predicted, the arm bends under weights alone." if process is None else ""
    written = None if output is None else read_table("output", output)
    if written is not None:  # includes the keys that the command line replaces
        check_table(OutputTable, written, file=output)
    try:
        job = make_post_job(
            camfile, robot=robot_name, part=place, program=programs, profile=profile, tool=tool, tools=tools,
            process=process, cam=of_file, plan=plan, output=written, job_file=job_file,
        )  # fmt: skip
        return carry_out(job, folder, note)
    except InputError as error:
        raise _name_option(error, job_file) from None


def _name_option(error: InputError, job_file: Path) -> InputError:
    """Return an error about the assumed job as one about the option of the value."""
    if error.file != str(job_file):
        return error
    table, _, key = str(error.where or "").partition(".")
    if table.startswith("tool["):
        table, key = "tools", f"{table}.{key}".rstrip(".")
    if table == "output" and key.startswith("programs"):
        return InputError(error.message, where="--program")
    return InputError(error.message, where=" ".join(filter(None, (OPTIONS.get(table), key))) or None)


def _read_part(text: str) -> Any:
    """Read the value of --part: three or six numbers, or a file."""
    from compplan.api.given import read_table

    if Path(text).suffix == ".toml":
        return read_table("part", text)
    try:
        return read_table("part", [float(word) for word in text.split(",")])
    except (ValueError, InputError):
        message = f"--part is {text!r}, expected X,Y,Z in mm, or X,Y,Z,RX,RY,RZ with a rotation vector in deg"
        raise InputError(message) from None


@make_job_command(out_folder)
def run_place(job: Job, folder: Path) -> CommandResult:
    """Search the best place for the part of JOB: write place.json and report.html.

    Example: compplan place paths/circle_500mm.toml --out out
    """
    from compplan.planning.plan import job_robot
    from compplan.planning.posture.place import place_part
    from compplan.reporting.place import open_placement, write_placement
    from compplan.uncertainty.posture_errors import posture_errors

    with show_progress() as announce:
        robot = job_robot(job)
        result = place_part(job, robot, announce, posture_errors(job, robot))
    summary = write_placement(result, job, folder)
    opening = open_placement(summary, result, str(job.file))
    return CommandResult(summary, opening.format(folder, ["place.json", "report.html"]))


@make_job_command(out_folder, robot_instead, epilog=f"Strategies: {', '.join((*STRATEGIES, *ONLINE))}.")
def run_compare(job: Job, folder: Path) -> CommandResult:
    """Compare every strategy on JOB: write compare.json and report.html.

    Example: compplan compare paths/circle_500mm.toml --out out
    """
    from compplan.api.verbs import compare
    from compplan.reporting.compare import open_comparison

    with show_progress() as announce:
        comparison = compare(job, out=folder, progress=announce)
    strategies = str(comparison).splitlines()[1:]
    lines = open_comparison(comparison).format(folder, ["compare.json", "report.html"], strategies)
    return CommandResult(comparison.to_dict(), lines)


@make_job_command(
    out_folder,
    click.option("--log", type=INPUT, help="Measured forces: CSV with s_mm or t_s, the length or the time cut so far, "
                 "and fx_N fy_N fz_N, part axes; mx_Nm my_Nm mz_Nm at the tip are used too."),
    click.option("--write", "table", type=INPUT, help="With --log: write the fitted coefficients to this file, for "
                 "[process] of a later job; process.toml of a robot folder takes the level instead, which later "
                 "plans read."),
    epilog=f"Force models of a job: {', '.join(FORCE_MODELS)}.",
)  # fmt: skip
def run_forces(job: Job, folder: Path, log: Path | None, table: Path | None) -> CommandResult:
    """Predict engagement and force along the path of JOB: write forces.json, forces.csv, report.html.

    Example: compplan forces examples/forces/pocket.toml --out out
    """
    from compplan.job.loading import predict_forces
    from compplan.process.learned_force import FILE as PROCESS_FILE
    from compplan.reporting.forces import list_fitted, open_forces, write_coefficients, write_forces, write_level

    if table is not None and log is None:
        raise InputError("--write needs --log, the measured forces")
    with show_progress() as announce:
        announce("forces: engagement and wrench along the path")
        found = predict_forces(job, log)
        if table is not None:
            (write_level if table.name == PROCESS_FILE else write_coefficients)(found, table)
        announce("write: forces.json, forces.csv, report.html")
        summary = write_forces(found, folder)
    notes = list(summary["notes"])
    if found.fit is not None:
        notes += [*found.fit.notes, *list_fitted(found.fit)]
    opening = open_forces(found, summary)
    if table is not None:
        use = f"Put [process.coefficients] of {table} in place of material in a job, then plan it."
        opening = replace(opening, next=f"Plan with {table.parent}." if table.name == PROCESS_FILE else use)
        notes.append(f"wrote {table}")
    return CommandResult(summary, opening.format(folder, ["forces.json", "forces.csv", "report.html"], notes))
