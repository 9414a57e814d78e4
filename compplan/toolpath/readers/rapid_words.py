"""The statements of ABB RAPID modules, and their fields."""

from __future__ import annotations

import re
from collections.abc import Iterator

from compplan.toolpath.readers.lines import LONGEST_LINE, split_lines

#: Lines that end without a semicolon.
BARE = re.compile(
    r"(MODULE|ENDMODULE|(LOCAL\s+)?(PROC|FUNC|TRAP|RECORD)|END(PROC|FUNC|TRAP|RECORD|IF|FOR|WHILE|TEST)|ELSE(IF)?|IF|FOR|"
    r"WHILE|TEST|CASE|DEFAULT|ERROR|UNDO|BACKWARD)\b"
)


def split_statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield statements in capitals, text in quotes left out, with the line that each begins in.

    Raises:
        ValueError: If a quote is never closed, or a statement is longer than any may be.

    """
    pending, first = "", 0
    for number, raw in enumerate(split_lines(text), start=1):
        line = re.sub(r'"[^"]*"', '""', raw) if '"' in raw else raw
        if not pending.strip() and raw.lstrip().startswith("!"):
            yield number, raw.strip()
            continue
        line = line.partition("!")[0].upper()
        if line.replace('""', "").count('"'):
            raise ValueError(f'line {number}: a quote (") is opened and never closed')
        if not pending.strip():
            first = number
            if re.match(r"\s*(%%%|VERSION:|LANGUAGE:)", line):
                continue
        if not pending.strip() and BARE.match(line.strip()) and ";" not in line:
            yield number, " ".join(line.split())
            continue
        *whole, rest = (pending + " " + line).split(";")
        for statement in whole:
            if statement.strip():
                yield first, " ".join(statement.split())
            first = number
        pending = rest
        if len(pending) > LONGEST_LINE:
            raise ValueError(f"statement of more than {LONGEST_LINE} characters in line {first}; no more are read")
    if pending.strip():
        yield first, " ".join(pending.split())
