"""Linearization of a model: Jacobians and loads at every possible place of an effect.

Effects build their signatures from these arrays. Springs of zero compliance at every joint and axis give axes, origins
and loads, in the loaded state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from compplan.effects.forward_model import (
    Attained,
    ForwardModel,
    OwnSpring,
    base_moment,
    grow_chain,
    own_springs,
    spring_coordinates,
)
from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot, Spring
from compplan.statics.chain import build_chain, drive_columns, jacobian, load_elements, locate_frames, locate_gravity

Place = tuple[str, str | None, str | None]
AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
#: Deflection at the softest place of an arm without springs, under loads and weights of a campaign (assumed). [m]
GIVES = 5e-3
#: Compliance without any load (assumed: joints and bearings of a large arm). [rad/(N m)]
LARGE_ARM = 4e-7


@dataclass(frozen=True, eq=False)
class Linearization:
    """A model, its solution and its first derivatives; n rows."""

    scene: ForwardModel  #: The model.
    attained: Attained  #: Its solution.
    point: Array  #: Target in the base frame. Shape (n, 3). [m]
    #: Number in `axis`, `origin` and `load` of joint j's axis a: `elements[joint, "rx"]`; of the base: "base".
    elements: dict[tuple[str, str], int]
    axis: Array  #: Axes, base axes. Shape (n, e, 3).
    origin: Array  #: Their origins, base frame. Shape (n, e, 3). [m]
    load: Array  #: Load of wrench and weights on each. Shape (n, e). [N m or N]
    own: dict[int, OwnSpring]  #: The spring about each joint axis, by joint number.
    current: Mapping[Place, Mapping[str, Any]]

    @property
    def robot(self) -> Robot:
        """The robot of the model."""
        return self.scene.robot

    @property
    def campaign(self) -> Campaign:
        """The rows of the model."""
        return self.scene.campaign

    @cached_property
    def motion(self) -> Array:
        """Motion of the target per motion of each commanded joint with its mimic joints. Shape (n, 6, nq)."""
        return drive_columns(self.attained.chain, self.attained.jacobian)

    @cached_property
    def spring_motion(self) -> Array:
        """Motion of the target per deflection of the spring about each joint axis. Shape (n, 6, nq)."""
        return np.asarray(self.attained.jacobian[:, :, self.attained.chain.joint_elements])

    def twist(self, joint: str, axis: str) -> Array:
        """Return the motion of the target per unit motion about or along an axis of a joint's child frame. (n, 6)"""
        k = self.elements[joint, axis]
        return unit_twist(self.axis[:, k], self.origin[:, k], self.point, axis[0] == "t")

    def parent_twist(self, joint: str, axis: str) -> Array:
        """Return the motion of the target per unit motion of a joint's origin, axes of its parent link.

        The origin is that of the joint at zero. Shape (n, 6).
        """
        k, number = self.elements[self.before[joint], axis], self.robot.joint_names.index(joint)
        origin = self.origin[:, self.elements[joint, "rx"]]
        if self.robot.prismatic[number]:
            origin = self.attained.frames.origin[:, self.attained.chain.joint_elements[number]]
        return unit_twist(self.axis[:, k], origin, self.point, axis[0] == "t")

    def joint_load(self, joint: str, axis: str) -> Array:
        """Return the load about or along an axis of a joint's child frame. Shape (n,). [N m or N]."""
        return np.asarray(self.load[:, self.elements[joint, axis]])

    @cached_property
    def before(self) -> dict[str, str]:
        """Name of the joint before each joint of the chain; the first follows "base"."""
        names = ["base", *(joint.name for joint in self.robot.joints)]
        return dict(zip(names[1:], names[:-1], strict=True))

    @cached_property
    def own_load(self) -> Array:
        """Load on each commanded joint about its axis. Shape (n, nq). [N m or N]."""
        joints = self.attained.chain.joint_elements
        return np.asarray(load_elements(self.attained.chain, self.attained.frames, self.attained.wrench)[:, joints])

    @cached_property
    def own_weight_load(self) -> Array:
        """Load of the links' weights on each commanded joint. Shape (n, nq). [N m or N]."""
        chain = replace(self.attained.chain, gravity=self.robot.real_gravity)
        return np.asarray(load_elements(chain, self.attained.frames, np.zeros((1, 6)))[:, chain.joint_elements])

    @cached_property
    def usual_compliance(self) -> float:
        """Typical rotary compliance of the robot, the scale of unknown compliances.

        The median of its rotary springs; without springs, the compliance with which the most loaded place deflects
        by `GIVES`. [rad/(N m)]
        """
        own = [s.compliance for i, s in self.own.items() if not self.robot.prismatic[i] and s.compliance > 0.0]
        if own:
            return float(np.median(own))
        turns = [k for (_, axis), k in self.elements.items() if axis[0] == "r"]
        arm = np.cross(self.axis[:, turns], self.point[:, None] - self.origin[:, turns])
        moved = np.sqrt(np.mean(np.sum(arm**2, axis=2) * self.load[:, turns] ** 2, axis=0)).max(initial=0.0)
        # one digit, so that it is constant during a fit; softer than 1 rad/(N m): no load
        return float(f"{GIVES / moved:.0e}") if moved > GIVES else LARGE_ARM

    @cached_property
    def yielding(self) -> Array:
        """Motion of the target per load on each elastic coordinate: J C. Shape (n, 6, s)."""
        chain = self.attained.chain
        return np.asarray(self.attained.jacobian[:, :, chain.spring_elements] @ chain.compliance)

    @cached_property
    def spring_jacobian(self) -> Array:
        """Motion of the TCP per motion of each elastic coordinate. Shape (n, 6, s)."""
        chain = self.attained.chain
        return jacobian(chain, self.attained.frames)[:, :, chain.spring_elements]

    @cached_property
    def encoder_of_coordinate(self) -> Array:
        """Change of every link-side reading per elastic coordinate. Shape (nq, s)."""
        matrix = np.zeros((self.robot.nq, self.attained.chain.n_springs))
        for spring in self.own.values():
            if spring.actuator:
                matrix[spring.joint, spring.coordinate] = spring.sign
        return matrix

    def joint_response(self, index: int, moved: Array, *, spring: bool = False) -> tuple[Array, Array]:
        """Return motion of the target and change of the link-side readings for motions of a joint behind its motor.

        moved: k motions, (n, k) [rad or m]; spring: whether its spring moves, without mimic joints.
        """
        motion = self.spring_motion if spring else self.motion
        encoder = np.zeros((len(moved), self.robot.nq, moved.shape[1]))
        if not spring or index not in self.own or self.own[index].actuator:
            encoder[:, index] = moved
        return motion[:, :, index, None] * moved[:, None], encoder

    def load_response(self, loads: Array) -> tuple[Array, Array]:
        """Return motion of the target and change of the link-side readings under k loads, (n, s, k), on the springs."""
        return self.yielding @ loads, self.encoder_of_coordinate @ (self.attained.chain.compliance @ loads)

    def wrench_response(self, wrench: Array) -> tuple[Array, Array]:
        """Return motion of the target and change of link-side readings under k wrenches at the TCP, shape (n, 6, k)."""
        return self.load_response(np.swapaxes(self.spring_jacobian, 1, 2) @ wrench)


def linearize_model(
    model: ForwardModel, attained: Attained, current: Mapping[Place, Mapping[str, Any]] | None = None
) -> Linearization:
    """Compute Jacobians and loads of a solved model; current: parameters of its effects by name, joint and axis."""
    robot = model.robot
    probes = [Spring(joint.name, axis, 0.0) for joint in robot.joints for axis in AXES]
    probed = replace(robot, springs=(*robot.springs, *probes))
    chain = grow_chain(model, build_chain(probed))
    coordinates = spring_coordinates(probed)
    theta = np.zeros((len(attained.q), chain.n_springs))
    theta[:, np.setdiff1d(np.arange(chain.n_springs), coordinates[len(robot.springs) :])] = attained.theta
    frames = locate_frames(chain, attained.q, theta)
    load = load_elements(chain, frames, attained.wrench)
    force = attained.wrench[:, :3] + chain.mass.sum() * locate_gravity(chain, frames)
    base_load = np.concatenate([force, base_moment(frames, chain, attained.wrench)], axis=1)
    elements, picked = {}, []
    for number, spring in enumerate(probed.springs[len(robot.springs) :]):
        elements[spring.joint, spring.axis] = number
        picked.append(int(chain.spring_elements[coordinates[len(robot.springs) + number]]))
    axis, origin = frames.axis[:, picked], frames.origin[:, picked]
    count = len(picked)
    for number, name in enumerate(AXES):
        elements["base", name] = count + number
    n = len(attained.q)
    eye = np.broadcast_to(np.r_[np.eye(3), np.eye(3)], (n, 6, 3))
    return Linearization(
        scene=model,
        attained=attained,
        point=attained.target,
        elements=elements,
        axis=np.concatenate([axis, eye], axis=1),
        origin=np.concatenate([origin, np.zeros((n, 6, 3))], axis=1),
        load=np.concatenate([load[:, picked], base_load], axis=1),
        own=own_springs(robot),
        current=current or {},
    )


def unit_twist(axis: Array, origin: Array, point: Array, slides: bool) -> Array:
    """Return the motion of a point per unit motion about (or along) an axis. Shapes (n, 3) -> (n, 6)."""
    if slides:
        return np.concatenate([axis, np.zeros_like(axis)], axis=1)
    return np.concatenate([np.cross(axis, point - origin), axis], axis=1)
