"""Mixture: the candidate models of the delivered robot, and the weights that predict held-out poses best [Breiman1996].

The named causes alone are not always the best prediction: a full calibration, or causes too doubtful to be named, may
predict better. Named causes, plain calibration, causes beside small errors of every class, and sparse calibration are
each fitted without each fold of poses in turn, and the mixture of predictions with the least squares on the poses left
out is delivered. Effects are small, so that a mixture of predictions is the same mixture of parameters. The weights for
a fold come from the other folds, so that the stated error includes their choice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from compplan.diagnosis.data.shared import STEPS
from compplan.diagnosis.evidence.candidates import CLASSES, REGISTRATION, in_background
from compplan.diagnosis.evidence.evidence import Posterior, Prior, drop_negative, find_posterior
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.diagnosis.search.fit import register_again
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit, FitState, build_state, stands
from compplan.diagnosis.validation.held_out import Folds, HeldOut, fit_frames, predict_gap
from compplan.diagnosis.validation.sparse import average_stays, posterior_of, solve_sparse
from compplan.effects.signature import Signature
from compplan.robot import Array

#: Largest difference of exact and first-order residuals of an option over its held-out ones (assumed: a tenth
#: of the square).
FAITHFUL = 0.3


def stack_weights(residuals: Array) -> Array:
    """Return the weights (k,), none negative and one in sum, whose mixture of residuals (k, m) has the least squares.

    Weights x that need not sum to one and make |R x|^2 + (sum x - 1)^2 least are these but for their sum: along any
    direction w = x / sum x the least value is |R w|^2 / (1 + |R w|^2).
    """
    gram = residuals @ residuals.T
    value, vector = np.linalg.eigh(gram / max(float(np.diag(gram).min()), 1e-300))
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    found = nnls(np.vstack([root, np.ones((1, len(gram)))]), np.append(np.zeros(len(gram)), 1.0))[0]
    return np.asarray(found / found.sum())


@dataclass(frozen=True, eq=False)
class StackedModel:
    """A mixture of options, their weights (k,), and weights for each fold from the others (folds, k)."""

    solved: tuple[SolvedOption, ...]
    weights: Array
    by_fold: Array

    def values(self, p: int) -> Array:
        """Return the mixed values of all rows. Shape (p,)."""
        return np.asarray(sum(w * s.posterior.values(p) for w, s in zip(self.weights, self.solved, strict=True)))

    def claimed(self) -> list[int]:
        """List the signatures that options of positive weight claim."""
        mixed = [s.option.claims for w, s in zip(self.weights, self.solved, strict=True) if w > 0]
        return sorted({claim.signature for claims in mixed for claim in claims})

    def without(self, fold: int) -> tuple[Array, list[int]]:
        """Return the mixed values without a fold, by its place, and the signatures that are claimed. Shape (p,)."""
        parts = [(w, s) for w, s in zip(self.by_fold[fold], self.solved, strict=True) if w > 0]
        claimed = {claim.signature for _, s in parts for claim in s.option.claims}
        return np.asarray(sum(w * s.values[fold] for w, s in parts)), sorted(claimed)

    def fitted(self, fit: Fit) -> Fit:
        """Return the fit with the mixture's posterior: those of the options, and the spread between their means."""
        p = fit.search.equations.p
        parts = [(w, s) for w, s in zip(self.weights, self.solved, strict=True) if w > 0]
        columns = np.unique(np.concatenate([s.posterior.columns for _, s in parts]))
        mean = self.values(p)[columns]

        def covary() -> Array:
            total = np.zeros((len(columns), len(columns)))
            for weight, one in parts:
                at = np.searchsorted(columns, one.posterior.columns)
                off = one.posterior.values(p)[columns] - mean
                total += weight * np.outer(off, off)
                total[np.ix_(at, at)] += weight * one.posterior.covariance
            return total

        variance = np.asarray(sum(w * s.variance for w, s in parts))
        largest = max(parts, key=lambda part: part[0])[1].posterior
        prior = fit.search.prior
        prior = Prior(np.full(p, -1), prior.spread, prior.free, np.where(prior.free, 0.0, variance))
        posterior = Posterior(largest.log_evidence, columns, mean, largest.hyper, covary)
        return replace(
            fit,
            search=replace(fit.search, prior=prior, cache={}),
            model=replace(fit.model, claims=(), posterior=posterior),
        )


def stack_options(folds: Folds, options: Sequence[Option], seen: NDArray[np.bool_]) -> StackedModel:
    """Mix options with the weights of least held-out squares of the rows seen, shape (r,).

    The first option is kept where all of them fail `is_faithful`.
    """
    every = tuple(solve_option(folds, option) for option in options)
    solved = tuple(one for one in every if is_faithful(folds.fit, one)) or every[:1]
    residual = np.stack([s.residual for s in solved])
    fold = folds.fold[folds.fit.search.equations.source[0].rows]

    def weigh(rows: NDArray[np.bool_]) -> Array:
        return stack_weights(residual[:, rows].reshape(len(solved), -1))

    by_fold = [weigh(seen & (fold != number)) for number, _ in folds.without_fold]
    return StackedModel(solved, weigh(seen), np.array(by_fold))


def is_faithful(fit: Fit, one: SolvedOption) -> bool:
    """Tell whether the exact model of an option leaves the same residual as its linearization.

    Derivatives are taken at the fitted robot: where that has link masses and the option has none, the option's exact
    model does not bend under weight as its linearization does.
    """
    equations, source = fit.search.equations, fit.search.equations.source[0]
    values = one.posterior.values(equations.p)
    used = np.flatnonzero(values)
    linear = (equations.observed[0] - equations.designs[0][..., used] @ values[used]) * source.sigma
    state = mixed_state(fit, values, [claim.signature for claim in one.option.claims])
    if not stands(fit.problem, state):
        return False
    gap = predict_gap(fit, register_again(fit, state, fit.state.use))
    if gap is None:
        return False
    off = abs(np.linalg.norm(gap[source.rows]) - np.linalg.norm(linear))
    return bool(off < FAITHFUL * np.linalg.norm(one.residual))


def hold_out_stack(folds: Folds, blend: StackedModel) -> HeldOut:
    """Predict every row by the exact model of the mixture that is fitted to the other folds."""
    place = {number: k for k, (number, _) in enumerate(folds.without_fold)}

    def build(number: int, _: NormalEquations) -> tuple[Fit, FitState]:
        return folds.fit, mixed_state(folds.fit, *blend.without(place[number]))

    held = folds.hold_out_states(build)
    chance = float(blend.weights @ [one.chance for one in blend.solved])
    return replace(held, residual=chance * held.residual)


#: Widths of a plain calibration, in units of the scale of each signature (assumed: zeros to 2 mrad and lengths to 2 mm
#: and 2 mrad, as in the usual weak pull to the nominal robot; compliances to three times what is usual).
WIDE = {
    "joint_offset": ("zeros", 2.0),
    "link_geometry": ("lengths", 4.0),
    "tool_frame": ("lengths", 2.0),
    "joint_stiffness": ("compliances", 3.0),
    "gravity_sag": ("compliances", 3.0),
}
#: From this many poses on, the choice of columns adds little to what held-out poses show (assumed).
MANY_STAYS = 200


@dataclass(frozen=True, eq=False)
class Option:
    """A model that the delivered robot may be mixed of.

    Attributes:
        name: What it is, in a few words.
        claims: Its claims.
        wide: Whether everything that a calibration fits is fitted with a wide prior.
        small: Classes of small errors that are fitted.
        sparse: Whether each column has a variance of its own instead, gear waves included.
    """

    name: str
    claims: tuple[Claim, ...] = ()
    wide: bool = False
    small: tuple[int, ...] = ()
    sparse: bool = False

    def prior(self, fit: Fit, claims: Sequence[Claim]) -> Prior:
        """Return its prior with some claims."""
        prior = fit.search.prior_of(claims)
        background, slab, spread = prior.background.copy(), prior.slab.copy(), prior.spread.copy()
        background[~np.isin(background, self.small)] = -1
        if self.wide:
            equations = fit.search.equations
            for number, signature in enumerate(equations.signatures):
                if in_calibration(signature):
                    columns, (label, width) = equations.columns(number), WIDE[signature.name]
                    own = columns[slab[columns] == 0.0]
                    spread[own], background[own] = width, CLASSES.index(label)
        return replace(prior, background=background, slab=slab, spread=spread)


#: Everything that a calibration fits, and nothing else; small errors of every class alone.
PLAIN, SMALL = Option("plain calibration", wide=True), Option("small errors", small=tuple(range(len(CLASSES))))


def in_calibration(signature: Signature) -> bool:
    """Tell whether a plain calibration fits a signature: one form of each place, all axes."""
    if signature.name == "link_geometry":
        return signature.axis is not None
    return signature.name in WIDE


@dataclass(frozen=True, eq=False)
class SolvedOption:
    """An option fitted to all rows and without each fold.

    Attributes:
        option: The option.
        posterior: Posterior of all rows.
        variance: Prior variance of every column. Shape (p,).
        values: Values without each fold. Shape (folds, p).
        chance: Factor of held-out errors, since the forms of claims were searched for in all rows.
        residual: Held-out residuals to first order, times that factor. Shape (r, 3). [m]
    """

    option: Option
    posterior: Posterior
    variance: Array
    values: Array
    chance: float
    residual: Array


def solve_option(folds: Folds, option: Option) -> SolvedOption:
    """Fit an option to all rows, noise and sizes of small errors as well, and without each fold."""
    if option.sparse:
        return _solve_sparse(folds, option)
    fit = folds.fit
    equations = fit.search.equations
    prior = option.prior(fit, option.claims)
    found = fit.model.posterior.hyper
    # what claims have explained left the classes of small errors nothing: without them they begin as usual
    hyper = find_posterior(equations, prior, replace(found, log_tau=np.zeros_like(found.log_tau)), steps=STEPS).hyper
    prior, posterior = _solve(equations, prior, hyper)
    values = [
        _solve(part, option.prior(fit, option.claims), hyper)[1].values(equations.p) for _, part in folds.without_fold
    ]
    return _hold_out(folds, option, posterior, prior.variance(hyper.log_tau), values)


def _solve_sparse(folds: Folds, option: Option) -> SolvedOption:
    """Fit the sparse model to all rows and without each fold: with all columns again where poses are few."""
    equations = folds.fit.search.equations
    built = [n for n, s in enumerate(equations.signatures) if is_built(s)]
    means = average_stays(equations, built, option.claims)
    whole = solve_sparse(means)
    near = whole if len(np.unique(folds.pose)) >= MANY_STAYS else None
    parts = [solve_sparse(means, folds.fold[means.row] != number, near) for number, _ in folds.without_fold]
    variance = np.zeros(equations.p)
    variance[whole.means.columns] = whole.variance
    values = [part.values(equations.p) for part in parts]
    return _hold_out(folds, option, posterior_of(folds.fit, whole), variance, values)


def _hold_out(
    folds: Folds, option: Option, posterior: Posterior, variance: Array, values: Sequence[Array]
) -> SolvedOption:  # fmt: skip
    chance = rate_chance(folds, option.claims)
    return SolvedOption(option, posterior, variance, np.array(values), chance, chance * predict_folds(folds, values))


def mixed_state(fit: Fit, values: Array, claims: Sequence[int]) -> FitState:
    """Put the values of a mixture, shape (p,), into the exact model, the widest of its claims first."""
    equations = fit.search.equations
    claimed = sorted(set(claims), key=lambda n: -len(equations.columns(n)))
    return build_state(fit, values, claimed, [n for n, s in enumerate(equations.signatures) if is_built(s)])


def is_built(signature: Signature) -> bool:
    """Tell whether a mixture writes a signature into its robot although it is not claimed."""
    return signature.name == REGISTRATION or in_background(signature) or in_calibration(signature)


def rate_chance(folds: Folds, claims: Sequence[Claim]) -> float:
    """Return the factor of held-out errors of claims whose forms were searched for in all rows.

    The best of t forms is better by chance by 2 log t squares of the noise [FosterGeorge1994], in every fold.
    """
    signatures = folds.fit.search.equations.signatures
    squares = 2.0 * sum(math.log(signatures[claim.signature].tried) for claim in claims)
    told = folds.fit.search.equations.source[0].told.mean()
    return float(np.sqrt(1.0 + squares / (told * len(np.unique(folds.pose)))))


def _solve(equations: NormalEquations, prior: Prior, hyper: Hyper) -> tuple[Prior, Posterior]:
    """Return the posterior, parameters of which none can be negative at zero where they would be."""
    bounded = equations.join_columns(n for n, s in enumerate(equations.signatures) if s.positive)
    return drop_negative(equations, prior, find_posterior(equations, prior, hyper, fit=False), bounded)


def predict_folds(folds: Folds, values: Sequence[Array]) -> Array:
    """Return what values without each fold leave of it, to first order, frames fitted to all rows. Shape (r, 3). [m]"""
    fit = folds.fit
    equations, source = fit.search.equations, fit.search.equations.source[0]
    left = np.zeros_like(equations.observed[0])
    for (number, _), own in zip(folds.without_fold, values, strict=True):
        test, used = folds.fold[source.rows] == number, np.flatnonzero(own)
        left[test] = equations.observed[0][test] - equations.designs[0][test][..., used] @ own[used]
    return fit_frames(fit, left * source.sigma, len(np.unique(folds.pose)))


def list_options(named: Sequence[Claim], possible: Sequence[Claim]) -> list[Option]:
    """List the models that the delivered robot is mixed of; without named claims the first is the nominal robot."""
    return [
        Option("named causes", tuple(named)),
        PLAIN,
        Option("causes and small errors", tuple(possible), small=SMALL.small),
        Option("sparse calibration", tuple(possible), sparse=True),
    ]
