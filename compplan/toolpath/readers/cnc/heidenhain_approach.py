"""APPR and DEP of Heidenhain programs: how a contour is approached and left. All of it lies in the working plane."""

from __future__ import annotations

import math
from collections.abc import Mapping

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine, cross, dot
from compplan.toolpath.readers.cnc.contour import Element
from compplan.toolpath.readers.cnc.heidenhain_words import KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.frames import PLANE_NORMALS
from compplan.toolpath.readers.lines import match_form

#: The word that each way must have: straight along the tangent or the normal, on an arc, on a line and an arc.
NEEDED = {"LT": "LEN", "LN": "LEN", "CT": "CCA", "LCT": "R"}


def find_begin(kind: str, values: Mapping[str, float], side: float, normal: Point, far: Point, first: Point,
               direction: Point) -> tuple[Point, Point | None, bool]:  # fmt: skip
    """Return where the way to a contour begins, and centre and sense of its arc; ValueError without any.

    The tool comes from `far`, the contour leaves its first point in `direction`; the tool runs left (1) or right (-1)
    of it. RL with R > 0 turns counter-clockwise. A departure is the same way driven back.
    """
    left, radius = cross(normal, direction), values.get("R", 0.0)
    if kind == "LT":
        return combine(1.0, first, -values["LEN"], direction), None, True
    if kind == "LCT" and not side:
        side = math.copysign(1.0, radius * dot(combine(1.0, far, -1.0, first), left))
    if not side:
        raise ValueError(f"{kind} without RL or RR does not say to which side of the contour it goes")
    if kind == "LN":
        return combine(1.0, first, values["LEN"] * side, left), None, True
    if radius == 0.0:
        raise ValueError(f"{kind} has no radius R")
    turn, size = side * math.copysign(1.0, radius), abs(radius)
    centre = combine(1.0, first, size * turn, left)
    if kind == "CT":
        arm, angle = combine(1.0, first, -1.0, centre), -turn * math.radians(values["CCA"])
    else:  # a straight line from `far` touches the circle
        arm = combine(1.0, far, -1.0, centre)
        arm = combine(1.0, arm, -dot(arm, normal), normal)
        distance = math.hypot(*arm)
        if distance < size:
            raise ValueError(f"no line touches a circle of radius {size:g} from {distance:.4g} from its centre")
        arm, angle = combine(size / distance, arm, 0.0, arm), turn * math.acos(size / distance)
    begin = combine(1.0, combine(1.0, centre, math.cos(angle), arm), math.sin(angle), cross(normal, arm))
    return begin, centre, turn > 0.0


def run_approach(it: Interpreter, words: KlartextWords, rest: str, *, leaves: bool = False) -> None:
    """Carry out APPR, whose moves wait for the first element of the contour, or DEP, which leaves the contour."""
    what, normal, line, axis = "DEP" if leaves else "APPR", PLANE_NORMALS[it.state.plane], it.flow.line, words.tool_axis
    kind, text = match_form(r"P?(LT|LN|CT|LCT)\b\s*(.*)", rest, f"{what}: LT, LN, CT, LCT").groups()
    block, before = words.read(text), None if it.state.motion == 0.0 else it.motion.feed(0.0)
    if words.take_modes(block) and not leaves:
        raise InputError("an approach with FMAX is not read; give it a feed")
    if NEEDED[kind] not in block.values:
        raise InputError(f"{what} {kind} has no {NEEDED[kind]}")
    feed, side = it.motion.feed(0.0), {"L": 1.0, "R": -1.0, "": 0.0}[words.side]

    def go(start: Point, end: Point, feed: float | None = feed, centre: Point | None = None, hand: bool = True,
           ) -> Element:  # fmt: skip
        return Element(start, end, (0, 1, 2), feed or 0.0, line, centre, normal, hand, rapid=feed is None)

    def approach(element: Element) -> list[Element]:
        flat, direction = combine(1.0, first, -1.0, depth), element.tangent(element.start)
        begin, centre, hand = find_begin(kind, block.values, side, normal, start, flat, direction)
        low, about = combine(1.0, begin, 1.0, depth), centre and combine(1.0, centre, 1.0, depth)
        reach = feed if kind == "LCT" else before
        moves = [go(start, begin, reach), go(begin, low, reach), go(low, first, feed, about, hand)]
        return [move for move in moves if math.dist(move.start, move.end) > 0.0]

    with words.functions(block):
        direction = it.motion.find_direction() if leaves else normal
        it.contour.refuse_open()
        if not leaves:
            it.course.begin_cut()
        start, first = it.contour.position, it.motion.target(block)[0]
        height = first[axis] - start[axis]
        depth = combine(height, normal, 0.0, normal)
        if not leaves:
            if abs(height) > 1e-9:
                it.note("an approach with a depth goes there before it touches the contour; newer controls sink on "
                        "the way")  # fmt: skip
            it.contour.wait(approach, first, line)
            return
        back, end = combine(-1.0, direction, 0.0, direction), combine(1.0, first, -1.0, depth)
        far = end if kind == "LCT" else start
        place, centre, hand = find_begin(kind, block.values, -side, normal, far, start, back)
        ways = [go(start, place, feed, centre, centre is None or not hand), *([go(place, end)] if far is end else [])]
        for element in ways:
            it.contour.add(element)
        if abs(height) > 1e-9:
            place = it.contour.position
            it.contour.add(Element(place, combine(1.0, place, 1.0, depth), (), feed, line))
        words.side, it.state.motion = "", 1.0
