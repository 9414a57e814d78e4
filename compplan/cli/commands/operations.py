"""What `compplan plan` and `compplan post` do with a job of several tools: a plan and programs for each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from compplan.errors import InfeasibleError
from compplan.io.tables import dump_json

if TYPE_CHECKING:
    from compplan.job.job import Job
    from compplan.planning.result import Plan


def carry_out_all(jobs: Sequence[Job], folder: Path, *, as_json: bool, note: str = "") -> None:
    """Plan every operation of a job, write them together, and say so.

    Args:
        jobs: One job an operation.
        folder: Folder to write to.
        as_json: Whether plan.json is printed in place of sentences.
        note: What the notes begin with, "" for nothing.

    Raises:
        InfeasibleError: If a plan is not what was asked for; all are written all the same.

    """
    from compplan.cli.commands.progress import show_progress
    from compplan.planning.operations import summarise_operations
    from compplan.planning.plan import plan_job
    from compplan.planning.result import replace_said
    from compplan.reporting.operations import deliver_operations, describe_operations, describe_order
    from compplan.reporting.plan_text import format_notes
    from compplan.reporting.writers.plan import note_programs

    name = jobs[0].data.get("name", "").rpartition(",")[0] or jobs[0].file.stem
    plans: list[Plan] = []
    for job in jobs:
        with show_progress() as announce:
            announce(f"tool {job.label}")
            plan = note_programs(plan_job(job, progress=announce))
            plans.append(replace_said(plan, (note, *plan.notes)) if note and not plans else plan)
    plans, files = deliver_operations(plans, folder, name)
    summary = summarise_operations(plans, name)
    if as_json:
        click.echo(dump_json(summary, indent=2))
    else:
        click.echo(f"{name}: {describe_operations(summary)}")
        for plan in plans:
            label = "" if plan.job is None else plan.job.label
            click.echo(f"{label}: {plan.status}, {len(plan.task)} waypoints; {plan.verdict.sentence}")
        for line in format_notes(summary["notes"], folder):
            click.echo(line)
        if any(plan.job is not None and plan.job.output.programs for plan in plans):
            click.echo(describe_order(summary, files))
        click.echo(f"wrote {len(files)} files to {folder}; next: open {folder / 'report.html'}, or compplan view "
                   f"{folder / summary['tools'][0]['folder']}")  # fmt: skip
    failing = [plan for plan in plans if plan.status != "solved"]
    if failing:
        said = "; ".join(f"{'' if plan.job is None else plan.job.label}: {plan.explain_failures()}" for plan in failing)
        limits = sorted({limit for plan in failing for limit in plan.command.failures.values()})
        raise InfeasibleError(f"{said}; the best compromise is written, marked {summary['status']}", limits=limits)
