"""Patterns fitted to a deviation with blocks of rows left out in turn, and the few cells that carry it.

A cell is one mechanism at one place, such as the spring of joint_3. Everything is computed from the normal equations
of the blocks, so that hundreds of fits cost less than one pass over the rows.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.patterns import Patterns
from compplan.robot import Array

FOLDS = 8
#: Added to the squared length of every pattern, as a share of it.
RIDGE = 1e-3
#: A cell is kept where it gains this many standard errors on rows left out, and this share of the sum of squares.
STANDARD_ERRORS = 3.0
LEAST_GAIN = 0.004
CELLS = 14

Cell = tuple[str, str]


@dataclass(frozen=True)
class Share:
    """A share of the mean square deviation, with its 95 % interval. All three from 0 to 1."""

    share: float
    low: float
    high: float

    def to_json(self) -> dict[str, float]:
        """Return the share as diagnosis.json holds it."""
        return {"share": round(self.share, 4), "low": round(self.low, 4), "high": round(self.high, 4)}


def find_interval(parts: Array, whole: Array, draws: Array) -> Share:
    """Find the share of sums over blocks, and its 95 % interval where the blocks are drawn anew.

    Args:
        parts: Sum of each block that counts. Shape (blocks,).
        whole: Whole sum of each block. Shape (blocks,).
        draws: How often each draw holds each block. Shape (draws, blocks).
    """
    drawn = (draws @ parts) / np.maximum(draws @ whole, 1e-300)
    low, high = np.percentile(drawn, (2.5, 97.5))
    share = parts.sum() / max(float(whole.sum()), 1e-300)
    return Share(*(float(np.clip(value, 0.0, 1.0)) for value in (share, min(low, share), max(high, share))))


class PatternFit:
    """Patterns and a deviation as normal equations of blocks.

    Args:
        patterns: The patterns at the rows used.
        nuisance: Columns that are taken out of both first, or None. Shape (n, 3, k).
        deviation: Shape (n, 3). [m]
        block: Block of each row, counted from 0. Shape (n,).
    """

    def __init__(self, patterns: Patterns, nuisance: Array | None, deviation: Array, block: NDArray[np.int_]) -> None:
        self.patterns = patterns
        target = deviation.reshape(-1)
        design = patterns.columns.reshape(len(target), -1)
        if nuisance is not None:
            left, size, _ = np.linalg.svd(_unit(nuisance.reshape(len(target), -1))[0], full_matrices=False)
            basis = left[:, size > 1e-8]
            target, design = target - basis @ (basis.T @ target), design - basis @ (basis.T @ design)
        design, self.length = _unit(design)
        blocks, p = int(block.max()) + 1, design.shape[1]
        self.gram, self.moment, self.square = np.zeros((blocks, p, p)), np.zeros((blocks, p)), np.zeros(blocks)
        for number in range(blocks):
            inside = np.repeat(block == number, 3)
            part, value = design[inside], target[inside]
            self.gram[number], self.moment[number] = part.T @ part, part.T @ value
            self.square[number] = value @ value
        self.folds = min(FOLDS, blocks)
        self.fold = np.arange(blocks) % self.folds
        self._fold_gram = np.array([self.gram[self.fold == fold].sum(0) for fold in range(self.folds)])
        self._fold_moment = np.array([self.moment[self.fold == fold].sum(0) for fold in range(self.folds)])

    @property
    def cells(self) -> list[Cell]:
        """Every place and mechanism that has patterns."""
        return list(dict.fromkeys(zip(self.patterns.place, self.patterns.mechanism, strict=True)))

    def find(self, cells: Collection[Cell], factor: str | None = None) -> NDArray[np.int_]:
        """Find the columns of cells, of one factor only where it is named."""
        labels = zip(self.patterns.place, self.patterns.mechanism, self.patterns.factor, strict=True)
        wanted = set(cells)
        return np.array(
            [k for k, (*cell, f) in enumerate(labels) if tuple(cell) in wanted and factor in (None, f)], int
        )

    def fit(self, columns: NDArray[np.int_]) -> Array:
        """Fit columns to the blocks outside each fold. Shape (folds, len(columns)), unknowns of unit columns."""
        pick = np.ix_(np.arange(self.folds), columns, columns)
        gram, moment = self._fold_gram[pick], self._fold_moment[:, columns]
        if self.folds > 1:
            gram, moment = gram.sum(0) - gram, moment.sum(0) - moment
        return np.asarray(np.linalg.solve(gram + RIDGE * np.eye(len(columns)), moment[..., None])[..., 0])

    def gain(self, columns: NDArray[np.int_]) -> Array:
        """Reduction of the sum of squares in each block by columns fitted without it. Shape (blocks,)."""
        if not len(columns):
            return np.zeros(len(self.fold))
        unknown = self.fit(columns)[self.fold]
        gram = self.gram[np.ix_(np.arange(len(self.fold)), columns, columns)]
        curved = (unknown[:, None, :] @ gram @ unknown[:, :, None])[:, 0, 0]
        return np.asarray(2 * (self.moment[:, columns] * unknown).sum(1) - curved)

    def explain(self, columns: NDArray[np.int_]) -> float:
        """Share of the mean square that columns explain on rows left out of their fit."""
        return float(self.gain(columns).sum() / max(float(self.square.sum()), 1e-300))

    def select(self) -> list[Cell]:
        """Select the few cells that carry the deviation: each has to earn its place on rows left out of its fit.

        Forward by the largest gain, where several gain the same within two standard errors the one with the fewest
        unknowns; backward; then each cell gives way to a simpler one that does the same, and forward once more.
        """
        chosen = self._grow([])
        simpler = self._simplify(chosen)
        return chosen if simpler == chosen else self._grow(simpler)

    def _grow(self, chosen: list[Cell]) -> list[Cell]:
        while len(chosen) < CELLS:
            best = self._best_addition(chosen)
            if best is None:
                break
            chosen = self._drop_idle([*chosen, best])
            if best not in chosen:
                break
        return chosen

    def divide(self, groups: Sequence[NDArray[np.int_]], draws: Array) -> list[Share]:
        """Divide what groups of columns explain together between them, by Shapley values with intervals."""
        n = len(groups)
        gains = {
            members: self.gain(np.concatenate([np.zeros(0, int), *(groups[k] for k in members)]))
            for size in range(n + 1)
            for members in combinations(range(n), size)
        }
        shares = []
        for player in range(n):
            value = np.zeros(len(self.fold))
            others = [k for k in range(n) if k != player]
            for size in range(n):
                weight = factorial(size) * factorial(n - size - 1) / factorial(n)
                for members in combinations(others, size):
                    value += weight * (gains[tuple(sorted((*members, player)))] - gains[members])
            shares.append(find_interval(value, self.square, draws))
        return shares

    def _best_addition(self, chosen: list[Cell]) -> Cell | None:
        before = self.gain(self.find(chosen))
        candidates = [cell for cell in self.cells if cell not in chosen]
        gains = [self.gain(self.find([*chosen, cell])) - before for cell in candidates]
        if not gains:
            return None
        leader = max(gains, key=lambda gain: float(gain.sum()))
        if not self._earns(leader):
            return None
        equal = [
            (len(self.find([cell])), -float(gain.sum()), cell)
            for cell, gain in zip(candidates, gains, strict=True)
            if self._is_equal(leader - gain) and self._earns(gain)
        ]
        return min(equal)[2]

    def _drop_idle(self, chosen: list[Cell]) -> list[Cell]:
        for cell in list(chosen[:-1]):
            rest = [other for other in chosen if other != cell]
            if not self._earns(self.gain(self.find(chosen)) - self.gain(self.find(rest))):
                chosen = rest
        return chosen

    def _simplify(self, chosen: list[Cell]) -> list[Cell]:
        """Put simpler cells in the place of others that gain the same."""
        for cell in list(chosen):
            rest = [other for other in chosen if other != cell]
            size, gain = len(self.find([cell])), self.gain(self.find(chosen))
            for rival in self.cells:
                if rival in chosen or len(self.find([rival])) >= size:
                    continue
                loss = gain - self.gain(self.find([*rest, rival]))
                if self._is_equal(loss):
                    size, chosen, gain = len(self.find([rival])), [*rest, rival], gain - loss
        return self._drop_idle(chosen)

    def _is_equal(self, loss: Array) -> bool:
        """Tell whether a loss is within what chance and small errors of the patterns do."""
        return bool(loss.sum() <= max(2 * _standard_error(loss), 0.25 * LEAST_GAIN * float(self.square.sum())))

    def _earns(self, gain: Array) -> bool:
        enough = LEAST_GAIN * float(self.square.sum())
        return bool(gain.sum() > max(STANDARD_ERRORS * _standard_error(gain), enough))


def _standard_error(gain: Array) -> float:
    """Estimate the standard error of the sum over blocks."""
    return float(np.sqrt(len(gain)) * gain.std(ddof=1)) if len(gain) > 1 else 0.0


def _unit(columns: Array) -> tuple[Array, Array]:
    """Scale columns to length one; return their lengths too."""
    length = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return columns / length, length
