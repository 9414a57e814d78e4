"""Macros of G-code (Fanuc, Haas, LinuxCNC): #1 = [#2 + 3] * SIN[30], X#1, IF, GOTO, WHILE DO, END, M98, M97, G65."""

from __future__ import annotations

import math
import operator
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.expressions import FUNCTIONS, Grammar, Parser, Value, need
from compplan.toolpath.readers.cnc.flow import CncProgram, Flow

#: Greatest number of variables.
MOST_VARIABLES = 10_000
HEAD = re.compile(r"\s*[O:]\s*0*(\d+)\b(?!\s*(?:SUB|CALL|IF|WHILE|REPEAT|DO)\b)", re.IGNORECASE)
#: Targets of jumps: block numbers, ends and beginnings of loops.
LABELS = {
    "N": re.compile(r"\s*(?:/\d?\s*)?N\s*0*(\d+)", re.IGNORECASE),
    "END": re.compile(r"\s*(?:N\d+\s*)?END\s*([1-9])", re.IGNORECASE),
    "DO": re.compile(r"\s*(?:N\d+\s*)?(?:WHILE\b.*)?DO\s*([1-9])", re.IGNORECASE),
}
#: Flow control of a line in capitals, without block number.
WHILE = re.compile(r"(?:WHILE\s*(\[.*\])\s*)?DO\s*([1-9])\s*$")
END_LOOP = re.compile(r"END\s*([1-9])\s*$")
GOTO = re.compile(r"GOTO\s*(.+)$")
IF = re.compile(r"IF\s*(?=\[)")
#: Variables that are set by the words of a macro call (Fanuc, argument specification I).
ARGUMENTS = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, *range(17, 27)), strict=True))
#: Beginning of a word whose number is a variable or an expression in brackets.
WORD_START = re.compile(r"([A-Z,])\s*=?\s*([-+]?)\s*(?=[#\[])")
ASSIGNMENT = re.compile(r"\s*(#[^=]*?)\s*=\s*")


def _work(rule: Callable[[float, float], float]) -> Callable[[Value, Value], float]:
    """Return an operator for values that may be vacant."""
    return lambda left, right: rule(need(left), need(right))


def _logic(name: str, rule: Callable[[bool, bool], bool]) -> Callable[[Value, Value], float]:
    def work(left: Value, right: Value) -> float:
        one, other = need(left), need(right)
        if {one, other} - {0.0, 1.0}:
            raise ValueError(f"{name} of {one:g} and {other:g}, of conditions only it has one meaning")
        return float(rule(bool(one), bool(other)))

    return work


#: A vacant variable equals only another vacant one, and is 0 in arithmetic.
GRAMMAR = Grammar(
    functions={
        **FUNCTIONS, "ATAN": (2, lambda y, x=None: math.degrees(math.atan(y) if x is None else math.atan2(y, x))),
        "SQR": (1, math.sqrt), "FIX": (1, math.floor), "FUP": (1, math.ceil), "POW": (2, math.pow),
        "ROUND": (1, lambda x: math.copysign(math.floor(abs(x) + 0.5), x)), "RND": (1, lambda x: math.floor(x + 0.5)),
    },
    operators={
        "EQ": (1, lambda a, b: float(a == b)), "NE": (1, lambda a, b: float(a != b)),
        "GT": (1, _work(operator.gt)), "LT": (1, _work(operator.lt)), "GE": (1, _work(operator.ge)),
        "LE": (1, _work(operator.le)), "+": (2, _work(operator.add)), "-": (2, _work(operator.sub)),
        "OR": (2, _logic("OR", lambda a, b: a or b)), "XOR": (2, _logic("XOR", lambda a, b: a != b)),
        "*": (3, _work(operator.mul)), "/": (3, _work(operator.truediv)), "MOD": (3, _work(math.fmod)),
        "AND": (3, _logic("AND", lambda a, b: a and b)), "**": (4, _work(math.pow)),
    },
    token=re.compile(
        r"\s*(?:(\d+\.?\d*|\.\d+)|"
        r"((?:EQ|NE|GT|LT|GE|LE|AND|OR|XOR|MOD|SIN|COS|TAN|ASIN|ACOS|ATAN|SQRT|SQR|ABS|ROUND|RND|FIX|FUP|LN|EXP|POW)"
        r"(?![A-Z]))|(#<[A-Z0-9_ ]*>|#|\*\*|[-+*/\[\],]))"
    ),
    brackets="[]",
)  # fmt: skip


class Macros:
    """Macro words and variables of a G-code program."""

    def __init__(self, flow: Flow) -> None:
        self.flow = flow
        #: Global variables; local variables of each call (#1 to #33 and names without a leading _).
        self.shared: dict[str, float] = {}
        self.local: list[dict[str, float]] = [{}]
        #: Target line of a jump.
        self.next: int | None = None

    def _scope(self, name: str) -> dict[str, float]:
        """Return the dictionary that holds a variable."""
        private = int(name) <= 33 if name.isdigit() else not name.startswith("_")
        return self.local[-1] if private else self.shared

    def get(self, name: str, indices: tuple[float, ...] = ()) -> Value:
        """Return the value of a variable, None if vacant (#0, and locals of a macro call without argument)."""
        value = self._scope(name).get(name)
        if value is None and name != "0" and not (len(self.local) > 1 and name.isdigit() and int(name) <= 33):
            shown = f"#{name}" if name.isdigit() else f"#<{name}>"
            raise ValueError(f"{shown} is read before the file has set it; set it in the file")
        return value

    def set(self, name: str, value: Value) -> None:
        """Set a variable; None makes it vacant."""
        if name == "0" or (name.isdigit() and int(name) >= 1000):
            raise ValueError(f"#{name} belongs to the control, the file may set #1 to #999")
        scope = self._scope(name)
        if value is None:
            scope.pop(name, None)
            return
        scope[name] = value
        if len(scope) > MOST_VARIABLES:
            raise ValueError(f"more than {MOST_VARIABLES} variables are set")

    def evaluate(self, text: str) -> tuple[Value, int]:
        """Return the value of the expression at the beginning of a text, and the index of its end."""
        parser = Parser(text, 0, GRAMMAR, self.get)
        return parser.parse_all(), parser.place

    def assign(self, line: str) -> bool:
        """Execute the assignments of a line (#1 = 5 #2 = #1); return whether the line contains assignments only."""
        place = 0
        results: list[tuple[str, Value]] = []
        while found := ASSIGNMENT.match(line, place):
            name = Parser(found.group(1), 0, GRAMMAR, self.get).read_name()
            value, used = self.evaluate(line[found.end() :])
            place = found.end() + used
            results.append((name, value))
        if line[place:].strip():
            return False
        for name, value in results:  # with the values of variables before the line
            self.set(name, value)
        return bool(results)

    def substitute(self, line: str) -> str:
        """Replace the expressions of a block by numbers; words with a vacant variable are left out."""
        parts: list[str] = []
        place = 0
        while found := WORD_START.search(line, place):
            parts.append(line[place : found.start()])
            parser = Parser(line[found.end() :], 0, GRAMMAR, self.get)
            value = parser.operand()
            place = found.end() + parser.place
            if value is not None:
                parts.append(f"{found.group(1)}{-value if found.group(2) == '-' else value:.12f} ")
        return "".join([*parts, line[place:]])

    def find_programs(self, lines: Sequence[str], file: Path) -> CncProgram:
        """Register the subprograms of a file by O number; return the first program."""
        numbers = [(index, found.group(1)) for index, line in enumerate(lines)
                   if line[:1] in "Oo: " and (found := HEAD.match(line))]  # fmt: skip
        for (index, number), stop in zip(numbers, [*(at for at, _ in numbers[1:]), len(lines)], strict=False):
            self.flow.programs.setdefault(number, CncProgram(lines, index + 1, stop, file))
        return CncProgram(lines, 0, numbers[1][0] if len(numbers) > 1 else len(lines), file)

    def _find(self, key: str, step: int = 0) -> int:
        """Return the next line of a key (END1, step 1), the previous one (DO1, step -1), or the next in turn (N10)."""
        program, here = self.flow.call.program, self.flow.line - 1
        if program.labels is None:
            program.labels = {}
            for index in range(program.first, program.last):
                for kind, pattern in LABELS.items():
                    if found := pattern.match(program.lines[index]):
                        program.labels.setdefault(kind + found.group(1), []).append(index)
        places = program.labels.get(key, [])
        at = bisect_left(places, here) - 1 if step < 0 else bisect_right(places, here)
        at = at if step or at < len(places) else 0  # a control searches on from the start
        if not 0 <= at < len(places):
            raise InputError(f"a jump to {key}, which is not in this program")
        return places[at]

    def run_macro(self, line: str) -> str | None:
        """Execute the macro words of a line in capitals; return the remaining block, None without any."""
        bare = re.sub(r"^N\s*\d+\s*", "", line)
        try:
            if self._control(bare) or (bare.startswith("#") and self.assign(bare)):
                return None
            return self.substitute(line)
        except (ValueError, ArithmeticError) as fault:
            raise InputError(f"{fault}, in {bare[:40]!r}") from None

    def _control(self, line: str) -> bool:
        """Execute IF, GOTO, WHILE DO and END; return whether the line is one of them."""
        unread = f"program control {line[:40]!r} is not read, expected"
        if found := IF.match(line):
            condition, used = self.evaluate(line[found.end() :])
            rest = line[found.end() + used :].strip()
            if rest.startswith("THEN"):
                if condition and not self.assign(rest[4:].strip()):
                    raise InputError(f"{unread} IF [..] THEN #1 = ..")
            elif not GOTO.match(rest):
                raise InputError(f"{unread} IF [..] GOTO or THEN")
            elif condition:
                self._control(rest)
            return True
        if found := GOTO.match(line):
            number, used = self.evaluate(found.group(1))
            if number is None or number != int(number) or found.group(1)[used:].strip():
                raise InputError(f"{unread} GOTO and the number of a block")
            self.next = self._find(f"N{int(number)}")
        elif found := WHILE.match(line):
            if found.group(1) and not self.evaluate(found.group(1))[0]:
                self.next = self._find("END" + found.group(2), 1) + 1
        elif found := END_LOOP.match(line):
            self.next = self._find("DO" + found.group(1), -1)
        elif line.startswith("WHILE"):
            raise InputError(f"{unread} WHILE [..] DO and a number from 1 to 9")
        return found is not None

    def call_number(self, values: Mapping[str, float], *, macro: bool = False, local: bool = False) -> None:
        """Execute M98 and G65 (subprogram O number), and M97 (`local`: from block N number of this program).

        P is the number of the program, L (or K in M98) of the repetitions; the other words of G65 are arguments.
        """
        code = "G65" if macro else "M97" if local else "M98"
        called = values.get("P", -1.0)
        times = values.get("L", 1.0 if macro else values.get("K", 1.0))
        if not (called.is_integer() and times.is_integer()) or called < 0:
            raise InputError(f"subprogram call {code} names no program, expected P and its number")
        number, programs = str(int(called)), self.flow.programs
        if not macro and not local and len(number) > 4 and number not in programs:
            times, number = float(number[:-4]), str(int(number[-4:]))
        if not local and number not in programs:
            raise InputError(f"subprogram call {code} P{number}: O{number} is not in this file; write it into the file")
        start = self._find(f"N{int(called)}") if local else None
        if macro:
            named = {str(ARGUMENTS[letter]): value for letter, value in values.items() if letter in ARGUMENTS}
            self.local.append(named)
        self.flow.run_program(f"P{number}", self.flow.call.program if local else programs[number], times, start)
        if macro:
            self.local.pop()
