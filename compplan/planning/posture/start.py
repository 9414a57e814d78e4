"""Initial posture of a plan: result of the ladder graph, or posture of another model of the same machine.

Where no posture path covers the complete toolpath, the stretches that the arm can follow are used, and a note names the
first waypoint out of reach and the limit. A robot folder written by a diagnosis or an update is the same machine: its
plan keeps the posture of the job's robot, with joints solved again near it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.errors import CompplanError, InfeasibleError, InputError
from compplan.job.job import Job
from compplan.planning.posture.choose import choose_partial, choose_plain, choose_posture_path
from compplan.planning.posture.clearance import ClearanceProfile, measure_clearance
from compplan.planning.posture.collision_scene import describe_contact
from compplan.planning.posture.follow import follow_path
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.summary import PostureSummary, Start, summarise_costs
from compplan.robot import Array, Robot, load_robot
from compplan.robot.folder import find_robot_folder
from compplan.robot.model import is_same_machine
from compplan.statics.chain import locate_frames
from compplan.statics.ik import (
    CONFIGURATIONS,
    build_arm,
    middle_of_limits,
    name_configuration,
    reach_tip_and_axis,
    solve_branches,
    solve_posture_near,
    stretch_arm,
)
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath, select_even

#: Note on robots of four joints.
FOUR_JOINTS = (
    "The robot has four joints: it cannot choose where its tool points. The tip is corrected; the tilt due to the"
    " load stays (tilt_after_deg in plan.json) and displaces points of the tool above the tip."
)
#: Waypoints tried without joint limits if none is reached within them.
TRIED_WAYPOINTS = 20


def find_start(robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings) -> Start:
    """Find the initial posture of a plan; x of the TCP points along tool_x (3,) at spin 0.

    Raises:
        InputError: If the job's start is outside the joint limits, or no waypoint is reached.
    """
    check_start(robot, settings.start)
    required = settings if settings.search else settings.keep_plain()
    problem = PostureProblem(robot, nominal, np.asarray(tool_x, float), required)
    if robot.nq < 6:
        return _follow_few_joints(problem)
    stated = settings.start is not None and not robot.prismatic[: robot.nq - 6].all()  # an arm of seven joints
    if settings.search and stated and (followed := _follow_start(problem)):
        return followed
    try:
        found = build_start(choose_posture_path(problem), nominal, settings)
        return found if settings.search else replace(found, posture_choice=None, notes=())
    except InfeasibleError as error:
        sentence = str(error)
    reason = f"{sentence[0].upper()}{sentence[1:]}."
    followed = _follow_start(problem) if settings.search else None
    return followed or find_partial(problem, reason)


def _follow(problem: PostureProblem, start: Array | None, notes: tuple[str, ...]) -> Start:
    """Follow the path from joint positions `start` (nq,), searched if None, by least joint motion."""
    robot, nominal, settings = problem.robot, problem.nominal, problem.settings
    q, missed = follow_path(problem.arm, nominal, tool_axes(nominal, problem.tool_x), start=start,
                            spin_free=robot.nq == 5 or settings.free_spin, most_step=settings.most_step)  # fmt: skip
    return Start(nominal, q, locate_frames(problem.chain, q).tcp_rotation, name_along(robot, q), missed, settings,
                 notes=notes)  # fmt: skip


def _follow_few_joints(problem: PostureProblem) -> Start:
    """Follow the path with an arm of four or five joints, along one branch."""
    robot = problem.robot
    followed = _follow(problem, None, (FOUR_JOINTS,) if robot.nq < 5 else ())
    if followed.missed.all():
        least = ", which keep the tool where it points" if robot.nq < 5 else ""
        raise InputError(
            f"robot {robot.name!r} of {robot.nq} joints{least}: reaches no waypoint of the path in one configuration; "
            "move the part, or check the frames"
        )
    return followed


def _follow_start(problem: PostureProblem) -> Start | None:
    """Follow the path from the job's start; None if it does not reach every waypoint."""
    if problem.settings.start is None or problem.settings.scene is not None:
        return None
    note = "Postures follow from the job's start, with the least motion of the joints to each waypoint."
    followed = _follow(problem, problem.settings.start, (note,))
    return None if followed.missed.any() else followed


def check_start(robot: Robot, start: Array | None) -> None:
    """Check the start joint positions of a job.

    Raises:
        InputError: If their number is not that of the joints, or one is outside its limits.
    """
    if start is None:
        return
    if len(start) != robot.nq:
        raise InputError(f"start has {len(start)} joint positions, the robot has {robot.nq}", where="plan.start_deg")
    for j in np.flatnonzero((start < robot.lower) | (start > robot.upper)):
        scale, unit = (1e3, "mm") if robot.prismatic[j] else (180 / np.pi, "deg")
        limits = f"[{robot.lower[j] * scale:.6g}, {robot.upper[j] * scale:.6g}]"
        name = robot.joint_names[j]
        message = f"joint {name!r} starts at {start[j] * scale:.6g} {unit}, limits {limits}"
        raise InputError(message, where="plan.start_deg")


def name_along(robot: Robot, q: Array) -> dict[str, str]:
    """Return the most frequent configuration of a motion."""
    arm = build_arm(robot)
    return CONFIGURATIONS[int(np.bincount(name_configuration(arm, q)).argmax())] if len(arm.arm) == 6 else {}


def build_start(posture_choice: PostureSummary, nominal: Toolpath, settings: PostureSettings) -> Start:
    """Build the start of a plan from the posture of the graph."""
    leaning = settings.lead > 0 or settings.lean > 0
    path = replace(nominal, axis=posture_choice.axis) if leaning else nominal
    words = tuple(
        f"The arm changes its configuration from {before} to {after} before waypoint {waypoint}."
        for waypoint, before, after in posture_choice.changes
    )
    return Start(
        path, posture_choice.q, posture_choice.rotation, posture_choice.configuration, posture_choice.missed,
        settings, posture_choice, words, programmed_axis=nominal.axis if leaning else None,
    )  # fmt: skip


def check_clearance(start: Start | None, q: Array) -> tuple[ClearanceProfile | None, dict[int, str]]:
    """Compute the clearance of a command, and describe violations by waypoint."""
    if start is None or start.settings.scene is None:
        return None, {}
    wanted = start.settings.clearance
    profile = measure_clearance(start.settings.scene, q, wanted)
    near = {
        int(waypoint): f"clearance ({describe_contact(contact)})"
        for waypoint, contact in zip(profile.computed, profile.contacts, strict=True)
        if contact.distance < wanted - 1e-4
    }
    if profile.own.first and profile.own.distance <= 0:
        near.setdefault(profile.own_waypoint, f"clearance ({describe_contact(profile.own)})")
    return profile, near


def find_plain(problem: PostureProblem, start: Start) -> Start | None:
    """Return the start with one configuration and the x axis of the tool as programmed.

    None if it is the graph's choice already, or infeasible.
    """
    if start.posture_choice is None or start.posture_choice.plain:
        return None
    plain = choose_plain(replace(problem, settings=start.settings), start.posture_choice)
    return None if plain is None else build_start(replace(plain, plain=False), problem.nominal, start.settings)


def find_partial(problem: PostureProblem, reason: str) -> Start:
    """Find a start with the stretches that the arm can follow, without collision checks; `reason`: why not all.

    Raises:
        InputError: If no waypoint is reached.
    """
    nominal, found = problem.nominal, choose_partial(problem)
    if found is None:
        return _start_nearest(problem)
    if not found.missed.any():
        start = build_start(found, nominal, problem.settings)
        return replace(start, notes=(f"{reason} The posture is that without anything in the way.", *start.notes))
    return _note_missed(problem, Start(nominal, found.q, found.rotation, found.configuration, found.missed,
                                      problem.settings))  # fmt: skip


def _start_nearest(problem: PostureProblem) -> Start:
    """Find the start nearest to a path that the arm reaches only beyond its joint limits.

    Raises:
        InputError: If it is out of reach without joint limits too, or the job requires a configuration.
    """
    nominal, arm = problem.nominal, problem.arm
    rotation, some = tool_axes(nominal, problem.tool_x), select_even(np.arange(len(nominal)), TRIED_WAYPOINTS)
    beyond = solve_branches(arm, nominal.position[some], rotation[some])
    if problem.settings.configuration or not np.isfinite(beyond).any():
        raise InputError(_explain_reach(problem))
    q = np.tile(middle_of_limits(problem.robot), (len(nominal), 1))
    q, _ = reach_tip_and_axis(arm, q, nominal.position, rotation, spin_free=problem.settings.free_spin,
                              every_joint=True)  # fmt: skip
    missed = np.ones(len(nominal), bool)
    return _note_missed(problem, Start(nominal, q, rotation, name_along(problem.robot, q), missed, problem.settings))


def _note_missed(problem: PostureProblem, start: Start) -> Start:
    """Add a note on the joint limits, or the reach of the arm, that exclude the first missed waypoint of a start."""
    robot, missed, nominal = problem.robot, start.missed, start.nominal
    first = np.flatnonzero(missed)[:1]
    best, _ = reach_tip_and_axis(problem.arm, start.q[first], nominal.position[first], start.rotation[first],
                                 spin_free=problem.settings.free_spin, every_joint=True)  # fmt: skip
    lower, upper = robot.arm_limits
    room = np.minimum(best[0] - lower, upper - best[0])
    at = np.flatnonzero(room < np.where(robot.prismatic, 1e-3, problem.settings.limit_room))
    named = [f"{'lower' if best[0, j] - lower[j] < upper[j] - best[0, j] else 'upper'} position limit of "
             f"{robot.joint_names[j]}" for j in at[:2]]  # fmt: skip
    text = f"{' and '.join(named) or 'the reach of the arm'} {'stop' if len(named) > 1 else 'stops'} it"
    stops = f"{text}; `compplan place` looks for a place of the part within reach"
    sentence = (f"{missed.sum()} of {len(missed)} waypoints of the toolpath are out of reach, the first is {first[0]} "
                f"({1e3 * nominal.arc_length[first[0]]:.0f} mm along the path): {stops}.")  # fmt: skip
    return replace(start, notes=(*start.notes, sentence), cause=stops)


def _explain_reach(problem: PostureProblem) -> str:
    """Explain why no waypoint is reached."""
    arm, words = problem.arm, problem.settings.configuration
    if words and choose_partial(replace(problem, settings=replace(problem.settings, configuration={}))) is not None:
        wanted = ", ".join(words.values())
        return f"configuration {wanted} reaches no waypoint, other configurations do; leave it to 'auto'"
    q = middle_of_limits(problem.robot)[None]
    first = locate_frames(arm.chain, q).origin[:, arm.chain.joint_elements[arm.arm[0]]]
    distance = float(np.linalg.norm(problem.nominal.position - first, axis=1).min())
    where = (
        f"its nearest waypoint is {distance:.2f} m from the first axis, the stretched arm {stretch_arm(arm):.2f} m long"
    )
    return f"the part is out of reach in position or orientation of the tool: {where}; move [part] or turn the tool"


def read_lock(job: Job, robot: Robot) -> Robot | None:
    """Return the robot whose posture a job keeps ([plan] keep): another model of the same machine, or None."""
    if job.plan.keep == "nothing":
        return None
    try:
        folder = find_robot_folder(job.context.own_robot or job.robot, job.folder)
    except CompplanError:
        return None  # another robot replaces a missing one
    if robot.folder is None or folder.resolve() == robot.folder.resolve():
        return None
    own = load_robot(folder)
    own = own if job.tool is None else job.tool.mount(own)
    return own if is_same_machine(own, robot) else None


def find_kept_start(
    robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings, lock: Robot | None
) -> Start:
    """Find the initial posture as `find_start`, but with the posture of the robot `lock` if given.

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
            note = f"The posture of {source} cannot be kept, it does not reach waypoint {lost[0]} with {robot.name!r}."
            return replace(anew, notes=(note, *anew.notes))
    return replace(kept, notes=(*kept.notes, f"The posture is kept: that of {source}."))


def _solve_again(robot: Robot, start: Start) -> Start:
    """Solve the joints of a robot near a start; waypoints not reached there are missed."""
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
