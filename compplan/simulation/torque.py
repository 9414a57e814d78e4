"""Joint torques of a run along a path, by Pinocchio's inverse dynamics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from compplan.robot import Array, Robot
from compplan.simulation.exact import build_exact_robot, hold_load
from compplan.statics.chain import build_chain, locate_frames

#: Torque limit as a multiple of the static load, if the latter alone is beyond the effort limit.
STATIC_ROOM = 1.05


class TorqueRules:
    """Joint torques of a cut: tau = a u + b x + c, x the square of the speed along it, u half its derivative.

    They include masses, weights and the wrench on the tool, but not friction. If the static load alone is beyond an
    effort limit, the limit is raised to `STATIC_ROOM` times the load, with a note.
    """

    def __init__(self, robot: Robot, q: Array, wrench: Array) -> None:
        weighed = replace(robot, springs=(), link_elasticities=(), gravity=np.array([0.0, 0.0, -9.81]))
        rigid = build_exact_robot(weighed, inertial=True)
        if robot.ground:
            turn = np.swapaxes(locate_frames(build_chain(robot), q).ground, 1, 2)
            wrench = np.hstack([(turn @ part[..., None])[..., 0] for part in (wrench[:, :3], wrench[:, 3:])])
        self.model, self.commanded = rigid.model, rigid.commanded
        self.positions = q @ rigid.commanded.T + rigid.shift
        static = self.held = hold_load(rigid, q, wrench)
        efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1e9)
        greatest = np.abs(static).max(axis=0)
        self.limits = np.maximum(efforts, STATIC_ROOM * greatest)
        self.notes = [
            f"The static load of {robot.joint_names[j]} ({greatest[j]:.0f} N m) is beyond its effort limit "
            f"({efforts[j]:.0f} N m): the limit is raised to {STATIC_ROOM:g} times this load."
            for j in np.flatnonzero(greatest > efforts)
        ]

    def rows(self, start: int, end: int, rate: Array, change: Array) -> tuple[Array, Array, Array, Array]:
        """Return a, b, c of the waypoints from `start` to `end`, shapes (k, nq), and the limits, shape (nq,). [N m]"""
        data, zero = self.model.createData(), np.zeros(self.model.nv)
        place = self.positions[start : end + 1]
        speed, curvature = rate @ self.commanded.T, change @ self.commanded.T
        a, b = np.empty((len(place), self.model.nv)), np.empty((len(place), self.model.nv))
        for i in range(len(place)):
            weight = pin.computeGeneralizedGravity(self.model, data, place[i])
            a[i] = pin.rnea(self.model, data, place[i], zero, speed[i]) - weight
            b[i] = pin.rnea(self.model, data, place[i], speed[i], curvature[i]) - weight
        return a @ self.commanded, b @ self.commanded, self.held[start : end + 1], self.limits
