"""Cycles of Heidenhain programs: frames, dwell, holes (1, 2, 17, 200 to 209, 240), patterns 220 and 221."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, set_level
from compplan.toolpath.readers.cnc.cycles import SKIPPED, Hole, drill, go_to_level, list_circle, list_grid
from compplan.toolpath.readers.cnc.heidenhain_frames import KlartextDatums
from compplan.toolpath.readers.cnc.heidenhain_words import ASSIGN, CYCLE, NUMBER, VALUE, KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.frames import PLANE_AXES, PLANE_NORMALS
from compplan.toolpath.readers.lines import match_form

#: Drilling cycles, and whether the tool leaves the hole with the feed; old ones, and the part that states their feed.
DRILLING = {1: False, 2: True, 17: True, 200: False, 201: True, 202: True, 203: False, 205: False, 206: True,
            207: True, 208: False, 209: True, 240: False}  # fmt: skip
OLD = {1: 5, 2: 4, 17: 3}
#: Cycles of frames, part by part; those that say nothing of the path.
FRAMES: Mapping[int, Callable[[KlartextDatums, str], None]] = {
    7: KlartextDatums.shift_datum, 8: KlartextDatums.mirror, 10: KlartextDatums.rotate, 11: KlartextDatums.scale,
    19: KlartextDatums.tilt_by_cycle,
}  # fmt: skip
SILENT = {13, 32, 239, 332, 392}
#: Rapid retraction, written as a feed. [mm/min]
FASTEST = 99999.0
CYCLE_VALUE = re.compile(rf"(Q\d+)\s*=\s*({VALUE}|F?MAX|F?AUTO|PREDEF)")


@dataclass
class Cycle:
    """Hold a cycle that is defined: its number and values, by its Q parameters or the numbers of its parts (1.2: 2)."""

    number: int
    values: dict[str, float] = field(default_factory=dict)

    def get(self, name: str) -> float:
        """Return a value that the cycle must have."""
        if name not in self.values:
            raise InputError(f"cycle {self.number} has no {name if name[0] == 'Q' else f'part {self.number}.{name}'}")
        return self.values[name]


class HeidenhainCycles:
    """Define and carry out cycles."""

    def __init__(self, it: Interpreter, datums: KlartextDatums, words: KlartextWords) -> None:
        self.it, self.datums, self.words, self.to_mm_s = it, datums, words, words.to_mm_s
        self.cycle: Cycle | None = None
        #: Whether lines with values of a cycle may follow.
        self.defining = False

    def define(self, text: str) -> None:
        """Carry out CYCL DEF."""
        found = match_form(CYCLE, text, "cycle: CYCL DEF and its number")
        number, part, rest = int(found.group(1)), int(found.group(2) or 0), found.group(3).strip()
        last = re.search(rf"([-+]?\s*{NUMBER}|Q\d+)\s*$", rest) if part else None
        if number in FRAMES:
            if found.group(2) is None:
                raise InputError(f"CYCL DEF {number} in one block is not read, expected {number}.0 and {number}.1 ..")
            if part == 0 and number == 8:
                self.it.put(mirror=None)
            elif part and (rest or number in (8, 19)):
                FRAMES[number](self.datums, rest)
        elif number == 247:
            self.datums.name_preset(rest)
        elif number == 9:
            if last:
                self.it.log.happen("dwell", self.it.flow.line, value=self.words.value(last.group(1)))
        elif number in OLD:
            if not part or self.cycle is None or self.cycle.number != number:
                self.cycle = Cycle(number)
            if last:
                self.cycle.values[str(part)] = self.words.value(last.group(1))
        elif number in DRILLING or number in (220, 221):
            cycle = Cycle(number, {name: self._read_value(value) for name, value in CYCLE_VALUE.findall(rest)})
            self.words.values.update(cycle.values)
            self.defining = True
            if number in DRILLING:
                self.cycle = cycle
            else:
                self._drill_pattern(cycle)
        elif number not in SILENT:
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

    def call(self, place: Point | None = None) -> None:
        """Drill where the tool is, or at a place, whose height counts on top of the cycle's surface."""
        if place is not None:
            above = self.cycle.values.get("Q203", 0.0) if self.cycle else 0.0
            self._drill_over(place, {"Q203": above + place[self.words.tool_axis]}, "CYCL CALL at positions")
            return
        self.it.contour.refuse_open()
        if self.cycle is None:
            raise InputError("a cycle is called, and none that is read is defined")
        self._drill(self.cycle)

    def _drill_over(self, place: Point, changes: Mapping[str, float], what: str) -> None:
        """Move rapidly over a place at the height of the tool, and drill there with some values changed."""
        if self.cycle is None or self.cycle.number in OLD:
            raise InputError(f"{what} needs a cycle from 200 before it")
        height = self.it.course.position[self.words.tool_axis]
        self.it.course.rapid(set_level(place, self.words.tool_axis, height), PLANE_AXES[self.it.state.plane])
        self._drill(Cycle(self.cycle.number, {**self.cycle.values, **changes}))

    def _drill(self, cycle: Cycle) -> None:
        """Carry out a cycle at the tool's place.

        From set-up clearance Q200 above the surface Q203 to the depth Q201, then to the level Q204 above the surface;
        cycles 1, 2 and 17 from the level where the tool is, by set-up clearance and depth, and back.
        """
        course, axis, values, old = self.it.course, self.words.tool_axis, cycle.values, cycle.number in OLD
        feed, out = self._find_feeds(cycle)
        if old and self.it.options.cycles != "expand":
            with self.it.log.hole():
                self.it.note(f"drilling cycle {cycle.number} {SKIPPED}")
            return
        if old:
            course.begin_cut()
            clear = top = course.position[axis]
            depth = -abs(cycle.get("1")) - abs(cycle.get("2"))
            bottom = clear + depth
            if cycle.get("2") > 0.0 and cycle.get("1") >= 0.0:
                raise InputError(f"CYCL DEF {cycle.number} with a depth above the surface is not read")
        else:
            if cycle.number == 240 and values.get("Q343", 0.0) != 0.0:
                raise InputError("cycle 240 with a diameter (Q343=1) is not read; give it a depth")
            surface, depth = values.get("Q203", 0.0), cycle.get("Q201")
            clear, bottom = surface + cycle.get("Q200"), surface + depth
            top = max(clear, surface + values.get("Q204", 0.0))
            self.it.state.motion = 0.0
        with self.it.log.hole():
            if not old:
                go_to_level(course, axis, clear)
            if cycle.number == 208 and depth != 0.0 and self.it.options.cycles == "expand":
                self._mill_bore(values, clear, bottom, feed)
                go_to_level(course, axis, clear)
                go_to_level(course, axis, top)
            elif depth != 0.0:
                hole = Hole(axis, clear, bottom, top, feed, out if DRILLING[cycle.number] else None, by_clear=True)
                drill(course, hole, str(cycle.number))
            elif not old:
                go_to_level(course, axis, top)

    def _find_feeds(self, cycle: Cycle) -> tuple[float, float | None]:
        """Return feed into and out of a hole in mm/s, None where it is left rapidly."""
        if cycle.number in (17, 207, 209):
            pitch = abs(cycle.get("3" if cycle.number == 17 else "Q239"))
            feed = pitch * self.words.unit * self.it.state.spindle / 60.0
            return feed, feed
        feed = self.to_mm_s(cycle.get(str(OLD.get(cycle.number, "Q206"))))
        back = cycle.values.get("Q208", 0.0) if cycle.number in (201, 202) else 0.0
        return feed, None if back >= FASTEST else self.to_mm_s(back) if back > 0.0 else feed

    def _mill_bore(self, values: Mapping[str, float], first: float, bottom: float, feed: float) -> None:
        """Mill a bore on a helix (cycle 208): from its middle out, down, round the bottom, back to the middle."""
        radius, course, plane = self.words.radii.get(self.words.tool), self.it.course, self.it.state.plane
        if radius is None:
            raise InputError("cycle 208 needs the radius of the tool (TOOL DEF n R), which the program does not state")
        reach, pitch = 0.5 * values.get("Q335", 0.0) - radius, abs(values.get("Q334", 0.0))
        if reach <= 0.0 or pitch <= 0.0:
            raise InputError("cycle 208 needs a bore Q335 wider than the tool and an infeed Q334")
        middle, one = course.position, PLANE_AXES[plane][0]
        end = set_level(middle, self.words.tool_axis, bottom)
        course.line(set_level(middle, one, middle[one] + reach), (), feed)
        for turns in (max(1, math.ceil((first - bottom) / pitch - 1e-9)), 1):
            low = set_level(end, one, middle[one] + reach)
            course.arc(low, (), feed, middle, PLANE_NORMALS[plane], True, turns)
        course.line(end, (), feed)

    def _drill_pattern(self, pattern: Cycle) -> None:
        """Carry out cycles 220 (holes on a circle) and 221 (holes in rows) with the cycle defined before."""
        get, n, course, axis = pattern.get, pattern.values, self.it.course, self.words.tool_axis
        if n.get("Q365", 0.0) != 0.0:
            raise InputError("cycle 220 with arcs between its holes (Q365=1) is not read")
        kept: dict[str, float] = {name: n[name] for name in ("Q200", "Q203", "Q204") if name in n}
        if n.get("Q301", 1.0) == 0.0:
            kept["Q204"] = 0.0
        if pattern.number == 220:
            count, start, span = int(get("Q241")), get("Q245"), n.get("Q246", 360.0) - get("Q245")
            step = n.get("Q247") or span / max(1, count if abs(abs(span) - 360.0) < 1e-9 else count - 1)
            places = list_circle((get("Q216"), get("Q217")), 0.5 * get("Q244"), start, step, count)
        else:
            counts, steps = (int(get("Q242")), int(get("Q243"))), (get("Q237"), get("Q238"))
            places = list_grid((get("Q225"), get("Q226")), n.get("Q224", 0.0), steps, counts)
        first, second = PLANE_AXES[self.it.state.plane]
        for u, v, _ in places:
            place = set_level(set_level((0.0, 0.0, 0.0), first, u), second, v)
            self._drill_over(place, kept, f"cycle {pattern.number}")
        top = n.get("Q203", 0.0) + n.get("Q204", 0.0)
        if top > course.position[axis]:
            go_to_level(course, axis, top)
