"""What a path leaves free: spin about the tool axis, leans, extra axes, a tube; and the joints that go with a choice.

The joints q of a station follow from the free coordinates z by the loaded pose equation F(q) = pose(z), F the loaded
equilibrium: it is solved for the six joints of the arm by Newton steps, and its exact derivative eliminates them:

    dq_arm/dz = J_arm^-1 (dpose/dz - J_extra dq_extra/dz),    J the loaded Jacobian.

Along the path, z departs from what the graph chose by cubic B-splines. In a tube the tip may leave the path: to its
left and along the tool axis by a share of what is allowed across the travel, ahead by one of what is allowed along it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from compplan.plan.task import PlanTask
from compplan.plan.timing import cutting_runs
from compplan.posture.lattice import orient_tool
from compplan.posture.summary import Stance
from compplan.robot import Array
from compplan.statics.ik import Arm, build_arm
from compplan.statics.sensitivity import attain_pose
from compplan.toolpath.contact import path_axes
from compplan.toolpath.toolpath import Toolpath, divide_toolpath

#: Coefficients of one free coordinate at most, and stations to one of them at least.
MOST_KNOTS, PER_KNOT = 40, 4
#: Coefficients at an end of a window that stay: value, slope and curvature go on.
HELD = 3
#: Change of a free coordinate that tells how the tool turns. [rad]
EPS = 1e-6
#: Newton steps of the loaded pose equation, and what it may miss. [m and rad]
NEWTON, REACHED = 8, 1e-7
#: Motion that a coordinate is reckoned in: spin, lean, an extra axis that turns or slides. [rad, rad, rad, m]
UNITS = {"spin": 0.3, "lead": 0.05, "lean": 0.05, "turn": 0.3, "slide": 0.2}
#: Ways of the tip in a tube, by the axes of the path frame: along the travel, to its left, along the tool axis.
TUBE = ("ahead", "left", "up")


@dataclass(frozen=True)
class Freedom:
    """The free coordinates of a path at k stations of a task; f coordinates, m coefficients of each.

    Attributes:
        task: The task.
        rows: Its waypoints that are stations. Shape (k,).
        names: What the coordinates are called: "spin", "lead", "lean", or the name of an extra axis.
        start: Their values as the graph chose them. Shape (k, f). [rad or m]
        units: Motion that each is reckoned in. Shape (f,). [rad or m]
        basis: B-splines at the stations. Shape (k, m).
        knots: Their knots along the waypoints of the toolpath.
        arm: The arm.
        upright: The toolpath at the stations, its tool axis as programmed.
        tool_x: Where x of the TCP points at spin 0, base axes. Shape (3,).
        twist: What the stance's orientation has beyond its own coordinates. Shape (k, 3, 3).
        wrench: Wrench at the stations, 0 in rapid moves. Shape (k, 6). [N, N m]
        most: Greatest size of each, infinite where joint limits alone hold it. Shape (k, f). [rad or m]
        frame: Axes of the path at the stations, as columns. Shape (k, 3, 3).
        ends: Whether the first and the last coefficients stay, because the path goes on there.

    """

    task: PlanTask
    rows: NDArray[np.int_]
    names: tuple[str, ...]
    start: Array
    units: Array
    basis: Array
    knots: Array
    arm: Arm
    upright: Toolpath
    tool_x: Array
    twist: Array
    wrench: Array
    most: Array
    frame: Array
    ends: tuple[bool, bool] = (False, False)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Coefficients that stay, so that a window goes on smoothly at its ends. Shape (m f,)."""
        m, place = self.basis.shape[1], np.arange(self.basis.shape[1])
        still = (self.ends[0] & (place < HELD)) | (self.ends[1] & (place >= m - HELD))
        return np.repeat(still, len(self.names))

    @property
    def extra(self) -> list[int]:
        """Places of the extra axes among the coordinates."""
        return [k for k, name in enumerate(self.names) if name not in ("spin", "lead", "lean", *TUBE)]

    def shift(self, values: Array, frame: Array) -> Array:
        """Return where the coordinates move the tip in its tube, path frames (p, 3, 3) given. Shape (p, 3). [m]."""
        moved = np.zeros((len(values), 3))
        for axis, name in enumerate(TUBE):
            if name in self.names:
                moved += values[:, [self.names.index(name)]] * frame[:, :, axis]
        return moved

    def values(self, change: Array) -> Array:
        """Return the coordinates at the stations for coefficients of shape (m, f), in units. Shape (k, f)."""
        return np.asarray(self.start + self.basis @ change * self.units)

    def spread(self, change: Array, places: Array) -> Array:
        """Return the change of the coordinates at places of the toolpath. Shape (p, f)."""
        inside = np.clip(places, self.knots[0], self.knots[-1])
        design = BSpline.design_matrix(inside, self.knots, 3).toarray()
        return np.asarray(design @ change * self.units)

    def orient(self, values: Array) -> Array:
        """Return the orientation of the TCP frame at the stations. Shape (k, 3, 3)."""
        angle = {name: values[:, k] for k, name in enumerate(self.names)}
        spin, lead, lean = (angle.get(name, np.zeros(len(values))) for name in ("spin", "lead", "lean"))
        rows = np.arange(len(values))
        return np.asarray(orient_tool(self.upright, self.tool_x, rows, spin, lead, lean) @ self.twist)

    def pose(self, q: Array, values: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Solve the loaded pose equation from nearby.

        Args:
            q: Joint positions to begin at. Shape (k, nq). [rad or m]
            values: Free coordinates. Shape (k, f). [rad or m]

        Returns:
            Joint positions (k, nq), their derivative by the coordinates (k, nq, f), and where they are reached (k,).

        """
        q, chain, arm = np.array(q), self.task.chain, self.arm
        target, wanted = self.orient(values), self.task.position[self.rows] + self.shift(values, self.frame)
        axes = arm.held[: len(self.extra)]
        q[:, axes] = values[:, self.extra]
        for _ in range(NEWTON):
            loaded = attain_pose(chain, q, self.wrench)
            turn = Rotation.from_matrix(target @ np.swapaxes(loaded.rotation, 1, 2)).as_rotvec()
            missed = np.hstack([wanted - loaded.position, turn])
            if np.abs(missed).max() < 1e-10:
                break
            step = _solve(loaded.jacobian[:, :, arm.arm], missed[..., None])[..., 0]
            q[:, arm.arm] += step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        rate = np.zeros((*q.shape, len(self.names)))
        for k in range(len(self.names)):
            wish = np.zeros((len(q), 6))
            if k in self.extra:
                axis = axes[self.extra.index(k)]
                wish -= loaded.jacobian[:, :, axis]
                rate[:, axis, k] = 1.0
            elif self.names[k] in TUBE:
                wish[:, :3] = self.frame[:, :, TUBE.index(self.names[k])]
            else:
                moved = values.copy()
                moved[:, k] += EPS
                wish[:, 3:] = Rotation.from_matrix(self.orient(moved) @ np.swapaxes(target, 1, 2)).as_rotvec() / EPS
            rate[:, arm.arm, k] = _solve(loaded.jacobian[:, :, arm.arm], wish[..., None])[..., 0]
        return q, rate, np.abs(missed).max(axis=1) < REACHED


def find_freedom(
    task: PlanTask, stance: Stance, nominal: Toolpath, tool_x: Array, most: int, tube: float = 0.0,
    window: tuple[int, int] | None = None,
) -> Freedom | None:  # fmt: skip
    """Find what a stance leaves free; None where nothing is.

    Args:
        task: The task that starts with the stance.
        stance: The stance.
        nominal: The toolpath that the stance was chosen for, its tool axis as programmed.
        tool_x: Where x of the TCP points at spin 0, base axes. Shape (3,).
        most: Stations at most.
        tube: Share of the tolerance by which the tip may leave the path.
        window: First and last waypoint of the task that are looked at, all of them if left out.

    """
    first, last = window or (0, len(task) - 1)
    settings, arm, robot = stance.settings, build_arm(task.robot), task.robot
    given = {"spin": stance.spin, "lead": stance.lead, "lean": stance.lean}
    free = {"spin": settings.free_spin, "lead": settings.lead > 0, "lean": settings.lean > 0}
    names = [name for name in given if free[name]]
    rows, every = pick_stations(task, most, first, last), np.arange(len(nominal))
    place = task.origin[rows]
    ways = _allow_tube(task, rows, tube)
    if not (names or ways or len(arm.held)) or len(arm.arm) != 6:
        return None
    units = [UNITS[name] for name in names] + [float(size.max()) for size in ways.values()]
    units += [UNITS["slide" if robot.prismatic[j] else "turn"] for j in arm.held]
    start = [np.interp(place, every, given[name]) for name in names] + [np.zeros(len(rows))] * len(ways)
    start += [task.q_start[rows, j] for j in arm.held]
    whole = np.ones(len(rows))
    sizes = {"lead": settings.lead * whole, "lean": settings.lean * whole, **ways}
    count = int(np.clip(len(rows) // PER_KNOT, 4, MOST_KNOTS))
    inner = np.unique(np.interp(np.linspace(0.0, len(rows) - 1, count - 2), np.arange(len(rows)), place))
    knots = np.r_[[inner[0]] * 3, inner, [inner[-1]] * 3]
    called, upright = (*names, *ways, *(robot.joint_names[j] for j in arm.held)), divide_toolpath(nominal, place)
    freedom = Freedom(
        task, rows, called, np.stack(start, axis=1), np.array(units),
        BSpline.design_matrix(place, knots, 3).toarray(), knots, arm, upright, tool_x,
        np.tile(np.eye(3), (len(rows), 1, 1)), np.where(task.compensated[rows, None], task.wrench[rows], 0.0),
        np.stack([sizes.get(name, np.inf * whole) for name in called], axis=1), path_axes(upright),
        (first > 0, last < len(task) - 1),
    )  # fmt: skip
    if any(np.abs(value).max() > 0.0 for name, value in given.items() if name not in names):
        return None
    angles = [np.interp(place, every, value) for value in given.values()]
    stood = orient_tool(freedom.upright, tool_x, np.arange(len(rows)), *angles)
    return replace(freedom, twist=np.swapaxes(stood, 1, 2) @ task.rotation[rows])


def _allow_tube(task: PlanTask, rows: NDArray[np.int_], share: float) -> dict[str, Array]:
    """Return how far the tip may go each way at the stations, none in rapid moves and where it rests. Shapes (k,). [m].

    Of what is allowed across the travel both ways there have an even part of the square.
    """
    if share <= 0.0:
        return {}
    allowed, inside = task.allowed, task.cut.copy()
    for first, last in cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests):
        inside[[first, last]] = False
    size = share * inside * (task.tolerance if allowed is None else allowed.normal)
    ways = {"left": size / np.sqrt(2.0), "up": size / np.sqrt(2.0)}
    if allowed is not None and allowed.apart.any():
        along = np.nan_to_num(allowed.tangential, posinf=0.0)
        ways = {"ahead": np.where(allowed.apart, share * inside * along, 0.0), **ways}
    return {name: size[rows] for name, size in ways.items() if size[rows].any()}


def pick_stations(task: PlanTask, most: int, first: int, last: int) -> NDArray[np.int_]:
    """Pick waypoints of a window evenly in programmed time; ends of rapid moves and rests belong to them."""
    rapid = np.r_[False, task.nominal.rapid[1:]]
    ends = np.flatnonzero(rapid | np.r_[rapid[1:], False] | (False if task.rests is None else task.rests))
    if last - first < most:
        return np.arange(first, last + 1)
    time = np.r_[0.0, np.cumsum(np.maximum(task.step_time, 1e-7))]
    even = np.searchsorted(time, np.linspace(time[first], time[last], most))
    return np.unique(np.r_[first, np.clip(even, first, last), ends[(ends > first) & (ends < last)], last])


def _solve(columns: Array, wanted: Array) -> Array:
    """Solve with a little damping, which singular postures need. Shapes (k, 6, 6) and (k, 6, c)."""
    turned = np.swapaxes(columns, 1, 2)
    return np.asarray(np.linalg.solve(turned @ columns + 1e-10 * np.eye(6), turned @ wanted))
