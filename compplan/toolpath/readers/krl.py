"""KUKA KRL programs (.src, with positions in the .dat beside them): LIN, CIRC, SPLINE and PTP in a base frame.

Statements run in their order, loops whose bounds are numbers pass by pass, programs that are called where they stand.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.lines import count_lines, read_bounded, split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.robot_moves import NUMBER, RobotProgram, check_coordinate, make_pose, split_fields

name = "krl"
suffixes = (".src", ".sub")

ITEM = re.compile(rf"\s*([A-Z]\w*)\s+({NUMBER}|'[BH][0-9A-F]+')\s*(?:,|$)")
AGGREGATE = re.compile(r"\{\s*(?:[A-Z]\w*\s*:)?([^{}]*)\}")
ASSIGN = re.compile(
    r"(?:DECL\s+|GLOBAL\s+|CONST\s+)*(?:[A-Z]\w*\s+)?(\$?[A-Z][\w.]*(?:\[\s*\d+\s*\])?(?:\.\w+)?)\s*=\s*(.+)$"
)
#: What may follow a position: approximation.
ENDING = re.compile(r"(\s*C_[A-Z]+|\s*CA\s.*)*\s*$")
#: Statements that set a signal, wait or stop, and those that a program of another language cannot repeat.
SWITCHES = {
    "output": re.compile(r"(?P<signal>\$OUT\[\d+\])\s*=\s*(?P<on>TRUE|FALSE)$"),
    "wait": re.compile(rf"WAIT\s+SEC\s+({NUMBER})$"), "halt": re.compile("HALT$"),
    "asked": re.compile(r"WAIT\b|PULSE\b|TRIGGER\b|\$A?N?OUT|ANOUT\b"),
}  # fmt: skip
MOTION = re.compile(r"(S?LIN|S?CIRC|S?PTP|SPL|SPLINE|ENDSPLINE|LIN_REL|PTP_REL|CIRC_REL|S\w+_REL)\b")
OPENS = re.compile(r"(IF|FOR|WHILE|LOOP|REPEAT|SWITCH)\b")
CLOSES = re.compile(r"(ENDIF|ENDFOR|ENDWHILE|ENDLOOP|UNTIL|ENDSWITCH)\b")
BAS = re.compile(r"BAS\s*\(\s*#(\w+)\s*,\s*([^)]*)\)")
PLACE, ANGLES, AXES = ("X", "Y", "Z"), ("A", "B", "C"), tuple(f"A{number}" for number in range(1, 7))
EXTERNAL = tuple(f"E{number}" for number in range(1, 7))
#: A loop whose bounds are numbers, a call, the head of a program.
FOR = re.compile(r"FOR\s+([A-Z]\w*)\s*=\s*([-+]?\d+)\s+TO\s+([-+]?\d+)(?:\s+STEP\s+([-+]?\d+))?\s*$")
CALL = re.compile(r"([A-Z_]\w{0,60})\s*\((.*)\)\s*$")
HEAD = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+(\w+)\s*\(")
#: Data of a module that every program of the controller sees; greatest number of data files that are looked into.
PUBLIC = re.compile(r"DEFDAT\s+\w+\s+PUBLIC\b")
SHARED = re.compile(r"(?:DECL\s+)?GLOBAL\s+(?:DECL\s+)?(?:CONST\s+)?\w+\s+(\w+)")
MOST_FILES = 200
#: Statements that say nothing about the path.
SILENT = re.compile(
    r"DECL|INT|REAL|BOOL|CHAR|EXT|INTERRUPT|GLOBAL|WAIT|HALT|CONTINUE|TRIGGER|SIGNAL|RETURN|BRAKE|PULSE|ENDFCT|ENUM|STRUC|"
    r"DEFDAT|ENDDAT|ANOUT|ANIN|CASE|DEFAULT|ELSE|IMPORT|RESUME|CREAD|CWRITE|COPEN|CCLOSE|E6POS|E6AXIS|FRAME|POS|AXIS|"
    r"CHANNEL|CONFIRM|FDAT|LDAT|PDAT|ON_ERROR_PROCEED|TIME_BLOCK|CONST_VEL"
)


def recognise(text: str) -> bool:
    """Tell whether a text of unknown suffix is KRL."""
    head = r"^[ \t]*(&ACCESS|(GLOBAL )?DEF +\w+ *\([^()\r\n]*\)[ \t]*(;.*)?\r?$)"
    return re.search(head, text, re.MULTILINE | re.IGNORECASE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a KRL program: the first one of the file, with those that it calls in the file or beside it.

    The path stands in the base that is in force at the first position. PTP moves are rapid.
    """
    reader = _KrlReader(file, options)
    reader.run(text)
    return reader.robot.log.finish(file, "krl", "mm", count_lines(text))


def read_pose(numbers: Mapping[str, float]) -> Array:
    """Return the pose of X Y Z A B C: R = Rz(A) Ry(B) Rx(C)."""
    turn = Rotation.from_euler("ZYX", [numbers[key] for key in ANGLES], degrees=True)
    return make_pose(np.array([numbers[key] for key in PLACE]), turn.as_matrix())


def clean_line(raw: str) -> str:
    """Return a statement in capitals, without its comment."""
    text = raw.partition(";")[0].strip()
    return "" if text.startswith("&") else text.upper()


def find_beside(file: Path, *suffixes: str) -> Sequence[str]:
    """Return the lines of the file of this name with one of these suffixes, none without any."""
    beside = next((path for suffix in suffixes if (path := file.with_suffix(suffix)).is_file()), None)
    return split_lines(read_bounded(beside)) if beside else ()


class _KrlReader:
    """Follow a program statement by statement."""

    def __init__(self, file: Path, options: CamTable) -> None:
        self.options, self.robot = options, RobotProgram(file, options)
        self.flow, self.note = self.robot.flow, self.robot.note
        self.flow.run_line = self._run_line
        self.feed = 0.0
        #: Speed of the move at hand alone. [mm/s]
        self.own: float | None = None
        #: Positions and frames by name, as texts; values of the counters of loops; the first call that is not read.
        self.positions = {"$NULLFRAME": "{X 0}"}
        self.counters: dict[str, int] = {}
        self.called = ""
        self.last: dict[str, float] = {}
        self.spline: list[Array] | None = None

    def run(self, text: str) -> None:
        """Carry out the first program of the file."""
        self._load_shared(text.upper())
        with self.flow.guard():
            self._load_data(self.flow.file)
            self.flow.run(self._find_programs(split_lines(text), self.flow.file))

    def _load_shared(self, text: str) -> None:
        """Keep the GLOBAL positions of public .dat files beside the program that its text names."""
        own = self.flow.file.stem.lower()
        data = sorted(path for path in self.flow.file.parent.glob("*.[dD][aA][tT]") if path.stem.lower() != own)
        keepers: dict[str, str] = {}
        for path in data[:MOST_FILES]:
            lines = [clean_line(raw) for raw in split_lines(read_bounded(path))]
            if not any(PUBLIC.match(line) for line in lines[:50]):
                continue
            names = {found.group(1) for line in lines if "GLOBAL" in line and (found := SHARED.match(line))}
            names = {name for name in names if re.search(rf"(?<!\w){name}(?!\w)", text)}
            for name in sorted(names & keepers.keys()):
                raise self.flow.error(f"{name} stands in {keepers[name]} and in {path.name}, both public; keep one")
            keepers.update(dict.fromkeys(names, path.name))
            whole = [line for line in lines if "=" in line and re.split(r"[\s\[=.]", line)[0] in names]
            for line in whole + [line for line in lines if "=" in line and "GLOBAL" in line]:
                self._assign(line)
        if keepers:
            files = ", ".join(sorted(set(keepers.values())))
            self.robot.log.note(f"positions of other files are read: {files}", 1)

    def _load_data(self, file: Path) -> None:
        """Keep the positions and frames that the .dat file beside a program declares."""
        for raw in find_beside(file, ".dat", ".DAT"):
            self._assign(clean_line(raw))

    def _find_programs(self, lines: Sequence[str], file: Path) -> CncProgram:
        """Find DEF NAME() in a file; return its first program."""
        first: CncProgram | None = None
        for index, raw in enumerate(lines):
            if "DEF" in raw.upper() and (head := HEAD.match(clean_line(raw))):
                found = self.flow.programs[head.group(1)] = CncProgram(lines, index + 1, len(lines), file)
                first = first or found
        return first or CncProgram(lines, 0, len(lines), file)

    def _run_line(self, program: CncProgram, index: int) -> int:
        """Carry out a statement; return the next one, or END."""
        raw = program.lines[index]
        statement, comment = clean_line(raw), raw.partition(";")[2].strip()
        if comment and not re.match(r"(END)?FOLD\b|%\{", comment, re.IGNORECASE):  # folds are the editor's
            self.robot.log.happen("comment", self.flow.line, text=comment)
        if statement in ("END", "ENDFCT") or (statement == "RETURN" and not self.robot.blocks):
            return END
        if self.counters:
            statement = self._fill_in(statement)
        if statement[:3] == "FOR" and not self.robot.blocks and (loop := FOR.match(statement)):
            return self._run_for(program, index, *loop.groups())
        if statement:
            self._carry_out(statement)
        return index + 1

    def _run_for(self, program: CncProgram, index: int, counter: str, first: str, last: str, step: str | None) -> int:
        """Carry out a loop whose bounds are known, pass by pass; return the next line, or END."""
        by = int(step or 1)
        if by == 0:
            raise InputError("FOR with STEP 0 never ends")
        end, outer = self._find_end(program, index, counter) + 1, self.counters.get(counter)
        for value in range(int(first), int(last) + (1 if by > 0 else -1), by):
            self.counters[counter] = value
            if self.flow.run(CncProgram(program.lines, index + 1, end, program.file)):
                return END
        self.counters.pop(counter, None)
        if outer is not None:
            self.counters[counter] = outer
        return end

    def _find_end(self, program: CncProgram, first: int, counter: str) -> int:
        """Return the line of the ENDFOR of a loop, which neither leaves early nor sets its counter."""
        depth = 0
        for index in range(first, program.last):
            statement = clean_line(program.lines[index])
            depth += statement.startswith("FOR ") - statement.startswith("ENDFOR")
            if depth == 0:
                return index
            if statement == "EXIT" or (index > first and re.match(rf"{counter}\s*=(?!=)", statement)):
                raise InputError(f"the loop ends where {statement[:24]!r} says; write its moves out in a row")
        raise InputError("FOR has no ENDFOR")

    def _fill_in(self, statement: str) -> str:
        """Return a statement with the counters of loops as numbers, where they stand as indices or bounds."""
        for counter, value in self.counters.items():
            place = rf"(?<=\[)\s*{counter}\s*(?=\])|(?<![\w.$\[]){counter}(?![\w.\[])(?!\s*=)"
            statement = re.sub(place, str(value), statement)
        return statement

    def _call(self, statement: str, called: str) -> None:
        """Carry out a program of the file, or NAME.src beside it; note calls of others."""
        programs, file = self.flow.programs, self.flow.file
        for word in (called, called.lower()):
            beside = file.with_name(f"{word}.src")
            if called not in programs:
                self._find_programs(find_beside(beside, ".src", ".SRC"), beside)
        if called not in programs:
            self.called = self.called or f"{statement[:24]} in line {self.flow.line}"
            self.note(f"call of {called[:24]}() is not read: it is neither here nor beside the file")
            self.robot.ask(statement)
            return
        if programs[called].file != file:
            self._load_data(programs[called].file)
        self.robot.call(called, f"{called}()")

    def _carry_out(self, statement: str) -> None:
        if OPENS.match(statement):
            self.robot.blocks += 1
        elif CLOSES.match(statement):
            self.robot.blocks = max(0, self.robot.blocks - 1)
        elif re.match(r"GOTO\b", statement):
            raise InputError("GOTO is not read; write the moves out in a row")
        elif re.match(r"ASY?S?PTP\b|ASYPTP\b", statement):
            raise InputError("ASYPTP (external axes on their own) is not read; write positions with E1 .. E6")
        elif MOTION.match(statement) and not re.match(r"\w+\s*(=|\()", statement):
            self.robot.check_row(statement)
            self._move(statement)
        elif setting := BAS.match(statement):
            self._set_up(*setting.groups())
        elif self.robot.switch(statement, SWITCHES) or self._assign(statement):
            pass
        elif call := None if SILENT.match(statement) else CALL.match(statement):
            self._call(statement, call.group(1))
        elif not SILENT.match(statement) and not statement.endswith(":"):
            self.note(f"statement {statement.split()[0][:20]} is not read")

    def _assign(self, statement: str) -> bool:
        """Carry out an assignment; return whether it is one."""
        found = ASSIGN.match(statement)
        if not found or MOTION.match(statement):
            return False
        target, value = found.groups()
        target = target.replace(" ", "")
        whole, _, part = target.partition(".")
        if target in ("$BASE", "$TOOL", "$IPO_MODE", "$VEL", "$VEL.CP"):
            self._set_system(target, statement, value)
        elif whole in ("$BASE", "$TOOL"):
            raise InputError(f"a part of {whole} is set ({statement[:30]}); write the whole frame")
        elif whole in self.positions:
            self._set_position(whole, part, value)
        elif (target.startswith("BASE_DATA[") or AGGREGATE.match(value)) and target[0] != "$" and not self.robot.blocks:
            self.positions[target] = value
            if target.startswith("BASE_DATA["):
                self._numbers(value)
        return True

    def _set_position(self, name: str, part: str, value: str) -> None:
        """Give a position or a frame that is known another value, or forget it where the value is not known."""
        position = self.positions.pop(name)
        if self.robot.blocks:
            return
        if not part and (AGGREGATE.match(value) or value in self.positions):
            self.positions[name] = self.positions.get(value, value)
        elif part and re.fullmatch(NUMBER, value):
            numbers = {**self._numbers(position), part: float(value)}
            self.positions[name] = "{" + ",".join(f"{key} {number!r}" for key, number in numbers.items()) + "}"

    def _set_system(self, target: str, statement: str, value: str) -> None:
        if self.robot.blocks and target != "$TOOL":
            raise InputError(f"{target} is set in a loop or a branch; write the program out")
        if target == "$BASE":
            self._use_base(value.strip())
        elif target == "$TOOL":
            self.robot.note_tool()
        elif target == "$IPO_MODE" and "TCP" in value:
            raise InputError("$IPO_MODE=#TCP (the part in the robot's hand) is not read")
        elif target.startswith("$VEL") and re.search(r"\bCP\b", statement):
            self.feed = self._read_speed(statement)

    def _read_speed(self, text: str) -> float:
        """Return the speed that a text states [mm/s], 0 where it states none and the user does."""
        speed = re.search(rf"\bCP\s*=?\s*({NUMBER})\s*(?:[,}}]|$)", text)
        if not speed and self.options.feed_mm_s is None:
            raise InputError(f"{text.strip()[:40]!r} sets no speed in m/s; state one with feed_mm_s (--feed)")
        return float(speed.group(1)) * 1e3 if speed else 0.0

    def _set_up(self, word: str, value: str) -> None:
        """Carry out BAS(#word, value)."""
        if word == "VEL_CP":
            if not re.fullmatch(NUMBER, value.strip()):
                raise InputError(f"speed {value!r} is no number")
            self.feed = float(value) * 1e3
        elif word == "BASE":
            self._use_base("$NULLFRAME" if value.strip() == "0" else f"BASE_DATA[{value.strip()}]")
        elif word == "TOOL":
            self.robot.note_tool()

    def _use_base(self, value: str) -> None:
        """Put a base in force; the path stays in the one that was in force at its first position."""
        text = value if value.startswith("{") else self.positions.get(value)
        known = None
        if text is not None:
            known = read_pose({**dict.fromkeys((*PLACE, *ANGLES), 0.0), **self._numbers(text)})
        if self.robot.placed and not (known is None and value == self.robot.frame_name):
            self.last = {}
        self.robot.use_frame(value, known, "base")

    def _numbers(self, text: str) -> dict[str, float]:
        """Return the numbers of {X 1,Y 2,..}."""
        found = AGGREGATE.match(text.strip())
        if not found:
            raise InputError(f"position {text.strip()[:30]!r} is not read, expected {{X 1,Y 2,Z 3,A 0,B 0,C 0}}")
        inside, place = found.group(1).strip(), 0
        numbers: dict[str, float] = {}
        while place < len(inside):
            item = ITEM.match(inside, place)
            if not item or item.group(1) in numbers:
                text = inside[place : place + 20].strip()
                raise InputError(f"position {text!r} is not read, expected numbers by name, each once")
            number = 0.0 if item.group(2).startswith("'") else float(item.group(2))
            numbers[item.group(1)] = check_coordinate(number, item.group(0).strip(" ,"))
            place = item.end()
        return numbers

    def _target(self, text: str) -> dict[str, float]:
        """Return the numbers of a position: written out, or declared by name."""
        text = text.strip()
        if text.startswith("{"):
            end = text.find("}") + 1
            position = text
        else:
            word = re.match(r"\$?[A-Z]\w*(\[\d+\])?", text)
            if not word or word.group(0) not in self.positions:
                raise InputError(f"position {text[:24]!r} is not known here or in the .dat file")
            end, position = word.end(), self.positions[word.group(0)]
        if not ENDING.match(text, end):
            raise InputError(f"{text[end : end + 24].strip()!r} after a position is not read, expected C_DIS and such")
        return self._numbers(position)

    def _read_with(self, extra: str) -> None:
        """Read what holds for one move (WITH): its speed; frames and modes are refused."""
        self.own = None
        for item in split_fields(extra, "{", "}"):
            if re.match(r"\s*\$(BASE|TOOL|IPO_MODE)\b", item):
                raise InputError(f"{item.strip()[:30]!r} for one move is not read; write it as a statement")
            if "$VEL" in item and "CP" in item:
                self.own = self._read_speed(item)

    def _pose(self, numbers: dict[str, float]) -> Array:
        """Return a pose; coordinates that are not named stay."""
        turned = {key: abs(value - self.last.get(key, value)) for key, value in numbers.items() if key in EXTERNAL}
        if max(turned.values(), default=0.0) > 1e-6:
            self.note("external axes move: the path is taken in the base as it is written")
        full = {**self.last, **numbers}
        missing = [key for key in (*PLACE, *ANGLES) if key not in full]
        if missing:
            raise InputError(f"position without {' '.join(missing)}, which nothing before it states")
        self.last, self.robot.placed = full, True
        return read_pose(full)

    def _move(self, statement: str) -> None:
        statement, _, extra = statement.partition(" WITH ")
        kind, rest = re.match(r"(\w+)\s*(.*)$", statement).groups()  # type: ignore[union-attr]
        if extra and kind == "SPL":
            raise InputError("SPL with data of its own (WITH) is not read; give them to the SPLINE")
        if self.spline is None:
            self._read_with(extra)
        poses, joints = self.spline, kind in ("PTP", "SPTP")
        if kind.endswith("_REL"):
            raise InputError(f"{kind} (relative moves) is not read; write absolute positions")
        if kind in ("SPLINE", "ENDSPLINE"):
            self.spline = [] if kind == "SPLINE" else None
            if poses and kind == "ENDSPLINE":
                self.robot.spline(poses, self._speed())
            return
        if (poses is None) == (kind == "SPL"):
            raise InputError(f"{kind} {'outside of' if poses is None else 'within'} SPLINE is not read")
        parts = split_fields(rest, "{", "}")
        named = re.match(r"\$?[A-Z]\w*(\[\w+\])?", parts[0])
        if joints and named and named.group(0) not in self.positions:
            unknown = named.group(0)[:24]
            self.robot.lose(f"joint move to {unknown} is left out: it is not known here or in the .dat file")
            return
        numbers = self._target(parts[0])
        if joints and numbers.keys() & set(AXES):
            self.robot.lose()
        elif joints:
            self.robot.rapid(self._pose(numbers))
        elif kind in ("LIN", "SLIN"):
            self.robot.straight(self._pose(numbers), self._speed())
        elif poses is not None:
            poses.append(self._pose(numbers))
        else:
            self._circle(numbers, parts[1:])

    def _circle(self, via: dict[str, float], parts: list[str]) -> None:
        if not parts:
            raise InputError("circle has no end position")
        middle = np.array([{**self.last, **via}.get(key, math.nan) for key in PLACE])
        if np.isnan(middle).any():
            raise InputError("circle has no middle position")
        words = re.search(rf"\bCA\s*=?\s*({NUMBER})", " ".join(parts))
        angle = math.radians(float(words.group(1))) if words else None
        self.robot.circle(middle, self._pose(self._target(parts[0])), self._speed(), angle=angle)

    def _speed(self) -> float:
        feed = self.feed if self.own is None else self.own
        if feed <= 0.0:
            where = f", {self.called} may set it" if self.called else ""
            self.note(f"cutting moves before any speed $VEL.CP have none{where}; state it with feed_mm_s (--feed)")
        return feed
