"""Contours with roundings and chamfers: an element before a corner is held until the next element is known."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine, cross, dot, normalise, orient
from compplan.toolpath.readers.cnc.course import Course

#: Least change of direction of a corner. [rad]
STRAIGHT = 1e-6
#: Greatest component of a tangent normal to the plane of a corner.
LEANING = 1e-6


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
    """Corner of a contour: ROUND (radius), LEG (from the corner to each end of a chamfer) or CHAMFER (its length).

    A modal corner is omitted if no cut follows.
    """

    kind: str
    size: float
    feed: float | None
    line: int
    modal: bool = False


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
                raise InputError(f"{fault}, in the corner of line {held_corner.line}") from None
            self._put(first)
            if between is not None:
                self._put(between)
        if corner is not None:
            self.held = element, corner
        else:
            self._put(element)

    def refuse_open(self) -> None:
        """Refuse a corner or an approach without a following cut; output an element held for a modal corner."""
        if self.held is not None and self.held[1].modal:
            element, self.held = self.held[0], None
            self._put(element)
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
    """Return two trimmed elements and the corner element between them; raise a ValueError if the corner does not fit.

    Two lines with a change of direction t are trimmed by r tan(t / 2) for a radius r, and c / (2 cos(t / 2)) for a
    chamfer of length c. With arcs, the centre of the rounding is the intersection of both elements offset inwards by r.
    """
    point, normal = before.end, after.normal if after.centre is not None else before.normal
    one, other = before.tangent(point), after.tangent(point)
    lines = before.centre is None and after.centre is None
    across = cross(one, other)
    turn = math.atan2(math.hypot(*across), dot(one, other))
    if before.axis is not None or after.axis is not None:
        raise ValueError("the tool turns beside a rounded or cut corner, which is not read")
    if turn < STRAIGHT or corner.size == 0.0:
        return before, None, after
    if turn > math.radians(179.9):
        raise ValueError("the path turns back at this corner")
    if corner.size < 0.0:
        raise ValueError(f"a corner of {corner.size:g}, expected a size above 0")
    feed = before.feed if corner.feed is None else corner.feed
    if lines:
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
    else:
        if corner.kind != "ROUND" or max(abs(dot(one, normal)), abs(dot(other, normal))) > LEANING:
            raise ValueError("a chamfer beside an arc, or a corner out of the plane of its arc, is not read")
        normal = orient(normal, right_hand=dot(across, normal) > 0.0)
        middle, first, last = _find_rounding(before, after, corner.size, normal)
    joint = Element(first, last, feed, middle, normal)
    return replace(before, end=first), joint, replace(after, start=last)


#: Line (point, direction) or circle (centre, radius); points of the plane are complex numbers.
Flat = tuple[complex, complex | float]


def _find_rounding(before: Element, after: Element, radius: float, normal: Point) -> tuple[Point, Point, Point]:
    """Return centre, start and end of the arc of given radius tangent to two elements on the inside of their corner.

    The corner turns right-handed about `normal`.
    """
    corner, u = before.end, before.tangent(before.end)
    v = cross(normal, u)

    def flatten(place: Point) -> complex:
        arm = combine(1.0, place, -1.0, corner)
        return complex(dot(arm, u), dot(arm, v))

    def move_inwards(element: Element) -> Flat:
        if element.centre is None:
            way = flatten(combine(1.0, corner, 1.0, element.tangent(corner)))
            return 1j * radius * way, way
        centre = flatten(element.centre)
        return centre, abs(abs(centre) - radius * dot(element.normal, normal))

    def touch(element: Element, centre: complex) -> complex | None:
        """Return the tangent point of an arc about a centre on an element, None beyond its ends."""
        start, end = flatten(element.start), flatten(element.end)
        if element.centre is None:
            way = (end - start) / abs(end - start)
            along = ((centre - start) * way.conjugate()).real
            return start + along * way if -1e-6 <= along <= abs(end - start) + 1e-6 else None
        middle, sense = flatten(element.centre), dot(element.normal, normal)
        place = middle + (centre - middle) * abs(start - middle) / max(abs(centre - middle), 1e-12)
        part, whole = (sense * cmath.phase((to - middle) / (start - middle)) % math.tau for to in (place, end))
        whole = math.tau if element.turns > 1 or abs(end - start) < 1e-9 else whole
        return place if part <= whole + 1e-6 or abs(place - start) < 1e-6 else None

    found: list[tuple[float, list[complex]]] = []
    for centre in _intersect(move_inwards(before), move_inwards(after)):
        first, last = touch(before, centre), touch(after, centre)
        if first is not None and last is not None:
            found.append((abs(centre), [centre, first, last]))
    if not found:
        raise ValueError(f"a rounding of radius {radius:g} does not fit between its elements")
    nearest = min(found, key=lambda places: places[0])[1]
    places = [combine(1.0, combine(1.0, corner, z.real, u), z.imag, v) for z in nearest]
    return places[0], places[1], places[2]


def _intersect(one: Flat, other: Flat) -> list[complex]:
    """Return the intersections of two lines or circles; an empty list for two lines."""
    (start, way), (centre, radius) = (one, other) if isinstance(one[1], complex) else (other, one)
    if isinstance(radius, complex):
        return []
    to = start - centre
    if isinstance(way, complex):
        along = (to * way.conjugate()).real
        inside = along * along - (abs(to) ** 2 - radius**2)
        root = math.sqrt(max(inside, 0.0))
        return [start + t * way for t in (-along + root, -along - root)] if inside >= -1e-9 else []
    along = (abs(to) ** 2 + radius**2 - way**2) / (2.0 * abs(to)) if abs(to) > 1e-12 else math.inf
    across = math.sqrt(max(radius**2 - along**2, 0.0))
    return [centre + to / abs(to) * complex(along, s * across) for s in (1, -1)] if abs(along) <= radius + 1e-9 else []


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
