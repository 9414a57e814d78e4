"""Intervals of named effects: whether the 95 % region excludes zero, and the ends of every parameter."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtri

from compplan.diagnosis.data.shared import HALF_WIDTH, LEVEL, ROUNDING
from compplan.effects.forward_model import own_springs
from compplan.effects.signature import Effect
from compplan.robot import Robot
from compplan.robot.uncertainty import Uncertainty, split_unknowns


def excludes_zero(effect: Effect, sizes: Uncertainty) -> bool:
    """Tell whether the 95 % region of an effect's parameters excludes zero; True where no uncertainty is stated.

    With values v and their covariance C: v^T C^-1 v above the 95 % point of chi-square.
    """
    for unknown, rows in split_unknowns(sizes.unknowns, np.arange(len(sizes.width), dtype=float)):
        if (unknown.effect, unknown.joint, unknown.axis) == tuple(effect.place):
            keys = [key.partition("#") for key in unknown.keys]
            values = [np.atleast_1d(effect.parameters.get(name, 0.0))[int(item or 0)] for name, _, item in keys]
            spread = sizes.spread[rows.astype(int)]
            covariance = spread @ spread.T
            covariance += ROUNDING * np.diag(np.diag(covariance))
            return bool(values @ np.linalg.solve(covariance, values) > chdtri(len(values), 1.0 - LEVEL))
    return True


def state_change(robot: Robot, effect: Effect, sizes: Uncertainty) -> dict[str, Any]:
    """State the intervals of an effect's parameters, which hold 95 % where the effect is present.

    Returns:
        "interval95": lower and upper end by parameter, where one is known; and, of a joint's compliance that the model
        knows, "change_percent": value, lower and upper end in percent of the model's.
    """
    deviation = {
        key: float(sigma)
        for unknown, widths in split_unknowns(sizes.unknowns, sizes.width)
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
