"""`compplan place`: where the part should stand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from compplan.cli.options import Answer, make_job_command, out_folder
from compplan.cli.terminal import show_progress

if TYPE_CHECKING:
    from compplan.job.job import Job


@make_job_command(out_folder)
def command(job: Job, folder: Path) -> Answer:
    """Search where the part of JOB should stand: write place.json and report.html.

    Example: compplan place paths/circle_500mm.toml --out out
    """
    from compplan.planning.plan import job_robot
    from compplan.planning.posture.place import place_part
    from compplan.reporting.place import write_placement
    from compplan.uncertainty.posture_errors import posture_errors

    with show_progress() as announce:
        robot = job_robot(job)
        result = place_part(job, robot, announce, posture_errors(job, robot))
    summary = write_placement(result, job, folder)
    there, here = summary["sensitivity_mm"]["p95"], summary["sensitivity_here_mm"]
    beside = "not to be followed" if here is None else f"{here['p95']:.4g} mm"
    raised = f"# counted from the robot base, which is raised by {summary['base_height_mm']:g} mm"
    return Answer(summary, [
        f"remaining deviation (95 %) there {there:.4g} mm, at the job's place {beside}",
        "[part]", f"position_mm = {summary['part']['position_mm']}",
        f"rotation_deg = {summary['part']['rotation_deg']}", *([raised] if summary["base_height_mm"] else []),
        f"wrote place.json, report.html to {folder}", "next: put [part] into the job, and plan",
    ])  # fmt: skip
