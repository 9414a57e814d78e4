"""Model update from a cut part: parameters of robot and force, and a residual of the path that they do not explain.

The deviation of a point at length s of the path is, to first order,

    d(s) = J(s) p + F(s) f + r(s) + G(s) g + o + noise,
    p ~ N(0, S), f ~ N(0, 1), r ~ GP(0, a^2 s_u^2 / 3), g ~ N(0, 1), o ~ N(0, s_r^2)

with parameters p, force f, a spatially smooth residual r, and terms that the next part does not repeat: part-specific
force and clamping g, and the offset o of one run. Size a and correlation length of the residual maximise the evidence.
The next program subtracts the posterior mean of p, f and r, if cross-validation over stretches of the part supports it
or noise alone explains the deviations. The band of the next part includes new realisations of g and o.

Robot and force are nearly collinear on one path: each may stay uncertain although their sum is known well. The robot
folder keeps their joint covariance (`LearnedForce.robot`) for other paths, and the joint posterior of this path
(`compplan.learning.path_state`) as the prior of its next part. The part-specific force has the same
slopes as the level common to all parts: only the prior separates the two, not the shape of the deviation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.distance import cdist
from scipy.special import chdtri

from compplan.learning.gathered_points import Gathered
from compplan.measurement.distance import band_radius
from compplan.robot import Array
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.band import Slopes
from compplan.uncertainty.sensitivities import CORRELATION

#: Candidate sizes of the residual relative to the robot's unexplained deviation; and least value of that. [m]
SIZES, LEAST = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0), 2e-5
#: Candidate correlation lengths of the residual relative to that of the robot.
SCALES = (0.1, 0.3, 1.0)
#: Folds of the cross-validation, and neighbouring rows of the path in one fold.
PARTS, STRETCH = 5, 2
#: Relinearisations at the estimate: the deviation is bilinear in compliance and force.
PASSES = 2
#: Confidence level of the test whether noise alone explains the deviations.
BY_CHANCE = 0.95


#: Motion of the tip along the path, (k, 3) [m], as a function of parameters, (p,), and shares of the force, (4,).
Exact = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class UpdateState:
    """Posterior given the measured points of a part; k rows along the path, p parameters."""

    values: Array  #: Posterior mean of the parameters relative to the folder. Shape (p,). [SI]
    force: Array  #: Posterior mean of the shares of the force: level and turns, in standard deviations. Shape (4,).
    own: Array  #: Posterior mean of the part-specific terms, the columns of `PartTerms.part`. Shape (m,).
    part_spread: float  #: Posterior deviation of level plus part-specific force, in prior deviations of the level.
    physics: Array  #: Motion of the tip due to the parameters. Shape (k, 3). [m]
    pushed: Array  #: Motion of the tip due to the force. Shape (k, 3). [m]
    residual: Array  #: Residual of the path. Shape (k, 3). [m]
    #: Posterior covariance of parameters [SI], shares and repeatable deviation of the path [m], in this order.
    joint: Array

    @property
    def covariance(self) -> Array:
        """Posterior covariance of the parameters. Shape (p, p). [SI]"""
        return self.joint[: len(self.values), : len(self.values)]

    @property
    def cross(self) -> Array:
        """Posterior covariance of parameters and shares. Shape (p, 4). [SI]"""
        return self.joint[: len(self.values), len(self.values) : -self.residual.size]

    @property
    def force_covariance(self) -> Array:
        """Posterior covariance of the shares. Shape (4, 4)."""
        return self.joint[len(self.values) : -self.residual.size, len(self.values) : -self.residual.size]

    @property
    def tip(self) -> Array:
        """Covariance of the repeatable deviation. Shape (3 k, 3 k). [m^2]"""
        return self.joint[-self.residual.size :, -self.residual.size :]


@dataclass(frozen=True, eq=False)
class ModelUpdate(UpdateState):
    """Model update from a part, and its consequence for the next program."""

    taken: bool  #: Whether a corrected program is written.
    reason: str  #: Reason of that decision.
    next_part: Array  #: Covariance of the tip on the next part. Shape (k, 3, 3). [m^2]
    band_before: Array  #: Radius that contains the true tip with 95 % probability, before. Shape (k,). [m]
    band_after: Array  #: The same for the next part. Shape (k,). [m]
    #: Both bands in the measured directions, at the rows of `gathered`. Shape (b,) each. [m]
    band_seen: tuple[Array, Array]
    gathered: Gathered  #: The measurements.
    rms: float  #: Root mean square of the measured deviation. [m]
    held_out: float  #: Root mean square deviation after correction, in cross-validation. [m]
    expected: float  #: Expected root mean square deviation of the next part. [m]
    model: UpdateModel  #: Prior model with the selected residual.

    @property
    def alone(self) -> Array:
        """Motion of the tip due to force and clamping of the measured part alone. Shape (k, 3). [m]"""
        return np.asarray(self.model.own.part @ self.own)


@dataclass(frozen=True, eq=False)
class PartTerms:
    """Part-specific deviations along the path, as columns of one standard deviation each; k rows."""

    part: Array  #: Of the measured part: force first, then clamping and temperature. Shape (k, 3, m). [m]
    following: Array  #: Of the next part. Shape (k, 3, n). [m]
    ratio: float = 0.0  #: Ratio of the part-specific force to the uncertainty of the level common to all parts.


@dataclass(frozen=True, eq=False)
class UpdateModel:
    """Prior model at the k rows of the path; its covariances are flattened to 3 k."""

    slopes: Slopes
    known: Uncertainty
    own: PartTerms
    size: float
    scale: float

    def repeats(self) -> tuple[Array, Array, Array]:
        """Return the repeatable terms: parameters and independent force (columns), residual (covariance)."""
        k = len(self.slopes.rows)
        columns, force = (part.reshape(3 * k, -1) for part in self.slopes.columns(self.known))
        apart = cdist(self.slopes.tip, self.slopes.tip) / self.scale
        field = np.kron(self.size**2 * np.exp(-0.5 * apart**2), np.eye(3))
        local = self.slopes.local.ravel()
        near = np.kron(np.exp(-apart * self.scale / CORRELATION), np.ones((3, 3)))
        return columns, force, field + near * np.outer(local, local)


def start_model(slopes: Slopes, known: Uncertainty, own: PartTerms) -> UpdateModel:
    """Return the prior model with the robot's unexplained deviation as residual.

    A path with the posterior of an earlier part includes that deviation.
    """
    size = max(known.smooth, LEAST) if slopes.beyond is None else LEAST
    return UpdateModel(slopes, known, own, size, known.scale)


def expect_deviations(slopes: Slopes, known: Uncertainty, gathered: Gathered, own: PartTerms) -> Array:
    """Return the prior covariance of the points: robot, force, clamping, instrument. Shape (3 b, 3 b). [m^2]"""
    k, b = len(slopes.rows), len(gathered.row)
    prior = prior_of(start_model(slopes, known, own))
    run = (known.repeatability or 0.0) * np.tile(np.eye(3), (k, 1))
    loose = np.hstack([own.part.reshape(3 * k, -1), run])
    rows = (3 * gathered.row[:, None] + np.arange(3)).ravel()
    every = (prior + loose @ loose.T)[np.ix_(rows, rows)] + np.diag(np.repeat(gathered.variance, 3))
    counts = gathered.counts
    return np.einsum("aij,ajbk,bkl->aibl", counts, every.reshape(b, 3, b, 3), counts, optimize=True).reshape(3 * b, -1)


def learn_part(slopes: Slopes, known: Uncertainty, gathered: Gathered, exact: Exact, own: PartTerms) -> ModelUpdate:
    """Compute the model update from a cut part by iterated linearisation.

    slopes: linearised path as it was cut; exact: nonlinear motion of the tip due to parameters and force.
    """
    _, model = choose_model(start_model(slopes, known, own), gathered)
    seen = np.sqrt(np.mean(np.sum(gathered.deviation**2, axis=1)))
    plain, state = gathered, condition(model, gathered)
    for _ in range(PASSES):
        share = state.force + own.ratio * np.eye(len(state.force))[0] * state.own[0]
        own_push = own.part[:, :, 0] * state.own[0]
        curved = exact(state.values, share) - state.physics - state.pushed - own_push
        shifted = plain.deviation - np.einsum("bij,bj->bi", plain.counts, curved[plain.row])
        gathered = replace(plain, deviation=shifted)
        state = condition(model, gathered)
    held = _hold_out(model, gathered)
    taken, reason = _decide(model, plain, float(seen), held)
    k = len(slopes.rows)
    prior = prior_of(model)
    before = band_radius(_with_run(model, take_blocks(prior, k), own.following))
    seen_before, seen_after = (_band_seen(model, covariance, gathered) for covariance in (prior, state.tip))
    following = _with_run(model, take_blocks(state.tip if taken else prior, k), own.following)
    return ModelUpdate(
        **vars(state), taken=taken, reason=reason,
        next_part=following, band_before=before, band_after=band_radius(following),
        band_seen=(seen_before, seen_after if taken else seen_before), gathered=plain, rms=float(seen), held_out=held,
        expected=float(np.sqrt(np.mean(np.trace(following, axis1=1, axis2=2)))), model=model,
    )  # fmt: skip


def choose_model(model: UpdateModel, gathered: Gathered) -> tuple[float, UpdateModel]:
    """Choose size and correlation length of the residual by maximum evidence; return log evidence and model.

    Candidates are multiples of the size and the scale of `model`.
    """
    tries = [replace(model, size=size * model.size, scale=scale * model.scale) for scale in SCALES for size in SIZES]
    scores = [_log_evidence(one, gathered) for one in tries]
    best = int(np.argmax(scores))
    return scores[best], tries[best]


def _observe(model: UpdateModel, gathered: Gathered) -> tuple[Array, Array, Array]:
    """Return observations (o,), observation matrix (o, 3 k), and covariance of noise and part-specific terms (o, o)."""
    value, vector = np.linalg.eigh(gathered.counts)
    number, axis = np.nonzero(value > 0.5)
    direction = vector[number, :, axis]
    H = np.zeros((len(number), 3 * len(model.slopes.rows)))
    H[np.arange(len(number))[:, None], 3 * gathered.row[number, None] + np.arange(3)] = direction
    run = (model.known.repeatability or 0.0) * direction
    loose = H @ model.own.part.reshape(H.shape[1], -1)
    own = np.diag(gathered.variance[number]) + run @ run.T + loose @ loose.T
    return np.einsum("oi,oi->o", direction, gathered.deviation[number]), H, own


def prior_of(model: UpdateModel) -> Array:
    """Return the prior covariance of the repeatable deviation. Shape (3 k, 3 k). [m^2]"""
    columns, force, field = model.repeats()
    return np.asarray(columns @ columns.T + force @ force.T + field)


def condition(model: UpdateModel, gathered: Gathered) -> UpdateState:
    """Condition parameters, force and residual on the observations."""
    columns, force, field = model.repeats()
    y, H, own = _observe(model, gathered)
    root, r = model.known.spread, columns.shape[1]
    tied, apart = model.slopes.tie or (np.zeros((force.shape[1], r)), np.eye(force.shape[1]))
    # parameters and shares of the force, then with the deviation of the path: rows of one Gaussian state
    top = np.block([[root, np.zeros((len(root), len(apart)))], [tied, apart]])
    every = np.hstack([columns, force])
    tip = every @ every.T + field
    prior = np.block([[top @ top.T, top @ every.T], [every @ top.T, tip]])
    factor = cho_factor(H @ tip @ H.T + own + 1e-18 * np.eye(len(y)))
    weight = H.T @ cho_solve(factor, y)
    seen = prior[:, len(top) :] @ H.T
    mean = prior[:, len(top) :] @ weight
    values, share = mean[: len(root)], mean[len(root) : len(top)]
    physics, pushed = model.slopes.model @ values, model.slopes.shared @ share
    own_columns = model.own.part.reshape(len(weight), -1)
    level = seen[len(root)] + model.own.ratio * H @ own_columns[:, 0]  # with the force of this part alone
    spread = prior[len(root), len(root)] + model.own.ratio**2 - level @ cho_solve(factor, level)
    return UpdateState(
        values=values,
        force=share,
        own=own_columns.T @ weight,
        part_spread=float(np.sqrt(max(spread, 0.0))),
        physics=physics,
        pushed=pushed,
        residual=mean[len(top) :].reshape(-1, 3) - physics - pushed,
        joint=prior - seen @ cho_solve(factor, seen.T),
    )


def _log_evidence(model: UpdateModel, gathered: Gathered) -> float:
    y, H, own = _observe(model, gathered)
    total = H @ prior_of(model) @ H.T + own + 1e-18 * np.eye(len(y))
    try:
        factor = cho_factor(total)
    except np.linalg.LinAlgError:
        return -np.inf
    return float(-0.5 * y @ cho_solve(factor, y) - np.log(np.diag(factor[0])).sum())


def learn_without(
    model: UpdateModel, gathered: Gathered, part: NDArray[np.int_]
) -> Iterator[tuple[NDArray[np.bool_], UpdateState]]:
    """Yield the mask of each fold and the posterior from all other points; nothing if there is one fold."""
    numbers = np.unique(part)
    for test in (part == number for number in numbers[: len(numbers) if len(numbers) > 1 else 0]):
        yield test, condition(model, gathered.take(~test))


def _hold_out(model: UpdateModel, gathered: Gathered) -> float:
    """Return the cross-validated root mean square deviation after correction. [m]"""
    left = np.full_like(gathered.deviation, np.inf)
    for test, state in learn_without(model, gathered, np.arange(len(gathered.row)) // STRETCH % PARTS):
        moved = (state.physics + state.pushed + state.residual)[gathered.row[test]]
        left[test] = gathered.deviation[test] - np.einsum("bij,bj->bi", gathered.counts[test], moved)
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def _decide(model: UpdateModel, gathered: Gathered, rms: float, held: float) -> tuple[bool, str]:
    """Decide whether the correction is supported, and return the reason; deviations within the noise support it."""
    if _is_chance(model, gathered):
        return True, (
            f"the measured deviation of {rms * 1e3:.3g} mm rms may come by chance from instrument, repeatability,"
            " clamping and force: the program corrects only what is expected to repeat"
        )
    if held >= rms:
        return False, (
            f"on stretches of the part left out of the fit {held * 1e3:.3g} mm rms remain with the correction and"
            f" {rms * 1e3:.3g} mm without it, the program stays as it is"
        )
    return True, (
        f"on stretches of the part left out of the fit the correction leaves {held * 1e3:.3g} mm of the measured"
        f" {rms * 1e3:.3g} mm rms"
    )


def _is_chance(model: UpdateModel, gathered: Gathered) -> bool:
    """Test whether instrument, repeatability and part-specific terms alone explain the measurements.

    Only directions whose prior variance exceeds that of the noise are tested, all together and each alone: the motion
    of a complete part would vanish among all numbers of a scan. Each test has half of the false alarm probability.
    """
    y, H, own = _observe(model, gathered)
    white = np.linalg.inv(np.linalg.cholesky(own + 1e-18 * np.eye(len(y))))
    value, vector = np.linalg.eigh(white @ H @ prior_of(model) @ H.T @ white.T)
    square = np.r_[vector[:, value > 1.0].T @ white @ y, 0.0] ** 2
    share, n = 0.5 * (1.0 - BY_CHANCE), max(len(square) - 1, 1)
    return bool(square.sum() <= chdtri(n, share) and square.max() <= chdtri(1, share / n))


def take_blocks(matrix: Array, k: int) -> Array:
    """Return the 3x3 blocks on the diagonal. Shape (k, 3, 3)."""
    return np.asarray(matrix.reshape(k, 3, k, 3)[np.arange(k), :, np.arange(k), :])


def _band_seen(model: UpdateModel, covariance: Array, gathered: Gathered) -> Array:
    """Return the band in the measured directions. Shape (b,). [m]"""
    blocks = _with_run(model, take_blocks(covariance, len(model.slopes.rows)), model.own.following)[gathered.row]
    return np.asarray(band_radius(gathered.counts @ blocks @ gathered.counts))


def _with_run(model: UpdateModel, covariance: Array, own: Array) -> Array:
    """Add part-specific terms, columns (k, 3, m) [m], and repeatability to a covariance. Shape (k, 3, 3). [m^2]"""
    return covariance + own @ np.swapaxes(own, 1, 2) + (model.known.repeatability or 0.0) ** 2 * np.eye(3)
