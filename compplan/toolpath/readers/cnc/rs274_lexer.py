"""Lexer of the RS-274 family: splits lines into the words of blocks, and handles comments and skip marks."""

from __future__ import annotations

import re

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.motion import FARTHEST_WITHOUT_POINT
from compplan.toolpath.readers.cnc.rs274_macro import Macros
from compplan.toolpath.readers.cnc.sinumerik_program import CHANGING
from compplan.toolpath.readers.cnc.state import CncBlock
from compplan.toolpath.readers.lines import DECIMAL

Words = list[tuple[str, float]]
NUMBER = rf"{DECIMAL}(?:E[-+]\d{{1,3}}(?![\d.]))?"
#: Word: one letter and a number, or a corner.
WORD = re.compile(rf"(,\s*[RC]|(?<![A-Z,])[A-Z])\s*=?\s*({NUMBER})", re.ASCII)
#: Words that a block may contain once; corners of Fanuc: ,R2 is a rounding, ,C2 a chamfer.
ONCE = frozenset((*"XYZABCIJKR", "RND", "CHR"))
CORNER = {",R": "RND", ",C": "CHR"}
#: Word directly before brackets, which marks them as arguments, not as a comment.
CALLED = re.compile(r"(?<![A-Za-z0-9_])[A-Za-z_]{2,}\w*$")
UNSIGNED_EXPONENT = re.compile(r"[\d.]E\d")
#: Unsupported flow control of other controls and of LinuxCNC (o1 while, o<name> call).
CONTROL = re.compile(
    r"(IF|ELSE|ELSEIF|WHILE|GOTO\w*|FOR|BREAK|CONTINUE|RETURN|ENDLOOP|ENDREPEAT|REPEATB?|UNTIL|LOOP|ENDIF|ENDFOR|ENDWHILE|CALL|PCALL|MCALL|EXTCALL|PROC|CASE|RET)\b"
)
O_WORD = re.compile(r"(?:N\s*\d+\s*)?O\s*(?:<[^<>]*>|\d+|\[[^\[\]]*\])\s*[A-Z]{2}")
#: Patterns that are refused in a line with other text than words.
REFUSED = (
    (re.compile(r"#|\bR\d+\s*=|=\s*[A-Z(]|(?<![A-Z\d])[A-Z]\s*=?\s*\["), "an expression: numbers are read"),
    (re.compile(r"[\d.]O"), "a letter O stands in or beside a number"),
)  # fmt: skip
#: Line with the name of a program only.
NAME_LINE = re.compile(r"O?<[^<>]*>|%.*|:.*")
#: End of the tape, or name of a further program; other text after % is a comment of a printer or a sender.
TAPE_END = re.compile(r"%\s*(\d+|_N_\w*|MPF.*|SPF.*)?")
SKIP_MARK = re.compile(r"((?:N\d+)?\s*)/\d?(?![\d.])\s*")
SKIP_WITHIN = re.compile(r"\s/\s*(?=[A-Z]|$)|/(?=[A-Z])")
BLOCK = re.compile(r"(N\d+\s*)?[GMTSFDHXYZABCIJKRUVW]\s*=?\s*[-+.#\[\d]|(N\d+\s*)?(#\d|R\d+\s*=)")
#: Line of an M code that owns its words and text.
OWNER_LINE = re.compile(r"(?:N\d+\s*)?M0*(\d+(?:\.\d+)?)(?=[\sA-Z]|$)(?!.*\bG\d)")
#: Homing of a printer: bare letters name axes (G28 X Y) or options (G28 W); all axes are unknown after it.
BARE_HOME = re.compile(r"(?:N\d+\s*)?G28(?:\s+[A-Z]\d?)+\s*")
#: Macro variables and flow control (Fanuc).
MACRO = re.compile(
    r"#\s*[\d#<\[]|(?<![A-Z_])[A-Z,]\s*[-+]?\s*\[|"
    r"^(?:N\s*\d+\s*)?(?:IF\s*\[|WHILE\s*\[|GOTO\s*\d|DO\s*[1-9]\s*$|END\s*[1-9]\s*$)"
)
#: Addresses of lengths; lengths without decimal point.
LENGTHS = frozenset("XYZIJKRUVW")
WITHOUT_POINT = re.compile(r"(?<![A-Z,])([XYZIJKRUVW])\s*=?\s*([-+]?\d+)(?![\d.E])")
IDENTIFIER = re.compile(r"(?<![A-Z0-9_])[A-Z]{2,}[A-Z0-9_]*")
#: Marks of a move, a call or a change of the frame in a line with an unknown word.
MOVES = re.compile(
    rf"(?<![A-Z0-9])([XYZABCIJKUVW]\s*=?\s*[-+.\d]|G0*[0-3](?![\d.]))|PLANE\b(?!\s+RESET\b)|ROTATION\b|MIRRORING\b|"
    rf"\b({CHANGING}|SUPA)\b"
)
ARGUMENTS = re.compile(r"[A-Za-z_]{2}\w*\(")
#: Comments, also without closing bracket, and quoted text.
REMARK = re.compile(r'\([^()]*$|\((?:[^()]|\([^()]*\))*\)|;.*|"[^"]*"')


def strip_comments(line: str) -> tuple[str, list[str]]:
    """Return a line in capitals without comments and quoted text, and the comments: ( .. ), and text after a ;."""
    if "(" not in line and ";" not in line and '"' not in line:
        return line.upper().strip(), []
    comments: list[str] = []

    def cut(found: re.Match[str]) -> str:
        text, start = found.group(), found.start()
        if text[0] == ";" or (text[0] == "(" and not CALLED.search(line, max(0, start - 64), start)):
            comments.append(text[1:].removesuffix(")" if text[0] == "(" else "").strip())
        return " "

    kept = REMARK.sub(cut, line)
    if '"' in kept:
        raise ValueError('a quote (") is opened and never closed')
    return kept.upper().strip(), [text for text in comments if text]


def split_words(line: str) -> tuple[Words, str]:
    """Split a line without comments into its words and the remaining text."""
    words = [(CORNER["," + letter[-1]] if letter[0] == "," else letter, float(number))
             for letter, number in WORD.findall(line)]  # fmt: skip
    return words, WORD.sub("", line).strip()


#: M codes of printers (Marlin, RepRap) that own the words of their block: machine settings without motion.
OWNERS = frozenset(float(code) for code in (
    16, 20, 22, 23, 24, 25, 26, 27, 28, 31, 32, 36, 42, 43, 73, 74, 84, 85, 92, *range(104, 126), 140, 141, 143, 144,
    145, 149, 150, *range(155, 196), *range(200, 300), *range(300, 310), 350, 351, 355, 360, 361, 362, 363, 364,
    *range(380, 382), *range(400, 430), 486, *range(500, 620), *range(665, 675), 701, 702, 710, 851, 852, 862, 865,
    871, 876, 900, *range(906, 920), 928, 951, 993, 994, 995, 997, 999, 1000, 1002, 1006,
))  # fmt: skip
#: M codes among them whose words include X Y Z.
WITH_COORDINATES = frozenset(float(code) for code in (
    92, 122, 125, *range(200, 230), 301, 303, 304, 350, 351, 420, 425, 540, 558, 566, 569, 574, 579, 584, 593, 665, 666,
    669, 671, 672, 851, 852, 871, 900, *range(906, 920), 951, 1006,
))  # fmt: skip


def owns_words(code: float) -> bool:
    """Return whether an M code owns the words of its block."""
    return code in OWNERS or (code > 16.0 and code != int(code))


class Lexer:
    """Split the lines of a G-code file into blocks of words.

    Other lines are executed or refused here: comments, skip marks, assignments, jumps, unknown words.
    """

    def __init__(self, it: Interpreter, macros: Macros) -> None:
        self.it, self.macros = it, macros
        #: Whether a block was read.
        self.begun = False

    def read(self, raw: str) -> CncBlock | None:
        """Return the block of a line, None if it has none."""
        line, comments = strip_comments(raw)
        for comment in comments:
            self.it.log.add_event("comment", text=comment)
        if not line:
            return None
        if len(line) > 200:
            line = " ".join(line.split())
        if line[0] in "%<:O" and NAME_LINE.fullmatch(line):
            if self.it.course.begun and TAPE_END.fullmatch(line):
                return CncBlock(machine=[99.0])
            return None
        if "/" in line:
            marked = SKIP_WITHIN.sub(" ", SKIP_MARK.sub(r"\1", line, count=1) if SKIP_MARK.match(line) else line)
            if marked != line:
                self.it.note("blocks marked with / are read")
            line = marked.strip()
        words, rest = split_words(line)
        if rest:
            found = self._read_more(line, raw, rest)
            if found is None:
                return None
            words, line = found
        elif "E" in line and UNSIGNED_EXPONENT.search(line):
            raise InputError(f"number {line[:40]!r} may be read in two ways, write it without an exponent")
        if next((letter for letter, _ in words if letter != "N"), "") == "L":
            raise InputError(f"subprogram call {line[:20]!r} is not read; call a program of the file (M98)")
        self._check_points(words, line)
        self.begun = self.begun or any(letter not in "NO" for letter, _ in words)
        block = CncBlock()
        for letter, value in words:
            block.put(letter, value, once=letter in ONCE)
        return block

    def _check_points(self, words: Words, line: str) -> None:
        """Refuse a length without decimal point that is implausible in mm and may be in increments."""
        scale = self.it.state.scale
        if all(letter not in LENGTHS or abs(number * scale) < FARTHEST_WITHOUT_POINT for letter, number in words):
            return
        for letter, number in WITHOUT_POINT.findall(line):
            if abs(float(number) * scale) >= FARTHEST_WITHOUT_POINT:
                raise InputError(
                    f"{letter}{number} has no decimal point and may count in mm or in the control's least increment "
                    f"(0.001 mm); write it with a point ({letter}{number}. or {letter}{float(number) / 1e3:.3f})"
                )

    def _read_more(self, line: str, raw: str, rest: str) -> tuple[Words, str] | None:
        """Return the words of a line with other text than words, and the line; None if it has no words to execute.

        The line may belong to an M code, contain macro words, or text without motion.
        """
        if O_WORD.match(line):
            raise InputError(f"program control {line[:40]!r} (O words) is not read; write the program out")
        if (owner := OWNER_LINE.match(line)) and owns_words(float(owner.group(1))):
            self.it.machine.leave_out(f"M{owner.group(1)}")
            return None
        if BARE_HOME.fullmatch(line):
            return [("G", 28.0)], line
        if MACRO.search(line):
            spelled = self.macros.run_macro(line)
            if spelled is None:
                return None
            line = spelled
        words, rest = split_words(line)
        if not rest:
            return words, line
        bare = re.sub(r"^N\d+\s*", "", line)
        if CONTROL.match(bare):
            raise InputError(f"program control {bare[:40]!r} is not read; write the program out in the CAM system")
        names = IDENTIFIER.findall(bare)
        if not self.begun and not BLOCK.match(bare) and not IDENTIFIER.match(bare):
            self.it.note(f"text before the first block is not read: {bare[:20]!r}")
            return None
        for pattern, what in REFUSED:
            if pattern.search(bare):
                raise InputError(f"{bare[:40]!r} is not read ({what}); write the program out in the CAM system")
        if names:
            moves = self.begun and (MOVES.search(bare) or MOVES.search(IDENTIFIER.sub(" ", bare)))
            if moves or ARGUMENTS.search(raw):
                raise InputError(f"word {names[0][:20]} is not read and may move the tool; post-process without it")
            self.it.note(f"vendor word {names[0][:20]} is not read")
            return None
        if set(rest) <= set("*%,:$!") or re.fullmatch(r"[DEHLNOPQST]", rest):
            self.it.note(f"character {rest[0]!r} is not read")
            return words, line
        raise InputError(f"cannot read {rest[:40]!r}, expected words such as X12.5")
