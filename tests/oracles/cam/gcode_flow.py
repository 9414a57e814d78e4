"""Which block of a G-code file comes next: subprograms, jumps, loops, variables."""

from __future__ import annotations

import re

from tests.oracles.cam.expressions import evaluate
from tests.oracles.cam.gcode_words import Words, cut_words, is_named, strip_comments
from tests.oracles.cam.moves import CannotTellError

#: Blocks that are carried out at most, before a loop is taken for endless.
MOST_BLOCKS = 5_000_000
_ASSIGN = re.compile(r"#(\d+|\[.*?\])\s*=(.*)")
_IF = re.compile(r"IF\s*(\[.*\])\s*(?:GOTO\s*(\d+)|THEN\s*(.+))$")
_WHILE = re.compile(r"WHILE\s*(\[.*\])\s*DO\s*(\d)$")
_NUMBERED = re.compile(r"N(\d+)")
_ALIGNED = re.compile(r":\d+\s*(?=[A-Z])")
_ACTION = re.compile(r"(?:N\d+\s*)?M(\d+)")
#: M codes whose block may move too.
MOVING_M = {
    *range(0, 15), 16, 17, 18, 19, 29, 30, 31, 33, 34, 35, 36, 41, 42, 43, 44, 46, 47, 48, 49, 50, 51, 60, 61, 88, 89,
    97, 98, 99, 198,
}  # fmt: skip
#: G codes that move nothing and change nothing that is read here.
SILENT = {
    4.1, 5.1, 8.0, 9.0, 40.0, 43.0, 43.1, 44.0, 49.0, 50.0, 61.0, 61.1, 62.0, 64.0, 69.1, 80.0, 94.1, 96.0, 97.0, 187.0,
}  # fmt: skip
#: G codes that the reader of G-code acts on.
KNOWN = {
    53.1, 68.2, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 10.0, 11.0, 15.0, 16.0, 17.0, 18.0, 19.0, 20.0, 21.0, 28.0, 29.0, 30.0,
    43.4, 43.5, 52.0, 53.0, 68.0, 69.0, 70.0, 71.0, 90.0, 90.1, 91.0, 91.1, 92.0, 93.0, 94.0, 95.0, 98.0, 99.0,
}  # fmt: skip
_PROGRAM = re.compile(r"[O:](\d+)")


class Flow:
    """Go through the blocks of a file in the order in which a controller does."""

    def __init__(self, text: str) -> None:
        """Cut a file into lines, comments stripped."""
        self.lines = [strip_comments(line) for line in text.splitlines()]
        self.at, self.line, self.spent = 0, 0, 0
        self.values: dict[str, float] = {}
        self.calls: list[tuple[int, int, int]] = []
        self.programs: dict[int, int] | None = None
        self.notes: list[str] = []

    def next_block(self) -> Words | None:
        """Return the words of the next block, None at the end."""
        while self.at < len(self.lines):
            text = self.lines[self.at]
            self.at += 1
            self.line = self.at
            self.spent += 1
            if self.spent > MOST_BLOCKS:
                raise CannotTellError("a loop without end", self.line)
            if text[:1] == ":" and (match := _ALIGNED.match(text)):
                text = text[match.end() :]
            if (match := _ACTION.match(text)) and int(match[1]) not in MOVING_M and "G" not in text:
                continue  # the words of an M code of its own, texts among them
            if not text or text[0] in "O:":
                if self.calls == [] and text and self.line > 1 and self._is_subprogram():
                    return None
                continue
            if text[0] == "N":
                text = _NUMBERED.sub("", text, count=1).strip()
                if not text:
                    continue
            if text[0] == "/":
                if re.search(r"[XYZ]", text):
                    raise CannotTellError("a block that a switch skips", self.line)
                continue
            if "#" in text or text[:2] in ("IF", "WH", "EN", "GO"):
                if self._steer(text):
                    continue
            elif is_named(text):
                self.notes.append("named commands of a printer are read past")
                continue
            return cut_words(text, self.values, self.line)
        return None

    def _is_subprogram(self) -> bool:
        """Tell whether a further program number begins here, which is run when called alone."""
        return any(self.lines[k] and self.lines[k][0] not in "O:" for k in range(self.at - 1))

    def _steer(self, text: str) -> bool:
        """Carry out an assignment, a jump or a loop; tell whether the line was one."""
        if match := _ASSIGN.fullmatch(text):
            index = match[1] if match[1].isdigit() else f"{evaluate(match[1], self.values):.0f}"
            self.values[f"#{index}"] = evaluate(match[2], self.values)
        elif match := _IF.fullmatch(text):
            if evaluate(match[1], self.values):
                if match[2]:
                    self._jump(int(match[2]))
                else:
                    self._steer(match[3])
        elif match := _WHILE.fullmatch(text):
            if not evaluate(match[1], self.values):
                self._leave(int(match[2]))
        elif match := re.fullmatch(r"GOTO\s*(\d+)", text):
            self._jump(int(match[1]))
        elif match := re.fullmatch(r"END\s*(\d)", text):
            self._turn_back(int(match[1]))
        elif text.startswith(("IF", "WHILE", "END", "GOTO")):
            raise CannotTellError(f"{text[:30]!r}", self.line)
        else:
            return False
        return True

    def _jump(self, number: int) -> None:
        for k, text in enumerate(self.lines):
            if (match := _NUMBERED.match(text)) and int(match[1]) == number:
                self.at = k
                return
        raise CannotTellError(f"block N{number}", self.line)

    def _leave(self, number: int) -> None:
        while self.at < len(self.lines):
            self.at += 1
            if re.fullmatch(rf"(?:N\d+\s*)?END\s*{number}", self.lines[self.at - 1]):
                return
        raise CannotTellError(f"END{number}", self.line)

    def _turn_back(self, number: int) -> None:
        for k in range(self.at - 2, -1, -1):
            if re.search(rf"WHILE\s*\[.*DO\s*{number}$", self.lines[k]):
                self.at = k
                return
        raise CannotTellError(f"WHILE of END{number}", self.line)

    def call(self, has: dict[str, float], *, local: bool) -> None:
        """Go into a subprogram, as often as it says."""
        number, times = int(has.get("P", -1.0)), int(has.get("L", has.get("K", 1.0)))
        if len(self.calls) > 20:
            raise CannotTellError("subprograms within each other", self.line)
        if not local and number > 9999 and "L" not in has:
            times, number = divmod(number, 10000)
        back = self.at
        if local:
            self._jump(number)
        else:
            if self.programs is None:
                found = [(k, _PROGRAM.match(text)) for k, text in enumerate(self.lines)]
                self.programs = {int(match[1]): k + 1 for k, match in found if match}
            if number not in self.programs:
                raise CannotTellError(f"subprogram {number}", self.line)
            self.at = self.programs[number]
        self.calls.append((back, self.at, times - 1))

    def give_back(self) -> bool:
        """Return from a subprogram; tell whether the program ends."""
        if not self.calls:
            return True
        back, start, left = self.calls.pop()
        if left > 0:
            self.calls.append((back, start, left - 1))
            self.at = start
        else:
            self.at = back
        return False
