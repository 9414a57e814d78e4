"""Lexer of the RS-274 family: the lines of a file become the words of blocks; comments and marks are dealt with."""

from __future__ import annotations

import re

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import FARTHEST_WITHOUT_POINT
from compplan.toolpath.readers.cnc.origins import FRAME_WORDS, swivel
from compplan.toolpath.readers.cnc.rs274_macro import MacroFlow
from compplan.toolpath.readers.cnc.state import CncBlock
from compplan.toolpath.readers.lines import DECIMAL

Words = list[tuple[str, float]]
NUMBER = rf"{DECIMAL}(?:E[-+]\d{{1,3}}(?![\d.]))?"
#: A word: one letter and a number.
WORD = re.compile(rf"(?<![A-Z,])([A-Z])\s*=?\s*({NUMBER})", re.ASCII)
#: What makes a corner round or cuts it off: ,R2 and ,C2 (Fanuc), RND=2, CHR=2 and CHF=2 (Siemens). Words that files for
#: Fanuc controls may hold beside: a tool direction (A3=0 B3=0 C3=1), a numbered spindle (M1=3), frames, machine moves.
CORNER = re.compile(rf"(?:,\s*([RC])|\b(RND|CHR|CHF)\s*=)\s*({NUMBER})")
#: Words that a block may hold once.
ONCE = frozenset((*"XYZABCIJKR", "RND", "CHR", "CHF"))
CORNER_WORDS = {"R": "RND", "C": "CHR", "RND": "RND", "CHR": "CHR", "CHF": "CHF"}
DIRECTION = re.compile(rf"(?<![A-Z0-9])([ABC]3)\s*=\s*({NUMBER})")
SPINDLE_NUMBER = re.compile(r"(?<![A-Z0-9])([MS])\d{1,2}\s*=\s*(?=\d)")
SPINDLE_ANGLE = re.compile(rf"\bSPOS\s*=\s*{NUMBER}")
#: Words of Siemens controls that say nothing about the programmed path, and those that a block may hold beside others.
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
SIEMENS = {"SUPA": "G53", "TRAORI": " ", "TRAFOOF": " "}
SWIVEL = re.compile(r'CYCLE800\(([-+\d.,\s"]*)\)')
#: What makes brackets a list of arguments, not a comment: a word right before them.
CALLED = re.compile(r"(?<![A-Za-z0-9_])[A-Za-z_]{2,}\w*$")
UNSIGNED_EXPONENT = re.compile(r"[\d.]E\d")
CONVERSATIONAL = re.compile(r"\d*\s*(BEGIN PGM\b|(L|CC|CR|CT|FN|TOOL CALL|CYCL DEF|BLK FORM)\s+[A-Z\d])")
#: Control of the flow that is not read, of other controls and of LinuxCNC (o1 while, o<name> call).
CONTROL = re.compile(
    r"(IF|ELSE|ELSEIF|WHILE|GOTO\w*|FOR|BREAK|CONTINUE|RETURN|ENDLOOP|ENDREPEAT|REPEATB?|UNTIL|LOOP|ENDIF|ENDFOR|ENDWHILE|CALL|PCALL|MCALL|EXTCALL|PROC|CASE|RET)\b"
    r"|O<|O\d+\s+(SUB|CALL|IF|WHILE|REPEAT|DO)\b"
)
O_WORD = re.compile(r"(?:N\s*\d+\s*)?O\s*(?:<[^<>]*>|\d+|\[[^\[\]]*\])\s*[A-Z]{2}")
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
#: Lengths that have no decimal point, and the least ones that no part of a robot has. [mm]
LENGTHS = frozenset("XYZIJKRUVW")
WITHOUT_POINT = re.compile(r"(?<![A-Z,])([XYZIJKRUVW])\s*=?\s*([-+]?\d+)(?![\d.E])")
TOOL_NAME = re.compile(r"\bT\d*\s*=\s*\"([^\"]*)\"", re.IGNORECASE)
IDENTIFIER = re.compile(r"(?<![A-Z0-9_])[A-Z]{2,}[A-Z0-9_]*")
#: What makes a line with a word that is not known a move or a call: a coordinate, a motion code, arguments.
MOVES = re.compile(r"(?<![A-Z0-9])([XYZABCIJKUVW]\s*=?\s*[-+.\d]|G0*[0-3](?![\d.]))")
ARGUMENTS = re.compile(r"[A-Za-z_]{2}\w*\(")
#: Words that change the frame; words whose whole line is text.
FRAMES = re.compile(r"PLANE\b(?!\s+RESET\b)|ROTATION\b|MIRRORING\b")
TEXT = {"MSG", "WRITE", "PROGRAM", "REM"}


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


def split_words(line: str) -> tuple[Words, str]:
    """Split a line without comments into its words and what could not be read as words."""
    others: Words = []
    if "," in line or "=" in line:
        others = [(CORNER_WORDS[one or other], float(number)) for one, other, number in CORNER.findall(line)]
        others += [(letter, float(number)) for letter, number in DIRECTION.findall(line)]
        line = re.sub(r"\bCR\s*=", "R", CORNER.sub(" ", line))
        line = SPINDLE_NUMBER.sub(r"\1", SPINDLE_ANGLE.sub(" ", DIRECTION.sub(" ", line)))
    found = WORD.findall(line)
    return [(letter, float(number)) for letter, number in found] + others, WORD.sub("", line).strip()


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

    Lines that are no block are dealt with here: comments, marks, assignments, jumps, words that are not known.
    """

    def __init__(self, it: Interpreter, macros: MacroFlow) -> None:
        self.it, self.macros = it, macros
        #: Whether a block was read.
        self.begun = False

    def read(self, raw: str) -> CncBlock | None:
        """Return the block in a line, None where it holds none."""
        line, comments = strip_comments(raw)
        for comment in comments:
            self.it.log.happen("comment", self.it.flow.line, text=comment)
        if not line:
            return None
        if len(line) > 200:
            line = " ".join(line.split())
        if line[0] in "%<:O" and NAME_LINE.fullmatch(line):
            return CncBlock(machine=[17.0]) if line[0] == "%" and self.it.course.begun else None
        if "/" in line:
            line = self._drop_marks(line)
        if line[:1] in ("O", "N") and O_WORD.match(line):
            raise InputError(f"program control {line[:40]!r} (O words) is not read; write the program out in the CAM "
                             "system")  # fmt: skip
        words, rest = split_words(line)
        if rest and (owner := OWNER_LINE.match(line)) and owns_words(float(owner.group(1))):
            self.it.note(f"M{owner.group(1)} is not read")
            self.it.log.happen("comment", self.it.flow.line, text=f"M{owner.group(1)} of the CAM file")
            return None
        if rest and BARE_HOME.fullmatch(line):
            words, rest = [("G", 28.0)], ""
        if rest and MACRO.search(line):
            spelled = self.macros.run_macro(line)
            if spelled is None:
                return None
            line = spelled
            words, rest = split_words(line)
        if rest:
            explained = self._explain(re.sub(r"^N\d+\s*", "", line), raw)
            if explained is None:
                return None
            words = explained
        elif "E" in line and UNSIGNED_EXPONENT.search(line):
            raise InputError(f"number {line[:40]!r} may be read in two ways, write it without an exponent")
        if next((letter for letter, _ in words if letter != "N"), "") == "L":
            raise InputError(f"subprogram call {line[:20]!r} is not read; call a program of the file (M98)")
        if '"' in raw and (named := TOOL_NAME.search(raw)):
            self.it.state.tool_name = named.group(1)
        self._check_points(words, line)
        self.begun = self.begun or any(letter not in "NO" for letter, _ in words)
        block = CncBlock()
        for letter, value in words:
            if letter == "G":
                block.codes.append(value)
            elif letter == "M":
                block.machine.append(value)
            elif letter in FRAME_WORDS:
                block.names.append(letter)
            elif letter in block.values and letter in ONCE:
                raise InputError(f"word {letter} stands twice in this block, expected once")
            else:
                block.values[letter] = value
        return block

    def _check_points(self, words: Words, line: str) -> None:
        """Refuse a length that is too great for a part unless it counts in increments."""
        scale = self.it.state.scale
        if all(letter not in LENGTHS or abs(number * scale) < FARTHEST_WITHOUT_POINT for letter, number in words):
            return
        for letter, number in WITHOUT_POINT.findall(line):
            if abs(float(number) * scale) >= FARTHEST_WITHOUT_POINT:
                raise InputError(
                    f"{letter}{number} has no decimal point and may count in mm or in the control's least increment "
                    f"(0.001 mm); write it with a point ({letter}{number}. or {letter}{float(number) / 1e3:g})"
                )

    def _drop_marks(self, line: str) -> str:
        """Return a line without the marks of blocks that an operator may skip."""
        marked = SKIP_WITHIN.sub(" ", SKIP_MARK.sub(r"\1", line, count=1) if SKIP_MARK.match(line) else line)
        if marked != line:
            self.it.note("blocks marked with / are read")
        return marked.strip()

    def _explain(self, line: str, raw: str) -> Words | None:
        """Deal with a line that holds more than words; return the words to be read, None where there are none."""
        if CONVERSATIONAL.match(line):
            raise InputError(f"conversational block {line[:40]!r}; post-process the program to ISO G-code (G0 to G3)")
        if CONTROL.match(line):
            raise InputError(f"program control {line[:40]!r} is not read; write the program out in the CAM system")
        names = IDENTIFIER.findall(line)
        if not self.begun and not BLOCK.match(line) and not IDENTIFIER.match(line):
            self.it.note(f"text before the first block is not read: {line[:20]!r}")
            return None
        if re.search(r"#|\bR\d+\s*=|=\s*[A-Z(]|(?<![A-Z\d])[A-Z]\s*=?\s*\[", line) or ("[" in line and not names):
            raise InputError(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        if re.search(r"[\d.]O", line):
            raise InputError(f"letter O stands in or beside a number in {line[:40]!r}, expected digits")
        if names:
            moves = self.begun and (FRAMES.search(line) or MOVES.search(IDENTIFIER.sub(" ", line)))
            if names[0] in FRAME_WORDS or names[0] in SIEMENS:
                return self._translate(names[0], line)
            if found := SWIVEL.search(raw.upper()):
                texts = [text.strip() for text in found.group(1).split(",")]
                swivel(self.it, [float(text) if text and text[0] != '"' else 0.0 for text in texts])
                return None
            if names[0] != "CYCLE832" and names[0] not in TEXT and (moves or ARGUMENTS.search(raw)):
                raise InputError(f"word {names[0][:20]} is not read and may move the tool; post-process without it")
            self.it.note(f"vendor word {names[0][:20]} is not read")
            return None
        words, rest = split_words(re.sub(r'\bT\d*\s*=\s*"', " ", line))
        if not rest:
            return words
        if set(rest) <= set("*%,:$!") or re.fullmatch(r"[DEHLNOPQST]", rest):
            self.it.note(f"character {rest[0]!r} is not read")
            return words
        raise InputError(f"cannot read {rest[:40]!r}, expected words such as X12.5")

    def _translate(self, name: str, line: str) -> Words:
        """Return the words of a line with a word of Siemens controls, in files for several controls."""
        bare = " ".join(word for word in line.split() if word not in HARMLESS or word == name)
        words, rest = split_words(bare.replace(name, SIEMENS.get(name, " "), 1))
        if rest:
            raise InputError(f"word {name} beside {rest[:20]!r} is not read; post-process without it")
        if name in ("TRAORI", "TRAFOOF"):
            self.it.control_tip(name == "TRAORI")
        return [*words, (name, 0.0)] if name in FRAME_WORDS else words
