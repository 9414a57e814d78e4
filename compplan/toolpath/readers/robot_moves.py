"""The moves of a robot program as a toolpath: poses in a base frame, straight, circular and spline moves."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.toolpath.readers.arcs import Point, find_arc, sample_arcs
from compplan.toolpath.readers.cnc.flow import Flow
from compplan.toolpath.readers.lines import DECIMAL
from compplan.toolpath.readers.moves import HasLine, MoveLog
from compplan.toolpath.readers.options import CHORD_MM, CamTable, find_start

#: A number in a robot program, capitals.
NUMBER = rf"{DECIMAL}(?:E[-+]?\d+)?"
#: How deep programs may call one another.
DEEPEST = 20
#: Greatest turn of the tool between waypoints. [deg]
TURN_STEP = 1.0
#: Turns of the tool axis below this are none. [rad]
STEADY = 1e-6
#: Points on each span of a spline.
SPLINE_POINTS = 16


class RobotProgram:
    """Hold a robot program that is followed: its flow, blocks that are open and not carried out, its moves."""

    def __init__(self, file: Path, options: CamTable) -> None:
        self.options, self.flow = options, Flow(file, deepest=DEEPEST)
        self.moves = RobotMoves(options, self.flow)
        self.log, self.note = self.moves.log, self.moves.note
        self.blocks = 0

    def check_row(self, statement: str) -> None:
        """Refuse a move in a loop or a branch."""
        if self.blocks:
            raise InputError(f"{statement[:30]!r} stands in a loop or a branch; write the moves out in a row")

    def call(self, name: str, called: str) -> None:
        """Carry out a program by its name; refuse calls in a loop or a branch, or too deep."""
        if self.blocks or self.flow.depth >= DEEPEST:
            raise InputError(f"call of {called} in a loop, a branch or too deep; write the moves out")
        self.flow.run_program(name, self.flow.programs[name], 1)

    def ask(self, statement: str) -> None:
        """Let the operator do what no program of another language can repeat."""
        where = "in a loop or a branch: " if self.blocks else ""
        self.log.happen("call", self.flow.line, text=f"{where}{statement}")

    def switch(self, statement: str, *, output: tuple[str, bool] | None, wait: float | None, halts: bool,
               asked: bool) -> bool:  # fmt: skip
        """Carry out a statement that sets a signal, waits, stops or asks; return whether it is one."""
        if self.blocks and (output or wait is not None or asked or halts):
            self.ask(statement)
        elif output:
            self.log.happen("output", self.flow.line, value=float(output[1]), text=output[0])
        elif wait is not None:
            self.log.happen("dwell", self.flow.line, value=max(wait, 0.0))
        elif halts:
            self.log.happen("stop", self.flow.line)
        elif asked:
            self.ask(statement)
        return bool(output or wait is not None or halts or asked)


def split_fields(text: str, opening: str = "[(", closing: str = "])") -> list[str]:
    """Split at commas outside of brackets."""
    parts, depth, start = [], 0, 0
    for index, letter in enumerate(text):
        depth += (letter in opening) - (letter in closing)
        if letter == "," and depth == 0:
            parts.append(text[start:index])
            start = index + 1
    return [*parts, text[start:]]


class RobotMoves:
    """Collect the moves of a robot program. Millimetres; poses are 4x4, the tool's seen from the frame in force.

    The path stands in the frame that is in force at the first pose; `frame` is where the present one stands in it.
    """

    def __init__(self, options: CamTable, reader: HasLine) -> None:
        self.reader, self.log = reader, MoveLog(CHORD_MM, reader)
        self.frame = np.eye(4)
        self.pose: Array | None = None
        self.moved = False
        self.stated = options.from_mm
        self.direction = _direction(options.tool_direction or "z")
        self.assumed = options.tool_direction is None

    def note(self, message: str) -> None:
        """Note something that was assumed or read past, at the line that is read."""
        self.log.note(message, self.reader.line)

    def rapid(self, pose: Array) -> None:
        """Move rapidly to a pose: in joint space, where a program's path is not known."""
        self._note()
        self.pose = self.frame @ pose
        self.log.rapid(_point(self.pose), self._axis(self.pose))

    def change_frame(self, before: Array | None, after: Array | None, change: str) -> None:
        """Put another frame in force, whose place and that of the one before have to be known."""
        if before is None or after is None:
            raise InputError(f"{change}, and their places are not both known")
        self.frame = self.frame @ np.linalg.inv(before) @ after

    def lose(self) -> None:
        """Forget the pose, where a joint move ends."""
        self.pose, self.moved = None, True

    def lose_joint_move(self) -> None:
        """Leave out a move to joint positions: where it takes the tip is not known."""
        self.note("joint moves to axis values are left out: where they take the tip is not known")
        self.lose()

    def note_tool(self) -> None:
        """Note that another tool is taken."""
        self.note("the tool changes on the way: the path is that of the tip of each")

    def _begin(self, end: Array) -> Array:
        """Return the pose at which a straight or circular move to a pose begins."""
        self._note()
        if self.pose is None:
            reason = "after a joint move to axis values" if self.moved else "at the beginning of the program"
            place = find_start((0.0, 0.0, 0.0), range(3), self.stated, reason)
            self.pose = make_pose(np.array(place), end[:3, :3])
            self.log.rapid(place, self._axis(end))
        return self.pose

    def straight(self, pose: Array, feed: float) -> None:
        """Move straight to a pose with a feed in mm/s; the tool turns evenly on the way."""
        end = self.frame @ pose
        before = self._begin(end)
        axis = self._axis(end)
        if math.dist(self._axis(before), axis) < STEADY:
            self.log.line(_point(end), feed, axis)
            self.pose = end
            return
        shares, rotations = self._turn(before, end)
        self._follow(before[:3, 3] + shares[:, None] * (end[:3, 3] - before[:3, 3]), rotations, feed)
        self.pose = end

    def _follow(self, points: Array, rotations: Array, feed: float) -> None:
        """Cut from point to point while the tool turns: one move, in pieces."""
        counts = dict(self.log.counts)
        for point, rotation in zip(points, rotations, strict=True):
            self.log.line(_tuple(point), feed, self._axis(rotation))
        self.log.count_one(counts)

    def circle(self, via: Array, pose: Array, feed: float, *, angle: float | None = None) -> None:
        """Move on the circle through a point (3,) to a pose, in the frame in force, with a feed in mm/s.

        `angle` [rad]: go on about its axis for this angle, positive from start over via to end, negative the other way.
        """
        end = self.frame @ pose
        before = self._begin(end)
        through = self.frame[:3, :3] @ via + self.frame[:3, 3]
        arc = find_arc(_point(before), _tuple(through), _point(end), angle)
        last = _tuple(sample_arcs([arc], self.log.chord)[0][-1]) if angle is not None else _point(end)
        goal = end.copy()
        goal[:3, 3] = last
        shares, _ = self._turn(before, goal)
        if len(shares) == 1:
            self.log.arc(arc, last, feed)
            self.log.axis = self._axis(goal)
        else:
            points, length = sample_arcs([arc], self.log.chord)[0], self.log.length
            turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.array([before[:3, :3], goal[:3, :3]])))
            self._follow(points, turn(np.arange(1, len(points) + 1) / len(points)).as_matrix(), feed)
            self.log.counts["arcs"] += 1
            self.log.length = length + arc.length
            self.log.arc_length += arc.length
        self.pose = goal

    def spline(self, poses: list[Array], feed: float) -> None:
        """Move on a spline through poses."""
        ends = [self.frame @ pose for pose in poses]
        before = self._begin(ends[0])
        self.note(
            "splines are read as cubic ones through their points (assumed: the controller's own is not published)"
        )
        points = np.array([before, *ends])
        length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points[:, :3, 3], axis=0), axis=1))]
        if np.any(np.diff(length) <= 1e-9):
            raise InputError("two points of a spline coincide")
        curve = CubicSpline(length, points[:, :3, 3])
        turn = Slerp(length, Rotation.from_matrix(points[:, :3, :3]))
        places = np.concatenate([np.linspace(a, b, SPLINE_POINTS + 1)[1:] for a, b in itertools.pairwise(length)])
        for point, rotation in zip(curve(places), turn(places).as_matrix(), strict=True):
            self.log.line(_tuple(point), feed, self._axis(rotation))
        self.pose = points[-1]

    def _turn(self, start: Array, end: Array) -> tuple[Array, Array]:
        """Return shares of a move at which the tool has turned by a step, and its rotation there."""
        still = math.dist(self._axis(start), self._axis(end)) < STEADY
        turned = Rotation.from_matrix(start[:3, :3].T @ end[:3, :3]).magnitude()
        pieces = 1 if still else max(1, math.ceil(math.degrees(turned) / TURN_STEP - 1e-9))
        shares = np.arange(1, pieces + 1) / pieces
        if pieces == 1:
            return shares, end[None, :3, :3]
        turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.array([start[:3, :3], end[:3, :3]])))
        return shares, np.asarray(turn(shares).as_matrix())

    def _axis(self, rotation: Array) -> Point:
        """Return the tool axis of a pose: from the tip towards the spindle; a steady tool keeps its axis exactly."""
        x, y, z = (-rotation[:3, :3] @ self.direction).tolist()
        axis = x + 0.0, y + 0.0, z + 0.0
        return self.log.axis if math.dist(axis, self.log.axis) < STEADY else axis

    def _note(self) -> None:
        if self.assumed:
            self.assumed = False
            self.note("z of the TCP frame is taken to point out of the tool (option tool_direction)")


def make_pose(position: Array, rotation: Array) -> Array:
    """Return a pose from position [mm] and rotation matrix."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def _direction(name: str) -> Array:
    axis = np.zeros(3)
    axis["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return axis


def _tuple(vector: Array) -> Point:
    x, y, z = vector.tolist()
    return x + 0.0, y + 0.0, z + 0.0


def _point(pose: Array) -> Point:
    return _tuple(pose[:3, 3])
