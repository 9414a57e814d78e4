"""Let a true arm run a program in MuJoCo: drives follow the command, springs swing with damped modes."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve

from benchmarks.coverage.draw import Truth
from benchmarks.simulated_robot.cell import SimulatedRobot
from benchmarks.simulated_robot.robot import Array

#: Step of time. [s]
STEP = 2e-3


class Swing:
    """An arm in motion: M u'' + D u' + K u = J^T w - h(q, u, q', u', q''), u the elastic coordinates.

    Newmark's mean acceleration; M, J and h are taken at the beginning of each step, by MuJoCo.
    """

    def __init__(self, truth: Truth) -> None:
        self.truth, self.cell = truth, SimulatedRobot(truth.arm)
        model = self.cell.model
        model.dof_armature[:] = 0.0
        model.dof_armature[self.cell.elastic] = 1e-6  # a body without mass
        self.stiffness = np.linalg.inv(self.cell.compliance + 1e-14 * np.eye(len(self.cell.elastic)))

    def run(self, time: Array, q: Array, wrench: Array, length: Array) -> Array:
        """Return the tip at the rows of a run that begins at rest under its first load. Shape (n, 3). [m]

        Args:
            time: Shape (n,). [s]
            q: Commanded joint positions. Shape (n, nq). [rad or m]
            wrench: Planned wrench at the tip, base axes. Shape (n, 6). [N, N m]
            length: Length of the path. Shape (n,). [m]
        """
        at = np.arange(time[0], time[-1] + STEP, STEP)
        inside = np.clip(at, time[0], time[-1])
        drive, rate, change = drive_through(time, q, inside)
        load = np.stack([np.interp(inside, time, wrench[:, k]) for k in range(6)], axis=1)
        load = self.truth.force(load, np.interp(inside, time, length))
        tip = self._integrate(self.truth.joints(drive, rate), rate, change, load)
        tip += self.truth.shift(tip)
        return np.stack([np.interp(time, at, tip[:, k]) for k in range(3)], axis=1)

    def _integrate(self, q: Array, rate: Array, change: Array, load: Array) -> Array:
        cell, model, data, h = self.cell, self.cell.model, self.cell.data, STEP
        e, s = cell.elastic, cell.set
        place = q[:, cell.driver] * cell.multiplier + cell.offset
        rate, change = (values[:, cell.driver] * cell.multiplier for values in (rate, change))
        u, v, a = self._settle(place[0], load[0]), np.zeros(len(e)), np.zeros(len(e))
        full, bias, applied = np.zeros((model.nv, model.nv)), np.zeros(model.nv), np.zeros(model.nv)
        found, damper, k = np.empty((len(q), 3)), None, self.stiffness
        for i in range(len(q)):
            data.qpos[s], data.qpos[e] = place[i], u
            data.qvel[s], data.qvel[e] = rate[i], v
            data.qacc[s], data.qacc[e] = change[i], 0.0
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            found[i] = data.xpos[cell.tip]
            if i % 4 == 0:
                mujoco.mj_crb(model, data)
                mujoco.mj_fullM(model, data, full)
                mass = full[np.ix_(e, e)]
                if damper is None or i % 2000 == 0:
                    damper = self._damp(mass)
                factor = cho_factor(mass + 0.5 * h * damper + 0.25 * h * h * k)
            mujoco.mj_rne(model, data, 1, bias)
            self._push(load[i], applied)
            ahead, quick = u + h * v + 0.25 * h * h * a, v + 0.5 * h * a
            a = cho_solve(factor, (applied - bias)[e] - damper @ quick - k @ ahead)
            u, v = ahead + 0.25 * h * h * a, quick + 0.5 * h * a
        return found

    def _settle(self, place: Array, load: Array) -> Array:
        cell, model, data = self.cell, self.cell.model, self.cell.data
        u, bias, applied = np.zeros(len(cell.elastic)), np.zeros(model.nv), np.zeros(model.nv)
        data.qvel[:], data.qacc[:] = 0, 0
        for _ in range(60):
            data.qpos[cell.set], data.qpos[cell.elastic] = place, u
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, bias)
            self._push(load, applied)
            u = cell.compliance @ (applied - bias)[cell.elastic]
        return u

    def _push(self, load: Array, applied: Array) -> None:
        """Write the generalised forces of a wrench at the tip, and of weights that the folder's gravity leaves out."""
        cell = self.cell
        applied[:] = 0
        mujoco.mj_applyFT(cell.model, cell.data, load[:3], load[3:], cell.data.xpos[cell.tip], cell.tip, applied)
        for mass in self.truth.arm.weights:
            cell.weigh(mass, applied)

    def _damp(self, mass: Array) -> Array:
        """Return the matrix that damps every mode by the same share of critical: D = 2 z M (M^-1 K)^1/2."""
        root = np.linalg.cholesky(mass)
        inverse = np.linalg.inv(root)
        value, vector = np.linalg.eigh(inverse @ self.stiffness @ inverse.T)
        middle = vector @ np.diag(np.sqrt(np.maximum(value, 0.0))) @ vector.T
        return np.asarray(2.0 * self.truth.damping * root @ middle @ root.T)


def drive_through(time: Array, q: Array, at: Array) -> tuple[Array, Array, Array]:
    """Return where ideal drives are at some times, their rates and accelerations. Shapes (k, nq).

    They go through all rows with continuous accelerations, at rest at both ends.

    Args:
        time: Shape (n,). [s]
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        at: Times. Shape (k,). [s]
    """
    keep = np.r_[True, np.diff(time) > 1e-7]
    if keep.sum() < 2:
        return np.tile(q[-1], (len(at), 1)), *np.zeros((2, len(at), q.shape[1]))
    way = CubicSpline(time[keep], q[keep], axis=0, bc_type="clamped")
    return way(at), way(at, 1), way(at, 2)
