"""The pool: postures that an arm can take."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array


def take_clear(batches: Iterable[Array], clear: Callable[[Array], NDArray[np.bool_]], count: int) -> Array:
    """Take postures from batches until enough of them are clear. Shape (<= count, nq). [rad or m]

    Args:
        batches: Postures that were drawn. Shape (k, nq) each. [rad or m]
        clear: Tells which the arm can take. Shape (k, nq) -> (k,).
        count: How many are wanted.
    """
    found: list[Array] = []
    for batch in batches:
        found.append(batch[clear(batch)])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]
