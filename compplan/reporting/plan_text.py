"""The terminal's lines about a plan: six of at most 100 characters, then each note that must be settled, whole."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from compplan.io.notes import list_remarks, list_stops
from compplan.io.quantities import format_mm
from compplan.planning.tolerance_verdict import KEEPS, NOT_KNOWN, describe_tolerance
from compplan.reporting.plan_summary import NO_PROGRAM, NO_PROGRAM_NAMES

if TYPE_CHECKING:
    from compplan.planning.result import Plan

#: Greatest width of a line on the terminal. [characters]
WIDTH = 100
#: The next step of a plan that is not solved.
NEXT = {
    "not_confirmed": "do not run the programs; change what is named below in the job or the robot folder",
    "infeasible": "compplan place JOB finds a place of the part within reach",
}
FIRST_RUN = "run without a part at reduced override, then cut and measure one part"


def format_plan(plan: Plan, folder: Path, files: Sequence[Path]) -> list[str]:
    """Return what the terminal says of a plan that was written to a folder."""
    cause = f"largest cause: {plan.verdict.largest_cause}"
    step = NEXT.get(plan.status) or plan.verdict.change or FIRST_RUN
    if plan.job is not None:
        step = step.replace(" JOB", f" {plan.job.file.name}")
    step = f"{step[0].lower()}{step[1:]}"
    return [
        _format_verdict(plan),
        _format_sizes(plan),
        *wrap(cause, f"next: {step}"),
        format_files(folder, files, count_notes(plan.notes)),
        _format_assumptions(plan),
        *format_stops([*plan.reasons, *plan.notes]),
    ]


def format_stops(notes: Iterable[str]) -> list[str]:
    """Return the notes that must be settled, whole."""
    return [f"before the machine moves: {stop}" for stop in list_stops(list(notes))]


def count_notes(notes: Iterable[str]) -> str:
    """Return how many other notes are in the report, in parentheses; "" for none."""
    count = len(list_remarks(list(notes)))
    return f" ({count} note{'s' * (count > 1)})" if count else ""


def format_files(folder: Path, files: Sequence[Path], notes: str = "") -> str:
    """Return which files were written, the programs by their number; `notes` follows the report."""
    names = [file.name for file in files]
    shown: list[str] = [name for name in ("report.html", "plan.json", "joints.csv") if name in names]
    programs = [file for file in files if file.suffix not in NO_PROGRAM and file.name not in NO_PROGRAM_NAMES]
    count = len([file for file in programs if file.name not in shown])
    shown = [f"{name}{notes}" if name == "report.html" else name for name in shown]
    shown += [f"{count} program file{'s' * (count > 1)}"] if count else []
    return f"wrote {', '.join(shown)} to {folder}"


def wrap(first: str, second: str) -> list[str]:
    """Join two phrases on one line where they fit, else on two; a longer one is cut between words."""
    joined = f"{first}; {second}"
    if len(joined) <= WIDTH:
        return [joined]
    return [text if len(text) <= WIDTH else textwrap.shorten(text, WIDTH, placeholder=" ...")
            for text in (first, second)]  # fmt: skip


def _format_verdict(plan: Plan) -> str:
    """Return the verdict on one line; what it does not say is in the lines below, or on stderr."""
    verdict, tolerance = plan.verdict, describe_tolerance(plan.task)
    tolerance = tolerance if len(tolerance) < WIDTH // 3 else "its tolerances"
    if plan.status == "infeasible":
        return f"Do not start: no solution. Waypoints out of reach or beyond a limit: {len(plan.command.failures)}."
    if plan.status == "not_confirmed":
        return "Do not start: the independent check does not confirm the plan, see below."
    if verdict.word == NOT_KNOWN or verdict.band is None:
        return f"Not known whether it keeps {tolerance}."
    band = format_mm(verdict.band)
    if verdict.word == KEEPS:
        return f"Keeps {tolerance}: the tip stays within {band} of the path along the whole cut (95 %)."
    return f"May not keep {tolerance}: the tip may be up to {band} off the path (95 %)."


def _format_sizes(plan: Plan) -> str:
    """Return deviation and band, each without and with correction."""
    before, after = (format_mm(run.max_deviation) for run in (plan.before, plan.after))
    sizes = f"deviation {before} -> {after} as modelled"
    band = plan.promise
    if band is None:
        return f"{sizes}; no 95 % band is stated"
    without = "" if band.before is None else f"{format_mm(band.before[1])} -> "
    return f"{sizes}; 95 % band {without}{format_mm(band.whole)}"


def _format_assumptions(plan: Plan) -> str:
    """Return what is assumed: the robot model, the force, and how the part frame was found."""
    basis = plan.verdict.basis or f"robot model: {plan.robot.grade}"
    if plan.job is None:
        return basis
    return (
        f"{basis}; part frame {'touched off with this robot' if plan.job.touched_off else 'absolute in the robot base'}"
    )
