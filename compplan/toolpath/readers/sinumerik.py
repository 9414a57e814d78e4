"""Reader of Sinumerik 840D programs, with one table entry per word, and their frames.

A new word is one line of `WORDS`: a G code by its number, any other by its name; see `readers.gcode` for the entries.
"""

from __future__ import annotations

import re
from itertools import zip_longest
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc import sinumerik_program as lexer
from compplan.toolpath.readers.cnc.cycles import SinumerikCycles
from compplan.toolpath.readers.cnc.flow import END, CncProgram, Flow
from compplan.toolpath.readers.cnc.interpreter import (
    COMMON,
    MOTIONS,
    MOVING,
    Code,
    Interpreter,
    ignore,
    refuse,
    set_mode,
)
from compplan.toolpath.readers.cnc.motion import CORNERS, MIDDLES, PLAIN, POLAR
from compplan.toolpath.readers.cnc.origins import FRAME_WORDS, Origins, change_frame, swivel
from compplan.toolpath.readers.cnc.sinumerik_program import FLOW, SinumerikFlow, strip
from compplan.toolpath.readers.cnc.state import AXES, INCH, CncBlock, State
from compplan.toolpath.readers.frames import PLANE_NORMALS, UP
from compplan.toolpath.readers.gcode import BEGINNING, refuse_turning
from compplan.toolpath.readers.lines import count_lines, split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable

name = "sinumerik"
suffixes = (".mpf", ".spf", ".arc")

#: Words with a value that do not affect the programmed path.
VALUES = {"SPOS", "SPOSA", "LIMS", "ADIS", "ADISPOS", "OVR", "OVRA", "ACC", "CTOL", "OTOL", "DISC", "FL"}
MARKS = "|".join((*sorted(lexer.HARMLESS), lexer.CHANGING))
#: Marks of Sinumerik programs, some of which also occur in G-code of other controls.
SURE = re.compile(
    r"^[ \t]*%_N_\w+_(MPF|SPF)|^;\$PATH=|\b(CYCLE|POCKET|SLOT|HOLES|LONGHOLE)\d*[ \t]*\(|\bGOTO[FB][ \t]+\w|\bSUPA\b|"
    rf"^[ \t/]*([A-Z][ \t]*=?[ \t]*[-+.\d]+[ \t]*)*(?<![.\w])({MARKS})\b(?![ \t]*/)|"
    r"^[ \t]*(N\d+[ \t]*)?DEF[ \t]+(REAL|INT|BOOL)\b|\bWORKPIECE\s*\(|[XYZIJK]\s*=\s*(AC|IC)\s*\(|"
    r"^[ \t]*(N\d+[ \t]*)?MSG[ \t]*\(|\bORI(WKS|MKS|AXES|VECT)\b|\bTRAFOOF\b|\b(CR|SPOS|TURN|AR|RND|CHR|CHF)=|"
    r"^[ \t]*(N\d+[ \t]*)?R\d+\s*=|[ABC]3=|\b[MS]\d{1,2}=|\bT\d*[ \t]*=[ \t]*\"|"
    r"^[ \t]*(N\d+[ \t]*)?L\d+[ \t]*(P[ \t]*\d+[ \t]*)?$",
    re.MULTILINE | re.IGNORECASE,
)
#: Comment, in brackets in other dialects: names of cutters there (CR=0) are not words of the program.
COMMENT = re.compile(r"(?<![\w=])\((?!\")[^()\n]*\)|;(?!\$PATH=)[^\n]*")
#: Marks of Fanuc programs: program number, reference position, drilling cycles and calls of subprograms.
FOREIGN = re.compile(
    r"^[ \t]*O\d{1,8}\b|(?<![A-Z_])(G0*28|G30|G73|G76|G8[1-9]|M0*98)[ \t]*(?=[A-Z]+[ \t]*-?[\d.])",
    re.MULTILINE | re.IGNORECASE,
)
#: Lengths of a motion block; addresses that do not affect the path.
LENGTHS = (*AXES, *"IJK", *MIDDLES, "CR", "RP")
SILENT = frozenset(("F", "S", "T", "D", "H", "M", "P", "FB", "FRC", "FRCM", "FA", "DISCL", "FGREF", "TOFFL",
                    "TOFFR", "OMA", "STOLF", "TCARR", *VALUES, *CORNERS))  # fmt: skip
OF_ARCS = frozenset(("CR", "TURN", *MIDDLES))
#: Moves in machine coordinates, which are left out: their end points may be unknown.
HOME = re.compile(r"\bSUPA\b|\bG0*1?53\b|\bG7[45]\b")
TOOL_NAME = re.compile(r"\bT\d*\s*=\s*\"([^\"]*)\"", re.IGNORECASE)
#: Words of motions that are not supported.
REFUSED = re.compile(
    r"[ABC]SPLINE|POLY|POLYPATH|INVCC?W|A?ROTS?|CROTS?|TRANSMIT\w*|TRACYL\w*|TRAANG|TRACON|TOFRAME\w?|TOROT\w?|PAROT|"
    r"MEAS|MEAW|DIAMON|DIAM90|ROTATION|OFFN|CORROF|PTP|EAUTO|ENAT|BAUTO|BNAT|MEAC|TANG\w*|ORIPATH\w*|ORICON\w*|COUPON"
)


def recognise(text: str) -> int:
    """Return 2 for a text with marks of Sinumerik programs, 1 for other G-code (the suffix decides), otherwise 0."""
    bare = COMMENT.sub("", text)
    sure = SURE.search(bare) is not None and FOREIGN.search(bare) is None
    return 2 if sure else int(BEGINNING.search(text) is not None)


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a Sinumerik program: the first main program of the file, with subprograms of the file or of its folder.

    The path is in the work offset that is active at the first move.
    """
    refuse_turning(text, file)
    reader = Sinumerik(file, options)
    reader.run(text)
    return reader.it.log.finish(file, name, ", ".join(reader.it.state.units) or "not stated", count_lines(text))


class Sinumerik:
    """Dialect of Sinumerik controls: executes the lines and blocks of a program."""

    tip_word, turns_to_plane = "TRAORI", False
    unit_words = "G70, G71, G700 or G710; the control's own setting is not in the file"
    frames: tuple[str, ...] = ("shift", "plane", "program", "origin")
    ends, moving = frozenset({2.0, 17.0, 30.0}), MOVING
    silent = frozenset(map(float, (6, 40, 41, 42, 43, 44, 45, 70, 19, 10, 11, 21, 22)))

    def __init__(self, file: Path, options: CamTable) -> None:
        scale = INCH if options.unit == "inch" else 1.0
        self.it = Interpreter(file, options, State(scale, feed_scale=scale), self, Flow(file))
        self.origins = Origins(self.it)
        self.values = lexer.SinumerikBlocks(self.it)
        self.evaluate = self.values.evaluate
        self.flow = SinumerikFlow(self.it, self.values)
        self.cycles = SinumerikCycles(self.it, self.evaluate)

    def run(self, text: str) -> None:
        """Execute the first main program of a file."""
        self.it.run(lambda: self.flow.find_programs(split_lines(text), self.it.file), self.origins.check_used)

    def square(self) -> Point:
        """Return the tool axis with all rotary axes at 0."""
        return self.it.plane.turn(UP)

    def run_line(self, program: CncProgram, index: int) -> int:
        """Execute a line; return the index of the next one, or END."""
        it, raw = self.it, program.lines[index]
        if it.steady and (found := PLAIN.fullmatch(raw)) and it.motion.cut_plain(found):
            return index + 1
        if program.labels is None:
            self.flow.prepare(program)
        it.steady = False
        body, comment = lexer.cut_comment(raw)
        if comment and not comment.startswith("$PATH"):
            it.log.add_event("comment", text=comment)
        text = body.upper()
        if not text or text[0] == "%":
            return index + 1
        found = lexer.BLOCK_NUMBER.match(text)
        if found and found.end():
            if "/" in found.group():
                it.note("blocks marked with / are read")
            text = text[found.end() :]
        if ":" in text and (label := lexer.LABEL.match(text)):
            text = text[label.end() :]
        if not text:
            return index + 1
        if word := FLOW.match(text):
            return self.flow.run_flow(word.group(1), text, raw, program, index)
        block = self.values.split(text, home=HOME.search(text) is not None)
        ended = self.run_block(block, raw)
        it.steady = self.cycles.modal is None and it.motion.is_steady()
        return END if ended else index + 1

    def run_block(self, block: CncBlock, raw: str) -> bool:
        """Execute a block; return whether the program ends."""
        it, values, names = self.it, block.values, block.names
        if '"' in raw and (named := TOOL_NAME.search(raw)):
            it.state.tool, it.state.tool_name = 0.0, named.group(1)
        if frame := next((word for word in names if word in FRAME_WORDS), None):
            if len(names) > 1 or block.codes or block.calls:
                raise InputError(f"{frame} stands in a block with other words, expected it alone")
            if frame.endswith("TRANS"):
                it.check_unit(values.get(letter) for letter in AXES)
            change_frame(it, frame, block)
            return False
        modal = "MCALL" in names
        if modal:
            names.remove("MCALL")
            self.cycles.modal = None
        if "RET" in names:
            return True
        for name in [name for name in names if it.flow.find_sibling(name)]:
            if modal:
                raise InputError(f"MCALL {name} (a subprogram at every place) is not read; write the program out")
            names.remove(name)
            it.call(name, values.pop("P", 1.0))
        if "L" in values:
            it.call(f"L{values.pop('L'):g}", values.pop("P", 1.0))
        if len(MOTIONS.intersection(block.codes)) > 1:
            raise InputError("two motions stand in one block, expected one")
        coordinate_use = it.run_words(block, (*block.codes, *names), find_word)
        if block.machine or 4.0 in block.codes or "S" in values or "T" in values:
            it.machine.start(block)
        if values and self._move(block, coordinate_use) and self.cycles.modal:
            self.cycles.drill(*self.cycles.modal)
        for called, arguments in block.calls:
            if called == "TRAORI":
                it.control_tip(True)
            elif called == "CYCLE800":
                swivel(it, [0.0 if not text or text[0] == '"' else self.evaluate(text) for text in arguments])
                it.course.set_tool_axis(it.plane.turn(PLANE_NORMALS[it.state.plane]))
            elif not self.cycles.run(called, arguments, modal=modal):
                self._call(called, arguments, values.get("P", 1.0))
        return it.machine.stop(block.machine)

    def _move(self, block: CncBlock, coordinate_use: str) -> bool:
        """Execute the motion of a block; return whether it moves the tool."""
        it, state, values = self.it, self.it.state, block.values
        for address in values:
            if address not in MOVING and address not in SILENT:
                raise InputError(f"word {address} is not read and may move the tool; post-process without it")
        if values.get("OVR", 100.0) != 100.0:
            it.note("OVR (a share of the feed) is not applied")
        if "F" in values and 4.0 not in block.codes:
            state.set_feed(values["F"])
        if coordinate_use == "once" or not block.has(MOVING):
            return False
        if coordinate_use == "machine":
            for letter in "ABC":
                if abs(values.get(letter, 0.0)) > 0.5 * lexer.UNKNOWN_VALUE:
                    raise InputError(f"{letter} of a move in machine coordinates is not known; write its angle")
            it.leave_out_machine_move(block, "SUPA, G53, G153, G74, G75")
            return False
        it.check_unit(values.get(name) for name in LENGTHS)
        if state.motion is None:
            it.note("coordinates before any G0 or G1 are read as G1")
            state.motion = 1.0
        if state.motion in (0.0, 1.0) and block.has(OF_ARCS):
            raise InputError("words of an arc (CR, TURN) in a straight block")
        if values.get("D") == 0.0 and "Z" in values:
            it.leave_without_length(block, "D0")
        else:
            it.motion.move(block)
        return True

    def _call(self, called: str, arguments: list[str], times: float) -> None:
        """Execute a subprogram with values of its parameters: PROC NAME(REAL A, INT B)."""
        values = [self.evaluate(text) if text else None for text in arguments]
        for _ in range(int(times) if values else 1):
            if values and self.it.flow.find_sibling(called):
                program = self.it.flow.programs[called]
                heads = map(strip, program.lines[program.first : min(program.first + 20, program.last)])
                head = next((text for text in heads if re.match(r"PROC\s+\w+\s*\(", text)), "()")
                texts = lexer.read_brackets(head, head.index("("))[0]
                if len(values) > len(texts):
                    raise InputError(f"{called} is called with {len(values)} values, its PROC line takes {len(texts)}")
                for text, value in zip_longest(texts, values):
                    head, _, default = text.partition("=")
                    name = head.split()[-1]
                    self.values.names.add(name)
                    self.values.numbers[name, ()] = self.evaluate(default or "0") if value is None else value
            self.it.call(called, 1.0 if values else times)

    def set_plane(self, block: CncBlock, code: float) -> None:
        """G17 to G19: set the working plane."""
        self.it.state.plane = int(code)
        if not self.it.state.tip_control:
            self.it.course.set_tool_axis(self.square())

    def set_unit(self, block: CncBlock, code: float) -> None:
        """G70, G71 (lengths alone), G700, G710 (feeds as well): inches or millimetres."""
        state, scale = self.it.state, INCH if code in (70.0, 700.0, 20.0) else 1.0
        if code not in (70.0, 71.0):
            if state.feed is not None and state.feed_mode != 93:
                state.feed *= scale / state.feed_scale
        elif scale != state.feed_scale:
            basic = "mm" if state.feed_scale == 1.0 else "inch"
            self.it.note(f"G70 and G71 set lengths only: F counts in {basic}/min, the control's basic system (taken "
                         "from --unit, else mm)")  # fmt: skip
        state.set_unit(scale, feeds=code not in (70.0, 71.0))

    def set_pole(self, block: CncBlock, code: float) -> None:
        """G110, G111, G112: set the pole relative to the tool, the origin or the last pole."""
        state = self.it.state
        last = state.pole or (0.0, 0.0, 0.0)
        base = {110.0: self.it.contour.position, 111.0: (0.0, 0.0, 0.0), 112.0: last}[code]
        if block.has(POLAR):
            raise InputError("a pole in polar coordinates is not read")
        block.relative.update({*AXES} - block.absolute)
        state.pole = state.place(block, base)[0]


UNREAD = refuse("it changes the path or its frame")
OFFSET = Code(lambda dialect, block, code: dialect.origins.use(code))
WORDS: dict[float | str, Code] = {
    **COMMON,
    **{motion: set_mode(1, motion=motion) for motion in MOTIONS},
    **{word: set_mode(1, motion=word) for word in ("CIP", "CT")},
    **dict.fromkeys((17.0, 18.0, 19.0), Code(Sinumerik.set_plane)),
    **dict.fromkeys((70.0, 71.0, 700.0, 710.0, 20.0, 21.0), Code(Sinumerik.set_unit)),
    **dict.fromkeys((74.0, 75.0, "SUPA"), ignore("machine")),
    25.0: ignore("once"), 26.0: ignore("once"),
    **dict.fromkeys((110.0, 111.0, 112.0), Code(Sinumerik.set_pole, 2, "once")),
    **dict.fromkeys((54.0, 55.0, 56.0, 57.0, 500.0, *(float(code) for code in range(505, 600))), OFFSET),
    **dict.fromkeys(("TRAORI", "TRAFOOF"), Code(lambda dialect, block, code: dialect.it.control_tip(code == "TRAORI"))),
    # no effect on the path
    **dict.fromkeys(map(float, (43, 49, 60, 62, 80, 140, 141, 142, 143, 290, 340, 341, 450,
                                451, 460, 461, 462, 601, 602, 603, 621, *range(640, 646))), ignore()),
    **dict.fromkeys((961.0, 962.0), COMMON[96.0]), **dict.fromkeys((971.0, 972.0), COMMON[97.0]),
    **dict.fromkeys((*lexer.HARMLESS, *VALUES), ignore()),
    # refused
    63.0: refuse("tapping"),
    **dict.fromkeys(map(float, (5, 7, 12, 35, 58, 59, 68, 92, 147, 148, 247, 248, 291, 331, 332, 347, 348)), UNREAD),
}  # fmt: skip


def find_word(word: float | str) -> Code | None:
    """Return the operation of a G code or a word without a number, None if unknown."""
    found = WORDS.get(word)
    return found or (UNREAD if isinstance(word, str) and REFUSED.fullmatch(word) else None)
