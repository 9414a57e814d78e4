"""The 95 % band of every station of the cut lies below the widest one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from compplan.planning.problem import Bounds, Limit, PlanningProblem, Station
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.chain import Chain
from compplan.statics.kinematics import SymbolicFrames, locate_symbolic
from compplan.statics.stiffness import attain_pose
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import Slopes, split_covariance
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    build_path_model,
    measure_force_slopes,
    measure_slopes,
    pick_rows,
    unload_model,
)
from compplan.uncertainty.touch_off import subtract_touch

#: 95 % quantile of the standard normal distribution.
QUANTILE = 1.6449
#: Rows at which what the columns of the band do not hold is measured, and its least share of the variance.
REST_ROWS, LEAST_REST = 40, 1e-4
#: Rows of the cut at which the band of a finished posture is measured.
BAND_ROWS = 120


@dataclass(frozen=True)
class BandLimit(Limit):
    """r(q) <= B, r the radius that holds the tip with 95 %.

    Its covariance V = sum_j a_j^2 g_j g_j^T + V_0 has a column g_j(q) for each uncertain quantity that depends on the
    posture: zero or gear of a joint (axis x lever), direction of a joint's axis, compliance of a spring (its column
    times its deflection), size and direction of the force. |x|^2 with x of covariance V is close to a scaled
    chi-squared variable, whose quantile is Wilson and Hilferty's.
    """

    chain: Chain  #: The elastic chain.
    zeros: Array  #: a_j of each joint element: zero and gear. Shape (m,). [rad or m]
    turns: Array  #: a_j of turns about each axis of the frame of each element. Shape (m,). [rad]
    springs: Array  #: a_j of each elastic coordinate, relative. Shape (s,).
    level: float  #: Relative standard deviation of the size of the force.
    direction: float  #: Standard deviation of its direction. [rad]
    rest: Array  #: V_0. Shape (3, 3). [m^2]
    reference: float  #: Radius that counts as 1. [m]
    cut: NDArray[np.bool_]  #: Stations that count. Shape (k,).
    most: float = np.inf  #: Greatest radius that is allowed, as a share of `reference`.
    name = "band"
    formula = "r_95(q) <= B"

    def rows(self, station: Station) -> ca.SX:
        """Return the band variable less the radius of the station."""
        return station.band - self.radius(station.frames, station.deflection, station.wrench) / self.reference

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds: none outside of the cut."""
        return np.where(self.cut, 0.0, -np.inf)[:, None], np.inf

    def radius(self, frames: SymbolicFrames, deflection: ca.SX, wrench: ca.SX) -> ca.SX:
        """Return the radius as an expression. [m]"""
        spread = self.spread(frames, deflection, wrench)
        total, square = ca.trace(spread), ca.sumsqr(spread)
        part = 2.0 / 9.0 * square / total**2
        return ca.sqrt(total * (1.0 - part + QUANTILE * ca.sqrt(part)) ** 3)

    def spread(self, frames: SymbolicFrames, deflection: ca.SX, wrench: ca.SX) -> ca.SX:
        """Return the covariance V. Shape (3, 3). [m^2]"""
        chain, tip, found = self.chain, frames.position, ca.SX(ca.DM(self.rest))
        levers = [tip - origin for origin in frames.origin]
        pulls = [axis if slides else ca.cross(axis, lever)
                 for axis, lever, slides in zip(frames.axis, levers, chain.translates, strict=True)]  # fmt: skip
        for zero, turn, pull, lever in zip(self.zeros.tolist(), self.turns.tolist(), pulls, levers, strict=True):
            found = found + zero**2 * ca.mtimes(pull, pull.T)
            if turn > 0.0:  # the sum over the turns about three axes
                found = found + turn**2 * (ca.sumsqr(lever) * ca.SX.eye(3) - ca.mtimes(lever, lever.T))
        springs = chain.spring_elements.tolist()
        if not springs:
            return found
        columns = ca.horzcat(*(pulls[k] for k in springs))
        shares = columns * ca.repmat((ca.DM(self.springs) * deflection).T, 3, 1)
        found = found + ca.mtimes(shares, shares.T)
        compliance = ca.SX(ca.sparsify(ca.DM(chain.compliance)))
        pushed = [self.level * ca.mtimes(columns, deflection)]
        for unit in (ca.SX(ca.DM(each)) for each in np.eye(3)):
            force, moment = ca.cross(unit, wrench[:3]), ca.cross(unit, wrench[3:])
            load = [ca.dot(frames.axis[k], force if chain.translates[k] else moment + ca.cross(levers[k], force))
                    for k in springs]  # fmt: skip
            pushed.append(self.direction * ca.mtimes(columns, ca.mtimes(compliance, ca.vertcat(*load))))
        return found + sum(ca.mtimes(column, column.T) for column in pushed)

    def evaluate(self, task: PlanTask, rows: NDArray[np.int_]) -> tuple[Array, Array]:
        """Evaluate V (k, 3, 3) [m^2] and radius (k,) [m] at some waypoints of the start."""
        q, wrench = task.q_start[rows], task.wrench[rows]
        theta = attain_pose(task.chain, q, wrench, slope=False).theta
        sizes = {"q": self.chain.nq, "theta": self.chain.n_springs, "wrench": 6}
        symbols = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        parts = locate_symbolic(self.chain, symbols["q"]), symbols["theta"], symbols["wrench"]
        function = ca.Function("band", list(symbols.values()), [ca.vec(self.spread(*parts)), self.radius(*parts)])
        spread, radius = function.map(len(rows))(q.T, np.zeros(0) if theta is None else theta.T, wrench.T)
        return np.array(spread).T.reshape(-1, 3, 3), np.array(radius)[0]


def read_band(task: PlanTask, force: ForceSpread, rows: NDArray[np.int_]) -> BandLimit:
    """Read how the 95 % band depends on the posture at stations (k,); what it leaves out stays as at the start."""
    chain, robot, known = task.chain, task.robot, robot_uncertainty(task.robot)
    zeros, turns, springs = np.zeros(len(chain.names)), np.zeros(len(chain.names)), np.zeros(chain.n_springs)
    element, at = dict(zip(robot.joint_names, chain.joint_elements.tolist(), strict=True)), 0
    for unknown in known.unknowns:
        square = known.width[at : at + len(unknown.keys)] ** 2
        at += len(unknown.keys)
        joint = element.get(str(unknown.joint), -1)
        if joint >= 0 and unknown.effect in ("joint_offset", "transmission_error"):
            zeros[joint] += square.mean()
        elif joint >= 0 and unknown.effect == "backlash":
            zeros[joint] += 0.25 * square.sum()
        elif joint >= 0 and unknown.effect == "link_geometry" and str(unknown.axis).startswith("r"):
            turns[joint] += square.sum()
        elif unknown.effect in ("joint_stiffness", "link_compliance"):
            axis = unknown.axis or "own"
            for s, name in enumerate(chain.spring_names):
                if name == f"{unknown.joint}.{axis}" and chain.compliance[s, s] > 0.0:
                    springs[s] += square.sum() / chain.compliance[s, s] ** 2
    level = float(np.hypot(force.level, force.path))
    band = BandLimit(chain, np.sqrt(zeros), np.sqrt(turns / 3.0), np.sqrt(springs), level, force.direction,
                     np.zeros((3, 3)), 1.0, task.cut[rows])  # fmt: skip
    some = pick_rows(task.cut, REST_ROWS)
    exact = spread_tip(task, force, some)
    value, vector = np.linalg.eigh((exact - band.evaluate(task, some)[0]).mean(axis=0))
    least = LEAST_REST * float(np.trace(exact.mean(axis=0)))
    band = replace(band, rest=vector @ np.diag(np.maximum(value, least)) @ vector.T)
    return replace(band, reference=float(band.evaluate(task, rows)[1][task.cut[rows]].max()))


def spread_tip(task: PlanTask, force: ForceSpread, rows: NDArray[np.int_]) -> Array:
    """Return the covariance of the tip at some waypoints, before correction and vibration. Shape (k, 3, 3). [m^2]."""
    known = robot_uncertainty(task.robot)
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    rest = unload_model(scene, rows)
    shared, local = measure_force_slopes(scene, rows, force, rest)
    model = subtract_touch(measure_slopes(scene, known.unknowns, rows, rest), rest.position, task.touched,
                           known.unknowns)  # fmt: skip
    if task.touched is not None:
        shared = np.concatenate([shared, task.touched.spread_part(rest.position)], axis=2)
    slopes = Slopes(rows, rest.position, model, shared, local, touched=task.touched)
    return np.asarray(sum(split_covariance(slopes, known).values()))
