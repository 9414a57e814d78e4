"""Blocks of G-code as words: letter and number, in the order in which they stand."""

from __future__ import annotations

import re

from tests.oracles.cam.expressions import evaluate
from tests.oracles.cam.moves import CannotTellError

_COMMENT = re.compile(r"\([^()]*\)|;.*")
_PLAIN = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_CORNER = re.compile(r",([RC])([-+]?(?:\d+\.?\d*|\.\d+))")
_EXPONENT = re.compile(r"\d\.?E[-+]?\d")
_NAMED = re.compile(r"[A-Z_]{2,}[A-Z_0-9]*(?:\s|=|$)")
_START = re.compile(r"\s*([A-Z])\s*([-+]?)\s*")
_NUMBER = re.compile(r"\d+\.?\d*|\.\d+")
_VARIABLE = re.compile(r"#\d+")
#: Words that open a line of macro language.
FLOW = ("IF", "WHILE", "DO", "END", "GOTO", "THEN")

Words = list[tuple[str, float]]


def strip_comments(text: str) -> str:
    """Return a line in capitals without comments, line number and the tape's percent sign."""
    if "(" in text or ";" in text:
        before = None
        while before != text:
            before, text = text, _COMMENT.sub(" ", text)
    if '"' in text:
        text = re.sub(r'T\s*=\s*"[^"]*"', " ", text)
    return text.replace("%", " ").strip().upper()


def cut_words(text: str, values: dict[str, float], line: int) -> Words:
    """Cut a block, comments stripped, into its words.

    Raises:
        CannotTellError: If something in it is no word.

    """
    if _EXPONENT.search(text):
        raise CannotTellError(f"a number or an E word in {text[:20]!r}", line)
    text = text.replace(" ", "").replace("\t", "")
    corners = [(f",{letter}", float(number)) for letter, number in _CORNER.findall(text)] if "," in text else []
    if corners:
        return [*cut_words(_CORNER.sub("", text), values, line), *corners]
    words = [(letter, float(number)) for letter, number in _PLAIN.findall(text)]
    if sum(map(len, (part for pair in _PLAIN.findall(text) for part in pair))) == len(text):
        return words
    return _cut_slowly(text, values, line)


def _cut_slowly(text: str, values: dict[str, float], line: int) -> Words:
    words: Words = []
    at = 0
    while at < len(text):
        head = _START.match(text, at)
        if head is None:
            raise CannotTellError(f"{text[at : at + 20]!r}", line)
        at = head.end()
        sign = -1.0 if head[2] == "-" else 1.0
        if text[at : at + 1] == "[":
            depth, end = 1, at + 1
            while end < len(text) and depth:
                depth += {"[": 1, "]": -1}.get(text[end], 0)
                end += 1
            value = evaluate(text[at:end], values)
        else:
            match = _NUMBER.match(text, at) or _VARIABLE.match(text, at)
            if match is None and text.startswith("G28"):  # a printer's flags
                words.append((head[1], 0.0))
                continue
            if match is None:
                raise CannotTellError(f"{text[head.start() : head.start() + 20]!r}", line)
            value, end = evaluate(match[0], values), match.end()
        words.append((head[1], sign * value))
        at = end
    return words


def is_named(text: str) -> bool:
    """Tell whether a line is a named command of a printer's firmware, no block."""
    return bool(_NAMED.match(text)) and not text.startswith(FLOW)
