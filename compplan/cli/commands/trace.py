"""`compplan trace`: what a controller made of programs, identified from logs."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.options import INPUT, Answer, make_command, out_folder, robot_option
from compplan.cli.terminal import show_progress


@make_command(
    click.argument("logs", nargs=-1, required=True, type=INPUT, metavar="LOG..."),
    click.option("--program", "programs", multiple=True, required=True, type=INPUT,
                 help="Program of a log: one a log, in order, or one for all."),
    robot_option(), out_folder,
)  # fmt: skip
def command(logs: tuple[Path, ...], programs: tuple[Path, ...], robot_name: str, folder: Path) -> Answer:
    """Hold each LOG of executed joints against its program: write trace.json, robot/ and report.html.

    Example: compplan trace run1.csv run2.csv --program p1.csv --program p2.csv --robot ur10 --out out
    """
    from compplan.reporting.trace import trace_logs, write_trace
    from compplan.robot import load_robot

    robot = load_robot(robot_name)
    with show_progress() as announce:
        announce("trace: logs beside their programs")
        traced = trace_logs(logs, programs, robot)
        announce("write: trace.json, robot, report.html")
        summary = write_trace(traced, folder)
    without, left = summary["left_without_model_mm"], summary["left_mm"]
    parts = ", ".join(f"{name.replace('_', ' ')} {100 * share:.0f} %" for name, share in summary["parts"].items())
    return Answer(summary, [
        f"across the programmed path: {without['median']:.3g} mm median, {without['p95']:.3g} mm 95 %",
        f"across the executed path:   {left['median']:.3g} mm median, {left['p95']:.3g} mm 95 %, "
        f"rows not fitted to ({summary['model']})",
        f"causes: {parts}", *(f"note: {note}" for note in summary["notes"]),
        f"wrote trace.json, robot, report.html to {folder}",
    ])  # fmt: skip
