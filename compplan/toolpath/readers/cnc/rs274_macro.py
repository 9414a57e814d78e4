"""Macro variables and expressions of G-code (Fanuc, Haas, LinuxCNC): #1 = [#2 + 3] * SIN[30], X#1, conditions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field

#: Greatest depth of brackets within brackets.
DEEPEST_BRACKETS = 50
#: Greatest number of variables.
MOST_VARIABLES = 10_000
#: Greatest distance of a result from 0.
GREATEST = 1e15
TOKEN = re.compile(
    r"\s*(#<[A-Z0-9_ ]*>|#|\*\*|[-+*/\[\],]|\d+\.?\d*|\.\d+|"
    r"(?:EQ|NE|GT|LT|GE|LE|AND|OR|XOR|MOD|SIN|COS|TAN|ASIN|ACOS|ATAN|SQRT|SQR|ABS|ROUND|RND|FIX|FUP|LN|EXP|POW)"
    r"(?![A-Z]))"
)
FUNCTIONS: dict[str, Callable[[float], float]] = {
    "SIN": lambda x: math.sin(math.radians(x)), "COS": lambda x: math.cos(math.radians(x)),
    "TAN": lambda x: math.tan(math.radians(x)), "ASIN": lambda x: math.degrees(math.asin(x)),
    "ACOS": lambda x: math.degrees(math.acos(x)), "ATAN": lambda x: math.degrees(math.atan(x)),
    "SQRT": math.sqrt, "SQR": math.sqrt, "ABS": abs, "LN": math.log, "EXP": math.exp,
    "ROUND": lambda x: math.copysign(math.floor(abs(x) + 0.5), x), "RND": lambda x: math.floor(x + 0.5),
    "FIX": lambda x: math.floor(x), "FUP": lambda x: math.ceil(x),
}  # fmt: skip
COMPARE: dict[str, Callable[[float, float], bool]] = {
    "EQ": lambda a, b: a == b,
    "NE": lambda a, b: a != b,
    "GT": lambda a, b: a > b,
    "LT": lambda a, b: a < b,
    "GE": lambda a, b: a >= b,
    "LE": lambda a, b: a <= b,
}
#: Operators from the weakest to the strongest.
LEVELS = (("EQ", "NE", "GT", "LT", "GE", "LE"), ("+", "-", "OR", "XOR"), ("*", "/", "AND", "MOD"), ("**",))
#: Words of a block: a letter and a variable, a bracket, or a number.
WORD_START = re.compile(r"([A-Z,])\s*=?\s*([-+]?)\s*(?=[#\[])")
ASSIGNMENT = re.compile(r"\s*(#[^=]*?)\s*=\s*")


class MacroError(ValueError):
    """Tell why an expression cannot be worked out."""


@dataclass
class Variables:
    """Hold the variables of a program: locals #1 to #33 of each call, and those that all programs share."""

    shared: dict[str, float] = field(default_factory=dict)
    local: list[dict[str, float]] = field(default_factory=lambda: [{}])

    def _home(self, name: str) -> dict[str, float]:
        """Return where a variable is kept."""
        number = int(name) if name.isdigit() else None
        private = (number is not None and number <= 33) or (number is None and not name.startswith("_"))
        return self.local[-1] if private else self.shared

    def get(self, name: str) -> float | None:
        """Return a variable, None where it is vacant (#0, and locals of a called macro that no argument set).

        Raises:
            MacroError: If nothing in the file has set it.

        """
        value = self._home(name).get(name)
        if value is None and name != "0" and not (len(self.local) > 1 and name.isdigit() and int(name) <= 33):
            shown = f"#{name}" if name.isdigit() else f"#<{name}>"
            raise MacroError(f"{shown} is read before the file has set it")
        return value

    def set(self, name: str, value: float | None) -> None:
        """Give a variable a value; None makes it vacant.

        Raises:
            MacroError: If it is #0, one of the control's own, or one too many.

        """
        if name == "0" or (name.isdigit() and int(name) >= 1000):
            raise MacroError(f"#{name} belongs to the control, the file may set #1 to #999")
        home = self._home(name)
        if value is None:
            home.pop(name, None)
            return
        home[name] = value
        if len(home) > MOST_VARIABLES:
            raise MacroError(f"more than {MOST_VARIABLES} variables are set")


class Evaluator:
    """Work out one expression from left to right."""

    def __init__(self, text: str, variables: Variables) -> None:
        self.text, self.place, self.variables, self.depth = text, 0, variables, 0

    def _peek(self) -> str:
        found = TOKEN.match(self.text, self.place)
        return found.group(1) if found else ""

    def _take(self) -> str:
        found = TOKEN.match(self.text, self.place)
        if not found:
            return ""
        self.place = found.end()
        return found.group(1)

    def _expect(self, token: str) -> None:
        if self._take() != token:
            raise MacroError(f"expected {token!r} in {self.text.strip()[:40]!r}")

    def evaluate(self, level: int = 0) -> float | None:
        """Return the value of the operators of a level and above, None where it is vacant."""
        if level == len(LEVELS):
            return self._evaluate_atom()
        left = self.evaluate(level + 1)
        while (operator := self._peek()) in LEVELS[level]:
            self._take()
            left = _apply(operator, left, self.evaluate(level + 1))
        return left

    def _evaluate_atom(self) -> float | None:
        token = self._take()
        if token in ("-", "+"):
            value = _need(self._evaluate_atom())
            return -value if token == "-" else value
        if token == "[":
            return self._evaluate_bracket()
        if token == "#":
            return self.variables.get(self._read_name())
        if token.startswith("#<"):
            return self.variables.get(token[2:-1].replace(" ", ""))
        if token in FUNCTIONS or token == "POW":
            return self._call(token)
        if not token or not (token[0].isdigit() or token[0] == "."):
            raise MacroError(
                f"expression {self.text.strip()[:40]!r} cannot be read at {self.text[self.place :][:10]!r}"
            )
        return float(token)

    def _evaluate_bracket(self) -> float | None:
        self.depth += 1
        if self.depth > DEEPEST_BRACKETS:
            raise MacroError(f"more than {DEEPEST_BRACKETS} brackets within brackets")
        value = self.evaluate()
        self._expect("]")
        self.depth -= 1
        return value

    def _read_name(self) -> str:
        """Read the number of a variable after its #: digits, another variable, or brackets."""
        token = self._take()
        if token == "#":
            number = _need(self.variables.get(self._read_name()))
        elif token == "[":
            number = _need(self._evaluate_bracket())
        elif token and token[0].isdigit():
            number = float(token)
        else:
            raise MacroError(f"# in {self.text.strip()[:40]!r} is followed by no number")
        if number != int(number) or not 0 <= number < 1e6:
            raise MacroError(f"#{number:g} is no variable, expected a whole number")
        return str(int(number))

    def _call(self, name: str) -> float:
        """Work out a function; ATAN[y]/[x] and ATAN[y, x] give the angle of the point (x, y) from 0 to 360 degrees."""
        self._expect("[")
        first = _need(self.evaluate())
        second: float | None = None
        if self._peek() == ",":
            self._take()
            second = _need(self.evaluate())
        self._expect("]")
        if name == "ATAN" and second is None and re.match(r"\s*/\s*\[", self.text[self.place :]):
            self._take()
            self._take()
            second = _need(self._evaluate_bracket())
        try:
            if name == "ATAN" and second is not None:
                return math.degrees(math.atan2(first, second))
            if name == "POW" and second is not None:
                return _finite(math.pow(first, second))
            return _finite(float(FUNCTIONS[name](first)))
        except (ValueError, OverflowError, KeyError):
            raise MacroError(f"{name}[{first:g}] has no value") from None


def _need(value: float | None) -> float:
    """Return a value that must not be vacant; vacant counts as 0 in arithmetic."""
    return 0.0 if value is None else value


def _finite(value: float) -> float:
    if not abs(value) < GREATEST:
        raise MacroError(f"an expression gives {value:g}, less than {GREATEST:g} is allowed")
    return value


def _apply(operator: str, left: float | None, right: float | None) -> float:
    """Return the result of an operator; a vacant variable equals another vacant one alone."""
    if operator in ("EQ", "NE") and (left is None or right is None):
        same = left is None and right is None
        return float(same == (operator == "EQ"))
    one, other = _need(left), _need(right)
    if operator in COMPARE:
        return float(COMPARE[operator](one, other))
    if operator in ("AND", "OR", "XOR"):
        if {one, other} - {0.0, 1.0}:
            raise MacroError(f"{operator} of {one:g} and {other:g}, of conditions only it has one meaning")
        return float({"AND": one and other, "OR": one or other, "XOR": one != other}[operator])
    if operator in ("/", "MOD") and other == 0.0:
        raise MacroError("division by 0")
    try:
        return _finite(
            one + other if operator == "+" else one - other if operator == "-" else one * other if operator == "*"
            else one / other if operator == "/" else math.fmod(one, other) if operator == "MOD"
            else math.pow(one, other)
        )  # fmt: skip
    except (ValueError, OverflowError):
        raise MacroError(f"{one:g} {operator} {other:g} has no value") from None


def work_out(text: str, variables: Variables) -> tuple[float | None, int]:
    """Return the value of the expression at the beginning of a text, and where it ends."""
    reader = Evaluator(text, variables)
    try:
        value = reader.evaluate()
    except RecursionError:
        raise MacroError(f"more than {DEEPEST_BRACKETS} brackets within brackets") from None
    return value, reader.place


def assign(line: str, variables: Variables) -> bool:
    """Carry out the assignments of a line (#1 = 5 #2 = #1); return whether it is nothing else.

    Raises:
        MacroError: If one of them cannot be worked out.

    """
    place = 0
    results: list[tuple[str, float | None]] = []
    while found := ASSIGNMENT.match(line, place):
        reader = Evaluator(found.group(1), variables)
        token = reader._take()
        name = token[2:-1].replace(" ", "") if token.startswith("#<") else reader._read_name()
        value, used = work_out(line[found.end() :], variables)
        place = found.end() + used
        results.append((name, value))
    if line[place:].strip():
        return False
    for name, value in results:  # those of one line count from before it
        variables.set(name, value)
    return bool(results)


def spell_out(line: str, variables: Variables) -> str:
    """Return a block with numbers in place of variables and expressions; words with a vacant variable are left out.

    Raises:
        MacroError: If one cannot be worked out.

    """
    parts: list[str] = []
    place = 0
    while found := WORD_START.search(line, place):
        parts.append(line[place : found.start()])
        reader = Evaluator(line[found.end() :], variables)
        value = reader._evaluate_atom()
        place = found.end() + reader.place
        if value is not None:
            value = _finite(-value if found.group(2) == "-" else value)
            parts.append(f"{found.group(1)}{value:.12f} ")
    return "".join([*parts, line[place:]])
