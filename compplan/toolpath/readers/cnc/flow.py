"""The order of the lines of a program: programs of a file, calls, jumps and loops, all of them bounded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.toolpath.readers.lines import read_bounded, split_lines

#: Greatest number of passes of one call, and of calls within calls.
MOST_CALLS = 9999
DEEPEST = 11
#: Greatest number of letters of blocks that are carried out again by jumps and calls, and what a block counts beside
#: its letters: some 120,000 blocks, 1 to 4 s (assumed).
MOST_LETTERS, BLOCK_LETTERS = 4_000_000, 15
#: Longest name of a program that is searched beside a file (assumed).
LONGEST_NAME = 100
#: What a line returns where its program ends.
END = -1


@dataclass
class CncProgram:
    """Hold a program of a file: its lines as the dialect splits them, from the first (from 0) up to the last.

    `labels` are the lines of its labels or block numbers, `partners` where blocks of control close or open, and
    `alternatives` the ELSE of an IF and the IF of an ELSE.
    """

    lines: Sequence[Any]
    first: int
    last: int
    file: Path
    labels: dict[str, list[int]] | None = None
    partners: dict[int, int] = field(default_factory=dict)
    alternatives: dict[int, int] = field(default_factory=dict)


@dataclass
class Call:
    """Hold a program that is carried out, and the passes of its loops so far."""

    program: CncProgram
    repeats: dict[int, int] = field(default_factory=dict)
    counting: dict[int, float] = field(default_factory=dict)


class Flow:
    """Follow programs from line to line."""

    def __init__(self, file: Path, deepest: int = DEEPEST) -> None:
        self.file, self.deepest = file, deepest
        self.line = self.executed = self.lines = self.depth = self.letters = 0
        self.over = False
        #: Returns the letters of a line.
        self.weigh: Callable[[Any], int] = len
        self.programs: dict[str, CncProgram] = {}
        self.call = Call(CncProgram((), 0, 0, file))
        #: Carries out a line of the program that runs; returns the next one, or END.
        self.run_line: Callable[[CncProgram, int], int] = lambda program, index: END

    def error(self, message: str) -> InputError:
        """Return an error at the line that is read."""
        return InputError(message, file=self.file, where=self.line)

    @contextmanager
    def guard(self) -> Iterator[None]:
        """Give the errors of a program the file and the line at which they occur."""
        try:
            yield
        except InputError as fault:
            raise (fault if fault.file else type(fault)(fault.message, file=self.file, where=self.line)) from None
        except ValueError as fault:
            raise self.error(str(fault)) from None

    def run(self, program: CncProgram, start: int | None = None) -> bool:
        """Carry out a program from a line on up to its end; return whether a line ended it."""
        kept, self.call = self.call, Call(program)
        self.lines = max(self.lines, len(program.lines))
        index, last, run_line = program.first if start is None else start, program.last, self.run_line
        while index < last:
            self.line = index + 1
            self.executed += 1
            if self.executed > self.lines:
                self.count_work(self.weigh(program.lines[index]))
            index = run_line(program, index)
            if index < 0 or self.over:
                break
        self.call = kept
        return index < 0

    def run_program(self, name: str, program: CncProgram, times: float, start: int | None = None) -> None:
        """Carry out a subprogram so many times."""
        if not 0 <= times <= MOST_CALLS or self.depth >= self.deepest:
            raise self.error(f"subprogram {name} is called {times:g} times at depth {self.depth + 1}, allowed are "
                             f"{MOST_CALLS} times and a depth of {self.deepest}")  # fmt: skip
        here, self.file, at = self.line, program.file, self.file
        self.depth += 1
        for _ in range(int(times)):
            self.count_work(0)
            self.run(program, start)
            if self.over:
                break
        self.depth -= 1
        self.line, self.file = here, at

    def count_work(self, letters: int) -> None:
        """Count a call, or the letters of a block that is carried out again."""
        self.letters += letters + BLOCK_LETTERS
        if self.letters > MOST_LETTERS:
            raise self.error(f"more than {MOST_LETTERS} letters of blocks are carried out again by jumps and calls; "
                             "no more are read")  # fmt: skip

    def repeat(self, index: int, times: Callable[[], float]) -> bool:
        """Return whether a repetition that stands in a line goes back once more."""
        left = self.call.repeats.get(index)
        left = int(times()) if left is None else left
        if left > 0:
            self.call.repeats[index] = left - 1
            return True
        self.call.repeats.pop(index, None)
        return False

    def find_beside(self, name: str) -> bool:
        """Load subprogram NAME from NAME.SPF in the folder of the file unless known; return whether it is known now."""
        searched = name not in self.programs and len(name) <= LONGEST_NAME
        for candidate in (f"{name}.SPF", f"{name}.spf", f"{name.lower()}.spf") if searched else ():
            beside = self.file.with_name(candidate)
            if beside.is_file():
                lines = split_lines(read_bounded(beside))
                self.programs[name] = CncProgram(lines, 0, len(lines), beside)
                break
        return name in self.programs
