"""Lexer of the RS-274 family: the lines of a file become the words of blocks; comments and marks are dealt with."""

from __future__ import annotations

import re

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import FARTHEST_WITHOUT_POINT
from compplan.toolpath.readers.cnc.origins import Origins
from compplan.toolpath.readers.cnc.rs274_flow import MacroFlow
from compplan.toolpath.readers.cnc.state import AXES, CncBlock
from compplan.toolpath.readers.lines import DECIMAL

Words = list[tuple[str, float]]
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
#: A line that an M code owns, its text included.
OWNER_LINE = re.compile(r"(?:N\d+\s*)?M0*(\d+(?:\.\d+)?)(?=[\sA-Z]|$)(?!.*\bG\d)")
#: Home of a printer: bare letters name axes (G28 X Y) or ways to do it (G28 W); all axes are elsewhere after it.
BARE_HOME = re.compile(r"(?:N\d+\s*)?G28(?:\s+[A-Z]\d?)+\s*")
#: Macro variables and control of the flow (Fanuc).
MACRO = re.compile(
    r"#\s*[\d#<\[]|(?<![A-Z_])[A-Z,]\s*[-+]?\s*\[|"
    r"^(?:N\s*\d+\s*)?(?:IF\s*\[|WHILE\s*\[|GOTO\s*\d|DO\s*[1-9]\s*$|END\s*[1-9]\s*$)"
)
#: O words of LinuxCNC: o1 while, o<name> call.
O_WORD = re.compile(r"(?:N\s*\d+\s*)?O\s*(?:<[^<>]*>|\d+|\[[^\[\]]*\])\s*[A-Z]{2}")
#: Lengths that have no decimal point, and the least ones that no part of a robot has. [mm]
LENGTHS = frozenset("XYZIJKRUVW")
WITHOUT_POINT = re.compile(r"(?<![A-Z,])([XYZIJKRUVW])\s*=?\s*([-+]?\d+)(?![\d.E])")
TOOL_NAME = re.compile(r"\bT\d*\s*=\s*\"([^\"]*)\"", re.IGNORECASE)
MOTION = re.compile(r"(?<![A-Z0-9])G0*[0-3](?![\d.])")


def strip_comments(line: str) -> tuple[str, list[str]]:
    """Return a line in capitals without comments and quoted text, and the comments.

    Comments: ( ... ), also when it is never closed, and what follows a ; outside of brackets.
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


def find_geometry(line: str, raw: str) -> str:
    """Return the word of a line that changes geometry or frames, "" without any; resets to nothing do not count."""
    for word in IDENTIFIER.findall(line):
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
    for word in IDENTIFIER.findall(line):
        if word in HARMLESS or word in VALUES or (GEOMETRY.fullmatch(word) and word not in TEXT):
            known.append(word)
            line = re.sub(rf"(?<![A-Z0-9_]){word}(?![A-Z0-9_])(\s*(\[[^\]]*\])?\s*=\s*[-+.\dA-Z]+)?", " ", line)
    return line.strip(), known, IDENTIFIER.findall(line)


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


class Lexer:
    """Turn the lines of a G-code file into the words of blocks.

    Lines that are no block are dealt with here: comments, marks, assignments, jumps, calls, vendor words.
    """

    def __init__(self, it: Interpreter, macros: MacroFlow, origins: Origins) -> None:
        self.it, self.macros, self.origins = it, macros, origins
        self.state, self.log, self.note = it.state, it.log, it.note
        #: Whether a block was read.
        self.begun = False

    def read(self, raw: str) -> CncBlock | None:
        """Return the block in a line, None where it holds none."""
        line, comments = strip_comments(raw)
        for comment in comments:
            self.log.happen("comment", self.it.flow.line, text=comment)
        if not line:
            return None
        if len(line) > 200:
            line = " ".join(line.split())
        if line[0] in "%<:O" and NAME_LINE.fullmatch(line):
            self.state.siemens = self.state.siemens or line.startswith("%_N_")
            ends = line[0] == "%" and (self.it.course.begun or (self.begun and line.startswith("%_N_")))
            return CncBlock(machine=[17.0]) if ends else None
        if "/" in line:
            line = self._drop_marks(line)
        if line[:1] in ("O", "N") and O_WORD.match(line):
            raise InputError(f"program control {line[:40]!r} (O words) is not read; write the program out in the CAM "
                             "system")  # fmt: skip
        words, rest = split_words(line)
        if rest and (owner := OWNER_LINE.match(line)) and owns_words(float(owner.group(1))):
            self.note(f"M{owner.group(1)} is not read")
            self.log.happen("comment", self.it.flow.line, text=f"M{owner.group(1)} of the CAM file")
            return None
        if rest and BARE_HOME.fullmatch(line):
            words, rest = [("G", 28.0)], ""
        if rest and not self.state.siemens and MACRO.search(line):
            spelled = self.macros.run_macro(line)
            if spelled is None:
                return None
            line = spelled
            words, rest = split_words(line)
        if (rest or (words and words[0][0] in "LN")) and self._call(line):
            return None
        named = TOOL_NAME.search(raw) if '"' in raw else None
        if rest:
            explained = self._explain(re.sub(r"^N\d+\s*", "", line), raw)
            if explained is None:
                return None
            words = explained
        elif "E" in line and UNSIGNED_EXPONENT.search(line):
            raise InputError(f"number {line[:40]!r} may be read in two ways, write it without an exponent")
        if fault := check_words(words):
            raise InputError(fault)
        if named:
            self.state.tool_name = named.group(1)
        if number := self._find_without_point(words, line):
            raise InputError(f"{number} has no decimal point and may count in mm or in the control's least increment "
                             f"(0.001 mm); write it with a point ({number}. or {number[0]}{float(number[1:]) / 1e3:g})"
                             )  # fmt: skip
        self.begun = self.begun or any(letter not in "NO" for letter, _ in words)
        block = CncBlock()
        for letter, value in words:
            if letter == "G":
                block.codes.append(value)
            elif letter == "M":
                block.machine.append(value)
            else:
                block.values[letter] = value
        return block

    def _call(self, line: str) -> bool:
        """Carry out the subprogram that a line calls (L100 P3, or its name); return whether it calls one."""
        found = CALL.match(line)
        if not found:
            return False
        called, flow = found.group(1), self.it.flow
        known = called in HARMLESS or called in TEXT or GEOMETRY.fullmatch(called)
        here = called in flow.programs or (not known and flow.find_beside(called))
        if here or re.fullmatch(r"L\d+", called):
            self.it.call(called, int(found.group(2) or 1) if here else 1)
            return True
        return False

    def _find_without_point(self, words: Words, line: str) -> str:
        """Return a word of a length that is too great for a part unless it counts in increments, "" without any."""
        if all(letter not in LENGTHS or abs(number * self.state.scale) < FARTHEST_WITHOUT_POINT
               for letter, number in words):  # fmt: skip
            return ""
        found = [f"{word.group(1)}{word.group(2)}" for word in WITHOUT_POINT.finditer(line)]
        return next((word for word in found if abs(float(word[1:]) * self.state.scale) >= FARTHEST_WITHOUT_POINT), "")

    def _drop_marks(self, line: str) -> str:
        """Return a line without the marks of blocks that an operator may skip."""
        marked = SKIP_WITHIN.sub(" ", SKIP_MARK.sub(r"\1", line, count=1) if SKIP_MARK.match(line) else line)
        if marked != line:
            self.note("blocks marked with / are read")
        return marked.strip()

    def _explain(self, line: str, raw: str) -> Words | None:
        """Deal with a line that holds more than words; return the words to be read, None where there are none."""
        if CONVERSATIONAL.match(line):
            raise InputError(f"conversational block {line[:40]!r}; post-process the program to ISO G-code (G0 to G3)")
        if CONTROL.match(line):
            raise InputError(f"program control {line[:40]!r} is not read; write the program out in the CAM system")
        if line == "RET":
            return [("M", 17.0)]
        self.state.siemens = self.state.siemens or SIEMENS.search(line) is not None
        if found := SHIFT.match(line):  # TRANS in place of, ATRANS on top of what shifts the origin
            numbers, scale = dict(split_words(found.group(2))[0]), self.state.scale
            old = self.origins.shifted if found.group(1) == "ATRANS" else (0.0, 0.0, 0.0)
            self.origins.shift({axis: old[axis] / scale + numbers.get(AXES[axis], 0.0) for axis in range(3)})
            return None
        if line.startswith("MSG") and (told := re.search(r'MSG\s*\(\s*"([^"]*)"', raw, re.IGNORECASE)):
            self.log.happen("comment", self.it.flow.line, text=told.group(1))
            return None
        geometry = find_geometry(line, raw)
        if geometry:
            raise InputError(f"{geometry} is not read and changes the path or its frame; post-process without it")
        if TIP_CONTROL.search(line):
            self.state.tip_control = True
        if re.search(r"\bSUPA\b", line):
            words = self._read_past(re.sub(r"\bSUPA\b", " ", line).strip())
            return [*(words or []), ("G", 153.0)]
        if not self.begun and not BLOCK.match(line) and not IDENTIFIER.match(line):
            self.note(f"text before the first block is not read: {line[:20]!r}")
            return None
        return self._read_past(line)

    def _read_past(self, line: str) -> Words | None:
        """Read past the words of a line that say nothing of the path."""
        if re.search(r"#|\bR\d+\s*=|=\s*[A-Z(]|(?<![A-Z\d])[A-Z]\s*=?\s*\[", line):
            raise InputError(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        if re.search(r"[\d.]O", line):
            raise InputError(f"letter O stands in or beside a number in {line[:40]!r}, expected digits")
        if re.search(r"(?<![A-Z0-9])[ABC][2-7]\s*=", line):
            raise InputError(f"orientation {line[:40]!r} is not read, expected A3= B3= C3= or rotary axes A B C")
        bare, known, unknown = drop_harmless(line)
        if unknown:
            word = unknown[0][:20]
            plain = unknown[0] in TEXT or not (self.begun or self.state.siemens)
            rest_of_line = IDENTIFIER.sub(" ", bare)
            if not plain and (self.state.siemens or COORDINATE.search(rest_of_line) or MOTION.search(rest_of_line)):
                raise InputError(f"word {word} is not read and may move the tool; post-process without it")
            self.note(f"vendor word {word} is not read")
            return None
        for word in known:
            self.note(f"vendor word {word[:20]} is not read")
        words, rest = split_words(bare.replace('"', " "))
        rest = re.sub(r"\bT\s*=?(?=\s|$)", "", rest).strip() if '"' in bare else rest
        if not rest:
            return words
        if set(rest) <= set("*%,:$!") or re.fullmatch(r"[DEHLNOPQST]", rest):
            self.note(f"character {rest[0]!r} is not read")
            return words
        if "[" in rest:
            raise InputError(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        raise InputError(f"cannot read {rest[:40]!r}, expected words such as X12.5")
