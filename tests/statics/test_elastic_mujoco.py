"""MuJoCo's rigid bodies, hinges and springs at rest give the same deflection as the elastic chain."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.robot import Body, Robot, Spring, load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium

mujoco = pytest.importorskip("mujoco")

ROBOTS = ["kuka_kr270", "staubli_tx200", "fanuc_m10ia", "kuka_kr240_rail"]
TOLERANCE_M = 0.1e-6
Array = NDArray[np.float64]


def with_random_springs(robot: Robot, rng: np.random.Generator) -> Robot:
    """Give every joint a spring about its own axis, some a second and third one, all bodies their mass, and gravity."""
    springs = []
    for joint in robot.actuated:
        sliding = joint.kind == "prismatic"
        springs.append(Spring(joint.name, "own", float(10 ** rng.uniform(-7.5, -6.5)) * (0.1 if sliding else 1.0)))
        for axis in rng.choice(["tx", "ty", "tz", "rx", "ry", "rz"], size=2, replace=False):
            compliance = 10 ** rng.uniform(-8.5, -7.5) if axis[0] == "t" else 10 ** rng.uniform(-7.5, -6.0)
            springs.append(Spring(joint.name, str(axis), float(compliance), rng.uniform(-0.3, 0.3, 3)))
    for joint in (j for j in robot.joints if j.kind == "fixed"):  # a plate or flange that yields
        springs.append(Spring(joint.name, "rx", 2e-7, rng.uniform(-0.1, 0.1, 3)))
        springs.append(Spring(joint.name, "tz", 1e-8))
    bodies = robot.bodies or tuple(Body(joint.child, 40.0, rng.uniform(-0.2, 0.2, 3)) for joint in robot.actuated)
    return replace(
        robot, springs=tuple(springs), link_elasticities=(), bodies=bodies, gravity=np.array([0.4, -0.3, -9.81])
    )


def text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))


def build_mujoco(robot: Robot, q: Array) -> object:
    """Build the tree with the commanded joints frozen at q."""
    root = ElementTree.Element("mujoco")
    ElementTree.SubElement(root, "compiler", angle="radian", boundmass="1e-12", boundinertia="1e-12")
    assert robot.gravity is not None
    ElementTree.SubElement(root, "option", gravity=text(robot.gravity))
    place = ElementTree.SubElement(root, "worldbody")

    def nest(pose: Array) -> None:
        nonlocal place
        quaternion = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)
        place = ElementTree.SubElement(place, "body", pos=text(pose[:3, 3]), quat=text(quaternion))

    def pose_of(rotation: Array, position: Array) -> Array:
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, position
        return pose

    values = dict(zip(robot.joint_names, q, strict=True))
    for joint in robot.joints:
        nest(joint.placement)
        if joint.actuated:
            value = values[joint.name]
            slides = joint.kind == "prismatic"
            turned = np.eye(3) if slides else Rotation.from_rotvec(joint.axis * value).as_matrix()
            nest(pose_of(turned, joint.axis * value if slides else np.zeros(3)))
        for spring in (s for s in robot.springs if s.joint == joint.name):
            nest(pose_of(np.eye(3), spring.offset))
            own = spring.axis == "own"
            slides = joint.kind == "prismatic" if own else spring.axis[0] == "t"
            axis = joint.axis if own else np.eye(3)["xyz".index(spring.axis[1])]
            kind, stiffness = "slide" if slides else "hinge", text(1 / spring.compliance)
            ElementTree.SubElement(place, "joint", type=kind, axis=text(axis), stiffness=stiffness)
            nest(pose_of(np.eye(3), -spring.offset))
        for body in (b for b in robot.bodies if b.link == joint.child):
            weight = ElementTree.SubElement(place, "body", pos=text(body.centre))
            ElementTree.SubElement(weight, "inertial", pos="0 0 0", mass=text(body.mass), diaginertia="1e-3 1e-3 1e-3")
    place.set("name", "tcp")
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def rest(model: object, wrench: Array) -> tuple[Array, Array]:
    """Bring MuJoCo's tree to rest under a wrench at the TCP: position and orientation of the TCP."""
    data = mujoco.MjData(model)
    tcp = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "tcp")
    for _ in range(60):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_passive(model, data)
        weight, applied = np.zeros(model.nv), np.zeros(model.nv)
        mujoco.mj_rne(model, data, 0, weight)
        mujoco.mj_applyFT(model, data, wrench[:3], wrench[3:], data.xpos[tcp], tcp, applied)
        unbalanced = data.qfrc_passive + applied - weight
        step = unbalanced / model.jnt_stiffness.reshape(model.nv, -1)[:, 0]
        data.qpos += step
        if np.abs(step).max() < 1e-14:
            return data.xpos[tcp].copy(), data.xmat[tcp].reshape(3, 3).copy()
    raise AssertionError("MuJoCo did not come to rest")


@pytest.mark.parametrize("name", ROBOTS)
def test_deflections_agree_with_mujoco_within_a_tenth_of_a_micrometre(name: str) -> None:
    rng = np.random.default_rng(ROBOTS.index(name))
    robot = with_random_springs(load_robot(name), rng)
    chain = build_chain(robot)
    q = rng.uniform(np.maximum(robot.lower, -1.5), np.minimum(robot.upper, 1.5), (6, robot.nq))
    wrench = np.hstack([rng.normal(size=(6, 3)) * 500, rng.normal(size=(6, 3)) * 80])
    loaded = solve_equilibrium(chain, q, wrench)
    unloaded = locate_frames(chain, q).tcp_position
    for row in range(len(q)):
        position, rotation = rest(build_mujoco(robot, q[row]), wrench[row])
        assert np.linalg.norm(loaded.position[row] - unloaded[row]) > 2e-5
        np.testing.assert_allclose(loaded.position[row], position, rtol=0, atol=TOLERANCE_M)
        np.testing.assert_allclose(loaded.rotation[row], rotation, rtol=0, atol=1e-8)
