"""Search: the set of effects with the largest posterior, found by adding, exchanging and removing effects."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import STEPS, rank_evidence
from compplan.diagnosis.evidence.evidence import (
    EVIDENCE,
    SIZES,
    Gain,
    Posterior,
    Prior,
    drop_negative,
    find_gains,
    find_posterior,
)
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.effects import gravity_sag
from compplan.effects.linearization import Place
from compplan.effects.signature import Signature
from compplan.robot import Array

#: Effects that require a compliance, and those that make a rigid robot compliant (as does weight on its joints).
BENDING = ("payload", "gravity_compensator", "gravity_sag", "stiffness_nonlinearity", "wrench_bias", "wrench_scale")
SOFT = ("joint_stiffness", "link_compliance", "base_compliance")
#: Effects that are curves over a joint's angle.
CURVES = ("transmission_error", "gravity_compensator")
#: Effects that occur at most once in most campaigns.
SHIFTS = ("frame_shift", "tool_shift")


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search for sets of effects."""

    #: Largest gain in log posterior by refitting noise and background (assumed: larger gains were not observed).
    close: float = 12.0
    #: Standard deviation of the logarithm of an effect's size about its scale (assumed: two thirds of all effects lie
    #: within a factor of five). [decades]
    decades: float = 0.7
    #: Log prior odds against two curves at one joint, and against each shift after the first of its kind (assumed).
    once_more: float = 10.0
    #: Number of places tried with refitted noise and background: to add a claim, to replace one, and as rivals of one
    #: (assumed).
    tried: int = 4
    #: Most effects of one campaign (assumed: several times the effects of any robot).
    most_effects: int = 24
    #: Least gain in log posterior of an exchange or an addition (assumed: less does not justify a larger model).
    least_gain: float = 0.5
    #: Most rounds of linearization and search (assumed: most campaigns converge in five).
    rounds: int = 8
    #: Round whose residuals give the noise; scores are compared from the next round on (assumed: the first model has
    #: removed backlash and drift from repeated poses).
    noise_round: int = 1
    #: Convergence: largest motion of an observation over its noise. Classes of the background below it are left out of
    #: the model (assumed: a hundredth of its variance).
    tolerance: float = 0.1
    #: Single background errors that move the target by less than this share of the noise are left out (assumed).
    negligible: float = 0.03


SEARCH = SearchSettings()


@dataclass(frozen=True)
class Claim:
    """A selected effect: number of its signature, and its prior size."""

    signature: int
    size: float


@dataclass(frozen=True, eq=False)
class Model:
    """A set of claims with its posterior; the score is log evidence plus log prior of the set."""

    claims: tuple[Claim, ...]
    posterior: Posterior
    score: float

    @property
    def signatures(self) -> tuple[int, ...]:
        """Numbers of the claimed signatures."""
        return tuple(claim.signature for claim in self.claims)


@dataclass(eq=False)
class Search:
    """Normal equations with their prior, and a cache of evaluated models.

    `log_prior` holds the log prior odds of each signature, `candidates` the numbers of claimable signatures, `start`
    the initial noise and background, `most` the greatest parameters of each signature that a robot folder can hold
    [SI]; `rigid`: whether only claims make the robot compliant.
    """

    equations: NormalEquations
    prior: Prior
    log_prior: Array
    candidates: Sequence[int]
    start: Hyper
    most: Sequence[Array]
    rigid: bool
    cache: dict[frozenset[Claim], Model] = field(default_factory=dict)

    def without(self, claims: Sequence[Claim], *removed: Claim) -> list[Claim]:
        """Remove claims; on a robot that becomes rigid also remove claims that require a compliance."""
        rest = [c for c in claims if c not in removed]
        signatures = [self.equations.signatures[c.signature] for c in rest]
        if not self.rigid or any(is_soft(s) for s in signatures):
            return rest
        return [c for c, s in zip(rest, signatures, strict=True) if is_soft(s) or s.name not in BENDING]

    def prior_of(self, claims: Sequence[Claim]) -> Prior:
        """Return the prior with these claims."""
        slab, background = self.prior.slab.copy(), self.prior.background.copy()
        for claim in claims:
            for columns in self.same_place[claim.signature]:
                background[columns] = -1
            slab[self.equations.columns(claim.signature)] = claim.size**2
        return replace(self.prior, background=background, slab=slab)

    @cached_property
    def same_place(self) -> list[list[NDArray[np.int_]]]:
        """Background columns that a claim of each signature replaces."""
        by_place: dict[Place, list[NDArray[np.int_]]] = {}
        for number, signature in enumerate(self.equations.signatures):
            columns = self.equations.columns(number)
            columns = columns[self.prior.background[columns] >= 0]
            if len(columns):
                by_place.setdefault(signature.place, []).append(columns)
        return [by_place.get(signature.place, []) for signature in self.equations.signatures]

    def model(self, claims: Sequence[Claim], hyper: Hyper, *, fit: bool = True, steps: int = STEPS) -> Model:
        """Return the model of a set of claims, from the cache if it was evaluated before."""
        key = frozenset(claims)
        if fit and key in self.cache:
            return self.cache[key]
        equations, prior = self.equations, self.prior_of(claims)
        posterior = find_posterior(equations, prior, hyper, fit=fit, steps=steps)
        signatures = ((n, equations.signatures[n]) for n in (claim.signature for claim in claims))
        bounded = equations.join_columns(n for n, s in signatures if s.positive and len(s.keys) > 1)
        posterior = drop_negative(equations, prior, posterior, bounded)[1]
        score = posterior.log_evidence + sum(self.log_prior[c.signature] + log_prior_size(c.size) for c in claims)
        score -= SEARCH.once_more * self._count_repeated(claims)
        if self._backwards(claims, posterior) or len(self.without(claims)) < len(claims):
            score = -np.inf
        model = Model(tuple(claims), posterior, float(score))
        if fit:
            self.cache[key] = model
        return model

    def _count_repeated(self, claims: Sequence[Claim]) -> int:
        """Count joints with two claimed curves over the same angle, and shifts after the first of each kind."""
        signatures = [self.equations.signatures[c.signature] for c in claims]
        kinds = [s.joint if s.name in CURVES else s.name for s in signatures if s.name in (*CURVES, *SHIFTS)]
        return len(kinds) - len(set(kinds))

    def _backwards(self, claims: Sequence[Claim], posterior: Posterior) -> bool:
        """Check whether a claim has an impossible parameter: negative backlash or compliance, or beyond its limit."""
        values = posterior.values(self.equations.p)
        for claim in claims:
            signature, columns = self.equations.signatures[claim.signature], self.equations.columns(claim.signature)
            sizes = values[columns] * signature.scale
            if (signature.positive and (sizes < 0).any()) or (signature.least and (sizes < signature.least).any()):
                return True
            if (np.abs(sizes) > self.most[claim.signature]).any():
                return True
        return False

    def gains(self, model: Model) -> list[Gain]:
        """Compute the gains of further claims, best first; prior odds included."""
        used_events = {self.equations.signatures[number].event for number in model.signatures}
        used = {int(column) for number in model.signatures for column in self.equations.columns(number)}
        free = [n for n, event, columns in self._placed if event not in used_events and used.isdisjoint(columns)]
        gains = find_gains(self.equations, model.posterior, free)
        # a gain is a mean over sizes, and the best size dominates it
        odds, several = self.log_prior.tolist(), float(np.log(len(SIZES)))
        of_size = {size: log_prior_size(size) for size in SIZES}
        scored = [
            Gain(g.signature, g.log_evidence + several + (odds[g.signature] + of_size[g.size]), g.size) for g in gains
        ]
        return sorted(scored, key=lambda g: -rank_evidence(g.log_evidence))

    @cached_property
    def _placed(self) -> list[tuple[int, tuple[str | int | None, ...], list[int]]]:
        """Number, event and columns of each candidate."""
        return [(n, self.equations.signatures[n].event, self.equations.columns(n).tolist()) for n in self.candidates]


def is_soft(signature: Signature) -> bool:
    """Check whether a form makes a rigid robot compliant."""
    return signature.name in SOFT or (signature.name == "gravity_sag" and signature.form == gravity_sag.JOINTS)


def log_prior_size(size: float) -> float:
    """Return the log probability of a size: log-normal about the scale of the effect."""
    weights = np.exp(-0.5 * (np.log10(SIZES) / SEARCH.decades) ** 2)
    return float(-0.5 * (np.log10(size) / SEARCH.decades) ** 2 - np.log(weights.sum()))


def search_models(search: Search, first: Sequence[Claim] = (), most: int = SEARCH.most_effects) -> Model:
    """Find the best set of effects: rounds of additions, exchanges and removals until none is worthwhile."""
    best = search.model(first, search.start, steps=EVIDENCE.first_steps)
    concerned = set(best.claims)
    for _ in range(SEARCH.most_effects):
        grown = best if len(best.claims) >= most else add_claim(search, best)
        changed = _exchange(search, _remove(search, grown), concerned | (set(grown.claims) - set(best.claims)))
        concerned = set()
        if changed.score < best.score + SEARCH.least_gain:
            return best if best.score >= changed.score else changed
        best = changed
    return best


def search_from_forward_selection(search: Search, found: Model, most: int) -> Model:
    """Return the better of a found model and one searched from a forward selection without small errors.

    Stepwise search ends in a local optimum, where small errors may compensate for a wrong first effect.
    """
    bare = replace(search, prior=replace(search.prior, background=np.full_like(search.prior.background, -1)), cache={})
    first = bare.model([], search.start, steps=EVIDENCE.first_steps)
    while len(first.claims) < most:
        grown = add_claim(bare, first)
        if grown.score < first.score + SEARCH.least_gain:
            break
        first = grown
    # noise and background are fitted from their start: models in the cache were fitted from another one
    afresh = replace(search, cache={})
    possible = np.isfinite(afresh.model(first.claims, search.start, steps=EVIDENCE.first_steps).score)
    other = search_models(afresh, first.claims if possible else (), most)
    return other if other.score > found.score + SEARCH.least_gain else found


def distinct_places(search: Search, gains: list[Gain], count: int) -> list[Gain]:
    """Return the best gain of each place, of the first `count` places.

    The form in the place's background is included: its gain is small because the background already explains it.
    """
    seen: set[Place] = set()
    result = []
    for gain in gains:
        place = search.equations.signatures[gain.signature].place
        inside = bool((search.prior.background[search.equations.columns(gain.signature)] >= 0).all())
        if place not in seen and len(seen) == count:
            break
        if place not in seen or inside:
            seen.add(place)
            result.append(gain)
    return result


def add_claim(search: Search, model: Model) -> Model:
    """Return the model with the claim that gains most, noise and background refitted; or the unchanged model."""
    best = model
    gains = distinct_places(search, search.gains(model), SEARCH.tried)
    for gain in gains:
        if gain.log_evidence < -SEARCH.close:
            break
        tried = search.model((*model.claims, Claim(gain.signature, gain.size)), model.posterior.hyper)
        if rank_evidence(tried.score) > rank_evidence(best.score):
            best = tried
    return best


def _remove(search: Search, model: Model) -> Model:
    while model.claims:
        # claims with a gain above their prior odds and the possible gain of a refit are not tried for removal
        price = {c: SEARCH.close - search.log_prior[c.signature] - log_prior_size(c.size) for c in model.claims}
        columns = search.equations.columns
        weak = [c for c in model.claims if model.posterior.loss_without(columns(c.signature)) < price[c]]
        smaller = [search.model(search.without(model.claims, claim), model.posterior.hyper) for claim in weak]
        best = max(smaller, key=lambda m: rank_evidence(m.score), default=model)
        if best.score <= model.score:
            return model
        model = best
    return model


def _exchange(search: Search, model: Model, concerned: Collection[Claim]) -> Model:
    """Try to replace claims by effects that explain the campaign better, other forms of the same place included."""
    for claim in model.claims:
        if claim not in model.claims or claim not in concerned:
            continue
        rest = search.without(model.claims, claim)
        reduced = search.model(rest, model.posterior.hyper, fit=False)
        gains = search.gains(reduced)
        for gain in [*distinct_places(search, gains, SEARCH.tried), *forms_of(search, gains, claim)]:
            same = gain.signature == claim.signature and gain.size == claim.size
            if same or reduced.score + gain.log_evidence < model.score - SEARCH.close:
                continue
            tried = search.model((*rest, Claim(gain.signature, gain.size)), model.posterior.hyper)
            if tried.score > model.score + SEARCH.least_gain:
                model = tried
    return model


def forms_of(search: Search, gains: list[Gain], claim: Claim) -> list[Gain]:
    """Return the best forms at a claim's place."""
    place = search.equations.signatures[claim.signature].place
    return [g for g in gains if search.equations.signatures[g.signature].place == place][: SEARCH.tried]
