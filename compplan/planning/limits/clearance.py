"""Clearance of arm and tool from part, fixture and the arm itself."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from compplan.planning.posture.clearance import linearise_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.planning.problem import Bounds, Limit, PlanningProblem, Station
from compplan.robot import Array


@dataclass(frozen=True)
class ClearanceLimit(Limit):
    """d_p + g_p (q - q_ref) >= 0 for every near pair p at a station; d_p is its distance less the required clearance.

    Distances of meshes are not symbolic expressions: they are linearised at the last solution, and the program is
    solved again while the clearance is violated.
    """

    pairs: Array  #: For every pair d_p - g_p q_ref and g_p; 1 and 0 in unused entries. Shape (k, pairs (1 + nq)).
    joints: int  #: Number of joints.
    name = "clearance"
    formula = "clearance(q) >= wanted"

    @property
    def numbers(self) -> Array:
        """Return the linearised margins of the pairs. Shape (k, pairs (1 + nq))."""
        return self.pairs

    def rows(self, station: Station) -> ca.SX:
        """Return the margins of the pairs."""
        pairs = ca.reshape(station.numbers[self.name], 1 + self.joints, -1)
        return ca.mtimes(pairs.T, ca.vertcat(1.0, station.q))

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds of the margins."""
        return 0.0, np.inf


def linearise_clearance(scene: CollisionScene, q: Array, wanted: float, reserve: float) -> ClearanceLimit:
    """Linearise the distances of near pairs at joint positions of the stations (k, nq).

    `wanted` is the required clearance from part and fixture; `reserve` is added for the motion between stations. [m]
    """
    near, (k, nq) = linearise_margin(scene, q, wanted), q.shape
    most = int(np.bincount(near.posture, minlength=k).max(initial=1))
    numbers = np.zeros((k, most, 1 + nq))
    numbers[:, :, 0] = 1.0
    order = np.argsort(near.posture, kind="stable")
    place = np.arange(len(order)) - np.searchsorted(near.posture[order], near.posture[order])
    station, rate = near.posture[order], near.rate[order]
    numbers[station, place, 0] = near.distance[order] - reserve - np.einsum("rj,rj->r", rate, q[station])
    numbers[station, place, 1:] = rate
    return ClearanceLimit(numbers.reshape(k, -1), nq)
