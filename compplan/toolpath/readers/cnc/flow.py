"""Control flow of a program: programs of a file, calls, jumps and loops, with limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.toolpath.readers.lines import read_bounded, split_lines

#: Greatest number of repetitions of a call, and depth of nested calls.
MOST_CALLS = 9999
DEEPEST = 11
#: Greatest number of characters of blocks that jumps and calls repeat, and the number added for each block:
#: about 120,000 blocks, 1 to 4 s (assumed).
MOST_LETTERS, BLOCK_LETTERS = 4_000_000, 15
#: Longest name of a program that is searched in the folder of a file (assumed). [characters]
LONGEST_NAME = 100
#: Result of a line that ends its program.
END = -1


@dataclass
class CncProgram:
    """Program of a file: lines as split by the dialect, from index `first` to `last` (exclusive).

    `labels` are the lines of its labels or block numbers, `partners` those of the other end of control structures,
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
    """Running program, with the repetitions that are left by line, and counting loops that begin their next pass."""

    program: CncProgram
    repeats: dict[int, int] = field(default_factory=dict)
    counting: set[int] = field(default_factory=set)


class Flow:
    """Execute programs line by line."""

    def __init__(self, file: Path, deepest: int = DEEPEST) -> None:
        self.file, self.deepest = file, deepest
        self.line = self.executed = self.lines = self.depth = self.letters = 0
        self.over = False
        #: Function that returns the number of characters of a line.
        self.weigh: Callable[[Any], int] = len
        self.programs: dict[str, CncProgram] = {}
        self.call = Call(CncProgram((), 0, 0, file))
        #: Function that executes a line of the running program and returns the index of the next one, or END.
        self.run_line: Callable[[CncProgram, int], int] = lambda program, index: END

    def error(self, message: str) -> InputError:
        """Return an error at the current line."""
        return InputError(message, file=self.file, where=self.line)

    @contextmanager
    def guard(self) -> Iterator[None]:
        """Add file and line to the errors of a program."""
        try:
            yield
        except InputError as fault:
            raise (fault if fault.file else type(fault)(fault.message, file=self.file, where=self.line)) from None
        except ValueError as fault:
            raise self.error(str(fault)) from None

    def run(self, program: CncProgram, start: int | None = None) -> bool:
        """Execute a program from a line to its end; return whether a line returned END."""
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
        """Execute a subprogram `times` times."""
        if not 0 <= times <= MOST_CALLS or self.depth >= self.deepest:
            raise self.error(f"subprogram {name} is called {times:g} times at depth {self.depth + 1}, at most "
                             f"{MOST_CALLS} times and depth {self.deepest} are read")  # fmt: skip
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
        """Count a call, or the characters of a repeated block, and refuse more than the limit."""
        self.letters += letters + BLOCK_LETTERS
        if self.letters > MOST_LETTERS:
            raise self.error(f"more than {MOST_LETTERS} letters of blocks are carried out again by jumps and calls; "
                             "no more are read")  # fmt: skip

    def repeat(self, index: int, times: Callable[[], float]) -> bool:
        """Return whether the repetition in a line jumps back once more."""
        left = self.call.repeats.get(index)
        left = int(times()) if left is None else left
        if left > 0:
            self.call.repeats[index] = left - 1
            return True
        self.call.repeats.pop(index, None)
        return False

    def find_sibling(self, name: str) -> bool:
        """Load subprogram NAME from NAME.SPF in the folder of the file unless known; return whether it is known."""
        searched = name not in self.programs and len(name) <= LONGEST_NAME
        for candidate in (f"{name}.SPF", f"{name}.spf", f"{name.lower()}.spf") if searched else ():
            beside = self.file.with_name(candidate)
            if beside.is_file():
                lines = split_lines(read_bounded(beside))
                self.programs[name] = CncProgram(lines, 0, len(lines), beside)
                break
        return name in self.programs
