"""The ladder from the present band to one that keeps the tolerance: what each further measurement would make of it.

The tip is off by L z + rest with independent standard normal z: parameters of the robot, what no parameter explains,
level and direction of the force. A measurement y = H z + noise of covariance diag(s^2) leaves z the covariance

    P = (1 + H^T diag(s^-2) H)^-1,    and the tip the covariance L P L^T + rest.

Each row of H is one measured coordinate at a place of the path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array


@dataclass(frozen=True)
class Shop:
    """What a shop measures with; assumed where no other source is given.

    Attributes:
        force_level: Relative standard deviation of the force after a log of a force sensor (gain 1 %, drift).
        force_direction: Standard deviation of its direction then. [rad]
        poses: Poses of a campaign (`compplan campaign --poses`), each measured without load and with the process force.
        tracker: Standard deviation of a measured pose per axis (default of `compplan campaign --sigma-mm`). [m]
        probe: Standard deviation of a measured point of a part per axis (default of `compplan learn`). [m]
        points: Points of a part that count as independent.
    """

    force_level: float = 0.02
    force_direction: float = 0.01
    poses: int = 12
    tracker: float = 3e-5
    probe: float = 2e-5
    points: int = 60


@dataclass(frozen=True)
class Rung:
    """The band after one more measurement, those before it included.

    Attributes:
        step: "now", "touch_off", "force_log", "poses" or "first_part".
        band: Distance that the whole cut keeps within with 95 %. [m]
        alone: The same after this measurement alone. [m]
        keeps: Whether `band` is within the tolerance.
        minutes: Work of one person (assumed).
        instrument: What it is measured with.
    """

    step: str
    band: float
    alone: float
    keeps: bool
    minutes: float
    instrument: str


#: Minutes of work (assumed) and instrument of each measurement, cheapest first.
COSTS = {
    "touch_off": (10.0, "probe or tip on the robot"),
    "force_log": (20.0, "force sensor"),
    "poses": (60.0, "tracker"),
    "first_part": (90.0, "coordinate measuring machine"),
}
#: The command of each measurement.
DO = {
    "touch_off": "touch the part off ([part] touched_off = true)",
    "force_log": "log the force of a cut (compplan forces JOB --log LOG)",
    "poses": "measure 12 poses (compplan campaign JOB)",
    "first_part": "measure a first part (compplan learn JOB MEASURED)",
}


def climb_ladder(
    now: float, band_after: Callable[[Sequence[str]], float], steps: Sequence[str], tolerance: float
) -> tuple[tuple[Rung, ...], tuple[str, ...]]:
    """Return the rungs, and the cheapest set of measurements that keeps; none where none is needed or none does.

    Args:
        now: The band of the whole cut now. [m]
        band_after: Tells the band of the whole cut after a set of measurements. [m]
        steps: Measurements that have not been taken.
        tolerance: Greatest deviation that counts as within tolerance. [m]
    """
    steps = sorted(steps, key=lambda step: COSTS[step][0])
    rungs = [Rung("now", now, now, now <= tolerance, 0.0, "")]
    for count, step in enumerate(steps, 1):
        band = band_after(steps[:count])
        rungs.append(Rung(step, band, band_after([step]), band <= tolerance, *COSTS[step]))
    if now <= tolerance:
        return tuple(rungs), ()
    sets = [chosen for size in range(1, len(steps) + 1) for chosen in combinations(steps, size)]
    sets.sort(key=lambda chosen: sum(COSTS[step][0] for step in chosen))
    return tuple(rungs), next((chosen for chosen in sets if band_after(chosen) <= tolerance), ())


def condition(columns: Array, rows: Sequence[Array], sigmas: Sequence[float]) -> Array:
    """Return the covariance of the tip after measurements. Shape (k, 3, 3). [m^2]

    Args:
        columns: Motion of the tip by each z. Shape (k, 3, c). [m]
        rows: H of each measurement, shape (m, c). [m]
        sigmas: Standard deviation of a row of each. [m]
    """
    whole = np.vstack([np.eye(columns.shape[2]), *(row / sigma for row, sigma in zip(rows, sigmas, strict=True))])
    upper = np.asarray(np.linalg.qr(whole, mode="r"))
    after = np.linalg.solve(upper.T, columns.reshape(-1, columns.shape[2]).T).T.reshape(columns.shape)
    return np.asarray(after @ np.swapaxes(after, 1, 2))


def pick_places(count: int, most: int) -> NDArray[np.int_]:
    """Return rows evenly along a path, at most so many."""
    return np.unique(np.linspace(0, count - 1, most).astype(int)) if count else np.zeros(0, int)
