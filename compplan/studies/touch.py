"""Touch-off in a study: every drawn robot finds the part by touching it before it cuts."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from compplan.effects.attained import attain_with_effects, rest_robot
from compplan.job.noise import NoiseTable
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.robot.pose import linear_displacement
from compplan.studies.kernel import Kernel, settle_tips
from compplan.studies.posterior import MODES
from compplan.studies.sampling import Cells, differentiate_placements, shift_tip
from compplan.toolpath.toolpath import select_waypoints
from compplan.uncertainty.touch_off import TouchedPart, locate_touching

#: Columns of `differentiate_placements`: growth, part frame.
GROWN, PART_AXES = 1, 6


class Touch(NamedTuple):
    """Touched points, components first; k points.

    Attributes:
        q: Joint positions there. Shape (nq, 1, k). [rad or m]
        shown: The points in the found frame. Shape (3, k). [m]
        placements: Motion of the tip per placement error. Shape (c, 3, k).
        offset: Motion of the tip by the effects of the robot folder. Shape (3, k). [m]
        fit: Shift of the middle and rotation vector of the best-fit motion of the points. Shape (6, 3 k).
    """

    q: Array
    shown: Array
    placements: Array
    offset: Array
    fit: Array


def prepare_touch(task: PlanTask, noise: NoiseTable, touched: TouchedPart | None) -> Touch | None:
    """Prepare the touched points of a strategy's posture; None where the part frame is absolute."""
    if touched is None:
        return None
    k, robot = len(touched.q), rest_robot(task.robot)
    nominal = replace(select_waypoints(task.nominal, np.zeros(k, int)), position=touched.shown, events=())
    there = replace(
        task, robot=robot, nominal=nominal, q_start=touched.q, wrench=np.zeros((k, 6)), rotation=task.rotation[:k],
        compensated=np.ones(k, bool), missed=np.zeros(k, bool), lead=np.zeros(k, bool), rests=np.zeros(k, bool),
        bias=None, links=None, places=None, start=None, step_time=np.ones(k - 1),
        theta=np.zeros((k, task.chain.n_springs)), touched=None,
    )  # fmt: skip
    rates = differentiate_placements(there, noise)[0]
    rates[GROWN : GROWN + PART_AXES] = 0.0  # the part does not move between touch and cut
    rates[len(rates) - 3 * MODES :] = 0.0  # the band counts what is unexplained as it is
    offset = np.zeros((k, 3))
    if robot.effects:
        plain = attain_with_effects(replace(robot, effects=()), touched.q, np.zeros((k, 6)), np.ones(k - 1))[0]
        offset = locate_touching(robot, touched.q) - plain
    return Touch(touched.q.T[:, None, :], touched.shown.T, rates, offset.T, linear_displacement(touched.shown))


def move_part(touch: Touch, kernel: Kernel, cells: Cells, scale: Array, position: Array) -> Array:
    """Return where the part of every cell stands beside the found frame, at positions (3, n). Shape (3, b, n). [m]

    scale: share of each spring's deflection that the feedback leaves. Shape (s, b).
    """
    b, k = cells.zero.shape[1], touch.q.shape[2]
    q = (touch.q + cells.zero[:, :, None]).reshape(len(touch.q), -1)
    factor = np.repeat(cells.factor * scale, k, axis=1)
    tips = settle_tips(kernel, q, np.zeros((6, b * k)), factor, np.zeros_like(factor)).reshape(3, b, k)
    gap = tips + shift_tip(cells.causes, touch.placements) + (touch.offset - touch.shown)[:, None, :]
    twist = touch.fit @ np.moveaxis(gap, 1, 0).transpose(0, 2, 1).reshape(b, -1).T
    lever = position - touch.shown.mean(axis=1, keepdims=True)
    return np.asarray(twist[:3, :, None] + np.cross(twist[3:, :, None], lever[:, None, :], axis=0))
