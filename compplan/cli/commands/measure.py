"""Measurement commands for a better robot model or program: `identify`, `diagnose`, `predict`, `campaign`, `learn`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from compplan.api.measured import choose_frames, read_measured, resolve_questions
from compplan.cli.commands.plan import explain_failures
from compplan.cli.options import (
    INPUT,
    CommandResult,
    Number,
    assume_ok,
    make_command,
    make_job_command,
    measured_options,
    out_folder,
    out_table,
    robot_instead,
    robot_option,
    split_names,
)
from compplan.cli.terminal import Work, show_progress
from compplan.effects import EFFECTS
from compplan.effects.requested import GEOMETRY
from compplan.io.parsing import LEAST_SIGMA_MM
from compplan.io.provenance import describe_origin
from compplan.measurement.checks import check_unit, list_notes
from compplan.measurement.fit.least_squares import LOSSES
from compplan.measurement.registration import folder_registration, parse_parts
from compplan.robot import load_robot

if TYPE_CHECKING:
    from compplan.diagnosis import Diagnosis
    from compplan.diagnosis.self_test import SelfTest
    from compplan.job.job import Job


@make_command(
    click.argument("measurements", type=INPUT), robot_option(), out_folder,
    click.option("--register", help='Frames that are unknown: "base", "tool" or "base,tool".'),
    click.option("--springs", help="Springs to identify, by name; default: those of the robot and one per joint."),
    click.option("--add", help='Springs that the robot lacks and gets, such as "joint_3.rx,base_joint.ry".'),
    click.option("--effects", help='Effects to fit too, such as "backlash,joint_coupling@joint_5:of joint_4".'),
    click.option("--geometry", type=click.Choice([*GEOMETRY, "auto"]), default="auto", help="Geometry to fit too."),
    click.option("--reference", type=click.Choice(["absolute", "difference", "auto"]), default="auto",
                 help="Absolute positions, or each pose against itself under other loads."),
    click.option("--loss", type=click.Choice(LOSSES), default="tukey", help="Loss function of the residuals."),
    measured_options, assume_ok, epilog=f"Effects: {', '.join(EFFECTS)}.",
)  # fmt: skip
def run_identify(
    measurements: Path, robot_name: str, folder: Path, register: str | None, springs: str | None,
    add: str | None, effects: str | None, instrument: Path | None, tool: Path | None,
    target_offset_mm: list[float] | None, assume_ok: bool, **choices: Any,
) -> CommandResult:  # fmt: skip
    """Identify the compliances of ROBOT from MEASUREMENTS (a measurement log), with 95 % intervals.

    Writes DIR/robot (the updated robot folder) and DIR/identify.json.

    Example: compplan identify examples/identify/measurements.csv --robot kuka_kr270 --out out
    """
    from compplan.identification.campaign import identify_campaign
    from compplan.identification.problem import IdentifyOptions
    from compplan.reporting.identify import list_compliances, open_identification, write_identification

    options = IdentifyOptions(
        register=parse_parts(register), springs=None if springs is None else split_names(springs), add=split_names(add),
        effects=split_names(effects), **choices,
    )  # fmt: skip
    robot, campaign = read_measured(
        measurements, robot_name, tool=tool, target_offset_mm=target_offset_mm, instrument=instrument
    )
    options = replace(options, register=choose_frames(options.register, campaign))
    resolve_questions(robot, campaign, options.register, assume_ok)
    with show_progress() as progress:
        found = identify_campaign(robot, campaign, options, progress=progress)
    summary = write_identification(found, folder, list(campaign.notes))
    held = len(summary["unidentifiable"])
    notes = list_compliances(summary)
    notes += [f"note: parameters that these poses do not determine: {held}, see the report"] if held else []
    notes += [*(f"note: {note}" for note in summary["notes"]), *list_notes(campaign.notes)]
    files = ["identify.json", "report.html", "robot"]
    return CommandResult(summary, open_identification(summary).format(folder, files, notes))


@make_command(
    click.argument("measurements", type=INPUT), robot_option(), out_folder,
    click.option("--register", help="Fit these frames in every model: base, tool or base,tool."),
    click.option("--without", multiple=True, metavar="EFFECT",
                 help=f"Leave an effect out of the candidates, may be repeated: {', '.join(EFFECTS)}."),
    click.option("--self-test", is_flag=True,
                 help="Simulate 20 effects of known size at these poses with this noise, diagnose each, and list those "
                 "found; takes twenty times as long. Ctrl-C keeps what is done."),
    measured_options, assume_ok,
)  # fmt: skip
def run_diagnose(
    measurements: Path, robot_name: str, folder: Path, register: str | None, self_test: bool, **options: Any
) -> CommandResult:  # fmt: skip
    """Diagnose the gap between ROBOT and MEASUREMENTS (a measurement log).

    Writes DIR/diagnosis.json, DIR/robot (the updated robot folder, for which all figures hold) and DIR/report.html.

    Example: compplan diagnose notebooks/diagnose_campaign/measurements.csv --robot kuka_kr270 --out out
    """
    from compplan.api.verbs import diagnose_measured
    from compplan.io.display import format_figures
    from compplan.reporting.diagnosis import CALIBRATION, deliver_diagnosis, open_diagnosis
    from compplan.reporting.diagnosis_text import describe_next, describe_self_test, describe_structure, list_effects

    with show_progress() as progress:
        start = perf_counter()
        diagnosis, questions = diagnose_measured(
            measurements, robot_name, register=parse_parts(register), progress=progress, self_test=self_test, **options
        )
        tested = _test_diagnosis(diagnosis, perf_counter() - start, progress) if self_test else None
        table = deliver_diagnosis(diagnosis, folder, progress, tested)
    verdict, kind = table["verdict"], diagnosis.delivery.kind
    todo = describe_next(table, kind, "in the report")
    small = table["where"]["by_joint"][CALIBRATION]["share"]
    notes = [
        *(f"accepted by --assume-ok: {question}" for question in questions),
        *list_effects(verdict["effects"]), *describe_structure(diagnosis), *format_figures(diagnosis.list_remarks()),
        *list_notes(diagnosis.fit.problem.campaign.notes),
        *(describe_self_test(table["self_test"]) if tested else []),
    ]  # fmt: skip
    opening = open_diagnosis(verdict, table["gap"], kind, None, todo, small)
    return CommandResult(table, opening.format(folder, ["report.html", "diagnosis.json", "robot"], notes))


def _test_diagnosis(diagnosis: Diagnosis, seconds: float, work: Work) -> SelfTest:
    """Run the self-test of a diagnosis that took `seconds`, and show the remaining time."""
    from compplan.diagnosis.self_test import PLANTED, run_self_test

    def show(done: int, left: float) -> None:
        left = PLANTED * seconds if np.isnan(left) else left
        work(f"self-test: {PLANTED - done} diagnoses to go, about {left:.0f} s; Ctrl-C ends it")
        work.count("self-test", done, PLANTED)

    return run_self_test(diagnosis, progress=show)


@make_command(
    click.argument("measurements", type=INPUT), robot_option(), out_table,
    click.option("--register", help="Fit these frames to the campaign first: base, tool or base,tool."),
    measured_options,
)  # fmt: skip
def run_predict(
    measurements: Path, robot_name: str, out: Path, register: str | None, **measured: Any
) -> CommandResult:  # fmt: skip
    """Predict the reading of the instrument in every row of MEASUREMENTS, for the robot as its folder states it.

    Example: compplan predict later.csv --robot out/robot --out prediction.csv
    """
    from compplan.simulation.predict import predict_campaign, write_prediction

    parts = parse_parts(register)
    robot, campaign = read_measured(measurements, robot_name, **measured)
    frames = folder_registration(load_robot(robot_name))
    prediction = predict_campaign(robot, campaign, register=parts, registration=frames)
    if not parts:
        check_unit(campaign, prediction.position)
    write_prediction(prediction, out)
    distance = np.linalg.norm(prediction.gap, axis=1) * 1e3
    distance = distance[np.isfinite(distance)]
    known = len(distance) > 0
    summary = {
        "rows": len(campaign), "rms_mm": float(np.sqrt(np.mean(distance**2))) if known else None,
        "median_mm": float(np.median(distance)) if known else None, "registered": list(parts),
        "notes": list(campaign.notes), "made_by": describe_origin(),
    }  # fmt: skip
    head = [f"{len(campaign)} rows; measured minus predicted: {summary['rms_mm']:.3f} mm rms"] if known else []
    return CommandResult(summary, [*head, *list_notes(campaign.notes), f"wrote {out}"])


@make_job_command(
    click.option("--poses", "count", type=click.IntRange(1, 200), required=True, help="How many poses to measure."),
    out_folder, robot_instead,
    click.option("--log", "log", type=INPUT, help="Earlier measurements to take into account."),
    click.option("--weights-kg", "weights", default="0", show_default=True, metavar="KG,KG",
                 help="Weights that can be hung on the tool; 0: none."),
    click.option("--pull-N", "pull", type=Number(0.0, 1e5), default=0.0, show_default=True,
                 help="Force with which the tool can be pulled sideways, along x or y of the base."),
    click.option("--sigma-mm", "sigma", type=Number(LEAST_SIGMA_MM, 10.0), default=0.03, show_default=True,
                 help="Standard deviation of the instrument, per axis."),
    click.option("--register", metavar="FRAMES",
                 help="Frames that are unknown: base, tool, base,tool (of a tracker if left out) or none."),
    click.option("--with", "instrument", default="tracker", show_default=True,
                 type=click.Choice(["tracker", "sockets", "gauge"]),
                 help="Instrument: tracker (or CMM, positions of the tip), sockets for a ball, dial gauge."),
    click.option("--places", type=click.IntRange(1, 30), help="How many sockets (3) or gauges (6)."),
    click.option("--instrument", "described", type=INPUT,
                 help="TOML file of the instrument of --log, as `diagnose` takes it."),
    click.option("--length-mm", type=Number(1.0, 5000.0),
                 help="Distance of the two sockets of a plate; left out: single sockets, which do not determine"
                 " the scale of the arm."),
    click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the candidates."),
)  # fmt: skip
def run_campaign(
    job: Job, count: int, folder: Path, log: Path | None, weights: str, pull: float, sigma: float, register: str | None,
    instrument: str, places: int | None, described: Path | None, length_mm: float | None, seed: int,
) -> CommandResult:  # fmt: skip
    """Design the measurements that narrow the 95 % band on JOB's path most.

    Writes campaign.csv (an empty log to fill in), programs that move to the poses, campaign.json and report.html.

    Example: compplan campaign paths/isf_cone.toml --poses 12 --weights-kg 0,50 --pull-N 300 --out poses
    """
    from compplan.diagnosis.data.plausibility import build_rows_model
    from compplan.learning.campaign import design_campaign, parse_weights
    from compplan.measurement.equipment import Equipment
    from compplan.planning.plan import plan_job
    from compplan.reporting.campaign import open_campaign, write_campaign

    frames = None if register is None else () if register == "none" else parse_parts(register)
    length = 1e-3 * (length_mm or 0.0)
    equipment = Equipment(parse_weights(weights), pull, sigma * 1e-3, frames, seed, instrument, places, length)
    with show_progress() as announce:
        announce("plan")
        plan = plan_job(job)
        known = None if log is None else read_measured(log, plan.robot, instrument=described)[1]
        if known is not None:
            rows = build_rows_model(plan.robot, known)
            check_unit(rows.campaign, rows.position)
        campaign = design_campaign(plan, equipment, count, known, announce)
        announce("report")
        summary = write_campaign(campaign, folder)
    notes = [*(f"put up {fixture.instruction}" for fixture in campaign.fixtures), *campaign.notes]
    return CommandResult(summary, open_campaign(campaign).format(folder, summary["files"], notes))


@make_job_command(
    click.argument("measured", type=INPUT), robot_option("Robot folder that the part's program was planned with."),
    out_folder,
    click.option("--frame", type=click.Choice(["part", "base"]), default="part", show_default=True,
                 help="Frame of the measured points."),
    click.option("--align", type=click.Choice(["datum", "best_fit"]),
                 help="Take the points as their frame states (datum), or remove a fitted shift and turn of all points"
                 " first (best_fit). Left out: datum, but a large shift of this kind is refused."),
    click.option("--sigma-mm", type=Number(LEAST_SIGMA_MM, 20.0),
                 help="Standard deviation of points whose file states none; assumed: 0.02, of a scan 0.05."),
    click.option("--instrument", type=INPUT,
                 help="TOML file of the instrument: its sigma_mm, where --sigma-mm is left out."),
    click.option("--mesh", type=INPUT, help="Nominal surface of the part, STL or PLY in mm, in the frame of the "
                 "points: they count along its normals."),
    click.option("--reach-mm", type=Number(0.0, 1000.0, min_open=True),
                 help="Greatest distance of that surface from the path of the tip; default: radius of the cutter in"
                 " [process] plus 1 mm."),
    assume_ok,
)  # fmt: skip
def run_learn(
    job: Job, measured: Path, robot_name: str, folder: Path, **options: Any
) -> CommandResult:  # fmt: skip
    """Learn from MEASURED points of a part cut with JOB: write the corrected program and the updated robot folder.

    MEASURED has columns x_mm y_mm z_mm of the attained tool tip, and where they are known s_mm (path length) and
    sigma_mm; a probe along normals has reading_mm along dir_i dir_j dir_k from there. Or it is a scan of the surface
    that the tip touches, in mm: STL, PLY, XYZ, or a table without a header (x y z [nx ny nz]); with --mesh of any
    surface that the tool cuts. The next part learns with --robot DIR/robot.

    Example: compplan learn paths/circle_500mm.toml part1.csv --robot kuka_kr270 --out part2
    """
    from compplan.api.verbs import learn
    from compplan.reporting.learn import open_update, write_learning

    with show_progress() as announce:
        update = learn(job, measured, robot_name, progress=announce, **options)
        announce("report")
        summary = write_learning(update, folder)
    lines = open_update(update).format(folder, summary["files"], update.notes[1:])
    given = {key: options[key] for key in ("frame", "align") if options[key] not in (None, "part")}
    lines[-1] += "".join(f" --{key} {value}" for key, value in given.items())
    return CommandResult(summary, lines, explain_failures([update.after]))
