"""From a comparison to its page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from compplan.report.compare_page import CompareView, write_comparison
from compplan.report.plan_report import list_assumptions

if TYPE_CHECKING:
    from compplan.plan.compare import Comparison


def write_compare_report(comparison: Comparison, out: str | Path) -> Path:
    """Write the page of a comparison: report.html in a folder.

    Args:
        comparison: The comparison.
        out: The folder.

    Returns:
        The file written.

    Raises:
        InputError: If the folder cannot be written.
    """
    file = Path(out) / "report.html"
    write_comparison(view_comparison(comparison), file)
    return file


def view_comparison(comparison: Comparison) -> CompareView:
    """Collect what the page of a comparison shows."""
    task = comparison.task
    facts = [] if comparison.job is None else [("job", str(comparison.job.file))]
    facts.append(("toolpath", task.nominal.source or "given in memory"))
    others = [cell.name for cell in comparison.cells[1:]]
    assumptions = list_assumptions(comparison.job)
    if others:
        assumptions.append(f"cells: {', '.join(others)}: what the model may be wrong by is assumed, not measured")
    told = comparison.drawn
    stopped = {name: command for name, command in comparison.commands.items() if command.status == "infeasible"}
    return CompareView(
        title=comparison.name,
        robot=task.robot,
        nominal=task.position,
        time=np.concatenate([[0.0], np.cumsum(task.step_time)]),
        cut=task.compensated,
        deviation={
            cell.name: {name: run.distance for name, run in comparison.evaluations[cell.name].items()}
            for cell in comparison.cells
        },
        tolerance=task.tolerance,
        drawn={name: (told.median(name), told.most(name)) for name in told.rms} if told else {},
        drawn_from=told.source if told else "",
        judge=comparison.judge,
        facts=facts,
        notes=[
            f"{name} is infeasible: {len(command.failures)} waypoints fail "
            f"({', '.join(sorted(set(command.failures.values())))}); its best compromise is shown."
            for name, command in stopped.items()
        ],
        assumptions=assumptions,
    )
