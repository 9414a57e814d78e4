"""Options: the models that the delivered robot is mixed of, each fitted without every fold of poses in turn.

Nominal robot, plain calibration, small errors of every class, alone and beside the causes, and sparse calibration.
Claims, and prior widths and noise of all but the sparse model, are those of all rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.diagnosis.data.shared import STEPS
from compplan.diagnosis.evidence.candidates import CLASSES, REGISTRATION, in_background
from compplan.diagnosis.evidence.evidence import Posterior, Prior, drop_negative, find_posterior
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.held_out import Folds, fit_frames
from compplan.diagnosis.validation.sparse import average_stays, posterior_of, solve_sparse
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


#: Everything that a calibration fits, and nothing else.
PLAIN = Option("plain calibration", wide=True)


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


def list_options(claims: Sequence[Claim]) -> list[Option]:
    """List the models that the delivered robot may be mixed of."""
    every = tuple(range(len(CLASSES)))
    return [
        Option("nominal"),
        Option("small errors", small=every),
        PLAIN,
        *([Option("causes and small errors", tuple(claims), small=every)] if claims else []),
        Option("sparse calibration", tuple(claims), sparse=True),
    ]
