"""Lexer and flow control of Sinumerik programs: words with numbers or expressions, variables, labels, jumps, loops."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.expressions import FUNCTIONS, Grammar, evaluate, evaluate_at
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import CncBlock
from compplan.toolpath.readers.lines import DECIMAL, match_form
from compplan.toolpath.readers.lines import cut_comment as cut_after

NUMBER = rf"{DECIMAL}(?:EX[-+]?\d+)?"
LETTER = re.compile(rf"([A-Z])\s*({NUMBER})(?![\d.]|\s*[=(\[])")
NAMED = re.compile(r"([$A-Z_][$\w]*)\s*", re.ASCII)
PLACED = re.compile(r"(AC|IC|DC|ACP|ACN|CAC|CIC|CDC)\s*\(")
BLOCK_NUMBER = re.compile(r"\s*(?:/\d?\s*)?(?:[N:]\s*\d+\s*)?(?:/\d?\s*)?")
LEADING = re.compile(BLOCK_NUMBER.pattern + r"\(([^)]*)\)?(.*)")
LABEL = re.compile(r"([A-Z_][A-Z0-9_]*)\s*:(?!=)\s*", re.ASCII)
#: Comment in brackets after words with numbers.
REMARK = re.compile(rf"(?:^|\s)[A-Z]\s*=?\s*{DECIMAL}\s*(\()", re.IGNORECASE)
QUOTED = re.compile(r'"[^"]*"')
EQUALS = re.compile(r"\s*=\s*(?!=)")
NUMBERED = re.compile(r"([A-Z])(\d{1,4})")
CLOSING = re.compile(r"\s*\)")
#: Words of Sinumerik controls that do not affect the programmed path.
HARMLESS = frozenset((
    "STOPRE", "SOFT", "SOFTA", "BRISK", "BRISKA", "DRIVE", "FFWON", "FFWOF", "COMPON", "COMPOF",
    "COMPCURV", "COMPCAD", "COMPSURF", "UPATH", "SPATH", "ORIWKS", "ORIMKS", "ORIAXES", "ORIVECT", "ORIPLANE",
    "ORIEULER", "ORIRPY", "ORIRPY2", "ORIVIRT1", "ORIVIRT2", "ORIC", "ORID", "ORISON", "ORISOF", "OSC", "OSD", "OST",
    "OSOF", "OSS", "OSSE", "CUT2D", "CUT2DF", "CUT3DC", "CUT3DF", "KONT", "KONTC", "KONTT", "NORM", "CFC", "CFIN",
    "CFTCP", "FNORM", "FLIN", "FCUB", "DIAMOF", "WALIMON", "WALIMOF", "CDON", "CDOF", "CDOF2", "CPRECON",
    "CPRECOF", "RTLION", "RTLIOF", "SBLOF", "SBLON", "DISPLOF", "DISPLON", "SAVE", "FIFOCTRL", "STARTFIFO",
    "STOPFIFO", "FENDNORM", "FENDOFF", "EXTENDED", "GFRAME0", "CYCLE832", "CYCLE_HSC", "DYNNORM", "DYNPOS",
    "DYNROUGH", "DYNSEMIFIN", "DYNFINISH", "PRIO", "SPCON", "SPCOF", "TCARR", "TCOABS", "TCOFR",
))  # fmt: skip
#: Words that change the path or its frame, or call a cycle at every position.
CHANGING = (
    r"A?TRANS|A?ROTS?|A?SCALE|A?MIRROR|MCALL|[ABC]SPLINE|POLY|TRANSMIT|TRACYL|TRAANG|TOFRAME|TOROT|DIAMON|DIAM90|OFFN|CIP|"
    r"INVCC?W|TRAORI|TRAFOOF"
)
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
#: Unsupported control statements.
REFUSED = {
    "CALL", "PCALL", "EXTCALL", "ISOCALL", "GOTOS", "ID", "IDS", "WHEN", "WHENEVER", "EVERY", "DO", "REDEF",
    "DEFINE", "CASE",
}  # fmt: skip
Key = tuple[str, tuple[float, ...]]

GRAMMAR = Grammar(
    functions={
        **FUNCTIONS, "ATAN2": (2, lambda y, x: math.degrees(math.atan2(y, x))), "POT": (1, lambda x: x * x),
        "TRUNC": (1, lambda x: float(math.trunc(x))), "ROUND": (1, lambda x: math.floor(x + 0.5)),
        "ROUNDUP": (1, lambda x: float(math.ceil(x))), "MINVAL": (2, min), "MAXVAL": (2, max),
        "BOUND": (3, lambda low, high, x: min(max(x, low), high)),
    },
    operators={
        "OR": (1, lambda a, b: float(bool(a) or bool(b))), "XOR": (2, lambda a, b: float(bool(a) != bool(b))),
        "AND": (3, lambda a, b: float(bool(a) and bool(b))),
        "==": (4, lambda a, b: float(a == b)), "<>": (4, lambda a, b: float(a != b)),
        "<": (4, lambda a, b: float(a < b)), ">": (4, lambda a, b: float(a > b)),
        "<=": (4, lambda a, b: float(a <= b)), ">=": (4, lambda a, b: float(a >= b)),
        "+": (5, lambda a, b: a + b), "-": (5, lambda a, b: a - b), "*": (6, lambda a, b: a * b),
        "/": (6, lambda a, b: a / b), "DIV": (6, lambda a, b: float(math.trunc(a / b))), "MOD": (6, math.fmod),
    },
)  # fmt: skip


#: Value of an unknown variable in a move that is left out.
UNKNOWN_VALUE = 1e30
#: System variables with a constant value while a program runs.
SYSTEM = {"$PI": math.pi, "TRUE": 1.0, "FALSE": 0.0, "$P_SEARCH": 0.0, "$P_ISTEST": 0.0, "$P_SIM": 0.0,
          "$P_SEARCH1": 0.0, "$P_SEARCH2": 0.0, "$P_DRYRUN": 0.0, "$P_PROGTEST": 0.0}  # fmt: skip


def find_key(name: str, indices: tuple[float, ...] = ()) -> Key:
    """Return the key of a variable: R5 is R[5]."""
    return ("R", (float(name[1:]),)) if name[0] == "R" and name[1:].isdigit() else (name, indices)


class SinumerikBlocks:
    """Words of blocks and variables of a program."""

    def __init__(self, it: Interpreter) -> None:
        self.it = it
        self.numbers: dict[Key, float] = {}
        #: Declared names of variables.
        self.names: set[str] = set()
        self.text, self.place, self.words, self.home = "", 0, CncBlock(), False

    def look_up(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a variable; if unknown, UNKNOWN_VALUE in an omitted move, otherwise a ValueError."""
        if name in SYSTEM:
            return SYSTEM[name]
        name, indices = find_key(name, indices)
        value = self.numbers.get((name, indices), 0.0 if name in self.names else UNKNOWN_VALUE if self.home else None)
        if value is None:
            shown = f"{name}[{', '.join(f'{index:g}' for index in indices)}]" if indices else name
            why = self.it.unknown.get(name, "the program gives it none")
            raise ValueError(f"{shown} has no value that is known: {why}")
        return value

    def assign(self, name: str, indices: tuple[float, ...], value: float | None) -> None:
        """Set a variable, None for a text."""
        if re.match(r"\$P_\w*FR", name):
            raise InputError(f"{name} sets a frame and is not read; use TRANS and ROT")
        if name.startswith("$"):
            self.it.note(f"system variable {name[:24]} is not read")
        elif value is None:
            self.it.unknown[name] = f"line {self.it.flow.line} gives it text"
            self.numbers.pop((name, indices), None)
        else:
            self.numbers[name, indices] = value

    def evaluate(self, text: str) -> float:
        """Return the value of an expression."""
        return evaluate(text, GRAMMAR, self.look_up)

    def split(self, text: str, *, home: bool = False) -> CncBlock:
        """Return the words of a block and execute its assignments; raise a ValueError for other text.

        The block is in capitals, without number, label and comment; `home`: its move is left out.
        """
        self.text, self.place, self.words, self.home = text, 0, CncBlock(), home
        while self.place < len(text):
            if text[self.place] in " \t":
                self.place += 1
            elif found := LETTER.match(text, self.place):
                self.place = found.end()
                self._keep(found.group(1), float(found.group(2).replace("EX", "E")))
            elif found := NAMED.match(text, self.place):
                self.place = found.end()
                self._read_named(found.group(1))
            else:
                raise ValueError(f"cannot read {text[self.place :][:40]!r}, expected words such as X12.5")
        self.home = False
        return self.words

    def _keep(self, address: str, number: float, how: str = "") -> None:
        words = self.words
        words.put(address, number)
        (words.relative if how == "I" else words.absolute if how == "A" else set()).add(address)

    def _read_named(self, name: str) -> None:
        """Read NAME, NAME=.., NAME[..]=.., NAME(..), R1=.., I1=.., A3=.., M1=.., S1=.."""
        text, words = self.text, self.words
        indices: tuple[float, ...] = ()
        if text.startswith("(", self.place):
            inside, self.place = read_brackets(text, self.place)
            words.calls.append((name, inside))
            return
        if text.startswith("[", self.place):
            close = text.find("]", self.place)
            if close < 0:
                raise ValueError(f"']' is missing in {text[:40]!r}")
            inner, self.place = text[self.place + 1 : close], close + 1
            if not re.fullmatch(r"\s*[A-Z]\w*\s*", inner) or inner.strip() in self.names:
                indices = tuple(evaluate_at(part, 0, GRAMMAR, self.look_up)[0] for part in inner.split(","))
        equals, numbered = EQUALS.match(text, self.place), NUMBERED.fullmatch(name)
        if not equals:
            if indices:
                raise ValueError(f"cannot read {name}[ in {text[:40]!r}")
            words.names.append(name)
            return
        self.place = equals.end()
        letter = numbered.group(1) if numbered else name
        if text.startswith('"', self.place):
            found = QUOTED.match(text, self.place)
            if not found:
                raise ValueError('a quote (") is opened and never closed')
            self.place = found.end()
            if letter != "T":
                self.assign(name, indices, None)
        elif name.startswith("$") and re.match(r"[A-Z_$]\w*\s*[(\[]", text[self.place :]):
            self.assign(name, indices, None)
            self.place = len(text)
        elif letter == "R" or name in self.names or name.startswith("$"):
            key = (name, indices) if name in self.names else find_key(name, indices)
            self.assign(*key, self._value()[0])
        elif numbered and letter in "MS":
            self._keep(letter, self._value()[0])
        else:
            self._keep(f"{letter}{int(numbered.group(2))}" if numbered else name, *self._value())

    def _value(self) -> tuple[float, str]:
        """Return a value, and whether it is absolute ("A"), relative ("I") or follows the distance mode ("")."""
        found = PLACED.match(self.text, self.place)
        if found and found.group(1) in ("CAC", "CIC", "CDC"):
            raise ValueError(f"coded positions ({found.group(1)}) are not read")
        value, self.place = evaluate_at(self.text, found.end() if found else self.place, GRAMMAR, self.look_up)
        if not found:
            return value, ""
        closing = CLOSING.match(self.text, self.place)
        if not closing:
            raise ValueError(f"')' is missing in {self.text[:40]!r}")
        self.place = closing.end()
        return value, "I" if found.group(1) == "IC" else "A"


def read_brackets(text: str, place: int) -> tuple[list[str], int]:
    """Return the arguments in the brackets that open at an index, and the index after them."""
    depth, quoted, parts = 0, False, [""]
    for index in range(place, len(text)):
        letter = text[index]
        quoted ^= letter == '"'
        depth += 0 if quoted else (letter in "([") - (letter in ")]")
        if depth == 0:
            return ([] if parts == [""] else [part.strip() for part in parts]), index + 1
        if letter == "," and depth == 1 and not quoted:
            parts.append("")
        elif index > place:
            parts[-1] += letter
    raise ValueError(f"')' is missing in {text[:40]!r}")


def cut_comment(line: str) -> tuple[str, str]:
    """Return a line without its comment, and the comment: after ; or in brackets at its start or after words."""
    comment = ""
    if "(" in line and (leading := LEADING.match(line)):
        comment, line = leading.groups()
    body, told = cut_after(line)
    if "(" in body and (found := REMARK.search(body)):
        told, body = body[found.end() :].rstrip(") ") or told, body[: found.start(1)]
    return body.strip(), (told or comment).strip()


class SinumerikFlow:
    """Flow control of a Sinumerik program."""

    def __init__(self, it: Interpreter, values: SinumerikBlocks) -> None:
        self.it, self.flow, self.values, self.evaluate = it, it.flow, values, values.evaluate

    def find_programs(self, lines: Sequence[str], file: Path) -> CncProgram:
        """Register the programs of a file; return the first main program with code, otherwise the first subprogram."""
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
        """Find the labels and the matching ends of control structures of a program."""
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
        """Execute DEF."""
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
        """Execute a control statement; return the index of the next line, or END."""
        rest = text[len(word) :].strip()
        if word in ("RET", "ENDPROC"):
            return END
        if word in REFUSED:
            raise InputError(f"{word} {rest[:24]!r} is not read; write the program out in the CAM system")
        if word == "MSG" and (told := re.search(r'MSG\s*\(\s*"([^"]*)"', raw, re.IGNORECASE)):
            self.it.log.add_event("comment", text=told.group(1))
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
            if word == "ENDFOR":
                self.flow.call.counting.add(program.partners[index])
            return program.partners[index]
        if word == "FOR":
            name, first, last = match_form(r"([A-Z_]\w*)\s*=\s*(.+?)\s+TO\s+(.+)", rest, "FOR: FOR I = 1 TO 5").groups()
            key, counting = find_key(name), self.flow.call.counting
            self.values.names |= {name} if key[0] != "R" else set()
            value = self.values.numbers[key] + 1.0 if index in counting else self.evaluate(first)
            self.values.numbers[key] = value
            counting.discard(index)
            return program.partners[index] + 1 if value > self.evaluate(last) else index + 1
        if word.startswith("GOTO"):
            return self._find_goto(word, rest, program, index)
        if word in ("REPEAT", "REPEATB") and rest:  # from the label to this line, P more times
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
