"""Sinumerik 840D programs (.mpf, .spf, .arc): flow, variables, subprograms, blocks."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.gcode import BEGINNING
from compplan.toolpath.readers.lines import MOST_LINES, count_lines, read_bounded, split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.plain import PLAIN_CODE
from compplan.toolpath.readers.sinumerik_flow import (
    DEEPEST,
    FLOW,
    LIMIT_TEXT,
    MOST_CALLS,
    SinumerikFlowReader,
    Unit,
    strip,
)
from compplan.toolpath.readers.sinumerik_frames import FRAME_WORDS
from compplan.toolpath.readers.sinumerik_words import (
    BLOCK_NUMBER,
    LABEL,
    Words,
    cut_comment,
    read_brackets,
    split_block,
    split_plain,
)

name = "sinumerik"
suffixes = (".mpf", ".spf", ".arc")

#: What no other language has, and what G-code of others may hold as well.
SURE = re.compile(
    r"^[ \t]*%_N_\w+_(MPF|SPF)|^;\$PATH=|\bCYCLE8[0-9]{1,2}\s*\(|\bGOTO[FB][ \t]+\w|\bSUPA\b|\bTRAFOOF\b|"
    r"^[ \t]*(N\d+[ \t]*)?(TRAORI|STOPRE|A?TRANS|A?ROT|A?MIRROR|A?SCALE|CYCLE832|MCALL)\b(?![ \t]*/)|"
    r"^[ \t]*(N\d+[ \t]*)?DEF[ \t]+(REAL|INT|BOOL)\b|"
    r"\bWORKPIECE\s*\(|[XYZIJK]\s*=\s*(AC|IC)\s*\(|^[ \t]*(N\d+[ \t]*)?MSG[ \t]*\(|\bORI(WKS|MKS|AXES|VECT)\b|"
    r"\b(CR|SPOS|TURN|AR)=|^[ \t]*(N\d+[ \t]*)?R\d+\s*=|[ABC]3=",
    re.MULTILINE | re.IGNORECASE,
)
#: A comment of other dialects in brackets: what a cutter is called there (CR=0) is no word of the program.
BRACKETED = re.compile(r"(?<![\w=])\((?!\")[^()\n]*\)")
#: The number of a Fanuc program, which no Sinumerik program has.
PROGRAM_NUMBER = re.compile(r"^[ \t]*O\d{1,8}\b", re.MULTILINE)
#: Moves in machine coordinates, which are left out: their places need not be known.
HOME = re.compile(r"\bSUPA\b|\bG0*1?53\b|\bG7[45]\b")
HEAD = re.compile(r"\s*%_N_(\w+?)_(MPF|SPF)\b", re.IGNORECASE)
PROC = re.compile(r"\s*(?:N\d+\s*)?PROC\s+(\w+)", re.IGNORECASE)


def recognise(text: str) -> int:
    """Tell whether a text is of a Sinumerik control: 1 for G-code of no mark, which the ending decides."""
    sure = SURE.search(BRACKETED.sub("", text)) is not None and PROGRAM_NUMBER.search(text) is None
    return 2 if sure else int(BEGINNING.search(text) is not None)


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a Sinumerik program: the first main program of the file, with subprograms of the file or beside it.

    The path stands in the work offset that is in force at the first move.

    Args:
        text: The program, or an archive of several.
        file: Its file, for messages.
        options: What the program does not say by itself.

    Raises:
        InputError: With file and line, if a block is not read and may change the path.

    """
    reader = _SinumerikReader(file, options)
    reader.run(text)
    return reader.log.finish(file, name, ", ".join(reader.units) or "not stated", count_lines(text))


class _SinumerikReader(SinumerikFlowReader):
    """Follow a program block by block."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.programs: dict[str, Unit] = {}
        self.steps = self.depth = 0
        self.ended = False

    def run(self, text: str) -> None:
        """Read the first main program."""
        lines = split_lines(text)
        main = self._find_programs(lines, self.file)
        try:
            self._run(main)
            self.contour.refuse_open()
        except ValueError as fault:
            raise self.error(str(fault)) from None
        except InputError as fault:
            raise fault if fault.file else self.error(fault.message) from None
        self.end_running()

    def _find_programs(self, lines: Sequence[str], file: Path) -> Unit:
        """Find the programs of a file; return the first main program, or the first at all."""
        heads: list[tuple[int, int, str, bool]] = []
        for index, line in enumerate(lines):
            if ("%_N_" in line or "%_n_" in line) and (found := HEAD.match(line)):
                heads.append((index, index + 1, found.group(1).upper(), found.group(2).upper() == "MPF"))
            elif "PROC" in line.upper() and (found := PROC.match(line)) and not (heads and heads[-1][0] >= index - 3):
                heads.append((index, index, found.group(1).upper(), False))
        ends = [head[0] for head in heads[1:]] + [len(lines)] if heads else []
        mains = [Unit(lines, 0, heads[0][0], file)] if heads else [Unit(lines, 0, len(lines), file)]
        others = []
        for (_, start, called, main), end in zip(heads, ends, strict=True):
            unit = Unit(lines, start, end, file)
            if main:
                mains.append(unit)
            else:
                self.programs[called] = unit
                others.append(unit)
        return next((unit for unit in mains if _holds(unit)), others[0] if others else mains[0])

    def _run(self, unit: Unit) -> None:
        """Carry out a program from its first line to its end."""
        before, self.file = self.file, unit.file
        text = "\n".join(unit.lines[unit.first : unit.last]).upper() if unit.last - unit.first < 300_000 else "GOTO"
        if re.search(r"\b(GOTO|IF|WHILE|FOR|REPEATB?|LOOP)", text):
            self.prepare(unit)
        index = unit.first
        active: dict[int, float] = {}
        repeats: dict[int, int] = {}
        while index < unit.last and not self.ended:
            self.line = index + 1
            self.steps += 1
            if self.steps > MOST_LINES:
                raise self.error(f"more than {MOST_LINES} blocks are carried out, calls counted; no more are read")
            after = self._run_line(unit, index, active, repeats)
            if after < 0:
                break
            for loop in [loop for loop in active if not loop <= after <= unit.partners[loop]]:
                del active[loop]
            index = after
        self.file = before

    def _run_line(self, unit: Unit, index: int, active: dict[int, float], repeats: dict[int, int]) -> int:
        """Carry out a line; return the next one, -1 at the end of the program."""
        raw = unit.lines[index]
        if self.steady and (found := PLAIN_CODE.fullmatch(raw)) and self.cut_plain(found):
            return index + 1
        self.steady = False
        body, comment = cut_comment(raw)
        if comment and not comment.startswith("$PATH"):
            self.log.happen("comment", self.line, text=comment)
        if not body:
            return index + 1
        text = body.upper()
        if text[0] == "%":
            return index + 1
        found = BLOCK_NUMBER.match(text)
        if found and found.end():
            if "/" in found.group():
                self.log.note("blocks marked with / are read", self.line)
            text = text[found.end() :]
        if ":" in text and (label := LABEL.match(text)):
            text = text[label.end() :]
        if not text:
            return index + 1
        words = split_plain(text)
        if words is None:
            flow = FLOW.match(text)
            if flow:
                return self.run_flow(flow.group(1), text, raw, unit, index, active, repeats)
            words = split_block(text, self.look_up_home if HOME.search(text) else self.look_up, self.variables)
        ended = self._run_block(words, raw)
        self.steady = self.modal is None and self.is_steady()
        return -1 if ended else index + 1

    def _run_block(self, words: Words, raw: str) -> bool:
        """Carry out a block; return whether the program ends."""
        for variable, indices, value in words.assigned:
            self._assign(variable, indices, value)
        named = self.name_tool(raw) if '"' in raw else None
        if named is not None:
            self.tool, self.tool_name = 0.0, named
        frame = next((word for word in words.names if word in FRAME_WORDS), None)
        if frame:
            if len(words.names) > 1 or words.codes or words.calls:
                raise self.error(f"{frame} stands in a block with other words, expected it alone")
            self.change_frame(frame, words)
            return False
        modal = "MCALL" in words.names
        if modal:
            words.names.remove("MCALL")
            self.modal = None
        if "RET" in words.names:
            return True
        words.names = [word for word in words.names if not self._call_by_name(word, words, modal=modal)]
        if "L" in words.values:
            self._call(f"L{words.values.pop('L'):g}", [], words.values.pop("P", 1.0))
        once = self.set_codes(words) if words.codes or words.names else ""
        if words.machine or "S" in words.values or "T" in words.values:
            self.start_machine(words)
        moved = bool(words.values) and self.run_motion(words, once)
        if moved and self.modal is not None:
            self.drill_here()
        for called, arguments in words.calls:
            if called == "TRAORI":
                self.set_name(called)
            elif not self.run_cycle(called, arguments, modal=modal):
                self._call(called, arguments, words.values.get("P", 1.0))
        return self.stop_machine(words) if words.machine else False

    def _call_by_name(self, word: str, words: Words, *, modal: bool) -> bool:
        """Call a subprogram that is named without brackets; return whether there is one."""
        if word not in self.programs and not self._find_beside(word):
            return False
        if modal:
            raise self.error(f"MCALL {word} (a subprogram at every place) is not read; write the program out")
        self._call(word, [], words.values.pop("P", 1.0))
        return True

    def _find_beside(self, word: str) -> bool:
        """Look for NAME.SPF beside the file."""
        for candidate in (f"{word}.SPF", f"{word}.spf", f"{word.lower()}.spf"):
            beside = self.file.with_name(candidate)
            if beside.is_file():
                lines = split_lines(read_bounded(beside))
                self.programs[word] = Unit(lines, 0, len(lines), beside)
                return True
        return False

    def _call(self, called: str, arguments: list[str], times: float) -> None:
        """Carry out a subprogram of the file, or beside it."""
        if called not in self.programs and not self._find_beside(called):
            where = f"neither %_N_{called}_SPF in this file nor {called}.SPF beside it is there"
            raise self.error(f"subprogram call {called[:LIMIT_TEXT]} is not read: {where}")
        if not 0.0 < times <= MOST_CALLS or self.depth >= DEEPEST:
            raise self.error(f"subprogram {called} is called {times:g} times at depth {self.depth + 1}, allowed are "
                             f"{MOST_CALLS} times and a depth of {DEEPEST}")  # fmt: skip
        self.contour.refuse_open()
        unit = self.programs[called]
        here, values = self.line, [self.evaluate(text) if text else 0.0 for text in arguments]
        self.depth += 1
        for _ in range(int(times)):
            self.count_jump()
            self._take_arguments(unit, called, values)
            self._run(unit)
        self.depth -= 1
        self.line = here

    def _take_arguments(self, unit: Unit, called: str, values: list[float]) -> None:
        """Give the parameters of PROC NAME(REAL A, INT B) their values."""
        if not values:
            return
        for index in range(unit.first, min(unit.first + 20, unit.last)):
            text = strip(unit.lines[index])
            if found := re.match(r"PROC\s+\w+\s*\(", text):
                names = [part.partition("=")[0].split()[-1] for part in read_brackets(text, found.end() - 1)[0]]
                if len(values) > len(names):
                    break
                for variable, value in zip(names, values, strict=False):
                    self.variables.add(variable)
                    self.numbers[variable, ()] = value
                return
        raise self.error(f"{called} is called with {len(values)} values that it does not take (PROC)")

    def _assign(self, variable: str, indices: tuple[float, ...], value: float | None) -> None:
        if variable.startswith("$"):
            if re.match(r"\$P_\w*(FR|FRAME)\w*", variable):
                raise self.error(f"{variable} sets a frame and is not read; use TRANS and ROT")
            self.log.note(f"system variable {variable[:24]} is not read", self.line)
            return
        if value is None:
            self.unknown[variable] = f"line {self.line} gives it text"
            self.numbers.pop((variable, indices), None)
            return
        self.numbers[variable, indices] = value


def _holds(unit: Unit) -> bool:
    """Return whether a program has a line that is no comment."""
    lines = unit.lines[unit.first : unit.last]
    return any(line.strip() and not line.lstrip().startswith(";") for line in lines)
