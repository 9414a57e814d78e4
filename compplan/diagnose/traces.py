"""Traces: the error that a joint would have to make at every row, against what the error depends on.

The other mechanisms that carry the deviation are taken out first, so that a soft spring shows as a line over torque,
lost motion as two levels, a gear error as a wave over the joint's angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compplan.diagnose.pattern_fit import Cell
from compplan.diagnose.patterns import Patterns
from compplan.robot import Array

#: Rows whose point lies nearer to the joint's axis than this share of the usual distance tell nothing about it.
NEAR_AXIS = 0.25
#: What stands on the horizontal axis, by mechanism.
DRIVERS = {
    "spring": ("load about the joint's axis", "N m", "N"),
    "lost motion": ("direction of the last move", "", ""),
    "lag": ("joint speed", "rad/s", "m/s"),
    "periodic error": ("joint position", "deg", "mm"),
    "zero": ("joint position", "deg", "mm"),
}


@dataclass(frozen=True, eq=False)
class Trace:
    """The error of one joint over the rows that show it; k rows.

    Attributes:
        place: The joint.
        mechanism: The mechanism that stays in.
        driver: What the error is drawn over. Shape (k,). [`driver_unit`]
        error: Error that the joint would have to make. Shape (k,). [`error_unit`]
        driver_name: What the driver is.
        driver_unit: Its unit.
        error_unit: "mrad" or "mm".
    """

    place: str
    mechanism: str
    driver: Array
    error: Array
    driver_name: str
    driver_unit: str
    error_unit: str


def trace_cells(
    patterns: Patterns, nuisance: Array | None, deviation: Array, cells: Sequence[Cell], joints: Sequence[str], q: Array
) -> tuple[Trace, ...]:
    """Trace the joint errors that cells stand for.

    Args:
        patterns: The patterns at n rows.
        nuisance: Columns that a registration has fitted, or None. Shape (n, 3, k).
        deviation: Measured minus predicted point, base axes. Shape (n, 3). [m]
        cells: Places and mechanisms that carry the deviation.
        joints: Names of the joints.
        q: Joint positions. Shape (n, nq). [rad or m]
    """
    labels = list(zip(patterns.place, patterns.mechanism, strict=True))
    kept = [k for k, label in enumerate(labels) if label in set(cells)]
    if not kept:
        return ()
    design = patterns.columns[:, :, kept]
    whole = design if nuisance is None else np.concatenate([design, nuisance], axis=2)
    flat = whole.reshape(-1, whole.shape[2])
    length = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    unknown = np.linalg.lstsq(flat / length, deviation.ravel(), rcond=1e-8)[0] / length
    left = deviation - (whole @ unknown)
    traces = []
    for place, mechanism in cells:
        if place not in joints or mechanism not in DRIVERS or (place, "zero") not in labels:
            continue
        inside = [k for k, column in enumerate(kept) if labels[column] == (place, mechanism)]
        own = patterns.columns[:, :, labels.index((place, "zero"))]
        square = (own**2).sum(1)
        seen = square > NEAR_AXIS**2 * square.mean()
        part = left + design[:, :, inside] @ unknown[inside]
        error = 1e3 * (own * part).sum(1) / np.maximum(square, 1e-300)
        index = list(joints).index(place)
        slides = patterns.unit[labels.index((place, "zero"))] == "m"
        name, unit, sliding_unit = DRIVERS[mechanism]
        if mechanism in ("zero", "periodic error"):
            driver = q[:, index] * (1e3 if slides else 180 / np.pi)
        else:
            summed = design[:, :, inside].sum(axis=2)
            driver = (own * summed).sum(1) / np.maximum(square, 1e-300)
        error_unit = "mm" if slides else "mrad"
        traces.append(
            Trace(place, mechanism, driver[seen], error[seen], name, sliding_unit if slides else unit, error_unit)
        )
    return tuple(traces)
