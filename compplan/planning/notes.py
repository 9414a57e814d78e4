"""Notes of a plan: assumptions, and where and why the feed is reduced."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.job.job import Job
from compplan.job.questions import question_job
from compplan.planning.checks import Check, state_notes
from compplan.planning.stability import describe_depth_limit
from compplan.planning.task import Command, PlanTask, cutting_runs
from compplan.planning.timing import Timing
from compplan.uncertainty.motion import Motion, greatest_shift

#: Deflection by inertia above which a note is written, as a share of the tolerance.
NOTED_SHARE = 0.1


def list_notes(
    task: PlanTask, command: Command, timing: Timing, motion: Motion | None, job: Job | None
) -> tuple[Check, ...]:
    """Return the notes of a plan, as failed checks."""
    notes = [*task.nominal.notes, "" if task.law is None else task.law.note]
    notes += [] if job is None else question_job(job, task.nominal)
    notes.append(describe_inertia(task, motion, job))
    if task.start is not None and task.start.settings.scene is not None:
        notes += task.start.settings.scene.notes
    notes.append(describe_causes(task, timing))
    if not np.isfinite(task.robot.acceleration_limits).any():
        notes.append("The robot folder states no acceleration limits: times follow from velocity limits alone.")
    if conflict := command.nlp.get("conflict"):
        notes.append(f"The nonlinear program has no solution: {conflict}. The command is the best compromise.")
    return state_notes(filter(None, [*notes, describe_depth_limit(task, command.q)]))


def describe_inertia(task: PlanTask, motion: Motion | None, job: Job | None) -> str:
    """Describe the deflection by inertia if the plan does not compensate it; "" below a tenth of the tolerance."""
    inertia = 0.0 if task.inertia or motion is None else greatest_shift(motion.answer[task.cut])
    if inertia <= NOTED_SHARE * task.tolerance:
        return ""
    text, masses = ", the 95 % band counts it", task.robot.sources.get("masses", "not stated in the folder")
    if task.missed.any():
        text = ", parts of the path are out of reach"
    elif job is not None and not job.plan.inertia:
        text = ", with [plan] inertia = true it does"
    return (f"The inertia of the motion bends the arm by up to {1e3 * inertia:.2g} mm (masses: {masses}); the plan "
            f"does not compensate it{text}.")  # fmt: skip


#: Time from both ends of a cut in which acceleration from and to rest is ignored, in smoothing times.
FROM_END = 4.0
#: Most stretches listed in a sentence.
LISTED = 5


def mark_slow(task: PlanTask, timing: Timing) -> NDArray[np.bool_]:
    """Mark the waypoints where limits reduce the feed, except for acceleration from and to rest. Shape (n,)."""
    middle = np.r_[timing.time[0], 0.5 * (timing.time[1:] + timing.time[:-1])]  # middle of the move that has the feed
    away = np.zeros(len(task), bool)
    for first, last in cutting_runs(task.nominal.rapid | task.lead):
        run = slice(first, last + 1)
        away[run] = np.minimum(middle[run] - timing.time[first], timing.time[last] - middle[run]) > (
            FROM_END * task.smoothing
        )
    slow = timing.lowered & away
    adjacent = np.r_[False, slow[:-1]] | np.r_[slow[1:], False]  # a single waypoint is due to rounding
    return np.asarray(slow & adjacent)


def find_least_feed(task: PlanTask, timing: Timing) -> tuple[float, float, str] | None:
    """Return the least feed where limits reduce it, the programmed one there [m/s], and why; None if they do not."""
    slow = np.flatnonzero(mark_slow(task, timing))
    if not len(slow):
        return None
    least = slow[timing.feed[slow].argmin()]
    joint, limit = int(timing.limiting[least]), "velocity" if timing.by_velocity[least] else "acceleration"
    cause = f"{limit} limit of {task.robot.joint_names[joint]}" if joint >= 0 else "corner, or to keep the run smooth"
    return float(timing.feed[least]), float(task.nominal.feed[least]), cause


def find_top_feed(task: PlanTask, timing: Timing) -> float | None:
    """Return the greatest feed of the cuts that never reach the programmed one; None if all reach it. [m/s]"""
    runs = cutting_runs(task.nominal.rapid | task.lead)
    short = [timing.feed[a + 1 : b + 1].max() for a, b in runs if timing.lowered[a + 1 : b + 1].all()]
    return float(max(short)) if short else None


def describe_causes(task: PlanTask, timing: Timing) -> str:
    """Describe where and how far the feed is reduced, and the limits reached there; "" if it is not reduced."""
    slow = np.flatnonzero(mark_slow(task, timing))
    if not len(slow):
        top = find_top_feed(task, timing)
        short = "in a cut this short, between speeding up and slowing down"
        return "" if top is None else f"The programmed feed is not reached: at most {1e3 * top:.3g} mm/s {short}."
    spans, least = np.split(slow, np.flatnonzero(np.diff(slow) > 1) + 1), int(slow[timing.share[slow].argmin()])
    listed = ", ".join(f"{span[0]}-{span[-1]}" for span in spans[:LISTED]) + (", ..." if len(spans) > LISTED else "")
    reached = {(int(timing.limiting[k]), bool(timing.by_velocity[k])) for k in slow if timing.limiting[k] >= 0}
    causes = [f"by the {'velocity' if fast else 'acceleration'} limit of {task.robot.joint_names[joint]}"
              for joint, fast in sorted(reached)]  # fmt: skip
    causes += ["at corners, where the tool comes to rest"] if task.rests.any() else []
    return (f"The feed is lowered at {len(slow)} waypoints ({listed}), down to {100 * timing.share[least]:.3g} % at "
            f"waypoint {least}: {', '.join([*causes, 'to keep the run smooth'])}."
            )  # fmt: skip
