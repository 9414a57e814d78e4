"""Imitation: how often a cause without a name would be explained as fully as a claim explains what the others leave.

A cause that is in no vocabulary moves the target all the same: by a wave, a step, a kink or a square of something that
a campaign passes through (an angle, the place of the target, the order of the rows, the load on a joint or on the
tool), or of two such things together; along a direction of the base or of the tool, or as a turn of a link about a
joint's frame. A vocabulary of hundreds of forms explains part of any of them, the more the fewer poses there are. So
such causes are drawn, at random and from none of the forms, and the best candidate is found for each: the share e of
its squares that this one explains, frames and the other claims fitted beside. A claim that explains the share

    E = (explained squares - its values) / (squares beside the others - noise)

of what the other claims leave beyond the noise is imitated with the probability P(e >= E).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import LEVEL, ROUNDING, SAMPLE, SEED
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.effects.linearization import AXES, Linearization
from compplan.measurement.observations import along as take_along
from compplan.robot import Array

#: Radians that a cause turns by over one standard deviation of what it follows (assumed: from nearly straight to a wave
#: that a few dozen poses just show).
ROUGHNESS = (0.5, 1.0, 2.0)
#: A cause of which more than this share is explained is explained whole: the rest is rounding
#: (theory: relative accuracy of the type).
WHOLE = 1.0 - 64.0 * ROUNDING


def rate_imitations(fit: Fit, doubt: RevisedProbabilities) -> dict[Claim, float]:
    """Return, for every claim, the probability that a cause without a name is explained as fully as it explains.

    Args:
        fit: The fit.
        doubt: Its claims among errors that no effect makes.
    """
    if not doubt.model.claims:
        return {}
    ledger = doubt.search.ledger
    total, design = ledger.channels[0].total, ledger.designs[0]
    causes = draw_causes(fit)
    length = np.maximum(np.sqrt(np.diag(total.gram)), 1e-12)
    gram = total.gram / np.outer(length, length)
    # observations are one more cause, the last
    against = np.column_stack([design.reshape(-1, ledger.p).T @ causes, total.against]) / length[:, None]
    squares = np.append(np.sum(causes**2, axis=0), total.square)
    frames = ledger.columns_named(REGISTRATION)
    blocks = [ledger.columns(number) for number in doubt.search.candidates]
    result = {}
    for claim in doubt.model.claims:
        beside = np.union1d(ledger.join_columns(n for n in doubt.model.signatures if n != claim.signature), frames)
        left, product, rest = take_out(gram, against, squares, beside.astype(int))
        count = total.count - len(beside)
        columns = ledger.columns(claim.signature)
        noise = min(float(count), float(rest[-1]))
        own = explain_squares(left, product[:, -1:], [columns])[0, 0] - len(columns)
        share = own / max(float(rest[-1]) - noise, 1e-12)
        # what frames and other claims take nearly whole shows nothing
        kept = np.flatnonzero(rest[:-1] > (1.0 - LEVEL) * squares[:-1])
        shares = explain_squares(left, product[:, kept], blocks) / rest[kept]
        # k values take k of the squares of anything
        values = np.array([len(block) for block in blocks])[:, None]
        shares = 1.0 - (1.0 - shares) * count / np.maximum(count - values, 1.0)
        best = shares.max(axis=0, initial=0.0)
        result[claim] = float((np.sum(best >= min(share, WHOLE)) + 0.5) / (len(kept) + 1.0))
    return result


def draw_causes(fit: Fit) -> Array:
    """Draw causes without a name, of one rms each in units of the noise. Shape (values, SAMPLE).

    Args:
        fit: The fit; its campaign says what a cause may follow.
    """
    at, channel = fit.at, fit.search.ledger.source[0]
    rows, rng = channel.rows, np.random.default_rng(SEED)
    followed = list_followed(at, rows)
    directions = [(joint.name, axis) for joint in at.robot.actuated for axis in AXES[3:]]
    rotation = at.attained.frames.tcp_rotation[rows]
    drawn: list[Array] = []
    while len(drawn) < SAMPLE:
        phases = [_pick(rng, followed) * rng.choice(ROUGHNESS) for _ in range(rng.integers(1, 3))]
        kind, along = rng.integers(3), rng.normal(size=3)
        if kind == 0:
            moved = np.broadcast_to(along, (len(rows), 3))
        elif kind == 1:
            moved = rotation @ along
        else:
            moved = at.parent_twist(*directions[int(rng.integers(len(directions)))])[rows, :3]
        if channel.direction is not None:
            moved = take_along(channel.direction, np.asarray(moved))
        cause = (_shape(rng, np.sum(phases, axis=0))[:, None] * moved / channel.sigma).reshape(-1)
        size = float(np.sqrt(np.mean(cause**2)))
        if size > ROUNDING:
            drawn.append(cause / size)
    return np.stack(drawn, axis=1)


def list_followed(at: Linearization, rows: NDArray[np.int_]) -> list[Array]:
    """List what a cause may follow at some rows, by kind, in units of its spread. Shapes (r, k)."""
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
    """Draw a wave, a step, a kink or a square."""
    shift = rng.uniform(0.0, 2.0 * np.pi)
    wave = np.sin(phase + shift)
    return [wave, np.sign(wave), np.abs(phase - rng.normal()), phase**2][int(rng.integers(4))]


def take_out(
    gram: Array, against: Array, squares: Array, columns: NDArray[np.int_]
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Take some columns out of all products: of columns, with causes, and of the causes with themselves."""
    if not len(columns):
        return gram, against, squares
    values, vectors = np.linalg.eigh(gram[np.ix_(columns, columns)])
    good = values > ROUNDING
    turn = vectors[:, good] / np.sqrt(values[good])
    of_columns, of_causes = turn.T @ gram[columns], turn.T @ against[columns]
    return (
        gram - of_columns.T @ of_columns,
        against - of_columns.T @ of_causes,
        np.maximum(squares - np.sum(of_causes**2, axis=0), 0.0),
    )


def explain_squares(gram: Array, against: Array, blocks: Sequence[NDArray[np.int_]]) -> Array:
    """Return the squares of every cause that each block of columns explains. Shape (blocks, causes)."""
    result = np.zeros((len(blocks), against.shape[1]))
    for size in {len(block) for block in blocks}:
        numbers = [n for n, block in enumerate(blocks) if len(block) == size]
        own = np.stack([blocks[n] for n in numbers])
        values, vectors = np.linalg.eigh(gram[own[:, :, None], own[:, None, :]])
        turned = np.swapaxes(vectors, 1, 2) @ against[own]
        weight = np.where(values > ROUNDING, 1.0 / np.maximum(values, ROUNDING), 0.0)
        result[numbers] = np.einsum("ni,nic->nc", weight, turned**2)
    return result
