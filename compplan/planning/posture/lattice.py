"""Ladder graph: all postures at some waypoints of a path, with their costs.

A rung is a station (a waypoint of the path). Its nodes are all options (spin, position of extra axes, lead and lean of
the tool axis) times all configurations of the arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.planning.posture.costs import SINGULARITY_MARGIN, measure_nodes
from compplan.planning.posture.settings import PostureProblem
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import CONFIGURATIONS, Arm, middle_of_limits, solve_branches, stretch_arm
from compplan.toolpath.contact import path_axes, tool_axes
from compplan.toolpath.toolpath import Toolpath, select_even

#: State of a node: usable, or the reason of its exclusion.
USABLE, OUT_OF_REACH, JOINT_LIMIT, SINGULAR, COLLISION, EXCLUDED = range(6)
#: Coarse step of the spin where an extra axis or tilts vary too, and where several axes do. [rad]
FEW_SPINS, FEWER_SPINS = float(np.radians(10.0)), float(np.radians(20.0))
#: Rotation of the tool axis about the joint next to the part from which that joint follows it [rad], positions of the
#: joint about it, and sine of the angle between both axes above which the rotation is well defined.
FOLLOWED, SIDES, ACROSS = float(np.radians(45.0)), 8, float(np.sin(np.radians(20.0)))
#: Distance of a rail's arm from the middle of a path at which the rail is held, as a share of the arm's reach.
RAIL_DISTANCE = 0.6
REASONS = ("usable", "out of reach", "joint limit", "singular", "collision", "configuration not wanted")


@dataclass(frozen=True)
class Options:
    """Options at one waypoint, g combinations."""

    #: Rotation about the tool axis (tip to spindle), zero with x along `tool_x`.
    #: Shape (k, g) or (1, g). [rad]
    spin: Array
    held: Array  #: Positions of the extra axes. Shape (k, g, h) or (1, g, h). [m or rad]
    lead: Array  #: Tilt of the tool axis along the path. Shape (k, g) or (1, g). [rad]
    lean: Array  #: Tilt of the tool axis across the path. Shape (k, g) or (1, g). [rad]
    neighbours: NDArray[np.int_]  #: Options that a step may start from, -1 in unused entries. Shape (g, w).
    shape: tuple[int, int, int]  #: Grid shape of g: spins, positions of extra axes, tilts.
    steps: Array  #: Grid step of each extra axis, 0 for a fixed one. Shape (h,). [m or rad]


@dataclass(frozen=True)
class Lattice:
    """Nodes of the ladder graph: k stations, g options, b slots."""

    stations: NDArray[np.int_]  #: Waypoint of each station. Shape (k,).
    options: Options  #: Options at each station.
    q: Array  #: Joint positions, NaN where there is no solution. Shape (k, g, b, nq). [rad or m]
    sensitivity: Array  #: Expected remaining deviation. Shape (k, g, b). [m]
    limits: Array  #: Nearness to joint limits. Shape (k, g, b).
    dexterity: Array  #: Inverse condition number. Shape (k, g, b).
    reason: NDArray[np.int8]  #: Index into `REASONS`. Shape (k, g, b).

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Return which nodes are usable; singular ones are, at a cost. Shape (k, g, b)."""
        return (self.reason == USABLE) | (self.reason == SINGULAR)

    def part(self, first: int, last: int) -> Lattice:
        """Return the lattice of the stations from `first` up to but without `last`."""
        on = slice(first, last)
        return Lattice(self.stations[on], self.options, self.q[on], self.sensitivity[on], self.limits[on],
                       self.dexterity[on], self.reason[on])  # fmt: skip

    def refuse(self, nodes: NDArray[np.bool_], why: int) -> Lattice:
        """Exclude nodes, shape (k, g, b) or broadcastable to it, for a reason."""
        return replace(self, reason=np.where(self.usable & nodes, why, self.reason).astype(np.int8))


def pick_stations(nominal: Toolpath, count: int) -> NDArray[np.int_]:
    """Pick waypoints evenly by length and by rotation of the tool axis; both ends of rapid moves are included."""
    n = len(nominal)
    if n <= count:
        return np.arange(n)
    turn = np.arccos(np.clip(np.einsum("ni,ni->n", nominal.axis[:-1], nominal.axis[1:]), -1.0, 1.0))
    steps = np.where(nominal.rapid[1:], 0.0, nominal.steps)
    share = steps / max(steps.sum(), 1e-300) + 0.5 * turn / max(turn.sum(), 1e-300)
    along = np.concatenate([[0.0], np.cumsum(share)])
    even = np.searchsorted(along, np.linspace(0.0, along[-1], count))
    rapid = np.flatnonzero(nominal.rapid[1:])
    ends = np.unique(np.r_[rapid, rapid + 1])
    return np.unique(np.r_[0, np.clip(even, 0, n - 1), select_even(ends, count), n - 1])


def follow_axis(arm: Arm, nominal: Toolpath) -> Array | None:
    """Return positions (n,) [rad] of the joint next to the part with the tool always on one side, or None.

    A part that is machined from all sides rotates under the tool: with b the angle of the tool axis about the joint
    axis in the part frame, the joint is at a constant - b, in the middle of its range. Where the two axes are nearly
    parallel, b is interpolated.
    """
    robot, joint = arm.robot, int(arm.robot.carriers.sum()) - 1
    if joint < 0 or joint not in arm.held or robot.prismatic[joint] or robot.lower[joint] == robot.upper[joint]:
        return None
    turn = -locate_frames(arm.chain, np.zeros((1, arm.chain.nq))).axis[0, arm.chain.joint_elements[joint]]
    first = np.cross(turn, np.eye(3)[np.abs(turn).argmin()])
    first /= np.linalg.norm(first)
    x, y = nominal.axis @ first, nominal.axis @ np.cross(turn, first)
    defined = np.flatnonzero(np.hypot(x, y) > ACROSS)
    if not len(defined):
        return None
    angle = np.interp(np.arange(len(nominal)), defined, np.unwrap(np.arctan2(y[defined], x[defined])))
    if np.ptp(angle) < FOLLOWED:
        return None
    return np.asarray(middle_of_limits(robot)[joint] + 0.5 * (angle.max() + angle.min()) - angle)


def build_options(problem: PostureProblem, stations: NDArray[np.int_]) -> Options:
    """Build the grid of options, equal for all stations (k,) except a joint that follows the tool (`follow_axis`)."""
    arm, settings = problem.arm, problem.settings
    follow = follow_axis(arm, problem.nominal) if settings.search else None
    varies = bool(len(arm.held)) or settings.lead > 0 or settings.lean > 0
    step = max(settings.spin_step, FEW_SPINS if len(arm.held) < 2 else FEWER_SPINS) if varies else settings.spin_step
    count = max(1, round(2 * np.pi / step)) if settings.free_spin else 1
    spins = np.arange(count) * 2 * np.pi / count
    robot, rest, axes = arm.robot, _hold_axes(problem), len(arm.held)
    positions = settings.held_steps if axes < 2 else max(3, int((3 * settings.held_steps) ** (1.0 / axes) + 1e-9))
    ranges = []
    followed = -1 if follow is None else int(robot.carriers.sum()) - 1
    for joint in arm.held:
        low, high = robot.lower[joint], robot.upper[joint]
        if joint == followed:
            ranges.append(np.arange(-SIDES // 2, SIDES - SIDES // 2) * 2 * np.pi / SIDES)
        elif settings.search and np.isfinite(low) and np.isfinite(high) and high > low:
            ranges.append(np.linspace(low, high, positions))
        else:
            ranges.append(rest[[joint]])
    cells = list(product(*ranges))
    held = np.array(cells, float).reshape(len(cells), len(arm.held))
    leans = [np.linspace(-limit, limit, 3) if limit > 0 else np.zeros(1) for limit in (settings.lead, settings.lean)]
    cone = [limit if limit > 0 else 1.0 for limit in (settings.lead, settings.lean)]  # elliptic
    tilts = np.array([tilt for tilt in product(*leans) if np.sum((np.array(tilt) / cone) ** 2) <= 1.0 + 1e-9])
    s, h, t = (axis.ravel() for axis in np.meshgrid(*(np.arange(len(v)) for v in (spins, held, tilts)), indexing="ij"))
    places = held[h][None]
    if follow is not None:
        places = places + np.where(arm.held == followed, follow[stations, None, None], 0.0)
    return Options(
        spin=spins[s][None],
        held=places,
        lead=tilts[t, 0][None],
        lean=tilts[t, 1][None],
        neighbours=_neighbours((len(spins), len(held), len(tilts)), [len(r) for r in ranges], tilts),
        shape=(len(spins), len(held), len(tilts)),
        steps=np.array([v[1] - v[0] if len(v) > 1 else 0.0 for v in ranges]),
    )


def _hold_axes(problem: PostureProblem) -> Array:
    """Return the positions of fixed extra axes: job's start, rails with the path in reach, otherwise mid-range.

    Rails: the arm's first axis is horizontally a share of its reach from the middle of the path. Shape (nq,).
    """
    arm, settings = problem.arm, problem.settings
    rest = middle_of_limits(arm.robot)
    if settings.search:
        return rest
    if settings.start is not None:
        return settings.start
    if arm.robot.prismatic[arm.held].all():
        for j in arm.held:
            grid = np.tile(rest, (61, 1))
            grid[:, j] = np.linspace(arm.robot.lower[j], arm.robot.upper[j], 61)
            origin = locate_frames(arm.chain, grid).origin[:, arm.chain.joint_elements[arm.arm[0]]]
            away = np.linalg.norm((origin - problem.nominal.position.mean(axis=0))[:, :2], axis=1)
            rest = grid[np.abs(away - RAIL_DISTANCE * stretch_arm(arm)).argmin()]
    return rest


def orient_tool(
    nominal: Toolpath, tool_x: Array, rows: NDArray[np.int_], spin: Array, lead: Array, lean: Array
) -> Array:
    """Return the orientation of the TCP frame at some waypoints (k,), z out of the tool, columns in base axes.

    The tool axis is tilted forward by `lead` along the path and by `lean` to its left, then the tool rotates about its
    axis by `spin`, right-handed about the direction from tip to spindle; x points along tool_x (3,) at spin 0.
    Angles have shape (k, ...) [rad], the result (k, ..., 3, 3).
    """
    shape = np.broadcast_shapes(spin.shape, lead.shape, lean.shape)
    turn, count = np.broadcast_to(spin, shape).ravel(), int(np.prod(shape[1:]))
    zero_spin = np.repeat(tool_axes(nominal, tool_x)[rows], count, axis=0)
    rotation = zero_spin @ Rotation.from_rotvec(turn[:, None] * np.array([0.0, 0.0, -1.0])).as_matrix()
    if np.any(lead) or np.any(lean):
        angles = np.stack([-np.broadcast_to(lean, shape).ravel(), np.broadcast_to(lead, shape).ravel()], axis=1)
        local = np.repeat(path_axes(nominal)[rows], count, axis=0)
        tilt = (local[..., :2] @ angles[..., None])[..., 0]
        rotation = Rotation.from_rotvec(tilt).as_matrix() @ rotation
    return rotation.reshape(*shape, 3, 3)


def fill_lattice(
    problem: PostureProblem, stations: NDArray[np.int_], options: Options, position: Array | None = None
) -> Lattice:
    """Solve the inverse kinematics of every node at stations (k,) and compute its criteria.

    `position` (k, 3) [m] are the tip positions of the stations (default: those of the path).
    """
    arm, settings, nominal = problem.arm, problem.settings, problem.nominal
    k, g = len(stations), options.spin.shape[1]
    spin, lead, lean = (np.broadcast_to(v, (k, g)) for v in (options.spin, options.lead, options.lean))
    held = np.broadcast_to(options.held, (k, g, options.held.shape[2])).reshape(k * g, -1)
    rotation = orient_tool(nominal, problem.tool_x, stations, spin, lead, lean).reshape(k * g, 3, 3)
    place = np.repeat(nominal.position[stations] if position is None else position, g, axis=0)
    q = solve_branches(arm, place, rotation, held).reshape(k, g, -1, problem.chain.nq)
    q = _wrap_into_limits(q, arm)
    reached = np.isfinite(q[..., 0])
    reason = np.where(reached, USABLE, OUT_OF_REACH).astype(np.int8)
    room = arm.robot.room(settings.limit_room)
    low, high = arm.robot.lower + room, arm.robot.upper - room
    inside = ((q >= low) & (q <= high)).all(axis=3)
    reason[reached & ~inside] = JOINT_LIMIT
    words = settings.configuration.items()
    wanted = np.array([all(slot[key] == word for key, word in words) for slot in CONFIGURATIONS])
    reason[(reason == USABLE) & ~wanted[: q.shape[2]]] = EXCLUDED
    values = {name: np.full(reached.shape, np.nan) for name in ("sensitivity", "limits", "dexterity")}
    rows = np.nonzero(reason == USABLE)
    nodes = measure_nodes(
        problem.chain, q[rows], problem.wrench[stations][rows[0]], limits=arm.robot.arm_limits,
        uncertainty=settings.known, axes=settings.axes, margin=settings.limit_margin,
    )  # fmt: skip
    for name, array in values.items():
        array[rows] = getattr(nodes, name)
    reason[(reason == USABLE) & (values["dexterity"] < SINGULARITY_MARGIN)] = SINGULAR
    return Lattice(stations, options, q, reason=reason, **values)


def _wrap_into_limits(q: Array, arm: Arm) -> Array:
    """Shift revolute joints by a full turn into their limits where possible."""
    low, high = arm.robot.lower, arm.robot.upper
    turn = np.where(arm.robot.prismatic, 0.0, 2 * np.pi)
    q = np.where(q < low, q + turn, q)
    return np.where((q > high) & (q - turn >= low), q - turn, q)


def _neighbours(shape: tuple[int, int, int], held: list[int], tilts: Array) -> NDArray[np.int_]:
    """List the neighbours of every option: within a few spins, one position of each extra axis, one step of tilt."""
    spins, positions, leans = shape
    wide = 4 if spins > 30 else 2
    window = range(-wide, wide + 1) if spins > 8 else range(-(spins // 2), spins - spins // 2)
    cells = np.array(list(np.ndindex(*held)), int).reshape(positions, len(held))
    near_held = [np.flatnonzero(np.abs(cells - cell).max(axis=1, initial=0) <= 1) for cell in cells]
    step = np.maximum(np.abs(tilts).max(axis=0), 1e-12)
    near_tilt = [np.flatnonzero((np.abs(tilts - tilt) <= 1.01 * step).all(axis=1)) for tilt in tilts]
    rows = []
    for s, h, t in product(range(spins), range(positions), range(leans)):
        around = product(((s + d) % spins for d in window), near_held[h], near_tilt[t])
        rows.append([(a * positions + b) * leans + c for a, b, c in around])
    width = max(len(row) for row in rows)
    return np.array([row + [-1] * (width - len(row)) for row in rows])
