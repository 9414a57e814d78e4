"""Delivery: the robot folders that a diagnosis writes, each judged by what it predicts of poses that it never saw.

Two folders at most: `causes` holds the named effects alone, `calibrated` what a calibration finds as well, mixed of
all models by what they predict (`doubt.blend`), or a plain calibration alone where that predicts better than the
mixture. The one that predicts held-out poses better is delivered as `robot`; every figure of the page belongs to it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import position_residual
from compplan.diagnosis.data.shared import NEGLIGIBLE, SAMPLE, SURE, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.results.posterior import name_alternatives, state_uncertainty
from compplan.diagnosis.results.verdict import Verdict, noise_floor
from compplan.diagnosis.search.fit import polish_fit, register_again
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit, FitState, Problem, advance_state, attain_state, stands
from compplan.diagnosis.validation.held_out import Folds, HeldOut, with_claims
from compplan.diagnosis.validation.mixture import (
    PLAIN,
    StackedModel,
    build_state,
    hold_out_small,
    hold_out_stack,
    is_built,
    list_options,
    stack_options,
    stack_single,
)
from compplan.effects import Effect, fold_effects, is_of_instrument
from compplan.effects.linearization import Place
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty
from compplan.robot.validity import ValidityPart, ValidityRegion

NOMINAL, CAUSES, CALIBRATED = "nominal", "causes", "calibrated"


@dataclass(frozen=True, eq=False)
class Delivery:
    """A robot folder and what it is worth.

    Attributes:
        kind: "nominal", "causes" or "calibrated".
        state: Effects, frames and rows of its exact model.
        held: What its model predicts of rows that it never saw.
        fitted: Fit with its claims, whose posterior tells how sure its parameters are; None for the nominal robot.
        residual: Measured minus expected by its exact model, base axes, all rows. Shape (n, 3). [m]
        uncertainty: How surely it is known.
        small: What small errors alone predict of rows that they never saw; None for no mixture.
        visited: Its parts in doubt and how well they held at each stay; None without.
    """

    kind: str
    state: FitState
    held: HeldOut
    fitted: Fit | None
    residual: Array
    uncertainty: Uncertainty
    small: HeldOut | None = None
    visited: ValidityRegion | None = None

    def folder(self, number: int) -> str:
        """Return the name of its folder, the first being `robot`."""
        return f"robot_{self.kind}" if number else "robot"

    def to_json(self, number: int) -> dict[str, Any]:
        """Return what diagnosis.json says of it, its place among the folders given."""
        held = round(1e3 * self.held.rms, 5)
        return {"folder": self.folder(number), "kind": self.kind, "held_out_rms_mm": held}

    def robot(self, nominal: Robot, known: int) -> Robot:
        """Return the robot folder: the nominal robot with the effects behind the `known` first ones."""
        visited = nominal.visited if self.fitted is None else self.visited
        folded = fold_effects(nominal, self.state.effects[known:])
        return replace(folded, uncertainty=self.uncertainty, visited=visited)


def deliver_folders(
    folds: Folds, verdict: Verdict, plain: HeldOut, nominal: FitState, good: NDArray[np.bool_]
) -> tuple[Delivery, ...]:
    """Build the folders that are worth delivering, the one to use first.

    Named causes alone come first where the mixture of all that may be wrong does not predict better.

    Args:
        folds: The fit, dealt to folds.
        verdict: Its verdict.
        plain: What the nominal robot predicts.
        nominal: FitState of the nominal robot.
        good: Rows that are no outliers. Shape (n,).
    """
    fit = folds.fit
    named = [Claim(f.signature, f.size) for f in verdict.findings if f.signature >= 0]
    beyond = confident_claims(verdict)
    every = possible_claims(verdict)
    seen = good[plain.rows]
    blend = stack_options(folds, list_options(every), seen)
    # few poses choose weights badly, and an option whose derivatives promise too much is in no mixture
    plainly = stack_single(folds, PLAIN)
    evaluated: list[tuple[str, Sequence[Claim] | StackedModel, HeldOut]] = [
        (CAUSES, named, folds.hold_out(named, background=False)),
        (CALIBRATED, blend, hold_out_stack(folds, blend)),
        (CALIBRATED, plainly, hold_out_stack(folds, plainly)),
    ]
    sure = partial(state_uncertainty, fit, every, good=good, rivals=name_alternatives(verdict))
    nothing = Delivery(NOMINAL, nominal, plain, None, _residual(fit.problem, nominal), sure(nominal, plain))
    useful = [option for option in evaluated if _is_better(option[2].of(seen), plain.of(seen), folds.pose[seen])]
    if not useful:
        return (nothing,)
    first = useful[0]
    for option in useful[1:]:
        if option[2].of(seen).rms < (1.0 - NEGLIGIBLE) * first[2].of(seen).rms:
            first = option
    fold = folds.fold[plain.rows]
    nested = first[2].nest_choice([held for _, _, held in useful], fold, seen)
    first = (*first[:2], nested)
    second = [o for o in useful if o[0] != first[0] and (isinstance(o[1], StackedModel) or o[1])]
    chosen = [first, *sorted(second, key=lambda o: rank_number(o[2].rms))[:1]]
    small = hold_out_small(folds, blend, seen)
    built = [(model, _build(fit, kind, model, held, sure, small)) for kind, model, held in chosen]
    delivered = [(_forms(model), delivery) for model, delivery in built if delivery is not None]
    # names are in doubt where they leave something and are not beyond doubt themselves
    rivals = {rival.instead for _, one in delivered for rival in one.uncertainty.rivals}
    # and where others that the campaign cannot tell from them may move the tip elsewhere in another way
    trusted = [
        claim for claim in (named if verdict.status == "explained" else beyond)
        if " ".join(part for part in fit.search.equations.signatures[claim.signature].place if part) not in rivals
    ]  # fmt: skip
    rest = folds.hold_out(trusted, background=False)
    places = {fit.search.equations.signatures[claim.signature].place for claim in trusted}
    stated = [
        replace(
            one, visited=list_visits(fit, one.state, forms, places, rest, one.held, seen),
            held=one.held.correct_for_selection(fold, seen),
        ) for forms, one in delivered
    ]  # fmt: skip
    # nothing goes out whose stated error is not below that of the robot as it is
    return tuple(one for one in stated if one.held.of(seen).rms < plain.of(seen).rms) or (nothing,)


def _forms(model: Sequence[Claim] | StackedModel) -> list[int]:
    """List the signatures that a model claims."""
    return model.claimed() if isinstance(model, StackedModel) else [claim.signature for claim in model]


def _is_better(new: HeldOut, nominal: HeldOut, pose: NDArray[np.int_]) -> bool:
    """Tell whether an updated robot predicts better than the nominal one: by enough, and not by luck.

    That a folder is there to be tested is evidence already, its causes are named or its small errors are fitted;
    held-out poses can only veto it, and seven of them, all predicted better, are worth one case of 128.
    """
    return new.rms < (1.0 - NEGLIGIBLE) * nominal.rms and new.selection_bonus(nominal, pose) < 1.0 - SURE


def confident_claims(verdict: Verdict) -> list[Claim]:
    """List named claims that are beyond doubt, or part of the instrument: these go out only where they are named."""
    sure = [f for f in verdict.findings if f.probability >= SURE or of_instrument(f.effect)]
    return [Claim(f.signature, f.size) for f in sure if f.signature >= 0]


def possible_claims(verdict: Verdict) -> list[Claim]:
    """List claims that may be true and can be delivered: named ones, and others that are no part of the instrument.

    What errors without a name explain as well is among them: poses never seen decide what it is worth. What no robot
    can have is not, for a plan may lead far from all poses.
    """
    unnamed = [f for f in (*verdict.minor, *verdict.doubtful) if not of_instrument(f.effect) and not f.beyond]
    sizes = {f.signature: f.size for f in (*verdict.findings, *unnamed) if f.signature >= 0}
    return [Claim(number, size) for number, size in sizes.items()]


def _build(
    fit: Fit, kind: str, model: Sequence[Claim] | StackedModel, held: HeldOut,
    sure: Callable[[FitState, HeldOut], Uncertainty], small: HeldOut,
) -> Delivery | None:  # fmt: skip
    """Fit a folder to all rows, exactly; None where its robot finds no equilibrium."""
    if isinstance(model, StackedModel):
        fitted, state = model.fitted(fit), build_state(fit, model.values(fit.search.equations.p), model.claimed())
    else:
        fitted = with_claims(fit, model, background=kind == CALIBRATED)
        state = polish_fit(replace(fitted, state=advance_state(fitted), base=fit.base or fit.state)).state
    if not stands(fit.problem, state):
        return None
    if isinstance(model, StackedModel):
        state = register_again(fit, state, fit.state.use)
    state = settle_play(fit.problem, state)
    residual = _residual(fit.problem, state)
    return Delivery(kind, state, held, fitted, residual, sure(state, held), small if kind == CALIBRATED else None)


def _residual(problem: Problem, state: FitState) -> Array:
    return position_residual(problem.campaign, *attain_state(problem, state))


def of_instrument(effect: Effect) -> bool:
    """Tell whether an effect is no part of the robot: instrument, sensor or clock. It is delivered only where named."""
    return is_of_instrument(effect.name)


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


#: Share of the largest motion below which a stay says nothing (assumed: a thousandth).
STILL = 1e-3


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
        if not columns or (number not in claims and not is_built(signature)):
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
