"""A robot program before it has a language: joint positions as the controller counts them, feeds and poses."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, ShapeError
from compplan.files.tables import Array
from compplan.program.counting import (
    believed_robot,
    krl_status,
    load_controller,
    locate_link,
    rates_to_controller,
    to_controller,
)
from compplan.robot import Robot


@dataclass(frozen=True)
class Program:
    """Hold a program; row i describes the move that ends at waypoint i.

    Args:
        name: Name; the languages shorten it to what they allow.
        joints: Commanded joint positions as the controller counts them. Shape (n, nq). [deg or mm]
        joint_names: The controller's names of the joints, from the base.
        prismatic: Which joints slide. Shape (nq,).
        feed: Feed; 0 for rapid moves. Shape (n,). [mm/s]
        rapid: Which moves are rapid. Shape (n,).
        time: Time at each waypoint, or None. Shape (n,). [s]
        rates: Greatest joint rates, or None. Shape (nq,). [deg/s or mm/s]
        tcp: Commanded TCP poses in the geometry that the controller believes, base frame, or None. [m]
            Shape (n, 4, 4).
        tool: Pose of the TCP frame seen from the controller's flange frame (z out of the flange), or None. [m]
            Shape (4, 4).
        status: S of KRL positions, or None. Shape (n,).
        robot: Name of the robot.
        controller: What controller it is.
        comments: Lines for the head of every file.

    """

    name: str
    joints: Array
    joint_names: tuple[str, ...]
    prismatic: NDArray[np.bool_]
    feed: Array
    rapid: NDArray[np.bool_]
    time: Array | None = None
    rates: Array | None = None
    tcp: Array | None = None
    tool: Array | None = None
    status: NDArray[np.int64] | None = None
    robot: str = ""
    controller: str = ""
    comments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, nq = self.joints.shape
        shapes = {"feed": (n,), "rapid": (n,), "time": (n,), "rates": (nq,), "tcp": (n, 4, 4), "status": (n,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and np.shape(array) != shape:
                raise ShapeError(f"program {name} has shape {np.shape(array)}, expected {shape}")
        if len(self.joint_names) != nq:
            raise ShapeError(f"program has {len(self.joint_names)} joint names, expected {nq}")

    def __len__(self) -> int:
        return len(self.joints)


def build_program(
    robot: Robot,
    q: Array,
    feed: Array,
    rapid: NDArray[np.bool_],
    *,
    name: str,
    time: Array | None = None,
    comments: Sequence[str] = (),
) -> Program:
    """Build a program from commanded joint positions: in the controller's counting, and with its geometry.

    Args:
        robot: The robot; its folder says how its controller counts.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        feed: Feed of the move that ends at each waypoint. Shape (n,). [m/s]
        rapid: Which moves are rapid. Shape (n,).
        name: Name of the program.
        time: Time at each waypoint, or None. Shape (n,). [s]
        comments: Lines for the head of every file.

    Raises:
        InputError: If controller.toml or controller.urdf of the robot's folder is not what it has to be.

    """
    controller, believed = load_controller(robot), believed_robot(robot)
    tip = locate_link(believed, q, robot.tcp)
    flange = locate_link(believed, q[:1], robot.flange) @ flange_turn(robot)
    limits = robot.velocity_limits
    return Program(
        name=name,
        joints=to_controller(controller, q),
        joint_names=controller.joint_names,
        prismatic=robot.prismatic,
        feed=np.where(rapid, 0.0, np.asarray(feed) * 1e3),
        rapid=np.asarray(rapid, dtype=bool),
        time=time,
        rates=rates_to_controller(controller, limits) if np.isfinite(limits).all() else None,
        tcp=tip,
        tool=np.linalg.inv(flange[0]) @ tip[0],
        status=krl_status(controller, robot, q),
        robot=robot.name,
        controller=controller.name,
        comments=tuple(comments),
    )


def short_name(text: str, longest: int) -> str:
    """Return a name that every controller takes: letters, digits and _, a letter first."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_") or "program"
    name = name if name[0].isalpha() else f"p_{name}"
    return name[:longest].rstrip("_")


def split_parts(count: int, most: int) -> list[slice]:
    """Return the rows of each file, none longer than `most`, all about equally long.

    Raises:
        InputError: If `most` is less than 1.

    """
    if most < 1:
        raise InputError(f"max_points_per_file is {most}, expected at least 1")
    parts = max(1, -(-count // most))
    edges = np.linspace(0, count, parts + 1).round().astype(int)
    return [slice(int(low), int(high)) for low, high in pairwise(edges)]


def head_lines(program: Program) -> list[str]:
    """Return what stands at the head of every file."""
    lines = [f"{program.name}: {len(program)} waypoints for {program.robot} {program.controller}".rstrip()]
    return [*lines, *program.comments]


def order_joints(program: Program, wanted: Sequence[str], language: str) -> list[int]:
    """Return the columns of joints that a language calls by these names.

    Raises:
        InputError: If the controller has no such joint.

    """
    missing = [name for name in wanted if name not in program.joint_names]
    if missing:
        own = list(program.joint_names)
        message = f"{language} programs need joints named {list(wanted)}, this controller has {own}"
        raise InputError(f"{message}; set joint_names in controller.toml")
    return [program.joint_names.index(name) for name in wanted]


def joint_percent(program: Program) -> Array:
    """Return the share of the joint rates that each move asks for, 1 to 100; rapid moves 100, unknown ones 10.

    The move from one waypoint to the next takes the time that `time` says, else distance over feed; the joint that asks
    for the greatest share of its rate decides. Shape (n,). [%]
    """
    percent = np.where(program.rapid, 100.0, 10.0)
    duration = None
    if program.time is not None:
        duration = np.diff(program.time)
    elif program.tcp is not None:
        distance = np.linalg.norm(np.diff(program.tcp[:, :3, 3], axis=0), axis=1) * 1e3
        duration = np.where(program.feed[1:] > 0.0, distance / np.maximum(program.feed[1:], 1e-9), np.nan)
    if duration is not None and program.rates is not None and len(program) > 1:
        share = np.max(np.abs(np.diff(program.joints, axis=0)) / program.rates, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = 100.0 * share / duration
        known = np.isfinite(wanted) & ~program.rapid[1:]
        percent[1:] = np.where(known, wanted, percent[1:])
    return np.clip(percent, 1.0, 100.0)


def euler_angles(rotation: Array, order: str) -> Array:
    """Return Euler angles about turning axes, "ZYX" (KUKA A B C) or "XYZ" (VAL3 rx ry rz).

    Where the angles are not unique, the last one is 0.

    Args:
        rotation: Rotations. Shape (n, 3, 3).
        order: Order of the axes, as scipy counts.

    Returns:
        Shape (n, 3). [deg]

    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(Rotation.from_matrix(rotation).as_euler(order, degrees=True)) + 0.0


def tool_place(program: Program, order: str) -> list[float]:
    """Return the tool as controllers take it: x, y, z and three Euler angles [mm, deg]."""
    tool = np.eye(4) if program.tool is None else program.tool
    angles = euler_angles(tool[None, :3, :3], order)[0]
    return [value + 0.0 for value in np.round(np.concatenate([tool[:3, 3] * 1e3, angles]), 5).tolist()]


def flange_turn(robot: Robot) -> Array:
    """Return the pose of the controller's flange frame seen from the robot's flange frame. Shape (4, 4) [m].

    Controllers count tools from a flange frame with z out of the flange. Where the URDF has a frame tool0 in the very
    place of the flange that only turns it, that is the one (ROS-Industrial); else the flange frame itself.
    """
    for joint in ElementTree.fromstring(robot.urdf).findall("joint"):
        parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
        if parent is None or child is None or joint.get("type") != "fixed":
            continue
        if (parent.get("link"), child.get("link")) == (robot.flange, "tool0"):
            place = {} if origin is None else origin.attrib
            if any(float(number) for number in place.get("xyz", "0 0 0").split()):
                break
            turn = np.eye(4)
            angles = [float(number) for number in place.get("rpy", "0 0 0").split()]
            turn[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
            return turn
    return np.eye(4)
