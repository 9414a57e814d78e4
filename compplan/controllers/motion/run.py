"""Execute a program as the robot folder's controller does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path as File

import numpy as np

from compplan.controllers.motion.drives import follow_command
from compplan.controllers.motion.geometry import build_path, follow_path, locate_nodes
from compplan.controllers.motion.instructions import read_instructions
from compplan.controllers.motion.timing import schedule_path
from compplan.controllers.writers.joint_convention import load_motion
from compplan.controllers.writers.motion_table import ServoMotion
from compplan.errors import InfeasibleError
from compplan.io.tables import write_table
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm

#: Longest step between two rows of EXECUTED.csv, and most rows of it. [s]
LONGEST_STEP, MOST_ROWS = 0.004, 5_000_000
#: Time that is executed after the last command, in which drives come to rest, in lags. [lags]
REST = 8.0


@dataclass(frozen=True)
class Executed:
    """What the controller makes of a program."""

    time: Array  #: Since the first command. Shape (k,). [s]
    q: Array  #: Joints that the drives reach. Shape (k, nq). [rad or m]
    position: Array  #: Nominal tip of them. Shape (k, 3). [m]
    motion: ServoMotion  #: The controller.
    notes: tuple[str, ...]  #: What is assumed.


def execute_program(file: File, robot: Robot, start: Array | None = None) -> Executed:
    """Execute the instructions of PROGRAM.csv as the controller of the robot folder does.

    `start` are joints near those in which it begins, where its first row gives a pose alone. Shape (nq,).

    Raises:
        InputError: If the file or the folder is not what it has to be.
        InfeasibleError: If a line cannot be followed, or a joint would leave its limits.
    """
    motion, assumed = load_motion(robot)
    instructions = read_instructions(file, robot)
    arm = build_arm(robot)
    path = build_path(locate_nodes(instructions, arm, start), arm, motion.blend_share)
    command = schedule_path(path, motion)
    if command.time[-1] > LONGEST_STEP * MOST_ROWS:
        took, most = command.time[-1] / 3600, LONGEST_STEP * MOST_ROWS / 3600
        raise InfeasibleError(f"the program takes {took:.1f} h, at most {most:.1f} h are executed; cut it")
    step = motion.cycle / np.ceil(motion.cycle / LONGEST_STEP - 1e-9)
    time = np.arange(0.0, command.time[-1] + REST * float(motion.lag.max()) + step, step)
    q = follow_path(path, np.interp(time, command.time, command.s))
    fine = replace(motion, cycle=step)
    q = follow_command(q, fine)
    notes = []
    if assumed:
        notes.append(f"assumed of the controller: {', '.join(assumed)}; compplan trace identifies them from a log")
    if not np.isfinite(instructions.q[0]).all() and start is None:
        notes.append("assumed: the posture at the start, nearest to the middle of the limits; give q1_deg .. in row 1")
    return Executed(time, q, locate_frames(arm.chain, q).tcp_position, fine, tuple(notes))


def write_executed(executed: Executed, robot: Robot, file: File) -> None:
    """Write EXECUTED.csv: time_s, q1_deg .., x_mm y_mm z_mm of the nominal tip, base frame."""
    columns: dict[str, object] = {"time_s": executed.time}
    for j in range(robot.nq):
        slides = bool(robot.prismatic[j])
        size = 1e3 if slides else 180.0 / np.pi
        columns[f"q{j + 1}_{'mm' if slides else 'deg'}"] = executed.q[:, j] * size
    for axis, values in zip("xyz", executed.position.T, strict=True):
        columns[f"{axis}_mm"] = 1e3 * values
    write_table(file, columns)
