"""The words of a line of G-code: letters with numbers, comments and quoted text aside."""

from __future__ import annotations

import re

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]\d{1,3}(?![\d.]))?"
#: A word: one letter and a number. Siemens writes X=12.5 and CR=5 (a radius).
WORD = re.compile(rf"(?<![A-Z,])([A-Z])\s*=?\s*({NUMBER})", re.ASCII)
#: What makes a corner round or cuts it off: ,R2 and ,C2 (Fanuc), RND=2, CHR=2 and CHF=2 (Siemens).
CORNER = re.compile(rf"(?:,\s*([RC])\s*|\b(RND|CHR|CHF)\s*=\s*)({NUMBER})")
CORNER_WORDS = {"R": "ROUND", "RND": "ROUND", "C": "LEG", "CHR": "LEG", "CHF": "CHAMFER"}
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
