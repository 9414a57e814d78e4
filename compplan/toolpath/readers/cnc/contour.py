"""Contours with roundings and chamfers: an element before a corner is held until the next element is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine, cross, dot, normalise, orient
from compplan.toolpath.readers.cnc.course import Course

#: Least change of direction of a corner. [rad]
STRAIGHT = 1e-6


@dataclass(frozen=True)
class Element:
    """Line (no centre) or arc of a contour, in program coordinates [mm]; feed in mm/s.

    An arc rotates right-handed about its normal by at most a full circle, plus the `turns` beyond the first. `axis` is
    the tool axis at the end in the part (None: unchanged); `run` executes an element on which rotary axes turn.
    """

    start: Point
    end: Point
    feed: float
    centre: Point | None = None
    normal: Point = (0.0, 0.0, 1.0)
    turns: int = 1
    axis: Point | None = None
    rapid: bool = False
    run: Callable[[], None] | None = None

    def tangent(self, place: Point) -> Point:
        """Return the unit tangent at a point of the element."""
        if self.centre is None:
            return normalise(combine(1.0, self.end, -1.0, self.start))
        return normalise(cross(self.normal, combine(1.0, place, -1.0, self.centre)))


@dataclass(frozen=True)
class Corner:
    """Corner of a contour: ROUND (radius), LEG (from the corner to each end of a chamfer) or CHAMFER (its length)."""

    kind: str
    size: float
    feed: float | None
    line: int


Approach = Callable[[Element], list[Element]]


class Contour:
    """Buffer of an approach or an element with a corner at its end, until the next element is known."""

    def __init__(self, course: Course) -> None:
        self.course = course
        self.held: tuple[Element, Corner] | None = None
        self.approach: Approach | None = None
        self.target: Point = (0.0, 0.0, 0.0)
        self.first = 0

    @property
    def position(self) -> Point:
        """Start of the next element, in program coordinates [mm]."""
        if self.approach is not None:
            return self.target
        return self.held[0].end if self.held else self.course.position

    @property
    def idle(self) -> bool:
        """Whether neither an element nor an approach is held."""
        return self.held is None and self.approach is None

    def wait(self, approach: Approach, target: Point) -> None:
        """Hold an approach to a point until the first element of the contour."""
        self.approach, self.target, self.first = approach, target, self.course.reader.line

    def add(self, element: Element, corner: Corner | None = None) -> None:
        """Add an element, with the corner at its end if there is one."""
        if self.approach is not None:
            approach, self.approach = self.approach, None
            for piece in approach(element):
                self._put(piece)
        if self.held is not None:
            before, held_corner = self.held
            self.held = None
            try:
                first, between, element = join_corner(before, held_corner, element)
            except ValueError as fault:
                raise InputError(f"corner of line {held_corner.line}: {fault}") from None
            self._put(first)
            if between is not None:
                self._put(between)
        if corner is not None:
            self.held = element, corner
        else:
            self._put(element)

    def refuse_open(self) -> None:
        """Refuse a corner or an approach without a following cut."""
        if self.held is not None:
            raise InputError(f"the rounded or cut corner of line {self.held[1].line} has no cutting move after it")
        if self.approach is not None:
            raise InputError(f"the approach of line {self.first} has no contour after it")

    def _put(self, element: Element) -> None:
        course = self.course
        if element.rapid:
            course.rapid(element.end, range(3), element.axis)
        elif element.run is not None:
            element.run()
        elif element.centre is None:
            course.line(element.end, element.feed, element.axis)
        else:
            course.arc(element.end, element.feed, element.centre, element.normal, element.turns)


def join_corner(before: Element, corner: Corner, after: Element) -> tuple[Element, Element | None, Element]:
    """Return two trimmed lines and the corner element between them; raise a ValueError if the corner does not fit.

    With a change of direction t they are trimmed by r tan(t / 2) for a radius r, and c / (2 cos(t / 2)) for a chamfer
    of length c.
    """
    point = before.end
    one, other = before.tangent(point), after.tangent(point)
    across = cross(one, other)
    turn = math.atan2(math.hypot(*across), dot(one, other))
    if before.axis is not None or after.axis is not None:
        raise ValueError("the tool turns beside a rounded or cut corner, which is not read")
    if turn < STRAIGHT or corner.size == 0.0:
        return before, None, after
    if before.centre is not None or after.centre is not None:
        raise ValueError(
            "it is beside an arc, which is not read; post-process the corner as an arc or a line of its own"
        )
    if turn > math.radians(179.9):
        raise ValueError("the path turns back at this corner")
    if corner.size < 0.0:
        raise ValueError(f"a corner of {corner.size:g}, expected a size above 0")
    normal = normalise(across)
    reach = {
        "ROUND": corner.size * math.tan(0.5 * turn), "LEG": corner.size,
        "CHAMFER": 0.5 * corner.size / math.cos(0.5 * turn),
    }[corner.kind]  # fmt: skip
    shortest = min(math.dist(before.start, point), math.dist(point, after.end))
    if reach > shortest + 1e-6:
        raise ValueError(f"a corner of {corner.size:g} takes {reach:g} of moves of {shortest:g}")
    first, last = combine(1.0, point, -reach, one), combine(1.0, point, reach, other)
    middle = combine(1.0, first, corner.size, cross(normal, one)) if corner.kind == "ROUND" else None
    joint = Element(first, last, before.feed if corner.feed is None else corner.feed, middle, normal)
    return replace(before, end=first), joint, replace(after, start=last)


def find_tangent_arc(start: Point, direction: Point, end: Point, normal: Point) -> tuple[Point, Point] | None:
    """Return centre and right-hand axis of the arc with a given start direction and end point; None if straight.

    Direction and normal of the plane are unit vectors.
    """
    travel = combine(1.0, end, -1.0, start)
    travel = combine(1.0, travel, -dot(travel, normal), normal)
    left = cross(normal, direction)
    aside = dot(travel, left)
    if abs(aside) < 1e-9 * max(1.0, math.hypot(*travel)):
        return None
    radius = dot(travel, travel) / (2.0 * aside)
    return combine(1.0, start, radius, left), orient(normal, right_hand=radius > 0.0)
