"""Dexterous directions around a point: from where the tool can come, and from where the arm yields least.

Around a point lies a sphere of tool axes. Those that the arm reaches inside its limits form the service region of the
point [AbdelMalek2004]; each direction is one posture a branch and roll angle, ranked by the deflection under a given
wrench [Singh2021].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InfeasibleError
from compplan.reporting.maps.reach import ON_LIMIT
from compplan.robot import Array
from compplan.statics.chain import build_chain
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import Arm, solve_branches
from compplan.statics.quality import quality_of_poses

ROLLS = 8
"""Roll angles about the tool axis that are tried in every direction."""


@dataclass(frozen=True)
class ServiceSphere:
    """Directions around a point, the least yielding posture of each."""

    point: Array  #: The point, base frame. Shape (3,). [m]
    direction: Array  #: Directions in which the tool points. Shape (m, 3).
    q: Array  #: Least yielding posture of each direction, NaN where none is reached. Shape (m, nq). [rad or m]
    deflection: Array  #: Deflection of the TCP under the wrench, to first order. Shape (m,). [m]
    inverse_condition: Array  #: Dexterity of that posture. Shape (m,).

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Tell which directions are reached. Shape (m,)."""
        return np.isfinite(self.deflection)

    @property
    def share(self) -> float:
        """Share of the sphere that is reached."""
        return float(self.reached.mean())


def spread_directions(count: int) -> Array:
    """Spread directions evenly over the sphere (a Fibonacci lattice). Shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def serve_point(
    arm: Arm, point: Array, wrench: Array, length: float, directions: Array | int = 200, *, least_dexterity: float = 0.0
) -> ServiceSphere:
    """Find the directions in which the tool reaches a point, and the least yielding posture of each.

    Args:
        arm: The arm, with the robot's elasticity.
        point: The point, base frame. Shape (3,). [m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
        length: Characteristic length of the dexterity. [m]
        directions: Directions in which the tool shall point, shape (m, 3), or how many to spread over the sphere.
        least_dexterity: Postures of a smaller inverse condition number do not count.

    Raises:
        InfeasibleError: If the point is reached from nowhere.
    """
    wanted = spread_directions(directions) if isinstance(directions, int) else np.asarray(directions, float)
    wanted = wanted / np.linalg.norm(wanted, axis=1, keepdims=True)
    rotation = _roll_frames(wanted)
    slots = solve_branches(arm, np.tile(point, (len(rotation), 1)), rotation)
    inside = ((slots >= arm.robot.lower - ON_LIMIT) & (slots <= arm.robot.upper + ON_LIMIT)).all(axis=-1)
    rows, branch = np.nonzero(inside)
    if not len(rows):
        raise InfeasibleError(f"no direction reaches the point {np.round(point, 4).tolist()} m inside the joint limits")
    q, owner = slots[rows, branch], rows // ROLLS
    chain = build_chain(arm.robot)
    cost = np.linalg.norm((cartesian_compliance(chain, q) @ wrench)[:, :3], axis=1)
    quality = quality_of_poses(chain, q, length)
    order = np.lexsort((np.where(quality >= least_dexterity, cost, np.inf), owner))
    first = order[np.unique(owner[order], return_index=True)[1]]
    first = first[quality[first] >= least_dexterity]
    m = len(wanted)
    result = ServiceSphere(point, wanted, np.full((m, q.shape[1]), np.nan), np.full(m, np.nan), np.full(m, np.nan))
    result.q[owner[first]] = q[first]
    result.deflection[owner[first]] = cost[first]
    result.inverse_condition[owner[first]] = quality[first]
    return result


def _roll_frames(direction: Array) -> Array:
    """Build TCP frames that point in each direction, at every roll angle. Shape (m * ROLLS, 3, 3)."""
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(direction, x)
    angle = np.arange(ROLLS) * 2 * np.pi / ROLLS
    rolled = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
    z = np.broadcast_to(direction[:, None], rolled.shape)
    return np.stack([rolled, np.cross(z, rolled), z], axis=-1).reshape(-1, 3, 3)
