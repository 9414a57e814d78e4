"""`compplan execute`: what the robot's controller makes of a program."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from compplan.cli.options import INPUT, Answer, make_command, out_table, robot_option
from compplan.io.provenance import describe_origin


@make_command(
    click.argument("program", type=INPUT),
    robot_option("Robot folder or name; [motion] of its controller.toml is executed."), out_table,
)  # fmt: skip
def command(program: Path, robot_name: str, out: Path) -> Answer:
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
    speed = f"tip at most {summary['fastest_mm_s']:.4g} mm/s"
    head = f"{summary['rows']} rows in {summary['duration_s']:.3f} s, {speed}"
    return Answer(summary, [head, *(f"note: {note}" for note in executed.notes), f"wrote {out}"])
