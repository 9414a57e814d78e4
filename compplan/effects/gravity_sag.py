"""gravity_sag: link weights load the springs and the model leaves them out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.folding import add_own_compliance
from compplan.effects.joint_stiffness import RIGID_SCALE
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot
from compplan.robot.model import STANDARD_GRAVITY
from compplan.statics.chain import load_elements

name = "gravity_sag"
words = "link weights bend the arm and the model leaves them out"
sits, follows = "links", "gravity"
SHARE, JOINTS = "gravity_m_s2", "joints"


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return gravity if the model has none; on a rigid robot without varying load, compliances too."""
    if not at.robot.bodies:
        return
    found = at.current.get((name, None, None), {})
    if (at.robot.gravity is None or SHARE in found) and at.attained.chain.n_springs:
        chain = at.attained.chain
        weighed = replace(chain, gravity=at.robot.real_gravity)
        loads = load_elements(weighed, at.attained.frames, np.zeros((1, 6)))[:, chain.spring_elements, None]
        twist, encoder = at.load_response(loads / STANDARD_GRAVITY)
        yield Signature(name, None, None, "", (SHARE,), np.array([STANDARD_GRAVITY]), twist, encoder, positive=True)
    rigid = not any(spring.compliance > 0 for spring in at.own.values())
    if not at.campaign.load_varies and (rigid or JOINTS in found):
        yield from _bending_joints(at)


def _bending_joints(at: Linearization) -> Iterable[Signature]:
    """Return one compliance per joint that is loaded by weights."""
    loads = at.own_weight_load
    joints = [k for k in range(at.robot.nq) if np.abs(loads[:, k]).max(initial=0.0) > 1e-3]
    if not joints:
        return
    twist = np.stack([at.spring_motion[:, :, k] * loads[:, None, k] for k in joints], axis=-1)
    encoder = np.zeros((len(loads), at.robot.nq, len(joints)))
    for column, k in enumerate(joints):
        encoder[:, k, column] = loads[:, k]
    names = [at.robot.joint_names[k] for k in joints]
    keys = tuple(f"compliance_rad_per_Nm#{column}" for column in range(len(joints)))
    # assumed: small robots bend more, so that a load of 1 N m turns a joint by ten times the scale of a medium robot
    scale = np.array([10 * RIGID_SCALE[at.robot.actuated[k].kind] for k in joints])
    # by joint: which joints the weights load changes with the linearized robot
    columns = tuple(f"compliance of {joint}" for joint in names)
    fixed = {JOINTS: names}
    yield Signature(name, None, None, JOINTS, keys, scale, twist, encoder, fixed, positive=True, columns=columns)


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write gravity, and the compliances of a rigid robot."""
    values = effect.parameters
    if SHARE in values:
        old = np.zeros(3) if robot.gravity is None else robot.gravity
        return replace(robot, gravity=old + np.array([0.0, 0.0, -float(values[SHARE])]))
    robot = replace(robot, gravity=robot.real_gravity)
    for joint, compliance in zip(values[JOINTS], values["compliance_rad_per_Nm"], strict=True):
        robot = add_own_compliance(robot, str(joint), max(float(compliance), 0.0))
    return robot
