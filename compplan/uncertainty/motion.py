"""Contribution of the motion of the arm to the band.

The springs respond dynamically to the load b(t) of the motion (`compplan.simulation.vibration`), and likewise to the
motion by which the drives compensate the static deflection under the load c(t). With k the factor of masses and
compliances,

    e(t) = k x(t; k)[b] - x(t; k)[c],      c = 0 without compensation,

where x[.] is the modelled response of the tip to a load, with frequencies over sqrt(k). c is b low-pass filtered to the
bandwidth that the arm can follow. Factors and damping are stratified samples of their distributions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from compplan.effects.forward_model import own_springs
from compplan.robot import Array, Robot
from compplan.robot.uncertainty import Uncertainty, split_unknowns
from compplan.simulation.vibration import MODES, POSTURES, Dynamics, find_modes, modal_response

#: Relative standard deviation of the moving masses, if the folder states them and if they are assumed (assumed: makers
#: state arms to some 10 %; link masses estimated from that of the arm err by more).
STATED, GUESSED = 0.10, 0.30
#: Factor of one standard deviation of the damping (assumed).
DAMPING_FACTOR = 1.6
#: Number of samples.
DRAWS = 12


def greatest_shift(shift: Array) -> float:
    """Return the greatest length of displacements (n, 3), 0 for none. [m]"""
    return float(np.linalg.norm(shift, axis=1).max(initial=0.0))


def spread_draws(error: Array) -> Array:
    """Return the covariance of sampled tips about their mean. Shape (d, n, 3) -> (n, 3, 3). [m^2]."""
    away = error - error.mean(axis=0)
    return np.asarray(np.einsum("dni,dnj->nij", away, away) / max(len(away) - 1, 1))


@dataclass(frozen=True, eq=False)
class Motion:
    """Dynamic error of the tip due to the motion of the arm; n rows."""

    error: Array  #: Actual minus planned tip, by sample. Shape (d, n, 3). [m]
    answer: Array  #: Modelled dynamic response of the tip to the inertial load. Shape (n, 3). [m]
    static: Array  #: Quasi-static response of the tip to the inertial load. Shape (n, 3). [m]
    source: str  #: Source of masses and damping.

    @property
    def mean(self) -> Array:
        """Return the mean over the samples. Shape (n, 3). [m]."""
        return np.asarray(self.error.mean(axis=0))

    @property
    def covariance(self) -> Array:
        """Return the covariance over the samples. Shape (n, 3, 3). [m^2]."""
        return spread_draws(self.error)

    def worst_rows(self, cut: NDArray[np.bool_], most: int) -> NDArray[np.int_]:
        """Return the rows of the cut with the greatest errors, at most `most`."""
        rows = np.flatnonzero(cut)
        size = (self.error[:, rows] ** 2).sum(axis=2).max(axis=0)
        return np.sort(rows[np.argsort(size)[-most:]])


class Push(NamedTuple):
    """Load on each elastic coordinate, (n, s) [N m or N], and static motion of the tip under it, (n, 3) [m]."""

    load: Array
    static: Array


def simulate_motion(
    dynamics: Dynamics, q: Array, time: Array, moving: Push, held: Push, *, width: float, damping: float, source: str
) -> Motion:
    """Simulate the response of sampled arms at joint positions (n, nq) and times (n,) [s] to the load of a motion.

    moving: inertial load; held: load that the plan compensates, zero without compensation; width: relative standard
    deviation of masses and compliances together; damping: ratio to critical; source: source of masses and damping.
    """
    rows = np.unique(np.linspace(0, len(q) - 1, min(POSTURES, len(q))).astype(int))
    modes = find_modes(dynamics, q[rows], MODES)
    level = ndtri((np.arange(DRAWS) + 0.5) / DRAWS)
    level /= np.sqrt(np.mean(level**2))  # stratified samples have too small a variance
    spread = np.sqrt(np.log1p(width**2))  # of the logarithm, for a relative deviation: lognormal, mean 1
    factors = np.exp(spread * level - 0.5 * spread**2)
    dampings = np.clip(damping * DAMPING_FACTOR ** level[(7 * np.arange(DRAWS)) % DRAWS], 1e-3, 0.9)
    mix = np.column_stack([np.r_[factors, 1.0], -np.r_[np.ones(DRAWS), 0.0]])
    more = modal_response(modes, rows, time, [moving.load, held.load], mix, mix[:, 0] ** -0.5, np.r_[dampings, damping])
    more += np.einsum("db,bni->dni", mix, [moving.static, held.static])
    error, answer = more[:-1], more[-1]
    return Motion(error, answer, moving.static, source)


def mass_uncertainty(robot: Robot, known: Uncertainty) -> tuple[float, str]:
    """Return the relative standard deviation of masses and compliances together, and the source of the masses."""
    said = str(robot.sources.get("masses", "not stated in the folder"))
    assumed = "assumed" in said or "does not say" in said
    masses = GUESSED if assumed else STATED
    own = {robot.joint_names[spring.joint]: spring.compliance for spring in own_springs(robot).values()}
    shares = [
        float(width[0]) / own[str(unknown.joint)]
        for unknown, width in split_unknowns(known.unknowns, known.width)
        if unknown.effect == "joint_stiffness" and own.get(str(unknown.joint), 0.0) > 0.0
    ]
    soft = float(np.sqrt(np.mean(np.square(shares)))) if shares else 0.0
    return float(np.hypot(masses, soft)), f"masses to {masses:.0%} ({said})"
