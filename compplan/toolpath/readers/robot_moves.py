"""Interpreter of robot programs, shared by KRL and RAPID: straight and circular moves between poses.

Millimetres; poses (4, 4) are those of the TCP in the active frame (base, work object).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.toolpath.readers.arcs import Point, build_arc, sample_arc
from compplan.toolpath.readers.cnc.flow import Flow
from compplan.toolpath.readers.lines import DECIMAL
from compplan.toolpath.readers.moves import MoveLog
from compplan.toolpath.readers.options import CHORD_MM, TURN_STEP, CamTable, find_start

#: Number in a robot program, in capitals.
NUMBER = rf"{DECIMAL}(?:E[-+]?\d+)?"
#: Greatest depth of nested calls.
DEEPEST = 20
#: Least change of the tool axis. [rad]
STEADY = 1e-6


#: Pattern of statements and their operation; None: they do not affect the path.
Match = re.Match[str]
Rule = tuple[re.Pattern[str], Callable[[Match], object] | None]


class RobotProgram:
    """Interpret a robot program: its control flow and moves; loops and branches are counted in `blocks`, not executed.

    The path is in the frame that is active at the first pose; `frame` is the pose of the active frame in it.
    """

    def __init__(self, file: Path, options: CamTable) -> None:
        self.options, self.flow = options, Flow(file, deepest=DEEPEST)
        self.log = MoveLog(CHORD_MM, self.flow)
        self.note = self.log.note
        self.blocks = 0
        self.frame = np.eye(4)
        #: Name and pose of the active frame (None: unknown); whether a pose was programmed in a frame.
        self.frame_name = ""
        self.place: Array | None = None
        self.placed = False
        self.pose: Array | None = None
        self.lost = False
        direction = options.tool_direction or "z"
        self.direction = np.array([axis == direction[-1] for axis in "xyz"]) * (-1.0 if direction[0] == "-" else 1.0)
        self.assumed = options.tool_direction is None

    def run_statement(self, statement: str, rules: Iterable[Rule]) -> object:
        """Execute a statement by the first rule with a matching pattern; return the result of the rule."""
        for pattern, run in rules:
            if found := pattern.match(statement):
                return run(found) if run else None
        return None

    def count_block(self, found: Match) -> None:
        """Count the beginning or end of a loop or a branch, which is not executed."""
        self.blocks = max(0, self.blocks + (-1 if found.group().startswith(("END", "UNTIL")) else 1))

    def refuse(self, found: Match) -> None:
        """Refuse an unsupported statement that moves the tool or its frame."""
        word = found.group()[:20].strip()
        raise InputError(f"{word} is not read and may move the tool or its frame; write absolute moves in a row")

    def check_row(self, statement: str) -> None:
        """Refuse a move in a loop or a branch."""
        if self.blocks:
            raise InputError(f"{statement[:30]!r} stands in a loop or a branch; write the moves out in a row")

    def call(self, name: str, called: str) -> None:
        """Execute a program by its name; refuse calls in a loop or a branch, or nested too deeply."""
        if self.blocks or self.flow.depth >= DEEPEST:
            raise InputError(f"call of {called} in a loop, a branch or too deep; write the moves out")
        self.flow.run_program(name, self.flow.programs[name], 1)

    def add_call_event(self, found: Match | str) -> None:
        """Append a statement without equivalent in other languages as an event for the operator."""
        where = "in a loop or a branch: " if self.blocks else ""
        self.log.add_event("call", text=where + (found if isinstance(found, str) else found.string))

    def switch(self, kind: str) -> Callable[[Match], None]:
        """Return the rule of an output, a wait (dwell) or a halt (stop); see `add_call_event` for loops and branches.

        Patterns of outputs have the groups `signal` and `on` or `level`, those of waits the group `time`.
        """

        def run(found: Match) -> None:
            words = found.groupdict()
            on = words.get("on") in ("TRUE", "SET") or words.get("level") == "1"
            value = max(float(words["time"]), 0.0) if kind == "dwell" else float(on)
            if self.blocks:
                self.add_call_event(found)
            else:
                self.log.add_event(kind, value=value, text=words.get("signal") or "")

        return run

    def use_frame(self, name: str, place: Array | None, kind: str) -> None:
        """Activate a frame; the path stays in the frame of its first pose, and both poses must be known."""
        if self.placed and (name != self.frame_name or not (place is None and self.place is None)):
            if self.place is None or place is None:
                raise InputError(f"{kind} changes from {self.frame_name or 'the one before'} to {name}, and their "
                                 "places are not both known")  # fmt: skip
            self.frame = self.frame @ np.linalg.inv(self.place) @ place
        self.frame_name, self.place = name, place

    def forget_pose(self, note: str = "") -> None:
        """Leave out a joint move; the pose at its end is unknown."""
        self.note(note or "joint moves to axis values are left out: where they take the tip is not known")
        self.pose, self.lost = None, True

    def note_tool(self) -> None:
        """Note a change of the tool."""
        if self.pose is not None:
            self.note("the tool changes on the way: the path is that of the tip of each")

    def rapid(self, pose: Array) -> None:
        """Move rapidly to a pose: in joint space, on an unknown path."""
        self._note_direction()
        self.pose = self.frame @ pose
        self.log.rapid(_point(self.pose), self._axis(self.pose))

    def straight(self, pose: Array, feed: float) -> None:
        """Move straight to a pose with a feed in mm/s; the orientation is interpolated uniformly."""
        end = self.frame @ pose
        before = self._begin(end)
        pieces = self._count_pieces(before, end)
        if pieces == 1:
            self.log.line(_point(end), feed, self._axis(end))
        else:
            self._follow(np.linspace(before[:3, 3], end[:3, 3], pieces + 1)[1:], before, end, feed)
        self.pose = end

    def circle(self, via: Array, pose: Array, feed: float, *, angle: float | None = None) -> None:
        """Move on the circle through a point (3,) to a pose, in the active frame, with a feed in mm/s.

        `angle` [rad], if given, is the sweep in place of that to the pose, positive from start through via to the pose.
        """
        goal = self.frame @ pose
        before = self._begin(goal)
        through = self.frame[:3, :3] @ via + self.frame[:3, 3]
        arc = build_arc(_point(before), _tuple(through), _point(goal), angle)
        if angle is not None:
            goal[:3, 3] = sample_arc(arc, self.log.chord)[-1]
        if self._count_pieces(before, goal) == 1:
            self.log.arc(arc, _point(goal), feed)
            self.log.axis = self._axis(goal)
        else:
            length = self.log.length
            self._follow(sample_arc(arc, self.log.chord), before, goal, feed)
            self.log.counts["arcs"] += 1
            self.log.length = length + arc.length
            self.log.arc_length += arc.length
        self.pose = goal

    def _begin(self, end: Array) -> Array:
        """Return the start pose of a straight or circular move to a pose."""
        self._note_direction()
        if self.pose is None:
            reason = "after a joint move to axis values" if self.lost else "at the beginning of the program"
            place = find_start((0.0, 0.0, 0.0), range(3), self.options.from_mm, reason)
            self.pose = end.copy()
            self.pose[:3, 3] = place
            self.log.rapid(place, self._axis(end))
        return self.pose

    def _count_pieces(self, start: Array, end: Array) -> int:
        """Return the number of pieces of a rotation between two poses; 1 if the tool axis is constant."""
        if math.dist(self._axis(start), self._axis(end)) < STEADY:
            return 1
        turned = Rotation.from_matrix(start[:3, :3].T @ end[:3, :3]).magnitude()
        return max(1, math.ceil(math.degrees(turned) / TURN_STEP - 1e-9))

    def _follow(self, points: Array, start: Array, end: Array, feed: float) -> None:
        """Cut through points with uniform rotation between two poses, counted as one move."""
        turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.array([start[:3, :3], end[:3, :3]])))
        with self.log.one_move():
            self._cut(points, turn(np.arange(1, len(points) + 1) / len(points)), feed)

    def _cut(self, points: Array, rotations: Rotation, feed: float) -> None:
        for point, rotation in zip(points, rotations.as_matrix(), strict=True):
            self.log.line(_tuple(point), feed, self._axis(rotation))

    def _axis(self, rotation: Array) -> Point:
        """Return the tool axis of a pose, from the tip towards the spindle; exactly the last one if it is constant."""
        axis = _tuple(-rotation[:3, :3] @ self.direction)
        return self.log.axis if math.dist(axis, self.log.axis) < STEADY else axis

    def _note_direction(self) -> None:
        if self.assumed:
            self.assumed = False
            self.note("z of the TCP frame is taken to point out of the tool (option tool_direction)")


def split_fields(text: str, opening: str = "[(", closing: str = "])") -> list[str]:
    """Split a text at commas outside of brackets."""
    parts, depth, start = [], 0, 0
    for index, letter in enumerate(text):
        depth += (letter in opening) - (letter in closing)
        if letter == "," and depth == 0:
            parts.append(text[start:index])
            start = index + 1
    return [*parts, text[start:]]


def _tuple(vector: Array) -> Point:
    x, y, z = vector.tolist()
    return x + 0.0, y + 0.0, z + 0.0


def _point(pose: Array) -> Point:
    return _tuple(pose[:3, 3])
