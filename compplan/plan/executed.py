"""Where the controller's drives take the loaded tip, and the command that leads by their lag.

Drives follow a command as F (q_cmd - T2 q_cmd''), F = 1 / (1 + T1 s) for each joint, less half the lost motion
(`compplan.executed.drives`). To second order the inverse of it is

    q_cmd = q + T1 q' + T2 q''.

It is led where the values were identified (a source in controller.toml), the joints stay within their limits, and the
model has the tip nearer to the path with it, in the 95th percentile and at the farthest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from compplan.executed.align import find_nearest
from compplan.executed.drives import follow_command
from compplan.path.toolpath import interpolate
from compplan.plan.task import PlanTask
from compplan.plan.timing import cutting_runs
from compplan.program.counting import load_motion
from compplan.program.servo import ASSUMED, ServoMotion
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.sensitivity import attain_pose

#: Pieces of the path to either side among which the nearest is taken, and poses that are followed at once.
SIDE, BLOCK = 40, 100_000


@dataclass(frozen=True)
class ExecutedPath:
    """How far the drives leave the loaded tip beside the path of a cut, the time along it aside.

    Attributes:
        p95: 95th percentile of what is sent. [m]
        most: Farthest of what is sent. [m]
        plain: The same two of the command that leads by nothing. [m]
        sent: Joint positions that programs hold. Shape (n, nq). [rad or m]
        leads: Whether they lead by the lag.
        source: Who says how the drives follow.

    """

    p95: float
    most: float
    plain: tuple[float, float]
    sent: Array
    leads: bool
    source: str

    def describe(self) -> dict[str, object]:
        """Return what plan.json holds."""
        plain = {"p95": 1e3 * self.plain[0], "max": 1e3 * self.plain[1]}
        return {"p95": 1e3 * self.p95, "max": 1e3 * self.most, "lag_led": self.leads, "without_lead": plain,
                "source": self.source}  # fmt: skip

    def say(self) -> str:
        """Say in a sentence where the drives take the tip, and what the programs do about it."""
        left = f"The drives as identified ({self.source}) leave the tip up to {1e3 * self.most:.3g} mm beside the path"
        if self.leads:
            return f"{left}: the programs lead by their lag (without that {1e3 * self.plain[1]:.3g} mm)."
        return f"{left}; a lead by their lag is not written, it does not help or a limit of a joint forbids it."


def describe_floor(task: PlanTask, q: Array) -> str:
    """Say where the whole correction is below what the robot can move (resolution_mm of controller.toml), else "".

    Args:
        task: The task.
        q: Command at the waypoints. Shape (n, nq). [rad or m]

    """
    floor = load_motion(task.robot)[0].resolution
    if not floor or not task.cut.any():
        return ""
    away = locate_frames(task.chain, q[task.cut]).tcp_position - task.position[task.cut]
    most = float(np.linalg.norm(away, axis=1).max())
    if not 1e-9 < most <= floor:
        return ""
    return (f"The whole correction, {1e3 * most:.3g} mm at most, is below the motion resolution of the robot "
            f"({1e3 * floor:g} mm, controller.toml): it is not written.")  # fmt: skip


def judge_executed(task: PlanTask, q: Array, time: Array) -> ExecutedPath | None:
    """Follow a command as the controller of the robot folder does; None where nobody states how its drives follow.

    Args:
        task: The task.
        q: Command at the waypoints. Shape (n, nq). [rad or m]
        time: Time at each waypoint. Shape (n,). [s]

    """
    motion = load_motion(task.robot)[0]
    drives = np.abs([motion.lag, motion.acceleration_lag, motion.lost_motion])
    if motion.source == ASSUMED or not drives.any() or not task.cut.any():
        return None
    plain = _measure(task, q, time, motion)
    if not drives[:2].any():
        return ExecutedPath(*plain, plain, q, False, motion.source)
    led = lead_lag(task, q, time, motion)
    rate = np.abs(np.diff(led, axis=0)) / np.maximum(np.diff(time), 1e-9)[:, None]
    inside = (rate <= task.velocity_limits).all() and ((led >= task.robot.lower) & (led <= task.robot.upper)).all()
    left = _measure(task, led, time, motion)
    if inside and left[0] < plain[0] and left[1] < plain[1]:
        return ExecutedPath(*left, plain, led, True, motion.source)
    return ExecutedPath(*plain, plain, q, False, motion.source)


def lead_lag(task: PlanTask, q: Array, time: Array, motion: ServoMotion) -> Array:
    """Return the command that leads by the lag of the drives; at rests and in rapid moves it is the command itself."""
    led = q.copy()
    for first, last in cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests):
        run = slice(first, last + 1)
        if last - first < 3 or not task.nominal.steps[first:last].any():
            continue
        rate = _rates(q[run], time[run])
        led[run] = q[run] + motion.lag * rate + motion.acceleration_lag * np.gradient(rate, time[run], axis=0)
        led[[first, last]] = q[[first, last]]
    return led


def _rates(q: Array, time: Array) -> Array:
    """Return rates of a run from rest to rest. Shape (k, nq)."""
    rate = np.gradient(q, time, axis=0)
    rate[[0, -1]] = 0.0
    return np.asarray(rate)


def _measure(task: PlanTask, q: Array, time: Array, motion: ServoMotion) -> tuple[float, float]:
    """Return 95th percentile and greatest distance of the executed loaded tip across the path of the cut. [m]"""
    rate = np.zeros_like(q)
    for first, last in cutting_runs(np.zeros(len(q), bool), task.rests):
        rate[first : last + 1] = _rates(q[first : last + 1], time[first : last + 1])
    at = np.arange(0.0, float(time[-1]) + motion.cycle, motion.cycle)
    reached = follow_command(CubicHermiteSpline(time, q, rate)(np.minimum(at, time[-1])), motion)
    when = np.clip(at - float(motion.lag.mean()), 0.0, time[-1])
    row = np.clip(np.searchsorted(time, when), 1, len(time) - 1)
    cut = task.cut[row] & task.cut[row - 1]
    far: list[Array] = []
    for rows in np.array_split(np.flatnonzero(cut), max(1, int(cut.sum()) // BLOCK)):
        load = interpolate(when[rows], time, task.wrench)
        bias = None if task.bias is None else interpolate(when[rows], time, task.bias)
        tip = attain_pose(task.chain, reached[rows], load, slope=False, torque_bias=bias).position
        near = find_nearest(task.position, row[rows], tip, SIDE)[0]
        far.append(np.linalg.norm(tip - near, axis=1))
    distance = np.concatenate(far)
    return float(np.percentile(distance, 95)), float(distance.max())
