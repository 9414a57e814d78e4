"""Arithmetic in CNC programs: formulas of Heidenhain and expressions of Siemens controls, by precedence climbing."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:EX?[-+]?\d+(?![\w.]))?)|([$A-Z_][$\w]*)|(<<|<>|==|<=|>=|[-+*/()\[\],^<>]))", re.ASCII
)
#: How deep brackets may stand in one another.
DEEPEST = 60
Operator = Callable[[float, float], float]
Lookup = Callable[[str, tuple[float, ...]], float]


@dataclass(frozen=True)
class Grammar:
    """Say what an expression may hold.

    Args:
        functions: Functions by name, and how many arguments each takes.
        operators: Operators by their sign or word: how tightly each binds (greater: tighter), and what it does.
        bare: Whether a function of one argument may go without brackets (SIN 30).

    """

    functions: Mapping[str, tuple[int, Callable[..., float]]]
    operators: Mapping[str, tuple[int, Operator]]
    bare: bool = False


def evaluate(text: str, grammar: Grammar, lookup: Lookup) -> float:
    """Return the value of an expression that is the whole text.

    Raises:
        ValueError: If it is none, or has no value.

    """
    value, place = evaluate_at(text, 0, grammar, lookup)
    if text[place:].strip():
        raise ValueError(f"cannot read {text[place:].strip()[:30]!r} in the expression {text.strip()[:40]!r}")
    return value


def evaluate_at(text: str, place: int, grammar: Grammar, lookup: Lookup) -> tuple[float, int]:
    """Return the value of the expression that begins at a place, and where it ends.

    Args:
        text: Text in capitals.
        place: Where the expression begins.
        grammar: What it may hold.
        lookup: Gives the value of a variable by its name and indices; raises ValueError where it has none.

    Raises:
        ValueError: If no expression begins there, or it has no value.

    """
    parser = _Parser(text, place, grammar, lookup)
    try:
        value = parser.parse(0)
    except (ZeroDivisionError, OverflowError):
        raise ValueError(f"expression {text[place:].strip()[:40]!r} has no value") from None
    if not math.isfinite(value):
        raise ValueError(f"expression {text[place:].strip()[:40]!r} has no value")
    return value, parser.place


class _Parser:
    def __init__(self, text: str, place: int, grammar: Grammar, lookup: Lookup) -> None:
        self.text, self.place, self.grammar, self.lookup = text, place, grammar, lookup
        self.depth = 0

    def parse(self, least: int) -> float:
        """Read operands joined by operators that bind at least so tightly."""
        value = self._operand()
        while True:
            found = TOKEN.match(self.text, self.place)
            sign = (found.group(2) or found.group(3)) if found else None
            rule = self.grammar.operators.get(sign) if sign else None
            if found is None or rule is None or rule[0] < least:
                return value
            self.place = found.end()
            value = rule[1](value, self.parse(rule[0] + 1))

    def _operand(self) -> float:
        found = TOKEN.match(self.text, self.place)
        if found is None:
            raise ValueError(f"cannot read {self.text[self.place :].strip()[:30]!r}, expected a number or expression")
        number, word, sign = found.groups()
        self.place = found.end()
        if number:
            return float(number.replace("EX", "E"))
        self.depth += 1
        if self.depth > DEEPEST:
            raise ValueError(f"expression {self.text[:40]!r} is too deep")
        try:
            if word:
                return self._named(word)
            if sign == "-":
                return -self._operand()
            if sign == "+":
                return self._operand()
            if sign == "(":
                value = self.parse(0)
                self._expect(")")
                return value
        finally:
            self.depth -= 1
        raise ValueError(f"{sign!r} stands where a number is expected in {self.text.strip()[:40]!r}")

    def _named(self, word: str) -> float:
        if word == "NOT":
            return float(not self._operand())
        function = self.grammar.functions.get(word)
        if function is None:
            return self.lookup(word, self._indices())
        count, rule = function
        if count == 0:
            return rule()
        if self.grammar.bare:
            return rule(self._operand())
        self._expect("(")
        values = [self.parse(0)]
        while self._accept(","):
            values.append(self.parse(0))
        self._expect(")")
        if len(values) != count:
            raise ValueError(f"{word} takes {count} numbers, {len(values)} are given")
        return rule(*values)

    def _indices(self) -> tuple[float, ...]:
        if not self._accept("["):
            return ()
        values = [self.parse(0)]
        while self._accept(","):
            values.append(self.parse(0))
        self._expect("]")
        return tuple(values)

    def _accept(self, sign: str) -> bool:
        found = TOKEN.match(self.text, self.place)
        if found is None or found.group(3) != sign:
            return False
        self.place = found.end()
        return True

    def _expect(self, sign: str) -> None:
        if not self._accept(sign):
            raise ValueError(f"{sign!r} is missing in {self.text.strip()[:40]!r}")


def sin_deg(angle: float) -> float:
    """Return the sine of an angle in degrees."""
    return math.sin(math.radians(angle))


def cos_deg(angle: float) -> float:
    """Return the cosine of an angle in degrees."""
    return math.cos(math.radians(angle))


def tan_deg(angle: float) -> float:
    """Return the tangent of an angle in degrees."""
    return math.tan(math.radians(angle))


def asin_deg(number: float) -> float:
    """Return the angle in degrees that has this sine."""
    return math.degrees(math.asin(number))


def acos_deg(number: float) -> float:
    """Return the angle in degrees that has this cosine."""
    return math.degrees(math.acos(number))


def atan_deg(number: float) -> float:
    """Return the angle in degrees that has this tangent."""
    return math.degrees(math.atan(number))
