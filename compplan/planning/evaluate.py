"""How far a run is from its path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.planning.task import PlanTask, attain_rows
from compplan.robot import Array
from compplan.simulation.simulated_robot import (
    SimulatedRobot,
    SimulatedRun,
    run_simulated_robot,
    touch_cell,
)
from compplan.statics.stiffness import attain_pose


@dataclass(frozen=True)
class Evaluation:
    """A run in a cell against its path; n waypoints, base frame. Figures are of the waypoints of the cut."""

    position: Array  #: Attained tip. Shape (n, 3). [m]
    rotation: Array  #: Attained orientation of the TCP frame. Shape (n, 3, 3).
    deviation: Array  #: Attained minus nominal tip. Shape (n, 3). [m]
    tilt: Array  #: Angle between attained and nominal tool axis. Shape (n,). [rad]
    cut: NDArray[np.bool_]  #: Waypoints that are compensated and evaluated. Shape (n,).

    @cached_property
    def distance(self) -> Array:
        """Distance of the attained tip from the nominal one. Shape (n,). [m]"""
        return np.asarray(np.linalg.norm(self.deviation, axis=1))

    @property
    def rms_deviation(self) -> float:
        """Root mean square distance over the cut. [m]"""
        return float(np.sqrt(np.mean(self.distance[self.cut] ** 2)))

    @property
    def max_deviation(self) -> float:
        """Greatest distance over the cut. [m]"""
        return float(self.distance[self.cut].max())

    @property
    def max_tilt(self) -> float:
        """Greatest angle between attained and nominal tool axis over the cut. [rad]"""
        return float(self.tilt[self.cut].max())

    @property
    def figures(self) -> dict[str, float]:
        """Deviation over the cut as files hold it: rms, mean and max. [mm]"""
        sizes = {"rms": self.rms_deviation, "mean": float(self.distance[self.cut].mean()), "max": self.max_deviation}
        return {name: value * 1e3 for name, value in sizes.items()}

    def share_within(self, tolerance: float) -> float:
        """Return the share of the cut's waypoints within a distance [m] of the path."""
        return float((self.distance[self.cut] <= tolerance).mean())


def find_part(task: PlanTask, cell: SimulatedRobot) -> SimulatedRobot:
    """Return a cell whose robot has found the part by touching it, where the task says so."""
    if task.touched is None or cell.displacement is not None:
        return cell
    return touch_cell(cell, task.touched.q, task.touched.shown)


def evaluate_run(task: PlanTask, q: Array, cell: SimulatedRobot, bias: Array | None = None) -> Evaluation:
    """Run a command (n, nq) in a cell and compare the loaded tool with the nominal path.

    The load of inertia on each elastic coordinate (n, s) is the task's if left out.
    """
    more = task.bias if bias is None else bias
    return _compare(task, run_simulated_robot(find_part(task, cell), q, task.wrench, task.step_time, more))


def evaluate_model(task: PlanTask, q: Array) -> Evaluation:
    """Compare a command (n, nq) with the nominal path as the planner's own model sees the loaded tool."""
    if task.robot.effects:
        found = attain_rows(task, q, np.arange(len(q)), slope=False)
    else:
        found = attain_pose(task.chain, q, task.wrench, slope=False, torque_bias=task.bias, theta=task.theta)
        found = task.see_pose(found)
    return _compare(task, SimulatedRun(found.position, found.rotation))


def _compare(task: PlanTask, run: SimulatedRun) -> Evaluation:
    position, rotation = run
    cosine = -np.einsum("ni,ni->n", rotation[:, :, 2], task.nominal.axis)
    sine = np.linalg.norm(np.cross(rotation[:, :, 2], task.nominal.axis), axis=1)
    away, tilt = position - task.programmed, np.arctan2(sine, cosine)
    return Evaluation(position, rotation, away, tilt, task.compensated)
