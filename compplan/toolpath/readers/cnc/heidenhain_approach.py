"""APPR and DEP of Heidenhain programs: how a contour is approached and left. All of it lies in the working plane."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine, cross, dot
from compplan.toolpath.readers.cnc.contour import Element
from compplan.toolpath.readers.cnc.heidenhain_words import KlartextWords, Words
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.frames import PLANE_NORMALS
from compplan.toolpath.readers.lines import match_form


@dataclass(frozen=True)
class Way:
    """Hold what an APPR or DEP block says: its kind LT, LN, CT or LCT, LEN, R (signed), CCA [deg], feeds in mm/s.

    The tool runs left (1) or right (-1) of the contour; `feed_before` leads to the approach, None where that is rapid.
    """

    kind: str
    length: float
    radius: float
    angle: float
    side: float
    normal: Point
    feed: float
    feed_before: float | None
    line: int

    def find_begin(self, far: Point, first: Point, direction: Point) -> tuple[Point, Point | None, bool]:
        """Return where the approach to a contour begins, and centre and sense of its arc; ValueError without any.

        The tool comes from `far`, the contour leaves its first point in `direction`. RL with R > 0 turns
        counter-clockwise.
        """
        left, turn = cross(self.normal, direction), self.side
        if self.kind == "LT":
            return combine(1.0, first, -self.length, direction), None, True
        if self.kind in ("CT", "LCT"):
            if self.radius == 0.0:
                raise ValueError(f"{self.kind} has no radius R")
            turn *= math.copysign(1.0, self.radius)
        if not turn and self.kind == "LCT":
            turn = 1.0 if dot(combine(1.0, far, -1.0, first), left) > 0.0 else -1.0
        if not turn:
            raise ValueError(f"{self.kind} without RL or RR does not say to which side of the contour it goes")
        if self.kind == "LN":
            return combine(1.0, first, self.length * turn, left), None, True
        radius = abs(self.radius)
        centre = combine(1.0, first, radius * turn, left)
        if self.kind == "CT":
            arm, angle = combine(1.0, first, -1.0, centre), -turn * math.radians(self.angle)
        else:  # a straight line from `far` touches the circle
            arm = combine(1.0, far, -1.0, centre)
            arm = combine(1.0, arm, -dot(arm, self.normal), self.normal)
            size = math.hypot(*arm)
            if size < radius:
                raise ValueError(f"no line touches a circle of radius {radius:g} from {size:.4g} from its centre")
            arm, angle = combine(radius / size, arm, 0.0, arm), turn * math.acos(radius / size)
        begin = combine(1.0, combine(1.0, centre, math.cos(angle), arm), math.sin(angle), cross(self.normal, arm))
        return begin, centre, turn > 0.0

    def go(self, start: Point, end: Point, feed: float | None, centre: Point | None = None, *,
           right_hand: bool = True) -> Element:  # fmt: skip
        """Return a line, rapid without a feed, or an arc about a centre."""
        return Element(start, end, (0, 1, 2), feed or 0.0, self.line, centre, self.normal, right_hand,
                       rapid=feed is None)  # fmt: skip

    def approach(self, start: Point, first: Point, depth: Point, direction: Point) -> list[Element]:
        """Return the moves to the first point of a contour, which lies by the vector `depth` below the start."""
        begin, centre, right_hand = self.find_begin(start, combine(1.0, first, -1.0, depth), direction)
        low = combine(1.0, begin, 1.0, depth)
        about = None if centre is None else combine(1.0, centre, 1.0, depth)
        feed_before = self.feed if self.kind == "LCT" else self.feed_before
        moves = [self.go(start, begin, feed_before), self.go(begin, low, feed_before)]
        moves.append(self.go(low, first, self.feed, about, right_hand=right_hand))
        return [move for move in moves if math.dist(move.start, move.end) > 0.0]

    def depart(self, last: Point, end: Point | None, direction: Point) -> list[Element]:
        """Return the moves that leave a contour: those of an approach the other way round. LCT goes to `end`."""
        back, reverse = replace(self, side=-self.side), combine(-1.0, direction, 0.0, direction)
        place, centre, right_hand = back.find_begin(end or last, last, reverse)
        moves = [self.go(last, place, self.feed, centre, right_hand=centre is None or not right_hand)]
        return moves if end is None else [*moves, self.go(place, end, self.feed)]


def run_approach(it: Interpreter, block: KlartextWords, rest: str) -> None:
    """APPR: its moves wait for the first element of the contour."""
    way, words, functions = _read_way(it, block, rest, "APPR")
    it.contour.refuse_open()
    it.course.begin_cut()
    start, (first, _) = it.contour.position, it.motion.target(block.read(words))
    depth = combine(dot(combine(1.0, first, -1.0, start), way.normal), way.normal, 0.0, way.normal)
    if math.hypot(*depth) > 1e-9:
        it.note("an approach with a depth goes there before it touches the contour; newer controls sink on the way")
    it.contour.wait(lambda element: way.approach(start, first, depth, element.tangent(element.start)), first,
                    it.flow.line)  # fmt: skip
    with block.functions(functions):
        pass


def run_departure(it: Interpreter, block: KlartextWords, rest: str) -> None:
    """DEP: leave the contour."""
    axis = block.tool_axis
    way, words, functions = _read_way(it, block, rest, "DEP")
    with block.functions(functions):
        direction = it.motion.find_direction()
        it.contour.refuse_open()
        last, target = it.contour.position, it.motion.target(block.read(words))[0]
        height = target[axis] - last[axis]
        flat = combine(1.0, target, -height, way.normal) if way.kind == "LCT" else None
        for element in way.depart(last, flat, direction):
            it.contour.add(element)
        if abs(height) > 1e-9:
            place = combine(1.0, it.contour.position, height, way.normal)
            it.contour.add(Element(it.contour.position, place, (), way.feed, it.flow.line))
        block.side, it.state.motion = "", 1.0


def _read_way(it: Interpreter, block: KlartextWords, rest: str, what: str) -> tuple[Way, Words, set[int]]:
    kind, text = match_form(r"P?(LT|LN|CT|LCT)\b\s*(.*)", rest, f"{what}: LT, LN, CT, LCT").groups()
    words, functions = block.split(text)
    feed_before = None if it.state.motion == 0.0 else it.motion.feed(0.0)
    block.take_side(words)
    if block.take_feed(words) and what == "APPR":
        raise InputError("an approach with FMAX is not read; give it a feed")
    need = {"LT": "LEN", "LN": "LEN", "CT": "CCA", "LCT": ""}[kind]
    if need and need not in words:
        raise InputError(f"{what} {kind} has no {need}")
    length, radius, angle = (block.value(words.get(name) or "0") for name in ("LEN", "R", "CCA"))
    side, normal = {"L": 1.0, "R": -1.0, "": 0.0}[block.side], PLANE_NORMALS[it.state.plane]
    feed, line = it.motion.feed(0.0), it.flow.line
    return Way(kind, length, radius, angle, side, normal, feed, feed_before, line), words, functions
