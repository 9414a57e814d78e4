"""The blocks of Sinumerik programs: words with numbers, with expressions, with AC() and IC(), calls with arguments."""

from __future__ import annotations

import math
import re

from compplan.toolpath.readers.cnc.expressions import FUNCTIONS, Grammar, Lookup, evaluate, evaluate_at
from compplan.toolpath.readers.cnc.state import CncBlock
from compplan.toolpath.readers.lines import DECIMAL
from compplan.toolpath.readers.lines import cut_comment as cut_after

NUMBER = rf"{DECIMAL}(?:EX[-+]?\d+)?"
LETTER = re.compile(rf"([A-Z])\s*({NUMBER})(?![\d.]|\s*[=(\[])")
EXTENDED = re.compile(r"([A-Z])(\d{1,4})\s*=\s*")
NAMED = re.compile(r"([$A-Z_][$\w]*)\s*", re.ASCII)
PLACED = re.compile(r"(AC|IC|DC|ACP|ACN|CAC|CIC|CDC)\s*\(")
BLOCK_NUMBER = re.compile(r"\s*(?:/\d?\s*)?(?:[N:]\s*\d+\s*)?(?:/\d?\s*)?")
LABEL = re.compile(r"([A-Z_][A-Z0-9_]*)\s*:(?!=)\s*", re.ASCII)
#: A comment in brackets after words with numbers.
REMARK = re.compile(rf"(?:^|\s)[A-Z]\s*=?\s*{DECIMAL}\s*(\()", re.IGNORECASE)
QUOTED = re.compile(r'"[^"]*"')


GRAMMAR = Grammar(
    functions={
        **FUNCTIONS, "ATAN2": (2, lambda y, x: math.degrees(math.atan2(y, x))), "POT": (1, lambda x: x * x),
        "TRUNC": (1, lambda x: float(math.trunc(x))), "ROUND": (1, lambda x: math.floor(x + 0.5)),
        "ROUNDUP": (1, lambda x: float(math.ceil(x))), "MINVAL": (2, min), "MAXVAL": (2, max),
        "BOUND": (3, lambda low, high, x: min(max(x, low), high)),
    },
    operators={
        "OR": (1, lambda a, b: float(bool(a) or bool(b))), "XOR": (2, lambda a, b: float(bool(a) != bool(b))),
        "AND": (3, lambda a, b: float(bool(a) and bool(b))),
        "==": (4, lambda a, b: float(a == b)), "<>": (4, lambda a, b: float(a != b)),
        "<": (4, lambda a, b: float(a < b)), ">": (4, lambda a, b: float(a > b)),
        "<=": (4, lambda a, b: float(a <= b)), ">=": (4, lambda a, b: float(a >= b)),
        "+": (5, lambda a, b: a + b), "-": (5, lambda a, b: a - b), "*": (6, lambda a, b: a * b),
        "/": (6, lambda a, b: a / b), "DIV": (6, lambda a, b: float(math.trunc(a / b))), "MOD": (6, math.fmod),
    },
)  # fmt: skip


#: Value of a variable that is not known, where the move that it stands in is left out.
ELSEWHERE = 1e30
#: System variables that have one value while a program runs.
SYSTEM = {"$PI": math.pi, "TRUE": 1.0, "FALSE": 0.0, "$P_SEARCH": 0.0, "$P_ISTEST": 0.0, "$P_SIM": 0.0,
          "$P_SEARCH1": 0.0, "$P_SEARCH2": 0.0, "$P_DRYRUN": 0.0, "$P_PROGTEST": 0.0}  # fmt: skip


class SinumerikVariables:
    """Hold the variables of a program."""

    def __init__(self, unknown: dict[str, str]) -> None:
        self.unknown = unknown
        self.numbers: dict[tuple[str, tuple[float, ...]], float] = {}
        #: Names that the program declares.
        self.names: set[str] = set()

    def look_up(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a variable; ValueError if it has none that is known."""
        if name in SYSTEM:
            return SYSTEM[name]
        if name[0] == "R" and name[1:].isdigit():
            name, indices = "R", (float(name[1:]),)
        value = self.numbers.get((name, indices), 0.0 if name in self.names else None)
        if value is None:
            shown = f"{name}[{', '.join(f'{index:g}' for index in indices)}]" if indices else name
            why = self.unknown.get(name, "the program gives it none")
            raise ValueError(f"{shown} has no value that is known: {why}")
        return value

    def look_up_home(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a variable in a move that is left out; ELSEWHERE where it has none that is known."""
        try:
            return self.look_up(name, indices)
        except ValueError:
            return ELSEWHERE

    def evaluate(self, text: str) -> float:
        """Return the value of an expression."""
        return evaluate(text, GRAMMAR, self.look_up)


def split_block(text: str, lookup: Lookup, variables: set[str]) -> CncBlock:
    """Return the words of any block; ValueError if something in it is none of these words.

    The block is in capitals, without number, label and comment; `variables` are the names that the program declares.
    """
    words, place = CncBlock(), 0

    def look(name: str, indices: tuple[float, ...]) -> float | None:
        if name[0] == "R" and name[1:].isdigit():
            name, indices = "R", (float(name[1:]),)
        for variable, at, value in reversed(words.assigned):  # what stands before it in the block holds already
            if variable == name and at == indices and value is not None:
                return value
        return lookup(name, indices)

    while place < len(text):
        if text[place] in " \t,":
            if text[place] == ",":
                raise ValueError(f"cannot read {text[place:][:30]!r}")
            place += 1
        elif found := LETTER.match(text, place):
            place = found.end()
            _keep(words, found.group(1), float(found.group(2).replace("EX", "E")), "")
        elif found := EXTENDED.match(text, place):
            named = found.group(1) + found.group(2)
            if named in variables:
                value, place, _ = read_value(text, found.end(), look)
                words.assigned.append((named, (), value))
            else:
                place = _read_extended(words, found.group(1), int(found.group(2)), text, found.end(), look)
        elif found := NAMED.match(text, place):
            place = _read_named(words, found.group(1), text, found.end(), look, variables)
        else:
            raise ValueError(f"cannot read {text[place:][:40]!r}, expected words such as X12.5")
    return words


def _keep(words: CncBlock, address: str, number: float, how: str) -> None:
    if address == "G":
        words.codes.append(number)
    elif address == "M":
        words.machine.append(number)
    elif address in words.values:
        raise ValueError(f"word {address} stands twice in this block, expected once")
    else:
        words.values[address] = number
        (words.relative if how == "I" else words.absolute if how == "A" else set()).add(address)


def _read_extended(words: CncBlock, letter: str, index: int, text: str, place: int, lookup: Lookup) -> int:
    """Read R1=.., I1=.., A3=.., M1=.., S1=.., X1=.. ."""
    if letter == "T" and text.startswith('"', place):
        return _skip_text(text, place)
    value, place, how = read_value(text, place, lookup)
    if letter == "R":
        words.assigned.append(("R", (float(index),), value))
    elif letter in "MS":
        _keep(words, letter, value, "")
    else:
        _keep(words, f"{letter}{index}", value, how)
    return place


def _read_named(words: CncBlock, name: str, text: str, place: int, lookup: Lookup, variables: set[str]) -> int:
    """Read NAME, NAME=.., NAME[..]=.., NAME(..)."""
    indices: tuple[float, ...] = ()
    if text.startswith("(", place):
        inside, place = read_brackets(text, place)
        words.calls.append((name, inside))
        return place
    if text.startswith("[", place):
        close = text.find("]", place)
        if close < 0:
            raise ValueError(f"']' is missing in {text[:40]!r}")
        inner = text[place + 1 : close]
        if not re.fullmatch(r"\s*[A-Z]\w*\s*", inner) or inner.strip() in variables:
            indices = tuple(evaluate_at(part, 0, GRAMMAR, lookup)[0] for part in inner.split(","))
        place = close + 1
    equals = re.compile(r"\s*=\s*(?!=)").match(text, place)
    if not equals:
        if indices:
            raise ValueError(f"cannot read {name}[ in {text[:40]!r}")
        words.names.append(name)
        return place
    place = equals.end()
    if text.startswith('"', place):
        place = _skip_text(text, place)
        if name != "T":
            words.assigned.append((name, indices, None))
        return place
    if name == "R" or name in variables or name.startswith("$"):
        if name.startswith("$") and re.match(r"[A-Z_$]\w*\s*[(\[]", text[place:]):
            words.assigned.append((name, indices, None))
            return len(text)
        value, place, _ = read_value(text, place, lookup)
        words.assigned.append((name, indices, value))
        return place
    value, place, how = read_value(text, place, lookup)
    _keep(words, name, value, how)
    return place


def _skip_text(text: str, place: int) -> int:
    found = QUOTED.match(text, place)
    if not found:
        raise ValueError('a quote (") is opened and never closed')
    return found.end()


def read_value(text: str, place: int, lookup: Lookup) -> tuple[float, int, str]:
    """Return a value, where it ends, and whether it is absolute ("A"), relative ("I") or as the mode says ("")."""
    found = PLACED.match(text, place)
    if not found:
        value, place = evaluate_at(text, place, GRAMMAR, lookup)
        return value, place, ""
    if found.group(1) in ("CAC", "CIC", "CDC"):
        raise ValueError(f"coded positions ({found.group(1)}) are not read")
    value, place = evaluate_at(text, found.end(), GRAMMAR, lookup)
    closing = re.compile(r"\s*\)").match(text, place)
    if not closing:
        raise ValueError(f"')' is missing in {text[:40]!r}")
    return value, closing.end(), "I" if found.group(1) == "IC" else "A"


def read_brackets(text: str, place: int) -> tuple[list[str], int]:
    """Return the arguments in the brackets that open at a place, and where they end."""
    depth, quoted, start, parts = 0, False, place + 1, []
    for index in range(place, len(text)):
        letter = text[index]
        if letter == '"':
            quoted = not quoted
        elif quoted:
            continue
        elif letter in "([":
            depth += 1
        elif letter in ")]":
            depth -= 1
            if depth == 0:
                parts.append(text[start:index].strip())
                return ([] if parts == [""] else parts), index + 1
        elif letter == "," and depth == 1:
            parts.append(text[start:index].strip())
            start = index + 1
    raise ValueError(f"')' is missing in {text[:40]!r}")


def cut_comment(line: str) -> tuple[str, str]:
    """Return a line without its comment, and the comment: after ; or alone in brackets; a ; within quotes is none."""
    comment = ""
    if "(" in line:
        number = BLOCK_NUMBER.match(line)
        rest = line[number.end() :] if number else line
        if rest.startswith("("):
            close = rest.find(")")
            comment = rest[1 : close if close > 0 else len(rest)].strip()
            line = rest[close + 1 :] if close > 0 else ""
    line, told = cut_after(line)
    comment = told or comment
    body = line.strip()
    if "(" in body and (found := REMARK.search(body)):
        comment = body[found.end() :].rstrip(") ") or comment
        body = body[: found.start(1)].strip()
    return body, comment
