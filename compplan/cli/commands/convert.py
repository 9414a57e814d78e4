"""`compplan convert`: a CAM file becomes a toolpath table."""

from __future__ import annotations

import dataclasses
from math import inf
from pathlib import Path
from typing import Any

import click

from compplan.cli.commands.cam_options import keep_stated, take_cam_options
from compplan.cli.commands.output_paths import OUT_FOLDER, OUT_TABLE
from compplan.errors import InputError
from compplan.io.tables import dump_json, write_text
from compplan.io.tomlfile import check_table, read_named_table
from compplan.io.transaction import replace_folder
from compplan.toolpath.readers import READERS, CamFacts, read_cam, refuse_idle
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.toolpath import check_toolpath, resample_toolpath, write_toolpath

CHOICES = {
    "arc_centres": ["incremental", "absolute", "reversed"],
    "circle_sense": ["auto", "right_hand", "left_hand"],
    "tilt_angles": ["spatial"],
    "cycles": ["skip", "expand"],
    "tool_direction": ["x", "y", "z", "-x", "-y", "-z"],
}

#: Endings of a toolpath table.
TABLES = (".csv", ".txt", "")
#: The page in the folder of --report.
PAGE = "report.html"


@click.command(epilog=f"Languages that are read: {', '.join(READERS)}.")
@click.argument("camfile", type=click.Path(path_type=Path))
@click.option("--out", "out", type=OUT_TABLE, required=True, help="The toolpath table to write (CSV).")
@click.option("--report", type=OUT_FOLDER, metavar="DIR",
              help="Folder for report.html: the path by tool, its box, what was refused or assumed.")  # fmt: skip
@click.option("--chord-tolerance-mm", type=float, help="Greatest distance between an arc and its chords (0.001).")
@click.option("--max-step-mm", type=float, help="Divide cutting moves that are longer.")
@click.option("--arc-centres", type=click.Choice(CHOICES["arc_centres"]), help="How I J K count in G-code.")
@click.option("--circle-sense", type=click.Choice(CHOICES["circle_sense"]), help="Sense of an APT CIRCLE.")
@take_cam_options
@click.option("--cam", "cam_file", metavar="FILE", help="TOML file as [cam] of a job; options here come before it.")
@click.option("--cycles", type=click.Choice(CHOICES["cycles"]), help="Whether drilling cycles are cut.")
@click.option("--tilt-angles", type=click.Choice(CHOICES["tilt_angles"]), help="What cycle 19 (Heidenhain) states.")
@click.option("--tool-direction", type=click.Choice(CHOICES["tool_direction"]), help="Where the TCP frame points out.")
@click.option("--strict", is_flag=True, default=None, help="Refuse a file that is read with any note.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(
    camfile: Path, out: Path, report: Path | None, max_step_mm: float | None, as_json: bool, cam_file: str | None,
    **options: Any,
) -> None:  # fmt: skip
    """Convert CAMFILE (a CAM file of a known language) to a toolpath table, and say what was read.

    Example: compplan convert part.nc --out part.csv
    """
    if out.suffix.lower() not in TABLES:
        raise InputError(f"--out is {str(out)!r}, expected the name of a table that ends in .csv")
    stated = read_named_table(cam_file, "cam")[0] if cam_file is not None else {}
    table = check_table(CamTable, {**stated, **keep_stated(**options)}, file=cam_file)
    try:
        cam = read_cam(camfile, table)
        toolpath = refuse_idle(cam)
    except InputError as error:
        if report is not None:
            from compplan.reporting.convert import render_refusal

            with replace_folder(report, "convert") as folder:
                write_text(folder / PAGE, render_refusal(camfile, error))
        raise
    if max_step_mm is not None and not 0.0 < max_step_mm < inf:
        raise InputError(f"--max-step-mm is {max_step_mm:g}, expected a finite number of mm, more than 0")
    if max_step_mm is not None:
        toolpath = resample_toolpath(toolpath, max_step_mm * 1e-3)
    write_toolpath(check_toolpath(toolpath, need_feed=False), out)
    if still := int(((toolpath.feed == 0.0) & ~toolpath.rapid)[1:].sum()):
        note = f"{still} cutting moves have no feed: state it with --feed"
        cam = dataclasses.replace(cam, facts=dataclasses.replace(cam.facts, notes=(*cam.facts.notes, note)))
    if report is not None:
        from compplan.reporting.convert import render_toolpath

        with replace_folder(report, "convert") as folder:
            write_text(folder / PAGE, render_toolpath(toolpath, cam.facts))
    if as_json:
        facts = {**dataclasses.asdict(cam.facts), "waypoints": len(toolpath)}
        click.echo(dump_json({"schema": 1, "out": str(out), **facts}))
        return
    for line in describe_facts(dataclasses.replace(cam.facts, waypoints=len(toolpath))):
        click.echo(line)
    click.echo(f"wrote {out}" if report is None else f"wrote {out}, {report / PAGE}")


def describe_facts(facts: CamFacts) -> list[str]:
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
