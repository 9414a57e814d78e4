"""Rival explanations: what else the robot might be where a campaign cannot tell a claim from other effects.

A claim of values a leaves the trace H a. An effect that the campaign cannot tell from it explains that trace with
values b, the least squares of H_b b against H a, frames fitted to both, and leaves d of its squares in units of the
noise. The robot is then off the folder by (-a, b) where this holds the claim, by (0, b) where it does not. Before the
campaign claim and rivals are equally probable; after it their weights are as 1 to exp(-d / 2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import NEGLIGIBLE
from compplan.diagnosis.results.verdict import Verdict
from compplan.diagnosis.search.state import Fit, FitState
from compplan.diagnosis.validation.ambiguity import AlternativeEffect, imitate_claim
from compplan.effects import is_of_instrument
from compplan.effects.signature import Signature
from compplan.robot import Array

#: Frames of a campaign and of a tool are no causes in a robot.
FRAMES = ("base_frame", "tool_frame", "tool_shift", "frame_shift")


@dataclass(frozen=True, eq=False)
class Explanation:
    """Another explanation of a claim.

    Attributes:
        instead: The claim.
        signature: The other effect.
        weight: Its probability, claim and rivals together one.
        columns: Columns that it moves, those of the claim and its own.
        shift: What it moves them by from what the folder holds. [SI]
        change: What it moves them by from what the claim says. [SI]
    """

    instead: Signature
    signature: Signature
    weight: float
    columns: NDArray[np.int_]
    shift: Array
    change: Array


def name_alternatives(verdict: Verdict) -> dict[int, tuple[AlternativeEffect, ...]]:
    """List for every claim of a verdict, by its signature, the effects that the campaign cannot tell from it."""
    found = (*verdict.findings, *verdict.minor, *verdict.doubtful)
    return {f.signature: tuple(rival for rival in f.rivals if rival.alike) for f in found if f.signature >= 0}


def explain_otherwise(
    fit: Fit, state: FitState, mean: Array, rivals: Mapping[int, Sequence[AlternativeEffect]]
) -> list[Explanation]:
    """Find what the robot would be under the rivals of the claims that may be true.

    Args:
        fit: The fit.
        state: What the folder holds.
        mean: Posterior mean of every column, in units of its scale. Shape (p,).
        rivals: Rivals of each claim, by its signature.
    """
    equations, found = fit.search.equations, []
    for number, others in rivals.items():
        own = equations.columns(number)
        held = np.array([state.values.get(equations.names[column], 0.0) for column in own]) / equations.scale[own]
        claimed = held if held.any() else mean[own]
        if not claimed.any() or is_of_instrument(equations.signatures[number].name):
            continue
        mine: list[tuple[Explanation, float]] = []
        for rival in others:
            if rival.place[0] in FRAMES or is_of_instrument(rival.place[0]):
                continue
            other, values, left = imitate_claim(fit, number, rival.place, claimed)
            signature, theirs = equations.signatures[other], equations.columns(other)
            if np.intersect1d(own, theirs).size or (signature.positive and (values < 0.0).any()):
                continue
            columns = np.r_[own, theirs]
            shift, change = (np.r_[-gone, values] * equations.scale[columns] for gone in (held, claimed))
            one = Explanation(equations.signatures[number], signature, 0.0, columns, shift, change)
            mine.append((one, float(np.exp(-0.5 * left))))
        total = 1.0 + sum(weight for _, weight in mine)
        for one, weight in mine:
            if weight / total >= NEGLIGIBLE:
                found.append(replace(one, weight=weight / total))
    return found
