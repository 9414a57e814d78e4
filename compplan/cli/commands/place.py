"""`compplan place`: where the part should stand."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.io.tables import dump_json


@click.command()
@click.argument("job", type=click.Path(path_type=Path))
@click.option("--out", "folder", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary (place.json) to stdout.")
def command(job: Path, folder: Path, as_json: bool) -> None:
    """Search where the part of JOB should stand: write place.json and report.html.

    Example: compplan place paths/circle_500mm.toml --out out
    """
    from compplan.cli.commands.progress import show_progress
    from compplan.job.operations import load_one_job
    from compplan.planning.plan import job_robot
    from compplan.planning.posture.place import place_part
    from compplan.reporting.place import write_placement
    from compplan.uncertainty.posture_errors import posture_errors

    checked = load_one_job(job)
    with show_progress() as announce:
        robot = job_robot(checked)
        result = place_part(checked, robot, announce, posture_errors(checked, robot))
    summary = write_placement(result, checked, folder)
    if as_json:
        click.echo(dump_json(summary))
        return
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    click.echo(f"remaining deviation (95 %) there {there:.4g} mm, at the job's place "
               + ("not to be followed" if here is None else f"{here['p95']:.4g} mm"))  # fmt: skip
    click.echo("[part]")
    click.echo(f"position_mm = {summary['part']['position_mm']}")
    click.echo(f"rotation_deg = {summary['part']['rotation_deg']}")
    if summary["base_height_mm"]:
        click.echo(f"# counted from the robot base, which is raised by {summary['base_height_mm']:g} mm")
    click.echo(f"wrote place.json, report.html to {folder}")
    click.echo("next: put [part] into the job, and plan")
