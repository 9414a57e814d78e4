"""Arcs of APT files: CIRCLE and MOVARC in their dialects, GOFWD along a circle; their sense about the axis."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.apt_words import split_fields
from compplan.toolpath.readers.arcs import Arc, Point, arc_about, combine, cross, dot, fits_circle
from compplan.toolpath.readers.moves import MoveLog
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.start import find_start

INCH = 25.4
CLOCKWISE = {"CLW", "CLOCKWISE", "CW"}
ANTICLOCKWISE = {"CCLW", "CCW", "ANTICLOCKWISE", "COUNTERCLOCKWISE"}
#: Greatest number of turns of one arc.
MOST_TURNS = 10_000


@dataclass(frozen=True)
class Pending:
    """Hold an arc record until the point that ends it: a point of its axis [mm], the axis, sense, turns, radius."""

    centre: Point
    normal: Point
    right_hand: bool
    turns: int = 1
    radius: float | None = None


class ArcReader:
    """Hold what has been read so far, and cut arcs."""

    def __init__(self, file: Path, options: CamTable, *, flipped: bool) -> None:
        self.file, self.options, self.flipped = file, options, flipped
        self.log = MoveLog(options.chord_tolerance_mm, self)
        self.scale = INCH if options.unit == "inch" else 1.0
        self.unit = ""
        self.line = 0
        self.feed: float | None = None
        self.revolution_feed: float | None = None
        self.spindle = 0.0
        self.rapid = self.placed = self.nx = self.away = False
        self.arc: Pending | None = None
        self.direction: Point | None = None
        self.before: Point | None = None
        self.votes = [0, 0]

    def error(self, message: str) -> InputError:
        """Return an error at the record that is read."""
        return InputError(message, file=self.file, where=self.line)

    def begin_cut(self, axis: Point) -> None:
        """Let a cut begin where the tool is; refuse it where that is not known."""
        if self.placed:
            return
        reason = "after GOHOME" if self.away else "no FROM or RAPID comes before it"
        start = find_start(self.log.position, range(3), self.options.from_mm, reason)
        if self.log.waypoints:
            self.log.rapid(start, axis)
        else:
            self.log.place(start, axis)
        self.placed = True

    def _numbers(self, minor: str) -> list[float]:
        """Return the numbers of a record that may hold words as well."""
        return [field for field in split_fields(minor) if not isinstance(field, str)] if minor else []

    def _axis(self, vector: list[float]) -> Point:
        length = math.hypot(*vector)
        if len(vector) != 3 or not 1e-3 < length < 1e3:
            raise self.error(f"tool axis {vector} is no direction")
        return vector[0] / length, vector[1] / length, vector[2] / length

    def _speed(self) -> float:
        """Return the feed in mm/s, 0 where none is known."""
        feed = self.feed
        if self.revolution_feed is not None:
            feed = self.revolution_feed * self.spindle / 60.0 if self.spindle > 0.0 else None
        if feed is None:
            self.log.note("cutting moves before any feed have none", self.line)
        return feed or 0.0

    def _note_arc(self, words: str) -> None:
        """Keep an arc record until the GOTO that ends it."""
        if re.match(r"\s*[XYZIJKR]\s*,", words):
            self._cut_lettered(words)
            return
        if "(" in words:
            raise self.error(f"arc record {words[:40]!r} is not read, expected x, y, z, i, j, k, r")
        angle = re.search(r"ANGLE\s*,\s*([-+.\d]+)", words)
        times = re.search(r"TIMES\s*,\s*([\d.]+)", words)
        plain = re.sub(r",?\s*(ANGLE|TIMES)\s*,\s*[-+.\d]+", "", words).strip(", ")
        numbers = self._numbers(plain)
        if len(numbers) < 6:
            raise self.error(f"arc record with {len(numbers)} numbers, expected x, y, z, i, j, k, r")
        found = set(re.findall(r"[A-Z]+", plain))
        clockwise = bool(found & CLOCKWISE) or (not found & ANTICLOCKWISE and (self.nx or len(numbers) >= 11))
        if self.options.circle_sense != "auto":
            clockwise = self.options.circle_sense == "left_hand"
        count = float(times.group(1)) if times else 1.0
        if angle:
            count = abs(float(angle.group(1))) / 360.0 - 1e-6
        if count > MOST_TURNS:
            raise self.error(f"arc of {count:g} turns, at most {MOST_TURNS} are read")
        turns = math.ceil(count) if angle else int(count)
        radius = numbers[6] * self.scale if len(numbers) > 6 else None
        centre, normal = self._scaled(numbers), self._axis(numbers[3:6])
        self.arc = Pending(centre, normal, clockwise == self.flipped, max(1, turns), radius)

    def _cut_lettered(self, words: str) -> None:
        """Cut along CIRCLE/X,x,Y,y,Z,z,I,i,J,j,K,k[,CCLW]: end and centre from the start; clockwise."""
        pairs = re.findall(r"([XYZIJK])\s*,\s*([-+]?(?:\d+\.?\d*|\.\d+))", words)
        values = {letter: float(number) * self.scale for letter, number in pairs}
        if not values.keys() & set("IJK"):
            raise self.error(f"arc record {words[:40]!r} has no centre, expected I, i, J, j, K, k")
        self.begin_cut(self.log.axis)
        start = self.log.position
        x, y, z = (values.get(letter, old) for letter, old in zip("XYZ", start, strict=True))
        offset = (values.get("I", 0.0), values.get("J", 0.0), values.get("K", 0.0))
        anticlockwise = bool(set(re.findall(r"[A-Z]+", words)) & ANTICLOCKWISE)
        pending = Pending(combine(1.0, start, 1.0, offset), self.log.axis, anticlockwise)
        self._cut_arc(pending, start, (x, y, z), self.log.axis)

    def _follow_circle(self, words: str) -> None:
        """Read TLON,GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/x,y,z,x,y,z): the line ends where the arc ends (CATIA)."""
        circle = re.search(r"\(\s*CIRCLE\s*/([^()]*)\)", words)
        end = re.search(r"\(\s*(?:LINE|POINT)\s*/([^()]*)\)", words)
        centre = self._numbers(circle.group(1)) if circle else []
        last = self._numbers(end.group(1)) if end else []
        if len(centre) < 4 or len(last) < 3 or self.direction is None:
            message = f"motion {words[:40]!r} is not read, expected INDIRV and GOFWD/(CIRCLE/x,y,z,r),ON,(LINE/..)"
            raise self.error(message)
        self.begin_cut(self.log.axis)
        start, middle, normal = self.log.position, self._scaled(centre), self.log.axis
        right_hand = dot(cross(normal, combine(1.0, start, -1.0, middle)), self.direction) > 0.0
        self._cut_arc(Pending(middle, normal, right_hand), start, self._scaled(last[-3:]), normal)

    def _scaled(self, numbers: list[float]) -> Point:
        """Return the first three numbers as a point in millimetres."""
        return numbers[0] * self.scale, numbers[1] * self.scale, numbers[2] * self.scale

    def _cut_arc(self, pending: Pending, start: Point, end: Point, axis: Point) -> None:
        """Cut along an arc, and keep how it leaves for the arc after it."""
        arc = arc_about(start, end, pending.centre, pending.normal, right_hand=pending.right_hand, turns=pending.turns)
        if not fits_circle(arc.radius, arc.end_radius):
            message = f"arc starts {arc.radius:.4f} mm from its axis and ends {arc.end_radius:.4f} mm from it"
            raise self.error(f"{message}, expected the same radius")
        if pending.radius is not None and abs(pending.radius - arc.radius) > max(0.1, 0.02 * arc.radius):
            message = f"an arc record states the radius {pending.radius:g} mm, its points lie on {arc.radius:.4g} mm"
            self.log.note(f"{message}: the points are taken", self.line)
        self._vote(arc)
        self.log.arc(arc, end, self._speed())
        if max(abs(one - other) for one, other in zip(axis, self.log.axis, strict=True)) > 1e-6:
            self.log.note("the tool axis turns at the end of an arc, not along it", self.line)
            self.log.line(end, self._speed(), axis)
        self.before = arc.tangent(arc.sweep)

    def _vote(self, arc: Arc) -> None:
        """Count whether an arc goes on from the move before it, or turns back on it."""
        if self.before is None:
            return
        along = dot(arc.tangent(0.0), self.before)
        if abs(along) > 0.99:
            self.votes[0 if along > 0.0 else 1] += 1
