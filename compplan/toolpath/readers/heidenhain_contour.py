"""APPR and DEP blocks of Heidenhain programs, their words."""

from __future__ import annotations

import math
import re

from compplan.toolpath.readers.arcs import combine, dot
from compplan.toolpath.readers.contour import Element
from compplan.toolpath.readers.heidenhain_approach import Way, approach, depart
from compplan.toolpath.readers.heidenhain_moves import HeidenhainMoveReader, unit_axis


class HeidenhainContourReader(HeidenhainMoveReader):
    """Carry out approaches and departures."""

    def run_approach(self, rest: str) -> None:
        """Carry out APPR: its moves wait for the first element of the contour."""
        _, way, words, functions = self._read_way(rest, "APPR")
        self.contour.refuse_open()
        self.begin_cut()
        start = self.contour.position
        first, _ = self.target(words)
        normal = unit_axis(self.tool_axis)
        depth = combine(dot(combine(1.0, first, -1.0, start), normal), normal, 0.0, normal)
        if math.hypot(*depth) > 1e-9:
            note = "an approach with a depth goes there before it touches the contour; newer controls sink on the way"
            self.log.note(note, self.line)

        def begin(element: Element) -> list[Element]:
            return approach(way, start, first, depth, element.tangent(element.start))

        self.contour.wait(begin, first, self.line)
        self.start_functions(functions)
        self.stop_functions(functions)

    def run_departure(self, rest: str) -> None:
        """Carry out DEP."""
        kind, way, words, functions = self._read_way(rest, "DEP")
        self.start_functions(functions)
        direction = self.find_direction()
        self.contour.refuse_open()
        last = self.contour.position
        end = self.target(words)[0] if kind == "LCT" else None
        normal = unit_axis(self.tool_axis)
        height = self.target(words)[0][self.tool_axis] - last[self.tool_axis]
        flat = None if end is None else combine(1.0, end, -height, normal)
        for element in depart(way, last, flat, direction):
            self.contour.add(element)
        if abs(height) > 1e-9:
            place = combine(1.0, self.contour.position, height, normal)
            self.contour.add(Element(self.contour.position, place, (), way.feed, self.line))
        self.side = ""
        self.was_rapid = False
        self.stop_functions(functions)

    def _read_way(self, rest: str, what: str) -> tuple[str, Way, dict[str, str], set[int]]:
        found = re.match(r"(P?)(LT|LN|CT|LCT)\b\s*(.*)", rest)
        if not found:
            raise self.error(f"{what} {rest[:20]!r} is not read, expected LT, LN, CT, LCT")
        words, functions = self.split(found.group(3))
        feed_before = None if self.was_rapid else self.speed()
        self.take_side(words)
        rapid = self.take_feed(words)
        if rapid and what == "APPR":
            raise self.error("an approach with FMAX is not read; give it a feed")
        kind = found.group(2)
        if kind in ("LT", "LN") and "LEN" not in words:
            raise self.error(f"{what} {kind} has no LEN")
        if kind == "CT" and "CCA" not in words:
            raise self.error(f"{what} CT has no CCA")
        length, radius, angle = (self.value(words.get(name) or "0") for name in ("LEN", "R", "CCA"))
        feed = self.speed()
        way = Way(kind, length, radius, angle, self.side, unit_axis(self.tool_axis), feed, feed_before, self.line)
        return kind, way, words, functions
