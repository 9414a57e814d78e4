"""Evaluation of a run against its path."""

from __future__ import annotations

import numpy as np

from compplan.planning.task import PlanTask, attain_rows
from compplan.robot import Array
from compplan.simulation.simulated_robot import (
    Evaluation,
    SimulatedRobot,
    SimulatedRun,
    run_simulated_robot,
    with_touched_part,
)
from compplan.statics.stiffness import attain_pose


def find_part(task: PlanTask, cell: SimulatedRobot) -> SimulatedRobot:
    """Return the simulated robot with the part frame measured by touching, if the task has one."""
    if task.touched is None or cell.displacement is not None:
        return cell
    return with_touched_part(cell, task.touched.q, task.touched.shown)


def evaluate_run(task: PlanTask, q: Array, cell: SimulatedRobot, bias: Array | None = None) -> Evaluation:
    """Run a command (n, nq) [rad or m] on a simulated robot and compare the TCP under load with the nominal path.

    `bias` (n, s) [N m or N]: inertial load on each of s elastic coordinates; default: that of the task.
    """
    more = task.bias if bias is None else bias
    return _compare(task, run_simulated_robot(find_part(task, cell), q, task.wrench, task.step_time, more))


def evaluate_model(task: PlanTask, q: Array) -> Evaluation:
    """Compare the TCP under load of a command (n, nq) [rad or m] in the planner's model with the nominal path."""
    if task.robot.effects:
        found = attain_rows(task, q, np.arange(len(q)), slope=False)
    else:
        found = attain_pose(task.chain, q, task.wrench, slope=False, torque_bias=task.bias, theta=task.theta)
        found = task.to_part_frame_pose(found)
    return _compare(task, SimulatedRun(found.position, found.rotation))


def _compare(task: PlanTask, run: SimulatedRun) -> Evaluation:
    position, rotation = run
    cosine = -np.einsum("ni,ni->n", rotation[:, :, 2], task.nominal.axis)
    sine = np.linalg.norm(np.cross(rotation[:, :, 2], task.nominal.axis), axis=1)
    away, tilt = position - task.programmed, np.arctan2(sine, cosine)
    return Evaluation(position, rotation, away, tilt, task.compensated)
