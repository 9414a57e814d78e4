"""Lexer of the RS-274 family: the lines of a file become the words of blocks; comments and marks are dealt with."""

from __future__ import annotations

import re

from compplan.toolpath.readers.cnc.machine import owns_words
from compplan.toolpath.readers.cnc.path import PathWriter
from compplan.toolpath.readers.cnc.state import AXES, FARTHEST_WITHOUT_POINT
from compplan.toolpath.readers.cnc.words import (
    BLOCK,
    CONTROL,
    CONVERSATIONAL,
    COORDINATE,
    IDENTIFIER,
    NAME_LINE,
    SHIFT,
    SIEMENS,
    SKIP_MARK,
    SKIP_WITHIN,
    TEXT,
    TIP_CONTROL,
    UNSIGNED_EXPONENT,
    check_words,
    drop_harmless,
    find_geometry,
    split_words,
    strip_comments,
)

Words = list[tuple[str, float]]
#: A line that an M code owns, its text included.
OWNER_LINE = re.compile(r"(?:N\d+\s*)?M0*(\d+(?:\.\d+)?)(?=[\sA-Z]|$)(?!.*\bG\d)")
#: Home of a printer: bare letters name axes (G28 X Y) or ways to do it (G28 W); all axes are elsewhere after it.
BARE_HOME = re.compile(r"(?:N\d+\s*)?G28(?:\s+[A-Z]\d?)+\s*")
#: Macro variables and control of the flow (Fanuc).
MACRO = re.compile(
    r"#\s*[\d#<\[]|(?<![A-Z_])[A-Z,]\s*[-+]?\s*\[|"
    r"^(?:N\s*\d+\s*)?(?:IF\s*\[|WHILE\s*\[|GOTO\s*\d|DO\s*[1-9]\s*$|END\s*[1-9]\s*$)"
)
#: O words of LinuxCNC: o1 while, o<name> call.
O_WORD = re.compile(r"(?:N\s*\d+\s*)?O\s*(?:<[^<>]*>|\d+|\[[^\[\]]*\])\s*[A-Z]{2}")
#: Lengths that have no decimal point, and the least ones that no part of a robot has. [mm]
LENGTHS = frozenset("XYZIJKRUVW")
WITHOUT_POINT = re.compile(r"(?<![A-Z,])([XYZIJKRUVW])\s*=?\s*([-+]?\d+)(?![\d.E])")
TOOL_NAME = re.compile(r"\bT\d*\s*=\s*\"([^\"]*)\"", re.IGNORECASE)
MOTION = re.compile(r"(?<![A-Z0-9])G0*[0-3](?![\d.])")


#: Words that end a program, and nothing else.
END_OF_PROGRAM: Words = [("M", 17.0)]


class Lexer:
    """Turn the lines of a G-code file into the words of blocks.

    Lines that are no block are dealt with here: comments, marks, assignments, jumps, calls, vendor words.

    Args:
        path: Writer of the moves, and with it the state of the program.

    """

    def __init__(self, path: PathWriter) -> None:
        self.path, self.state, self.log, self.error = path, path.state, path.log, path.error
        self.flow = path.flow
        #: Whether a block was read.
        self.begun = False

    def read(self, raw: str) -> Words | None:
        """Return the words of the block in a line, None where it holds none.

        Raises:
            InputError: If something in it is not known and may move the tool.

        """
        try:
            line, comments = strip_comments(raw)
        except ValueError as fault:
            raise self.error(str(fault)) from None
        for comment in comments:
            self.log.happen("comment", self.path.line, text=comment)
        if not line:
            return None
        if len(line) > 200:
            line = " ".join(line.split())
        if line[0] in "%<:O" and NAME_LINE.fullmatch(line):
            self.state.siemens = self.state.siemens or line.startswith("%_N_")
            ends = line[0] == "%" and (self.state.moved or (self.begun and line.startswith("%_N_")))
            return END_OF_PROGRAM if ends else None
        if "/" in line:
            line = self._drop_marks(line)
        if line[0] in "ON" and O_WORD.match(line):
            raise self.error(f"program control {line[:40]!r} (O words) is not read; write the program out in the CAM "
                             "system")  # fmt: skip
        words, rest = split_words(line)
        if rest and (owner := OWNER_LINE.match(line)) and owns_words(float(owner.group(1))):
            self.log.note(f"M{owner.group(1)} is not read", self.path.line)
            self.log.happen("comment", self.path.line, text=f"M{owner.group(1)} of the CAM file")
            return None
        if rest and BARE_HOME.fullmatch(line):
            words, rest = [("G", 28.0)], ""
        if rest and not self.state.siemens and MACRO.search(line):
            spelled = self.flow.run_macro(line)
            if spelled is None:
                return None
            line = spelled
            words, rest = split_words(line)
        if (rest or (words and words[0][0] in "LN")) and self.flow.call_name(line):
            return None
        named = TOOL_NAME.search(raw) if '"' in raw else None
        if rest:
            explained = self._explain(re.sub(r"^N\d+\s*", "", line), raw)
            if explained is None:
                return None
            words = explained
        elif "E" in line and UNSIGNED_EXPONENT.search(line):
            raise self.error(f"number {line[:40]!r} may be read in two ways, write it without an exponent")
        fault_text = check_words(words)
        if fault_text:
            raise self.error(fault_text)
        if named:
            self.state.tool_name = named.group(1)
        if number := self._find_without_point(words, line):
            raise self.error(f"{number} has no decimal point and may count in mm or in the control's least increment "
                             f"(0.001 mm); write it with a point ({number}. or {number[0]}{float(number[1:]) / 1e3:g})"
                             )  # fmt: skip
        self.begun = self.begun or any(letter not in "NO" for letter, _ in words)
        return words

    def _find_without_point(self, words: Words, line: str) -> str:
        """Return a word of a length that is too great for a part unless it counts in increments, "" without any."""
        if all(letter not in LENGTHS or abs(number * self.state.scale) < FARTHEST_WITHOUT_POINT
               for letter, number in words):  # fmt: skip
            return ""
        found = [f"{word.group(1)}{word.group(2)}" for word in WITHOUT_POINT.finditer(line)]
        return next((word for word in found if abs(float(word[1:]) * self.state.scale) >= FARTHEST_WITHOUT_POINT), "")

    def _drop_marks(self, line: str) -> str:
        """Return a line without the marks of blocks that an operator may skip."""
        marked = SKIP_WITHIN.sub(" ", SKIP_MARK.sub(r"\1", line, count=1) if SKIP_MARK.match(line) else line)
        if marked != line:
            self.log.note("blocks marked with / are read", self.path.line)
        return marked.strip()

    def _explain(self, line: str, raw: str) -> Words | None:
        """Deal with a line that holds more than words; return the words to be read, None where there are none."""
        if CONVERSATIONAL.match(line):
            raise self.error(f"conversational block {line[:40]!r}; post-process the program to ISO G-code (G0 to G3)")
        if CONTROL.match(line):
            raise self.error(f"program control {line[:40]!r} is not read; write the program out in the CAM system")
        if line == "RET":
            return END_OF_PROGRAM
        self.state.siemens = self.state.siemens or SIEMENS.search(line) is not None
        if SHIFT.match(line):
            self._shift(line)
            return None
        if line.startswith("MSG") and (told := re.search(r'MSG\s*\(\s*"([^"]*)"', raw, re.IGNORECASE)):
            self.log.happen("comment", self.path.line, text=told.group(1))
            return None
        geometry = find_geometry(line, raw)
        if geometry:
            raise self.error(f"{geometry} is not read and changes the path or its frame; post-process without it")
        if TIP_CONTROL.search(line):
            self.state.tip_control = True
        if re.search(r"\bSUPA\b", line):
            words = self._read_past(re.sub(r"\bSUPA\b", " ", line).strip())
            return [*(words or []), ("G", 153.0)]
        if not self.begun and not BLOCK.match(line) and not IDENTIFIER.match(line):
            self.log.note(f"text before the first block is not read: {line[:20]!r}", self.path.line)
            return None
        return self._read_past(line)

    def _read_past(self, line: str) -> Words | None:
        """Read past the words of a line that say nothing of the path."""
        if re.search(r"#|\bR\d+\s*=|=\s*[A-Z(]|(?<![A-Z\d])[A-Z]\s*=?\s*\[", line):
            raise self.error(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        if re.search(r"[\d.]O", line):
            raise self.error(f"letter O stands in or beside a number in {line[:40]!r}, expected digits")
        if re.search(r"(?<![A-Z0-9])[ABC][2-7]\s*=", line):
            raise self.error(f"orientation {line[:40]!r} is not read, expected A3= B3= C3= or rotary axes A B C")
        bare, known, unknown = drop_harmless(line)
        if unknown:
            word = unknown[0][:20]
            plain = unknown[0] in TEXT or not (self.begun or self.state.siemens)
            rest_of_line = IDENTIFIER.sub(" ", bare)
            if not plain and (self.state.siemens or COORDINATE.search(rest_of_line) or MOTION.search(rest_of_line)):
                raise self.error(f"word {word} is not read and may move the tool; post-process without it")
            self.log.note(f"vendor word {word} is not read", self.path.line)
            return None
        for word in known:
            self.log.note(f"vendor word {word[:20]} is not read", self.path.line)
        words, rest = split_words(bare.replace('"', " "))
        rest = re.sub(r"\bT\s*=?(?=\s|$)", "", rest).strip() if '"' in bare else rest
        if not rest:
            return words
        if set(rest) <= set("*%,:$!") or re.fullmatch(r"[DEHLNOPQST]", rest):
            self.log.note(f"character {rest[0]!r} is not read", self.path.line)
            return words
        if "[" in rest:
            raise self.error(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        raise self.error(f"cannot read {rest[:40]!r}, expected words such as X12.5")

    def _shift(self, line: str) -> None:
        """Shift the program's origin (TRANS in place of, ATRANS on top of what shifts it)."""
        found = SHIFT.match(line)
        assert found is not None
        numbers = dict(split_words(found.group(2))[0])
        state = self.state
        old = [value / state.scale for value in state.shift] if found.group(1) == "ATRANS" else [0.0, 0.0, 0.0]
        state.set_shift({axis: old[axis] + numbers.get(AXES[axis], 0.0) for axis in range(3)})
