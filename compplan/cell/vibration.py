"""The lowest natural frequencies of a robot on its springs, and the loads that its own motion puts on them.

Masses count whether or not the folder's gravity does. With M the mass matrix and C the compliance of
the elastic coordinates at a posture, frequencies f solve det(1 / (2 pi f)^2 - C M) = 0; the drives hold still. A motion
loads the springs by the inverse dynamics of the stiff arm, weight left out [Featherstone2008].
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from compplan.cell.judge import Judge, build_judge
from compplan.robot import Array, Robot


@dataclass(frozen=True)
class Dynamics:
    """A robot with all its masses as a Pinocchio model, springs as joints.

    Attributes:
        judge: The model; its gravity is zero.
        compliance: Compliance of the elastic coordinates. Shape (s, s).

    """

    judge: Judge
    compliance: Array

    @property
    def known(self) -> bool:
        """Tell whether there are masses on springs."""
        return bool(len(self.judge.elastic)) and sum(inertia.mass for inertia in self.judge.model.inertias) > 0


def build_dynamics(robot: Robot) -> Dynamics:
    """Build the dynamics of a robot, all bodies of its URDF and the tool included."""
    judge = build_judge(replace(robot, gravity=np.zeros(3), weights=()))
    return Dynamics(judge, judge.compliance)


def natural_frequencies(dynamics: Dynamics, q: Array, count: int = 2) -> Array:
    """Return the lowest natural frequencies at some postures, NaN where there are fewer. Shape (k, count) [Hz].

    Args:
        dynamics: The robot.
        q: Joint positions. Shape (k, nq). [rad or m]
        count: How many frequencies.

    """
    judge, found = dynamics.judge, np.full((len(q), count), np.nan)
    if not dynamics.known:
        return found
    data, rigid = judge.model.createData(), q @ judge.commanded.T + judge.shift
    for i in range(len(q)):
        mass = pin.crba(judge.model, data, rigid[i])
        mass = np.triu(mass) + np.triu(mass, 1).T
        square = np.linalg.eigvals(dynamics.compliance @ mass[np.ix_(judge.elastic, judge.elastic)]).real
        slow = np.sort(square[square > 1e-12])[::-1][:count]
        found[i, : len(slow)] = 1.0 / (2.0 * np.pi * np.sqrt(slow))
    return found


def find_modes(dynamics: Dynamics, q: Array, count: int) -> list[tuple[Array, Array]]:
    """Return the lowest modes at some postures: angular frequencies, and how the tip moves in each.

    With M v = C^-1 v / w^2 scaled to v^T M v = 1 the tip moves by J v.

    Args:
        dynamics: The robot.
        q: Joint positions. Shape (k, nq). [rad or m]
        count: How many modes at most.

    Returns:
        For each posture frequencies, shape (m,) [rad/s], and motion of the tip, base axes, shape (3, m) [1/sqrt(kg)].

    """
    judge, found = dynamics.judge, []
    data, rigid = judge.model.createData(), q @ judge.commanded.T + judge.shift
    for configuration in rigid:
        mass = pin.crba(judge.model, data, configuration)
        mass = (np.triu(mass) + np.triu(mass, 1).T)[np.ix_(judge.elastic, judge.elastic)]
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        tip = pin.computeFrameJacobian(judge.model, data, configuration, judge.tcp, world)[:3, judge.elastic]
        square, shapes = np.linalg.eig(dynamics.compliance @ mass)
        order = np.argsort(square.real)[::-1][:count]
        order = order[square.real[order] > 1e-12]
        way = shapes.real[:, order]
        way = way / np.sqrt(np.maximum(np.einsum("sm,st,tm->m", way, mass, way), 1e-300))
        found.append((1.0 / np.sqrt(square.real[order]), tip @ way))
    return found


def inertial_loads(dynamics: Dynamics, q: Array, velocity: Array, acceleration: Array) -> Array:
    """Return what a motion puts on each elastic coordinate, weight left out. Shape (k, s). [N m or N].

    Args:
        dynamics: The robot.
        q: Joint positions. Shape (k, nq). [rad or m]
        velocity: Shape (k, nq). [rad/s or m/s]
        acceleration: Shape (k, nq). [rad/s^2 or m/s^2]

    """
    judge, data = dynamics.judge, dynamics.judge.model.createData()
    rigid = q @ judge.commanded.T + judge.shift
    rate, change = velocity @ judge.commanded.T, acceleration @ judge.commanded.T
    loads = np.empty((len(q), len(judge.elastic)))
    for i in range(len(q)):
        loads[i] = -pin.rnea(judge.model, data, rigid[i], rate[i], change[i])[judge.elastic]
    return loads


def differentiate_run(q: Array, time: Array, runs: list[tuple[int, int]]) -> tuple[Array, Array]:
    """Return joint velocities and accelerations of a timed motion by differences; zero at the ends of runs and outside.

    Args:
        q: Joint positions. Shape (n, nq). [rad or m]
        time: Shape (n,). [s]
        runs: First and last row of every run from rest to rest.

    Returns:
        Shapes (n, nq). [rad/s or m/s, and a second]

    """
    velocity, acceleration = np.zeros(q.shape), np.zeros(q.shape)
    for first, last in runs:
        step = np.maximum(np.diff(time[first : last + 1]), 1e-12)[:, None]
        mean, inside = np.diff(q[first : last + 1], axis=0) / step, slice(first + 1, last)
        both = step[:-1] + step[1:]
        velocity[inside] = (step[:-1] * mean[1:] + step[1:] * mean[:-1]) / both
        acceleration[inside] = 2.0 * np.diff(mean, axis=0) / both
    return velocity, acceleration
