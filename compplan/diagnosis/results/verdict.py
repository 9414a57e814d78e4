"""Verdict: the named effects with their probabilities, and the unexplained rest."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import CERTAIN, ROUNDING, STEPS, beats_chance, rank_number, rms_length
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import Gain
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import representable_forms
from compplan.diagnosis.search.search import SEARCH, Claim, Search, distinct_places
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.bounds import find_breach
from compplan.diagnosis.validation.held_out import take_out_frames
from compplan.diagnosis.validation.probability import (
    BELOW_NOISE,
    AlternativeEffect,
    Evidence,
    calibrate_probability,
    find_alternatives,
    rate_similarities,
)
from compplan.diagnosis.validation.unmodelled import UNMODELLED, RevisedProbabilities
from compplan.effects.signature import Effect
from compplan.robot import Array

#: Least probability of a named effect (theory: more likely than not; the contract of diagnosis.json).
CLAIMED = 0.5
#: Noise floors up to which a gap counts as explained, or as absent (assumed: the project's rule).
FLOORS_LEFT = 1.5


@dataclass(frozen=True)
class NamingSettings:
    """Thresholds of the verdict."""

    #: Largest share of a gap left by calibration with small errors for the status "calibrated" (assumed: the project's
    #: rule).
    calibrated_share: float = 0.2
    #: Residuals below `FLOORS_LEFT` are structure, too, if they gain more log evidence than chance and exceed this
    #: share of the noise floor (assumed: smaller errors cost a campaign nothing).
    structure_size: float = 0.5
    #: Least motion of the target by a named effect, over the noise floor (assumed).
    nameable: float = 0.8
    #: Least share of an unmodelled error for which its driver is reported (assumed).
    mentioned: float = 0.4
    #: Probability of a claim that unmodelled errors explain as well, and of one with an impossible size (assumed).
    refused: float = 1.0 - CERTAIN


NAMING = NamingSettings()
CALIBRATED = "calibrated"


@dataclass(frozen=True)
class Finding:
    """A named effect."""

    effect: Effect  #: The effect, with its parameters.
    probability: float  #: Probability that it, or one indistinguishable from it, is present.
    explained: float  #: Root mean square motion of the target that it explains. [m]
    #: Log posterior odds against the best model without it, unmodelled errors in both; infinite if there is none.
    margin: float
    #: Effects that explain the same, best first; those with `alike` are ambiguous with it.
    rivals: tuple[AlternativeEffect, ...]
    size: float  #: Size of its prior, in units of its scale.
    signature: int  #: Number of its signature in the fit's normal equations.
    evidence: Evidence | None = None  #: Evidence for its probability.
    beyond: str = ""  #: Why no robot of this kind can have this size (`validation.bounds`); empty if one can.


@dataclass(frozen=True)
class Structure:
    """Unexplained error; root mean squares are of 3D distances [m]."""

    gain: float  #: Log evidence gained by unmodelled errors over noise and small errors alone.
    rms: float  #: Residual beyond the noise floor.
    gap: float  #: Gap of the model without effects.
    background: float  #: Motion by small errors.
    explained: float  #: Motion by all named effects together.
    left: bool  #: Whether it counts as structure.
    floor: float  #: Noise floor.
    dependences: tuple[Finding, ...] = ()  #: Drivers of the error that no effect explains, largest first.


@dataclass(frozen=True)
class Verdict:
    """Verdict: status as in diagnosis.json, named effects (largest share first), improbable ones, small ones."""

    status: str
    findings: tuple[Finding, ...]
    doubtful: tuple[Finding, ...]
    minor: tuple[Finding, ...]
    structure: Structure


def reach_verdict(fit: Fit, revised: RevisedProbabilities) -> Verdict:
    """Decide which effects of a finished fit are named."""
    structure = measure_structure(fit, revised)
    similarity = rate_similarities(fit, revised)
    findings = [evaluate_claim(fit, revised, c, similarity[c], structure) for c in revised.model.claims]
    findings = sorted(findings, key=lambda f: -rank_number(f.explained))
    small = NAMING.nameable * structure.floor
    minor = tuple(f for f in findings if f.explained < small and not only_in_readings(fit, revised, f))
    # the motion of claims of impossible size remains unexplained
    structure = replace(structure, left=structure.left or any(f.beyond for f in findings if f not in minor))
    named = tuple(f for f in findings if f.probability >= CLAIMED and f not in minor)
    doubtful = tuple(f for f in findings if f.probability < CLAIMED and f not in minor)
    equations = revised.search.equations
    columns = equations.join_columns(f.signature for f in named)
    structure = replace(
        structure, explained=motion_of(fit.search, columns, revised.model.posterior.values(equations.p))
    )
    if named:
        status = "partly_explained" if structure.left else "explained"
    else:
        status = "none" if structure.gap <= FLOORS_LEFT * structure.floor else "unknown"
    return Verdict(status, named, doubtful, minor, structure)


def drop_insignificant(verdict: Verdict, determined: Collection[int]) -> Verdict:
    """Move named effects without a signature in `determined`, whose size may be zero, to `doubtful`."""
    kept = tuple(f for f in verdict.findings if f.signature < 0 or f.signature in determined)
    if len(kept) == len(verdict.findings):
        return verdict
    status = verdict.status if kept else "unknown"
    dropped = tuple(
        replace(f, probability=min(f.probability, NAMING.refused)) for f in verdict.findings if f not in kept
    )
    return replace(verdict, status=status, findings=kept, doubtful=(*dropped, *verdict.doubtful))


def check_calibration(verdict: Verdict, before: float, after: float) -> Verdict:
    """Set the status "calibrated" for a gap without a named cause if calibration with small errors explains it.

    `before` is the rms held-out error of the nominal robot, `after` that with small errors. [m]
    """
    least = max(FLOORS_LEFT * verdict.structure.floor, NAMING.calibrated_share * before)
    return replace(verdict, status=CALIBRATED) if verdict.status == "unknown" and after <= least else verdict


def evaluate_claim(
    fit: Fit, revised: RevisedProbabilities, claim: Claim, similarity: float, structure: Structure
) -> Finding:
    """Compare the model with the best ones without a claim, unmodelled errors in all of them."""
    values = revised.model.posterior.values(revised.search.equations.p)
    rivals = find_alternatives(fit, claim.signature, values[: fit.search.equations.p])
    margin, share = compare_sets(revised.search, revised.model.claims, revised.model.posterior.hyper, claim, rivals)
    equations = revised.search.equations
    columns = equations.columns(claim.signature)
    signature = equations.signatures[claim.signature]
    explained = motion_of(fit.search, columns, values)
    evidence = Evidence(margin, similarity)
    effect = signature.effect(values[columns] * signature.scale)
    beyond = find_breach(fit, effect, explained, structure.gap)
    return Finding(
        effect=effect,
        probability=NAMING.refused if beyond else share * calibrate_probability(evidence),
        explained=explained,
        margin=margin,
        rivals=tuple(rivals),
        size=claim.size,
        signature=claim.signature,
        evidence=evidence,
        beyond=beyond,
    )


def compare_sets(
    search: Search, claims: Sequence[Claim], hyper: Hyper, claim: Claim, rivals: Sequence[AlternativeEffect]
) -> tuple[float, float]:
    """Compare a set of claims with the best sets without one of them; noise is held.

    A form that contains the claim as a special case (a nonlinear stiffness with a linear part contains a joint's
    stiffness) is the same with more parameters; it is not evidence against the claim.

    Returns:
        Log posterior odds against sets without the claim and all effects alike, infinite if no robot can have one of
        these; and the posterior share of the claim among those alike that the campaign distinguishes from it.
    """
    equations = search.equations
    rest = search.without(claims, claim)
    whole = search.model(claims, hyper, fit=False).score
    if not np.isfinite(whole):
        return -np.inf, 1.0
    without = search.model(rest, hyper, fit=False)
    own, wider = equations.signatures[claim.signature].place, representable_forms(equations, claim.signature)
    alike, competing = {r.place for r in rivals if r.alike}, {r.place for r in rivals if r.competes}
    gains = [(equations.signatures[g.signature].place, g) for g in search.gains(without) if g.signature not in wider]

    def exchange(found: list[Gain]) -> list[float]:
        best = distinct_places(search, found, SEARCH.tried)
        return [search.model((*rest, Claim(g.signature, g.size)), hyper, fit=False).score for g in best]

    others = [without.score, *exchange([g for place, g in gains if place not in alike and place != own])]
    margin = whole - float(np.logaddexp.reduce(others))
    together = np.logaddexp.reduce([whole, *exchange([g for place, g in gains if place in competing])])
    return margin, float(np.exp(whole - together))


def only_in_readings(fit: Fit, revised: RevisedProbabilities, finding: Finding) -> bool:
    """Check whether an effect does not move the target, but exceeds the noise of the encoders."""
    equations = fit.search.equations
    columns = equations.columns(finding.signature)
    values = revised.model.posterior.values(revised.search.equations.p)[columns]
    moves = [rms_length(d[..., columns] @ values) for d in equations.designs]
    return bool(moves[0] < ROUNDING and max(moves) ** 2 > BELOW_NOISE)


def measure_structure(fit: Fit, revised: RevisedProbabilities) -> Structure:
    """Measure the error left by claims and small errors, and what it depends on."""
    equations, posterior, source = revised.search.equations, revised.model.posterior, revised.search.equations.source[0]
    values = posterior.values(equations.p)
    foreign = np.concatenate([np.zeros(0, int), *revised.members]).astype(int)
    values[foreign] = 0.0
    left = (
        equations.observed[0] - equations.designs[0][..., np.flatnonzero(values)] @ values[values != 0]
    ) * source.sigma
    n_values = float(source.n_values.sum())
    used = n_values - count_used(revised, foreign)
    rms = float(np.sqrt(n_values / len(left) * np.sum(left**2) / max(used, 1.0)))
    floor = noise_floor(fit)
    claimed = equations.join_columns(revised.model.signatures)
    frames = equations.columns_named(REGISTRATION)
    small = np.setdiff1d(np.flatnonzero(values), np.concatenate([claimed, frames]))
    beyond = float(np.sqrt(max(rms**2 - floor**2, 0.0)))
    free = fit.search.model(revised.model.claims, fit.model.posterior.hyper, steps=STEPS)
    gain = float(posterior.log_evidence - free.posterior.log_evidence)
    plain = gain > beats_chance(len(revised.classes)) and beyond > NAMING.structure_size * floor
    gap = rms_length(take_out_frames(equations, equations.observed[0]) * source.sigma)
    structure = Structure(
        gain, beyond, gap, motion_of(fit.search, small, values), 0.0,  # nothing is named yet
        bool(rms > FLOORS_LEFT * floor or plain), floor,
    )  # fmt: skip
    return replace(structure, dependences=find_dependences(revised, structure))


def count_used(revised: RevisedProbabilities, foreign: NDArray[np.int_]) -> float:
    """Count the degrees of freedom that claims and small errors take: sum of 1 - posterior over prior variance."""
    posterior, prior = revised.model.posterior, revised.search.prior_of(revised.model.claims)
    variance = prior.variance(posterior.hyper.log_tau)[posterior.columns]
    share = 1.0 - np.diag(posterior.covariance) / np.maximum(variance, 1e-300)
    return float(np.sum(share[~np.isin(posterior.columns, foreign)]))


def find_dependences(revised: RevisedProbabilities, structure: Structure) -> tuple[Finding, ...]:
    """Find the drivers of unmodelled errors, if structure is left."""
    if not structure.left:
        return ()
    equations = revised.search.equations
    values = revised.model.posterior.values(equations.p)
    found = []
    for driver in dict.fromkeys(revised.classes):
        columns = np.concatenate([m for m, d in zip(revised.members, revised.classes, strict=True) if d == driver])
        motion = motion_of(revised.search, columns, values)
        if motion < NAMING.mentioned * max(structure.rms, structure.floor):
            continue
        owners = [n for n, s in enumerate(equations.signatures) if s.name == UNMODELLED]
        owners = [n for n in owners if np.isin(equations.columns(n), columns).all()]
        moves = {n: motion_of(revised.search, equations.columns(n), values) for n in owners}
        largest = equations.signatures[max(moves, key=lambda n: rank_number(moves[n]))]
        effect = Effect(UNMODELLED, largest.joint, driver if largest.joint is None else str(largest.axis))
        found.append(Finding(effect, CLAIMED, motion, structure.gain, (), 1.0, -1))
    return tuple(sorted(found, key=lambda f: -rank_number(f.explained)))


def noise_floor(fit: Fit) -> float:
    """Return the rms 3D distance that a perfect model leaves of a row of the log. [m]"""
    noise, scatter = fit.noises["position"], fit.problem.campaign.scatter
    factor = min(float(np.exp(fit.model.posterior.hyper.log_noise[0])), noise.chance_factor)
    n_values = fit.search.equations.source[0].n_values.mean()
    # of pooled rows: scatter of their means, and of a row about its mean
    return float(np.sqrt(n_values * (factor * noise.sigma**2 + scatter**2 + noise.stay**2)))


def motion_of(search: Search, columns: NDArray[np.int_], values: Array) -> float:
    """Return the root mean square motion by given columns, over all rows. [m]"""
    if not len(columns):
        return 0.0
    equations = search.equations
    return rms_length(equations.designs[0][..., columns] @ values[columns] * equations.source[0].sigma)
