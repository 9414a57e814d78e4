"""State of a fit, and its parameters in the exact model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import Channel, group_poses
from compplan.diagnosis.data.noise import Noise
from compplan.diagnosis.data.shared import SAMPLE, SEED
from compplan.diagnosis.evidence.candidates import CLASSES, REGISTRATION, Key, in_background, key_of
from compplan.diagnosis.evidence.evidence import drop_negative
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.diagnosis.search.search import SEARCH, Model, Search
from compplan.effects import Effect, apply_effects, build_model, solve_model_poses
from compplan.effects.checks import limit_sizes
from compplan.effects.forward_model import Attained, ForwardModel, observe_again
from compplan.effects.linearization import Linearization, linearize_model
from compplan.effects.signature import Signature
from compplan.errors import ConvergenceError
from compplan.measurement.campaign import Campaign
from compplan.measurement.registration import CONTACTS, Registration
from compplan.robot import Array, Robot
from compplan.robot.pose import apply_twist


@dataclass(frozen=True, eq=False)
class Problem:
    """Input of a diagnosis."""

    robot: Robot  #: The nominal robot.
    campaign: Campaign  #: The measurement log.
    register: tuple[str, ...] = ()  #: Frames that are fitted in every model.
    without: tuple[str, ...] = ()  #: Effects that are left out of the candidates.
    #: Effects assumed present (joint conventions that were found beforehand).
    fixed: tuple[Effect, ...] = ()
    #: The last solved state, reused while only frames change.
    latest: list[tuple[tuple[Effect, ...], ForwardModel, Attained]] = field(
        default_factory=list, init=False, repr=False
    )

    @cached_property
    def searched(self) -> NDArray[np.bool_]:
        """Rows that names are searched in, poses with all their visits: all, or of many poses `SAMPLE`. Shape (n,).

        One pose is drawn from each stretch of time with as many poses.
        """
        group = np.unique(group_poses(self.campaign), return_inverse=True)[1].reshape(-1)
        first = np.unique(group, return_index=True)[1]
        order = np.argsort(first)
        ends = np.arange(SAMPLE + 1) * len(order) // SAMPLE
        if len(order) <= SAMPLE:
            return np.ones(len(group), bool)
        return np.isin(group, order[np.random.default_rng(SEED).integers(ends[:-1], ends[1:])])

    @property
    def excluded(self) -> tuple[str, ...]:
        """Effects that are not candidates: those left out, and registered frames."""
        registered = {"base": "base_frame", "tool": "tool_frame", CONTACTS: "base_frame"}
        return (*self.without, *(registered[part] for part in self.register))


@dataclass(frozen=True, eq=False)
class FitState:
    """Current effects, parameters, frames and rows of a fit."""

    effects: tuple[Effect, ...]  #: Effects in the exact model, background included.
    values: dict[str, float]  #: Parameters by column. [SI]
    registration: Registration | None  #: Frames of the campaign, or None.
    use: NDArray[np.bool_]  #: Rows that are not outliers and have a known approach. Shape (n,).
    claims: tuple[tuple[Key, float], ...] = ()  #: Place and form of the claims, and their sizes.
    #: Standard deviation of the residuals per axis of position; 0 before the first model. [m]
    scatter: float = 0.0
    most: int = SEARCH.most_effects  #: Most effects that may be claimed.


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished fit."""

    problem: Problem  #: Input of the diagnosis.
    state: FitState  #: Effects, frames and rows.
    at: Linearization  #: Linearization; `state` may be later.
    channels: tuple[Channel, ...]  #: Measured minus expected values of the fitted model.
    search: Search  #: The last search, with all its evaluated models.
    model: Model  #: The best model.
    noises: dict[str, Noise]  #: Noise of each channel.
    outliers: NDArray[np.int_]  #: Rows reported as outliers.
    score: float = -np.inf  #: Log posterior with the squares that the exact model leaves.


def known_approach(campaign: Campaign, state: FitState) -> NDArray[np.bool_]:
    """Return the rows that a model can predict: all, or with backlash those with a known approach. Shape (n,)."""
    play = any(key[0] == "backlash" for key, _ in state.claims)
    return ~campaign.first_visit if play else np.ones(len(campaign), bool)


def has_equilibrium(problem: Problem, state: FitState) -> bool:
    """Check whether the robot of a state has an equilibrium at every row."""
    try:
        _, attained = attain_state(problem, state)
    except ConvergenceError:
        return False
    return bool(np.isfinite(attained.position).all())


def attain_state(problem: Problem, state: FitState) -> tuple[ForwardModel, Attained]:
    """Build the forward model with the state's effects and solve it."""
    for effects, scene, attained in problem.latest:
        if effects is state.effects:
            if scene.registration is not state.registration:
                scene = replace(scene, registration=state.registration)
                attained = observe_again(scene, attained)
            return scene, attained
    scene = build_model(problem.robot, problem.campaign, registration=state.registration)
    scene = apply_effects(scene, state.effects)
    attained = solve_model_poses(scene)
    problem.latest[:] = [(state.effects, scene, attained)]
    return scene, attained


def linearize_state(problem: Problem, state: FitState) -> Linearization:
    """Build the forward model with the state's effects, solve it and linearize."""
    scene, attained = attain_state(problem, state)
    return linearize_model(scene, attained, {effect.place: effect.parameters for effect in state.effects})


def advance_state(fit: Fit, share: float = 1.0) -> FitState:
    """Move the exact model to the posterior mean, or by a share of the step from the current state.

    During a partial step, effects claimed before but not now fade as the others change.
    """
    equations = fit.search.equations
    prior = fit.search.prior_of(fit.model.claims)
    # compliances below zero would cancel others to first order, and cannot be built
    single = equations.join_columns(n for n, s in enumerate(equations.signatures) if s.positive and len(s.scale) == 1)
    bounded = single[prior.background[single] >= 0]
    prior, posterior = drop_negative(equations, prior, fit.model.posterior, bounded)
    here = np.array([fit.state.values.get(name, 0.0) for name in equations.names]) / equations.scale
    vector = here + share * (posterior.values(equations.p) - here)
    before = {key for key, _ in fit.state.claims} if share < 1.0 else set()
    claimed = list(fit.model.signatures)
    claimed += [n for n, s in enumerate(equations.signatures) if n not in claimed and key_of(s) in before]
    # classes of the background with negligible motion are left out
    noticeable = np.zeros(len(CLASSES) + 1, bool)
    for label in range(len(CLASSES)):
        columns = np.flatnonzero((prior.background == label) & (vector != 0))
        noticeable[label] = bool(len(columns)) and not is_negligible(equations, columns, vector, SEARCH.tolerance)
    rest = [
        n for n, s in enumerate(equations.signatures)
        if s.name == REGISTRATION or (in_background(s) and noticeable[prior.background[equations.columns(n)]].all())
    ]  # fmt: skip
    first = posterior.hyper
    scatter = float(np.exp(0.5 * first.log_noise[0]) * np.hypot(1.0, np.exp(first.log_shared[0])))
    state = build_state(fit, vector, claimed, rest)
    return replace(state, claims=claims_of(fit), scatter=fit.noises["position"].sigma * scatter)


def build_state(fit: Fit, values: Array, claimed: Sequence[int], rest: Sequence[int]) -> FitState:
    """Apply the value of each column, shape (p,), to the exact model: claims first, then others with noticeable motion.

    Where several signatures share a column, the first one's form is kept.
    """
    equations, left = fit.search.equations, values.copy()
    effects, kept, registration = list(fit.problem.fixed), dict[str, float](), fit.state.registration
    for number in [*claimed, *(n for n in rest if n not in claimed)]:
        signature, columns = equations.signatures[number], equations.columns(number)
        if signature.name == REGISTRATION:
            registration = move_registration(registration, signature, left[columns] * signature.scale)
        elif number in claimed or not is_negligible(equations, columns, left, SEARCH.negligible):
            part = np.maximum(left[columns], 0.0) if signature.positive else left[columns]
            sizes = limit_sizes(fit.problem.robot, signature, part * signature.scale)
            sizes = np.maximum(sizes, signature.least) if signature.least else sizes
            if part.any():
                kept |= {equations.names[c]: float(size) for c, size in zip(columns, sizes, strict=True)}
                effects.append(signature.effect(sizes))
            left[columns] = 0.0
    return replace(fit.state, effects=tuple(effects), values=kept, registration=registration)


def is_negligible(equations: NormalEquations, columns: NDArray[np.int_], vector: Array, least: float) -> bool:
    """Check whether errors are below a share of the noise; they are left out, since they may be large elsewhere."""
    part = vector[columns]
    return all(np.sqrt(np.mean((design[..., columns] @ part) ** 2)) < least for design in equations.designs)


def move_registration(registration: Registration | None, signature: Signature, step: Array) -> Registration | None:
    """Turn and shift the frame of a registration signature."""
    if registration is None:
        return None
    what, _, label = signature.form.partition(" ")
    if what == CONTACTS:
        places = registration.places.copy()
        places[int(label)] += step
        return replace(registration, places=places)
    move = apply_twist(step)
    if signature.form == "base":
        return replace(registration, base=registration.base @ move)
    tools = registration.tool.copy()
    number = int(label)
    tools[number] = tools[number] @ move
    return replace(registration, tool=tools)


def claims_of(fit: Fit) -> tuple[tuple[Key, float], ...]:
    """Return place, form and size of the claims of a fit."""
    return tuple((key_of(fit.search.equations.signatures[c.signature]), c.size) for c in fit.model.claims)
