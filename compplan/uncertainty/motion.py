"""What the motion of the arm and the place of the part add to the band.

The springs answer to the load b(t) of the motion with their own dynamics (`compplan.simulation.vibration`), and so they
do to drives that move ahead by what the load c(t) that a plan compensates would bend. With k the factor of masses and
compliances,

    e(t) = k x(t; k)[b] - x(t; k)[c],      c = 0 where nothing is compensated,

x[.] the answer of the tip to a load as modelled, with frequencies over sqrt(k). c is b without what changes faster than
the arm can follow. Factors and damping are drawn, evenly over their distributions.
A part whose place is stated to a width is off by a shift and a turn about its own frame, one for the whole path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from compplan.effects.forward_model import own_springs
from compplan.job.noise import NoiseTable
from compplan.robot import Array, Robot
from compplan.robot.pose import rigid_columns
from compplan.robot.uncertainty import Uncertainty, split_unknowns
from compplan.simulation.vibration import MODES, POSTURES, Dynamics, find_modes, modal_response

#: Relative standard deviation of the masses that move, where the folder states them and where they are assumed
#: (assumed: makers state arms to some 10 %; shares of links guessed from the whole arm err by more).
STATED, GUESSED = 0.10, 0.30
#: Factor by which damping may be other than assumed, one standard deviation (assumed).
DAMPING_FACTOR = 1.6
#: Factors and dampings that are drawn.
DRAWS = 12


def greatest_shift(shift: Array) -> float:
    """Return the greatest length of displacements (n, 3), 0 for none. [m]"""
    return float(np.linalg.norm(shift, axis=1).max(initial=0.0))


def spread_draws(error: Array) -> Array:
    """Return the covariance of drawn tips about their mean. Shape (d, n, 3) -> (n, 3, 3). [m^2]."""
    away = error - error.mean(axis=0)
    return np.asarray(np.einsum("dni,dnj->nij", away, away) / max(len(away) - 1, 1))


@dataclass(frozen=True, eq=False)
class Motion:
    """Where the motion of the arm puts the tip; n rows."""

    error: Array  #: Tip beside the planned one in every draw. Shape (d, n, 3). [m]
    answer: Array  #: Motion of the tip by the load of its motion, as modelled. Shape (n, 3). [m]
    static: Array  #: The same if the springs gave at once. Shape (n, 3). [m]
    source: str  #: What it rests on.

    @property
    def mean(self) -> Array:
        """Mean over the draws. Shape (n, 3). [m]."""
        return np.asarray(self.error.mean(axis=0))

    @property
    def covariance(self) -> Array:
        """Covariance over the draws. Shape (n, 3, 3). [m^2]."""
        return spread_draws(self.error)

    def worst_rows(self, cut: NDArray[np.bool_], most: int) -> NDArray[np.int_]:
        """Return the rows of the cut where the motion moves the tip the most, at most so many."""
        rows = np.flatnonzero(cut)
        size = (self.error[:, rows] ** 2).sum(axis=2).max(axis=0)
        return np.sort(rows[np.argsort(size)[-most:]])


class Push(NamedTuple):
    """A load on each elastic coordinate, shape (n, s) [N m or N], and the tip's motion at rest by it, (n, 3) [m]."""

    load: Array
    static: Array


def swing_arm(
    dynamics: Dynamics, q: Array, time: Array, moving: Push, held: Push, *, width: float, damping: float, source: str
) -> Motion:
    """Let drawn arms, (n, nq), answer to the load of a motion at times (n,) [s].

    held: the load that the plan compensates, nothing where it compensates none; width: relative standard deviation of
    masses and compliances together; damping: share of critical damping; source: what masses and damping rest on.
    """
    rows = np.unique(np.linspace(0, len(q) - 1, min(POSTURES, len(q))).astype(int))
    modes = find_modes(dynamics, q[rows], MODES)
    level = ndtri((np.arange(DRAWS) + 0.5) / DRAWS)
    level /= np.sqrt(np.mean(level**2))  # a dozen even draws spread less than the distribution
    spread = np.sqrt(np.log1p(width**2))  # of the logarithm, for a relative deviation: lognormal, mean 1
    factors = np.exp(spread * level - 0.5 * spread**2)
    dampings = np.clip(damping * DAMPING_FACTOR ** level[(7 * np.arange(DRAWS)) % DRAWS], 1e-3, 0.9)
    mix = np.column_stack([np.r_[factors, 1.0], -np.r_[np.ones(DRAWS), 0.0]])
    more = modal_response(modes, rows, time, [moving.load, held.load], mix, mix[:, 0] ** -0.5, np.r_[dampings, damping])
    more += np.einsum("db,bni->dni", mix, [moving.static, held.static])
    error, answer = more[:-1], more[-1]
    return Motion(error, answer, moving.static, source)


def know_masses(robot: Robot, known: Uncertainty) -> tuple[float, str]:
    """Return the relative width of masses and compliances together, and what the masses rest on."""
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


def read_placement(noise: NoiseTable | None) -> tuple[float, float] | None:
    """Return the stated uncertainty of the part's place, shift [m] and turn [rad] per axis, or None."""
    if noise is None or not {"part_frame_mm", "part_frame_deg"} & noise.model_fields_set:
        return None
    return noise.part_frame_mm * 1e-3, float(np.radians(noise.part_frame_deg))


def shift_part(position: Array, origin: Array, width: tuple[float, float]) -> Array:
    """Return how the part moves by one standard deviation of its place: three shifts, three turns. Shape (n, 3, 6).

    position: wanted tip (n, 3) [m]; origin: of the part frame (3,) [m]; width: deviations per axis [m, rad].
    """
    return np.asarray(rigid_columns(position, origin) * np.repeat(width, 3))
