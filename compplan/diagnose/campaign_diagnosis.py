"""Diagnose a campaign: conventions, registration, fit, verdict, held-out gap, updated robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.channels import position_residual
from compplan.diagnose.conventions import find_conventions
from compplan.diagnose.evidence import WITNESSED, Hyper, Posterior, find_posterior
from compplan.diagnose.fit import (
    Fit,
    Problem,
    State,
    advance_state,
    bend_forwards,
    fit_effects,
    linearize_state,
    stands,
)
from compplan.diagnose.held_out import HeldOut, hold_out, make_folds, prior_of
from compplan.diagnose.polish import polish_fit
from compplan.diagnose.result import Candidate, Diagnosis, Gap
from compplan.diagnose.search import Claim, distinct_places
from compplan.diagnose.unmodelled import UNMODELLED
from compplan.diagnose.verdict import Finding, Verdict, look_again, reach_verdict
from compplan.effects import attain_scene, fold_effects, robot_effects
from compplan.effects.linearization import Place
from compplan.effects.scene import Scene
from compplan.errors import InputError
from compplan.measure.campaign import Campaign
from compplan.measure.registration import Registration, fit_registration, stated_registration
from compplan.robot import Array, Robot

#: An updated robot has to shrink the held-out gap by this share, or the nominal one stays.
WORTH_IT = 0.01
#: The same where structure is left that no effect explains.
WORTH_IT_IN_DOUBT = 0.1
RANKED = 12
FEWEST_ROWS = 12
#: Claims that need no second look where no structure is left.
PLAIN_CLAIMS = 1
#: What a row called outlier costs an explanation, log posterior (assumed).
OUTLIER_COST = 10.0
#: Noise variance over its estimate beyond which the estimate stands for the floor and the rest is structure.
EXCESS = 1.3


def diagnose_campaign(
    robot: Robot, campaign: Campaign, *, register: Sequence[str] = (), without: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:  # fmt: skip
    """Find which effects make the gap between a robot model and a measured campaign.

    Args:
        robot: The nominal robot; effects of its effects.toml count as known.
        campaign: What was measured.
        register: Frames that no model can know, of "base" and "tool"; they are fitted in every model.
        without: Effects to leave out of the candidates.
        progress: Told what is being done.

    Raises:
        InputError: If the campaign has too few rows.
    """
    if campaign.usable.sum() < FEWEST_ROWS:
        raise InputError(
            f"{int(campaign.usable.sum())} usable rows, expected at least {FEWEST_ROWS}", file=campaign.file
        )
    parts = tuple(register)
    known = robot_effects(robot)
    progress("conventions")
    conventions = () if "joint_coupling" in without else find_conventions(robot, campaign, parts)
    problem = Problem(robot, campaign, parts, tuple(without), (*known, *conventions))
    registration, nominal = _register(replace(problem, fixed=known), campaign)
    started = _register(problem, campaign)[0] if conventions else registration
    fit = polish_fit(fit_effects(problem, started, ~campaign.first_visit, progress))
    progress("verdict")
    verdict = reach_verdict(fit)
    if parts:
        verdict = look_again(fit, verdict)
    elif verdict.structure.left or len(fit.model.claims) > PLAIN_CLAIMS:
        # free shapes would take the many errors of a robot that is not calibrated; where frames are known, it is
        free = replace(problem, unmodelled=True)
        other = polish_fit(fit_effects(free, started, ~campaign.first_visit, progress))
        if rate_fit(other) > rate_fit(fit):
            progress("verdict")
            fit, verdict = other, reach_verdict(other)
    verdict = _with_conventions(verdict, problem, len(known))
    return _conclude(fit, verdict, nominal, registration, len(known), progress)


def rate_fit(fit: Fit) -> float:
    """Rate a finished fit by its log posterior, rows that it calls outliers paid for."""
    return fit.model.score - OUTLIER_COST * len(fit.outliers)


def _register(problem: Problem, campaign: Campaign) -> tuple[Registration | None, Scene]:
    """Fit the registration of the nominal robot."""
    state = State(problem.fixed, {}, None, campaign.usable)
    scene = linearize_state(problem, state).scene
    if not problem.register:
        stated = stated_registration(campaign)
        return stated, replace(scene, registration=stated)
    attained = attain_scene(scene)
    registration = fit_registration(campaign, attained.position, attained.rotation, problem.register)
    return registration, replace(scene, registration=registration)


def _with_conventions(verdict: Verdict, problem: Problem, known: int) -> Verdict:
    """Put conventions that were found beforehand first among the findings."""
    found = tuple(Finding(effect, 0.99, float("inf"), 100.0, (), 1.0, -1) for effect in problem.fixed[known:])
    if not found:
        return verdict
    status = {"none": "explained", "unknown": "partly_explained"}.get(verdict.status, verdict.status)
    return replace(verdict, findings=(*found, *verdict.findings), status=status)


def _conclude(
    fit: Fit, verdict: Verdict, nominal: Scene, registration: Registration | None, known: int,
    progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """Hold out, choose the updated robot, and collect the record."""
    problem, campaign = fit.problem, fit.problem.campaign
    progress("held out")
    folds = make_folds(campaign)
    named = [f.signature for f in (*verdict.findings, *verdict.minor) if f.signature >= 0]
    claims = [c for c in fit.model.claims if c.signature in named]
    plain = hold_out(fit, prior_of(fit, [], background=False), fit.model.posterior.hyper, folds)
    if verdict.status == "unknown":
        # whatever is fitted to an unknown cause may harm elsewhere
        state, held = _nominal_state(fit), plain
    else:
        state, held = _choose_update(
            fit, claims, folds, plain, WORTH_IT_IN_DOUBT if verdict.structure.left else WORTH_IT
        )
    state = settle_play(problem, state)
    residual_before = position_residual(campaign, nominal, attain_scene(nominal))
    after = linearize_state(problem, state)
    residual_after = position_residual(campaign, after.scene, after.attained)
    good = campaign.usable.copy()
    good[fit.outliers] = False
    if _rms(residual_after[good]) > (1.0 - WORTH_IT) * _rms(residual_before[good]) and state.effects[known:]:
        state, held = _nominal_state(fit), plain
        after = linearize_state(problem, state)
        residual_after = position_residual(campaign, after.scene, after.attained)
    generic = hold_out(fit, prior_of(fit, [], background=True), _wide(fit), folds)
    ranked = rank_candidates(fit, verdict, folds)
    taken = {f.effect.place for f in verdict.findings}
    wrong = min((c.held_out for c in ranked if c.place not in taken), default=plain.rms)
    before_rows = np.linalg.norm(residual_before, axis=1)
    gap = Gap(
        before=_rms(residual_before[good]),
        after=_rms(residual_after[good]),
        held_out_before=float(np.sqrt(np.mean(before_rows[plain.rows] ** 2))) if not problem.register else plain.rms,
        held_out_after=held.rms,
        noise_floor=noise_floor(fit),
        registration_only=plain.rms,
        generic=generic.rms,
        wrong=wrong,
    )
    effects = state.effects[known:]
    updated = fold_effects(problem.robot, effects)
    return Diagnosis(
        robot=problem.robot, updated=updated, fit=fit, verdict=verdict, gap=gap, candidates=ranked,
        residual_before=residual_before, residual_after=residual_after, registration=state.registration,
        outliers=fit.outliers, noise=fit.noises["position"].source,
    )  # fmt: skip


def noise_floor(fit: Fit) -> float:
    """Return the rms 3D distance that a perfect model leaves. [m]"""
    noise = fit.noises["position"]
    factor = float(np.exp(fit.model.posterior.hyper.log_noise[0]))
    factor = factor if noise.witnesses < WITNESSED else min(factor, max(EXCESS, noise.leeway))
    return float(np.sqrt(3.0 * factor) * noise.sigma)


def _choose_update(
    fit: Fit, claims: list[Claim], folds: NDArray[np.int_], plain: HeldOut, worth: float
) -> tuple[State, HeldOut]:
    """Choose between all that was fitted, the named effects alone, and the nominal robot, by the held-out gap."""
    hyper = fit.model.posterior.hyper
    prior, _ = bend_forwards(fit.search.ledger, prior_of(fit, fit.model.claims), fit.model.posterior)
    options = [
        (hold_out(fit, prior, hyper, folds, fit.search.ledger.columns_named(UNMODELLED)), True),
        (hold_out(fit, prior_of(fit, claims, background=False), hyper, folds), False),
    ]
    held, everything = min(options, key=lambda o: o[0].rms * (1.0 if o[1] else 1.002))
    if held.rms > (1.0 - worth) * plain.rms:
        return _nominal_state(fit), plain
    return (replace(fit.state, unmodelled=None) if everything else _refitted(fit, claims)), held


def _refitted(fit: Fit, claims: list[Claim]) -> State:
    """Fit named effects alone, without background."""
    prior = prior_of(fit, claims, background=False)
    posterior: Posterior = find_posterior(fit.search.ledger, prior, fit.model.posterior.hyper, fit=False)
    posterior = replace(posterior, hyper=replace(posterior.hyper, log_tau=np.full_like(posterior.hyper.log_tau, -4.0)))
    model = replace(fit.model, claims=tuple(claims), posterior=posterior)
    state = advance_state(replace(fit, model=model, state=fit.base or fit.state))
    state = replace(state, unmodelled=None)
    return state if stands(fit.problem, state) else replace(fit.state, unmodelled=None)


def settle_play(problem: Problem, state: State) -> State:
    """Find on which side of its play each joint stood when the campaign began: where the first rows say so."""
    campaign = problem.campaign
    first = campaign.first_visit & campaign.usable & (campaign.run_index == 0)
    if not first.any():
        return state
    effects = list(state.effects)
    for number, effect in enumerate(effects):
        if effect.name != "backlash":
            continue
        tries = []
        for start in (-0.5, 0.5):
            effects[number] = replace(effect, parameters={**effect.parameters, "start_ratio": start})
            at = linearize_state(problem, replace(state, effects=tuple(effects)))
            gap = position_residual(campaign, at.scene, at.attained)[first]
            tries.append((float(np.median(np.linalg.norm(gap, axis=1))), start, effects[number]))
        effects[number] = min(tries, key=lambda t: t[:2])[2]
    return replace(state, effects=tuple(effects))


def _nominal_state(fit: Fit) -> State:
    return _refitted(fit, [])


def _wide(fit: Fit) -> Hyper:
    hyper = fit.model.posterior.hyper
    return replace(hyper, log_tau=np.zeros_like(hyper.log_tau))


def rank_candidates(fit: Fit, verdict: Verdict, folds: NDArray[np.int_]) -> tuple[Candidate, ...]:
    """Rank effects: named ones, then their rivals and what else explains the gap on its own."""
    search, ledger = fit.search, fit.search.ledger
    hyper = fit.model.posterior.hyper
    probability: dict[Place, float] = {}
    chosen: dict[Place, Claim] = {}
    for finding in (*verdict.findings, *verdict.doubtful):
        if finding.signature < 0:
            continue
        probability[finding.effect.place] = finding.probability
        chosen[finding.effect.place] = Claim(finding.signature, finding.size)
        for rival in finding.rivals[:3]:
            left = 1.0 - finding.probability
            probability.setdefault(rival.place, 0.5 * finding.probability if rival.alike else 0.5 * left * rival.share)
    alone = search.model([], hyper, fit=False)
    gains = [g for g in search.gains(alone) if ledger.signatures[g.signature].name != UNMODELLED]
    for gain in gains:
        place = ledger.signatures[gain.signature].place
        if place in probability and place not in chosen:
            chosen[place] = Claim(gain.signature, gain.size)
    for gain in distinct_places(search, gains, RANKED):
        place = ledger.signatures[gain.signature].place
        chosen.setdefault(place, Claim(gain.signature, gain.size))
        probability.setdefault(place, 0.0)
    candidates = []
    for place, claim in list(chosen.items())[: 2 * RANKED]:
        held = hold_out(fit, prior_of(fit, [claim], background=False), hyper, folds)
        candidates.append(Candidate(place, held.rms, probability[place]))
    return tuple(sorted(candidates, key=lambda c: (-round(c.probability, 3), c.held_out)))


def _rms(residual: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))) if len(residual) else 0.0
