"""APPR and DEP of Heidenhain programs: approach and departure of a contour in the working plane."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, orient, set_levels
from compplan.toolpath.readers.cnc.contour import Element
from compplan.toolpath.readers.cnc.heidenhain_words import KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.frames import PLANE_AXES, PLANE_NORMALS
from compplan.toolpath.readers.lines import match_form

#: Required word of each approach: line along the tangent (LT) or normal (LN), arc (CT), line and arc (LCT).
NEEDED = {"LT": "LEN", "LN": "LEN", "CT": "CCA", "LCT": "R"}


def find_begin(kind: str, values: Mapping[str, float], side: float, far: complex, first: complex, direction: complex
               ) -> tuple[complex, complex | None, bool]:  # fmt: skip
    """Return the start of an approach, and centre and sense (right-hand) of its arc; ValueError if it does not exist.

    Points of the plane are complex numbers. The tool comes from `far`; the contour starts at `first` in `direction`,
    with the tool to its left (1) or right (-1). RL with R > 0 is counter-clockwise.
    """
    left, length, radius = 1j * direction, values.get("LEN", 0.0), values.get("R", 0.0)
    if kind == "LT":
        return first - length * direction, None, True
    if kind == "LCT" and not side:
        side = math.copysign(1.0, radius * ((far - first) * left.conjugate()).real)
    if not side:
        raise ValueError(f"{kind} needs RL or RR, the side of the contour")
    if kind == "LN":
        return first + length * side * left, None, True
    if radius == 0.0:
        raise ValueError(f"{kind} has no radius R")
    turn, size = side * math.copysign(1.0, radius), abs(radius)
    centre = first + size * turn * left
    arm, angle = first - centre, -math.radians(values.get("CCA", 0.0))
    if kind == "LCT":  # a straight line from `far` touches the circle
        distance = abs(far - centre)
        if distance < size:
            raise ValueError(f"no line touches a circle of radius {size:g} from {distance:.4g} from its centre")
        arm, angle = (far - centre) * size / distance, math.acos(size / distance)
    return centre + arm * cmath.exp(1j * turn * angle), centre, turn > 0.0


def run_approach(it: Interpreter, words: KlartextWords, rest: str, *, leaves: bool = False) -> None:
    """Execute APPR, whose moves are held until the first element of the contour, or DEP, which is APPR reversed."""
    what, plane, axis = "DEP" if leaves else "APPR", it.state.plane, words.tool_axis
    kind, text = match_form(r"P?(LT|LN|CT|LCT)\b\s*(.*)", rest, f"{what}: LT, LN, CT, LCT").groups()
    block, before = words.read(text), None if it.state.motion == 0.0 else it.motion.feed(0.0)
    if words.set_modes(block) and not leaves:
        raise InputError("an approach with FMAX is not read; give it a feed")
    if NEEDED[kind] not in block.values:
        raise InputError(f"{what} {kind} has no {NEEDED[kind]}")
    feed, side = it.motion.feed(0.0), {"L": 1.0, "R": -1.0, "": 0.0}[words.side]
    one, other = PLANE_AXES[plane]

    def flatten(point: Point) -> complex:
        return complex(point[one], point[other])

    def lift(place: complex, level: Point) -> Point:
        return set_levels(level, {one: place.real, other: place.imag})

    def go(start: Point, end: Point, feed: float | None = feed, centre: complex | None = None, hand: bool = True,
           ) -> Element:  # fmt: skip
        about, normal = None if centre is None else lift(centre, end), orient(PLANE_NORMALS[plane], right_hand=hand)
        return Element(start, end, feed or 0.0, about, normal, rapid=feed is None)

    def approach(element: Element) -> list[Element]:
        direction = flatten(element.tangent(element.start))
        place, centre, hand = find_begin(kind, block.values, side, flatten(start), flatten(first), direction)
        begin, low, reach = lift(place, start), lift(place, first), feed if kind == "LCT" else before
        moves = [go(start, begin, reach), go(begin, low, reach), go(low, first, feed, centre, hand)]
        return [move for move in moves if math.dist(move.start, move.end) > 0.0]

    with words.functions(block):
        direction = flatten(it.motion.find_direction()) if leaves else 0j
        it.contour.refuse_open()
        if not leaves:
            it.course.begin_cut()
        start, first = it.contour.position, it.motion.target(block)[0]
        height = first[axis] - start[axis]
        if not leaves:
            if abs(height) > 1e-9:
                it.note("an approach with a depth goes there before the contour; newer controls sink on the way")
            it.contour.wait(approach, first)
            return
        end, last = flatten(first), flatten(start)
        far = end if kind == "LCT" else last
        place, centre, hand = find_begin(kind, block.values, -side, far, last, -direction)
        it.contour.add(go(start, lift(place, start), feed, centre, centre is None or not hand))
        if kind == "LCT":
            it.contour.add(go(lift(place, start), lift(end, start)))
        if abs(height) > 1e-9:
            low = it.contour.position
            it.contour.add(Element(low, set_levels(low, {axis: first[axis]}), feed))
        words.side, it.state.motion = "", 1.0
