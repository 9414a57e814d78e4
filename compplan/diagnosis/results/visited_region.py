"""Visits: where a campaign was, and how well the parts of a folder that are in doubt held there.

The parts in doubt are all that a folder holds beside its names: small errors, doubtful causes; and the names too,
unless they are beyond doubt or nothing is left that they do not explain; and every name that has rivals, which the
campaign cannot tell from it and a path elsewhere may. With g what the rest of the folder leaves of a stay that no fit
saw, and m the motion of the tip by the parts, the share w = g . m / |m|^2 of them was there, known to
e / |m|, e^2 the mean square per axis of what the whole folder leaves. From place to place it spreads by s,

    s^2 = max(sum |m|^2 (w - w_mean)^2 - sum v, 0) / sum |m|^2, w_mean = sum |m|^2 w / sum |m|^2,

v the variance per axis that noise alone gives the mean of a stay's rows.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import SAMPLE
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.results.verdict import noise_floor
from compplan.diagnosis.search.state import Fit, FitState
from compplan.diagnosis.validation.held_out import HeldOut
from compplan.diagnosis.validation.stacking import is_built
from compplan.effects import is_of_instrument
from compplan.effects.linearization import Place
from compplan.robot.validity import ValidityPart, ValidityRegion

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
