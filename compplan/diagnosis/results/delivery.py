"""Delivery: the robot folder of a diagnosis, validated on held-out poses.

The folder holds the posterior of named effects, of shifts of the tool with or without a name, and of small errors
(`validation.calibration`). If this predicts held-out poses no better than the nominal robot by more than chance, the
nominal robot is written.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import position_residual
from compplan.diagnosis.data.shared import NEGLIGIBLE
from compplan.diagnosis.evidence.evidence import Posterior
from compplan.diagnosis.results.posterior import state_nominal_uncertainty, state_uncertainty
from compplan.diagnosis.results.verdict import Verdict
from compplan.diagnosis.search.fit import register_again
from compplan.diagnosis.search.search import SHIFTS, Claim
from compplan.diagnosis.search.state import Fit, FitState, Problem, attain_state, has_equilibrium
from compplan.diagnosis.validation.calibration import calibrate, calibrated_state, hold_out_calibration
from compplan.diagnosis.validation.held_out import Folds, HeldOut
from compplan.effects import fold_effects, is_of_instrument
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty

NOMINAL, CALIBRATED = "nominal", "calibrated"


@dataclass(frozen=True, eq=False)
class Delivery:
    """The delivered robot folder with its validation."""

    kind: str  #: "nominal" or "calibrated".
    state: FitState  #: Effects, frames and rows of its exact model.
    held: HeldOut  #: Residuals of held-out rows.
    residual: Array  #: Measured minus expected by its exact model, base axes, all rows. Shape (n, 3). [m]
    uncertainty: Uncertainty  #: Parameter uncertainty of the robot.
    posterior: Posterior  #: The posterior of the calibration, which is not part of the nominal robot.

    def robot(self, nominal: Robot, known: int) -> Robot:
        """Return the delivered robot: the nominal robot with the effects after the first `known` ones."""
        folded = fold_effects(nominal, self.state.effects[known:])
        return replace(folded, uncertainty=self.uncertainty)


def deliver_robot(
    folds: Folds, verdict: Verdict, plain: HeldOut, nominal: FitState, good: NDArray[np.bool_]
) -> Delivery:  # fmt: skip
    """Build the calibrated robot; return the nominal one unless the calibrated one predicts clearly better.

    `plain`: held-out residuals of the nominal robot; `nominal`: its state; `good`: rows without outliers, shape (n,).
    """
    fit, problem, claims = folds.fit, folds.fit.problem, deliverable_claims(folds.fit, verdict)
    seen, fold = good[plain.rows], folds.fold[plain.rows]
    before = plain.of(seen)
    found = calibrate(folds, claims)
    held = hold_out_calibration(folds, found)
    stated = held.correct_for_selection(fold, seen)
    # a delivered robot must have a stated error below the nominal one
    better = held.of(seen).rms < (1.0 - NEGLIGIBLE) * before.rms and stated.of(seen).rms < before.rms
    values = found.posterior.values(fit.search.equations.p)
    state = calibrated_state(fit, values, found.named) if better else nominal
    if not better or not has_equilibrium(problem, state):
        residual = _residual(problem, nominal)
        # a calibration that predicts as well as the nominal robot says that its parameters are nearly nominal
        if stated.of(seen).rms <= (1.0 + NEGLIGIBLE) * before.rms:
            known = state_uncertainty(folds, found, nominal, plain, good)
        else:
            known = state_nominal_uncertainty(folds, nominal, residual, good)
        return Delivery(NOMINAL, nominal, plain, residual, known, found.posterior)
    state = register_again(fit, state, fit.state.use)
    known = state_uncertainty(folds, found, state, held, good)
    return Delivery(CALIBRATED, state, stated, _residual(problem, state), known, found.posterior)


def deliverable_claims(fit: Fit, verdict: Verdict) -> list[Claim]:
    """List named effects, and feasible shifts of the tool with or without a name.

    Rows before and after a shift contradict each other, which no small error can represent.
    """
    claims = {f.signature: f.size for f in verdict.findings if f.signature >= 0}
    beyond = {f.signature for f in verdict.doubtful if f.beyond}
    others = [Claim(f.signature, f.size) for f in (*verdict.minor, *verdict.doubtful)]
    for claim in (*others, *fit.model.claims):
        name = fit.search.equations.signatures[claim.signature].name
        if name in SHIFTS and not is_of_instrument(name) and claim.signature not in beyond:
            claims.setdefault(claim.signature, claim.size)
    return [Claim(number, size) for number, size in claims.items()]


def _residual(problem: Problem, state: FitState) -> Array:
    return position_residual(problem.campaign, *attain_state(problem, state))
