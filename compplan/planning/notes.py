"""Notes of a plan: questions about the job, assumptions, and where and why the feed is reduced."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.joint_convention import locate_pendant
from compplan.io.notes import Stop
from compplan.io.tables import Array
from compplan.job.job import Job
from compplan.planning.checks import Check, state_notes
from compplan.planning.stability import describe_depth_limit
from compplan.planning.task import Command, PlanTask, cutting_runs
from compplan.planning.timing import Timing
from compplan.robot import Robot, load_robot
from compplan.robot.mounting import name_axis, outward_axis
from compplan.uncertainty.motion import Motion, greatest_shift

#: Deflection by inertia above which a note is written, as a share of the tolerance.
NOTED_SHARE = 0.1
#: Force models of a turning tool.
TURNING = ("milling", "end_mill", "drill")


def list_notes(
    task: PlanTask, command: Command, timing: Timing, motion: Motion | None, job: Job | None
) -> tuple[Check, ...]:
    """Return the notes of a plan, as failed checks."""
    notes = [*task.nominal.notes, "" if task.law is None else task.law.note]
    if job is not None:
        notes += [describe_spindle(task, job), "" if job.part.fit is None else job.part.fit.tell()]
        if job.tool is not None:
            notes += check_tool(job, job.context.mounted or load_robot(job.robot, relative_to=job.folder))
        notes.append(check_spindle(task.nominal.axis, job))
        if job.tool is not None and job.tool.mass_kg is None:
            notes.append("The weight of the tool is unknown ([tool] has no mass_kg) and left out.")
    notes.append(describe_inertia(task, motion, job))
    if task.start is not None and task.start.settings.scene is not None:
        notes += task.start.settings.scene.notes
    notes += [describe_causes(task, timing), "" if job is None else describe_outside(job)]
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


def describe_spindle(task: PlanTask, job: Job) -> str:
    """Note that a CAM file does not start the spindle of a cut; "" if it does."""
    turned = any(event.kind in ("spindle_cw", "spindle_ccw") for event in task.nominal.events)
    read = isinstance(job.toolpath, str) and not job.toolpath.lower().endswith(".csv")
    if job.process.model not in TURNING or not read or turned or job.output.templates:
        return ""
    return Stop("The CAM file never starts the spindle (no M3 or M4), so the programs do not: start it before the cut, "
                "or write lines that do into a template ([output] templates).")  # fmt: skip


#: Angle between tool and flange above which a note questions the tool. [deg]
SIDEWAYS = 60.0
#: Flange-tip distance below which no tool direction is inferred. [m]
SHORT = 0.02
#: Tool length as a share of the reach above which a note questions it; usual tools have a fifth (assumed).
LONG = 0.5


def check_tool(job: Job, robot: Robot) -> list[str]:
    """Question a sideways tool without a mesh, a very long one, or an unconfirmed pendant frame."""
    assert job.tool is not None
    pose, out = job.tool.locate_frame(robot) @ job.tool.pose, outward_axis(robot)
    length, notes = float(np.linalg.norm(pose[:3, 3])), list[str]()
    pendant = locate_pendant(robot) if job.tool.frame == "pendant" else None
    if pendant is not None and not pendant.confirmed:
        notes.append(Stop(
            f"The tool frame of the pendant of {robot.name} is not confirmed ({pendant.source}): jog along +x of tool "
            f"0 and check the direction against compplan doctor {robot.name}."
        ))  # fmt: skip
    if length > LONG * robot.longest_reach:
        notes.append(Stop(
            f"The tool is {1e3 * length:.4g} mm long, the arm's links end to end {1e3 * robot.longest_reach:.4g} mm: "
            "little of the wrist's turning is left at such a tip. Is tool.position_mm in mm?"
        ))  # fmt: skip
    angle, offset = _angle(out, pose[:3, 2]), _angle(out, pose[:3, 3]) if length > SHORT else 0.0
    drawn = job.collision is not None and job.collision.tool is not None
    if max(angle, offset) > SIDEWAYS and not drawn:
        text = (f"The tool points {angle:.3g} deg away from" if angle > SIDEWAYS
                else f"The tip lies {offset:.3g} deg aside of")  # fmt: skip
        notes.append(Stop(f"{text} the direction {name_axis(out)} in which the flange of {robot.name} points: is that "
                          f"right? compplan init --robot {robot.name} writes a straight tool."))  # fmt: skip
    return notes


def check_spindle(axis: Array, job: Job) -> str:
    """Question a path with the spindle always on the -z side of the part. axis: base axes, shape (n, 3)."""
    if not len(axis) or float((axis @ job.T_base_part[:3, 2]).max()) > -np.cos(np.radians(SIDEWAYS)):
        return ""
    return Stop("The spindle is on the side of -z of the part frame all along. Is z of the part reversed, or i j k of "
                "the toolpath?")  # fmt: skip


def _angle(a: Array, b: Array) -> float:
    """Compute the angle between two directions. [deg]"""
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def describe_outside(job: Job) -> str:
    """List templates outside the job's folder, links resolved, since programs contain their lines; "" for none."""
    home = (job.folder if job.file.is_file() else Path.cwd()).resolve()
    files = {name: (job.folder / text).resolve() for name, text in job.output.templates.items()}
    listed = "; ".join(f"{name} = {path}" for name, path in files.items() if not path.is_relative_to(home))
    return Stop(f"Templates outside the job's folder go into the programs: {listed}.") if listed else ""


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


def find_least_feed(task: PlanTask, timing: Timing) -> tuple[float, float] | None:
    """Return the least feed where limits reduce it, and the programmed one there; None if they do not. [m/s]"""
    slow = np.flatnonzero(mark_slow(task, timing))
    if not len(slow):
        return None
    least = slow[timing.feed[slow].argmin()]
    return float(timing.feed[least]), float(task.nominal.feed[least])


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
