"""Deviation of the loaded tool between waypoints, and division of moves.

The motion between waypoints is joint-linear (joints.csv, joint moves of programs) or Cartesian-linear (commanded tip on
a straight line); the wrench is interpolated linearly. Divisions keep every waypoint; new ones lie on the straight move,
with a posture between their neighbours.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.effects.attained import attain_with_effects
from compplan.errors import InfeasibleError
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, solve_posture_near
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.contact import turn_about_axis
from compplan.toolpath.corners import find_corners
from compplan.toolpath.events import find_halts
from compplan.toolpath.toolpath import Toolpath, divide_toolpath

#: Evaluated places on a move, as shares of it.
SHARES = (0.5, 0.25, 0.75)
#: Deviation in the middle of a move below which other places are not evaluated. [m]
STRAIGHT = 2e-7
#: Waypoints at rest along which the correction grows where a force begins abruptly, or fades where one ends abruptly.
LEAD_ROWS = 8
#: Shortest step next to a rest [m], and ratio of successive steps.
FIRST_STEP, GROWTH = 1e-4, 1.8
#: Greatest motion of a joint in one move of a cut. [rad, m]
MOST_TURN, MOST_SLIDE = float(np.radians(4.0)), 0.05
#: Change of direction of a reversal. [rad]
REVERSAL = float(np.arccos(-0.9))
#: Most pieces of a move per division, and most waypoints of a path.
MOST_PIECES, MOST_WAYPOINTS = 16, 1_000_000


class Between(NamedTuple):
    """Greatest distance of the loaded tip from each move; n - 1 moves, zero in rapid moves."""

    joint: Array  #: Joint positions linear in time. Shape (n - 1,). [m]
    cartesian: Array  #: Commanded tip on a straight line. Shape (n - 1,). [m]

    @property
    def most(self) -> Array:
        """Greatest distance of both. Shape (n - 1,). [m]"""
        return np.maximum(self.joint, self.cartesian)

    @property
    def max_deviation(self) -> float:
        """Greatest distance over the path. [m]"""
        return float(self.most.max(initial=0.0))


def cutting_moves(task: PlanTask) -> NDArray[np.int_]:
    """Return the moves of the cut, by their first waypoint."""
    return np.flatnonzero(~task.nominal.rapid[1:] & ~task.lead[1:])


def measure_between(task: PlanTask, q: Array) -> Between:
    """Compute the deviation of the loaded tip between waypoints of a command (n, nq), as modelled."""
    moves, n = cutting_moves(task), len(task)
    joint, cartesian = np.zeros(n - 1), np.zeros(n - 1)
    plain = locate_frames(task.chain, q).tcp_position
    for share in SHARES:
        if share != SHARES[0]:
            moves = moves[Between(joint, cartesian).most[moves] > STRAIGHT]
        if not len(moves):
            break
        start, end = task.position[moves], task.position[moves + 1]
        load = task.wrench[moves] * (1 - share) + task.wrench[moves + 1] * share
        middle = q[moves] * (1 - share) + q[moves + 1] * share
        bias = None if task.bias is None else task.bias[moves] * (1 - share) + task.bias[moves + 1] * share
        loaded = _attain(task, q, middle, load, bias, moves, share)
        joint[moves] = np.maximum(joint[moves], distance_to_moves(loaded, start, end))
        straight = plain[moves] * (1 - share) + plain[moves + 1] * share
        bent = loaded - locate_frames(task.chain, middle).tcp_position
        cartesian[moves] = np.maximum(cartesian[moves], distance_to_moves(straight + bent, start, end))
    return Between(joint, cartesian)


def insert_between(values: Array, inside: Array, moves: NDArray[np.int_], share: float) -> Array:
    """Insert one row into every move: given rows at `moves`, otherwise interpolated. Shape (2 n - 1, ...)."""
    rows = np.empty((2 * len(values) - 1, *values.shape[1:]))
    rows[::2], rows[1::2] = values, values[:-1] * (1 - share) + values[1:] * share
    rows[2 * moves + 1] = inside
    return rows


def divide_times(step_time: Array, share: float) -> Array:
    """Return the times of all moves of a path of `insert_between`. Shape (2 n - 2,). [s]"""
    return np.stack([step_time * share, step_time * (1 - share)], axis=1).ravel()


def _attain(
    task: PlanTask, q: Array, middle: Array, load: Array, bias: Array | None, moves: NDArray[np.int_], share: float
) -> Array:
    """Compute the loaded tip at a share of some moves; effects of the robot folder need the complete path in order."""
    near = task.theta[moves]
    loaded = attain_pose(task.chain, middle, load, slope=False, torque_bias=bias, theta=near).position
    if not task.robot.effects:
        return task.to_part_frame(loaded)
    if bias is not None:
        loaded = loaded - attain_pose(task.chain, middle, load, slope=False).position
    path, acting = (insert_between(*parts, moves, share) for parts in ((q, middle), (task.wrench, load)))
    tip = attain_with_effects(task.robot, path, acting, divide_times(task.step_time, share))[0][2 * moves + 1]
    return task.to_part_frame(tip if bias is None else tip + loaded)


def required_pieces(deviation: Array, chord: float) -> NDArray[np.int_]:
    """Return the number of pieces of each move with a deviation (n - 1,) [m] for a deviation within `chord` [m]."""
    excess = deviation / max(chord, 1e-12)
    return np.where(excess > 1.0, np.ceil(np.sqrt(1.2 * excess)), 1.0).astype(int)


def distance_to_moves(point: Array, start: Array, end: Array) -> Array:
    """Compute the distance of points from straight moves. Shape (k,)."""
    along = end - start
    square = np.maximum(np.einsum("ni,ni->n", along, along), 1e-30)
    share = np.clip(np.einsum("ni,ni->n", point - start, along) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(point - start - share[:, None] * along, axis=1))


def predict_loads(task: PlanTask, feed: Array | None = None) -> Array:
    """Predict the planned wrench at every waypoint. Shape (n, 6). [N, N m]

    A point of contact has no wrench (except a dead weight): the tool reaches it in a rapid move, without contact. Along
    a lead-in the wrench of the following cut grows linearly; along a lead-out that of the previous cut fades. `feed`
    (n,) [m/s] is that of the move that ends at each waypoint (default: programmed).
    """
    nominal = task.nominal
    given = nominal.wrench if task.law is None else task.law.predict(nominal, feed)
    wrench = np.zeros((len(nominal), 6)) if given is None else np.array(given)
    if task.law is None or not task.law.always:
        wrench[find_contacts(nominal.rapid)] = 0.0
    edges = np.flatnonzero(np.diff(np.r_[False, task.lead, False]))
    for first, end in edges.reshape(-1, 2).tolist():
        share = np.arange(1.0, end - first + 1.0)[:, None] / (end - first)
        wrench[first:end] = (1.0 - share) * wrench[first - 1] if task.leaving[first] else share * wrench[end]
    return wrench


def find_contacts(rapid: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the waypoints at the end of a rapid move and the beginning of a cut."""
    return np.flatnonzero(rapid[:-1] & ~rapid[1:])


def divide_task(task: PlanTask, places: Array, lead: NDArray[np.bool_] | None = None) -> PlanTask:
    """Divide moves of a task.

    Args:
        task: The task.
        places: Old waypoint numbers of the new waypoints, fractional on a move, ascending; with all old ones. (m,)
        lead: New waypoints of a lead-in after a contact, or of a lead-out after a cut. Shape (m,).
    """
    before = np.clip(np.floor(places).astype(int), 0, len(task) - 2)
    share = (places - before)[:, None]
    nominal = divide_toolpath(task.nominal, places)
    old = np.flatnonzero((places == np.round(places)) & np.r_[True, np.diff(places) > 0])
    at = places[old].astype(int)
    leads = np.zeros(len(places), bool)
    leads[old] = task.lead[at]
    if lead is not None:
        rapid, feed = nominal.rapid.copy(), nominal.feed.copy()
        rapid[lead] = False
        feed[lead] = task.nominal.feed[before[lead] + task.nominal.rapid[before[lead]]]
        nominal, leads = replace(nominal, rapid=rapid, feed=feed), leads | lead
    q = task.q_start[before] * (1 - share) + task.q_start[before + 1] * share
    x = task.rotation[before, :, 0] * (1 - share) + task.rotation[before + 1, :, 0] * share
    rotation, missed, rests = turn_about_axis(x, nominal.axis), np.zeros(len(places), bool), np.zeros(len(places), bool)
    q[old], rotation[old], missed[old] = task.q_start[at], task.rotation[at], task.missed[at]
    rests[old] = task.rests[at]
    fresh = np.ones(len(places), bool)
    fresh[old] = False
    fresh &= share[:, 0] > 0
    if fresh.any():
        arm, position = build_arm(task.robot), nominal.position[fresh]
        q[fresh], rotation[fresh], reached = solve_posture_near(arm, q[fresh], position, rotation[fresh],
                                                        spin_free=task.spin_free)  # fmt: skip
        missed[fresh] = ~reached
    compensated = ~nominal.rapid
    compensated[find_contacts(nominal.rapid)] = True
    new = replace(
        task, nominal=nominal, rotation=rotation, compensated=compensated, q_start=q, missed=missed, rests=rests,
        lead=leads, wrench=np.zeros((len(places), 6)), bias=None, links=None, step_time=programmed_times(nominal),
        origin=np.interp(places, np.arange(len(task)), task.origin),
    )  # fmt: skip
    return replace(new, wrench=predict_loads(new))


def prepare_sampling(task: PlanTask, *, rest_at_corners: bool) -> PlanTask:
    """Add lead-ins, lead-outs, rests (at sharp corners on request) and the first division to a task with posture."""
    rapid = task.nominal.rapid
    contacts, leaves = find_contacts(rapid), np.flatnonzero(~rapid[:-1] & rapid[1:])
    sudden, abrupt = (True, True) if task.law is None else (task.law.sudden, task.law.abrupt)
    contacts = contacts[sudden & (np.abs(task.wrench[contacts + 1]).max(axis=1) > 0)]
    leaves = leaves[abrupt & (np.abs(task.wrench[leaves]).max(axis=1) > 0)]
    if len(contacts) + len(leaves):
        leads = np.repeat(np.r_[contacts, leaves], LEAD_ROWS)
        places = np.sort(np.r_[np.arange(len(task)), leads]).astype(float)
        task = divide_task(task, places, np.r_[False, np.diff(places) == 0])
    rests = np.zeros(len(task), bool)
    rests[:-1] = (task.lead[:-1] & ~task.lead[1:]) | task.leaving[1:] & ~task.lead[:-1]
    if rest_at_corners:
        rests[_find_rests(task.nominal)] = True
    rapid = task.nominal.rapid
    rests[[k for k in find_halts(task.nominal.events) if not rapid[k : k + 2].any() and k + 1 < len(task)]] = True
    task = replace(task, rests=rests)
    graded = _grade(task) if task.follows_feed else np.zeros(0)
    places = np.unique(np.r_[np.arange(len(task)), graded, _bound_travel(task)])
    return divide_task(task, places) if len(places) > len(task) else task


def divide_by(task: PlanTask, pieces: NDArray[np.int_]) -> PlanTask:
    """Divide the move that starts at each waypoint into equal pieces. Shape of `pieces`: (n - 1,).

    Raises:
        InfeasibleError: If there are too many waypoints; with the waypoint of the most pieces.

    """
    count = np.clip(pieces, 1, MOST_PIECES)
    if count.sum() > MOST_WAYPOINTS:
        worst = int(np.argmax(count))
        message = (
            f"path makes {count.sum()} waypoints when it is divided to stay within {1e3 * task.chord:.3g} mm between "
            f"them, at most {MOST_WAYPOINTS}, the most after waypoint {worst}, "
            f"{1e3 * task.nominal.arc_length[worst]:.1f} mm along the path; raise sampling.chord_mm or plan part of it"
        )
        raise InfeasibleError(message, waypoints=[worst], limits=["number of waypoints"])
    extra = np.repeat(np.arange(len(task) - 1), count - 1)
    first = np.concatenate([[0], np.cumsum(count - 1)[:-1]])
    share = (np.arange(len(extra)) - first[extra] + 1.0) / count[extra]
    return divide_task(task, np.sort(np.r_[np.arange(len(task)), extra + share]))


def _find_rests(nominal: Toolpath) -> NDArray[np.int_]:
    """Find sharp corners of the cut, reversals included."""
    corners, turn = find_corners(nominal)
    back = (turn > REVERSAL) & ~nominal.rapid & ~np.r_[nominal.rapid[1:], True]
    if nominal.rounded is not None:
        curved = nominal.rounded > 0.0
        curved[1:-1] |= curved[:-2] | curved[2:]
        corners = corners[~curved[corners]]
    return np.union1d(corners, np.flatnonzero(back))


def programmed_times(nominal: Toolpath) -> Array:
    """Compute the time of every move at the programmed feed, of rapid moves at the median feed. Shape (n - 1,). [s]"""
    feed, cutting = nominal.feed[1:], ~nominal.rapid[1:]
    typical = float(np.median(feed[cutting & (feed > 0)])) if (cutting & (feed > 0)).any() else 0.1
    return np.asarray(nominal.steps / np.where(cutting & (feed > 0), feed, typical))


def _grade(task: PlanTask) -> Array:
    """Return places next to every rest, at growing distances: there the force grows with the feed."""
    steps = task.nominal.steps
    places = [
        grow_places(move, FIRST_STEP / max(float(steps[move]), 1e-12), forward)
        for first, last in task.runs
        for move, forward in ((first, True), (last - 1, False))
    ]
    return np.concatenate([np.zeros(0), *places])


def grow_places(move: int, share: float, forward: bool) -> Array:
    """Return places on a move at growing distances from its start (or its end), the first at a share of the move."""
    shares = share * GROWTH ** np.arange(max(np.ceil(np.log(0.6 / share) / np.log(GROWTH)), 0.0))
    return np.asarray(move + shares if forward else move + 1.0 - shares)


def _bound_travel(task: PlanTask) -> Array:
    """Return places that bound the joint motion of every move of the cut."""
    most = np.where(task.robot.prismatic, MOST_SLIDE, MOST_TURN)
    need = np.ceil((np.abs(np.diff(task.q_start, axis=0)) / most).max(axis=1) - 1e-9).astype(int)
    need[task.nominal.rapid[1:] | task.missed[1:] | task.missed[:-1]] = 1
    need = np.clip(need, 1, MOST_PIECES)
    wide = np.flatnonzero(need > 1)
    return np.concatenate([np.zeros(0), *(i + np.arange(1, need[i]) / need[i] for i in wide)])
