"""The order of the lines of a G-code program: subprograms, macro calls, jumps and loops, all of them bounded."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.macro import MacroError, Variables, assign, spell_out, work_out
from compplan.toolpath.readers.cnc.words import CALL, GEOMETRY, HARMLESS, TEXT
from compplan.toolpath.readers.lines import MOST_LINES, read_bounded, split_lines

#: Greatest number of passes of one call, of calls within calls, and of jumps.
MOST_CALLS = 9999
DEEPEST = 11
MOST_JUMPS = 20_000
HEAD = re.compile(r"\s*[O:]\s*0*(\d+)\b(?!\s*(?:SUB|CALL|IF|WHILE|REPEAT|DO)\b)", re.IGNORECASE)
SEQUENCE = re.compile(r"\s*(?:/\d?\s*)?N\s*0*(\d+)", re.IGNORECASE)
LOOP_END = re.compile(r"\s*(?:N\d+\s*)?END\s*([1-9])", re.IGNORECASE)
LOOP = re.compile(r"\s*(?:N\d+\s*)?(WHILE\b.*)?DO\s*([1-9])", re.IGNORECASE)
#: Control of the flow on a line in capitals, its number taken off.
WHILE = re.compile(r"(?:WHILE\s*(\[.*\])\s*)?DO\s*([1-9])\s*$")
END = re.compile(r"END\s*([1-9])\s*$")
GOTO = re.compile(r"GOTO\s*(.+)$")
IF = re.compile(r"IF\s*(?=\[)")
#: Variables that the words of a macro call set (Fanuc, first kind of arguments).
ARGUMENTS = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, *range(17, 27)), strict=True))


class Flow:
    """Follow a program from line to line.

    Args:
        file: Its file.
        run_line: Carries out one line; returns whether this program ends.

    """

    def __init__(self, file: Path, run_line: Callable[[str], bool]) -> None:
        self.file, self.run_line = file, run_line
        self.line = self.executed = self.depth = self.jumps = 0
        self.over = False
        self.variables = Variables()
        #: Subprograms by their names: lines, first and last of them, file.
        self.programs: dict[str, tuple[Sequence[str], int, int, Path]] = {}
        self._lines: Sequence[str] = ()
        self._first = self._last = 0
        self._next: int | None = None
        #: Calls so far, and the variables at the last pass of each jump of each call.
        self._call_number = self._calls = 0
        self._passed: dict[tuple[int, int], list[tuple[str, float]]] = {}
        self._numbers: dict[tuple[int, int, int], dict[int, int]] = {}

    def error(self, message: str) -> InputError:
        """Return an error at the line that is read."""
        return InputError(message, file=self.file, where=self.line)

    def _run_lines(self, lines: Sequence[str], first: int, last: int, start: int | None = None) -> None:
        """Carry out lines from `start` up to the end of a program that holds those from first to last."""
        kept = self._lines, self._first, self._last, self._call_number
        self._calls += 1
        self._call_number = self._calls
        self._lines, self._first, self._last = lines, first, last
        index = first if start is None else start
        while index < last:
            self.line = index + 1
            self.executed += 1
            if self.executed > MOST_LINES:
                raise self.error(f"more than {MOST_LINES} blocks are carried out, calls counted; no more are read")
            if self.run_line(lines[index]) or self.over:
                break
            index += 1
            if self._next is not None:
                index, self._next = self._next, None
        self._lines, self._first, self._last, self._call_number = kept

    def run(self, lines: Sequence[str]) -> None:
        """Read every line of the first program up to its end."""
        self._run_lines(lines, 0, self.find_programs(lines))

    def _jump(self, index: int) -> None:
        """Go on at a line.

        Raises:
            InputError: If the program jumps without end.

        """
        self.jumps += 1
        if self.jumps > MOST_JUMPS:
            raise self.error(f"more than {MOST_JUMPS} jumps are carried out; no more are read")
        known = self._passed.get((self._call_number, self.line))
        now = [*self.variables.local[-1].items(), *self.variables.shared.items()]
        if known == now:
            raise self.error("this jump repeats without end: no variable has changed since the last time")
        self._passed[self._call_number, self.line] = now
        self._next = index

    def _find_number(self, number: int) -> int:
        """Return where block N number stands in this program: the next one, or the first."""
        key = id(self._lines), self._first, self._last
        if key not in self._numbers:
            places: dict[int, int] = {}
            for index in range(self._last - 1, self._first - 1, -1):
                if found := SEQUENCE.match(self._lines[index]):
                    places[int(found.group(1))] = index
            self._numbers[key] = places
        place = self._numbers[key].get(number)
        if place is None:
            raise self.error(f"jump to block N{number}, which is not in this program")
        return place

    def find_programs(self, lines: Sequence[str]) -> int:
        """Find the subprograms that stand in the file, after %_N_NAME_SPF or O1000; return where the first one ends."""
        heads = [index for index, line in enumerate(lines) if line.startswith("%_N_")]
        for index, stop in zip(heads, [*heads[1:], len(lines)], strict=False):
            found = re.match(r"%_N_(\w+)_SPF", lines[index].upper())
            if found:
                self.programs[found.group(1)] = (lines, index + 1, stop, self.file)
        numbers = [(index, found.group(1)) for index, line in enumerate(lines)
                   if line[:1] in "Oo: " and (found := HEAD.match(line))]  # fmt: skip
        for (index, number), stop in zip(numbers, [*(at for at, _ in numbers[1:]), len(lines)], strict=False):
            self.programs.setdefault(number, (lines, index + 1, stop, self.file))
        return numbers[1][0] if len(numbers) > 1 else len(lines)

    def run_macro(self, line: str) -> str | None:
        """Carry out the macro words of a line in capitals; return the block that is left to be read, None without any.

        Raises:
            InputError: With the line, if they cannot be worked out.

        """
        bare = re.sub(r"^N\s*\d+\s*", "", line)
        try:
            if self._control(bare):
                return None
            if bare.startswith("#") and assign(bare, self.variables):
                return None
            return spell_out(line, self.variables)
        except MacroError as fault:
            raise self.error(f"{fault}, in {bare[:40]!r}") from None

    def _control(self, line: str) -> bool:
        """Carry out IF, GOTO, WHILE DO and END; return whether the line is one of them."""
        if found := IF.match(line):
            condition, used = work_out(line[found.end() :], self.variables)
            rest = line[found.end() + used :].strip()
            if rest.startswith("THEN"):
                if condition and not assign(rest[4:].strip(), self.variables):
                    raise self.error(f"program control {line[:40]!r} is not read, expected IF [..] THEN #1 = ..")
            elif not GOTO.match(rest):
                raise self.error(f"program control {line[:40]!r} is not read, expected IF [..] GOTO or THEN")
            elif condition:
                self._control(rest)
            return True
        if found := GOTO.match(line):
            number, used = work_out(found.group(1), self.variables)
            if number is None or number != int(number) or found.group(1)[used:].strip():
                raise self.error(f"program control {line[:40]!r} is not read, expected GOTO and the number of a block")
            self._jump(self._find_number(int(number)))
            return True
        if found := WHILE.match(line):
            if found.group(1) and not work_out(found.group(1), self.variables)[0]:
                self._jump(self._find_loop(self.line, 1, found.group(2)) + 1)
            return True
        if found := END.match(line):
            self._jump(self._find_loop(self.line - 2, -1, found.group(1)))
            return True
        return False

    def _find_loop(self, index: int, step: int, label: str) -> int:
        """Return where the other end of a loop stands, END label ahead or DO label behind."""
        pattern, group = (LOOP_END, 1) if step > 0 else (LOOP, 2)
        while self._first <= index < self._last:
            found = pattern.match(self._lines[index])
            if found and found.group(group) == label:
                return index
            index += step
        raise self.error(f"loop {label} has no {'END' if step > 0 else 'DO'} {label} in this program")

    def call_name(self, line: str) -> bool:
        """Carry out a call of a subprogram (L100 P3, or its name); return whether the line is one."""
        found = CALL.match(line)
        if not found:
            return False
        called, times = found.group(1), int(found.group(2) or 1)
        known = called in HARMLESS or called in TEXT or GEOMETRY.fullmatch(called)
        if called not in self.programs and not known:
            for candidate in (f"{called}.SPF", f"{called}.spf", f"{called.lower()}.spf"):
                beside = self.file.with_name(candidate)
                if beside.is_file():
                    found_lines = split_lines(read_bounded(beside))
                    self.programs[called] = (found_lines, 0, len(found_lines), beside)
                    break
        if called not in self.programs:
            if re.fullmatch(r"L\d+", called):
                where = f"neither %_N_{called}_SPF in this file nor {called}.SPF beside it is there"
                raise self.error(f"subprogram call {called} is not read: {where}")
            return False
        if times > MOST_CALLS or self.depth >= DEEPEST:
            raise self.error(f"subprogram {called} is called {times} times at depth {self.depth + 1}, allowed are "
                             f"{MOST_CALLS} times and a depth of {DEEPEST}")  # fmt: skip
        self._run_program(self.programs[called], times)
        return True

    def call_number(self, values: Mapping[str, float], *, macro: bool = False, local: bool = False) -> None:
        """Carry out M98 and G65 (subprogram O number), and M97 (block N number of this program).

        Args:
            values: Words of the block: P names the program, L (or K in M98) says how often.
            macro: Whether the other words are arguments (G65).
            local: Whether P names a block (M97).

        Raises:
            InputError: If it is not in the file, or calls itself without end.

        """
        code = "G65" if macro else "M97" if local else "M98"
        called = values.get("P", -1.0)
        times = values.get("L", 1.0 if macro else values.get("K", 1.0))
        if called != int(called) or called < 0 or times != int(times):
            raise self.error(f"subprogram call {code} names no program, expected P and its number")
        number = str(int(called))
        if not macro and not local and len(number) > 4 and number not in self.programs:
            times, number = float(number[:-4]), str(int(number[-4:]))
        if not local and number not in self.programs:
            raise self.error(f"subprogram call {code} P{number}: O{number} is not in this file; write it into the file")
        if not 0 <= times <= MOST_CALLS or self.depth >= DEEPEST:
            raise self.error(f"subprogram P{number} is called {times:g} times at depth {self.depth + 1}, allowed are "
                             f"{MOST_CALLS} times and a depth of {DEEPEST}")  # fmt: skip
        start = self._find_number(int(called)) if local else None
        program = (self._lines, self._first, self._last, self.file) if local else self.programs[number]
        if macro:
            named = {str(ARGUMENTS[letter]): value for letter, value in values.items() if letter in ARGUMENTS}
            self.variables.local.append(named)
        self._run_program(program, int(times), start)
        if macro:
            self.variables.local.pop()

    def _run_program(self, program: tuple[Sequence[str], int, int, Path], times: int, start: int | None = None) -> None:
        """Carry out a subprogram so many times."""
        lines, first, last, file = program
        here, at, self.file = self.line, self.file, file
        self.depth += 1
        for _ in range(times):
            self._run_lines(lines, first, last, start)
            if self.over:
                break
        self.depth -= 1
        self.line, self.file = here, at
