"""Sparse Bayesian calibration: all errors of a robot in one linear model, with a prior variance for each column.

With the means y of the stays, in units of their noise, and the columns Phi of zeros, lengths, compliances, bending,
reversal, gear waves and claims,

    y = Phi x + e,    x_j ~ N(0, d_j),    e of Student's t, variance v of each channel

d and v are those of largest marginal likelihood [MacKay1992; Tipping2001]: with the posterior m, S of x,

    g_j = 1 - S_jj / d_j,    d_j = m_j^2 / g_j,    v = sum w r^2 / (N - sum g),    w = (nu + 1) / (nu + r^2 / v)

A column without support in the campaign ends at d = 0. One stay is one observation, however many rows it has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.evidence.evidence import EVIDENCE, Posterior
from compplan.diagnosis.evidence.likelihood import factorize, invert_factor, mirror_lower, solve_factor
from compplan.diagnosis.evidence.normal_equations import NormalEquations, extend_normal_equations, turn_along
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.effects.transmission_error import periods_seen, waves_at
from compplan.robot import Array


@dataclass(frozen=True)
class SparseSettings:
    """Numbers of the sparse calibration."""

    #: Gear waves that are offered: harmonics of a turn, and the part of a period that has to be seen (assumed: teeth,
    #: wave generator and bearings of real gears err in fewer).
    waves: int = 30
    seen: float = 0.5
    #: Degrees of freedom of the errors' distribution (assumed: usual for robust regression [Lange1989]).
    student: float = 5.0
    #: Largest prior deviation of a column, in units of its signature's scale (assumed: zeros to 4 mrad, lengths to 4
    #: mm).
    largest: float = 4.0
    #: Changes of the robust weights, and of the variances with each of them (assumed: most columns settle in fewer).
    reweighted: int = 15
    steps: int = 4
    #: Share of the observations that counts as noise at first (assumed: far too much, so that no column fits chance).
    first_noise: float = 0.1
    #: A column that moves no observation by more than this share of its noise is left out (assumed).
    gone: float = 1e-3


SPARSE = SparseSettings()


@dataclass(frozen=True, eq=False)
class StayMeans:
    """Means of stays; N values, k columns.

    Attributes:
        design: Columns. Shape (N, k).
        observed: Values, in units of the noise of one row. Shape (N,).
        channel: Channel of each. Shape (N,).
        row: A row of the campaign that belongs to each. Shape (N,).
        columns: Columns of the normal equations. Shape (k,).
        free: Columns without a prior. Shape (k,).
        positive: Columns that cannot be negative. Shape (k,).
        most: Largest prior variance. Shape (k,).
    """

    design: Array
    observed: Array
    channel: NDArray[np.int_]
    row: NDArray[np.int_]
    columns: NDArray[np.int_]
    free: NDArray[np.bool_]
    positive: NDArray[np.bool_]
    most: Array


@dataclass(frozen=True, eq=False)
class SparseModel:
    """A solution: columns that are left, prior variances d (k,), values (k,), covariance (k, k), noise v."""

    means: StayMeans
    variance: Array
    mean: Array
    covariance: Array
    noise: Array

    def values(self, p: int) -> Array:
        """Return the values of all columns. Shape (p,)."""
        full = np.zeros(p)
        full[self.means.columns] = self.mean
        return full


def add_gear_waves(fit: Fit) -> Fit:
    """Return a fit whose normal equations hold gear waves of every harmonic; its prior has none of them."""
    at, equations, prior = fit.at, fit.search.equations, fit.search.prior
    known, fresh = set(equations.names), []
    for index in np.flatnonzero(~at.robot.prismatic):
        visited = float(np.ptp(fit.problem.campaign.q[:, index]))
        seen = [
            cycles
            for cycles in range(1, SPARSE.waves + 1)
            if periods_seen(cycles, visited, slides=False) >= SPARSE.seen
        ]
        fresh += [waves_at(at, int(index), [float(cycles)]) for cycles in seen]
    fresh = [signature for signature in fresh if not known & set(signature.column_names)]
    equations = extend_normal_equations(equations, fresh)
    grown = (0, equations.p - len(prior.slab))
    background = np.pad(prior.background, grown, constant_values=-1)
    spread, free, slab = np.pad(prior.spread, grown), np.pad(prior.free, grown), np.pad(prior.slab, grown)
    prior = replace(prior, background=background, spread=spread, free=free, slab=slab)
    odds = np.pad(fit.search.log_prior, (0, len(fresh)), constant_values=-np.inf)
    return replace(fit, search=replace(fit.search, equations=equations, prior=prior, log_prior=odds, cache={}))


def average_stays(equations: NormalEquations, signatures: Sequence[int], claims: Sequence[Claim]) -> StayMeans:
    """Average the rows of each stay."""
    claimed = [claim.signature for claim in claims]
    columns = equations.join_columns([*signatures, *claimed])
    parts: list[tuple[Array, Array, Array, Array]] = []
    for number, (source, design, observed) in enumerate(
        zip(equations.source, equations.designs, equations.observed, strict=True)
    ):
        design, observed, told = turn_along(source, design[..., columns], observed)
        first = np.flatnonzero(np.r_[True, np.diff(source.group) > 0])
        size = np.diff(np.r_[first, len(source.group)]).astype(float)
        kept = np.logical_or.reduceat(told, first, axis=0)
        mean = np.add.reduceat(design, first, axis=0)[kept] / np.repeat(size, kept.sum(axis=1))[:, None]
        value = (np.add.reduceat(observed, first, axis=0) / size[:, None])[kept]
        parts.append((mean, value, np.full(len(value), number), np.repeat(source.rows[first], kept.sum(axis=1))))
    design, observed, channel, row = (np.concatenate(several) for several in zip(*parts, strict=True))
    positive, most = np.zeros(equations.p, bool), np.full(equations.p, SPARSE.largest**2)
    for number in (*signatures, *claimed):
        positive[equations.columns(number)] |= equations.signatures[number].positive
    for claim in claims:
        own = equations.columns(claim.signature)
        most[own] = np.maximum(most[own], claim.size**2)
    free = np.isin(columns, equations.columns_named("registration"))
    return StayMeans(design, observed, channel, row, columns, free, positive[columns], most[columns])


def solve_sparse(
    means: StayMeans, rows: NDArray[np.bool_] | None = None, start: SparseModel | None = None
) -> SparseModel:
    """Fit variances, noise and values to all or some of the means (N,), from a start with its columns alone."""
    if start is not None:
        means = start.means
    used = np.ones(len(means.observed), bool) if rows is None else rows
    y, channel = means.observed[used], means.channel[used]
    kinds = int(means.channel.max(initial=0)) + 1
    size2 = np.maximum(np.mean(means.design[used] ** 2, axis=0), 1e-12)
    alive = (size2 > SPARSE.gone**2) | means.free
    means, size2 = _take(means, alive), size2[alive]
    design = means.design[used]
    if start is None:
        variance = np.where(means.free, EVIDENCE.free_variance, np.minimum(1.0 / size2, means.most))
        noise = SPARSE.first_noise * np.array([np.mean(y[channel == k] ** 2) for k in range(kinds)])
    else:
        variance, noise = start.variance[alive], start.noise.copy()
    weight = np.ones(len(y))
    while True:
        for _ in range(SPARSE.reweighted):
            root = np.sqrt(weight / noise[channel])
            scaled, target = design * root[:, None], y * root
            few = len(y) < design.shape[1]
            gram, against = np.zeros((0, 0)) if few else scaled.T @ scaled, scaled.T @ target
            for _ in range(SPARSE.steps):
                mean, known = _solve(scaled, target, gram, against, variance)
                determined = np.clip(known, 1e-9, 1.0)
                fitted = np.minimum(mean**2 / determined, means.most)
                variance = np.where(means.free, EVIDENCE.free_variance, np.maximum(fitted, 1e-300))
                kept = (variance * size2 > SPARSE.gone**2 * noise.min()) | means.free
                if not kept.all():
                    means, size2, variance, design = _take(means, kept), size2[kept], variance[kept], design[:, kept]
                    scaled, mean, determined, against = scaled[:, kept], mean[kept], determined[kept], against[kept]
                    gram = gram[np.ix_(kept, kept)] if len(gram) else gram
            left = y - design @ mean
            for k in range(kinds):
                own = channel == k
                taken = determined.sum() * own.sum() / len(y)
                noise[k] = max(float(np.sum(weight[own] * left[own] ** 2)) / max(own.sum() - taken, 1.0), 1e-9)
            weight = (SPARSE.student + 1.0) / (SPARSE.student + left**2 / noise[channel])
        root = np.sqrt(weight / noise[channel])
        scaled = design * root[:, None]
        deviation = np.sqrt(variance)
        inner = (scaled * deviation).T @ (scaled * deviation) + np.eye(len(deviation))
        covariance = mirror_lower(invert_factor(factorize(inner))) * np.outer(deviation, deviation)
        mean = covariance @ (scaled.T @ (y * root))
        wrong = means.positive & (mean < 0.0)
        if not wrong.any():
            return SparseModel(means, variance, mean, covariance, noise)
        means, size2, variance, design = _take(means, ~wrong), size2[~wrong], variance[~wrong], design[:, ~wrong]


def _take(means: StayMeans, kept: NDArray[np.bool_]) -> StayMeans:
    return means if kept.all() else replace(
        means, design=means.design[:, kept], columns=means.columns[kept], free=means.free[kept],
        positive=means.positive[kept], most=means.most[kept],
    )  # fmt: skip


def _solve(design: Array, target: Array, gram: Array, against: Array, variance: Array) -> tuple[Array, Array]:
    """Return values and 1 - S_jj / d_j of each column; solved among the values where there is no gram. Shapes (k,)."""
    deviation = np.sqrt(variance)
    if len(gram):
        lower = factorize(gram * np.outer(deviation, deviation) + np.eye(len(variance)))
        inverse = invert_factor(lower)
        return deviation * solve_factor(lower, deviation * against), 1.0 - np.diag(inverse)
    scaled = design * deviation
    lower = factorize(scaled @ scaled.T + np.eye(len(target)))
    mean = deviation * (scaled.T @ solve_factor(lower, target))
    return mean, np.asarray(np.sum(scaled * solve_factor(lower, scaled), axis=0))


def posterior_of(fit: Fit, model: SparseModel) -> Posterior:
    """Return a solution as a posterior: what a stay's mean errs by beyond the noise of its rows is shared by them."""
    hyper = fit.model.posterior.hyper
    several = [np.mean(1.0 / np.unique(source.group, return_counts=True)[1]) for source in fit.search.equations.source]
    beyond = model.noise / np.exp(hyper.log_noise) - np.array(several)
    hyper = replace(hyper, log_shared=0.5 * np.log(np.maximum(beyond, 1e-6)))
    return Posterior(0.0, model.means.columns, model.mean, hyper, lambda: model.covariance)
