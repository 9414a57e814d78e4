"""Keep how an arm stands along a path: branch, rotation about the tool axis, full turns and extra axes.

A robot folder that a diagnosis or an update wrote is the same machine: its plan keeps the posture that the job's own
robot chooses. The joints are solved anew around the posture that is kept; where that fails a posture is chosen, and the
change is told.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.errors import CompplanError, InputError
from compplan.job.job import Job
from compplan.planning.posture.follow import solve_posture_near
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.start import find_start, name_along
from compplan.planning.posture.summary import Start, summarise_costs
from compplan.robot import Array, Robot, load_robot
from compplan.robot.folder import find_robot_folder
from compplan.statics.ik import build_arm
from compplan.toolpath.toolpath import Toolpath

#: Two folders whose joints stand nearer than this are of one machine (assumed: measured geometry differs by
#: millimetres). [m], and the same for axes [rad]
SAME_PLACE, SAME_AXIS = 0.05, 0.1


def read_lock(job: Job, robot: Robot) -> Robot | None:
    """Read whose posture a job keeps ([plan] keep): that of another model of the same machine, or of none."""
    if job.plan.keep == "nothing":
        return None
    try:
        folder = find_robot_folder(job.context.own_robot or job.robot, job.folder)
    except CompplanError:
        return None  # another robot stands in for one that is not there
    if robot.folder is None or folder.resolve() == robot.folder.resolve():
        return None
    own = load_robot(folder)
    own = own if job.tool is None else job.tool.mount(own)
    return own if is_same_machine(own, robot) else None


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
    robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings, lock: Robot | None
) -> Start:
    """Find where a plan starts, the posture kept where a lock says so; arguments as of `find_start`.

    Raises:
        InputError: If no waypoint is reached.
    """
    if lock is None:
        return find_start(robot, nominal, tool_x, settings)
    source = f"robot {lock.name!r}"
    try:
        start = find_start(lock, nominal, tool_x, settings)
    except InputError:
        return find_start(robot, nominal, tool_x, settings)
    kept = _solve_again(robot, start)
    lost = np.flatnonzero(kept.missed & ~start.missed)
    if len(lost):
        anew = find_start(robot, nominal, tool_x, settings)
        if anew.missed.sum() < kept.missed.sum():
            told = f"The posture of {source} cannot be kept, it does not reach waypoint {lost[0]} with {robot.name!r}."
            return replace(anew, notes=(told, *anew.notes))
    return replace(kept, notes=(*kept.notes, f"The posture is kept: that of {source}."))


def _solve_again(robot: Robot, start: Start) -> Start:
    """Solve the joints of a robot around a start; what it does not reach there is missed."""
    nominal, free = start.nominal, start.settings.free_spin or robot.nq == 5
    q, rotation, reached = solve_posture_near(
        build_arm(robot), start.q, nominal.position, start.rotation, spin_free=free
    )
    missed = ~reached
    words = name_along(robot, q) or start.configuration
    posture_choice = start.posture_choice
    if posture_choice is not None and not missed.any():
        costs = summarise_costs(PostureProblem(robot, nominal, np.zeros(3), posture_choice.settings), q)
        posture_choice = replace(posture_choice, q=q, costs=costs)
    return replace(start, q=np.clip(q, robot.lower, robot.upper), rotation=rotation, missed=missed,
                   configuration=words, posture_choice=posture_choice)  # fmt: skip
