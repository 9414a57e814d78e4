"""A taught robot is tried on paths that its part did not see, before it is delivered: copies of the path, moved aside.

What a lesson says of the robot is the mean of what the folder before held possible. Where it moves the tip of such a
path farther than that folder allowed with 95 %, or the arm finds no equilibrium, it explains the part by something that
does not hold elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError
from compplan.measurement.distance import band_radius
from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty
from compplan.statics.ik import build_arm, pose_error, refine_ik
from compplan.uncertainty.band import linearise_path, split_covariance
from compplan.uncertainty.sensitivities import ForceSpread, apply_wrench_to_model, build_path_model, pick_rows, tip_of

#: How far a copy is moved along each base axis, at least (assumed: as far as a neighbouring part lies), and how many
#: rows of it are looked at. [m]
ASIDE, ROWS = 0.15, 60
#: Where a copy is reached. [m, rad]
REACHED = 1e-6


def check_generalisation(
    task: PlanTask, taught: Robot, known: Uncertainty, shares: Array, spread: ForceSpread
) -> tuple[bool, str]:
    """Try a taught robot on copies of the path, moved along each base axis to where the arm reaches.

    Args:
        task: The task that was cut, with the robot of the folder before.
        taught: The taught robot, with the tool of the job.
        known: What was known of the robot.
        shares: What is told of the force, in standard deviations of level and turns. Shape (4,).
        spread: How surely the force was known.

    Returns:
        Whether it holds there, and what the copies say; "" where none is reached.
    """
    rows = pick_rows(task.cut, ROWS)
    wrench, every = task.wrench[rows], np.ones(len(rows), bool)
    moved, allowed = [], []
    for q in _move_aside(task, rows):
        try:
            before, after = (build_path_model(robot, q, wrench) for robot in (task.robot, taught))
            here = np.arange(len(rows))
            change = tip_of(apply_wrench_to_model(after, shares, spread), here) - tip_of(before, here)
        except ConvergenceError:
            return False, "the updated arm has no equilibrium on a displaced copy of the path"
        slopes = linearise_path(before, known, spread, every)
        parts = split_covariance(slopes, known)
        moved.append(np.linalg.norm(change, axis=1))
        allowed.append(band_radius(np.asarray(sum(parts.values()))))
    if not moved:
        return True, ""
    size, band = (np.sqrt(np.mean(np.square(values), axis=1)) for values in (moved, allowed))
    worst = int(np.argmax(size / np.maximum(band, 1e-12)))
    said = (
        f"on {len(moved)} displaced copies of the path, the updated robot moves the tip by up to"
        f" {1e3 * size[worst]:.3g} mm where the old folder allowed {1e3 * band[worst]:.3g} mm (95 %)"
    )
    return bool(size[worst] <= band[worst]), said


def _move_aside(task: PlanTask, rows: NDArray[np.int_]) -> list[Array]:
    """Return joint positions of the copies that are reached within the limits. Shape (k, nq) each. [rad or m]"""
    robot, place = task.robot, task.position[rows]
    arm, way = build_arm(robot), max(ASIDE, float(np.ptp(place, axis=0).max()))
    found = []
    for axis in np.eye(3):
        for shift in (way * axis, -way * axis):
            q = refine_ik(arm, task.q_start[rows], place + shift, task.rotation[rows], iterations=30)
            miss = np.abs(pose_error(arm.chain, q, place + shift, task.rotation[rows])).max()
            if miss <= REACHED and ((q >= robot.lower) & (q <= robot.upper)).all():
                found.append(q)
                break
    return found
