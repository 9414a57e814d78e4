"""The judge: exact loaded equilibrium computed by Pinocchio, which shares no kinematics with the planner.

Springs become joints of a Pinocchio model; the equilibrium is solved pose by pose with Pinocchio's Jacobians and its
generalised gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from compplan.errors import ConvergenceError
from compplan.robot import Array, Joint, Robot

MAX_ITERATIONS = 60
#: Poses nearer than this start from where the last two lead. [rad or m]
NEIGHBOUR = 0.02


@dataclass(frozen=True)
class Judge:
    """A robot as a Pinocchio model with its springs as joints.

    Attributes:
        model: Pinocchio model; its configuration holds commanded and elastic coordinates in chain order.
        tcp: Frame id of the TCP.
        commanded: Row of Q per model coordinate: coordinate = select @ q + shift. Shape (n_coordinates, nq).
        shift: Shape (n_coordinates,).
        elastic: Model coordinates that are elastic, in chain order. Shape (s,).
        compliance: Compliance of the elastic coordinates. Shape (s, s).
        weighs: Whether gravity loads the springs.
    """

    model: pin.Model
    tcp: int
    commanded: Array
    shift: Array
    elastic: np.ndarray
    compliance: Array
    weighs: bool


def build_judge(robot: Robot) -> Judge:
    """Build the Pinocchio model of a robot with every spring as a joint."""
    model = pin.Model()
    gravity = np.zeros(3) if robot.gravity is None else robot.gravity
    model.gravity = pin.Motion(np.r_[gravity, np.zeros(3)])
    parent, pending = 0, pin.SE3.Identity()
    rows: list[tuple[Array, float]] = []
    elastic: list[int] = []
    blocks: list[Array] = []

    def append(name: str, axis: Array, slides: bool, row: Array | None, shift: float) -> None:
        nonlocal parent, pending
        kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
        parent = model.addJoint(parent, kind(*(float(v) for v in axis)), pending, name)
        pending = pin.SE3.Identity()
        if row is None:
            elastic.append(len(rows))
        rows.append((np.zeros(robot.nq) if row is None else row, shift))

    def hang(link: str) -> None:
        for body in robot.bodies:
            if body.link == link:
                model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.centre, 1e-6 * np.eye(3)), pending)

    hang(robot.base)
    for count, joint in enumerate(robot.joints):
        pending = pending * pin.SE3(joint.placement)
        if joint.kind != "fixed":
            append(joint.name, joint.axis, joint.kind == "prismatic", *_drive(robot, joint))
        for number, spring in enumerate(robot.springs):
            if spring.joint != joint.name:
                continue
            shift = pin.SE3(np.eye(3), np.asarray(spring.offset))
            pending = pending * shift
            slides = joint.kind == "prismatic" if spring.axis == "own" else spring.axis[0] == "t"
            axis = joint.axis if spring.axis == "own" else np.eye(3)["xyz".index(spring.axis[1])]
            append(f"spring {number}", axis, slides, None, 0.0)
            blocks.append(np.array([[spring.compliance]]))
            pending = pending * shift.inverse()
        hang(joint.child)
        far = pin.SE3(robot.joints[count + 1].placement) if count + 1 < len(robot.joints) else pin.SE3.Identity()
        for number, block in enumerate(robot.link_elasticities):
            if block.link == joint.child:
                pending = pending * far
                for k in range(6):
                    append(f"link {number}.{k}", np.eye(3)[k % 3], k < 3, None, 0.0)
                blocks.append(block.compliance)
                pending = pending * far.inverse()
    tcp = model.addFrame(pin.Frame("tcp", parent, 0, pending, pin.FrameType.OP_FRAME))
    size = sum(len(block) for block in blocks)
    compliance, start = np.zeros((size, size)), 0
    for matrix in blocks:
        compliance[start : start + len(matrix), start : start + len(matrix)] = matrix
        start += len(matrix)
    select, shifts = np.array([row for row, _ in rows]), np.array([value for _, value in rows])
    return Judge(model, tcp, select, shifts, np.array(elastic, int), compliance, bool(gravity.any()))


def judge_pose(
    judge: Judge, q: Array, wrench: Array | None = None, tolerance: float = 1e-13
) -> tuple[Array, Array, Array]:
    """Solve the exact loaded equilibrium at every pose.

    Args:
        judge: The judge.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        tolerance: Largest change of an elastic coordinate in the last iteration. [rad or m]

    Returns:
        TCP position (n, 3) [m], orientation (n, 3, 3), both in the base frame, elastic coordinates (n, s) [rad or m].

    Raises:
        ConvergenceError: If a pose does not settle.
    """
    q = np.atleast_2d(q)
    load = np.zeros((len(q), 6)) if wrench is None else np.broadcast_to(wrench, (len(q), 6))
    data = judge.model.createData()
    position, rotation = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    thetas = np.zeros((len(q), len(judge.elastic)))
    theta = before = np.zeros(len(judge.elastic))
    rigid = q @ judge.commanded.T + judge.shift
    for i in range(len(q)):
        start = 2 * theta - before if i and np.abs(q[i] - q[i - 1]).max() < NEIGHBOUR else theta
        before, theta = theta, _settle(judge, data, rigid[i], load[i], start, tolerance)
        placement = data.oMf[judge.tcp]
        position[i], rotation[i], thetas[i] = placement.translation, placement.rotation, theta
    return position, rotation, thetas


def _settle(judge: Judge, data: pin.Data, rigid: Array, wrench: Array, theta: Array, tolerance: float) -> Array:
    """Iterate theta <- C tau(theta) until the step vanishes."""
    model, configuration, elastic = judge.model, rigid.copy(), judge.elastic
    step, world = np.inf, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for _ in range(MAX_ITERATIONS):
        configuration[elastic] = rigid[elastic] + theta
        torque = pin.computeFrameJacobian(model, data, configuration, judge.tcp, world).T[elastic] @ wrench
        if judge.weighs:
            torque -= pin.computeGeneralizedGravity(model, data, configuration)[elastic]
        update = judge.compliance @ torque
        step = float(np.abs(update - theta).max(initial=0.0))
        theta = update
        if step < tolerance:
            configuration[elastic] = rigid[elastic] + theta
            pin.forwardKinematics(model, data, configuration)
            pin.updateFramePlacement(model, data, judge.tcp)
            return theta
    raise ConvergenceError(f"equilibrium did not settle, last step {step:.3g} rad", residual=step)


def _drive(robot: Robot, joint: Joint) -> tuple[Array, float]:
    row = np.zeros(robot.nq)
    if joint.mimic is None:
        row[robot.joint_names.index(joint.name)] = 1.0
        return row, 0.0
    row[robot.joint_names.index(joint.mimic.joint)] = joint.mimic.multiplier
    return row, joint.mimic.offset
