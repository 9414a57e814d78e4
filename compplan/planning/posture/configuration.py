"""The plain posture: one configuration along the whole path, the tool's x axis where the job points it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.planning.posture.motion import find_torn
from compplan.planning.posture.settings import PostureProblem
from compplan.planning.posture.summary import PostureSummary, summarise_costs
from compplan.robot import Array, Robot
from compplan.statics.chain import joint_jacobian, locate_frames
from compplan.statics.ik import CONFIGURATIONS, Arm, build_arm, middle_of_limits, refine_ik, solve_branches
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import pick_even

#: Waypoints that the choice looks at; the chosen configuration is then solved at every waypoint.
SAMPLES = 400
#: A joint may move this much between neighbouring waypoints of one configuration. [rad or m]
LARGEST_STEP = 0.8
#: Distance of a rail's arm from the middle of a path, in its reach.
BESIDE = 0.6


class Posture(NamedTuple):
    """One configuration along a path."""

    q: Array  #: Joint positions that put the unloaded tool on the path. Shape (n, nq). [rad or m]
    configuration: dict[str, str]  #: Shoulder, elbow and wrist.
    #: Waypoints that the arm does not reach in this configuration within its limits; q is then the nearest that was
    #: found. Shape (n,).
    missed: NDArray[np.bool_]


def choose_posture(
    robot: Robot, position: Array, rotation: Array, *, words: Mapping[str, str] | None = None,
    start: Array | None = None,
) -> Posture:  # fmt: skip
    """Choose one configuration for a whole path (n, 3), (n, 3, 3) and solve it at every waypoint.

    `words` are those that it has to have, such as {"elbow": "up"}; `start` (nq,) [rad or m] is where it starts near.

    Of the configurations (and full turns of joints with more than one) that reach the most waypoints, the one is taken
    that keeps farthest from joint limits and singularities, or that is nearest to the start that the job gives.

    Raises:
        InputError: If the wanted start lies outside the joint limits, or if no waypoint is reached at all.
    """
    check_start(robot, start)
    arm, n, words = build_arm(robot), len(position), words or {}
    held = _hold_extra_axes(arm, position, start)
    sample = pick_even(np.arange(n), SAMPLES)
    branches = solve_branches(arm, position[sample], rotation[sample], held[sample])
    candidates = _rank_candidates(arm, branches, words, start)
    if not candidates:
        raise InputError(_explain_reach(arm, position, rotation, held, words))
    _, slot, turns = candidates[0]
    q = branches[:, slot] if n == len(sample) else solve_branches(arm, position, rotation, held)[:, slot]
    reached = np.isfinite(q[:, 0])
    if not reached.any():
        raise InputError(_explain_reach(arm, position, rotation, held, words))
    q = _unwrap(arm, q)
    sampled = _unwrap(arm, branches[:, slot])  # the whole path may begin a turn away from the sampled one
    away = np.round((sampled[np.isfinite(sampled[:, 0])][0] - q[reached][0]) / (2 * np.pi)) * 2 * np.pi
    q = q + turns + np.where(robot.prismatic, 0.0, away)
    q = _fill_missed(arm, q, reached, position, rotation)
    inside = ((q >= robot.lower - 1e-9) & (q <= robot.upper + 1e-9)).all(axis=1)
    return Posture(q, CONFIGURATIONS[slot], ~(reached & inside))


def _rank_candidates(
    arm: Arm, branches: Array, words: Mapping[str, str], start: Array | None
) -> list[tuple[float, int, Array]]:
    """List cost, slot and whole turns of every configuration that is wanted, best first."""
    ranked = []
    for slot, configuration in enumerate(CONFIGURATIONS):
        q = branches[:, slot]
        reached = np.isfinite(q[:, 0])
        wanted = all(configuration[key] == word for key, word in words.items())
        if wanted and reached.any():
            path = _unwrap(arm, q)[reached]
            ranked += [(_rate(arm, path + turns, reached.mean(), start), slot, turns)
                       for turns in _turn_variants(arm.robot, path.min(axis=0), path.max(axis=0))]  # fmt: skip
    return sorted(ranked, key=lambda entry: entry[0])


def _rate(arm: Arm, q: Array, share: float, start: Array | None) -> float:
    """Rate one way to stand; what is missed or torn outweighs everything else."""
    robot = arm.robot
    outside = np.maximum(robot.lower - q, q - robot.upper).max(axis=1) > 1e-9
    torn = (np.abs(np.diff(q, axis=0)) > LARGEST_STEP).any(axis=1)
    penalty = 1e6 * (1.0 - share * (1.0 - outside.mean())) + 1e3 * float(np.sum(torn))
    if start is not None:
        return penalty + float(np.linalg.norm(q[0] - start))
    reach = robot.upper - robot.lower
    span = np.where(np.isfinite(reach) & (reach > 0.0), reach, np.inf)  # a joint that is held uses none of its own
    usage = (2 * np.abs(q - middle_of_limits(robot)) / span).max()
    columns = joint_jacobian(arm.chain, locate_frames(arm.chain, q))[:, :, arm.arm]
    columns[:, :3] /= _reach(arm)
    kappa = np.linalg.cond(columns).max()
    return penalty + 1.0 / max(1.0 - float(usage), 0.02) + 0.05 * float(min(kappa, 1e4))


def _turn_variants(robot: Robot, low: Array, high: Array) -> list[Array]:
    """List the whole turns that keep a path from low to high (nq,) within the joint limits; else those nearest."""
    choices = []
    for j in range(robot.nq):
        fitting = [0.0]
        if not robot.prismatic[j] and np.isfinite(robot.lower[j]) and np.isfinite(robot.upper[j]):
            fewest = int(np.ceil((robot.lower[j] - low[j]) / (2 * np.pi) - 1e-9))
            most = int(np.floor((robot.upper[j] - high[j]) / (2 * np.pi) + 1e-9))
            shifts = 2 * np.pi * np.arange(-2, 3)
            excess = np.maximum(robot.lower[j] - low[j] - shifts, high[j] + shifts - robot.upper[j])
            fitting = [2 * np.pi * k for k in range(fewest, most + 1)] or [float(shifts[excess.argmin()])]
        choices.append(fitting)
    return [np.array(turns) for turns in product(*choices)]


def _unwrap(arm: Arm, q: Array) -> Array:
    """Make the reached waypoints of a configuration continuous; the others stay NaN."""
    q, reached = np.array(q), np.isfinite(q[:, 0])
    turning = ~arm.robot.prismatic
    rows = np.flatnonzero(reached)
    q[np.ix_(rows, turning)] = np.unwrap(q[np.ix_(rows, turning)], axis=0)
    return q


def _fill_missed(arm: Arm, q: Array, reached: NDArray[np.bool_], position: Array, rotation: Array) -> Array:
    """Put the arm as near as it comes where it does not reach: least squares from the nearest waypoint reached."""
    missing = np.flatnonzero(~reached)
    if not len(missing):
        return q
    rows = np.flatnonzero(reached)
    filled = np.clip(q[find_nearest_rows(rows, missing)], arm.robot.lower, arm.robot.upper)
    filled = refine_ik(arm, filled, position[missing], rotation[missing], iterations=25)
    q = q.copy()
    q[missing] = np.clip(filled, arm.robot.lower, arm.robot.upper)
    return q


def find_nearest_rows(rows: NDArray[np.int_], wanted: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return of rising rows (k,) those nearest to wanted ones (m,), the lower of two as near. Shape (m,)."""
    after = np.clip(np.searchsorted(rows, wanted), 0, len(rows) - 1)
    before = rows[np.maximum(after - 1, 0)]
    return np.where(np.abs(wanted - before) <= np.abs(rows[after] - wanted), before, rows[after])


def _hold_extra_axes(arm: Arm, position: Array, start: Array | None) -> Array:
    """Place the joints before the arm: where the job starts, or so that the path lies well within the arm's reach.

    A rail slides until the arm's first axis stands a share of its reach beside the middle of the path.
    """
    rest = middle_of_limits(arm.robot)
    if start is not None:
        rest = np.where(np.isin(np.arange(arm.chain.nq), arm.held), start, rest)
    elif len(arm.held) and arm.robot.prismatic[arm.held].all():
        for j in arm.held:
            grid = np.tile(rest, (61, 1))
            grid[:, j] = np.linspace(arm.robot.lower[j], arm.robot.upper[j], 61)
            origin = locate_frames(arm.chain, grid).origin[:, arm.chain.joint_elements[arm.arm[0]]]
            distance = np.linalg.norm((origin - position.mean(axis=0))[:, :2], axis=1)
            rest = grid[np.abs(distance - BESIDE * _reach(arm)).argmin()]
    return np.tile(rest[arm.held], (len(position), 1))


def _reach(arm: Arm) -> float:
    """Return the length of the stretched arm [m]."""
    frames = locate_frames(arm.chain, np.zeros((1, arm.chain.nq)))
    points = np.vstack([frames.origin[0, arm.chain.joint_elements[arm.arm]], frames.tcp_position])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def check_start(robot: Robot, start: Array | None) -> None:
    """Refuse joint positions to start near that the robot cannot take.

    Raises:
        InputError: If their number is not that of the joints, or one lies outside its limits.

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


def _explain_reach(arm: Arm, position: Array, rotation: Array, held: Array, words: Mapping[str, str]) -> str:
    """Say why no waypoint is reached."""
    sample = pick_even(np.arange(len(position)), 20)
    if words and np.isfinite(solve_branches(arm, position[sample], rotation[sample], held[sample])).any():
        wanted = ", ".join(words.values())
        return f"configuration {wanted} reaches no waypoint, other configurations do; leave it to 'auto'"
    q = np.zeros((len(sample), arm.chain.nq))
    q[:, arm.held] = held[sample]
    first = locate_frames(arm.chain, q).origin[:, arm.chain.joint_elements[arm.arm[0]]]
    distance = float(np.linalg.norm(position[sample] - first, axis=1).min())
    where = f"its nearest waypoint is {distance:.2f} m from the first axis, the stretched arm {_reach(arm):.2f} m long"
    return f"the part is out of reach in position or orientation of the tool: {where}; move [part] or turn the tool"


#: Waypoints of a finished line whose margin is looked at.
MARGIN_SAMPLES = 600


def solve_default_posture(problem: PostureProblem, posture_choice: PostureSummary) -> PostureSummary | None:
    """Return the plain posture in place of what the graph chose, with the settings of that.

    None where it is not reached, jumps in a cut or does not keep clear.
    """
    settings, nominal, margin = posture_choice.settings, problem.nominal, problem.margin
    rotation = tool_axes(nominal, problem.tool_x)
    try:
        plain = choose_posture(problem.robot, nominal.position, rotation, words=settings.configuration,
                               start=settings.start)  # fmt: skip
    except InputError:
        return None
    if plain.missed.any() or find_torn(plain.q, nominal, settings.most_step).any():
        return None
    rows = pick_even(np.arange(len(nominal)), MARGIN_SAMPLES)
    if margin is not None and (margin(plain.q[rows], rows) < 0).any():
        return None
    none = np.zeros(len(nominal))
    picture = replace(posture_choice.map, chosen=np.zeros(len(posture_choice.map.chosen)))
    return replace(
        posture_choice, q=plain.q, rotation=rotation, spin=none, lead=none, lean=none, changes=(), map=picture,
        configuration=plain.configuration, instead_of=posture_choice.costs,
        costs=summarise_costs(replace(problem, settings=settings), plain.q),
    )  # fmt: skip
