"""The 95 % band of every station of the cut lies below the widest one."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from compplan.planning.problem import PlanningProblem, Station
from compplan.robot import Array
from compplan.statics.chain import Chain
from compplan.statics.kinematics import SymbolicFrames, locate_symbolic

#: 95 % quantile of the standard normal distribution.
QUANTILE = 1.6449


@dataclass(frozen=True)
class BandLimit:
    """r(q) <= B, r the radius that holds the tip with 95 %.

    Its covariance V = sum_j a_j^2 g_j g_j^T + V_0 has a column g_j(q) for each uncertain quantity that depends on the
    posture: zero or gear of a joint (axis x lever), direction of a joint's axis, compliance of a spring (its column
    times its deflection), size and direction of the force. |x|^2 with x of covariance V is close to a scaled
    chi-squared variable, whose quantile is Wilson and Hilferty's.

    Attributes:
        chain: The elastic chain.
        zeros: a_j of each joint element: zero and gear. Shape (m,). [rad or m]
        turns: a_j of turns about each axis of the frame of each element. Shape (m,). [rad]
        springs: a_j of each elastic coordinate, relative. Shape (s,).
        level: Relative standard deviation of the size of the force.
        direction: Standard deviation of its direction. [rad]
        rest: V_0. Shape (3, 3). [m^2]
        reference: Radius that counts as 1. [m]
        cut: Stations that count. Shape (k,).
        most: Greatest radius that is allowed, as a share of `reference`.

    """

    chain: Chain
    zeros: Array
    turns: Array
    springs: Array
    level: float
    direction: float
    rest: Array
    reference: float
    cut: NDArray[np.bool_]
    most: float = np.inf
    name: str = "band"
    timed: bool = False
    of_joints: bool = False
    numbers: Array | None = None

    def __str__(self) -> str:
        return "r_95(q) <= B"

    def rows(self, station: Station) -> ca.SX:
        """Return the band variable less the radius of the station."""
        return station.band - self.radius(station.frames, station.deflection, station.wrench) / self.reference

    def bounds(self, problem: PlanningProblem) -> tuple[Array, Array]:
        """Return the bounds: none outside of the cut."""
        return np.where(self.cut, 0.0, -np.inf)[:, None], np.full((len(problem), 1), np.inf)

    def radius(self, frames: SymbolicFrames, deflection: ca.SX, wrench: ca.SX) -> ca.SX:
        """Return the radius as an expression. [m]"""
        spread = ca.SX(ca.DM(self.rest))
        for column in self.columns(frames, deflection, wrench):
            spread = spread + ca.mtimes(column, column.T)
        total, square = ca.trace(spread), ca.sumsqr(spread)
        part = 2.0 / 9.0 * square / total**2
        return ca.sqrt(total * (1.0 - part + QUANTILE * ca.sqrt(part)) ** 3)

    def columns(self, frames: SymbolicFrames, deflection: ca.SX, wrench: ca.SX) -> list[ca.SX]:
        """Return the columns a_j g_j of what depends on the posture. Shapes (3). [m]"""
        chain, tip, found = self.chain, frames.position, list[ca.SX]()
        units = [ca.SX(ca.DM(unit)) for unit in np.eye(3)]
        for k in range(len(chain.names)):
            lever = tip - frames.origin[k]
            if self.zeros[k] > 0.0:
                pull = frames.axis[k] if chain.translates[k] else ca.cross(frames.axis[k], lever)
                found.append(float(self.zeros[k]) * pull)
            if self.turns[k] > 0.0:
                found += [float(self.turns[k]) * ca.cross(unit, lever) for unit in units]
        springs = chain.spring_elements.tolist()
        pulls = [frames.axis[k] if chain.translates[k] else ca.cross(frames.axis[k], tip - frames.origin[k])
                 for k in springs]  # fmt: skip
        if not pulls:
            return found
        shares = self.springs.tolist()
        found += [shares[s] * deflection[s] * pull for s, pull in enumerate(pulls) if shares[s] > 0.0]
        columns, compliance = ca.horzcat(*pulls), ca.SX(ca.sparsify(ca.DM(chain.compliance)))
        found.append(self.level * ca.mtimes(columns, deflection))
        for unit in units:
            force, moment = ca.cross(unit, wrench[:3]), ca.cross(unit, wrench[3:])
            turns = [moment + ca.cross(tip - frames.origin[k], force) for k in springs]
            load = [ca.dot(frames.axis[k], force if chain.translates[k] else turn)
                    for k, turn in zip(springs, turns, strict=True)]  # fmt: skip
            found.append(self.direction * ca.mtimes(columns, ca.mtimes(compliance, ca.vertcat(*load))))
        return found

    def evaluate(self, q: Array, wrench: Array, theta: Array) -> tuple[Array, Array]:
        """Evaluate columns and radius at n postures.

        Args:
            q: Joint positions. Shape (n, nq). [rad or m]
            wrench: Wrench on the tool. Shape (n, 6). [N, N m]
            theta: Elastic coordinates under it. Shape (n, s). [rad or m]

        Returns:
            Columns (n, 3, c) and radii (n,). [m]

        """
        sizes = {"q": self.chain.nq, "theta": self.chain.n_springs, "wrench": 6}
        symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        parts = locate_symbolic(self.chain, symbols["q"]), symbols["theta"], symbols["wrench"]
        outputs = [ca.vec(ca.horzcat(*self.columns(*parts))), self.radius(*parts)]
        columns, radius = ca.Function("band", list(symbols.values()), outputs).map(len(q))(q.T, theta.T, wrench.T)
        return np.array(columns).T.reshape(len(q), -1, 3).swapaxes(1, 2), np.array(radius)[0]
