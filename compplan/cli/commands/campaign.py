"""`compplan campaign`: the measurements that narrow a path's 95 % band most."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from compplan.cli.options import INPUT, Answer, make_job_command, out_folder, robot_instead
from compplan.cli.terminal import show_progress
from compplan.errors import InputError
from compplan.io.parsing import LEAST_SIGMA_MM

if TYPE_CHECKING:
    from compplan.job.job import Job


@make_job_command(
    click.option("--poses", "count", type=click.IntRange(1, 200), required=True, help="How many poses to measure."),
    out_folder, robot_instead,
    click.option("--log", "log", type=INPUT, help="What has been measured already."),
    click.option("--weights-kg", "weights", default="0", show_default=True, metavar="KG,KG",
                 help="Weights that can hang at the tool; 0: none."),
    click.option("--pull-N", "pull", type=click.FloatRange(0.0, 1e5), default=0.0, show_default=True,
                 help="Force with which the tool can be pulled sideways, along x or y of the base."),
    click.option("--sigma-mm", "sigma", type=click.FloatRange(LEAST_SIGMA_MM, 10.0), default=0.03, show_default=True,
                 help="Standard deviation of the instrument, per axis."),
    click.option("--register", metavar="FRAMES",
                 help="Frames that are unknown: base, tool, base,tool (of a tracker if left out) or none."),
    click.option("--for", "purpose", type=click.Choice(["path", "calibration"]), default="path", show_default=True,
                 help="Narrow the band on JOB's path, or serve a calibration of an arm that is hardly known."),
    click.option("--with", "instrument", default="tracker", show_default=True,
                 type=click.Choice(["tracker", "sockets", "gauge", "ball_bar"]),
                 help="What sees the tip: positions by a tracker or CMM, a ball put into sockets, a dial gauge,"
                 " a ball bar."),
    click.option("--places", type=click.IntRange(1, 30), help="Where those stand; else 3, of dial gauges 6."),
    click.option("--instrument", "described", type=INPUT,
                 help="TOML file of the instrument of --log, as `diagnose` takes it."),
    click.option("--length-mm", type=click.FloatRange(1.0, 5000.0),
                 help="Length of the ball bar (300 is assumed), or distance of the two sockets of a plate; left out:"
                 " sockets one by one, which do not determine the scale."),
    click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the candidates."),
)  # fmt: skip
def command(
    job: Job, count: int, folder: Path, log: Path | None, weights: str, pull: float, sigma: float, register: str | None,
    purpose: str, instrument: str, places: int | None, described: Path | None, length_mm: float | None, seed: int,
) -> Answer:  # fmt: skip
    """Design the measurements that narrow the 95 % band on JOB's path most, or calibrate the arm with fewest poses.

    Writes campaign.csv (an empty log to fill in), programs that move to the poses, campaign.json and report.html.

    Example: compplan campaign paths/isf_cone.toml --poses 12 --weights-kg 0,50 --pull-N 300 --out poses
    """
    from compplan.cli.measured import read_log
    from compplan.learning.campaign import Equipment, design_campaign, parse_weights
    from compplan.measurement.registration import parse_parts
    from compplan.planning.plan import plan_job
    from compplan.reporting.campaign import write_campaign

    if not sigma < 10.0 or not pull < 1e5:
        raise InputError("--sigma-mm and --pull-N are finite numbers")
    frames = None if register is None else () if register == "none" else parse_parts(register)
    length = None if length_mm is None else length_mm * 1e-3
    equipment = Equipment(parse_weights(weights), pull, sigma * 1e-3, frames, seed, purpose, instrument, places, length)
    with show_progress() as announce:
        announce("plan")
        plan = plan_job(job)
        campaign = design_campaign(plan, equipment, count, read_log(log, plan.robot, described), announce)
        announce("report")
        summary = write_campaign(campaign, folder)
    lines = [summary["says"], *(f"put up {stand.says}" for stand in campaign.stands), *campaign.notes]
    if len(campaign.touching):
        poses = ", ".join(str(k + 1) for k in campaign.touching)
        lines.append(f"the way to pose {poses} touches something: go around")
    more = "" if instrument == "tracker" else f" and --instrument {folder / 'instrument.toml'}"
    more += f" and --register {','.join(equipment.frames)}" if equipment.frames else ""
    todo = f"next: measure, fill in {folder / 'campaign.csv'}, and compplan diagnose it with the robot of the job{more}"
    return Answer(summary, [*lines, f"wrote {', '.join(summary['files'])} to {folder}", todo])
