"""Where a plan starts: the posture that the ladder graph chooses, or one fixed configuration where it finds none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.errors import InfeasibleError, InputError
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.clearance import ClearanceProfile, measure_clearance
from compplan.planning.posture.configuration import choose_posture, solve_default_posture
from compplan.planning.posture.contacts import describe_contact
from compplan.planning.posture.follow import follow_from, follow_path
from compplan.planning.posture.partial import find_partial
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.summary import PostureSummary, Start
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import CONFIGURATIONS, build_arm, name_configuration
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath

#: What a robot of four joints cannot do.
FOUR_JOINTS = (
    "The robot has four joints: it cannot choose where its tool points. The tip is corrected; what the load leans the"
    " tool stays (tilt_after_deg in plan.json), and points of the tool above the tip are aside by it."
)


#: By what finished postures are compared, in words.
COMPARED = {"driven_s": "time", "band_mm": "95 % band", "joint_travel_deg": "joint motion"}
#: Postures whose measures differ by less than this share tie.
TIED = 1e-3


def find_start(robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings) -> Start:
    """Find where a plan starts, x of the TCP pointing along tool_x (3,) at no rotation about the tool axis.

    Raises:
        InputError: If the wanted start lies outside the joint limits, or no waypoint is reached.
    """
    if robot.nq < 6:
        return _follow_few_joints(robot, nominal, tool_x, settings)
    note: tuple[str, ...] = ()
    if settings.search:
        problem = PostureProblem(robot, nominal, np.asarray(tool_x, float), settings)
        stated = settings.start is not None and not robot.prismatic[: robot.nq - 6].all()  # where seven axes stand
        if stated and (followed := _follow_start(problem)):
            return followed
        try:
            return stand(choose_posture_path(problem), nominal, settings)
        except InfeasibleError as error:
            sentence = str(error)
        reason = f"{sentence[0].upper()}{sentence[1:]}."
        if settings.scene is not None:
            blind = find_start(robot, nominal, tool_x, replace(settings, scene=None))
            if blind.posture_choice is not None:
                said = f"{reason} The posture is that without anything in the way."
                return replace(blind, settings=settings, notes=(said, *blind.notes))
        if instead := _follow_start(problem) or find_partial(problem):
            return instead
        note = (f"{reason} One configuration is kept instead, and x of the TCP frame points along plan.tool_x all the"
                " way.",)  # fmt: skip
    rotation = tool_axes(nominal, tool_x)
    posture = choose_posture(robot, nominal.position, rotation, words=settings.configuration, start=settings.start)
    return Start(nominal, posture.q, rotation, posture.configuration, posture.missed, settings, notes=note)


def _follow_few_joints(robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings) -> Start:
    """Follow the path with an arm of four or five joints, along one branch."""
    arm, free = build_arm(robot), robot.nq == 5 or (settings.search and settings.free_spin)
    q, missed = follow_path(arm, nominal.position, tool_axes(nominal, tool_x), spin_free=free)
    if missed.all():
        least = ", which keep the tool where it points" if robot.nq < 5 else ""
        raise InputError(
            f"robot {robot.name!r} of {robot.nq} joints{least}: reaches no waypoint of the path in one configuration; "
            "move the part, or check the frames"
        )
    note = (FOUR_JOINTS,) if robot.nq < 5 else ()
    return Start(nominal, q, locate_frames(arm.chain, q).tcp_rotation, {}, missed, settings, notes=note)


def _follow_start(problem: PostureProblem) -> Start | None:
    """Go on from the job's start by the least motion of all joints; None where that does not lead along the path."""
    robot, nominal, settings = problem.robot, problem.nominal, problem.settings
    if settings.start is None or settings.scene is not None:
        return None
    q, missed = follow_from(
        robot, problem.chain, nominal.position, tool_axes(nominal, problem.tool_x), settings.start,
        free_spin=settings.free_spin, most_step=settings.most_step,
    )  # fmt: skip
    if missed.any():
        return None
    told = "The motion goes on from the job's start, every waypoint by the least motion of the joints."
    return Start(nominal, q, locate_frames(problem.chain, q).tcp_rotation, name_along(robot, q), missed, settings,
                 notes=(told,), of_program=True)  # fmt: skip


def name_along(robot: Robot, q: Array) -> dict[str, str]:
    """Name the configuration along most of a motion."""
    arm = build_arm(robot)
    return CONFIGURATIONS[int(np.bincount(name_configuration(arm, q)).argmax())] if len(arm.arm) == 6 else {}


def stand(posture_choice: PostureSummary, nominal: Toolpath, settings: PostureSettings) -> Start:
    """Start where the graph stands."""
    leaning = settings.lead > 0 or settings.lean > 0
    path = replace(nominal, axis=posture_choice.axis) if leaning else nominal
    words = tuple(
        f"The arm changes its configuration from {before} to {after} before waypoint {waypoint}."
        for waypoint, before, after in posture_choice.changes
    )
    if len(compared := posture_choice.compared) > 1:
        cost, unit = COMPARED[posture_choice.compared_by], posture_choice.compared_by.rpartition("_")[2]
        said = f"the {len(compared)} postures that were compared tie at a {cost} of {min(compared.values()):.4g} {unit}"
        if max(compared.values()) > (1.0 + TIED) * min(compared.values()):
            listed = ", ".join(f"{name} {value:.4g} {unit}" for name, value in compared.items())
            said = f"of the postures that were compared the one of the least {cost} is driven ({listed})"
        words += (f"Preset {posture_choice.settings.preset}: {said}.",)
    return Start(
        path, posture_choice.q, posture_choice.rotation, posture_choice.configuration, posture_choice.missed,
        settings, posture_choice, words, upright=nominal.axis if leaning else None,
    )  # fmt: skip


def check_clearance(start: Start | None, q: Array) -> tuple[ClearanceProfile | None, dict[int, str]]:
    """Measure the clearance of a command; also tell the waypoints that come too near, and what is in the way."""
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


def find_plain(robot: Robot, nominal: Toolpath, tool_x: Array, start: Start) -> Start | None:
    """Start with one configuration and the tool's x as the job has it, in place of what the graph chose.

    None where the graph chose it already, or it cannot be kept.
    """
    if start.posture_choice is None or start.posture_choice.instead_of is not None:
        return None
    problem = PostureProblem(robot, nominal, tool_x, start.settings)
    posture_choice = solve_default_posture(problem, start.posture_choice)
    return None if posture_choice is None else stand(replace(posture_choice, instead_of=None), nominal, start.settings)
