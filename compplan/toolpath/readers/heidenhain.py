"""Heidenhain conversational programs (Klartext, .h) of TNC 4xx, iTNC 530, TNC 6xx: flow, parameters, blocks."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.contour import Corner
from compplan.toolpath.readers.expressions import evaluate
from compplan.toolpath.readers.frames import Frame, stretch
from compplan.toolpath.readers.heidenhain_cycles import HeidenhainCycleReader
from compplan.toolpath.readers.heidenhain_frames import INCH
from compplan.toolpath.readers.heidenhain_words import (
    ASSIGN,
    CALL,
    FUNCTION_NUMBER,
    GRAMMAR,
    ISO,
    JUMP,
    LABEL,
    NUMBER,
    VALUE,
    HeidenhainBlock,
    split_blocks,
)
from compplan.toolpath.readers.lines import MOST_LINES, count_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.plain import PLAIN_KLARTEXT
from compplan.toolpath.readers.start import refuse_unit

name = "heidenhain"
suffixes = (".h", ".i", ".hnc")

HEAD = re.compile(r"^[ \t]*\d*[ \t]*BEGIN[ \t]+PGM\b", re.MULTILINE | re.IGNORECASE)
KLARTEXT = re.compile(
    r"^[ \t]*\d+[ \t]+(TOOL[ \t]+CALL|CYCL[ \t]+DEF|BLK[ \t]+FORM|CALL[ \t]+LBL|LBL[ \t]+\d|L[ \t]+[XYZI][-+\d])",
    re.MULTILINE | re.IGNORECASE,
)
#: Greatest number of jumps and calls that are carried out, and how deep programs call one another.
MOST_JUMPS = 200_000
DEEPEST = 19
MOTIONS = {"L", "LP", "LN", "C", "CR", "CT", "CP", "CTP"}
#: Blocks that say nothing of the path.
SILENT = {"BLK", "FLUTE", "SEL", "DECLARE", "OPEN", "CLOSE", "WRITE", "END-SUB", "GLOBAL", "SQL"}
REFUSED = {
    "SPL": "splines", "FL": "free contours", "FLT": "free contours", "FC": "free contours", "FCT": "free contours",
    "FPOL": "free contours", "FSELECT": "free contours", "CONTOUR": "contour cycles", "TURNDATA": "turning",
    "POLARKIN": "polar kinematics", "AFC": "adaptive feed",
}  # fmt: skip
WORD = re.compile(r"[A-Z]+")


def recognise(text: str) -> int:
    """Tell whether a text is Klartext, or DIN/ISO of the same controls (which is refused)."""
    return 3 if HEAD.search(text) else 2 if KLARTEXT.search(text) or ISO.search(text) else 0


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a conversational program: its first one, with its own subprograms.

    The path stands in the datum that is in force at the beginning (cycle 247), the tool axis follows from tilted planes
    and vectors.

    Args:
        text: The program.
        file: Its file, for messages.
        options: What the program does not say by itself.

    Raises:
        InputError: With file and line, if a block is not read and may change the path.

    """
    reader = _HeidenhainReader(file, options)
    reader.run(text)
    unit = "not stated" if not reader.begun else "inch" if reader.inch else "mm"
    return reader.log.finish(file, name, unit, count_lines(text))


class _HeidenhainReader(HeidenhainCycleReader):
    """Follow a program block by block."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.blocks: list[HeidenhainBlock] = []
        self.labels: dict[str, int] = {}
        self.begun = self.inch = False
        self.jumps = 0
        self.steps = 0
        if options.unit == "inch":
            self._set_inch()

    def run(self, text: str) -> None:
        """Read every block up to the end of the program."""
        if not HEAD.search(text) and (found := ISO.search(text)):
            self.line = text.count("\n", 0, found.start()) + 1
            raise self.error("a DIN/ISO program of a Heidenhain control is not read; write it in Klartext")
        try:
            self.blocks = list(split_blocks(text))
        except ValueError as fault:
            raise self.error(str(fault)) from None
        self._find_labels()
        try:
            self._run(0, 0)
            self.contour.refuse_open()
        except ValueError as fault:
            raise self.error(str(fault)) from None
        except InputError as fault:
            raise fault if fault.file else self.error(fault.message) from None
        self.end_running()
        if not self.begun and self.options.unit is None:
            self.line = 1
            raise self.error(refuse_unit("BEGIN PGM .. MM or INCH").message)

    def _find_labels(self) -> None:
        for index, block in enumerate(self.blocks):
            if not block.text.startswith("LBL"):
                continue
            found = LABEL.match(block.text)
            self.line = block.line
            if not found:
                raise self.error(f"label {block.text[:30]!r} is not read, expected LBL and a number or a name")
            word = found.group(1)
            if word != "0" and word in self.labels:
                raise self.error(f"label {word} stands twice, first in line {self.blocks[self.labels[word]].line}")
            if word != "0":
                self.labels[word] = index

    def _run(self, index: int, depth: int) -> int:
        """Carry out blocks from one on, to the end of the program (or of the subprogram, where depth is not 0)."""
        blocks, count = self.blocks, len(self.blocks)
        repeats: dict[int, int] = {}
        while index < count and not self.ends:
            block = blocks[index]
            self.line, text = block.line, block.text
            self.steps += 1
            if self.steps > MOST_LINES:
                raise self.error(f"more than {MOST_LINES} blocks are carried out, repeats counted; no more are read")
            if block.comment:
                self.log.happen("comment", self.line, text=block.comment)
            index += 1
            if text[:1] == "/":
                self.log.note("blocks marked with / are read", self.line)
                text = text[1:].strip()
            if not text:
                continue
            if text == "LBL 0" and depth:
                return index
            plain = PLAIN_KLARTEXT.fullmatch(text) if self.steady else None
            if plain and self._is_followed(index) and self.cut_plain(plain):
                continue
            self.steady = False
            if text[0] in "CIF" and (text.startswith(("CALL", "FN", "IF")) and self._jumps(text)):
                index = self._jump(text, index, depth, repeats)
                continue
            if text.startswith("END PGM"):
                return index
            self._carry_out(text, index)
            self.steady = text[0] == "L" and self.is_steady()
        return index

    def _is_followed(self, index: int) -> bool:
        """Return whether a block comes next, and asks for no corner."""
        return index < len(self.blocks) and self.blocks[index].text[:3] not in ("RND", "CHF", "")

    def _jumps(self, text: str) -> bool:
        return text.startswith("CALL") or " GOTO" in text

    def _jump(self, text: str, index: int, depth: int, repeats: dict[int, int]) -> int:
        """Carry out a call of a label, a repetition or a jump; return where to go on."""
        self.jumps += 1
        if self.jumps > MOST_JUMPS:
            raise self.error(f"more than {MOST_JUMPS} jumps and calls are carried out; no more are read")
        if not text.startswith("CALL"):
            found = JUMP.search(text)
            if not found:
                raise self.error(f"jump {text[:40]!r} is not read, expected IF .. EQU .. GOTO LBL ..")
            one, how, other, label = found.groups()
            a, b = self._formula(one), self._formula(other)
            jumps = {"EQU": a == b, "NE": a != b, "GT": a > b, "LT": a < b}[how]
            return self._label(label) if jumps else index
        found = CALL.match(text)
        if not found:
            raise self.error(f"call {text[:40]!r} is not read, only labels of the program are called")
        label, times = found.groups()
        start = self._label(label)
        if times is None:
            if depth >= DEEPEST:
                raise self.error(f"subprograms call one another more than {DEEPEST} deep")
            self.contour.refuse_open()
            here = self.line
            self._run(start, depth + 1)
            self.line = here
            return index
        left = repeats.get(index)
        left = int(self.value(times)) if left is None else left
        if left > 0:
            repeats[index] = left - 1
            return start
        repeats.pop(index, None)
        return index

    def _label(self, word: str) -> int:
        key = word if word.startswith('"') or word.isdigit() else f"{self.value(word):g}"
        if key not in self.labels:
            raise self.error(f"label {key} is not in this program")
        return self.labels[key] + 1

    def _carry_out(self, text: str, index: int) -> None:
        """Carry out a block that does not jump."""
        first = WORD.match(text)
        word = first.group() if first else ""
        defining, self.defining = self.defining, False
        if word in MOTIONS:
            corner = self._corner_after(index) if index < len(self.blocks) else None
            self.run_motion(word, text[len(word) :], corner)
        elif text[0] == "(" and not self.begun and text.endswith(")"):
            self.log.happen("comment", self.line, text=text[1:-1].strip())
        elif text[0] in "*;":
            self.log.happen("comment", self.line, text=text[1:].strip())
        elif word.startswith("Q") and "=" in text:
            self._assign(text)
            if defining:
                self.add_value(text)
                self.defining = True
        elif text[0] in "XYZABC" and len(word) == 1 and word not in MOTIONS:
            self.run_motion("L", text, self._corner_after(index))
        elif word in ("RND", "CHF"):
            if self.contour.held is None:
                raise self.error(f"{word} does not stand between two cutting moves")
        elif word == "IX" or word in ("IY", "IZ", "IA", "IB", "IC"):
            self.run_motion("L", text, self._corner_after(index))
        else:
            self._carry_out_other(word, text)

    def _carry_out_other(self, word: str, text: str) -> None:
        rest = text[len(word) :].strip()
        if word == "CC":
            self.set_pole(rest)
        elif word == "CYCL":
            if rest.startswith("CALL"):
                self.run_call(text)
            else:
                self.define_cycle(text)
        elif word == "TOOL":
            self.change_tool(text)
        elif word == "FN":
            self._run_function(text)
        elif word == "PLANE":
            self.run_plane(rest)
        elif word == "APPR":
            self.run_approach(rest)
        elif word == "DEP":
            self.run_departure(rest)
        elif word == "BEGIN":
            self._begin(text)
        elif word == "STOP" or (word == "M" and rest[:1].isdigit()):
            self._run_functions(word, text)
        elif word == "PATTERN":
            self.define_pattern(text)
        elif word in ("FUNCTION", "TRANS"):
            self._run_word(word, rest)
        elif word == "LBL" or word in SILENT:
            pass
        elif word == "TCH":
            self.log.note("probing (TCH PROBE) is left out; where it ended is not known", self.line)
            self.contour.refuse_open()
            self.course.lose()
        elif word in REFUSED:
            raise self.error(f"{word} ({REFUSED[word]}) is not read; post-process without it")
        elif word == "ERROR" or set(text) <= set("%-_=#* "):
            self.log.note(f"line {text[:20]!r} is not read", self.line)
        else:
            raise self.error(f"block {text[:40]!r} is not read and may move the tool; post-process without it")

    def _run_functions(self, word: str, text: str) -> None:
        """Carry out a block of M functions alone, and STOP."""
        words, functions = self.split(text.removeprefix("STOP"))
        if words.keys() - {"F", "FMAX"}:
            raise self.error(f"cannot read the block {text[:40]!r}")
        self.start_functions(functions)
        if word == "STOP":
            self.log.happen("stop", self.line)
        if functions & {89, 99}:
            self.call_where_asked(functions)
        self.stop_functions(functions)

    def _corner_after(self, index: int) -> Corner | None:
        """Return the corner that the next block asks for."""
        while index < len(self.blocks) and not self.blocks[index].text:
            index += 1
        if index >= len(self.blocks) or self.blocks[index].text[:3] not in ("RND", "CHF"):
            return None
        block = self.blocks[index]
        found = re.fullmatch(rf"(RND|CHF)\s*R?\s*({VALUE})\s*(?:F\s*({VALUE}))?\s*((?:M\s*\d+\s*)*)", block.text)
        if not found or found.group(4):
            self.line = block.line
            raise self.error(f"corner {block.text[:30]!r} is not read, expected RND or CHF, a number and F")
        feed = None if found.group(3) is None else self.to_mm_s(self.value(found.group(3)))
        return Corner("ROUND" if found.group(1) == "RND" else "LEG", self.value(found.group(2)), feed, block.line)

    def _begin(self, text: str) -> None:
        unit = re.search(r"\b(MM|INCH)\s*$", text)
        if self.begun:
            raise self.error("a second program begins; one a file is read")
        if not unit:
            raise self.error(f"{text[:40]!r} states no unit, expected MM or INCH at its end")
        self.begun = True
        if unit.group(1) == "INCH" and not self.inch:
            self._set_inch()
        elif unit.group(1) == "MM" and self.inch:
            self.inch, self.unit = False, Frame()
            self.set_frame()

    def _set_inch(self) -> None:
        self.inch, self.unit = True, stretch(INCH, INCH, INCH)
        self.set_frame()

    def _assign(self, text: str) -> None:
        """Carry out Q1 = formula."""
        found = ASSIGN.fullmatch(text)
        if not found:
            raise self.error(f"assignment {text[:40]!r} is not read")
        target, formula = found.groups()
        if target.startswith("QS") or '"' in formula:
            self.unknown[target] = f"line {self.line} gives it text"
            self.values.pop(target, None)
            return
        self.values[target] = self._formula(formula)

    def _formula(self, text: str) -> float:
        try:
            return evaluate(re.sub(r"(?<=\d),(?=\d)", ".", text), GRAMMAR, self.look_up)
        except ValueError as fault:
            raise self.error(str(fault)) from None

    def _run_function(self, text: str) -> None:
        """Carry out FN 0 to 8 and 13; what others set is not known."""
        found = FUNCTION_NUMBER.match(text)
        if not found:
            raise self.error(f"function {text[:30]!r} is not read, expected FN, its number and a colon")
        number, rest = int(found.group(1)), found.group(2).strip()
        assigned = ASSIGN.match(rest)
        if number in (*range(9), 13) and assigned:
            self._assign(rest)
        elif number == 20:
            self.log.happen("call", self.line, text=f"{text[:60]}")
        elif number == 14:
            self.log.happen("stop", self.line, text=text[:60])
        else:
            for target in re.findall(r"Q[LRS]?\d+", rest)[:1]:
                self.values.pop(target, None)
                self.unknown[target] = f"FN {number} of line {self.line} sets it"
            self.log.note(f"FN {number} is not read", self.line)

    def _run_word(self, word: str, rest: str) -> None:
        """Carry out FUNCTION .. and TRANS .. ."""
        if word == "TRANS":
            if rest.startswith("DATUM AXIS"):
                self.shift_datum(rest.removeprefix("DATUM AXIS").strip())
            elif rest == "DATUM RESET":
                self.shift_datum("X0 Y0 Z0")
            else:
                raise self.error(f"TRANS {rest[:30]!r} is not read; use cycles 7, 8, 10, 11")
        elif rest.startswith("RESET TCPM"):
            self.control_tip(False)
        elif rest.startswith("TCPM"):
            self.control_tip(True, spatial="AXIS SPAT" in rest)
            if re.search(r"REFPNT\s+(CNT|TIP-CNT|CNT-CNT)", rest):
                raise self.error("TCPM with the centre of the tool as reference (REFPNT CNT) is not read")
        elif rest.startswith("DWELL") and (found := re.search(rf"TIME\s*({NUMBER})", rest)):
            self.log.happen("dwell", self.line, value=float(found.group(1)))
        elif re.match(r"(MODE\s+(MILL|SET)|FEED|S-PULSE|PROG\s+PATH\s+IS\s+CONTOUR|AFC|DCM|COUNT|RESET|TABDATA|"
                      r"FILE|CORRDATA|LIFTOFF|DRESS|TURNDATA\s+SPIN)", rest):  # fmt: skip
            self.log.note(f"FUNCTION {rest.split()[0]} is not read", self.line)
        else:
            raise self.error(f"FUNCTION {rest[:30]!r} is not read and may change the path")
