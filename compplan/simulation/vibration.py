"""The lowest natural frequencies of a robot on its springs, and the loads that its own motion puts on them.

Masses count whether or not the folder's gravity does. With M the mass matrix and C the compliance of
the elastic coordinates at a posture, frequencies f solve det(1 / (2 pi f)^2 - C M) = 0; the drives hold still. A motion
loads the springs by the inverse dynamics of the stiff arm, weight left out [Featherstone2008].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from compplan.robot import Array, Robot
from compplan.simulation.exact import ExactRobot, build_exact_robot


@dataclass(frozen=True)
class Dynamics:
    """A robot with all its masses as a Pinocchio model, springs as joints."""

    judge: ExactRobot  #: The model; its gravity is zero.
    #: The same seen from the ground, where accelerations count; another one only where a positioner carries the part.
    standing: ExactRobot
    compliance: Array  #: Compliance of the elastic coordinates. Shape (s, s).

    @property
    def known(self) -> bool:
        """Tell whether there are masses on springs."""
        return bool(len(self.judge.elastic)) and sum(inertia.mass for inertia in self.judge.model.inertias) > 0


@dataclass(frozen=True)
class ModeShapes:
    """The lowest modes at one posture, v^T M v = 1; m modes, s elastic coordinates."""

    omega: Array  #: Angular frequencies, rising. Shape (m,). [rad/s]
    shape: Array  #: Elastic coordinates of each mode. Shape (s, m). [1/sqrt(kg) and kin]
    tip: Array  #: Motion of the tip in each, base axes. Shape (3, m). [1/sqrt(kg)]


def build_dynamics(robot: Robot) -> Dynamics:
    """Build the dynamics of a robot, all bodies of its URDF and the tool included."""
    weightless = replace(robot, gravity=np.zeros(3), weights=())
    judge = build_exact_robot(weightless)
    return Dynamics(
        judge,
        build_exact_robot(weightless, standing=True) if robot.ground else judge,
        judge.compliance,
    )


def natural_frequencies(dynamics: Dynamics, q: Array, count: int = 2) -> Array:
    """Return the `count` lowest natural frequencies at postures, (k, nq), NaN where there are fewer. (k, count) [Hz]"""
    found = np.full((len(q), count), np.nan)
    if dynamics.known:
        for row, modes in zip(found, find_modes(dynamics, q, count), strict=True):
            row[: len(modes.omega)] = modes.omega / (2.0 * np.pi)
    return found


def find_modes(dynamics: Dynamics, q: Array, count: int) -> list[ModeShapes]:
    """Return at most `count` lowest modes at postures, (k, nq), from M v = C^-1 v / w^2."""
    judge, found = dynamics.judge, []
    data, world = judge.model.createData(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for configuration in q @ judge.commanded.T + judge.shift:
        mass = pin.crba(judge.model, data, configuration)
        mass = (np.triu(mass) + np.triu(mass, 1).T)[np.ix_(judge.elastic, judge.elastic)]
        tip = pin.computeFrameJacobian(judge.model, data, configuration, judge.tcp, world)[:3, judge.elastic]
        square, shapes = np.linalg.eig(dynamics.compliance @ mass)
        order = np.argsort(square.real)[::-1][:count]
        order = order[square.real[order] > 1e-12]
        way = shapes.real[:, order]
        way = way / np.sqrt(np.maximum(np.einsum("sm,st,tm->m", way, mass, way), 1e-300))
        found.append(ModeShapes(1.0 / np.sqrt(square.real[order]), way, tip @ way))
    return found


def inertial_loads(dynamics: Dynamics, q: Array, velocity: Array, acceleration: Array) -> Array:
    """Return what a motion puts on each elastic coordinate, weight left out. Shape (k, s). [N m or N]

    q, velocity and acceleration: shape (k, nq). [rad or m, per s, per s^2]
    """
    judge, data = dynamics.standing, dynamics.standing.model.createData()
    rigid = q @ judge.commanded.T + judge.shift
    rate, change = velocity @ judge.commanded.T, acceleration @ judge.commanded.T
    loads = np.empty((len(q), len(judge.elastic)))
    for i in range(len(q)):
        loads[i] = -pin.rnea(judge.model, data, rigid[i], rate[i], change[i])[judge.elastic]
    return loads
