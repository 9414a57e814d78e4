"""Heidenhain conversational programs (Klartext, .h) of TNC 4xx, iTNC 530, TNC 6xx: read by `cnc.heidenhain`."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.heidenhain import Klartext
from compplan.toolpath.readers.cnc.heidenhain_lexer import ISO
from compplan.toolpath.readers.lines import count_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable

name = "heidenhain"
suffixes = (".h", ".i", ".hnc")

HEAD = re.compile(r"^[ \t]*\d*[ \t]*BEGIN[ \t]+PGM\b", re.MULTILINE | re.IGNORECASE)
KLARTEXT = re.compile(
    r"^[ \t]*\d+[ \t]+(TOOL[ \t]+CALL|CYCL[ \t]+DEF|BLK[ \t]+FORM|CALL[ \t]+LBL|LBL[ \t]+\d|L[ \t]+[XYZI][-+\d])",
    re.MULTILINE | re.IGNORECASE,
)


def recognise(text: str) -> int:
    """Tell whether a text is Klartext, or DIN/ISO of the same controls (which is refused)."""
    return 3 if HEAD.search(text) else 2 if KLARTEXT.search(text) or ISO.search(text) else 0


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a conversational program: its first one, with its own subprograms.

    The path stands in the datum that is in force at the beginning (cycle 247), the tool axis follows from tilted planes
    and vectors.
    """
    if not HEAD.search(text) and (found := ISO.search(text)):
        message = "a DIN/ISO program of a Heidenhain control is not read; write it in Klartext"
        raise InputError(message, file=file, where=text.count("\n", 0, found.start()) + 1)
    reader = Klartext(file, options)
    reader.run(text)
    unit = "not stated" if not reader.begun else "inch" if reader.inch else "mm"
    return reader.it.finish(name, unit, count_lines(text))
