"""`compplan place`: where the part should stand."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.options import INPUT, json_summary, out_folder
from compplan.cli.terminal import show, show_progress


@click.command()
@click.argument("job", type=INPUT)
@out_folder
@json_summary
def command(job: Path, folder: Path, as_json: bool) -> None:
    """Search where the part of JOB should stand: write place.json and report.html.

    Example: compplan place paths/circle_500mm.toml --out out
    """
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
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    beside = "not to be followed" if here is None else f"{here['p95']:.4g} mm"
    lines = [
        f"remaining deviation (95 %) there {there:.4g} mm, at the job's place {beside}",
        "[part]", f"position_mm = {summary['part']['position_mm']}",
        f"rotation_deg = {summary['part']['rotation_deg']}",
        f"wrote place.json, report.html to {folder}", "next: put [part] into the job, and plan",
    ]  # fmt: skip
    show(summary, as_json, lines)
