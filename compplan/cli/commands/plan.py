"""`compplan plan`: from a job to a corrected robot program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from compplan.cli.options import INPUT, json_summary, out_folder, posture_kept, robot_instead
from compplan.cli.terminal import show, show_progress
from compplan.errors import CompplanError, InfeasibleError

if TYPE_CHECKING:
    from compplan.job.job import Job
    from compplan.planning.result import Plan

#: What a plan goes through, as it says it.
STAGES = (
    "robot and toolpath", "posture", "sampling", "compensation", "force and feed", "virtual cell", "margins",
    "95 % band", "write",
)  # fmt: skip


@click.command()
@click.argument("job", type=INPUT)
@out_folder
@robot_instead
@posture_kept
@json_summary
def command(job: Path, folder: Path, robot_name: str | None, keep: str | None, as_json: bool) -> None:
    """Plan JOB: write plan.json, joints.csv, report.html and native programs.

    Example: compplan plan paths/isf_cone.toml --out out
    """
    from compplan.job.job import load_job

    checked = load_job(job, robot_name, keep)
    carry_out(checked, folder, as_json=as_json, note=_describe_lesson(checked, f"learned_{job.stem}.csv"))


def _describe_lesson(job: Job, name: str) -> str:
    """Say that the robot's folder holds a lesson of this path; a robot that is not found is refused elsewhere."""
    from compplan.robot.folder import find_robot_folder

    try:
        found = (find_robot_folder(job.robot, job.folder) / name).is_file()
    except CompplanError:
        return ""
    told = "parts of this path were measured; only the program of compplan learn uses what they left over"
    return f"{name} in the robot folder: {told}" if found else ""


def carry_out(job: Job, folder: Path, *, as_json: bool, note: str = "") -> None:
    """Plan a job, a plan for each tool that it calls, write what came of it, and say so.

    Raises:
        InfeasibleError: If a plan is not what was asked for; it is written all the same.
    """
    from compplan.job.operations import split_job
    from compplan.planning.checks import state_notes
    from compplan.planning.plan import plan_job
    from compplan.planning.result import summarise_plan
    from compplan.reporting.plan_text import format_plan
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    jobs = split_job(job)
    plans: list[Plan] = []
    with show_progress(STAGES) as announce:
        for one in jobs:
            plan = note_programs(plan_job(one, progress=announce))
            plans.append(plan.add_checks(state_notes([note]), first=True) if note and not plans else plan)
            announce("95 % band: where the true tip is")
            _ = plans[-1].promise, plans[-1].mismatch
        if len(jobs) == 1:
            announce("write: programs, joints.csv, report.html")
            plan, files = deliver_plan(plans[0], folder)
            plans = [plan]
    if len(jobs) == 1:
        show(summarise_plan(plan), as_json, format_plan(plan, folder, files))
    else:
        name = jobs[0].data.get("name", "").rpartition(",")[0] or jobs[0].file.stem
        plans = _deliver_all(plans, folder, name, as_json=as_json)
    _refuse_failures(plans)


def _deliver_all(plans: Sequence[Plan], folder: Path, name: str, *, as_json: bool) -> list[Plan]:
    """Write the plans of several tools together, say so, and return them with what their files say."""
    from compplan.planning.operations import summarise_operations
    from compplan.reporting.operations import deliver_operations, describe_operations, describe_order
    from compplan.reporting.plan_text import count_notes, format_stops

    read, files = deliver_operations(plans, folder, name)
    summary = summarise_operations(read, name)
    lines = [f"{name}: {describe_operations(summary)}"]
    for plan in read:
        label = "" if plan.job is None else plan.job.label
        lines.append(f"{label}: {plan.status}, {len(plan.task)} waypoints; {plan.verdict.sentence}")
    lines += format_stops(summary["notes"])
    if any(plan.job is not None and plan.job.output.programs for plan in read):
        lines.append(describe_order(summary, files))
    first = folder / summary["tools"][0]["folder"]
    report = f"{folder / 'report.html'}{count_notes(summary['notes'])}"
    lines.append(f"wrote {len(files)} files to {folder}; next: open {report}, or compplan view {first}")
    show(summary, as_json, lines)
    return read


def _refuse_failures(plans: Sequence[Plan]) -> None:
    """Refuse plans that are not solved, with the waypoints and limits that stop them."""
    from compplan.planning.operations import worst_status

    failing = [plan for plan in plans if plan.status != "solved"]
    if not failing:
        return
    labels = [f"{plan.job.label}: " if plan.job is not None and len(plans) > 1 else "" for plan in failing]
    said = "; ".join(f"{label}{plan.explain_failures()}" for label, plan in zip(labels, failing, strict=True))
    waypoints = sorted(failing[0].command.failures) if len(plans) == 1 else []
    limits = sorted({limit for plan in failing for limit in plan.command.failures.values()})
    message = f"{said}; the best compromise is written, marked {worst_status(plans)}"
    raise InfeasibleError(message, waypoints=waypoints, limits=limits)
