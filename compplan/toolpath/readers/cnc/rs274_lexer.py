"""Lexer of the RS-274 family: the lines of a file become the words of blocks; comments and marks are dealt with."""

from __future__ import annotations

import re

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import FARTHEST_WITHOUT_POINT
from compplan.toolpath.readers.cnc.origins import Origins
from compplan.toolpath.readers.cnc.rs274_flow import MacroFlow
from compplan.toolpath.readers.cnc.rs274_words import (
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
    owns_words,
    split_words,
    strip_comments,
)
from compplan.toolpath.readers.cnc.state import AXES, CncBlock

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
    """

    def __init__(self, it: Interpreter, macros: MacroFlow, origins: Origins) -> None:
        self.it, self.macros, self.origins, self.state, self.log, self.note = (
            it,
            macros,
            origins,
            it.state,
            it.log,
            it.note,
        )
        #: Whether a block was read.
        self.begun = False

    def read(self, raw: str) -> CncBlock | None:
        """Return the block in a line, None where it holds none."""
        try:
            line, comments = strip_comments(raw)
        except ValueError as fault:
            raise InputError(str(fault)) from None
        for comment in comments:
            self.log.happen("comment", self.it.flow.line, text=comment)
        if not line:
            return None
        if len(line) > 200:
            line = " ".join(line.split())
        if line[0] in "%<:O" and NAME_LINE.fullmatch(line):
            self.state.siemens = self.state.siemens or line.startswith("%_N_")
            ends = line[0] == "%" and (self.it.course.begun or (self.begun and line.startswith("%_N_")))
            return CncBlock(machine=[17.0]) if ends else None
        if "/" in line:
            line = self._drop_marks(line)
        if line[:1] in ("O", "N") and O_WORD.match(line):
            raise InputError(f"program control {line[:40]!r} (O words) is not read; write the program out in the CAM "
                             "system")  # fmt: skip
        words, rest = split_words(line)
        if rest and (owner := OWNER_LINE.match(line)) and owns_words(float(owner.group(1))):
            self.note(f"M{owner.group(1)} is not read")
            self.log.happen("comment", self.it.flow.line, text=f"M{owner.group(1)} of the CAM file")
            return None
        if rest and BARE_HOME.fullmatch(line):
            words, rest = [("G", 28.0)], ""
        if rest and not self.state.siemens and MACRO.search(line):
            spelled = self.macros.run_macro(line)
            if spelled is None:
                return None
            line = spelled
            words, rest = split_words(line)
        if (rest or (words and words[0][0] in "LN")) and (called := self.macros.call_name(line)):
            self.it.call(*called)
            return None
        named = TOOL_NAME.search(raw) if '"' in raw else None
        if rest:
            explained = self._explain(re.sub(r"^N\d+\s*", "", line), raw)
            if explained is None:
                return None
            words = explained
        elif "E" in line and UNSIGNED_EXPONENT.search(line):
            raise InputError(f"number {line[:40]!r} may be read in two ways, write it without an exponent")
        fault_text = check_words(words)
        if fault_text:
            raise InputError(fault_text)
        if named:
            self.state.tool_name = named.group(1)
        if number := self._find_without_point(words, line):
            raise InputError(f"{number} has no decimal point and may count in mm or in the control's least increment "
                             f"(0.001 mm); write it with a point ({number}. or {number[0]}{float(number[1:]) / 1e3:g})"
                             )  # fmt: skip
        self.begun = self.begun or any(letter not in "NO" for letter, _ in words)
        block = CncBlock()
        for letter, value in words:
            if letter == "G":
                block.codes.append(value)
            elif letter == "M":
                block.machine.append(value)
            else:
                block.values[letter] = value
        return block

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
            self.note("blocks marked with / are read")
        return marked.strip()

    def _explain(self, line: str, raw: str) -> Words | None:
        """Deal with a line that holds more than words; return the words to be read, None where there are none."""
        if CONVERSATIONAL.match(line):
            raise InputError(f"conversational block {line[:40]!r}; post-process the program to ISO G-code (G0 to G3)")
        if CONTROL.match(line):
            raise InputError(f"program control {line[:40]!r} is not read; write the program out in the CAM system")
        if line == "RET":
            return END_OF_PROGRAM
        self.state.siemens = self.state.siemens or SIEMENS.search(line) is not None
        if found := SHIFT.match(line):  # TRANS in place of, ATRANS on top of what shifts the origin
            numbers, scale = dict(split_words(found.group(2))[0]), self.state.scale
            old = self.origins.shifted if found.group(1) == "ATRANS" else (0.0, 0.0, 0.0)
            self.origins.shift({axis: old[axis] / scale + numbers.get(AXES[axis], 0.0) for axis in range(3)})
            return None
        if line.startswith("MSG") and (told := re.search(r'MSG\s*\(\s*"([^"]*)"', raw, re.IGNORECASE)):
            self.log.happen("comment", self.it.flow.line, text=told.group(1))
            return None
        geometry = find_geometry(line, raw)
        if geometry:
            raise InputError(f"{geometry} is not read and changes the path or its frame; post-process without it")
        if TIP_CONTROL.search(line):
            self.state.tip_control = True
        if re.search(r"\bSUPA\b", line):
            words = self._read_past(re.sub(r"\bSUPA\b", " ", line).strip())
            return [*(words or []), ("G", 153.0)]
        if not self.begun and not BLOCK.match(line) and not IDENTIFIER.match(line):
            self.note(f"text before the first block is not read: {line[:20]!r}")
            return None
        return self._read_past(line)

    def _read_past(self, line: str) -> Words | None:
        """Read past the words of a line that say nothing of the path."""
        if re.search(r"#|\bR\d+\s*=|=\s*[A-Z(]|(?<![A-Z\d])[A-Z]\s*=?\s*\[", line):
            raise InputError(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        if re.search(r"[\d.]O", line):
            raise InputError(f"letter O stands in or beside a number in {line[:40]!r}, expected digits")
        if re.search(r"(?<![A-Z0-9])[ABC][2-7]\s*=", line):
            raise InputError(f"orientation {line[:40]!r} is not read, expected A3= B3= C3= or rotary axes A B C")
        bare, known, unknown = drop_harmless(line)
        if unknown:
            word = unknown[0][:20]
            plain = unknown[0] in TEXT or not (self.begun or self.state.siemens)
            rest_of_line = IDENTIFIER.sub(" ", bare)
            if not plain and (self.state.siemens or COORDINATE.search(rest_of_line) or MOTION.search(rest_of_line)):
                raise InputError(f"word {word} is not read and may move the tool; post-process without it")
            self.note(f"vendor word {word} is not read")
            return None
        for word in known:
            self.note(f"vendor word {word[:20]} is not read")
        words, rest = split_words(bare.replace('"', " "))
        rest = re.sub(r"\bT\s*=?(?=\s|$)", "", rest).strip() if '"' in bare else rest
        if not rest:
            return words
        if set(rest) <= set("*%,:$!") or re.fullmatch(r"[DEHLNOPQST]", rest):
            self.note(f"character {rest[0]!r} is not read")
            return words
        if "[" in rest:
            raise InputError(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        raise InputError(f"cannot read {rest[:40]!r}, expected words such as X12.5")
