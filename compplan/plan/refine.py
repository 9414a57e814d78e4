"""The posture that the graph chose, bettered by the program of time, posture and promise; as it is where none wins."""

from __future__ import annotations

import logging
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from compplan.controllers.writers.counting import load_motion
from compplan.errors import InfeasibleError
from compplan.plan.freedom import TUBE, Freedom, find_freedom
from compplan.plan.ground import DEEPEST, LEAST_SHARE, drop_least, state_ground
from compplan.plan.narrow import INERTIA_WINDOWS
from compplan.plan.one_program import Point, Prices, build_program
from compplan.plan.program_step import solve_program
from compplan.plan.run_meter import RunMeter, TimedStart
from compplan.plan.task import PlanTask
from compplan.plan.timing import cutting_runs, time_rapids
from compplan.posture.chatter import count_chatter, judge_chatter
from compplan.posture.costs import Weights
from compplan.posture.lattice import build_options, fill_lattice, follow_axis, orient_tool, pick_stations
from compplan.posture.search import measure_rungs, search_line
from compplan.posture.stance import Wish
from compplan.posture.start import Bettered, PostureRequest, Start, find_plain, find_start, stand
from compplan.posture.summary import Stance, summarise_costs
from compplan.robot import Array, Robot
from compplan.statics.ik import build_arm, pose_error, refine_ik
from compplan.toolpath.contact import path_axes, tool_axes
from compplan.toolpath.toolpath import Toolpath, interpolate

LOG = logging.getLogger(__name__)

#: Stations of the program at most, waypoints of a window that they stand for, windows of a path at most (then windows
#: are longer), and stations of the graph's bound.
MOST_STATIONS, WINDOW, MOST_WINDOWS, BOUND_STATIONS = 400, 8000, 16, 25
#: Windows of smoothing, as shares of those that plans have, and starts whose speed is eased, the best ones.
WINDOWS, EASED = (1.0, 0.7), 3
#: Gain that a posture is changed for, and difference of time or band that counts as none.
LEAST_GAIN, SAME = 0.01, 1e-3
#: Joint positions that differ by less are one posture. [rad or m]
ALIKE = 1e-4
#: Presets whose band is measured beside that of a plan without a preset, whose graph they may take as long as.
COMPARED = ("accurate", "promise")
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
        meter: How runs are measured.
        tube: Share of the tolerance by which the program may leave the path.

    """

    robot: Robot
    nominal: Toolpath
    tool_x: Array
    stance: Wish
    request: PostureRequest
    meter: RunMeter
    tube: float = 0.0

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
    if stance is None or start.request is None:
        return start
    if stance.settings.weights or stance.settings.start is not None:
        return start
    preset = stance.settings.preset if stance.settings.compares else ""
    prices = PRICES.get(preset)
    free = stance.settings.free_spin or stance.settings.lead > 0 or stance.settings.lean > 0 or stance.q.shape[1] > 6
    free |= choice.tube > 0.0
    if prices is None or not free or stance.missed.any():
        return start
    energy = stance.settings.energy
    prices, choice = prices._replace(energy=energy), replace(choice, meter=replace(choice.meter, energy=energy))
    task = choice.meter.state(start)
    if preset in ("", "fast") and not energy and choice.meter.time(task) <= AT_FEED * _least_time(task):
        return start
    measured = choice.meter.measure(start)
    if not measured:
        return start
    first = measured[0]
    origins = {"graph": start} if len(task) > WINDOW else _find_origins(start, choice, preset)
    runs: list[tuple[TimedStart, str, Brought | None]] = [(first, "graph", None)]
    for name, origin in origins.items():
        runs += [(run, name, None) for run in choice.meter.measure(origin)] if origin is not start else []
        weighed = [prices, PRICES[""]._replace(energy=energy)] if preset in COMPARED else [prices]
        state = task if origin is start else choice.meter.state(origin)
        found = [each for own in weighed if (each := propose_start(state, origin, choice, own)) is not None]
        runs += [(run, name, how) for better, how in found for run in choice.meter.measure(better)]
    if (cut := start.request.chatter) is not None:  # nowhere nearer to chatter than half of the limit, or the graph's
        near = judge_chatter(cut, start.q, 1.0 / DEEPEST) + LEAST_SHARE
        runs = [each for each in runs if (judge_chatter(cut, each[0].start.q, 1.0 / DEEPEST) <= near).all()]
    slowest = max(run.time for run, name, how in runs if how is None and name in ("graph", "plain graph"))
    taken = _choose_run(preset, first, runs, choice.meter, slowest if preset in COMPARED else first.time)
    if taken is None:
        return start
    run, name, how = taken
    stood_on = run.start.stance
    assert stood_on is not None
    bound = _bound_by_graph(task, stood_on, choice)
    told = Bettered(start, (first.time, run.time), (1e3 * first.band, 1e3 * run.band), bound, name,
                    *(how or Brought(0, ())), (first.energy, run.energy) if energy else None)  # fmt: skip
    costs = {**stood_on.costs, "driven_s": run.time, "band_mm": 1e3 * run.still}
    compared = {**stance.compared, "program": costs[stance.compared_by]} if stance.compared else {}
    chosen = replace(stood_on, settings=stance.settings, costs=costs, compared=compared,
                     chatter=count_chatter(start.request.chatter, run.start.q))  # fmt: skip
    off = 0.0 if run.start.aside is None else run.start.aside
    path = replace(choice.nominal, position=choice.nominal.position + off)
    stood = stand(replace(chosen, compared_by=stance.compared_by), path, start.request)
    return replace(stood, bettered=told, aside=run.start.aside, pace=run.start.pace,
                   notes=(*stood.notes, told.sentence(run.start.pace)))  # fmt: skip


def _find_origins(start: Start, choice: StartChoice, preset: str) -> dict[str, Start]:
    """Find the starts that the program goes on from, by name: the graph's, the plain one, other presets' postures."""
    others = {"programmed": find_plain(choice.robot, choice.nominal, choice.tool_x, start)}
    if preset in COMPARED:
        others["plain graph"] = choice.other("accurate")
    if preset != "fast":
        others["fast"] = choice.other("fast")
    origins = {"graph": start}
    for name, other in others.items():
        if other is None or other.stance is None or other.missed.any():
            continue
        if not any(np.allclose(other.q, each.q, atol=ALIKE) for each in origins.values()):
            origins[name] = other
    return origins


def _choose_run(
    preset: str, first: TimedStart, runs: list[tuple[TimedStart, str, Brought | None]], meter: RunMeter, most: float,
) -> tuple[TimedStart, str, Brought | None] | None:
    """Choose the run that a preset is for, of all runs and of the best ones eased; None where none gains.

    Args:
        preset: The preset by name, "" for none.
        first: The graph's run.
        runs: The runs, where each comes from, and what the program did.
        meter: How runs are measured.
        most: Time that is not passed, unless by `fast`. [s]

    """
    def share(run: TimedStart) -> tuple[float, float, float]:
        return run.time / most, run.band / first.band, run.still / first.still

    def value_of(run: TimedStart) -> float:
        own = _judge(preset, *share(run))
        return (own + meter.energy * run.energy / first.energy) / (1.0 + meter.energy) if first.energy > 0.0 else own

    runs = list(runs)
    beside = None if preset == "fast" else first._replace(time=most)
    order = sorted(runs, key=lambda entry: share(entry[0])[0] if preset == "fast" else sum(share(entry[0])[:2]))
    for number, (run, name, how) in enumerate(order[:EASED]):
        for window in WINDOWS if number == 0 else WINDOWS[:1]:
            if window < 1.0 or (beside is not None and run.time <= (1.0 + SAME) * most):
                runs += [(eased, name, how) for eased in meter.measure(
                    run.start, window=window, beside=beside, quiet=run.quiet)]  # fmt: skip
    best, least = None, 1.0 - LEAST_GAIN
    for run, name, how in runs:
        value = value_of(run)
        LOG.debug("%s%s: time %.4f -> %.4f s, band %.4f -> %.4f mm", name, "" if how is None else ", program",
                  first.time, run.time, 1e3 * first.band, 1e3 * run.band)
        if value < least:
            best, least = (run, name, how), value
    return best


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
    if max(time, band) > 1.0 + SAME:
        return np.inf
    if preset == "promise":
        return band
    return 0.5 * (band + still) if preset else 0.5 * (time + band)


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


class Brought(NamedTuple):
    """How a start was found: steps of the program, and what was free."""

    steps: int
    names: tuple[str, ...]


def propose_start(task: PlanTask, start: Start, choice: StartChoice, prices: Prices) -> tuple[Start, Brought] | None:
    """Solve the program around a start, window by window; None where nothing is free, or no step brings anything.

    Args:
        task: The task that starts so.
        start: The start, from a stance.
        choice: How starts are weighed.
        prices: What is weighed.

    """
    here, steps = start, 0
    names: tuple[str, ...] = ()
    for window in list_windows(len(task)):
        own = task if here is start else choice.meter.state(here)
        if (found := _solve_window(own, here, choice, prices, window)) is not None:
            here, names = found[0], found[1].names
            steps += found[1].steps
    return None if here is start else (here, Brought(steps, names))


def list_windows(count: int) -> list[tuple[int, int]]:
    """List first and last waypoint of the windows of a path, each half over the one before; one where it is short."""
    if count <= WINDOW:
        return [(0, count - 1)]
    size = max(WINDOW, int(np.ceil(2.0 * count / (MOST_WINDOWS + 1))))
    firsts = np.arange(0, count - size // 2, size // 2)
    return [(first, min(first + size, count - 1)) for first in firsts.tolist()]


def _solve_window(
    task: PlanTask, start: Start, choice: StartChoice, prices: Prices, window: tuple[int, int]
) -> tuple[Start, Brought] | None:
    """Solve the program of one window around a start."""
    stance, request = start.stance, start.request
    if stance is None or request is None or task.missed.any():
        return None
    tube = choice.tube if window == (0, len(task) - 1) else 0.0
    freedom = find_freedom(task, stance, choice.nominal, choice.tool_x, MOST_STATIONS, tube, window)
    if freedom is None:
        return None
    ground = state_ground(freedom, request, choice.meter, prices)
    program = None if ground is None else build_program(freedom, ground, prices)
    if program is None:
        return None
    point = drop_least(program, solve_program(program), load_motion(task.robot)[0].resolution)
    if not point.change.any():
        return None
    moved = freedom.spread(point.change, np.arange(len(choice.nominal), dtype=float))
    aside = freedom.shift(_keep_in_tube(freedom, moved), path_axes(choice.nominal))
    path = replace(choice.nominal, position=choice.nominal.position + aside)
    better = _follow(freedom, point, stance, path, request)
    if better is None:
        return None
    found = replace(stand(better, path, request), aside=aside if aside.any() else None)
    return found, Brought(program.steps, freedom.names)


def _keep_in_tube(freedom: Freedom, moved: Array) -> Array:
    """Return the change of the free coordinates at every waypoint, that in the tube within its bounds. Shape (n, f)."""
    place, every = freedom.task.origin[freedom.rows], np.arange(len(moved))
    most = interpolate(every, place, freedom.most)
    return np.where([name in TUBE for name in freedom.names], np.clip(moved, -most, most), moved)


def _follow(
    freedom: Freedom, point: Point, stance: Stance, nominal: Toolpath, request: PostureRequest
) -> Stance | None:
    """Follow a choice of the free coordinates at every waypoint of its window; None where that tears."""
    robot, arm, place = freedom.task.robot, freedom.arm, freedom.task.origin[freedom.rows]
    every = np.arange(int(np.ceil(place[0])), int(place[-1]) + 1)
    moved = freedom.spread(point.change, every.astype(float))
    given = {"spin": stance.spin, "lead": stance.lead, "lean": stance.lean}
    stood = orient_tool(nominal, freedom.tool_x, every, *(value[every] for value in given.values()))
    turned = {name: value.copy() for name, value in given.items()}
    for k, name in enumerate(freedom.names):
        if name in turned:
            turned[name][every] += moved[:, k]
    rest = np.swapaxes(stood, 1, 2) @ stance.rotation[every]
    rotation, q = stance.rotation.copy(), stance.q.copy()
    rotation[every] = orient_tool(nominal, freedom.tool_x, every, *(value[every] for value in turned.values())) @ rest
    q[every] += interpolate(every, place, point.q - freedom.task.q_start[freedom.rows])
    q[np.ix_(every, arm.held)] = stance.q[np.ix_(every, arm.held)] + moved[:, freedom.extra]
    q[every] = refine_ik(arm, q[every], nominal.position[every], rotation[every])
    missed = np.abs(pose_error(arm.chain, q[every], nominal.position[every], rotation[every])).max(axis=1) > REACHED
    torn = np.abs(np.diff(q, axis=0)).max(axis=1)[~nominal.rapid[1:]].max(initial=0.0) > stance.settings.most_step
    if missed.any() or torn or (q < robot.lower).any() or (q > robot.upper).any():
        return None
    picture = replace(stance.map, chosen=turned["spin"][stance.map.waypoint], held=q[stance.map.waypoint][:, arm.held])
    costs = summarise_costs(freedom.task.chain, robot, nominal, q, stance.settings, request.axes)
    return replace(stance, q=q, rotation=rotation, spin=turned["spin"], lead=turned["lead"], lean=turned["lean"],
                   costs=costs, map=picture)  # fmt: skip
