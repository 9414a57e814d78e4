"""Subprograms, macro calls, jumps and loops of G-code: M98, M97, G65, O numbers, L100, IF, GOTO, WHILE DO, END."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.flow import CncProgram, Flow
from compplan.toolpath.readers.cnc.rs274_macro import Variables

#: Greatest number of jumps, and of letters of macro blocks that are carried out again: a hundred a jump (assumed).
MOST_JUMPS = 20_000
MOST_LETTERS = 100 * MOST_JUMPS
HEAD = re.compile(r"\s*[O:]\s*0*(\d+)\b(?!\s*(?:SUB|CALL|IF|WHILE|REPEAT|DO)\b)", re.IGNORECASE)
SEQUENCE = re.compile(r"\s*(?:/\d?\s*)?N\s*0*(\d+)", re.IGNORECASE)
LOOP_END = re.compile(r"\s*(?:N\d+\s*)?END\s*([1-9])", re.IGNORECASE)
LOOP = re.compile(r"\s*(?:N\d+\s*)?(?:WHILE\b.*)?DO\s*([1-9])", re.IGNORECASE)
#: Control of the flow on a line in capitals, its number taken off.
WHILE = re.compile(r"(?:WHILE\s*(\[.*\])\s*)?DO\s*([1-9])\s*$")
END_LOOP = re.compile(r"END\s*([1-9])\s*$")
GOTO = re.compile(r"GOTO\s*(.+)$")
IF = re.compile(r"IF\s*(?=\[)")
#: Variables that the words of a macro call set (Fanuc, first kind of arguments).
ARGUMENTS = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, *range(17, 27)), strict=True))


class MacroFlow:
    """Carry out the control of a G-code program."""

    def __init__(self, flow: Flow) -> None:
        self.flow = flow
        self.variables = Variables()
        #: Line that a jump goes to.
        self.next: int | None = None
        self.file_lines = self.letters = 0
        #: Variables at the last pass of each jump of each call.
        self._passed: dict[tuple[int, int], list[tuple[str, float]]] = {}

    def find_programs(self, lines: Sequence[str], file: Path) -> CncProgram:
        """Find the subprograms of a file, after %_N_NAME_SPF or O1000; return the first program."""
        self.file_lines = len(lines)
        heads = [index for index, line in enumerate(lines) if line.startswith("%_N_")]
        for index, stop in zip(heads, [*heads[1:], len(lines)], strict=False):
            if found := re.match(r"%_N_(\w+)_SPF", lines[index].upper()):
                self.flow.programs[found.group(1)] = CncProgram(lines, index + 1, stop, file)
        numbers = [(index, found.group(1)) for index, line in enumerate(lines)
                   if line[:1] in "Oo: " and (found := HEAD.match(line))]  # fmt: skip
        for (index, number), stop in zip(numbers, [*(at for at, _ in numbers[1:]), len(lines)], strict=False):
            self.flow.programs.setdefault(number, CncProgram(lines, index + 1, stop, file))
        return CncProgram(lines, 0, numbers[1][0] if len(numbers) > 1 else len(lines), file)

    def _jump(self, index: int) -> None:
        """Go on at a line; refuse to jump without end."""
        self.flow.count_jump()
        place = self.flow.call.number, self.flow.line
        now = [*self.variables.local[-1].items(), *self.variables.shared.items()]
        if self._passed.get(place) == now:
            raise InputError("this jump repeats without end: no variable has changed since the last time")
        self._passed[place] = now
        self.next = index

    def _find_number(self, number: int) -> int:
        """Return where block N number stands in this program: the first one."""
        program = self.flow.call.program
        if program.labels is None:
            program.labels = {}
            for index in range(program.first, program.last):
                if found := SEQUENCE.match(program.lines[index]):
                    program.labels.setdefault(found.group(1), []).append(index)
        if str(number) not in program.labels:
            raise InputError(f"jump to block N{number}, which is not in this program")
        return program.labels[str(number)][0]

    def run_macro(self, line: str) -> str | None:
        """Carry out the macro words of a line in capitals; return the block that is left, None without any."""
        if self.flow.executed > self.file_lines:
            self.letters += len(line)
            if self.letters > MOST_LETTERS:
                raise InputError(f"more than {MOST_LETTERS} letters of macro blocks are carried out again by jumps and "
                                 "calls; no more are read")  # fmt: skip
        bare = re.sub(r"^N\s*\d+\s*", "", line)
        try:
            if self._control(bare) or (bare.startswith("#") and self.variables.assign(bare)):
                return None
            return self.variables.spell_out(line)
        except (ValueError, OverflowError) as fault:
            raise InputError(f"{fault}, in {bare[:40]!r}") from None

    def _control(self, line: str) -> bool:
        """Carry out IF, GOTO, WHILE DO and END; return whether the line is one of them."""
        unread = f"program control {line[:40]!r} is not read, expected"
        if found := IF.match(line):
            condition, used = self.variables.work_out(line[found.end() :])
            rest = line[found.end() + used :].strip()
            if rest.startswith("THEN"):
                if condition and not self.variables.assign(rest[4:].strip()):
                    raise InputError(f"{unread} IF [..] THEN #1 = ..")
            elif not GOTO.match(rest):
                raise InputError(f"{unread} IF [..] GOTO or THEN")
            elif condition:
                self._control(rest)
            return True
        if found := GOTO.match(line):
            number, used = self.variables.work_out(found.group(1))
            if number is None or number != int(number) or found.group(1)[used:].strip():
                raise InputError(f"{unread} GOTO and the number of a block")
            self._jump(self._find_number(int(number)))
        elif found := WHILE.match(line):
            if found.group(1) and not self.variables.work_out(found.group(1))[0]:
                self._jump(self._find_loop(self.flow.line, 1, found.group(2)) + 1)
        elif found := END_LOOP.match(line):
            self._jump(self._find_loop(self.flow.line - 2, -1, found.group(1)))
        elif line.startswith("WHILE"):
            raise InputError(f"{unread} WHILE [..] DO and a number from 1 to 9")
        return found is not None

    def _find_loop(self, index: int, step: int, label: str) -> int:
        """Return where the other end of a loop stands, END label ahead or DO label behind."""
        program, pattern = self.flow.call.program, LOOP_END if step > 0 else LOOP
        while program.first <= index < program.last:
            found = pattern.match(program.lines[index])
            if found and found.group(1) == label:
                return index
            index += step
        raise InputError(f"loop {label} has no {'END' if step > 0 else 'DO'} {label} in this program")

    def call_number(self, values: Mapping[str, float], *, macro: bool = False, local: bool = False) -> None:
        """Carry out M98 and G65 (subprogram O number), and M97 (local: block N number of this program).

        P names the program, L (or K in M98) says how often; the other words of G65 are arguments.
        """
        code = "G65" if macro else "M97" if local else "M98"
        called = values.get("P", -1.0)
        times = values.get("L", 1.0 if macro else values.get("K", 1.0))
        if called != int(called) or called < 0 or times != int(times):
            raise InputError(f"subprogram call {code} names no program, expected P and its number")
        number, programs = str(int(called)), self.flow.programs
        if not macro and not local and len(number) > 4 and number not in programs:
            times, number = float(number[:-4]), str(int(number[-4:]))
        if not local and number not in programs:
            raise InputError(f"subprogram call {code} P{number}: O{number} is not in this file; write it into the file")
        start = self._find_number(int(called)) if local else None
        if macro:
            named = {str(ARGUMENTS[letter]): value for letter, value in values.items() if letter in ARGUMENTS}
            self.variables.local.append(named)
        self.flow.run_program(f"P{number}", self.flow.call.program if local else programs[number], times, start)
        if macro:
            self.variables.local.pop()
