"""Calibration: the posterior of the delivered robot, all its errors in one linear model with a width for each column.

With the means y of the stays, in units of their noise, and the columns Phi of named effects, zeros, lengths,
compliances, bending, reversal and gear waves,

    y = Phi x + e,    x_j ~ N(0, d_j),    e of Student's t, variance v of each channel

A small error has 1 / d_j ~ Gamma(nu / 2, nu (t u_j)^2 / 2), which makes x_j Student's t of nu degrees of freedom: most
errors of a class are of size t, a few much larger. u_j moves a pose by its noise, t is half-Cauchy of scale one. A
named effect has one d for all its columns. d, t and v are those of largest marginal likelihood [MacKay1992;
Tipping2001]: with the posterior m, S of x,

    g_j = 1 - S_jj / d_j,    d_j = (m_j^2 + nu (t u_j)^2) / (g_j + nu)    or, named,    d = sum m_j^2 / sum g_j
    v = sum w r^2 / (N - sum g),    w = (mu + 1) / (mu + r^2 / v)

v is at least the scatter of rows of one stay. One stay is one observation, regardless of its number of rows. The fit is
repeated without each fold of poses, which validates the robot folder on held-out poses.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import build_channels
from compplan.diagnosis.evidence.candidates import (
    BACKGROUND,
    CLASSES,
    REGISTRATION,
    in_background,
    key_of,
    offered_signatures,
    propose_again,
    proposed_signatures,
)
from compplan.diagnosis.evidence.evidence import EVIDENCE, SIZES, Posterior
from compplan.diagnosis.evidence.likelihood import factorize, invert_factor, invert_triangle, mirror_lower, solve_factor
from compplan.diagnosis.evidence.normal_equations import NormalEquations, build_normal_equations, turn_along
from compplan.diagnosis.search.fit import register_again
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit, FitState, build_state, known_approach
from compplan.diagnosis.validation.held_out import Folds, HeldOut
from compplan.effects.signature import Signature
from compplan.effects.transmission_error import periods_seen, waves_at
from compplan.robot import Array
from compplan.statics.chain import chunks


@dataclass(frozen=True)
class CalibrationSettings:
    """Settings of the calibration."""

    #: Gear waves: number of harmonics of a turn, and least part of a period in the joint's range (assumed: teeth, wave
    #: generator and bearings of real gears err in fewer).
    waves: int = 30
    seen: float = 0.5
    #: Degrees of freedom of the sizes of small errors (assumed: the heaviest tail with a scale), and of the residuals
    #: (assumed: usual for robust regression [Lange1989]).
    sizes: float = 2.0
    student: float = 5.0
    #: Largest prior deviation of a small error, in units of its scale (assumed: zeros of 10 mrad, lengths of 10 mm).
    largest: float = 10.0
    #: Most updates of the robust weights, and of the variances with each of them (assumed: most converge in half).
    reweighted: int = 30
    steps: int = 3
    #: Convergence: motion of the fitted values over the noise (assumed).
    tolerance: float = 0.01
    #: Largest common factor by which variances of a class change in a step (assumed).
    fastest: float = 4.0
    #: Initial share of the observations' squares that is noise (assumed: far too much, so that no column fits chance).
    first_noise: float = 0.1
    #: Columns that move no observation by more than this share of its noise are left out (assumed).
    least_motion: float = 1e-3
    #: Fewest poses from which a fit without some of them starts at that of all poses (assumed).
    many_poses: int = 200


CALIBRATION = CalibrationSettings()


@dataclass(frozen=True, eq=False)
class StayMeans:
    """Means of stays; N values, k columns."""

    design: Array  #: Columns. Shape (N, k).
    observed: Array  #: Values, in units of the noise of one row. Shape (N,).
    channel: NDArray[np.int_]  #: Channel of each value. Shape (N,).
    row: NDArray[np.int_]  #: A row of the campaign in the stay of each value. Shape (N,).
    columns: NDArray[np.int_]  #: Columns of the normal equations. Shape (k,).
    #: Class of small errors, then one number for each named effect; -1 for frames, without a prior. Shape (k,).
    group: NDArray[np.int_]
    positive: NDArray[np.bool_]  #: Columns that cannot be negative. Shape (k,).
    least: Array  #: Smallest variance of each channel. Shape (channels,).

    def take(self, kept: NDArray[np.bool_]) -> StayMeans:
        """Select columns. Shape of `kept`: (k,)."""
        if kept.all():
            return self
        return replace(
            self, design=self.design[:, kept], columns=self.columns[kept], group=self.group[kept],
            positive=self.positive[kept],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SolvedMeans:
    """Fitted columns: prior variances d (k,), values (k,), Phi^T N^-1 Phi (k, k); and noise v of each channel."""

    means: StayMeans
    variance: Array
    mean: Array
    information: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class Calibration:
    """Named signatures, posterior of all rows, and posterior without each fold by its number."""

    named: tuple[int, ...]
    posterior: Posterior
    without_fold: Mapping[int, Posterior]


def calibrate(folds: Folds, claims: Sequence[Claim]) -> Calibration:
    """Fit named effects and all small errors, to all rows and without each fold."""
    fit = folds.fit
    means = average_stays(fit.search.equations, claims, np.exp(fit.model.posterior.hyper.log_noise))
    whole = solve_means(means)
    near = whole if len(np.unique(folds.pose)) >= CALIBRATION.many_poses else None
    usual = (EVIDENCE.tau_scale * fit.search.prior.spread) ** 2

    def find(solved: SolvedMeans) -> Posterior:
        # errors that the poses do not show have at least their usual variance
        columns, information = solved.means.columns, solved.information
        deviation = np.sqrt(np.maximum(solved.variance, usual[columns]))

        def compute_covariance() -> Array:
            inner = information * np.outer(deviation, deviation) + np.eye(len(deviation))
            return mirror_lower(invert_factor(factorize(inner))) * np.outer(deviation, deviation)

        return Posterior(0.0, columns, solved.mean, fit.model.posterior.hyper, compute_covariance)

    parts = {number: find(solve_means(means, folds.fold[means.row] != number, near)) for number in folds.numbers}
    return Calibration(tuple(claim.signature for claim in claims), find(whole), parts)


def calibrated_state(fit: Fit, values: Array, named: Sequence[int]) -> FitState:
    """Apply the values of a calibration, shape (p,), to the exact model, the widest of its named effects first."""
    equations = fit.search.equations
    claimed = sorted(named, key=lambda n: -len(equations.columns(n)))
    return build_state(fit, values, claimed, [n for n, s in enumerate(equations.signatures) if is_calibrated(s)])


def hold_out_calibration(folds: Folds, found: Calibration) -> HeldOut:
    """Predict every row with the robot calibrated without its fold, as read from its folder."""
    p = folds.fit.search.equations.p
    return folds.hold_out(lambda number: calibrated_state(folds.fit, found.without_fold[number].values(p), found.named))


def is_calibrated(signature: Signature) -> bool:
    """Check whether a signature is written into the robot although it is not named."""
    return signature.name in (REGISTRATION, "gravity_sag", "tool_frame") or in_background(signature)


def read_all_rows(fit: Fit, claims: Sequence[Claim]) -> Fit:
    """Return a fit with the normal equations of its calibration, of all rows that are not outliers.

    They have the columns of claims, small errors, effects in the model that was linearized, and gear waves of every
    harmonic, last; its prior contains none of these waves. Other signatures keep their numbers, without columns.
    """
    problem, at, old, prior = fit.problem, fit.at, fit.search.equations, fit.search.prior
    use = known_approach(problem.campaign, fit.state)
    use[fit.outliers] = False
    claimed = {claim.signature for claim in (*fit.model.claims, *claims)}
    needed = {
        key_of(s): is_calibrated(s) or n in claimed or bool(old.start[old.columns(n)].any())
        for n, s in enumerate(old.signatures)
    }
    names = {name for s in old.signatures if needed[key_of(s)] for name in s.column_names}

    def read() -> Iterator[Signature]:
        proposals = proposed_signatures(old.signatures)
        again = (propose_again(at, [s], {key_of(s)})[0] if needed[key_of(s)] else s for s in proposals)
        for signature in chain(offered_signatures(at, problem.register, problem.excluded), again):
            if key_of(signature) in needed:
                yield signature if needed[key_of(signature)] else signature.part(signature.form, slice(0))
        for index in np.flatnonzero(~at.robot.prismatic):
            visited = float(np.ptp(problem.campaign.q[:, index]))
            for cycles in range(1, CALIBRATION.waves + 1):
                if periods_seen(cycles, visited, slides=False) >= CALIBRATION.seen:
                    waves = waves_at(at, int(index), [float(cycles)])
                    if names.isdisjoint(waves.column_names):
                        yield waves

    channels = build_channels(at.scene, at.attained, use, fit.noises)
    equations = build_normal_equations(channels, read(), dict(zip(old.names, old.start * old.scale, strict=True)))
    state = fit.state if problem.searched.all() else register_again(fit, replace(fit.state, use=use), use)
    known = {name: number for number, name in enumerate(old.names) if name in names}
    column = np.array([known.get(name, -1) for name in equations.names])
    prior = replace(
        prior, background=np.where(column < 0, -1, prior.background[column]),
        spread=np.where(column < 0, 0.0, prior.spread[column]), free=(column >= 0) & prior.free[column],
        slab=np.where(column < 0, 0.0, prior.slab[column]),
    )  # fmt: skip
    search = replace(fit.search, equations=equations, prior=prior, cache={})
    return replace(fit, state=state, channels=channels, search=search)


def average_stays(equations: NormalEquations, claims: Sequence[Claim], noise: Array) -> StayMeans:
    """Average the rows of each stay; `noise`: variance of a row about its stay, one a channel, shape (channels,)."""
    small = [n for n, s in enumerate(equations.signatures) if is_calibrated(s)]
    claimed = [claim.signature for claim in claims]
    columns = equations.join_columns([*small, *claimed])
    parts: list[tuple[Array, Array, Array, Array]] = []
    least = []
    for number, (source, design, observed) in enumerate(
        zip(equations.source, equations.designs, equations.observed, strict=True)
    ):
        design, observed, measured = turn_along(source, design[..., columns], observed)
        first = np.flatnonzero(np.r_[True, np.diff(source.group) > 0])
        size = np.diff(np.r_[first, len(source.group)]).astype(float)
        kept = np.logical_or.reduceat(measured, first, axis=0)
        mean = np.add.reduceat(design, first, axis=0)[kept] / np.repeat(size, kept.sum(axis=1))[:, None]
        value = (np.add.reduceat(observed, first, axis=0) / size[:, None])[kept]
        parts.append((mean, value, np.full(len(value), number), np.repeat(source.rows[first], kept.sum(axis=1))))
        least.append(float(noise[number] * np.mean(1.0 / size)))
    design, observed, channel, row = (np.concatenate(several) for several in zip(*parts, strict=True))
    positive, group = np.zeros(equations.p, bool), np.full(equations.p, -1)
    for number in small:
        name, members = equations.signatures[number].name, equations.columns(number)
        if name != REGISTRATION:
            group[members] = CLASSES.index("compliances" if name == "gravity_sag" else BACKGROUND[name][0])
    for place, number in enumerate(claimed):
        group[equations.columns(number)] = len(CLASSES) + place
    for number in (*small, *claimed):
        positive[equations.columns(number)] |= equations.signatures[number].positive
    return StayMeans(design, observed, channel, row, columns, group[columns], positive[columns], np.array(least))


def solve_means(
    means: StayMeans, rows: NDArray[np.bool_] | None = None, start: SolvedMeans | None = None
) -> SolvedMeans:
    """Fit variances, noise and values to all or some of the means (N,), optionally from a start and its columns."""
    used = np.ones(len(means.observed), bool) if rows is None else rows
    means = means if start is None else start.means
    y, channel, count = means.observed, means.channel, int(used.sum())
    explained = np.zeros(len(y)) if start is None else means.design @ start.mean
    size2 = np.maximum(np.einsum("n,nk,nk->k", used / count, means.design, means.design), 1e-12)
    alive = (size2 > CALIBRATION.least_motion**2) | (means.group < 0)
    means, size2 = means.take(alive), size2[alive]
    design, group = means.design, means.group
    unit2 = np.minimum(1.0 / size2, CALIBRATION.largest**2)
    most = np.where(group < len(CLASSES), CALIBRATION.largest**2, max(SIZES) ** 2)
    width2 = np.ones(len(CLASSES))
    if start is None:
        variance = np.where(group < 0, EVIDENCE.free_variance, unit2)
        weight, channels = used.astype(float), len(means.least)
        square, values = np.bincount(channel, weight * y**2, channels), np.bincount(channel, weight, channels)
        # a channel may have no values among some of the rows
        noise = np.maximum(CALIBRATION.first_noise * square / np.maximum(values, 1.0), means.least)
    else:
        variance, noise = start.variance[alive], start.noise.copy()
        weight = used * _weigh(y - explained, noise[channel])
    for _ in range(CALIBRATION.reweighted):
        sharp = weight / noise[channel]
        gram = _multiply(design, sharp) if count >= design.shape[1] else None
        for _ in range(CALIBRATION.steps):
            mean, known = _solve(design, sharp, y, gram, variance)
            variance = _fit_variance(mean, np.clip(known, 1e-9, 1.0), unit2, group, variance, width2)
            variance = np.clip(variance, 1e-300, np.where(group < 0, EVIDENCE.free_variance, most))
        before, explained = explained, design @ mean
        left = y - explained
        for k in range(len(noise)):
            mask = used & (channel == k)
            freedom = max(mask.sum() * (1.0 - known.sum() / count), 1.0)
            noise[k] = max(float(np.sum(weight[mask] * left[mask] ** 2)) / freedom, means.least[k])
        weight = used * _weigh(left, noise[channel])
        if np.sum(used * (explained - before) ** 2 / noise[channel]) < CALIBRATION.tolerance**2 * count:
            break
    sharp = weight / noise[channel]
    information, against = _multiply(design, sharp), design.T @ (sharp * y)
    while True:
        deviation = np.sqrt(variance)
        lower = factorize(information * np.outer(deviation, deviation) + np.eye(len(deviation)))
        mean = deviation * solve_factor(lower, deviation * against)
        wrong = means.positive & (mean < 0.0)
        if not wrong.any():
            return SolvedMeans(means, variance, mean, information, noise)
        means, variance = means.take(~wrong), variance[~wrong]
        information, against = information[np.ix_(~wrong, ~wrong)], against[~wrong]


def _weigh(left: Array, noise: Array) -> Array:
    """Return the robust weights of residuals with the variance of their noise. Shape (N,)."""
    return np.asarray((CALIBRATION.student + 1.0) / (CALIBRATION.student + left**2 / noise))


def _multiply(design: Array, weight: Array) -> Array:
    """Return the weighted products of columns (N, k), weights (N,), without a copy of all rows. Shape (k, k)."""
    root = np.sqrt(weight)[:, None]
    gram = np.zeros((design.shape[1], design.shape[1]))
    for part in chunks(len(design)):
        scaled = design[part] * root[part]
        gram += scaled.T @ scaled
    return gram


def _fit_variance(
    mean: Array, known: Array, unit2: Array, group: NDArray[np.int_], variance: Array, width2: Array
) -> Array:  # fmt: skip
    """Return the prior variances (k,) after a step towards largest evidence; `width2` (classes,) is updated in place.

    First all of a class change by one factor, then each separately, with the width t^2.
    """
    nu, fitted = CALIBRATION.sizes, variance.copy()
    for number in np.unique(group[group >= 0]):
        mask = group == number
        if number >= len(CLASSES):
            fitted[mask] = np.sum(mean[mask] ** 2) / np.sum(known[mask])
            continue
        wide = width2[number]
        grown = float(np.sum(mean[mask] ** 2 / variance[mask]) / (np.sum(known[mask]) + 2.0 * wide / (1.0 + wide)))
        wide = max(wide * np.clip(grown, 1.0 / CALIBRATION.fastest, CALIBRATION.fastest), 1e-9)
        fitted[mask] = (mean[mask] ** 2 + nu * wide * unit2[mask]) / (known[mask] + nu)
        # largest of nu / 2 (n log t^2 - t^2 sum u^2 / d) - log(1 + t^2)
        share, count = 0.5 * nu * float(np.sum(unit2[mask] / fitted[mask])), 0.5 * nu * mask.sum()
        middle = count - share - 1.0
        width2[number] = 2.0 * count / (np.sqrt(middle**2 + 4.0 * share * count) - middle)
    return fitted


def _solve(
    design: Array, weight: Array, observed: Array, gram: Array | None, variance: Array
) -> tuple[Array, Array]:  # fmt: skip
    """Return values and 1 - S_jj / d_j of each column; without a gram solved among the values. Shapes (k,)."""
    deviation = np.sqrt(variance)
    if gram is not None:
        lower = factorize(gram * np.outer(deviation, deviation) + np.eye(len(variance)))
        inverse = invert_factor(lower)
        return deviation * solve_factor(lower, deviation * (design.T @ (weight * observed))), 1.0 - np.diag(inverse)
    root = np.sqrt(weight)
    scaled = design * root[:, None] * deviation
    white = invert_triangle(factorize(scaled @ scaled.T + np.eye(len(observed))))
    across = white @ scaled
    return deviation * (across.T @ (white @ (observed * root))), np.asarray(np.sum(across**2, axis=0))
