"""Where a plan starts: the posture that the ladder graph chooses, or what is kept where it finds none.

Where no posture leads along a whole path, each stretch whose waypoints are within reach is chosen for by itself, the
longest first. The first waypoint that fails is named with what stops it, and with a shift of the part that was tried
and found to bring the whole path within reach.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InfeasibleError, InputError
from compplan.planning.posture.choose import NODE_BUDGET, choose_posture_path
from compplan.planning.posture.clearance import ClearanceProfile, measure_clearance
from compplan.planning.posture.collision_scene import describe_contact
from compplan.planning.posture.configuration import choose_posture, find_nearest_rows, solve_default_posture
from compplan.planning.posture.follow import follow_from, follow_path, reach_with_all, turn_about_axis
from compplan.planning.posture.lattice import build_options, fill_lattice, pick_stations
from compplan.planning.posture.settings import PostureProblem, PostureSettings
from compplan.planning.posture.summary import PostureSummary, Start
from compplan.robot import Array, Robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import CONFIGURATIONS, build_arm, name_configuration
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import Toolpath, pick_even, select_waypoints

#: What a robot of four joints cannot do.
FOUR_JOINTS = (
    "The robot has four joints: it cannot choose where its tool points. The tip is corrected; what the load leans the"
    " tool stays (tilt_after_deg in plan.json), and points of the tool above the tip are aside by it."
)


#: By what finished postures are compared, in words.
COMPARED = {"driven_s": "time", "band_mm": "95 % band", "joint_travel_deg": "joint motion"}
#: Postures whose measures differ by less than this share tie.
TIED = 1e-3
#: Stretches that are chosen for, the shortest one [waypoints], and attempts on each.
STRETCHES, SHORTEST, ATTEMPTS = 4, 5, 4
#: Rounds in which the end of a stretch is looked for more finely, and waypoints looked at in each.
ROUNDS, LOOKED_AT = 3, 8
#: Shifts of the part that are tried, in shares of how far the tip misses; steps in which they are told. [m]
SHIFTS, STEP = (1.1, 1.5, 2.2, 3.5), 0.01
#: Waypoints that a shift is tried at first, failing and kept; shifts whose whole path is tried then.
FAILING, KEPT, TRIED = 12, 8, 3
#: A coarser grid that decides what is within reach. [rad]
COARSE = float(np.radians(15.0))
#: Letters of the sentence at most.
LONGEST = 300


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
            return build_start(choose_posture_path(problem), nominal, settings)
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


def build_start(posture_choice: PostureSummary, nominal: Toolpath, settings: PostureSettings) -> Start:
    """Build the start of a plan from the posture that the graph chose."""
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
    return (
        None
        if posture_choice is None
        else build_start(replace(posture_choice, instead_of=None), nominal, start.settings)
    )


def find_partial(problem: PostureProblem) -> Start | None:
    """Keep the stretches of a path that an arm can follow, whatever is in the way; None where there is none."""
    asked, problem = problem.settings, replace(problem, settings=replace(problem.settings, scene=None))
    nominal, n = problem.nominal, len(problem.nominal)
    stretches = (_choose_stretch(problem, first, last) for first, last in _find_stretches(problem)[:STRETCHES])
    found = [stretch for stretch in stretches if stretch is not None]
    q, rotation, missed = np.full((n, problem.robot.nq), np.nan), np.empty((n, 3, 3)), np.ones(n, bool)
    for first, posture_choice in found:
        rows = slice(first, first + len(posture_choice.q))
        q[rows], rotation[rows], missed[rows] = posture_choice.q, posture_choice.rotation, posture_choice.missed
    if missed.all():
        return None
    lost = np.flatnonzero(np.isnan(q[:, 0]))
    near = find_nearest_rows(np.flatnonzero(np.isfinite(q[:, 0])), lost)
    q[lost], rotation[lost] = q[near], turn_about_axis(rotation[near][:, :, 0], nominal.axis[lost])
    longest = max(found, key=lambda entry: len(entry[1].q))[1]
    mend, first = _say(problem, q, rotation, missed), int(np.flatnonzero(missed)[0])
    sentence = (f"{missed.sum()} of {n} waypoints of the toolpath are out of reach, the first is {first} "
                f"(s = {1e3 * nominal.arc_length[first]:.0f} mm): {mend}")  # fmt: skip
    return Start(nominal, q, rotation, longest.configuration, missed, asked, notes=(f"{sentence[:LONGEST]}.",),
                 of_program=True, mend=mend)  # fmt: skip


def find_reached(problem: PostureProblem, rows: NDArray[np.int_]) -> NDArray[np.bool_]:
    """Tell which waypoints have a posture within the limits, on a coarse grid. Shape (k,)."""
    step = max(problem.settings.spin_step, COARSE)
    coarse = replace(problem, settings=replace(problem.settings, spin_step=step))
    lattice = fill_lattice(coarse, rows, build_options(coarse, rows))
    return np.asarray(lattice.usable.any(axis=(1, 2)))


def _find_stretches(problem: PostureProblem) -> list[tuple[int, int]]:
    """List stretches (first, last waypoint) whose waypoints are within reach, longest first."""
    options = build_options(problem, np.zeros(1, int)).spin.shape[1]
    rows = pick_stations(problem.nominal, int(np.clip(2 * NODE_BUDGET // options, 60, problem.settings.stations)))
    reached = find_reached(problem, rows)
    for _ in range(ROUNDS):
        edges = np.flatnonzero(np.diff(reached.astype(int)))
        more = [np.linspace(rows[e], rows[e + 1], LOOKED_AT + 2).astype(int)[1:-1] for e in edges[:LOOKED_AT]]
        new = np.setdiff1d(np.concatenate(more), rows) if more else np.zeros(0, int)
        if not len(new):
            break
        seen = find_reached(problem, new)
        order = np.argsort(np.r_[rows, new], kind="stable")
        rows, reached = np.r_[rows, new][order], np.r_[reached, seen][order]
    ends = np.flatnonzero(np.diff(np.r_[0, reached.astype(int), 0]))
    spans = [(int(rows[a]), int(rows[b - 1])) for a, b in zip(ends[::2], ends[1::2], strict=True)]
    return sorted((s for s in spans if s[1] - s[0] >= SHORTEST), key=lambda s: s[0] - s[1])


def _choose_stretch(problem: PostureProblem, first: int, last: int) -> tuple[int, PostureSummary] | None:
    """Choose for a stretch; where no motion leads along it, for its longer part."""
    for _ in range(ATTEMPTS):
        if last - first < SHORTEST:
            return None
        part = select_waypoints(problem.nominal, np.arange(first, last + 1))
        try:
            return first, choose_posture_path(replace(problem, nominal=part))
        except InfeasibleError as error:
            stops = first + min(error.waypoints, default=0)
        if stops - first >= last - stops:
            last = stops - 1
        else:
            first = stops + 1
    return None


def _say(problem: PostureProblem, q: Array, rotation: Array, missed: NDArray[np.bool_]) -> str:
    """Name what stops the first waypoint that fails, and the shift of the part that mends it."""
    robot, chain, settings, position = problem.robot, problem.chain, problem.settings, problem.nominal.position
    failing = np.flatnonzero(missed)
    some = pick_even(failing, FAILING)
    best, _ = reach_with_all(
        robot, chain, q[some], position[some], rotation[some], free_spin=settings.free_spin, draw=False
    )
    miss = position[some] - locate_frames(chain, best).tcp_position
    lower, upper = robot.arm_limits
    room = np.minimum(best[0] - lower, upper - best[0])
    at = np.flatnonzero(room < np.where(robot.prismatic, 1e-3, settings.limit_room))
    named = [f"{'lower' if best[0, j] - lower[j] < upper[j] - best[0, j] else 'upper'} position limit of "
             f"{robot.joint_names[j]}" for j in at]  # fmt: skip
    text = f"{' and '.join(named[:2]) or 'the reach of the arm'} {'stop' if len(named) > 1 else 'stops'} it"
    shift = _find_shift(problem, some, np.flatnonzero(~missed), miss)
    if shift is None:
        most = 1e3 * float(np.linalg.norm(miss, axis=1).max())
        return f"{text}; no shift of the part by some {most:.0f} mm along one axis mends it"
    k = int(np.abs(shift).argmax())
    mends = f"with the part moved by {1e3 * shift[k]:+.0f} mm along {'xyz'[k]} of the base all is reached (tried)"
    return f"{text}; {mends}"


def _find_shift(
    problem: PostureProblem, failing: NDArray[np.int_], kept: NDArray[np.int_], miss: Array
) -> Array | None:
    """Return a shift of the part along one axis with which the whole path is followed, or None. Shape (3,). [m]"""
    rows = np.union1d(failing, pick_even(kept, KEPT))
    size, tried = max(float(np.linalg.norm(miss, axis=1).max()), STEP), 0
    mean = miss.mean(axis=0)
    directions = sorted((sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)), key=lambda d: float(mean @ d))
    for share in SHIFTS:
        length = np.ceil(share * size / STEP) * STEP
        for direction in directions:
            path = replace(problem.nominal, position=problem.nominal.position + length * direction)
            moved = replace(problem, nominal=path)
            if not find_reached(moved, rows).all():
                continue
            tried += 1
            try:
                if not choose_posture_path(moved).missed.any():
                    return np.asarray(length * direction)
            except InfeasibleError:
                pass
            if tried >= TRIED:
                return None
    return None
