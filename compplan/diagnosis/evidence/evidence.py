"""Evidence: probability of a campaign given a set of effects, a background of small errors, and noise.

With whitened columns Phi of prior variance D and observations y,

    y ~ N(0, V),   V = N + Phi D Phi^T,   log p(y) = -1/2 (log det V + y^T V^-1 y) + const

N is the noise of each channel (variance v in units of its estimate) plus an error common to the rows of a stay
(lambda^2 v), which covers unmodelled errors [Bishop2006, ch. 3; Rasmussen2006, ch. 2]. D is small for the background,
where tau scales a class of errors, and large for claimed effects. Noise and background are fitted to the campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize
from scipy.special import log_ndtr

from compplan.diagnosis.evidence.likelihood import Hyper, SolvedColumns, gather_products, list_products
from compplan.diagnosis.evidence.normal_equations import ChannelProducts, NormalEquations
from compplan.robot import Array


@dataclass(frozen=True)
class EvidenceSettings:
    """Settings of the evidence."""

    #: Log range of fitted background, shared error and unmodelled error, and lower limit of noise over its estimate
    #: (assumed: far beyond the values of any campaign).
    log_range: tuple[float, ...] = (-4.0, 5.0)
    #: Logarithm of the largest background (assumed: a larger one is that of a robot never adjusted).
    most_tau: float = 3.0
    #: Scale of the half-Cauchy prior of a class's background (assumed).
    tau_scale: float = 0.7
    #: Spread of log tau among the classes of one robot, which resemble each other in size (assumed).
    tau_spread: float = 0.6
    #: Convergence: least gain in log evidence of a step (assumed: far below decisive differences).
    tolerance: float = 0.005
    #: Initial logarithm of the shared error and of the backgrounds (assumed: a fifth of their scale).
    start: float = -1.5
    #: Typical error of the logarithm of a shared error or a background: the unit of a fit's steps (assumed).
    likely: float = 0.3
    #: Most steps of a fit of noise and background from their start (assumed).
    first_steps: int = 40
    #: Variance of columns without a prior, in units of their scale (assumed: as good as free).
    free_variance: float = 1000000.0


EVIDENCE = EvidenceSettings()


@dataclass(frozen=True, eq=False)
class Prior:
    """Active columns and their prior variances."""

    background: NDArray[np.int_]  #: Class of each column's background, -1 for none. Shape (p,).
    spread: Array  #: Background standard deviation of each column at tau = 1, in units of its scale. Shape (p,).
    free: NDArray[np.bool_]  #: Columns without a prior in every model (registration). Shape (p,).
    slab: Array  #: Variance of claimed columns, 0 where nothing is claimed. Shape (p,).
    #: Classes of unmodelled errors: independent of the others, any size, tau in noise floors, half-Cauchy. Shape
    #: (classes,), or (0,) for none.
    loose: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))

    def variance(self, log_tau: Array) -> Array:
        """Return the prior variance of every column. Shape (p,)."""
        tau2 = np.exp(2.0 * log_tau)
        small = np.where(self.background >= 0, tau2[np.maximum(self.background, 0)] * self.spread**2, 0.0)
        return np.asarray(small + self.slab + EVIDENCE.free_variance * self.free)

    def of(self, columns: NDArray[np.int_]) -> Prior:
        """Return the prior of given columns alone."""
        return Prior(self.background[columns], self.spread[columns], self.free[columns], self.slab[columns], self.loose)

    @cached_property
    def active(self) -> NDArray[np.int_]:
        """Columns that may differ from zero."""
        return np.flatnonzero((self.background >= 0) | self.free | (self.slab > 0))


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of a campaign under a prior."""

    log_evidence: float  #: Logarithm of the evidence, hyperpriors included.
    columns: NDArray[np.int_]  #: Active columns.
    mean: Array  #: Posterior means, in units of their scale. Shape (active,).
    hyper: Hyper  #: Noise and background.
    #: Computes the covariance on request: few models need it, and a search holds hundreds of posteriors.
    compute_covariance: Callable[[], Array]

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the columns. Shape (active, active)."""
        return self.compute_covariance()

    def loss_without(self, columns: NDArray[np.int_]) -> float:
        """Return the log likelihood lost by setting these columns to zero, the others refitted."""
        at = np.flatnonzero(np.isin(self.columns, columns))
        mean, block = self.mean[at], self.covariance[np.ix_(at, at)]
        return 0.5 * float(mean @ np.linalg.solve(block + 1e-12 * np.trace(block) * np.eye(len(at)), mean))

    def values(self, p: int) -> Array:
        """Return the values of all columns. Shape (p,)."""
        full = np.zeros(p)
        full[self.columns] = self.mean
        return full


def start_hyper(equations: NormalEquations, classes: int) -> Hyper:
    """Return the initial hyperparameters: estimated noise, small shared error and background."""
    c = len(equations.channels)
    return Hyper(np.zeros(c), np.full(c, EVIDENCE.start), np.full(classes, EVIDENCE.start))


def find_posterior(
    equations: NormalEquations,
    prior: Prior,
    hyper: Hyper,
    *,
    fit: bool = True,
    steps: int = EVIDENCE.first_steps,
) -> Posterior:
    """Compute evidence and posterior; noise and background are fitted to the campaign unless `fit` is False.

    `hyper` holds their initial values; `steps` limits the fit.
    """
    channels, loose, variance = equations.channels, _loose(prior, hyper), _Variance(prior)
    rows = gather_products(channels, prior.active)
    if not fit:
        return _conclude(prior, channels, rows.solve(variance.at(hyper.log_tau), hyper))
    bounds = (
        [(EVIDENCE.log_range[0], _most_noise(ch)) for ch in channels]
        + [EVIDENCE.log_range] * len(channels)
        + [EVIDENCE.log_range if is_loose else (EVIDENCE.log_range[0], EVIDENCE.most_tau) for is_loose in loose]
    )
    # evidence relative to its initial value, for its digits; steps in units of typical errors
    others = len(hyper.vector) - len(channels)
    unit = np.array([np.sqrt(2.0 / max(ch.total.count, 1)) for ch in channels] + [EVIDENCE.likely] * others)
    started: list[float] = []
    latest: dict[bytes, SolvedColumns] = {}

    def cost(vector: Array) -> tuple[float, Array]:
        here = hyper.with_vector(vector * unit)
        done = rows.solve(variance.at(here.log_tau), here)
        extra, slope = _hyperprior(channels, here, loose)
        of_noise, of_shared, of_columns = done.slopes()
        slope = slope + np.concatenate([of_noise, of_shared, variance.by_class(of_columns, here.log_tau)])
        latest.clear()
        latest[vector.tobytes()] = done
        started.append(done.value + extra)
        return started[0] - started[-1], -slope * unit

    gained = [0.0]

    def stop_converged(intermediate_result: OptimizeResult) -> None:
        # the optimizer's tolerance is a share of the total gain: after a large gain it stops far too early
        gained.append(-intermediate_result.fun)
        if gained[-1] - gained[-2] < EVIDENCE.tolerance:
            raise StopIteration

    limits = [(low / u, high / u) for (low, high), u in zip(bounds, unit, strict=True)]
    options = {"maxiter": steps, "ftol": 0.0}
    first = np.clip(hyper.vector / unit, *np.array(limits).T)
    found = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=limits, options=options, callback=stop_converged)
    hyper = hyper.with_vector(found.x * unit)
    done = latest.get(found.x.tobytes()) or rows.solve(variance.at(hyper.log_tau), hyper)
    return _conclude(prior, channels, done)


def drop_negative(
    equations: NormalEquations, prior: Prior, posterior: Posterior, bounded: NDArray[np.int_]
) -> tuple[Prior, Posterior]:
    """Set nonnegative columns with negative posterior means to zero until none is left; noise is held."""
    while True:
        wrong = bounded[posterior.values(equations.p)[bounded] < 0.0]
        if not len(wrong):
            return prior, posterior
        background, slab = prior.background.copy(), prior.slab.copy()
        background[wrong], slab[wrong] = -1, 0.0
        prior = replace(prior, background=background, slab=slab)
        posterior = find_posterior(equations, prior, posterior.hyper, fit=False)


def _conclude(prior: Prior, channels: Sequence[ChannelProducts], done: SolvedColumns) -> Posterior:
    hyper = done.hyper
    extra = _hyperprior(channels, hyper, _loose(prior, hyper))[0]

    def compute_covariance() -> Array:
        rows = gather_products(channels, prior.active)
        return rows.solve(_Variance(prior).at(hyper.log_tau), hyper).compute_covariance()

    return Posterior(done.value + extra, prior.active, done.mean, hyper, compute_covariance)


class _Variance:
    """Prior variance of the active columns as a function of the background."""

    def __init__(self, prior: Prior) -> None:
        active = prior.active
        self.background = prior.background[active]
        self.small = np.flatnonzero(self.background >= 0)
        self.label = self.background[self.small]
        self.spread2 = prior.spread[active[self.small]] ** 2
        self.large = prior.slab[active] + EVIDENCE.free_variance * prior.free[active]

    def at(self, log_tau: Array) -> Array:
        """Return the variances. Shape (a,)."""
        variance = self.large.copy()
        variance[self.small] += np.exp(2.0 * log_tau)[self.label] * self.spread2
        return variance

    def by_class(self, of_columns: Array, log_tau: Array) -> Array:
        """Return the derivatives by log tau of each class from those by the variance of each active column."""
        part = 2.0 * of_columns[self.small] * np.exp(2.0 * log_tau)[self.label] * self.spread2
        return np.asarray(np.bincount(self.label, part, len(log_tau)))


def _most_noise(channel: ChannelProducts) -> float:
    """Return the logarithm of the largest noise to try: all that was observed, and a factor e."""
    return float(np.log(max(channel.total.square / max(channel.total.count, 1), 1.0)) + 1.0)


def _loose(prior: Prior, hyper: Hyper) -> NDArray[np.bool_]:
    """Return which classes are loose (unmodelled errors). Shape (classes,)."""
    return prior.loose if len(prior.loose) else np.zeros(len(hyper.log_tau), bool)


def _hyperprior(
    channels: Sequence[ChannelProducts], hyper: Hyper, loose: NDArray[np.bool_]
) -> tuple[float, Array]:  # fmt: skip
    """Return log prior of noise and background, and its gradient.

    Noise has the chi-square likelihood with the degrees of freedom of its estimate. Shared errors and backgrounds are
    half-Cauchy, and the classes of one robot resemble each other (assumed: an error as large as the noise and a
    background as large as its class's scale are common).
    """
    degrees_of_freedom = np.array([ch.degrees_of_freedom for ch in channels])
    factor = np.exp(-hyper.log_noise)
    shared2, tau2 = np.exp(2 * hyper.log_shared), np.exp(2 * hyper.log_tau)
    value = -0.5 * np.sum(degrees_of_freedom * (hyper.log_noise + factor - 1.0)) - np.sum(np.log1p(shared2))
    scale2 = np.where(loose, 1.0, EVIDENCE.tau_scale**2)
    value -= np.sum(np.log1p(tau2 / scale2))
    alike = hyper.log_tau[~loose]
    apart = np.where(loose, 0.0, hyper.log_tau - np.sum(alike) / max(len(alike), 1))
    value -= 0.5 * np.sum(apart**2) / EVIDENCE.tau_spread**2
    gradient_tau = -2 * tau2 / (scale2 + tau2) - apart / EVIDENCE.tau_spread**2
    slope = -0.5 * degrees_of_freedom * (1.0 - factor)
    gradient = np.concatenate([slope, -2 * shared2 / (1 + shared2), gradient_tau])
    return float(value), gradient


#: Sizes of an effect in units of its prior scale; each is as probable as the others (assumed).
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 40.0)


@dataclass(frozen=True, eq=False)
class Gain:
    """Increase of the log evidence by claiming a signature, and the best of `SIZES`."""

    signature: int
    log_evidence: float
    size: float


def find_gains(equations: NormalEquations, posterior: Posterior, candidates: list[int]) -> list[Gain]:
    """Compute the gain of each candidate in log evidence, noise and background held."""
    gram, against = combine_normal_equations(equations, posterior.hyper)
    cross = gram.take(posterior.columns, axis=1)
    left = against - cross @ posterior.mean
    known = cross @ posterior.covariance
    by_size: dict[int, list[int]] = {}
    for n in candidates:
        by_size.setdefault(len(equations.columns(n)), []).append(n)
    gains: list[Gain] = []
    for size, numbers in by_size.items():
        columns = np.stack([equations.columns(n) for n in numbers])
        positive = np.array([size == 1 and equations.signatures[n].positive for n in numbers], bool)
        blocks = gram[columns[:, :, None], columns[:, None, :]] - known[columns] @ np.swapaxes(cross[columns], 1, 2)
        sure, best = _rate_blocks(blocks, left[columns], positive)
        gains += [Gain(n, g, b) for n, g, b in zip(numbers, sure.tolist(), best.tolist(), strict=True)]
    return gains


@lru_cache(maxsize=1)
def combine_normal_equations(equations: NormalEquations, hyper: Hyper) -> tuple[Array, Array]:
    """Return the products of all columns with columns and with observations, over the noise of all channels.

    Shapes (p, p), (p,). Cached, since a search repeats this at the same noise.
    """
    weights, products = list_products(equations.channels)
    weight = weights.weigh(hyper.log_noise, hyper.log_shared)
    gram = weight[0] * products[0].gram
    for factor, part in zip(weight[1:], products[1:], strict=True):
        gram += factor * part.gram
    return gram, np.sum([factor * part.against for factor, part in zip(weight, products, strict=True)], axis=0)


def _rate_blocks(blocks: Array, left: Array, positive: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return gain and best size of signatures of k columns each; `positive`: of one nonnegative column.

    Shapes (m, k, k), (m, k), (m,) -> (m,), (m,).
    """
    values, vectors = np.linalg.eigh(0.5 * (blocks + np.swapaxes(blocks, 1, 2)))
    squares = np.einsum("mki,mk->mi", vectors, left) ** 2
    size2 = (np.array(SIZES) ** 2)[:, None, None]
    grown = 1 + size2 * np.maximum(values, 0.0)
    log_gain = 0.5 * np.sum(size2 * squares / grown - np.log(grown), axis=2)
    half = np.log(2) + log_ndtr(np.sqrt(size2 / grown)[..., 0] * left[:, 0])
    log_gain = log_gain + np.where(positive, half, 0.0)
    best = np.argmax(log_gain, axis=0)
    top = np.take_along_axis(log_gain, best[None], axis=0)[0]
    return top + np.log(np.mean(np.exp(log_gain - top), axis=0)), np.array(SIZES)[best]
