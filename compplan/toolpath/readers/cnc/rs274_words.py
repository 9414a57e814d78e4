"""Words of the lines of G-code: letters with numbers, comments, and words of more than one letter."""

from __future__ import annotations

import re

from compplan.toolpath.readers.lines import DECIMAL

NUMBER = rf"{DECIMAL}(?:E[-+]\d{{1,3}}(?![\d.]))?"
#: A word: one letter and a number. Siemens writes X=12.5 and CR=5 (a radius).
WORD = re.compile(rf"(?<![A-Z,])([A-Z])\s*=?\s*({NUMBER})", re.ASCII)
#: What makes a corner round or cuts it off: ,R2 and ,C2 (Fanuc), RND=2, CHR=2 and CHF=2 (Siemens).
CORNER = re.compile(rf"(?:,\s*([RC])\s*|\b(RND|CHR|CHF)\s*=\s*)({NUMBER})")
CORNER_WORDS = {"R": "RND", "RND": "RND", "C": "CHR", "CHR": "CHR", "CHF": "CHF"}
#: What makes brackets a list of arguments, not a comment: a word right before them.
CALLED = re.compile(r"(?<![A-Za-z0-9_])[A-Za-z_]{2,}\w*$")
#: Direction of the tool (Siemens A3=0 B3=0 C3=1), and codes of a numbered spindle (M1=3, S1=2000).
DIRECTION = re.compile(rf"(?<![A-Z0-9])([ABC])3\s*=\s*({NUMBER})")
SPINDLE_NUMBER = re.compile(r"(?<![A-Z0-9])([MS])\d{1,2}\s*=\s*(?=\d)")
UNSIGNED_EXPONENT = re.compile(r"[\d.]E\d")
TIP_CONTROL = re.compile(r"TRAORI\b|\bM128\b|\bG0*43\.[45]\b")
CONVERSATIONAL = re.compile(r"\d*\s*(BEGIN PGM\b|(L|CC|CR|CT|FN|TOOL CALL|CYCL DEF|BLK FORM)\s+[A-Z\d])")
CONTROL = re.compile(
    r"(IF|ELSE|ELSEIF|WHILE|GOTO\w*|FOR|BREAK|CONTINUE|RETURN|ENDLOOP|ENDREPEAT|REPEATB?|UNTIL|LOOP|ENDIF|ENDFOR|ENDWHILE|CALL|PCALL|MCALL|EXTCALL|PROC|CASE)\b"
    r"|O<|O\d+\s+(SUB|CALL|IF|WHILE|REPEAT|DO)\b"
)
#: A program's name alone on its line.
NAME_LINE = re.compile(r"O?<[^<>]*>|%.*|:.*")
SKIP_MARK = re.compile(r"((?:N\d+)?\s*)/\d?(?![\d.])\s*")
SKIP_WITHIN = re.compile(r"\s/\s*(?=[A-Z]|$)|/(?=[A-Z])")
BLOCK = re.compile(r"(N\d+\s*)?[GMTSFDHXYZABCIJKRUVW]\s*=?\s*[-+.#\[\d]|(N\d+\s*)?(#\d|R\d+\s*=)")


def strip_comments(line: str) -> tuple[str, list[str]]:
    """Return a line in capitals without comments and quoted text, and the comments.

    Comments: ( ... ), also when it is never closed, and what follows a ; outside of brackets.

    Raises:
        ValueError: If a quote is never closed, or brackets within a comment do not match.

    """
    if "(" not in line and ";" not in line and '"' not in line:
        return line.upper().strip(), []
    kept: list[str] = []
    comments: list[str] = []
    arguments: set[int] = set()
    depth, deepest, quoted = 0, 0, False
    for place, letter in enumerate(line):
        if quoted:
            quoted = letter != '"'
        elif depth:
            depth += (letter == "(") - (letter == ")")
            deepest = max(deepest, depth)
            comments[-1] += letter if depth else ""
        elif letter == ";":
            comments.append(line[place + 1 :])
            break
        elif letter == "(":
            depth = deepest = 1
            comments.append("")
            arguments |= {len(comments) - 1} if CALLED.search(line, max(0, place - 64), place) else set()
            kept.append(" ")
        else:
            quoted = letter == '"'
            kept.append(letter)
    if quoted:
        raise ValueError('a quote (") is opened and never closed')
    if depth and deepest > 1:
        raise ValueError("brackets within a comment are opened and never closed")
    return "".join(kept).upper().strip(), [
        text.strip() for number, text in enumerate(comments) if text.strip() and number not in arguments
    ]


def split_words(line: str) -> tuple[list[tuple[str, float]], str]:
    """Split a line without comments into its words and what could not be read as words."""
    words: list[tuple[str, float]] = []
    if "," in line or "=" in line:
        words = [(CORNER_WORDS[a or b], float(number)) for a, b, number in CORNER.findall(line)]
        line = re.sub(r"\bCR\s*=", "R", CORNER.sub(" ", line))
        words += [(letter + "3", float(number)) for letter, number in DIRECTION.findall(line)]
        line = SPINDLE_NUMBER.sub(r"\1", DIRECTION.sub(" ", line))
    found = WORD.findall(line)
    rest = WORD.sub("", line).strip()
    return [(letter, float(number)) for letter, number in found] + words, rest


def check_words(words: list[tuple[str, float]]) -> str:
    """Return what is wrong with the words of a block: coordinates given twice, two motions; else nothing."""
    if len({letter for letter, _ in words}) == len(words):
        return ""
    letters = [letter for letter, _ in words if letter in "XYZABCIJKR" or letter in CORNER_WORDS.values()]
    twice = next((letter for letter in letters if letters.count(letter) > 1), None)
    if twice:
        return f"word {twice} stands twice in this block, expected once"
    motions = sorted({number for letter, number in words if letter == "G" and number in (0.0, 1.0, 2.0, 3.0)})
    if len(motions) > 1:
        return f"G{motions[0]:g} and G{motions[1]:g} stand in one block, expected one motion"
    return ""


#: Words that say nothing about the programmed path; the rest of their line is read.
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
SHIFT = re.compile(rf"(A?TRANS)((?:\s*[XYZ]\s*=?\s*{DECIMAL})*)\s*$")
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


#: Codes of printers (Marlin, RepRap) that own the words of their block: they set the machine, and move nothing.
OWNERS = frozenset(float(code) for code in (
    16, 20, 22, 23, 24, 25, 26, 27, 28, 31, 32, 36, 42, 43, 73, 74, 84, 85, 92, *range(104, 126), 140, 141, 143, 144,
    145, 149, 150, *range(155, 196), *range(200, 300), *range(300, 310), 350, 351, 355, 360, 361, 362, 363, 364,
    *range(380, 382), *range(400, 430), 486, *range(500, 620), *range(665, 675), 701, 702, 710, 851, 852, 862, 865,
    871, 876, 900, *range(906, 920), 928, 951, 993, 994, 995, 997, 999, 1000, 1002, 1006,
))  # fmt: skip
#: ... those among them that take coordinates.
PLACING = frozenset(float(code) for code in (
    92, 122, 125, *range(200, 230), 301, 303, 304, 350, 351, 420, 425, 540, 558, 566, 569, 574, 579, 584, 593, 665, 666,
    669, 671, 672, 851, 852, 871, 900, *range(906, 920), 951, 1006,
))  # fmt: skip


def owns_words(code: float) -> bool:
    """Return whether the words of a block belong to an M code."""
    return code in OWNERS or (code > 16.0 and code != int(code))
