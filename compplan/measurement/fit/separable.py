"""What rows can tell apart: the largest set of parameters that is not singular, and how near it is to that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array

#: A direction whose standard error is more than this many typical sizes is called unidentifiable.
LIMIT = 10.0
#: Squared singular value of the column-scaled system below which a direction is singular, whatever the noise.
SINGULAR = 1e-12
#: Share of a direction from which a parameter may be the one that is held.
SHARE = 0.2


def find_free(information: Array, sizes: Array, rank: Sequence[int]) -> NDArray[np.bool_]:
    """Find a largest set of parameters that the data tell apart; the rest has to be held.

    Args:
        information: Information matrix A^T W A. Shape (p, p). [per unit squared]
        sizes: Typical sizes of the parameters. Shape (p,).
        rank: What is held first where several act alike: the lowest. Shape (p,).

    Returns:
        Mask of the parameters that can be free. Shape (p,).
    """
    scaled = information * np.outer(sizes, sizes)
    strength = np.sqrt(np.diag(scaled))
    free: NDArray[np.bool_] = strength * LIMIT > 1
    while free.any():
        index = np.flatnonzero(free)
        block = scaled[np.ix_(index, index)]
        norm = strength[index]
        value, vector = np.linalg.eigh(block / np.outer(norm, norm))
        direction = vector[:, 0]
        if value[0] > SINGULAR:
            value, vector = np.linalg.eigh(block)
            if value[0] * LIMIT**2 > 1:
                break
            direction = vector[:, 0]
        weight = np.abs(direction)
        suspects = np.flatnonzero(weight > SHARE * weight.max())
        free[index[min(suspects, key=lambda k: (rank[int(index[k])], -weight[k]))]] = False
    return free


def find_mates(information: Array, sizes: Array, free: NDArray[np.bool_]) -> list[tuple[int, list[int]]]:
    """Return every parameter that is held, and the free ones that act as it does: six at most, the likest first.

    Args:
        information: Information matrix A^T W A. Shape (p, p). [per unit squared]
        sizes: Typical sizes of the parameters. Shape (p,).
        free: Mask of the free parameters. Shape (p,).
    """
    scaled = information * np.outer(sizes, sizes)
    strength, index = np.sqrt(np.diag(scaled)), np.flatnonzero(free)
    found = []
    for k in (int(held) for held in np.flatnonzero(~free)):
        mates: list[int] = []
        if strength[k] * LIMIT > 1 and len(index):
            share = np.linalg.lstsq(scaled[np.ix_(index, index)], scaled[index, k], rcond=None)[0]
            part = np.abs(share) * strength[index]
            mates = [int(index[j]) for j in np.argsort(-part) if part[j] > SHARE * max(strength[k], part.max())][:6]
        found.append((k, mates))
    return found


def condition_number(information: Array, free: NDArray[np.bool_]) -> float:
    """Compute the condition number of the column-scaled system of the free parameters."""
    index = np.flatnonzero(free)
    if not len(index):
        return float("nan")
    block = information[np.ix_(index, index)]
    norm = np.sqrt(np.diag(block))
    value = np.linalg.eigvalsh(block / np.outer(norm, norm))
    return float(np.sqrt(value[-1] / max(value[0], 1e-300)))
