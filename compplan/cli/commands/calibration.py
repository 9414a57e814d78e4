"""`compplan calibration`: a controller's own calibration, read into a robot folder or written from one."""

from __future__ import annotations

from pathlib import Path

import click

from compplan.cli.options import INPUT, Answer, make_command, robot_option
from compplan.io.transaction import check_folder
from compplan.reporting.writers.calibration import write_calibrated, write_controller_file
from compplan.robot import load_robot


@make_command(
    click.argument("direction", type=click.Choice(["read", "write"])), click.argument("source", type=INPUT),
    robot_option("The type as it ships, which the controller's numbers count from."),
    click.option("--out", required=True, type=INPUT, help="read: folder to write; write: file."),
)  # fmt: skip
def command(direction: str, source: Path, robot_name: str, out: Path) -> Answer:
    """Read a UR controller's calibration, the file SOURCE, into DIR/robot, or write it from the measured folder SOURCE.

    What the controller's file cannot hold of a folder is listed with the tip error that it leaves.

    Example: compplan calibration write out/robot --robot ur10e --out calibration.conf
    """
    nominal = load_robot(robot_name)
    if direction == "read":
        check_folder(out)
        summary = write_calibrated(source, nominal, out)
        lines = [f"{nominal.name} with the geometry of {source} ({summary['format']})", f"wrote {out / 'robot'}"]
        return Answer(summary, lines)
    summary = write_controller_file(load_robot(source), nominal, out)
    lines = [f"lost, tip error rms over {summary['poses']} drawn poses without load:"]
    lines += [f"  {row['rms_mm']:9.4f} mm  {row['what']}" for row in summary["lost"]]
    lines += [f"  {summary['left_rms_mm']:9.4f} mm  left in all", f"wrote {out}: {summary['advice']}"]
    return Answer(summary, lines)
