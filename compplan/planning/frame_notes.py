"""What is asked about tool and part before a plan is trusted: which way they point, how long the tool is."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.controllers.writers.joint_convention import load_controller
from compplan.controllers.writers.pendant import locate_pendant
from compplan.io.notes import Stop
from compplan.io.tables import Array
from compplan.job.job import Job
from compplan.planning.task import PlanTask
from compplan.robot import Robot, load_robot
from compplan.robot.mounting import mounted_tool, name_axis, outward_axis

#: Angle between tool and flange from which on the tool is asked about. [deg]
SIDEWAYS = 60.0
#: A tip nearer to the flange than this says nothing of a direction. [m]
SHORT = 0.02
#: Share of the reach (base axis to wrist) beyond which a tool is asked about; robots carry tools of a fifth (assumed).
LONG = 0.5


def describe_frames(task: PlanTask, job: Job | None) -> list[str]:
    """Ask about a tool across the flange or too long and a spindle below the part; say how a part frame was fitted."""
    if job is None:
        return []
    notes = [] if job.part.fit is None else [job.part.fit.tell()]
    if job.tool is None:
        return [*notes, *look_at_spindle(task.nominal.axis, job)]
    robot = job.mounted or load_robot(job.robot, relative_to=job.folder)
    return [*notes, *ask_about_tool(job, robot), *ask_about_form(job, robot), *look_at_spindle(task.nominal.axis, job)]


def describe_part_frame(job: Job) -> str:
    """Return in a sentence how the part frame was found, and what deviations are relative to."""
    if not job.touched_off:
        return "part frame: absolute in the robot base ([part] touched_off = false)"
    points = job.part.touched_points
    where = "three corners of the box of the cut" if points is None else f"the {len(points)} points of [part]"
    return (f"part frame: touched off with this robot and tool at {where}; deviations and the 95 % band are relative "
            "to it ([part] touched_off = false: the frame is absolute)")  # fmt: skip


def ask_about_tool(job: Job, robot: Robot) -> list[str]:
    """Ask about a tool that leaves the flange sideways, where no mesh of it says that it does, or is very long."""
    if job.tool is None:
        return []
    pose, out = job.tool.locate_tcp(robot), outward_axis(robot)
    length = float(np.linalg.norm(pose[:3, 3]))
    notes: list[str] = []
    if length > LONG * robot.longest_reach:
        notes.append(Stop(
            f"The tool is {1e3 * length:.4g} mm long, the arm's links end to end {1e3 * robot.longest_reach:.4g} mm: "
            "little of the wrist's turning is left at such a tip. Is tool.position_mm in mm?"
        ))  # fmt: skip
    if job.collision is not None and job.collision.tool is not None:
        return notes
    angle = _angle(out, pose[:3, 2])
    aside = _angle(out, pose[:3, 3]) if length > SHORT else 0.0
    if max(angle, aside) <= SIDEWAYS:
        return notes
    said = (f"The tool points {angle:.3g} deg away from" if angle > SIDEWAYS
            else f"The tip lies {aside:.3g} deg aside of")  # fmt: skip
    return [*notes, Stop(f"{said} the direction {name_axis(out)} in which the flange of {robot.name} looks: is that "
                         f"so? {_straight(robot, length or 0.1)}")]  # fmt: skip


def _straight(robot: Robot, length: float) -> str:
    """Say how a straight tool of a length is written, in the pendant's frame where that is known."""
    pendant = locate_pendant(robot)
    if pendant is not None and pendant.stated:
        z = [0.0, 0.0, round(1e3 * length, 3)]
        return f'A straight one has frame = "pendant", position_mm = {z}, as the teach pendant shows it.'
    turn = Rotation.from_matrix(mounted_tool(robot)[:3, :3]).as_rotvec(degrees=True).round(3) + 0.0
    place = (1e3 * length * outward_axis(robot)).round(3).tolist()
    return f"A straight one has position_mm = {place}, rotation_deg = {turn.tolist()}."


def ask_about_form(job: Job, robot: Robot) -> list[str]:
    """Ask about angles in the form of another maker, and about a pendant frame that nobody confirmed."""
    notes: list[str] = []
    maker = load_controller(robot).name
    for name, table in (("tool", job.tool), ("part", job.part)):
        if table is not None and table.abc_deg is not None and "Doosan" in maker:
            notes.append(
                Stop(f"{name}.abc_deg are KUKA's A B C (z, y', x''); those of a Doosan turn z, y', z'': zyz_deg.")
            )
    found = locate_pendant(robot) if job.tool is not None and job.tool.frame == "pendant" else None
    if found is not None and not found.confirmed:
        notes.append(Stop(
            f"How the pendant of {robot.name} counts tools is not confirmed ({found.source}): jog along +x of tool 0 "
            f"and see whether the flange goes where compplan doctor {robot.name} says."
        ))  # fmt: skip
    return notes


def look_at_spindle(axis: Array, job: Job) -> list[str]:
    """Ask about a path whose spindle stands on the side of -z of the part all along. axis: base axes, shape (n, 3)."""
    up = job.T_base_part[:3, 2]
    if not len(axis) or float((axis @ up).max()) > -np.cos(np.radians(SIDEWAYS)):
        return []
    return [
        Stop("The spindle looks away from the part all along: it stands on the side of -z of the part frame. Is z of "
             "the part turned over, or i j k of the toolpath?")
    ]  # fmt: skip


def _angle(a: Array, b: Array) -> float:
    """Return the angle between two directions. [deg]"""
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
