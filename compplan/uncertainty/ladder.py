"""Predicted 95 % band after further measurements, up to the cheapest set of them that keeps the tolerance.

The error of the tip is L z + rest with independent standard normal z: parameters of the robot, unexplained errors,
level and direction of the force. After a measurement y = H z + noise of covariance diag(s^2) the covariance of z is

    P = (1 + H^T diag(s^-2) H)^-1,    and that of the tip is L P L^T + rest.

Each row of H is one measured coordinate: of a point of the path, or of a pose that a campaign would choose, apart from
collisions. Poses determine parameters alone: unexplained errors are noise to them (`pose_variance`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from compplan.effects import solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.errors import ConvergenceError
from compplan.measurement.pose_selection import (
    approach_poses,
    draw_postures,
    narrow_target,
    offer_once,
    pull_aside,
    take_greedily,
)
from compplan.robot import Array, Robot
from compplan.robot.pose import rigid_columns
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.posture_errors import derive_unknowns
from compplan.uncertainty.sensitivities import build_varied_model

#: Assumed measurements: poses of a campaign, pull at the tool [N], standard deviation of the tracker per axis [m];
#: that of a point on a part (default of `compplan learn`), number of independent points; relative standard deviation
#: of the force level (gain 1 %, drift) and standard deviation of its direction [rad] after a log of a force sensor.
POSES, PULL, TRACKER_SIGMA = 12, 400.0, 3e-5
PROBE, POINTS = 2e-5, 60
#: Postures drawn for a forecast, how many of them it chooses of, and their seed.
DRAWN, OFFERED, SEED = 300, 60, 0
#: Prior standard deviations of unknown frames. [m, rad]
LOOSE = (1.0, 0.5)
FORCE_LEVEL, FORCE_DIRECTION = 0.02, 0.01


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


def observe_poses(
    robot: Robot, known: Uncertainty, target: Array, path_q: Array, lowest: float, count: int, pull: float,
    variance: float,
) -> Array:  # fmt: skip
    """Return what the poses of a campaign measure: derivatives by each z of `known`, freed of unknown frames. (m, r)

    Poses are chosen greedily of a sample, each posture once. The frame of the tracker and the place of its target on
    the tool are unknown: what they could explain is not observed. Empty if no posture is found, or one lacks an
    equilibrium.

    Args:
        robot: The robot with its tool.
        known: Uncertainty of its r independent parameters z.
        target: Motion of the tip along the path by each z. Shape (k, 3, r). [m]
        path_q: Joint positions along the path. Shape (n, nq). [rad or m]
        lowest: Least height of the path over the base plane. [m]
        count: Number of poses.
        pull: Force with which the tool can be pulled sideways. [N]
        variance: Of a measured pose per axis. [m^2]
    """
    r, postures = target.shape[2], draw_postures(robot, path_q, lowest, SEED, DRAWN)[:OFFERED]
    loads = np.array([(0.0, 0.0, 0.0), *pull_aside(pull)[::2]])  # the opposite pull shows the same
    k, posture = len(postures), np.tile(np.arange(len(postures)), len(loads))
    sign = np.where(np.arange(len(posture)) // k % 2 == posture % 2, 1.0, -1.0)
    if not k:
        return np.zeros((0, r))
    try:
        scene = build_varied_model(robot, approach_poses(robot, postures[posture], sign, np.repeat(loads, k, axis=0)))
        at = linearize_model(scene, solve_model_poses(scene))
    except ConvergenceError:
        return np.zeros((0, r))
    slopes = (derive_unknowns(at, known.unknowns) @ known.spread)[1::2]
    frames = np.concatenate([rigid_columns(at.point[1::2], np.zeros(3)), at.attained.rotation[1::2]], axis=2)
    rows = np.concatenate([slopes, frames * np.r_[np.repeat(LOOSE, 3), np.full(3, LOOSE[0])]], axis=2)
    motion = np.pad(target.reshape(-1, r), ((0, 0), (0, rows.shape[2] - r)))
    worth = narrow_target(motion, np.eye(motion.shape[1]), rows, variance)
    taken = take_greedily(offer_once(worth, posture), min(count, k))
    seen, hidden = slopes[taken].reshape(-1, r), frames[taken].reshape(-1, frames.shape[2])
    return np.asarray(seen - hidden @ np.linalg.lstsq(hidden, seen, rcond=1e-9)[0])


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
