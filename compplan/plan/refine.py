"""The posture that the graph chose, bettered by the program of time, posture and promise; as it is where none wins."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.effects.scene import Scene
from compplan.errors import ConvergenceError, InfeasibleError
from compplan.known.assumed import known_uncertainty
from compplan.known.slopes import ForceSpread, measure_force_slopes, measure_slopes, pick_rows, stage_path
from compplan.path.contact import tool_axes
from compplan.path.toolpath import Toolpath, interpolate
from compplan.plan.bending import measure_bending
from compplan.plan.feed import FeedWish, TorqueRules, time_run
from compplan.plan.freedom import Freedom, find_freedom
from compplan.plan.one_program import Ground, Point, Prices, build_program
from compplan.plan.program_step import margin_stations, solve_program
from compplan.plan.task import PlanTask
from compplan.plan.timing import INERTIA_WINDOWS, cutting_runs, time_rapids
from compplan.posture.clearance import measure_margin
from compplan.posture.costs import Weights
from compplan.posture.lattice import build_options, fill_lattice, follow_axis, orient_tool, pick_stations
from compplan.posture.search import measure_rungs, search_line
from compplan.posture.stance import Wish
from compplan.posture.start import Bettered, PostureRequest, Start, find_start, stand
from compplan.posture.summary import Stance, summarise_costs
from compplan.promise.band import Slopes, band_radius, split_covariance
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty
from compplan.statics.ik import build_arm, pose_error, refine_ik

LOG = logging.getLogger(__name__)

#: Stations of the program at most, waypoints that they may stand for, and stations of the graph's bound.
MOST_STATIONS, MOST_WAYPOINTS, BOUND_STATIONS = 400, 8000, 50
#: Rows of the cut at which the band of a finished posture is measured.
BAND_ROWS = 120
#: Shares of the acceleration limits that are tried, so that a shorter run rings no more than the start's.
PUSHES = (1.0, 0.95, 0.9, 0.85, 0.8, 0.7)
#: Gain that a posture is changed for, and difference of time or band that counts as none.
LEAST_GAIN, SAME = 0.01, 1e-3
#: A run whose time is this near to the least that the programmed feed allows has nothing to gain.
AT_FEED = 1.02
#: A waypoint is reached where it misses the pose by less. [m and rad]
REACHED = 1e-6
#: What the program weighs by preset; a preset that is not here keeps the posture of the graph.
PRICES = {
    "fast": Prices(most_band=np.inf),
    "accurate": Prices(time=0.1, band=1.0),
    "promise": Prices(time=0.1, band=1.0),
    "": Prices(time=1.0, band=0.3),
}


@dataclass(frozen=True)
class StartChoice:
    """How starts are weighed.

    Attributes:
        robot: The robot.
        nominal: The toolpath, its tool axis as programmed.
        tool_x: Where x of the TCP points at spin 0, base axes. Shape (3,).
        stance: What is said about configuration and start.
        request: What is asked of the posture.
        wish: What the process asks of the feed.
        force: How surely the force is known.
        state: States the task that begins so.
        damping: Damping of the arm's vibrations, share of critical.

    """

    robot: Robot
    nominal: Toolpath
    tool_x: Array
    stance: Wish
    request: PostureRequest
    wish: FeedWish
    force: ForceSpread
    state: Callable[[Start], PlanTask]
    damping: float

    def other(self, preset: str) -> Start:
        """Find the graph's start for another preset."""
        asked = replace(self.request, settings=replace(self.request.settings, preset=preset), measures={})
        rotation = tool_axes(self.nominal, self.tool_x)
        return find_start(self.robot, self.nominal, self.tool_x, rotation, self.stance, asked)


def better_start(start: Start, choice: StartChoice) -> Start:
    """Better a start by the program; the start itself where the feed sets the time, or nothing wins.

    A preset that was asked for by name gets better by what it is for: `fast` by the time, `accurate` and `promise` by
    the band at no more time. Without a name the run gets shorter, and no band wider.

    Args:
        start: The graph's start.
        choice: How starts are weighed.

    """
    stance = start.stance
    if stance is None or start.request is None or stance.chatter is not None:
        return start
    if stance.settings.weights or stance.settings.start is not None:
        return start
    preset = stance.settings.preset if stance.settings.compares else ""
    prices = PRICES.get(preset)
    free = stance.settings.free_spin or stance.settings.lead > 0 or stance.settings.lean > 0 or stance.q.shape[1] > 6
    if prices is None or not free or stance.missed.any() or len(start.nominal) > MOST_WAYPOINTS:
        return start
    task = choice.state(start)
    if preset in ("", "fast") and _time(task, choice) <= AT_FEED * _least_time(task):
        return start
    time, band, still = _measure(start, choice)[0]
    best, best_value, brought = start, 1.0, None
    for origin in [start, *([choice.other("fast")] if not preset else [])]:
        if origin.stance is None or origin.missed.any():
            continue
        found = propose_start(task if origin is start else choice.state(origin), origin, choice, prices)
        for candidate, how in [(origin, None)] * (origin is not start) + ([found] if found else []):
            pushes = PUSHES if not preset else (1.0,)
            for push, (taken, wide, quiet) in zip(pushes, _measure(candidate, choice, pushes), strict=True):
                value = _judge(preset, taken / time, wide / band, quiet / still)
                LOG.debug("time %.4f -> %.4f s, band %.4f -> %.4f mm, %.0f %% of the acceleration, %s",
                          time, taken, 1e3 * band, 1e3 * wide, 100 * push, "graph" if how is None else "program")
                if value < best_value - LEAST_GAIN:
                    best, best_value, brought = replace(candidate, push=push), value, (taken, wide, quiet, how)
    if brought is None or best.stance is None:
        return start
    taken, wide, quiet, how = brought
    bound = _bound_by_graph(task, best.stance, choice)
    told = Bettered(start, (time, taken), (1e3 * band, 1e3 * wide), bound, *(how or Brought(0, ())))
    costs = {**best.stance.costs, "driven_s": taken, "band_mm": 1e3 * quiet}
    compared = {**stance.compared, "program": costs[stance.compared_by]} if stance.compared else {}
    chosen = replace(best.stance, settings=stance.settings, costs=costs, compared=compared)
    stood = stand(replace(chosen, compared_by=stance.compared_by), choice.nominal, start.request)
    return replace(stood, bettered=told, push=best.push, notes=(*stood.notes, told.sentence(best.push)))


def _judge(preset: str, time: float, band: float, still: float) -> float:
    """Return what a preset makes less, as a share of the start's; infinite where that is bought with what it may not.

    Args:
        preset: The preset by name, "" for none.
        time: Time as a share of the start's.
        band: Widest band as a share of the start's.
        still: The same, vibration left out.

    """
    if preset == "fast":
        return time
    if preset:
        return still if max(time, band) <= 1.0 + SAME else np.inf
    return 0.5 * (time + band) if max(time, band) <= 1.0 + SAME else np.inf


def _time(task: PlanTask, choice: StartChoice) -> float:
    """Time the run before correction. [s]."""
    try:
        return float(time_run(task, task.q_start, choice.wish)[1].time[-1])
    except ConvergenceError:
        return np.inf


def _measure(start: Start, choice: StartChoice, pushes: tuple[float, ...] = (1.0,)) -> list[tuple[float, float, float]]:
    """Measure time [s] and widest 95 % band, with and without vibration [m], before correction.

    Args:
        start: The start.
        choice: How starts are weighed.
        pushes: Shares of the acceleration limits.

    """
    task, found = choice.state(start), []
    rows = pick_rows(task.cut, BAND_ROWS)
    try:
        still = spread_tip(task, choice.force, rows)
        quiet = float(band_radius(still).max(initial=0.0))
        for push in pushes:
            run = replace(task, acceleration_limits=push * task.acceleration_limits)
            timing = time_run(run, run.q_start, choice.wish)[1]
            motion = measure_bending(run, run.q_start, timing, choice.damping).motion
            spread = still
            if motion is not None:
                away = motion.error[:, rows] - motion.error[:, rows].mean(axis=0)
                spread = still + np.einsum("dni,dnj->nij", away, away) / max(len(away) - 1, 1)
            found.append((float(timing.time[-1]), float(band_radius(spread).max(initial=0.0)), quiet))
    except ConvergenceError:
        found += [(np.inf, np.inf, np.inf)] * (len(pushes) - len(found))
    return found


def spread_tip(task: PlanTask, force: ForceSpread, rows: NDArray[np.int_]) -> Array:
    """Return the covariance of the tip at some waypoints, before correction and vibration. Shape (k, 3, 3). [m^2]."""
    scene = stage_path(task.robot, task.q_start, task.wrench, task.step_time)
    return _spread_scene(scene, known_uncertainty(task.robot), force, rows)


def _spread_scene(scene: Scene, known: Uncertainty, force: ForceSpread, rows: NDArray[np.int_]) -> Array:
    shared, local = measure_force_slopes(scene, rows, force)
    slopes = Slopes(rows, np.zeros((len(rows), 3)), measure_slopes(scene, known.unknowns, rows), shared, local)
    return np.asarray(sum(split_covariance(slopes, known).values()))


def _least_time(task: PlanTask) -> float:
    """Return the time of the programmed feed, of rapid moves, and of smoothing at both ends of every run. [s]."""
    rapid, smooth = task.nominal.rapid[1:], task.smoothing * (sum(INERTIA_WINDOWS) if task.inertia else 1.0)
    moves = np.abs(np.diff(task.q_start, axis=0))[rapid]
    between = time_rapids(moves, task.velocity_limits, task.acceleration_limits).sum()
    runs = len(cutting_runs(np.r_[False, rapid], task.rests))
    return float(task.step_time[~rapid].sum() + between + runs * smooth)


def _bound_by_graph(task: PlanTask, stance: Stance, choice: StartChoice) -> float:
    """Return the least time of any way through the ladder graph's grid by feed and joint velocities alone. [s]."""
    settings, arm, nominal = stance.settings, build_arm(task.robot), choice.nominal
    stations = pick_stations(nominal, BOUND_STATIONS)
    follow = follow_axis(arm, nominal)
    options = build_options(arm, settings, None if follow is None else follow[stations])
    lattice = fill_lattice(arm.chain, arm, nominal, choice.tool_x, stations, options, settings)
    rungs = measure_rungs(nominal, stations, most_step=settings.most_step, reconfigure=settings.reconfigure)
    nothing = Weights(**{each.name: 0.0 for each in fields(Weights)})
    try:
        return search_line(lattice, rungs, replace(nothing, time=1.0), task.robot).cost
    except InfeasibleError:
        return _least_time(task)


def measure_radius(robot: Robot, force: ForceSpread, q: Array, wrench: Array) -> Array:
    """Measure the 95 % band at joint positions (k, nq) under a wrench (k, 6), by what is known of a robot. [m]."""
    scene, every = stage_path(robot, q, wrench), np.arange(len(q))
    return band_radius(_spread_scene(scene, known_uncertainty(robot), force, every))


class Brought(NamedTuple):
    """How a start was found: steps of the program, and what was free."""

    steps: int
    names: tuple[str, ...]


def propose_start(task: PlanTask, start: Start, choice: StartChoice, prices: Prices) -> tuple[Start, Brought] | None:
    """Solve the program around a start; None where nothing is free, or no step brings anything.

    Args:
        task: The task that starts so.
        start: The start, from a stance.
        choice: How starts are weighed.
        prices: What is weighed.

    """
    stance, request = start.stance, start.request
    if stance is None or request is None or task.missed.any():
        return None
    freedom = find_freedom(task, stance, choice.nominal, choice.tool_x, MOST_STATIONS)
    if freedom is None:
        return None
    program = build_program(freedom, _state_ground(freedom, stance, request, choice.force, choice.wish), prices)
    if program is None:
        return None
    point = solve_program(program)
    if not point.change.any():
        return None
    better = _follow(freedom, point, stance, choice.nominal, request)
    if better is None:
        return None
    return stand(better, choice.nominal, request), Brought(program.steps, freedom.names)


def _state_ground(
    freedom: Freedom, stance: Stance, request: PostureRequest, force: ForceSpread, wish: FeedWish
) -> Ground:
    """State what postures have to keep."""
    task, scene, settings = freedom.task, request.scene, stance.settings
    margin = None
    if scene is not None:
        at = margin_stations(len(freedom.rows))

        def margin(q: Array) -> Array:
            return measure_margin(scene, q[at], request.wanted)

    torques = None
    if wish.torque:
        def torques(q: Array) -> Callable[[int, int, Array, Array], tuple[Array, Array, Array, Array]]:
            return TorqueRules(task.robot, q, freedom.wrench).rows

    return Ground(lambda q, wrench: measure_radius(task.robot, force, q, wrench), margin, settings.limit_margin,
                  (settings.lead, settings.lean), torques)  # fmt: skip


def _follow(
    freedom: Freedom, point: Point, stance: Stance, nominal: Toolpath, request: PostureRequest
) -> Stance | None:
    """Follow a choice of the free coordinates at every waypoint of the toolpath; None where that tears."""
    every, robot, arm = np.arange(len(nominal)), freedom.task.robot, freedom.arm
    moved = freedom.spread(point.change, every.astype(float))
    given = {"spin": stance.spin, "lead": stance.lead, "lean": stance.lean}
    stood = orient_tool(nominal, freedom.tool_x, every, *given.values())
    turned = {name: value + (moved[:, freedom.names.index(name)] if name in freedom.names else 0.0)
              for name, value in given.items()}  # fmt: skip
    rest = np.swapaxes(stood, 1, 2) @ stance.rotation
    rotation = orient_tool(nominal, freedom.tool_x, every, *turned.values()) @ rest
    place = freedom.task.origin[freedom.rows]
    away = point.q - freedom.task.q_start[freedom.rows]
    q = stance.q + interpolate(every, place, away)
    q[:, arm.held] = stance.q[:, arm.held] + moved[:, freedom.extra]
    q = refine_ik(arm, q, nominal.position, rotation)
    missed = np.abs(pose_error(arm.chain, q, nominal.position, rotation)).max(axis=1) > REACHED
    torn = np.abs(np.diff(q, axis=0)).max(axis=1)[~nominal.rapid[1:]].max(initial=0.0) > stance.settings.most_step
    if missed.any() or torn or (q < robot.lower).any() or (q > robot.upper).any():
        return None
    picture = replace(stance.map, chosen=turned["spin"][stance.map.waypoint], held=q[stance.map.waypoint][:, arm.held])
    costs = summarise_costs(freedom.task.chain, robot, nominal, q, stance.settings, request.axes)
    return replace(stance, q=q, rotation=rotation, spin=turned["spin"], lead=turned["lead"], lean=turned["lean"],
                   costs=costs, map=picture)  # fmt: skip
