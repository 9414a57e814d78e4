"""`compplan predict`: what the measuring instrument should see of a campaign."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from compplan.cli.measured import load_measured, measured_options
from compplan.cli.options import INPUT, Answer, make_command, out_table, robot_option
from compplan.io.provenance import describe_origin
from compplan.measurement.checks import check_unit, list_notes
from compplan.measurement.registration import folder_registration, parse_parts
from compplan.robot import load_robot
from compplan.simulation.predict import predict_campaign, write_prediction


@make_command(
    click.argument("measurements", type=INPUT), robot_option(), out_table,
    click.option("--register", help="Fit these frames to the campaign first: base, tool or base,tool."),
    measured_options,
)  # fmt: skip
def command(
    measurements: Path, robot_name: str, out: Path, register: str | None, instrument: Path | None,
    tool: Path | None, target_offset: str | None,
) -> Answer:  # fmt: skip
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
    known = len(distance) > 0
    summary = {
        "rows": len(campaign), "rms_mm": float(np.sqrt(np.mean(distance**2))) if known else None,
        "median_mm": float(np.median(distance)) if known else None, "registered": list(parts),
        "notes": list(campaign.notes), "made_by": describe_origin(),
    }  # fmt: skip
    head = [f"{len(campaign)} rows; measured positions differ by {summary['rms_mm']:.3f} mm rms"] if known else []
    return Answer(summary, [*head, *list_notes(campaign.notes), f"wrote {out}"])
