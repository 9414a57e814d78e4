"""How far a run is from its path, and how far a command from its limits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.cell.cell import MISMATCHES, Cell, build_cell, run_cell
from compplan.errors import ShapeError
from compplan.plan.strategies.limits import measure_correction
from compplan.plan.task import PlanTask, attain_rows
from compplan.plan.timing import Timing
from compplan.robot import Array
from compplan.statics.sensitivity import attain_pose


@dataclass(frozen=True)
class Evaluation:
    """A run in a cell against its path; n waypoints, base frame. Figures are of the waypoints of the cut.

    Attributes:
        cell: Name of the cell.
        position: Attained tip. Shape (n, 3). [m]
        rotation: Attained orientation of the TCP frame. Shape (n, 3, 3).
        deviation: Attained minus nominal tip. Shape (n, 3). [m]
        tilt: Angle between attained and nominal tool axis. Shape (n,). [rad]
        cut: Waypoints that are compensated and judged. Shape (n,).

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


class Mismatch(NamedTuple):
    """What a command leaves in a cell that differs from the planner's model.

    Attributes:
        cell: Name of the cell; says in what it differs.
        rms_deviation: Root mean square distance over the judged waypoints. [m]
        max_deviation: Greatest distance over them. [m]
        waypoints: How many waypoints of the cut were judged, evenly spread.

    """

    cell: str
    rms_deviation: float
    max_deviation: float
    waypoints: int


def evaluate_mismatch(task: PlanTask, q: Array, factor: float = MISMATCHES[0], most: int = 10000) -> Mismatch:
    """Run a command in a cell whose compliances are all wrong by a factor.

    Args:
        task: The task; its predicted wrench acts.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        factor: Compliance of the cell over that of the model; assumed, not measured.
        most: How many waypoints to judge at most; all of them where effects of the robot depend on the motion.

    """
    cell = build_cell(task.robot.scale_compliance(factor), f"compliance x {factor:g}")
    rows = np.flatnonzero(task.compensated)
    if task.robot.effects:
        position = run_cell(cell, q, task.wrench, task.step_time).position[rows]
    else:
        rows = rows[:: max(1, -(-len(rows) // most))]
        position = run_cell(cell, q[rows], task.wrench[rows]).position
    distance = np.linalg.norm(position - task.position[rows], axis=1)
    return Mismatch(cell.name, float(np.sqrt(np.mean(distance**2))), float(distance.max()), len(rows))


def evaluate_run(
    task: PlanTask, q: Array, cell: Cell, wrench: Array | None = None, bias: Array | None = None
) -> Evaluation:
    """Run a command in a cell and compare the loaded tool with the nominal path.

    Args:
        task: The task.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        cell: The cell.
        wrench: Wrench that acts, the task's if left out. Shape (n, 6). [N, N m]
        bias: Load of inertia on each elastic coordinate, the task's if left out. Shape (n, s). [N m or N]

    """
    load, more = task.wrench if wrench is None else wrench, task.bias if bias is None else bias
    run = run_cell(cell, q, load, task.step_time, more)
    return _compare(task, cell.name, run.position, run.rotation)


def evaluate_model(task: PlanTask, q: Array) -> Evaluation:
    """Compare with the nominal path where the planner's own model sees the loaded tool: fast, and no judge."""
    if task.robot.effects:
        attained = attain_rows(task, q, np.arange(len(q)), slope=False)
    else:
        attained = attain_pose(task.chain, q, task.wrench, slope=False, torque_bias=task.bias)
    return _compare(task, "planner's model", attained.position, attained.rotation)


def _compare(task: PlanTask, name: str, position: Array, rotation: Array) -> Evaluation:
    cosine = -np.einsum("ni,ni->n", rotation[:, :, 2], task.nominal.axis)
    sine = np.linalg.norm(np.cross(rotation[:, :, 2], task.nominal.axis), axis=1)
    return Evaluation(name, position, rotation, position - task.position, np.arctan2(sine, cosine), task.compensated)


def measure_margins(task: PlanTask, q: Array, timing: Timing) -> Margins:
    """Measure how far a command stays from its limits."""
    room = np.minimum(q - task.robot.lower, task.robot.upper - q).min(axis=0)
    joint = int(room.argmin())
    correction = float(measure_correction(task, q)[task.compensated].max(initial=0.0))
    return Margins(float(room[joint]), joint, timing.velocity_ratio, timing.acceleration_ratio, correction)


def path_accuracy(nominal: Array, attained: Array) -> float:
    """Compute the path accuracy of repeated runs [ISO 9283]: greatest distance of the mean attained path from nominal.

    Args:
        nominal: Wanted tips. Shape (n, 3). [m]
        attained: Attained tips of each repetition. Shape (repetitions, n, 3). [m]

    Raises:
        ShapeError: If the arrays do not belong together.

    """
    if attained.ndim != 3 or attained.shape[1:] != nominal.shape:
        raise ShapeError(f"attained has shape {attained.shape}, expected (repetitions, {len(nominal)}, 3)")
    return float(np.linalg.norm(attained.mean(axis=0) - nominal, axis=1).max())
