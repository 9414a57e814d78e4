"""Contours with rounded and cut corners: elements wait for the one after them where a corner lies between."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, centre_from_radius, combine, cross, dot, normalise
from compplan.toolpath.readers.cnc.course import Course

#: Angles below this count as none. [rad]
STRAIGHT = 1e-6


@dataclass(frozen=True)
class Element:
    """Hold a line (no centre) or an arc of a contour, in the coordinates of the program; feeds in mm/s.

    `named` are the axes of the end that are absolute coordinates. An arc turns about its normal, by the right hand or
    against it, for at most a full circle and further `turns` beyond the first. `axis` is the tool axis at the end, in
    the part (None: it stays); `run` puts down an element on which rotary axes turn.
    """

    start: Point
    end: Point
    named: tuple[int, ...]
    feed: float
    line: int
    centre: Point | None = None
    normal: Point = (0.0, 0.0, 1.0)
    right_hand: bool = True
    turns: int = 1
    axis: Point | None = None
    run: Callable[[], None] | None = None

    def tangent(self, place: Point) -> Point:
        """Return the direction of travel at a point of the element."""
        if self.centre is None:
            return _unit(combine(1.0, self.end, -1.0, self.start))
        along = cross(self.normal, combine(1.0, place, -1.0, self.centre))
        return _unit(along if self.right_hand else (-along[0], -along[1], -along[2]))


@dataclass(frozen=True)
class Corner:
    """Hold a corner: ROUND (radius), LEG (from the corner to either end of the chamfer) or CHAMFER (its length)."""

    kind: str
    size: float
    feed: float | None
    line: int


class Contour:
    """Hold the element that a corner ends, until the next one comes."""

    def __init__(self, course: Course, unit: str = " mm") -> None:
        self.course, self.unit = course, unit
        self.held: tuple[Element, Corner] | None = None

    @property
    def position(self) -> Point:
        """Where the next element begins, in the coordinates of the program."""
        return self.held[0].end if self.held else self.course.position

    def add(self, element: Element, corner: Corner | None = None) -> None:
        """Take an element, and the corner at its end."""
        if self.held is not None:
            before, asked = self.held
            self.held = None
            try:
                first, between, element = join_corner(before, asked, element, self.unit)
            except ValueError as fault:
                raise InputError(f"{fault}, in the corner of line {asked.line}") from None
            self._put(first)
            if between is not None:
                self._put(between)
        if corner is not None:
            self.held = element, corner
        else:
            self._put(element)

    def refuse_open(self) -> None:
        """Refuse a corner that no cut follows."""
        if self.held is not None:
            raise InputError(f"the rounded or cut corner of line {self.held[1].line} has no cutting move after it")

    def _put(self, element: Element) -> None:
        course = self.course
        if element.run is not None:
            element.run()
        elif element.centre is None:
            course.line(element.end, element.named, element.feed, element.axis)
        else:
            about = (element.centre, element.normal, element.right_hand, element.turns)
            course.arc(element.end, element.named, element.feed, *about)


def join_corner(
    before: Element, corner: Corner, after: Element, unit: str = ""
) -> tuple[Element, Element | None, Element]:
    """Return two lines cut back to a corner between them, and what joins them; ValueError if no such corner fits.

    Lines turning by t lose r tan(t / 2) each to a rounding of radius r, and c / (2 cos(t / 2)) to a chamfer of length
    c. `unit` is that of messages, "" where it depends on the program.
    """
    point, one, other = before.end, before.tangent(before.end), after.tangent(before.end)
    across = cross(one, other)
    turn = math.atan2(math.hypot(*across), dot(one, other))
    if before.axis is not None or after.axis is not None:
        raise ValueError("the tool turns beside a rounded or cut corner, which is not read")
    if turn < STRAIGHT or corner.size == 0.0:
        return before, None, after
    if before.centre is not None or after.centre is not None:
        raise ValueError("a rounded or cut corner beside an arc is not read; post-process it as an arc of its own")
    if turn > math.radians(179.9):
        raise ValueError("the path turns back at this corner")
    if corner.size < 0.0:
        raise ValueError(f"a corner of {corner.size:g}{unit}, expected a size above 0")
    reach = {
        "ROUND": corner.size * math.tan(0.5 * turn), "LEG": corner.size,
        "CHAMFER": 0.5 * corner.size / math.cos(0.5 * turn),
    }[corner.kind]  # fmt: skip
    shortest = min(math.dist(before.start, point), math.dist(point, after.end))
    if reach > shortest + 1e-6:
        raise ValueError(f"a corner of {corner.size:g}{unit} takes {reach:g}{unit} of moves of {shortest:g}{unit}")
    normal = normalise(across)
    first, last = combine(1.0, point, -reach, one), combine(1.0, point, reach, other)
    middle = combine(1.0, first, corner.size, cross(normal, one)) if corner.kind == "ROUND" else None
    feed = before.feed if corner.feed is None else corner.feed
    joint = Element(first, last, before.named, feed, corner.line, middle, normal)
    return replace(before, end=first), joint, replace(after, start=last)


def find_tangent_arc(start: Point, direction: Point, end: Point, normal: Point) -> tuple[Point, bool] | None:
    """Return centre and sense of the arc that leaves along a direction and ends at a point; None where it is straight.

    Direction and normal of the plane are unit vectors.
    """
    travel = combine(1.0, end, -1.0, start)
    travel = combine(1.0, travel, -dot(travel, normal), normal)
    left = cross(normal, direction)
    aside = dot(travel, left)
    if abs(aside) < 1e-9 * max(1.0, math.hypot(*travel)):
        return None
    radius = dot(travel, travel) / (2.0 * aside)
    return combine(1.0, start, radius, left), radius > 0.0


def find_centre(start: Point, end: Point, normal: Point, radius: float, unit: str, *, right_hand: bool) -> Point:
    """Return the centre of an arc that is given by its radius (negative: the longer of the two); else a ValueError."""
    centre = centre_from_radius(start, end, normal, radius, right_hand=right_hand)
    if centre is None:
        travel = combine(1.0, end, -1.0, start)
        far = math.hypot(*combine(1.0, travel, -dot(travel, normal), normal))
        raise ValueError(f"arc of radius R {radius:g}{unit} cannot join ends that are {far:g}{unit} apart, expected "
                         f"0 < distance <= {2 * abs(radius):g}{unit}")  # fmt: skip
    return centre


def _unit(vector: Point) -> Point:
    size = math.hypot(*vector)
    if size < 1e-12:
        raise ValueError("an element of the contour has no length")
    return vector[0] / size, vector[1] / size, vector[2] / size
