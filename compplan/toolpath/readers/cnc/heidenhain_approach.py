"""APPR and DEP of Heidenhain programs: how a contour is approached and left. Everything stands in one plane."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine, cross, dot
from compplan.toolpath.readers.cnc.contour import Element
from compplan.toolpath.readers.cnc.heidenhain_words import KlartextWords, Words
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import PLANE_NORMALS


@dataclass(frozen=True)
class Way:
    """Hold what an APPR or DEP block says: its kind LT, LN, CT or LCT, and its feed in mm/s.

    Args:
        length, radius, angle: LEN of LT and LN; R of CT and LCT, signed; CCA of CT. [deg]
        side: "L" or "R" where the tool runs left or right of the contour, "" without compensation.
        feed_before: Feed of the move to where the approach begins, None where that is rapid. [mm/s]

    """

    kind: str
    length: float
    radius: float
    angle: float
    side: str
    normal: Point
    feed: float
    feed_before: float | None
    line: int


def approach(way: Way, start: Point, first: Point, depth: Point, direction: Point) -> list[Element]:
    """Return the moves from where the tool is to the first point of a contour; ValueError if the block says too little.

    The first point stands at its depth; `depth` is how far it lies from the start along the normal, as a vector. The
    contour begins in `direction`.
    """
    high = combine(1.0, first, -1.0, depth)
    begin, centre, right_hand = _begin(way, start, high, direction)
    low = combine(1.0, begin, 1.0, depth)
    feed_before = way.feed if way.kind == "LCT" else way.feed_before
    moves = [_line(start, begin, feed_before, way)]
    if math.hypot(*depth) > 0.0:
        moves.append(_line(begin, low, feed_before, way))
    if centre is None:
        moves.append(_line(low, first, way.feed, way))
    else:
        about = combine(1.0, centre, 1.0, depth)
        moves.append(Element(low, first, (0, 1, 2), way.feed, way.line, about, way.normal, right_hand))
    return [move for move in moves if math.dist(move.start, move.end) > 0.0]


def _begin(way: Way, start: Point, first: Point, direction: Point) -> tuple[Point, Point | None, bool]:
    """Return where the approach begins, and centre and sense of its arc."""
    if way.kind == "LT":
        return combine(1.0, first, -way.length, direction), None, True
    if way.kind == "LN":
        return combine(1.0, first, way.length, _aside(way, direction)), None, True
    centre, right_hand = _centre(way, first, direction, start)
    if way.kind == "CT":
        turn = math.radians(way.angle) * (-1.0 if right_hand else 1.0)
        return _around(centre, first, way.normal, turn), centre, right_hand
    return _tangent_point(centre, abs(way.radius), start, way.normal, right_hand=right_hand), centre, right_hand


def depart(way: Way, last: Point, end: Point | None, direction: Point) -> list[Element]:
    """Return the moves that leave a contour: those of an approach the other way round. LCT goes to `end`."""
    back = replace(way, side={"L": "R", "R": "L", "": ""}[way.side])
    place, centre, right_hand = _begin(back, end or last, last, combine(-1.0, direction, 0.0, direction))
    if centre is None:
        return [_line(last, place, way.feed, way)]
    arc = Element(last, place, (0, 1, 2), way.feed, way.line, centre, way.normal, not right_hand)
    return [arc] if end is None else [arc, _line(place, end, way.feed, way)]


def _line(start: Point, end: Point, feed: float | None, way: Way) -> Element:
    return Element(start, end, (0, 1, 2), feed or 0.0, way.line, rapid=feed is None)


def _aside(way: Way, direction: Point) -> Point:
    """Return the direction from the contour to the side on which the tool runs."""
    if not way.side:
        raise ValueError(f"{way.kind} without RL or RR does not say to which side of the contour it goes")
    left = cross(way.normal, direction)
    return left if way.side == "L" else (-left[0], -left[1], -left[2])


def _centre(way: Way, place: Point, direction: Point, other: Point) -> tuple[Point, bool]:
    """Return centre and sense of the arc that touches the contour: RL with R > 0 turns counter-clockwise."""
    if way.radius == 0.0:
        raise ValueError(f"{way.kind} has no radius R")
    left = cross(way.normal, direction)
    if way.side:
        right_hand = (way.side == "L") == (way.radius > 0.0)
    elif way.kind == "LCT":
        right_hand = dot(combine(1.0, other, -1.0, place), left) > 0.0
    else:
        raise ValueError(f"{way.kind} without RL or RR does not say to which side of the contour it goes")
    return combine(1.0, place, abs(way.radius) * (1.0 if right_hand else -1.0), left), right_hand


def _around(centre: Point, place: Point, normal: Point, angle: float) -> Point:
    arm = combine(1.0, place, -1.0, centre)
    return combine(1.0, combine(1.0, centre, math.cos(angle), arm), math.sin(angle), cross(normal, arm))


def _tangent_point(centre: Point, radius: float, far: Point, normal: Point, *, right_hand: bool) -> Point:
    """Return where a straight line from a point touches a circle, in the sense of travel."""
    arm = combine(1.0, far, -1.0, centre)
    arm = combine(1.0, arm, -dot(arm, normal), normal)
    size = math.hypot(*arm)
    if size < radius:
        raise ValueError(f"no line touches a circle of radius {radius:g} from a point {size:.4g} from its centre")
    angle = math.acos(min(1.0, radius / max(size, 1e-12)))
    unit = combine(1.0 / size, arm, 0.0, arm)
    along = cross(normal, unit)
    side = radius * math.sin(angle) * (1.0 if right_hand else -1.0)
    reach = combine(radius * math.cos(angle), unit, side, along)
    return combine(1.0, centre, 1.0, reach)


class Approaches:
    """Carry out APPR and DEP."""

    def __init__(self, it: Interpreter, words: KlartextWords) -> None:
        self.it, self.words = it, words

    @property
    def _normal(self) -> Point:
        return PLANE_NORMALS[self.it.state.plane]

    def run_approach(self, rest: str) -> None:
        """APPR: its moves wait for the first element of the contour."""
        it = self.it
        way, words, functions = self._read_way(rest, "APPR")
        it.contour.refuse_open()
        it.course.begin_cut()
        start, (first, _) = it.contour.position, it.motion.target(self.words.read(words))
        depth = combine(dot(combine(1.0, first, -1.0, start), self._normal), self._normal, 0.0, self._normal)
        if math.hypot(*depth) > 1e-9:
            it.note("an approach with a depth goes there before it touches the contour; newer controls sink on the way")

        def begin(element: Element) -> list[Element]:
            return approach(way, start, first, depth, element.tangent(element.start))

        it.contour.wait(begin, first, it.flow.line)
        self.words.start_functions(functions)
        self.words.stop_functions(functions)

    def run_departure(self, rest: str) -> None:
        """DEP: leave the contour."""
        it = self.it
        way, words, functions = self._read_way(rest, "DEP")
        self.words.start_functions(functions)
        direction = it.motion.find_direction()
        it.contour.refuse_open()
        last, target = it.contour.position, it.motion.target(self.words.read(words))[0]
        height = target[self.words.tool_axis] - last[self.words.tool_axis]
        flat = combine(1.0, target, -height, self._normal) if way.kind == "LCT" else None
        for element in depart(way, last, flat, direction):
            it.contour.add(element)
        if abs(height) > 1e-9:
            place = combine(1.0, it.contour.position, height, self._normal)
            it.contour.add(Element(it.contour.position, place, (), way.feed, it.flow.line))
        self.words.side, it.state.motion = "", 1.0
        self.words.stop_functions(functions)

    def _read_way(self, rest: str, what: str) -> tuple[Way, Words, set[int]]:
        found = re.match(r"P?(LT|LN|CT|LCT)\b\s*(.*)", rest)
        if not found:
            raise InputError(f"{what} {rest[:20]!r} is not read, expected LT, LN, CT, LCT")
        words, functions = self.words.split(found.group(2))
        feed_before = None if self.it.state.motion == 0.0 else self.it.motion.feed(0.0)
        self.words.take_side(words)
        if self.words.take_feed(words) and what == "APPR":
            raise InputError("an approach with FMAX is not read; give it a feed")
        kind = found.group(1)
        need = "LEN" if kind in ("LT", "LN") else "CCA" if kind == "CT" else ""
        if need and need not in words:
            raise InputError(f"{what} {kind} has no {need}")
        length, radius, angle = (self.words.value(words.get(name) or "0") for name in ("LEN", "R", "CCA"))
        feed, line = self.it.motion.feed(0.0), self.it.flow.line
        way = Way(kind, length, radius, angle, self.words.side, self._normal, feed, feed_before, line)
        return way, words, functions
