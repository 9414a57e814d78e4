"""`compplan plan`: from a job to a corrected robot program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from compplan.cli.commands.operations import carry_out_all
from compplan.cli.commands.options import posture_kept, robot_instead
from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.errors import CompplanError, InfeasibleError
from compplan.io.tables import dump_json

if TYPE_CHECKING:
    from compplan.job.job import Job

#: What a plan goes through, as it tells it.
STAGES = (
    "robot and toolpath", "posture", "sampling", "compensation", "force and feed", "virtual cell", "margins",
    "95 % band", "write",
)  # fmt: skip


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--out", "folder", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@robot_instead
@posture_kept
@click.option("--json", "as_json", is_flag=True, help="Print the summary (plan.json) to stdout.")
def command(job: Path, folder: Path, robot: str | None, keep: str | None, as_json: bool) -> None:
    """Plan JOB: write plan.json, joints.csv, report.html and native programs.

    Example: compplan plan paths/isf_cone.toml --out out
    """
    from compplan.job.job import load_job

    checked = load_job(job, robot, keep)
    carry_out(checked, folder, as_json=as_json, note=_describe_lesson(checked, f"learned_{job.stem}.csv"))


def _describe_lesson(job: Job, name: str) -> str:
    """Say that the robot's folder holds a lesson of this path; a robot that is not found says so elsewhere."""
    from compplan.robot.folder import find_robot_folder

    try:
        found = (find_robot_folder(job.robot, job.folder) / name).is_file()
    except CompplanError:
        return ""
    told = "parts of this path were measured; only the program of compplan learn uses what they left over"
    return f"{name} in the robot folder: {told}" if found else ""


def carry_out(job: Job, folder: Path, *, as_json: bool, note: str = "") -> None:
    """Plan a job, write what came of it, and say so.

    Args:
        job: The job.
        folder: Folder to write to.
        as_json: Whether plan.json is printed in place of sentences.
        note: What the plan's notes begin with, "" for nothing.

    Raises:
        InfeasibleError: If the plan is not what was asked for; it is written all the same.

    """
    from compplan.job.operations import split_job

    jobs = split_job(job)
    if len(jobs) > 1:
        carry_out_all(jobs, folder, as_json=as_json, note=note)
    else:
        _carry_out_one(jobs[0], folder, as_json=as_json, note=note)


def _carry_out_one(job: Job, folder: Path, *, as_json: bool, note: str = "") -> None:
    """Plan a job of one tool, as `carry_out` says."""
    from compplan.cli.commands.progress import show_progress
    from compplan.planning.plan import plan_job
    from compplan.planning.result import replace_said
    from compplan.reporting.plan_text import format_plan
    from compplan.reporting.writers.plan import deliver_plan, note_programs, summarise_plan

    with show_progress(STAGES) as announce:
        plan = note_programs(plan_job(job, progress=announce))
        plan = replace_said(plan, (note, *plan.notes)) if note else plan
        announce("95 % band: where the true tip is")
        _ = plan.promise, plan.mismatch
        announce("write: programs, joints.csv, report.html")
        plan, files = deliver_plan(plan, folder)
    if as_json:
        click.echo(dump_json(summarise_plan(plan), indent=2))
    else:
        for line in format_plan(plan, folder, files):
            click.echo(line)
    if plan.status != "solved":
        failing = sorted(plan.command.failures)
        limits = sorted(set(plan.command.failures.values()))
        marked = "infeasible" if plan.status == "infeasible" else "not_confirmed"
        message = f"{plan.explain_failures()}; the best compromise is written, marked {marked}"
        raise InfeasibleError(message, waypoints=failing, limits=limits)
