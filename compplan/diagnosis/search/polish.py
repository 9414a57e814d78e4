"""Polish: the last exact steps of a fit whose claims stand, until the exact model keeps what derivatives promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import build_channels, position_residual
from compplan.diagnosis.data.outliers import find_outliers
from compplan.diagnosis.evidence.background import build_prior, in_background, log_priors
from compplan.diagnosis.evidence.candidates import (
    REGISTRATION,
    key_of,
    offered_signatures,
    propose_again,
    proposed_signatures,
)
from compplan.diagnosis.evidence.normal_equations import build_normal_equations
from compplan.diagnosis.search.search import Claim, Search
from compplan.diagnosis.search.state import (
    Fit,
    FitState,
    advance_state,
    attain_state,
    known_approach,
    linearize_state,
    stands,
)
from compplan.measurement.fit_frames import fit_registration

#: The exact model has arrived when it leaves this little more than its linearization promises (assumed).
ARRIVED = 1.02


def polish_fit(fit: Fit) -> Fit:
    """Refit the parameters of a finished fit exactly, its claims, noise and background held.

    Args:
        fit: The fit.
    """
    vector = fit.model.posterior.values(fit.search.ledger.p)
    left = fit.search.ledger.left(vector)[0] * fit.search.ledger.source[0].sigma
    expected = float(np.sqrt(np.mean(np.sum(left**2, axis=1))))
    use = fit.state.use.copy() if fit.base is None else fit.base.use.copy()
    state = register_again(fit, fit.state, use)
    best, least = state, exact_rms(fit, state, use)
    while least >= ARRIVED * expected:
        state = _step(fit, best, use)
        if not stands(fit.problem, state):
            break
        state = register_again(fit, state, use)
        exact = exact_rms(fit, state, use)
        if exact >= least:
            break
        best, least = state, exact
    campaign = fit.problem.campaign
    residual = position_residual(campaign, *attain_state(fit.problem, best))
    outliers = find_outliers(campaign, residual, best.scatter, known_approach(campaign, best))
    return replace(fit, state=best, exact=least, outliers=outliers)


def register_again(fit: Fit, state: FitState, use: NDArray[np.bool_]) -> FitState:
    """Fit the frames of a campaign to a state's exact model, where they are fitted at all and where that is closer."""
    problem = fit.problem
    if not problem.register:
        return state
    attained = attain_state(problem, replace(state, registration=None))[1]
    frames = fit_registration(problem.campaign, attained.position, attained.rotation, problem.register, rows=use)
    registered = replace(state, registration=frames)
    return registered if exact_rms(fit, registered, use) < exact_rms(fit, state, use) else state


def exact_rms(fit: Fit, state: FitState, use: NDArray[np.bool_]) -> float:
    """Return the root mean square distance that the exact model leaves on some rows. [m]"""
    campaign = fit.problem.campaign
    residual = position_residual(campaign, *attain_state(fit.problem, state))[use & campaign.usable]
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def _step(fit: Fit, state: FitState, use: NDArray[np.bool_]) -> FitState:
    """Linearize at a state and take the posterior mean of the claimed and background columns."""
    at = linearize_state(fit.problem, state)
    channels = build_channels(at.scene, at.attained, use, fit.noises)
    sizes = dict(state.claims)
    old = proposed_signatures(fit.search.ledger.signatures)
    problem = fit.problem
    offered = offered_signatures(at, problem.register, problem.excluded)
    offered += propose_again(at, old, set(sizes))
    kept = [s for s in offered if key_of(s) in sizes or s.name == REGISTRATION or in_background(s)]
    ledger = build_normal_equations(channels, kept, state.values)
    free = [n for n, s in enumerate(kept) if s.name == REGISTRATION]
    hyper = fit.model.posterior.hyper
    search = Search(ledger, build_prior(ledger, free, fit.problem.excluded), log_priors(kept), [], hyper)
    claims = [Claim(n, sizes[key_of(s)]) for n, s in enumerate(kept) if key_of(s) in sizes]
    model = search.model(claims, hyper, fit=False)
    return advance_state(replace(fit, at=at, channels=channels, search=search, model=model, state=state))
