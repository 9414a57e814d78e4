"""The vocabulary of the diagnosis as columns of a least squares: what one unit of an effect moves, to first order."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.rival.bending import Bending
from benchmarks.rival.chain import Array
from benchmarks.rival.scene import Motion, Spec


class Columns(Bending):
    """Columns of every effect over one scene."""

    def of(self, spec: Spec) -> Motion:
        """Return the columns of an effect."""
        return getattr(self, f"_{spec.effect}")(spec)  # type: ignore[no-any-return]

    # --- geometry and frames ---

    def _joint_offset(self, spec: Spec) -> Motion:
        return self.of_reading(self.known[str(spec.joint)], [np.ones(self.n)], seen=False)

    def _link_geometry(self, spec: Spec) -> Motion:
        s = next(i for i, g in enumerate(self.scene.chain.segments) if g.name == spec.joint)
        posed, axis = self.scene.posed, str(spec.axis)
        direction = posed.parent[s][:, :, "xyz".index(axis[1])]
        return self.motion([self.move(direction, posed.origin[s], axis[0] == "r")])

    def _tool_frame(self, spec: Spec) -> Motion:
        return self._at_tool(np.ones(self.n, bool))

    def _at_tool(self, active: np.ndarray) -> Motion:
        axes, tip = self.scene.posed.attitude, self.scene.posed.tip
        moves = [self.move(axes[:, :, k], tip, turns=False) for k in range(3)]
        if self.scene.log.attitude is not None:
            moves += [self.move(axes[:, :, k], tip) for k in range(3)]
        return self.motion([m * active[:, None] for m in moves])

    def _base_frame(self, spec: Spec) -> Motion:
        return self._at_base(np.ones(self.n, bool))

    def _at_base(self, active: np.ndarray) -> Motion:
        units = [np.tile(np.eye(3)[k], (self.n, 1)) for k in range(3)]
        centre = np.zeros((self.n, 3))
        moves = [self.move(u, centre, turns) for turns in (False, True) for u in units]
        return self.motion([m * active[:, None] for m in moves])

    def _since(self, spec: Spec) -> np.ndarray:
        return np.asarray((np.arange(self.n) >= float(spec.shape[0])) | self.scene.later)

    def _frame_shift(self, spec: Spec) -> Motion:
        return self._at_base(self._since(spec))

    def _tool_shift(self, spec: Spec) -> Motion:
        return self._at_tool(self._since(spec))

    def _thermal_drift(self, spec: Spec) -> Motion:
        segments, posed = self.scene.chain.segments, self.scene.posed
        moving = [i for i, g in enumerate(segments) if g.kind != "fixed"]
        grown = np.zeros((self.n, 3))
        for s in [*moving, moving[-1] + 1]:
            if s < len(segments):
                grown = grown + posed.parent[s] @ segments[s].place
        rise = self._rise(spec)
        return self.motion([1e-5 * np.hstack([grown * rise[:, None], np.zeros((self.n, 3))])])

    def _rise(self, spec: Spec) -> Array:
        log = self.scene.log
        if spec.shape and log.timed:
            return np.asarray(10.0 * (1.0 - np.exp(-(log.time - log.time[0]) / float(spec.shape[0]))))
        heat = log.heat if log.heat is not None else np.zeros(self.n)
        good = np.isfinite(heat)
        heat = np.interp(np.arange(self.n), np.flatnonzero(good), heat[good]) if good.any() else np.zeros(self.n)
        return np.asarray(heat - (np.mean(heat[:3]) if self.scene.cold is None else self.scene.cold))

    # --- gears, motion, readings ---

    def _backlash(self, spec: Spec) -> Motion:
        joint = self.known[str(spec.joint)]
        return self.of_reading(joint, [-0.5 * direction_of(self.scene.q[:, joint])], seen=True)

    def _transmission_error(self, spec: Spec) -> Motion:
        joint = self.known[str(spec.joint)]
        phase = float(spec.shape[0]) * self.scene.q[:, joint]
        return self.of_reading(joint, [np.sin(phase), np.cos(phase)], seen=True)

    def speed(self, joint: int) -> Array:
        """Speed of a joint in path runs, zero elsewhere. Shape (n,). [rad/s]"""
        log, out = self.scene.log, np.zeros(self.n)
        for label in dict.fromkeys(log.run[log.moving]):
            k = np.flatnonzero(log.run == label)
            if len(k) > 2 and np.all(np.diff(log.time[k]) > 0.0):
                out[k] = np.gradient(self.scene.q[k, joint], log.time[k])
        return np.nan_to_num(out)

    def _tracking_lag(self, spec: Spec) -> Motion:
        joints = range(self.nq) if spec.joint is None else [self.known[spec.joint]]
        moves = sum((self.reading[j] * -self.speed(j)[:, None] for j in joints), np.zeros((self.n, 6)))
        mark = np.zeros((self.n, self.nq))
        for j in joints:
            mark[:, j] = -self.speed(j)
        return self.motion([moves], [mark])

    def _time_skew(self, spec: Spec) -> Motion:
        moves = sum((self.reading[j] * -self.speed(j)[:, None] for j in range(self.nq)), np.zeros((self.n, 6)))
        return self.motion([moves])

    def _joint_coupling(self, spec: Spec) -> Motion:
        joint, other = self.known[str(spec.joint)], self.known[str(spec.shape[0])]
        return self.of_reading(joint, [self.scene.q[:, other]], seen=False)


def direction_of(reading: Array) -> Array:
    """Return the direction of the last move, 0 before the first. Shape (n,)."""
    out, last = np.zeros(len(reading)), 0.0
    for k in range(1, len(reading)):
        step = reading[k] - reading[k - 1]
        if abs(step) > 1e-7:
            last = float(np.sign(step))
        out[k] = last
    return out


def rotation_gap(measured: Array, model: Array) -> Array:
    """Return the turn from model to measured axes, base axes. Shape (n, 3). [rad]"""
    out = np.full((len(model), 3), np.nan)
    good = np.isfinite(measured).all(axis=(1, 2))
    out[good] = Rotation.from_matrix(measured[good] @ model[good].transpose(0, 2, 1)).as_rotvec()
    return out
