"""`compplan diagnose`: where the sim-to-real gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.measured import load_measured, measured_options, registered_parts, settle_questions
from compplan.cli.options import INPUT, assume_ok, json_summary, out_folder, robot_option
from compplan.cli.terminal import show, show_progress
from compplan.diagnosis import diagnose_campaign
from compplan.effects import EFFECTS
from compplan.errors import UnknownNameError
from compplan.io.display import format_figures
from compplan.measurement.checks import list_notes
from compplan.measurement.registration import parse_parts
from compplan.reporting.diagnosis import deliver_diagnosis
from compplan.reporting.diagnosis_text import describe_structure
from compplan.reporting.effect_text import list_effects


@click.command("diagnose")
@click.argument("measurements", type=INPUT)
@robot_option()
@out_folder
@click.option("--register", help="Fit these frames in every model: base, tool or base,tool.")
@click.option("--without", multiple=True, metavar="EFFECT",
              help=f"Leave an effect out of the candidates, may be repeated: {', '.join(EFFECTS)}.")  # fmt: skip
@measured_options
@assume_ok
@json_summary
def command(
    measurements: Path, robot_name: str, folder: Path, register: str | None, without: tuple[str, ...],
    tool: Path | None, instrument: Path | None, target_offset: str | None, assume_ok: bool, as_json: bool,
) -> None:  # fmt: skip
    """Diagnose the gap between ROBOT and MEASUREMENTS (a measurement log).

    Writes DIR/diagnosis.json, DIR/robot (the updated robot folder, which every figure belongs to) and DIR/report.html.

    Example: compplan diagnose notebooks/diagnose_campaign/measurements.csv --robot kuka_kr270 --out out
    """
    parse_parts(register)
    for name in without:
        if name not in EFFECTS:
            raise UnknownNameError("effect", name, list(EFFECTS))
    robot, campaign = load_measured(measurements, robot_name, tool, target_offset, instrument)
    parts = registered_parts(register, campaign)
    with show_progress() as progress:
        progress("questions")
        asked = settle_questions(robot, campaign, parts, assume_ok, events=True)
        diagnosis = diagnose_campaign(robot, campaign, register=parts, without=without, progress=progress)
        table, opening = deliver_diagnosis(diagnosis, folder, progress)
    what, headline = diagnosis.summary()[0]
    following = opening.next.replace("listed below", "listed in the report")
    lines = [
        *(f"assumed to be meant: {question}" for question in asked),
        f"{what}: {headline}", *list_effects(table["verdict"]["effects"]), *describe_structure(diagnosis),
        *format_figures(diagnosis.list_figures()), *list_notes(diagnosis.fit.problem.campaign.notes),
        f"wrote diagnosis.json, report.html, robot/ to {folder}",
        f"next: {following.replace('OUT/robot', str(folder / 'robot'))}",
    ]  # fmt: skip
    show(table, as_json, lines)
