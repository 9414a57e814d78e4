"""Which block of a SINUMERIK program comes next: labels, jumps, loops, branches, variables."""

from __future__ import annotations

import re

from tests.oracles.cam.expressions import evaluate
from tests.oracles.cam.moves import CannotTellError

#: Blocks that are carried out at most, before a loop is taken for endless.
MOST_BLOCKS = 2_000_000
_ASSIGN = re.compile(r"(R\d+|[A-Z_]\w*)\s*=\s*([^=\"]+)")
_LABEL = re.compile(r"([A-Z_]\w+)\s*:\s*(?!=)(.*)")
_FOR = re.compile(r"FOR\s+(\w+)\s*=\s*(.+?)\s+TO\s+(.+)")
_GOTO = re.compile(r"(?:IF\s+(.+?)\s+)?GOTO([FB]?)\s+(\w+)")
#: What closes each structure.
ENDS = {"IF": "ENDIF", "FOR": "ENDFOR", "WHILE": "ENDWHILE", "LOOP": "ENDLOOP", "REPEAT": "UNTIL"}
#: Names that are words of blocks, no variables.
WORDS = {
    "X", "Y", "Z", "A", "B", "C", "I", "J", "K", "F", "S", "T", "D", "H", "I1", "J1", "K1", "A2", "B2", "C2", "A3",
    "B3", "C3", "CR", "AR", "AP", "RP", "TURN", "RND", "RNDM", "CHR", "CHF", "FRC", "FRCM", "SPOS", "RPL", "ADIS", "S1",
    "M1", "T1", "DISR", "DISCL", "FB",
}  # fmt: skip


class SinumerikFlow:
    """Go through the blocks of a program in the order in which the control does."""

    def __init__(self, text: str) -> None:
        """Cut a program into blocks in capitals, comments and texts in quotes stripped."""
        self.blocks: list[tuple[int, str, str]] = []
        for number, line in enumerate(text.upper().splitlines(), 1):
            bare = re.sub(r'\bT\s*=\s*"[^"]*"', " ", line.split(";")[0] if '"' not in line else _uncomment(line))
            bare = re.sub(r"\bMSG\s*\(.*?\"[^\"]*\".*?\)|\bMSG\s*\(\s*\)", " ", bare).strip()
            if not bare or bare.startswith("%"):
                if bare.startswith("%_N_") and bare.endswith("_SPF"):
                    break  # a subprogram of the same archive
                continue
            mark = re.match(r"(:?N?\d+|N\d+)\s*", bare)
            name = "" if mark is None else mark[1].lstrip(":")
            bare = bare if mark is None else bare[mark.end() :].strip()
            if bare or name:
                self.blocks.append((number, name, bare))
        self.at, self.line, self.spent = 0, 0, 0
        self.values: dict[str, float] = {}
        self.loops: dict[int, float] = {}

    def next_block(self) -> str | None:
        """Return the next block that is no matter of the flow, None at the end."""
        while self.at < len(self.blocks):
            self.line, _, text = self.blocks[self.at]
            self.at += 1
            self.spent += 1
            if self.spent > MOST_BLOCKS:
                raise CannotTellError("a loop without end", self.line)
            if (match := _LABEL.fullmatch(text)) and match[1] not in WORDS:
                text = match[2].strip()
            if text and not self._steer(text):
                return text
        return None

    def value(self, text: str) -> float:
        """Return the value of an expression."""
        text = re.sub(r"\bR\[([^\[\]]+)\]", lambda match: f"R{evaluate(match[1], self.values):.0f}", text)
        if re.search(r"\bPOT\b|\bATAN2\b|\bB_|\$", text):
            raise CannotTellError(f"an expression {text[:30]!r}", self.line)
        return evaluate(text.strip(), self.values)

    def _steer(self, text: str) -> bool:
        """Carry out what steers; tell whether the block was such."""
        head = re.split(r"[\s(]", text)[0]
        if head == "DEF":
            self._define(text)
        elif match := _GOTO.fullmatch(text):
            if match[1] is None or self.value(match[1]):
                self._jump(match[3], match[2])
        elif head == "IF":
            if not self.value(text[2:]):
                self._skip("IF", ("ELSE", "ENDIF"))
        elif head == "ELSE":
            self._skip("IF", ("ENDIF",))
        elif head == "FOR":
            self._count(text)
        elif head == "WHILE":
            if not self.value(text[5:]):
                self._skip("WHILE", ("ENDWHILE",))
        elif head in ("ENDFOR", "ENDWHILE", "ENDLOOP") or (head == "UNTIL" and not self.value(text[5:])):
            self._return(next(key for key, end in ENDS.items() if end == head))
        elif head in ("ENDIF", "LOOP", "UNTIL") or text == "REPEAT":
            pass
        elif head in ("CASE", "REPEAT", "REPEATB", "GOTO", "GOTOS", "GOTOC", "PROC", "CALL", "EXTCALL"):
            raise CannotTellError(f"{text[:30]!r}", self.line)
        else:
            return self._assign(text)
        return True

    def _define(self, text: str) -> None:
        match = re.fullmatch(r"DEF\s+(?:REAL|INT|BOOL)\s+([^\[\]]+)", text)
        if match is None:
            raise CannotTellError(f"{text[:30]!r}", self.line)
        for entry in match[1].split(","):
            name, _, value = entry.partition("=")
            self.values[name.strip()] = self.value(value) if value.strip() else 0.0

    def _assign(self, text: str) -> bool:
        """Carry out a block of assignments alone."""
        parts = re.split(r"\s+(?=R\d+\s*=)", text)
        matches = [_ASSIGN.fullmatch(part) for part in parts]
        found = [match for match in matches if match is not None]
        if len(found) < len(parts) or any(match[1] in WORDS for match in found):
            return False
        if any(not re.fullmatch(r"R\d+", match[1]) and match[1] not in self.values for match in found):
            return False
        for match in found:
            self.values[match[1]] = self.value(match[2])
        return True

    def _count(self, text: str) -> None:
        match = _FOR.fullmatch(text)
        if match is None:
            raise CannotTellError(f"{text[:30]!r}", self.line)
        here, name = self.at, match[1]
        self.values[name] = self.values[name] + 1.0 if here in self.loops else self.value(match[2])
        self.loops[here] = 1.0
        if self.values[name] > self.value(match[3]):
            del self.loops[here]
            self._skip("FOR", ("ENDFOR",))

    def _skip(self, word: str, ends: tuple[str, ...]) -> None:
        """Go on after the word that ends this branch or loop."""
        depth = 1
        while self.at < len(self.blocks):
            text = self.blocks[self.at][2]
            self.at += 1
            if _opens(text, word):
                depth += 1
            elif text.split(" ")[0] in ends and depth == 1:
                return
            elif text.split(" ")[0] == ENDS[word]:
                depth -= 1
        raise CannotTellError(f"{word} without its end", self.line)

    def _return(self, word: str) -> None:
        """Go back to where a loop begins."""
        depth = 1
        for k in range(self.at - 2, -1, -1):
            text = self.blocks[k][2]
            if re.split(r"[\s(]", text)[0] == ENDS[word]:
                depth += 1
            elif _opens(text, word):
                depth -= 1
                if not depth:
                    self.at = k
                    return
        raise CannotTellError(f"the start of {word}", self.line)

    def _jump(self, name: str, way: str) -> None:
        order = list(range(len(self.blocks)))
        if way:
            order = order[self.at :] if way == "F" else order[: self.at][::-1]
        for k in order:
            _, number, text = self.blocks[k]
            if number == name or ((match := _LABEL.fullmatch(text)) and match[1] == name):
                self.at = k
                return
        raise CannotTellError(f"the label {name}", self.line)


def _opens(text: str, word: str) -> bool:
    return re.split(r"[\s(]", text)[0] == word and not (word == "IF" and "GOTO" in text)


def _uncomment(line: str) -> str:
    """Strip a comment that does not stand in quotes."""
    return "".join(re.match(r'(?:[^";]|"[^"]*")*', line).group(0))  # type: ignore[union-attr]
