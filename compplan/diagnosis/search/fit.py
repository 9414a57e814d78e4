"""Fit: rounds of linearization, search and exact forward models until convergence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import Channel, build_channels, estimate_noises, position_residual
from compplan.diagnosis.data.noise import NOISE, Noise, find_gross_outliers, find_outliers
from compplan.diagnosis.data.shared import rms_length
from compplan.diagnosis.evidence.candidates import (
    CLASSES,
    REGISTRATION,
    build_prior,
    key_of,
    log_priors,
    offered_signatures,
    propose_again,
    proposed_signatures,
)
from compplan.diagnosis.evidence.evidence import start_hyper
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import (
    NormalEquations,
    build_normal_equations,
    extend_normal_equations,
)
from compplan.diagnosis.evidence.proposals import propose_shifts, propose_waves
from compplan.diagnosis.search.search import SEARCH, SOFT, Claim, Search, search_from_forward_selection, search_models
from compplan.diagnosis.search.state import (
    Fit,
    FitState,
    Problem,
    advance_state,
    attain_state,
    claims_of,
    has_equilibrium,
    known_approach,
    linearize_state,
)
from compplan.effects.checks import limit_sizes
from compplan.effects.forward_model import own_springs
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.measurement.frames import fit_registration
from compplan.measurement.registration import Registration
from compplan.robot import Array


def fit_effects(
    problem: Problem, registration: Registration | None,
    progress: Callable[[str], None] = lambda text: None,
) -> Fit:  # fmt: skip
    """Find the effects of a campaign and fit them exactly, starting from the registration's frames."""
    state = FitState(problem.fixed, {}, registration, problem.campaign.usable)
    noises: dict[str, Noise] | None = None
    proposals: list[Signature] = []
    best: Fit | None = None
    restarted = converged = False
    for number in range(SEARCH.rounds):
        progress(f"round {number + 1}")
        # small effects are fitted after large ones are exact: twice as many effects each round
        state = replace(state, most=min(2 ** (number + 1), SEARCH.most_effects))
        # repeated poses show the noise after the first model has removed backlash and drift
        fit, proposals = _round(problem, state, noises if number > SEARCH.noise_round else None, proposals)
        noises = fit.noises
        step = descend(fit, advance_state(fit))
        if step is None:
            break
        new, score = step
        if best is None or number <= SEARCH.noise_round or score > best.score:
            best = replace(fit, state=new, score=score)
        converged = number > SEARCH.noise_round and len(fit.model.claims) < state.most and _converged(fit, state, new)
        state = new
        if converged and not restarted:
            progress("second start")
            restarted, other = True, search_from_forward_selection(fit.search, fit.model, state.most)
            converged = other is fit.model
            state = replace(state, claims=claims_of(replace(fit, model=other)))
        if converged:
            break
    if best is None:
        # even the shortest step has no equilibrium: no effect is claimed
        best = replace(fit, model=fit.search.model([], fit.search.start))
    last = register_again(best, best.state, best.state.use)
    residual = position_residual(problem.campaign, *attain_state(problem, last))
    outliers = find_outliers(problem.campaign, residual, last.scatter, known_approach(problem.campaign, last))
    return replace(best, state=last, outliers=outliers)


def _round(
    problem: Problem, state: FitState, noises: dict[str, Noise] | None, proposals: list[Signature]
) -> tuple[Fit, list[Signature]]:  # fmt: skip
    """Linearize at a state, search, propose rows and periods from the residuals, and search again."""
    at = linearize_state(problem, state)
    if noises is None:
        noises = estimate_noises(problem.campaign, at.attained, problem.robot.repeatability, state.registration)
    residual = position_residual(problem.campaign, at.scene, at.attained)
    if state.scatter > 0:
        outliers = find_outliers(problem.campaign, residual, state.scatter, known_approach(problem.campaign, state))
    else:
        outliers = find_gross_outliers(problem.campaign, residual)
    use = known_approach(problem.campaign, state) & problem.searched
    use[outliers] = False
    state = replace(state, use=use)
    channels = build_channels(at.scene, at.attained, use, noises)
    equations = build_normal_equations(channels, _offer_all(problem, state, at, proposals), state.values)
    fit = _search_equations(problem, state, at, channels, equations, noises)
    while True:
        fresh = _propose(fit)
        known = {key_of(s) for s in fit.search.equations.signatures}
        fresh = [s for s in fresh if key_of(s) not in known and s.name not in problem.excluded]
        if not fresh:
            break
        before, equations = fit.model.score, extend_normal_equations(fit.search.equations, fresh)
        held, proposed = replace(fit.state, claims=claims_of(fit)), {key_of(s) for s in fresh}
        # the motions of the proposals and the products before them take as much memory as the search
        del fit, fresh
        fit = _search_equations(problem, held, at, channels, equations, noises)
        claimed = {key_of(fit.search.equations.signatures[n]) for n in fit.model.signatures}
        if fit.model.score < before + SEARCH.least_gain or not claimed & proposed:
            break
    return fit, proposed_signatures(fit.search.equations.signatures)


def _offer_all(
    problem: Problem, state: FitState, at: Linearization, proposals: list[Signature]
) -> Iterator[Signature]:  # fmt: skip
    """List signatures without unknown rows or periods, and earlier proposals that are claimed.

    A nonlinear stiffness of a joint requires a spring in the robot folder; a rigid joint gets compliance instead.
    """
    springs = own_springs(problem.robot)
    sprung = {problem.robot.joint_names[index] for index, spring in springs.items() if spring.compliance > 0.0}
    for signature in offered_signatures(at, problem.register, problem.excluded):
        if signature.name != "stiffness_nonlinearity" or signature.joint in sprung:
            yield signature
    yield from propose_again(at, proposals, {key for key, _ in state.claims})


def _search_equations(
    problem: Problem, state: FitState, at: Linearization, channels: tuple[Channel, ...], equations: NormalEquations,
    noises: dict[str, Noise],
) -> Fit:  # fmt: skip
    search = _build_search(problem, equations, start_hyper(equations, len(CLASSES)))
    numbers = {key_of(s): n for n, s in enumerate(equations.signatures)}
    first = [Claim(numbers[key], size) for key, size in state.claims if key in numbers]
    model = search_models(search, first, state.most)
    return Fit(problem, state, at, channels, search, model, noises, np.zeros(0, int))


def _build_search(problem: Problem, equations: NormalEquations, start: Hyper) -> Search:
    free = [n for n, s in enumerate(equations.signatures) if s.name == REGISTRATION]
    robot, prior = problem.robot, build_prior(equations, free, problem.excluded)
    # a base frame moves whatever the placement of the first joint moves
    same = [("link_geometry", robot.joint_names[0])] if "base_frame" in {s.name for s in equations.signatures} else []
    candidates = [n for n, s in enumerate(equations.signatures) if n not in free and (s.name, s.joint) not in same]
    springs = any(spring.compliance > 0.0 for spring in robot.springs) or bool(robot.link_elasticities)
    # under varying loads, small compliances everywhere are fitted as well, and deflect
    rigid = not (springs or problem.campaign.load_varies or any(e.name in SOFT for e in problem.fixed))
    most = [limit_sizes(robot, s, np.full(len(s.keys), np.inf)) for s in equations.signatures]
    return Search(equations, prior, log_priors(equations.signatures), candidates, start, most, rigid)


def _propose(fit: Fit) -> list[Signature]:
    equations, values = fit.search.equations, fit.model.posterior.values(fit.search.equations.p)
    left = equations.left(values)
    waves: dict[int, set[int]] = {}
    names = fit.at.robot.joint_names
    for number, signature in enumerate(equations.signatures):
        columns = equations.columns(number)
        if signature.name == "transmission_error" and values[columns].any():
            waves.setdefault(names.index(str(signature.joint)), set()).update(columns.tolist())
    joint_waves = {
        index: [design[..., sorted(columns)] @ values[sorted(columns)] for design in equations.designs]
        for index, columns in waves.items()
    }
    proposals = propose_shifts(fit.at, fit.channels, left)
    return proposals + propose_waves(fit.at, fit.channels, left, joint_waves)


def _converged(fit: Fit, old: FitState, new: FitState) -> bool:
    if {key for key, _ in old.claims} != {key for key, _ in new.claims}:
        return False
    names = fit.search.equations.names
    change = np.array([new.values.get(name, 0.0) - old.values.get(name, 0.0) for name in names])
    change = change / fit.search.equations.scale
    used = np.flatnonzero(change)
    steps = [np.sqrt(np.mean((d[..., used] @ change[used]) ** 2)) for d in fit.search.equations.designs]
    return max(steps, default=0.0) < SEARCH.tolerance


def register_again(fit: Fit, state: FitState, use: NDArray[np.bool_]) -> FitState:
    """Fit the frames of a campaign to the exact model of a state, if they are registered and the fit is closer."""
    problem = fit.problem
    if not problem.register:
        return state
    attained = attain_state(problem, replace(state, registration=None))[1]
    frames = fit_registration(problem.campaign, attained.position, attained.rotation, problem.register, rows=use)
    registered = replace(state, registration=frames)
    return registered if exact_rms(fit, registered, use) < exact_rms(fit, state, use) else state


def exact_rms(fit: Fit, state: FitState, use: NDArray[np.bool_]) -> float:
    """Return the root mean square distance of the exact model from the measurements, on given rows. [m]"""
    campaign = fit.problem.campaign
    return rms_length(position_residual(campaign, *attain_state(fit.problem, state))[use & campaign.usable])


def descend(fit: Fit, full: FitState) -> tuple[FitState, float] | None:
    """Shorten a step until the exact model improves; return best state and exact score, None without an equilibrium.

    The score is the log posterior with the squared residuals of the exact model instead of those predicted by its
    derivatives. An excluded row counts as a row at the outlier limit, so that scores are comparable.
    """
    equations, posterior = fit.search.equations, fit.model.posterior
    here = np.array([fit.state.values.get(name, 0.0) for name in equations.names]) / equations.scale
    variance = fit.search.prior_of(fit.model.claims).variance(posterior.hyper.log_tau)
    weight = 1.0 / np.maximum(variance[posterior.columns], 1e-12)
    target = posterior.values(equations.p)

    def cost(channels: Sequence[Channel], vector: Array) -> float:
        left = [channel.residual / channel.sigma for channel in channels]
        values = vector[posterior.columns]
        return square_left(channels, left, posterior.hyper) + float(np.sum(weight * values**2))

    start = cost(fit.channels, here)
    predicted_cost = square_left(fit.channels, equations.left(target), posterior.hyper)
    predicted_cost += float(np.sum(weight * target[posterior.columns] ** 2))
    tried: list[tuple[float, FitState]] = []
    share = 1.0
    while share > SEARCH.tolerance and not (tried and tried[-1][0] < start):
        state = full if share == 1.0 else advance_state(fit, share)
        if has_equilibrium(fit.problem, state):
            channels = build_channels(*attain_state(fit.problem, state), fit.state.use, fit.noises)
            tried.append((cost(channels, here + share * (target - here)), state))
        share *= 0.5
    if not tried:
        return None
    least, state = min(tried, key=lambda t: t[0])
    left_out = known_approach(fit.problem.campaign, fit.state) & fit.problem.searched & ~fit.state.use
    return state, fit.model.score - 0.5 * (least - predicted_cost + NOISE.outlying**2 * float(left_out.sum()))


def square_left(channels: Sequence[Channel], left: Sequence[Array], hyper: Hyper) -> float:
    """Return the squared residuals (r, c) of each channel in units of the fitted noise, shared errors included."""
    total = 0.0
    for channel, rest, noise, shared in zip(channels, left, hyper.log_noise, hyper.log_shared, strict=True):
        # the influence of a gross error is bounded
        rest = rest * np.minimum(1.0, NOISE.outlying / np.maximum(np.abs(rest) * np.exp(-0.5 * noise), 1e-12))
        first = np.flatnonzero(np.r_[True, np.diff(channel.group) > 0])
        sizes = np.diff(np.r_[first, len(channel.group)])
        mean2 = np.sum(np.add.reduceat(rest, first, axis=0) ** 2, axis=1) / sizes
        ratio = sizes * np.exp(2 * shared)
        total += float(np.exp(-noise) * (np.sum(rest**2) - np.sum(ratio / (1 + ratio) * mean2)))
    return total
