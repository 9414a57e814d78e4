"""Choose the posture along a path: coarse graph, fine graph around the coarse solution, then every waypoint.

Collisions are checked along the solution of the graph. Where it collides, the neighbouring nodes are checked and the
search is repeated, so that only few nodes are tested.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from compplan.errors import InfeasibleError
from compplan.planning.posture.costs import SINGULARITY_MARGIN, Weights, choose_weights
from compplan.planning.posture.follow import find_jumps_along
from compplan.planning.posture.lattice import (
    COLLISION,
    EXCLUDED,
    JOINT_LIMIT,
    Lattice,
    Options,
    build_options,
    fill_lattice,
    orient_tool,
    pick_stations,
)
from compplan.planning.posture.search import Line, Rungs, find_nearest_rows, measure_rungs, search_line
from compplan.planning.posture.settings import PostureProblem
from compplan.planning.posture.summary import PostureSummary, PostureTrace, summarise_costs
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import CLOSE, CONFIGURATIONS, pose_error, reach_tip_and_axis, refine_ik, solve_nearest
from compplan.toolpath.contact import turn_about_axis
from compplan.toolpath.toolpath import select_even

#: Share of the plain posture's figure below which a choice replaces it: margin of the accuracy of band figures
#: (assumed), none for the others; and the figure of each preset.
GAINS = {"accurate": 0.999, "error_band": 0.99, "smooth": 1.0, "fast": 1.0}
FIGURES = {"smooth": "joint_travel_deg", "fast": "time_s"}
#: Most searches because of collisions, and most rounds with additional stations.
COLLISION_ROUNDS, STATION_ROUNDS = 25, 4
#: Spin and tilts below which the tool orientation is that of the job. [rad]
SAME_ORIENTATION = 1e-9
#: Most stations times options of the graph, with at least 50 stations.
NODE_BUDGET = 17_500
#: Greatest joint distance between a waypoint of the same configuration and the interpolation of its stations. [rad]
NEAR = 0.3
#: Standard deviation and half width of the filter that smooths the steps of the grid. [stations]
SMOOTH, REACH = 1.5, 6
#: Steps of the fine grid on either side of the coarse line.
FINE_SPINS, FINE_HELD, FINE_TILTS = 5, 2, 1
#: Waypoints of a finished path whose clearance margin is computed.
MARGIN_SAMPLES = 600


def choose_posture_path(problem: PostureProblem) -> PostureSummary:
    """Choose configuration, spin, extra axes and tilt of the tool axis along a path.

    One configuration and the job's tool orientation are preferred, unless the choice is better by the figure of the
    preset. Both finished postures are compared. The plain one must keep the required distance from joint limits and
    singularities, or that of the choice.

    Raises:
        InfeasibleError: If no posture path exists; with the waypoints and the violated limit.
    """
    settings, posture_choice = problem.settings, _choose_line(problem)
    if not settings.search:
        return posture_choice
    leans = np.abs(np.stack([posture_choice.spin, posture_choice.lead, posture_choice.lean])).max()
    if leans < SAME_ORIENTATION and not posture_choice.changes and not len(problem.arm.held):  # the plain one itself
        return posture_choice
    plain = choose_plain(problem)
    if plain is None:
        return posture_choice
    chosen, costs = posture_choice.costs, plain.costs
    required = {"limit_distance_deg": np.degrees(settings.limit_margin), "dexterity_min": SINGULARITY_MARGIN}
    if any(costs[name] < min(least, chosen[name]) for name, least in required.items()):
        return posture_choice
    figure = FIGURES.get(settings.preset, "sensitivity_rms_mm")
    ours, theirs = chosen[figure], costs[figure]
    gained = ours < GAINS[settings.preset] * theirs
    keeps = gained or (theirs > ours and costs["joint_travel_deg"] >= chosen["joint_travel_deg"])
    return posture_choice if keeps else plain


def choose_partial(problem: PostureProblem) -> PostureSummary | None:
    """Choose postures for every stretch that the arm can follow, without collision checks; None if it can follow none.

    The other waypoints are missed; the arm has the posture of the nearest reached waypoint there.
    """
    alone = replace(problem, settings=replace(problem.settings, scene=None))
    try:
        if problem.settings.scene is not None:
            return choose_posture_path(alone)
    except InfeasibleError:
        pass
    try:
        found, _ = _choose_at(alone, _pick_stations(alone), partial=True)
    except InfeasibleError:
        return None
    if found.missed.all():
        return None
    lost = np.flatnonzero(found.missed)
    near = find_nearest_rows(np.flatnonzero(~found.missed), lost)
    q, rotation = found.q.copy(), found.rotation.copy()
    q[lost], rotation[lost] = q[near], turn_about_axis(rotation[near][:, :, 0], problem.nominal.axis[lost])
    return replace(found, q=q, rotation=rotation)


def _pick_stations(problem: PostureProblem) -> NDArray[np.int_]:
    """Pick as many stations as the node budget of the graph allows."""
    options = build_options(problem, np.zeros(1, int)).spin.shape[1]
    return pick_stations(problem.nominal, int(np.clip(NODE_BUDGET // options, 50, problem.settings.stations)))


def _choose_line(problem: PostureProblem) -> PostureSummary:
    """Choose by the graph, with more stations where its solution cannot be followed between them."""
    settings, nominal = problem.settings, problem.nominal
    stations = _pick_stations(problem)
    for _ in range(STATION_ROUNDS):
        posture_choice, bad = _choose_at(problem, stations)
        if not len(bad):
            return posture_choice
        around = np.unique(bad[:, None] + np.arange(-3, 3))
        more = np.setdiff1d(around[(around >= 0) & (around < len(nominal))], stations)
        if not len(more):
            break
        stations = np.union1d(stations, select_even(more, settings.stations))
    kind = "clearance" if settings.scene is not None and not posture_choice.missed.any() else "continuity"
    raise InfeasibleError(
        f"the posture cannot be followed at {len(bad)} waypoints, first at waypoint {bad[0]}: "
        f"{'the arm comes too near' if kind == 'clearance' else 'joints would have to jump or leave their limits'}; "
        "move the part, free the rotation, or divide the path more finely there",
        waypoints=[int(w) for w in bad], limits=[kind],
    )  # fmt: skip


def _choose_at(
    problem: PostureProblem, stations: NDArray[np.int_], *, partial: bool = False
) -> tuple[PostureSummary, NDArray[np.int_]]:
    """Choose at stations (a `partial` choice leaves some out); return the choice and the waypoints where it fails."""
    settings = problem.settings
    rungs = measure_rungs(problem.nominal, stations, most_step=settings.most_step)
    coarse = fill_lattice(problem, stations, build_options(problem, stations))
    weights = choose_weights(settings.preset, least_level(coarse, rungs))
    keeps = settings.start is None and not partial  # the required distance from joint limits, unless infeasible
    try:
        coarse, line = _search_clear(problem, coarse, rungs, weights, away=keeps, partial=partial)
    except InfeasibleError:
        if not keeps:
            raise
        keeps = False
        coarse, line = _search_clear(problem, coarse, rungs, weights, away=False)
    fine, chosen = coarse, line
    if (options := _refine_options(problem, coarse.options, line)) is not None:
        slots = np.arange(coarse.reason.shape[2])
        finer = fill_lattice(problem, stations, options).refuse((slots != line.slot[:, None])[:, None], EXCLUDED)
        try:
            finer, found = _search_clear(problem, finer, rungs, weights, away=keeps, partial=partial)
            fine, chosen = (coarse, line) if found.cost > line.cost else (finer, found)
        except InfeasibleError:
            pass
    trace = trace_line(problem, stations, fine.options, chosen, smooth=True)
    if trace.missed.any():
        trace = trace_line(problem, stations, fine.options, chosen, smooth=False)
    bad, rows = trace.missed.copy(), select_even(np.arange(len(trace.q)), MARGIN_SAMPLES)
    bad[rows] |= problem.violates_clearance(trace.q[rows])
    posture_choice = PostureSummary(
        **vars(trace), configuration=CONFIGURATIONS[int(np.bincount(chosen.slot).argmax())],
        changes=_list_changes(chosen, stations), settings=settings,
        costs=summarise_costs(problem, trace.q),
    )  # fmt: skip
    return posture_choice, np.flatnonzero(bad)


def least_level(lattice: Lattice, rungs: Rungs) -> float:
    """Compute the smallest squared sensitivity of the usable nodes, mean over the cut. [mm^2]"""
    values = np.where(lattice.usable, lattice.sensitivity, np.inf).min(axis=(1, 2))
    known = np.isfinite(values)
    return float(1e6 * (rungs.cut_share[known] * values[known] ** 2).sum() / max(rungs.cut_share[known].sum(), 1e-300))


def choose_plain(problem: PostureProblem) -> PostureSummary | None:
    """Choose the plain posture: one configuration, the tool orientation of the job.

    None if it cannot be followed.
    """
    try:
        plain = _choose_line(replace(problem, settings=problem.settings.keep_plain()))
    except InfeasibleError:
        return None
    if plain.changes:
        return None
    return replace(plain, settings=problem.settings)


def _search_clear(
    problem: PostureProblem, lattice: Lattice, rungs: Rungs, weights: Weights, *, away: bool, partial: bool = False
) -> tuple[Lattice, Line]:
    """Search until no node collides; remove colliding nodes. `away`: keep the required distance from joint limits."""
    settings = problem.settings
    room = settings.limit_margin if away else settings.limit_room
    lattice = lattice.refuse(lattice.limits > 0, JOINT_LIMIT) if away else lattice
    for _ in range(COLLISION_ROUNDS):
        line = search_line(lattice, rungs, weights, problem.robot, start=settings.start, room=room, partial=partial)
        rows, near = np.arange(len(line.option)), problem.violates_clearance(line.q)
        if not near.any():
            return lattice, line
        reason = lattice.reason.copy()
        reason[rows[near], line.option[near], line.slot[near]] = COLLISION
        suspects = np.zeros(reason.shape, bool)
        suspects[rows[near], :, line.slot[near]] = True
        node = np.nonzero(suspects & replace(lattice, reason=reason).usable)
        hits = problem.violates_clearance(lattice.q[node])
        reason[tuple(index[hits] for index in node)] = COLLISION
        lattice = replace(lattice, reason=reason)
    worst = lattice.stations[near]
    raise InfeasibleError(
        f"no posture keeps clear at waypoint {worst[0]}; move the part, lower the clearance or use a slimmer tool",
        waypoints=[int(w) for w in worst], limits=["clearance"],
    )  # fmt: skip


def _refine_options(problem: PostureProblem, coarse: Options, line: Line) -> Options | None:
    """Build the fine grid around a solution; None where nothing varies."""
    settings = problem.settings
    spins, positions, _ = coarse.shape
    centre = [_take(v, line.option) for v in (coarse.spin, coarse.held, coarse.lead, coarse.lean)]
    if max(coarse.shape) == 1:
        return None
    spin = 2 * np.pi / spins * np.arange(-FINE_SPINS, FINE_SPINS + 1) / FINE_SPINS if spins > 1 else np.zeros(1)
    held = [np.zeros(1)] * len(problem.arm.held)
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
    low, high = problem.robot.lower[problem.arm.held], problem.robot.upper[problem.arm.held]
    count = len(away)
    shape = (len(spin), int(np.prod([len(v) for v in held])), len(lean[0]) * len(lean[1]))
    everything = np.tile(np.arange(count), (count, 1))
    spin = centre[0][:, None] + away[:, 0]
    return Options(spin, np.clip(moved, low, high), lead, side, everything, shape, coarse.steps)


def _list_changes(line: Line, stations: NDArray[np.int_]) -> tuple[tuple[int, str, str], ...]:
    """List the changes of configuration: first waypoint afterwards, configuration before, after."""
    words = [" ".join(CONFIGURATIONS[slot].values()) for slot in line.slot]
    return tuple((int(stations[i]), words[i - 1], words[i]) for i in np.flatnonzero(np.diff(line.slot)) + 1)


def trace_line(
    problem: PostureProblem, stations: NDArray[np.int_], options: Options, line: Line, *, smooth: bool
) -> PostureTrace:
    """Interpolate a solution of the graph at stations (k,) to every waypoint, with smooth spin, extra axes and tilts.

    A free spin is adapted where the path passes a singularity; `smooth` filters the steps of the grid in spin and
    tilts.
    """
    arm, nominal, most_step = problem.arm, problem.nominal, problem.settings.most_step
    steps = np.maximum(nominal.steps, 1e-3 * max(float(nominal.steps.mean()), 1e-9))
    place = np.r_[0.0, np.cumsum(steps)]  # by length, with a small least step
    along, lead, lean = (_take(v, line.option) for v in (options.spin, options.lead, options.lean))
    turns = np.column_stack([np.unwrap(along), lead, lean])
    if smooth and len(stations) > 3:
        bell = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / SMOOTH) ** 2)
        around = np.pad(turns, ((REACH, REACH), (0, 0)), mode="edge")
        turns = np.lib.stride_tricks.sliding_window_view(around, len(bell), axis=0) @ (bell / bell.sum())
    spin, lead, lean = PchipInterpolator(place[stations], turns)(place).T  # without overshoot and without kinks
    between = PchipInterpolator(place[stations], line.q)(place)
    rotation = initial = orient_tool(nominal, problem.tool_x, np.arange(len(nominal)), spin, lead, lean)
    followed = solve_nearest(arm, nominal.position, rotation, between)
    lost = ~(np.abs(followed - between).max(axis=1) <= NEAR)
    if lost.any():
        followed[lost] = refine_ik(arm, between[lost], nominal.position[lost], rotation[lost])
        error = pose_error(arm.chain, followed[lost], nominal.position[lost], rotation[lost])
        lost[lost] = np.abs(error).max(axis=1) > CLOSE
    jumps = find_jumps_along(followed, nominal, most_step)
    if problem.settings.free_spin and (lost | jumps).any():
        stretch = _whole_stretches(lost | jumps, stations)
        wanted = nominal.position[stretch], rotation[stretch]
        followed[stretch], reached = reach_tip_and_axis(arm, between[stretch], *wanted)
        lost[stretch] = ~reached
        jumps = find_jumps_along(followed, nominal, most_step)
        rotation = np.array(rotation)
        rotation[stretch] = locate_frames(arm.chain, followed[stretch]).tcp_rotation
        turned = np.swapaxes(initial[stretch], 1, 2) @ rotation[stretch]
        spin[stretch] -= np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    outside = ((followed < arm.robot.lower) | (followed > arm.robot.upper)).any(axis=1)
    return PostureTrace(followed, rotation, spin, lead, lean, lost | outside | jumps)


def _whole_stretches(marked: NDArray[np.bool_], stations: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return all waypoints between the stations around marked ones; marked stations include both sides."""
    rows = np.arange(len(marked))
    span, on = np.searchsorted(stations, rows, side="right"), np.isin(rows, stations)
    spans = np.union1d(span[marked], span[marked & on] - 1)
    return np.flatnonzero(marked | (np.isin(span, spans) & ~on))


def _take(values: Array, choice: NDArray[np.int_]) -> Array:
    wide = np.broadcast_to(values, (len(choice), *values.shape[1:]))
    return wide[np.arange(len(choice)), choice]
