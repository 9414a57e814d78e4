"""Stacking: the mixture of candidate models that predicts held-out poses best [Breiman1996].

The named causes alone are not always the best prediction: a full calibration, or causes too doubtful to be named, may
predict better. Each model is fitted without each fold of poses in turn, and the mixture of predictions with the least
squares on the poses left out is delivered. Effects are small, so that a mixture of predictions is the same mixture of
parameters. The weights for a fold come from the other folds, so that the stated error includes their choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import Posterior, Prior
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.diagnosis.search.polish import register_again
from compplan.diagnosis.search.state import Fit, FitState, idle, move_registration, stands
from compplan.diagnosis.validation.held_out import Folds, HeldOut, predict_gap
from compplan.diagnosis.validation.options import Option, SolvedOption, is_built, solve_option
from compplan.effects.checks import limit_sizes
from compplan.robot import Array

#: Largest difference of exact and first-order residuals of an option over its held-out ones (assumed: a tenth
#: of the square).
FAITHFUL = 0.3


def stack_weights(residuals: Array) -> Array:
    """Return the weights, none negative and one in sum, whose mixture of residuals has the least squares. Shape (k,).

    Weights x that need not sum to one and make |R x|^2 + (sum x - 1)^2 least are these but for their sum: along any
    direction w = x / sum x the least value is |R w|^2 / (1 + |R w|^2).

    Args:
        residuals: Residuals of each option. Shape (k, m).
    """
    gram = residuals @ residuals.T
    value, vector = np.linalg.eigh(gram / max(float(np.diag(gram).min()), 1e-300))
    root = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T
    found = nnls(np.vstack([root, np.ones((1, len(gram)))]), np.append(np.zeros(len(gram)), 1.0))[0]
    return np.asarray(found / found.sum())


def build_state(fit: Fit, values: Array, first: Sequence[int]) -> FitState:
    """Put values into the exact model.

    Args:
        fit: The fit; its outliers and scatter are kept.
        values: Value of each column, in units of its scale. Shape (p,).
        first: Signatures whose form is kept where several share a column: claims.
    """
    equations, left = fit.search.equations, values.copy()
    claimed = sorted(set(first), key=lambda n: -len(equations.columns(n)))
    rest = [n for n, s in enumerate(equations.signatures) if n not in first and is_built(s)]
    effects, kept, registration = list(fit.problem.fixed), dict[str, float](), fit.state.registration
    for number in [*claimed, *rest]:
        signature, columns = equations.signatures[number], equations.columns(number)
        if signature.name == REGISTRATION:
            registration = move_registration(registration, signature, left[columns] * signature.scale)
            continue
        if number not in claimed and idle(equations, columns, left):
            continue
        part = left[columns]
        if signature.positive:
            part = np.maximum(part, 0.0)
        sizes = limit_sizes(fit.problem.robot, signature, part * signature.scale)
        if signature.least:
            sizes = np.maximum(sizes, signature.least)
        if part.any():
            kept |= {equations.names[c]: float(size) for c, size in zip(columns, sizes, strict=True)}
            effects.append(signature.effect(sizes))
        left[columns] = 0.0
    return replace(fit.state, effects=tuple(effects), values=kept, registration=registration)


@dataclass(frozen=True, eq=False)
class StackedModel:
    """A mixture of options.

    Attributes:
        solved: The options.
        weights: Weight of each. Shape (k,).
        by_fold: Weights for each fold, from the other folds. Shape (folds, k).
    """

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
    """Mix options with the weights of least held-out squares.

    Args:
        folds: The fit, dealt to folds.
        options: The options; the first is kept where all of them fail `is_faithful`.
        seen: Predicted rows that are no outliers. Shape (r,).
    """
    every = tuple(solve_option(folds, option) for option in options)
    solved = tuple(one for one in every if is_faithful(folds.fit, one)) or every[:1]
    residual = np.stack([s.residual for s in solved])
    fold = folds.fold[folds.fit.search.equations.source[0].rows]

    def weigh(rows: NDArray[np.bool_]) -> Array:
        return stack_weights(residual[:, rows].reshape(len(solved), -1))

    by_fold = [weigh(seen & (fold != number)) for number, _ in folds.without_fold]
    return StackedModel(solved, weigh(seen), np.array(by_fold))


def stack_single(folds: Folds, option: Option) -> StackedModel:
    """Return the mixture of one option alone."""
    return StackedModel((solve_option(folds, option),), np.ones(1), np.ones((len(folds.without_fold), 1)))


def is_faithful(fit: Fit, one: SolvedOption) -> bool:
    """Tell whether the exact model of an option leaves the same residual as its linearization.

    Derivatives are taken at the fitted robot: where that has link masses and the option has none, the option's exact
    model does not bend under weight as its linearization does.
    """
    equations, source = fit.search.equations, fit.search.equations.source[0]
    values = one.posterior.values(equations.p)
    used = np.flatnonzero(values)
    linear = (equations.observed[0] - equations.designs[0][..., used] @ values[used]) * source.sigma
    state = build_state(fit, values, [claim.signature for claim in one.option.claims])
    if not stands(fit.problem, state):
        return False
    gap = predict_gap(fit, register_again(fit, state, fit.state.use))
    if gap is None:
        return False
    off = abs(np.linalg.norm(gap[source.rows]) - np.linalg.norm(linear))
    return bool(off < FAITHFUL * np.linalg.norm(one.residual))


def hold_out_small(folds: Folds, blend: StackedModel, seen: NDArray[np.bool_]) -> HeldOut:
    """Predict every row, to first order, by the mixture of the options without causes and gear waves.

    Args:
        folds: The fit, dealt to folds.
        blend: The mixture of all options.
        seen: Predicted rows that are no outliers. Shape (r,).
    """
    rows = folds.fit.search.equations.source[0].rows
    fold = folds.fold[rows]
    residual = np.stack([one.residual for one in blend.solved if not (one.option.claims or one.option.sparse)])
    mixed = np.zeros_like(residual[0])
    for number, _ in folds.without_fold:
        others = seen & (fold != number)
        weights = stack_weights(residual[:, others].reshape(len(residual), -1))
        mixed[fold == number] = np.tensordot(weights, residual[:, fold == number], 1)
    return HeldOut(rows, mixed)


def hold_out_stack(folds: Folds, blend: StackedModel) -> HeldOut:
    """Predict every row by the exact model of the mixture that is fitted to the other folds."""
    place = {number: k for k, (number, _) in enumerate(folds.without_fold)}

    def build(number: int, _: NormalEquations) -> tuple[Fit, FitState]:
        return folds.fit, build_state(folds.fit, *blend.without(place[number]))

    held = folds.hold_out_states(build)
    chance = float(blend.weights @ [one.chance for one in blend.solved])
    return replace(held, residual=chance * held.residual)
