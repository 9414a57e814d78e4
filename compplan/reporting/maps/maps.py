"""Deflection maps: how far the tool yields all over a plane, under the worst unit force and under a given wrench.

The worst unit force is the first right singular vector of the translational compliance, and the deflection under it the
first singular value [Mamedov2018, eqs. 14 to 16]. A given wrench bends the arm in exact loaded equilibrium. Where elbow
up and elbow down both reach a point, the stiffer posture counts and both are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError
from compplan.reporting.maps.reach import ELBOWS, Plane, ReachedPlane
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.stiffness import worst_unit_force

TIE = 1e-4
"""Elbow down counts as stiffer where it is so by this share; where both are the same, elbow up is taken."""


@dataclass(frozen=True)
class ElbowMap:
    """Deflection over a plane in one elbow configuration, or in the stiffer of both; NaN where it does not reach.

    Attributes:
        q: Joint positions. Shape (b, a, nq). [rad or m]
        worst: Deflection under the worst unit force. Shape (b, a). [m/N]
        force: Direction of that force, base axes. Shape (b, a, 3).
        under_wrench: Deflection under the given wrench, against the arm without it. Shape (b, a). [m]
        reduced_gap: Length of full minus reduced deflection under the full model's worst unit force. Shape (b, a).
            [m/N]
    """

    q: Array
    worst: Array
    force: Array
    under_wrench: Array
    reduced_gap: Array

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Tell which points are reached. Shape (b, a)."""
        return np.isfinite(self.worst)


@dataclass(frozen=True)
class DeflectionMap:
    """Deflection maps of a robot over a plane.

    Attributes:
        plane: The plane.
        posture: How the tool points.
        wrench: Given wrench of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
        elbows: The map of each elbow configuration, by name.
        best: The stiffer configuration at every point.
        chosen: Index of it in `ELBOWS`, -1 where nothing reaches. Shape (b, a).
    """

    plane: Plane
    posture: str
    wrench: Array
    elbows: dict[str, ElbowMap]
    best: ElbowMap
    chosen: NDArray[np.int_]


def map_deflection(robot: Robot, reached: ReachedPlane, wrench: Array, reduced: Robot | None = None) -> DeflectionMap:
    """Map the deflection of a robot over a plane, beside a reduced model of the same robot where one is given.

    wrench: of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
    """
    chain = build_chain(robot)
    other = None if reduced is None else build_chain(reduced)
    up, down = (_map_elbow(chain, other, reached.q[:, :, k], wrench) for k in range(len(ELBOWS)))
    softness = [np.where(up.reached, up.worst, np.inf), np.where(down.reached, down.worst * (1 + TIE), np.inf)]
    chosen = np.where(up.reached | down.reached, np.argmin(softness, axis=0), -1)

    def pick(name: str) -> Array:
        first, second = getattr(up, name), getattr(down, name)
        which = chosen if first.ndim == 2 else chosen[..., None]
        return np.asarray(np.select([which == 0, which == 1], [first, second], np.nan))

    best = ElbowMap(*(pick(field.name) for field in fields(ElbowMap)))
    return DeflectionMap(reached.plane, reached.posture, wrench, {"up": up, "down": down}, best, chosen)


def deflection_under(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute by how much a wrench moves the TCP, in exact equilibrium; NaN beyond buckling. Shape (n,) [m]."""
    try:
        moved = solve_equilibrium(chain, q, wrench).position - solve_equilibrium(chain, q).position
    except ConvergenceError:
        if len(q) == 1:
            return np.full(1, np.nan)
        half = len(q) // 2
        return np.r_[deflection_under(chain, q[:half], wrench), deflection_under(chain, q[half:], wrench)]
    return np.asarray(np.linalg.norm(moved, axis=1))


def _map_elbow(chain: Chain, other: Chain | None, candidates: Array, wrench: Array) -> ElbowMap:
    """Evaluate the candidates (b, a, k, nq) of an elbow and keep the stiffest at every point."""
    shape, nq = candidates.shape[:2], candidates.shape[-1]
    flat = candidates.reshape(-1, nq)
    valid = np.flatnonzero(np.isfinite(flat).all(axis=1))
    size, direction = np.full(len(flat), np.nan), np.full((len(flat), 3), np.nan)
    if len(valid):
        size[valid], direction[valid] = worst_unit_force(cartesian_compliance(chain, flat[valid]))
    cost = np.where(np.isfinite(size), size, np.inf).reshape(-1, candidates.shape[2])
    pick = np.arange(len(cost)) * candidates.shape[2] + cost.argmin(axis=1)
    size, direction, q = size[pick], direction[pick], flat[pick]
    rows = np.flatnonzero(np.isfinite(size))
    under, gap = np.full(len(pick), np.nan), np.full(len(pick), np.nan)
    if len(rows):
        under[rows] = deflection_under(chain, q[rows], wrench)
        if other is not None:
            change = cartesian_compliance(chain, q[rows]) - cartesian_compliance(other, q[rows])
            gap[rows] = np.linalg.norm(np.einsum("nij,nj->ni", change[:, :3, :3], direction[rows]), axis=1)
    q = np.where(np.isfinite(size)[:, None], q, np.nan)
    q, direction = q.reshape(*shape, nq), direction.reshape(*shape, 3)
    return ElbowMap(q, size.reshape(shape), direction, under.reshape(shape), gap.reshape(shape))
