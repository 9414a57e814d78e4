"""Gears: whether a curve of several waves over a joint's angle is the error of a gear.

Real gears err in several waves a turn: wave generator, flex spline, bearings, encoder. Each of them is a wave by
itself: it gains evidence beside the others, halves of the poses give it the same size and phase, so that each predicts
the other, and the campaign has seen its period. Where waves do not repeat they are a curve of any shape, and name
nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.evidence.evidence import find_posterior
from compplan.diagnosis.evidence.normal_equations import select_rows
from compplan.diagnosis.evidence.proposals import TRIED_A_WAVE
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.split_half import draw_halves
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.effects import gravity_sag
from compplan.effects.signature import Signature
from compplan.effects.transmission_error import periods_seen
from compplan.robot import Array

#: A lawful form explains most of what a curve of no law does where it has this part of its log evidence, and a wave is
#: met again where so many pairs of halves agree on it (assumed: in drawn campaigns true gear errors have .85 and more
#: but for one, other causes mostly less than .6).
MOST_OF_IT = 0.75


def find_gears(fit: Fit, doubt: RevisedProbabilities) -> frozenset[Claim]:
    """Find the claims of several waves that are errors of gears.

    Args:
        fit: The fit.
        doubt: Its claims among errors that no effect makes.
    """
    signatures = doubt.search.ledger.signatures
    several = [c for c in doubt.model.claims if _cycles(signatures[c.signature])]
    halves = solve_halves(fit, doubt) if several else np.zeros((0, 0))
    return frozenset(claim for claim in several if _is_gear(fit, doubt, claim, halves))


def is_law(fit: Fit, signature: Signature) -> bool:
    """Tell whether a form is a law of its effect in this campaign.

    The moment of the links' weight is a wave of a turn itself: where the model leaves bending under it out, a wave of
    which less than a period is seen is no gear's law.

    Args:
        fit: The fit.
        signature: The form.
    """
    cycles = signature.fixed.get("cycles_per_turn", ())
    bends = any(s.name == "gravity_sag" and s.form == gravity_sag.JOINTS for s in fit.search.ledger.signatures)
    if not signature.lawful or not bends or not cycles:
        return signature.lawful
    return float(periods_seen(min(cycles), _range_of(fit, signature), slides=False)) >= 1.0


def _range_of(fit: Fit, signature: Signature) -> float:
    """Return the range that the joint of a form visits. [rad or m]"""
    index = fit.at.robot.joint_names.index(str(signature.joint))
    return float(np.ptp(fit.problem.campaign.q[:, index]))


def _cycles(signature: Signature) -> list[float]:
    """Return the cycles of a form of several waves that is no law by itself; empty for any other."""
    if signature.lawful or not signature.form.startswith("waves"):
        return []
    return list(signature.fixed.get("cycles_per_turn", signature.fixed.get("cycles_per_m", ())))


def solve_halves(fit: Fit, doubt: RevisedProbabilities) -> Array:
    """Return the values that halves of the poses lead to, noise and sizes of classes held. Shape (halves, p)."""
    search, model = doubt.search, doubt.model
    prior = search.prior_of(model.claims)
    columns, found = prior.active, []
    for rows in draw_halves(fit.problem.campaign):
        part = replace(search.ledger, channels=select_rows(search.ledger, rows, columns))
        values = np.zeros(search.ledger.p)
        values[columns] = find_posterior(part, prior.of(columns), model.posterior.hyper, fit=False).values(len(columns))
        found.append(values)
    return np.array(found)


def _is_gear(fit: Fit, doubt: RevisedProbabilities, claim: Claim, halves: Array) -> bool:
    ledger, posterior = doubt.search.ledger, doubt.model.posterior
    signature, columns = ledger.signatures[claim.signature], ledger.columns(claim.signature)
    seen = periods_seen(np.array(_cycles(signature)), _range_of(fit, signature), "cycles_per_m" in signature.fixed)
    waves = columns.reshape(-1, 2)
    # the best of all periods in pure noise, and two values that so many poses tell [Schwarz1978]
    least = 3 * np.log(TRIED_A_WAVE) + np.log(len(np.unique(group_poses(fit.problem.campaign))))
    own = [
        wave for wave, periods in zip(waves, seen, strict=True)
        if periods >= 1.0 and posterior.loss_without(wave) >= least and repeats(halves, wave)
    ]  # fmt: skip
    if not own:
        return False
    return posterior.loss_without(np.concatenate(own)) >= MOST_OF_IT * posterior.loss_without(columns)


def repeats(halves: Array, columns: NDArray[np.int_]) -> bool:
    """Tell whether halves of a campaign give a wave the same size and phase.

    Args:
        halves: Values that halves lead to, those of a pair in a row. Shape (2 pairs, p).
        columns: Columns of the wave: sine and cosine.
    """
    first, second = halves[0::2][:, columns], halves[1::2][:, columns]
    product = np.einsum("ij,ij->i", first, second)
    larger = np.maximum(np.sum(first**2, axis=1), np.sum(second**2, axis=1))
    # |a - b|^2 < |a|^2: with less a half predicts the other worse than no wave
    return bool(np.mean(2.0 * product >= larger) >= MOST_OF_IT)
