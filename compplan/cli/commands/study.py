"""Robot studies: `montecarlo` on a job, `map` over the workspace, `reproduce` for comparison with a paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from compplan.cli.options import CommandResult, Number, make_command, make_job_command, out_folder, split_names
from compplan.cli.terminal import show_progress
from compplan.errors import InputError
from compplan.job.names import ONLINE, STRATEGIES
from compplan.reproduce import PAPERS, reproduce_paper

if TYPE_CHECKING:
    from compplan.job.job import Job


@make_job_command(
    click.option("--samples", type=click.IntRange(2, 10_000_000), default=1000, show_default=True,
                 help="Number of samples."),
    click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="Random seed."),
    out_folder,
    click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine; default: one per core."),
    click.option("--scheduler", help="Address of a Dask scheduler (tcp://HOST:PORT) whose workers compute."),
    click.option("--strategies", help="Names of the strategies, with commas; default: those for this robot of "
                 f"{', '.join((*STRATEGIES, *ONLINE))}."),
    click.option("--replicates", type=click.IntRange(2, 1024), default=8, show_default=True,
                 help="Independent replicates."),
    click.option("--waypoints", type=click.IntRange(2, 5_000_000), default=2500, show_default=True,
                 help="A longer path is thinned evenly to this many waypoints."),
    click.option("--no-sensitivity", is_flag=True, help="Leave out the sensitivity analysis."),
    click.option("--discard", is_flag=True, help="Delete finished samples of another study in OUT first."),
)  # fmt: skip
def run_montecarlo(
    job: Job, folder: Path, workers: int | None, scheduler: str | None, strategies: str | None, waypoints: int,
    no_sensitivity: bool, discard: bool, **design: Any,
) -> CommandResult:  # fmt: skip
    """Simulate strategies on JOB with drawn errors of robot, force and part: write montecarlo.json, report.html.

    Samples are kept in OUT/samples: run an interrupted study again to continue it.

    Example: compplan montecarlo paths/isf_cone.toml --samples 200 --seed 1 --out out
    """
    from compplan.studies.workers import Workers, start_server

    if scheduler is None and workers != 1:
        start_server()  # loads in parallel with the imports below
    from compplan.io.transaction import lock_folder
    from compplan.reporting.montecarlo import open_study, write_study
    from compplan.reporting.provenance import explain_grade
    from compplan.studies.job_study import study_job
    from compplan.studies.runner import Settings

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
        written = write_study(study, folder)
    files = [str(path.relative_to(folder)) for path in written]
    note = f"robot model: {explain_grade(study.run.study.task.robot)}"
    return CommandResult(study.summary, open_study(study).format(folder, files, [note]))


@make_command(
    click.argument("robot"), out_folder,
    click.option("--posture", type=click.Choice(["straight", "down", "outward"]), default="down", show_default=True,
                 help="How the tool points; straight: wrist joints at zero."),
    click.option("--force", nargs=3, type=Number(-1e5, 1e5), default=(0.0, 0.0, 1000.0), show_default=True,
                 help="Force on the tool, base axes. [N]"),
    click.option("--moment", nargs=3, type=Number(-1e5, 1e5), default=(0.0, 0.0, 0.0), show_default=True,
                 help="Moment on the tool at the TCP, base axes. [Nm]"),
    click.option("--height-mm", type=Number(-1e5, 1e5), default=500.0, show_default=True,
                 help="Height of the horizontal plane."),
    click.option("--azimuth-deg", type=Number(-360.0, 360.0), default=0.0, show_default=True,
                 help="Direction of the vertical plane."),
    click.option("--points", type=click.IntRange(5, 1000), default=100, show_default=True,
                 help="Points along each side."),
)  # fmt: skip
def run_map(
    robot: str, folder: Path, posture: str, force: tuple[float, ...], moment: tuple[float, ...], height_mm: float,
    azimuth_deg: float, points: int,
) -> CommandResult:  # fmt: skip
    """Draw how far ROBOT yields: under the worst unit force and under a given wrench, over two planes.

    Example: compplan map kuka_kr270 --force 0 0 -800 --out out
    """
    from compplan.effects import robot_effects
    from compplan.reporting.map import write_map
    from compplan.reporting.maps.survey import MapSettings, map_robot
    from compplan.robot import load_robot

    settings = MapSettings(
        posture, np.array([*force, *moment]), height_mm * 1e-3, float(np.radians(azimuth_deg)), points
    )
    loaded = load_robot(robot)
    robot_effects(loaded)  # not used in maps, but a wrong file is reported here too
    with show_progress() as progress:
        progress("maps of two planes")
        result = map_robot(loaded, settings)
        progress("pictures and report")
        opening = write_map(result, folder)
    return CommandResult(result.summary(), opening.format(folder, ["map.json", "report.html"]))


@make_command(click.argument("paper", metavar="|".join(PAPERS)), out_folder)
def run_reproduce(paper: str, folder: Path) -> CommandResult:
    """Recompute the figures of a paper, and list both side by side.

    Example: compplan reproduce johra2022 --out out
    """
    from compplan.reproduce.paper import summarise_reproduction, write_reproduction

    with show_progress() as progress:
        progress(f"figures of {paper}")
        result = reproduce_paper(paper)
        progress("report")
        write_reproduction(result, folder)
    summary, lines = summarise_reproduction(result), []
    for row in result.rows:
        ours = f"{row.ours:.4g}" if isinstance(row.ours, float) else row.ours or "none"
        unit = f" {row.unit}" if row.unit and row.ours is not None else ""
        lines.append(f"{row.quantity}: paper {row.paper}, ours {ours}{unit}: {row.verdict}")
    counts = ", ".join(f"{count} {verdict}" for verdict, count in summary["verdicts"].items())
    return CommandResult(summary, [*lines, counts, f"wrote {folder / 'reproduction.json'}, {folder / 'report.html'}"])
