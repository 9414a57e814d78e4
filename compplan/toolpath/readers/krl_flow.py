"""The flow of a KRL program: its statements in order, loops whose bounds are numbers, programs that it calls, data."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.lines import read_bounded, split_lines
from compplan.toolpath.readers.robot_moves import RobotProgram

#: A loop whose bounds are numbers.
FOR = re.compile(r"FOR\s+([A-Z]\w*)\s*=\s*([-+]?\d+)\s+TO\s+([-+]?\d+)(?:\s+STEP\s+([-+]?\d+))?\s*$")
CALL = re.compile(r"([A-Z_]\w{0,60})\s*\((.*)\)\s*$")
HEAD = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+(\w+)\s*\(")
#: Data of a module that every program of the controller sees.
PUBLIC = re.compile(r"DEFDAT\s+\w+\s+PUBLIC\b")
SHARED = re.compile(r"(?:DECL\s+)?GLOBAL\s+(?:DECL\s+)?(?:CONST\s+)?\w+\s+(\w+)")
#: Greatest number of data files beside a program that are looked into.
MOST_FILES = 200


def clean_line(raw: str) -> str:
    """Return a statement in capitals, without its comment."""
    text = raw.partition(";")[0].strip()
    return "" if text.startswith("&") else text.upper()


class KrlFlow:
    """Follow programs statement by statement."""

    def __init__(self, program: RobotProgram, carry_out: Callable[[str], None], assign: Callable[[str], bool]) -> None:
        self.program, self.carry_out, self.assign = program, carry_out, assign
        self.flow = program.flow
        self.flow.run_line = self._run_line
        #: Values of the counters of loops, that of the innermost loop last.
        self.counters: dict[str, list[int]] = {}
        self.called = ""

    def run(self, text: str) -> None:
        """Carry out the first program of the file."""
        lines = split_lines(text)
        self._load_shared(text.upper())
        with self.flow.guard():
            self._load_data(self.flow.file)
            self.flow.run(self._find_programs(lines, self.flow.file))

    def _load_shared(self, text: str) -> None:
        """Keep the GLOBAL positions of public .dat files beside the program that its text names."""
        own = self.flow.file.stem.lower()
        data = sorted(path for path in self.flow.file.parent.glob("*.[dD][aA][tT]") if path.stem.lower() != own)
        keepers: dict[str, str] = {}
        for path in data[:MOST_FILES]:
            lines = [clean_line(raw) for raw in split_lines(read_bounded(path))]
            if not any(PUBLIC.match(line) for line in lines[:50]):
                continue
            names = {found.group(1) for line in lines if "GLOBAL" in line and (found := SHARED.match(line))}
            names = {name for name in names if re.search(rf"(?<!\w){name}(?!\w)", text)}
            for name in sorted(names & keepers.keys()):
                raise self.flow.error(f"{name} stands in {keepers[name]} and in {path.name}, both public; keep one")
            keepers.update(dict.fromkeys(names, path.name))
            whole = [line for line in lines if "=" in line and re.split(r"[\s\[=.]", line)[0] in names]
            for line in whole + [line for line in lines if "=" in line and "GLOBAL" in line]:
                self.assign(line)
        if keepers:
            files = ", ".join(sorted(set(keepers.values())))
            self.program.log.note(f"positions of other files are read: {files}", 1)

    def _load_data(self, file: Path) -> None:
        """Keep the positions and frames that the .dat file beside a program declares."""
        beside = next((file.with_suffix(end) for end in (".dat", ".DAT") if file.with_suffix(end).is_file()), None)
        for raw in split_lines(read_bounded(beside)) if beside else ():
            self.assign(clean_line(raw))

    def _find_programs(self, lines: list[str], file: Path) -> CncProgram:
        """Find DEF NAME() in a file; return its first program."""
        first: CncProgram | None = None
        for index, raw in enumerate(lines):
            if "DEF" in raw.upper() and (head := HEAD.match(clean_line(raw))):
                found = self.flow.programs[head.group(1)] = CncProgram(lines, index + 1, len(lines), file)
                first = first or found
        return first or CncProgram(lines, 0, len(lines), file)

    def _run_line(self, program: CncProgram, index: int) -> int:
        """Carry out a statement; return the next one, or END."""
        statement, counting = clean_line(program.lines[index]), self.flow.call.counting
        self._keep_comment(program.lines[index])
        if statement in ("END", "ENDFCT") or (statement == "RETURN" and not self.program.blocks):
            return END
        if statement[:3] == "FOR" and (rounds := self._count_rounds(statement)) is not None:
            return self._run_for(program, index, *rounds)
        if program.partners.get(index) in counting:
            return program.partners[index]
        if statement:
            self.carry_out(self._fill_in(statement) if self.counters else statement)
        return index + 1

    def _run_for(self, program: CncProgram, index: int, counter: str, values: range) -> int:
        """Carry out a loop whose bounds are known, pass by pass; return the next line."""
        counting = self.flow.call.counting
        number = counting.get(index, 0.0)
        if index not in counting:
            end = self._find_end(program, index, counter)
            program.partners.update({index: end, end: index})
            self.counters.setdefault(counter, []).append(0)
        if number < len(values):
            counting[index], self.counters[counter][-1] = number + 1.0, values[int(number)]
            return index + 1
        counting.pop(index, None)
        self.counters[counter].pop()
        if not self.counters[counter]:
            del self.counters[counter]
        return program.partners[index] + 1

    def _keep_comment(self, raw: str) -> None:
        """Keep a comment; folds are the editor's."""
        text = raw.partition(";")[2].strip() if ";" in raw else ""
        if text and not re.match(r"(END)?FOLD\b|%\{", text, re.IGNORECASE):
            self.program.log.happen("comment", self.flow.line, text=text)

    def _count_rounds(self, statement: str) -> tuple[str, range] | None:
        """Return counter and values of FOR i = 1 TO 9 STEP 2, None where its bounds are not known."""
        found = FOR.match(self._fill_in(statement))
        if self.program.blocks or not found:
            return None
        counter, start, stop, step = found.groups()
        by = int(step or 1)
        if by == 0:
            raise InputError("FOR with STEP 0 never ends")
        return counter, range(int(start), int(stop) + (1 if by > 0 else -1), by)

    def _find_end(self, program: CncProgram, first: int, counter: str) -> int:
        """Return the line of the ENDFOR of a loop, which neither leaves early nor sets its counter."""
        depth = 0
        for index in range(first, program.last):
            statement = clean_line(program.lines[index])
            depth += statement.startswith("FOR ") - statement.startswith("ENDFOR")
            if depth == 0:
                return index
            if statement == "EXIT" or (index > first and re.match(rf"{counter}\s*=(?!=)", statement)):
                raise InputError(f"the loop ends where {statement[:24]!r} says; write its moves out in a row")
        raise InputError("FOR has no ENDFOR")

    def _fill_in(self, statement: str) -> str:
        """Return a statement with the counters of loops as numbers, where they stand as indices or bounds."""
        for counter, values in self.counters.items():
            place = rf"(?<=\[)\s*{counter}\s*(?=\])|(?<![\w.$\[]){counter}(?![\w.\[])(?!\s*=)"
            statement = re.sub(place, str(values[-1]), statement)
        return statement

    def call(self, statement: str) -> None:
        """Carry out a program of the file, or NAME.src beside it; note calls of others."""
        called = CALL.match(statement).group(1)  # type: ignore[union-attr]
        programs, file = self.flow.programs, self.flow.file
        if called not in programs:
            beside = next((path for end in (".src", ".SRC") for word in (called, called.lower())
                           if (path := file.with_name(word + end)).is_file()), None)  # fmt: skip
            if beside is not None:
                self._find_programs(split_lines(read_bounded(beside)), beside)
        if called not in programs:
            self.called = self.called or f"{statement[:24]} in line {self.flow.line}"
            self.program.note(f"call of {called[:24]}() is not read: it is neither here nor beside the file")
            self.program.ask(statement)
            return
        if programs[called].file != file:
            self._load_data(programs[called].file)
        self.program.call(called, f"{called}()")
