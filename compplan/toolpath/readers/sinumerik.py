"""Sinumerik 840D programs (.mpf, .spf, .arc): read by `cnc.sinumerik`."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.toolpath.readers.cnc.sinumerik import Sinumerik
from compplan.toolpath.readers.gcode import BEGINNING
from compplan.toolpath.readers.lines import count_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable

name = "sinumerik"
suffixes = (".mpf", ".spf", ".arc")

#: What no other language has, and what G-code of others may hold as well.
SURE = re.compile(
    r"^[ \t]*%_N_\w+_(MPF|SPF)|^;\$PATH=|\bCYCLE8[0-9]{1,2}\s*\(|\bGOTO[FB][ \t]+\w|\bSUPA\b|\bTRAFOOF\b|"
    r"^[ \t]*(N\d+[ \t]*)?(TRAORI|STOPRE|A?TRANS|A?ROT|A?MIRROR|A?SCALE|CYCLE832|MCALL)\b(?![ \t]*/)|"
    r"^[ \t]*(N\d+[ \t]*)?DEF[ \t]+(REAL|INT|BOOL)\b|"
    r"\bWORKPIECE\s*\(|[XYZIJK]\s*=\s*(AC|IC)\s*\(|^[ \t]*(N\d+[ \t]*)?MSG[ \t]*\(|\bORI(WKS|MKS|AXES|VECT)\b|"
    r"\b(CR|SPOS|TURN|AR|RND|CHR|CHF|T\d*=\")=|^[ \t]*(N\d+[ \t]*)?R\d+\s*=|[ABC]3=|\b[MS]\d{1,2}=|"
    r"(?<![.\w])(A?TRANS|A?ROTS?|A?SCALE|A?MIRROR|TRAORI|COMP(ON|OF|CAD|CURV)|FFWO[NF]|SOFTA?|BRISKA?|[US]PATH|CFTCP|MCALL|[ABC]SPLINE|"
    r"POLY|TRANSMIT|TRACYL|TRAANG|TOFRAME|TOROT|DIAMON|OFFN|CIP|INVCC?W)\b(?![ \t]*/)|"
    r"\b(CYCLE|POCKET|SLOT|HOLES|LONGHOLE)\d*[ \t]*\(|^[ \t]*(N\d+[ \t]*)?L\d+[ \t]*(P[ \t]*\d+[ \t]*)?$",
    re.MULTILINE | re.IGNORECASE,
)
#: A comment of other dialects in brackets: what a cutter is called there (CR=0) is no word of the program.
BRACKETED = re.compile(r"(?<![\w=])\((?!\")[^()\n]*\)")
#: The number of a Fanuc program, which no Sinumerik program has.
PROGRAM_NUMBER = re.compile(r"^[ \t]*O\d{1,8}\b", re.MULTILINE)


def recognise(text: str) -> int:
    """Tell whether a text is of a Sinumerik control: 1 for G-code of no mark, which the ending decides."""
    sure = SURE.search(BRACKETED.sub("", text)) is not None and PROGRAM_NUMBER.search(text) is None
    return 2 if sure else int(BEGINNING.search(text) is not None)


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a Sinumerik program: the first main program of the file, with subprograms of the file or beside it.

    The path stands in the work offset that is in force at the first move.
    """
    reader = Sinumerik(file, options)
    reader.run(text)
    return reader.it.finish(name, ", ".join(reader.it.state.units) or "not stated", count_lines(text))
