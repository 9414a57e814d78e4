"""Clearance of the program's postures along the swept arm: between its stations as well, with exact derivatives.

Each of the several nearest pairs of a station is a row, so that none is missed where the nearest one changes:

    d_k + n_k . (J_b - J_a) dq/dz dz >= limit_k
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.posture.clearance import HIDDEN, linearise_margin, step_between, sweep_margin
from compplan.posture.collision_scene import CollisionScene
from compplan.robot import Array

#: Stations that are looked at to begin with.
STATIONS = 60


@dataclass
class SweptClearance:
    """What keeps the arm clear on its way.

    Attributes:
        scene: What may touch what.
        wanted: Clearance that is asked for of part and fixture. [m]
        at: Places that have rows, stations counted from 0: evenly spaced ones, and those at which the arm came near in
            a step. Shape (j,).

    """

    scene: CollisionScene
    wanted: float
    at: Array

    def keeps(self, q: Array) -> bool:
        """Tell whether the arm keeps clear from the first to the last station, and remember where it comes near.

        Args:
            q: Joint positions at all stations. Shape (k, nq). [rad or m]

        """
        places, margin = sweep_margin(self.scene, q, self.wanted, self.at)
        self.at = np.union1d(self.at, places[margin < HIDDEN])
        return bool(margin.min() >= 0.0)

    def linearise(self, q: Array, columns: Array) -> tuple[Array, Array]:
        """Return the margins of pairs that are near, and their derivatives.

        Args:
            q: Joint positions at all stations. Shape (k, nq). [rad or m]
            columns: Their derivatives by c coefficients. Shape (k, nq, c).

        Returns:
            Margins (r,) [m] and their derivatives (r, c) [m].

        """
        near = linearise_margin(self.scene, step_between(q, self.at), self.wanted)
        return near.distance, np.einsum("rj,rjc->rc", near.rate, step_between(columns, self.at[near.posture]))
