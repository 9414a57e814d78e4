"""Input and output of a compensation strategy: a `PlanTask` (robot, path, wrench, limits) and a `Command`.

Only `attain_rows` predicts the pose of the loaded tool, with the effects of the robot folder (effects.toml).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.joint_convention import controller_robot
from compplan.effects.attained import attain_with_effects
from compplan.effects.transmission_error import weigh_joints
from compplan.job.noise import NoiseTable
from compplan.planning.posture.summary import Start
from compplan.process.force_law import ForceLaw
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, joint_jacobian, locate_frames
from compplan.statics.ik import build_arm, refine_ik
from compplan.statics.stiffness import AttainedPose, attain_pose, chunk_rows
from compplan.toolpath.toolpath import Toolpath, interpolate, select_even
from compplan.uncertainty.touch_off import TouchedPart, spread_placement

#: Smoothing time of the motion without a known natural frequency. [s]
SMOOTHING = 0.05
#: Least duration of a move that loads or unloads the tool at rest, in smoothing times.
PERIODS = 2.0
#: Distance from its limit below which a joint [rad or m] or a correction [m] is at the limit.
AT_LIMIT, AT_CORRECTION = 1e-6, 1e-6
#: Limits of a failed waypoint: correction, or reach of the arm.
CORRECTION_LIMIT, OUT_OF_REACH = "correction limit", "reach of the arm"


@dataclass(frozen=True)
class PlanTask:
    """Path to correct with the input of a strategy; n waypoints, nq joints, base frame."""

    robot: Robot  #: Robot model with its tool.
    chain: Chain  #: Elastic chain of the robot.
    nominal: Toolpath  #: Required path, base frame.
    rotation: Array  #: Required orientation of the TCP frame, with the chosen spin. Shape (n, 3, 3).
    #: Predicted wrench at the tip, see `compplan.planning.sampling.predict_loads`. Shape (n, 6). [N, N m]
    wrench: Array
    #: Waypoints to correct: the cut and its points of contact; the others are rapid. Shape (n,).
    compensated: NDArray[np.bool_]
    q_start: Array  #: Joint positions with the unloaded tool on the path. Shape (n, nq). [rad or m]
    configuration: Mapping[str, str]  #: Shoulder, elbow and wrist of q_start.
    missed: NDArray[np.bool_]  #: Waypoints out of reach. Shape (n,).
    step_time: Array  #: Time from each waypoint to the next at the programmed feed. Shape (n - 1,). [s]
    velocity_limits: Array  #: Velocity limits. Shape (nq,). [rad/s or m/s]
    acceleration_limits: Array  #: Acceleration limits. Shape (nq,). [rad/s^2 or m/s^2]
    max_correction: float  #: Greatest distance of the unloaded tip from the path. [m]
    #: Greatest allowed deviation of the loaded tip. [m]
    tolerance: float
    spin_free: bool  #: Whether the rotation about the tool axis is free.
    start: Start | None = None  #: Result of the posture search, or None.
    law: ForceLaw | None = None  #: Force law, or None if the path has its wrench.
    #: Waypoints with the tip at rest along which the correction grows at a contact or fades after a cut. Shape (n,).
    lead: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    #: Waypoints within a cut at which the tool comes to rest. Shape (n,).
    rests: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    #: Allowed deviation of the loaded tip between waypoints. [m]
    chord: float = np.inf
    smoothing: float = SMOOTHING  #: Smoothing time of the motion. [s]
    inertia: bool = False  #: Whether the inertia of the motion is a load.
    constant_feed: bool = False  #: Whether the complete cut requires one feed.
    torque_limits: bool = False  #: Whether joint torques must stay within the efforts of the robot.
    bias: Array | None = None  #: Load of inertia on each elastic coordinate, or None. Shape (n, s). [N m or N]
    #: Link-side joint positions, None if they are q_start. Shape (n, nq). [rad or m]
    links: Array | None = None
    #: Number of each waypoint in the toolpath, fractional where a move was divided (default: 0, 1, ..). Shape (n,).
    origin: Array = field(default_factory=lambda: np.zeros(0))
    #: Elastic coordinates of the last equilibrium: initial guess of the next one, overwritten. Results depend on them
    #: only by rounding. Shape (n, s). [rad or m]
    theta: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: Part frame measured by touching with the robot; None if absolute. Loaded poses are relative to the measured
    #: frame (`to_part_frame`).
    touched: TouchedPart | None = None
    part_origin: Array | None = None  #: Origin of the part frame; None: the middle of the path. Shape (3,). [m]

    def __post_init__(self) -> None:
        shape = (len(self.nominal), self.chain.n_springs)
        for name in ("lead", "rests"):
            if len(getattr(self, name)) != shape[0]:
                object.__setattr__(self, name, np.zeros(shape[0], bool))
        if self.theta.shape != shape:
            object.__setattr__(self, "theta", np.zeros(shape))
        if len(self.origin) != shape[0]:
            object.__setattr__(self, "origin", np.arange(shape[0], dtype=float))

    def __len__(self) -> int:
        return len(self.nominal)

    @property
    def position(self) -> Array:
        """Required tool tip. Shape (n, 3). [m]"""
        return self.nominal.position

    @property
    def programmed(self) -> Array:
        """Programmed path: `position` without its offset within the tolerance tube. Shape (n, 3). [m]"""
        offset = None if self.start is None else self.start.offset
        if offset is None:
            return self.position
        every = np.arange(len(offset))
        return self.position - interpolate(self.origin, every, offset)

    @property
    def programmed_axis(self) -> Array:
        """Programmed tool axis, tip to spindle: that of `nominal` without lead and lean. Shape (n, 3)."""
        axis = None if self.start is None else self.start.programmed_axis
        return self.nominal.axis if axis is None else interpolate(self.origin, np.arange(len(axis)), axis)

    @cached_property
    def q_uncorrected(self) -> Array:
        """Joint positions of the uncorrected program, by the geometry of the controller. Shape (n, nq). [rad or m]"""
        believed = self.robot if self.touched is None else controller_robot(self.robot)
        arm = None if believed is self.robot else build_arm(believed)
        if arm is None or len(arm.arm) < 6:
            return self.q_start
        return refine_ik(arm, self.q_start, self.position, self.rotation)

    @property
    def slowdown(self) -> Array:
        """Slowdown factor of the run relative to the fastest one, to vibrate less. Shape (n,)."""
        slow = None if self.start is None else self.start.slowdown
        return np.ones(len(self)) if slow is None else np.interp(self.origin, slow.places, slow.slower)

    @property
    def gentle_time(self) -> float:
        """Least duration of a move that loads or unloads the tool at rest. [s]"""
        return PERIODS * self.smoothing

    def spread_part(self, noise: NoiseTable) -> Array:
        """Return the motion of the part by one deviation of its placement (`spread_placement`). Shape (n, 3, 6). [m]"""
        origin = self.position.mean(axis=0) if self.part_origin is None else self.part_origin
        return spread_placement(noise, self.touched, self.position, origin)

    def to_part_frame(self, position: Array) -> Array:
        """Return positions of the loaded tip relative to the measured part frame. Shape (n, 3). [m]"""
        return position if self.touched is None else self.touched.see_position(position)

    def to_part_frame_pose(self, pose: AttainedPose) -> AttainedPose:
        """Return loaded poses relative to the measured part frame; unloaded poses are those of the controller."""
        if self.touched is None or self.touched.displacement is None:
            return pose
        touched = self.touched
        return pose._replace(
            position=touched.see_position(pose.position), rotation=touched.see_rotation(pose.rotation),
            jacobian=touched.see_jacobian(pose.jacobian),
        )  # fmt: skip

    @property
    def follows_feed(self) -> bool:
        """Return whether the wrench depends on the actual feed."""
        return self.law is not None and self.law.follows_feed

    @property
    def q_links(self) -> Array:
        """Link-side joint positions; commands lead them by inertia and lost motion. Shape (n, nq). [rad or m]"""
        return self.q_start if self.links is None else self.links

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Waypoints whose deviation is evaluated: the cut and its points of contact, without `lead`. Shape (n,)."""
        return self.compensated & ~self.lead

    @property
    def leaving(self) -> NDArray[np.bool_]:
        """Waypoints of `lead` after a cut, along which the correction fades. Shape (n,)."""
        last = np.maximum.accumulate(np.where(self.lead, 0, np.arange(len(self))))
        return np.asarray(self.lead & ~self.nominal.rapid[last])

    @property
    def fixed_joints(self) -> NDArray[np.bool_]:
        """Joints fixed at q_start: rails and positioners, which do not follow small motions. Shape (nq,)."""
        return (self.robot.prismatic | self.robot.carriers) & (np.arange(self.robot.nq) < self.robot.nq - 6)

    @cached_property
    def joint_weights(self) -> Array:
        """Weight of the motion of each joint in least-motion corrections. Shape (nq,)."""
        return weigh_joints(self.chain, self.q_start, self.robot)

    @cached_property
    def runs(self) -> list[tuple[int, int]]:
        """First and last waypoint of every run of the cut from rest to rest."""
        return cutting_runs(np.r_[False, self.nominal.rapid[1:]], self.rests)

    @cached_property
    def moving_runs(self) -> list[tuple[int, int]]:
        """Runs along which the required tip moves; in the others the tool rotates in place."""
        return [(first, last) for first, last in self.runs if self.nominal.steps[first:last].any()]

    @property
    def redundant(self) -> bool:
        """Return whether the arm has more joints than pose equations."""
        return self.chain.nq - int(self.fixed_joints.sum()) > count_equations(self.chain, spin_free=self.spin_free)


def cutting_runs(rapid: NDArray[np.bool_], rests: NDArray[np.bool_] | None = None) -> list[tuple[int, int]]:
    """List first and last waypoint of every run from rest to rest.

    Args:
        rapid: Whether the move that ends at a waypoint is rapid. Shape (n,).
        rests: Waypoints within a cut at which the tool comes to rest, or None. Shape (n,).
    """
    moves = np.flatnonzero(~rapid[1:]) + 1
    if not len(moves):
        return []
    new = np.diff(moves) > 1
    if rests is not None:
        new |= rests[moves[:-1]]
    breaks = np.flatnonzero(new)
    firsts, lasts = np.r_[moves[0], moves[breaks + 1]], np.r_[moves[breaks], moves[-1]]
    return [(int(first) - 1, int(last)) for first, last in zip(firsts, lasts, strict=True)]


def pick_worst(rows: NDArray[np.int_], score: Array, most: int) -> NDArray[np.int_]:
    """Pick at most `most` of rows (k,): half with the greatest scores (k,), the others evenly."""
    if len(rows) <= most:
        return rows
    return np.union1d(rows[np.argsort(score)[-most // 2 :]], select_even(rows, most // 2))


def count_equations(chain: Chain, *, spin_free: bool) -> int:
    """Count the pose equations of a waypoint: tip, tool axis (five joints or more), spin if it is not free."""
    return (3 if chain.nq < 5 else 5) + (not spin_free)


@dataclass(frozen=True)
class Command:
    """Command of a strategy."""

    q: Array  #: Commanded joint positions. Shape (n, nq). [rad or m]
    status: str = "solved"  #: "solved" or "infeasible".
    failures: Mapping[int, str] = field(default_factory=dict)  #: Failed waypoints and their limits.
    solve_time: float = 0.0  #: Wall time in the solver. [s]
    nlp: Mapping[str, Any] = field(default_factory=dict)  #: Figures of the nonlinear program for plan.json.
    lead: Array | float = 0.0  #: Command minus link positions, due to lost motion. Shape (n, nq). [rad or m]
    #: Encoder that the axes are controlled by: "motor", "link" or "combined" (`compplan.statics.encoders`).
    feedback: str = "motor"
    beta: Array | float = 0.0  #: Share of combined feedback. Shape (nq,).
    #: Change of the command per measured wrench at the tip, base axes; None without a force sensor.
    #: Shape (n, nq, 6). [rad/N, rad/(N m)]
    gain: Array | None = None
    expected: Array | None = None  #: Expected wrench at the tip, base axes. Shape (n, 6). [N, N m]

    @property
    def links(self) -> Array:
        """Link-side joint positions. Shape (n, nq). [rad or m]"""
        return self.q - self.lead


def attain_rows(task: PlanTask, q: Array, rows: NDArray[np.int_], *, slope: bool = True) -> AttainedPose:
    """Predict the pose of the loaded tool (unloaded in rapid moves) at some waypoints (k,).

    q (n, nq) is the command of the complete path, on which effects with a memory depend. Without `slope` the derivative
    is zero. With effects in the robot folder, their forward model yields the pose, and deflection by inertia is added.
    """
    bias = None if task.bias is None else task.bias[rows]
    loaded = attain_pose(task.chain, q[rows], task.wrench[rows], slope=slope, torque_bias=bias, theta=task.theta[rows])
    task.theta[rows] = loaded.theta
    if task.robot.effects:
        position, rotation = (part[rows] for part in attain_with_effects(task.robot, q, task.wrench, task.step_time))
        if bias is not None:
            static = attain_pose(task.chain, q[rows], task.wrench[rows], slope=False)
            position = position + loaded.position - static.position
            rotation = loaded.rotation @ np.swapaxes(static.rotation, 1, 2) @ rotation
        loaded = loaded._replace(position=position, rotation=rotation)
    loaded = task.to_part_frame_pose(loaded)
    rapid = np.flatnonzero(~task.compensated[rows])
    if not len(rapid):
        return loaded
    position, rotation, columns = (np.array(part) for part in loaded[:3])
    for part in chunk_rows(len(rapid), task.chain):
        frames = locate_frames(task.chain, q[rows[rapid[part]]])
        position[rapid[part]], rotation[rapid[part]] = frames.tcp_position, frames.tcp_rotation
        columns[rapid[part]] = joint_jacobian(task.chain, frames)
    return AttainedPose(position, rotation, columns)


def pose_equations(task: PlanTask, attained: AttainedPose, rows: NDArray[np.int_]) -> Array:
    """Compute the residuals of the pose equations: tip, tool axis (and spin). Shape (k, equations). [m, rad]"""
    missed = [attained.position - task.position[rows]]
    missed += [np.einsum("ni,ni->n", a, b)[:, None] for a, b in _crossings(task, attained, rows)]
    return np.hstack(missed)


def differentiate_equations(task: PlanTask, attained: AttainedPose, rows: NDArray[np.int_]) -> Array:
    """Differentiate the pose equations with respect to the commanded joints. Shape (k, equations, nq)."""
    turns = [
        np.einsum("ni,nij->nj", np.cross(b, a), attained.jacobian[:, 3:])[:, None]
        for a, b in _crossings(task, attained, rows)
    ]
    return np.concatenate([attained.jacobian[:, :3], *turns], axis=1)


def _crossings(task: PlanTask, attained: AttainedPose, rows: NDArray[np.int_]) -> list[tuple[Array, Array]]:
    """Pair required and attained directions that are normal to each other at the required pose. Shapes (k, 3)."""
    x, y = task.rotation[rows, :, 0], task.rotation[rows, :, 1]
    # with four joints (palletisers, SCARA) the tip determines the tool axis
    pairs = [] if task.chain.nq < 5 else [(x, attained.rotation[:, :, 2]), (y, attained.rotation[:, :, 2])]
    return pairs if task.spin_free else [*pairs, (y, attained.rotation[:, :, 0])]


def check_limits(task: PlanTask, q: Array) -> Command:
    """Return joint positions as a command, with the waypoints that violate a limit or are out of reach."""
    outside = np.maximum(task.robot.lower - q, q - task.robot.upper)
    too_far = measure_correction(task, q) > task.max_correction + AT_CORRECTION
    failing = np.flatnonzero(task.missed | (outside > 1e-9).any(axis=1) | (too_far & task.compensated))
    failures = name_failures(task, q, failing)
    return Command(q, "infeasible" if failures else "solved", failures)


def measure_correction(task: PlanTask, q: Array) -> Array:
    """Compute the distance of the unloaded tip from the path. Shape (n,). [m]"""
    tip = np.empty((len(q), 3))
    for start in range(0, len(q), 4096):
        rows = slice(start, start + 4096)
        tip[rows] = locate_frames(task.chain, q[rows]).tcp_position
    return np.asarray(np.linalg.norm(tip - task.position, axis=1))


def name_failures(task: PlanTask, q: Array, failing: NDArray[np.int_]) -> dict[int, str]:
    """Name the limit of each failed waypoint: position limit of a joint, correction limit, or reach."""
    if not len(failing):
        return {}
    robot = task.robot
    at_lower, at_upper = q[failing] <= robot.lower + AT_LIMIT, q[failing] >= robot.upper - AT_LIMIT
    far = measure_correction(task, q)[failing] > task.max_correction - 2 * AT_CORRECTION
    names = {}
    for k, waypoint in enumerate(failing.tolist()):
        stopping = [
            f"{side} position limit of {robot.joint_names[j]}"
            for side, at in (("lower", at_lower), ("upper", at_upper))
            for j in np.flatnonzero(at[k])
        ]
        if far[k] and task.compensated[waypoint]:
            stopping.append(CORRECTION_LIMIT)
        names[waypoint] = ", ".join(stopping) or OUT_OF_REACH
    return names
