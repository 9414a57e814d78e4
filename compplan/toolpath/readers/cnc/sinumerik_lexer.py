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
NAMED = re.compile(r"([$A-Z_][$\w]*)\s*", re.ASCII)
PLACED = re.compile(r"(AC|IC|DC|ACP|ACN|CAC|CIC|CDC)\s*\(")
BLOCK_NUMBER = re.compile(r"\s*(?:/\d?\s*)?(?:[N:]\s*\d+\s*)?(?:/\d?\s*)?")
LEADING = re.compile(BLOCK_NUMBER.pattern + r"\(([^)]*)\)?(.*)")
LABEL = re.compile(r"([A-Z_][A-Z0-9_]*)\s*:(?!=)\s*", re.ASCII)
#: A comment in brackets after words with numbers.
REMARK = re.compile(rf"(?:^|\s)[A-Z]\s*=?\s*{DECIMAL}\s*(\()", re.IGNORECASE)
QUOTED = re.compile(r'"[^"]*"')
EQUALS = re.compile(r"\s*=\s*(?!=)")
NUMBERED = re.compile(r"([A-Z])(\d{1,4})")
CLOSING = re.compile(r"\s*\)")
#: Words of Siemens controls that say nothing about the programmed path.
HARMLESS = frozenset((
    "TRAORI", "TRAFOOF", "STOPRE", "SOFT", "SOFTA", "BRISK", "BRISKA", "DRIVE", "FFWON", "FFWOF", "COMPON", "COMPOF",
    "COMPCURV", "COMPCAD", "COMPSURF", "UPATH", "SPATH", "ORIWKS", "ORIMKS", "ORIAXES", "ORIVECT", "ORIPLANE",
    "ORIEULER", "ORIRPY", "ORIRPY2", "ORIVIRT1", "ORIVIRT2", "ORIC", "ORID", "ORISON", "ORISOF", "OSC", "OSD", "OST",
    "OSOF", "OSS", "OSSE", "CUT2D", "CUT2DF", "CUT3DC", "CUT3DF", "KONT", "KONTC", "KONTT", "NORM", "CFC", "CFIN",
    "CFTCP", "FNORM", "FLIN", "FCUB", "DIAMOF", "DIAM90", "WALIMON", "WALIMOF", "CDON", "CDOF", "CDOF2", "CPRECON",
    "CPRECOF", "RTLION", "RTLIOF", "SBLOF", "SBLON", "DISPLOF", "DISPLON", "SAVE", "FIFOCTRL", "STARTFIFO",
    "STOPFIFO", "FENDNORM", "FENDOFF", "EXTENDED", "GFRAME0", "CYCLE832", "CYCLE_HSC", "DYNNORM", "DYNPOS",
    "DYNROUGH", "DYNSEMIFIN", "DYNFINISH", "PRIO", "SPCON", "SPCOF", "TCARR", "TCOABS", "TCOFR", "STAY", "FMAX",
    "TCPM",
))  # fmt: skip
#: Words that change the path or its frame, or call a cycle at every place.
CHANGING = (
    r"A?TRANS|A?ROTS?|A?SCALE|A?MIRROR|MCALL|[ABC]SPLINE|POLY|TRANSMIT|TRACYL|TRAANG|TOFRAME|TOROT|DIAMON|OFFN|CIP|"
    r"INVCC?W"
)
Key = tuple[str, tuple[float, ...]]

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


def find_key(name: str, indices: tuple[float, ...] = ()) -> Key:
    """Return what a variable is kept by: R5 is R[5]."""
    return ("R", (float(name[1:]),)) if name[0] == "R" and name[1:].isdigit() else (name, indices)


class SinumerikVariables:
    """Hold the variables of a program."""

    def __init__(self, unknown: dict[str, str]) -> None:
        self.unknown = unknown
        self.numbers: dict[Key, float] = {}
        #: Names that the program declares.
        self.names: set[str] = set()

    def look_up(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a variable; ValueError if it has none that is known."""
        if name in SYSTEM:
            return SYSTEM[name]
        name, indices = find_key(name, indices)
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
    splitter = _Splitter(text, lookup, variables)
    while splitter.place < len(text):
        splitter.read_word()
    return splitter.words


class _Splitter:
    """Split a block into its words, from a place on."""

    def __init__(self, text: str, lookup: Lookup, variables: set[str]) -> None:
        self.text, self.lookup, self.variables = text, lookup, variables
        self.words, self.place = CncBlock(), 0

    def _look_up(self, name: str, indices: tuple[float, ...]) -> float | None:
        key = find_key(name, indices)
        for variable, at, value in reversed(self.words.assigned):  # what stands before it in the block holds already
            if (variable, at) == key and value is not None:
                return value
        return self.lookup(*key)

    def read_word(self) -> None:
        """Read a word, or pass over a blank."""
        text, place = self.text, self.place
        if text[place] in " \t":
            self.place += 1
        elif found := LETTER.match(text, place):
            self.place = found.end()
            self._keep(found.group(1), float(found.group(2).replace("EX", "E")))
        elif found := NAMED.match(text, place):
            self.place = found.end()
            self._read_named(found.group(1))
        else:
            raise ValueError(f"cannot read {text[place:][:40]!r}, expected words such as X12.5")

    def _keep(self, address: str, number: float, how: str = "") -> None:
        words = self.words
        if address == "G":
            words.codes.append(number)
        elif address == "M":
            words.machine.append(number)
        elif address in words.values:
            raise ValueError(f"word {address} stands twice in this block, expected once")
        else:
            words.values[address] = number
            (words.relative if how == "I" else words.absolute if how == "A" else set()).add(address)

    def _read_named(self, name: str) -> None:
        """Read NAME, NAME=.., NAME[..]=.., NAME(..), R1=.., I1=.., A3=.., M1=.., S1=.."""
        text, words = self.text, self.words
        indices: tuple[float, ...] = ()
        if text.startswith("(", self.place):
            inside, self.place = read_brackets(text, self.place)
            words.calls.append((name, inside))
            return
        if text.startswith("[", self.place):
            close = text.find("]", self.place)
            if close < 0:
                raise ValueError(f"']' is missing in {text[:40]!r}")
            inner, self.place = text[self.place + 1 : close], close + 1
            if not re.fullmatch(r"\s*[A-Z]\w*\s*", inner) or inner.strip() in self.variables:
                indices = tuple(evaluate_at(part, 0, GRAMMAR, self._look_up)[0] for part in inner.split(","))
        equals, numbered = EQUALS.match(text, self.place), NUMBERED.fullmatch(name)
        if not equals:
            if indices:
                raise ValueError(f"cannot read {name}[ in {text[:40]!r}")
            words.names.append(name)
            return
        self.place = equals.end()
        letter = numbered.group(1) if numbered else name
        if text.startswith('"', self.place):
            found = QUOTED.match(text, self.place)
            if not found:
                raise ValueError('a quote (") is opened and never closed')
            self.place = found.end()
            if letter != "T":
                words.assigned.append((name, indices, None))
        elif name.startswith("$") and re.match(r"[A-Z_$]\w*\s*[(\[]", text[self.place :]):
            words.assigned.append((name, indices, None))
            self.place = len(text)
        elif letter == "R" or name in self.variables or name.startswith("$"):
            key = (name, indices) if name in self.variables else find_key(name, indices)
            words.assigned.append((*key, self._value()[0]))
        elif numbered and letter in "MS":
            self._keep(letter, self._value()[0])
        else:
            self._keep(f"{letter}{int(numbered.group(2))}" if numbered else name, *self._value())

    def _value(self) -> tuple[float, str]:
        """Return a value, and whether it is absolute ("A"), relative ("I") or as the mode says ("")."""
        found = PLACED.match(self.text, self.place)
        if found and found.group(1) in ("CAC", "CIC", "CDC"):
            raise ValueError(f"coded positions ({found.group(1)}) are not read")
        value, self.place = evaluate_at(self.text, found.end() if found else self.place, GRAMMAR, self._look_up)
        if not found:
            return value, ""
        closing = CLOSING.match(self.text, self.place)
        if not closing:
            raise ValueError(f"')' is missing in {self.text[:40]!r}")
        self.place = closing.end()
        return value, "I" if found.group(1) == "IC" else "A"


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
    """Return a line without its comment, and the comment: after ; or in brackets, first or after words with numbers."""
    comment = ""
    if "(" in line and (leading := LEADING.match(line)):
        comment, line = leading.groups()
    body, told = cut_after(line)
    if "(" in body and (found := REMARK.search(body)):
        told, body = body[found.end() :].rstrip(") ") or told, body[: found.start(1)]
    return body.strip(), (told or comment).strip()
