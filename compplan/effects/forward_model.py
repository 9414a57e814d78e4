"""A scene: a robot at the rows of a campaign, with everything that effects have changed about it.

Effects write into a scene one after the other; `solve_model_poses` then solves the loaded equilibrium exactly and
tells what
instrument and encoders should see. Between the reading q of a joint and its true position stand, in this order,

    q_link = q + drive (between motor-side and link-side encoder: backlash, gear error, lag, springs of any law)
    q_true = q_link + zero (what both encoders cannot see: an offset of the zero, a coupling that is left out)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.measurement.campaign import Campaign
from compplan.measurement.registration import Registration
from compplan.robot import Array, Robot
from compplan.robot.mounting import find_hand, mounted_tool
from compplan.statics.chain import Chain, Frames, build_chain, locate_gravity
from compplan.statics.elastic import solve_equilibrium

#: Elastic coordinates are settled to this; a nanometre at two metres.
TOLERANCE = 1e-9
LAW_PASSES = 3

#: Deflection beyond the linear one as a function of the load on a joint's own spring. [N m -> rad, N -> m]
Law = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class ForwardModel:
    """A robot at n rows; nq joints.

    Attributes:
        robot: The robot; effects that a URDF and springs can say are in it.
        campaign: Joints, loads, order and times of the rows. Its measured positions are not used.
        later: Whether the rows belong to a later campaign than the one that the effects were found in.
        zero: True minus link-side position of each joint. Shape (n, nq). [rad or m]
        drive: Link-side minus motor-side position of each joint, elastic part left out. Shape (n, nq). [rad or m]
        wrench: Wrench that really acts at the TCP, base axes. Shape (n, 6). [N, N m]
        joint_load: Further load on each joint's own spring. Shape (n, nq). [N m or N]
        laws: Nonlinear deflections: joint index and law.
        growth: Relative growth of the placements before each joint, and from the last to the flange. Shape (n, nq + 1).
        base_twist: Motion of the robot in the measurement frame, base axes about the base origin. Shape (n, 6). [m,
            rad]
        tool_twist: Motion of the target on the tool, TCP axes. Shape (n, 6). [m, rad]
        payload: Mass and first moments about the flange that the model lacks, flange axes. Shape (4,). [kg, kg m]
        tilt: Compliance of the base about the base axes where no joint can carry it. Shape (3,). [rad/(N m)]
        encoder: What link-side encoders report beyond the truth. Shape (n, nq). [rad or m]
        registration: Frames fitted to the campaign, or None.

    """

    robot: Robot
    campaign: Campaign
    later: bool
    zero: Array
    drive: Array
    wrench: Array
    joint_load: Array
    laws: tuple[tuple[int, Law], ...]
    growth: Array
    base_twist: Array
    tool_twist: Array
    payload: Array
    tilt: Array
    encoder: Array
    registration: Registration | None = None

    def joint_index(self, joint: str | None) -> int:
        """Return the number of a commanded joint, counted from 0."""
        return self.robot.joint_names.index(str(joint))


class Attained(NamedTuple):
    """What a scene comes to; n rows.

    Attributes:
        position: Target as the instrument should see it. Shape (n, 3). [m]
        rotation: Orientation as the instrument should see it. Shape (n, 3, 3).
        link: Link-side readings. Shape (n, nq). [rad or m]
        motor: Motor-side readings. Shape (n, nq). [rad or m]
        q: True joint positions, springs left out. Shape (n, nq). [rad or m]
        theta: Elastic coordinates of the chain. Shape (n, s). [rad or m]
        wrench: Wrench at the TCP, weights of an unmodelled payload included. Shape (n, 6). [N, N m]
        chain: The chain that was solved.
        frames: Its loaded frames, base axes.
        target: Target in the base frame, before registration and base motion. Shape (n, 3). [m]

    """

    position: Array
    rotation: Array
    link: Array
    motor: Array
    q: Array
    theta: Array
    wrench: Array
    chain: Chain
    frames: Frames
    target: Array


def build_model(
    robot: Robot, campaign: Campaign, *, registration: Registration | None = None, later: bool = False
) -> ForwardModel:
    """Put a robot at the rows of a campaign, with no effect yet.

    Args:
        robot: The robot.
        campaign: The rows.
        registration: Frames fitted to the campaign; none if the instrument stands in the robot's base frame.
        later: Whether the effects to come were found in an earlier campaign: shifts have then happened for every row.

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


def solve_model_poses(scene: ForwardModel, *, tolerance: float = TOLERANCE, theta: Array | None = None) -> Attained:
    """Solve the loaded equilibrium of a scene and tell what instrument and encoders should see.

    Args:
        scene: The scene.
        tolerance: Elastic coordinates are settled to this. [rad or m]
        theta: Elastic coordinates to begin at, such as those of a scene nearby; zero if left out, or if this one has
            other springs. Shape (n, s). [rad or m]

    Raises:
        ConvergenceError: If the robot buckles under the load.

    """
    robot = scene.robot
    springs = own_springs(robot)
    motor_side = ~scene.campaign.link_controlled[:, None]
    chain, q, drive, bias = compute_model_loads(scene, springs)
    wrench, bent = scene.wrench, np.zeros((len(q), chain.n_springs))
    theta = theta if theta is not None and theta.shape == bent.shape else None
    for repeat in range(LAW_PASSES if scene.laws or scene.payload.any() else 1):
        extra = bias + bent if bias is not None else bent if scene.laws else None
        loaded = solve_equilibrium(chain, q, wrench, tolerance=tolerance, torque_bias=extra, theta=theta)
        theta = loaded.theta
        if repeat == LAW_PASSES - 1:
            break
        if scene.payload.any():
            wrench = scene.wrench + payload_wrench(robot, loaded.frames, scene.payload)
        bent = _bend(scene, springs, loaded.torque - bent)
    # the load on a spring holds what its law bends it beyond the linear part
    lift = np.where(
        motor_side,
        drive + own_deflection(springs, loaded.theta, robot.nq),
        scene.drive + own_yield(springs, loaded.torque, robot.nq),
    )
    return _observe(scene, chain, loaded.frames, q, loaded.theta, wrench, lift)


class Load(NamedTuple):
    """What of a scene is solved: chain, joints as they stand without springs, lift of the drives, load on springs."""

    chain: Chain
    q: Array
    drive: Array
    bias: Array | None


def compute_model_loads(scene: ForwardModel, springs: dict[int, OwnSpring], chain: Chain | None = None) -> Load:
    """Return what of a scene is solved, laws and payload left out; the robot's chain is built if left out."""
    chain = model_chain(scene, chain)
    drive = np.where(scene.campaign.link_controlled[:, None], 0.0, scene.drive)
    return Load(chain, np.nan_to_num(scene.campaign.q) + drive + scene.zero, drive, _spring_load(scene, chain, springs))


def _observe(
    scene: ForwardModel, chain: Chain, frames: Frames, q: Array, theta: Array, wrench: Array, lift: Array
) -> Attained:
    """Pass a loaded pose through tool, base and registration to the instrument, and through the encoders."""
    position, rotation, target = see_target(scene, frames, wrench)
    reading, linked = np.nan_to_num(scene.campaign.q), scene.campaign.link_controlled[:, None]
    link = np.where(linked, reading, reading + lift + scene.encoder)
    motor = np.where(linked, reading - lift, reading)
    return Attained(position, rotation, link, motor, q, theta, wrench, chain, frames, target)


def observe_again(scene: ForwardModel, attained: Attained) -> Attained:
    """Observe what a scene has come to already through other frames of the campaign."""
    position, rotation, target = see_target(scene, attained.frames, attained.wrench)
    return attained._replace(position=position, rotation=rotation, target=target)


def see_target(scene: ForwardModel, frames: Frames, wrench: Array) -> tuple[Array, Array, Array]:
    """Return position and rotation of the target in the instrument's frame, and its position in the robot's."""
    campaign, registration = scene.campaign, scene.registration
    position, rotation = frames.tcp_position, frames.tcp_rotation
    position = position + np.einsum("nij,nj->ni", rotation, scene.tool_twist[:, :3])
    rotation = rotation @ Rotation.from_rotvec(scene.tool_twist[:, 3:]).as_matrix()
    if registration is not None:
        tool = registration.tool[campaign.target_index]
        position = position + np.einsum("nij,nj->ni", rotation, tool[:, :3, 3])
        rotation = rotation @ tool[:, :3, :3]
    target = position
    twist = scene.base_twist + _tilt(scene, frames, wrench)
    turn = Rotation.from_rotvec(twist[:, 3:]).as_matrix()
    position = np.einsum("nij,nj->ni", turn, position) + twist[:, :3]
    rotation = turn @ rotation
    if registration is not None:
        base = registration.base
        position, rotation = position @ base[:3, :3].T + base[:3, 3], base[:3, :3] @ rotation
    return position, rotation, target


def model_chain(scene: ForwardModel, chain: Chain | None = None) -> Chain:
    """Build the chain of a scene: links grown row by row, actuator springs locked where link-side readings control."""
    chain = chain or build_chain(scene.robot)
    if scene.growth.any():
        segment = np.searchsorted(chain.joint_elements, np.arange(len(chain.names)))
        factor = 1.0 + scene.growth
        chain = replace(
            chain,
            position=chain.position * factor[:, segment, None],
            tcp_position=chain.tcp_position + scene.growth[:, -1, None] * find_hand(scene.robot),
        )
    if scene.campaign.link_controlled.any() and chain.actuator.any():
        locked = scene.campaign.link_controlled[:, None] & chain.actuator
        keep = ~(locked[:, :, None] | locked[:, None, :])
        chain = replace(chain, compliance=chain.compliance * keep)
    return chain


class OwnSpring(NamedTuple):
    """The spring about a joint's own axis: joint, elastic coordinate, number of the spring, sign, compliance."""

    joint: int
    coordinate: int
    spring: int
    sign: float
    compliance: float
    actuator: bool


def own_springs(robot: Robot) -> dict[int, OwnSpring]:
    """Find the spring about each joint's own axis: `axis = "own"`, or a spring axis that is parallel to the joint's.

    Springs that are shifted away from the joint are not its own. Returns one spring per commanded joint that has one.
    """
    found: dict[int, OwnSpring] = {}
    joints = {joint.name: joint for joint in robot.joints}
    for number, (spring, coordinate) in enumerate(zip(robot.springs, spring_coordinates(robot), strict=True)):
        joint = joints[spring.joint]
        if not joint.actuated:
            continue
        sign = own_sign(joint.axis, spring.axis, joint.kind == "prismatic")
        index = robot.joint_names.index(joint.name)
        if sign and index not in found and not np.any(spring.offset):
            found[index] = OwnSpring(index, coordinate, number, sign, spring.compliance, spring.actuator)
    return found


def own_sign(joint_axis: Array, axis: str, slides: bool) -> float:
    """Return 1 or -1 where a spring axis is parallel to the joint's axis and of its kind, otherwise 0."""
    if axis == "own":
        return 1.0
    if slides != axis.startswith("t"):
        return 0.0
    cosine = float(joint_axis["xyz".index(axis[1])])
    return float(np.sign(cosine)) if abs(cosine) > 1 - 1e-6 else 0.0


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


def link_coordinates(robot: Robot) -> list[int]:
    """Find the first elastic coordinate of each link's 6x6, as `build_chain` counts; -1 for a link behind no joint."""
    index, count = [-1] * len(robot.link_elasticities), 0
    for joint in robot.joints:
        count += sum(spring.joint == joint.name for spring in robot.springs)
        for k, block in enumerate(robot.link_elasticities):
            if block.link == joint.child:
                index[k], count = count, count + 6
    return index


def own_deflection(springs: dict[int, OwnSpring], theta: Array, nq: int) -> Array:
    """Return the deflection of every joint that its encoders see. Shape (n, nq). [rad or m]."""
    result = np.zeros((len(theta), nq))
    for index, spring in springs.items():
        if spring.actuator:
            result[:, index] = spring.sign * theta[:, spring.coordinate]
    return result


def own_yield(springs: dict[int, OwnSpring], torque: Array, nq: int) -> Array:
    """Return what the same springs yield under a load where link-side readings hold them. Shape (n, nq). [rad or m]."""
    result = np.zeros((len(torque), nq))
    for index, spring in springs.items():
        if spring.actuator:
            result[:, index] = spring.sign * spring.compliance * torque[:, spring.coordinate]
    return result


def payload_wrench(robot: Robot, frames: Frames, payload: Array) -> Array:
    """Return the weight of a mass that hangs on the flange, as a wrench at the TCP, base axes. Shape (n, 6). [N, N m].

    Args:
        robot: The robot; its flange and gravity.
        frames: Loaded frames.
        payload: Mass and first moments about the flange, flange axes. Shape (4,). [kg, kg m]

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


def _tilt(scene: ForwardModel, frames: Frames, wrench: Array) -> Array:
    twist = np.zeros((len(wrench), 6))
    if scene.tilt.any():
        twist[:, 3:] = scene.tilt * base_moment(frames, build_chain(scene.robot), wrench)
    return twist


def _bend(scene: ForwardModel, springs: dict[int, OwnSpring], torque: Array) -> Array:
    """Return the loads that bend springs as far as their laws bend them beyond the linear part. Shape (n, s)."""
    bent = np.zeros_like(torque)
    for index, law in scene.laws:
        if index in springs and springs[index].compliance > 0:
            spring = springs[index]
            k = spring.coordinate
            bent[:, k] += spring.sign * law(spring.sign * torque[:, k]) / spring.compliance
    return bent


def _spring_load(scene: ForwardModel, chain: Chain, springs: dict[int, OwnSpring]) -> Array | None:
    if not scene.joint_load.any():
        return None
    bias = np.zeros((len(scene.campaign), chain.n_springs))
    for index, spring in springs.items():
        bias[:, spring.coordinate] = spring.sign * scene.joint_load[:, index]
    return bias
