"""The blocks of Heidenhain programs, numbers, comments and continued lines aside; the words of a block."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from compplan.toolpath.readers.cnc.expressions import FUNCTIONS, Grammar
from compplan.toolpath.readers.lines import DECIMAL, LONGEST_LINE, cut_comment, split_lines

NUMBER = r"(?:\d+(?:[.,]\d*)?|[.,]\d+)"
#: A value of a word: a number or a Q parameter, with or without a sign.
VALUE = rf"[-+]?\s*(?:{NUMBER}|Q[LRS]?\d+)"
#: The block of an ordinary cut: L X+1.5 Y-2 Z+.3 F1000.
PLAIN = re.compile(rf"L(?: ?X({DECIMAL}))?(?: ?Y({DECIMAL}))?(?: ?Z({DECIMAL}))?(?: ?F({DECIMAL}))?(?: M90)?")
#: Words of a motion block. Bare signs belong to DR and to R of paraxial blocks.
WORD = re.compile(
    rf"(IP[AR]|P[AR]|I?[XYZABCUVW](?!C)|N[XYZ](?=\s*[-+\d.,Q])|T[XYZ](?=\s*[-+\d.,Q])|CCA|LEN|DR|"
    rf"R[0LR](?![\d.,])|R|F\s*(?:MAX|AUTO)|F[UZT]?|S(?=\s*[\d.,Q])|M\s*(?=\d|Q))"
    rf"\s*({VALUE}|[-+](?!\s*[\d.,Q]))?"
)
BLOCK_NUMBER = re.compile(r"\s*(\d+)\s*(?=\D|$)")
FUNCTION_NUMBER = re.compile(r"FN\s*(\d+)\s*:\s*(.*)")
ASSIGN = re.compile(r"(Q[LRS]?\d+)\s*=\s*(.+)")
JUMP = re.compile(r"IF\s+(.+?)\s+(EQU|NE|GT|LT)\s+(.+?)\s+GOTO\s+LBL\s*(\".*\"|\d+|QS?\d+)\s*$")
CALL = re.compile(r"CALL\s+LBL\s*(\"[^\"]*\"|\d+|QS?\d+)\s*(?:REP\s*(\d+|Q[LR]?\d+)(?:\s*/\s*\d+)?)?\s*$")
LABEL = re.compile(r"LBL\s*(\"[^\"]*\"|\d+)\s*$")
CYCLE = re.compile(r"CYCL\s+DEF\s*(\d+)(?:\s*\.(\d+))?\s*(.*)")
ISO = re.compile(r"^\s*%\S*\s+G7[01]\b", re.MULTILINE)
#: M functions that have words of their own; only some of them a feed.
M_WORDS = re.compile(
    r"M\s*(?:(10[134]|112|118|120|124|128|14[0258])(?!\d))"
    r"((?:\s*(?:MB\s*(?:MAX|[-+]?[\d.,]+)|LA\s*[\d.]+|LIMIT|T\s*[\d.]+|E\s*[\d.]+|(?<=\d\s)[XYZ][\d.]+|"
    r"(?:(?<=M103 )|(?<=M128 )|(?<=M140 )|(?<=MAX )|(?<=M103)|(?<=M128))F\s*(?:MAX|[\d.]+)))*)"
)


GRAMMAR = Grammar(
    functions={
        **FUNCTIONS, "ATAN": (1, lambda x: math.degrees(math.atan(x))), "SQ": (1, lambda x: x * x),
        "LOG": (1, math.log10), "NEG": (1, lambda x: -x), "INT": (1, lambda x: float(math.trunc(x))),
        "FRAC": (1, lambda x: x - math.trunc(x)), "SGN": (1, lambda x: float((x > 0.0) - (x < 0.0))),
        "PI": (0, lambda: math.pi),
    },
    operators={
        "+": (1, lambda a, b: a + b), "-": (1, lambda a, b: a - b), "*": (2, lambda a, b: a * b),
        "/": (2, lambda a, b: a / b), "DIV": (2, lambda a, b: a / b), "^": (3, lambda a, b: a**b),
        "LEN": (1, math.hypot), "ANG": (1, lambda y, x: math.degrees(math.atan2(y, x)) % 360.0),
    },
    bare=True,
)  # fmt: skip


@dataclass(frozen=True)
class HeidenhainBlock:
    """Hold a block: its line, its text in capitals without number and comment (/: may be skipped), its comment."""

    line: int
    text: str
    comment: str


def split_blocks(text: str) -> Iterator[HeidenhainBlock]:
    """Yield the blocks of a program; a ~ at the end of a line goes on in the next, as do lines of a cycle's values."""
    pending, notes, first, goes_on = "", "", 0, False
    for line, raw in enumerate(split_lines(text), start=1):
        body = raw.strip()
        more = body.endswith("~")
        if more:
            body = body[:-1].rstrip()
        body, comment = cut_comment(body)
        if not goes_on:
            mark = "/" if body[:1] == "/" else ""
            body = body[1:].lstrip() if mark else body
            found = BLOCK_NUMBER.match(body) if body[:1].isdigit() else None
            pending, notes, first = mark + (body[found.end() :] if found else body), comment, line
        else:
            pending, notes = f"{pending} {body}", f"{notes} {comment}"
            if len(pending) > LONGEST_LINE:
                raise ValueError(f"block of more than {LONGEST_LINE} characters in line {first}; no more are read")
        goes_on = more
        if not more:
            yield HeidenhainBlock(first, _tidy(pending), notes.strip())
    if goes_on:
        yield HeidenhainBlock(first, _tidy(pending), notes.strip())


def _tidy(text: str) -> str:
    """Return a block in capitals with single spaces."""
    tidy = (" ".join(text.split()) if "  " in text or "\t" in text else text.strip()).upper()
    return f"CYCL{tidy[5:]}" if tidy.startswith("CYCLE ") else tidy


def split_words(text: str) -> tuple[list[tuple[str, str]], str]:
    """Return the words of a motion block with their values, and what could not be read."""
    words = [(word.replace(" ", ""), value.replace(" ", "")) for word, value in WORD.findall(text)]
    return words, WORD.sub("", text).strip()
