"""Which moves of a path carry force, and which joint is the busiest on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compplan.io.quantities import format_percent
from compplan.planning.task import PlanTask
from compplan.planning.timing import Timing
from compplan.reporting.along_path import find_spans
from compplan.robot import Array

#: Forces below this share of the greatest one are none.
NO_FORCE = 1e-3


def mark_force(wrench: Array, cut: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark the moves of the cut (n,) that carry force, by the waypoint that they end at; wrench: (n, 6) [N, N m]."""
    size = np.linalg.norm(wrench[:, :3], axis=1)
    acts = size > NO_FORCE * max(float(size.max(initial=0.0)), 1e-12)
    return np.asarray(cut & (acts | np.r_[acts[:1], acts[:-1]]))


def describe_force(length: Array, cut: NDArray[np.bool_], pushed: NDArray[np.bool_]) -> str:
    """Say which share of the cut carries force; length up to each waypoint (n,) [m], masks (n,)."""
    steps = np.r_[0.0, np.diff(length)]
    whole, share = float(steps[cut].sum()), float(steps[pushed].sum())
    if not pushed.any() or whole <= 0:
        return "No force is predicted."
    if share > 0.9999 * whole:
        return "The tool carries force all along the cut."
    count = len(find_spans(cut & ~pushed))
    stretches = "one stretch" if count == 1 else f"{count} stretches"
    return (
        f"The tool carries force on {format_percent(share / whole)} of the cut's length; on {stretches} none is "
        "predicted (above the stock, straight in or out of it, or at rest)."
    )


def list_rates(task: PlanTask, timing: Timing) -> list[tuple[str, Array, Array]]:
    """Return name, joint rates and their limits, where there are any."""
    pairs = [("velocity", timing.velocity, task.velocity_limits),
             ("acceleration", timing.acceleration, task.acceleration_limits)]  # fmt: skip
    return [(name, rates, limits) for name, rates, limits in pairs if np.isfinite(limits).any()]


def busiest_rate(rates: Sequence[tuple[str, Array, Array]], joints: Sequence[str], row: int) -> str:
    """Say which rate of which joint is used the most around a waypoint; rates: name, values (n, nq), limits (nq,)."""
    best, said = 0.0, "–"
    for name, values, limits in rates:
        near = np.abs(values[max(row - 3, 0) : row + 4]) / limits
        k = int(np.argmax(near.max(axis=0)))
        if near.max() > best:
            best = float(near.max())
            said = f"{name} of {joints[k]} ({format_percent(best)})"
    return said
