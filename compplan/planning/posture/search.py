"""Path of least cost through the ladder graph, by dynamic programming.

The cost of a path is a sum over its nodes and edges:

    sum_i omega_i (w_s s_i^2 + w_l l_i + w_k (0.1 / k_i)^2 + w_g max(0, k_0 / k_i - 1)^2 + w_c c_i)
        + sum_i (w_m (l / L)^2 |dq_i|^2 / dsigma_i + w_t t_i + w_r r_i),

k the inverse condition number, omega the share of the cut (first term) or of the path, dsigma the share of the path of
an edge, L the length of the path, l = 100 mm, t the time of an edge (programmed, or of the slowest joint), and r the
time that joints at half their velocity limits need beyond the programmed time, as a share of the total. A change of
configuration within the cut passes a singularity and costs w_g once.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InfeasibleError
from compplan.planning.posture.costs import SINGULARITY_MARGIN, Weights
from compplan.planning.posture.lattice import REASONS, USABLE, Lattice
from compplan.robot import Array, Robot
from compplan.toolpath.toolpath import Toolpath

#: Path length that joint motion is referred to. [m]
LENGTH = 0.1
#: Greatest motion of a joint between stations of a cut. [rad]
EDGE = 1.6
#: Share of the velocity limits available at the programmed feed: the rest is reserved for acceleration.
RATE_SHARE = 0.5
#: Joint position differences per block of computation.
BLOCK = 60_000
#: Cost of one change of configuration in a rapid move, far above all other costs.
CHANGE = 1e6
#: Costs that differ by less are equal: the first is chosen.
TIE = 1e-12


@dataclass(frozen=True)
class Rungs:
    """Quantities of stations and edges that do not depend on the posture."""

    cut_share: Array  #: Share of the cut that a station represents. Shape (k,).
    path_share: Array  #: Share of the path that a station represents. Shape (k,).
    sigma: Array  #: Share of the path of each edge, bounded below, times (L / l)^2. Shape (k - 1,).
    feed_time: Array  #: Programmed time of each edge. Shape (k - 1,). [s]
    #: Greatest motion of a joint on each edge; infinite where the arm may change its configuration. Shape (k - 1,).
    #: [rad]
    most_motion: Array

    def part(self, first: int, last: int) -> Rungs:
        """Return stations and edges from `first` up to but without `last`."""
        on = (self.cut_share[first:last], self.path_share[first:last])
        between = (edge[first : last - 1] for edge in (self.sigma, self.feed_time, self.most_motion))
        return Rungs(*on, *between)


class Line(NamedTuple):
    """Path through the graph."""

    option: NDArray[np.int_]  #: Option at each station. Shape (k,).
    slot: NDArray[np.int_]  #: Slot at each station. Shape (k,).
    q: Array  #: Joint positions at each station, full turns included. Shape (k, nq). [rad or m]
    cost: float  #: Total cost. [mm^2]


def measure_rungs(nominal: Toolpath, stations: NDArray[np.int_], *, most_step: float) -> Rungs:
    """Compute shares, times and allowed motions of stations (k,) of a path and the edges between.

    Each joint moves by at most `most_step` [rad] between neighbouring waypoints of a cut; the configuration may change
    in rapid moves that neither start nor end at the part.
    """
    cut = np.concatenate([[0.0], np.cumsum(np.where(nominal.rapid[1:], 0.0, nominal.steps))])
    between = np.diff(cut[stations])
    waypoints, rapid = np.diff(stations), nominal.rapid[1:]
    share, spread = (0.5 * np.r_[edge, 0.0] + 0.5 * np.r_[0.0, edge] for edge in (between, waypoints))
    cut_share = share / max(share.sum(), 1e-300)
    total = max(nominal.arc_length[-1], 1e-300)
    sigma = np.maximum(np.diff(nominal.arc_length[stations]) / total, 0.1 / len(stations)) * (total / LENGTH) ** 2
    time = np.where(rapid | (nominal.feed[1:] <= 0), 0.0, nominal.steps / np.maximum(nominal.feed[1:], 1e-9))
    feed_time = np.add.reduceat(np.r_[time, 0.0], stations[:-1]) if len(stations) > 1 else np.zeros(0)
    most = np.minimum(most_step * waypoints, EDGE)
    touches = ~nominal.rapid
    touches[:-1] |= ~nominal.rapid[1:]
    touches[0] = not nominal.rapid[1] if len(nominal) > 1 else True
    free = [nominal.rapid[a + 1 : b + 1].all() and not touches[[a, b]].any() for a, b in pairwise(stations)]
    most = np.where(np.array(free, bool), np.inf, most)
    return Rungs(cut_share, spread / max(spread.sum(), 1e-300), sigma, feed_time, most)


def cost_nodes(lattice: Lattice, rungs: Rungs, weights: Weights) -> Array:
    """Compute the cost of every node, infinite if not usable. Shape (k, g, b). [mm^2]"""
    cut, path = rungs.cut_share[:, None, None], rungs.path_share[:, None, None]
    cost = cut * 1e6 * weights.sensitivity * lattice.sensitivity**2 + path * weights.limits * lattice.limits
    dexterity = np.maximum(lattice.dexterity, 1e-3)
    cost += path * weights.dexterity * (0.1 / dexterity) ** 2
    cost += path * weights.singularity * np.maximum(SINGULARITY_MARGIN / dexterity - 1.0, 0.0) ** 2
    return np.where(lattice.usable, np.nan_to_num(cost, nan=np.inf), np.inf)


def search_line(
    lattice: Lattice, rungs: Rungs, weights: Weights, robot: Robot, *, start: Array | None = None, room: float = 0.0,
    partial: bool = False,
) -> Line:  # fmt: skip
    """Find the path of least cost through the graph.

    Joints with a range above a full turn are first treated modulo a full turn and keep `room` [rad] from their limits;
    if no such path fits between the limits, every full turn becomes a separate slot. The path starts near the joint
    positions `start` (nq,), if given. A `partial` path may have gaps; stations in a gap get the posture of the nearest
    station of the path.

    Raises:
        InfeasibleError: If there is no path; with the waypoint at which the search ends and the violated limit.
    """
    if partial:
        search = functools.partial(search_line, weights=weights, robot=robot, start=start, room=room)
        return _search_stretches(lattice, rungs, search)
    cost = cost_nodes(lattice, rungs, weights)
    if start is not None:
        cost = _start_near(lattice.q, cost, start, robot)
    turns = (robot.upper - robot.lower > 2 * np.pi) & ~(robot.prismatic | robot.carriers)
    option, slot, total = _sweep(lattice, lattice.q, cost, rungs, weights, robot, turns)
    way = lattice.q[np.arange(len(option)), option, slot]
    steps = np.diff(way, axis=0)  # full turns are accumulated along the path
    steps = np.where(turns, steps - 2 * np.pi * np.round(steps / (2 * np.pi)), steps)
    way = np.concatenate([way[:1], way[:1] + np.cumsum(steps, axis=0)])
    shifted = _shift_turns(way, robot, turns, start, room)
    if shifted is not None:
        return Line(option, slot, shifted, total)
    q, expanded = _expand_turns(lattice.q, cost, robot, turns, room)
    option, slot, total = _sweep(lattice, q, expanded, rungs, weights, robot, np.zeros_like(turns))
    return Line(option, slot % lattice.q.shape[2], q[np.arange(len(option)), option, slot], total)


def _search_stretches(lattice: Lattice, rungs: Rungs, search: Callable[[Lattice, Rungs], Line]) -> Line:
    """Search every connected stretch of stations."""
    count = len(lattice.stations)
    first, last, rows, lines = 0, count, list[int](), list[Line]()
    while first < count:
        try:
            lines.append(search(lattice.part(first, last), rungs.part(first, last)))
            rows += range(first, last)
            first, last = last, count
        except InfeasibleError as error:
            stop = int(np.searchsorted(lattice.stations, error.waypoints[0]))
            first, last = (first, stop) if stop > first else (first + 1, count)
            if first == count and not lines:
                raise
    near = np.searchsorted(rows, find_nearest_rows(np.array(rows), np.arange(count)))
    option, slot, q = (np.concatenate([line[k] for line in lines])[near] for k in range(3))
    return Line(option, slot, q, float("inf"))


def find_nearest_rows(rows: NDArray[np.int_], wanted: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return the nearest of ascending rows (k,) to each wanted row (m,), the lower one in a tie. Shape (m,)."""
    after = np.clip(np.searchsorted(rows, wanted), 0, len(rows) - 1)
    before = rows[np.maximum(after - 1, 0)]
    return np.where(np.abs(wanted - before) <= np.abs(rows[after] - wanted), before, rows[after])


def _sweep(
    lattice: Lattice, q: Array, cost: Array, rungs: Rungs, weights: Weights, robot: Robot, turns: NDArray[np.bool_],
) -> tuple[NDArray[np.int_], NDArray[np.int_], float]:  # fmt: skip
    """Run dynamic programming over the stations; return option and slot at each, and the total cost."""
    k, g, b = cost.shape
    best = cost[0]
    back = np.zeros((k, g, b), np.int32)
    last = np.concatenate([best, np.full((1, b), np.inf)])
    neighbours = lattice.options.neighbours
    everything = np.tile(np.arange(g), (g, 1))
    for i in range(1, k):
        if not np.isfinite(best).any():
            _refuse(lattice, i - 1, cost)
        free = not np.isfinite(rungs.most_motion[i - 1])
        around = everything if free or neighbours.shape[1] >= g else neighbours
        last = np.concatenate([best, np.full((1, b), np.inf)])
        best, back[i] = _step(last, q[i - 1], q[i], around, i, rungs, weights, robot, turns)
        best = best + cost[i]
    if not np.isfinite(best).any():
        _refuse(lattice, k - 1, cost)
    option, slot = np.empty(k, int), np.empty(k, int)
    # among equal costs choose the end nearest to the middle of the joint ranges
    width = robot.upper - robot.lower
    between = np.isfinite(width) & (width > 0.0)  # neither unlimited nor fixed
    share = (q[-1] - np.where(between, robot.lower, 0.0)) / np.where(between, width, 1.0) - 0.5
    middle = np.where(between, share, 0.0)
    away = np.where(best <= best.min() + TIE, (middle**2).sum(axis=2), np.inf)
    option[-1], slot[-1] = np.unravel_index(int(_first_least(away.reshape(1, -1))[0]), best.shape)
    for i in range(k - 1, 0, -1):
        option[i - 1], slot[i - 1] = divmod(int(back[i, option[i], slot[i]]), b)
    return option, slot, float(best.min())


def _step(
    last: Array, before: Array, here: Array, around: NDArray[np.int_], i: int, rungs: Rungs, weights: Weights,
    robot: Robot, turns: NDArray[np.bool_],
) -> tuple[Array, NDArray[np.int32]]:  # fmt: skip
    """Find the predecessor of least cost of every node, among options and slots of finite cost."""
    g, b = here.shape[:2]
    best, back = np.full((g, b), np.inf), np.zeros((g, b), np.int32)
    slots = np.flatnonzero(np.isfinite(last[:-1]).any(axis=0))
    targets = np.flatnonzero(np.isfinite(here[..., 0]).any(axis=0))
    free = not np.isfinite(rungs.most_motion[i - 1])
    at, block = np.moveaxis(here, 2, 0), max(1, BLOCK // around.size)
    wrist = np.flatnonzero(~robot.prismatic)[:-4:-2]
    for s in slots:
        start = np.concatenate([before[:, s], np.full((1, before.shape[2]), np.nan)])
        source, value = np.ascontiguousarray(start.T)[:, around], last[around, s]
        for some in np.split(targets, np.arange(block, len(targets), block)):
            near = np.isfinite(at[0][:, some])[:, :, None] & np.isfinite(value)[:, None]
            for j in () if free else wrist:  # the motion of these joints excludes most edges
                step = at[j][:, some, None] - source[j][:, None]
                if turns[j]:
                    _take_turns_out(step)
                near &= np.abs(step, out=step) <= rungs.most_motion[i - 1]
            rows, t = np.nonzero(near.any(axis=2))
            if not len(rows):
                continue
            t = some[t]
            change = np.where(free | (s % 8 == t % 8), 0.0, weights.singularity)[:, None]
            edge = _cost_edges(source[:, rows], at[:, rows, t], change, i - 1, rungs, weights, robot, turns)
            edge += value[rows]
            edge[np.isnan(edge)] = np.inf
            choice = _first_least(edge)
            least = edge[np.arange(len(rows)), choice]
            better = least < best[rows, t] - TIE
            rows, t = rows[better], t[better]
            best[rows, t] = least[better]
            back[rows, t] = around[rows, choice[better]] * b + s
    return best, back


def _first_least(cost: Array) -> NDArray[np.int_]:
    """Return the first index of least cost in each row, within `TIE`: rounding does not decide ties."""
    return np.argmax(cost <= cost.min(axis=1, keepdims=True) + TIE, axis=1)


def _cost_edges(
    source: Array, here: Array, change: Array, i: int, rungs: Rungs, weights: Weights, robot: Robot,
    turns: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Compute edge costs, infinite beyond the greatest motion. Shapes (nq, r, w), (nq, r) and (r, 1) give (r, w)."""
    motion, most, time = (np.zeros(source.shape[1:]) for _ in range(3))
    timed, limit = weights.time > 0 or weights.rate > 0, rungs.most_motion[i]
    for j in range(len(here)):
        step = here[j][:, None] - source[j]
        if turns[j]:
            _take_turns_out(step)
        motion += step * step
        step = np.abs(step, out=step)
        if not robot.prismatic[j]:
            np.maximum(most, step, out=most)
        if timed:
            np.maximum(time, np.divide(step, robot.velocity_limits[j], out=step), out=time)
    motion *= weights.motion
    motion /= rungs.sigma[i]
    edge = motion + change
    if weights.time > 0:
        edge += weights.time * np.maximum(time, rungs.feed_time[i])
    if timed and rungs.feed_time[i] > 0:
        excess = np.maximum(time / RATE_SHARE - rungs.feed_time[i], 0.0)
        edge += weights.rate * excess / rungs.feed_time.sum()
    if not np.isfinite(limit):
        edge += np.where(most > EDGE, CHANGE, 0.0)
    edge[~(most <= limit)] = np.inf
    return np.asarray(edge)


def _take_turns_out(step: Array) -> None:
    """Subtract full turns from motions, in place. [rad]"""
    turns = step * (0.5 / np.pi)
    np.rint(turns, out=turns)
    turns *= 2 * np.pi
    step -= turns


def _shift_turns(way: Array, robot: Robot, turns: NDArray[np.bool_], start: Array | None, keep: float) -> Array | None:
    """Shift each joint by full turns into its limits, as far from them as possible (or near the start)."""
    way = way.copy()
    for j in np.flatnonzero(turns):
        choices = []
        for m in range(-3, 4):
            low, high = way[:, j].min() + 2 * np.pi * m, way[:, j].max() + 2 * np.pi * m
            if low >= robot.lower[j] + keep and high <= robot.upper[j] - keep:
                room = min(low - robot.lower[j], robot.upper[j] - high, np.pi)
                rank = -abs(way[0, j] + 2 * np.pi * m - start[j]) if start is not None else room
                choices.append((round(rank, 9), -abs(m), m))  # rounding does not decide ties
        if not choices:
            return None
        way[:, j] += 2 * np.pi * max(choices)[2]
    return way


def _expand_turns(q: Array, cost: Array, robot: Robot, turns: NDArray[np.bool_], room: float) -> tuple[Array, Array]:
    """Make every full turn between the limits a separate slot; slot modulo the old number is the old slot."""
    for j in np.flatnonzero(turns):
        variants, costs = [], []
        for m in (-1, 0, 1):
            moved = q.copy()
            moved[..., j] += 2 * np.pi * m
            inside = (moved[..., j] >= robot.lower[j] + room) & (moved[..., j] <= robot.upper[j] - room)
            if m == 0 or inside.any():
                variants.append(moved)
                costs.append(np.where(inside, cost, np.inf))
        q, cost = np.concatenate(variants, axis=2), np.concatenate(costs, axis=2)
    return q, cost


def _start_near(q: Array, cost: Array, start: Array, robot: Robot) -> Array:
    """Allow at the first station only the slot with the posture nearest to the start."""
    distance = np.abs(q[0] - start)
    distance = np.where(robot.prismatic, distance, np.minimum(distance, np.abs(distance - 2 * np.pi))).max(axis=2)
    distance = np.where(np.isfinite(cost[0]), np.nan_to_num(distance, nan=np.inf), np.inf)
    slot = int(np.unravel_index(int(np.argmin(distance)), distance.shape)[1])
    only = np.full_like(cost[0], np.inf)
    only[:, slot] = cost[0][:, slot]
    return np.concatenate([only[None], cost[1:]])


def _refuse(lattice: Lattice, station: int, cost: Array) -> None:
    """Raise the error of a search that ends at a station, with waypoint and reasons."""
    waypoint = int(lattice.stations[station])
    reasons = lattice.reason[station]
    if not np.isfinite(cost[station]).any():
        counts = np.bincount(reasons.ravel(), minlength=len(REASONS))
        names = [REASONS[r] for r in np.argsort(-counts) if counts[r] and r != USABLE]
        raise InfeasibleError(
            f"no posture at waypoint {waypoint}: {', '.join(names)}; move the part, free the rotation or another "
            "configuration",
            waypoints=[waypoint], limits=names,
        )  # fmt: skip
    raise InfeasibleError(
        f"no continuous motion reaches waypoint {waypoint}: the arm would have to change its configuration in the cut; "
        "move the part, free the rotation, or retract before this waypoint",
        waypoints=[waypoint], limits=["continuity"],
    )  # fmt: skip
