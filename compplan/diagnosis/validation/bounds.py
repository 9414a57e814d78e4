"""Bounds: largest sizes of effects that a robot of this kind can have, each with its reason.

If a campaign cannot distinguish an effect from others, its fitted size may exceed the limits of weight, gears and data
sheet. Such a claim is not named: its motion has another cause. Neither is a step at the first or last few poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.diagnosis.data.shared import FEW_ROWS, ROUNDING
from compplan.diagnosis.search.state import Fit
from compplan.effects import Effect, thermal_drift
from compplan.effects.gravity_sag import JOINTS
from compplan.effects.link_compliance import SHARE
from compplan.effects.payload import carried_payload, payload_values
from compplan.robot import Array, Robot
from compplan.robot.model import STANDARD_GRAVITY
from compplan.robot.mounting import mounted_tool
from compplan.robot.rating import read_rating

#: Largest rotation of a joint, a link or the base plate under the weight of the stretched arm and its rated payload
#: (assumed: a fiftieth of the arm's length; the softest arms on sale bend by less than a hundredth as a whole). [rad]
MOST_BENT = 0.02


@dataclass(frozen=True)
class SizeLimits:
    """Largest sizes of effects."""

    #: Motion of the target by one claim over the gap: more than ten gaps occur only if others cancel them (assumed).
    most_motion: float = 10.0
    #: Mass at the flange over the rated payload (assumed: arms carry a tenth more than rated; without a data sheet,
    #: less than their mass).
    over_rating: float = 1.1
    #: Largest distance of a mass's centre behind the flange (assumed: the length of a wrist, with its cables). [m]
    most_offset: float = 0.1
    #: Warming of a link within a campaign (assumed: working arms warm up by 10 to 30 K), and its growth (theory: of
    #: aluminium). [K, 1/K]
    most_warmed: float = 40.0
    expansion: float = 2.4e-5


LIMITS = SizeLimits()


def find_breach(fit: Fit, effect: Effect, explained: float, gap: float) -> str:
    """Return why a robot cannot have an effect of this size; empty if it can.

    `explained` is the rms motion of the target by the effect, `gap` the rms gap of the model without effects. [m]
    """
    if explained > LIMITS.most_motion * gap:
        return f"it moves the target by {1e3 * explained:.3g} mm, the gap is {1e3 * gap:.3g} mm"
    check = {
        "payload": _check_payload, "link_compliance": _check_bending, "base_compliance": _check_bending,
        "joint_stiffness": _check_bending, "gravity_sag": _check_bending, "thermal_drift": _check_growth,
        "frame_shift": _check_step, "tool_shift": _check_step,
    }.get(effect.name)  # fmt: skip
    return "" if check is None else check(fit, effect)


def _check_payload(fit: Fit, effect: Effect) -> str:
    robot, payload = fit.problem.robot, payload_values(effect)
    carried, added = carried_payload(robot), float(payload[0])
    whole, rating = added + carried[0], read_rating(robot)
    if rating is not None and whole > LIMITS.over_rating * rating.payload:
        return f"{whole:.3g} kg on the flange, the arm is sold for {rating.payload:g} kg"
    arm = float(sum(body.mass for body in robot.bodies)) - carried[0]
    if rating is None and whole > arm:
        return f"{whole:.3g} kg on the flange, the arm itself weighs {arm:.3g} kg"
    behind = -float(outward_axis(fit) @ payload[1:])
    if added > 0.0 and behind > LIMITS.most_offset * whole:
        return f"{added:.3g} kg with their centre {1e3 * behind / added:.4g} mm behind the flange, inside the arm"
    # a mass can only be removed if it was there: the rest of the tool is in front of the flange, too
    left = -float(outward_axis(fit) @ (payload + carried)[1:])
    if added <= 0.0 and left > LIMITS.most_offset * whole:
        where = f"{1e3 * left / whole:.4g} mm behind the flange, inside the arm" if whole > 0.0 else "nowhere"
        return f"{-added:.3g} kg less on the flange leave {whole:.3g} kg with their centre {where}"
    return ""


def _check_bending(fit: Fit, effect: Effect) -> str:
    values = effect.parameters
    for key, several in values.items():
        if not key.startswith("compliance"):
            continue
        for joint, compliance in zip(values.get(JOINTS, [effect.joint]), np.atleast_1d(several), strict=True):
            moment = stretched_moment(fit.problem.robot, joint)
            turn = moment * float(compliance) / (SHARE["t"] if key.endswith("m_per_N") else 1.0)
            if turn > MOST_BENT:
                where = "the base" if joint is None else joint
                return f"{where} would bend by {1e3 * turn:.3g} mrad under the stretched arm's {moment:.3g} N m"
    return ""


def _check_growth(fit: Fit, effect: Effect) -> str:
    grown = np.abs(thermal_drift.apply(fit.at.scene, effect).growth - fit.at.scene.growth).max(initial=0.0)
    if grown <= LIMITS.most_warmed * LIMITS.expansion:
        return ""
    return f"a link would grow by {1e3 * grown:.2g} mm per metre: aluminium {grown / LIMITS.expansion:.2g} K warmer"


def _check_step(fit: Fit, effect: Effect) -> str:
    row, stay = int(effect.parameters["row"]), fit.problem.campaign.stay
    for side, part in (("before", stay[:row]), ("after", stay[row:])):
        if len(np.unique(part)) < FEW_ROWS:
            return f"fewer than {FEW_ROWS} poses {side} row {row}: a step there fits errors of any cause"
    return ""


def stretched_moment(robot: Robot, joint: str | None) -> float:
    """Return the moment of the arm's weight beyond a joint (None: the base) and of its rated payload, stretched. [N m]

    g (sum_b m_b (l_b + |c_b|) + m_rated l_flange), l the length of chain from the joint to a link; 0 without masses and
    data sheet.
    """
    start = next((j.child for j in robot.joints if j.name == joint), robot.base)
    length = {start: 0.0}
    for j in robot.joints:
        if j.parent in length:
            length.setdefault(j.child, length[j.parent] + float(np.linalg.norm(j.placement[:3, 3])))
    moment = sum(b.mass * (length[b.link] + float(np.linalg.norm(b.centre))) for b in robot.bodies if b.link in length)
    rating = read_rating(robot)
    carried = 0.0 if rating is None else rating.payload * length.get(robot.flange, 0.0)
    return STANDARD_GRAVITY * (moment + carried)


def outward_axis(fit: Fit) -> Array:
    """Return the outward direction of the flange in its frame: towards the tool, or its z by default. Shape (3,)."""
    tip = mounted_tool(fit.problem.robot)[:3, 3]
    length = float(np.linalg.norm(tip))
    return np.asarray(tip / length) if length > ROUNDING else np.array([0.0, 0.0, 1.0])
