"""Blend: the robot that predicts best, mixed of candidate models by the weights that poses never seen give them.

A diagnosis names what it is sure of. The robot folder has another task, to predict: a plain calibration of everything
that can be calibrated, or causes too doubtful to be named, may do that better than the names alone. So all of them are
fitted without each fold of poses in turn, and the mixture of their predictions with the least squares on the poses
left out goes out (stacking [Breiman1996]). Effects are small: a mixture of predictions is the same mixture of
parameters. The weights for a fold come from the other folds, so that the stated error pays for the choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from compplan.diagnose.background import CLASSES, in_background
from compplan.diagnose.channels import block_index
from compplan.diagnose.evidence import Hyper, Posterior, Prior, find_posterior
from compplan.diagnose.held_out import Folds, HeldOut, fit_frames
from compplan.diagnose.ledger import Ledger
from compplan.diagnose.offers import REGISTRATION
from compplan.diagnose.search import STEPS, Claim
from compplan.diagnose.state import ACTIVE_SETS, Fit, FitState, idle, move_registration
from compplan.effects import is_of_instrument
from compplan.effects.signature import Signature
from compplan.robot import Array

#: Widths of a plain calibration, in units of the scale of each signature (assumed: zeros to 2 mrad and lengths to 2 mm
#: and 2 mrad, as in the usual weak pull to the nominal robot; compliances to three times what is usual).
WIDE = {
    "joint_offset": ("zeros", 2.0),
    "link_geometry": ("lengths", 4.0),
    "tool_frame": ("lengths", 2.0),
    "joint_stiffness": ("compliances", 3.0),
    "gravity_sag": ("compliances", 3.0),
}
#: Classes of small errors that a plain calibration takes the place of, and those that may stand beside it.
BESIDE = tuple(k for k, name in enumerate(CLASSES) if name not in ("zeros", "lengths", "compliances"))
#: From this many stays on, the choice of a few claims adds little to what held-out poses show: ten among two hundred
#: places are worth 2 * 10 * log(200) of 3 * 400 values, 5 % of the error (assumed; [FosterGeorge1994]).
MANY_STAYS = 400
Decide = Callable[[Ledger], Sequence[Claim]]


@dataclass(frozen=True, eq=False)
class Option:
    """A model that may have a part in the robot that goes out.

    Attributes:
        name: What it is, in a few words.
        claims: Its claims.
        wide: Whether everything that a calibration fits is fitted with a wide prior.
        small: Classes of small errors that are fitted.
        decide: Chooses the claims from a ledger anew, where the choice itself is in doubt.
    """

    name: str
    claims: tuple[Claim, ...] = ()
    wide: bool = False
    small: tuple[int, ...] = ()
    decide: Decide | None = None

    def prior(self, fit: Fit, claims: Sequence[Claim]) -> Prior:
        """Return its prior with some claims."""
        prior = fit.search.prior_of(claims)
        background, slab, spread = prior.background.copy(), prior.slab.copy(), prior.spread.copy()
        background[~np.isin(background, self.small)] = -1
        if self.wide:
            for columns, label, width in _wide_columns(fit.search.ledger):
                own = columns[slab[columns] == 0.0]
                spread[own], background[own] = width, label
        return replace(prior, background=background, slab=slab, spread=spread)


def _wide_columns(ledger: Ledger) -> list[tuple[NDArray[np.int_], int, float]]:
    """List columns, classes and widths of a plain calibration."""
    return [
        (ledger.columns(n), CLASSES.index(WIDE[s.name][0]), WIDE[s.name][1])
        for n, s in enumerate(ledger.signatures) if in_calibration(s)
    ]  # fmt: skip


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
        posterior: What all rows say.
        variance: Prior variance of every column. Shape (p,).
        values: Values without each fold. Shape (folds, p).
        claimed: Signatures that are claimed without each fold.
        chance: Factor by which errors of rows never seen are larger, since forms were looked for in all rows.
        residual: Observed minus predicted of rows never seen, to first order, that factor in it. Shape (r, 3). [m]
    """

    option: Option
    posterior: Posterior
    variance: Array
    values: Array
    claimed: tuple[tuple[int, ...], ...]
    chance: float
    residual: Array


def solve_option(folds: Folds, option: Option) -> SolvedOption:
    """Fit an option to all rows, noise and small errors as large as these say, and without each fold."""
    fit = folds.fit
    ledger = fit.search.ledger
    prior = option.prior(fit, option.claims)
    found = fit.model.posterior.hyper
    # what claims have explained left the classes of small errors nothing: without them they begin as usual
    hyper = find_posterior(ledger, prior, replace(found, log_tau=np.zeros_like(found.log_tau)), steps=STEPS).hyper
    prior, posterior = _solve(ledger, prior, hyper)
    values, claimed = [], []
    for _, part in folds.ledgers:
        claims = option.claims if option.decide is None else option.decide(part)
        claimed.append(tuple(claim.signature for claim in claims))
        values.append(_solve(part, option.prior(fit, claims), hyper)[1].values(ledger.p))
    chance = rate_chance(folds, option.claims)
    left = chance * predict_folds(folds, values)
    variance = prior.variance(hyper.log_tau)
    return SolvedOption(option, posterior, variance, np.array(values), tuple(claimed), chance, left)


def rate_chance(folds: Folds, claims: Sequence[Claim]) -> float:
    """Return by which factor errors of rows never seen are larger than they seem, for forms looked for in all rows.

    The best of t forms is better by chance by 2 log t squares of the noise [FosterGeorge1994], in every fold.

    Args:
        folds: The fit, dealt to folds.
        claims: The claims.
    """
    signatures = folds.fit.search.ledger.signatures
    squares = 2.0 * sum(float(np.log(signatures[claim.signature].tried)) for claim in claims)
    return float(np.sqrt(1.0 + squares / (3 * len(np.unique(folds.pose)))))


def _solve(ledger: Ledger, prior: Prior, hyper: Hyper) -> tuple[Prior, Posterior]:
    """Return the posterior with parameters of which none can be negative at zero where they would be."""
    one_sided = np.zeros(ledger.p, bool)
    for number, signature in enumerate(ledger.signatures):
        if signature.positive:
            one_sided[ledger.columns(number)] = True
    posterior = find_posterior(ledger, prior, hyper, fit=False)
    for _ in range(ACTIVE_SETS):
        wrong = one_sided & (posterior.values(ledger.p) < 0)
        if not wrong.any():
            break
        background, slab = np.where(wrong, -1, prior.background), np.where(wrong, 0.0, prior.slab)
        prior = replace(prior, background=background, slab=slab)
        posterior = find_posterior(ledger, prior, hyper, fit=False)
    return prior, posterior


def predict_folds(folds: Folds, values: Sequence[Array]) -> Array:
    """Return what values without each fold leave of it, to first order, frames fitted to all rows. Shape (r, 3). [m]"""
    fit = folds.fit
    ledger, source = fit.search.ledger, fit.search.ledger.source[0]
    left = np.zeros_like(ledger.observed[0])
    for (number, _), own in zip(folds.ledgers, values, strict=True):
        test, used = folds.fold[source.rows] == number, np.flatnonzero(own)
        left[test] = ledger.observed[0][test] - ledger.designs[0][test][..., used] @ own[used]
    return fit_frames(fit, left * source.sigma, len(np.unique(folds.pose)))


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


def _is_built(signature: Signature) -> bool:
    return signature.name == REGISTRATION or in_background(signature) or in_calibration(signature)


def build_state(fit: Fit, values: Array, first: Sequence[int]) -> FitState:
    """Put values into the exact model.

    Args:
        fit: The fit; its outliers and scatter are kept.
        values: Value of each column, in units of its scale. Shape (p,).
        first: Signatures whose form is kept where several share a column: claims.
    """
    ledger, left = fit.search.ledger, values.copy()
    claimed = sorted(set(first), key=lambda n: -len(ledger.columns(n)))
    rest = [n for n, s in enumerate(ledger.signatures) if n not in first and _is_built(s)]
    effects, kept, registration = list(fit.problem.fixed), dict[str, float](), fit.state.registration
    for number in [*claimed, *rest]:
        signature, columns = ledger.signatures[number], ledger.columns(number)
        if signature.name == REGISTRATION:
            registration = move_registration(registration, signature, left[columns] * signature.scale)
            continue
        if number not in claimed and idle(ledger, columns, left):
            continue
        part = left[columns]
        if signature.positive:
            part = np.maximum(part, 0.0)
        sizes = part * signature.scale
        if signature.least:
            sizes = np.maximum(sizes, signature.least)
        if part.any():
            kept |= {ledger.names[c]: float(size) for c, size in zip(columns, sizes, strict=True)}
            effects.append(signature.effect(sizes))
        left[columns] = 0.0
    return replace(fit.state, effects=tuple(effects), values=kept, registration=registration)


@dataclass(frozen=True, eq=False)
class Blend:
    """A mixture of options.

    Attributes:
        solved: The options.
        weights: Part of each. Shape (k,).
        by_fold: Part of each where a fold is left out, from the other folds. Shape (folds, k).
    """

    solved: tuple[SolvedOption, ...]
    weights: Array
    by_fold: Array

    def values(self, p: int) -> Array:
        """Return the mixed values of all rows. Shape (p,)."""
        return np.asarray(sum(w * s.posterior.values(p) for w, s in zip(self.weights, self.solved, strict=True)))

    def claimed(self) -> list[int]:
        """List the signatures that options with a part in it claim."""
        mixed = [s.option.claims for w, s in zip(self.weights, self.solved, strict=True) if w > 0]
        return sorted({claim.signature for claims in mixed for claim in claims})

    def without(self, fold: int) -> tuple[Array, list[int]]:
        """Return the mixed values without a fold, by its place, and the signatures that are claimed. Shape (p,)."""
        parts = [(w, s) for w, s in zip(self.by_fold[fold], self.solved, strict=True) if w > 0]
        values = np.asarray(sum(w * s.values[fold] for w, s in parts))
        return values, sorted({number for _, s in parts for number in s.claimed[fold]})

    def fitted(self, fit: Fit) -> Fit:
        """Return the fit with the mixture's posterior: the options' own, and how far they are from each other."""
        p = fit.search.ledger.p
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


def list_options(sure: Sequence[Claim], possible: Sequence[Claim], decide: Decide | None) -> list[Option]:
    """List the models that may have a part in the robot that goes out.

    Args:
        sure: Claims that are not in doubt.
        possible: These and others that may be delivered.
        decide: Chooses such claims from a ledger anew, or None where that is not needed.
    """
    every = tuple(range(len(CLASSES)))
    options = [
        Option("nominal"),
        Option("small errors", small=every),
        Option("plain calibration", wide=True),
        Option("plain calibration and small errors", wide=True, small=BESIDE),
    ]
    chosen: list[tuple[str, tuple[Claim, ...], Decide | None]] = []
    if sure:
        chosen.append(("sure causes", tuple(sure), None))
    if len(possible) > len(sure):
        chosen.append(("causes", tuple(possible), decide))
    for name, claims, again in chosen:
        options += [
            Option(name, claims, decide=again),
            Option(f"{name} and small errors", claims, small=every, decide=again),
            Option(f"{name} and plain calibration", claims, wide=True, decide=again),
        ]
    return options


def decide_once(folds: Folds, claims: Sequence[Claim]) -> Decide | None:
    """Return what weighs claims anew in a part of the campaign, asked once for each part: it leaves out and exchanges.

    None where so many poses are there that the choice of a few claims counts for little.

    Args:
        folds: The fit, dealt to folds.
        claims: Claims that may be delivered.
    """
    fit = folds.fit
    if len(np.unique(block_index(fit.problem.campaign))) >= MANY_STAYS:
        return None
    signatures = fit.search.ledger.signatures
    named = {claim.signature for claim in claims}
    allowed = [n for n in fit.search.candidates if n in named or not is_of_instrument(signatures[n].name)]
    decide = folds.decide_again(claims, allowed)
    made: dict[int, Sequence[Claim]] = {}

    def once(ledger: Ledger) -> Sequence[Claim]:
        if id(ledger) not in made:
            made[id(ledger)] = decide(ledger)
        return made[id(ledger)]

    return once


def blend_options(folds: Folds, options: Sequence[Option], seen: NDArray[np.bool_]) -> Blend:
    """Mix options by what they predict of rows that they never saw.

    Args:
        folds: The fit, dealt to folds.
        options: The options.
        seen: Predicted rows that are no outliers. Shape (r,).
    """
    solved = tuple(solve_option(folds, option) for option in options)
    residual = np.stack([s.residual for s in solved])
    fold = folds.fold[folds.fit.search.ledger.source[0].rows]

    def weigh(rows: NDArray[np.bool_]) -> Array:
        return stack_weights(residual[:, rows].reshape(len(solved), -1))

    by_fold = [weigh(seen & (fold != number)) for number, _ in folds.ledgers]
    return Blend(solved, weigh(seen), np.array(by_fold))


def hold_out_lawful(folds: Folds, blend: Blend, seen: NDArray[np.bool_]) -> HeldOut:
    """Predict every row, to first order, by the mixture of those options alone whose every form is a law.

    Args:
        folds: The fit, dealt to folds.
        blend: The mixture of all options.
        seen: Predicted rows that are no outliers. Shape (r,).
    """
    signatures, rows = folds.fit.search.ledger.signatures, folds.fit.search.ledger.source[0].rows
    fold = folds.fold[rows]

    def is_lawful(one: SolvedOption) -> bool:
        numbers = {claim.signature for claim in one.option.claims}.union(*one.claimed)
        return all(signatures[number].lawful for number in numbers)

    residual = np.stack([one.residual for one in blend.solved if is_lawful(one)])
    mixed = np.zeros_like(residual[0])
    for number, _ in folds.ledgers:
        others = seen & (fold != number)
        weights = stack_weights(residual[:, others].reshape(len(residual), -1))
        mixed[fold == number] = np.tensordot(weights, residual[:, fold == number], 1)
    return HeldOut(rows, mixed)


def hold_out_blend(folds: Folds, blend: Blend) -> HeldOut:
    """Predict every row by the exact model of the mixture that the other folds lead to."""
    place = {number: k for k, (number, _) in enumerate(folds.ledgers)}

    def build(number: int, _: Ledger) -> tuple[Fit, FitState]:
        return folds.fit, build_state(folds.fit, *blend.without(place[number]))

    held = folds.hold_out_states(build)
    chance = float(blend.weights @ [one.chance for one in blend.solved])
    return replace(held, residual=chance * held.residual)
