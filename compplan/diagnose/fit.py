"""Fit: rounds of linearization, search and exact forward models, until nothing changes any more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.diagnose.background import CLASSES, build_prior, in_background, log_priors
from compplan.diagnose.channels import Channel, build_channels, estimate_noises, position_residual
from compplan.diagnose.evidence import Hyper, Posterior, Prior, find_posterior, start_hyper
from compplan.diagnose.ledger import Ledger, build_ledger, extend_ledger
from compplan.diagnose.noise import Noise
from compplan.diagnose.offers import REGISTRATION, Key, key_of, offer_again, offered_signatures, proposed_signatures
from compplan.diagnose.outliers import find_gross_outliers, find_outliers
from compplan.diagnose.proposals import propose_shifts, propose_waves
from compplan.diagnose.search import MOST_EFFECTS, Claim, Model, Search, search_models
from compplan.effects import Effect, apply_effects, attain_scene, stage_scene
from compplan.effects.linearization import Linearization, linearize_scene
from compplan.effects.scene import Attained, Scene
from compplan.effects.signature import Signature
from compplan.errors import ConvergenceError
from compplan.measure.campaign import Campaign
from compplan.measure.registration import Registration
from compplan.robot import Array, Robot

ROUNDS = 8
#: The round whose residual tells the noise; scores are compared from the next one on.
NOISE_ROUND = 1
#: Shares of a step that are tried until the exact model gains.
STEPS = (1.0, 0.5, 0.25, 0.1)
#: Standard deviations at which one value counts no further in the choice of a step (a gross error steers nothing).
FAR_OFF = 8.0
#: Most effects of the first rounds: what is small has to wait until the large ones are exact.
FIRST_ROUNDS = (2, 4, 8, 16)
#: Parameters have settled when no observation moves by more than this share of its noise.
SETTLED = 0.1
#: Classes of the background that move the target by less than this share of the noise are left out of the model.
NO_BACKGROUND = 0.1
#: Single background errors that move the target by less than this share of the noise are left out as well.
IDLE = 0.03


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be diagnosed.

    Attributes:
        robot: The nominal robot.
        campaign: What was measured.
        register: Frames that are fitted in every model.
        without: Effects that are left out of the candidates.
        fixed: Effects that are taken for granted (a convention of counting that was found beforehand).
    """

    robot: Robot
    campaign: Campaign
    register: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    fixed: tuple[Effect, ...] = ()

    @property
    def excluded(self) -> tuple[str, ...]:
        """Effects that are no candidates: those left out, and frames that are registered."""
        registered = {"base": "base_frame", "tool": "tool_frame"}
        return (*self.without, *(registered[part] for part in self.register))


@dataclass(frozen=True, eq=False)
class State:
    """Where a fit stands.

    Attributes:
        effects: Effects in the exact model, background included.
        values: Parameters by column. [SI]
        registration: Frames of the campaign, or None.
        use: Rows that are not outliers and whose approach is known. Shape (n,).
        claims: Place and form of the claims, and their sizes.
        most: Most effects that may be claimed.
        scatter: Standard deviation that the model leaves per axis of position; 0 before there is a model. [m]
    """

    effects: tuple[Effect, ...]
    values: dict[str, float]
    registration: Registration | None
    use: NDArray[np.bool_]
    claims: tuple[tuple[Key, float], ...] = ()
    scatter: float = 0.0
    most: int = MOST_EFFECTS


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished fit.

    Attributes:
        problem: What was diagnosed.
        state: Effects, frames and rows.
        at: Linearization at the fitted model.
        channels: Observations minus what the fitted model expects.
        search: The last search, with all the models it looked at.
        model: The best of them.
        noises: Noise of each channel.
        outliers: Rows reported as outliers.
        base: State that the linearization was taken at, where `state` has gone on.
        exact: Root mean square distance that the exact model leaves on the rows used. [m]
        score: Log posterior with the squares that the exact model leaves.
    """

    problem: Problem
    state: State
    at: Linearization
    channels: tuple[Channel, ...]
    search: Search
    model: Model
    noises: dict[str, Noise]
    outliers: NDArray[np.int_]
    base: State | None = None
    exact: float = 0.0
    score: float = -np.inf


def fit_effects(
    problem: Problem, registration: Registration | None,
    progress: Callable[[str], None] = lambda text: None,
) -> Fit:  # fmt: skip
    """Find the effects of a campaign and fit them exactly.

    Args:
        problem: What is to be diagnosed.
        registration: Frames to begin with, or None.
        progress: Told what is being done.
    """
    state = State(problem.fixed, {}, registration, problem.campaign.usable)
    noises: dict[str, Noise] | None = None
    proposals: list[Signature] = []
    best: Fit | None = None
    for number in range(ROUNDS):
        progress(f"round {number + 1}")
        state = replace(state, most=FIRST_ROUNDS[number] if number < len(FIRST_ROUNDS) else MOST_EFFECTS)
        # poses met again tell the noise once the first model has taken play and drift out of them
        fit, proposals = _round(problem, state, noises if number > NOISE_ROUND else None, proposals, progress)
        noises = fit.noises
        step = descend(fit, advance_state(fit))
        if step is None:
            break
        following, score = step
        if best is None or number <= NOISE_ROUND or score > best.score:
            best = replace(fit, state=following, base=fit.state, score=score)
        settled = number > NOISE_ROUND and len(fit.model.claims) < state.most and _settled(fit, state, following)
        state = following
        if settled:
            break
    if best is None:
        # the exact model cannot bear the least step: the campaign stays as it is
        best = replace(fit, model=fit.search.model([], fit.search.start), base=fit.state)
    return _finish(best, best.state)


def descend(fit: Fit, full: State) -> tuple[State, float] | None:
    """Shorten a step until the exact model gains by it; returns the state and its exact score, or None.

    The score is the log posterior of the model with the squares that the exact model leaves in the place of those that
    its derivatives promise.

    Args:
        fit: The fit that the step starts from.
        full: The whole step.
    """
    ledger, posterior = fit.search.ledger, fit.model.posterior
    here = np.array([fit.state.values.get(name, 0.0) for name in ledger.names]) / ledger.scale
    variance = fit.search.prior_of(fit.model.claims).variance(posterior.hyper.log_tau)
    weight = 1.0 / np.maximum(variance[posterior.columns], 1e-12)
    target = posterior.values(ledger.p)

    def cost(channels: Sequence[Channel], vector: Array) -> float:
        left = [channel.residual / channel.sigma for channel in channels]
        own = vector[posterior.columns]
        return square_left(channels, left, posterior.hyper) + float(np.sum(weight * own**2))

    start = cost(fit.channels, here)
    promised = square_left(fit.channels, ledger.left(target), posterior.hyper)
    promised += float(np.sum(weight * target[posterior.columns] ** 2))
    tried: list[tuple[float, State]] = []
    for share in STEPS:
        state = full if share == 1.0 else advance_state(fit, share)
        channels = observe_state(fit, state)
        if channels is None:
            continue
        tried.append((cost(channels, here + share * (target - here)), state))
        if tried[-1][0] < start:
            break
    if not tried:
        return None
    least, state = min(tried, key=lambda t: t[0])
    return state, fit.model.score - 0.5 * (least - promised)


def square_left(channels: Sequence[Channel], left: Sequence[Array], hyper: Hyper) -> float:
    """Return the squares that are left in units of the fitted noise, errors that stays share included.

    Args:
        channels: The channels of observations.
        left: What is left in each, in units of its estimated noise. Shape (r, c) each.
        hyper: Noise and background.
    """
    total = 0.0
    for channel, rest, noise, shared in zip(channels, left, hyper.log_noise, hyper.log_shared, strict=True):
        rest = rest * np.minimum(1.0, FAR_OFF / np.maximum(np.abs(rest) * np.exp(-0.5 * noise), 1e-12))
        first = np.flatnonzero(np.r_[True, np.diff(channel.group) > 0])
        sizes = np.diff(np.r_[first, len(channel.group)])
        mean2 = np.sum(np.add.reduceat(rest, first, axis=0) ** 2, axis=1) / sizes
        ratio = sizes * np.exp(2 * shared)
        total += float(np.exp(-noise) * (np.sum(rest**2) - np.sum(ratio / (1 + ratio) * mean2)))
    return total


def observe_state(fit: Fit, state: State) -> tuple[Channel, ...] | None:
    """Compare the campaign with the exact model of a state, or None where that finds no equilibrium."""
    try:
        scene, attained = attain_state(fit.problem, state)
    except ConvergenceError:
        return None
    if not np.isfinite(attained.position).all():
        return None
    return build_channels(scene, attained, fit.state.use, fit.noises)


def _round(
    problem: Problem, state: State, noises: dict[str, Noise] | None, proposals: list[Signature],
    progress: Callable[[str], None],
) -> tuple[Fit, list[Signature]]:  # fmt: skip
    """Linearize at a state, search, look for rows and periods in what is left, and search again."""
    at = linearize_state(problem, state)
    if noises is None:
        noises = estimate_noises(problem.campaign, at.attained, problem.robot.repeatability)
    residual = position_residual(problem.campaign, at.scene, at.attained)
    if state.scatter > 0:
        outliers = find_outliers(problem.campaign, residual, state.scatter, known_approach(problem.campaign, state))
    else:
        outliers = find_gross_outliers(problem.campaign, residual)
    use = known_approach(problem.campaign, state)
    use[outliers] = False
    state = replace(state, use=use)
    channels = build_channels(at.scene, at.attained, use, noises)
    fixed = offered_signatures(at, problem.register, problem.excluded)
    wanted = {key for key, _ in state.claims}
    kept = offer_again(at, proposals, wanted)
    fit = _search(problem, state, at, channels, [*fixed, *kept], noises, progress)
    for _ in range(3):
        fresh = _propose(fit)
        known = {key_of(s) for s in fit.search.ledger.signatures}
        fresh = [s for s in fresh if key_of(s) not in known and s.name not in problem.excluded]
        if not fresh:
            break
        before = fit.model.score
        fit = search_again(fit, fresh, progress)
        claimed = {key_of(fit.search.ledger.signatures[n]) for n in fit.model.signatures}
        if fit.model.score < before + 0.5 or not claimed & {key_of(s) for s in fresh}:
            break
    return fit, proposed_signatures(fit.search.ledger.signatures)


def known_approach(campaign: Campaign, state: State) -> NDArray[np.bool_]:
    """Tell which rows a model can predict: all, or with play those whose approach is known. Shape (n,)."""
    play = any(key[0] == "backlash" for key, _ in state.claims)
    return ~campaign.first_visit if play else np.ones(len(campaign), bool)


def stands(problem: Problem, state: State) -> bool:
    """Tell whether the robot of a state finds its equilibrium at every row."""
    try:
        _, attained = attain_state(problem, state)
    except ConvergenceError:
        return False
    return bool(np.isfinite(attained.position).all())


def attain_state(problem: Problem, state: State) -> tuple[Scene, Attained]:
    """Put the state's effects into a scene and solve it."""
    scene = stage_scene(problem.robot, problem.campaign, registration=state.registration)
    scene = apply_effects(scene, state.effects)
    return scene, attain_scene(scene)


def linearize_state(problem: Problem, state: State) -> Linearization:
    """Put the state's effects into a scene, solve it and linearize."""
    scene, attained = attain_state(problem, state)
    return linearize_scene(scene, attained, {effect.place: effect.parameters for effect in state.effects})


def _search(
    problem: Problem, state: State, at: Linearization, channels: tuple[Channel, ...], signatures: list[Signature],
    noises: dict[str, Noise], progress: Callable[[str], None],
) -> Fit:  # fmt: skip
    ledger = build_ledger(channels, signatures, state.values)
    return _search_ledger(problem, state, at, channels, ledger, noises, progress)


def search_again(fit: Fit, fresh: list[Signature], progress: Callable[[str], None] = lambda text: None) -> Fit:
    """Search with further signatures, from the claims there are, at the linearization of a fit.

    Args:
        fit: The fit.
        fresh: Signatures that it has not seen.
        progress: Told what is being done.
    """
    ledger = extend_ledger(fit.search.ledger, fresh)
    held = replace(fit.state, claims=_claims(fit))
    return _search_ledger(fit.problem, held, fit.at, fit.channels, ledger, fit.noises, progress)


def _search_ledger(
    problem: Problem, state: State, at: Linearization, channels: tuple[Channel, ...], ledger: Ledger,
    noises: dict[str, Noise], progress: Callable[[str], None],
) -> Fit:  # fmt: skip
    signatures = ledger.signatures
    free = [n for n, s in enumerate(signatures) if s.name == REGISTRATION]
    prior = build_prior(ledger, free, problem.excluded)
    candidates = [n for n in range(len(signatures)) if n not in free]
    search = Search(
        ledger, prior, log_priors(signatures), candidates, start_hyper(ledger, len(CLASSES)),
        progress=progress,
    )
    numbers = {key_of(s): n for n, s in enumerate(signatures)}
    first = [Claim(numbers[key], size) for key, size in state.claims if key in numbers]
    model = search_models(search, first, state.most)
    return Fit(problem, state, at, channels, search, model, noises, np.zeros(0, int))


def _claims(fit: Fit) -> tuple[tuple[Key, float], ...]:
    return tuple((key_of(fit.search.ledger.signatures[c.signature]), c.size) for c in fit.model.claims)


def _propose(fit: Fit) -> list[Signature]:
    ledger, values = fit.search.ledger, fit.model.posterior.values(fit.search.ledger.p)
    left = ledger.left(values)
    waves: dict[int, set[int]] = {}
    names = fit.at.robot.joint_names
    for number, signature in enumerate(ledger.signatures):
        columns = ledger.columns(number)
        if signature.name == "transmission_error" and values[columns].any():
            waves.setdefault(names.index(str(signature.joint)), set()).update(columns.tolist())
    own = {
        index: [design[..., sorted(columns)] @ values[sorted(columns)] for design in ledger.designs]
        for index, columns in waves.items()
    }
    proposals = propose_shifts(fit.at, fit.channels, left)
    return proposals + propose_waves(fit.at, fit.channels, left, own)


def advance_state(fit: Fit, share: float = 1.0) -> State:
    """Take the posterior mean into the exact model, or a share of the way to it from where the fit stands."""
    ledger = fit.search.ledger
    prior, posterior = bend_forwards(ledger, fit.search.prior_of(fit.model.claims), fit.model.posterior)
    here = np.array([fit.state.values.get(name, 0.0) for name in ledger.names]) / ledger.scale
    vector = here + share * (posterior.values(ledger.p) - here)
    claimed = list(fit.model.signatures)
    registration = fit.state.registration
    values: dict[str, float] = {}
    effects = list(fit.problem.fixed)
    background = prior.background
    quiet = _quiet_classes(ledger, background, vector)
    order = [*claimed, *(n for n in range(len(ledger.signatures)) if n not in claimed)]
    for number in order:
        signature, columns = ledger.signatures[number], ledger.columns(number)
        if signature.name == REGISTRATION:
            registration = _move_registration(registration, signature, vector[columns] * signature.scale)
            continue
        if number not in claimed:
            labels = background[columns]
            if (labels < 0).any() or quiet[labels].any() or not in_background(signature):
                continue
            if any(ledger.names[column] in values for column in columns) or idle(ledger, columns, vector):
                continue
        part = vector[columns].copy()
        if signature.positive:
            part = np.maximum(part, 0.0)
        if part.any():
            sizes = part * signature.scale
            values |= {ledger.names[column]: float(size) for column, size in zip(columns, sizes, strict=True)}
            effects.append(signature.effect(sizes))
    first = posterior.hyper
    scatter = fit.noises["position"].sigma * float(
        np.exp(0.5 * first.log_noise[0]) * np.hypot(1.0, np.exp(first.log_shared[0]))
    )
    return State(tuple(effects), values, registration, fit.state.use, _claims(fit), scatter)


def idle(ledger: Ledger, columns: NDArray[np.int_], vector: Array) -> bool:
    """Tell whether background errors move nothing here: they stay out of the model, as elsewhere they might."""
    part = vector[columns]
    return all(np.sqrt(np.mean((design[..., columns] @ part) ** 2)) < IDLE for design in ledger.designs)


def _quiet_classes(ledger: Ledger, background: NDArray[np.int_], vector: Array) -> NDArray[np.bool_]:
    """Tell which classes of the background hardly move anything. Shape (classes,)."""
    quiet = np.ones(len(CLASSES), bool)
    for label in range(len(CLASSES)):
        columns = np.flatnonzero((background == label) & (vector != 0))
        moves = [np.sqrt(np.mean((design[..., columns] @ vector[columns]) ** 2)) for design in ledger.designs]
        quiet[label] = max(moves, default=0.0) < NO_BACKGROUND
    return quiet


def bend_forwards(ledger: Ledger, prior: Prior, posterior: Posterior) -> tuple[Prior, Posterior]:
    """Take background errors that can only be positive out of a model where they come out negative.

    Nothing bends against its load; left in, such errors would cancel others to first order and could not be built.
    """
    one_sided = np.zeros(ledger.p, bool)
    for number, signature in enumerate(ledger.signatures):
        if signature.positive and len(signature.scale) == 1:
            one_sided[ledger.columns(number)] = True
    for _ in range(6):
        wrong = one_sided & (prior.background >= 0) & (posterior.values(ledger.p) < 0)
        if not wrong.any():
            break
        prior = replace(prior, background=np.where(wrong, -1, prior.background))
        posterior = find_posterior(ledger, prior, posterior.hyper, fit=False)
    return prior, posterior


def _move_registration(registration: Registration | None, signature: Signature, step: Array) -> Registration | None:
    if registration is None:
        return None
    move = np.eye(4)
    move[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix()
    move[:3, 3] = step[:3]
    if signature.form == "base":
        return replace(registration, base=registration.base @ move)
    tools = registration.tool.copy()
    number = int(signature.form.split()[1])
    tools[number] = tools[number] @ move
    return replace(registration, tool=tools)


def _settled(fit: Fit, old: State, new: State) -> bool:
    if {key for key, _ in old.claims} != {key for key, _ in new.claims}:
        return False
    names = fit.search.ledger.names
    change = np.array([new.values.get(name, 0.0) - old.values.get(name, 0.0) for name in names])
    change = change / fit.search.ledger.scale
    used = np.flatnonzero(change)
    steps = [np.sqrt(np.mean((d[..., used] @ change[used]) ** 2)) for d in fit.search.ledger.designs]
    return max(steps, default=0.0) < SETTLED


def _finish(fit: Fit, state: State) -> Fit:
    """Keep the last search, and the state that its posterior leads to, with the outliers seen from there."""
    campaign = fit.problem.campaign
    scene, attained = attain_state(fit.problem, state)
    residual = position_residual(campaign, scene, attained)
    outliers = find_outliers(campaign, residual, state.scatter, known_approach(campaign, state))
    rows = fit.channels[0].rows
    exact = float(np.sqrt(np.mean(np.sum(residual[rows] ** 2, axis=1))))
    return replace(fit, outliers=outliers, exact=exact)
