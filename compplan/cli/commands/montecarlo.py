"""`compplan montecarlo`: strategies against each other under uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from compplan.cli.options import Answer, make_job_command, out_folder, split_names
from compplan.cli.terminal import format_table, show_progress
from compplan.errors import InputError
from compplan.job.names import ONLINE, STRATEGIES

if TYPE_CHECKING:
    from compplan.job.job import Job


@make_job_command(
    click.option("--samples", type=click.IntRange(2, 10_000_000), default=1000, show_default=True,
                 help="Number of samples."),
    click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="Seed of everything."),
    out_folder,
    click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine; default: one a core."),
    click.option("--scheduler", help="Address of a Dask scheduler (tcp://HOST:PORT) whose workers compute."),
    click.option("--strategies", help="Names of the strategies, with commas; default: all that the robot can carry out "
                 f"of {', '.join((*STRATEGIES, *ONLINE))}."),
    click.option("--replicates", type=click.IntRange(2, 1024), default=8, show_default=True,
                 help="Independent replicates."),
    click.option("--waypoints", type=click.IntRange(2, 5_000_000), default=2500, show_default=True,
                 help="A longer path is thinned evenly to this many waypoints."),
    click.option("--no-sensitivity", is_flag=True, help="Leave out the sensitivity analysis."),
    click.option("--discard", is_flag=True, help="Take away finished samples of another study in OUT first."),
)  # fmt: skip
def command(
    job: Job, folder: Path, workers: int | None, scheduler: str | None, strategies: str | None, waypoints: int,
    no_sensitivity: bool, discard: bool, **design: Any,
) -> Answer:  # fmt: skip
    """Let strategies cut JOB in many uncertain cells: write montecarlo.json, report.html and the samples.

    Samples are kept in OUT/samples: an interrupted study goes on where it stopped when it is run again.

    Example: compplan montecarlo paths/isf_cone.toml --samples 200 --seed 1 --out out
    """
    from compplan.io.transaction import lock_folder
    from compplan.reporting.montecarlo import write_study
    from compplan.studies.job_study import study_job
    from compplan.studies.runner import Settings
    from compplan.studies.workers import Workers

    if workers and scheduler:
        raise InputError("--workers and --scheduler are both given, choose one")
    names = list(split_names(strategies))
    if strategies is not None and (not names or len(set(names)) < len(names)):
        raise InputError(f"--strategies is {strategies!r}, expected names with commas, each once")
    with lock_folder(folder), show_progress() as announce:
        study = study_job(
            job, Settings(**design), folder, strategies=names, most_waypoints=waypoints, sensitivity=not no_sensitivity,
            discard=discard, workforce=Workers(workers, scheduler), announce=announce, progress=announce.count,
        )  # fmt: skip
        announce("report")
        files = write_study(study, folder)
    wrote = f"wrote {', '.join(str(path.relative_to(folder)) for path in files)} to {folder}"
    return Answer(study.summary, [*_describe_study(study.summary), wrote])


def _describe_study(summary: Mapping[str, Any]) -> list[str]:
    """Return rms and greatest deviation of every strategy."""
    rows = []
    for name, figures in summary["strategies"].items():
        rms, ends = figures["rms_mm"], figures["rms_mm"]["ci95"]
        share = f"{100 * figures['within_tolerance']:.3g} %"
        numbers = [f"{value:.4g}" for value in (rms["mean"], rms["p95"], figures["max_mm"]["p95"])]
        rows.append([name, numbers[0], f"{ends[0]:.4g} to {ends[1]:.4g}", *numbers[1:], share])
    columns = ["strategy", "rms, mean", "95 % interval", "rms, 95 %", "greatest, 95 %", "parts within tolerance"]
    title = f"{summary['name']}: deviation in mm over {summary['samples']} samples"
    lines, most = format_table(rows, columns, title, 110), summary["waypoints_of_path"]
    if summary["waypoints"] < most:
        lines.append(f"path thinned from {most} to {summary['waypoints']} waypoints")
    grade = summary["robot_grade"]
    return [*lines, f"robot model: {grade}; uncertainties as in the report, assumed where the job states none"]
