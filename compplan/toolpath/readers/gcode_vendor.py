"""Words of more than one letter in G-code: what may be read past, what changes the path, what may call a program."""

from __future__ import annotations

import re

#: Words that say nothing about the programmed path; the rest of their line is read.
HARMLESS = {
    "TRAORI", "TRAFOOF", "STOPRE", "SOFT", "SOFTA", "BRISK", "BRISKA", "DRIVE", "FFWON", "FFWOF", "COMPON",
    "COMPOF", "COMPCURV", "COMPCAD", "COMPSURF", "UPATH", "SPATH", "ORIWKS", "ORIMKS", "ORIAXES", "ORIVECT",
    "ORIPLANE", "ORIEULER", "ORIRPY", "ORIRPY2", "ORIVIRT1", "ORIVIRT2", "ORIC", "ORID", "ORISON", "ORISOF", "OSC",
    "OSD", "OST", "OSOF", "OSS", "OSSE", "CUT2D", "CUT2DF", "CUT3DC", "CUT3DF", "KONT", "KONTC", "KONTT", "NORM",
    "CFC", "CFIN", "CFTCP", "FNORM", "FLIN", "FCUB", "DIAMOF", "DIAM90", "WALIMON", "WALIMOF", "CDON", "CDOF",
    "CDOF2", "CPRECON", "CPRECOF", "RTLION", "RTLIOF", "SBLOF", "SBLON", "DISPLOF", "DISPLON", "SAVE", "FIFOCTRL",
    "STARTFIFO", "STOPFIFO", "FENDNORM", "FENDOFF", "EXTENDED", "GFRAME0", "CYCLE832", "CYCLE_HSC", "DYNNORM",
    "DYNPOS", "DYNROUGH", "DYNSEMIFIN", "DYNFINISH", "PRIO", "SPCON", "SPCOF", "TCARR", "TCOABS", "TCOFR", "STAY",
    "FMAX", "TCPM",
}
#: ... of words with a value.
VALUES = {"SPOS", "SPOSA", "LIMS", "ADIS", "ADISPOS", "OVR", "OVRA", "ACC", "CTOL", "OTOL", "DISC", "FL"}
#: Words whose whole line is text, or data that no move depends on.
TEXT = {"MSG", "WORKPIECE", "EXTERN", "DEF", "GROUP_BEGIN", "GROUP_END", "WRITE", "PROGRAM", "REM", "SETMS"}
#: Words that change geometry or frames.
GEOMETRY = re.compile(
    r"CIP|CT|[ABC]SPLINE|POLY|POLYPATH|INVCC?W|A?ROTS?|CROTS?|RPL|A?SCALE|A?MIRROR|CYCLE800|PLANE|TRANSMIT\w*|TRACYL\w*|"
    r"TRAANG|TRACON|TOFRAME\w?|TOROT\w?|PAROT|OFFN|RP|AP|AR|TURN|RNDM|ANG|POCKET\d*|SLOT\d*|HOLES\d*|LONGHOLE|"
    r"CYCLE\d+|MEAS|MEAW|MCALL|RPY|DIAMON|CTRANS|CROT|CSCALE|CMIRROR|ROTATION|MIRRORING"
)
IDENTIFIER = re.compile(r"(?<![A-Z0-9_])[A-Z]{2,}[A-Z0-9_]*")
COORDINATE = re.compile(r"(?<![A-Z0-9_])[XYZABCIJKUVW]\s*=?\s*[-+.\d]")
SIEMENS = re.compile(r"%_N_|\b(TRAORI|TRAFOOF|CYCLE\d{3}|WORKPIECE|STOPRE|SUPA|ORIWKS|ORIMKS|G500|ATRANS)\b")
SHIFT = re.compile(r"(A?TRANS)((?:\s*[XYZ]\s*=?\s*[-+]?(?:\d+\.?\d*|\.\d+))*)\s*$")
CALL = re.compile(r"(?:N\d+\s*)?(L\d{1,9}|[A-Z_]{2}\w{0,60})\s*(?:P\s*=?\s*(\d{1,9}))?\s*$")


def find_words(line: str) -> list[str]:
    """Return the words of more than one letter."""
    return IDENTIFIER.findall(line)


def find_geometry(line: str, raw: str) -> str:
    """Return the word of a line that changes geometry or frames, "" without any; resets to nothing do not count."""
    for word in find_words(line):
        if GEOMETRY.fullmatch(word) and word not in HARMLESS and not _resets(word, line, raw):
            return word
    return ""


def _resets(word: str, line: str, raw: str) -> bool:
    """Return whether a word that changes frames takes them back."""
    if word in ("ROT", "SCALE", "MIRROR"):
        return re.sub(r"^N\d+\s*", "", line) == word
    if word == "PLANE":
        return re.search(r"PLANE\s+RESET\b", line) is not None
    if word == "CYCLE800":
        inside = re.search(r"CYCLE800\s*\(([^)]*)\)", raw, re.IGNORECASE)
        fields = inside.group(1).split(",") if inside else ["?"]
        turns = [field.strip() for field in fields[4:13]]
        return fields == [""] or (len(fields) >= 13 and all(re.fullmatch(r"[-+]?0*\.?0*", field) for field in turns))
    return False


def drop_harmless(line: str) -> tuple[str, list[str], list[str]]:
    """Return a line without the words that may be read past, those words, and the words that are left."""
    known: list[str] = []
    for word in find_words(line):
        if word in HARMLESS or word in VALUES or (GEOMETRY.fullmatch(word) and word not in TEXT):
            known.append(word)
            line = re.sub(rf"(?<![A-Z0-9_]){word}(?![A-Z0-9_])(\s*(\[[^\]]*\])?\s*=\s*[-+.\dA-Z]+)?", " ", line)
    return line.strip(), known, find_words(line)
