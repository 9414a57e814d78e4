"""Follow the tool of a program whose coordinates stand in frames: what of its place is known, moves in the part."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Arc, Point, arc_about, combine, cross, dot, fits_circle
from compplan.toolpath.readers.frames import UNIT, Frame
from compplan.toolpath.readers.moves import MoveLog
from compplan.toolpath.readers.start import find_start

AXES = "XYZ"
#: Greatest turn of the tool between waypoints. [deg]
TURN_STEP = 1.0
#: Turns of the tool below this are none. [rad]
STEADY = 1e-9


class Course:
    """Hold where the tool is, in the coordinates of the program, and put down its moves in the part.

    Args:
        log: Log of the moves.
        stated: Where cuts begin whose start the program leaves open (`from_mm`), in the part. [mm]

    """

    def __init__(self, log: MoveLog, stated: Sequence[float] | None = None) -> None:
        self.log, self.stated = log, stated
        self.frame = Frame()
        self.position: Point = (0.0, 0.0, 0.0)
        self.untold = {0, 1, 2}
        self.lost: set[int] = set()
        self.direction: Point | None = None
        #: Whether the tool has gone where only the machine knows since its last move.
        self.away = False
        #: Greatest height of a rapid move so far, in the part [mm].
        self.height: float | None = None

    @property
    def knows(self) -> bool:
        """Whether the place of the tool is known."""
        return not self.untold and not self.lost

    def use(self, frame: Frame) -> None:
        """Put a frame in force; the tool stays where it is, and is counted anew."""
        if frame == self.frame:
            return
        back = frame.invert()
        for unknown in (self.untold, self.lost):
            if unknown and frame.rows != self.frame.rows:
                spread = {i for i in range(3) if any(abs(self.frame.rows[i][j]) > 1e-12 for j in unknown)}
                unknown_now = {i for i in range(3) if any(abs(back.rows[i][j]) > 1e-12 for j in spread)}
                unknown.clear()
                unknown.update(unknown_now)
        self.position = back.apply(self.frame.apply(self.position))
        self.frame, self.direction = frame, None

    def move_frame(self, frame: Frame) -> None:
        """Put a frame in force under the tool: its coordinates stay, its place in the part changes."""
        if frame != self.frame:
            self.frame, self.direction = frame, None

    def aim(self, axis: Point) -> None:
        """Turn the tool, in the part, by rotary axes: where that takes its tip is not known."""
        if _angle(self.log.axis, axis) > STEADY:
            self.lose()
            self.log.axis = axis

    def lose(self, axes: Iterable[int] = range(3)) -> None:
        """Forget coordinates: the tool has gone where only the machine knows."""
        self.lost.update(axes)
        self.direction, self.away = None, True

    def retreat(self, line: int) -> None:
        """Go straight up to the greatest height of a rapid so far: on the way to the machine's home."""
        x, y, z = self.log.position
        if self.knows and self.height is not None and z < self.height and self.frame.rows == UNIT:
            note = f"the way home begins straight up to Z{self.height:g}, the highest rapid so far"
            self.log.note(note, line)
            self.log.rapid((x, y, self.height))
            self.position = self.frame.invert().apply(self.log.position)

    def rapid(self, target: Point, named: Iterable[int], axis: Point | None = None) -> None:
        """Move rapidly to a place; nothing is put down until all of it is known."""
        self._reach(target, named)
        self.direction = None
        point = self.frame.apply(target)
        if self.knows:
            if self.away and self.log.waypoints and axis in (None, self.log.axis) and self.frame.rows == UNIT:
                above = max(self.log.position[2], point[2])  # from home sideways first, then down
                self.log.rapid((point[0], point[1], above))
            self.away = False
            self.height = point[2] if self.height is None else max(self.height, point[2])
            self.log.rapid(point, axis)
            return
        self.log.counts["rapid_moves"] += 1
        if not self.log.waypoints:
            self.log.place(point, axis)
        self.log.axis = axis or self.log.axis

    def line(self, target: Point, named: Iterable[int], feed: float, line: int, *, axis: Point | None = None,
             on_way: Callable[[float], Point] | None = None) -> None:  # fmt: skip
        """Cut straight to a place.

        Args:
            target: The place, in the coordinates of the program.
            named: Axes that the program names as absolute coordinates.
            feed: Feed. [mm/s]
            line: Line, for notes.
            axis: Tool axis at the end, in the part.
            on_way: Tool axis after a share of the move; left out: on the great circle.

        Raises:
            InputError: If it begins where the tool is not known to be.

        """
        self.begin_cut()
        start = self.frame.apply(self.position)
        self._reach(target, named)
        end = self.frame.apply(target)
        length = math.dist(start, end)
        if length > 1e-9:
            self.direction = combine(1.0 / length, end, -1.0 / length, start)
        cut_turning(self.log, start, end, feed, axis, on_way)

    def arc(self, target: Point, named: Iterable[int], centre: Point, normal: Point, feed: float, line: int, *,
            right_hand: bool, turns: int = 1) -> None:  # fmt: skip
        """Cut along an arc or a helix; everything stands in the coordinates of the program.

        Raises:
            InputError: If start and end lie on no circle about the centre, or the start is not known.

        """
        self.begin_cut()
        frame, start = self.frame, self.frame.apply(self.position)
        self._reach(target, named)
        end, unit = frame.apply(target), frame.turn(normal)
        size = math.hypot(*unit)
        unit = unit[0] / size, unit[1] / size, unit[2] / size
        hand = right_hand != frame.mirrored
        arc = arc_about(start, end, frame.apply(centre), unit, right_hand=hand, turns=turns)
        if not fits_circle(arc.radius, arc.end_radius):
            message = f"arc starts {arc.radius:.4f} mm from its centre and ends {arc.end_radius:.4f} mm from it"
            raise InputError(f"{message}, expected the same radius")
        self.put_arc(arc, end, feed)

    def put_arc(self, arc: Arc, end: Point, feed: float) -> None:
        """Put down an arc that stands in the part."""
        self.log.arc(arc, end, feed)
        self.direction = arc.tangent(arc.sweep)

    def begin_cut(self) -> None:
        """Let a cut begin where the tool is, before its block says where it ends.

        Raises:
            InputError: If that is not known, and the user states no place.

        """
        unknown = self.untold | self.lost
        if not unknown:
            return
        stated = None if self.stated is None else self.frame.invert().apply((*self.stated,))  # type: ignore[arg-type]
        reason = "after a move of the machine's axes" if self.lost else ""
        start = find_start(self.position, unknown, stated, reason)
        if self.log.waypoints:
            self.rapid(start, range(3))
        else:
            self.untold.clear()
            self.lost.clear()
            self.position, self.away = start, False
            point = self.frame.apply(start)
            self.height = point[2]
            self.log.place(point)

    def _reach(self, target: Point, named: Iterable[int]) -> None:
        self.position = target
        if self.untold or self.lost:
            for axis in named:
                self.untold.discard(axis)
                self.lost.discard(axis)


def cut_turning(
    log: MoveLog, start: Point, end: Point, feed: float, axis: Point | None,
    on_way: Callable[[float], Point] | None = None,
) -> None:  # fmt: skip
    """Cut straight to a point while the tool turns: one move, in pieces.

    Args:
        log: Log of the moves.
        start: Where it begins, in the part. [mm]
        end: Where it ends. [mm]
        feed: Feed. [mm/s]
        axis: Tool axis at the end; None: it stays.
        on_way: Tool axis after a share of the move; left out: on the great circle.

    """
    angle = 0.0 if axis is None else _angle(log.axis, axis)
    if axis is None or angle <= math.radians(TURN_STEP):
        log.line(end, feed, axis)
        return
    pieces, before, counts = math.ceil(math.degrees(angle) / TURN_STEP - 1e-9), log.axis, dict(log.counts)
    for piece in range(1, pieces + 1):
        share = piece / pieces
        point = end if piece == pieces else combine(1.0 - share, start, share, end)
        log.line(point, feed, on_way(share) if on_way else _turn_towards(before, axis, share))
    log.count_one(counts)


def _angle(before: Point, after: Point) -> float:
    return math.atan2(math.hypot(*cross(before, after)), dot(before, after))


def _turn_towards(start: Point, end: Point, share: float) -> Point:
    """Return a direction on the great circle between two, which are not opposite, after a share of the turn."""
    angle = _angle(start, end)
    if angle < STEADY or share == 1.0:
        return end
    sine = math.sin(angle)
    return combine(math.sin((1.0 - share) * angle) / sine, start, math.sin(share * angle) / sine, end)
