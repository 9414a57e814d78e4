"""Placement of the part: effect of arm errors at its touched points on the part frame, and its uncertainty.

A part frame located with the robot follows from the positions that the controller displayed while the arm sagged. With
displayed points c and points T(q) of the loaded arm, the part is displaced from the stated frame by the rigid motion D
that fits D c = T(q) best. Loaded poses are compared with the path as D^-1 T(q): arm errors count by their difference
between path and touched points. Every touched coordinate is read with an independent error s, so that the fitted frame
x of covariance s^2 F F^T (F: `linear_displacement`) adds to the error of the tip. A placement stated in [noise], a
shift and a rotation about the part frame, replaces x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compplan.controllers.writers.joint_convention import controller_robot
from compplan.effects.attained import TRANSIENT, attain_with_effects, rest_robot
from compplan.effects.forward_model import ForwardModel
from compplan.job.job import Job
from compplan.job.noise import NoiseTable
from compplan.robot import Array, Robot
from compplan.robot.pose import fit_displacement, linear_displacement, rigid_columns, see_position, see_rotation
from compplan.robot.uncertainty import Unknown
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import locate_loaded
from compplan.statics.ik import build_arm, pose_error, refine_ik
from compplan.toolpath.toolpath import Toolpath
from compplan.uncertainty.sensitivities import build_path_model, measure_slopes

#: Greatest pose error of a touched point that counts as reached. [m, rad]
REACHED = 1e-6
#: Repeatability of a touched coordinate, one standard deviation (assumed: edge finder or wired probe). [m]
TOUCH_REPEATABILITY = 2e-5


@dataclass(frozen=True, eq=False)
class TouchOff:
    """Touch-off of a part: found frame and touched points."""

    frame: Array  #: Pose of the found part frame in the base frame. Shape (4, 4). [m]
    #: Touched points in the part frame; None: three corners of the box of the cut. Shape (k, 3). [m]
    points: Array | None = None


@dataclass(frozen=True, eq=False)
class TouchedPart:
    """A part located by touch-off."""

    robot: Robot  #: Robot model of the touch-off.
    q: Array  #: Joint positions at the touched points. Shape (k, nq). [rad or m]
    shown: Array  #: The touched points in the found frame, base axes. Shape (k, 3). [m]
    #: D, from the found frame to the actual frame by the robot model; None if neither gravity, effects nor the geometry
    #: in the controller displace the arm. Shape (4, 4). [m]
    displacement: Array | None

    def spread_part(self, position: Array) -> Array:
        """Return the motion of the fitted part by one deviation of the touched coordinates. Shape (n, 3, 6). [m]"""
        fit = linear_displacement(self.shown)
        value, vector = np.linalg.eigh(fit @ fit.T)
        root = vector * np.sqrt(np.maximum(value, 0.0)) @ vector.T  # symmetric, hence unique
        return self._carry(TOUCH_REPEATABILITY * root, position)

    def follow(self, moved: Array, position: Array) -> Array:
        """Return the motion of the fitted part at positions, due to the touched points. Shape (n, 3, p). [m]

        moved: motion of the touched points by each of p causes, (k, 3, p) [m]; position: base axes, (n, 3) [m].
        """
        return self._carry(linear_displacement(self.shown) @ moved.reshape(3 * len(moved), moved.shape[2]), position)

    def _carry(self, twist: Array, position: Array) -> Array:
        lever = position - self.shown.mean(axis=0)
        return np.asarray(twist[:3] + np.cross(twist[3:].T[None], lever[:, None]).transpose(0, 2, 1))

    def see_position(self, position: Array) -> Array:
        """Return positions of the arm relative to the found frame, base axes. Shape (n, 3). [m]."""
        return position if self.displacement is None else see_position(position, self.displacement)

    def see_rotation(self, rotation: Array) -> Array:
        """Return orientations relative to the found frame, base axes. Shape (n, 3, 3)."""
        return rotation if self.displacement is None else see_rotation(rotation, self.displacement)

    def see_jacobian(self, jacobian: Array) -> Array:
        """Return twists relative to the found frame, base axes, linear rows first. Shape (n, 6, nq)."""
        if self.displacement is None:
            return jacobian
        turn = self.displacement[:3, :3].T
        return np.concatenate([turn @ jacobian[:, :3], turn @ jacobian[:, 3:]], axis=1)


def states_placement(noise: NoiseTable) -> bool:
    """Return whether [noise] states how accurately the part is placed."""
    return bool({"part_frame_mm", "part_frame_deg"} & noise.model_fields_set)


def spread_placement(noise: NoiseTable, touched: TouchedPart | None, position: Array, origin: Array) -> Array:
    """Return the motion of the part by one deviation of its placement. Shape (n, 3, 6). [m]

    The placement is that stated in [noise], otherwise that of the touched part, otherwise the default of [noise].

    Args:
        noise: [noise] of the job.
        touched: The touched part, None for an absolute frame.
        position: Nominal tip. Shape (n, 3). [m]
        origin: Origin of the part frame. Shape (3,). [m]
    """
    if touched is not None and not states_placement(noise):
        return touched.spread_part(position)
    width = noise.part_frame_mm * 1e-3, float(np.radians(noise.part_frame_deg))
    return np.asarray(rigid_columns(position, origin) * np.repeat(width, 3))


def describe_placement(noise: NoiseTable, touched: TouchedPart | None) -> list[str]:
    """Describe the assumed standard deviations of an absolute part frame; none if touched or stated in [noise]."""
    if touched is not None or states_placement(noise):
        return []
    widths = f"{noise.part_frame_mm:g} mm and {noise.part_frame_deg:g} deg per axis"
    return [f"assumed standard deviations of the absolute part frame: {widths} ([noise] part_frame_mm, part_frame_deg)"]


def read_touch(job: Job) -> TouchOff:
    """Return the touch-off of a job: at the points of [part], or at three corners of the box of its cut."""
    return TouchOff(job.T_base_part, job.part.touched_points)


def touch_part(robot: Robot, path: Toolpath, rotation: Array, q: Array, touch: TouchOff) -> TouchedPart:
    """Compute the touched part by the robot model; path in the base frame, with its tool rotations and joint positions.

    The tool orientation at each touched point is that of the nearest waypoint of the cut; an unreachable point is
    replaced by that waypoint.
    """
    cut = np.flatnonzero(~path.rapid)
    turn, origin = touch.frame[:3, :3], touch.frame[:3, 3]
    points = pick_corners((path.position[cut] - origin) @ turn) if touch.points is None else touch.points
    points = points @ turn.T + origin
    row = cut[np.linalg.norm(path.position[cut] - points[:, None], axis=2).argmin(axis=1)]
    believed = controller_robot(robot)
    points, found = _reach_points(believed, points, path.position[row], rotation[row], q[row])
    return TouchedPart(robot, found, points, _find_displacement(robot, believed, found))


def pick_corners(points: Array) -> Array:
    """Return three corners of the box of points: least x, y, greatest z, along its two longest sides. (3, 3) [m]"""
    low, high = points.min(axis=0), points.max(axis=0)
    first, other = np.array([low[0], low[1], high[2]]), np.array([high[0], high[1], low[2]])
    corners = np.tile(first, (3, 1))
    for k, axis in enumerate(np.argsort(low - high, kind="stable")[:2].tolist()):
        corners[k + 1, axis] = other[axis]
    return corners


def _reach_points(believed: Robot, points: Array, position: Array, rotation: Array, near: Array) -> tuple[Array, Array]:
    """Return reachable points, and the joint positions at which the controller displays them."""
    arm = build_arm(believed)
    there = refine_ik(arm, near, position, rotation, iterations=30) if len(arm.arm) == 6 else near
    q = refine_ik(arm, there, points, rotation, iterations=30) if len(arm.arm) == 6 else near
    missed = np.abs(pose_error(arm.chain, q, points, rotation)).max(axis=1) > REACHED
    missed |= ((q < believed.lower) | (q > believed.upper)).any(axis=1)
    q = np.where(missed[:, None], there, q)
    return locate_frames(arm.chain, q).tcp_position, q


def _find_displacement(robot: Robot, believed: Robot, q: Array) -> Array | None:
    bends = bool(robot.springs or robot.link_elasticities) and robot.loading_gravity is not None
    if not bends and not robot.effects and believed is robot:
        return None
    shown = locate_frames(build_chain(believed), q).tcp_position
    return fit_displacement(shown, locate_touching(robot, q))


def locate_touching(robot: Robot, q: Array) -> Array:
    """Return the loaded tip at rest and without process force. Shape (k, 3). [m]."""
    still, robot = np.zeros((len(q), 6)), rest_robot(robot)
    if robot.effects:
        return attain_with_effects(robot, q, still, np.ones(len(q) - 1))[0]
    return locate_loaded(build_chain(robot), q, still, tolerance=1e-12)[0]


def build_touch_model(touched: TouchedPart) -> ForwardModel:
    """Build the forward model of the robot at the touched points, at rest and without process force."""
    return build_path_model(rest_robot(touched.robot), touched.q, np.zeros((len(touched.q), 6)))


def is_lasting(unknowns: Sequence[Unknown]) -> Array:
    """Return 1 for every parameter that acts at the touched points, 0 for those of transient effects. Shape (p,)."""
    lasting = [float(unknown.effect not in TRANSIENT) for unknown in unknowns]
    return np.repeat(lasting, [len(unknown.keys) for unknown in unknowns])


def subtract_touch(model: Array, position: Array, touched: TouchedPart | None, unknowns: Sequence[Unknown]) -> Array:
    """Return motions of the tip, (k, 3, p), relative to the part that moves with the touched points. [m per SI unit]

    position: of the tip, (k, 3) [m]; without a touched part the motions are unchanged.
    """
    if touched is None or not model.shape[2]:
        return model
    at = measure_slopes(build_touch_model(touched), unknowns, np.arange(len(touched.q)))
    return np.asarray(model - touched.follow(at * is_lasting(unknowns), position))
