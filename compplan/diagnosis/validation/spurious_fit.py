"""Spurious-fit probability: how often a cause outside the vocabulary would be fitted as well as a claim fits the data.

A vocabulary of hundreds of effects explains part of any smooth error, the more the fewer poses there are. Errors that
no effect makes are therefore drawn: a wave, step, kink or parabola of one or two quantities that the campaign varies
(joint angle, place of the target, row number, load), along a fixed direction of the base or of the tool, or as a
rotation of a link. For each of them the best effect of the vocabulary is fitted, frames and the other claims fitted
beside it, and explains the share e of the squares. A claim explains the share

    E = (squares explained - number of its parameters) / (squares that the other claims leave - noise),

and P(e >= E) over the draws is its spurious-fit probability.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import LEVEL, ROUNDING, SAMPLE, SEED
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.normal_equations import project_out
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.effects.linearization import AXES, Linearization
from compplan.measurement.observations import along as take_along
from compplan.robot import Array

#: Phase of a drawn error over one standard deviation of what it follows (assumed: from nearly straight to a wave that a
#: few dozen poses just resolve). [rad]
ROUGHNESS = (0.5, 1.0, 2.0)


def rate_spurious_fits(fit: Fit, doubt: RevisedProbabilities) -> dict[Claim, float]:
    """Return the spurious-fit probability of every claim."""
    if not doubt.model.claims:
        return {}
    equations = doubt.search.equations
    total, p = equations.channels[0].total, equations.p
    drawn, length = draw_errors(fit), np.maximum(np.sqrt(np.diag(total.gram)), 1e-12)
    # products of the columns, of unit length, with the drawn errors and, last, the observations
    against = np.column_stack([equations.designs[0].reshape(-1, p).T @ drawn, total.against]) / length[:, None]
    squares = np.diag(np.append(np.sum(drawn**2, axis=0), total.square))
    gram = np.block([[total.gram / np.outer(length, length), against], [against.T, squares]])
    blocks = [equations.columns(number) for number in doubt.search.candidates]
    values = np.array([len(block) for block in blocks])[:, None]
    frames, result = equations.columns_named(REGISTRATION), dict[Claim, float]()
    for claim in doubt.model.claims:
        others = equations.join_columns(n for n in doubt.model.signatures if n != claim.signature)
        beside = np.union1d(others, frames).astype(int)
        left = project_out(gram, beside)
        squares, count = np.maximum(np.diag(left), 0.0), total.count - len(beside)
        columns = equations.columns(claim.signature)
        explained = explain_squares(left, [columns], np.array([len(left) - 1]))[0, 0] - len(columns)
        share = explained / max(float(squares[-1]) - min(float(count), float(squares[-1])), 1e-12)
        # errors that frames and other claims explain nearly whole show nothing
        kept = p + np.flatnonzero(squares[p:-1] > (1.0 - LEVEL) * np.diag(gram)[p:-1])
        shares = explain_squares(left, blocks, kept) / squares[kept]
        # k parameters explain k of the squares of anything; what is left of an error explained whole is rounding
        best = (1.0 - (1.0 - shares) * count / np.maximum(count - values, 1.0)).max(axis=0, initial=0.0)
        result[claim] = float((np.sum(best >= min(share, 1.0 - np.sqrt(ROUNDING))) + 0.5) / (len(kept) + 1.0))
    return result


def draw_errors(fit: Fit) -> Array:
    """Draw errors that no effect makes, of one rms each in units of the noise. Shape (values, SAMPLE)."""
    at, channel = fit.at, fit.search.equations.source[0]
    rows, rng = channel.rows, np.random.default_rng(SEED)
    followed = list_followed(at, rows)
    directions = [(joint.name, axis) for joint in at.robot.actuated for axis in AXES[3:]]
    rotation = at.attained.frames.tcp_rotation[rows]
    drawn: list[Array] = []
    while len(drawn) < SAMPLE:
        phases = [_pick(rng, followed) * rng.choice(ROUGHNESS) for _ in range(rng.integers(1, 3))]
        kind, direction = rng.integers(3), rng.normal(size=3)
        if kind == 0:
            moved = np.broadcast_to(direction, (len(rows), 3))
        elif kind == 1:
            moved = rotation @ direction
        else:
            moved = at.parent_twist(*directions[int(rng.integers(len(directions)))])[rows, :3]
        if channel.direction is not None:
            moved = take_along(channel.direction, np.asarray(moved))
        error = (_shape(rng, np.sum(phases, axis=0))[:, None] * moved / channel.sigma).reshape(-1)
        size = float(np.sqrt(np.mean(error**2)))
        if size > ROUNDING:
            drawn.append(error / size)
    return np.stack(drawn, axis=1)


def list_followed(at: Linearization, rows: NDArray[np.int_]) -> list[Array]:
    """List what a drawn error may follow, by kind, standardised. Shapes (r, k)."""
    campaign = at.campaign
    kinds = [np.nan_to_num(campaign.q), at.point, np.arange(len(campaign), dtype=float)[:, None]]
    kinds.append(np.nan_to_num(at.own_load))
    if campaign.load_varies:
        kinds.append(np.nan_to_num(at.scene.wrench[:, :3]))
    found = []
    for values in (kind[rows] for kind in kinds):
        spread = values.std(axis=0)
        seen = spread > ROUNDING
        if seen.any():
            found.append((values[:, seen] - values[:, seen].mean(axis=0)) / spread[seen])
    return found


def _pick(rng: np.random.Generator, followed: Sequence[Array]) -> Array:
    kind = followed[int(rng.integers(len(followed)))]
    return np.asarray(kind[:, rng.integers(kind.shape[1])])


def _shape(rng: np.random.Generator, phase: Array) -> Array:
    """Draw a wave, a step, a kink or a parabola."""
    wave = np.sin(phase + rng.uniform(0.0, 2.0 * np.pi))
    return [wave, np.sign(wave), np.abs(phase - rng.normal()), phase**2][int(rng.integers(4))]


def explain_squares(gram: Array, blocks: Sequence[NDArray[np.int_]], errors: NDArray[np.int_]) -> Array:
    """Return the squares of some columns that each block of others explains. Shape (blocks, errors)."""
    result = np.zeros((len(blocks), len(errors)))
    for size in {len(block) for block in blocks}:
        numbers = [n for n, block in enumerate(blocks) if len(block) == size]
        own = np.stack([blocks[n] for n in numbers])
        # columns have unit length: what is left of one that the others hold is rounding
        inner = gram[own[:, :, None], own[:, None, :]] + ROUNDING * np.eye(size)
        against = gram[own[:, :, None], errors]
        result[numbers] = np.einsum("nsc,nsc->nc", against, np.linalg.solve(inner, against))
    return result
