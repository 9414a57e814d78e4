"""Predicted 95 % band after further measurements, up to the cheapest set of them that keeps the tolerance.

The error of the tip is L z + rest with independent standard normal z: parameters of the robot, unexplained errors,
level and direction of the force. After a measurement y = H z + noise of covariance diag(s^2) the covariance of z is

    P = (1 + H^T diag(s^-2) H)^-1,    and that of the tip is L P L^T + rest.

Each row of H is one measured coordinate: of a point of the path, or of a pose that a campaign would choose. Poses
determine parameters alone (`compplan.uncertainty.poses`): unexplained errors are noise to them (`pose_variance`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.assumed import LINK_ELASTICITY

#: Assumed measurements: poses of a campaign, pull at the tool [N], standard deviation of the tracker per axis [m];
#: that of a point on a part (default of `compplan learn`), number of independent points; relative standard deviation
#: of the force level (gain 1 %, drift) and standard deviation of its direction [rad] after a log of a force sensor.
POSES, PULL, TRACKER_SIGMA = 12, 400.0, 3e-5
PROBE, POINTS = 2e-5, 60
FORCE_LEVEL, FORCE_DIRECTION = 0.02, 0.01
#: Effects that are observable only under load.
COMPLIANCES = ("joint_stiffness", "link_compliance", "base_compliance", LINK_ELASTICITY)


@dataclass(frozen=True)
class MeasurementStep:
    """Predicted band after a measurement and all cheaper ones."""

    step: str  #: "now", "touch_off", "force_log", "poses" or "first_part".
    band: float  #: 95 % band of the complete cut. [m]
    alone: float  #: 95 % band after this measurement alone. [m]
    keeps: bool  #: Whether `band` is within the tolerance.
    minutes: float  #: Working time of one person (assumed). [min]
    instrument: str  #: Measuring instrument.


#: Minutes of work (assumed) and instrument of each measurement, cheapest first.
COSTS = {
    "touch_off": (10.0, "probe or tip on the robot"),
    "force_log": (20.0, "force sensor"),
    "poses": (60.0, "tracker"),
    "first_part": (90.0, "coordinate measuring machine"),
}
#: Short name and command of each measurement.
SHORT = {"touch_off": "touch-off", "force_log": "force log", "poses": "12 measured poses", "first_part": "first part"}
DO = {
    "touch_off": "touch the part off ([part] touched_off = true)",
    "force_log": "log the force of a cut (compplan forces JOB --log LOG)",
    "poses": "measure 12 poses (compplan campaign JOB --pull-N 400)",
    "first_part": "measure a first part (compplan learn JOB MEASURED)",
}


def predict_bands(
    now: float, band_after: Callable[[Sequence[str]], float], steps: Sequence[str], tolerance: float
) -> tuple[tuple[MeasurementStep, ...], tuple[str, ...]]:
    """Return the bands by measurement, and the cheapest set that keeps the tolerance; empty if not needed or possible.

    now: band of the complete cut [m], band_after: band after a set of measurements; steps: available measurements.
    """
    steps = sorted(steps, key=lambda step: COSTS[step][0])
    ladder = [MeasurementStep("now", now, now, now <= tolerance, 0.0, "")]
    for count, step in enumerate(steps, 1):
        band = min(band_after(steps[:count]), ladder[-1].band)  # bands are sampled, but no measurement widens one
        alone = min(band_after([step]), now)
        ladder.append(MeasurementStep(step, band, alone, band <= tolerance, *COSTS[step]))
    if now <= tolerance:
        return tuple(ladder), ()
    sets = [chosen for size in range(1, len(steps) + 1) for chosen in combinations(steps, size)]
    sets.sort(key=lambda chosen: sum(COSTS[step][0] for step in chosen))
    return tuple(ladder), next((chosen for chosen in sets if band_after(chosen) <= tolerance), ())


def pose_variance(known: Uncertainty, sigma: float) -> float:
    """Return the variance of a measured pose per axis: instrument, repeatability, unexplained errors. [m^2]"""
    return sigma**2 + (known.repeatability or 0.0) ** 2 + known.smooth**2


def condition(columns: Array, rows: Sequence[Array], sigmas: Sequence[float]) -> Array:
    """Return the motion of the tip by each z after measurements with rows H, (m, c), and sigmas. Shape (k, 3, c). [m]

    columns: the same before. Shape (k, 3, c). [m]
    """
    whole = np.vstack([np.eye(columns.shape[2]), *(row / sigma for row, sigma in zip(rows, sigmas, strict=True))])
    upper = np.asarray(np.linalg.qr(whole, mode="r"))
    return np.asarray(np.linalg.solve(upper.T, columns.reshape(-1, columns.shape[2]).T).T.reshape(columns.shape))


def pick_places(count: int, most: int) -> NDArray[np.int_]:
    """Return at most `most` evenly spaced of `count` rows."""
    return np.unique(np.linspace(0, count - 1, most).astype(int)) if count else np.zeros(0, int)
