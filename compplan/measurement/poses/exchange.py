"""Which of many measurements to take: greedily by what each adds, then exchanged one by one [Fedorov1972].

One search for every aim: an aim tells what each candidate is worth beside some that are taken. The loop asks for the
variance of the tip along a path, the diagnosis for the odds of two explanations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from compplan.robot import Array

#: Tells what every candidate is worth beside some that are taken. Shape (m,).
Worth = Callable[[list[int]], Array]
#: An exchange has to be worth more by this share, so that rounding does not go round in circles.
BETTER = 1e-9
#: Rounds of exchange (assumed: most choices settle in two).
ROUNDS = 3


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
    """Exchange what is taken, and order it by what each adds to those before it; also return what that is.

    Args:
        worth: What every candidate is worth beside some.
        taken: Candidates to begin with.
    """
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
