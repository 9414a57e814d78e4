"""Stands that creep: what was put up for contacts, gauges or a bar moves while its poses are measured.

With y what a model leaves of the rows of a stand, P the axes that each row tells, c the place of each label and v a
steady creep of the whole stand in the order of the rows, t from -1 to 1,

    y = P (c + v t) + noise        beside        y = P c + noise        by the F ratio of both.

A stand is the labels that known distances tie to each other, or one label. What the order of the rows goes with, poses
that follow it among that, looks the same: nobody can tell them apart by one pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from compplan.measurement.observations import DISTANCE, Observations, along
from compplan.robot import Array

#: A creep is said where chance makes so large a one once in a thousand at most.
BY_CHANCE = 1e-3


@dataclass(frozen=True)
class Creep:
    """A stand that creeps.

    Attributes:
        labels: Its labels.
        way: How far it goes from its first row to its last. [m]
        before: Root mean square of what is left of its rows, the creep not counted. [m]
        after: The same with it, as if no number had been spent on it. [m]
    """

    labels: tuple[str, ...]
    way: float
    before: float
    after: float

    def describe(self) -> str:
        """Say it in a sentence."""
        return (
            f"what holds {', '.join(self.labels)} crept by {1e3 * self.way:.2g} mm over its rows, as it seems:"
            f" {1e3 * self.before:.3f} mm are left of them, {1e3 * self.after:.3f} mm but for a steady creep; fasten it"
        )


def find_creep(sights: Observations | None, gap: Array, use: NDArray[np.bool_]) -> tuple[Creep, ...]:
    """Find the stands that creep beyond chance.

    Args:
        sights: What was seen, or None.
        gap: What a model leaves, seen minus expected. Shape (n, 3). [m]
        use: Rows that count. Shape (n,).
    """
    if sights is None or not sights.names:
        return ()
    stand = np.arange(len(sights.names))
    for a, b in sights.known.between:
        stand[stand == stand[b]] = stand[a]
    use = use & sights.seen & np.isfinite(gap).all(axis=1) & (sights.contact >= 0)
    groups = np.unique(stand)
    found = [_judge_stand(sights, gap, np.flatnonzero(use & (stand[sights.contact] == one))) for one in groups]
    chance = BY_CHANCE / len(groups)
    return tuple(creep for creep, luck in filter(None, found) if luck < chance)


def _judge_stand(sights: Observations, gap: Array, rows: NDArray[np.int_]) -> tuple[Creep, float] | None:
    """Return the creep of a stand and how likely chance makes one as large; None where too few rows tell it."""
    if len(rows) < 3:
        return None
    own, y = sights.take(rows), gap[rows]
    unit = y / np.maximum(np.linalg.norm(y, axis=1), 1e-300)[:, None]
    way = np.where((own.kind == DISTANCE)[:, None], unit, own.direction)
    labels, number = np.unique(own.contact, return_inverse=True)
    time = np.linspace(-1.0, 1.0, len(rows))
    place = np.einsum("nl,ij->nilj", np.eye(len(labels))[number.reshape(-1)], np.eye(3)).reshape(len(rows), 3, -1)
    design = along(way, np.concatenate([place, time[:, None, None] * np.eye(3)], axis=2))
    design = design.reshape(3 * len(rows), -1)
    still, flat, told = design[:, :-3], y.reshape(-1), np.isfinite(way).all(axis=1)
    solved = [np.linalg.lstsq(part, flat, rcond=1e-9) for part in (still, design)]
    before, after = (
        float(np.sum((flat - part @ one[0]) ** 2)) for part, one in zip((still, design), solved, strict=True)
    )
    few, more = (int(one[2]) for one in solved)
    numbers = int(np.where(told, 1, 3).sum())
    free = numbers - more
    if more == few or free < 1 or after <= 0.0:
        return None
    ratio = (before - after) / (more - few) / (after / free)
    fair = after * (numbers - few) / free
    creep = Creep(
        tuple(sights.names[k] for k in labels), 2.0 * float(np.linalg.norm(solved[1][0][-3:])),
        float(np.sqrt(before / len(rows))), float(np.sqrt(fair / len(rows))),
    )  # fmt: skip
    return creep, float(fdtrc(more - few, free, ratio))
