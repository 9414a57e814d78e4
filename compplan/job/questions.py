"""Questions about a job that is probably not meant as it is: tool, spindle, part frame, templates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compplan.controllers.writers.joint_convention import locate_pendant
from compplan.io.notes import Stop
from compplan.job.job import Job
from compplan.job.tools import CUTTERS
from compplan.robot import Array, Robot, load_robot
from compplan.robot.mounting import name_axis, outward_axis
from compplan.toolpath.toolpath import Toolpath

#: Angle between tool and flange above which a note questions the tool. [deg]
SIDEWAYS = 60.0
#: Flange-tip distance below which no tool direction is inferred. [m]
SHORT = 0.02
#: Tool length as a share of the reach above which a note questions it; usual tools have a fifth (assumed).
LONG = 0.5


def question_job(job: Job, nominal: Toolpath) -> list[str]:
    """Return the questions about a job and its path in the base frame, one sentence each; "" for none."""
    notes = [describe_spindle(nominal, job), "" if job.part.fit is None else job.part.fit.tell()]
    if job.tool is not None:
        notes += check_tool(job, job.context.mounted or load_robot(job.robot, relative_to=job.folder))
    notes.append(check_spindle(nominal.axis, job))
    if job.tool is not None and job.tool.mass_kg is None:
        notes.append("The weight of the tool is unknown ([tool] has no mass_kg) and left out.")
    return [*notes, describe_outside(job)]


def describe_spindle(nominal: Toolpath, job: Job) -> str:
    """Note that a CAM file does not start the spindle of a cut; "" if it does."""
    turned = any(event.kind in ("spindle_cw", "spindle_ccw") for event in nominal.events)
    read = isinstance(job.toolpath, str) and not job.toolpath.lower().endswith(".csv")
    if job.process.model not in CUTTERS or not read or turned or job.output.templates:
        return ""
    return Stop("The CAM file never starts the spindle (no M3 or M4), so the programs do not: start it before the cut, "
                "or write lines that do into a template ([output] templates).")  # fmt: skip


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
