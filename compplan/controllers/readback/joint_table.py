"""Compare joints.csv with the commanded arm; joints and limits of the robot folder are read a second time."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from compplan.io.parsing import guard_parser, parse_xml
from compplan.io.tables import read_text
from compplan.io.tomlfile import read_toml
from compplan.robot import Array

#: Columns of joints.csv beside time and joints.
WANTED = ("x_mm", "y_mm", "z_mm", "i", "j", "k", "fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Rounding that joints.csv leaves. [deg or mm]
TABLE = 1e-6


@dataclass(frozen=True)
class Commanded:
    """What was planned, row by row of what is delivered: the way there, the path, the way back."""

    q: Array  #: Commanded joint positions. Shape (n, nq). [rad or m]
    time: Array  #: Shape (n,). [s]
    wanted: Array  #: Wanted tip [mm], tool axis, wrench on the tool [N, N m], base frame. Shape (n, 12).
    program: Array  #: Rows that programs hold; Shape (m,).
    feed: Array  #: Feed that is driven in the move to each row, 0 in rapid moves. Shape (n,). [m/s]
    #: Whether the tool has to stand still at each row that programs hold, beside the ends of rapid moves. Shape (m,).
    stands: NDArray[np.bool_]
    may_stop: NDArray[np.bool_]  #: Where programs may stop exactly instead of leaving the path in a zone. Shape (m,).
    #: Whether the speed of the move to each row that programs hold is of no account. Shape (m,).
    free: NDArray[np.bool_]
    table: NDArray[np.bool_]  #: Rows that joints.csv holds. Shape (n,).
    sent: Array  #: Joint positions that programs hold: q, or what leads by the lag of drives. Shape (n, nq). [rad or m]
    asked: Array  #: Feed that the CAM file asks for in the move to each row that programs hold. Shape (m,). [mm/s]
    beside: Array  #: How far zones may lead beside a corner. Shape (m,). [m]
    #: From a row that programs hold to the corner that moves of the tool state in its place, nan at rows of a rounded
    #: corner that they leave out, 0 elsewhere. Shape (m, 3). [m]
    corner: Array
    #: How far rows may lie beside moves of the tool that stand for them. [mm]
    fit: float

    def take(self, kept: NDArray[np.int_]) -> Commanded:
        """Return what was planned where programs hold some of their rows alone."""
        some = {
            name: getattr(self, name)[kept]
            for name in ("program", "stands", "may_stop", "free", "asked", "beside", "corner")
        }
        return replace(self, **some)


def check_posture_choice(wanted: Commanded, cycle: float) -> Iterator[str]:
    """Say where joints.csv leaves out a row that is no nearer than a cycle to one that it holds."""
    out, held = np.flatnonzero(~wanted.table), wanted.time[wanted.table]
    if not len(out):
        return
    after = np.clip(np.searchsorted(held, wanted.time[out]), 1, len(held) - 1)
    near = np.minimum(np.abs(wanted.time[out] - held[after - 1]), np.abs(held[after] - wanted.time[out]))
    if near.max() >= cycle:
        row, far = int(out[near.argmax()]), 1e3 * float(near.max())
        yield f"joints.csv leaves out row {row}, {far:.3g} ms from the rows around it, a cycle is {1e3 * cycle:g} ms"


def check_joint_table(file: Path, joints: JointTable, wanted: Commanded) -> Iterator[str]:
    """Say where joints.csv is not what was planned."""
    with file.open(encoding="utf-8", newline="") as stream:
        head = next(csv.reader(stream))
    axes = (f"q{k + 1}_{'mm' if slides else 'deg'}" for k, slides in enumerate(joints.slides))
    names = ["time_s", *axes, *WANTED]
    missing = [name for name in names if name not in head]
    if missing:
        yield f"joints.csv has no column {missing[0]}"
        return
    at = [head.index(name) for name in names]
    with guard_parser(file, "is not a table"):
        table = np.loadtxt(file, delimiter=",", skiprows=1, usecols=at, ndmin=2, encoding="utf-8")
    if len(table) != wanted.table.sum():
        yield f"joints.csv has {len(table)} rows, planned are {wanted.table.sum()}"
        return
    nq = len(joints.slides)
    off = np.abs(table[:, 1 : nq + 1] - to_degrees(wanted.q[wanted.table], joints)).max()
    if off > TABLE:
        yield f"joints.csv: a joint is {off:.4g} deg or mm off"
    if (late := np.abs(table[:, 0] - wanted.time[wanted.table]).max()) > 1e-6:
        yield f"joints.csv: time is {late:.4g} s off"
    away = np.abs(table[:, nq + 1 :] - wanted.wanted[wanted.table])
    for what, unit, columns in (("wanted tip", " mm", away[:, :3]), ("tool axis", "", away[:, 3:6]),
                                ("wrench", " N or N m", away[:, 6:])):  # fmt: skip
        if columns.max() > TABLE:
            yield f"joints.csv: the {what} is {columns.max():.4g}{unit} off"


def to_degrees(q: Array, joints: JointTable) -> Array:
    """Return positions of joints as programs hold them, slides in mm. Shape as q. [deg or mm]"""
    return np.where(np.array(joints.slides), 1e3 * q, np.degrees(q))


@dataclass(frozen=True)
class JointTable:
    """The joints that a controller commands, from the base out. SI units.

    Attributes:
        names: Names. nq of them.
        slides: Whether they are prismatic. Shape (nq,).
        outer: Whether they are external axes: those that slide, or carry the part. Shape (nq,).
        lower, upper, velocity, acceleration: Limits, infinite where none is stated. Shape (nq,).
    """

    names: tuple[str, ...]
    slides: tuple[bool, ...]
    outer: tuple[bool, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array


def read_joints(folder: Path) -> JointTable:
    """Read the joints of a robot folder."""
    table = read_toml(folder / "elasticity.toml")
    root = parse_xml(read_text(folder / "robot.urdf"), folder / "robot.urdf")
    carrier = {}
    for joint in root.findall("joint"):
        child = joint.find("child")
        carrier["" if child is None else child.get("link", "")] = joint
    carrying = _list_moving(carrier, str(table.get("part", "")))
    chain = [*carrying, *_list_moving(carrier, str(table["tcp"]))]
    limits = []
    for joint in chain:
        found, soft = joint.find("limit"), joint.find("safety_controller")
        stated, inner = ({} if tag is None else tag.attrib for tag in (found, soft))
        low = max(float(stated.get("lower", "0")), float(inner.get("soft_lower_limit", "-inf")))
        high = min(float(stated.get("upper", "0")), float(inner.get("soft_upper_limit", "inf")))
        bounds = (-math.inf, math.inf) if joint.get("type") == "continuous" else (low, high)
        limits.append((*bounds, float(stated.get("velocity", "0")) or math.inf))
    lower, upper, velocity = np.array(limits, dtype=float).T
    acceleration = np.array(table.get("acceleration_limits", [math.inf] * len(chain)), float)
    slides = tuple(joint.get("type") == "prismatic" for joint in chain)
    names = tuple(joint.get("name", "") for joint in chain)
    outer = tuple(slide or k < len(carrying) for k, slide in enumerate(slides))
    return JointTable(names, slides, outer, lower, upper, velocity, acceleration)


def _list_moving(carrier: Mapping[str, ElementTree.Element], link: str) -> list[ElementTree.Element]:
    """List the joints of their own motion from the root to a link."""
    chain: list[ElementTree.Element] = []
    while link in carrier:
        joint = carrier[link]
        if joint.get("type") != "fixed" and joint.find("mimic") is None:
            chain.append(joint)
        parent = joint.find("parent")
        link = "" if parent is None else parent.get("link", "")
    return chain[::-1]
