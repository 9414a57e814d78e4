"""Feed requirements of a process: constant feed, joint torques within their limits.

A constant feed is the highest that is feasible at every waypoint of the cut: with q(s) along the path and feed f,

    |q'| f <= v_max,    |q''| f^2 <= a_max;

the tool still starts and stops at rest. Sharp corners limit the feed: `compplan.toolpath.corners` rounds them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from compplan.planning.task import PlanTask, cutting_runs
from compplan.planning.timing import Timing, parameter_steps, time_command
from compplan.robot import Array
from compplan.simulation.torque import TorqueRules


def time_run(task: PlanTask, q: Array, slow: Array | None = None) -> tuple[PlanTask, Timing, tuple[str, ...]]:
    """Compute the timing of a command (n, nq); `slow` (n,): required slowdown factors, or None.

    Returns:
        The task with its final programmed feed, the timing, and notes for the user.
    """
    notes, rules = list[str](), None
    if task.constant_feed:
        feed, note = find_constant_feed(task, q)
        notes += [note] if note else []
        task = program_feed(task, feed)
    if task.torque_limits:
        rules = TorqueRules(task.robot, q, task.wrench)
        notes += rules.notes
    return task, time_command(task, q, rules=rules, slow=slow, keep=task.constant_feed), tuple(notes)


def find_constant_feed(task: PlanTask, q: Array) -> tuple[float, str]:
    """Find the highest feed [m/s] feasible at every waypoint of a command (n, nq), at most the lowest programmed one.

    Returns the feed, and a note on the limit that reduces it, "" if none.
    """
    cutting = ~task.nominal.rapid & (task.nominal.feed > 0)
    cutting[0] = False
    programmed = float(task.nominal.feed[cutting].min())
    even = program_feed(task, programmed)
    best, note = programmed, ""
    apart = even.nominal.rapid | even.lead  # lead-ins and lead-outs are at rest
    apart[0] = False
    for start, end in cutting_runs(apart):
        if end - start < 2:
            continue
        along = np.r_[0.0, np.cumsum(parameter_steps(even, q, start, end))]
        spline = CubicSpline(along, q[start : end + 1], bc_type="not-a-knot" if end - start > 2 else "natural")
        shares = {
            "velocity": task.velocity_limits / np.maximum(np.abs(spline(along, 1)), 1e-12),
            "acceleration": np.sqrt(task.acceleration_limits / np.maximum(np.abs(spline(along, 2)), 1e-12)),
        }
        for kind, share in shares.items():
            k, j = np.unravel_index(int(np.argmin(share)), share.shape)
            if programmed * share[k, j] < best:
                best = float(programmed * share[k, j])
                note = (f"One feed for the whole cut: {1e3 * best:.4g} mm/s instead of {1e3 * programmed:.4g}, held "
                        f"down by the {kind} limit of {task.robot.joint_names[int(j)]} at waypoint {start + k}."
                        )  # fmt: skip
    return best, note


def program_feed(task: PlanTask, feed: float) -> PlanTask:
    """Return the task with one feed [m/s] for all cutting moves."""
    nominal = replace(task.nominal, feed=np.where(task.nominal.rapid, task.nominal.feed, feed))
    cutting = ~task.nominal.rapid[1:]
    times = np.where(cutting, nominal.steps / feed, task.step_time)
    return replace(task, nominal=nominal, step_time=np.asarray(times))
