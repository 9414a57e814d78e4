"""Gains: what claiming each candidate would add to the evidence, noise and background held."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from compplan.diagnosis.evidence.evidence import Posterior, combine_channels
from compplan.diagnosis.evidence.likelihood import Hyper
from compplan.diagnosis.evidence.normal_equations import NormalEquations
from compplan.robot import Array

#: Sizes that an effect may have, in units of its prior scale; each is as probable as the others (assumed).
SIZES = (0.1, 0.3, 1.0, 3.0, 10.0, 40.0)


@dataclass(frozen=True, eq=False)
class Gain:
    """What claiming a signature would add to the log evidence, and at which of `SIZES`."""

    signature: int
    log_evidence: float
    size: float


def find_gains(equations: NormalEquations, posterior: Posterior, candidates: list[int]) -> list[Gain]:
    """Compute what each candidate would add to the log evidence, noise and background held."""
    gram, against, _, _ = combine_normal_equations(equations, posterior.hyper)
    cross = gram.take(posterior.columns, axis=1)
    left = against - cross @ posterior.mean
    known = cross @ posterior.covariance
    alone = np.maximum(np.diag(gram) - np.einsum("ij,ij->i", known, cross), 0.0)
    by_size: dict[int, list[int]] = {}
    for n in candidates:
        by_size.setdefault(len(equations.columns(n)), []).append(n)
    gains: list[Gain] = []
    for size, numbers in by_size.items():
        own = np.stack([equations.columns(n) for n in numbers])
        if size == 1:
            positive = np.array([equations.signatures[n].positive for n in numbers], bool)
            sure, best = _single_gains(alone[own[:, 0]], left[own[:, 0]], positive)
        else:
            blocks = gram[own[:, :, None], own[:, None, :]] - known[own] @ np.swapaxes(cross[own], 1, 2)
            sure, best = _joint_gains(blocks, left[own])
        gains += [Gain(n, g, b) for n, g, b in zip(numbers, sure.tolist(), best.tolist(), strict=True)]
    return gains


@lru_cache(maxsize=1)
def combine_normal_equations(equations: NormalEquations, hyper: Hyper) -> tuple[Array, Array, float, float]:
    """Combine the channels of all normal equations; a search asks again and again at the same noise."""
    return combine_channels(equations.channels, hyper)


def _single_gains(block: Array, left: Array, positive: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return gain and best size of signatures of one column each."""
    size2 = np.array(SIZES)[:, None] ** 2
    grown = 1 + size2 * block
    log_gain = 0.5 * (size2 * left**2 / grown - np.log(grown))
    log_gain = log_gain + np.where(positive, np.log(2) + log_ndtr(np.sqrt(size2 / grown) * left), 0.0)
    best = np.argmax(log_gain, axis=0)
    top = np.take_along_axis(log_gain, best[None], axis=0)[0]
    return top + np.log(np.mean(np.exp(log_gain - top), axis=0)), np.array(SIZES)[best]


def _joint_gains(blocks: Array, left: Array) -> tuple[Array, Array]:
    """Return gain and best size of signatures of several columns each. Shapes (m, k, k), (m, k) -> (m,), (m,)."""
    values, vectors = np.linalg.eigh(0.5 * (blocks + np.swapaxes(blocks, 1, 2)))
    values = np.maximum(values, 0.0)
    squares = np.einsum("mki,mk->mi", vectors, left) ** 2
    sizes = (np.array(SIZES) ** 2)[:, None, None]
    log_gain = 0.5 * np.sum(sizes * squares / (1 + sizes * values) - np.log1p(sizes * values), axis=2)
    best = np.argmax(log_gain, axis=0)
    top = np.take_along_axis(log_gain, best[None], axis=0)[0]
    return top + np.log(np.mean(np.exp(log_gain - top), axis=0)), np.array(SIZES)[best]
