"""Evidence: how probable a campaign is under a set of effects, a background of small errors, and noise.

With whitened columns Phi of prior variance D and observations y,

    y ~ N(0, V),   V = N + Phi D Phi^T,   log p(y) = -1/2 (log det V + y^T V^-1 y) + const

N is the noise of each channel (variance v in units of its estimate) plus an error that the rows of a stay share
(lambda^2 v), which stands for whatever no signature explains [Bishop2006, ch. 3; Rasmussen2006, ch. 2]. D is small for
the background, where tau scales a whole class of errors, and large for claimed effects. Noise and background are fitted
to the campaign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize

from compplan.diagnose.few_rows import FewRows, SolvedRows, gather_rows, row_posterior, row_slopes, solve_rows
from compplan.diagnose.ledger import ChannelProducts, Ledger, Products
from compplan.errors import ConvergenceError
from compplan.robot import Array

#: Logarithms of the smallest and largest background, shared error and error without a name that are fitted (assumed:
#: far beyond what any campaign has shown).
TAU_RANGE, SHARED_RANGE, LOOSE_RANGE = (-4.0, 3.0), (-3.5, 4.0), (-4.0, 5.0)
#: Scale of the half-Cauchy prior of a class's background (assumed).
TAU_SCALE = 0.7
#: Classes of one robot are alike: a robot that is slightly wrong is so everywhere. Spread of log tau among them
#: (assumed).
TAU_SPREAD = 0.6
#: Logarithms of the noise variance over its estimate: the least that is looked at, and the most, all that was observed
#: and a factor e within these (assumed).
LEAST_NOISE, MOST_NOISE = -6.0, (1.0, 12.0)
#: Log evidence has settled when a step changes it by less than this share (assumed: far below what decides).
SETTLED = 5e-3
#: Logarithm of the shared error and of the backgrounds that a fit begins with (assumed: a fifth of their scale).
START = -1.5
#: Likely error of the logarithm of a shared error or a background: the unit of a fit's steps (assumed).
LIKELY = 0.3
#: Steps of a fit of noise and background at most (assumed: most settle in ten).
MOST_STEPS = 25
#: Variance of columns that every model fits freely, in units of their scale (assumed: as good as free).
FREE_VARIANCE = 1e6
#: What is added to a matrix that rounding made indefinite, over its trace; how often, and by which factor more
#: (assumed).
JITTER, MOST_JITTERS, MORE_JITTER = 1e-13, 8, 100.0


@dataclass(frozen=True, eq=False)
class Hyper:
    """Noise and background.

    Attributes:
        log_noise: Logarithm of each channel's noise variance over its estimate. Shape (channels,).
        log_shared: Logarithm of the shared error over the noise, standard deviations. Shape (channels,).
        log_tau: Logarithm of the size of each background class over its scale. Shape (classes,).
    """

    log_noise: Array
    log_shared: Array
    log_tau: Array

    @property
    def vector(self) -> Array:
        """All of it, side by side."""
        return np.concatenate([self.log_noise, self.log_shared, self.log_tau])

    def with_vector(self, vector: Array) -> Hyper:
        """Return the hyperparameters that a vector holds."""
        c = len(self.log_noise)
        return Hyper(vector[:c].copy(), vector[c : 2 * c].copy(), vector[2 * c :].copy())


@dataclass(frozen=True, eq=False)
class Prior:
    """Which columns are active, and how large they may be.

    Attributes:
        background: Class of each column's background, -1 for none. Shape (p,).
        spread: Background standard deviation of each column at tau = 1, in units of its scale. Shape (p,).
        free: Columns that every model fits freely (registration). Shape (p,).
        slab: Variance of claimed columns, 0 where nothing is claimed. Shape (p,).
        loose: Classes that no other class resembles and that may be of any size: what an unknown cause follows. Their
            tau is in noise floors, half-Cauchy. Shape (classes,), or (0,) for none.
    """

    background: NDArray[np.int_]
    spread: Array
    free: NDArray[np.bool_]
    slab: Array
    loose: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def variance(self, log_tau: Array) -> Array:
        """Return the prior variance of every column. Shape (p,)."""
        tau2 = np.exp(2.0 * log_tau)
        small = np.where(self.background >= 0, tau2[np.maximum(self.background, 0)] * self.spread**2, 0.0)
        return np.asarray(small + self.slab + FREE_VARIANCE * self.free)

    @cached_property
    def active(self) -> NDArray[np.int_]:
        """Columns that may differ from zero."""
        return np.flatnonzero((self.background >= 0) | self.free | (self.slab > 0))


@dataclass(frozen=True, eq=False)
class Posterior:
    """What the campaign says under a prior.

    Attributes:
        log_evidence: Logarithm of the evidence, hyperpriors included.
        columns: Active columns.
        mean: Their values, in units of their scale. Shape (active,).
        covariance: Their covariance. Shape (active, active).
        hyper: Noise and background.
    """

    log_evidence: float
    columns: NDArray[np.int_]
    mean: Array
    covariance: Array
    hyper: Hyper

    def loss_without(self, columns: NDArray[np.int_]) -> float:
        """Return the log likelihood that is lost where these columns are set to zero, the rest refitted."""
        at = np.flatnonzero(np.isin(self.columns, columns))
        mean, block = self.mean[at], self.covariance[np.ix_(at, at)]
        return 0.5 * float(mean @ np.linalg.solve(block + 1e-12 * np.trace(block) * np.eye(len(at)), mean))

    def values(self, p: int) -> Array:
        """Return the values of all columns. Shape (p,)."""
        full = np.zeros(p)
        full[self.columns] = self.mean
        return full


def excess_square(channels: Sequence[ChannelProducts], posterior: Posterior, columns: NDArray[np.int_]) -> float:
    """Return the squares that some columns leave beyond the noise.

    Args:
        channels: The products.
        posterior: Values of the columns.
        columns: Active columns that count as explanation.
    """
    mean = np.where(np.isin(posterior.columns, columns), posterior.mean, 0.0)
    total = 0.0
    for channel in channels:
        part = channel.total.take(posterior.columns)
        left = part.square - 2 * mean @ part.against + mean @ part.gram @ mean
        total += float(left) - part.count
    return total


def start_hyper(ledger: Ledger, classes: int) -> Hyper:
    """Start with the estimated noise, little shared error and little background."""
    c = len(ledger.channels)
    return Hyper(np.zeros(c), np.full(c, START), np.full(classes, START))


def find_posterior(
    ledger: Ledger, prior: Prior, hyper: Hyper, *, fit: bool = True, steps: int = MOST_STEPS, shared: bool = True
) -> Posterior:
    """Compute evidence and posterior, noise and background fitted to the campaign unless told otherwise.

    Args:
        ledger: The products.
        prior: The prior.
        hyper: Noise and background to begin with.
        fit: Whether to fit them.
        steps: Most steps of the fit.
        shared: Whether rows of a stay may share an error.
    """
    solver, channels = _choose_solver(ledger, prior), ledger.channels
    if not fit:
        return solver.conclude(solver.solve(hyper), hyper)
    bounds = (
        [(LEAST_NOISE, _most_noise(ch)) for ch in channels]
        + [SHARED_RANGE if shared else (SHARED_RANGE[0], SHARED_RANGE[0])] * len(channels)
        + [LOOSE_RANGE if loose else TAU_RANGE for loose in _loose(prior, hyper)]
    )
    # the optimizer's tolerance is relative: evidence counts from where it starts; steps in units of likely errors
    others = len(hyper.vector) - len(channels)
    unit = np.array([np.sqrt(2.0 / ch.total.count) for ch in channels] + [LIKELY] * others)
    started: list[float] = []
    latest: dict[bytes, Any] = {}

    def cost(vector: Array) -> tuple[float, Array]:
        here = hyper.with_vector(vector * unit)
        value, slope, done = solver.value_and_slope(here)
        latest.clear()
        latest[vector.tobytes()] = done
        started.append(value)
        return started[0] - value, -slope * unit

    limits = [(low / u, high / u) for (low, high), u in zip(bounds, unit, strict=True)]
    options = {"maxiter": steps, "ftol": SETTLED}
    first = np.clip(hyper.vector / unit, *np.array(limits).T)
    found = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=limits, options=options)
    hyper = hyper.with_vector(found.x * unit)
    return solver.conclude(latest.get(found.x.tobytes()) or solver.solve(hyper), hyper)


class _Solver(Protocol):
    """What solves the evidence; `done` is what its own `solve` returns."""
    def solve(self, hyper: Hyper) -> Any: ...
    def value_and_slope(self, hyper: Hyper) -> tuple[float, Array, Any]: ...
    def conclude(self, done: Any, hyper: Hyper) -> Posterior: ...


@dataclass(frozen=True, eq=False)
class _Columns:
    """Evidence solved among the active columns."""

    prior: Prior
    channels: list[ChannelProducts]

    def solve(self, hyper: Hyper) -> _Solved:
        return _solve(self.channels, self.prior, hyper)

    def value_and_slope(self, hyper: Hyper) -> tuple[float, Array, _Solved]:
        done = self.solve(hyper)
        return done.value, _slope(self.channels, self.prior, hyper, done), done

    def conclude(self, done: _Solved, hyper: Hyper) -> Posterior:
        return Posterior(done.value, self.prior.active, done.mean, done.covariance, hyper)


@dataclass(frozen=True, eq=False)
class _Few:
    """Evidence solved among the values, which are fewer than the columns."""

    prior: Prior
    ledger: Ledger
    rows: FewRows

    def solve(self, hyper: Hyper) -> SolvedRows:
        variance = self.prior.variance(hyper.log_tau)[self.prior.active]
        return solve_rows(self.rows, variance, hyper.log_noise, hyper.log_shared)

    def value_and_slope(self, hyper: Hyper) -> tuple[float, Array, SolvedRows]:
        done, channels = self.solve(hyper), self.ledger.channels
        of_noise, of_shared, of_columns = row_slopes(self.rows, done, len(channels))
        extra, hyper_slope = _hyperprior(channels, hyper, _loose(self.prior, hyper))
        slope = np.concatenate([of_noise, of_shared, _class_slopes(self.prior, hyper, of_columns)])
        return done.value + extra, slope + hyper_slope, done

    def conclude(self, done: SolvedRows, hyper: Hyper) -> Posterior:
        mean, covariance = row_posterior(self.rows, done)
        extra = _hyperprior(self.ledger.channels, hyper, _loose(self.prior, hyper))[0]
        return Posterior(done.value + extra, self.prior.active, mean, covariance, hyper)


def _choose_solver(ledger: Ledger, prior: Prior) -> _Solver:
    """Choose the smaller matrix: that of the values or that of the active columns."""
    wide = (prior.free | (prior.slab > 0))[prior.active]
    few = gather_rows(ledger.channels, prior.active, wide)
    if few is None:
        return _Columns(prior, [channel.take(prior.active) for channel in ledger.channels])
    return _Few(prior, ledger, few)


def _most_noise(channel: ChannelProducts) -> float:
    """Return the logarithm of the largest noise worth trying: all that was observed, and some."""
    return float(np.clip(np.log(max(channel.total.square, 1e-300) / channel.total.count) + 1.0, *MOST_NOISE))


def _slope(channels: list[ChannelProducts], prior: Prior, hyper: Hyper, done: _Solved) -> Array:
    """Return the derivative of the log evidence with respect to noise and background."""
    active, mean, covariance = prior.active, done.mean, done.covariance
    gradient_noise, gradient_shared = [], []
    for channel, log_noise, log_shared in zip(channels, hyper.log_noise, hyper.log_shared, strict=True):
        noise, shared = np.exp(log_noise), np.exp(2 * log_shared)
        rest = _expected_square(channel.total, mean, covariance)
        by_size = {n: _expected_square(m, mean, covariance) for n, m in channel.means.items()}
        within = rest - sum(n * shared / (1 + n * shared) * by_size[n] for n in by_size)
        gradient_noise.append(0.5 * (within / noise - channel.total.count))
        slope = sum(
            n / (1 + n * shared) ** 2 * by_size[n] / noise - channel.means[n].count * n / (1 + n * shared)
            for n in by_size
        )
        gradient_shared.append(0.5 * slope * 2 * shared)
    residual = done.against - done.gram @ mean
    # G - G S G = 1/D - S/D^2 on the diagonal, where S = (1/D + G)^-1
    own = np.maximum(prior.variance(hyper.log_tau)[active], 1e-300)
    slope_d = 0.5 * (residual**2 - (1.0 - np.diag(covariance) / own) / own)
    gradient_tau = _class_slopes(prior, hyper, slope_d)
    _, hyper_gradient = _hyperprior(channels, hyper, _loose(prior, hyper))
    return np.concatenate([gradient_noise, gradient_shared, gradient_tau]) + hyper_gradient


def _class_slopes(prior: Prior, hyper: Hyper, of_columns: Array) -> Array:
    """Return the derivatives by log tau of each class from those by the variance of each active column."""
    classes = prior.background[prior.active]
    variance = np.where(
        classes >= 0, np.exp(2 * hyper.log_tau[np.maximum(classes, 0)]) * prior.spread[prior.active] ** 2, 0.0
    )
    return np.array([np.sum((of_columns * variance * 2)[classes == k]) for k in range(len(hyper.log_tau))])


def _expected_square(products: Products, mean: Array, covariance: Array) -> float:
    gram, against = products.gram, products.against
    fitted = products.square - 2 * mean @ against + mean @ gram @ mean
    return float(fitted + np.vdot(covariance, gram))


def combine_channels(channels: Sequence[ChannelProducts], hyper: Hyper) -> tuple[Array, Array, float, float]:
    """Return gram, products with the observations, their square, and log det of the noise."""
    p = len(channels[0].total.against)
    gram, against, square, log_det = np.zeros((p, p)), np.zeros(p), 0.0, 0.0
    for channel, log_noise, log_shared in zip(channels, hyper.log_noise, hyper.log_shared, strict=True):
        weight, shared = np.exp(-log_noise), np.exp(2 * log_shared)
        gram += weight * channel.total.gram
        against += weight * channel.total.against
        square += weight * channel.total.square
        log_det += channel.total.count * log_noise
        for n, means in channel.means.items():
            share = weight * n * shared / (1 + n * shared)
            gram -= share * means.gram
            against -= share * means.against
            square -= share * means.square
            log_det += means.count * np.log1p(n * shared)
    return gram, against, square, float(log_det)


@dataclass(frozen=True, eq=False)
class _Solved:
    """Log evidence, mean and covariance of the active columns, and their products in units of the fitted noise."""

    value: float
    mean: Array
    covariance: Array
    gram: Array
    against: Array


def _solve(channels: list[ChannelProducts], prior: Prior, hyper: Hyper) -> _Solved:
    """Solve for the active columns at one noise and background."""
    gram, against, square, log_det = combine_channels(channels, hyper)
    root = np.sqrt(prior.variance(hyper.log_tau)[prior.active])
    inner = root[:, None] * gram
    inner *= root
    inner[np.diag_indices_from(inner)] += 1.0
    factor = _factor(inner)
    covariance = inner
    if len(root):
        lower = dpotri(factor[0], lower=1)[0]
        covariance = np.where(np.tri(len(root), dtype=bool), lower, lower.T)
    covariance = root[:, None] * covariance
    covariance *= root
    mean = covariance @ against
    log_det += 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
    value = -0.5 * (log_det + square - float(against @ mean)) + _hyperprior(channels, hyper, _loose(prior, hyper))[0]
    return _Solved(value, mean, covariance, gram, against)


def _factor(inner: Array) -> tuple[Array, bool]:
    """Factorize a matrix that rounding may have made slightly indefinite."""
    jitter = 0.0
    for _ in range(MOST_JITTERS):
        try:
            return cho_factor(inner + jitter * np.eye(len(inner)), lower=True, check_finite=False)  # type: ignore[no-any-return]
        except LinAlgError:
            jitter = max(MORE_JITTER * jitter, JITTER * float(np.trace(inner)))
    raise ConvergenceError("the evidence of a model cannot be computed, its columns are degenerate", residual=jitter)


def _loose(prior: Prior, hyper: Hyper) -> NDArray[np.bool_]:
    """Tell which classes are loose. Shape (classes,)."""
    return prior.loose if len(prior.loose) else np.zeros(len(hyper.log_tau), bool)


def _hyperprior(
    channels: Sequence[ChannelProducts], hyper: Hyper, loose: NDArray[np.bool_]
) -> tuple[float, Array]:  # fmt: skip
    """Return log prior of noise and background, and its gradient.

    Noise has the chi-square likelihood of the degrees of freedom that its estimate rests on: what repeats do not show
    is no noise, but an error that stays share. Shared errors and backgrounds are half-Cauchy, and the classes of one
    robot resemble each other (assumed: an error as large as the noise, a background as large as its class's scale, is
    no surprise).
    """
    witnesses = np.array([ch.witnesses for ch in channels])
    factor = np.exp(-hyper.log_noise)
    shared2, tau2 = np.exp(2 * hyper.log_shared), np.exp(2 * hyper.log_tau)
    value = -0.5 * np.sum(witnesses * (hyper.log_noise + factor - 1.0)) - np.sum(np.log1p(shared2))
    value -= np.sum(np.log1p(tau2[~loose] / TAU_SCALE**2)) + np.sum(np.log1p(tau2[loose]))
    alike = hyper.log_tau[~loose]
    apart = np.where(loose, 0.0, hyper.log_tau - np.mean(alike)) if len(alike) else np.zeros(len(loose))
    value -= 0.5 * np.sum(apart**2) / TAU_SPREAD**2
    gradient_tau = np.where(loose, -2 * tau2 / (1 + tau2), -2 * tau2 / (TAU_SCALE**2 + tau2) - apart / TAU_SPREAD**2)
    slope = -0.5 * witnesses * (1.0 - factor)
    gradient = np.concatenate([slope, -2 * shared2 / (1 + shared2), gradient_tau])
    return float(value), gradient
