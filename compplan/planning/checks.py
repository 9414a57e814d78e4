"""Checks of a plan beside the loaded tip: tool axis, correction, limits, effort, feed, times, inertia.

Each is computed from the commanded joints by engines of its own. A plan is not confirmed where one fails.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from compplan.controllers.readback.robot import JointTable, read_joints
from compplan.job.job import Job
from compplan.planning.deflection import Bending
from compplan.planning.evaluate import Evaluation
from compplan.planning.strategies.limits import AT_CORRECTION
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.simulation.exact import ExactRobot
from compplan.simulation.inertia import find_inside, fit_parabolas, load_springs, shift_tip, solve_rigid

#: Rounding that limits, times and feeds leave.
ROUNDING = 1.002
#: The tool may lean this much besides what loads bend. [rad]
LEAN = float(np.radians(0.05))
#: Time between samples in which jerks are looked for. [s]
SAMPLE = 1e-3
#: Rows at which inertia is worked out a second time where nothing is compensated, and its greatest difference.
LOOKED_AT, INERTIA_SHARE, INERTIA_LEAST = 2000, 0.1, 2e-6


@dataclass(frozen=True)
class Driven:
    """What is driven, and what it is judged with.

    Attributes:
        task: The task.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Shape (n,). [s]
        job: The job.
        judge: The robot as the judge reads it.
        moving: The same with all masses and no weight.

    """

    task: PlanTask
    q: Array
    time: Array
    job: Job
    judge: ExactRobot
    moving: ExactRobot

    @property
    def cutting(self) -> NDArray[np.bool_]:
        """Whether the move that ends at each row cuts or leads in. Shape (n,)."""
        return np.r_[False, ~self.task.nominal.rapid[1:]]


def run_checks(driven: Driven, after: Evaluation, bending: Bending) -> tuple[str, ...]:
    """Return what speaks against a plan besides the loaded tip.

    Args:
        driven: What is driven.
        after: The command in the judge's cell.
        bending: What the plan says bends the arm.

    """
    assert driven.task.robot.folder is not None
    joints = read_joints(Path(driven.task.robot.folder))
    position, rotation = solve_rigid(driven.judge, driven.q)
    return (
        *_vote_on_axis(driven, after, rotation), *_vote_on_correction(driven, position),
        *_vote_on_motion(driven, joints), *_vote_on_feed(driven), *_vote_on_inertia(driven, bending),
    )  # fmt: skip


def _vote_on_axis(driven: Driven, after: Evaluation, stiff: Array) -> list[str]:
    """The loaded tool's axis lies along the path's, but for what loads bend; its x too where it is not free."""
    task, cut = driven.task, after.cut
    bent = _angle(after.rotation[:, :, 2], stiff[:, :, 2])
    beyond = np.where(cut, after.tilt - np.maximum(1.5 * bent, 0.0), -1.0)
    worst = int(beyond.argmax())
    if beyond[worst] > LEAN:
        return [
            f"the independent check finds the tool axis "
            f"{np.degrees(after.tilt[worst]):.3g} deg aside at waypoint {worst}"
        ]
    if task.spin_free or driven.q.shape[1] < 6:
        return []
    towards = driven.job.T_base_part[:3, :3] @ np.asarray(driven.job.plan.tool_x, float)
    upright, axis = task.upright, task.nominal.axis
    flat = towards - (upright @ towards)[:, None] * upright
    size = np.linalg.norm(flat, axis=1)
    middle = upright + axis  # a lean takes x along: half a turn about the programmed axis, half one about the middle
    for about in (upright, middle / np.linalg.norm(middle, axis=1, keepdims=True)):
        flat = 2.0 * np.einsum("ni,ni->n", flat, about)[:, None] * about - flat
    sure = cut & (size > 0.05 * np.linalg.norm(towards))
    turned = np.where(sure, _angle(after.rotation[:, :, 0], flat / np.maximum(size, 1e-12)[:, None]) - 1.5 * bent, -1.0)
    worst = int(turned.argmax())
    if turned[worst] > LEAN + 1.5 * _angle(after.rotation[worst : worst + 1, :, 0], stiff[worst : worst + 1, :, 0])[0]:
        return [
            f"the independent check finds the tool turned "
            f"{np.degrees(turned[worst]):.3g} deg about its axis, waypoint {worst}"
        ]
    return []


def _angle(a: Array, b: Array) -> Array:
    """Return the angle between unit vectors. Shape (n,). [rad]."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ni,ni->n", a, b)))


def _vote_on_correction(driven: Driven, stiff: Array) -> list[str]:
    """The unloaded tip stays within the correction that the job allows."""
    task = driven.task
    most = task.max_correction
    size = np.where(task.compensated, np.linalg.norm(stiff - task.position, axis=1), 0.0)
    if size.max() <= most + 2 * AT_CORRECTION:
        return []
    found = f"{1e3 * size.max():.3g} mm at waypoint {size.argmax()}"
    return [f"the independent check finds a correction of {found}, allowed are {1e3 * most:g} mm"]


def _vote_on_motion(driven: Driven, joints: JointTable) -> list[str]:
    """Joints stay within the limits that the robot folder states, in place and in time."""
    q, time, found = driven.q, driven.time, []
    limits, cutting = driven.job.limits, driven.cutting
    if len(joints.names) != q.shape[1]:
        return [f"the robot folder has {len(joints.names)} joints, the program commands {q.shape[1]}"]
    over = np.maximum(joints.lower - q, q - joints.upper).max(axis=0)
    for j in np.flatnonzero(over > 1e-9).tolist():
        found.append(f"{joints.names[j]} passes its limits in robot.urdf by {_state(over[j], joints.slides[j])}")
    step = np.diff(time)
    if (step < 0.0).any():
        return [*found, f"time runs backwards at waypoint {int((step < 0.0).argmax()) + 1}"]
    moved = np.abs(np.diff(q, axis=0))
    use = (moved / np.maximum(step, 1e-12)[:, None] / joints.velocity / limits.velocity_scale).max(axis=0)
    for j in np.flatnonzero(use > ROUNDING).tolist():
        found.append(f"{joints.names[j]} moves {use[j]:.3g} times as fast as robot.urdf allows")
    rests = np.zeros(len(q), bool) if driven.task.rests is None else driven.task.rests
    rows = find_inside(time, cutting)
    rows = rows[~rests[rows]]
    if len(rows):
        push = np.abs(fit_parabolas(q, time, rows)[1]) / joints.acceleration / limits.acceleration_scale
        most = push.max(axis=0)
        for j in np.flatnonzero(most > ROUNDING * 1.01).tolist():
            found.append(f"{joints.names[j]} accelerates {most[j]:.3g} times as much as elasticity.toml allows")
    return [*found, *_vote_on_jerk(driven, joints)]


def _vote_on_jerk(driven: Driven, joints: JointTable) -> list[str]:
    """Sampled every millisecond, as a cubic spline over time through each run, no joint passes a limit of the jerk."""
    limits, task = driven.job.limits, driven.task
    after = np.inf if limits.full_acceleration_after_s is None else limits.full_acceleration_after_s
    assumed = joints.acceleration * limits.acceleration_scale / after if after < np.inf else joints.jerk
    allowed = joints.jerk if np.isfinite(joints.jerk).any() else assumed
    if not np.isfinite(allowed).any():
        return []
    rests = np.zeros(len(driven.q), bool) if task.rests is None else task.rests
    ends = np.flatnonzero(rests | ~driven.cutting | np.r_[~driven.cutting[1:], True])
    use = np.zeros(len(allowed))
    for first, last in pairwise(ends):
        rows = np.arange(first, last + 1)
        rows = rows[np.r_[True, np.diff(driven.time[rows]) > 1e-9]]
        samples = np.arange(driven.time[rows[0]], driven.time[rows[-1]], SAMPLE)
        if len(rows) > 2 and len(samples) > 3:
            curve = CubicSpline(driven.time[rows], driven.q[rows], bc_type="clamped")
            use = np.maximum(use, np.abs(np.diff(curve(samples), 3, axis=0)).max(axis=0) / SAMPLE**3 / allowed)
    return [f"{joints.names[j]} jerks {use[j]:.3g} times as much as is allowed" for j in np.flatnonzero(use > ROUNDING)]


def _state(over: float, slides: bool) -> str:
    return f"{1e3 * over:.3g} mm" if slides else f"{np.degrees(over):.3g} deg"


def _vote_on_feed(driven: Driven) -> list[str]:
    """The wanted tip never runs faster than the feed programmed."""
    task, step = driven.task, np.diff(driven.time)
    cut = driven.cutting[1:] & ~task.lead[1:] & (task.nominal.feed[1:] > 0.0)
    length = np.linalg.norm(np.diff(task.position, axis=0), axis=1)
    faster = np.where(cut, length - ROUNDING * step * task.nominal.feed[1:], -1.0)
    if faster.max(initial=-1.0) <= 1e-7:
        return []
    k = int(faster.argmax())
    driven_at, programmed = 60e3 * length[k] / max(float(step[k]), 1e-12), 60e3 * task.nominal.feed[k + 1]
    return [f"the tool runs at {driven_at:.4g} mm/min to waypoint {k + 1}, programmed are {programmed:.4g}"]


def _vote_on_inertia(driven: Driven, bending: Bending) -> list[str]:
    """What the plan says that inertia moves the tip is what Pinocchio's inverse dynamics says."""
    if not np.isfinite(bending.at_once):
        return []
    task, cutting = driven.task, driven.cutting
    q = task.q_links
    rests = np.zeros(len(q), bool) if task.rests is None else task.rests
    rows = find_inside(driven.time, cutting)
    rows = rows[~rests[rows]]
    if not len(rows):
        return []
    push = np.linalg.norm(fit_parabolas(q, driven.time, rows)[1], axis=1)
    rows = np.sort(rows[np.argsort(push)[-LOOKED_AT // 2 :]])
    loads = load_springs(driven.moving, q, driven.time, cutting, rests, rows)
    most = float(np.linalg.norm(shift_tip(driven.moving, q[rows], loads[rows]), axis=1).max())
    if abs(most - bending.at_once) <= INERTIA_LEAST + INERTIA_SHARE * max(most, bending.at_once):
        return []
    told, found = 1e3 * bending.at_once, 1e3 * most
    return [f"inertia moves the tip by {told:.3g} mm in the plan, by {found:.3g} mm in Pinocchio's inverse dynamics"]
