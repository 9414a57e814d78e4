"""Macros of G-code (Fanuc, Haas, LinuxCNC): #1 = [#2 + 3] * SIN[30], X#1, conditions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field

from compplan.toolpath.readers.cnc.expressions import FUNCTIONS, Grammar, Parser, Value, need

#: Greatest number of variables, and greatest distance of a result from 0.
MOST_VARIABLES = 10_000
GREATEST = 1e15
#: Words of a block: a letter and a variable, a bracket, or a number.
WORD_START = re.compile(r"([A-Z,])\s*=?\s*([-+]?)\s*(?=[#\[])")
ASSIGNMENT = re.compile(r"\s*(#[^=]*?)\s*=\s*")


def _finite(rule: Callable[[float, float], float]) -> Callable[[Value, Value], float]:
    """Return an operator on values that may be vacant, whose result is bounded."""

    def work(left: Value, right: Value) -> float:
        value = rule(need(left), need(right))
        if not abs(value) < GREATEST:
            raise ValueError(f"an expression gives {value:g}, less than {GREATEST:g} is allowed")
        return value

    return work


def _logic(name: str, rule: Callable[[bool, bool], bool]) -> Callable[[Value, Value], float]:
    def work(left: Value, right: Value) -> float:
        one, other = need(left), need(right)
        if {one, other} - {0.0, 1.0}:
            raise ValueError(f"{name} of {one:g} and {other:g}, of conditions only it has one meaning")
        return float(rule(bool(one), bool(other)))

    return work


def _divide(left: float, right: float) -> float:
    if right == 0.0:
        raise ValueError("division by 0")
    return left / right


def _power(left: float, right: float) -> float:
    try:
        return math.pow(left, right)
    except (ValueError, OverflowError):
        raise ValueError(f"{left:g} ** {right:g} has no value") from None


#: A vacant variable equals another vacant one alone, and counts as 0 in arithmetic.
GRAMMAR = Grammar(
    functions={
        **FUNCTIONS, "ATAN": (2, lambda y, x=None: math.degrees(math.atan(y) if x is None else math.atan2(y, x))),
        "SQR": (1, math.sqrt), "FIX": (1, math.floor), "FUP": (1, math.ceil), "POW": (2, _power),
        "ROUND": (1, lambda x: math.copysign(math.floor(abs(x) + 0.5), x)), "RND": (1, lambda x: math.floor(x + 0.5)),
    },
    operators={
        "EQ": (1, lambda a, b: float(a == b)), "NE": (1, lambda a, b: float(a != b)),
        "GT": (1, lambda a, b: float(need(a) > need(b))), "LT": (1, lambda a, b: float(need(a) < need(b))),
        "GE": (1, lambda a, b: float(need(a) >= need(b))), "LE": (1, lambda a, b: float(need(a) <= need(b))),
        "+": (2, _finite(lambda a, b: a + b)), "-": (2, _finite(lambda a, b: a - b)),
        "OR": (2, _logic("OR", lambda a, b: a or b)), "XOR": (2, _logic("XOR", lambda a, b: a != b)),
        "*": (3, _finite(lambda a, b: a * b)), "/": (3, _finite(_divide)),
        "MOD": (3, _finite(lambda a, b: math.fmod(a, b) if b else _divide(a, b))),
        "AND": (3, _logic("AND", lambda a, b: a and b)), "**": (4, _finite(_power)),
    },
    token=re.compile(
        r"\s*(?:(\d+\.?\d*|\.\d+)|"
        r"((?:EQ|NE|GT|LT|GE|LE|AND|OR|XOR|MOD|SIN|COS|TAN|ASIN|ACOS|ATAN|SQRT|SQR|ABS|ROUND|RND|FIX|FUP|LN|EXP|POW)"
        r"(?![A-Z]))|(#<[A-Z0-9_ ]*>|#|\*\*|[-+*/\[\],]))"
    ),
    brackets="[]",
)  # fmt: skip


@dataclass
class Variables:
    """Hold the variables of a program: locals #1 to #33 of each call, and those that all programs share."""

    shared: dict[str, float] = field(default_factory=dict)
    local: list[dict[str, float]] = field(default_factory=lambda: [{}])

    def _home(self, name: str) -> dict[str, float]:
        """Return where a variable is kept."""
        private = int(name) <= 33 if name.isdigit() else not name.startswith("_")
        return self.local[-1] if private else self.shared

    def get(self, name: str, indices: tuple[float, ...] = ()) -> Value:
        """Return a variable, None where it is vacant (#0, and locals of a called macro that no argument set)."""
        value = self._home(name).get(name)
        if value is None and name != "0" and not (len(self.local) > 1 and name.isdigit() and int(name) <= 33):
            shown = f"#{name}" if name.isdigit() else f"#<{name}>"
            raise ValueError(f"{shown} is read before the file has set it")
        return value

    def set(self, name: str, value: Value) -> None:
        """Give a variable a value; None makes it vacant."""
        if name == "0" or (name.isdigit() and int(name) >= 1000):
            raise ValueError(f"#{name} belongs to the control, the file may set #1 to #999")
        home = self._home(name)
        if value is None:
            home.pop(name, None)
            return
        home[name] = value
        if len(home) > MOST_VARIABLES:
            raise ValueError(f"more than {MOST_VARIABLES} variables are set")

    def work_out(self, text: str) -> tuple[Value, int]:
        """Return the value of the expression at the beginning of a text, and where it ends."""
        parser = Parser(text, 0, GRAMMAR, self.get)
        return parser.parse_all(), parser.place

    def assign(self, line: str) -> bool:
        """Carry out the assignments of a line (#1 = 5 #2 = #1); return whether it is nothing else."""
        place = 0
        results: list[tuple[str, Value]] = []
        while found := ASSIGNMENT.match(line, place):
            name = Parser(found.group(1), 0, GRAMMAR, self.get).read_name()
            value, used = self.work_out(line[found.end() :])
            place = found.end() + used
            results.append((name, value))
        if line[place:].strip():
            return False
        for name, value in results:  # those of one line count from before it
            self.set(name, value)
        return bool(results)

    def spell_out(self, line: str) -> str:
        """Return a block with numbers in place of its expressions; words with a vacant variable are left out."""
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
