"""Conventions of a robot's controller: joints, configuration words, geometry, and flange frame of its tools."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from compplan.controllers.writers.motion_table import ASSUMED, MotionTable, ServoMotion, read_motion
from compplan.errors import InputError, ShapeError, UnknownNameError
from compplan.io.tables import Array, read_text
from compplan.io.tomlfile import (
    Numbers,
    SchemaOne,
    StrictTable,
    Vector3,
    check_table,
    parse_toml,
    refuse_other_types,
)
from compplan.robot import Robot
from compplan.robot.folder import has_moved
from compplan.robot.pose import apply_twist, build_pose, follow_joints
from compplan.robot.urdf import read_urdf

#: Valid name of a joint, and valid zero [deg or mm].
JointName = Annotated[str, Field(pattern=r"^[ -~]{0,31}[!-~]$")]
Zero = Annotated[float, Field(ge=-1e5, le=1e5)]
#: Reasons why signs and zeros are not known.
NO_FILE = "the robot folder has no controller.toml, those of the URDF are used"
NOT_CHECKED = "controller.toml says checked = false"
#: Greatest departure from unit length and from a right angle that counts as rounding.
ROUNDING = 1e-6
#: A frame tool0 farther from the flange is a tool, not the flange. [m]
SAME_PLACE = 1e-9


class ConfigurationWord(StrictTable):
    """One configuration word: it has one value at or above a threshold, and another below it.

    The number is a joint position minus the threshold, between -180 and 180 deg, or a coordinate of the origin of link
    `point` in the frame of link `frame`. `status` is the contribution of each value to S of a KRL position, `native`
    the value in the controller's language.
    """

    joint: str | None = None
    threshold_deg: float = 0.0
    point: str | None = None
    frame: str | None = None
    axis: Literal["x", "y", "z"] = "x"
    threshold_mm: float = 0.0
    above: str
    below: str
    status: dict[str, int] = Field(default_factory=dict)
    native: dict[str, str] = Field(default_factory=dict)


class WorldTable(StrictTable):
    """[world]: reference frame of the controller's frames, in the URDF's base frame."""

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    rotation_deg: Vector3 = (0.0, 0.0, 0.0)


class PendantTable(StrictTable):
    """[pendant] of controller.toml: the maker's flange frame (tool 0, all zero), axes of the URDF's flange frame.

    x, z: directions of its x and z axes.
    confirmed: whether a public source confirms the pendant's frame itself, x included.
    source: origin of the data.
    """

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    x: Vector3
    z: Vector3
    confirmed: bool = False
    source: str = ""

    @model_validator(mode="after")
    def _check_axes(self) -> PendantTable:
        for name, axis in (("x", self.x), ("z", self.z)):
            if abs(np.linalg.norm(axis) - 1.0) > ROUNDING:
                raise ValueError(f"has {name} = {list(axis)} of length {np.linalg.norm(axis):.6g}, expected 1")
        if abs(np.dot(self.x, self.z)) > ROUNDING:
            raise ValueError(f"has x = {list(self.x)} and z = {list(self.z)}, expected a right angle between them")
        return self


class ControllerTable(StrictTable):
    """controller.toml of a robot folder."""

    schema_: SchemaOne = Field(alias="schema")
    controller: str = ""
    joint_names: Annotated[tuple[JointName, ...], Field(strict=False)] | None = None
    sign: Annotated[tuple[Annotated[Literal[-1, 1], BeforeValidator(refuse_other_types)], ...], Field(strict=False)]
    zero_deg: Annotated[tuple[Zero, ...], Field(strict=False)]
    coupling: Annotated[tuple[Numbers, ...], Field(strict=False)] | None = None
    world: WorldTable = WorldTable.model_construct()
    pendant: PendantTable | None = None
    motion: MotionTable | None = None
    checked: bool = True
    configuration: dict[str, ConfigurationWord] = Field(default_factory=dict)


@dataclass(frozen=True)
class JointConvention:
    """Joint convention of a controller: controller = sign q + zero + coupling q, in deg and mm."""

    name: str  #: Name of the controller.
    joint_names: tuple[str, ...]  #: The controller's names of the joints, from the base.
    prismatic: NDArray[np.bool_]  #: Which joints slide. Shape (nq,).
    matrix: Array  #: Sum of sign (diagonal) and coupling. Shape (nq, nq).
    zero: Array  #: Controller's joint positions at q = 0. Shape (nq,). [deg or mm]
    words: Mapping[str, ConfigurationWord]  #: Configuration words by name.
    #: Pose of the reference frame of the controller's frames, in the URDF's base frame. Shape (4, 4). [m]
    world: Array = field(default_factory=lambda: np.eye(4))
    unchecked: str = ""  #: Reason why signs and zeros are not known; "" with a checked controller.toml.


def _read_table(robot: Robot) -> tuple[ControllerTable | None, Path]:
    """Read controller.toml of the robot's folder, None if it does not exist, and return its path as well."""
    file = (robot.folder or Path()) / "controller.toml"
    there = robot.folder is not None and file.exists()
    return _parse_table(read_text(file), file) if there else None, file


@lru_cache(maxsize=8)  # a command reads the same text many times
def _parse_table(text: str, file: Path) -> ControllerTable:
    return check_table(ControllerTable, parse_toml(text, file), file=file)


def load_controller(robot: Robot) -> JointConvention:
    """Read controller.toml of the robot's folder; without the file the controller has the conventions of the URDF.

    Raises:
        InputError: If the file is not valid or does not fit the robot.
    """
    nq, (table, file) = robot.nq, _read_table(robot)
    plain = tuple(f"J{number}" for number in range(1, nq + 1))
    if table is None:
        return JointConvention("", plain, robot.prismatic, np.eye(nq), np.zeros(nq), {}, unchecked=NO_FILE)
    names = table.joint_names or plain
    for key, length, what in (("sign", len(table.sign), "numbers"), ("zero_deg", len(table.zero_deg), "numbers"),
                              ("joint_names", len(names), "names")):  # fmt: skip
        if length != nq:
            raise InputError(f"has {length} {what}, expected {nq}, one per joint", file=file, where=key)
    if len(set(names)) < nq:
        raise InputError(f"is {list(names)}, expected {nq} different names", file=file, where="joint_names")
    coupling = table.coupling or ((0.0,) * nq,) * nq
    if [len(row) for row in coupling] != [nq] * nq:
        raise InputError(f"expected {nq} rows of {nq} numbers", file=file, where="coupling")
    matrix = np.diag(np.array(table.sign, float)) + np.array(coupling)
    if abs(np.linalg.det(matrix)) < 1e-9:
        raise InputError("sign and coupling give a singular matrix; correct one of them", file=file, where="coupling")
    links = [robot.base, *(joint.child for joint in robot.joints)]
    for key, word in table.configuration.items():
        where = f"configuration.{key}"
        if word.joint is not None and word.joint not in robot.joint_names:
            raise UnknownNameError("joint", word.joint, list(robot.joint_names), file=file, where=where)
        if word.joint is None and not {word.point, word.frame} <= set(links):
            raise InputError(f"needs a joint, or a point and a frame from {links}", file=file, where=where)
    world = apply_twist(np.r_[np.array(table.world.position_mm) * 1e-3, np.radians(table.world.rotation_deg)])
    zero, words = np.array(table.zero_deg, float), table.configuration
    unchecked = "" if table.checked else NOT_CHECKED
    return JointConvention(table.controller, tuple(names), robot.prismatic, matrix, zero, words, world, unchecked)


def load_motion(robot: Robot) -> tuple[ServoMotion, list[str]]:
    """Read the motion model of the robot's controller ([motion] of controller.toml), and list its assumed values.

    Raises:
        InputError: If the file is not valid or does not fit the robot.
    """
    load_controller(robot)
    table, file = _read_table(robot)
    motion, limits = None if table is None else table.motion, (robot.velocity_limits, robot.acceleration_limits)
    stated = set() if motion is None or motion.source == ASSUMED else motion.model_fields_set
    assumed = [name for name in MotionTable.model_fields if name not in {*stated, "source"}]
    return read_motion(motion, robot.prismatic, limits, file), assumed


def to_controller(controller: JointConvention, q: Array) -> Array:
    """Convert joint positions to the controller's convention. Shape (n, nq). [rad or m] -> [deg or mm]."""
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != len(controller.zero):
        raise ShapeError(f"q has shape {q.shape}, expected (n, {len(controller.zero)})")
    return np.where(controller.prismatic, q * 1e3, np.degrees(q)) @ controller.matrix.T + controller.zero


def from_controller(controller: JointConvention, joints: Array) -> Array:
    """Convert joint positions from the controller's convention. Shape (n, nq). [deg or mm] -> [rad or m]."""
    counted = np.asarray(joints, dtype=np.float64) - controller.zero
    degrees = np.linalg.solve(controller.matrix, counted.T).T
    return np.where(controller.prismatic, degrees * 1e-3, np.radians(degrees))


def locate_links(robot: Robot, q: Array) -> dict[str, Array]:
    """Return the poses of the frames of all links, unloaded, base frame. Shape (n, nq) -> (n, 4, 4) [m]."""
    poses = follow_joints(robot.base, robot.joints, dict(zip(robot.joint_names, q.T, strict=True)))
    return {link: np.broadcast_to(pose, (len(q), 4, 4)) for link, pose in poses.items()}


def find_bend(robot: Robot, poses: Mapping[str, Array]) -> NDArray[np.bool_] | None:
    """Return the sign of the wrist bend of a six-axis arm; it changes where fourth and last axis are in line.

    It is the sign of a5 . (a4 x a6), with the unit vectors of the last three axes. None for other arms. Shape (n,).
    poses: those of `locate_links`.
    """
    turning = [joint for joint in robot.joints[robot.carrying :] if joint.actuated and joint.kind != "prismatic"]
    if len(turning) != 6:
        return None
    fourth, fifth, sixth = (poses[joint.child][:, :3, :3] @ joint.axis for joint in turning[3:])
    return np.asarray(np.einsum("ni,ni->n", fifth, np.cross(fourth, sixth)) >= 0.0)


def measure_words(
    controller: JointConvention, robot: Robot, q: Array, poses: Mapping[str, Array]
) -> dict[str, tuple[NDArray[np.str_], Array]]:
    """Return the value of each configuration word, and its distance from the threshold [deg or mm]. Shapes (n,) each.

    The values are names: {"elbow": (["up", ...], [12.3, ...]), ...}. q: joint positions, shape (n, nq) [rad or m];
    poses: those of `locate_links`.
    """
    found: dict[str, tuple[NDArray[np.str_], Array]] = {}
    for key, word in controller.words.items():
        if word.joint is not None:
            turned = (np.degrees(q[:, robot.joint_names.index(word.joint)]) - word.threshold_deg + 180.0) % 360.0
            above, distance = turned >= 180.0, 90.0 - np.abs(np.abs(turned - 180.0) - 90.0)
        else:
            frame, point = poses[word.frame or ""], poses[word.point or ""]
            point_in_frame = np.einsum("nji,nj->ni", frame[:, :3, :3], point[:, :3, 3] - frame[:, :3, 3])
            place = point_in_frame[:, "xyz".index(word.axis)] * 1e3
            above, distance = place >= word.threshold_mm, np.abs(place - word.threshold_mm)
        found[key] = np.where(above, word.above, word.below), distance
    return found


def native_words(counting: JointConvention, words: Mapping[str, NDArray[np.str_]]) -> dict[str, NDArray[np.str_]]:
    """Return configurations in the controller's words, where controller.toml translates them. Shape (n,) each."""
    translated = {}
    for key, values in words.items():
        native = counting.words[key].native
        if {*values.tolist()} <= set(native):
            translated[key] = np.array([native[value] for value in values.tolist()])
    return translated


def krl_status(counting: JointConvention, words: Mapping[str, NDArray[np.str_]]) -> NDArray[np.int64] | None:
    """Return S of KRL positions, or None where controller.toml does not define it. Shape (n,)."""
    status = [(counting.words[key].status, values.tolist()) for key, values in words.items()]
    if not status or not all(adds for adds, _ in status):
        return None
    return np.sum([[adds.get(value, 0) for value in values] for adds, values in status], axis=0, dtype=np.int64)


def controller_robot(robot: Robot) -> Robot:
    """Return the robot with the kinematic model of its controller.

    That is controller.urdf of its folder if the file exists, otherwise the geometry of its URDF, without changes that
    were learned since.

    Raises:
        InputError: If controller.urdf is not a URDF or lacks a joint of the chain.
    """
    file, text = Path("robot.urdf"), robot.urdf
    if robot.folder is not None and (robot.folder / "controller.urdf").exists():
        file = robot.folder / "controller.urdf"
        text = read_text(file)
    elif not has_moved(robot, robot):
        return robot
    believed = {joint.name: joint for joint in read_urdf(text, file).joints}
    own = {element.get("name") for element in ElementTree.fromstring(robot.urdf).findall("joint")}
    joints = list(robot.joints[: robot.carrying])
    for joint in robot.joints[robot.carrying :]:
        other = believed.get(joint.name)
        if other is None and joint.name in own and joint.name != "tool_joint":
            raise InputError(f"no joint named {joint.name!r}, expected the joints of robot.urdf", file=file)
        joints.append(joint if other is None else replace(joint, placement=other.placement, axis=other.axis))
    return replace(robot, joints=tuple(joints))


@dataclass(frozen=True)
class Pendant:
    """The maker's flange frame."""

    pose: Array  #: Its pose in the URDF's flange frame. Shape (4, 4). [m]
    source: str  #: Origin of the data.
    confirmed: bool  #: Whether the source confirms the pendant's frame itself.
    stated: bool  #: Whether it is from controller.toml; otherwise it is tool0 of the URDF.


def locate_pendant(robot: Robot) -> Pendant | None:
    """Return the maker's flange frame of a robot: from controller.toml, otherwise tool0 of a ROS-Industrial URDF.

    Raises:
        InputError: If controller.toml is not valid.
    """
    table, _ = _read_table(robot)
    if table is not None and table.pendant is not None:
        stated = table.pendant
        axes = np.column_stack([stated.x, np.cross(stated.z, stated.x), stated.z])
        pose = build_pose(np.asarray(stated.position_mm) * 1e-3, axes)
        return Pendant(pose, stated.source, stated.confirmed, stated=True)
    turn = _find_tool0(robot)
    source = "tool0 of the URDF, the all-zero tool in descriptions of ROS-Industrial"
    return None if turn is None else Pendant(turn, source, confirmed=False, stated=False)


def _find_tool0(robot: Robot) -> Array | None:
    """Return the pose of a frame tool0 at the origin of the flange, in the flange frame, or None. Shape (4, 4)."""
    urdf = read_urdf(robot.urdf, Path("robot.urdf") if robot.folder is None else robot.folder / "robot.urdf")
    if not {"tool0", robot.flange} <= set(urdf.links):
        return None
    try:
        chains = [urdf.chain_to(link)[0] for link in (robot.flange, "tool0")]
    except InputError:
        return None
    flange, tool = (follow_joints(chain[0].parent, chain, {})[chain[-1].child] for chain in chains)
    turn = np.linalg.inv(flange) @ tool
    moving = [[joint.name for joint in chain if joint.kind != "fixed"] for chain in chains]
    if moving[0] != moving[1] or np.abs(turn[:3, 3]).max() > SAME_PLACE:
        return None
    return build_pose(np.zeros(3), turn[:3, :3])
