"""Circles under a milling force [Mamedov2018, Tables 4 and 5]: a posture that the paper does not state is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import Arm, build_arm, solve_branches

FORCE = np.array([440.0, 1370.0, -635.0, 0.0, 0.0, 0.0])
RADII = (0.01, 0.5)
PLANES = ("xy", "xz", "yz")
POINTS = 36
#: Uncompensated mean errors per axis, the rows of `RADII`, and compensated ones. [mm]
MEANS_BEFORE = ((0.776, 1.825, 0.628), (0.753, 1.968, 0.701))
MAXIMA_BEFORE = ((0.779, 1.841, 0.639), (1.072, 2.838, 1.261))
MEANS_AFTER = ((0.113, 0.160, 0.017), (0.111, 0.314, 0.045))
_TARGET = np.array([MEANS_BEFORE, MEANS_AFTER]) * 1e-3


@dataclass(frozen=True)
class CirclePosture:
    """Where the circles lie and how the tool stands: what the paper leaves out."""

    centre: Array  #: Centre of both circles, base frame. Shape (3,). [m]
    orientation: Array  #: Rotation vector of the TCP frame, the same all around. Shape (3,). [rad]
    plane: str  #: Plane of the circles: "xy", "xz" or "yz".
    slot: int  #: Configuration, an index into `compplan.statics.ik.CONFIGURATIONS`.


@dataclass(frozen=True)
class CircleErrors:
    """Errors along both circles, before and after the mirrored compensation by the reduced model."""

    before: Array  #: Shape (2, POINTS, 3). [m]
    after: Array  #: Shape (2, POINTS, 3). [m]

    def means(self, errors: Array) -> Array:
        """Return the mean size per axis. Shape (2, 3). [m]."""
        return np.asarray(np.abs(errors).mean(axis=1))

    def misfit(self) -> Array:
        """Return the relative errors of the means before and after compensation. Shape (2, 2, 3)."""
        return np.array([self.means(self.before), self.means(self.after)]) / _TARGET - 1.0


def fit_posture(full: Robot, reduced: Robot, *, seed: int = 0) -> CirclePosture:
    """Fit a posture to the paper's means before and after compensation: twelve numbers, seven free ones.

    Postures are drawn at random, the best on the small circle are tried on the large one, and the best of them refined.

    Args:
        full: The full model.
        reduced: The model of the compensation.
        seed: Seed of the draw.
    """
    best: tuple[float, CirclePosture] | None = None
    for posture in _shortlist(build_arm(full), build_chain(full), seed):
        cost = float(np.sum(_misfit(full, reduced, posture) ** 2))
        if best is None or cost < best[0]:
            best = cost, posture
    assert best is not None
    start = best[1]

    def residual(x: Array) -> Array:
        return _misfit(full, reduced, CirclePosture(x[:3], x[3:], start.plane, start.slot))

    found = least_squares(residual, np.r_[start.centre, start.orientation], diff_step=1e-4, max_nfev=15)
    return CirclePosture(found.x[:3], found.x[3:], start.plane, start.slot)


def compensate_circles(full: Robot, reduced: Robot, posture: CirclePosture) -> CircleErrors:
    """Compute the errors along the circles: the mirrored point is commanded, the full model answers there."""
    arm, chain, model = build_arm(full), build_chain(full), build_chain(reduced)
    before, after = np.empty((2, POINTS, 3)), np.empty((2, POINTS, 3))
    for k, radius in enumerate(RADII):
        points = circle(posture, radius)
        q = _reach(arm, points, posture)
        before[k] = _move(chain, q)
        mirrored = points - _move(model, q)
        answer = _reach(arm, mirrored, posture)
        after[k] = mirrored + _move(chain, answer) - points
    return CircleErrors(before, after)


def circle(posture: CirclePosture, radius: float) -> Array:
    """Lay out a circle. Shape (POINTS, 3). [m]."""
    angle = np.arange(POINTS) * 2 * np.pi / POINTS
    points = np.tile(posture.centre, (POINTS, 1))
    first, second = ("xyz".index(letter) for letter in posture.plane)
    points[:, first] += radius * np.cos(angle)
    points[:, second] += radius * np.sin(angle)
    return points


def _shortlist(arm: Arm, chain: Chain, seed: int) -> list[CirclePosture]:
    """Draw postures and keep those that yield at their centre as the small circle does."""
    rng, count = np.random.default_rng(seed), 4000
    centre = rng.uniform([-2.2, -2.2, 0.2], [2.2, 2.2, 2.2], (count, 3))
    turn = Rotation.random(count, random_state=seed)
    slots = solve_branches(arm, centre, turn.as_matrix())[:, :4]
    inside = ((slots >= arm.robot.lower) & (slots <= arm.robot.upper)).all(axis=-1)
    rows, slot = np.nonzero(inside)
    gap = np.abs(_move(chain, slots[rows, slot])) / _TARGET[0, 0] - 1
    order = np.argsort((gap**2).sum(axis=1))[:12]
    vectors = turn.as_rotvec()
    return [CirclePosture(centre[rows[k]], vectors[rows[k]], plane, int(slot[k])) for k in order for plane in PLANES]


def _misfit(full: Robot, reduced: Robot, posture: CirclePosture) -> Array:
    """Return the relative errors of the twelve means, with a penalty for points out of reach. Shape (12,)."""
    errors = compensate_circles(full, reduced, posture)
    result = np.empty((2, 2, 3))
    for i, values in enumerate((errors.before, errors.after)):
        reached = np.isfinite(values).all(axis=2)
        for k in range(len(RADII)):
            known = np.abs(values[k, reached[k]])
            means = known.mean(axis=0) if len(known) else np.zeros(3)
            result[i, k] = means / _TARGET[i, k] - 1 + 5 * (1 - reached[k].mean())
    return result.ravel()


def _reach(arm: Arm, points: Array, posture: CirclePosture) -> Array:
    turn = np.tile(Rotation.from_rotvec(posture.orientation).as_matrix(), (len(points), 1, 1))
    q = solve_branches(arm, points, turn)[:, posture.slot]
    within = (q >= arm.robot.lower) & (q <= arm.robot.upper)
    return np.where(np.asarray(within.all(axis=-1))[:, None], q, np.nan)


def _move(chain: Chain, q: Array) -> Array:
    """Move the TCP by the force, to first order as the paper does. Shape (n, 3). [m]."""
    return np.asarray((cartesian_compliance(chain, q) @ FORCE)[:, :3])
