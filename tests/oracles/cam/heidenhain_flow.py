"""Which block of a conversational program comes next: labels, repeats, jumps, Q parameters."""

from __future__ import annotations

import math
import re

from tests.oracles.cam.expressions import evaluate
from tests.oracles.cam.moves import CannotTellError

#: Blocks that are carried out at most, before a jump is taken for endless.
MOST_BLOCKS = 2_000_000
_OPERAND = r"([-+]?\s*(?:\d+\.?\d*|\.\d+|Q[LR]?\d+))"
_LABEL = r"(\"[^\"]+\"|\d+)"
_JUMP = re.compile(rf"FN ?(?:9|1[0-2]) ?: ?IF {_OPERAND} (EQU|NE|GT|LT) {_OPERAND} GOTO LBL ?{_LABEL}")
_FUNCTION = re.compile(r"FN ?([0-8]|13) ?: ?(Q[LR]?\d+) ?= ?(.+)")
_FORMULA = re.compile(r"(Q[LR]?\d+) ?= ?(.+)")
_CALL = re.compile(rf"CALL LBL ?{_LABEL}(?: ?REP ?(\d+)(?: ?/ ?\d+)?)?")
_TESTS = {"EQU": lambda a, b: a == b, "NE": lambda a, b: a != b, "GT": lambda a, b: a > b, "LT": lambda a, b: a < b}


class HeidenhainFlow:
    """Go through the blocks of a program in the order in which the control does."""

    def __init__(self, text: str) -> None:
        """Cut a program into blocks, comments stripped, continued ones joined."""
        self.text = text.upper()
        if re.search(r"TOOL DEF[^;\n]*L", self.text) and re.search(r"\bF ?(?:9999|15999)\b", self.text):
            raise CannotTellError("rapid traverse as F9999")
        self.blocks: list[tuple[int, str]] = []
        kept, first = "", 0
        for number, line in enumerate(self.text.splitlines(), 1):
            part = line.split(";")[0].strip()
            carried = "~" in line
            part = part.replace("~", " ").strip()
            if not kept:
                first, part = number, re.sub(r"^\d+\s*(?=\D|$)", "", part)
                part = "" if re.match(r"\(|FLUTE LEN", part) else re.sub(r"^CYCLE ", "CYCL ", part)
            part = re.sub(r"\s*\([^()]*\)$", "", part) if re.match(r"L[PN]?\s", part) else part
            kept = f"{kept} {part}".strip() if kept else part
            if not carried:
                if kept:
                    self.blocks.append((first, re.sub(r"\s+", " ", kept)))
                kept = ""
        self.at, self.line, self.spent = 0, 0, 0
        self.values: dict[str, float] = {}
        self.calls: list[int] = []
        self.left: dict[int, int] = {}

    def next_block(self) -> str | None:
        """Return the next block that is no matter of the flow, None at the end."""
        while self.at < len(self.blocks):
            self.line, text = self.blocks[self.at]
            self.at += 1
            self.spent += 1
            if self.spent > MOST_BLOCKS:
                raise CannotTellError("a jump without end", self.line)
            if not self._steer(text):
                return text
        return None

    def _steer(self, text: str) -> bool:
        if match := re.fullmatch(rf"LBL ?{_LABEL}", text):
            if match[1] == "0" and self.calls:
                self.at = self.calls.pop()
        elif match := _CALL.fullmatch(text):
            self._call(match[1], int(match[2] or 0))
        elif match := _JUMP.fullmatch(text):
            first, last = (evaluate(value.replace(" ", ""), self.values) for value in (match[1], match[3]))
            if _TESTS[match[2]](first, last):
                self._go(match[4])
        elif match := _FUNCTION.fullmatch(text):
            self.values[match[2]] = self._work_out(int(match[1]), match[3])
        elif match := _FORMULA.fullmatch(text):
            self.values[match[1]] = self._formula(match[2])
        elif text.startswith("CALL"):
            raise CannotTellError(f"{text[:30]!r}", self.line)
        else:
            return False
        return True

    def _formula(self, text: str) -> float:
        if "ATAN" in text:
            raise CannotTellError("an arc tangent", self.line)
        return evaluate(re.sub(r"\bPI\b", repr(math.pi), text.replace("^", "**")), self.values)

    def _work_out(self, number: int, text: str) -> float:
        """Return the value of FN 0 to 8 and 13."""
        if number in (0, 1, 2, 3):
            return self._formula(text)
        if number in (5, 6, 7):
            return self._formula(text)
        words = re.fullmatch(rf"{_OPERAND} ?(DIV|LEN|ANG) ?{_OPERAND}", text)
        if words is None:
            raise CannotTellError(f"FN {number}: {text[:20]}", self.line)
        a, b = (evaluate(value.replace(" ", ""), self.values) for value in (words[1], words[3]))
        if words[2] == "DIV":
            return a / b
        return math.hypot(a, b) if words[2] == "LEN" else math.degrees(math.atan2(a, b))

    def _go(self, label: str) -> None:
        for k, (_, text) in enumerate(self.blocks):
            if re.fullmatch(rf"LBL ?{re.escape(label)}", text):
                self.at = k + 1
                return
        raise CannotTellError(f"label {label}", self.line)

    def _call(self, label: str, repeats: int) -> None:
        """Go into a subprogram, or back to a label as often as it says."""
        here = self.at
        if not repeats:
            if len(self.calls) > 20:
                raise CannotTellError("subprograms within each other", self.line)
            self.calls.append(here)
            self._go(label)
            return
        left = self.left.get(here, repeats)
        if left > 0:
            self.left[here] = left - 1
            self._go(label)
        else:
            del self.left[here]
