"""`compplan diagnose`: where the sim-to-real gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from math import isfinite
from pathlib import Path

import click

from compplan.cli.commands.measured import (
    load_measured,
    measured_options,
    registered_parts,
    settle_questions,
)
from compplan.cli.commands.options import complete_robots
from compplan.cli.commands.output_paths import OUT_FOLDER
from compplan.cli.commands.progress import show_progress
from compplan.diagnosis import Diagnosis, Finding, diagnose_campaign
from compplan.diagnosis.evidence.unmodelled import describe_unmodelled
from compplan.diagnosis.results.accuracy import MORE, Assessment
from compplan.diagnosis.results.calibration import state_change
from compplan.diagnosis.results.delivery import NOMINAL
from compplan.diagnosis.results.verdict import CALIBRATED
from compplan.effects import EFFECTS
from compplan.errors import UnknownNameError
from compplan.io.tables import dump_json
from compplan.measurement.checks import list_notes
from compplan.measurement.registration import parse_parts
from compplan.reporting.diagnosis_text import describe_beside, describe_counting
from compplan.reporting.effect_text import describe_change
from compplan.reporting.writers.diagnosis import deliver_diagnosis


@click.command("diagnose")
@click.argument("measurements", type=click.Path(path_type=Path))
@click.option("--robot", "robot_name", required=True, shell_complete=complete_robots,
              help="Robot folder, or name of a shipped robot.")  # fmt: skip
@click.option("--out", type=OUT_FOLDER, default="out", show_default=True, help="Folder to write to.")
@click.option("--register", help="Fit these frames in every model: base, tool or base,tool.")
@click.option(
    "--without",
    multiple=True,
    metavar="EFFECT",
    help=f"Leave an effect out of the candidates, may be repeated: {', '.join(EFFECTS)}.",
)
@measured_options
@click.option("--assume-ok", is_flag=True, help="Go on where the log raises a question.")
@click.option("--json", "as_json", is_flag=True, help="Print diagnosis.json.")
def command(
    measurements: Path, robot_name: str, out: Path, register: str | None, without: tuple[str, ...], tool: Path | None,
    instrument: Path | None, target_offset: str | None, assume_ok: bool, as_json: bool,
) -> None:  # fmt: skip
    """Diagnose the gap between ROBOT and MEASUREMENTS (a measurement log).

    Writes DIR/diagnosis.json, DIR/robot (the updated robot folder, which every figure belongs to) and DIR/report.html;
    where named causes alone and all that a calibration finds are both worth a folder, DIR/robot is the one that
    predicts better, and DIR/robot_causes or DIR/robot_calibrated the other.

    Example: compplan diagnose docs/notebooks/diagnose_campaign/measurements.csv --robot kuka_kr270 --out out
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
        table, assessment = deliver_diagnosis(diagnosis, out, progress)
    if as_json:
        click.echo(dump_json(table))
        return
    for question in asked:
        click.echo(f"assumed to be meant: {question}")
    click.echo(describe_diagnosis(diagnosis))
    click.echo(describe_assessment(diagnosis, assessment))
    measured = diagnosis.fit.problem.campaign
    for note in list_notes(measured.notes):
        click.echo(note)
    folders = ", ".join(f"{delivery.folder(number)}/" for number, delivery in enumerate(diagnosis.deliveries))
    click.echo(f"wrote diagnosis.json, report.html, {folders} to {out}")
    click.echo(describe_next(diagnosis, out))


def describe_diagnosis(diagnosis: Diagnosis) -> str:
    """Write the answer in a few lines."""
    verdict, gap = diagnosis.verdict, diagnosis.gap
    single = ": many small errors, no cause by itself" if verdict.status == CALIBRATED else ""
    lines = [f"verdict: {verdict.status.replace('_', ' ')}{single}"]
    for finding in verdict.findings:
        place = " ".join(str(part) for part in finding.effect.place if part is not None)
        rivals = ", ".join(" ".join(str(p) for p in r.place if p is not None) for r in finding.rivals if r.alike)
        tie = f"; this campaign cannot tell it from {rivals}" if rivals else ""
        change = describe_change(state_change(diagnosis.robot, finding.effect, diagnosis.sizes))
        lines.append(
            f"  {place}: {change + ' (95 %), ' if change else ''}probability {finding.probability:.2f}, "
            f"{_describe_motion(finding, gap.before)}{tie}"
        )
    if counting := describe_counting(diagnosis):
        lines.append(f"  {counting}")
    if verdict.structure.background > verdict.structure.floor:
        # small errors that cancel each other move the target further than the gap: they explain no more than there is
        moved = min(verdict.structure.background, verdict.structure.gap)
        lines.append(f"  calibration, small errors everywhere: {moved * 1e3:.3f} mm")
    for left in verdict.structure.dependences if verdict.status != CALIBRATED else ():
        what = describe_unmodelled(left.effect.joint, str(left.effect.axis))
        beside = describe_beside(verdict.findings, left)
        lines.append(f"  no named effect makes {what}{beside}: {left.explained * 1e3:.3f} mm")
    lines.append(
        f"gap: {gap.before * 1e3:.3f} mm before, {gap.after * 1e3:.3f} mm after; "
        f"on rows not in the fit {gap.held_out_before * 1e3:.3f} mm before, {gap.held_out_after * 1e3:.3f} mm after; "
        f"noise floor {gap.noise_floor * 1e3:.3f} mm"
    )
    if len(diagnosis.outliers):
        count = len(diagnosis.outliers)
        lines.append(f"{count} {'row is' if count == 1 else 'rows are'} reported as outlier{'s' * (count > 1)}")
    return "\n".join(lines)


def describe_next(diagnosis: Diagnosis, out: Path) -> str:
    """Say what to do with the folders that were written to `out`."""
    if diagnosis.deliveries[0].kind == NOMINAL:
        return "next: nothing predicts better than the robot as it was; what to measure next is on the page"
    return f"next: plan with it, compplan plan JOB --robot {out / 'robot'}; what to measure next is on the page"


def _describe_motion(finding: Finding, gap: float) -> str:
    """Say how far an effect moves the target; what was found before anything was fitted has no such figure."""
    if not isfinite(finding.explained):
        return "found before anything was fitted"
    beside = ", of which other errors cancel a part" if finding.explained > gap else ""
    return f"moves the target {finding.explained * 1e3:.3f} mm{beside}"


def describe_assessment(diagnosis: Diagnosis, assessment: Assessment) -> str:
    """Write what the folders are worth in a few lines."""
    folders = [f"{d.folder(k)} ({d.kind}): {d.held.rms * 1e3:.3f} mm" for k, d in enumerate(diagnosis.deliveries)]
    before, after = assessment.accuracy["before"], assessment.accuracy["after"]
    lines = [
        f"folders, on rows not in the fit: {'; '.join(folders)}",
        f"pose accuracy over {before.poses} poses: mean {before.mean * 1e3:.3f} mm before, "
        f"{after.mean * 1e3:.3f} mm on rows not in the fit",
    ]
    learning = assessment.learning
    if learning is not None:
        now, then = learning.at(learning.now), learning.at(learning.now + MORE)
        less = 100.0 * (1.0 - then / now) if now > 0.0 else 0.0
        lines.append(f"{MORE} more poses like these would take {less:.1f} % off the error")
    return "\n".join(lines)
