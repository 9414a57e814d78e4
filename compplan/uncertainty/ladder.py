"""The ladder from the present band to one that keeps the tolerance: what each further measurement would make of it.

The tip is off by L z + rest with independent standard normal z: parameters of the robot, what the parameters leave
unexplained, level and direction of the force. A measurement y = H z + noise of covariance diag(s^2) leaves z the
covariance

    P = (1 + H^T diag(s^-2) H)^-1,    and the tip the covariance L P L^T + rest.

Each row of H is one measured coordinate at a place of the path. Poses tell of parameters alone: unexplained errors are
noise to them (`pose_variance`), here as where a campaign chooses poses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.uncertainty.assumed import LINK_ELASTICITY, moves_base

#: What the ladder counts with (assumed): poses of a campaign, pull at the tool [N], standard deviation of the tracker
#: per axis [m]; that of a point on a part (default of `compplan learn`), points that count as independent; what a
#: log of a force sensor leaves of the force, its level (gain 1 %, drift) and direction [rad].
POSES, PULL, TRACKER_SIGMA = 12, 400.0, 3e-5
PROBE, POINTS = 2e-5, 60
FORCE_LEVEL, FORCE_DIRECTION = 0.02, 0.01
#: Effects that only a load shows.
COMPLIANCES = ("joint_stiffness", "link_compliance", "base_compliance", LINK_ELASTICITY)


@dataclass(frozen=True)
class Rung:
    """The band after one more measurement, those before it included."""

    step: str  #: "now", "touch_off", "force_log", "poses" or "first_part".
    band: float  #: Distance that the whole cut keeps within with 95 %. [m]
    alone: float  #: The same after this measurement alone. [m]
    keeps: bool  #: Whether `band` is within the tolerance.
    minutes: float  #: Work of one person (assumed).
    instrument: str  #: What it is measured with.


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
    "poses": "measure 12 poses (compplan campaign JOB --pull-N 400)",
    "first_part": "measure a first part (compplan learn JOB MEASURED)",
}


def climb_ladder(
    now: float, band_after: Callable[[Sequence[str]], float], steps: Sequence[str], tolerance: float
) -> tuple[tuple[Rung, ...], tuple[str, ...]]:
    """Return the rungs, and the cheapest set of measurements that keeps; none where none is needed or none does.

    now: the band of the whole cut [m], band_after: after a set of measurements; steps: those that have not been taken.
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


def weigh_poses(robot: Robot, unknowns: Sequence[Unknown], load: float) -> Array:
    """Return what poses of a campaign see of each parameter, of what it moves on the path. Shape (p,).

    A tracker stands anywhere: it sees nothing of what moves base and arm alike. Compliances show by the pull, under the
    greatest force of the process as `load`. [N]
    """
    share = min(1.0, PULL / max(load, 1e-9))
    weight = [
        0.0 if moves_base(robot, unknown) else share if unknown.effect in COMPLIANCES else 1.0 for unknown in unknowns
    ]
    return np.repeat(weight, [len(unknown.keys) for unknown in unknowns])


def pose_variance(known: Uncertainty, sigma: float) -> float:
    """Return the variance of a measured pose per axis: instrument, repeatability, unexplained errors. [m^2]"""
    return sigma**2 + (known.repeatability or 0.0) ** 2 + known.smooth**2


def condition(columns: Array, rows: Sequence[Array], sigmas: Sequence[float]) -> Array:
    """Return the covariance of the tip after measurements with rows H, (m, c), and sigmas. Shape (k, 3, 3). [m^2]

    columns: motion of the tip by each z. Shape (k, 3, c). [m]
    """
    whole = np.vstack([np.eye(columns.shape[2]), *(row / sigma for row, sigma in zip(rows, sigmas, strict=True))])
    upper = np.asarray(np.linalg.qr(whole, mode="r"))
    after = np.linalg.solve(upper.T, columns.reshape(-1, columns.shape[2]).T).T.reshape(columns.shape)
    return np.asarray(after @ np.swapaxes(after, 1, 2))


def pick_places(count: int, most: int) -> NDArray[np.int_]:
    """Return rows evenly along a path, at most so many."""
    return np.unique(np.linspace(0, count - 1, most).astype(int)) if count else np.zeros(0, int)
