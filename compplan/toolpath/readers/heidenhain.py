"""Reader of Heidenhain conversational programs (Klartext), with one table entry per statement.

A new statement is one line of `STATEMENTS`: `run(dialect, rest)` executes it; `rest` follows its first word.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc import heidenhain_words as lexer
from compplan.toolpath.readers.cnc.contour import Corner
from compplan.toolpath.readers.cnc.flow import END, CncProgram, Flow
from compplan.toolpath.readers.cnc.heidenhain_approach import run_approach
from compplan.toolpath.readers.cnc.heidenhain_cycles import HeidenhainCycles, find_spatial
from compplan.toolpath.readers.cnc.heidenhain_words import ADDRESSES, KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import STRAIGHT
from compplan.toolpath.readers.cnc.state import AXES, INCH, LETTERS, CncBlock, State
from compplan.toolpath.readers.frames import PLANE_AXES, PLANE_NORMALS, stretch
from compplan.toolpath.readers.lines import count_lines, match_form
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable, refuse_unit

name = "heidenhain"
suffixes = (".h", ".i", ".hnc")

HEAD = re.compile(r"^[ \t]*\d*[ \t]*BEGIN[ \t]+PGM\b", re.MULTILINE | re.IGNORECASE)
KLARTEXT = re.compile(
    r"^[ \t]*\d+[ \t]+(TOOL[ \t]+CALL|CYCL[ \t]+DEF|BLK[ \t]+FORM|CALL[ \t]+LBL|LBL[ \t]+\d|L[ \t]+[XYZI][-+\d])",
    re.MULTILINE | re.IGNORECASE,
)
DEEPEST = 19
#: Motions: straight, arcs about the pole, arcs by radius, tangent arcs.
MOTIONS = {"L", "LP", "LN", "C", "CR", "CT", "CP", "CTP"}
#: M functions that affect neither the path nor machine functions of a robot.
SILENT = frozenset(map(float, (
    6, 10, 11, 16, 17, 21, 22, 25, 26, 31, 32, 52, 53, 54, 57, 59, 89, 90, 91, 92, 94, 97, 98, 99, 101, 102, 107, 108,
    *range(111, 114), *range(115, 119), 120, 124, 126, 127, 128, 129, *range(134, 139), *range(140, 146), 148, 149,
)))  # fmt: skip
POSITION = re.compile(r"POS\s*\d+\s*\(([^()]*)\)")
CORNER = re.compile(rf"(RND|CHF)\s*R?\s*({lexer.VALUE})\s*(?:F\s*({lexer.VALUE}))?\s*")
WORD = re.compile(r"[A-Z]+")
#: FUNCTION .. without effect on the path.
SILENT_FUNCTION = re.compile(
    r"(MODE\s+(MILL|SET)|FEED|S-PULSE|PROG\s+PATH\s+IS\s+CONTOUR|AFC|DCM|COUNT|RESET|TABDATA|FILE|CORRDATA|LIFTOFF|"
    r"DRESS|TURNDATA\s+SPIN)"
)


def recognise(text: str) -> int:
    """Return 3 for BEGIN PGM, 2 for other Klartext or DIN/ISO of these controls (which is refused), otherwise 0."""
    return 3 if HEAD.search(text) else 2 if KLARTEXT.search(text) or lexer.ISO.search(text) else 0


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a conversational program with its subprograms.

    The path is in the datum that is active at the beginning (cycle 247). The tool axis follows from tilted planes,
    rotary axes and vectors.
    """
    if not HEAD.search(text) and (found := lexer.ISO.search(text)):
        message = "a DIN/ISO program of a Heidenhain control is not read; write it in Klartext"
        raise InputError(message, file=file, where=text.count("\n", 0, found.start()) + 1)
    reader = Klartext(file, options)
    reader.it.run(lambda: reader.load(text))
    if not reader.begun and options.unit is None:
        raise InputError(refuse_unit("BEGIN PGM .. MM or INCH").message, file=file, where=1)
    unit = "not stated" if not reader.begun else "mm" if reader.words.unit == 1.0 else "inch"
    return reader.it.log.finish(file, name, unit, count_lines(text))


class Klartext:
    """Dialect of Heidenhain Klartext: executes the blocks of a program."""

    tip_word, turns_to_plane = "M128", False
    frames: tuple[str, ...] = ("unit", "datum", "plane", "shift", "mirror", "rotation", "scale")
    ends, moving = frozenset({2.0, 30.0}), STRAIGHT
    silent = SILENT

    def __init__(self, file: Path, options: CamTable) -> None:
        flow = Flow(file, DEEPEST)
        flow.weigh = lambda block: len(block.text)
        self.it = Interpreter(file, options, State(motion=0.0), self, flow)
        self.it.motion.keeps_polar = False
        self.words = KlartextWords(self.it)
        self.value = self.words.value
        self.labels: dict[str, int] = {}
        self.begun = False
        #: Whether every positioning move calls the cycle (M89, modal).
        self.calls = False
        self.cycles = HeidenhainCycles(self.it, self.words)
        self.points: list[Point] = []
        self._set_unit(INCH if options.unit == "inch" else 1.0)

    def load(self, text: str) -> CncProgram:
        """Split the text into a program and find its labels."""
        blocks, flow = list(lexer.split_blocks(text)), self.it.flow
        for index, block in enumerate(blocks):
            if block.text.startswith("LBL"):
                flow.line = block.line
                word = match_form(lexer.LABEL, block.text, "label: LBL and a number or a name").group(1)
                if word in self.labels:
                    raise InputError(f"label {word} occurs twice, first in line {blocks[self.labels[word]].line}")
                if word != "0":
                    self.labels[word] = index
        return CncProgram(blocks, 0, len(blocks), self.it.file)

    def square(self) -> Point:
        """Return the tool axis with all rotary axes at 0, or that of spatial angles (TCPM AXIS SPAT)."""
        normal, angles = PLANE_NORMALS[self.it.state.plane], self.it.rotary.angles
        if not self.it.rotary.spatial:
            return normal
        return find_spatial(*(angles.get(letter, 0.0) for letter in LETTERS)).turn(normal)

    def run_line(self, program: CncProgram, index: int) -> int:
        """Execute a block; return the index of the next one, or END."""
        it, block = self.it, program.lines[index]
        it.flow.line, text = block.line, block.text
        if block.comment:
            it.log.add_event("comment", text=block.comment)
        index += 1
        if text[:1] == "/":
            it.note("blocks marked with / are read")
            text = text[1:].strip()
        if not text:
            return index
        if (text == "LBL 0" and it.flow.depth) or text.startswith("END PGM"):
            return END
        if it.steady and (plain := lexer.PLAIN.fullmatch(text)):
            followed = index < program.last and program.lines[index].text[:3] not in ("RND", "CHF", "")
            if followed and it.motion.cut_plain(plain):
                return index
        it.steady = False
        if text.startswith("CALL") or (" GOTO" in text and text.startswith(("FN", "IF"))):
            return self._jump(text, program, index)
        self._carry_out(text, program, index)
        it.steady = text[0] == "L" and not (self.words.fast or self.calls) and it.motion.is_steady()
        return index

    def _jump(self, text: str, program: CncProgram, index: int) -> int:
        """Execute a call of a label, a repetition or a jump; return the index of the next block."""
        flow = self.it.flow
        if not text.startswith("CALL"):
            one, how, other, label = match_form(lexer.JUMP, text, "jump: IF .. EQU .. GOTO LBL ..").groups()
            a, b = self.value(one), self.value(other)
            jumps = {"EQU": a == b, "NE": a != b, "GT": a > b, "LT": a < b}[how]
            return self._label(label) if jumps else index
        label, times = match_form(lexer.CALL, text, "call: a label of the program").groups()
        start = self._label(label)
        if times is None:
            self.it.contour.refuse_open()
            flow.run_program(f"LBL {label}", program, 1, start)
            return index
        if start > index:
            raise InputError(f"CALL LBL {label} REP before its label has two meanings; call it without REP")
        return start if flow.repeat(index, lambda: self.value(times)) else index

    def _label(self, word: str) -> int:
        key = word if word.startswith('"') or word.isdigit() else f"{self.value(word):g}"
        if key not in self.labels:
            raise InputError(f"label {key} is not in this program")
        return self.labels[key] + 1

    def _carry_out(self, text: str, program: CncProgram, index: int) -> None:
        """Execute a block without jump."""
        first = WORD.match(text)
        word = first.group() if first else ""
        defining, self.cycles.defining = self.cycles.defining, False
        if word in MOTIONS:
            self._move(word, text[len(word) :], self._corner_after(program, index))
        elif word.removeprefix("I") in ADDRESSES:  # X+10 alone
            self._move("L", text, self._corner_after(program, index))
        elif text[0] in "*;" or (text[0] == "(" and not self.begun and text.endswith(")")):
            self.it.log.add_event("comment", text=text[1 : -1 if text[0] == "(" else None].strip())
        elif word.startswith("Q") and "=" in text:
            self.cycles.defining = defining
            if not (defining and self.cycles.add_values(text)):
                self._assign(text)
        elif word in STATEMENTS:
            STATEMENTS[word](self, text[len(word) :].strip())
        elif word in REFUSED:
            raise InputError(f"{word} ({REFUSED[word]}) is not read; post-process without it")
        elif word in SILENT_WORDS or text == "END-SUB":
            pass
        elif word == "ERROR" or set(text) <= set("%-_=#* "):
            self.it.note(f"line {text[:20]!r} is not read")
        else:
            raise InputError(f"block {text[:40]!r} is not read and may move the tool; post-process without it")

    def _corner_after(self, program: CncProgram, index: int) -> Corner | None:
        """Return the corner (RND, CHF) in the next block, None without any."""
        while index < program.last and not program.lines[index].text:
            index += 1
        if index >= program.last or program.lines[index].text[:3] not in ("RND", "CHF"):
            return None
        block, here = program.lines[index], self.it.flow.line
        self.it.flow.line = block.line
        kind, size, speed = match_form(CORNER, block.text, "corner: RND or CHF, a number and F").groups()
        self.it.flow.line = here
        feed = None if speed is None else self.it.state.to_mm_s(self.value(speed))
        return Corner("ROUND" if kind == "RND" else "LEG", self.value(size), feed, block.line)

    def check_corner(self, rest: str) -> None:
        """RND, CHF: refuse a corner without a cutting move before it; `_corner_after` reads all others."""
        if self.it.contour.held is None:
            raise InputError("RND or CHF does not stand between two cutting moves; leave it out")

    def begin(self, rest: str) -> None:
        """BEGIN PGM: set the unit."""
        unit = re.search(r"\b(MM|IN|INCH)\s*$", rest)
        if self.begun:
            raise InputError("a second program begins; one a file is read")
        if not unit:
            raise InputError(f"{rest[:40]!r} states no unit, expected MM or INCH at its end")
        self.begun = True
        self._set_unit(1.0 if unit.group(1) == "MM" else INCH)

    def _set_unit(self, scale: float) -> None:
        self.words.unit = scale
        self.it.set_frames(unit=stretch((scale, scale, scale)) if scale != 1.0 else None)
        self.words.set_feed_mode(94)

    def _assign(self, text: str) -> None:
        """Execute Q1 = formula."""
        target, formula = match_form(lexer.ASSIGN, text, "assignment").groups()
        if target.startswith("QS") or '"' in formula:
            self.words.forget(target, f"line {self.it.flow.line} gives it text")
        else:
            self.words.values[target] = self.value(formula)

    def run_function(self, text: str) -> None:
        """FN 0 to 8 and 13: assignments; parameters that other functions set are unknown."""
        found = match_form(lexer.FUNCTION_NUMBER, f"FN {text}", "function: FN, its number and a colon")
        number, rest, line = int(found.group(1)), found.group(2).strip(), self.it.flow.line
        if number in (*range(9), 13) and lexer.ASSIGN.match(rest):
            self._assign(rest)
        elif number in (14, 20):
            self.it.log.add_event("call" if number == 20 else "stop", text=f"FN {text}"[:60])
        else:
            for target in re.findall(r"Q[LRS]?\d+", rest)[:1]:
                self.words.forget(target, f"FN {number} of line {line} sets it")
            self.it.note(f"FN {number} is not read")

    def run_word_function(self, rest: str) -> None:
        """FUNCTION: tool centre point control (TCPM), dwells."""
        if rest.startswith("RESET TCPM"):
            self.it.control_tip(False)
        elif rest.startswith("TCPM"):
            self.it.control_tip(True, spatial="AXIS SPAT" in rest)
            if re.search(r"REFPNT\s+(CNT|TIP-CNT|CNT-CNT)", rest):
                raise InputError("TCPM with the centre of the tool as reference (REFPNT CNT) is not read")
        elif rest.startswith("DWELL") and (found := re.search(rf"TIME\s*({lexer.NUMBER})", rest)):
            self.it.log.add_event("dwell", value=float(found.group(1)))
        elif SILENT_FUNCTION.match(rest):
            self.it.note(f"FUNCTION {rest.split()[0]} is not read")
        else:
            raise InputError(f"FUNCTION {rest[:30]!r} is not read and may change the path")

    def probe(self, rest: str) -> None:
        """TCH PROBE: left out; the position at its end is unknown."""
        self.it.note("probing (TCH PROBE) is left out; where it ended is not known")
        self.it.contour.refuse_open()
        self.it.course.mark_unknown()

    def run_functions(self, text: str, *, stops: bool = False) -> None:
        """M functions without a move, or after STOP."""
        block = self.words.read(text if text[:1] == "M" or not text or stops else f"M{text}")
        if block.values.keys() - {"F", "S"} or set(block.names) - {"FMAX"}:
            raise InputError(f"cannot read the block {text[:40]!r}")
        with self.words.functions(block) as codes:
            if stops:
                self.it.log.add_event("stop")
            self._call_cycle(codes & {89.0, 99.0})

    def _call_cycle(self, codes: set[float]) -> None:
        """Execute the cycle after a move that calls it: M99 once, M89 modal."""
        if codes:
            self.calls = self.calls or 89.0 in codes
            self.cycles.call()
            self.calls = self.calls and 99.0 not in codes

    def _move(self, kind: str, rest: str, corner: Corner | None) -> None:
        """Execute a motion block; `corner` is the corner in the next block."""
        it, state = self.it, self.it.state
        block = self.words.read(re.sub(r"\([^()]*\)$", "", rest))
        with self.words.functions(block) as codes:
            rapid = self.words.set_modes(block)
            if codes & {91.0, 92.0}:
                it.leave_out_machine_move(block, "M91, M92")
            else:
                if kind[0] == "L":
                    if "R" in block.values or any(word.startswith("DR") for word in (*block.values, *block.names)):
                        raise InputError("words of an arc in a straight block; remove them")
                    state.motion = 0.0 if rapid else 1.0
                    if kind == "LN":
                        self._read_vector(block)
                elif rapid:
                    raise InputError("an arc with FMAX is not read; give it a feed")
                else:
                    self._read_arc(kind, block)
                it.motion.move(block, corner)
            self._call_cycle(codes & {89.0, 99.0} or ({89.0} if self.calls else set()))

    def _read_vector(self, block: CncBlock) -> None:
        """Read the tool axis of LN: TX TY TZ, or with tip control the normal NX NY NZ; A B C are ignored."""
        values = block.values
        for letter in LETTERS:
            values.pop(letter, None)
        for kind in ("T", "N") if self.it.state.tip_control else ("T",):
            found = {f"{name}3": values[kind + axis] for name, axis in zip(LETTERS, AXES, strict=True)
                     if kind + axis in values}  # fmt: skip
            if found:
                values.update(found)
                return

    def _read_arc(self, kind: str, block: CncBlock) -> None:
        """Read C and CP (about the pole), CR (radius), CT and CTP (tangent)."""
        state, values = self.it.state, block.values
        if kind in ("CT", "CTP"):
            state.motion = "CT"
            return
        if "DR+" not in block.names and "DR-" not in block.names:
            raise InputError("arc without a sense, expected DR+ or DR-")
        state.motion = 3.0 if "DR+" in block.names else 2.0
        if kind == "CR":
            if "R" not in values:
                raise InputError("CR has no radius R")
            values["CR"] = values["R"]
        else:
            self.words.need_pole()
            block.names.append("CC")
        if "AP" in block.relative:
            angle = values["AP"]
            if angle == 0.0 or (angle > 0.0) != (state.motion == 3.0):
                raise InputError(f"IPA{angle:+g} and DR contradict each other; write both with one sign")
            values["TURN"] = math.ceil(abs(angle) / 360.0 - 1e-9) - 1.0

    def set_pole(self, rest: str) -> None:
        """CC: set the pole, or the centre of arcs."""
        block, state = self.words.read(rest), self.it.state
        named = block.list_axes()
        if named and len(named) != 2:
            raise InputError(f"CC names {len(named)} axes, expected 2 (or none: where the tool is)")
        plane = next(plane for plane, axes in PLANE_AXES.items() if set(axes) == set(named)) if named else state.plane
        state.pole, state.pole_plane = state.place(block, self.it.contour.position)[0], plane
        with self.words.functions(block):
            pass

    def call_cycle(self, rest: str) -> None:
        """CYCL CALL, CYCL CALL POS, CYCL CALL PAT, CYCL DEF: call or define a cycle."""
        if not rest.startswith("CALL"):
            self.cycles.define(f"CYCL {rest}")
            return
        words = rest.removeprefix("CALL").strip()
        pattern = words.startswith("PAT")
        if pattern and not self.points:
            raise InputError("CYCL CALL PAT before a supported pattern is defined")
        block = self.words.read(words.removeprefix("PAT").removeprefix("POS"))
        with self.words.functions(block) as codes:
            self.words.set_modes(block)
            at_place = words.startswith("POS")
            for place in self.points if pattern else [self.it.motion.target(block)[0] if at_place else None]:
                self.cycles.call(place)
            if not pattern:
                self.calls = (self.calls or 89.0 in codes) and 99.0 not in codes

    def define_pattern(self, text: str) -> None:
        """PATTERN DEF: define a pattern of single positions (POS)."""
        if POSITION.sub("", text.removeprefix("DEF")).strip():
            raise InputError(f"PATTERN {text[:32]!r} is not read, only PATTERN DEF with POS is")
        self.points = [self.it.motion.target(self.words.read(words))[0] for words in POSITION.findall(text)]


#: Operation of each statement on the rest of its block.
STATEMENTS: dict[str, Callable[[Klartext, str], None]] = {
    "BEGIN": Klartext.begin, "M": Klartext.run_functions,
    "STOP": lambda dialect, rest: dialect.run_functions(rest, stops=True),
    "TOOL": lambda dialect, rest: dialect.words.change_tool(rest),
    "FN": Klartext.run_function, "FUNCTION": Klartext.run_word_function, "TCH": Klartext.probe,
    # frames
    "PLANE": lambda dialect, rest: dialect.cycles.run_plane(rest),
    "TRANS": lambda dialect, rest: dialect.cycles.run_trans(rest),
    # contours and cycles
    "CC": Klartext.set_pole, "RND": Klartext.check_corner, "CHF": Klartext.check_corner,
    "APPR": lambda dialect, rest: run_approach(dialect.it, dialect.words, rest),
    "DEP": lambda dialect, rest: run_approach(dialect.it, dialect.words, rest, leaves=True),
    "CYCL": Klartext.call_cycle, "PATTERN": Klartext.define_pattern,
}  # fmt: skip
#: Statements without effect on the path, and those that are refused.
SILENT_WORDS = frozenset(("BLK", "FLUTE", "SEL", "DECLARE", "OPEN", "CLOSE", "WRITE", "GLOBAL", "SQL", "LBL"))
REFUSED = {
    "SPL": "splines", "CONTOUR": "contour cycles", "TURNDATA": "turning", "POLARKIN": "polar kinematics",
    "AFC": "adaptive feed", **dict.fromkeys(("FL", "FLT", "FC", "FCT", "FPOL", "FSELECT"), "free contours"),
}  # fmt: skip
