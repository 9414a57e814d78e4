"""Intervals of an effect's parameters, and its change of a joint's compliance in percent."""

from __future__ import annotations

from typing import Any

from compplan.diagnosis.data.shared import HALF_WIDTH
from compplan.effects.forward_model import own_springs
from compplan.effects.signature import Effect
from compplan.robot import Robot
from compplan.robot.uncertainty import Uncertainty, split_unknowns


def state_change(robot: Robot, effect: Effect, sure: Uncertainty) -> dict[str, Any]:
    """State the intervals of an effect's parameters.

    Returns:
        "interval95": lower and upper end by parameter, where one is known; and, of a joint's compliance that the model
        knows, "change_percent": value, lower and upper end in percent of the model's.
    """
    deviation = {
        key: float(sigma)
        for unknown, widths in split_unknowns(sure.unknowns, sure.width)
        if (unknown.effect, unknown.joint, unknown.axis) == tuple(effect.place)
        for key, sigma in zip(unknown.keys, widths, strict=True)
    }
    ends = {
        key: [float(value) - HALF_WIDTH * deviation[key], float(value) + HALF_WIDTH * deviation[key]]
        for key, value in effect.parameters.items()
        if key in deviation
    }
    if not ends:
        return {}
    found: dict[str, Any] = {"interval95": ends}
    if effect.name == "joint_stiffness":
        spring = own_springs(robot).get(robot.joint_names.index(str(effect.joint)))
        key = next(iter(ends))
        if spring is not None and spring.compliance > 0.0:
            found["change_percent"] = [
                round(100.0 * value / spring.compliance, 2) for value in (float(effect.parameters[key]), *ends[key])
            ]
    return found
