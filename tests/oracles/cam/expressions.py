"""Arithmetic of control programs: numbers, variables, brackets, functions in degrees."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from tests.oracles.cam.moves import CannotTellError

_TOKEN = re.compile(r"\s*(\d+\.?\d*(?:E[-+]?\d+)?|\.\d+|\*\*|<>|>=|<=|==|[A-Z]+\d*|[-+*/()\[\]#<>=,])")
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "SIN": lambda v: math.sin(math.radians(v)), "COS": lambda v: math.cos(math.radians(v)),
    "TAN": lambda v: math.tan(math.radians(v)), "ASIN": lambda v: math.degrees(math.asin(v)),
    "ACOS": lambda v: math.degrees(math.acos(v)), "SQRT": math.sqrt, "ABS": abs, "FIX": math.floor, "FUP": math.ceil,
    "ROUND": lambda v: math.floor(v + 0.5), "TRUNC": math.trunc, "INT": math.trunc, "NEG": lambda v: -v,
    "SQ": lambda v: v * v, "FRAC": lambda v: v - math.trunc(v), "LN": math.log, "EXP": math.exp,
}  # fmt: skip
_COMPARE: dict[str, Callable[[float, float], bool]] = {
    "EQ": lambda a, b: a == b, "NE": lambda a, b: a != b, "GT": lambda a, b: a > b, "GE": lambda a, b: a >= b,
    "LT": lambda a, b: a < b, "LE": lambda a, b: a <= b, "==": lambda a, b: a == b, "<>": lambda a, b: a != b,
    ">": lambda a, b: a > b, ">=": lambda a, b: a >= b, "<": lambda a, b: a < b, "<=": lambda a, b: a <= b,
}  # fmt: skip


class Expression:
    """Work out an expression of capital letters.

    Args:
        text: The expression.
        values: Values of the variables, by name (`#1`, `R1`, `Q1`).

    """

    def __init__(self, text: str, values: dict[str, float]) -> None:
        """Cut the text into its words."""
        self.words: list[str] = []
        at, text = 0, text.strip()
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None:
                raise CannotTellError(f"an expression {text!r}")
            self.words.append(match[1])
            at = match.end()
        self.values, self.at = values, 0

    def result(self) -> float:
        """Return its value; 1 or 0 of a comparison.

        Raises:
            CannotTellError: If something in it is not known.

        """
        try:
            value = self._compare()
        except (ValueError, ZeroDivisionError, OverflowError):
            raise CannotTellError(f"an expression without a value: {' '.join(self.words)}") from None
        if self.at < len(self.words):
            raise CannotTellError(f"an expression {' '.join(self.words)!r}")
        return value

    def _next(self) -> str:
        return self.words[self.at] if self.at < len(self.words) else ""

    def _take(self) -> str:
        self.at += 1
        return self.words[self.at - 1] if self.at <= len(self.words) else ""

    def _compare(self) -> float:
        value = self._sum()
        while self._next() in _COMPARE:
            value = float(_COMPARE[self._take()](value, self._sum()))
        return value

    def _sum(self) -> float:
        value = self._product()
        while self._next() in ("+", "-"):
            value = value + self._product() if self._take() == "+" else value - self._product()
        return value

    def _product(self) -> float:
        value = self._power()
        while self._next() in ("*", "/", "MOD", "DIV"):
            word, other = self._take(), self._power()
            if word == "*":
                value *= other
            elif word == "/":
                value /= other
            else:
                value = math.fmod(value, other) if word == "MOD" else math.trunc(value / other)
        return value

    def _power(self) -> float:
        value = self._factor()
        while self._next() == "**":
            self._take()
            value = value ** self._factor()
        return value

    def _factor(self) -> float:
        word = self._take()
        if word in ("-", "+"):
            return -self._factor() if word == "-" else self._factor()
        if word in ("(", "["):
            value = self._compare()
            if self._take() not in (")", "]"):
                raise CannotTellError("a bracket that does not close")
            return value
        if word == "#":
            return self._value(f"#{self._factor():.0f}")
        if word == "ATAN":
            return self._arc_tangent()
        if word in _FUNCTIONS:
            return _FUNCTIONS[word](self._factor())
        if word[:1].isdigit() or word[:1] == ".":
            return float(word)
        return self._value(word)

    def _value(self, name: str) -> float:
        if name not in self.values:
            raise CannotTellError(f"the value of {name}")
        return self.values[name]

    def _arc_tangent(self) -> float:
        first = self._factor()
        if self._next() == "/":
            self._take()
            return math.degrees(math.atan2(first, self._factor()))
        return math.degrees(math.atan(first))


def evaluate(text: str, values: dict[str, float]) -> float:
    """Return the value of an expression; plain numbers are quick.

    Raises:
        CannotTellError: If something in it is not known.

    """
    try:
        return float(text)
    except ValueError:
        return Expression(text, values).result()
