"""Time, posture and promise in one program: free coordinates along the path and the speed on it, decided together.

    minimise    w_t T / T_0 + w_b B / B_0 + w_e E / E_0 + w_m sum_f |dz_f| / unit_f
    over        z(s) = z_graph(s) + splines,   x(s) = (ds/dt)^2,   B
    subject to  F(q(s)) = pose(z(s))                          loaded tip and tool on the path; q eliminated exactly
                q_min <= q <= q_max,  |lead|, |lean|, |tip off the path| <= limits
                clearance(q) >= wanted, along the swept arm,  depth / limit of chatter(q) <= share
                band(q) <= B <= B_most
                q'^2 x <= v_max^2,  |q'' x + q' x' / 2| <= a_max,  x <= 1    velocity, acceleration, programmed feed
                |jerk|, |torque| <= limits where there are any

T is the time of the cut and of rapid moves, B the widest 95 % band by what is known of the robot, E the work of the
motors, sum |tau dq|, and |dz| how far a free coordinate travels: travel back and forth pays twice, so that no reversal
is left that buys nothing. Sequential quadratic programming over the free coordinates alone: every step is linearised
with the joints eliminated, x as the square of the speed keeps most rows straight, and what a step promises is checked
by the exact fastest run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from compplan.errors import ConvergenceError
from compplan.plan.fastest_run import TorqueParts, time_cut
from compplan.plan.freedom import Freedom
from compplan.plan.swept import SweptClearance
from compplan.plan.timing import cutting_runs, time_rapids
from compplan.robot import Array

#: Change of a free coordinate that tells how band and chatter answer. [units]
PROBE = 1e-3
#: Weight of a passed band in the figure that a step is judged by.
PASSED = 20.0
#: Stations at which the band is looked at.
BAND_STATIONS = 40


class Prices(NamedTuple):
    """What the program weighs, each in shares of what the start has.

    Attributes:
        time: Of the time of the run.
        band: Of the widest 95 % band.
        motion: Of one unit of travel of a free coordinate.
        most_band: Greatest band as a share of the start's; infinite where it may grow.
        energy: Of the work of the motors.

    """

    time: float = 1.0
    band: float = 0.0
    motion: float = 2e-3
    most_band: float = 1.0
    energy: float = 0.0

    @property
    def counts_band(self) -> bool:
        """Tell whether the band counts at all."""
        return self.band != 0.0 or bool(np.isfinite(self.most_band))


#: From first and last station, joint motion per programmed time and its derivative to torques tau = a u + b x + c.
TorquesAlong = Callable[[int, int, Array, Array], tuple[Array, Array, Array, Array]]


@dataclass(frozen=True)
class Ground:
    """What a program asks of postures, beside its limits.

    Attributes:
        band: Radius of the 95 % band at joint positions (k, nq) under a wrench (k, 6), None where it does not count.
            Shape (k,). [m]
        clear: What keeps the arm clear, None where nothing is in the way.
        room: Distance to joint limits that is kept where the start has it. [rad or m]
        torques: Torque rows of the stations from one to another at joint positions, or None.
        work: The same where the work of the motors counts, or None.

    """

    band: Callable[[Array, Array], Array] | None = None
    clear: SweptClearance | None = None
    room: float = 0.0
    torques: Callable[[Array], TorquesAlong] | None = None
    work: Callable[[Array], TorquesAlong] | None = None


@dataclass(frozen=True)
class TimedStretch:
    """One run from rest to rest between stations: its programmed times."""

    first: int
    last: int
    along: Array


@dataclass(frozen=True)
class Point:
    """Where the search stands.

    Attributes:
        change: Coefficients. Shape (m, f). [units]
        values: Free coordinates. Shape (k, f). [rad or m]
        q: Joint positions. Shape (k, nq). [rad or m]
        rate: Their derivative by the coordinates. Shape (k, nq, f).
        speeds: Share of the programmed feed along each run.
        time: Time of runs and rapid moves. [s]
        radius: Band at its stations. Shape (j,). [m]
        energy: Work of the motors along the runs, 0 where it does not count. [J]
        cost: What is minimised.
        slope: Derivative of the band by the coordinates where it is asked for. Shape (f, j). [m/rad or 1]

    """

    change: Array
    values: Array
    q: Array
    rate: Array
    speeds: list[Array]
    time: float
    radius: Array
    energy: float
    cost: float
    slope: Array | None = None


@dataclass
class JointProgram:
    """The program of a path.

    Attributes:
        freedom: What is free.
        ground: What postures have to keep.
        prices: What is weighed.
        runs: The runs from rest to rest.
        rapids: Stations that rapid moves end at.
        looked: Stations whose band is looked at.
        first: The start; what is weighed is weighed against it.
        steps: Steps taken.

    """

    freedom: Freedom
    ground: Ground
    prices: Prices
    runs: list[TimedStretch]
    rapids: NDArray[np.int_]
    looked: NDArray[np.int_]
    first: Point | None = None
    steps: int = field(default=0)

    def evaluate(self, change: Array, near: Array) -> Point | None:
        """Solve the joints, the fastest run and the band of a choice; None where it cannot be followed."""
        freedom, task = self.freedom, self.freedom.task
        values = freedom.values(change)
        q, rate, reached = freedom.pose(near, values)
        lower, upper = self.bounds()
        if not reached.all() or (q < lower - 1e-7).any() or (q > upper + 1e-7).any():
            return None
        if self.ground.clear is not None and not self.ground.clear.keeps(q):
            return None
        try:
            speeds, total = self.time(q)
        except ConvergenceError:
            return None
        moves = np.abs(q[self.rapids] - q[self.rapids - 1])
        total += float(time_rapids(moves, task.velocity_limits, task.acceleration_limits).sum())
        at = self.looked
        radius = np.ones(len(at)) if self.ground.band is None else self.ground.band(q[at], freedom.wrench[at])
        energy = sum(float(part.sum()) for part, *_ in self.work(q, speeds))
        point = Point(change, values, q, rate, speeds, total, radius, energy, 0.0)
        return replace(point, cost=self.cost(point))

    def differentiate(self, point: Point) -> Point:
        """Add the derivative of the band at its stations by every free coordinate, where the band counts."""
        freedom, at, f = self.freedom, self.looked, len(self.freedom.names)
        if self.ground.band is None or point.slope is not None:
            return point
        probes = point.q[at] + PROBE * np.moveaxis(point.rate[at] * freedom.units, 2, 0)
        found = self.ground.band(probes.reshape(-1, probes.shape[-1]), np.tile(freedom.wrench[at], (f, 1)))
        return replace(point, slope=(found.reshape(f, -1) - point.radius) / PROBE / freedom.units[:, None])

    def cost(self, point: Point) -> float:
        """Return what is minimised, a passed band included."""
        start = self.first or point
        widest, least = float(point.radius.max()), float(start.radius.max())
        travel = float((np.abs(np.diff(point.values[self.marks()], axis=0)) / self.freedom.units).sum())
        passed = max(widest / least - self.prices.most_band, 0.0)
        energy = self.prices.energy * point.energy / start.energy if start.energy > 0.0 else 0.0
        return self.prices.time * point.time / start.time + self.prices.band * widest / least + (
            energy + self.prices.motion * travel + PASSED * passed
        )

    def work(self, q: Array, speeds: list[Array]) -> Iterator[tuple[Array, Array, Array, Array]]:
        """Tell the work of the motors along each run; nothing where it does not count.

        Returns:
            Work of every motor on every move, and its derivative by the motion of the joint, by the square of the speed
            at the move's end and at its beginning, torques by posture and load as they are. Shapes (k - 1, nq). [J]

        """
        if self.ground.work is None:
            return
        rules = self.ground.work(q)
        for run, speed in zip(self.runs, speeds, strict=True):
            part, step = q[run.first : run.last + 1], np.diff(run.along)[:, None]
            curve = CubicSpline(run.along, part, bc_type="natural")
            a, b, c, _ = rules(run.first, run.last, curve(run.along, 1), curve(run.along, 2))
            x, move = speed[:, None] ** 2, np.diff(part, axis=0)
            torque = a[:-1] * np.diff(x, axis=0) / (2.0 * step) + b[:-1] * x[:-1] + c[:-1]
            sign = np.sign(torque * move)
            ahead = a[:-1] / (2.0 * step)
            yield sign * torque * move, sign * torque, sign * move * ahead, sign * move * (b[:-1] - ahead)

    def time(self, q: Array) -> tuple[list[Array], float]:
        """Return the speed along each run, and the time of all.

        Raises:
            ConvergenceError: If a run cannot keep its limits.

        """
        task, speeds, total = self.freedom.task, [], 0.0
        rules = None if self.ground.torques is None else self.ground.torques(q)
        for run in self.runs:
            rows: TorqueParts | None = None
            if rules is not None:
                def rows(rate: Array, change: Array, run: TimedStretch = run) -> tuple[Array, Array, Array, Array]:
                    return rules(run.first, run.last, rate, change)
            part = q[run.first : run.last + 1]
            speed = time_cut(run.along, part, task.velocity_limits, task.acceleration_limits, rows)[2]
            speeds.append(speed)
            total += float((2.0 * np.diff(run.along) / np.maximum(speed[1:] + speed[:-1], 1e-9)).sum())
        return speeds, total

    def bounds(self) -> tuple[Array, Array]:
        """Return the joint limits, away from them by what the start keeps. Shapes (nq,)."""
        robot = self.freedom.task.robot
        room = robot.room(self.ground.room)
        if self.first is not None:
            room = np.minimum(room, np.minimum(self.first.q - robot.lower, robot.upper - self.first.q).min(axis=0))
        return robot.lower + np.maximum(room, 0.0), robot.upper - np.maximum(room, 0.0)

    def marks(self) -> NDArray[np.int_]:
        """Return the stations between which travel of the free coordinates counts."""
        k, m = self.freedom.basis.shape
        return np.unique(np.linspace(0, k - 1, min(2 * m, k)).astype(int))


def build_program(freedom: Freedom, ground: Ground, prices: Prices) -> JointProgram | None:
    """Build the program of a path; None where there is no run to make shorter or the start cannot be evaluated."""
    task, rows = freedom.task, freedom.rows
    rapid = np.r_[False, task.nominal.rapid[rows[1:]]]
    rests = None if task.rests is None else task.rests[rows]
    length, time = np.r_[0.0, np.cumsum(task.nominal.steps)], np.r_[0.0, np.cumsum(np.maximum(task.step_time, 1e-7))]
    runs = [TimedStretch(a, b, time[rows[a : b + 1]] - time[rows[a]]) for a, b in cutting_runs(rapid, rests)
            if b - a >= 2 and length[rows[b]] > length[rows[a]]]  # fmt: skip
    cut = np.flatnonzero(task.cut[rows])
    if not runs or not len(cut):
        return None
    looked = cut[np.unique(np.linspace(0, len(cut) - 1, BAND_STATIONS).astype(int))]
    program = JointProgram(freedom, ground, prices, runs, np.flatnonzero(rapid), looked)
    program.first = program.evaluate(np.zeros((freedom.basis.shape[1], len(freedom.names))), task.q_start[rows])
    return None if program.first is None else program
