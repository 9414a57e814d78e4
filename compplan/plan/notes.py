"""What a user should know of a plan: where the feed is lowered and why, where the arm swings over, what is assumed."""

from __future__ import annotations

import itertools

import numpy as np

from compplan.cell.forces import RECORDED
from compplan.job.job import Job
from compplan.plan.bending import Bending
from compplan.plan.coupling import CouplingEffect
from compplan.plan.task import PlanTask
from compplan.plan.timing import Timing

#: Share of the tolerance from which on the inertia of the motion is told.
WORTH_A_NOTE = 0.1
#: A joint that moves more than this between two waypoints of a cut swings over. [rad or m]
SWING = 0.5


def group_waypoints(waypoints: list[int]) -> list[tuple[int, int]]:
    """Group waypoints into spans (first, last)."""
    breaks = [0, *(k for k in range(1, len(waypoints)) if waypoints[k] != waypoints[k - 1] + 1), len(waypoints)]
    return [(waypoints[a], waypoints[b - 1]) for a, b in itertools.pairwise(breaks) if b > a]


def tell_coupling(effect: CouplingEffect | None) -> tuple[str, ...]:
    """Say what it makes of the uncorrected tip that the force depends on where the tool is, and where that fails."""
    if effect is None:
        return ()
    left, settled = " / ".join(f"{100 * share:.3g}" for share in effect.left), effect.settled
    (before, _), (after, _) = effect.without_size, effect.coupled_size
    note = (f"The force depends on where the tool is ({effect.source}): of the uncorrected deviation {left} % are left "
            f"in x / y / z of the base, {1e3 * after:.3g} mm (rms) in place of {1e3 * before:.3g} mm; "
            f"{settled.passes} passes, ratio {settled.ratio:.2g}.")  # fmt: skip
    return (note,) if settled.agrees else (note, settled.explain())


def list_notes(task: PlanTask, timing: Timing, bending: Bending, job: Job | None) -> tuple[str, ...]:
    """Say what the reader of the path noted, where the feed had to be lowered, where the arm swings over, and more."""
    notes = [*task.nominal.notes, *([task.law.note] if task.law is not None and task.law.note else [])]
    if job is not None and job.process.model in RECORDED:
        reason = RECORDED[job.process.model]
        notes.append(f"The judge takes the wrench of {job.process.model!r} as the planner recorded it: {reason}.")
    if job is not None and job.process.model == "end_mill":
        asks = "judges it" if job.stability.judge else "judges it where the job has a table [stability]"
        notes.append(f"Whether the cut chatters is not part of this plan: compplan forces {asks}.")
    if job is not None and job.tool is not None and job.tool.mass_kg is None:
        notes.append("The weight of the tool is not known: [tool] says no mass_kg, so none bends the arm.")
    if not task.inertia and bending.inertia > WORTH_A_NOTE * task.tolerance:
        notes.append(
            f"The inertia of the motion bends the arm by up to {1e3 * bending.inertia:.2g} mm "
            f"(masses: {bending.masses}); the plan does not compensate it, with [plan] inertia = true it does."
        )
    scene = task.start.request.scene if task.start is not None and task.start.request is not None else None
    if scene is not None and scene.note:
        notes.append(scene.note)
    notes += _tell_margin(task)
    spans = find_slow_spans(task, timing)
    if spans:
        count = sum(last - first + 1 for first, last in spans)
        rows = np.concatenate([np.arange(first, last + 1) for first, last in spans])
        least = rows[timing.share[rows].argmin()]
        listed = ", ".join(f"{first}-{last}" for first, last in spans[:5]) + (", ..." if len(spans) > 5 else "")
        notes.append(
            f"The feed is lowered at {count} waypoints ({listed}), down to {100 * timing.share[least]:.3g} % "
            f"at waypoint {least} by {_name_cause(task, timing, int(least))}."
        )
    swings = (np.abs(np.diff(task.q_start, axis=0)).max(axis=1) > SWING) & ~task.nominal.rapid[1:]
    for waypoint in (np.flatnonzero(swings) + 1)[:3].tolist():
        notes.append(f"The posture swings over in the move to waypoint {waypoint}: near a singularity.")
    if not np.isfinite(task.robot.acceleration_limits).any():
        notes.append("The robot folder states no acceleration limits: times follow from velocity limits alone.")
    return tuple(notes)


def _tell_margin(task: PlanTask) -> list[str]:
    """Say where the posture comes nearer to a joint limit than was asked for, and which limit that is."""
    stance = None if task.start is None else task.start.stance
    turning = np.flatnonzero(~task.robot.prismatic)
    if stance is None or not len(turning):
        return []
    room = np.minimum(task.q_start - task.robot.lower, task.robot.upper - task.q_start)[:, turning]
    row, column = np.unravel_index(int(room.argmin()), room.shape)
    kept, asked = float(room[row, column]), stance.settings.limit_margin
    if kept >= 0.99 * asked:
        return []
    joint = int(turning[column])
    low = task.q_start[row, joint] - task.robot.lower[joint] < task.robot.upper[joint] - task.q_start[row, joint]
    return [
        f"The posture comes within {np.degrees(kept):.3g} deg of the {'lower' if low else 'upper'} limit of "
        f"{task.robot.joint_names[joint]} at waypoint {row}; posture.limit_margin_deg asks for "
        f"{np.degrees(asked):.3g}: "
        + ("the way found keeps it at its stations, not between them."
           if stance.keeps_margin else "no way along the path keeps it.")
    ]


def find_slow_spans(task: PlanTask, timing: Timing) -> list[tuple[int, int]]:
    """Find spans of waypoints where limits lower the feed; starting up and coming to rest do not count."""
    lowered = timing.lowered & ~task.nominal.rapid
    rest = task.nominal.rapid | task.lead | np.isin(np.arange(len(task)), (0, len(task) - 1))
    spans = []
    for first, last in group_waypoints(np.flatnonzero(lowered).tolist()):
        change = np.diff(timing.share[first : last + 1])
        if rest[max(first - 1, 0) : first + 1].any():
            first += int(np.argmax(np.r_[change < 0, True]))
        if rest[last : last + 2].any():
            last -= int(np.argmax(np.r_[change[::-1] > 0, True]))
        if first < last:
            spans.append((first, last))
    return spans


def _name_cause(task: PlanTask, timing: Timing, waypoint: int) -> str:
    near = slice(max(waypoint - 1, 0), waypoint + 2)
    joint = timing.limiting[near][timing.limiting[near] >= 0]
    if not len(joint):
        return "rate limits nearby"
    kind = "velocity" if timing.by_velocity[waypoint] else "acceleration"
    return f"the {kind} limit of {task.robot.joint_names[joint[0]]}"
