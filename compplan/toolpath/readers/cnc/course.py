"""Position of the tool in program coordinates, with unknown coordinates, and its moves in the part frame.

Rapid moves are logged once all coordinates are known; cuts from an unknown position are refused.
Moves in a frame with unknown pose in the part are left out (suspended), and cuts there are refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, arc_about, combine, cross, dot, normalise, orient
from compplan.toolpath.readers.frames import ORIGIN, UNIT, UP, Frame
from compplan.toolpath.readers.moves import MoveLog
from compplan.toolpath.readers.options import CHORD_MM, TURN_STEP, CamTable, find_start

#: Least change of the tool axis. [rad]
STEADY = 1e-9


class Course:
    """Track the position of the tool in program coordinates and log its moves in the part frame."""

    def __init__(self, reader: Any, options: CamTable, *, starts_at_zero: bool = False) -> None:
        self.reader, self.options, self.starts_at_zero = reader, options, starts_at_zero
        self.log = MoveLog(CHORD_MM, reader)
        self.note = self.log.note
        self.frame = Frame()
        self.position: Point = (0.0, 0.0, 0.0)
        #: Axes with unknown coordinate; True after a machine move, False if the program has not stated it yet.
        self.unknown = dict.fromkeys(range(3), False)
        #: Whether a cut has begun; whether a machine move to an unknown position precedes the next move.
        self.begun = self.after_machine_move = False
        self.reason = ""
        #: Greatest height of a rapid move so far, along Z of the frame. [mm]
        self.height: float | None = None
        self.up = UP
        #: Reasons to leave out moves, with the error message of a cut and the note of a rapid move ("": none).
        self.suspended: dict[str, tuple[str, str]] = {}
        self.left_out = 0
        #: Two points in program coordinates whose difference is the direction at the end of the last cut; None
        #: if the last move was not a cut.
        self.last_direction: tuple[Point, Point] | None = None

    def use(self, frame: Frame) -> None:
        """Activate a frame; the tool does not move, its coordinates are converted."""
        if frame == self.frame:
            return
        back = frame.invert()
        if self.unknown and frame.rows != self.frame.rows:
            mix = back.then(self.frame).rows
            on = {i: [lost for j, lost in self.unknown.items() if abs(mix[i][j]) > 1e-12] for i in range(3)}
            self.unknown = {axis: any(lost) for axis, lost in on.items() if lost}
        self.position = back.apply(self.frame.apply(self.position))
        self.move_frame(frame)

    def move_frame(self, frame: Frame) -> None:
        """Activate a frame; the tool keeps its coordinates, so its position in the part changes."""
        if frame == self.frame:
            return
        if frame.rows != self.frame.rows:
            up = normalise(frame.turn(UP))
            if math.dist(up, self.up) > STEADY:
                self.up, self.height = up, None
        self.frame, self.last_direction = frame, None

    def set_tool_axis(self, axis: Point) -> None:
        """Set the tool axis in the part by rotary axes; the position of the tip is then unknown."""
        if _angle(self.log.axis, axis) > STEADY:
            self.mark_unknown()
            self.log.axis = axis

    def mark_unknown(self, axes: Iterable[int] = range(3), reason: str = "after a move of the machine's axes") -> None:
        """Mark coordinates as unknown after a machine move."""
        lost = dict.fromkeys(axes, True)
        self.unknown.update(lost)
        self.last_direction, self.after_machine_move, self.reason = None, self.after_machine_move or bool(lost), reason

    def mark_known(self, axes: Iterable[int]) -> None:
        """Mark coordinates as known."""
        for axis in axes:
            self.unknown.pop(axis, None)

    def suspend(self, reason: str, refusal: str = "", note: str = "") -> None:
        """Leave out all moves until `resume`; refuse cuts and note rapid moves if there is a text for them."""
        self.suspended[reason] = refusal, note

    def resume(self, reason: str) -> None:
        """Log moves again, from an unknown position."""
        if self.suspended.pop(reason, None) is not None:
            self.mark_unknown(range(3), "after a change of the frame")

    def retreat(self) -> None:
        """Retract along Z to the greatest height of a rapid move so far, before a move to the reference position."""
        if self.suspended or self.height is None or self.unknown or not self.log.waypoints:
            return
        place = self.frame.apply(self.position)
        rise = self.height - dot(self.up, place)
        if rise > 0.0:
            self.note(f"the way home begins straight up to Z{self.height:g}, the highest rapid so far")
            place = combine(1.0, place, rise, self.up)
            self.log.rapid(place)
            self.position = self.frame.invert().apply(place)

    def level_of_height(self) -> float | None:
        """Return the greatest height of a rapid move so far as Z of the program, None without any."""
        if self.height is None:
            return None
        place = self.frame.apply(self.position)
        return self.frame.invert().apply(combine(1.0, place, self.height - dot(self.up, place), self.up))[2]

    def rapid(self, target: Point, named: Sequence[int] = (), axis: Point | None = None) -> None:
        """Move rapidly to a position; the move is logged only if all coordinates are known."""
        before, log = self.position, self.log
        self.position, self.last_direction = target, None
        self.mark_known(named)
        if self.suspended:
            for note in filter(None, (note for _, note in self.suspended.values())):
                self.note(note)
            return
        point = self.frame.apply(target)
        if self.unknown:
            log.counts["rapid_moves"] += target != before or bool(named)
            if not log.waypoints:
                log.place(point, axis)
            log.axis = axis or log.axis
            return
        level = dot(self.up, point)
        if self.after_machine_move:
            self.after_machine_move = False
            if log.waypoints and self.height is not None and axis in (None, log.axis):  # sideways first, then down
                above = max(self.height, level, dot(self.up, self.frame.apply(before)))
                log.rapid(combine(1.0, point, above - level, self.up))
        self.height = level if self.height is None else max(self.height, level)
        log.rapid(point, axis)

    def begin_cut(self) -> None:
        """Begin a cut at the position of the tool, before its end point is evaluated."""
        if self.suspended:
            return
        if unknown := set(self.unknown):
            elsewhere, stated = any(self.unknown.values()) or self.after_machine_move, self.options.from_mm
            if stated is None and self.starts_at_zero and not elsewhere:
                names = " ".join("XYZ"[axis] for axis in sorted(unknown))
                self.note(
                    f"the file states no {names} for the start of the first cut: 0 is assumed; --from X,Y,Z states it"
                )
                stated = [0.0, 0.0, 0.0]
            if stated is not None:
                stated = list(self.frame.invert().apply((stated[0], stated[1], stated[2])))
            start = find_start(self.position, unknown, stated, self.reason if elsewhere else "")
            if self.log.waypoints:
                self.rapid(start, range(3))
            else:
                self.mark_known(range(3))
                self.position, self.after_machine_move = start, False
                point = self.frame.apply(start)
                self.height = dot(self.up, point)
                self.log.place(point)
        self.begun = True

    def check_place(self, axes: Iterable[int]) -> None:
        """Refuse a block that depends on an unknown coordinate of these axes."""
        unknown = " ".join("XYZ"[axis] for axis in sorted(set(axes).intersection(self.unknown)))
        if unknown and not self.suspended:
            why = f" ({self.reason})" if self.reason else ""
            raise InputError(f"this block counts from where the tool is, and {unknown} of the tool is not known{why}; "
                             f"write {unknown} into it, or let a rapid move to them come first")  # fmt: skip

    def leave_out(self, target: Point) -> bool:
        """Leave out a cut if moves are suspended; return whether they are."""
        if not self.suspended:
            return False
        if refusal := next((refusal for refusal, _ in self.suspended.values() if refusal), ""):
            raise InputError(refusal)
        self.left_out += 1
        self.position = target
        return True

    def line(self, target: Point, feed: float, axis: Point | None = None) -> None:
        """Cut straight to a position with a feed in mm/s; the tool axis moves to `axis` on the great circle."""
        if self.leave_out(target):
            return
        if self.unknown:
            self.begin_cut()
        start, end = self.frame.apply(self.position), self.frame.apply(target)
        angle = 0.0 if axis is None else _angle(self.log.axis, axis)
        if axis is not None and angle > math.radians(TURN_STEP):
            pieces, before = math.ceil(math.degrees(angle) / TURN_STEP - 1e-9), self.log.axis
            with self.log.one_move():
                for share in (piece / pieces for piece in range(1, pieces)):  # on the great circle
                    from_before, to_axis = (math.sin(part * angle) / math.sin(angle) for part in (1.0 - share, share))
                    way = combine(from_before, before, to_axis, axis)
                    self.log.line(combine(1.0 - share, start, share, end), feed, way)
                self.log.line(end, feed, axis)
        else:
            self.log.line(end, feed, axis)
        if math.dist(start, end) > 1e-9:
            self.last_direction = self.position, target
        self.position = target

    def arc(self, target: Point, feed: float, centre: Point, normal: Point, turns: int) -> None:
        """Cut along an arc or a helix about a centre, right-handed about a normal, given in program coordinates."""
        if self.leave_out(target):
            return
        if self.unknown:
            self.begin_cut()
        frame = self.frame
        if frame.rows is not UNIT and not frame.similar:
            raise InputError("an arc under a scale that differs between axes would be an ellipse and is not read")
        start, end, unit = frame.apply(self.position), frame.apply(target), normalise(frame.turn(normal))
        arc = arc_about(start, end, frame.apply(centre), orient(unit, right_hand=not frame.mirrored), turns)
        arc.check_circle()
        self.log.arc(arc, end, feed)
        along = cross(normal, combine(1.0, target, -1.0, centre))
        self.position, self.last_direction = target, (ORIGIN, along)


def _angle(before: Point, after: Point) -> float:
    return math.atan2(math.hypot(*cross(before, after)), dot(before, after))
