"""The records of an APT file and their fields: numbers are numbers whole, or they are refused."""

from __future__ import annotations

import re
from collections.abc import Iterator

from compplan.toolpath.readers.lines import LONGEST_LINE, split_lines

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][-+]?\d+)?")
WORD = re.compile(r"[A-Z][A-Z0-9._+\-/ ]*")
#: Words that begin with digits: 1STPECK, 3DCUT, 5AXIS; a number with a letter O for a zero, or an exponent, is none.
ORDINAL = re.compile(r"\d{1,2}(?!O+\b)[A-Z]{3,}[A-Z0-9_\-]*")


def split_records(text: str) -> Iterator[tuple[int, str]]:
    """Yield each record with the line that it begins in; $ continues it, $$ begins a comment: whole lines are yielded.

    Raises:
        ValueError: If a record is longer than any line may be.

    """
    pending, first = "", 0
    for number, raw in enumerate(split_lines(text), start=1):
        if not pending and raw.lstrip().startswith("$$"):
            yield number, raw.strip()
            continue
        line = raw.partition("$$")[0].rstrip()
        first = first if pending else number
        if line.endswith("$"):
            pending += line[:-1]
            if len(pending) > LONGEST_LINE:
                raise ValueError(f"record of more than {LONGEST_LINE} characters in line {first}; no more are read")
            continue
        record = (pending + line).strip()
        pending = ""
        if record:
            yield first, record
    if pending.strip():
        yield first, pending.strip()


def split_fields(minor: str) -> list[float | str]:
    """Return the fields of a record, numbers as such.

    Raises:
        ValueError: If a field is neither a number nor a word: 1O, 1.2.3, nothing between two commas.

    """
    texts = minor.upper().split(",") if "," in minor else minor.upper().split()
    texts = [text.strip() for text in texts]
    if len(texts) > 3 and not texts[-1]:
        texts.pop()
    fields: list[float | str] = []
    for text in texts:
        if NUMBER.fullmatch(text):
            fields.append(float(text.replace("D", "E")))
        elif WORD.fullmatch(text) or ORDINAL.fullmatch(text):
            fields.append(text)
        else:
            raise ValueError(f"field {text[:20]!r} is neither a number nor a word")
    return fields


def read_numbers(minor: str) -> list[float]:
    """Return the fields of a record that holds numbers alone.

    Raises:
        ValueError: If a field is no number.

    """
    fields = split_fields(minor) if minor else []
    for field in fields:
        if isinstance(field, str):
            raise ValueError(f"field {field[:20]!r} is no number")
    return [field for field in fields if not isinstance(field, str)]
