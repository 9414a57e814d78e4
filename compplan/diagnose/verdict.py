"""Verdict: which effects are named, how probable each is, and whether structure is left that none of them explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from compplan.diagnose.ambiguity import Rival, find_rivals, share_explained
from compplan.diagnose.evidence import SHARED_RANGE, WITNESSED, find_posterior
from compplan.diagnose.fit import Fit, search_again
from compplan.diagnose.offers import REGISTRATION
from compplan.diagnose.search import Claim, distinct_places
from compplan.diagnose.unmodelled import UNMODELLED, angle_signatures
from compplan.effects.signature import Effect
from compplan.robot import Array

#: Log odds are divided by this: evidence of real campaigns is less sharp than its model (assumed).
TEMPER = 2.0
MOST_SURE = 0.99
#: An effect is named from this probability on.
CLAIMED = 0.5
#: Rivals of each claim that are fitted in its place.
FITTED_RIVALS = 3
#: Structure is left where an error that stays share gains this much log evidence, and is this large against the noise,
STRUCTURE_GAIN, STRUCTURE_SIZE = 6.0, 0.35
#: or where the noise is this much larger than its estimate (variance, less one),
EXCESS = 0.5
#: or where rows of one kind scatter more than those of another by this factor (variance). Median of chi-square of
#: three.
UNEVEN, MEDIAN_SQUARE = 1.4, 2.366
#: or where small errors everywhere would have to move the target by this many noise floors (then they are not small).
LARGE_BACKGROUND = 6.0
#: or where the exact model leaves this many times what its linearization promises.
DIVERGED = 1.25
#: An error that moves the target less than this share of the noise floor is no cause of a gap and is not named.
NAMEABLE = 0.8
#: Neither is one that is less than this share of the gap where frames were registered (assumed).
NAMEABLE_SHARE = 0.1
#: What shows in the readings alone has to be this many standard deviations large.
PLAIN = 3.0
#: A zero that is off by more than this [rad or m] is counted wrongly, not adjusted badly: centimetres at the tool.
FAR_ZERO = 0.02
#: Names are withheld where the structure left is larger than this share of what they explain. Where even the frames
#: were unknown the robot is far from calibrated, and small causes beside the named ones are no surprise (assumed).
UNTRUSTED, UNTRUSTED_REGISTERED = 0.15, 0.28
#: Greatest probability of a name that a second look gives up.
GIVEN_UP = 0.4
#: Structure counts however small it is where it gains this much log evidence.
PLAIN_STRUCTURE = 25.0


@dataclass(frozen=True)
class Finding:
    """An effect that is named.

    Attributes:
        effect: The effect, with its parameters.
        probability: Probability that it, or one that the campaign cannot tell from it, is present.
        explained: Root mean square motion of the target that it explains. [m]
        margin: Log posterior odds against the best model without it.
        rivals: Effects that explain the same, best first; those with `alike` are ambiguous with it.
        size: Size of its prior, in units of its scale.
        signature: Number of its signature in the fit's ledger.
        apart: Part of `explained` that the errors which no effect explains could not imitate. [m]
    """

    effect: Effect
    probability: float
    explained: float
    margin: float
    rivals: tuple[Rival, ...]
    size: float
    signature: int
    apart: float = np.inf


@dataclass(frozen=True)
class Structure:
    """What no effect explains.

    Attributes:
        gain: Log evidence that an error shared by the rows of a stay gains over noise alone.
        rms: Root mean square of that error, 3D. [m]
        gap: Root mean square gap of the model without effects, 3D. [m]
        background: Root mean square motion that the background of small errors explains, 3D. [m]
        explained: Root mean square motion that all claims together explain, 3D. [m]
        left: Whether it counts as structure.
        dependences: What an error that no effect explains depends on, largest first.
    """

    gain: float
    rms: float
    gap: float
    background: float
    explained: float
    left: bool
    dependences: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes:
        status: "none", "explained", "partly_explained" or "unknown".
        findings: Named effects, largest share of the gap first.
        doubtful: Effects that were considered and are too improbable to be named.
        minor: Effects that are there and too small to be a cause of the gap.
        structure: What is left.
    """

    status: str
    findings: tuple[Finding, ...]
    doubtful: tuple[Finding, ...]
    minor: tuple[Finding, ...]
    structure: Structure


def reach_verdict(fit: Fit) -> Verdict:
    """Judge a finished fit.

    Args:
        fit: The fit.
    """
    structure = measure_structure(fit)
    findings = [weigh_claim(fit, claim) for claim in fit.model.claims]
    findings = sorted((name_far_zero(f) for f in findings), key=lambda f: -f.explained)
    noise = fit.noises["position"].sigma * float(np.exp(0.5 * fit.model.posterior.hyper.log_noise[0]))
    small = NAMEABLE * np.sqrt(3.0) * noise
    foreign = [f for f in findings if f.effect.name == UNMODELLED]
    findings = [f for f in findings if f.effect.name != UNMODELLED]
    foreign = [f for f in foreign if f.explained >= small and f.probability >= CLAIMED]
    if foreign:
        numbers = [f.signature for f in foreign]
        shares = [share_explained(fit, f.signature, numbers) for f in findings]
        findings = [set_apart(f, share, small) for f, share in zip(findings, shares, strict=True)]
    if structure.left:
        limit = UNTRUSTED_REGISTERED if fit.problem.register else UNTRUSTED
        findings = [replace(f, probability=f.probability * trust_in(f, structure, limit)) for f in findings]
    structure = add_dependences(structure, foreign)
    if fit.problem.register:
        # where even the frames were unknown the robot is far from calibrated: what is small beside the gap is no cause
        small = max(small, NAMEABLE_SHARE * structure.gap)
    minor = tuple(f for f in findings if f.explained < small and not only_in_readings(fit, f))
    named = tuple(f for f in findings if f.probability >= CLAIMED and f not in minor)
    doubtful = tuple(f for f in findings if f.probability < CLAIMED and f not in minor)
    if named:
        status = "partly_explained" if structure.left else "explained"
    else:
        status = "unknown" if structure.left or any(f.margin > 5.0 for f in doubtful) else "none"
    return Verdict(status, named, doubtful, minor, structure)


def look_again(fit: Fit, verdict: Verdict) -> Verdict:
    """Doubt the names that a search gives up as soon as errors of joints may follow other joints' angles.

    A robot that is not calibrated has errors that no effect of the vocabulary makes; some effects imitate them well.

    Args:
        fit: The fit, without such errors.
        verdict: Its verdict.
    """
    second = search_again(fit, angle_signatures(fit.at))
    ledger = second.search.ledger
    kept = {ledger.signatures[n].place for n in second.model.signatures}
    given_up = [f for f in verdict.findings if f.signature >= 0 and f.effect.place not in kept]
    doubted = [replace(f, probability=min(f.probability, GIVEN_UP)) for f in given_up]
    foreign = [weigh_claim(second, c) for c in second.model.claims if ledger.signatures[c.signature].name == UNMODELLED]
    foreign = [f for f in foreign if f.explained >= NAMEABLE_SHARE * verdict.structure.gap and f.probability >= CLAIMED]
    named = tuple(f for f in verdict.findings if f not in given_up)
    structure = add_dependences(verdict.structure, foreign)
    status = verdict.status
    if structure.left:
        status = "partly_explained" if named else "unknown"
    return replace(
        verdict, status=status, findings=named, doubtful=(*verdict.doubtful, *doubted), structure=structure
    )


def set_apart(finding: Finding, share: float, small: float) -> Finding:
    """Doubt an effect as far as errors that no effect explains could have left its trace.

    Args:
        finding: The effect.
        share: Share of its trace that those errors can explain.
        small: Motion below which an error is no cause. [m]
    """
    apart = finding.explained * float(np.sqrt(1.0 - share))
    return replace(finding, apart=apart, probability=float(finding.probability * apart**2 / (apart**2 + small**2)))


def add_dependences(structure: Structure, dependences: Sequence[Finding]) -> Structure:
    """Count errors that follow something, and that no effect explains, as structure."""
    if not dependences:
        return structure
    rest = structure.rms if structure.left else 0.0
    rms = float(np.sqrt(rest**2 + sum(f.explained**2 for f in dependences)))
    return replace(structure, left=True, rms=rms, dependences=tuple(dependences))


def name_far_zero(finding: Finding) -> Finding:
    """Name an offset that no adjustment could leave joint_coupling, a matter of counting; the offset is its rival."""
    effect = finding.effect
    size = abs(float(next(iter(effect.parameters.values())))) if effect.name == "joint_offset" else 0.0
    if size < FAR_ZERO:
        return finding
    key = "zero_m" if "offset_m" in effect.parameters else "zero_rad"
    counted = Effect("joint_coupling", effect.joint, None, {key: next(iter(effect.parameters.values()))})
    rivals = tuple(r for r in finding.rivals if r.place != counted.place)
    return replace(finding, effect=counted, rivals=(Rival(effect.place, 1.0, 0.0, 1), *rivals))


def only_in_readings(fit: Fit, finding: Finding) -> bool:
    """Tell whether an effect does not move the target at all, but shows plainly in the encoders."""
    columns = fit.search.ledger.columns(finding.signature)
    values = fit.model.posterior.values(fit.search.ledger.p)[columns]
    moves = [np.sqrt(np.mean(np.sum((d[..., columns] @ values) ** 2, axis=1))) for d in fit.search.ledger.designs]
    return bool(moves[0] < 1e-6 and max(moves) > PLAIN)


def trust_in(finding: Finding, structure: Structure, limit: float) -> float:
    """Return how far a name can be trusted where structure is left: a cause explains far more than it leaves.

    What is left is compared with the geometric mean of what the effect and all effects together explain: a small effect
    of many that together explain nearly everything is no imitation.

    Args:
        finding: The effect.
        structure: What is left.
        limit: Ratio at which a name is worth half.
    """
    alone = min(finding.explained, structure.gap)
    together = min(max(structure.explained, alone), structure.gap)
    ratio = structure.rms / max(np.sqrt(alone * together), 1e-12)
    return float(1.0 / (1.0 + (ratio / limit) ** 4))


def weigh_claim(fit: Fit, claim: Claim) -> Finding:
    """Compare the model with the best ones that lack a claim."""
    search, model = fit.search, fit.model
    ledger = search.ledger
    rivals = find_rivals(fit, claim.signature)
    alike = {r.place for r in rivals if r.alike}
    rest = [c for c in model.claims if c != claim]
    without = search.model(rest, model.posterior.hyper)
    scores = [without.score]
    frozen = search.model(rest, model.posterior.hyper, fit=False)
    own = ledger.signatures[claim.signature].place
    gains = [g for g in search.gains(frozen) if ledger.signatures[g.signature].place not in alike | {own}]
    for gain in distinct_places(search, gains, FITTED_RIVALS):
        if frozen.score + gain.log_evidence > model.score - 25.0:
            tried = search.model((*rest, Claim(gain.signature, gain.size)), model.posterior.hyper)
            scores.append(tried.score)
    margin = float(model.score - logsumexp(scores))
    probability = min(float(expit(margin / TEMPER)), MOST_SURE)
    values = model.posterior.values(ledger.p)
    columns = ledger.columns(claim.signature)
    signature = ledger.signatures[claim.signature]
    return Finding(
        effect=signature.effect(values[columns] * signature.scale),
        probability=probability,
        explained=_motion(fit, columns, values),
        margin=margin,
        rivals=tuple(rivals),
        size=claim.size,
        signature=claim.signature,
    )


def measure_structure(fit: Fit) -> Structure:
    """Measure what is left: errors that rows of a stay share, beyond noise and background."""
    model, ledger = fit.model, fit.search.ledger
    prior = fit.search.prior_of(model.claims)
    silent = replace(model.posterior.hyper, log_shared=np.full_like(model.posterior.hyper.log_shared, SHARED_RANGE[0]))
    alone = find_posterior(ledger, prior, silent, shared=False)
    gain = model.posterior.log_evidence - alone.log_evidence
    hyper, noise = model.posterior.hyper, fit.noises["position"]
    sigma = noise.sigma * float(np.exp(0.5 * hyper.log_noise[0]))
    shared = float(np.exp(hyper.log_shared[0]))
    values = model.posterior.values(ledger.p)
    claimed = ledger.join_columns(n for n in model.signatures if ledger.signatures[n].name != UNMODELLED)
    apart = ledger.columns_named(REGISTRATION, UNMODELLED)
    others = np.setdiff1d(np.flatnonzero(values), np.concatenate([claimed, apart]))
    factor = float(np.exp(hyper.log_noise[0]))
    excess = factor - 1.0 if noise.witnesses >= WITNESSED and factor > noise.leeway else 0.0
    uneven = uneven_scatter(fit, values)
    excess = max(excess, uneven)
    rms = np.sqrt(3.0) * np.sqrt((sigma * shared) ** 2 + excess * noise.sigma**2)
    left = (gain > STRUCTURE_GAIN and shared > STRUCTURE_SIZE) or gain > PLAIN_STRUCTURE or excess > EXCESS
    expected = np.sqrt(np.mean(np.sum(ledger.left(values)[0] ** 2, axis=1))) * noise.sigma
    if fit.exact > DIVERGED * expected:
        # the exact model does not do what its derivatives promise: what was fitted is no cause
        rms, left = max(rms, float(np.sqrt(fit.exact**2 - expected**2))), True
    background = _motion(fit, others, values)
    if background > LARGE_BACKGROUND * np.sqrt(3.0) * noise.sigma and noise.witnesses >= WITNESSED:
        rms, left = np.hypot(rms, background), True
    gap = np.sqrt(np.mean(np.sum(ledger.observed[0] ** 2, axis=1))) * noise.sigma
    explained = _motion(fit, claimed, values)
    return Structure(float(gain), float(rms), float(gap), background, explained, bool(left))


def uneven_scatter(fit: Fit, values: Array) -> float:
    """Return by how much the rows of one kind scatter more than those of another, in units of the noise variance.

    Kinds are rest and motion, and with and without load. Zero where they scatter alike or are too few.
    """
    channel, campaign = fit.channels[0], fit.problem.campaign
    square = np.sum(fit.search.ledger.left(values)[0] ** 2, axis=1)
    worst = 0.0
    for kind in (campaign.on_path, campaign.unloaded):
        inside = kind[channel.rows]
        if min(inside.sum(), (~inside).sum()) < 20:
            continue
        pair = sorted((float(np.median(square[inside])), float(np.median(square[~inside]))))
        spread = 2.5 * np.sqrt(1.0 / inside.sum() + 1.0 / (~inside).sum())
        if pair[1] > pair[0] * np.exp(3.0 * spread) * UNEVEN:
            worst = max(worst, (pair[1] - pair[0]) / MEDIAN_SQUARE)
    return worst


def _motion(fit: Fit, columns: NDArray[np.int_], values: Array) -> float:
    """Return the root mean square motion that some columns explain, over all rows. [m]"""
    if not len(columns):
        return 0.0
    moved = fit.search.ledger.designs[0][..., columns] @ values[columns] * fit.noises["position"].sigma
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1))))
