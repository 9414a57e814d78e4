"""Exact model: exact loaded equilibrium by Pinocchio, independent of the planner's kinematics.

Springs become joints of a Pinocchio model; the equilibrium is solved pose by pose with Pinocchio's Jacobians and its
generalised gravity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag

from compplan.errors import ConvergenceError
from compplan.robot import Array, Robot

MAX_ITERATIONS = 60
#: Small rotational inertia of a mass about its centre, for numerics. [kg m^2]
INERTIA = 1e-6
#: Sum of masses at a joint, as a share of the sum of their absolute values, below which it is zero.
LEAST_SHARE = 1e-3
#: Lower bound of the ratio of successive steps in the convergence test.
LEAST_RATIO = 0.01
#: Joint distance of poses below which the initial guess is extrapolated from the last ones. [rad or m]
NEIGHBOUR = 0.02


@dataclass(frozen=True)
class ExactRobot:
    """Robot as a Pinocchio model with its springs as joints."""

    model: pin.Model  #: Pinocchio model; its configuration has commanded and elastic coordinates in chain order.
    tcp: int  #: Frame id of the TCP.
    commanded: Array  #: Model coordinates from joint positions: commanded @ q + shift. Shape (n_coordinates, nq).
    shift: Array  #: Constant part of the model coordinates. Shape (n_coordinates,).
    elastic: np.ndarray  #: Indices of the elastic model coordinates, in chain order. Shape (s,).
    compliance: Array  #: Compliance of the elastic coordinates. Shape (s, s).
    weighs: bool  #: Whether gravity loads the springs.
    #: Joints with a total mass of zero or less, such as with a tool lighter than the one of the spring identification:
    #: joint, mass [kg] and first moment in the joint frame, shape (3,) [kg m]. Pinocchio requires masses above 0.
    lifts: tuple[tuple[int, float, Array], ...] = ()
    #: Frame with constant gravity if a positioner carries the part; 0 for the base.
    ground: int = 0
    gravity: Array = field(default_factory=lambda: np.zeros(3))  #: Gravity in that frame. Shape (3,). [m/s^2]

    def turn_gravity(self, data: pin.Data, coordinates: Array) -> None:
        """Set gravity in the frame of the link that carries the part, at a posture."""
        if self.ground:
            pin.forwardKinematics(self.model, data, coordinates)
            turn = pin.updateFramePlacement(self.model, data, self.ground).rotation
            self.model.gravity = pin.Motion(np.r_[turn @ self.gravity, np.zeros(3)])

    def weigh(self, data: pin.Data, coordinates: Array) -> Array:
        """Compute the torque that supports the weights at every model coordinate. Shape (n_coordinates,). [N m or N]"""
        torque = np.array(pin.computeGeneralizedGravity(self.model, data, coordinates))
        if self.lifts:
            pin.computeJointJacobians(self.model, data, coordinates)
            gravity = self.model.gravity.linear
            for joint, mass, moment in self.lifts:
                columns = pin.getJointJacobian(self.model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
                load = np.r_[mass * gravity, np.cross(data.oMi[joint].rotation @ moment, gravity)]
                torque -= columns.T @ load
        return torque


class ExactRobotBuilder:
    """Builder of a Pinocchio model, from the base outwards."""

    def __init__(self, commanded: Sequence[str], gravity: Array) -> None:
        self.names, self.model, self.ground, self.gravity = list(commanded), pin.Model(), 0, gravity
        self.model.gravity = pin.Motion(np.r_[gravity, np.zeros(3)])
        self.weighs = bool(np.any(gravity))
        self.parent, self.pending = 0, pin.SE3.Identity()
        self.rows: list[tuple[Array, float]] = []
        self.elastic: list[int] = []
        self.blocks: list[Array] = []
        self.hung: dict[int, list[tuple[float, Array, Array]]] = {}

    def set_ground(self) -> None:
        """Fix gravity in the axes of the current frame."""
        frame = pin.Frame("ground", self.parent, 0, self.pending, pin.FrameType.OP_FRAME)
        self.ground = self.model.addFrame(frame)

    def move(self, placement: pin.SE3) -> None:
        """Move the current frame on the same body."""
        self.pending = self.pending * placement

    def drive(self, name: str, axis: Array, slides: bool, driver: str, factor: float, offset: float) -> None:
        """Add a joint driven by a commanded one."""
        row = np.zeros(len(self.names))
        row[self.names.index(driver)] = factor
        self._append(name, axis, slides, row, offset)

    def spring(self, axis: Array, slides: bool, compliance: float, offset: Array) -> None:
        """Add an elastic coordinate with its origin at an offset."""
        shift = pin.SE3(np.eye(3), np.asarray(offset, float))
        self.move(shift)
        self._append(f"spring {len(self.blocks)}", axis, slides, None, 0.0)
        self.blocks.append(np.array([[compliance]], float))
        self.move(shift.inverse())

    def elastic_link(self, far: pin.SE3, compliance: Array) -> None:
        """Add the six elastic coordinates of a link at its far end."""
        self.move(far)
        for k in range(6):
            self._append(f"link {len(self.blocks)}.{k}", np.eye(3)[k % 3], k < 3, None, 0.0)
        self.blocks.append(np.asarray(compliance, float))
        self.move(far.inverse())

    def hang(self, masses: Iterable[tuple[str, float, Array, Array]], link: str) -> None:
        """Attach the masses of a link (name, mass, centre, inertia about it, link frame) to the current frame."""
        for name, mass, centre, inertia in masses:
            if name == link:
                where = np.asarray(self.pending.act(np.asarray(centre, float)))
                turned = self.pending.rotation @ inertia @ self.pending.rotation.T
                self.hung.setdefault(self.parent, []).append((mass, where, turned))

    def finish(self, tip: pin.SE3) -> ExactRobot:
        """Add the TCP relative to the current frame and return the exact model."""
        tcp = self.model.addFrame(pin.Frame("tcp", self.parent, 0, self.pending * tip, pin.FrameType.OP_FRAME))
        compliance = block_diag(np.zeros((0, 0)), *self.blocks)
        select, shifts = np.array([row for row, _ in self.rows]), np.array([value for _, value in self.rows])
        lifts = self._add_masses()
        elastic = np.array(self.elastic, int)
        return ExactRobot(
            self.model, tcp, select, shifts, elastic, compliance, self.weighs, lifts, self.ground, self.gravity
        )

    def _add_masses(self) -> tuple[tuple[int, float, Array], ...]:
        """Add the masses to their joints, and return joints with a total mass of zero or less."""
        lifts = []
        for joint, masses in self.hung.items():
            total, moment = sum(mass for mass, _, _ in masses), sum((mass * at for mass, at, _ in masses), np.zeros(3))
            if total > LEAST_SHARE * sum(abs(mass) for mass, _, _ in masses):
                spread = INERTIA * np.eye(3)
                for mass, at, inertia in masses:
                    arm = at - moment / total
                    spread += inertia + max(mass, 0.0) * (arm @ arm * np.eye(3) - np.outer(arm, arm))
                if np.linalg.eigvalsh(spread).min() <= 0:  # the inertia of the file is not physical
                    spread = INERTIA * np.eye(3)
                self.model.appendBodyToJoint(joint, pin.Inertia(total, moment / total, spread), pin.SE3.Identity())
            elif joint:
                lifts.append((joint, total, moment))
        return tuple(lifts)

    def _append(self, name: str, axis: Array, slides: bool, row: Array | None, shift: float) -> None:
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        self.parent = self.model.addJoint(self.parent, kind(*(float(v) for v in axis)), self.pending, name)
        self.pending = pin.SE3.Identity()
        if row is None:
            self.elastic.append(len(self.rows))
        self.rows.append((np.zeros(len(self.names)) if row is None else row, shift))


def build_exact_robot(robot: Robot, *, inertial: bool = False) -> ExactRobot:
    """Build the Pinocchio model of a robot in memory, springs as joints; `read_exact_robot` reads a folder.

    Args:
        robot: The robot.
        inertial: Whether the model is in the frame of the ground (inertial), even if a positioner carries the part.
    """
    names, robot = robot.joint_names, robot.alone if inertial else robot
    down = robot.loading_gravity
    builder = ExactRobotBuilder(names, np.zeros(3) if down is None else down)
    masses = [(body.link, body.mass, body.centre, body.inertia) for body in robot.loading_bodies]
    builder.hang(masses, robot.base)
    for count, joint in enumerate(robot.joints):
        builder.move(pin.SE3(joint.placement))
        slides = joint.kind == "prismatic"
        if joint.kind != "fixed":
            driver = (joint.name, 1.0, 0.0)
            if joint.mimic is not None:
                driver = (joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset)
            builder.drive(joint.name, joint.axis, slides, *driver)
        for spring in robot.springs:
            if spring.joint == joint.name:
                own = spring.axis == "own"
                axis = joint.axis if own else np.eye(3)["xyz".index(spring.axis[1])]
                builder.spring(axis, slides if own else spring.axis[0] == "t", spring.compliance, spring.offset)
        builder.hang(masses, joint.child)
        if joint.child == robot.ground:
            builder.set_ground()
        far = pin.SE3(robot.joints[count + 1].placement) if count + 1 < len(robot.joints) else pin.SE3.Identity()
        for block in robot.link_elasticities:
            if block.link == joint.child:
                builder.elastic_link(far, block.compliance)
    return builder.finish(pin.SE3.Identity())


def solve_exact_pose(
    exact_robot: ExactRobot, q: Array, wrench: Array | None = None, tolerance: float = 1e-13, bias: Array | None = None
) -> tuple[Array, Array, Array]:
    """Solve the exact loaded equilibrium at every pose.

    Args:
        exact_robot: The exact model.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        tolerance: Change of the elastic coordinates per iteration at convergence. [rad or m]
        bias: Further load on each elastic coordinate, such as inertia. Shape (n, s). [N m or N]

    Returns:
        TCP position (n, 3) [m], orientation (n, 3, 3), both in the base frame, elastic coordinates (n, s) [rad or m].

    Raises:
        ConvergenceError: If the equilibrium of a pose does not converge.
    """
    q = np.atleast_2d(q)
    load = np.zeros((len(q), 6)) if wrench is None else np.broadcast_to(wrench, (len(q), 6))
    data = exact_robot.model.createData()
    position, rotation = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    thetas = np.zeros((len(q), len(exact_robot.elastic)))
    more = np.zeros((len(q), len(exact_robot.elastic))) if bias is None else bias
    theta = before = earlier = np.zeros(len(exact_robot.elastic))
    rigid = q @ exact_robot.commanded.T + exact_robot.shift
    near = np.r_[False, np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) < NEIGHBOUR].tolist()
    for i in range(len(q)):
        start = theta
        if near[i]:
            start = 3.0 * (theta - before) + earlier if i > 2 and near[i - 1] and near[i - 2] else 2.0 * theta - before
        try:
            earlier, before, theta = (
                before,
                theta,
                _solve_equilibrium(exact_robot, data, rigid[i], load[i], more[i], start, tolerance),
            )
        except ConvergenceError as error:
            message = f"{error} at waypoint {i} under {np.linalg.norm(load[i, :3]):.3g} N"
            raise ConvergenceError(
                f"{message}; the load is near or beyond buckling: check forces, and compliances of the robot",
                residual=error.residual,
            ) from None
        placement = data.oMf[exact_robot.tcp]
        position[i], rotation[i], thetas[i] = placement.translation, placement.rotation, theta
    return position, rotation, thetas


def _solve_equilibrium(
    exact_robot: ExactRobot, data: pin.Data, rigid: Array, wrench: Array, bias: Array, theta: Array, tolerance: float
) -> Array:
    """Iterate theta <- C tau(theta) until the step, or the next one extrapolated from the last two, is negligible."""
    model, configuration, elastic = exact_robot.model, rigid.copy(), exact_robot.elastic
    step, world, straight = math.inf, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED, rigid[elastic]
    if exact_robot.weighs:
        exact_robot.turn_gravity(data, configuration)
    for _ in range(MAX_ITERATIONS):
        configuration[elastic] = straight + theta
        torque = (wrench @ pin.computeFrameJacobian(model, data, configuration, exact_robot.tcp, world))[elastic] + bias
        if exact_robot.weighs:
            torque -= exact_robot.weigh(data, configuration)[elastic]
        update = exact_robot.compliance @ torque
        change = update - theta
        last, step = step, math.sqrt(change @ change)
        theta = update
        if step < tolerance or (
            step < 0.5 * last < math.inf and step * max(step / last, LEAST_RATIO) < 0.1 * tolerance
        ):
            configuration[elastic] = straight + theta
            pin.forwardKinematics(model, data, configuration)
            pin.updateFramePlacement(model, data, exact_robot.tcp)
            return theta
    raise ConvergenceError(f"equilibrium did not converge, last step {step:.3g} rad", residual=step)


def hold_load(exact_robot: ExactRobot, q: Array, wrench: Array) -> Array:
    """Compute the joint torques that support wrench and weight, springs rigid. Shape (n, nq)."""
    data, model = exact_robot.model.createData(), exact_robot.model
    rigid = q @ exact_robot.commanded.T + exact_robot.shift
    torque = np.empty((len(q), model.nv))
    for i in range(len(q)):
        columns = pin.computeFrameJacobian(
            model, data, rigid[i], exact_robot.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        torque[i] = -columns.T @ wrench[i]
        if exact_robot.weighs:
            exact_robot.turn_gravity(data, rigid[i])
            torque[i] += exact_robot.weigh(data, rigid[i])
    return torque @ exact_robot.commanded


def load_by_motion(exact_robot: ExactRobot, q: Array, velocity: Array, acceleration: Array) -> Array:
    """Compute the inertial load on each elastic coordinate of a rigid arm, without weight. Shape (k, s). [N m or N]

    `exact_robot` is without gravity; q, velocity and acceleration: shape (k, nq). [rad or m, per s, per s^2]
    """
    model, data = exact_robot.model, exact_robot.model.createData()
    place, rate, change = (values @ exact_robot.commanded.T for values in (q, velocity, acceleration))
    torques = np.empty((len(q), model.nv))
    for torque, *motion in zip(torques, place + exact_robot.shift, rate, change, strict=True):
        torque[:] = pin.rnea(model, data, *motion)
    return -torques[:, exact_robot.elastic]
