"""What a user should know of a plan: where the feed is lowered and why, where the arm swings over, what is assumed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compplan.io.notes import Stop
from compplan.job.job import Job
from compplan.planning.deflection import Bending
from compplan.planning.frame_notes import describe_frames
from compplan.planning.outside import describe_outside
from compplan.planning.run_timing import Timing
from compplan.planning.slow import describe_causes
from compplan.planning.task import PlanTask
from compplan.robot import Robot
from compplan.robot.soft_limits import describe_soft_limits

#: Share of the tolerance from which on the inertia of the motion is told.
WORTH_A_NOTE = 0.1
#: How readers note drilling cycles that they do not cut.
LEFT_OUT = "left out: the tool moves rapidly above the holes"
#: Force models of a turning tool.
TURNING = ("milling", "end_mill", "drill")
#: A joint that moves more than this between two waypoints of a cut swings over. [rad or m]
SWING = 0.5


def describe_shrinkage(robot: Robot, share: float) -> str:
    """Say that parts of the robot folder may not hold along the path, and what the plan makes of that."""
    parts = [] if robot.visited is None else robot.visited.parts
    names = ", ".join(dict.fromkeys(part.effect.replace("_", " ") for part in parts))
    return (
        f"The campaign of the robot folder does not show that its errors in doubt ({names}) hold at the poses and "
        f"loads of this path: {100.0 * share:.0f} % of them are compensated, the rest widens the 95 % band. Poses near "
        "the path, under its load, settle it: compplan campaign."
    )


def describe_left_out(notes: Sequence[str]) -> tuple[str, ...]:
    """Say that cuts of the file are in no program: a plan without them is not the plan of the file."""
    if not any(LEFT_OUT in note for note in notes):
        return ()
    return ('holes of the file are not cut, [cam] cycles = "skip" leaves them out; write cycles = "expand"',)


def list_notes(task: PlanTask, timing: Timing, bending: Bending, job: Job | None) -> tuple[str, ...]:
    """Say what the reader of the path noted, where the feed had to be lowered, where the arm swings over, and more."""
    notes = [*task.nominal.notes, *([task.law.note] if task.law is not None and task.law.note else [])]
    notes += [*describe_spindle(task, job), *describe_frames(task, job), *_describe_positioner(task.robot, job)]
    if job is not None and job.tool is not None and job.tool.mass_kg is None:
        notes.append("The weight of the tool is not known: [tool] says no mass_kg, so none bends the arm.")
    if not task.inertia and bending.inertia > WORTH_A_NOTE * task.tolerance:
        asked = job is None or job.plan.inertia
        reason = "parts of the path are out of reach" if task.missed.any() else "with [plan] inertia = true it does"
        said = ", the 95 % band counts it" if asked and not task.missed.any() else f", {reason}"
        notes.append(
            f"The inertia of the motion bends the arm by up to {1e3 * bending.inertia:.2g} mm "
            f"(masses: {bending.masses}); the plan does not compensate it{said}."
        )
    scene = task.start.request.scene if task.start is not None and task.start.request is not None else None
    notes += scene.notes if scene is not None else ()
    notes += _describe_margin(task)
    slow = describe_causes(task, timing)
    notes += [slow] if slow else []
    swings = (np.abs(np.diff(task.q_start, axis=0)).max(axis=1) > SWING) & ~task.nominal.rapid[1:]
    for waypoint in (np.flatnonzero(swings) + 1)[:3].tolist():
        notes.append(Stop(f"The posture swings over in the move to waypoint {waypoint}: near a singularity."))
    if job is not None and (told := describe_outside(job, task.robot)):
        notes.append(told)
    notes += _ask_about_x(task, job)
    if told := describe_soft_limits(task.robot):
        notes.append(f"{told[0].upper()}{told[1:]}.")
    if not np.isfinite(task.robot.acceleration_limits).any():
        notes.append("The robot folder states no acceleration limits: times follow from velocity limits alone.")
    return tuple(notes)


def describe_spindle(task: PlanTask, job: Job | None) -> list[str]:
    """Say that nothing turns the spindle of a cut that comes from a CAM file."""
    if job is None or job.process.model not in TURNING or not isinstance(job.toolpath, str):
        return []
    if job.toolpath.lower().endswith(".csv") or job.output.header:
        return []
    if any(event.kind in ("spindle_cw", "spindle_ccw") for event in task.nominal.events):
        return []
    return [
        Stop("The CAM file never starts the spindle (no M3 or M4), so the programs do not: start it before the cut, "
             "or name lines that do in [output] header.")
    ]  # fmt: skip


def _ask_about_x(task: PlanTask, job: Job | None) -> list[str]:
    """Say that a stated x of the TCP frame means nothing where it points along the tool axis."""
    if job is None or "tool_x" not in job.plan.model_fields_set:
        return []
    wanted = np.asarray(job.tool_x_base, float)
    across = np.linalg.norm(np.cross(task.nominal.axis, wanted / np.linalg.norm(wanted)), axis=1)
    if across.max() > np.sin(np.radians(1.0)):
        return []
    return ["plan.tool_x points along the tool axis, so it says nothing: the rotation about the axis is chosen freely."]


def _describe_positioner(robot: Robot, job: Job | None) -> list[str]:
    """Say what carries the part, what holds still, and what is taken for granted of it."""
    if not robot.ground:
        return []
    names = [joint.name for joint in robot.actuated[: int(robot.carriers.sum())]]
    held = [] if job is None else [*job.positioner.hold_deg, *job.positioner.hold_mm]
    stays = f" (held: {', '.join(held)})" if held else ""
    return [
        f"The part is carried by {', '.join(names)}{stays}: poses and deviations count from {robot.base}. It is taken "
        "as rigid under the part, whose weight nobody states, and as true as its model."
    ]


def _describe_margin(task: PlanTask) -> list[str]:
    """Say where the posture comes nearer to a joint limit than was asked for, and which limit that is."""
    stance = None if task.start is None else task.start.stance
    turning = np.flatnonzero(~task.robot.prismatic & ~task.robot.carriers)
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
        + (
            "the way found keeps it at its stations, not between them."
            if stance.keeps_margin
            else "no way along the path keeps it."
        )
    ]
