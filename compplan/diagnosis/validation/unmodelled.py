"""Unmodelled: dependences of a gap beyond every effect of the vocabulary.

A gap with a cause outside the vocabulary still depends on something: target position, load, time, another joint. Each
dependence is a smooth function of unknown shape, added to the search. Such a function is never named as a cause and
never written into a robot. It prevents effects from fitting errors that they do not cause, and it describes an unknown
cause.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import ROUNDING, STEPS, rank_evidence
from compplan.diagnosis.evidence.evidence import EVIDENCE, Prior, find_posterior
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import NormalEquations, extend_normal_equations
from compplan.diagnosis.evidence.proposals import LEAST_RANGE
from compplan.diagnosis.search.search import SEARCH, Model, Search, add_claim
from compplan.diagnosis.search.state import Fit
from compplan.effects.linearization import AXES, Linearization
from compplan.effects.signature import Signature
from compplan.effects.tool_frame import tool_twists
from compplan.measurement.campaign import Campaign
from compplan.robot import Array

UNMODELLED = "unmodelled"


@dataclass(frozen=True)
class UnmodelledSettings:
    """Settings of the shapes of unmodelled errors."""

    #: Time constants of creep (assumed). [s]
    creep_times: tuple[float, float] = (60.0, 400.0)
    #: Time constants of errors that decay early, as shares of the campaign (assumed).
    early: tuple[float, float] = (0.02, 0.1)
    #: Degree of the curves over time, and of the fields over the workspace (assumed).
    time_degree: int = 4
    field_degree: int = 3
    #: Distance of an instrument over the motion of the target (assumed): terms of a field that is curved about the
    #: instrument shrink by this from degree to degree.
    far: float = 8.0
    #: Speeds at which friction fades, over the fastest (assumed).
    fading: tuple[float, ...] = (0.05, 0.2, 0.8)


SHAPES = UnmodelledSettings()


def unmodelled_signatures(fit: Fit) -> Iterator[Signature]:
    """List the dependences that a campaign can show, without those that another one contains."""
    at = fit.at
    yield from _of_position(at)
    yield from _of_time(at)
    if at.campaign.load_varies:
        yield from _of_load(at)
    if at.attained.chain.n_springs:
        # a force on the tool that depends on the position of the target
        twist, encoder = at.wrench_response(_times(_shifts(at), _monomials(at, 2)[0]))
        yield from _offer(None, "an unknown force that changes with the place", "curved", twist, encoder, common=True)
    if at.campaign.load_varies:
        # bending about the axis of the load is an effect of the vocabulary, unless excluded
        yield from _of_links(at, bending="link_compliance" in fit.problem.without)
    for index in range(at.robot.nq):
        yield from _of_joint(at, index)


def describe_unmodelled(joint: str | None, driver: str) -> str:
    """Describe the dependence of an unmodelled error."""
    return f"an error {'' if joint is None else f'of {joint} '}that follows {driver}"


def _offer(
    joint: str | None, driver: str, form: str, twist: Array, encoder: Array | None = None,
    *, common: bool = False, weight: Array | float = 1.0,
) -> Iterable[Signature]:  # fmt: skip
    """Build columns of twist, shape (n, 6, k), scaled so that together they move the target by a metre.

    A weight makes columns larger than others beforehand; `common` gives all of them the same unit.
    """
    size = np.sqrt(np.mean(np.sum(twist[:, :3] ** 2, axis=1), axis=0))
    seen = size > ROUNDING
    if not seen.any():
        return
    size = np.full_like(size, np.sqrt(np.mean(size[seen] ** 2))) if common else size
    weight = np.broadcast_to(weight, seen.shape)[seen]
    scale = weight / size[seen] / np.sqrt(np.sum(weight**2))
    keys = tuple(f"{driver} {form} {k}" for k in np.flatnonzero(seen))
    visible = None if encoder is None else encoder[:, :, seen]
    yield Signature(UNMODELLED, joint, driver, form, keys, scale, twist[:, :, seen], visible)


def _of_position(at: Linearization) -> Iterable[Signature]:
    """Build fields over the workspace: the instrument's scale, and curved ones."""
    point = at.point
    driver = "the place of the target"
    moved = np.concatenate([np.broadcast_to(np.eye(3), (len(point), 3, 3)), point[:, :, None]], axis=2)
    scaled = np.concatenate([moved, np.zeros_like(moved)], axis=1)
    yield from _offer(None, driver, "scale", scaled, weight=np.array([1.0, 1.0, 1.0, 1.0 / SHAPES.far]))
    curves, degrees = _monomials(at, SHAPES.field_degree)
    yield from _offer(None, driver, "field", _times(_shifts(at), curves), weight=np.tile(SHAPES.far**-degrees, 3))


def _of_load(at: Linearization) -> Iterable[Signature]:
    """Build deflections proportional to the force in base or tool axes, misread forces, and unknown forces."""
    force, n = at.scene.wrench[:, :3], len(at.point)
    R = at.attained.frames.tcp_rotation
    local = np.einsum("nji,nj->ni", R, force)
    fixed, turned = np.zeros((n, 6, 3 * 3)), np.zeros((n, 6, 3 * 3))
    for column in range(3 * 3):
        i, k = divmod(column, 3)
        fixed[:, i, column] = force[:, k]
        turned[:, :3, column] = R[:, :, i] * local[:, k, None]
    yield from _offer(None, "the force in base axes", "linear", fixed, common=True)
    yield from _offer(None, "the force in tool axes", "linear", turned, common=True)
    if at.attained.chain.n_springs:
        twist, encoder = at.wrench_response(turned)
        yield from _offer(None, "force components that are mixed up", "linear", twist, encoder, common=True)


def _shifts(at: Linearization) -> Array:
    """Return shifts along the axes of the base. Shape (n, 6, 3)."""
    return np.broadcast_to(np.eye(6, 3), (len(at.point), 6, 3))


def _monomials(at: Linearization, degree: int) -> tuple[Array, Array]:
    """Return products of the target's coordinates, from their mean, in units of their spread, and their degrees.

    Shapes (n, k), (k,).
    """
    powers = [power for d in range(degree + 1) for power in combinations_with_replacement(range(3), d)]
    seen = (at.point - at.point.mean(axis=0)) / np.maximum(at.point.std(axis=0), ROUNDING)
    curves = np.column_stack([np.prod(seen[:, list(power)], axis=1) for power in powers])
    return curves, np.array([float(len(power)) for power in powers])


def _of_time(at: Linearization) -> Iterable[Signature]:
    """Build drifts of the base and of the tool: smooth motions without steps."""
    curves = time_curves(at.campaign)
    base = np.stack([at.twist("base", axis) for axis in AXES], axis=-1)
    yield from _offer(None, "time", "base", _times(base, curves))
    yield from _offer(None, "time", "tool", _times(tool_twists(at), curves[:, 1:]))


def _of_links(at: Linearization, *, bending: bool) -> Iterable[Signature]:
    """Build link rotations behind a joint that are proportional to the load on it."""
    for joint in at.robot.actuated:
        loads = np.stack([at.joint_load(joint.name, axis) for axis in AXES[3:]], axis=-1)
        turn = np.stack([at.twist(joint.name, axis) for axis in AXES[3:]], axis=-1)
        across = np.concatenate([turn * np.roll(loads, step, axis=1)[:, None] for step in (1, 2)], axis=-1)
        yield from _offer(joint.name, "the moments on it", "across", across, common=True)
        if bending:
            yield from _offer(joint.name, "the moments on it", "bending", turn * loads[:, None], common=True)


def _of_joint(at: Linearization, index: int) -> Iterable[Signature]:
    """Build errors about a joint's axis; link-side encoders, if there are any, may measure them or not."""
    name = at.robot.joint_names[index]
    for driver, form, shape in _own_errors(at, index):
        twist = at.motion[:, :, index, None] * shape[:, None]
        for signature in _offer(name, driver, form, twist, common=True):
            yield signature
            if at.campaign.link is not None and len(signature.scale) == shape.shape[1]:
                encoder = np.zeros((len(shape), at.robot.nq, shape.shape[1]))
                encoder[:, index] = shape
                yield replace(signature, form=f"{form}, seen by the encoder", encoder=encoder)


def _own_errors(at: Linearization, index: int) -> Iterable[tuple[str, str, Array]]:
    """Return errors that follow angles, loads, direction, speed, or the past: driver, form, shape (n, k)."""
    names = at.robot.joint_names
    campaign, q, load = at.campaign, np.nan_to_num(at.campaign.q), at.own_load
    typical = float(np.sqrt(np.mean(load[:, index] ** 2))) + 1e-9
    part = load[:, index] / typical
    for other in range(at.robot.nq):
        if other == index:
            continue
        if campaign.load_varies:
            yield f"the load on {names[other]}", "linear", load[:, [other]]
        if at.robot.actuated[other].kind == "revolute" and np.ptp(q[:, other]) > LEAST_RANGE:
            wave = np.column_stack([np.sin(q[:, other]), np.cos(q[:, other]) - np.cos(q[:, other]).mean()])
            yield f"the angle of {names[other]}", "wave", wave
    direction = campaign.approach[:, index]
    if (direction > 0).any() and (direction < 0).any():
        both = [direction, direction * np.abs(part), direction * part**2][: 3 if campaign.load_varies else 1]
        yield "load and direction of approach", "product", np.column_stack(both)
    speed = campaign.speed[:, index]
    if np.abs(speed).max(initial=0.0) > ROUNDING:
        fast = speed / np.abs(speed).max()
        slow = [np.sign(fast) * np.exp(-np.abs(fast) / width) for width in SHAPES.fading]
        yield "its speed", "friction", np.column_stack([fast, *slow])
    if campaign.time is not None and campaign.load_varies:
        past = np.column_stack([past_load(campaign.time, load[:, index], tau) for tau in SHAPES.creep_times])
        yield "its load of the past minutes", "creep", past


def time_curves(campaign: Campaign) -> Array:
    """Return polynomials and decays over time, or over the order of the rows. Shape (n, curves)."""
    clock = np.arange(len(campaign), dtype=float) if campaign.time is None else np.nan_to_num(campaign.time)
    span = max(float(np.ptp(clock)), 1e-9)
    share = (clock - clock.min()) / span
    early = np.exp(-share[:, None] / np.array(SHAPES.early))
    return np.concatenate(
        [legendre.legvander(2.0 * share - 1.0, SHAPES.time_degree), early - early.mean(axis=0)], axis=1
    )


def past_load(time: Array, load: Array, tau: float) -> Array:
    """Return the mean of a load over the past, with a time constant. Shape (n,)."""
    keep = np.exp(-np.maximum(np.diff(np.nan_to_num(time), prepend=np.nan_to_num(time[:1])), 0.0) / tau).tolist()
    strain, result = float(load[0]) if len(load) else 0.0, []
    for factor, value in zip(keep, load.tolist(), strict=True):
        strain = value + (strain - value) * factor
        result.append(strain)
    return np.array(result)


def _times(twists: Array, curves: Array) -> Array:
    """Multiply every twist with every curve. Shape (n, 6, a), (n, c) -> (n, 6, a c)."""
    return (twists[:, :, :, None] * curves[:, None, None, :]).reshape(len(twists), 6, -1)


Indices = NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class RevisedProbabilities:
    """Claims of a fit, re-estimated with unmodelled errors."""

    search: Search  #: The search whose prior holds unmodelled errors.
    model: Model  #: The remaining claims, with the posterior of all columns.
    classes: tuple[str, ...]  #: Driver of each loose class, in the order of the posterior's last `log_tau`.
    members: tuple[Indices, ...]  #: Columns of each loose class.


def class_of(signature: Signature) -> tuple[str, str]:
    """Return the driver of a signature, and "scale" for a scale error; joints share a class."""
    driver = str(signature.axis)
    if driver.startswith("the angle of"):
        driver = "the angles of other joints"
    if driver.startswith("the load on"):
        driver = "the load on other joints"
    return driver, "scale" if signature.form == "scale" else ""


def revise_probabilities(fit: Fit) -> RevisedProbabilities:
    """Re-estimate the claims of a fit with unmodelled errors in the model."""
    old = fit.search.equations
    equations = extend_normal_equations(old, unmodelled_signatures(fit))
    fresh = equations.signatures[len(old.signatures) :]
    kinds = list(dict.fromkeys(class_of(s) for s in fresh))
    numbers = range(len(old.signatures), len(equations.signatures))
    members = tuple(
        equations.join_columns(n for n in numbers if class_of(equations.signatures[n]) == kind) for kind in kinds
    )
    prior = _loosen(fit, equations, members)
    hyper = fit.model.posterior.hyper
    hyper = Hyper(
        hyper.log_noise, hyper.log_shared, np.concatenate([hyper.log_tau, np.full(len(kinds), EVIDENCE.start)])
    )
    odds = np.concatenate([fit.search.log_prior, np.full(len(fresh), -np.inf)])
    search = replace(fit.search, equations=equations, prior=prior, log_prior=odds, start=hyper, cache={})
    model = _search_again(search, search.model(fit.model.claims, hyper, steps=EVIDENCE.first_steps))
    if model.claims:
        # several claims together may fit one unmodelled error: restart without claims, classes at one noise floor
        grown = replace(hyper, log_tau=np.where(prior.loose, 0.0, hyper.log_tau))
        other = _search_again(search, search.model([], grown, steps=EVIDENCE.first_steps))
        model = other if other.score > model.score + SEARCH.least_gain else model
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
    """Remove claims that unmodelled errors explain as well, and add claims that raise the evidence."""
    while True:
        here = search.model(model.claims, model.posterior.hyper, fit=False)
        best = _leave_out(search, here)
        if best.score <= here.score:
            best = add_claim(search, model)
            if best.score < model.score + SEARCH.least_gain:
                return model
        fitted = search.model(best.claims, best.posterior.hyper, steps=STEPS)
        if fitted.score <= model.score:
            return model
        model = fitted


def _leave_out(search: Search, model: Model) -> Model:
    """Return the best model with one claim less, unmodelled errors refitted where they explain most of it."""
    loose = search.prior.loose
    hyper = model.posterior.hyper
    grown = replace(hyper, log_tau=np.where(loose, np.maximum(hyper.log_tau, 0.0), hyper.log_tau))
    less = [search.without(model.claims, out) for out in model.claims]
    tried = [search.model(rest, hyper, fit=False) for rest in less]
    starts = sorted((search.model(rest, grown, fit=False) for rest in less), key=lambda m: -rank_evidence(m.score))
    for start in starts[: SEARCH.tried]:
        posterior = find_posterior(search.equations, search.prior_of(start.claims), grown, steps=STEPS)
        score = start.score - start.posterior.log_evidence + posterior.log_evidence
        tried.append(Model(start.claims, posterior, score))
    return max(tried, key=lambda m: rank_evidence(m.score), default=replace(model, score=-np.inf))
