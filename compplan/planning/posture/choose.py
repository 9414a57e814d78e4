"""Choose how the robot stands along a path: coarse graph, fine graph around its line, then every waypoint.

Collisions are looked for along the line that the graph proposes; where it collides, the neighbourhood is checked and
the search repeated, so that only a small part of the nodes is ever tested.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InfeasibleError
from compplan.planning.posture.configuration import MARGIN_SAMPLES, solve_default_posture
from compplan.planning.posture.costs import Weights, choose_weights
from compplan.planning.posture.lattice import (
    COLLISION,
    JOINT_LIMIT,
    NOT_WANTED,
    Lattice,
    Options,
    build_options,
    fill_lattice,
    follow_axis,
    pick_stations,
)
from compplan.planning.posture.motion import price_motion
from compplan.planning.posture.search import Line, Rungs, measure_rungs, search_line
from compplan.planning.posture.settings import PostureSettings
from compplan.planning.posture.summary import PostureMap, PostureSummary, mark_collisions, slice_map, summarise_costs
from compplan.planning.posture.trace import PostureTrace, trace_line
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.ik import CONFIGURATIONS, Arm, build_arm
from compplan.toolpath.toolpath import Toolpath

#: Tells by how much postures keep clear: (q (m, nq), waypoints (m,)) -> margin (m,) [m], negative where too near.
Margin = Callable[[Array, NDArray[np.int_]], Array]
#: Errors of a finished posture that add up.
ERRORS = ("sensitivity_rms_mm", "travel_error_rms_mm", "inertia_rms_mm")
#: Share of the plain posture's figure that a choice has to get below to be worth its turns: figures of the band are not
#: known better (assumed), the others are compared as they are.
GAINS = {"accurate": 0.999, "error_band": 0.99, "smooth": 1.0, "fast": 1.0}
#: Searches that collisions may ask for, and rounds of further stations.
COLLISION_ROUNDS, STATION_ROUNDS = 25, 4
#: Rotation and leans below which a tool stands as the job has it. [rad]
STILL = 1e-9
#: Stations times options that the graph has at most, as long as 50 stations are left.
NODE_BUDGET = 17_500
#: Steps of the fine grid on either side of the coarse line.
FINE_SPINS, FINE_HELD, FINE_TILTS = 5, 2, 1


@dataclass(frozen=True)
class Task:
    """What every step of the choice needs.

    Attributes:
        robot: The robot with its tool.
        chain: Its elastic chain.
        arm: The arm for inverse kinematics.
        nominal: Toolpath in the base frame with its wrench.
        tool_x: Where x of the TCP points at spin 0, base axes. Shape (3,).
        axes: Axes in whose components the wrench errs, as columns. Shape (3, 3).
        settings: What may vary and what it is chosen for.
        margin: By how much postures keep clear, or None.

    """

    robot: Robot
    chain: Chain
    arm: Arm
    nominal: Toolpath
    tool_x: Array
    axes: Array
    settings: PostureSettings
    margin: Margin | None = None


def choose_posture_path(
    robot: Robot, nominal: Toolpath, tool_x: Array, settings: PostureSettings | None = None, *,
    axes: Array | None = None, margin: Margin | None = None,
) -> PostureSummary:  # fmt: skip
    """Choose configuration, rotation about the tool axis, extra axes and lean along a path.

    Args:
        robot: The robot with its tool.
        nominal: Toolpath in the base frame, with its predicted wrench.
        tool_x: Where x of the TCP points at spin 0, base axes. Shape (3,).
        settings: What may vary and what it is chosen for.
        axes: Axes in whose components the wrench errs, as columns in base axes (the part's); base axes if left out.
            Shape (3, 3).
        margin: Tells by how much postures keep clear; what does not leaves the graph.

    Raises:
        InfeasibleError: If nothing leads along the path; with the waypoint and what stands there.

    """
    settings = settings or PostureSettings()
    axes = np.eye(3) if axes is None else axes
    task = Task(robot, build_chain(robot), build_arm(robot), nominal, np.asarray(tool_x, float), axes, settings, margin)
    return _prefer_still(task, _choose_line(task))


def _choose_line(task: Task) -> PostureSummary:
    """Choose by the graph, with more stations where its way cannot be followed between them."""
    settings, nominal = task.settings, task.nominal
    follow = follow_axis(task.arm, nominal)
    options = build_options(task.arm, settings, follow).spin.shape[1]
    stations = pick_stations(nominal, int(np.clip(NODE_BUDGET // options, 50, settings.stations)))
    for _ in range(STATION_ROUNDS):
        posture_choice, bad = _choose_at(task, stations, None if follow is None else follow[stations])
        if not len(bad):
            return posture_choice
        more = np.setdiff1d(_surround(bad, len(nominal)), stations)
        if not len(more):
            break
        few = np.linspace(0, len(more) - 1, min(len(more), settings.stations)).astype(int)
        stations = np.union1d(stations, more[few])
    kind = "clearance" if task.margin is not None and not posture_choice.missed.any() else "continuity"
    raise InfeasibleError(
        f"the posture cannot be followed at {len(bad)} waypoints, first at waypoint {bad[0]}: "
        f"{'the arm comes too near' if kind == 'clearance' else 'joints would have to jump or leave their limits'}; "
        "move the part, free the rotation, or divide the path more finely there",
        waypoints=[int(w) for w in bad], limits=[kind],
    )  # fmt: skip


def _choose_at(task: Task, stations: NDArray[np.int_], follow: Array | None) -> tuple[PostureSummary, NDArray[np.int_]]:
    """Choose at the given stations; return the posture and the waypoints between where it fails."""
    settings, robot = task.settings, task.robot
    rungs = measure_rungs(task.nominal, stations, most_step=settings.most_step, reconfigure=settings.reconfigure)
    coarse = _fill(task, stations, build_options(task.arm, settings, follow))
    own = {**({"travel": 1.0} if settings.motion.stated and settings.preset == "accurate" else {}), **settings.weights}
    weights = choose_weights(settings.preset, least_level(coarse, rungs), own)
    if coarse.usable.any():  # none is where the part is out of reach, which the search says
        reached = coarse.q[coarse.usable]
        rungs = replace(rungs, price=price_motion(task.chain, reached, robot.prismatic, settings.motion))
    coarse, line, keeps = _search_with_margin(task, coarse, rungs, weights)
    fine, chosen = coarse, line
    options = _refine_options(task, coarse.options, line)
    if options is not None:
        fine = _keep_slot(_fill(task, stations, options), line)
        if keeps:
            task, fine = _keep_away(task), _drop_near_limits(fine)
        try:
            fine, chosen = _search_clear(task, fine, rungs, weights)
        except InfeasibleError:
            fine, chosen = coarse, line
    if chosen.cost > line.cost:
        fine, chosen = coarse, line
    trace = _trace(task, stations, fine.options, chosen, smooth=True)
    if trace.missed.any():
        trace = _trace(task, stations, fine.options, chosen, smooth=False)
    trace = _allow_changes(trace, task.nominal, settings)
    bad = trace.missed.copy()
    if task.margin is not None:
        rows = np.unique(np.linspace(0, len(bad) - 1, min(len(bad), MARGIN_SAMPLES)).astype(int))
        bad[rows] |= task.margin(trace.q[rows], rows) < 0
    picture: PostureMap = slice_map(coarse, line, chosen, fine.options, task.nominal, rungs.cut_share)
    if task.margin is not None and not bad.any():
        picture = mark_collisions(picture, task.margin)
    posture_choice = PostureSummary(
        q=trace.q, rotation=trace.rotation, spin=trace.spin, lead=trace.lead, lean=trace.lean,
        configuration=CONFIGURATIONS[int(np.bincount(chosen.slot).argmax())], changes=_list_changes(chosen, stations),
        weights=weights, settings=settings,
        costs=summarise_costs(task.chain, robot, task.nominal, trace.q, settings, task.axes),
        map=picture, missed=trace.missed, keeps_margin=keeps,
    )  # fmt: skip
    return posture_choice, np.flatnonzero(bad)


def _search_with_margin(task: Task, lattice: Lattice, rungs: Rungs, weights: Weights) -> tuple[Lattice, Line, bool]:
    """Search at the asked distance from joint limits, and only where no way keeps it, nearer; also tell which."""
    if task.settings.start is None:
        try:
            return *_search_clear(_keep_away(task), _drop_near_limits(lattice), rungs, weights), True
        except InfeasibleError:
            pass
    return *_search_clear(task, lattice, rungs, weights), False


def _keep_away(task: Task) -> Task:
    return replace(task, settings=replace(task.settings, limit_room=task.settings.limit_margin))


def _drop_near_limits(lattice: Lattice) -> Lattice:
    """Refuse what stands nearer to a joint limit than is asked for."""
    reason = np.where(lattice.usable & (lattice.limits > 0), JOINT_LIMIT, lattice.reason).astype(np.int8)
    return replace(lattice, reason=reason)


def _prefer_still(task: Task, posture_choice: PostureSummary) -> PostureSummary:
    """Keep one configuration and the tool's x where the job has it, unless the choice is better by what it is for.

    Both finished postures are weighed as they are, by the measure of the preset (`measure_choice`). The plain one has
    to stand as well as was asked for, or as the choice does.
    """
    settings, nominal, robot = task.settings, task.nominal, task.robot
    if robot.nq < 6 or settings.weights:
        return posture_choice
    leans = np.abs(np.stack([posture_choice.spin, posture_choice.lead, posture_choice.lean])).max()
    if (
        leans < STILL and not posture_choice.changes and not len(task.arm.held)
    ):  # the choice is the plain posture itself
        return replace(posture_choice, plain=posture_choice.costs)
    still = solve_default_posture(robot, nominal, task.tool_x, posture_choice, task.axes, task.margin)
    if still is None:
        return posture_choice
    chosen = posture_choice.costs
    costs = still.costs
    still, posture_choice = replace(still, plain=costs), replace(posture_choice, plain=costs)
    for name, asked in (
        ("limit_distance_deg", np.degrees(settings.limit_margin)),
        ("dexterity_min", settings.singularity_margin),
    ):
        if costs[name] < min(asked, chosen[name]):
            return posture_choice
    counts = posture_choice.weights.travel > 0
    ours, theirs = (measure_choice(settings.preset, value, counts_travel=counts) for value in (chosen, costs))
    gained = ours < GAINS[settings.preset] * theirs
    keeps = gained or (theirs > ours and costs["joint_travel_deg"] >= chosen["joint_travel_deg"])
    return posture_choice if keeps else still


def measure_choice(preset: str, costs: dict[str, float], *, counts_travel: bool = False) -> float:
    """Return what a preset makes small, of a finished posture: deviation [mm], joint travel [deg] or time [s]."""
    if preset == "smooth":
        return costs["joint_travel_deg"]
    if preset == "fast":
        return costs["time_s"]
    return sum_errors(costs) if preset == "error_band" or counts_travel else costs["sensitivity_rms_mm"]


def sum_errors(costs: dict[str, float]) -> float:
    """Return the root of the sum of squares of what compensation leaves, of gears and of inertia [mm]."""
    return float(np.linalg.norm([costs[name] for name in ERRORS]))


def least_level(lattice: Lattice, rungs: Rungs) -> float:
    """Return the mean over the cut of the least squared sensitivity of any usable node [mm^2]."""
    values = np.where(lattice.usable, lattice.sensitivity, np.inf).min(axis=(1, 2))
    known = np.isfinite(values)
    return float(1e6 * (rungs.cut_share[known] * values[known] ** 2).sum() / max(rungs.cut_share[known].sum(), 1e-300))


def _trace(task: Task, stations: NDArray[np.int_], options: Options, line: Line, *, smooth: bool) -> PostureTrace:
    return trace_line(
        task.arm, task.nominal, task.tool_x, stations, options, line.option, line.q,
        most_step=task.settings.most_step, free_spin=task.settings.free_spin, smooth=smooth,
    )  # fmt: skip


def _fill(task: Task, stations: NDArray[np.int_], options: Options) -> Lattice:
    return fill_lattice(
        task.chain, task.arm, task.nominal, task.tool_x, stations, options, task.settings, axes=task.axes
    )


def _search_clear(task: Task, lattice: Lattice, rungs: Rungs, weights: Weights) -> tuple[Lattice, Line]:
    """Search until the line keeps clear; what collides leaves the graph."""
    start = None if task.settings.start is None else np.array(task.settings.start)
    checked = np.zeros(lattice.reason.shape, bool)
    for _ in range(COLLISION_ROUNDS):
        line = search_line(lattice, rungs, weights, task.robot, start=start, room=task.settings.limit_room)
        if task.margin is None:
            return lattice, line
        rows = np.arange(len(line.option))
        near = task.margin(line.q, lattice.stations) < 0
        if not near.any():
            return lattice, line
        reason = lattice.reason.copy()
        reason[rows[near], line.option[near], line.slot[near]] = COLLISION
        checked[rows, line.option, line.slot] = True
        suspects = np.zeros_like(checked)
        suspects[rows[near], :, line.slot[near]] = True
        suspects &= ~checked & lattice.usable
        node = np.nonzero(suspects)
        hits = task.margin(lattice.q[node], lattice.stations[node[0]]) < 0
        checked |= suspects
        reason[tuple(index[hits] for index in node)] = COLLISION
        lattice = replace(lattice, reason=reason)
    worst = lattice.stations[near]
    raise InfeasibleError(
        f"no posture keeps clear at waypoint {worst[0]}; move the part, lower the clearance or use a slimmer tool",
        waypoints=[int(w) for w in worst], limits=["clearance"],
    )  # fmt: skip


def _refine_options(task: Task, coarse: Options, line: Line) -> Options | None:
    """Build the fine grid around a line; None where nothing varies."""
    settings = task.settings
    spins, positions, _ = coarse.shape
    centre = [
        np.broadcast_to(v, (len(line.option), *v.shape[1:]))[np.arange(len(line.option)), line.option]
        for v in (coarse.spin, coarse.held, coarse.lead, coarse.lean)
    ]
    if max(coarse.shape) == 1:
        return None
    spin = 2 * np.pi / spins * np.arange(-FINE_SPINS, FINE_SPINS + 1) / FINE_SPINS if spins > 1 else np.zeros(1)
    held = [np.zeros(1)] * len(task.arm.held)
    if positions > 1:
        fine = np.arange(-FINE_HELD, FINE_HELD + 1) / (FINE_HELD + 1)
        held = [step * fine if step else np.zeros(1) for step in coarse.steps]
    lean = [
        limit * np.arange(-FINE_TILTS, FINE_TILTS + 1) / 2 if limit > 0 else np.zeros(1)
        for limit in (settings.lead, settings.lean)
    ]
    grid = np.meshgrid(spin, *held, *lean, indexing="ij")
    away = np.stack([axis.ravel() for axis in grid], axis=1)
    h = len(held)
    lead = np.clip(centre[2][:, None] + away[:, 1 + h], -settings.lead, settings.lead)
    side = np.clip(centre[3][:, None] + away[:, 2 + h], -settings.lean, settings.lean)
    if settings.lead > 0 and settings.lean > 0:
        outside = np.maximum(np.hypot(lead / settings.lead, side / settings.lean), 1.0)
        lead, side = lead / outside, side / outside
    moved = centre[1][:, None] + away[:, 1 : 1 + h]
    low, high = task.robot.lower[task.arm.held], task.robot.upper[task.arm.held]
    count = len(away)
    shape = (len(spin), int(np.prod([len(v) for v in held])), len(lean[0]) * len(lean[1]))
    everything = np.tile(np.arange(count), (count, 1))
    spin = centre[0][:, None] + away[:, 0]
    return Options(spin, np.clip(moved, low, high), lead, side, everything, shape, coarse.steps)


def _keep_slot(lattice: Lattice, line: Line) -> Lattice:
    """Keep only the configuration that the coarse line has at each station."""
    other = np.arange(lattice.reason.shape[2])[None, :] != line.slot[:, None]
    reason = np.where(lattice.usable & other[:, None, :], NOT_WANTED, lattice.reason).astype(np.int8)
    return replace(lattice, reason=reason)


def _allow_changes(trace: PostureTrace, nominal: Toolpath, settings: PostureSettings) -> PostureTrace:
    """Forgive steps of rapid moves where the arm may change its configuration; elsewhere they count as torn."""
    if settings.reconfigure:
        return trace
    torn = np.zeros(len(trace.q), bool)
    torn[1:] = np.abs(np.diff(trace.q, axis=0)).max(axis=1) > 1.05
    return replace(trace, missed=trace.missed | (torn & nominal.rapid))


def _list_changes(line: Line, stations: NDArray[np.int_]) -> tuple[tuple[int, str, str], ...]:
    """List where the configuration changes: first waypoint afterwards, before, after."""

    def words(slot: int) -> str:
        return " ".join(CONFIGURATIONS[slot].values())

    places = np.flatnonzero(np.diff(line.slot)) + 1
    return tuple((int(stations[i]), words(int(line.slot[i - 1])), words(int(line.slot[i]))) for i in places)


def _surround(waypoints: NDArray[np.int_], n: int) -> NDArray[np.int_]:
    """Return waypoints with their neighbours."""
    wide = np.unique(np.concatenate([waypoints + d for d in (-3, -2, -1, 0, 1, 2)]))
    return wide[(wide >= 0) & (wide < n)]
