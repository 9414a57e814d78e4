"""Mixture: the candidate models of the delivered robot, and the weights that predict held-out poses best [Breiman1996].

The named causes alone are not always the best prediction: a full calibration, or causes too doubtful to be named, may
predict better. Named causes, plain calibration, causes beside small errors of every class, and sparse calibration are
each fitted without each fold of poses in turn, and the mixture of predictions with the least squares on the poses left
out is delivered. Effects are small, so that a mixture of predictions is the same mixture of parameters. The weights for
a fold come from the other folds, so that the stated error includes their choice.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class Option:
    """A model that the delivered robot may be mixed of: claims, and what is fitted beside them.

    `wide` fits all that a calibration fits with a wide prior, `small` small errors of every class; `sparse` gives each
    column a variance of its own instead, gear waves included.
    """

    claims: tuple[Claim, ...] = ()
    wide: bool = False
    small: bool = False
    sparse: bool = False

    @property
    def signatures(self) -> list[int]:
        """Numbers of the claimed signatures."""
        return [claim.signature for claim in self.claims]

    def prior(self, fit: Fit) -> Prior:
        """Return its prior."""
        prior, equations = fit.search.prior_of(self.claims), fit.search.equations
        background, spread = prior.background.copy(), prior.spread.copy()
        if not self.small:
            background[:] = -1
        if self.wide:
            for number, signature in enumerate(equations.signatures):
                if in_calibration(signature):
                    columns, (label, width) = equations.columns(number), WIDE[signature.name]
                    own = columns[prior.slab[columns] == 0.0]
                    spread[own], background[own] = width, CLASSES.index(label)
        return replace(prior, background=background, spread=spread)


#: Everything that a calibration fits, and nothing else; small errors of every class alone.
PLAIN, SMALL = Option(wide=True), Option(small=True)


def list_options(named: Sequence[Claim], possible: Sequence[Claim]) -> list[Option]:
    """List the models that the delivered robot is mixed of; without named claims the first is the nominal robot."""
    return [Option(tuple(named)), PLAIN, Option(tuple(possible), small=True), Option(tuple(possible), sparse=True)]


def in_calibration(signature: Signature) -> bool:
    """Tell whether a plain calibration fits a signature: one form of each place, all axes."""
    return signature.name in WIDE and (signature.name != "link_geometry" or signature.axis is not None)


def is_built(signature: Signature) -> bool:
    """Tell whether a mixture writes a signature into its robot although it is not claimed."""
    return signature.name == REGISTRATION or in_background(signature) or in_calibration(signature)


@dataclass(frozen=True, eq=False)
class SolvedOption:
    """An option with its posterior of all rows, values without each fold (folds, p), held-out residuals (r, 3) [m]."""

    option: Option
    posterior: Posterior
    values: Array
    residual: Array


def solve_option(folds: Folds, option: Option) -> SolvedOption:
    """Fit an option to all rows, noise and sizes of small errors as well, and without each fold."""
    fit, equations = folds.fit, folds.fit.search.equations
    if option.sparse:
        built = [n for n, s in enumerate(equations.signatures) if is_built(s)]
        means = average_stays(equations, built, option.claims)
        whole = solve_sparse(means)
        # where poses are few, all columns are chosen from again without each fold
        near = whole if len(np.unique(folds.pose)) >= MANY_STAYS else None
        parts = [solve_sparse(means, folds.fold[means.row] != number, near) for number, _ in folds.without_fold]
        posterior, values = posterior_of(fit, whole), [part.values(equations.p) for part in parts]
    else:
        prior, found = option.prior(fit), fit.model.posterior.hyper
        # what claims have explained left the classes of small errors nothing: without them they begin as usual
        start = replace(found, log_tau=np.zeros_like(found.log_tau))
        hyper = find_posterior(equations, prior, start, steps=STEPS).hyper
        posterior = _solve(equations, prior, hyper)
        values = [_solve(part, prior, hyper).values(equations.p) for _, part in folds.without_fold]
    source, left = equations.source[0], np.zeros_like(equations.observed[0])
    for (number, _), own in zip(folds.without_fold, values, strict=True):
        test, used = folds.fold[source.rows] == number, np.flatnonzero(own)
        left[test] = equations.observed[0][test] - equations.designs[0][test][..., used] @ own[used]
    residual = fit_frames(fit, left * source.sigma, len(np.unique(folds.pose)))
    return SolvedOption(option, posterior, np.array(values), residual)


def _solve(equations: NormalEquations, prior: Prior, hyper: Hyper) -> Posterior:
    """Return the posterior, parameters of which none can be negative at zero where they would be."""
    bounded = equations.join_columns(n for n, s in enumerate(equations.signatures) if s.positive)
    return drop_negative(equations, prior, find_posterior(equations, prior, hyper, fit=False), bounded)[1]


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

    def claimed(self, weights: Array | None = None) -> list[int]:
        """List the signatures that options of positive weight claim."""
        mixed = zip(self.weights if weights is None else weights, self.solved, strict=True)
        return sorted({number for w, s in mixed if w > 0 for number in s.option.signatures})

    def posterior(self, p: int) -> Posterior:
        """Return the mixture's posterior: those of the options, and the spread between their means."""
        parts = [(w, s.posterior) for w, s in zip(self.weights, self.solved, strict=True) if w > 0]
        columns = np.unique(np.concatenate([one.columns for _, one in parts]))
        mean = np.asarray(sum(w * one.values(p) for w, one in parts))[columns]

        def covary() -> Array:
            total = np.zeros((len(columns), len(columns)))
            for weight, one in parts:
                at, off = np.searchsorted(columns, one.columns), one.values(p)[columns] - mean
                total += weight * np.outer(off, off)
                total[np.ix_(at, at)] += weight * one.covariance
            return total

        largest = max(parts, key=lambda part: part[0])[1]
        return Posterior(largest.log_evidence, columns, mean, largest.hyper, covary)


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


def mixed_state(fit: Fit, values: Array, claims: Sequence[int]) -> FitState:
    """Put the values of a mixture, shape (p,), into the exact model, the widest of its claims first."""
    equations = fit.search.equations
    claimed = sorted(claims, key=lambda n: -len(equations.columns(n)))
    return build_state(fit, values, claimed, [n for n, s in enumerate(equations.signatures) if is_built(s)])


def is_faithful(fit: Fit, one: SolvedOption) -> bool:
    """Tell whether the exact model of an option leaves the same residual as its linearization.

    Derivatives are taken at the fitted robot: where that has link masses and the option has none, the option's exact
    model does not bend under weight as its linearization does.
    """
    equations, source = fit.search.equations, fit.search.equations.source[0]
    values = one.posterior.values(equations.p)
    used = np.flatnonzero(values)
    linear = (equations.observed[0] - equations.designs[0][..., used] @ values[used]) * source.sigma
    state = mixed_state(fit, values, one.option.signatures)
    if not stands(fit.problem, state):
        return False
    gap = predict_gap(fit, register_again(fit, state, fit.state.use))
    if gap is None:
        return False
    off = abs(np.linalg.norm(gap[source.rows]) - np.linalg.norm(linear))
    return bool(off < FAITHFUL * np.linalg.norm(one.residual))


def hold_out_stack(folds: Folds, blend: StackedModel) -> HeldOut:
    """Predict every row by the exact model of the mixture that is fitted to the other folds."""
    weights = {number: own for (number, _), own in zip(folds.without_fold, blend.by_fold, strict=True)}
    place = {number: k for k, number in enumerate(weights)}

    def build(number: int, _: NormalEquations) -> tuple[Fit, FitState]:
        values = sum(w * s.values[place[number]] for w, s in zip(weights[number], blend.solved, strict=True))
        return folds.fit, mixed_state(folds.fit, np.asarray(values), blend.claimed(weights[number]))

    return folds.hold_out_states(build)
