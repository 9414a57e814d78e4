"""Lexer of Heidenhain programs: blocks, words with the addresses of all dialects, feeds, tools, M functions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import set_levels
from compplan.toolpath.readers.cnc.expressions import FUNCTIONS, Grammar, evaluate
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import POLAR
from compplan.toolpath.readers.cnc.state import AXES, INCH, LETTERS, CncBlock
from compplan.toolpath.readers.frames import DEEP_AXIS
from compplan.toolpath.readers.lines import DECIMAL, LONGEST_LINE, cut_comment, match_form, split_lines

NUMBER = r"(?:\d+(?:[.,]\d*)?|[.,]\d+)"
#: Value of a word: a number or a Q parameter, with or without a sign.
VALUE = rf"[-+]?\s*(?:{NUMBER}|Q[LRS]?\d+)"
#: Block of a plain straight cut: L X+1.5 Y-2 Z+.3 F1000.
PLAIN = re.compile(rf"L(?: ?X({DECIMAL}))?(?: ?Y({DECIMAL}))?(?: ?Z({DECIMAL}))?(?: ?F({DECIMAL}))?(?: M90)?")
#: Words of a motion block. Bare signs belong to DR and to R of paraxial blocks.
WORD = re.compile(
    rf"(IP[AR]|P[AR]|I?[XYZABCUVW](?!C)|N[XYZ](?=\s*[-+\d.,Q])|T[XYZ](?=\s*[-+\d.,Q])|CCA|LEN|D[LR]2?|"
    rf"R[0LR](?![\d.,])|R|F\s*(?:MAX|AUTO)|F[UZT]?|S(?=\s*[\d.,Q])|M\s*(?=\d|Q))"
    rf"\s*({VALUE}|[-+](?!\s*[\d.,Q]))?"
)
#: Block: skip mark and text, without its number.
NUMBERED = re.compile(r"\s*(/?)\s*(?:\d+\s*(?=\D|$))?(.*)")
FUNCTION_NUMBER = re.compile(r"FN\s*(\d+)\s*:\s*(.*)")
ASSIGN = re.compile(r"(Q[LRS]?\d+)\s*=\s*(.+)")
JUMP = re.compile(r".*?IF\s+(.+?)\s+(EQU|NE|GT|LT)\s+(.+?)\s+GOTO\s+LBL\s*(\".*\"|\d+|QS?\d+)\s*$")
CALL = re.compile(r"CALL\s+LBL\s*(\"[^\"]*\"|\d+|QS?\d+)\s*(?:REP\s*(\d+|Q[LR]?\d+)(?:\s*/\s*\d+)?)?\s*$")
LABEL = re.compile(r"LBL\s*(\"[^\"]*\"|\d+)\s*$")
CYCLE = re.compile(r"CYCL\s+DEF\s*(\d+)(?:\s*\.(\d+))?\s*(.*)")
ISO = re.compile(r"^\s*%\S*\s+G7[01]\b", re.MULTILINE)
#: M functions with their words; only some have a feed.
M_WORDS = re.compile(
    r"M\s*(?:(10[134]|112|118|120|124|128|14[0258])(?!\d))"
    r"((?:\s*(?:MB\s*(?:MAX|[-+]?[\d.,]+)|LA\s*[\d.]+|LIMIT|T\s*[\d.]+|E\s*[\d.]+|(?<=\d\s)[XYZ][\d.]+|"
    r"(?:(?<=M103 )|(?<=M128 )|(?<=M140 )|(?<=MAX )|(?<=M103)|(?<=M128))F\s*(?:MAX|[\d.]+)))*)"
)
REFUSED_M = {130: "coordinates that are not tilted", 114: "the old compensation of rotary axes",
             **dict.fromkeys(range(200, 205), "laser")}  # fmt: skip
#: Feeds that are rapid traverse on old controls (TNC 145, 155). [mm/min]
OLD_RAPID = frozenset({9999.0, 15999.0})
PLANES = {0: 19, 1: 18, 2: 17}
#: Addresses of coordinates in all dialects; with the prefix I they are incremental.
ADDRESSES = {**{letter: letter for letter in (*AXES, *LETTERS)}, "PR": "RP", "PA": "AP"}
#: Words without number: side of the contour, sense of an arc, feeds.
BARE = frozenset(("R0", "RL", "RR", "R+", "R-", "DR+", "DR-", "FMAX", "FAUTO"))
UNREAD_AXES = frozenset(("U", "V", "W", "IU", "IV", "IW"))
TOOL = re.compile(r"CALL\s*(\"[^\"]*\"|\d+(?:\.\d+)?|Q[LRS]?\d+)?\s*([XYZUVW](?=\s|$))?\s*(.*)")
TOOL_DEF = re.compile(rf"DEF\s*(?:\"[^\"]*\"|\d+|Q\d+)?\s*(?:L\s*({VALUE}))?\s*(?:R\s*{VALUE})?\s*(?:F\s*{VALUE})?\s*$")
#: Parameters that PLANE and cycle 19 set to the angles of the rotary axes.
TILT_ANGLES = {"Q120", "Q121", "Q122"}


GRAMMAR = Grammar(
    functions={
        **FUNCTIONS, "ATAN": (1, lambda x: math.degrees(math.atan(x))), "SQ": (1, lambda x: x * x),
        "LOG": (1, math.log10), "NEG": (1, lambda x: -x), "INT": (1, lambda x: float(math.trunc(x))),
        "FRAC": (1, lambda x: x - math.trunc(x)), "SGN": (1, lambda x: float((x > 0.0) - (x < 0.0))),
        "PI": (0, lambda: math.pi),
    },
    operators={
        "+": (1, lambda a, b: a + b), "-": (1, lambda a, b: a - b), "*": (2, lambda a, b: a * b),
        "/": (2, lambda a, b: a / b), "DIV": (2, lambda a, b: a / b), "^": (3, lambda a, b: a**b),
        "LEN": (1, math.hypot), "ANG": (1, lambda y, x: math.degrees(math.atan2(y, x)) % 360.0),
    },
    bare=True,
)  # fmt: skip


@dataclass(frozen=True)
class HeidenhainBlock:
    """Block: its line, text in capitals without number and comment (first /: optional block), and comment."""

    line: int
    text: str
    comment: str


def split_blocks(text: str) -> Iterator[HeidenhainBlock]:
    """Yield the blocks of a program; a ~ at the end of a line continues the block in the next line."""
    parts: list[tuple[str, str]] = []
    letters = 0
    for line, raw in enumerate([*split_lines(text), ""], start=1):
        body = raw.strip()
        parts.append(cut_comment(body.removesuffix("~").rstrip()))
        letters += len(parts[-1][0])
        first = line + 1 - len(parts)
        if letters > LONGEST_LINE:
            raise ValueError(f"block of more than {LONGEST_LINE} characters in line {first}; no more are read")
        if not body.endswith("~"):
            mark, words = NUMBERED.fullmatch(" ".join(part for part, _ in parts)).groups()  # type: ignore[union-attr]
            words = " ".join(words.split()).upper()
            words = f"CYCL{words[5:]}" if words.startswith("CYCLE ") else words
            yield HeidenhainBlock(first, mark + words, " ".join(note for _, note in parts).strip())
            parts, letters = [], 0


class KlartextWords:
    """Words of blocks, values of parameters, tool calls and machine functions of a Klartext program."""

    def __init__(self, it: Interpreter) -> None:
        self.it = it
        self.values: dict[str, float] = dict.fromkeys(TILT_ANGLES, 0.0)
        #: Unit of length. [mm]
        self.unit = 1.0
        #: Whether TOOL DEF states tool lengths, as on old controls; whether the active feed means rapid traverse there.
        self.old = self.fast = False
        #: Side of the tool relative to the contour: L, R, or none.
        self.side = ""
        #: Name or number of the tool in the spindle, feed F of the tool call.
        self.tool = ""
        self.tool_feed: float | None = None
        #: Function that applies a change of the tool axis to the frames.
        self.turn_axis: Callable[[], None] = lambda: None

    @property
    def tool_axis(self) -> int:
        """Number of the tool axis."""
        return DEEP_AXIS[self.it.state.plane]

    def value(self, text: str) -> float:
        """Return the value of a number or a formula."""
        try:
            return float(text)
        except ValueError:
            return evaluate(text.replace(",", "."), GRAMMAR, self._look_up)

    def _look_up(self, name: str, indices: tuple[float, ...]) -> float:
        if name in self.values and not indices:
            return self.values[name]
        why = self.it.unknown.get(name, "the program gives it none")
        raise ValueError(f"parameter {name} has no value that is known: {why}; set it before")

    def forget(self, name: str, why: str) -> None:
        """Mark the value of a parameter as unknown, with the reason."""
        self.values.pop(name, None)
        self.it.unknown[name] = why

    def set_feed_mode(self, mode: int) -> None:
        """Set feeds per minute (94) or per revolution (95); the unit of F in inch programs is 0.1 inch/min."""
        self.it.state.set_feed_mode(mode, self.unit if mode == 95 or self.unit == 1.0 else 0.1 * INCH)

    def read(self, text: str) -> CncBlock:
        """Read a block: numbers by the addresses of all dialects, M functions, words without a number.

        M140 is executed immediately.
        """
        block = CncBlock()
        for number, words in M_WORDS.findall(text):
            block.machine.append(float(number))
            if number == "140":
                self._retract(words)
        text = M_WORDS.sub(" ", text)
        if rest := WORD.sub("", text).strip():
            raise InputError(f"cannot read {rest[:30]!r} in the block {text[:40]!r}")
        for word, number in ((word.replace(" ", ""), number.replace(" ", "")) for word, number in WORD.findall(text)):
            address = ADDRESSES.get(word.removeprefix("I"), word)
            if address in block.values or word + number in block.names:
                raise InputError(f"word {word} stands twice in the block {text[:40]!r}")
            if word in UNREAD_AXES:
                self.it.note("axes U V W are not read")
            elif word + number in BARE:
                block.names.append(word + number)
            elif not number:
                raise InputError(f"word {word} has no number in the block {text[:40]!r}")
            elif word == "M":
                block.machine.append(float(int(self.value(number))))
            else:
                by_plane = address in LETTERS and any(name in number for name in TILT_ANGLES)
                unread = address in LETTERS and (self.it.rotary.ignored or (by_plane and self.it.tilted))
                block.values[address] = 0.0 if unread else self.value(number)
                block.names += ["TILT"] if by_plane else []
                if address != word and word[0] == "I":
                    block.relative.add(address)
        if block.has(POLAR):
            self.need_pole()
        return block

    def _retract(self, words: str) -> None:
        """Retract along the tool axis (M140 MB)."""
        course, axis = self.it.course, self.tool_axis
        way = re.search(r"MB\s*([-+]?[\d.,]+)", words)
        if way is None:
            self.it.note("retracts to the end of the machine's travel (M140 MB MAX) are left out")
            course.mark_unknown((axis,))
            return
        self.it.contour.refuse_open()
        target = set_levels(course.position, {axis: course.position[axis] + self.value(way.group(1))})
        feed = re.search(r"F\s*([\d.]+)", words)
        if feed:
            course.line(target, self.it.state.to_mm_s(float(feed.group(1))))
        else:
            course.rapid(target)

    @contextmanager
    def functions(self, block: CncBlock) -> Iterator[set[float]]:
        """Execute S and M functions before and after the move of their block."""
        codes = set(block.machine)
        if "S" in block.values:
            self.it.state.spindle = block.values["S"]
            self.it.machine.switch_on((), changed=True)
        for code in sorted(codes & REFUSED_M.keys()):
            raise InputError(f"M{code:g} ({REFUSED_M[int(code)]}) is not read; post-process without it")
        self.it.machine.switch_on(sorted(codes))
        if 128.0 in codes:
            self.it.control_tip(True)
        if codes & {136.0, 137.0}:
            self.set_feed_mode(95 if 136.0 in codes else 94)
        yield codes
        if 129.0 in codes:
            self.it.control_tip(False)
        if self.it.machine.stop(sorted(codes)):
            self.it.flow.over = True

    def change_tool(self, text: str) -> None:
        """TOOL CALL and TOOL DEF: set the tool, its axis, radius, speed and feed."""
        it = self.it
        if re.match(r"DEF(?![A-Z])", text):
            self.old = self.old or match_form(TOOL_DEF, text, "tool TOOL").group(1) is not None
            return
        called, axis, rest = match_form(TOOL, text, "tool call TOOL").groups()
        it.contour.refuse_open()
        block = self.read(re.sub(r"\"[^\"]*\"|[:=]", " ", rest))
        if block.values.keys() - {"S", "F", "FU", "FZ", "DL", "DR", "DR2"} or block.names:
            raise InputError(f"cannot read {rest[:30]!r} in the tool call")
        if block.values.get("DL") or block.values.get("DR"):
            it.note("oversizes DL, DR of TOOL CALL are not applied: the path is that of the tool tip")
        if "F" in block.values:
            self.tool_feed = block.values["F"]
            it.state.set_feed(self.tool_feed)
        if called is not None:
            name = called[1:-1] if called.startswith('"') else ""
            number = 0.0 if called.startswith('"') else self.value(called)
            if (key := called if called.startswith('"') else f"{number:g}") != self.tool:
                self.tool, it.state.tool, it.state.tool_name = key, number, name
                it.machine.change_tool()
        if axis in ("X", "Y", "Z") and AXES.index(axis) != self.tool_axis:
            it.state.plane = PLANES[AXES.index(axis)]
            self.turn_axis()
        with self.functions(block):
            pass

    def set_modes(self, block: CncBlock) -> bool:
        """Set contour side and feed of a block; return whether it is rapid."""
        state, values = self.it.state, block.values
        for word in ("R0", "RL", "RR", "R+", "R-"):
            if word in block.names:
                self.side = word[1:] if word in ("RL", "RR") else ""
                if word != "R0":
                    self.it.compensate_radius(word)
        if "FMAX" in block.names:
            return True
        if "FAUTO" in block.names:
            if self.tool_feed is None:
                raise InputError("F AUTO, but TOOL CALL states no F")
            state.set_feed(self.tool_feed)
        elif "FU" in values:
            state.feed = values["FU"] * self.unit * (1.0 if state.feed_mode == 95 else state.spindle)
        elif "FZ" in values or "FT" in values:
            raise InputError("feeds per tooth (FZ) or as a time (FT) are not read; write F")
        elif "F" in values:
            state.set_feed(values["F"])
            self.fast = self.old and values["F"] in OLD_RAPID
        if self.fast:
            self.it.note("F9999 and F15999 are rapid traverse in programs of old controls")
        return self.fast

    def need_pole(self) -> None:
        """Refuse a block relative to a pole if none is set."""
        if self.it.state.pole is None:
            raise InputError("no pole or centre (CC) stands before this block")
