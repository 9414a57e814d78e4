"""Drilling cycles of Heidenhain programs: 1, 2, 17, 200 to 209 and 240, patterns 220 and 221."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.contour import Element
from compplan.toolpath.readers.heidenhain_contour import HeidenhainContourReader
from compplan.toolpath.readers.heidenhain_moves import PLANES
from compplan.toolpath.readers.heidenhain_words import ASSIGN, CYCLE, NUMBER, VALUE
from compplan.toolpath.readers.options import CamTable

#: Drilling cycles, and how the tool leaves the hole: rapidly, or with the feed.
DRILLING = {200: "rapid", 201: "feed", 202: "feed", 203: "rapid", 205: "rapid", 206: "feed", 207: "feed", 208: "rapid",
            209: "feed", 240: "rapid"}  # fmt: skip
OLD_DRILLING = {1: "rapid", 2: "feed", 17: "feed"}
#: Cycles that say nothing of the path.
SILENT = {13, 32, 239, 332, 392}
#: Rapid retraction, written as a feed. [mm/min]
FASTEST = 99999.0
MOST_HOLES = 10_000
CYCLE_VALUE = re.compile(rf"(Q\d+)\s*=\s*({VALUE}|F?MAX|F?AUTO|PREDEF)")
POSITION = re.compile(r"POS\s*\d+\s*\(([^()]*)\)")


@dataclass
class HeidenhainCycle:
    """Hold a cycle that is defined: its number, the values of its Q parameters, or those of its parts (1.1, 1.2)."""

    number: int
    values: dict[str, float] = field(default_factory=dict)
    parts: dict[int, float] = field(default_factory=dict)


class HeidenhainCycleReader(HeidenhainContourReader):
    """Define and carry out cycles."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.cycle: HeidenhainCycle | None = None
        self.defining = False
        self.points: list[Point] = []

    def define_cycle(self, text: str) -> None:
        """Carry out CYCL DEF."""
        found = CYCLE.match(text)
        if not found:
            raise self.error(f"cycle {text[:30]!r} is not read, expected CYCL DEF and its number")
        number, part, rest = int(found.group(1)), found.group(2), found.group(3).strip()
        at = None if part is None else int(part)
        if self.define_frame(number, at, rest) or number in SILENT:
            return
        if number == 9:
            waits = re.search(rf"({NUMBER})\s*$", rest)
            if at and waits:
                self.log.happen("dwell", self.line, value=self.value(waits.group(1)))
        elif number in DRILLING or number in (220, 221):
            self._define_new(number, rest)
        elif number in OLD_DRILLING:
            self._define_old(number, at or 0, rest)
        else:
            raise self.error(f"CYCL DEF {number} is not read; write its moves out in the CAM system")

    def _define_new(self, number: int, rest: str) -> None:
        cycle = HeidenhainCycle(number)
        for found in CYCLE_VALUE.finditer(rest):
            cycle.values[found.group(1)] = self._cycle_value(found.group(2))
        self.values.update(cycle.values)
        self.defining = True
        if number in (220, 221):
            self._drill_pattern(cycle)
        else:
            self.cycle = cycle

    def add_value(self, text: str) -> None:
        """Take a value that stands on a line of its own after its cycle."""
        found = ASSIGN.match(text)
        if found and self.cycle is not None:
            self.cycle.values[found.group(1)] = self._cycle_value(found.group(2).strip())

    def _cycle_value(self, text: str) -> float:
        if text.endswith("MAX"):
            return FASTEST
        if text.endswith("AUTO"):
            return (self.tool_feed or 0.0) * 60.0 / (self.to_mm_s(1.0) * 60.0)
        if text == "PREDEF":
            raise self.error("values from GLOBAL DEF (PREDEF) are not read; write them out")
        return self.value(text)

    def _define_old(self, number: int, part: int, rest: str) -> None:
        if part == 0 or self.cycle is None or self.cycle.number != number:
            self.cycle = HeidenhainCycle(number)
        found = re.search(rf"([-+]?\s*{NUMBER}|Q\d+)\s*$", rest)
        if part and found:
            self.cycle.parts[part] = self.value(found.group(1))

    def call_cycle(self) -> None:
        """Drill where the tool is."""
        self.contour.refuse_open()
        if self.cycle is None:
            raise self.error("a cycle is called, and none that is read is defined")
        if self.cycle.number in OLD_DRILLING:
            with self.log.hole():
                self._drill_old(self.cycle)
        else:
            self._drill(self.cycle)

    def run_call(self, text: str) -> None:
        """Carry out CYCL CALL, CYCL CALL POS and CYCL CALL PAT."""
        words = text.removeprefix("CYCL CALL").strip()
        if words.startswith("PAT"):
            self._call_at_points(words)
            return
        found, functions = self.split(words.removeprefix("POS"))
        self.start_functions(functions - {89, 99})
        self.take_feed(found)
        if words.startswith("POS"):
            self._drill_at(self.target(found)[0])
        else:
            self.call_cycle()
        self.calls = (self.calls or 89 in functions) and 99 not in functions
        self.stop_functions(functions)

    def _drill_at(self, place: Point) -> None:
        """Drill at a place; its height counts on top of the cycle's surface."""
        if self.cycle is None or self.cycle.number in OLD_DRILLING:
            raise self.error("CYCL CALL at positions needs a cycle from 200")
        values = dict(self.cycle.values)
        values["Q203"] = values.get("Q203", 0.0) + place[self.tool_axis]
        self._rapid_over(place)
        self._drill(HeidenhainCycle(self.cycle.number, values))

    def define_pattern(self, text: str) -> None:
        """Carry out PATTERN DEF with single positions."""
        if POSITION.sub("", text.removeprefix("PATTERN DEF")).strip():
            raise self.error(f"{text[:40]!r} is not read, only PATTERN DEF with POS is")
        self.points = [self.target(self.split(words)[0])[0] for words in POSITION.findall(text)]

    def _call_at_points(self, words: str) -> None:
        if not self.points:
            raise self.error("CYCL CALL PAT, and no pattern that is read is defined")
        _, functions = self.split(words.removeprefix("PAT"))
        self.start_functions(functions)
        for place in self.points:
            self._drill_at(place)
        self.stop_functions(functions)

    def _rapid_over(self, place: Point) -> None:
        """Go rapidly above a place, at the height where the tool is."""
        point, named = list(self.course.position), PLANES[self.tool_axis]
        for axis in named:
            point[axis] = place[axis]
        self.course.rapid((point[0], point[1], point[2]), named)

    def _level(self, height: float) -> Point:
        point = list(self.course.position)
        point[self.tool_axis] = height
        return point[0], point[1], point[2]

    def _drill(self, cycle: HeidenhainCycle) -> None:
        """Carry out a cycle from 200 as one hole."""
        with self.log.hole():
            self._cut_hole(cycle)

    def _cut_hole(self, cycle: HeidenhainCycle) -> None:
        """Carry out a cycle from 200: to the clearance Q200 above the surface Q203, with Q206 by Q201, back."""
        values = cycle.values
        try:
            surface, clear, depth = values.get("Q203", 0.0), values["Q200"], values["Q201"]
        except KeyError as missing:
            raise self.error(f"cycle {cycle.number} has no {missing.args[0]}") from None
        if cycle.number == 240 and values.get("Q343", 0.0) != 0.0:
            raise self.error("cycle 240 with a diameter (Q343=1) is not read; give it a depth")
        feed, out = self._cycle_feeds(cycle)
        first, bottom = surface + clear, surface + depth
        top = max(first, surface + values.get("Q204", 0.0))
        axis = (self.tool_axis,)
        self.course.rapid(self._level(first), axis)
        if self.options.cycles == "expand" and depth != 0.0:
            if cycle.number == 208:
                self._mill_bore(values, first, bottom, feed)
            else:
                self.course.line(self._level(bottom), axis, feed, self.line)
            if DRILLING[cycle.number] == "feed" and out is not None:
                self.course.line(self._level(first), axis, out, self.line)
            else:
                self.course.rapid(self._level(first), axis)
        elif depth != 0.0:
            self.log.note(f"drilling cycle {cycle.number} is left out: the tool moves rapidly above the holes "
                          "(option cycles)", self.line)  # fmt: skip
        self.course.rapid(self._level(top), axis)
        self.was_rapid = True

    def _cycle_feeds(self, cycle: HeidenhainCycle) -> tuple[float, float | None]:
        """Return feed into and out of a hole in mm/s, None where it is left rapidly."""
        values, number = cycle.values, cycle.number
        if number in (207, 209):
            if "Q239" not in values:
                raise self.error(f"cycle {number} has no Q239")
            feed = abs(values["Q239"]) * self.unit.scale * self.spindle / 60.0
            return feed, feed
        if "Q206" not in values:
            raise self.error(f"cycle {number} has no Q206")
        feed = self.to_mm_s(values["Q206"])
        if number in (201, 202):
            back = values.get("Q208", 0.0)
            return feed, None if back >= FASTEST else self.to_mm_s(back) if back > 0.0 else feed
        return feed, feed

    def _mill_bore(self, values: Mapping[str, float], first: float, bottom: float, feed: float) -> None:
        """Mill a bore on a helix (cycle 208): from its middle out, down, round the bottom, back to the middle."""
        radius = self.radii.get(self.tool)
        if radius is None:
            raise self.error("cycle 208 needs the radius of the tool (TOOL DEF n R), which the program does not state")
        reach = 0.5 * values.get("Q335", 0.0) - radius
        pitch = abs(values.get("Q334", 0.0))
        if reach <= 0.0 or pitch <= 0.0:
            raise self.error("cycle 208 needs a bore Q335 wider than the tool and an infeed Q334")
        middle = self.course.position
        one, _ = PLANES[self.tool_axis]
        begin = list(middle)
        begin[one] += reach
        normal = tuple(float(axis == self.tool_axis) for axis in range(3))
        self._cut((begin[0], begin[1], begin[2]), feed)
        turns = max(1, math.ceil((first - bottom) / pitch - 1e-9))
        for height, rounds in ((bottom, turns), (bottom, 1)):
            start, end = self.course.position, self._level(height)
            centre = list(start)
            centre[one] -= reach
            self.contour.add(Element(start, end, (), feed, self.line, (centre[0], centre[1], centre[2]),
                                     (normal[0], normal[1], normal[2]), True, rounds))  # fmt: skip
        back = list(middle)
        back[self.tool_axis] = bottom
        self._cut((back[0], back[1], back[2]), feed)

    def _cut(self, end: Point, feed: float) -> None:
        self.course.line(end, (), feed, self.line)

    def _drill_old(self, cycle: HeidenhainCycle) -> None:
        """Carry out cycles 1, 2 and 17: from the level where the tool is, by set-up clearance and depth."""
        parts = cycle.parts
        try:
            way = abs(parts[1]) + abs(parts[2])
            if cycle.number == 17:
                feed = abs(parts[3]) * self.unit.scale * self.spindle / 60.0
            else:
                feed = self.to_mm_s(parts[5 if cycle.number == 1 else 4])
        except KeyError as missing:
            raise self.error(f"CYCL DEF {cycle.number} has no part {cycle.number}.{missing.args[0]}") from None
        if parts[2] > 0.0 and parts[1] >= 0.0:
            raise self.error(f"CYCL DEF {cycle.number} with a depth above the surface is not read")
        start = self.course.position
        if self.options.cycles != "expand":
            self.log.note(f"drilling cycle {cycle.number} is left out: the tool moves rapidly above the holes "
                          "(option cycles)", self.line)  # fmt: skip
            return
        self.course.line(self._level(start[self.tool_axis] - way), (), feed, self.line)
        if OLD_DRILLING[cycle.number] == "feed":
            self.course.line(start, (), feed, self.line)
        else:
            self.course.rapid(start, ())

    def _drill_pattern(self, pattern: HeidenhainCycle) -> None:
        """Carry out cycles 220 (holes on a circle) and 221 (holes in rows) with the cycle defined before."""
        if self.cycle is None or self.cycle.number in OLD_DRILLING:
            raise self.error(f"cycle {pattern.number}, and no cycle from 200 is defined before it")
        n, cycle = pattern.values, self.cycle
        try:
            places = _circle_places(n) if pattern.number == 220 else _row_places(n)
        except KeyError as missing:
            raise self.error(f"cycle {pattern.number} has no {missing.args[0]}") from None
        if len(places) > MOST_HOLES:
            raise self.error(f"pattern of {len(places)} holes, at most {MOST_HOLES} are read")
        if n.get("Q365", 0.0) != 0.0:
            raise self.error("cycle 220 with arcs between its holes (Q365=1) is not read")
        kept: dict[str, float] = {name: n[name] for name in ("Q200", "Q203", "Q204") if name in n}
        first, second = PLANES[self.tool_axis]
        for u, v in places:
            point = [0.0, 0.0, 0.0]
            point[first], point[second] = u, v
            self._rapid_over((point[0], point[1], point[2]))
            values = {**cycle.values, **kept}
            if n.get("Q301", 1.0) == 0.0:
                values["Q204"] = 0.0
            self._drill(HeidenhainCycle(cycle.number, values))
        top = n.get("Q203", 0.0) + n.get("Q204", 0.0)
        if top > self.course.position[self.tool_axis]:
            self.course.rapid(self._level(top), (self.tool_axis,))


def _circle_places(n: Mapping[str, float]) -> list[tuple[float, float]]:
    count = int(n["Q241"])
    span = n.get("Q246", 360.0) - n["Q245"]
    step = n.get("Q247", 0.0)
    if step == 0.0:
        step = span / count if abs(abs(span) - 360.0) < 1e-9 else span / max(1, count - 1)
    radius = 0.5 * n["Q244"]
    angles = [math.radians(n["Q245"] + step * i) for i in range(min(count, MOST_HOLES + 1))]
    return [(n["Q216"] + radius * math.cos(angle), n["Q217"] + radius * math.sin(angle)) for angle in angles]


def _row_places(n: Mapping[str, float]) -> list[tuple[float, float]]:
    columns, rows = int(n["Q242"]), int(n["Q243"])
    if columns * rows > MOST_HOLES:
        return [(0.0, 0.0)] * (MOST_HOLES + 1)
    angle = math.radians(n.get("Q224", 0.0))
    places = []
    for row in range(rows):
        for column in range(columns) if row % 2 == 0 else reversed(range(columns)):
            u, v = column * n["Q237"], row * n["Q238"]
            x, y = u * math.cos(angle) - v * math.sin(angle), u * math.sin(angle) + v * math.cos(angle)
            places.append((n["Q225"] + x, n["Q226"] + y))
    return places
