"""Which of many measurements to take: greedily by what each adds, then exchanged one by one [Fedorov1972].

One search for every aim: an aim tells what each candidate is worth beside some that are taken. Identification asks for
the determinant of the information, the loop for the variance of the tip along a path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from compplan.robot import Array

#: Tells what every candidate is worth beside some that are taken. Shape (m,).
Worth = Callable[[list[int]], Array]
#: An exchange has to be worth more by this share, so that rounding does not go round in circles.
BETTER = 1e-9


def take_greedily(worth: Worth, count: int) -> list[int]:
    """Take candidates one after the other, each for what it adds to those before it."""
    taken: list[int] = []
    for _ in range(count):
        gain = worth(taken)
        gain[taken] = -np.inf
        taken.append(int(gain.argmax()))
    return taken


def exchange_taken(worth: Worth, taken: Sequence[int], rounds: int) -> list[int]:
    """Replace what is taken by better candidates, one by one, until none is better or the rounds are over."""
    taken = list(taken)
    for _ in range(rounds):
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
