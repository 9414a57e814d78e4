"""The words of Heidenhain blocks: places, feeds, tools, M functions, in the words that all dialects share."""

from __future__ import annotations

import re
from collections.abc import Mapping

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import set_level
from compplan.toolpath.readers.cnc.heidenhain_frames import TILT_ANGLES, KlartextDatums
from compplan.toolpath.readers.cnc.heidenhain_lexer import M_WORDS, VALUE, split_words
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import POLAR
from compplan.toolpath.readers.cnc.state import AXES, INCH, LETTERS, CncBlock

REFUSED_M = {130: "coordinates that are not tilted", 114: "the old compensation of rotary axes",
             **dict.fromkeys(range(200, 205), "laser")}  # fmt: skip
#: Feeds that are rapid traverse on old controls (TNC 145, 155). [mm/min]
OLD_RAPID = frozenset({9999.0, 15999.0})
PLANES = {0: 19, 1: 18, 2: 17}
#: What words of a block are called in all dialects; with I before them they count from where the tool is.
ADDRESSES = {**{letter: letter for letter in (*AXES, *LETTERS)}, "PR": "RP", "PA": "AP"}
TOOL = re.compile(r"CALL\s*(\"[^\"]*\"|\d+(?:\.\d+)?|Q[LRS]?\d+)?\s*([XYZUVW](?=\s|$))?\s*(.*)")
TOOL_DEF = re.compile(rf"DEF\s*(\"[^\"]*\"|\d+|Q\d+)?\s*(?:L\s*({VALUE}))?\s*(?:R\s*({VALUE}))?\s*(?:F\s*{VALUE})?\s*$")
TOOL_WORD = re.compile(rf"(D[LR]2?|S|F[UZ]?)\s*:?\s*(?:=\s*)?({VALUE})")
Words = dict[str, str]


class KlartextWords:
    """Read the words of blocks, and let happen what they switch."""

    def __init__(self, it: Interpreter, datums: KlartextDatums) -> None:
        self.it, self.datums = it, datums
        self.per_turn = False
        #: Whether the program states lengths of tools, as on old controls, and whether its feed is rapid there.
        self.old = self.fast = False
        #: Side of the contour on which the tool runs: L, R, or none.
        self.side = ""
        #: Tool in the spindle, as the program calls it, its feed, and radii that the program states.
        self.tool = ""
        self.tool_feed: float | None = None
        self.radii: dict[str, float] = {}

    def set_feed_scale(self) -> None:
        """Set the feed unit of plain blocks to the one that is now in force (per minute or per turn, mm or inch)."""
        self.it.state.feed_scale = self.to_mm_s(1.0) * 60.0

    def to_mm_s(self, number: float) -> float:
        """Return a feed in mm/s; in programs in inches F counts tenths of an inch a minute."""
        if self.per_turn:
            return number * self.datums.unit * self.it.state.spindle / 60.0
        return number * (1.0 if self.datums.unit == 1.0 else 0.1 * INCH) / 60.0

    def control_tip(self, on: bool, *, spatial: bool = False) -> None:
        """Let X Y Z be the tip in the part frame, however the rotary axes stand, or not."""
        self.it.contour.refuse_open()
        self.it.rotary.spatial, self.it.state.tip_control = spatial, on
        self.it.set_frame()

    def split(self, text: str) -> tuple[Words, set[int]]:
        """Return the words of a block by their letters, and its M functions."""
        functions: set[int] = set()
        if "M1" in text or "M 1" in text:
            for found in M_WORDS.finditer(text):
                functions.add(int(found.group(1)))
                if found.group(1) == "140":
                    self._retract(found.group(2))
            text = M_WORDS.sub(" ", text)
        found_words, rest = split_words(text)
        if rest:
            raise InputError(f"cannot read {rest[:30]!r} in the block {text[:40]!r}")
        words: Words = {}
        for letter, value in found_words:
            if letter == "M":
                functions.add(int(self.datums.value(value)))
            elif letter in words or (letter[0] == "I" and letter[1:] in words) or "I" + letter in words:
                raise InputError(f"word {letter} stands twice in the block {text[:40]!r}")
            else:
                words[letter] = value
        if "S" in words:
            self._set_speed(self.datums.value(words.pop("S")))
        return words, functions

    def _retract(self, words: str) -> None:
        """Go back along the tool axis (M140 MB)."""
        course, axis = self.it.course, self.datums.tool_axis
        way = re.search(r"MB\s*([-+]?[\d.,]+)", words)
        if way is None:
            self.it.note("retracts to the end of the machine's travel (M140 MB MAX) are left out")
            course.lose((axis,))
            return
        self.it.contour.refuse_open()
        target = set_level(course.position, axis, course.position[axis] + self.datums.value(way.group(1)))
        feed = re.search(r"F\s*([\d.]+)", words)
        if feed:
            course.line(target, (), self.to_mm_s(float(feed.group(1))))
        else:
            course.rapid(target)

    def start_functions(self, functions: set[int]) -> None:
        """Let happen what M functions switch before the move of their block."""
        if not functions:
            return
        for number in sorted(functions & REFUSED_M.keys()):
            raise InputError(f"M{number} ({REFUSED_M[number]}) is not read; post-process without it")
        self.it.machine.switch_on(sorted(map(float, functions)), self.it.flow.line)
        if 128 in functions:
            self.control_tip(True)
        if functions & {136, 137}:
            self.per_turn = 136 in functions
            self.set_feed_scale()

    def stop_functions(self, functions: set[int]) -> None:
        """Let happen what M functions switch after it."""
        if 129 in functions:
            self.control_tip(False)
        if self.it.machine.stop(sorted(functions), self.it.flow.line):
            self.it.flow.over = True

    def _set_speed(self, speed: float) -> None:
        """Take a speed of the spindle; one that turns changes its speed."""
        self.it.state.spindle = speed
        if self.per_turn:
            self.set_feed_scale()
        if self.it.state.turning:
            self.it.log.happen(self.it.state.turning, self.it.flow.line, value=speed)

    def change_tool(self, text: str) -> None:
        """TOOL CALL and TOOL DEF: the tool, its axis, speed and feed."""
        it = self.it
        if re.match(r"DEF(?![A-Z])", text):
            found = TOOL_DEF.match(text)
            if not found:
                raise InputError(f"tool TOOL {text[:36]!r} is not read")
            self.old = self.old or found.group(2) is not None
            if found.group(3) is not None:
                self.radii[found.group(1) or ""] = self.datums.value(found.group(3))
            return
        found = TOOL.match(text)
        if not found:
            raise InputError(f"tool call TOOL {text[:36]!r} is not read")
        called, axis, rest = found.groups()
        it.contour.refuse_open()
        words, bare = dict(TOOL_WORD.findall(rest)), TOOL_WORD.sub("", rest)
        if re.sub(r"M\s*\d+|\"[^\"]*\"", "", bare).strip():
            raise InputError(f"cannot read {rest[:30]!r} in the tool call")
        if any(self.datums.value(words[key]) for key in ("DL", "DR") if key in words):
            it.note("oversizes DL, DR of TOOL CALL are not applied: the path is that of the tool tip")
        if "S" in words:
            it.state.spindle = self.datums.value(words["S"])
            self.set_feed_scale()
        if "F" in words:
            self.tool_feed = self._set_feed(self.to_mm_s(self.datums.value(words["F"])))
        if called is not None:
            number = 0.0 if called.startswith('"') else self.datums.value(called)
            key = called if called.startswith('"') else f"{number:g}"
            if key != self.tool:
                self.tool = key
                it.state.tool, it.state.tool_name = number, called[1:-1] if called.startswith('"') else ""
                it.machine.change_tool(it.flow.line)
        if axis in ("X", "Y", "Z") and AXES.index(axis) != self.datums.tool_axis:
            it.state.plane = PLANES[AXES.index(axis)]
            self.datums.use_axis(AXES.index(axis))
        if "S" in words and it.state.turning:
            it.log.happen(it.state.turning, it.flow.line, value=it.state.spindle)
        functions = {int(number) for number in re.findall(r"M\s*(\d+)", bare)}
        self.start_functions(functions)
        self.stop_functions(functions)

    def _set_feed(self, feed: float) -> float:
        self.it.state.feed = feed * 60.0
        return feed

    def take_side(self, words: Mapping[str, str]) -> None:
        """Keep whether the tool runs left or right of the contour."""
        for word in ("R0", "RL", "RR", "R"):
            if word in words and (word != "R" or words[word] in ("+", "-")):
                self.side = word[1:].replace("0", "")
                if word != "R0":
                    self.it.compensate_radius(f"{word}{words[word] if word == 'R' else ''}")

    def take_feed(self, words: Mapping[str, str]) -> bool:
        """Take the feed of a block; return whether it is rapid."""
        if "FMAX" in words:
            return True
        if "FAUTO" in words:
            if self.tool_feed is None:
                raise InputError("F AUTO, but TOOL CALL states no F")
            self._set_feed(self.tool_feed)
        elif "FU" in words:
            self._set_feed(self.datums.value(words["FU"]) * self.datums.unit * self.it.state.spindle / 60.0)
        elif "FZ" in words or "FT" in words:
            raise InputError("feeds per tooth (FZ) or as a time (FT) are not read; write F")
        elif "F" in words:
            if not words["F"]:
                raise InputError("word F has no number")
            feed = self.datums.value(words["F"])
            self._set_feed(self.to_mm_s(feed))
            self.fast = self.old and feed in OLD_RAPID
        if self.fast:
            self.it.note("F9999 and F15999 are rapid traverse in programs of old controls")
        return self.fast

    def read(self, words: Mapping[str, str]) -> CncBlock:
        """Return the places that words name, as addresses that all dialects share."""
        block = CncBlock()
        for word, address in ADDRESSES.items():
            if word in words or "I" + word in words:
                text, turns = words.get(word) or words.get("I" + word) or "", word in LETTERS
                by_plane = turns and any(name in text for name in TILT_ANGLES)
                unread = turns and (self.it.rotary.ignored or (by_plane and self.it.tilted))
                block.values[address] = 0.0 if unread else self.datums.value(text)
                if word not in words:
                    block.relative.add(address)
                if by_plane:
                    block.names.append("TILT")
        if block.has(POLAR):
            self.need_pole()
        return block

    def need_pole(self) -> None:
        """Refuse a block that counts from a pole where none is set."""
        if self.it.state.pole is None:
            raise InputError("no pole or centre (CC) stands before this block")
