"""Drilling cycles of Heidenhain programs: 1, 2, 17, 200 to 209 and 240, patterns 220 and 221."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, set_level
from compplan.toolpath.readers.cnc.cycles import SKIPPED, Hole, drill, list_circle, list_grid
from compplan.toolpath.readers.cnc.heidenhain_frames import KlartextDatums
from compplan.toolpath.readers.cnc.heidenhain_words import ASSIGN, CYCLE, NUMBER, VALUE, KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import PLANE_AXES

#: Drilling cycles, and whether the tool leaves the hole with the feed.
DRILLING = {200: False, 201: True, 202: True, 203: False, 205: False, 206: True, 207: True, 209: True,
            240: False}  # fmt: skip
OLD_DRILLING = {1: False, 2: True, 17: True}
#: Cycles that say nothing of the path.
SILENT = {13, 32, 239, 332, 392}
#: Rapid retraction, written as a feed. [mm/min]
FASTEST = 99999.0
CYCLE_VALUE = re.compile(rf"(Q\d+)\s*=\s*({VALUE}|F?MAX|F?AUTO|PREDEF)")


@dataclass
class Cycle:
    """Hold a cycle that is defined: its number, the values of its Q parameters, or those of its parts (1.1, 1.2)."""

    number: int
    values: dict[str, float] = field(default_factory=dict)
    parts: dict[int, float] = field(default_factory=dict)

    def get(self, name: str) -> float:
        """Return a value that the cycle must have."""
        if name not in self.values:
            raise InputError(f"cycle {self.number} has no {name}")
        return self.values[name]

    def part(self, number: int) -> float:
        """Return a part that the cycle must have."""
        if number not in self.parts:
            raise InputError(f"CYCL DEF {self.number} has no part {self.number}.{number}")
        return self.parts[number]


class HeidenhainCycles:
    """Define and carry out cycles."""

    def __init__(self, it: Interpreter, datums: KlartextDatums, words: KlartextWords) -> None:
        self.it, self.datums, self.words, self.to_mm_s = it, datums, words, words.to_mm_s
        self.cycle: Cycle | None = None
        #: Whether lines with values of a cycle may follow.
        self.defining = False

    def define(self, text: str) -> None:
        """Carry out CYCL DEF."""
        found = CYCLE.match(text)
        if not found:
            raise InputError(f"cycle {text[:30]!r} is not read, expected CYCL DEF and its number")
        number, part, rest = int(found.group(1)), found.group(2), found.group(3).strip()
        at = None if part is None else int(part)
        if self.datums.define(number, at, rest) or number in SILENT:
            return
        if number == 9:
            waits = re.search(rf"({NUMBER})\s*$", rest)
            if at and waits:
                self.it.log.happen("dwell", self.it.flow.line, value=self.words.value(waits.group(1)))
        elif number in DRILLING or number in (220, 221):
            values = {name: self._read_value(value) for name, value in CYCLE_VALUE.findall(rest)}
            self.words.values.update(values)
            self.defining = True
            if number in (220, 221):
                self._drill_pattern(Cycle(number, values))
            else:
                self.cycle = Cycle(number, values)
        elif number in OLD_DRILLING:
            if not at or self.cycle is None or self.cycle.number != number:
                self.cycle = Cycle(number)
            value = re.search(rf"([-+]?\s*{NUMBER}|Q\d+)\s*$", rest)
            if at and value:
                self.cycle.parts[at] = self.words.value(value.group(1))
        else:
            raise InputError(f"CYCL DEF {number} is not read; write its moves out in the CAM system")

    def add_value(self, text: str) -> None:
        """Take a value that stands on a line of its own after its cycle."""
        found = ASSIGN.match(text)
        if found and self.cycle is not None:
            self.cycle.values[found.group(1)] = self._read_value(found.group(2).strip())

    def _read_value(self, text: str) -> float:
        if text.endswith("MAX"):
            return FASTEST
        if text.endswith("AUTO"):
            return (self.words.tool_feed or 0.0) / self.to_mm_s(1.0)
        if text == "PREDEF":
            raise InputError("values from GLOBAL DEF (PREDEF) are not read; write them out")
        return self.words.value(text)

    def call(self) -> None:
        """Drill where the tool is."""
        self.it.contour.refuse_open()
        if self.cycle is None:
            raise InputError("a cycle is called, and none that is read is defined")
        with self.it.log.hole():
            if self.cycle.number in OLD_DRILLING:
                self._drill_old(self.cycle)
            else:
                self._drill(self.cycle)

    def call_at(self, place: Point) -> None:
        """Drill at a place; its height counts on top of the cycle's surface."""
        cycle = self._need_new("CYCL CALL at positions needs a cycle from 200")
        surface = cycle.values.get("Q203", 0.0) + place[self.words.tool_axis]
        self._rapid_over(place)
        with self.it.log.hole():
            self._drill(Cycle(cycle.number, {**cycle.values, "Q203": surface}))

    def _need_new(self, message: str) -> Cycle:
        if self.cycle is None or self.cycle.number in OLD_DRILLING:
            raise InputError(message)
        return self.cycle

    def _rapid_over(self, place: Point) -> None:
        """Go rapidly above a place, at the height where the tool is."""
        height = self.it.course.position[self.words.tool_axis]
        self.it.course.rapid(set_level(place, self.words.tool_axis, height), PLANE_AXES[self.it.state.plane])

    def _drill(self, cycle: Cycle) -> None:
        """Carry out a cycle from 200: to the clearance Q200 above the surface Q203, with Q206 by Q201, back."""
        values, course, axis = cycle.values, self.it.course, self.words.tool_axis
        surface, clear, depth = values.get("Q203", 0.0), cycle.get("Q200"), cycle.get("Q201")
        if cycle.number == 240 and values.get("Q343", 0.0) != 0.0:
            raise InputError("cycle 240 with a diameter (Q343=1) is not read; give it a depth")
        feed, out = self._find_feeds(cycle)
        first, bottom = surface + clear, surface + depth
        top = max(first, surface + values.get("Q204", 0.0))
        course.rapid(set_level(course.position, axis, first), (axis,))
        expand = self.it.options.cycles == "expand" and depth != 0.0
        if depth != 0.0:
            hole = Hole(axis, first, bottom, top, feed, out if DRILLING[cycle.number] else None, by_clear=True)
            drill(course, hole, expand=expand, name=str(cycle.number))
        else:
            course.rapid(set_level(course.position, axis, top), (axis,))
        self.it.state.motion = 0.0

    def _find_feeds(self, cycle: Cycle) -> tuple[float, float | None]:
        """Return feed into and out of a hole in mm/s, None where it is left rapidly."""
        if cycle.number in (207, 209):
            feed = abs(cycle.get("Q239")) * self.words.unit * self.it.state.spindle / 60.0
            return feed, feed
        feed = self.to_mm_s(cycle.get("Q206"))
        back = cycle.values.get("Q208", 0.0) if cycle.number in (201, 202) else 0.0
        return feed, None if back >= FASTEST else self.to_mm_s(back) if back > 0.0 else feed

    def _drill_old(self, cycle: Cycle) -> None:
        """Carry out cycles 1, 2 and 17: from the level where the tool is, by set-up clearance and depth."""
        way = abs(cycle.part(1)) + abs(cycle.part(2))
        if cycle.number == 17:
            feed = abs(cycle.part(3)) * self.words.unit * self.it.state.spindle / 60.0
        else:
            feed = self.to_mm_s(cycle.part(5 if cycle.number == 1 else 4))
        if cycle.part(2) > 0.0 and cycle.part(1) >= 0.0:
            raise InputError(f"CYCL DEF {cycle.number} with a depth above the surface is not read")
        course, axis = self.it.course, self.words.tool_axis
        if self.it.options.cycles != "expand":
            self.it.note(f"drilling cycle {cycle.number} {SKIPPED}")
            return
        start = course.position
        course.line(set_level(start, axis, start[axis] - way), (), feed)
        if OLD_DRILLING[cycle.number]:
            course.line(start, (), feed)
        else:
            course.rapid(start)

    def _drill_pattern(self, pattern: Cycle) -> None:
        """Carry out cycles 220 (holes on a circle) and 221 (holes in rows) with the cycle defined before."""
        n, course, axis = pattern.values, self.it.course, self.words.tool_axis
        cycle = self._need_new(f"cycle {pattern.number}, and no cycle from 200 is defined before it")
        if n.get("Q365", 0.0) != 0.0:
            raise InputError("cycle 220 with arcs between its holes (Q365=1) is not read")
        kept: dict[str, float] = {name: n[name] for name in ("Q200", "Q203", "Q204") if name in n}
        if n.get("Q301", 1.0) == 0.0:
            kept["Q204"] = 0.0
        first, second = PLANE_AXES[self.it.state.plane]
        for u, v, _ in _list_circle(pattern) if pattern.number == 220 else _list_rows(pattern):
            self._rapid_over(set_level(set_level((0.0, 0.0, 0.0), first, u), second, v))
            with self.it.log.hole():
                self._drill(Cycle(cycle.number, {**cycle.values, **kept}))
        top = n.get("Q203", 0.0) + n.get("Q204", 0.0)
        if top > course.position[axis]:
            course.rapid(set_level(course.position, axis, top), (axis,))


def _list_circle(n: Cycle) -> list[Point]:
    count, start = int(n.get("Q241")), n.get("Q245")
    span, step = n.values.get("Q246", 360.0) - start, n.values.get("Q247", 0.0)
    if step == 0.0:
        step = span / max(1, count if abs(abs(span) - 360.0) < 1e-9 else count - 1)
    return list_circle((n.get("Q216"), n.get("Q217")), 0.5 * n.get("Q244"), start, step, count)


def _list_rows(n: Cycle) -> list[Point]:
    counts = int(n.get("Q242")), int(n.get("Q243"))
    return list_grid((n.get("Q225"), n.get("Q226")), n.values.get("Q224", 0.0), (n.get("Q237"), n.get("Q238")), counts)
