"""`compplan plan`: from a job to a corrected robot program."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from compplan.cli.options import Answer, make_job_command, out_folder, posture_kept, robot_instead
from compplan.cli.terminal import show_progress
from compplan.errors import CompplanError, InfeasibleError

if TYPE_CHECKING:
    from compplan.job.job import Job
    from compplan.planning.result import Plan

#: What a plan goes through, as it says it.
STAGES = (
    "robot and toolpath", "posture", "sampling", "compensation", "force and feed", "virtual cell", "margins",
    "95 % band", "write",
)  # fmt: skip


@make_job_command(out_folder, robot_instead, posture_kept, several=True)
def command(job: Job, folder: Path) -> Answer:
    """Plan JOB: write plan.json, joints.csv, report.html and native programs.

    Example: compplan plan paths/isf_cone.toml --out out
    """
    from compplan.robot.folder import find_robot_folder

    name, note = f"learned_{job.file.stem}.csv", ""
    try:
        if (find_robot_folder(job.robot, job.folder) / name).is_file():
            note = "parts of this path were measured; only the program of compplan learn uses what they left over"
            note = f"{name} in the robot folder: {note}"
    except CompplanError:  # a robot that is not found is refused by the plan
        pass
    return carry_out(job, folder, note)


def carry_out(job: Job, folder: Path, note: str = "") -> Answer:
    """Plan a job, a plan for each tool that it calls, and write what came of it; `note` is added to the first."""
    from compplan.job.operations import split_job
    from compplan.planning.plan import plan_job
    from compplan.planning.result import replace_said, summarise_plan
    from compplan.reporting.plan_summary import format_plan
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    jobs, plans = split_job(job), list["Plan"]()
    with show_progress(STAGES) as announce:
        for one in jobs:
            plan = note_programs(plan_job(one, progress=announce))
            plans.append(replace_said(plan, (note, *plan.notes)) if note and not plans else plan)
            announce("95 % band: where the true tip is")
            _ = plans[-1].promise, plans[-1].mismatch
        if len(jobs) == 1:
            announce("write: programs, joints.csv, report.html")
            plan, files = deliver_plan(plans[0], folder)
    if len(jobs) == 1:
        return Answer(summarise_plan(plan), format_plan(plan, folder, files), _explain_failures([plan]))
    return _deliver_all(plans, folder, jobs[0].data.get("name", "").rpartition(",")[0] or jobs[0].file.stem)


def _deliver_all(plans: Sequence[Plan], folder: Path, name: str) -> Answer:
    """Write the plans of several tools together."""
    from compplan.planning.operations import summarise_operations
    from compplan.reporting.operations import deliver_operations, describe_operations, describe_order
    from compplan.reporting.plan_summary import count_notes, format_stops

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
    return Answer(summary, lines, _explain_failures(read))


def _explain_failures(plans: Sequence[Plan]) -> InfeasibleError | None:
    """Return which waypoints and limits stop plans that are not solved; None where all are."""
    from compplan.planning.operations import worst_status

    failing = [plan for plan in plans if plan.status != "solved"]
    if not failing:
        return None
    labels = [f"{plan.job.label}: " if plan.job is not None and len(plans) > 1 else "" for plan in failing]
    why = "; ".join(f"{label}{plan.explain_failures()}" for label, plan in zip(labels, failing, strict=True))
    waypoints = sorted(failing[0].command.failures) if len(plans) == 1 else []
    limits = sorted({limit for plan in failing for limit in plan.command.failures.values()})
    message = f"{why}; the best compromise is written, marked {worst_status(plans)}"
    return InfeasibleError(message, waypoints=waypoints, limits=limits)
