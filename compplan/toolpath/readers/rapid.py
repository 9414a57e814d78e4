"""ABB RAPID programs (.mod): MoveL, MoveC and MoveJ to robtargets in a work object."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.lines import LONGEST_LINE, count_lines, split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.robot_moves import NUMBER, RobotProgram, check_coordinate, make_pose, split_fields

name = "rapid"
suffixes = (".mod", ".modx", ".prg", ".sys")

OPENS, CLOSES = re.compile(r"(IF|FOR|WHILE|TEST)\b"), re.compile(r"(ENDIF|ENDFOR|ENDWHILE|ENDTEST)\b")
PROC = re.compile(r"(?:LOCAL\s+)?PROC\s+(\w+)\s*\(")
DATA = re.compile(
    r"(?:LOCAL\s+|TASK\s+)?(?:CONST|PERS|VAR)\s+(ROBTARGET|WOBJDATA|SPEEDDATA|JOINTTARGET|TOOLDATA)\s+(\w+)\s*:=\s*(.+)$"
)
MOVE = re.compile(r"(MOVE(?:L|J|C)(?:DO|SYNC|AO|GO)?|TRIGG[LJC]|MOVEABSJ|MOVEEXTJ)\s*\\?\s*(.*)$")
ASSIGN = re.compile(r"(\w+)\s*([.{].*?)?\s*:=\s*(.+)$")
#: Statements that set a signal, wait or stop, and those that a program of another language cannot repeat.
SWITCHES = {
    "output": re.compile(
        r"(?:(?P<on>SET|RESET)\s+|SETDO\s*(?:\\[^,]*,)?\s*)(?P<signal>\w+)(?(on)|\s*,\s*(?P<level>[01]))$"
    ),
    "wait": re.compile(rf"WAITTIME\s*(?:\\INPOS\s*,)?\s*({NUMBER})$"), "halt": re.compile(r"STOP\b"),
    "asked": re.compile(r"(WAIT\w*|SET[A-Z]O\w*|SET|RESET|PULSEDO|INVERTDO|TRIGGIO|TRIGGEQUIP|TRIGGINT)\b"),
}  # fmt: skip
#: Number by which two robots move together (\\ID:=20), after a target.
POINT_ID = re.compile(r"\\\s*ID\s*:=\s*\w+")
VELSET = re.compile(rf"VELSET\s+({NUMBER})\s*,\s*({NUMBER})$")
#: Statements that move the tool, or the frames that it moves in, in ways that are not read.
REFUSED = re.compile(r"((SEARCH[LC]|ARC\w+|SPOT\w*|PAINT\w*|CORRCON|PDISP\w+|EOFFS\w+|GOTO)\b|CSS\w+ACT|%|CALLBYVAR)")
SILENT = re.compile(
    r"(CONST|PERS|VAR|LOCAL|TASK|CONF[LJ]|ACCSET|VELSET|SINGAREA|WAIT\w*|SET\w*|RESET|TP\w+|PULSEDO|STOP|EXIT\w*|RETURN|"
    r"CLK\w+|GRIPLOAD|PATHACCLIM|WORLDACCLIM|MOTIONSUP|ACTUNIT|DEACTUNIT|INCR|DECR|ISIGNAL\w+|CONNECT|IDELETE|OPEN|CLOSE|"
    r"WRITE|USE\w*|RECORD|ENDRECORD|TRIGGIO|TRIGGEQUIP|MODULE|ENDMODULE|PROC|ENDPROC|ERROR|RAISE|RETRY|TRYNEXT)\b"
)

#: Lines that end without a semicolon.
BARE = re.compile(
    r"(MODULE|ENDMODULE|(LOCAL\s+)?(PROC|FUNC|TRAP|RECORD)|END(PROC|FUNC|TRAP|RECORD|IF|FOR|WHILE|TEST)|ELSE(IF)?|IF|FOR|"
    r"WHILE|TEST|CASE|DEFAULT|ERROR|UNDO|BACKWARD)\b"
)


def recognise(text: str) -> bool:
    """Tell whether a text of unknown suffix is RAPID."""
    head = r"^[ \t]*(%%%|MODULE[ \t]+\w+|PROC[ \t]+\w+[ \t]*\()"
    return re.search(head, text, re.MULTILINE | re.IGNORECASE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a RAPID module: its procedure main, or the first one, with those of the module that it calls.

    The path stands in the work object of the first move. MoveJ moves are rapid.
    """
    reader = _RapidReader(file, options)
    reader.run(text)
    return reader.robot.log.finish(file, "rapid", "mm", count_lines(text))


def split_statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield statements in capitals, text in quotes left out, with the line that each begins in."""
    pending, first = "", 0
    for number, raw in enumerate(split_lines(text), start=1):
        line = re.sub(r'"[^"]*"', '""', raw) if '"' in raw else raw
        if not pending.strip() and raw.lstrip().startswith("!"):
            yield number, raw.strip()
            continue
        line = line.partition("!")[0].upper()
        if line.replace('""', "").count('"'):
            raise ValueError(f'line {number}: a quote (") is opened and never closed')
        if not pending.strip():
            first = number
            if re.match(r"\s*(%%%|VERSION:|LANGUAGE:)", line):
                continue
        if not pending.strip() and BARE.match(line.strip()) and ";" not in line:
            yield number, " ".join(line.split())
            continue
        *whole, rest = (pending + " " + line).split(";")
        for statement in whole:
            if statement.strip():
                yield first, " ".join(statement.split())
            first = number
        pending = rest
        if len(pending) > LONGEST_LINE:
            raise ValueError(f"statement of more than {LONGEST_LINE} characters in line {first}; no more are read")
    if pending.strip():
        yield first, " ".join(pending.split())


class _RapidReader:
    """Follow a module statement by statement."""

    def __init__(self, file: Path, options: CamTable) -> None:
        self.options, self.robot = options, RobotProgram(file, options)
        self.data: dict[tuple[str, str], str] = {}
        self.flow, self.note = self.robot.flow, self.robot.note
        self.flow.run_line = self._run_line
        self.tool = ""
        self.external: Sequence[float] = ()
        self.share, self.fastest = 1.0, math.inf

    def run(self, text: str) -> None:
        """Carry out main, or the first procedure."""
        loose: list[tuple[int, str]] = []
        programs: dict[str, list[tuple[int, str]]] = {}
        current = loose
        try:
            for line, statement in split_statements(text):
                head = PROC.match(statement)
                if head:
                    current = programs.setdefault(head.group(1), [])
                elif statement.startswith("ENDPROC"):
                    current = loose
                else:
                    current.append((line, statement))
                    if found := DATA.match(statement):
                        self.data[found.group(1), found.group(2)] = found.group(3)
        except ValueError as fault:
            raise InputError(str(fault), file=self.flow.file) from None
        for called, lines in programs.items():
            self.flow.programs[called] = CncProgram(lines, 0, len(lines), self.flow.file)
        lines = programs.get("MAIN") or next(iter(programs.values()), loose)
        with self.flow.guard():
            self.flow.run(CncProgram(lines, 0, len(lines), self.flow.file))

    def _run_line(self, program: CncProgram, index: int) -> int:
        """Carry out a statement; return the next one, or END."""
        self.flow.line, statement = program.lines[index]
        ends = re.match(r"(ERROR|UNDO|BACKWARD)\b", statement) or self._carry_out(statement)
        return END if ends else index + 1

    def _carry_out(self, statement: str) -> bool:
        """Carry out a statement; return whether the procedure ends."""
        if statement.startswith("!"):
            self.robot.log.happen("comment", self.flow.line, text=statement[1:].strip())
        elif OPENS.match(statement):
            self.robot.blocks += 0 if re.match(r"IF\b(?!.*\bTHEN$)", statement) else 1
            if "MOVE" in statement:
                raise InputError(f"{statement[:30]!r} holds a move in a branch; write the moves out in a row")
            if re.search(r"\b(SETDO|SET|RESET|PULSEDO|STOP)\b", statement):
                self.robot.ask(statement)
        elif CLOSES.match(statement):
            self.robot.blocks = max(0, self.robot.blocks - 1)
        elif MOVE.match(statement):
            self.robot.check_row(statement)
            self._move(*MOVE.match(statement).groups())  # type: ignore[union-attr]
        elif REFUSED.match(statement):
            raise InputError(f"{statement.split()[0][:20]} is not read and may move the tool or its frame")
        elif self._switch(statement) or self._assign(statement):
            pass
        elif re.match(r"(RETURN|EXIT)\b", statement) and not self.robot.blocks:
            return True
        elif (called := statement.split()[0]) in self.flow.programs:
            self.robot.call(called, called)
        elif not SILENT.match(statement) and not statement.startswith("ELSE"):
            self.note(f"statement {statement.split()[0][:20]} is not read")
            self.robot.ask(statement)
        return False

    def _switch(self, statement: str) -> bool:
        """Carry out a statement that waits, stops or sets a signal or the speed; return whether it is one."""
        if statement.startswith("VELSET"):
            velset = VELSET.match(statement)
            if velset is None or self.robot.blocks:
                raise InputError(f"{statement[:30]!r} changes the speed and is not read, expected two numbers in a row")
            self.share, self.fastest = float(velset.group(1)) / 100.0, float(velset.group(2))
            return True
        return self.robot.switch(statement, SWITCHES)

    def _assign(self, statement: str) -> bool:
        """Carry out an assignment; return whether it is one."""
        found = ASSIGN.match(statement)
        if not found:
            return False
        name, part, value = found.groups()
        kind = next((kind for kind in ("ROBTARGET", "WOBJDATA", "SPEEDDATA") if (kind, name) in self.data), None)
        if kind is not None:
            if part or self.robot.blocks or not value.startswith("["):
                raise InputError(f"{name} changes on the way ({statement[:30]}) and is not read; write the values out")
            self.data[kind, name] = value
        elif ("TOOLDATA", name) in self.data:
            self.robot.note_tool()
        return True

    def _move(self, word: str, rest: str) -> None:
        if word in ("MOVEABSJ", "MOVEEXTJ"):
            self.robot.lose()
            return
        fields = split_fields(POINT_ID.sub("", re.sub(r"^\s*CONC\s*,", "", rest)))
        circle = word.startswith(("MOVEC", "TRIGGC"))
        count = 2 if circle else 1
        if len(fields) < count + 3:
            raise InputError(f"{word} with {len(fields)} arguments, expected target, speed, zone and tool")
        switches = " ".join(fields)
        if re.search(r"\\T\s*:=", switches):
            raise InputError(f"{word} with a time (\\T) is not read; give it a speed")
        found = re.search(r"\\WOBJ\s*:=\s*(\w+)", switches)
        wobj = found.group(1) if found else "WOBJ0"
        if wobj != self.robot.frame_name:
            self.robot.use_frame(wobj, self._work_object(wobj), "work object")
            self.robot.placed = True
        tool = fields[min(count + 2 + word.startswith("TRIGG"), len(fields) - 1)].partition("\\")[0].strip()
        if self.tool and tool != self.tool:
            self.robot.note_tool()
        self.tool = tool
        poses = [self._target(field) for field in fields[:count]]
        if word.startswith(("MOVEJ", "TRIGGJ")):
            self.robot.rapid(poses[0])
        elif circle:
            self.robot.circle(poses[0][:3, 3], poses[1], self._speed(fields[2]))
        elif fields[1].strip() == "VMAX":
            self.note("straight moves at vmax are read as rapid ones")
            self.robot.rapid(poses[0])
        else:
            self.robot.straight(poses[0], self._speed(fields[1]))
        if word.startswith("TRIGG") or word[5:] in ("SYNC", "AO", "GO"):
            self.robot.ask(f"{word} {','.join(fields[count + 1 :])}")
        elif word.endswith("DO") and len(fields) >= count + 5:
            state = float(fields[-1].strip() not in ("0", "LOW"))
            self.robot.log.happen("output", self.flow.line, value=state, text=fields[-2].strip())

    def _work_object(self, wobj: str) -> Array | None:
        """Return the place of a work object, None where the module does not say it."""
        if wobj == "WOBJ0":
            return np.eye(4)
        text = self.data.get(("WOBJDATA", wobj))
        if text is None:
            return None
        fields = split_fields(text.strip()[1:-1])
        if len(fields) != 5:
            raise InputError(f"work object {wobj} has {len(fields)} parts, expected 5")
        if fields[0].strip() == "TRUE":
            raise InputError(f"work object {wobj} is held by the robot, which is not read")
        if fields[1].strip() == "FALSE":
            self.note(f"work object {wobj} moves with another unit: the path is taken in it as it is written")
            return None
        user, thing = (self._pose(field, 2) for field in fields[3:])
        return user @ thing

    def _target(self, field: str) -> Array:
        """Return the pose of a robtarget: written out, by name, or Offs(target, x, y, z)."""
        field = field.strip()
        for word, pattern in (("Offs", r"OFFS\s*\((.*)\)"), ("RelTool", r"RELTOOL\s*\(([^\\]*)\)")):
            if not (found := re.fullmatch(pattern, field)):
                continue
            parts = split_fields(found.group(1))
            if len(parts) != 4:
                raise InputError(f"{word} with {len(parts)} arguments, expected target, x, y, z")
            pose, step = self._target(parts[0]), np.array([self._coordinate(part) for part in parts[1:]])
            pose[:3, 3] += step if word == "Offs" else pose[:3, :3] @ step
            return pose
        if not field.startswith("["):
            if ("ROBTARGET", field) not in self.data:
                raise InputError(f"target {field[:32]!r} is not known in this module")
            field = self.data["ROBTARGET", field].strip()
        parts = split_fields(field[1:-1])
        if len(parts) == 4:
            external = [self._number(part) for part in split_fields(parts[3].strip()[1:-1])]
            if self.external and any(abs(a - b) > 1e-6 for a, b in zip(external, self.external, strict=False)):
                self.note("external axes move: the path is taken in the work object as it is written")
            self.external = external
        return self._pose(field, 4)

    def _pose(self, field: str, count: int) -> Array:
        """Return the pose of [[x, y, z], [q1, q2, q3, q4], ...]."""
        field = field.strip()
        parts = split_fields(field[1:-1]) if field.startswith("[") and field.endswith("]") else []
        inside = [part.strip() for part in parts[:2]]
        if len(parts) != count or not all(part.startswith("[") and part.endswith("]") for part in inside):
            raise InputError(f"pose {field[:30]!r} is not read, expected [[x, y, z], [q1, q2, q3, q4], ..]")
        place = [self._coordinate(word) for word in split_fields(inside[0][1:-1])]
        turn = [self._number(word) for word in split_fields(inside[1][1:-1])]
        if len(place) != 3 or len(turn) != 4:
            raise InputError(f"pose has {len(place)} coordinates and {len(turn)} of a quaternion, expected 3 and 4")
        size = float(np.linalg.norm(turn))
        if not abs(size - 1.0) <= 1e-2:
            raise InputError(f"quaternion {turn} has length {size:.4g}, expected 1")
        return make_pose(np.array(place), Rotation.from_quat([*turn[1:], turn[0]]).as_matrix())

    def _number(self, word: str) -> float:
        if not re.fullmatch(NUMBER, word.strip()):
            raise InputError(f"{word.strip()[:24]!r} is no number; write the program out")
        return float(word)

    def _coordinate(self, word: str) -> float:
        number = self._number(word)
        return check_coordinate(number, f"{number:g} mm")

    def _speed(self, field: str) -> float:
        """Return the speed of the tip in mm/s, after VelSet."""
        return min(self._programmed_speed(field) * self.share, self.fastest)

    def _programmed_speed(self, field: str) -> float:
        r"""Return the speed of the tip in mm/s: v100, [v, ..], a name, or what \V says."""
        override = re.search(rf"\\V\s*:=\s*({NUMBER})\s*(?:\\|$)", field)
        if override:
            return float(override.group(1))
        field = field.partition("\\")[0].strip()
        text = self.data.get(("SPEEDDATA", field), field).strip()
        if text.startswith("["):
            return self._number(split_fields(text[1:-1])[0])
        found = re.fullmatch(r"V(\d+)", text)
        if not found and self.options.feed_mm_s is not None:
            self.note(f"speed {field[:24]!r} is not known here")
            return 0.0
        if not found:
            hint = "expected v100 or data of this module; state it with feed_mm_s (--feed)"
            raise InputError(f"speed {field[:24]!r} is not known, {hint}")
        return float(found.group(1))
