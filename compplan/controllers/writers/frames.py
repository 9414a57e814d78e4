"""Frames of robot programs, and the orientation angles of each controller."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.controllers.writers.joint_convention import locate_pendant
from compplan.io.tables import Array
from compplan.robot import Robot


def euler_angles(rotation: Array, order: str) -> Array:
    """Return Euler angles in scipy's notation: capitals are intrinsic axes, small letters extrinsic ones. [deg]

    "ZYX" are A B C of KUKA, "XYZ" rx ry rz of VAL3, "xyz" W P R of FANUC and Rx Ry Rz of Yaskawa, "ZYZ" O A T of
    Kawasaki. Where the angles are not unique, the last one is 0. Shape (n, 3, 3) -> (n, 3).
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(Rotation.from_matrix(rotation).as_euler(order, degrees=True)) + 0.0


def place_numbers(pose: Array, order: str, digits: int = 7) -> list[float]:
    """Return a pose as x, y, z and three Euler angles, rounded. Shape (4, 4) [m] -> 6 numbers [mm, deg]."""
    return list(map(float, place_table(pose[None], order, digits)[0]))


def place_table(poses: Array, order: str, digits: int = 6) -> Array:
    """Return poses as x, y, z and three Euler angles, rounded. Shape (n, 4, 4) [m] -> (n, 6) [mm, deg]."""
    table = np.column_stack([poses[:, :3, 3] * 1e3, euler_angles(poses[:, :3, :3], order)])
    return np.asarray(np.round(table, digits) + 0.0, np.float64)


def quaternions(poses: Array) -> Array:
    """Return rotations as quaternions, real part first and not negative. Shape (n, 4, 4) -> (n, 4)."""
    x, y, z, w = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True).T
    return np.column_stack([w, x, y, z])


def rotation_vectors(poses: Array) -> Array:
    """Return rotations as axis times angle. Shape (n, 4, 4) -> (n, 3) [rad]."""
    return np.asarray(Rotation.from_matrix(poses[:, :3, :3]).as_rotvec())


def flange_turn(robot: Robot) -> Array:
    """Return the pose of the controller's flange frame in the robot's flange frame. Shape (4, 4) [m].

    Controllers define tools in a flange frame with z out of the flange: that of [pendant] in controller.toml, otherwise
    a frame tool0 of the URDF at the origin of the flange (ROS-Industrial), otherwise the flange itself.
    """
    found = locate_pendant(robot)
    return np.eye(4) if found is None else found.pose


def compute_tool_mass(robot: Robot) -> tuple[float | None, Array]:
    """Return mass [kg] and centre [m] of the bodies on the flange, flange frame; None where no mass is stated."""
    bodies = robot.bodies_on_flange()
    mass, moment = sum(body.mass for body in bodies), sum((body.mass * body.centre for body in bodies), np.zeros(3))
    return (mass, moment / mass) if mass > 0.0 else (None, moment)
