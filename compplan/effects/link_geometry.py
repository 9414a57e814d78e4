"""link_geometry: a length or an axis direction in a joint's <origin> differs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.effects.folding import change_joint, find_joint
from compplan.effects.linearization import AXES, Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Joint, Robot

name = "link_geometry"
words = "a length or direction at {at} differs"
follows = "posture"
#: Assumed: lengths to half a millimetre, directions to half a milliradian.
SCALE = {"t": 5e-4, "r": 5e-4}
UNIT = {"t": "m", "r": "rad"}


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return each axis of each moving joint's origin, and all of a joint together.

    Axes are those of the parent link, as in the URDF. A rotation about the joint axis is an offset of its zero.
    """
    for joint in at.robot.actuated:
        twists = {axis: at.parent_twist(joint.name, axis) for axis in AXES if not _own(joint, axis)}
        keys = tuple(f"{axis}_{UNIT[axis[0]]}" for axis in twists)
        scale, twist = np.array([SCALE[axis[0]] for axis in twists]), np.stack(list(twists.values()), axis=-1)
        every = Signature(name, joint.name, None, "all", keys, scale, twist, columns=keys)
        for k, axis in enumerate(twists):
            yield replace(every.part("", slice(k, k + 1)), axis=axis)
        yield every


def _own(joint: Joint, axis: str) -> bool:
    """Return whether a parent axis is (nearly) the joint axis."""
    if (joint.kind == "prismatic") != (axis[0] == "t"):
        return False
    return abs(float((joint.placement[:3, :3] @ joint.axis)["xyz".index(axis[1])])) > 0.9


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write the step into the joint's origin: a shift, then a turn, in the axes of its parent link."""
    step = np.array([float(effect.parameters.get(f"{axis}_{UNIT[axis[0]]}", 0.0)) for axis in AXES])
    placement = find_joint(robot, effect.joint).placement.copy()
    placement[:3, 3] += step[:3]
    placement[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ placement[:3, :3]
    return change_joint(robot, str(effect.joint), placement=placement)
