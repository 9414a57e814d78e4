"""Descent: a step of a fit counts only as far as the exact model gains by it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compplan.diagnosis.data.channels import Channel, build_channels
from compplan.diagnosis.data.outliers import OUTLYING
from compplan.diagnosis.evidence.evidence import Hyper
from compplan.diagnosis.search.state import SETTLED, Fit, FitState, advance_state, attain_state, known_approach
from compplan.errors import ConvergenceError
from compplan.robot import Array


def descend(fit: Fit, full: FitState) -> tuple[FitState, float] | None:
    """Shorten a step until the exact model gains by it; returns the state and its exact score, or None.

    The score is the log posterior of the model with the squares that the exact model leaves in the place of those that
    its derivatives promise. A row that was left out counts as the least that is left out, so that scores of fits with
    other outliers can be compared.

    Args:
        fit: The fit that the step starts from.
        full: The whole step.
    """
    ledger, posterior = fit.search.ledger, fit.model.posterior
    here = np.array([fit.state.values.get(name, 0.0) for name in ledger.names]) / ledger.scale
    variance = fit.search.prior_of(fit.model.claims).variance(posterior.hyper.log_tau)
    weight = 1.0 / np.maximum(variance[posterior.columns], 1e-12)
    target = posterior.values(ledger.p)

    def cost(channels: Sequence[Channel], vector: Array) -> float:
        left = [channel.residual / channel.sigma for channel in channels]
        own = vector[posterior.columns]
        return square_left(channels, left, posterior.hyper) + float(np.sum(weight * own**2))

    start = cost(fit.channels, here)
    promised = square_left(fit.channels, ledger.left(target), posterior.hyper)
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
