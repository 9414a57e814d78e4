"""Motion instructions of a program, one for each row."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.writers.zones import FASTEST
from compplan.io.columns import FileColumn
from compplan.io.tables import Array, Table, read_table
from compplan.robot import Robot

#: Greatest valid zone. [m]
WIDEST = 2.0

COLUMNS = (
    FileColumn("move", "text", required=True),
    FileColumn("x", "length", missing=True, group="pose"),
    FileColumn("y", "length", missing=True, group="pose"),
    FileColumn("z", "length", missing=True, group="pose"),
    FileColumn("i", missing=True, group="axis"),
    FileColumn("j", missing=True, group="axis"),
    FileColumn("k", missing=True, group="axis"),
    FileColumn("q#", ("angle", "length"), missing=True),
    FileColumn("feed", "speed", required=True),
    FileColumn("zone", "length"),
)


@dataclass(frozen=True)
class Instructions:
    """Motion instructions of a program; the robot starts at the end of the first one."""

    file: Path  #: File of the program.
    lines: NDArray[np.int64]  #: Line of each in the file. Shape (n,).
    straight: NDArray[np.bool_]  #: Whether the tip moves along a line; otherwise a joint move. Shape (n,).
    position: Array  #: Tip at the end of each, base frame; NaN where joints are given. Shape (n, 3). [m]
    axis: Array  #: Tool axis there, tip to spindle; NaN where joints are given. Shape (n, 3).
    q: Array  #: Joints there; NaN for a row with only a pose. Shape (n, nq). [rad or m]
    feed: Array  #: Speed of the tip during the move. Shape (n,). [m/s]
    #: Distance from the end at which the controller may leave for the next one; 0: exact stop. Shape (n,). [m]
    zone: Array

    def __len__(self) -> int:
        return len(self.feed)


def read_instructions(file: Path, robot: Robot) -> Instructions:
    """Read PROGRAM.csv.

    Raises:
        InputError: With file and line, if a row is not a valid instruction for this robot.
    """
    table = read_table(file, COLUMNS)
    n, nq = len(table), robot.nq
    if n < 2:
        raise table.error(f"has {n} rows, expected at least 2: the start position and a move")
    joints = read_joints(table, robot, "q#")
    position = table.stack(["x", "y", "z"]) if "x" in table else np.full((n, 3), np.nan)
    axis = table.stack(["i", "j", "k"]) if "i" in table else np.tile([0.0, 0.0, 1.0], (n, 1))
    axis = _check_ends(table, joints, position, axis)
    words = table.text["move"]
    for row in np.flatnonzero(~np.isin(words, ("joint", "line")))[:1]:
        raise table.error(f"move is {str(words[row])!r}, expected joint or line", int(row))
    zone = table.values["zone"] if "zone" in table else np.zeros(n)
    feed = table.values["feed"]
    for name, values, low, high, unit in (("feed_mm_s", feed, 1e-9, FASTEST, "mm/s"), ("zone_mm", zone, 0.0, WIDEST,
                                                                                      "mm")):  # fmt: skip
        for row in np.flatnonzero((values < low) | (values > high))[:1]:
            span = f"0 to {1e3 * high:g} {unit}"
            raise table.error(f"{name} is {1e3 * values[row]:g} {unit}, expected {span}", int(row))
    _check_limits(table, joints, robot)
    return Instructions(file, table.lines, words == "line", position, axis, joints.reshape(n, nq), feed, zone)


def read_joints(table: Table, robot: Robot, name: str) -> Array:
    """Return numbered joint columns of a table; NaN without such columns. Shape (n, nq). [rad or m]

    Raises:
        InputError: If their number or their units do not match the robot.
    """
    keys = table.numbered(name)
    if not keys:
        return np.full((len(table), robot.nq), np.nan)
    if len(keys) != robot.nq:
        raise table.error(f"has {len(keys)} columns {name.replace('#', '1')} .., the robot has {robot.nq} joints")
    for key, slides in zip(keys, robot.prismatic, strict=True):
        if (table.units[key] in ("m", "mm", "um")) != bool(slides):
            raise table.error(f"column '{table.headers[key]}' of a joint that {'slides' if slides else 'turns'}, "
                              f"expected {'mm' if slides else 'deg'}")  # fmt: skip
    return table.stack(keys)


def mark_whole(values: Array) -> NDArray[np.bool_]:
    """Return which rows are complete. Shape (n, k) -> (n,)."""
    return np.asarray(np.isfinite(values).all(axis=1))


def _check_ends(table: Table, joints: Array, position: Array, axis: Array) -> Array:
    """Refuse a row without a complete pose or complete joints; return unit tool axes."""
    posed, partly = mark_whole(position), np.asarray(np.isfinite(position).any(axis=1))
    bent, partly_bent = mark_whole(joints), np.asarray(np.isfinite(joints).any(axis=1))
    for row in np.flatnonzero(~(posed | bent) | (partly & ~posed) | (partly_bent & ~bent))[:1]:
        raise table.error("needs all of x_mm y_mm z_mm or all of q1_deg .. of its end", int(row))
    left_out: NDArray[np.bool_] = np.asarray(np.isnan(axis).all(axis=1)) & posed
    axis = np.where(left_out[:, None], [0.0, 0.0, 1.0], axis)
    size = np.linalg.norm(axis, axis=1)
    for row in np.flatnonzero(posed & ~(np.abs(size - 1.0) < 1e-2))[:1]:
        raise table.error(f"tool axis i j k has the length {size[row]:.4g}, expected 1", int(row))
    return np.asarray(np.where(posed[:, None], axis / np.where(size > 0, size, 1.0)[:, None], np.nan))


def _check_limits(table: Table, joints: Array, robot: Robot) -> None:
    beyond = (joints < robot.lower - 1e-6) | (joints > robot.upper + 1e-6)
    for row, joint in np.argwhere(beyond)[:1]:
        unit, size = ("mm", 1e3) if robot.prismatic[joint] else ("deg", 180.0 / np.pi)
        low, high = robot.lower[joint] * size, robot.upper[joint] * size
        raise table.error(f"joint {robot.joint_names[joint]!r} is at {joints[row, joint] * size:.6g} {unit}, "
                          f"limits [{low:.6g}, {high:.6g}]", int(row))  # fmt: skip
