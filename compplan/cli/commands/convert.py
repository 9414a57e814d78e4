"""`compplan convert`: a CAM file becomes a toolpath table."""

from __future__ import annotations

from dataclasses import asdict, replace
from math import inf
from pathlib import Path
from typing import Any

import click

from compplan.cli.options import FOLDER, INPUT, TABLE, Answer, keep_stated, make_command, take_cam_options
from compplan.errors import InputError
from compplan.io.tables import write_text
from compplan.io.tomlfile import check_table, read_named_table
from compplan.io.transaction import replace_folder
from compplan.toolpath.readers import READERS, CamFacts, read_cam, refuse_idle
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.toolpath import check_toolpath, resample_toolpath, write_toolpath

#: Endings of a toolpath table.
TABLES = (".csv", ".txt", "")


@make_command(
    click.argument("camfile", type=INPUT),
    click.option("--out", type=TABLE, required=True, help="The toolpath table to write (CSV)."),
    click.option("--report", type=FOLDER, metavar="DIR",
                 help="Folder for report.html: the path by tool, its box, what was refused or assumed."),
    click.option("--chord-tolerance-mm", type=float, help="Greatest distance between an arc and its chords (0.001)."),
    click.option("--max-step-mm", type=float, help="Divide cutting moves that are longer."),
    click.option("--arc-centres", type=click.Choice(["incremental", "absolute", "reversed"]),
                 help="How I J K count in G-code."),
    click.option("--circle-sense", type=click.Choice(["auto", "right_hand", "left_hand"]),
                 help="Sense of an APT CIRCLE."),
    take_cam_options,
    click.option("--cam", "cam_file", metavar="FILE", help="TOML file as [cam] of a job; options here come before it."),
    click.option("--cycles", type=click.Choice(["skip", "expand"]), help="Whether drilling cycles are cut."),
    click.option("--tilt-angles", type=click.Choice(["spatial"]), help="What cycle 19 (Heidenhain) states."),
    click.option("--tool-direction", type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
                 help="Where the TCP frame points out."),
    click.option("--strict", is_flag=True, default=None, help="Refuse a file that is read with any note."),
    epilog=f"Languages that are read: {', '.join(READERS)}.",
)  # fmt: skip
def command(
    camfile: Path, out: Path, report: Path | None, max_step_mm: float | None, cam_file: str | None, **options: Any
) -> Answer:
    """Convert CAMFILE (a CAM file of a known language) to a toolpath table, and say what was read.

    Example: compplan convert part.nc --out part.csv
    """
    from compplan.reporting.convert import render_refusal, render_toolpath

    if out.suffix.lower() not in TABLES:
        raise InputError(f"--out is {str(out)!r}, expected the name of a table that ends in .csv")
    stated = read_named_table(cam_file, "cam")[0] if cam_file is not None else {}
    table = check_table(CamTable, {**stated, **keep_stated(**options)}, file=cam_file)
    try:
        cam = read_cam(camfile, table)
        toolpath = refuse_idle(cam)
    except InputError as error:
        _write_page(report, render_refusal(camfile, error))
        raise
    if max_step_mm is not None:
        if not 0.0 < max_step_mm < inf:
            raise InputError(f"--max-step-mm is {max_step_mm:g}, expected a finite number of mm, more than 0")
        toolpath = resample_toolpath(toolpath, max_step_mm * 1e-3)
    write_toolpath(check_toolpath(toolpath, need_feed=False), out)
    facts = replace(cam.facts, waypoints=len(toolpath))
    if still := int(((toolpath.feed == 0.0) & ~toolpath.rapid)[1:].sum()):
        note = f"{still} cutting moves have no feed: state it with --feed"
        facts = replace(facts, notes=(*facts.notes, note))
    page = _write_page(report, render_toolpath(toolpath, facts) if report is not None else "")
    return Answer({"schema": 1, "out": str(out), **asdict(facts)}, [*_describe_facts(facts), f"wrote {out}{page}"])


def _write_page(folder: Path | None, html: str) -> str:
    """Write the page, where a folder is given, and return how the terminal names it."""
    if folder is None:
        return ""
    with replace_folder(folder, "convert") as part:
        write_text(part / "report.html", html)
    return f", {folder / 'report.html'}"


def _describe_facts(facts: CamFacts) -> list[str]:
    """Return the facts about a CAM file as lines for people."""
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
        lines.append(f"events          {facts.events} (spindle, coolant, ..: plan and post carry them)")
    return lines + [f"note: {note}" for note in facts.notes]
