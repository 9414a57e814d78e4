"""What would narrow a promise: the same band, recomputed with one of its causes known better.

To measure parameter j down to the standard deviation w takes c S e_j e_j^T S / S_jj off the covariance S, with
c = 1 - w^2 / S_jj; what is correlated with it is then known better too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty

#: How well a compliance can be had by loading the arm (assumed), share of its own value; and anything else, share of
#: its present width.
COMPLIANCE, SHARE = 0.05, 0.25


@dataclass(frozen=True)
class Narrowing:
    """What better knowledge of one cause would do.

    Attributes:
        cause: A parameter, or "the force".
        words: What would have to be known, and how well.
        promise: Greatest distance of the band then. [m]
    """

    cause: str
    words: str
    promise: float


def rank_narrowings(
    knowable: Sequence[tuple[str, str, Array]], greatest: Callable[[Array], float]
) -> tuple[Narrowing, ...]:
    """Rank what could be known better by the promise that it leaves, smallest first.

    Args:
        knowable: Cause, words, and what it takes off the covariance. Shape (k, 3, 3) each. [m^2]
        greatest: Tells the greatest distance of the band without a part of its covariance. [m]
    """
    found = [Narrowing(cause, words, greatest(part)) for cause, words, part in knowable]
    return tuple(sorted(found, key=lambda entry: entry.promise))


def list_knowable(
    robot: Robot, known: Uncertainty, model: Array, parts: Mapping[str, Array], most: int = 6
) -> list[tuple[str, str, Array]]:
    """Return what better knowledge takes off the covariance of the tip: cause, words, and shape (k, 3, 3) each. [m^2]

    Args:
        robot: The robot.
        known: What is known of it.
        model: Motion of the tip by the columns of `known.spread`. Shape (k, 3, r). [m]
        parts: Covariance of the tip by each part.
        most: Parameters that are looked at: those that take off the most.
    """
    deviation = known.width
    seen = model @ known.factor.T
    found = []
    for j, (name, (words, width)) in enumerate(zip(known.names, _targets(robot, known, deviation), strict=True)):
        share = 1.0 - (min(width, deviation[j]) / deviation[j]) ** 2 if deviation[j] > 0 else 0.0
        found.append((name, words, share * seen[:, :, j, None] * seen[:, None, :, j]))
    found.sort(key=lambda entry: -float(np.trace(entry[2], axis1=1, axis2=2).mean()))
    return [*found[:most], ("the force", "the force twice as well", 0.75 * parts["force"])]


def _targets(robot: Robot, known: Uncertainty, deviation: Array) -> list[tuple[str, float]]:
    """Return for each parameter what would have to be known, and the standard deviation that this means."""
    own = {spring.joint: spring.compliance for spring in robot.springs if spring.axis == "own"}
    found, first = [], 0
    for unknown in known.unknowns:
        whole = own.get(str(unknown.joint), 0.0)
        for name in unknown.names:
            now = float(deviation[first])
            if unknown.effect == "joint_stiffness" and COMPLIANCE * whole < now and whole > 0:
                found.append((f"the compliance of {unknown.joint} to {100 * COMPLIANCE:g} %", COMPLIANCE * whole))
            else:
                found.append((f"{name} to a quarter of its width", SHARE * now))
            first += 1
    return found
