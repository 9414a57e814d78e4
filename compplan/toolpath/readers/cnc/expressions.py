"""Parser of expressions in CNC programs: formulas of Klartext, expressions of Sinumerik, macros of G-code."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:EX?[-+]?\d+(?![\w.]))?)|([$A-Z_][$\w]*)|(<<|<>|==|<=|>=|[-+*/()\[\],^<>]))", re.ASCII
)
#: Greatest depth of nested brackets.
DEEPEST = 50
#: Value of a variable; None: vacant, 0 in arithmetic (macros of G-code).
Value = float | None
Lookup = Callable[[str, tuple[float, ...]], Value]
#: Functions of all dialects with their numbers of arguments; angles in degrees.
FUNCTIONS: Mapping[str, tuple[int, Callable[..., float]]] = {
    "SIN": (1, lambda x: math.sin(math.radians(x))), "COS": (1, lambda x: math.cos(math.radians(x))),
    "TAN": (1, lambda x: math.tan(math.radians(x))), "ASIN": (1, lambda x: math.degrees(math.asin(x))),
    "ACOS": (1, lambda x: math.degrees(math.acos(x))), "SQRT": (1, math.sqrt), "ABS": (1, abs), "LN": (1, math.log),
    "EXP": (1, math.exp),
}  # fmt: skip


@dataclass(frozen=True)
class Grammar:
    """Grammar of expressions: functions with their numbers of arguments, operators with their precedence.

    A greater precedence binds tighter. If `bare`, a function of one argument needs no brackets (SIN 30).
    """

    functions: Mapping[str, tuple[int, Callable[..., float]]]
    operators: Mapping[str, tuple[int, Callable[..., float]]]
    bare: bool = False
    token: re.Pattern[str] = TOKEN
    brackets: str = "()"


def evaluate(text: str, grammar: Grammar, lookup: Lookup) -> float:
    """Return the value of a text that is one expression; raise a ValueError if it is not."""
    value, place = evaluate_at(text, 0, grammar, lookup)
    if text[place:].strip():
        raise ValueError(f"cannot read {text[place:].strip()[:30]!r} in the expression {text.strip()[:40]!r}")
    return value


def evaluate_at(text: str, place: int, grammar: Grammar, lookup: Lookup) -> tuple[float, int]:
    """Return the value of the expression that begins at an index of a text in capitals, and the index of its end."""
    parser = Parser(text, place, grammar, lookup)
    return need(parser.parse_all()), parser.place


def need(value: Value) -> float:
    """Return a value, 0 for a vacant one."""
    return 0.0 if value is None else value


class Parser:
    """Evaluate expressions of a text from an index on by precedence climbing; `lookup` returns values of variables."""

    def __init__(self, text: str, place: int, grammar: Grammar, lookup: Lookup) -> None:
        self.text, self.place, self.grammar, self.lookup = text, place, grammar, lookup
        self.depth = 0

    def parse_all(self) -> Value:
        """Return the value of the expression at the current index."""
        first = self.place
        try:
            value = self.parse()
        except (ZeroDivisionError, OverflowError):
            value = math.nan
        if value is not None and not math.isfinite(value):
            raise ValueError(f"expression {self.text[first:].strip()[:40]!r} has no value")
        return value

    def parse(self, least: int = 0) -> Value:
        """Return the value of operands joined by operators with a precedence of at least `least`."""
        value = self.operand()
        while True:
            found = self.grammar.token.match(self.text, self.place)
            sign = (found.group(2) or found.group(3)) if found else None
            rule = self.grammar.operators.get(sign) if sign else None
            if found is None or rule is None or rule[0] < least:
                return value
            self.place = found.end()
            value = rule[1](value, self.parse(rule[0] + 1))

    def operand(self) -> Value:
        """Return the value of a number, a variable, a function or an expression in brackets."""
        found = self.grammar.token.match(self.text, self.place)
        if found is None:
            raise ValueError(f"cannot read {self.text[self.place :].strip()[:30]!r}, expected a number or expression")
        number, word, sign = found.groups()
        self.place = found.end()
        if number:
            return float(number.replace("EX", "E"))
        self.depth += 1
        if self.depth > DEEPEST:
            raise ValueError(f"more than {DEEPEST} nested brackets, in {self.text[:40]!r}")
        try:
            if word:
                return self._named(word)
            if sign in ("-", "+"):
                value = need(self.operand())
                return -value if sign == "-" else value
            if sign == self.grammar.brackets[0]:
                inner = self.parse()
                self._expect(self.grammar.brackets[1])
                return inner
            if sign[0] == "#":
                return self.lookup(self.read_name(sign), ())
        finally:
            self.depth -= 1
        raise ValueError(f"{sign!r} stands where a number is expected in {self.text.strip()[:40]!r}")

    def read_name(self, sign: str = "") -> str:
        """Return the name of a macro variable: #<NAME>, or # and digits, another variable, or brackets."""
        sign = sign or self._take()
        if sign != "#":
            return sign[2:-1].replace(" ", "")
        number = need(self.operand())
        if number != int(number) or not 0 <= number < 1e6:
            raise ValueError(f"#{number:.10g} is not a variable, expected a whole number from 0 to 999999")
        return str(int(number))

    def _named(self, word: str) -> Value:
        if word == "NOT":
            return float(not self.operand())
        function = self.grammar.functions.get(word)
        if function is None:
            return self.lookup(word, tuple(self._list("]")) if self._accept("[") else ())
        count, rule = function
        values: list[float] = []
        if self.grammar.bare:
            values = [need(self.operand())] if count else []
        else:
            self._expect(self.grammar.brackets[0])
            values = self._list(self.grammar.brackets[1])
            if word == "ATAN" and len(values) < count and re.match(r"\s*/\s*\[", self.text[self.place :]):
                self._take()  # ATAN[y]/[x]
                values.append(need(self.operand()))
        if len(values) != count and word != "ATAN":
            raise ValueError(f"{word} takes {count} numbers, {len(values)} are given")
        try:
            return float(rule(*values))
        except ValueError:
            raise ValueError(f"{word} of {', '.join(f'{value:g}' for value in values)} has no value") from None

    def _list(self, closing: str) -> list[float]:
        """Return the values of comma-separated expressions up to a closing bracket."""
        values = [need(self.parse())]
        while self._accept(","):
            values.append(need(self.parse()))
        self._expect(closing)
        return values

    def _take(self) -> str:
        found = self.grammar.token.match(self.text, self.place)
        self.place = found.end() if found else self.place
        return (found.group(3) or "") if found else ""

    def _accept(self, sign: str) -> bool:
        here = self.place
        if self._take() == sign:
            return True
        self.place = here
        return False

    def _expect(self, sign: str) -> None:
        if not self._accept(sign):
            raise ValueError(f"expected {sign!r} in {self.text.strip()[:40]!r}")
