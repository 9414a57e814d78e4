"""Cost of the part of the 95 % band that motion adds."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import casadi as ca
import numpy as np
import pinocchio as pin

from compplan.planning.problem import Cost, Station
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.simulation.vibration import build_dynamics
from compplan.statics.chain import jacobian, locate_frames


@dataclass(frozen=True)
class Band(Cost):
    """w / S sum (|d| / d_0)^2 ds, d = A q'' + h(q', q') the quasi-static deflection of the tip by inertia.

    A and h are evaluated at the initial guess of the program. The rest of the band hardly depends on the motion.
    """

    weight: float  #: w / S relative to the other costs, S the total programmed time. [1/s]
    deflection: Array  #: A / d_0, then h / d_0 per pair of joints. Shape (k, 3, nq + nq (nq + 1) / 2).
    name = "band"
    formula = "{weight:g} sum (|d| / d_0)^2 ds"
    timed = True

    @property
    def numbers(self) -> Array:
        """Return the deflection factors of every station, column by column. Shape (k, c)."""
        return np.swapaxes(self.deflection, 1, 2).reshape(len(self.deflection), -1)

    def term(self, station: Station) -> ca.SX:
        """Return the weighted square of the deflection."""
        nq, rate = station.q.numel(), station.rate
        pairs = ca.vertcat(*(rate[i] * rate[j] for i, j in combinations_with_replacement(range(nq), 2)))
        half_rate = 0.5 * (station.half_rate + station.half_rate_before)
        motion = ca.vertcat(station.change * station.square + rate * half_rate, pairs * station.square)
        return self.weight * station.step * ca.sumsqr(ca.mtimes(ca.reshape(station.numbers[self.name], 3, -1), motion))


def measure_deflection(task: PlanTask, q: Array) -> Array:
    """Compute the quasi-static deflection of the tip per joint acceleration, then per product of two joint rates.

    Shape (k, 3, nq + nq (nq + 1) / 2). [m per rad/s^2 and per rad^2/s^2, or with m]
    """
    robot, nq, unit = build_dynamics(task.robot).inertial, q.shape[1], np.eye(q.shape[1])
    columns = jacobian(task.chain, locate_frames(task.chain, q))[:, :3, task.chain.spring_elements]
    columns, data, none = columns @ task.chain.compliance, robot.model.createData(), np.zeros(robot.model.nv)
    both = list(combinations_with_replacement(range(nq), 2))
    rates = [(unit[i] + (i != j) * unit[j]) @ robot.commanded.T for i, j in both]
    moves = [*((none, change) for change in robot.commanded.T), *((rate, none) for rate in rates)]
    loads = np.empty((len(q), len(moves), len(robot.elastic)))
    for row, place in zip(loads, q @ robot.commanded.T + robot.shift, strict=True):
        for load, (rate, change) in zip(row, moves, strict=True):
            load[:] = pin.rnea(robot.model, data, place, rate, change)[robot.elastic]
    own = {i: nq + k for k, (i, j) in enumerate(both) if i == j}
    for k, (i, j) in enumerate(both):  # keep the mixed part of the squared sum of two rates
        if i != j:
            loads[:, nq + k] -= loads[:, own[i]] + loads[:, own[j]]
    return np.asarray(columns @ np.swapaxes(loads, 1, 2))
