"""Delivery: the robot folder that a diagnosis writes, judged by what its model predicts of poses that it never saw.

The folder holds the posterior of named effects and small errors (`validation.calibration`); where that predicts poses
left out no better than the nominal robot by more than chance, the nominal robot is written.

Its parts in doubt are all that it holds beside its names: small errors and doubtful causes; and the names too, unless
they are beyond doubt or nothing is left that they do not explain; and every name that has rivals, which the campaign
cannot tell from it and a path elsewhere may. With g what the rest of the folder leaves of a stay that no fit saw, and m
the motion of the tip by the parts, the share w = g . m / |m|^2 of them was there, known to e / |m|, e^2 the mean square
per axis of what the whole folder leaves. From place to place it spreads by s,

    s^2 = max(sum |m|^2 (w - w_mean)^2 - sum v, 0) / sum |m|^2, w_mean = sum |m|^2 w / sum |m|^2,

v the variance per axis that noise alone gives the mean of a stay's rows.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import position_residual
from compplan.diagnosis.data.shared import NEGLIGIBLE, SAMPLE, SURE
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import Posterior
from compplan.diagnosis.results.posterior import name_alternatives, state_uncertainty
from compplan.diagnosis.results.verdict import Verdict, motion_of, noise_floor
from compplan.diagnosis.search.fit import register_again
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit, FitState, Problem, attain_state, stands
from compplan.diagnosis.validation.bounds import find_breach
from compplan.diagnosis.validation.calibration import calibrate, calibrated_state, hold_out_calibration, is_calibrated
from compplan.diagnosis.validation.held_out import Folds, HeldOut
from compplan.effects import fold_effects, is_of_instrument
from compplan.effects.linearization import Place
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty
from compplan.robot.validity import ValidityPart, ValidityRegion

NOMINAL, CALIBRATED = "nominal", "calibrated"
#: Share of the largest motion below which a stay says nothing (assumed: a thousandth).
STILL = 1e-3


@dataclass(frozen=True, eq=False)
class Delivery:
    """The robot folder and what it is worth.

    Attributes:
        kind: "nominal" or "calibrated".
        state: Effects, frames and rows of its exact model.
        held: What its model predicts of rows that it never saw.
        residual: Measured minus expected by its exact model, base axes, all rows. Shape (n, 3). [m]
        uncertainty: How surely it is known.
        posterior: The posterior that it holds; None for the nominal robot.
        visited: Its parts in doubt and how well they held at each stay; None without.
    """

    kind: str
    state: FitState
    held: HeldOut
    residual: Array
    uncertainty: Uncertainty
    posterior: Posterior | None = None
    visited: ValidityRegion | None = None

    def robot(self, nominal: Robot, known: int) -> Robot:
        """Return the robot folder: the nominal robot with the effects behind the `known` first ones."""
        visited = nominal.visited if self.posterior is None else self.visited
        folded = fold_effects(nominal, self.state.effects[known:])
        return replace(folded, uncertainty=self.uncertainty, visited=visited)


def deliver_robot(
    folds: Folds, verdict: Verdict, plain: HeldOut, nominal: FitState, good: NDArray[np.bool_]
) -> Delivery:  # fmt: skip
    """Build the calibrated robot; the nominal one where that predicts no better, by enough, than it.

    `plain` is what the nominal robot predicts, `nominal` its state; `good` tells rows that are no outliers. Shape (n,).
    """
    fit, every, problem = folds.fit, possible_claims(folds.fit, verdict), folds.fit.problem
    named = [Claim(f.signature, f.size) for f in verdict.findings if f.signature >= 0]
    seen, fold, rivals = good[plain.rows], folds.fold[plain.rows], name_alternatives(verdict)
    before = plain.of(seen)
    found = calibrate(folds, named)
    held = hold_out_calibration(folds, found)
    stated = held.correct_for_selection(fold, seen)
    # nothing goes out whose stated error is not below the nominal one
    better = held.of(seen).rms < (1.0 - NEGLIGIBLE) * before.rms and stated.of(seen).rms < before.rms
    values = found.posterior.values(fit.search.equations.p)
    state = calibrated_state(fit, values, found.named) if better else nominal
    if not better or not stands(problem, state):
        known = state_uncertainty(fit, every, nominal, plain, good, rivals)
        return Delivery(NOMINAL, nominal, plain, _residual(problem, nominal), known)
    state = settle_play(problem, register_again(fit, state, fit.state.use))
    known = state_uncertainty(fit, every, state, held, good, rivals)
    # names are in doubt where they leave something and are not beyond doubt themselves, and where others that the
    # campaign cannot tell from them may move the tip elsewhere in another way
    instead, signatures = {rival.instead for rival in known.rivals}, fit.search.equations.signatures
    sure = [
        Claim(f.signature, f.size)
        for f in verdict.findings
        if f.signature >= 0
        and (verdict.status == "explained" or f.probability >= SURE or is_of_instrument(f.effect.name))
        and " ".join(part for part in signatures[f.signature].place if part) not in instead
    ]
    rest, places = folds.hold_out(sure), {signatures[claim.signature].place for claim in sure}
    visited = list_visits(fit, state, found.named, places, rest, held, seen)
    return Delivery(CALIBRATED, state, stated, _residual(problem, state), known, found.posterior, visited)


def possible_claims(fit: Fit, verdict: Verdict) -> list[Claim]:
    """List claims that may be true and can be delivered: named ones, and others that are no part of the instrument.

    What errors without a name explain as well is among them: poses never seen decide what it is worth. What no robot
    can have is not, for a plan may lead far from all poses.
    """
    equations, gap = fit.search.equations, verdict.structure.gap
    values = fit.model.posterior.values(equations.p)
    claims = {f.signature: f.size for f in verdict.findings if f.signature >= 0}
    beyond = {f.signature for f in verdict.doubtful if f.beyond}
    beside = [Claim(f.signature, f.size) for f in (*verdict.minor, *verdict.doubtful)]
    for claim in (*beside, *fit.model.claims):
        signature, columns = equations.signatures[claim.signature], equations.columns(claim.signature)
        effect = signature.effect(values[columns] * signature.scale)
        if claim.signature in beyond or is_of_instrument(signature.name):
            continue
        if not find_breach(fit, effect, motion_of(fit.search, columns, values), gap):
            claims.setdefault(claim.signature, claim.size)
    return [Claim(number, size) for number, size in claims.items()]


def _residual(problem: Problem, state: FitState) -> Array:
    return position_residual(problem.campaign, *attain_state(problem, state))


def settle_play(problem: Problem, state: FitState) -> FitState:
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
            gap = position_residual(campaign, *attain_state(problem, replace(state, effects=tuple(effects))))[first]
            tries.append((float(np.median(np.linalg.norm(gap, axis=1))), start, effects[number]))
        effects[number] = min(tries, key=lambda t: t[:2])[2]
    return replace(state, effects=tuple(effects))


def list_visits(
    fit: Fit, state: FitState, claims: Sequence[int], sure: Collection[Place], rest: HeldOut, whole: HeldOut,
    seen: NDArray[np.bool_],
) -> ValidityRegion | None:  # fmt: skip
    """List the parts in doubt of a folder and how well they held at the stays of its campaign; None without parts.

    Args:
        fit: The fit.
        state: What the folder holds.
        claims: Signatures that it claims: the form of each that is written.
        sure: Places of effects that are not in doubt.
        rest: What the folder without these parts leaves of rows that no fit saw.
        whole: What the whole folder leaves of them.
        seen: Rows of these that are no outliers. Shape (r,).
    """
    parts = _list_parts(fit, state, claims, sure)
    if not parts or not seen.any():
        return None
    rows = whole.rows[seen]
    campaign = fit.problem.campaign
    _, first, stay = np.unique(campaign.stay[rows], return_index=True, return_inverse=True)
    count = np.bincount(stay.reshape(-1))
    left, gap = (
        np.stack([np.bincount(stay.reshape(-1), side.residual[seen, k]) / count for k in range(3)], axis=1)
        for side in (whole, rest)
    )
    motion = gap - left
    length = np.linalg.norm(motion, axis=1)
    moves = np.flatnonzero(length > STILL * length.max(initial=0.0))
    if not len(moves):
        return None
    along = np.einsum("ni,ni->n", gap[moves], motion[moves]) / length[moves]
    off = along - length[moves] * float(along @ length[moves] / np.sum(length[moves] ** 2))
    told = float(fit.search.equations.source[0].told[seen].mean())  # axes of a position, one number of a gauge
    noise = noise_floor(fit) ** 2 / told / count[moves]
    # a gauge sees one of three axes of the motion that the share is of (assumed: as much along each)
    whole_motion = float(np.sum(length[moves] ** 2)) * left.shape[1] / told
    spread = float(np.sqrt(max(np.sum(off**2 - noise), 0.0) / whole_motion))
    moves = moves[np.unique(np.linspace(0, len(moves) - 1, SAMPLE).astype(int))]
    at, size = rows[first[moves]], length[moves]
    share = np.einsum("ni,ni->n", gap[moves], motion[moves]) / size**2
    error = max(float(np.sqrt(np.mean(np.sum(left**2, axis=1)) / told)), 1e-9)
    q, wrench = np.nan_to_num(campaign.q[at]), np.nan_to_num(campaign.wrench[at])
    return ValidityRegion(parts, q, wrench, share, error / size, spread)


def _list_parts(fit: Fit, state: FitState, claims: Sequence[int], sure: Collection[Place]) -> tuple[ValidityPart, ...]:
    """List what a folder holds beside its sure causes, each column once."""
    equations, taken, parts = fit.search.equations, set[int](), []
    held = {effect.place for effect in state.effects}
    for number in [*claims, *(n for n in range(len(equations.signatures)) if n not in claims)]:
        signature = equations.signatures[number]
        if signature.name == REGISTRATION or is_of_instrument(signature.name) or signature.place not in held:
            continue
        columns = [
            int(c) for c in equations.columns(number) if int(c) not in taken and equations.names[c] in state.values
        ]
        if not columns or (number not in claims and not is_calibrated(signature)):
            continue
        taken.update(columns)
        if signature.place in sure:
            continue
        keys = {int(c): key for c, key in zip(equations.columns(number), signature.keys, strict=True)}
        value = np.array([state.values[equations.names[c]] for c in columns])
        if value.any() and len(columns) == len(keys):
            fixed = dict(signature.fixed)
            parts.append(ValidityPart(*signature.place, tuple(keys[c] for c in columns), value, fixed))
    return tuple(parts)
