"""Limit of the joint torques: efforts of the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from compplan.planning.problem import Limit, Station
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.simulation.torque import TorqueRules
from compplan.statics.chain import Chain, build_chain
from compplan.statics.inertia import divide_body
from compplan.statics.kinematics import locate_symbolic

#: Gravity, base axes. [m/s^2]
GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class TorqueLimit(Limit):
    """|sum_b J_b^T m_b (p_b'' - g) - J^T w| <= tau_max, p_b the point masses equivalent to the bodies.

    With x the square of the speed, p_b'' = J_b (q'' x + q' x' / 2) + (J_b q')' q' x. Without friction.
    """

    chain: Chain  #: Joints and point masses of the rigid arm.
    most: Array  #: Greatest joint torques. Shape (nq,). [N m or N]
    name = "torque"
    formula = "|M q'' + c + g - J^T w| <= tau_max"
    of_joints = True

    def rows(self, station: Station) -> ca.SX:
        """Return the torques as shares of their limits."""
        frames = locate_symbolic(self.chain, station.q)
        place = ca.vertcat(*frames.centre)
        mass = ca.DM(np.repeat(self.chain.mass, 3))
        speed = ca.jtimes(place, station.q, station.rate)
        a = ca.jtimes(place, station.q, station.change) + ca.jtimes(speed, station.q, station.rate)
        a = a * station.square + speed * station.half_rate - ca.DM(np.tile(GRAVITY, len(self.chain.mass)))
        torque = ca.jtimes(place, station.q, mass * a, True)
        force, moment = station.wrench[:3], station.wrench[3:]
        held = [
            ca.dot(frames.axis[k], force if self.chain.translates[k]
                   else moment + ca.cross(frames.position - frames.origin[k], force))
            for k in self.chain.joint_elements.tolist()
        ]  # fmt: skip
        return (torque - ca.vertcat(*held)) / ca.DM(self.most)


def read_torques(task: PlanTask) -> TorqueLimit | None:
    """Read the torque limits of a task; None on a positioner or without masses: only the timing enforces them there."""
    robot = task.robot
    if robot.ground or not robot.bodies:
        return None
    points = tuple(point for body in robot.bodies for point in divide_body(body))
    stiff = replace(robot, springs=(), link_elasticities=(), gravity=np.zeros(3), weights=(), bodies=points)
    return TorqueLimit(build_chain(stiff), TorqueRules(robot, task.q_start, task.wrench).limits)
