"""`compplan execute`: what the robot's controller makes of a program."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from compplan.cli.commands.options import complete_robots
from compplan.cli.commands.output_paths import OUT_TABLE
from compplan.io.provenance import describe_origin
from compplan.io.tables import dump_json


@click.command("execute")
@click.argument("program", type=click.Path(path_type=Path))
@click.option("--robot", "robot_name", required=True, shell_complete=complete_robots,
              help="Robot folder or name; [motion] of its controller.toml is executed.")  # fmt: skip
@click.option("--out", required=True, type=OUT_TABLE, help="CSV file to write.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def command(program: Path, robot_name: str, out: Path, as_json: bool) -> None:
    """Execute the instructions of PROGRAM as the controller does: blends, speed, drives that lag.

    Example: compplan execute program.csv --robot ur10 --out executed.csv
    """
    from compplan.controllers.motion.run import execute_program, write_executed
    from compplan.robot import load_robot

    robot = load_robot(robot_name)
    executed = execute_program(program, robot)
    write_executed(executed, robot, out)
    rate = np.linalg.norm(np.diff(executed.position, axis=0), axis=1) / executed.motion.cycle
    summary = {
        "schema": 1, "rows": len(executed.time), "duration_s": float(executed.time[-1]),
        "fastest_mm_s": 1e3 * float(rate.max(initial=0.0)), "source": executed.motion.source,
        "notes": list(executed.notes), "made_by": describe_origin(),
    }  # fmt: skip
    if as_json:
        click.echo(dump_json(summary))
        return
    click.echo(f"{summary['rows']} rows in {summary['duration_s']:.3f} s, "
               f"tip at most {summary['fastest_mm_s']:.4g} mm/s")  # fmt: skip
    for note in executed.notes:
        click.echo(f"note: {note}")
    click.echo(f"wrote {out}")
