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

#: Instrument that sees positions, standing anywhere.
TRACKER = "tracker"


@dataclass(frozen=True)
class Equipment:
    """What a shop has to measure with; defaults are assumed."""

    weights: tuple[float, ...] = (0.0,)  #: Weights that can hang at the tool, 0 for none. [kg]
    pull: float = 0.0  #: Force with which the tool can be pulled sideways, 0 for none. [N]
    sigma: float = 3e-5  #: Standard deviation of the instrument per axis. [m]
    #: Frames that are unknown, of "base" and "tool"; None: both of a tracker, none of other instruments.
    register: tuple[str, ...] | None = None
    seed: int = 0  #: Seed of the candidates.
    instrument: str = TRACKER  #: What sees the tip, "tracker", "sockets" or "gauge".
    places: int | None = None  #: Unknown places at which it stands; None: the usual number.
    length: float = 0.0  #: Distance of the two sockets of a plate, 0 for single ones. [m]
    poses: int = 12  #: Poses of a campaign that a plan's ladder counts with, under the process force.
    #: Relative standard deviation of the force after a log of a force sensor (gain 1 %, drift).
    force_level: float = 0.02
    force_direction: float = 0.01  #: Standard deviation of its direction then. [rad]
    probe: float = 2e-5  #: Standard deviation of a measured point of a part per axis (default of `compplan learn`). [m]
    points: int = 60  #: Points of a part that count as independent.

    @property
    def frames(self) -> tuple[str, ...]:
        """Return the frames that are unknown: the poses have to tell them from the arm."""
        if self.register is None:
            return ("base", "tool") if self.instrument == TRACKER else ()
        return tuple(part for part in self.register if part != "base" or self.instrument == TRACKER)

    @property
    def loaded(self) -> bool:
        """Tell whether loads can be changed."""
        return self.pull > 0.0 or any(self.weights)


#: What the ladder of a plan counts with.
USUAL = Equipment(pull=400.0)
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
    """Return what poses of `USUAL` equipment see of each parameter, of what it moves on the path. Shape (p,).

    A tracker stands anywhere: it sees nothing of what moves base and arm alike. Compliances show by the pull, under the
    greatest force of the process as `load`. [N]
    """
    share = min(1.0, USUAL.pull / max(load, 1e-9))
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
