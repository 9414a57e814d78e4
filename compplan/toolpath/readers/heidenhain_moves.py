"""Motion blocks of Heidenhain programs: L, LP, LN, CC, C, CR, CT, CP, CTP, and the words of a block."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

from compplan.toolpath.readers.arcs import Point, combine, dot
from compplan.toolpath.readers.contour import Corner, Element, find_centre, find_tangent_arc
from compplan.toolpath.readers.expressions import cos_deg, sin_deg
from compplan.toolpath.readers.heidenhain_frames import AXES, TILT_ANGLES
from compplan.toolpath.readers.heidenhain_machine import HeidenhainMachineReader
from compplan.toolpath.readers.heidenhain_words import M_WORDS, split_words
from compplan.toolpath.readers.options import CamTable, ask_compensation
from compplan.toolpath.readers.plain import read_place
from compplan.toolpath.readers.turning import LETTERS

#: Feeds that are rapid traverse on old controls (TNC 145, 155). [mm/min]
OLD_RAPID = frozenset({9999.0, 15999.0})
#: Axes of the working plane by the tool axis.
PLANES = {0: (1, 2), 1: (2, 0), 2: (0, 1)}
#: Words that say where a block goes.
PLACES = frozenset((*(sign + letter for sign in ("", "I") for letter in (*AXES, *LETTERS)), "PR", "PA", "IPR", "IPA"))


class HeidenhainMoveReader(HeidenhainMachineReader):
    """Carry out motion blocks."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.was_rapid = True
        self.side = ""
        self.pole: tuple[int, int, float, float] | None = None

    def split(self, text: str) -> tuple[dict[str, str], set[int]]:
        """Return the words of a block by their letters, and its M functions.

        Raises:
            InputError: If something in it is not read, or a word stands twice.

        """
        functions: set[int] = set()
        if "M1" in text or "M 1" in text:
            for found in M_WORDS.finditer(text):
                functions.add(int(found.group(1)))
                self._note_function(int(found.group(1)), found.group(2))
            text = M_WORDS.sub(" ", text)
        found_words, rest = split_words(text)
        if rest:
            raise self.error(f"cannot read {rest[:30]!r} in the block {text[:40]!r}")
        words: dict[str, str] = {}
        for letter, value in found_words:
            if letter == "M":
                functions.add(int(self.value(value)))
            elif letter in words or (letter[0] == "I" and letter[1:] in words) or "I" + letter in words:
                raise self.error(f"word {letter} stands twice in the block {text[:40]!r}")
            else:
                words[letter] = value
        if "S" in words:
            self.set_speed(self.value(words.pop("S")))
        return words, functions

    def run_motion(self, kind: str, rest: str, corner: Corner | None) -> None:
        """Carry out a motion block.

        Args:
            kind: L, LP, LN, C, CR, CT, CP or CTP.
            rest: What follows.
            corner: Corner that the block after it asks for.

        """
        words, functions = self.split(re.sub(r"\([^()]*\)$", "", rest))
        self.start_functions(functions)
        self.take_side(words)
        rapid = self.take_feed(words)
        if functions & {91, 92}:
            self._go_in_machine(words)
        elif kind in ("L", "LP", "LN"):
            self._go_straight(kind, words, corner, rapid=rapid)
        else:
            self._go_round(kind, words, corner, rapid=rapid)
        if self.calls or functions & {89, 99}:
            self.call_where_asked(functions)
        self.stop_functions(functions)

    def take_side(self, words: Mapping[str, str]) -> None:
        """Keep whether the tool runs left or right of the contour."""
        for word in ("R0", "RL", "RR", "R"):
            if word in words and (word != "R" or words[word] in ("+", "-")):
                self.side = word[1:].replace("0", "")
                if word != "R0":
                    sign = words[word] if word == "R" else ""
                    self.log.note(ask_compensation(self.options, f"{word}{sign}"), self.line)

    def take_feed(self, words: Mapping[str, str]) -> bool:
        """Take the feed of a block; return whether it is rapid."""
        if "FMAX" in words:
            return True
        if "FAUTO" in words:
            if self.tool_feed is None:
                raise self.error("F AUTO, but TOOL CALL states no F")
            self.feed = self.tool_feed
        elif "FU" in words:
            self.feed = self._length(words["FU"]) * self.spindle / 60.0
        elif "FZ" in words or "FT" in words:
            raise self.error("feeds per tooth (FZ) or as a time (FT) are not read; write F")
        elif "F" in words:
            if not words["F"]:
                raise self.error("word F has no number")
            self.feed = self.to_mm_s(self.value(words["F"]))
            self.fast = self.old and self.value(words["F"]) in OLD_RAPID
        if self.fast:
            self.log.note("F9999 and F15999 are rapid traverse in programs of old controls", self.line)
        return self.fast

    def target(self, words: Mapping[str, str]) -> tuple[Point, tuple[int, ...]]:
        """Return where the words of a block lead, and which axes they name as absolute coordinates."""
        point, named = list(self.contour.position), []
        for axis, letter in enumerate(AXES):
            if letter in words:
                point[axis] = self.value(words[letter])
                named.append(axis)
            elif "I" + letter in words:
                point[axis] += self.value(words["I" + letter])
        if not words.keys().isdisjoint(("PR", "PA", "IPR", "IPA")):
            first, second, radius, angle = self._polar(words, (point[0], point[1], point[2]))
            point[first] = self._pole()[2] + radius * cos_deg(angle)
            point[second] = self._pole()[3] + radius * sin_deg(angle)
            named += [first, second]
        return (point[0], point[1], point[2]), tuple(named)

    def _pole(self) -> tuple[int, int, float, float]:
        if self.pole is None:
            raise self.error("no pole or centre (CC) stands before this block")
        return self.pole

    def _polar(self, words: Mapping[str, str], start: Point) -> tuple[int, int, float, float]:
        """Return the axes of the pole's plane, radius and angle [deg] of the end of a polar block."""
        first, second, x, y = self._pole()
        dx, dy = start[first] - x, start[second] - y
        radius, angle = math.hypot(dx, dy), math.degrees(math.atan2(dy, dx))
        if "PR" in words or "IPR" in words:
            radius = self.value(words["PR"]) if "PR" in words else radius + self.value(words["IPR"])
        if "PA" in words or "IPA" in words:
            angle = self.value(words["PA"]) if "PA" in words else angle + self.value(words["IPA"])
        return first, second, radius, angle

    def _go_in_machine(self, words: Mapping[str, str]) -> None:
        """Leave out a move in machine coordinates; where it ended is not known."""
        self.contour.refuse_open()
        named = [axis for axis, letter in enumerate(AXES) if letter in words or "I" + letter in words]
        if named:
            self.log.note("moves in machine coordinates (M91, M92) are left out", self.line)
            if 2 in named:
                self.course.retreat(self.line)
            self.course.lose(named)
        for letter in LETTERS:
            if letter in words:
                self.rotary.take(letter, self.value(words[letter]))

    def _go_straight(self, kind: str, words: Mapping[str, str], corner: Corner | None, *, rapid: bool) -> None:
        if words.get("R", "+") not in ("+", "-") or "DR" in words:
            raise self.error("words of an arc in a straight block")
        if not rapid and not words.keys().isdisjoint(PLACES):
            self.begin_cut()
        target, named = self.target(words)
        moving = named or target != self.contour.position
        before = dict(self.rotary.angles)
        axis = self._turn(words, rapid=rapid) if kind != "LN" else self._turn_to_vector(words)
        if not moving and axis is None:
            return
        if rapid:
            self.contour.refuse_open()
            self.course.rapid(target, named, axis)
        else:
            self.check_machine()
            turning = axis is not None and not self.spatial and kind != "LN"
            on_way = self.rotary.turn_on_way(before) if turning else None
            self.contour.add(
                Element(self.contour.position, target, named, self.speed(), self.line, axis=axis, on_way=on_way,
                        normal=unit_axis(self.tool_axis)), corner)  # fmt: skip
        self.was_rapid = rapid

    def is_steady(self) -> bool:
        """Tell whether an L block of X Y Z F alone cuts straight to where its numbers say, and nothing else."""
        return bool(
            self.feed and not self.was_rapid and not self.fast and self.contour.idle and self.course.knows
            and not (self.calls or self.rotary.unknown)
        )  # fmt: skip

    def cut_plain(self, found: re.Match[str]) -> bool:
        """Carry out an L block of X Y Z F alone where the program is steady; return whether it was read."""
        feed = found.group(4)
        target = read_place(found, self.course.position, 1.0)
        if target is None or (feed is not None and float(feed) <= 0.0):
            return False
        if feed is not None:
            self.feed = self.to_mm_s(float(feed))
        self.course.line(target, (), self.speed(), self.line)
        return True

    def check_machine(self) -> None:
        """Refuse a cut while rotary axes stand turned of which nobody says what they turn."""
        if not self.tilted and not self.spatial:
            self.rotary.refuse_unknown()

    def _turn(self, words: Mapping[str, str], *, rapid: bool) -> Point | None:
        """Return the tool axis that A B C ask for, None where they ask for nothing."""
        letters = [letter for letter in LETTERS if letter in words or "I" + letter in words]
        if not words.keys().isdisjoint(("U", "V", "W", "IU", "IV", "IW")):
            self.log.note("axes U V W are not read", self.line)
        if not letters or self.rotary.ignored:
            return None
        by_plane = any(name in words[letter] for letter in letters if letter in words for name in TILT_ANGLES)
        if self.tilted and (by_plane or not self.tip_control):
            note = "A B C in a tilted plane position the rotary axes as the plane asks: its axis is taken"
            self.log.note(note, self.line)
            return None
        now, square = self.rotary.angles, unit_axis(self.tool_axis)
        angles = {
            key: self.value(words[key]) if key in words else now.get(key, 0.0) + self.value(words["I" + key])
            for key in letters
        }
        if not self.spatial:
            return self.turn_to(angles, square, "M128", rapid=rapid)
        for letter, angle in angles.items():
            self.rotary.take(letter, angle)
        return self._spatial(*(now.get(letter, 0.0) for letter in LETTERS)).turn(square)

    def _turn_to_vector(self, words: Mapping[str, str]) -> Point | None:
        """Return the tool axis of an LN block: its vector TX TY TZ, or with tip control its normal NX NY NZ."""
        for letter in ("T", "N") if self.tip_control else ("T",):
            names = [letter + axis for axis in AXES]
            found = [name for name in names if name in words]
            if not found:
                continue
            fault = f"direction {' '.join(found)} of an LN block, expected three numbers, not all 0"
            return self.point_along([self.value(words[name]) for name in found], fault)
        return None

    def set_pole(self, rest: str) -> None:
        """Carry out CC."""
        words, functions = self.split(rest)
        start = self.contour.position
        plane = PLANES[self.tool_axis]
        named = [axis for axis, letter in enumerate(AXES) if letter in words or "I" + letter in words]
        if named and len(named) != 2:
            raise self.error(f"CC names {len(named)} axes, expected 2 (or none: where the tool is)")
        if named:
            first, second = next(pair for pair in PLANES.values() if set(pair) == set(named))
        else:
            first, second = plane
        place = [
            self.value(words[AXES[axis]]) if AXES[axis] in words
            else start[axis] + (self.value(words["I" + AXES[axis]]) if named else 0.0)
            for axis in (first, second)
        ]  # fmt: skip
        self.pole = first, second, place[0], place[1]
        self.start_functions(functions)
        self.stop_functions(functions)

    def _go_round(self, kind: str, words: Mapping[str, str], corner: Corner | None, *, rapid: bool) -> None:
        """Cut along an arc."""
        if any(letter in words or "I" + letter in words for letter in LETTERS):
            raise self.error("rotary axes on an arc are not read")
        self.check_machine()
        if rapid:
            raise self.error("an arc with FMAX is not read; give it a feed")
        self.begin_cut()
        start = self.contour.position
        target, named = self.target(words)
        feed = self.speed()
        turns, plane = 1, PLANES[self.tool_axis]
        if kind in ("C", "CP"):
            plane = self._pole()[:2]
        normal = unit_axis(3 - sum(plane))
        if kind in ("CT", "CTP"):
            found = find_tangent_arc(start, self.find_direction(), target, normal)
            if abs(dot(combine(1.0, target, -1.0, start), normal)) > 1e-9:
                raise self.error(f"{kind} that leaves its plane is not read")
            if found is None:
                self.contour.add(Element(start, target, named, feed, self.line, normal=normal), corner)
                return
            centre, right_hand = found
        else:
            right_hand = self._sense(words)
            if kind == "CR":
                if not words.get("R"):
                    raise self.error("CR has no radius R")
                centre = find_centre(start, target, normal, self.value(words["R"]), right_hand=right_hand)
            else:
                first, second, x, y = self._pole()
                places = list(start)
                places[first], places[second] = x, y
                centre = places[0], places[1], places[2]
            if "IPA" in words:
                turns = self._count_turns(self.value(words["IPA"]), right_hand=right_hand)
        self.contour.add(Element(start, target, named, feed, self.line, centre, normal, right_hand, turns), corner)
        self.was_rapid = False

    def _sense(self, words: Mapping[str, str]) -> bool:
        sign = words.get("DR", "")
        if sign not in ("+", "-"):
            raise self.error("arc without a sense, expected DR+ or DR-")
        return sign == "+"

    def _count_turns(self, angle: float, *, right_hand: bool) -> int:
        """Return the turns of an arc that goes on by an angle [deg]."""
        if angle == 0.0 or (angle > 0.0) != right_hand:
            raise self.error(f"IPA{angle:+g} and DR{'+' if right_hand else '-'} contradict each other")
        turns = math.ceil(abs(angle) / 360.0 - 1e-9)
        if turns > 10_000:
            raise self.error(f"arc of {turns} turns, at most 10000 are read")
        return turns


def unit_axis(number: int) -> Point:
    """Return the unit vector of X, Y or Z (0, 1, 2)."""
    return ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))[number]
