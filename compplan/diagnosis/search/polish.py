"""Exact steps of a fit: as far as the exact model gains by them, and the last ones once claims stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import Channel, build_channels, position_residual
from compplan.diagnosis.data.noise import OUTLYING, find_outliers
from compplan.diagnosis.evidence.candidates import (
    REGISTRATION,
    build_prior,
    in_background,
    key_of,
    log_priors,
    offered_signatures,
    propose_again,
    proposed_signatures,
)
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import build_normal_equations
from compplan.diagnosis.search.search import Claim, Search
from compplan.diagnosis.search.state import (
    SETTLED,
    Fit,
    FitState,
    advance_state,
    attain_state,
    known_approach,
    linearize_state,
    stands,
)
from compplan.errors import ConvergenceError
from compplan.measurement.frames import fit_registration
from compplan.robot import Array

#: The exact model has arrived when it leaves this little more than its linearization promises (assumed).
ARRIVED = 1.02


def polish_fit(fit: Fit) -> Fit:
    """Refit the parameters of a finished fit exactly, its claims, noise and background held."""
    vector = fit.model.posterior.values(fit.search.equations.p)
    left = fit.search.equations.left(vector)[0] * fit.search.equations.source[0].sigma
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
    old = proposed_signatures(fit.search.equations.signatures)
    problem = fit.problem
    offered = offered_signatures(at, problem.register, problem.excluded)
    offered += propose_again(at, old, set(sizes))
    kept = [s for s in offered if key_of(s) in sizes or s.name == REGISTRATION or in_background(s)]
    equations = build_normal_equations(channels, kept, state.values)
    free = [n for n, s in enumerate(kept) if s.name == REGISTRATION]
    hyper = fit.model.posterior.hyper
    search = Search(equations, build_prior(equations, free, fit.problem.excluded), log_priors(kept), [], hyper)
    claims = [Claim(n, sizes[key_of(s)]) for n, s in enumerate(kept) if key_of(s) in sizes]
    model = search.model(claims, hyper, fit=False)
    return advance_state(replace(fit, at=at, channels=channels, search=search, model=model, state=state))


def descend(fit: Fit, full: FitState) -> tuple[FitState, float] | None:
    """Shorten a step until the exact model gains by it; returns the state and its exact score, or None.

    The score is the log posterior of the model with the squares that the exact model leaves in the place of those that
    its derivatives promise. A row that was left out counts as the least that is left out, so that scores of fits with
    other outliers can be compared.
    """
    equations, posterior = fit.search.equations, fit.model.posterior
    here = np.array([fit.state.values.get(name, 0.0) for name in equations.names]) / equations.scale
    variance = fit.search.prior_of(fit.model.claims).variance(posterior.hyper.log_tau)
    weight = 1.0 / np.maximum(variance[posterior.columns], 1e-12)
    target = posterior.values(equations.p)

    def cost(channels: Sequence[Channel], vector: Array) -> float:
        left = [channel.residual / channel.sigma for channel in channels]
        own = vector[posterior.columns]
        return square_left(channels, left, posterior.hyper) + float(np.sum(weight * own**2))

    start = cost(fit.channels, here)
    promised = square_left(fit.channels, equations.left(target), posterior.hyper)
    promised += float(np.sum(weight * target[posterior.columns] ** 2))
    tried: list[tuple[float, FitState]] = []
    share = 1.0
    while share > SETTLED and not (tried and tried[-1][0] < start):
        state = full if share == 1.0 else advance_state(fit, share)
        channels = observe_state(fit, state)
        if channels is not None:
            tried.append((cost(channels, here + share * (target - here)), state))
        share *= 0.5
    if not tried:
        return None
    least, state = min(tried, key=lambda t: t[0])
    left_out = known_approach(fit.problem.campaign, fit.state) & ~fit.state.use
    return state, fit.model.score - 0.5 * (least - promised + OUTLYING**2 * float(left_out.sum()))


def square_left(channels: Sequence[Channel], left: Sequence[Array], hyper: Hyper) -> float:
    """Return the squares that are left in units of the fitted noise, errors that stays share included.

    Args:
        channels: The channels of observations.
        left: What is left in each, in units of its estimated noise. Shape (r, c) each.
        hyper: Noise and background.
    """
    total = 0.0
    for channel, rest, noise, shared in zip(channels, left, hyper.log_noise, hyper.log_shared, strict=True):
        # a gross error steers nothing
        rest = rest * np.minimum(1.0, OUTLYING / np.maximum(np.abs(rest) * np.exp(-0.5 * noise), 1e-12))
        first = np.flatnonzero(np.r_[True, np.diff(channel.group) > 0])
        sizes = np.diff(np.r_[first, len(channel.group)])
        mean2 = np.sum(np.add.reduceat(rest, first, axis=0) ** 2, axis=1) / sizes
        ratio = sizes * np.exp(2 * shared)
        total += float(np.exp(-noise) * (np.sum(rest**2) - np.sum(ratio / (1 + ratio) * mean2)))
    return total


def observe_state(fit: Fit, state: FitState) -> tuple[Channel, ...] | None:
    """Compare the campaign with the exact model of a state, or None where that finds no equilibrium."""
    try:
        scene, attained = attain_state(fit.problem, state)
    except ConvergenceError:
        return None
    if not np.isfinite(attained.position).all():
        return None
    return build_channels(scene, attained, fit.state.use, fit.noises)
