"""CAM files and programs of controllers: `convert`, `execute`, `trace`, `calibration`."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from compplan.cli.options import (
    FOLDER,
    INPUT,
    TABLE,
    CommandResult,
    Number,
    keep_stated,
    make_command,
    out_folder,
    out_table,
    robot_option,
    take_cam_options,
)
from compplan.cli.terminal import show_progress
from compplan.errors import InputError
from compplan.io.provenance import describe_origin
from compplan.io.tables import write_text
from compplan.io.tomlfile import check_table, read_named_table
from compplan.io.transaction import replace_folder
from compplan.robot import load_robot
from compplan.toolpath.readers import READERS, CamFacts, read_cam, refuse_idle
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.toolpath import check_toolpath, resample_toolpath, write_toolpath

#: File extensions of a toolpath table.
TABLES = (".csv", ".txt", "")


@make_command(
    click.argument("camfile", type=INPUT),
    click.option("--out", type=TABLE, required=True, help="The toolpath table to write (CSV)."),
    click.option("--report", type=FOLDER, metavar="DIR",
                 help="Folder for report.html: the path by tool, its box, what was assumed."),
    click.option("--max-step-mm", type=Number(0.0, 1e6, min_open=True), help="Divide cutting moves that are longer."),
    take_cam_options,
    click.option("--cam", "cam_file", metavar="FILE", help="TOML file as [cam] of a job; options replace its keys."),
    click.option("--cycles", type=click.Choice(["skip", "expand"]), help="Whether drilling cycles are cut."),
    click.option("--tool-direction", type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
                 help="Axis of the TCP frame that points out of the tool."),
    click.option("--strict", is_flag=True, default=None, help="Refuse a file that can only be read with notes."),
    epilog=f"Languages that are read: {', '.join(READERS)}.",
)  # fmt: skip
def run_convert(
    camfile: Path, out: Path, report: Path | None, max_step_mm: float | None, cam_file: str | None, **options: Any
) -> CommandResult:
    """Convert CAMFILE (a CAM file of a known language) to a toolpath table, and report what was read.

    Example: compplan convert part.nc --out part.csv
    """
    from compplan.reporting.convert import render_toolpath

    if out.suffix.lower() not in TABLES:
        raise InputError(f"--out is {str(out)!r}, expected the name of a table that ends in .csv")
    stated = read_named_table(cam_file, "cam")[0] if cam_file is not None else {}
    table = check_table(CamTable, {**stated, **keep_stated(**options)}, file=cam_file)
    cam = read_cam(camfile, table)
    toolpath = refuse_idle(cam)
    if max_step_mm is not None:
        toolpath = resample_toolpath(toolpath, max_step_mm * 1e-3)
    write_toolpath(check_toolpath(toolpath, need_feed=False), out)
    facts = replace(cam.facts, waypoints=len(toolpath))
    if still := int(((toolpath.feed == 0.0) & ~toolpath.rapid)[1:].sum()):
        note = f"{still} cutting moves have no feed: state it with --feed"
        facts = replace(facts, notes=(*facts.notes, note))
    page = "" if report is None else f", {report / 'report.html'}"
    if report is not None:
        with replace_folder(report, "convert") as part:
            write_text(part / "report.html", render_toolpath(toolpath, facts))
    return CommandResult(
        {"schema": 1, "out": str(out), **asdict(facts)}, [*_describe_facts(facts), f"wrote {out}{page}"]
    )


def _describe_facts(facts: CamFacts) -> list[str]:
    """Return the facts about a CAM file as lines of text."""
    lines = [
        f"{facts.file}: {facts.kind}, {facts.lines} lines, unit {facts.unit}",
        f"cutting moves   {facts.cutting_moves}, {facts.cutting_length_mm:.3f} mm",
        f"arcs            {facts.arcs} ({facts.full_circles} full circles, {facts.helical_arcs} helical), "
        f"{facts.arc_length_mm:.3f} mm",
        f"rapid moves     {facts.rapid_moves}",
        f"waypoints       {facts.waypoints}",
    ]
    if facts.box_mm is not None:
        sides = zip("xyz", *facts.box_mm, strict=True)
        lines.append("box [mm]        " + ", ".join(f"{name} {low:.3f} to {high:.3f}" for name, low, high in sides))
    if facts.cycles:
        lines.append(f"drilled holes   {facts.cycles}")
    if facts.events:
        lines.append(f"events          {facts.events} (spindle, coolant, ..: not in the CSV)")
    return lines + [f"note: {note}" for note in facts.notes]


@make_command(
    click.argument("program", type=INPUT),
    robot_option("Robot folder or name; [motion] of its controller.toml is executed."), out_table,
)  # fmt: skip
def run_execute(program: Path, robot_name: str, out: Path) -> CommandResult:
    """Simulate how the controller executes PROGRAM: blends, speed, lag of the drives.

    Example: compplan execute program.csv --robot ur10 --out executed.csv
    """
    from compplan.controllers.motion.run import execute_program, write_executed

    if program.suffix.lower() != ".csv":
        raise InputError('is not a program table; execute reads the CSV written with programs = ["csv"]', file=program)
    robot = load_robot(robot_name)
    executed = execute_program(program, robot)
    write_executed(executed, robot, out)
    rate = np.linalg.norm(np.diff(executed.position, axis=0), axis=1) / executed.motion.cycle
    summary = {
        "schema": 1, "rows": len(executed.time), "duration_s": float(executed.time[-1]),
        "fastest_mm_s": 1e3 * float(rate.max(initial=0.0)), "source": executed.motion.source,
        "notes": list(executed.notes), "made_by": describe_origin(),
    }  # fmt: skip
    speed = f"tip at most {summary['fastest_mm_s']:.4g} mm/s"
    head = f"{summary['rows']} rows in {summary['duration_s']:.3f} s, {speed}"
    return CommandResult(summary, [head, *(f"note: {note}" for note in executed.notes), f"wrote {out}"])


@make_command(
    click.argument("logs", nargs=-1, required=True, type=INPUT, metavar="LOG..."),
    click.option("--program", "programs", multiple=True, required=True, type=INPUT,
                 help="Program of a log: one per log, in order, or one for all."),
    robot_option(), out_folder,
)  # fmt: skip
def run_trace(logs: tuple[Path, ...], programs: tuple[Path, ...], robot_name: str, folder: Path) -> CommandResult:
    """Compare each LOG of executed joints with its program: write trace.json, robot/ and report.html.

    Example: compplan trace run1.csv run2.csv --program p1.csv --program p2.csv --robot ur10 --out out
    """
    from compplan.reporting.trace import open_trace, trace_logs, write_trace

    robot = load_robot(robot_name)
    with show_progress() as announce:
        announce("trace: logs beside their programs")
        traced = trace_logs(logs, programs, robot)
        announce("write: trace.json, robot, report.html")
        summary = write_trace(traced, folder)
    lines = open_trace(summary, traced.found).format(folder, ["trace.json", "report.html", "robot"], summary["notes"])
    return CommandResult(summary, lines)


@make_command(
    click.argument("direction", type=click.Choice(["read"]), metavar="read", expose_value=False),
    click.argument("source", type=INPUT),
    robot_option("The type as it ships, which the controller's numbers count from."),
    click.option("--out", required=True, type=FOLDER, help="Folder to write."),
)  # fmt: skip
def run_calibration(source: Path, robot_name: str, out: Path) -> CommandResult:
    """Read a UR controller's calibration, the file SOURCE, into DIR/robot.

    Example: compplan calibration read calibration.conf --robot ur10e --out out
    """
    from compplan.reporting.writers.robot_folder import write_calibrated

    nominal = load_robot(robot_name)
    summary = write_calibrated(source, nominal, out)
    lines = [f"{nominal.name} with the geometry of {source} ({summary['format']})", f"wrote {out / 'robot'}"]
    return CommandResult(summary, lines)
