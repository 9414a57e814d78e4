"""Execution of a program by a controller: timing along the path, lag of its drives, and output of the result.

The speed along the path is the greatest within feed, joint limits and acceleration of the tip. Drives follow with a
first-order lag, an acceleration residue, and lost motion at reversals of a joint:

    q = F (q_cmd - T2 d^2 q_cmd / dt^2) - h/2 sign(last motion),   F: 1 / (1 + T1 s)

On a ramp of rate v the joint trails by T1 v; at an acceleration a it trails by T2 a more. A pure delay, a second-order
drive and feed forward have the same form to second order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path as File

import numpy as np
from scipy.linalg.blas import dtbsv

from compplan.controllers.motion.geometry import Path, build_path, follow_path, locate_nodes
from compplan.controllers.motion.instructions import read_instructions
from compplan.controllers.writers.joint_convention import load_motion
from compplan.controllers.writers.motion_table import ServoMotion
from compplan.errors import InfeasibleError
from compplan.io.tables import write_table
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm

#: Longest step between two rows of EXECUTED.csv, and greatest number of rows. [s]
LONGEST_STEP, MOST_ROWS = 0.004, 5_000_000
#: Time after the last command in which drives come to rest. [lags]
REST = 8.0


@dataclass(frozen=True)
class Executed:
    """Execution of a program by a controller."""

    time: Array  #: Time since the first command. Shape (k,). [s]
    q: Array  #: Joints reached by the drives. Shape (k, nq). [rad or m]
    position: Array  #: Nominal tip of these joints. Shape (k, 3). [m]
    motion: ServoMotion  #: Motion model of the controller.
    notes: tuple[str, ...]  #: Notes on assumptions.


def execute_program(file: File, robot: Robot, start: Array | None = None) -> Executed:
    """Execute the instructions of PROGRAM.csv with the motion model of the robot folder.

    `start` are joints near those at the beginning, for a first row with only a pose. Shape (nq,).

    Raises:
        InputError: If the file or the folder is not valid.
        InfeasibleError: If a line cannot be followed, or a joint would leave its limits.
    """
    motion, assumed = load_motion(robot)
    instructions = read_instructions(file, robot)
    arm = build_arm(robot)
    path = build_path(locate_nodes(instructions, arm, start), arm, motion.blend_share)
    scheduled = schedule_path(path, motion)
    cycles = motion.cycle * np.arange(len(scheduled))
    if cycles[-1] > LONGEST_STEP * MOST_ROWS:
        took, most = cycles[-1] / 3600, LONGEST_STEP * MOST_ROWS / 3600
        raise InfeasibleError(f"the program takes {took:.1f} h, at most {most:.1f} h are executed; cut it")
    step = motion.cycle / np.ceil(motion.cycle / LONGEST_STEP - 1e-9)
    time = np.arange(0.0, cycles[-1] + REST * float(motion.lag.max()) + step, step)
    fine = replace(motion, cycle=step)
    q = follow_command(follow_path(path, np.interp(time, cycles, scheduled)), fine)
    notes = []
    if assumed:
        notes.append(f"assumed of the controller: {', '.join(assumed)}; compplan trace identifies them from a log")
    if not np.isfinite(instructions.q[0]).all() and start is None:
        notes.append("assumed: the posture at the start, nearest to the middle of the limits; give q1_deg .. in row 1")
    return Executed(time, q, locate_frames(arm.chain, q).tcp_position, fine, tuple(notes))


def write_executed(executed: Executed, robot: Robot, file: File) -> None:
    """Write EXECUTED.csv: time_s, q1_deg .., x_mm y_mm z_mm of the nominal tip, base frame."""
    columns: dict[str, object] = {"time_s": executed.time, **robot.joint_columns(executed.q)}
    for axis, values in zip("xyz", executed.position.T, strict=True):
        columns[f"{axis}_mm"] = 1e3 * values
    write_table(file, columns)


def limit_speed(path: Path, motion: ServoMotion) -> Array:
    """Return the speed along s at every point, within feed, joint velocities and cornering limits. Shape (m,). [m/s]

    The curvature q'' at a point uses v^2 |q''| of a joint's acceleration, and v^2 |p''| of the tip's. Between points
    v^2 changes by at most 2 a ds.
    """
    step = np.diff(path.s)
    slope, bend, tip_slope, tip_bend = path.bends
    tiny = 1e-12
    speed = np.r_[path.feed[:1], np.minimum(path.feed[:-1], path.feed[1:])]
    speed = np.minimum(speed, (motion.velocity_limits / np.maximum(slope, tiny)).min(axis=1))
    square = speed**2
    corner = np.minimum((motion.acceleration_limits / np.maximum(bend, tiny)).min(axis=1),
                        motion.acceleration / np.maximum(tip_bend, tiny))  # fmt: skip
    square = np.minimum(square, corner)
    square[path.stops] = 0.0
    gain = np.minimum((motion.acceleration_limits / np.maximum(slope, tiny)).min(axis=1),
                      motion.acceleration / np.maximum(tip_slope, 1e-3))  # fmt: skip
    grown = np.r_[0.0, np.cumsum(2.0 * np.minimum(gain[:-1], gain[1:]) * step)]
    square = np.minimum.accumulate(square - grown) + grown
    square = (np.minimum.accumulate((square + grown)[::-1])[::-1]) - grown
    return np.sqrt(np.maximum(square, 0.0))


def schedule_path(path: Path, motion: ServoMotion) -> Array:
    """Return the length along a path at the controller's cycle, smoothed as by its interpolator. Shape (k,). [m]

    At exact stops the smoothing comes to rest.
    """
    speed = limit_speed(path, motion)
    step = np.diff(path.s)
    duration = 2.0 * step / np.maximum(speed[:-1] + speed[1:], 1e-6)
    rest = np.zeros(len(path.s))
    rest[path.stops] = motion.smoothing
    arrive = np.r_[0.0, np.cumsum(duration + rest[:-1])]
    leave = arrive + rest
    total = leave[-1] + motion.smoothing
    time = np.arange(0.0, total + motion.cycle, motion.cycle)
    s = _move_evenly(path.s, speed, arrive, leave, time)
    return _average(s, max(1, round(motion.smoothing / motion.cycle)))


def _move_evenly(s: Array, speed: Array, arrive: Array, leave: Array, time: Array) -> Array:
    """Return the length at instants, with constant acceleration between two points."""
    i = np.clip(np.searchsorted(arrive, time, "right") - 1, 0, len(s) - 2)
    begin, end = leave[i], arrive[i + 1]
    u = np.clip(time - begin, 0.0, end - begin)
    change = (speed[i + 1] - speed[i]) / np.maximum(end - begin, 1e-12)
    moved = s[i] + speed[i] * u + 0.5 * change * u**2
    return np.asarray(np.where(time >= arrive[-1], s[-1], np.minimum(moved, s[i + 1])))


def _average(s: Array, width: int) -> Array:
    """Return the mean over the last `width` instants; the controller rests before the first."""
    total = np.cumsum(np.r_[np.full(width, s[0]), s] - s[0])
    averaged = (total[width:] - total[:-width]) / width + s[0]
    return np.asarray(np.maximum.accumulate(averaged))


#: Rate below which a joint does not reverse. [rad/s or m/s]
STILL = 1e-6


def follow_command(q: Array, motion: ServoMotion) -> Array:
    """Return the joints reached by the drives for a command at the controller's cycle; they rest before the first row.

    Shape (k, nq). [rad or m]
    """
    lagged = lag_command(q, motion.lag, motion.acceleration_lag, motion.cycle)
    if not motion.lost_motion.any():
        return lagged
    return lagged - 0.5 * motion.lost_motion * hold_direction(q, motion.cycle)


def lag_command(q: Array, lag: Array, acceleration_lag: Array, cycle: float) -> Array:
    """Return a command after lag T1 [s] and acceleration residue T2 [s^2] of every joint, exact for linear pieces.

    Rows of the command, shape (k, nq) [rad or m], are a cycle [s] apart.
    """
    out = np.empty_like(q)
    for j in range(q.shape[1]):
        command = q[:, j]
        if acceleration_lag[j]:
            padded = np.r_[command[0], command, command[-1]]
            command = command - acceleration_lag[j] * np.diff(padded, 2) / cycle**2
        out[:, j] = _lag(command, lag[j] / cycle)
    return out


def _lag(command: Array, cycles: float) -> Array:
    """Filter by 1 / (1 + T s), T in cycles, with linear input between rows: y_k = a y_k-1 + b_0 x_k + b_1 x_k-1."""
    if cycles < 1e-3 or len(command) < 2:
        return command
    a = np.exp(-1.0 / cycles)
    b0, b1 = 1.0 - cycles * (1.0 - a), cycles * (1.0 - a) - a
    rest = command[0]
    moved = command - rest
    driven = b0 * moved
    driven[1:] += b1 * moved[:-1]
    band = np.ones((2, len(moved)), order="F")
    band[1] = -a
    return np.asarray(dtbsv(1, band, driven, lower=1, diag=1, overwrite_x=1)) + rest


def hold_direction(q: Array, cycle: float) -> Array:
    """Return the sign of the last motion of every joint; 0 before it first moves. Shape (k, nq)."""
    rate = np.diff(q, axis=0, prepend=q[:1]) / cycle
    sign = np.where(np.abs(rate) > STILL, np.sign(rate), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(q))[:, None], 0), axis=0)
    return np.asarray(np.take_along_axis(sign, last, axis=0))
