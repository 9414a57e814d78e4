"""Flow of Sinumerik programs: labels, jumps, IF, loops, repeats, declarations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.sinumerik_lexer import BLOCK_NUMBER, LABEL, SinumerikVariables, cut_comment, find_key
from compplan.toolpath.readers.lines import match_form

HEAD = re.compile(r"\s*%_N_(\w+?)_(MPF|SPF)\b", re.IGNORECASE)
PROC = re.compile(r"\s*(?:N\d+\s*)?PROC\s+(\w+)", re.IGNORECASE)
FLOW = re.compile(
    r"(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|REPEATB?|UNTIL|LOOP|ENDLOOP|GOTO[FBCS]?|CASE|DEF|PROC|RET|EXTERN|MSG|"
    r"ENDPROC|CALL|PCALL|EXTCALL|ISOCALL|ID|IDS|WHEN|WHENEVER|EVERY|DO|REDEF|DEFINE)(?![\w=])"
)
CONTROL = re.compile(r"\b(?:GOTO|IF|ELSE|END|WHILE|FOR|REPEAT|UNTIL|LOOP|CASE)", re.IGNORECASE)
OPENING = {"IF": "ENDIF", "WHILE": "ENDWHILE", "FOR": "ENDFOR", "LOOP": "ENDLOOP", "REPEAT": "UNTIL"}
GOTO = r"(.*?)\b(GOTO[FBC]?)\s+(N\s*\d+|[A-Z_]\w*|\d+)\s*"
DECLARE = re.compile(r"DEF\s+(?:CHAN\s+|NCK\s+)?(REAL|INT|BOOL|CHAR|STRING(?:\[\d+\])?|AXIS|FRAME)\s+(.*)")
#: Statements of control that are not read.
REFUSED = {
    "CALL", "PCALL", "EXTCALL", "ISOCALL", "GOTOS", "ID", "IDS", "WHEN", "WHENEVER", "EVERY", "DO", "REDEF",
    "DEFINE", "CASE",
}  # fmt: skip


class SinumerikFlow:
    """Carry out the control of a Sinumerik program."""

    def __init__(self, it: Interpreter, values: SinumerikVariables) -> None:
        self.it, self.flow, self.values, self.evaluate = it, it.flow, values, values.evaluate

    def find_programs(self, lines: Sequence[str], file: Path) -> CncProgram:
        """Find the programs of a file; return the first main program, or the first at all."""
        heads: list[tuple[int, int, str, bool]] = []  # line, first line of the program, name, whether a main program
        for index, line in enumerate(lines):
            if ("%_N_" in line or "%_n_" in line) and (found := HEAD.match(line)):
                heads.append((index, index + 1, found.group(1).upper(), found.group(2).upper() == "MPF"))
            elif "PROC" in line.upper() and (found := PROC.match(line)) and not (heads and heads[-1][0] >= index - 3):
                heads.append((index, index, found.group(1).upper(), False))
        ends = [*(head[0] for head in heads[1:]), len(lines)]
        mains, others = [CncProgram(lines, 0, heads[0][0] if heads else len(lines), file)], list[CncProgram]()
        for (_, start, called, main), end in zip(heads, ends, strict=False):
            program = CncProgram(lines, start, end, file)
            (mains if main else others).append(program)
            if not main:
                self.flow.programs[called] = program
        code = re.compile(r"[ \t]*[^;\s]")
        held = (main for main in mains if any(code.match(line) for line in lines[main.first : main.last]))
        return next(held, others[0] if others else mains[0])

    def prepare(self, program: CncProgram) -> None:
        """Find the labels of a program that is carried out, and where its blocks of control close."""
        stack: list[tuple[str, int]] = []
        program.labels, here = {}, self.flow.line
        if not CONTROL.search("\n".join(program.lines[program.first : program.last])):
            return
        for index in range(program.first, program.last):
            body = strip(program.lines[index])
            if not body or not (body[0] in "IEWFRULN" or ":" in body):
                continue
            if (found := LABEL.match(body)) and found.group(1) != "N":
                program.labels.setdefault(found.group(1), []).append(index)
                body = body[found.end() :]
            word = FLOW.match(body)
            key = word.group(1) if word else ""
            if (key == "IF" and re.search(r"\bGOTO[FBCS]?\b", body)) or (key == "REPEAT" and body.strip() != key):
                continue
            if key in OPENING:
                stack.append((key, index))
            elif key == "ELSE" and stack and stack[-1][0] == "IF":
                program.alternatives.update({stack[-1][1]: index, index: stack[-1][1]})
            elif key in OPENING.values():
                self.flow.line = index + 1
                if not stack or OPENING[stack[-1][0]] != key:
                    raise InputError(f"{key} has no matching opening word")
                opened = stack.pop()[1]
                program.partners.update({opened: index, index: opened})
        if stack:
            self.flow.line = stack[-1][1] + 1
            raise InputError(f"{stack[-1][0]} is never closed by {OPENING[stack[-1][0]]}")
        self.flow.line = here

    def _declare(self, text: str) -> None:
        """Carry out DEF."""
        kind, rest = match_form(DECLARE, text, "declaration").groups()
        item = r"([A-Z_$][\w]*)\s*(?:\[[^\]]*\])?\s*(?:=\s*((?:\"[^\"]*\"|[^,(]|\([^)]*\))+))?"
        for variable, value in re.findall(item, rest):
            if variable == "SET" or kind.startswith(("STRING", "CHAR", "AXIS", "FRAME")):
                self.it.unknown[variable] = f"line {self.flow.line} declares it as {kind}"
                self.values.names.discard(variable)
                continue
            self.values.names.add(variable)
            if value and not value.lstrip().startswith(("SET", '"')):
                self.values.numbers[variable, ()] = self.evaluate(value)

    def run_flow(self, word: str, text: str, raw: str, program: CncProgram, index: int) -> int:
        """Carry out a statement of control; return the next line, -1 at the end."""
        rest = text[len(word) :].strip()
        if word in ("RET", "ENDPROC"):
            return END
        if word in REFUSED:
            raise InputError(f"{word} {rest[:24]!r} is not read; write the program out in the CAM system")
        if word == "MSG" and (told := re.search(r'MSG\s*\(\s*"([^"]*)"', raw, re.IGNORECASE)):
            self.it.log.happen("comment", self.flow.line, text=told.group(1))
        elif word == "DEF":
            self._declare(text)
        if word in ("MSG", "DEF", "PROC", "EXTERN"):
            return index + 1
        if word == "IF" and "GOTO" in rest:
            condition, how, label = match_form(GOTO, rest, "IF: IF .. GOTOF label").groups()
            return self._find_goto(how, label, program, index) if self.evaluate(condition) else index + 1
        if word == "IF":
            other = program.alternatives.get(index, program.partners[index])
            return index + 1 if self.evaluate(rest) else other + 1
        if word == "ELSE" and index in program.alternatives:
            return program.partners[program.alternatives[index]] + 1
        if word in ("WHILE", "UNTIL"):
            return index + 1 if self.evaluate(rest) else program.partners[index] + 1
        if word in ("ENDWHILE", "ENDLOOP", "ENDFOR"):
            return program.partners[index]
        if word == "FOR":
            name, first, last = match_form(r"([A-Z_]\w*)\s*=\s*(.+?)\s+TO\s+(.+)", rest, "FOR: FOR I = 1 TO 5").groups()
            key, counting = find_key(name), self.flow.call.counting
            self.values.names |= {name} if key[0] != "R" else set()
            value = self.values.numbers[key] + 1.0 if index in counting else self.evaluate(first)
            self.values.numbers[key] = counting[index] = value
            return program.partners[index] + 1 if value > self.evaluate(last) else index + 1
        if word.startswith("GOTO"):
            return self._find_goto(word, rest, program, index)
        if word in ("REPEAT", "REPEATB") and rest:  # from the label to here, P times more
            pattern = r"([A-Z_]\w*)(?:\s*P\s*=?\s*(.+))?" if word == "REPEAT" else "(?!)"
            label, times = match_form(pattern, rest, "REPEAT: REPEAT label P=n").groups()
            start = self._find_goto("GOTOB", label, program, index)
            return start if self.flow.repeat(index, lambda: self.evaluate(times or "1")) else index + 1
        return index + 1

    def _find_goto(self, how: str, label: str, program: CncProgram, index: int) -> int:
        """Return the line of a label or block number, forwards (GOTOF), backwards (GOTOB), or both."""
        label = label.strip()
        number = label.removeprefix("N").strip()
        places = (program.labels or {}).get(label, [])
        if number.isdigit():
            block = re.compile(rf"\s*[N:]\s*0*{int(number)}(?!\d)", re.IGNORECASE)
            places = [at for at in range(program.first, program.last) if block.match(program.lines[at])]
        ahead = [at for at in places if at > index and how != "GOTOB"]
        behind = [at for at in places if at <= index and how != "GOTOF"]
        if ahead or behind:
            return ahead[0] if ahead else behind[-1]
        if how == "GOTOC":
            return index + 1
        raise InputError(f"{how} {label[:24]}: this label does not stand {'before' if how == 'GOTOB' else 'after'} it")


def strip(raw: str) -> str:
    """Return a line in capitals without comment, number and marks."""
    body = cut_comment(raw)[0].upper()
    found = BLOCK_NUMBER.match(body)
    return body[found.end() :] if found else body
