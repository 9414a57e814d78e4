"""joint_stiffness: a joint's compliance differs from the model's."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from compplan.effects.folding import add_own_compliance
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.robot import Robot

name = "joint_stiffness"
words = "the compliance of {at} differs from the model"
follows = "load"
#: Assumed: half of the modelled compliance; of a rigid joint the usual one of the robot (slide: medium robot).
RELATIVE_SCALE = 0.5
#: A joint keeps at least a tenth of its modelled compliance (assumed).
LEAST_SHARE = 0.9
RIGID_SCALE = {"revolute": 1e-6, "prismatic": 1e-7}


def compliance_key(kind: str) -> str:
    """Return the key of a compliance with its unit."""
    return "compliance_change_m_per_N" if kind == "prismatic" else "compliance_change_rad_per_Nm"


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return every joint with a loaded spring; joints without a spring only if the external load varies."""
    weighed = at.current.get(("gravity_sag", None, None), {})
    sag = dict(zip(weighed.get("joints", ()), weighed.get("compliance_rad_per_Nm", ()), strict=True))
    motor_side = ~at.campaign.link_controlled[:, None]
    for index, joint in enumerate(at.robot.actuated):
        changed = at.current.get((name, joint.name, None), {}).get(compliance_key(joint.kind), 0.0)
        nominal = at.own[index].compliance - changed - sag.get(joint.name, 0.0) if index in at.own else 0.0
        nominal = nominal if nominal > 1e-12 else 0.0
        if nominal <= 0.0 and not at.campaign.load_varies:
            continue
        usual = RIGID_SCALE[joint.kind] if joint.kind == "prismatic" else at.usual_compliance
        scale = RELATIVE_SCALE * nominal if nominal > 0 else usual
        load = at.own_load[:, index, None] * motor_side
        twist, encoder = at.joint_response(index, load, spring=True)
        keys, least = (compliance_key(joint.kind),), (-LEAST_SHARE * nominal,)
        yield Signature(name, joint.name, None, "", keys, np.array([scale]), twist, encoder, least=least)


def fold(robot: Robot, effect: Effect) -> Robot:
    """Write the compliance into the joint's spring."""
    return add_own_compliance(robot, str(effect.joint), float(next(iter(effect.parameters.values()))))
