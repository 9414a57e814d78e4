"""How far a run is from its path, and how far a command from its limits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import PlanTask, attain_rows, measure_correction
from compplan.planning.timing import Timing
from compplan.robot import Array
from compplan.simulation.simulated_robot import (
    MISMATCHES,
    SimulatedRobot,
    SimulatedRun,
    build_simulated_robot,
    run_simulated_robot,
    touch_cell,
)
from compplan.statics.stiffness import attain_pose

#: Waypoints that are judged in a cell with other compliances.
MOST_JUDGED = 10_000


@dataclass(frozen=True)
class Evaluation:
    """A run in a cell against its path; n waypoints, base frame. Figures are of the waypoints of the cut.

    Attributes:
        cell: Name of the cell.
        position: Attained tip. Shape (n, 3). [m]
        rotation: Attained orientation of the TCP frame. Shape (n, 3, 3).
        deviation: Attained minus nominal tip. Shape (n, 3). [m]
        tilt: Angle between attained and nominal tool axis. Shape (n,). [rad]
        cut: Waypoints that are compensated and evaluated. Shape (n,).

    """

    cell: str
    position: Array
    rotation: Array
    deviation: Array
    tilt: Array
    cut: NDArray[np.bool_]

    @cached_property
    def distance(self) -> Array:
        """Distance of the attained tip from the nominal one. Shape (n,). [m]."""
        return np.asarray(np.linalg.norm(self.deviation, axis=1))

    @property
    def rms_deviation(self) -> float:
        """Root mean square distance over the cut. [m]."""
        return float(np.sqrt(np.mean(self.distance[self.cut] ** 2)))

    @property
    def mean_deviation(self) -> float:
        """Mean distance over the cut. [m]."""
        return float(self.distance[self.cut].mean())

    @property
    def max_deviation(self) -> float:
        """Greatest distance over the cut. [m]."""
        return float(self.distance[self.cut].max())

    @property
    def max_tilt(self) -> float:
        """Greatest angle between attained and nominal tool axis over the cut. [rad]."""
        return float(self.tilt[self.cut].max())

    @property
    def figures(self) -> dict[str, float]:
        """Deviation over the cut as files hold it: rms, mean and max. [mm]."""
        sizes = {"rms": self.rms_deviation, "mean": self.mean_deviation, "max": self.max_deviation}
        return {name: value * 1e3 for name, value in sizes.items()}

    def share_within(self, tolerance: float) -> float:
        """Return the share of the cut's waypoints within a distance [m] of the path."""
        return float((self.distance[self.cut] <= tolerance).mean())


class Margins(NamedTuple):
    """How far a command stays from its limits.

    Attributes:
        position: Least distance of a joint from its position limits; negative beyond. [rad or m]
        joint: The joint that comes nearest, counted from 0.
        velocity_ratio: Greatest joint velocity against its limit.
        acceleration_ratio: Greatest joint acceleration against its limit.
        max_correction: Greatest correction in the cut. [m]

    """

    position: float
    joint: int
    velocity_ratio: float
    acceleration_ratio: float
    max_correction: float


@dataclass(frozen=True, eq=False)
class Mismatch:
    """What a command leaves in a cell that differs from the planner's model.

    Attributes:
        cell: Name of the cell; says in what it differs.
        rows: Waypoints of the cut that were judged, evenly spread. Shape (k,).
        deviation: Attained minus nominal tip there. Shape (k, 3). [m]

    """

    cell: str
    rows: NDArray[np.int_]
    deviation: Array

    @cached_property
    def distance(self) -> Array:
        """Distance of the attained tip from the nominal one. Shape (k,). [m]."""
        return np.asarray(np.linalg.norm(self.deviation, axis=1))

    @property
    def rms_deviation(self) -> float:
        """Root mean square distance. [m]."""
        return float(np.sqrt(np.mean(self.distance**2)))

    @property
    def max_deviation(self) -> float:
        """Greatest distance. [m]."""
        return float(self.distance.max())

    @property
    def waypoints(self) -> int:
        """How many waypoints were judged."""
        return len(self.rows)

    def describe(self) -> dict[str, Any]:
        """Describe it for plan.json."""
        return {"cell": self.cell, "rms_mm": self.rms_deviation * 1e3, "max_mm": self.max_deviation * 1e3,
                "waypoints": self.waypoints}  # fmt: skip

    def along(self, count: int) -> Array:
        """Return the distance at all waypoints of the path, interpolated between those judged. Shape (count,). [m]."""
        return np.asarray(np.interp(np.arange(count), self.rows, self.distance))


def evaluate_mismatch(task: PlanTask, q: Array) -> Mismatch:
    """Run a command (n, nq) in a cell whose compliances are all wrong by one factor, which is assumed, not measured.

    At most MOST_JUDGED waypoints are judged; all of them where effects of the robot depend on the motion.
    """
    cell = build_simulated_robot(task.robot.scale_compliance(MISMATCHES[0]), f"compliance x {MISMATCHES[0]:g}")
    cell = find_part(task, cell)
    rows = np.flatnonzero(task.compensated)
    if task.robot.effects:
        position = run_simulated_robot(cell, q, task.wrench, task.step_time).position[rows]
    else:
        rows = rows[:: max(1, -(-len(rows) // MOST_JUDGED))]
        position = run_simulated_robot(cell, q[rows], task.wrench[rows]).position
    return Mismatch(cell.name, rows, position - task.programmed[rows])


def find_part(task: PlanTask, cell: SimulatedRobot) -> SimulatedRobot:
    """Return a cell whose robot has found the part by touching it, where the task says so."""
    if task.touched is None or cell.displacement is not None:
        return cell
    return touch_cell(cell, task.touched.q, task.touched.shown)


def evaluate_run(
    task: PlanTask, q: Array, cell: SimulatedRobot, wrench: Array | None = None, bias: Array | None = None
) -> Evaluation:
    """Run a command (n, nq) in a cell and compare the loaded tool with the nominal path.

    Wrench (n, 6) [N, N m] and load of inertia on each elastic coordinate (n, s) are the task's if left out.
    """
    load, more = task.wrench if wrench is None else wrench, task.bias if bias is None else bias
    cell = find_part(task, cell)
    return _compare(task, cell.name, run_simulated_robot(cell, q, load, task.step_time, more))


def evaluate_model(task: PlanTask, q: Array) -> Evaluation:
    """Compare a command (n, nq) with the nominal path as the planner's own model sees the loaded tool; no judge."""
    if task.robot.effects:
        found = attain_rows(task, q, np.arange(len(q)), slope=False)
    else:
        found = attain_pose(task.chain, q, task.wrench, slope=False, torque_bias=task.bias, theta=task.theta)
        found = task.see_pose(found)
    return _compare(task, "planner's model", SimulatedRun(found.position, found.rotation))


def _compare(task: PlanTask, name: str, run: SimulatedRun) -> Evaluation:
    position, rotation = run
    cosine = -np.einsum("ni,ni->n", rotation[:, :, 2], task.nominal.axis)
    sine = np.linalg.norm(np.cross(rotation[:, :, 2], task.nominal.axis), axis=1)
    away, tilt = position - task.programmed, np.arctan2(sine, cosine)
    return Evaluation(name, position, rotation, away, tilt, task.compensated)


def measure_margins(task: PlanTask, q: Array, timing: Timing) -> Margins:
    """Measure how far a command stays from its limits."""
    held = task.robot.lower == task.robot.upper  # stands where the job wants it
    room = np.where(held, np.inf, np.minimum(q - task.robot.lower, task.robot.upper - q).min(axis=0))
    joint = int(room.argmin())
    correction = float(measure_correction(task, q)[task.compensated].max(initial=0.0))
    return Margins(float(room[joint]), joint, timing.velocity_ratio, timing.acceleration_ratio, correction)
