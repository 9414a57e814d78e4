"""Diagnose a campaign: conventions, registration, fit, verdict, held-out gap, updated robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from compplan.diagnosis.data.channels import position_residual
from compplan.diagnosis.data.conventions import find_conventions
from compplan.diagnosis.data.shared import LISTED, rank_number, rms_length
from compplan.diagnosis.results.delivery import deliver_robot
from compplan.diagnosis.results.posterior import set_calibrated_sizes
from compplan.diagnosis.results.result import Candidate, Diagnosis, Gap
from compplan.diagnosis.results.verdict import Finding, Verdict, check_calibration, reach_verdict
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.search import SEARCH, Claim, distinct_places
from compplan.diagnosis.search.state import Fit, FitState, Problem, attain_state
from compplan.diagnosis.validation.calibration import read_all_rows
from compplan.diagnosis.validation.held_out import Folds, make_folds
from compplan.diagnosis.validation.probability import MAP
from compplan.diagnosis.validation.unmodelled import RevisedProbabilities, revise_probabilities
from compplan.effects import robot_effects, solve_model_poses
from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import AXES
from compplan.errors import InputError
from compplan.measurement.campaign import Campaign
from compplan.measurement.frames import fit_registration
from compplan.measurement.pooling import pool_rows
from compplan.measurement.registration import Registration, fitted_parts, stated_registration
from compplan.robot import Robot

#: Fewest rows of a campaign (theory: twice the values of the frames of base and tool, three to a row).
FEWEST_ROWS = 2 * len(AXES)
#: Ratio of held-out to fitted rms error from which a frame counts as undetermined (assumed: the few values of frames
#: cause less than two).
OPEN_FRAMES = 5.0


def diagnose_campaign(
    robot: Robot, campaign: Campaign, *, register: Sequence[str] = (), without: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Diagnosis:  # fmt: skip
    """Find which effects make the gap between a robot model and a measured campaign.

    Args:
        robot: The nominal robot; effects of its effects.toml count as known.
        campaign: The measurement log; rows of a pose are pooled if there are very many.
        register: Frames of the campaign, not the robot, of "base" and "tool"; fitted in every model.
        without: Effects to leave out of the candidates.
        progress: Called with the name of each step.

    Raises:
        InputError: If the campaign has too few rows.
    """
    if campaign.usable.sum() < FEWEST_ROWS:
        raise InputError(
            f"{int(campaign.usable.sum())} usable rows, expected at least {FEWEST_ROWS}", file=campaign.file
        )
    campaign = pool_rows(campaign)
    parts = fitted_parts(campaign, register)
    known = robot_effects(robot)
    progress("conventions")
    conventions = () if "joint_coupling" in without else find_conventions(robot, campaign, parts)
    problem = Problem(robot, campaign, parts, tuple(without), (*known, *conventions))
    registration, nominal = _register(replace(problem, fixed=known), campaign)
    started = _register(problem, campaign)[0] if conventions else registration
    fit = fit_effects(problem, started, progress)
    progress("verdict")
    revised = revise_probabilities(fit)
    verdict = _with_conventions(reach_verdict(fit, revised), problem, len(known))
    return _conclude(fit, revised, verdict, nominal, started, len(known), progress)


def _register(problem: Problem, campaign: Campaign) -> tuple[Registration | None, ForwardModel]:
    """Fit the registration of the nominal robot; return it with the forward model."""
    state = FitState(problem.fixed, {}, None, campaign.usable)
    scene, attained = attain_state(problem, state)
    if not problem.register:
        stated = stated_registration(campaign)
        return stated, replace(scene, registration=stated)
    registration = fit_registration(campaign, attained.position, attained.rotation, problem.register)
    return registration, replace(scene, registration=registration)


def _with_conventions(verdict: Verdict, problem: Problem, known: int) -> Verdict:
    """Insert conventions that were found beforehand before the other findings."""
    beforehand = problem.fixed[known:]
    found = tuple(Finding(e, MAP.most_probable, float("inf"), float("inf"), (), 1.0, -1) for e in beforehand)
    if not found:
        return verdict
    status = {"none": "explained", "unknown": "partly_explained"}.get(verdict.status, verdict.status)
    return replace(verdict, findings=(*found, *verdict.findings), status=status)


def _conclude(
    fit: Fit, revised: RevisedProbabilities, verdict: Verdict, nominal: ForwardModel,
    registration: Registration | None, known: int,
    progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """Predict held-out poses, select the updated robot, and build the result."""
    problem, campaign = fit.problem, fit.problem.campaign
    progress("held out")
    folds = Folds(read_all_rows(fit, revised.model.claims), make_folds(campaign))
    before = position_residual(campaign, nominal, solve_model_poses(nominal))
    state = FitState(problem.fixed, {}, registration, folds.fit.state.use)
    plain = folds.hold_out(lambda number: state)
    if not problem.register:
        plain = replace(plain, residual=before[plain.rows])
    good = campaign.usable.copy()
    good[fit.outliers] = False
    refuse_open_frames(rms_length(before[good]), plain.of(good[plain.rows]).rms, campaign)
    first = deliver_robot(folds, verdict, plain, state, good)
    seen = good[plain.rows]
    verdict, sizes = set_calibrated_sizes(folds.fit, first.posterior, verdict, first.uncertainty.calibration)
    verdict = check_calibration(verdict, plain.of(seen).rms, first.held.of(seen).rms)
    gap = Gap(
        before=rms_length(before[good]),
        after=rms_length(first.residual[good]),
        held_out_before=rms_length(plain.residual[seen]),
        held_out_after=rms_length(first.held.residual[seen]),
        noise_floor=verdict.structure.floor,
    )
    return Diagnosis(
        robot=problem.robot, updated=first.robot(problem.robot, known), fit=fit,
        revised=revised, verdict=verdict, gap=gap, candidates=rank_candidates(verdict, replace(folds, fit=fit)),
        residual_before=before, residual_after=first.residual, registration=first.state.registration,
        outliers=fit.outliers, delivery=first, equations=folds.fit.search.equations,
        sizes=sizes, noise=fit.noises["position"].source,
    )  # fmt: skip


def refuse_open_frames(inside: float, left_out: float, campaign: Campaign) -> None:
    """Raise an error if the poses do not determine the frames; no robot folder could be validated on them.

    `inside`: rms error of the nominal robot on all rows; `left_out`: on poses excluded from the frame fit. [m]

    Raises:
        InputError: If the held-out error is much larger.
    """
    if left_out > OPEN_FRAMES * inside:
        raise InputError(
            f"too few poses to locate instrument, target and contacts: the nominal robot leaves"
            f" {1e3 * inside:.3g} mm on all poses and {1e3 * left_out:.3g} mm on poses left out; measure more poses,"
            " and more at each contact",
            file=campaign.file,
        )


def rank_candidates(verdict: Verdict, folds: Folds) -> tuple[Candidate, ...]:
    """Rank effects: named ones, then their rivals and others that explain the gap alone, on the rows of a fit."""
    fit, search, equations = folds.fit, folds.fit.search, folds.fit.search.equations
    hyper = fit.model.posterior.hyper
    found = [finding for finding in (*verdict.findings, *verdict.doubtful) if finding.signature >= 0]
    probability = {finding.effect.place: finding.probability for finding in found}
    chosen = {finding.effect.place: Claim(finding.signature, finding.size) for finding in found}
    for finding in found:
        for rival in finding.rivals[: SEARCH.tried]:
            left = 1.0 - finding.probability
            probability.setdefault(rival.place, 0.5 * finding.probability if rival.alike else 0.5 * left * rival.share)
    gains = search.gains(search.model([], hyper, fit=False))
    places = [equations.signatures[gain.signature].place for gain in gains]
    rivals = [gain for gain, place in zip(gains, places, strict=True) if place in probability]
    beforehand = {finding.effect.place for finding in verdict.findings if finding.signature < 0}
    for gain in (*rivals, *distinct_places(search, gains, LISTED)):
        place = equations.signatures[gain.signature].place
        if place not in beforehand:
            chosen.setdefault(place, Claim(gain.signature, gain.size))
            probability.setdefault(place, 0.0)
    candidates = []
    for place, claim in list(chosen.items())[: 2 * LISTED]:
        held = folds.hold_out_linear(claim)
        candidates.append(Candidate(place, held.rms, probability[place]))
    return tuple(sorted(candidates, key=lambda c: (-round(c.probability, 3), rank_number(c.held_out))))
