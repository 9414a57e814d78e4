"""Posterior: parameter uncertainty of the updated robot, and the error that no parameter explains.

The parameters of claims and small errors are normal about their posterior mean, covariance S. Of those that the robot
folder does not hold, the mean m counts as well: the second moment about the folder is S + m m^T.

A claim of values a moves the rows by H a. An effect that the campaign cannot distinguish from it fits that motion with
values b, the least squares of H_b b against H a, frames fitted to both, and leaves d of its squares in units of the
noise variance. Claim and alternatives have weights 1 and exp(-d / 2), normalised; an alternative is off the folder by
(-a, b) where this holds the claim, by (0, b) where it does not, and adds w m m^T with m that difference.

What held-out poses show beyond noise and parameters is unexplained. A conformal step widens both until the band holds
those poses. Intervals of named effects hold given that these, and no others, are present.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.data.shared import HALF_WIDTH, LEVEL, NEGLIGIBLE, SAMPLE
from compplan.diagnosis.evidence.candidates import REGISTRATION, in_background
from compplan.diagnosis.evidence.evidence import EVIDENCE, Posterior
from compplan.diagnosis.results.verdict import Verdict, unname
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit, FitState
from compplan.diagnosis.validation.held_out import HeldOut, with_claims
from compplan.diagnosis.validation.probability import AlternativeEffect, imitate_claim
from compplan.diagnosis.validation.unmodelled import UNMODELLED
from compplan.effects import is_of_instrument
from compplan.effects.checks import limit_sizes
from compplan.effects.forward_model import own_springs
from compplan.effects.signature import Effect, Signature
from compplan.measurement.distance import calibrate_band
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown, split_unknowns, spread_unknowns
from compplan.uncertainty.assumed import free_base

#: Frames of a campaign and of a tool are no causes in a robot.
FRAMES = ("base_frame", "tool_frame", "tool_shift", "frame_shift")
#: Distances over which an unexplained error may forget itself (assumed). [m]
SCALES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.3)
#: What is taken where poses are too few to tell: the middle of them. [m]
SCALE = SCALES[len(SCALES) // 2]
#: Fewest poses whose pairs tell that distance (assumed: thirty poses have four hundred pairs).
FEWEST_POSES = 30


@dataclass(frozen=True, eq=False)
class _Known:
    """Parameters of the posterior: columns, second moment about the folder, means that it lacks."""

    unknowns: tuple[Unknown, ...]
    columns: NDArray[np.int_]
    moment: Array
    missing: Array


def state_uncertainty(
    fit: Fit, claims: list[Claim], state: FitState, held: HeldOut, good: NDArray[np.bool_],
    rivals: Mapping[int, Sequence[AlternativeEffect]] | None = None,
) -> Uncertainty:  # fmt: skip
    """State how surely the delivered robot is known.

    Args:
        fit: The fit.
        claims: Claims that may be true, named or not.
        state: What is delivered; no values for the nominal robot.
        held: What the delivered model leaves on poses that it never saw.
        good: Rows that are no outliers. Shape (n,).
        rivals: Effects that the campaign cannot tell from a claim, by its signature.
    """
    fitted = with_claims(_with_usual_classes(fit), claims, background=True)
    known = _collect(fitted, claims, state)
    campaign, channel = fit.problem.campaign, fit.search.equations.source[0]
    noise = channel.sigma[:, 0] ** 2 + channel.noise.stay**2
    model = _model_covariance(fitted, known)
    seen = good[channel.rows]
    left, told, axes = held.residual[seen], channel.told[seen], channel.axes[seen]
    excess = np.sum(left**2, axis=1) - told * noise[seen] - np.trace(model[seen], axis1=1, axis2=2)
    # one number of a gauge or a bar shows one of three axes
    unexplained = float(np.sqrt(max(axes.shape[1] * excess.sum() / told.sum(), 0.0))) if len(left) else 0.0
    place = fit.at.point[channel.rows][seen]
    pose = group_poses(campaign)[channel.rows][seen]
    along = unexplained**2 / axes.shape[1] * axes
    factor, groups = calibrate_band(left, model[seen] + along, noise[seen][:, None, None] * axes, pose)
    mean = fitted.model.posterior.values(fitted.search.equations.p)
    others = explain_otherwise(fit, state, mean, rivals or {})
    known = _add_rivals(known, others)
    unknowns, root = spread_unknowns(known.unknowns, known.moment)
    name = campaign.file.name if campaign.file else "a campaign"
    scatter = fit.problem.robot.repeatability or channel.noise.stay or None
    stated = Uncertainty(
        grade="measured",
        source=f"diagnosed from {name}, {int(good.sum())} rows at {len(np.unique(pose))} poses",
        unknowns=unknowns,
        factor=root,
        unexplained=unexplained,
        scale=find_scale(place, left, pose) if unexplained > 0 else SCALE,
        repeatability=scatter,
        calibration=factor,
        groups=groups,
    )
    frames = state.registration
    adrift = frames is not None and ("base" in frames.parts or campaign.adrift)
    return free_base(fit.problem.robot, stated) if adrift else stated


def size_named(fit: Fit, posterior: Posterior, verdict: Verdict, calibration: float) -> tuple[Verdict, Uncertainty]:
    """Give named effects the sizes that they have in the calibration, and state their covariance.

    Effects whose 95 % region contains zero are named no more: with values v and covariance C, v^T C^-1 v below the 95 %
    point of chi-square. `posterior` is that of the calibration, `calibration` the factor of all deviations that makes
    bands hold poses left out.
    """
    robot, equations = fit.problem.robot, fit.search.equations
    values, findings, told = posterior.values(equations.p), [], set[int]()
    unknowns, columns = [], np.zeros(0, int)
    for finding in verdict.findings:
        if finding.signature >= 0:
            signature, own = equations.signatures[finding.signature], equations.columns(finding.signature)
            size = limit_sizes(robot, signature, values[own] * signature.scale)
            finding = replace(finding, effect=signature.effect(size))
            if 2.0 * posterior.loss_without(own) > calibration**2 * chdtri(len(own), 1.0 - LEVEL):
                told.add(finding.signature)
            if np.isin(own, posterior.columns).all() and not np.isin(own, columns).any():
                unknowns.append(Unknown(*signature.place, signature.keys, np.zeros(len(own)), dict(signature.fixed)))
                columns = np.r_[columns, own]
        findings.append(finding)
    at = np.searchsorted(posterior.columns, columns)
    covariance = posterior.covariance[np.ix_(at, at)] * np.outer(equations.scale[columns], equations.scale[columns])
    spread, factor = spread_unknowns(unknowns, covariance)
    sizes = Uncertainty("measured", "named effects", spread, factor, calibration=calibration)
    return unname(replace(verdict, findings=tuple(findings)), told), sizes


def _with_usual_classes(fit: Fit) -> Fit:
    """Let no class of the background be smaller than usual: that a few poses did not show it does not make it nothing.

    Where many poses tell a parameter, its prior hardly counts; where few do, it is what is left of the parameter.
    """
    posterior = fit.model.posterior
    hyper = posterior.hyper
    usual = replace(hyper, log_tau=np.maximum(hyper.log_tau, np.log(EVIDENCE.tau_scale)))
    return replace(fit, model=replace(fit.model, posterior=replace(posterior, hyper=usual)))


def _collect(fitted: Fit, claims: Sequence[Claim], state: FitState) -> _Known:
    """Collect parameters of the claims, then of the background, each once."""
    equations, posterior = fitted.search.equations, fitted.model.posterior
    place = {int(column): number for number, column in enumerate(posterior.columns)}
    claimed = [claim.signature for claim in claims]
    taken: set[int] = set()
    unknowns, columns = [], []
    for number in [*claimed, *(n for n in range(len(equations.signatures)) if n not in claimed)]:
        signature = equations.signatures[number]
        if signature.name in (REGISTRATION, UNMODELLED) or is_of_instrument(signature.name):
            continue
        if number not in claimed and not in_background(signature):
            continue
        own = [(int(c), key) for c, key in zip(equations.columns(number), signature.keys, strict=True)]
        own = [(c, key) for c, key in own if c in place and c not in taken]
        if own:
            taken |= {c for c, _ in own}
            columns += [c for c, _ in own]
            keys = tuple(key for _, key in own)
            empty = np.zeros(len(own))
            unknowns.append(
                Unknown(signature.name, signature.joint, signature.axis, keys, empty, dict(signature.fixed))
            )
    at = np.array([place[c] for c in columns], int)
    scale = equations.scale[columns]
    held = np.array([state.values.get(equations.names[c], 0.0) for c in columns])
    missing = np.where(held == 0.0, posterior.mean[at] * scale, 0.0)
    moment = posterior.covariance[np.ix_(at, at)] * np.outer(scale, scale) + np.outer(missing, missing)
    return _Known(tuple(unknowns), np.array(columns, int), moment, missing)


def _add_rivals(known: _Known, explanations: Sequence[Explanation]) -> _Known:
    """Add what the robot is off under rival explanations to the second moment.

    A cause changes the robot by d, which is d_r with weight w_r and else nothing. The mean that the folder lacks
    becomes m + sum E(d), and its second moment grows by the covariances of all d.
    """
    unknowns, columns = list(known.unknowns), known.columns.tolist()
    for one in explanations:
        theirs = zip(one.columns[-len(one.signature.keys) :], one.signature.keys, strict=True)
        new = [(int(c), key) for c, key in theirs if int(c) not in columns]
        if new:
            keys, s = tuple(key for _, key in new), one.signature
            unknowns.append(Unknown(s.name, s.joint, s.axis, keys, np.zeros(len(new)), dict(s.fixed)))
            columns += [c for c, _ in new]
    p, grown = len(columns), len(columns) - len(known.columns)
    missing = np.pad(known.missing, (0, grown))
    moment = np.pad(known.moment, (0, grown)) - np.outer(missing, missing)
    means: dict[tuple[str, str | None, str | None], Array] = {}
    for one in explanations:
        change = np.zeros(p)
        for column, moved in zip(one.columns, one.change, strict=True):
            if column in columns:
                change[columns.index(column)] = moved
        moment += one.weight * np.outer(change, change)
        means[one.instead.place] = means.get(one.instead.place, np.zeros(p)) + one.weight * change
    for mean in means.values():
        moment -= np.outer(mean, mean)
    missing = missing + sum(means.values(), np.zeros(p))
    moment += np.outer(missing, missing)
    return _Known(tuple(unknowns), np.array(columns, int), moment, missing)


def _model_covariance(fitted: Fit, known: _Known) -> Array:
    """Return the covariance of what the model says of each row's position, frames included. Shape (r, 3, 3). [m^2]."""
    equations, posterior = fitted.search.equations, fitted.model.posterior
    scale = equations.scale[known.columns]
    moment = posterior.covariance.copy()
    at = np.searchsorted(posterior.columns, known.columns)
    moment[np.ix_(at, at)] = known.moment / np.outer(scale, scale)
    design = equations.designs[0][..., posterior.columns] * equations.source[0].sigma[:, :, None]
    return np.asarray(design @ moment @ np.swapaxes(design, 1, 2))


def find_scale(place: Array, left: Array, pose: NDArray[np.int_]) -> float:
    """Find the distance over which errors that are left (n, 3) forget themselves, from pairs of places (n, 3). [m]

    Least squares of r_i . r_j against a exp(-d_ij^2 / 2 l^2) over pairs of different poses, a >= 0 free.
    """
    _, index, count = np.unique(pose, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    if len(count) < FEWEST_POSES:
        return SCALE
    mean = [np.stack([np.bincount(index, part[:, k]) / count for k in range(3)], axis=1) for part in (place, left)]
    few = np.unique(np.linspace(0, len(count) - 1, SAMPLE).astype(int))
    at, error = mean[0][few], mean[1][few]
    i, j = np.triu_indices(len(at), 1)
    square, product = np.sum((at[i] - at[j]) ** 2, axis=1), np.einsum("ni,ni->n", error[i], error[j])
    tries = []
    for scale in SCALES:
        shape = np.exp(-0.5 * square / scale**2)
        size = max(float(shape @ product) / max(float(shape @ shape), 1e-30), 0.0)
        tries.append((float(np.sum((product - size * shape) ** 2)), scale if size > 0 else SCALE))
    return min(tries)[1]


@dataclass(frozen=True, eq=False)
class Explanation:
    """Another explanation of a claim."""

    instead: Signature  #: The claim.
    signature: Signature  #: The other effect.
    weight: float  #: Its probability, claim and rivals together one.
    columns: NDArray[np.int_]  #: Columns that it moves, those of the claim and its own.
    change: Array  #: What it moves them by from what the claim says. [SI]


def name_alternatives(verdict: Verdict) -> dict[int, tuple[AlternativeEffect, ...]]:
    """List for every claim of a verdict, by its signature, the effects that the campaign cannot tell from it."""
    found = (*verdict.findings, *verdict.minor, *verdict.doubtful)
    return {f.signature: tuple(rival for rival in f.rivals if rival.alike) for f in found if f.signature >= 0}


def explain_otherwise(
    fit: Fit, state: FitState, mean: Array, rivals: Mapping[int, Sequence[AlternativeEffect]]
) -> list[Explanation]:
    """Find what the robot would be under the rivals of the claims that may be true, by signature.

    `mean` is the posterior mean of every column, in units of its scale. Shape (p,).
    """
    equations, found = fit.search.equations, []
    for number, others in rivals.items():
        own = equations.columns(number)
        held = np.array([state.values.get(equations.names[column], 0.0) for column in own]) / equations.scale[own]
        claimed = held if held.any() else mean[own]
        if not claimed.any() or is_of_instrument(equations.signatures[number].name):
            continue
        mine: list[tuple[Explanation, float]] = []
        for rival in others:
            if rival.place[0] in FRAMES or is_of_instrument(rival.place[0]):
                continue
            other, values, left = imitate_claim(fit, number, rival.place, claimed)
            signature, theirs = equations.signatures[other], equations.columns(other)
            if np.intersect1d(own, theirs).size or (signature.positive and (values < 0.0).any()):
                continue
            columns = np.r_[own, theirs]
            change = np.r_[-claimed, values] * equations.scale[columns]
            one = Explanation(equations.signatures[number], signature, 0.0, columns, change)
            mine.append((one, float(np.exp(-0.5 * left))))
        total = 1.0 + sum(weight for _, weight in mine)
        for one, weight in mine:
            if weight / total >= NEGLIGIBLE:
                found.append(replace(one, weight=weight / total))
    return found


def state_change(robot: Robot, effect: Effect, sizes: Uncertainty) -> dict[str, Any]:
    """State the intervals of an effect's parameters, which hold 95 % where the effect is present.

    Returns:
        "interval95": lower and upper end by parameter, where one is known; and, of a joint's compliance that the model
        knows, "change_percent": value, lower and upper end in percent of the model's.
    """
    deviation = {
        key: float(sigma)
        for unknown, widths in split_unknowns(sizes.unknowns, sizes.width)
        if (unknown.effect, unknown.joint, unknown.axis) == tuple(effect.place)
        for key, sigma in zip(unknown.keys, widths, strict=True)
    }
    ends = {
        key: [float(value) - HALF_WIDTH * deviation[key], float(value) + HALF_WIDTH * deviation[key]]
        for key, value in effect.parameters.items()
        if key in deviation
    }
    if not ends:
        return {}
    found: dict[str, Any] = {"interval95": ends}
    if effect.name == "joint_stiffness":
        spring = own_springs(robot).get(robot.joint_names.index(str(effect.joint)))
        key = next(iter(ends))
        if spring is not None and spring.compliance > 0.0:
            found["change_percent"] = [
                round(100.0 * value / spring.compliance, 2) for value in (float(effect.parameters[key]), *ends[key])
            ]
    return found
