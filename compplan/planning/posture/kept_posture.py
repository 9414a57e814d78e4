"""Keep how an arm stands along a path: branch, rotation about the tool axis, full turns and extra axes.

A robot folder that a diagnosis or an update wrote is the same machine: its plan keeps the posture that the job's own
robot chooses, and a program that exists already is kept on request. The joints are solved anew around the posture that
is kept; where that fails a posture is chosen, and the change is told.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import CompplanError, InputError
from compplan.io.columns import FileColumn
from compplan.io.tables import read_table
from compplan.job.job import KEEP_NOTHING, KEEP_ROBOT, Job
from compplan.planning.posture.follow import REACHED, reach_tip_and_axis, turn_about_axis
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.start import find_start, name_along
from compplan.planning.posture.summary import Start, summarise_costs
from compplan.robot import Array, Robot, load_robot
from compplan.robot.folder import find_robot_folder
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, pose_error, refine_ik
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath, interpolate

#: Rows of a program that bring the correction in or out; the others follow the path.
BESIDE = ("approach", "retract")
#: A kept program is of this path where their lengths differ by less than this share.
SAME_LENGTH = 0.02
#: Two folders whose joints stand nearer than this are of one machine (assumed: measured geometry differs by
#: millimetres). [m], and the same for axes [rad]
SAME_PLACE, SAME_AXIS = 0.05, 0.1


class Kept(NamedTuple):
    """A posture along a path."""

    length: Array  #: Length of the path at each row. Shape (m,). [m]
    axis: Array  #: Tool axis, tip to spindle, base axes. Shape (m, 3).
    q: Array  #: Joint positions. Shape (m, nq). [rad or m]
    source: str  #: Where it comes from, in words.


def read_lock(job: Job, robot: Robot) -> Robot | Kept | None:
    """Read whose posture a job keeps ([plan] keep): another model of the same machine, a program, or nothing.

    Raises:
        InputError: If the program is not one of this robot, its tool mounted.
    """
    keep = job.plan.keep
    if keep == KEEP_NOTHING:
        return None
    if keep != KEEP_ROBOT:
        return read_program(job.folder / keep, robot)
    try:
        folder = find_robot_folder(job.context.own_robot or job.robot, job.folder)
    except CompplanError:
        return None  # another robot stands in for one that is not there
    if robot.folder is None or folder.resolve() == robot.folder.resolve():
        return None
    own = load_robot(folder)
    own = own if job.tool is None else job.tool.mount(own)
    return own if is_same_machine(own, robot) else None


def read_program(path: Path, robot: Robot) -> Kept:
    """Read the posture of an earlier plan from its joints.csv, or the folder that holds it.

    Raises:
        InputError: If there is no such file, or it is not what a plan writes for this robot.
    """
    file = path / "joints.csv" if path.is_dir() else path
    if not file.is_file():
        raise InputError("no such file, expected joints.csv of an earlier plan, or its folder", file=file)
    wanted = [FileColumn(name, "length", True) for name in "xyz"] + [FileColumn(name, "number", True) for name in "ijk"]
    joints = [FileColumn(f"q{n}", "length" if slides else "angle", True) for n, slides in enumerate(robot.prismatic, 1)]
    table = read_table(file, [*wanted, *joints, FileColumn("move", "text")], unknown="note")
    along = ~np.isin(table.text["move"], BESIDE) if "move" in table else np.ones(len(table), bool)
    numbers = table.stack([*"xyz", *"ijk", *(column.name for column in joints)])
    if along.sum() < 2 or not np.isfinite(numbers).all():
        raise table.error("a kept program has at least two rows along the path, every number given")
    numbers = numbers[along]
    steps = np.linalg.norm(np.diff(numbers[:, :3], axis=0), axis=1)
    return Kept(np.r_[0.0, np.cumsum(steps)], numbers[:, 3:6], numbers[:, 6:], str(file))


def is_same_machine(one: Robot, other: Robot) -> bool:
    """Tell whether two folders describe one machine: the same joints, at nearly the same places."""
    if one.joint_names != other.joint_names or len(one.joints) != len(other.joints):
        return False
    for a, b in zip(one.joints, other.joints, strict=True):
        gap = np.linalg.inv(a.placement) @ b.placement
        turn = np.arccos(np.clip(0.5 * (np.trace(gap[:3, :3]) - 1.0), -1.0, 1.0))
        if np.linalg.norm(gap[:3, 3]) > SAME_PLACE or turn > SAME_AXIS:
            return False
    return True


def find_kept_start(
    robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings, lock: Robot | Kept | None
) -> Start:
    """Find where a plan starts, the posture kept where a lock says so; arguments as of `find_start`.

    Raises:
        InputError: If a kept program is of another path, or no waypoint is reached.
    """
    if lock is None:
        return find_start(robot, nominal, tool_x, settings)
    if isinstance(lock, Kept):
        source, start = lock.source, _follow_program(lock, nominal, tool_axes(nominal, tool_x), settings)
    else:
        source = f"robot {lock.name!r}"
        try:
            start = find_start(lock, nominal, tool_x, settings)
        except InputError:
            return find_start(robot, nominal, tool_x, settings)
    kept = _stand_again(robot, start)
    lost = np.flatnonzero(kept.missed & ~start.missed)
    if len(lost):
        anew = find_start(robot, nominal, tool_x, settings)
        if anew.missed.sum() < kept.missed.sum():
            told = f"The posture of {source} cannot be kept, it does not reach waypoint {lost[0]} with {robot.name!r}."
            return replace(anew, notes=(told, *anew.notes))
    return replace(kept, notes=(*kept.notes, f"The posture is kept: that of {source}."))


def _follow_program(program: Kept, nominal: Toolpath, rotation: Array, settings: PostureSettings) -> Start:
    """Lay a program's posture along a path, the rotation still the path's.

    Raises:
        InputError: If the path is longer or shorter than the program's.
    """
    ends = float(program.length[-1]), float(nominal.arc_length[-1])
    if abs(ends[0] - ends[1]) > SAME_LENGTH * max(*ends, 1e-9):
        raise InputError(
            f"program {program.source} follows a path of {1e3 * ends[0]:.5g} mm, the job's is {1e3 * ends[1]:.5g} mm "
            "long; keep the program of this path, or none", where="plan.keep",
        )  # fmt: skip
    place, length = nominal.arc_length * (ends[0] / max(ends[1], 1e-12)), program.length
    near, upright = interpolate(place, length, program.q), None
    if settings.lead > 0 or settings.lean > 0:
        axis = interpolate(place, length, program.axis)
        axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        rotation = tilt_tool(rotation, axis)
        upright, nominal = nominal.axis, replace(nominal, axis=axis)
    missed = np.zeros(len(nominal), bool)
    return Start(nominal, near, rotation, {}, missed, settings, of_program=True, upright=upright)


def tilt_tool(rotation: Array, axis: Array) -> Array:
    """Lean TCP frames (n, 3, 3) by the least rotation that points their tool axis, against z, along axis (n, 3)."""
    before = -rotation[:, :, 2]
    across = np.cross(before, axis)
    angle = np.arctan2(np.linalg.norm(across, axis=1), np.einsum("ni,ni->n", before, axis))
    turn = across / np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None] * angle[:, None]
    return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ rotation)


def _stand_again(robot: Robot, start: Start) -> Start:
    """Solve the joints of a robot around a start; what it does not reach there is missed."""
    arm, nominal, rotation = build_arm(robot), start.nominal, start.rotation
    near, free = start.q, start.settings.free_spin
    if robot.nq < 6:
        q, reached = reach_tip_and_axis(arm, near, nominal.position, rotation, spin_free=free or robot.nq == 5)
        rotation = locate_frames(arm.chain, q).tcp_rotation
    else:
        if start.of_program and free:
            rotation = turn_about_axis(locate_frames(arm.chain, near).tcp_rotation[:, :, 0], nominal.axis)
        q = refine_ik(arm, near, nominal.position, rotation, iterations=30)
        reached = np.abs(pose_error(arm.chain, q, nominal.position, rotation)).max(axis=1) < REACHED
    inside = ((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9)).all(axis=1)
    missed: NDArray[np.bool_] = ~(reached & inside)
    words = name_along(robot, q) or start.configuration
    posture_choice = start.posture_choice
    if posture_choice is not None and not missed.any():
        costs = summarise_costs(PostureProblem(robot, nominal, np.zeros(3), posture_choice.settings), q)
        posture_choice = replace(posture_choice, q=q, costs=costs)
    return replace(start, q=np.clip(q, robot.lower, robot.upper), rotation=rotation, missed=missed,
                   configuration=words, posture_choice=posture_choice)  # fmt: skip
