"""Flow of Sinumerik programs: labels, jumps, IF, CASE, loops, repeats, declarations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.sinumerik_cycles import SinumerikCycleReader
from compplan.toolpath.readers.sinumerik_words import BLOCK_NUMBER, LABEL, cut_comment

#: Greatest number of jumps, calls and passes that are carried out, and how deep programs call one another.
MOST_JUMPS = 200_000
MOST_CALLS = 9999
DEEPEST = 11
FLOW = re.compile(
    r"(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|REPEATB?|UNTIL|LOOP|ENDLOOP|GOTO[FBCS]?|CASE|DEF|PROC|RET|EXTERN|MSG|"
    r"ENDPROC|CALL|PCALL|EXTCALL|ISOCALL|ID|IDS|WHEN|WHENEVER|EVERY|DO|REDEF|DEFINE)(?![\w=])"
)
OPENING = {"IF": "ENDIF", "WHILE": "ENDWHILE", "FOR": "ENDFOR", "LOOP": "ENDLOOP", "REPEAT": "UNTIL"}
GOTO = re.compile(r"(.*?)\b(GOTO[FBC]?)\s+(N\s*\d+|[A-Z_]\w*|\d+)\s*$")
DECLARE = re.compile(r"DEF\s+(?:CHAN\s+|NCK\s+)?(REAL|INT|BOOL|CHAR|STRING(?:\[\d+\])?|AXIS|FRAME)\s+(.*)")
LIMIT_TEXT = 40
#: Statements of control that are not read.
REFUSED = {"CALL", "PCALL", "EXTCALL", "ISOCALL", "GOTOS", "ID", "IDS", "WHEN", "WHENEVER", "EVERY", "DO", "REDEF",
           "DEFINE"}  # fmt: skip


@dataclass
class Unit:
    """Hold a program of a file: its lines, where it stands, its labels and where its blocks of control close."""

    lines: Sequence[str]
    first: int
    last: int
    file: Path
    parameters: list[str] = field(default_factory=list)
    labels: dict[str, list[int]] = field(default_factory=dict)
    partners: dict[int, int] = field(default_factory=dict)
    alternatives: dict[int, int] = field(default_factory=dict)


class SinumerikFlowReader(SinumerikCycleReader):
    """Follow jumps and loops."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.jumps = 0

    def prepare(self, unit: Unit) -> None:
        """Find labels, and where blocks of control close."""
        stack: list[tuple[str, int]] = []
        for index in range(unit.first, unit.last):
            body = strip(unit.lines[index])
            if not body or not (body[0] in "IEWFRULN" or ":" in body):
                continue
            self._find_label(unit, unit.lines[index], index)
            if (found := LABEL.match(body)) and found.group(1) not in ("N",):
                body = body[found.end() :]
            word = FLOW.match(body)
            if not word:
                continue
            key = word.group(1)
            if key == "IF" and re.search(r"\bGOTO[FBCS]?\b", body):
                continue
            if key == "REPEAT" and body[len("REPEAT") :].strip():
                continue
            if key in OPENING:
                stack.append((key, index))
            elif key == "ELSE" and stack and stack[-1][0] == "IF":
                unit.alternatives[stack[-1][1]] = index
                unit.alternatives[index] = stack[-1][1]
            elif key in OPENING.values():
                self.line = index + 1
                if not stack or OPENING[stack[-1][0]] != key:
                    raise self.error(f"{key} closes nothing that is open")
                _, opened = stack.pop()
                unit.partners[opened] = index
                unit.partners[index] = opened
        if stack:
            self.line = stack[-1][1] + 1
            raise self.error(f"{stack[-1][0]} is never closed by {OPENING[stack[-1][0]]}")

    def _find_label(self, unit: Unit, raw: str, index: int) -> None:
        body = strip(raw)
        if (found := LABEL.match(body)) and found.group(1) != "N":
            unit.labels.setdefault(found.group(1), []).append(index)

    def _declare(self, text: str) -> None:
        """Carry out DEF."""
        found = DECLARE.match(text)
        if not found:
            raise self.error(f"declaration {text[:LIMIT_TEXT]!r} is not read")
        kind, rest = found.groups()
        for item in re.findall(r"([A-Z_$][\w]*)\s*(\[[^\]]*\])?\s*(?:=\s*((?:\"[^\"]*\"|[^,(]|\([^)]*\))+))?", rest):
            variable, _, value = item
            if variable in ("SET",) or kind.startswith(("STRING", "CHAR", "AXIS", "FRAME")):
                self.unknown[variable] = f"line {self.line} declares it as {kind}"
                self.variables.discard(variable)
                continue
            self.variables.add(variable)
            if value and not value.lstrip().startswith(("SET", '"')):
                self.numbers[variable, ()] = self.evaluate(value)

    def run_flow(self, word: str, text: str, raw: str, unit: Unit, index: int, active: dict[int, float],
                  repeats: dict[int, int]) -> int:  # fmt: skip
        """Carry out a statement of control; return the next line, -1 at the end."""
        rest = text[len(word) :].strip()
        if word == "MSG":
            told = re.search(r'MSG\s*\(\s*"([^"]*)"', raw, re.IGNORECASE)
            if told:
                self.log.happen("comment", self.line, text=told.group(1))
        elif word == "DEF":
            self._declare(text)
        elif word in ("PROC", "EXTERN"):
            pass
        elif word in ("RET", "ENDPROC"):
            return -1
        elif word in REFUSED:
            raise self.error(f"{word} {rest[:24]!r} is not read; write the program out in the CAM system")
        else:
            self.count_jump()
            return self._jump(word, text, rest, unit, index, active, repeats)
        return index + 1

    def count_jump(self) -> None:
        """Count a jump or a call."""
        self.jumps += 1
        if self.jumps > MOST_JUMPS:
            raise self.error(f"more than {MOST_JUMPS} jumps and calls are carried out; no more are read")

    def _jump(self, word: str, text: str, rest: str, unit: Unit, index: int, active: dict[int, float],
              repeats: dict[int, int]) -> int:  # fmt: skip
        """Carry out IF, loops and jumps; return the next line."""
        if word == "IF":
            return self._run_if(rest, unit, index)
        if word == "ELSE":
            return unit.partners[unit.alternatives[index]] + 1 if index in unit.alternatives else index + 1
        if word == "WHILE":
            return index + 1 if self.evaluate(rest) else unit.partners[index] + 1
        if word in ("ENDWHILE", "ENDLOOP"):
            return unit.partners[index]
        if word == "ENDFOR":
            return unit.partners[index]
        if word == "FOR":
            return self._run_for(rest, unit, index, active)
        if word == "UNTIL":
            return index + 1 if self.evaluate(rest) else unit.partners[index] + 1
        if word.startswith("GOTO"):
            return self._find_goto(word, rest, unit, index)
        if word == "CASE":
            return self._run_case(rest, unit, index)
        if word in ("REPEAT", "REPEATB") and rest:
            return self._repeat(word, rest, unit, index, repeats)
        return index + 1

    def _run_if(self, rest: str, unit: Unit, index: int) -> int:
        found = GOTO.match(rest)
        if found:
            holds = self.evaluate(found.group(1))
            return self._find_goto(found.group(2), found.group(3), unit, index) if holds else index + 1
        if "GOTO" in rest:
            raise self.error(f"jump {rest[:LIMIT_TEXT]!r} is not read, expected IF .. GOTOF label")
        if self.evaluate(rest):
            return index + 1
        return unit.alternatives.get(index, unit.partners[index]) + 1

    def _run_for(self, rest: str, unit: Unit, index: int, active: dict[int, float]) -> int:
        found = re.match(r"([A-Z_]\w*)\s*=\s*(.+?)\s+TO\s+(.+)$", rest)
        if not found:
            raise self.error(f"FOR {rest[:LIMIT_TEXT]!r} is not read, expected FOR I = 1 TO 5")
        variable = found.group(1)
        key = ("R", (float(variable[1:]),)) if re.fullmatch(r"R\d+", variable) else (variable, ())
        self.variables |= {variable} if key[0] != "R" else set()
        value = active[index] + 1.0 if index in active else self.evaluate(found.group(2))
        if index in active:
            value = self.numbers[key] + 1.0
        self.numbers[key] = active[index] = value
        if value > self.evaluate(found.group(3)):
            return unit.partners[index] + 1
        return index + 1

    def _run_case(self, rest: str, unit: Unit, index: int) -> int:
        found = re.match(r"(.+?)\s+OF\s+(.*)$", rest)
        if not found:
            raise self.error(f"CASE {rest[:LIMIT_TEXT]!r} is not read")
        value = self.evaluate(found.group(1))
        for constant, how, label in re.findall(r"(\S+)\s+(GOTO[FBC]?)\s+([A-Z_]\w*|N?\d+)", found.group(2)):
            if constant == "DEFAULT" or self.evaluate(constant) == value:
                return self._find_goto(how, label, unit, index)
        return index + 1

    def _find_goto(self, how: str, label: str, unit: Unit, index: int) -> int:
        """Return the line of a label or block number, forwards (GOTOF), backwards (GOTOB), or both."""
        label = label.strip()
        number = label.removeprefix("N").strip()
        places = unit.labels.get(label, [])
        if number.isdigit():
            block = re.compile(rf"\s*[N:]\s*0*{int(number)}(?!\d)", re.IGNORECASE)
            places = [at for at in range(unit.first, unit.last) if block.match(unit.lines[at])]
        ahead, behind = [at for at in places if at > index], [at for at in places if at <= index]
        chosen = ahead[:1] if how != "GOTOB" else behind[-1:]
        if how in ("GOTO", "GOTOC") and not chosen:
            chosen = behind[-1:]
        if not chosen:
            if how == "GOTOC":
                return index + 1
            where = "before" if how == "GOTOB" else "after"
            raise self.error(f"{how} {label[:24]}: this label does not stand {where} it")
        return chosen[0]

    def _repeat(self, word: str, rest: str, unit: Unit, index: int, repeats: dict[int, int]) -> int:
        """Carry out REPEAT label [label] P=n: from the label to here (or to the second one), n times more."""
        found = re.fullmatch(r"([A-Z_]\w*)(?:\s+([A-Z_]\w*))?(?:\s*P\s*=?\s*(.+))?", rest)
        if not found or word == "REPEATB" or found.group(2):
            raise self.error(f"{word} {rest[:LIMIT_TEXT]!r} is not read, expected REPEAT label P=n")
        start = self._find_goto("GOTOB", found.group(1), unit, index)
        left = repeats.get(index)
        left = int(self.evaluate(found.group(3) or "1")) if left is None else left
        if left > 0:
            repeats[index] = left - 1
            return start
        repeats.pop(index, None)
        return index + 1


def strip(raw: str) -> str:
    """Return a line in capitals without comment, number and marks."""
    body = cut_comment(raw)[0].upper()
    found = BLOCK_NUMBER.match(body)
    return body[found.end() :] if found else body
