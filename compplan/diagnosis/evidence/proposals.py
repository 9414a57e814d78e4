"""Proposals: effects with an unknown row or period, found in the residuals of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import Channel
from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS, LEVEL, SAMPLE, beats_chance
from compplan.effects import frame_shift, tool_shift
from compplan.effects.base_frame import SCALE as BASE_SCALE
from compplan.effects.base_frame import base_twists
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.effects.tool_frame import SCALE as TOOL_SCALE
from compplan.effects.tool_frame import tool_twists
from compplan.effects.transmission_error import (
    OVERTONES,
    periods_seen,
    series_at,
    waves,
    waves_at,
)
from compplan.measurement.observations import along
from compplan.robot import Array

Waves = NDArray[np.complex128]
#: Least joint range for a search for waves (assumed). [rad or m]
LEAST_RANGE = 0.3


@dataclass(frozen=True)
class ProposalSettings:
    """Settings of the search for rows and periods."""

    #: Rows proposed for each kind of shift, and least number of waves to try at a joint (assumed).
    proposed: int = 2
    #: Most cycles per turn, integers and values between (assumed: gears of arms turn 50 to 170 times, and a strain wave
    #: gear errs twice a turn of its motor).
    most_cycles: float = 200.0
    #: Regularisation of shifts that the rows on one side do not determine, in squares of the noise (assumed).
    hold: float = 1e-2
    #: Spacing of frequencies, and least distance of two waves, in turns over the range (theory: the width of a wave is
    #: one turn, a quarter loses little).
    between: float = 0.25
    #: Upper limit of the number of tried sets of n waves: this to the power of n + 2 (assumed: not all were).
    tried_a_wave: int = 10
    #: Least cycles per turn, or per metre (assumed).
    least_cycles: float = 0.5


PROPOSALS = ProposalSettings()


def propose_shifts(at: Linearization, channels: Sequence[Channel], left: Sequence[Array]) -> list[Signature]:
    """Propose shifts of frame and tool at the rows where a step explains most.

    `left` holds the residuals of the model in each channel, in units of the noise. Shape (r, c) each.
    """
    starts = np.flatnonzero(np.r_[False, np.diff(at.campaign.stay) > 0])
    kinds = ((frame_shift, base_twists(at) * BASE_SCALE), (tool_shift, tool_twists(at) * TOOL_SCALE))
    found: list[Signature] = []
    for model, twist in kinds:
        gains = _step_gains(channels, left, twist, len(at.campaign))
        order = starts[np.argsort(-gains[starts])]
        used: list[int] = []
        for row in order:
            if len(used) == PROPOSALS.proposed or gains[row] < beats_chance(len(starts)):
                break
            if all(abs(int(row) - other) > FEW_ROWS for other in used):
                used.append(int(row))
        for row in used:
            found += model.shift_at(at, row, tried=max(len(starts), 1))
    return found


def _step_gains(channels: Sequence[Channel], left: Sequence[Array], twist: Array, n: int) -> Array:
    """Return the gain in log likelihood of fits before and after each row over one fit for all. Shape (n,)."""
    gram, against = np.zeros((n, 6, 6)), np.zeros((n, 6))
    for channel, rest in zip(channels, left, strict=True):
        if channel.name in ("encoder", "distance"):
            continue
        part = slice(0, 3) if channel.name == "position" else slice(3, 6)
        columns = twist[channel.rows, part] / channel.sigma[:, :, None]
        if channel.direction is not None:
            columns = along(channel.direction, columns)
        length = np.linalg.norm(rest, axis=1)
        # bound the influence of single outlying rows
        far = np.quantile(length, LEVEL)
        rest = rest * np.minimum(1.0, far / np.maximum(length, 1e-12))[:, None]
        gram[channel.rows] += np.einsum("nik,nil->nkl", columns, columns)
        against[channel.rows] += np.einsum("nik,ni->nk", columns, rest)
    gram_before, against_before = np.cumsum(gram, axis=0), np.cumsum(against, axis=0)
    total_gram, total_against = gram_before[-1], against_before[-1]
    before = (
        np.concatenate([np.zeros((1, 6, 6)), gram_before[:-1]]),
        np.concatenate([np.zeros((1, 6)), against_before[:-1]]),
    )
    after = (total_gram - before[0], total_against - before[1])
    gains = _explained(*before) + _explained(*after) - _explained(total_gram[None], total_against[None])[0]
    return 0.5 * gains


def _explained(gram: Array, against: Array) -> Array:
    solved = np.linalg.solve(gram + PROPOSALS.hold * np.eye(gram.shape[-1]), against[..., None])[..., 0]
    return np.asarray(np.einsum("nk,nk->n", against, solved))


def propose_waves(
    at: Linearization, channels: Sequence[Channel], left: Sequence[Array], joint_waves: dict[int, list[Array]]
) -> list[Signature]:
    """Propose waves for every joint."""
    found: list[Signature] = []
    for index, joint in enumerate(at.robot.actuated):
        pull, weight = _projected(at, channels, left, joint_waves.get(index), index)
        angle = np.nan_to_num(at.campaign.q[:, index])
        seen = weight > 0
        spread = float(np.ptp(angle[seen])) if seen.sum() >= ENOUGH_ROWS else 0.0
        if spread < LEAST_RANGE:
            continue
        slides = joint.kind == "prismatic"
        spectrum = _Spectrum(angle[seen], spread, slides)
        # each wave has two values, and a value of a free form needs ten poses
        most = max(len(np.unique(at.campaign.stay[seen])) // ENOUGH_ROWS, PROPOSALS.proposed)
        picked = _match_waves(angle[seen], pull[seen], weight[seen], spectrum, slides, most)
        for count in {1, 2, len(picked)}:
            if 0 < count <= len(picked):
                tried = int(min(len(spectrum.grid) ** count, PROPOSALS.tried_a_wave ** (2 + count)))
                found.append(waves_at(at, index, picked[:count], tried=tried))
        if picked:
            some = np.flatnonzero(seen)[:: 1 + int(seen.sum()) // SAMPLE]
            grid = spectrum.grid[periods_seen(spectrum.grid, spread, slides) >= 1.0]
            cycle = find_series(angle[some], pull[some], weight[some], grid, slides)
            found.append(series_at(at, index, cycle, tried=min(len(grid), PROPOSALS.tried_a_wave**3)))
    return found


def wave_grid(spread: float, slides: bool) -> tuple[Array, Array]:
    """Return the cycles per turn (per metre) to evaluate, dense enough for every wave.

    Integer cycles, and evenly spaced cycles.
    """
    turns = spread if slides else spread / (2 * np.pi)
    step = PROPOSALS.between / turns
    whole = np.arange(1.0, PROPOSALS.most_cycles) if not slides else np.zeros(0)
    return whole, np.arange(max(PROPOSALS.least_cycles, step), PROPOSALS.most_cycles, min(step, 1.0))


class _Spectrum:
    """Sums of a signal times all waves of a grid.

    For an even grid f_jk = f_0 + (j B + k) s, all waves are products of two short lists, exp(i (f_0 + j B s) x) and
    exp(i k s x); their sums are a product of two small matrices.
    """

    def __init__(self, angle: Array, spread: float, slides: bool) -> None:
        whole, even = wave_grid(spread, slides)
        self.grid, self.order = np.unique(np.concatenate([whole, even]), return_index=True)
        self.count = len(even)
        phase = angle[:, None] * (2 * np.pi if slides else 1.0)
        width = int(np.ceil(np.sqrt(max(self.count, 1))))
        step = even[1] - even[0] if self.count > 1 else 0.0
        self.whole = _turn(phase * whole)
        self.coarse, self.fine = _turn(phase * even[::width]), _turn(phase * (step * np.arange(width)))

    def sums(self, signal: Array) -> Waves:
        """Return the sum of signal times exp(i f x) for every cycle f. Shape (n,) -> (cycles,)."""
        return self._sum(signal, self.whole, self.coarse, self.fine)

    def double_sums(self, signal: Array) -> Waves:
        """Return the sum of signal times exp(2 i f x) for every cycle f. Shape (n,) -> (cycles,)."""
        return self._sum(signal, self.whole**2, self.coarse**2, self.fine**2)

    def _sum(self, signal: Array, whole: Waves, coarse: Waves, fine: Waves) -> Waves:
        even = ((coarse * signal[:, None]).T @ fine).reshape(-1)[: self.count]
        return np.asarray(np.concatenate([signal @ whole, even])[self.order])


def _turn(phase: Array) -> Waves:
    turned = np.empty(phase.shape, complex)
    turned.real, turned.imag = np.cos(phase), np.sin(phase)
    return turned


def _projected(
    at: Linearization, channels: Sequence[Channel], left: Sequence[Array], fitted: list[Array] | None, index: int
) -> tuple[Array, Array]:
    """Project the residuals on the motion of one joint: pull J^T e and weight J^T J of every row, noise units."""
    n = len(at.campaign)
    pull, weight = np.zeros(n), np.zeros(n)
    for number, (channel, rest) in enumerate(zip(channels, left, strict=True)):
        if channel.name == "distance":
            continue
        if channel.name == "encoder":
            column = np.zeros_like(rest)
            column[:, index] = 1.0 / channel.sigma[:, 0]
        else:
            part = slice(0, 3) if channel.name == "position" else slice(3, 6)
            column = at.motion[channel.rows, part, index] / channel.sigma
            if channel.direction is not None:
                column = along(channel.direction, column)
        total = rest if fitted is None else rest + fitted[number]
        pull[channel.rows] += np.einsum("ni,ni->n", column, total)
        weight[channel.rows] += np.einsum("ni,ni->n", column, column)
    return pull, weight


def _match_waves(
    angle: Array, pull: Array, weight: Array, spectrum: _Spectrum, slides: bool, most: int
) -> list[float]:  # fmt: skip
    """Select waves one by one, refitting all after each, while the gain exceeds chance."""
    picked: list[float] = []
    grid, total = spectrum.grid, float(weight.sum())
    columns, rest = _take_out_line(angle, pull, weight)
    # products of sine and cosine, from those of twice the angle
    double = spectrum.double_sums(weight)
    sines, cosines = (0.5 * (total + sign * double.real) + 1e-9 * total for sign in (-1.0, 1.0))
    across = 0.5 * double.imag
    while len(picked) < most:
        against = spectrum.sums(rest)
        a, b = against.imag, against.real
        gain = 0.5 * (a * a * cosines - 2.0 * a * b * across + b * b * sines) / (sines * cosines - across**2)
        if picked:
            gain[np.min(np.abs(grid[:, None] - np.array(picked)), axis=1) < PROPOSALS.between * grid[0]] = 0.0
        best = int(np.argmax(gain))
        if gain[best] < beats_chance(len(grid)):
            break
        picked.append(float(grid[best]))
        columns = np.column_stack([columns, waves(angle, picked[-1:], slides)])
        rest = pull - weight * (columns @ _weighted_fit(columns, pull, weight))
    return picked


def find_series(angle: Array, pull: Array, weight: Array, grid: Array, slides: bool) -> float:
    """Return the cycles of the wave with overtones of largest evidence; all sizes equal that of the largest sine.

    `pull` is the residual projected on the joint's motion, `weight` the square of that motion, both over the joint's
    `angle`, shape (n,); `grid` holds the cycles to evaluate.
    """
    _, rest = _take_out_line(angle, pull, weight)
    overtones = np.arange(1, len(OVERTONES) + 1)
    # scaled sine and cosine of every overtone for every cycle: (cycles, 2 overtones, n)
    turn = _turn(np.multiply.outer(grid, angle) * (2 * np.pi if slides else 1.0))[:, None] ** overtones[:, None]
    shape = (len(grid), -1, len(angle))
    columns = (np.stack([turn.imag, turn.real], axis=2) * np.array(OVERTONES)[:, None, None]).reshape(shape)
    moments, against = columns * weight @ np.swapaxes(columns, 1, 2), columns @ rest
    sine = moments[:, :2, :2] + 1e-9 * weight.sum() * np.eye(2)
    squares = np.einsum("fk,fk->f", against[:, :2], np.linalg.solve(sine, against[:, :2, None])[..., 0])
    size = np.sqrt(2.0 * squares.max() / weight.sum())
    inner = np.eye(columns.shape[1]) + size**2 * moments
    explained = size**2 * np.einsum("fk,fk->f", against, np.linalg.solve(inner, against[..., None])[..., 0])
    return float(grid[np.argmax(explained - np.linalg.slogdet(inner)[1])])


def _take_out_line(angle: Array, pull: Array, weight: Array) -> tuple[Array, Array]:
    """Return a constant and a slope over the angle, and the residual without them. Shapes (n, 2), (n,)."""
    smooth = np.column_stack([np.ones_like(angle), angle - angle.mean()])
    return smooth, pull - weight * (smooth @ _weighted_fit(smooth, pull, weight))


def _weighted_fit(columns: Array, pull: Array, weight: Array) -> Array:
    gram = columns.T @ (weight[:, None] * columns)
    return np.asarray(np.linalg.solve(gram + 1e-6 * np.trace(gram) * np.eye(len(gram)) / len(gram), columns.T @ pull))
