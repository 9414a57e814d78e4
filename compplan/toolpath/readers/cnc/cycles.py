"""Drilling cycles: the geometry of holes and of patterns of holes, which all dialects share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, set_level
from compplan.toolpath.readers.cnc.course import Course

#: Greatest number of holes of one block or pattern, and of pecks of one hole.
MOST_HOLES = 10_000
MOST_PECKS = 10_000
#: How far a deep-hole cycle stays above the depth before when it comes back (G83) or goes back (G73). [mm]
PECK_CLEARANCE_MM = 0.254
#: Least depth of a last peck of its own (at most a tenth of a peck): less remains where a file rounds Q to 0.001 mm or
#: 0.0001 inch; assumed. [mm]
LEAST_PECK_MM = 0.005
SKIPPED = "is left out: the tool moves rapidly above the holes (option cycles)"


@dataclass
class Hole:
    """Hold a hole along an axis of the program (0 to 2), from the level at which the feed begins to its bottom.

    Args:
        top: Level that the tool goes back to.
        feed, out: Feed, and feed back to `clear`, None where the tool leaves the hole rapidly. [mm/s]
        pecks: Levels on the way to the bottom.
        lifts: Whether the tool leaves the hole after each of them, else it goes back a little.
        by_clear: Whether a rapid way out stops at `clear`.
        wait: Dwell at the bottom. [s]
        turn: Sense of the spindle at the bottom and above (tapping), "" where it stays, at its speed [1/min].

    """

    axis: int
    clear: float
    bottom: float
    top: float
    feed: float
    out: float | None = None
    pecks: Sequence[float] = ()
    lifts: bool = False
    by_clear: bool = False
    wait: float = 0.0
    turn: tuple[str, str] = ("", "")
    speed: float = 0.0


def drill(course: Course, hole: Hole, *, expand: bool, name: str) -> None:
    """Carry out a hole where the tool is: rapidly to its clear level, down with feed, and back; else go back alone."""
    log, line = course.log, course.reader.line
    if expand:
        course.rapid(set_level(course.position, hole.axis, hole.clear), (hole.axis,))
        course.begin_cut()
        if not course.leave_out(set_level(course.position, hole.axis, hole.bottom)):
            _cut_hole(course, hole)
            if hole.turn[1]:
                log.happen(hole.turn[1], line, value=hole.speed)
    else:
        course.note(f"drilling cycle {name} {SKIPPED}")
    course.rapid(set_level(course.position, hole.axis, hole.top), (hole.axis,))


def _cut_hole(course: Course, hole: Hole) -> None:
    """Cut a hole from its clear level to its bottom, in pecks where the cycle has them."""
    place, log, line = course.position, course.log, course.reader.line

    def at(level: float) -> Point:
        return set_level(place, hole.axis, level)

    for deeper in (*hole.pecks, hole.bottom):
        course.line(at(deeper), (), hole.feed)
        if deeper != hole.bottom:
            back = min(deeper + PECK_CLEARANCE_MM, hole.clear)
            course.rapid(at(hole.clear if hole.lifts else back))
            if hole.lifts:
                course.rapid(at(back))
    if hole.wait > 0.0:
        log.happen("dwell", line, value=hole.wait)
    if hole.turn[0]:
        log.happen(hole.turn[0], line, value=hole.speed)
    if hole.out is not None:
        course.line(at(hole.clear), (), hole.out)
    elif hole.by_clear:
        course.rapid(at(hole.clear))


def list_pecks(clear: float, bottom: float, first: float, less: float, least: float) -> list[float]:
    """Return the levels of the pecks of a hole: of `first`, each by `less` shorter, none shorter than `least`."""
    if (clear - bottom) / max(least, 1e-9) > MOST_PECKS:
        raise InputError(f"a hole of more than {MOST_PECKS} pecks, of {least:g} mm")
    depths, peck = [clear], first
    while depths[-1] - peck > bottom + min(LEAST_PECK_MM, 0.1 * peck):
        depths.append(depths[-1] - peck)
        peck = max(peck - less, least)
    return depths[1:]


def list_circle(centre: tuple[float, float], radius: float, start: float, step: float, count: int) -> list[Point]:
    """List holes on a circle; angles in degrees."""
    angles = [math.radians(start + step * i) for i in range(_check(count))]
    return [(centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle), 0.0) for angle in angles]


def list_grid(corner: tuple[float, float], turn: float, steps: tuple[float, float], counts: tuple[int, int],
              first: float = 0.0) -> list[Point]:  # fmt: skip
    """List holes in rows, to and fro; the rows turn about the corner by an angle in degrees."""
    cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    places: list[Point] = []
    _check(counts[0] * counts[1])
    for row in range(counts[1]):
        for column in range(counts[0]) if row % 2 == 0 else reversed(range(counts[0])):
            u, v = first + column * steps[0], row * steps[1]
            places.append((corner[0] + u * cosine - v * sine, corner[1] + u * sine + v * cosine, 0.0))
    return places


def _check(count: int) -> int:
    if not 0 < count <= MOST_HOLES:
        raise InputError(f"pattern of {count} holes, 1 to {MOST_HOLES} are read")
    return count
