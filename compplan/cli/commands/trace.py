"""`compplan trace`: what a controller made of programs, identified from logs."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.commands.options import complete_robots
from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.io.tables import dump_json


@click.command("trace")
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="LOG...")
@click.option("--program", "programs", multiple=True, required=True, type=click.Path(path_type=Path),
              help="Program of a log: one a log, in order, or one for all.")  # fmt: skip
@click.option("--robot", "robot_name", required=True, shell_complete=complete_robots,
              help="Robot folder, or name of a shipped robot.")  # fmt: skip
@click.option("--out", "folder", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary (trace.json) to stdout.")
def command(logs: tuple[Path, ...], programs: tuple[Path, ...], robot_name: str, folder: Path, as_json: bool) -> None:
    """Hold each LOG of executed joints against its program: write trace.json, robot/ and report.html.

    Example: compplan trace run1.csv run2.csv --program p1.csv --program p2.csv --robot ur10 --out out
    """
    from compplan.cli.commands.progress import show_progress
    from compplan.reporting.trace import trace_logs, write_trace
    from compplan.robot import load_robot

    robot = load_robot(robot_name)
    with show_progress() as announce:
        announce("trace: logs beside their programs")
        traced = trace_logs(logs, programs, robot)
        announce("write: trace.json, robot, report.html")
        summary = write_trace(traced, folder)
    if as_json:
        click.echo(dump_json(summary))
        return
    without, left = summary["left_without_model_mm"], summary["left_mm"]
    click.echo(f"across the programmed path: {without['median']:.3g} mm median, {without['p95']:.3g} mm 95 %")
    click.echo(f"across the executed path:   {left['median']:.3g} mm median, {left['p95']:.3g} mm 95 %, "
               f"rows not fitted to ({summary['model']})")  # fmt: skip
    parts = ", ".join(f"{name.replace('_', ' ')} {100 * share:.0f} %" for name, share in summary["parts"].items())
    click.echo(f"causes: {parts}")
    for note in summary["notes"]:
        click.echo(f"note: {note}")
    click.echo(f"wrote trace.json, robot, report.html to {folder}")
