"""Delivery: the robot folders that a diagnosis writes, each judged by what it predicts of poses that it never saw.

Two folders at most: `causes` holds the named effects alone, `calibrated` the small errors everywhere as well. The one
that predicts held-out poses better is delivered as `robot`; every figure of the page belongs to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.channels import block_index, position_residual
from compplan.diagnose.explanations import name_rivals
from compplan.diagnose.held_out import Folds, HeldOut, with_claims
from compplan.diagnose.polish import polish_fit
from compplan.diagnose.posterior import state_uncertainty
from compplan.diagnose.search import Claim
from compplan.diagnose.state import Fit, FitState, Problem, advance_state, attain_state, stands
from compplan.diagnose.verdict import Verdict
from compplan.effects import Effect, fold_effects, is_of_instrument
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty

#: An updated robot has to shrink the held-out gap by this share, or the nominal one stays; a larger model has to
#: shrink what a smaller one leaves by the second share (assumed: less is worth no change on the shop floor).
WORTH_IT, WORTH_MORE = 0.01, 0.02
#: Luck may be as good as the held-out poses show in one case of so many at most (assumed). That a folder is there to be
#: tested is evidence already, its causes are named or its small errors are fitted; held-out poses can only veto it, and
#: seven of them, all predicted better, are worth one case of 128.
LUCK = 0.1
#: From this many stays on, the choice of a few claims adds little to what held-out poses show: ten among two hundred
#: places are worth 2 * 10 * log(200) of 3 * 400 values, 5 % of the error (assumed; [FosterGeorge1994]).
MANY_STAYS = 400
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
    """

    kind: str
    state: FitState
    held: HeldOut
    fitted: Fit | None
    residual: Array
    uncertainty: Uncertainty

    def folder(self, number: int) -> str:
        """Return the name of its folder, the first being `robot`."""
        return f"robot_{self.kind}" if number else "robot"

    def to_json(self, number: int) -> dict[str, Any]:
        """Return what diagnosis.json says of it, its place among the folders given."""
        held = round(1e3 * self.held.rms, 5)
        return {"folder": self.folder(number), "kind": self.kind, "held_out_rms_mm": held}

    def robot(self, nominal: Robot, known: int) -> Robot:
        """Return the robot folder: the nominal robot with the effects behind the `known` first ones."""
        return replace(fold_effects(nominal, self.state.effects[known:]), uncertainty=self.uncertainty)


def deliver_folders(
    folds: Folds, verdict: Verdict, plain: HeldOut, nominal: FitState, good: NDArray[np.bool_]
) -> tuple[Delivery, ...]:
    """Build the folders that are worth delivering, the one to use first.

    Named causes alone come first where small errors everywhere, or claims that are too improbable to be named, do not
    predict better.

    Args:
        folds: The fit, dealt to folds.
        verdict: Its verdict.
        plain: What the nominal robot predicts.
        nominal: State of the nominal robot.
        good: Rows that are no outliers. Shape (n,).
    """
    fit = folds.fit
    named = [Claim(f.signature, f.size) for f in verdict.findings if f.signature >= 0]
    every = possible_claims(verdict)
    judged = [(CAUSES, named, folds.hold_out(named, background=False)), (CALIBRATED, named, folds.hold_out(named))]
    seen = good[plain.rows]
    if len(every) > len(named):
        judged.append((CALIBRATED, every, hold_out_doubtful(folds, named, every, seen)))
    sure = partial(state_uncertainty, fit, every, good=good, rivals=name_rivals(verdict))
    rest = Delivery(NOMINAL, nominal, plain, None, _residual(fit.problem, nominal), sure(nominal, plain))
    useful = [option for option in judged if _is_better(option[2].of(seen), plain.of(seen), folds.pose[seen])]
    if not useful:
        return (rest,)
    first = useful[0]
    for option in useful[1:]:
        if option[2].of(seen).rms < (1.0 - WORTH_MORE) * first[2].of(seen).rms:
            first = option
    second = [o for o in useful if o[0] != first[0] and o[1]]
    chosen = [first, *sorted(second, key=lambda o: o[2].rms)[:1]]
    built = [_build(fit, kind, claims, held, sure) for kind, claims, held in chosen]
    return tuple(delivery for delivery in built if delivery is not None) or (rest,)


def _is_better(new: HeldOut, nominal: HeldOut, pose: NDArray[np.int_]) -> bool:
    """Tell whether an updated robot predicts better than the nominal one: by enough, and not by luck."""
    return new.rms < (1.0 - WORTH_IT) * nominal.rms and new.luck_against(nominal, pose) < LUCK


def hold_out_doubtful(
    folds: Folds, named: Sequence[Claim], every: Sequence[Claim], seen: NDArray[np.bool_]
) -> HeldOut:  # fmt: skip
    """Predict every row by claims of which some are in doubt: as they are, or chosen again, whichever is worse.

    They have been chosen among hundreds of forms: few poses choose others of what may be delivered, and that counts.
    Forms that have been looked for in all rows, the best of t, stay the same in every fold and are better there than
    elsewhere by as much as the best of t is by chance, 2 log t squares of the noise [FosterGeorge1994].

    Args:
        folds: The fit, dealt to folds.
        named: Claims that are not in doubt.
        every: These and the others.
        seen: Predicted rows that are no outliers. Shape (r,).
    """
    fit, signatures = folds.fit, folds.fit.search.ledger.signatures
    held = folds.hold_out(every)
    if len(np.unique(block_index(fit.problem.campaign))) < MANY_STAYS:
        places = {signatures[claim.signature].place for claim in every}
        given_up = {signatures[claim.signature].place for claim in fit.model.claims} - places
        allowed = [
            n for n in fit.search.candidates
            if signatures[n].place not in given_up and not is_of_instrument(signatures[n].name)
        ]  # fmt: skip
        again = folds.hold_out(every, decide=folds.decide_again(named, allowed))
        held = max(held, again, key=lambda h: h.of(seen).rms)
    chance = 2.0 * sum(float(np.log(signatures[c.signature].tried)) for c in every if c not in named)
    values = 3 * len(np.unique(folds.pose))
    return replace(held, residual=float(np.sqrt(1.0 + chance / values)) * held.residual)


def possible_claims(verdict: Verdict) -> list[Claim]:
    """List claims that may be true and can be delivered: named ones, and others that are no part of the instrument.

    What errors without a name explain as well (no evidence of its own) is no property of the robot: it interpolates
    between the poses and misleads beyond them.
    """
    unnamed = [f for f in (*verdict.minor, *verdict.doubtful) if f.evidence is not None and not of_instrument(f.effect)]
    sizes = {f.signature: f.size for f in (*verdict.findings, *unnamed) if f.signature >= 0}
    return [Claim(number, size) for number, size in sizes.items()]


def _build(
    fit: Fit, kind: str, claims: Sequence[Claim], held: HeldOut, sure: Callable[[FitState, HeldOut], Uncertainty]
) -> Delivery | None:
    """Fit a folder to all rows, exactly; None where its robot finds no equilibrium."""
    fitted = with_claims(fit, claims, background=kind == CALIBRATED)
    state = polish_fit(replace(fitted, state=advance_state(fitted), base=fit.base or fit.state)).state
    if not stands(fit.problem, state):
        return None
    state = settle_play(fit.problem, state)
    return Delivery(kind, state, held, fitted, _residual(fit.problem, state), sure(state, held))


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
