"""Run a window of a log as a model has it, and tell what of the log that explains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from compplan.controllers.motion.align import find_nearest
from compplan.controllers.motion.drives import follow_command, lag_command
from compplan.controllers.motion.geometry import follow_path
from compplan.controllers.motion.timing import schedule_path
from compplan.controllers.motion.windows import Window
from compplan.controllers.writers.motion_table import ServoMotion
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import Arm

#: Cycle at which windows are run. [s]
CYCLE = 0.004
#: Time to either side among which the nearest point of a run is taken. [s]
NEAR = 0.04


@dataclass(frozen=True)
class WindowRun:
    """A window as a model executes it."""

    command: Array  #: Joints that are commanded. Shape (k, nq). [rad or m]
    q: Array  #: Joints that the drives reach. Shape (k, nq). [rad or m]
    at: Array  #: Where every row of the window is in it, in rows of the run. Shape (n,).

    @cached_property
    def here(self) -> tuple[Array, Array]:
        """Joints and their change a row of the run at the rows of the window. Shape (n, nq) twice."""
        return read_run(self.q, self.at)


def run_window(window: Window, motion: ServoMotion, arm: Arm) -> WindowRun:
    """Execute a window and find its rows in the run: where the path's length is theirs, then nearest in the joints."""
    if window.latest.get("motion") is motion:  # a step that was taken is looked at again for its slopes
        return window.latest["run"]
    model = replace(motion, cycle=CYCLE)
    path = window.path(arm, motion.blend_share)
    schedule = schedule_path(path, model)
    still = np.arange(1, 1 + int(0.2 / CYCLE))
    s = np.r_[schedule.s, np.full(len(still), schedule.s[-1])]
    command = follow_path(path, s)
    q = follow_command(command, model)
    at = np.interp(window.lengths(arm, motion.blend_share), s + 1e-9 * np.arange(len(s)), np.arange(len(s)))
    run = WindowRun(command, q, _match_rows(window, q, at + float(motion.lag.mean()) / CYCLE))
    window.latest.update(motion=motion, run=run)
    return run


def _match_rows(window: Window, q: Array, at: Array) -> Array:
    """Move the rows along a run to where their joints, weighed by what they move at the tip, are nearest to it."""
    for _ in range(4):
        here, slope = read_run(q, at)
        slope = slope * window.leverage
        gap = (window.q - here) * window.leverage
        size = (slope**2).sum(axis=1)
        step = (gap * slope).sum(axis=1) / np.maximum(size, 1e-16)
        at = np.clip(at + np.where(size > 1e-12, np.clip(step, -15.0, 15.0), 0.0), 0.0, len(q) - 1.0)
    return at


def read_run(q: Array, at: Array) -> tuple[Array, Array]:
    """Return joints and their change a row at places of a run. Shape (n,) -> (n, nq) twice."""
    i = np.clip(at.astype(int), 1, len(q) - 3)
    u = (at - i)[:, None]
    before, here, after, last = q[i - 1], q[i], q[i + 1], q[i + 2]
    c1, c2 = 0.5 * (after - before), before - 2.5 * here + 2 * after - 0.5 * last
    c3 = 0.5 * (last - before) + 1.5 * (here - after)
    return here + u * (c1 + u * (c2 + u * c3)), c1 + u * (2 * c2 + 3 * u * c3)


def find_residual(window: Window, run: WindowRun) -> Array:
    """Return what rows are beside a run, across it, in joints weighed by their leverage. Shape (n, nq). [m]."""
    here, slope = run.here
    gap, slope = (window.q - here) * window.leverage, slope * window.leverage
    return drop_along(gap, slope)


def drop_along(gap: Array, slope: Array) -> Array:
    """Take what lies along a direction out of vectors. Shape (n, k)."""
    size = np.maximum((slope**2).sum(axis=1), 1e-16)
    return np.asarray(gap - ((gap * slope).sum(axis=1) / size)[:, None] * slope)


def locate_beside(window: Window, run: WindowRun, q: Array, arm: Arm) -> Array:
    """Return the point of a run's tip that is nearest to every row. Shape (n, 3). [m]."""
    tip = locate_frames(arm.chain, q).tcp_position
    index = np.round(run.at).astype(int)
    return find_nearest(tip, index, window.tip + window.torn_by, round(NEAR / CYCLE))[0]


def measure_left(window: Window, motion: ServoMotion, arm: Arm) -> Array:
    """Return the distance of every row, torn or not, across the executed path of a model. Shape (n,). [m]."""
    run = run_window(window, motion, arm)
    return np.asarray(np.linalg.norm(window.tip + window.torn_by - locate_beside(window, run, run.q, arm), axis=1))


def divide_gap(window: Window, motion: ServoMotion, arm: Arm) -> dict[str, Array]:
    """Divide what rows are beside the programmed path among its causes.

    Every cause is the step from one executed path to the next at its nearest points: blends, then lag, then lost
    motion; torn readings are what putting them right moved.

    Returns:
        By cause, and `gap` for all of it. Shape (n, 3) each. [m]
    """
    run = run_window(window, motion, arm)
    lagged = lag_command(run.command, motion.lag, motion.acceleration_lag, CYCLE)
    shift = float(motion.lag.mean()) / CYCLE
    early = replace(run, at=np.maximum(run.at - shift, 0.0))
    seen = replace(window, torn_by=np.zeros_like(window.torn_by))
    blended = locate_beside(seen, early, run.command, arm)
    lagging, reached = locate_beside(seen, run, lagged, arm), locate_beside(seen, run, run.q, arm)
    return {
        "gap": window.tip + window.torn_by - window.point,
        "lag": lagging - blended,
        "blend": blended - window.point,
        "jitter": window.torn_by,
        "lost_motion": reached - lagging,
    }
