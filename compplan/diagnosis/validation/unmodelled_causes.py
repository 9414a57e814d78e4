"""Re-estimate the claims of a fit with nonparametric terms for causes outside the vocabulary.

An unknown cause makes a smooth error over the place of the target, time, load, angles of other joints, direction of
approach or past load. These errors enter the model as classes of small errors, each of a size fitted to the campaign
(half-Cauchy prior, scale one noise floor). A claim that only fits an unknown cause loses its evidence to them. What
they explain is the structure that no effect explains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import STEPS, rank_evidence
from compplan.diagnosis.evidence.evidence import FIRST_STEPS, START, Prior, find_posterior
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import NormalEquations, extend_normal_equations
from compplan.diagnosis.evidence.unmodelled import unmodelled_signatures
from compplan.diagnosis.search.search import WORTHWHILE, Model, Search, add_claim
from compplan.diagnosis.search.state import Fit
from compplan.effects.signature import Signature

Indices = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class RevisedProbabilities:
    """Claims of a fit, re-estimated with unmodelled errors.

    Attributes:
        search: The search whose prior holds unmodelled errors.
        model: The remaining claims, with the posterior of all columns.
        classes: What each loose class follows, in the order of the posterior's last `log_tau`.
        members: Columns of each loose class.
    """

    search: Search
    model: Model
    classes: tuple[str, ...]
    members: tuple[Indices, ...]


def foreign_signatures(fit: Fit) -> list[Signature]:
    """List the unmodelled errors, without those that another one contains."""
    found = []
    for signature in unmodelled_signatures(fit.at):
        form, driver = signature.form, str(signature.axis)
        inside = form in ("degree 1", "degree 2", "frame", "joints", "link")
        inside |= form == "linear" and driver.startswith("an unknown force")
        # links that bend about the axis of their load are an effect of the vocabulary, unless it is left out
        inside |= form == "bending" and "link_compliance" not in fit.problem.without
        if not inside:
            found.append(signature)
    return found


def class_of(signature: Signature) -> tuple[str, str]:
    """Return what a class follows, and "scale" for a scale error; joints share a class."""
    driver = str(signature.axis)
    if driver.startswith("the angle of"):
        driver = "the angles of other joints"
    if driver.startswith("the load on"):
        driver = "the load on other joints"
    return driver, "scale" if signature.form == "scale" else ""


def revise_probabilities(fit: Fit, progress: Callable[[str], None] = lambda text: None) -> RevisedProbabilities:
    """Re-estimate the claims of a fit with unmodelled errors in the model."""
    fresh = foreign_signatures(fit)
    old = fit.search.equations
    equations = extend_normal_equations(old, fresh)
    kinds = list(dict.fromkeys(class_of(s) for s in fresh))
    numbers = range(len(old.signatures), len(equations.signatures))
    members = tuple(
        equations.join_columns(n for n in numbers if class_of(equations.signatures[n]) == kind) for kind in kinds
    )
    prior = _loosen(fit, equations, members)
    hyper = fit.model.posterior.hyper
    hyper = Hyper(hyper.log_noise, hyper.log_shared, np.concatenate([hyper.log_tau, np.full(len(kinds), START)]))
    odds = np.concatenate([fit.search.log_prior, np.full(len(fresh), -np.inf)])
    search = Search(equations, prior, odds, fit.search.candidates, hyper, progress=progress, rigid=fit.search.rigid)
    model = _search_again(search, search.model(fit.model.claims, hyper, steps=FIRST_STEPS))
    if model.claims:
        # several claims together may fit one unmodelled error: start once more without claims, classes one noise floor
        grown = replace(hyper, log_tau=np.where(prior.loose, 0.0, hyper.log_tau))
        other = _search_again(search, search.model([], grown, steps=FIRST_STEPS))
        model = other if other.score > model.score + WORTHWHILE else model
    return RevisedProbabilities(search, model, tuple(driver for driver, _ in kinds), members)


def _loosen(fit: Fit, equations: NormalEquations, members: Sequence[Indices]) -> Prior:
    """Extend a prior by the classes of unmodelled errors, in units of the noise floor."""
    old = fit.search.prior
    count, classes = equations.p - len(old.slab), len(fit.model.posterior.hyper.log_tau)
    background = np.concatenate([old.background, np.full(count, -1)])
    floor = np.sqrt(3.0) * fit.noises["position"].sigma
    spread = np.concatenate([old.spread, np.full(count, floor)])
    for number, columns in enumerate(members):
        background[columns] = classes + number
    free = np.concatenate([old.free, np.zeros(count, bool)])
    loose = np.arange(classes + len(members)) >= classes
    return Prior(background, spread, free, np.zeros(equations.p), loose)


def _search_again(search: Search, model: Model) -> Model:
    """Remove claims that unmodelled errors explain as well, and add those whose evidence this raises."""
    while True:
        here = search.model(model.claims, model.posterior.hyper, fit=False)
        best = _leave_out(search, here)
        if best.score <= here.score:
            best = add_claim(search, model)
            if best.score < model.score + WORTHWHILE:
                return model
        fitted = search.model(best.claims, best.posterior.hyper, steps=STEPS)
        if fitted.score <= model.score:
            return model
        model = fitted


def _leave_out(search: Search, model: Model) -> Model:
    """Return the best model with one claim less, unmodelled errors fitted anew."""
    loose = search.prior.loose
    hyper = model.posterior.hyper
    grown = replace(hyper, log_tau=np.where(loose, np.maximum(hyper.log_tau, 0.0), hyper.log_tau))
    best = replace(model, score=-np.inf)
    for out in model.claims:
        rest = search.without(model.claims, out)
        held, start = search.model(rest, hyper, fit=False), search.model(rest, grown, fit=False)
        posterior = find_posterior(search.equations, search.prior_of(rest), grown, steps=STEPS)
        score = start.score - start.posterior.log_evidence + posterior.log_evidence
        best = max(best, held, Model(tuple(rest), posterior, score), key=lambda m: rank_evidence(m.score))
    return best
