"""The words of a line of G-code: letters with numbers, comments and vendor records aside."""

from __future__ import annotations

import re

#: A word: one letter and a number. Siemens writes X=12.5 and CR=5 (a radius).
WORD = re.compile(r"(?<![A-Z])([A-Z])\s*=?\s*([-+]?(?:\d+\.?\d*|\.\d+))")
COMMENT = re.compile(r"\([^()]*\)?")
TIP_CONTROL = re.compile(r"TRAORI\b|\bM128\b|\bG0*43\.[45]\b")
CONVERSATIONAL = re.compile(r"\d*\s*(BEGIN PGM\b|(L|CC|CR|CT|FN|TOOL CALL|CYCL DEF|BLK FORM)\s+[A-Z\d])")
CONTROL = re.compile(
    r"(IF|WHILE|GOTO\w*|FOR|REPEAT|UNTIL|LOOP|ENDIF|ENDFOR|ENDWHILE|CALL|EXTCALL|PROC|CASE)\b"
    r"|O<|O\d+\s+(SUB|CALL|IF|WHILE|REPEAT|DO)\b"
)


def strip_comments(line: str) -> str:
    """Return a line in capitals without comments: ( ... ), also when it is never closed, and what follows a ;."""
    line, _, _ = line.partition(";")
    if "(" in line:
        line = COMMENT.sub(" ", line)
    return line.upper().strip()


def split_words(line: str) -> tuple[list[tuple[str, float]], str]:
    """Split a line without comments into its words and what could not be read as words."""
    if "CR=" in line:
        line = line.replace("CR=", "R")
    found = WORD.findall(line)
    rest = WORD.sub("", line).strip()
    return [(letter, float(number)) for letter, number in found], rest
