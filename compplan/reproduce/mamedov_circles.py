"""Circles under a milling force [Mamedov2018, Tables 4 and 5], in a fitted posture, as the paper states none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.ik import Arm, build_arm, solve_branches
from compplan.statics.stiffness import displace_linearly

FORCE = np.array([440.0, 1370.0, -635.0, 0.0, 0.0, 0.0])
RADII = (0.01, 0.5)
POINTS = 36
#: Uncompensated mean and maximum and compensated mean errors per axis, one row per radius. [mm]
MEANS_BEFORE = ((0.776, 1.825, 0.628), (0.753, 1.968, 0.701))
MAXIMA_BEFORE = ((0.779, 1.841, 0.639), (1.072, 2.838, 1.261))
MEANS_AFTER = ((0.113, 0.160, 0.017), (0.111, 0.314, 0.045))
_TARGET = np.array([MEANS_BEFORE, MEANS_AFTER]) * 1e-3


#: Centre of both circles (in the xz plane, base frame) [m], configuration (an index into
#: `compplan.statics.ik.CONFIGURATIONS`), and constant orientation of the TCP. The paper states none: least-squares fit
#: from random start postures, seven numbers for the twelve means of Tables 4 and 5 (fitted).
CENTRE, SLOT = np.array([-1.36963, 0.68992, 1.07902]), 0
ORIENTATION = Rotation.from_rotvec([-0.77049, -1.25579, 0.75336]).as_matrix()


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


def compensate_circles(full: Robot, reduced: Robot) -> CircleErrors:
    """Compute the errors along the circles: the mirrored point is commanded, the error is that of the full model."""
    arm, chain, model = build_arm(full), build_chain(full), build_chain(reduced)
    before, after = np.empty((2, POINTS, 3)), np.empty((2, POINTS, 3))
    angle = np.arange(POINTS) * 2 * np.pi / POINTS
    for k, radius in enumerate(RADII):
        points = CENTRE + radius * np.column_stack([np.cos(angle), np.zeros(POINTS), np.sin(angle)])
        q = _reach(arm, points)
        before[k] = _move(chain, q)
        mirrored = points - _move(model, q)
        answer = _reach(arm, mirrored)
        after[k] = mirrored + _move(chain, answer) - points
    return CircleErrors(before, after)


def _reach(arm: Arm, points: Array) -> Array:
    q = solve_branches(arm, points, np.tile(ORIENTATION, (len(points), 1, 1)))[:, SLOT]
    within = (q >= arm.robot.lower) & (q <= arm.robot.upper)
    return np.where(np.asarray(within.all(axis=-1))[:, None], q, np.nan)


def _move(chain: Chain, q: Array) -> Array:
    """Compute the displacement of the TCP by the force, to first order as in the paper. Shape (n, 3). [m]"""
    return displace_linearly(chain, q, FORCE, complementary=False)[:, :3]
