"""`compplan predict`: what the measuring instrument should see of a campaign."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from compplan.cli.commands.measured import load_measured, measured_options
from compplan.cli.commands.options import complete_robots
from compplan.cli.commands.output_paths import OUT_TABLE
from compplan.io.provenance import describe_origin
from compplan.io.tables import dump_json
from compplan.measurement.checks import check_unit, list_notes
from compplan.measurement.registration import folder_registration, parse_parts
from compplan.robot import load_robot
from compplan.simulation.predict import predict_campaign, write_prediction


@click.command("predict")
@click.argument("measurements", type=click.Path(path_type=Path))
@click.option("--robot", "robot_name", required=True, shell_complete=complete_robots,
              help="Robot folder, or name of a shipped robot.")  # fmt: skip
@click.option("--out", required=True, type=OUT_TABLE, help="CSV file to write.")
@click.option("--register", default=None, help="Fit these frames to the campaign first: base, tool or base,tool.")
@measured_options
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(
    measurements: Path, robot_name: str, out: Path, register: str | None, instrument: Path | None,
    tool: Path | None, target_offset: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Predict what the instrument should see in every row of MEASUREMENTS, if the robot folder were the whole truth.

    Example: compplan predict later.csv --robot out/robot --out prediction.csv
    """
    parts = parse_parts(register)
    robot, campaign = load_measured(measurements, robot_name, tool, target_offset, instrument)
    frames = folder_registration(load_robot(robot_name))
    prediction = predict_campaign(robot, campaign, register=parts, registration=frames)
    if not parts:
        check_unit(campaign, prediction.position)
    write_prediction(prediction, out)
    distance = np.linalg.norm(prediction.gap, axis=1) * 1e3
    distance = distance[np.isfinite(distance)]
    summary = {
        "rows": len(campaign),
        "rms_mm": float(np.sqrt(np.mean(distance**2))) if len(distance) else None,
        "median_mm": float(np.median(distance)) if len(distance) else None,
        "registered": list(parts),
        "notes": list(campaign.notes),
        "made_by": describe_origin(),
    }
    if as_json:
        click.echo(dump_json(summary))
        return
    if len(distance):
        click.echo(f"{len(campaign)} rows; measured positions differ by {summary['rms_mm']:.3f} mm rms")
    for note in list_notes(campaign.notes):
        click.echo(note)
    click.echo(f"wrote {out}")
