"""What a robot folder can hold of a lesson: parameters that URDF and springs can say, and how surely all are known."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from compplan.effects import EFFECTS, Effect
from compplan.effects.signature import pack_parameters
from compplan.known.assumed import LINK_ELASTICITY
from compplan.known.vary import vary_robot
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, split_unknowns

#: Effects that are one spring.
SPRINGS = ("joint_stiffness", "link_compliance", "base_compliance")


class Learned(NamedTuple):
    """A parameter that a part told something of.

    Attributes:
        name: Its name for people.
        key: Its key; the unit is its end.
        value: What it moved by. [SI]
        width: Its standard deviation before. [SI]
        kept: Whether the robot folder holds it, nine tenths of it at least.
    """

    name: str
    key: str
    value: float
    width: float
    kept: bool


def teach_robot(robot: Robot, known: Uncertainty, values: Array, covariance: Array) -> tuple[Robot, Array]:
    """Put what was learned into a robot folder: what URDF and springs can say, and how surely all of it is known.

    What they cannot say (lost motion, gear error, the tool of the job, a spring below zero) stays with the path; its
    mean counts as not known, m m^T.

    Args:
        robot: The robot of the folder.
        known: What was known; its unknowns order the values.
        values: Posterior means about the folder. Shape (p,). [SI]
        covariance: Posterior covariance. Shape (p, p).

    Returns:
        The robot, and how much of each value it holds now. Shape (p,). [SI]
    """
    held: list[Array] = []
    for unknown, own in split_unknowns(known.unknowns, values):
        robot, part = hold_values(robot, unknown, own)
        held.append(part)
    holds = np.concatenate(held) if held else np.zeros(0)
    missing = values - holds
    after = known.with_covariance(covariance + np.outer(missing, missing))
    folder = after.select(u.effect != "tool_frame" for u in after.unknowns)
    return replace(robot, uncertainty=replace(folder, grade=known.grade)), holds


def hold_values(robot: Robot, unknown: Unknown, own: Array) -> tuple[Robot, Array]:
    """Put values of one unknown into a robot folder; also return how much of them it holds. own: shape (k,). [SI]

    A spring bends with its load: of a compliance that would come out below zero the folder holds what takes it to zero.
    """
    if unknown.effect == LINK_ELASTICITY:
        return vary_robot(robot, unknown, own)[0], own
    joints = {joint.name for joint in robot.joints}
    if unknown.effect == "tool_frame" or (unknown.joint is not None and unknown.joint not in joints):
        return robot, np.zeros(len(own))
    effect = Effect(unknown.effect, unknown.joint, unknown.axis, pack_parameters(unknown.keys, own, unknown.fixed))
    folded = EFFECTS[unknown.effect].fold(robot, effect)
    if folded is None:
        return robot, np.zeros(len(own))
    if unknown.effect in SPRINGS:
        own = np.array([_sum_springs(folded) - _sum_springs(robot)])
    return folded, own


def _sum_springs(robot: Robot) -> float:
    return float(sum(spring.compliance for spring in robot.springs))


def list_learned(known: Uncertainty, values: Array, held: Array, most: int = 10) -> list[Learned]:
    """List the parameters that moved most for their width."""
    kept = np.abs(values - held) <= 0.1 * np.abs(values)
    width = known.width
    share = np.abs(values) / np.maximum(width, 1e-300)
    names, keys = known.names, [key for unknown in known.unknowns for key in unknown.keys]
    return [
        Learned(names[k], keys[k], float(values[k]), float(width[k]), bool(kept[k]))
        for k in np.argsort(-share)[:most]
    ]
