"""Which of many measurements to take: greedily by what each adds, then exchanged one by one [Fedorov1972].

One search for every aim: an aim tells what each candidate is worth beside some that are taken. The loop asks for the
variance of the tip along a path, the diagnosis for the odds of two explanations. Rows of derivatives H with noise R
take S H^T (H S H^T + R)^-1 H S off a covariance S.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

#: Tells what every candidate is worth beside some that are taken. Shape (m,).
Worth = Callable[[list[int]], Array]
#: An exchange has to be worth more by this share, so that rounding does not go round in circles.
BETTER = 1e-9
#: Rounds of exchange (assumed: most choices settle in two).
ROUNDS = 3
#: What each measurement gains beside a state: its mean (P,) and covariance (P, P), rows (m, c, P) -> (m,).
Gain = Callable[[Array, Array, Array], Array]


def grow_choice(worth: Worth, count: int) -> Iterator[tuple[int, float]]:
    """Take candidates one after the other, each for what it adds to those before it; yield each and what it adds."""
    taken: list[int] = []
    for _ in range(count):
        gain = worth(taken)
        gain[taken] = -np.inf
        taken.append(int(gain.argmax()))
        yield taken[-1], float(gain[taken[-1]])


def take_greedily(worth: Worth, count: int) -> list[int]:
    """Take candidates one after the other, each for what it adds to those before it."""
    return [number for number, _ in grow_choice(worth, count)]


def settle_choice(worth: Worth, taken: Sequence[int]) -> list[tuple[int, float]]:
    """Exchange what is taken, and order it by what each adds to those before it; also return what that is."""
    chosen = exchange_taken(worth, taken)
    grown = grow_choice(lambda order: worth([chosen[k] for k in order])[chosen], len(chosen))
    return [(chosen[k], gain) for k, gain in grown]


def exchange_taken(worth: Worth, taken: Sequence[int]) -> list[int]:
    """Replace what is taken by better candidates, one by one, until none is better or the rounds are over."""
    taken = list(taken)
    for _ in range(ROUNDS):
        changed = False
        for place, leaving in enumerate(taken):
            others = taken[:place] + taken[place + 1 :]
            gain = worth(others)
            gain[others] = -np.inf
            best = int(gain.argmax())
            if best != leaving and gain[best] > gain[leaving] + BETTER * abs(gain[leaving]):
                taken[place], changed = best, True
        if not changed:
            break
    return taken


def weight_rows(gain: Gain, covariance: Array, rows: Array, noise: float, mean: Array | None = None) -> Worth:
    """Tell what every measurement is worth beside some that are taken, for an exchange.

    covariance before any of them, (P, P), and mean, (P,), zero if left out; rows: derivatives of each measurement,
    (m, c, P); noise: variance of each component.
    """
    before = np.zeros(len(covariance)) if mean is None else mean
    return lambda taken: gain(*explain_rows(before, covariance, rows[taken], noise), rows)


def learn_rows(covariance: Array, rows: Array, noise: float) -> Array:
    """Return the covariance, (P, P), after measurements with derivatives (m, c, P) and a variance of each component."""
    return explain_rows(np.zeros(len(covariance)), covariance, rows, noise)[1]


def explain_rows(mean: Array, covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Return what is left of a difference m, H m being what measurements show of it, and its covariance after them.

    mean: (P,); covariance: (P, P); rows: derivatives of each measurement, (m, c, P); noise: variance of a component.
    """
    for H in rows:
        along = covariance @ H.T
        gain = np.linalg.solve(H @ along + noise * np.eye(len(H)), along.T)
        mean, covariance = mean - gain.T @ (H @ mean), covariance - along @ gain
        covariance = 0.5 * (covariance + covariance.T)
    return mean, covariance


def _innovate(covariance: Array, rows: Array, noise: float) -> tuple[Array, Array]:
    """Return H S and the covariance H S H^T + R of what each measurement shows. Shapes (m, c, P), (m, c, c)."""
    m, c, p = rows.shape
    along = (rows.reshape(m * c, p) @ covariance).reshape(m, c, p)
    return along, np.einsum("mip,mjp->mij", along, rows) + noise * np.eye(c)


def measure_gains(covariance: Array, rows: Array, weight: Array, noise: float) -> Array:
    """Return what each measurement, rows (m, c, P), would take off the trace of S W, both (P, P). Shape (m,)."""
    along, inner = _innovate(covariance, rows, noise)
    outer = np.einsum("mip,mjp->mij", (along.reshape(-1, len(weight)) @ weight).reshape(along.shape), along)
    return np.asarray(np.trace(np.linalg.solve(inner, outer), axis1=1, axis2=2))


def odds_gains(mean: Array, covariance: Array, rows: Array, noise: float = 1.0) -> Array:
    """Return d^T (H S H^T + R)^-1 d / 2, d = H m: the expected log likelihood ratio of each measurement. Shape (m,).

    mean m: difference of two explanations, (P,); covariance S: mean of theirs, (P, P); rows H: (m, c, P).
    """
    d, inner = rows @ mean, _innovate(covariance, rows, noise)[1]
    return np.asarray(0.5 * np.einsum("mc,mc->m", d, np.linalg.solve(inner, d[..., None])[..., 0]))


def take_clear(batches: Iterable[Array], clear: Callable[[Array], NDArray[np.bool_]], count: int) -> Array:
    """Take postures from batches, (k, nq) each, until `count` of them are clear. Shape (<= count, nq). [rad or m]"""
    found: list[Array] = []
    for batch in batches:
        found.append(batch[clear(batch)])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]
