"""`compplan place`: where the part should stand."""

from __future__ import annotations

import json
from pathlib import Path

import click


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--out", "folder", type=click.Path(path_type=Path), required=True, help="Folder to write to.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary (place.json) to stdout.")
def command(job: Path, folder: Path, as_json: bool) -> None:
    """Search where the part of JOB should stand: write place.json, place_map.png and posture_map.png."""
    from compplan.commands.progress import show_progress
    from compplan.files.tables import replace_file, write_text
    from compplan.job.job import load_job
    from compplan.plan.plan import job_robot
    from compplan.posture.place import describe_placement, place_part
    from compplan.report.place_map import draw_place_map
    from compplan.report.posture_map import draw_map_picture

    checked = load_job(job)
    with show_progress() as announce:
        result = place_part(checked, job_robot(checked), announce)
    summary = describe_placement(result, checked)
    pictures = {"place_map.png": draw_place_map(result), "posture_map.png": draw_map_picture(result.stance.map)}
    for name, png in pictures.items():
        with replace_file(folder / name) as part:
            part.write_bytes(png)
    write_text(folder / "place.json", json.dumps(summary, indent=1) + "\n")
    if as_json:
        click.echo(json.dumps(summary))
        return
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    click.echo(f"remaining deviation (95 %) there {there:.4g} mm, at the job's place "
               + ("not to be followed" if here is None else f"{here['p95']:.4g} mm"))  # fmt: skip
    click.echo("[part]")
    click.echo(f"position_mm = {summary['part']['position_mm']}")
    click.echo(f"rotation_deg = {summary['part']['rotation_deg']}")
    if summary["base_height_mm"]:
        click.echo(f"# counted from the robot base, which is raised by {summary['base_height_mm']:g} mm")
    click.echo(f"wrote place.json, place_map.png, posture_map.png to {folder}")
