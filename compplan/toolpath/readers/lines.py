"""Text and lines of a CAM file, with limits on memory and time."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.errors import InputError
from compplan.io.tables import read_text

#: Number without an exponent, in every CAM language except Klartext.
DECIMAL = r"[-+]?(?:\d+\.?\d*|\.\d+)"
#: Greatest size of a CAM file. [bytes]
MOST_BYTES = 128 * 2**20
#: Greatest number of lines in a CAM file.
MOST_LINES = 3_000_000
#: Greatest length of a line; G-code blocks end at 256 characters on most controllers.
LONGEST_LINE = 10_000


def read_bounded(path: Path) -> str:
    """Return the text of a CAM file; raise an InputError if it is not readable, not text, or exceeds the limits."""
    if path.is_file() and path.stat().st_size > MOST_BYTES:
        size = path.stat().st_size / 2**20
        raise InputError(f"holds {size:.0f} MB, CAM files of at most {MOST_BYTES >> 20} MB are read", file=path)
    text = read_text(path)
    zero = text.find("\0")
    if zero >= 0:
        raise InputError("is a binary file, expected text", file=path, where=text.count("\n", 0, zero) + 1)
    count = count_lines(text)
    if count > MOST_LINES:
        raise InputError(f"has {count} lines, at most {MOST_LINES} are read", file=path)
    for number, line in enumerate(split_lines(text), start=1):
        if len(line) > LONGEST_LINE:
            message = f"line of {len(line)} characters, at most {LONGEST_LINE} are read"
            raise InputError(message, file=path, where=number)
    return text


def count_lines(text: str) -> int:
    """Return the number of lines."""
    ends = text.count("\n") + text.count("\r") - text.count("\r\n")
    return ends + (not text.endswith(("\n", "\r")) and bool(text))


def split_lines(text: str) -> list[str]:
    """Split a text into lines that end with CR, LF or CR LF only (not with form feed, U+0085 or U+2028)."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    if not lines[-1]:
        lines.pop()
    return lines


def match_form(pattern: re.Pattern[str] | str, text: str, what: str) -> re.Match[str]:
    """Match a complete text with a pattern; raise an InputError otherwise. `what` is "kind: expected form"."""
    found = re.fullmatch(pattern, text)
    if found is None:
        kind, _, expected = what.partition(": ")
        raise InputError(f"{kind} {text.strip()[:40]!r} is not read{expected and ', expected '}{expected}")
    return found


def cut_comment(line: str) -> tuple[str, str]:
    """Return a line without the comment after a ;, and the comment; a ; within quotes does not begin a comment."""
    place = line.find(";")
    while place >= 0 and line.count('"', 0, place) % 2:
        place = line.find(";", place + 1)
    return (line, "") if place < 0 else (line[:place].rstrip(), line[place + 1 :].strip())
