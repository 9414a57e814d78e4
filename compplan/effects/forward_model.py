"""Forward model: a robot at the rows of a campaign, changed by effects.

`solve_model_poses` solves the loaded equilibrium exactly and returns what instrument and encoders should read. Between
the reading q of a joint and its true position are, in this order,

    q_link = q + drive (between motor-side and link-side encoder: backlash, gear error, lag, springs of any law)
    q_true = q_link + zero (invisible to both encoders: an offset of the zero, an unmodelled coupling)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.measurement.campaign import Campaign
from compplan.measurement.registration import Registration
from compplan.robot import Array, Robot
from compplan.robot.mounting import find_hand, mounted_tool
from compplan.robot.springs import own_sign
from compplan.statics.chain import Chain, Frames, build_chain, jacobian, locate_gravity
from compplan.statics.elastic import solve_equilibrium

#: Tolerance of elastic coordinates: a nanometre at two metres. [rad or m]
TOLERANCE = 1e-9
LAW_PASSES = 3

#: Nonlinear part of the deflection as a function of the load on the spring about a joint axis. [N m -> rad, N -> m]
Law = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class ForwardModel:
    """A robot at n rows; nq joints."""

    robot: Robot  #: The robot, with the effects that URDF and springs express.
    campaign: Campaign  #: Joints, loads, order and times of the rows. Its measured positions are not used.
    later: bool  #: Whether the rows belong to a later campaign than that of the effects.
    zero: Array  #: True minus link-side position of each joint. Shape (n, nq). [rad or m]
    drive: Array  #: Link-side minus motor-side position of each joint, elastic part left out. Shape (n, nq). [rad or m]
    wrench: Array  #: True wrench at the TCP, base axes. Shape (n, 6). [N, N m]
    joint_load: Array  #: Further load on the spring about each joint axis. Shape (n, nq). [N m or N]
    laws: tuple[tuple[int, Law], ...]  #: Nonlinear deflections: joint index and law.
    #: Relative growth of the placements before each joint, and from the last to the flange. Shape (n, nq + 1).
    growth: Array
    #: Motion of the robot in the measurement frame, base axes about the base origin. Shape (n, 6). [m, rad]
    base_twist: Array
    tool_twist: Array  #: Motion of the target on the tool, TCP axes. Shape (n, 6). [m, rad]
    payload: Array  #: Unmodelled mass and its first moments about the flange, flange axes. Shape (4,). [kg, kg m]
    tilt: Array  #: Compliance of the base about the base axes that no spring represents. Shape (3,). [rad/(N m)]
    encoder: Array  #: Error of the link-side encoders. Shape (n, nq). [rad or m]
    registration: Registration | None = None  #: Frames fitted to the campaign, or None.

    def joint_index(self, joint: str | None) -> int:
        """Return the number of a commanded joint, counted from 0."""
        return self.robot.joint_names.index(str(joint))

    def add_to_joint(self, name: Literal["zero", "drive", "joint_load"], index: int, values: Array) -> ForwardModel:
        """Add values, shape (n,), to a quantity of a joint."""
        fields: dict[str, Any] = {name: getattr(self, name).copy()}
        fields[name][:, index] += values
        return replace(self, **fields)


class Attained(NamedTuple):
    """Solution of a model at n rows."""

    position: Array  #: Measured position of the target. Shape (n, 3). [m]
    rotation: Array  #: Measured orientation. Shape (n, 3, 3).
    link: Array  #: Link-side readings. Shape (n, nq). [rad or m]
    motor: Array  #: Motor-side readings. Shape (n, nq). [rad or m]
    q: Array  #: True joint positions, springs left out. Shape (n, nq). [rad or m]
    theta: Array  #: Elastic coordinates of the chain. Shape (n, s). [rad or m]
    wrench: Array  #: Wrench at the TCP, weights of an unmodelled payload included. Shape (n, 6). [N, N m]
    chain: Chain  #: The chain that was solved.
    frames: Frames  #: Its loaded frames, base axes.
    target: Array  #: Target in the base frame, before registration and base motion. Shape (n, 3). [m]

    @property
    def jacobian(self) -> Array:
        """Motion of the target per motion of each element of the chain. Shape (n, 6, m)."""
        return jacobian(self.chain, self.frames._replace(tcp_position=self.target))


def build_model(
    robot: Robot, campaign: Campaign, *, registration: Registration | None = None, later: bool = False
) -> ForwardModel:
    """Build the model of a robot at the rows of a campaign, without effects.

    registration: frames fitted to the campaign, none if the instrument uses the robot's base frame; later: whether the
    effects are from an earlier campaign, so that shifts precede every row.
    """
    n, nq = len(campaign), robot.nq

    def nothing(columns: int) -> Array:
        return np.zeros((n, columns))

    return ForwardModel(
        robot=robot,
        campaign=campaign,
        later=later,
        zero=nothing(nq),
        drive=nothing(nq),
        wrench=np.nan_to_num(campaign.wrench),
        joint_load=nothing(nq),
        laws=(),
        growth=nothing(nq + 1),
        base_twist=nothing(6),
        tool_twist=nothing(6),
        payload=np.zeros(4),
        tilt=np.zeros(3),
        encoder=nothing(nq),
        registration=registration,
    )


def solve_model_poses(model: ForwardModel, *, tolerance: float = TOLERANCE, theta: Array | None = None) -> Attained:
    """Solve the loaded equilibrium of a model and return what instrument and encoders should read.

    tolerance: of the elastic coordinates [rad or m]; theta: initial ones, zero if left out or of another number of
    springs, (n, s) [rad or m].

    Raises:
        ConvergenceError: If the robot buckles under the load.
    """
    robot = model.robot
    springs = own_springs(robot)
    motor_side = ~model.campaign.link_controlled[:, None]
    chain, q, drive, bias = compute_model_loads(model, springs)
    wrench, bent = model.wrench, np.zeros((len(q), chain.n_springs))
    theta = theta if theta is not None and theta.shape == bent.shape else None
    for repeat in range(LAW_PASSES if model.laws or model.payload.any() else 1):
        extra = bias + bent if bias is not None else bent if model.laws else None
        loaded = solve_equilibrium(chain, q, wrench, tolerance=tolerance, torque_bias=extra, theta=theta)
        theta = loaded.theta
        if repeat == LAW_PASSES - 1:
            break
        if model.payload.any():
            wrench = model.wrench + payload_wrench(robot, loaded.frames, model.payload)
        bent = _bend(model, springs, loaded.torque - bent)
    # the load on a spring contains the nonlinear part of its law; under link-side control the spring is locked
    compliance = np.array([springs[k].compliance if k in springs else 0.0 for k in range(robot.nq)])
    gear, loads = (own_deflection(springs, part, robot.nq) for part in (loaded.theta, loaded.torque))
    lift = np.where(motor_side, drive + gear, model.drive + compliance * loads)
    return _observe(model, chain, loaded.frames, q, loaded.theta, wrench, lift)


class Load(NamedTuple):
    """Inputs of the equilibrium: chain, joint positions without springs, lift of the drives, load on springs."""

    chain: Chain
    q: Array
    drive: Array
    bias: Array | None


def compute_model_loads(model: ForwardModel, springs: dict[int, OwnSpring], chain: Chain | None = None) -> Load:
    """Return the inputs of the equilibrium of a model, without laws and payload."""
    chain = model_chain(model, chain)
    drive = np.where(model.campaign.link_controlled[:, None], 0.0, model.drive)
    bias: Array | None = None
    if model.joint_load.any():
        bias = np.zeros((len(model.campaign), chain.n_springs))
        for index, spring in springs.items():
            bias[:, spring.coordinate] = spring.sign * model.joint_load[:, index]
    return Load(chain, np.nan_to_num(model.campaign.q) + drive + model.zero, drive, bias)


def _observe(
    model: ForwardModel, chain: Chain, frames: Frames, q: Array, theta: Array, wrench: Array, lift: Array
) -> Attained:
    """Compute the readings of instrument and encoders at a loaded pose."""
    position, rotation, target = see_target(model, frames, wrench)
    reading, linked = np.nan_to_num(model.campaign.q), model.campaign.link_controlled[:, None]
    link = np.where(linked, reading, reading + lift + model.encoder)
    motor = np.where(linked, reading - lift, reading)
    return Attained(position, rotation, link, motor, q, theta, wrench, chain, frames, target)


def observe_again(model: ForwardModel, attained: Attained) -> Attained:
    """Compute the readings of a solved model through other frames of the campaign."""
    position, rotation, target = see_target(model, attained.frames, attained.wrench)
    return attained._replace(position=position, rotation=rotation, target=target)


def see_target(model: ForwardModel, frames: Frames, wrench: Array) -> tuple[Array, Array, Array]:
    """Compute the pose of the target in the frame of the instrument, and its position in the base frame."""
    campaign, registration = model.campaign, model.registration
    position, rotation = frames.tcp_position, frames.tcp_rotation
    position = position + np.einsum("nij,nj->ni", rotation, model.tool_twist[:, :3])
    rotation = rotation @ Rotation.from_rotvec(model.tool_twist[:, 3:]).as_matrix()
    if registration is not None:
        tool = registration.tool[campaign.target_index]
        position = position + np.einsum("nij,nj->ni", rotation, tool[:, :3, 3])
        rotation = rotation @ tool[:, :3, :3]
    target = position
    twist = model.base_twist
    if model.tilt.any():
        tilt = model.tilt * base_moment(frames, build_chain(model.robot), wrench)
        twist = twist + np.hstack([np.zeros((len(tilt), 3)), tilt])
    turn = Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    position = np.einsum("nij,nj->ni", turn, position) + twist[:, :3]
    rotation = turn @ rotation
    if registration is not None:
        base = registration.base
        position, rotation = position @ base[:3, :3].T + base[:3, 3], base[:3, :3] @ rotation
    return position, rotation, target


def model_chain(model: ForwardModel, chain: Chain | None = None) -> Chain:
    """Build the chain of a model: links grown row by row, actuator springs locked under link-side control."""
    chain = grow_chain(model, chain or build_chain(model.robot))
    if model.campaign.link_controlled.any() and chain.actuator.any():
        locked = model.campaign.link_controlled[:, None] & chain.actuator
        keep = ~(locked[:, :, None] | locked[:, None, :])
        chain = replace(chain, compliance=chain.compliance * keep)
    return chain


def grow_chain(model: ForwardModel, chain: Chain) -> Chain:
    """Return a chain whose links and flange have grown as in a model, row by row."""
    if not model.growth.any():
        return chain
    segment = np.searchsorted(chain.joint_elements, np.arange(len(chain.names)))
    return replace(
        chain,
        position=chain.position * (1.0 + model.growth)[:, segment, None],
        tcp_position=chain.tcp_position + model.growth[:, -1, None] * find_hand(model.robot),
    )


class OwnSpring(NamedTuple):
    """The spring about a joint axis: joint, elastic coordinate, number of the spring, sign, compliance."""

    joint: int
    coordinate: int
    spring: int
    sign: float
    compliance: float
    actuator: bool


def own_springs(robot: Robot) -> dict[int, OwnSpring]:
    """Find the spring about each joint axis: `axis = "own"`, or a spring axis parallel to the joint axis.

    Springs with an offset from the joint are excluded.
    """
    found: dict[int, OwnSpring] = {}
    joints = {joint.name: joint for joint in robot.joints}
    for number, (spring, coordinate) in enumerate(zip(robot.springs, spring_coordinates(robot), strict=True)):
        joint = joints[spring.joint]
        if not joint.actuated:
            continue
        sign = own_sign(joint, spring.axis)
        index = robot.joint_names.index(joint.name)
        if sign and index not in found and not np.any(spring.offset):
            found[index] = OwnSpring(index, coordinate, number, sign, spring.compliance, spring.actuator)
    return found


def spring_coordinates(robot: Robot) -> list[int]:
    """Return the elastic coordinate of every spring, in the order of `robot.springs`, as `build_chain` numbers them."""
    coordinates, count = {}, 0
    for joint in robot.joints:
        for number, spring in enumerate(robot.springs):
            if spring.joint == joint.name:
                coordinates[number] = count
                count += 1
        count += 6 * sum(block.link == joint.child for block in robot.link_elasticities)
    return [coordinates[number] for number in range(len(robot.springs))]


def own_deflection(springs: dict[int, OwnSpring], theta: Array, nq: int) -> Array:
    """Select deflections or loads (n, s) of the springs between the encoders of every joint. Shape (n, nq)."""
    result = np.zeros((len(theta), nq))
    for index, spring in springs.items():
        if spring.actuator:
            result[:, index] = spring.sign * theta[:, spring.coordinate]
    return result


def payload_wrench(robot: Robot, frames: Frames, payload: Array) -> Array:
    """Return the weight of a mass on the flange, as a wrench at the TCP, base axes. Shape (n, 6). [N, N m].

    payload: mass and first moments about the flange, flange axes, (4,). [kg, kg m]
    """
    gravity = frames.ground @ robot.real_gravity
    T_flange_tcp = mounted_tool(robot)
    R_base_flange = frames.tcp_rotation @ T_flange_tcp[:3, :3].T
    arm = payload[1:] - payload[0] * T_flange_tcp[:3, 3]
    moment = np.cross(np.einsum("nij,j->ni", R_base_flange, arm), gravity)
    return np.concatenate([payload[0] * gravity, moment], axis=1)


def base_moment(frames: Frames, chain: Chain, wrench: Array) -> Array:
    """Return the moment of all loads about the base origin, base axes. Shape (n, 3). [N m]."""
    moment = wrench[:, 3:] + np.cross(frames.tcp_position, wrench[:, :3])
    if chain.gravity.any() and len(chain.body_element):
        weight = np.asarray(chain.mass)[..., None] * locate_gravity(chain, frames)[:, None]
        moment = moment + np.cross(frames.centre, weight).sum(1)
    return np.asarray(moment)


def _bend(model: ForwardModel, springs: dict[int, OwnSpring], torque: Array) -> Array:
    """Return the loads equivalent to the nonlinear part of the spring laws. Shape (n, s)."""
    bent = np.zeros_like(torque)
    for index, law in model.laws:
        if index in springs and springs[index].compliance > 0:
            spring = springs[index]
            k = spring.coordinate
            bent[:, k] += spring.sign * law(spring.sign * torque[:, k]) / spring.compliance
    return bent
