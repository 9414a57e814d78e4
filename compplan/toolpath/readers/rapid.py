"""Reader of ABB RAPID programs (.mod): MoveL, MoveC and MoveJ to robtargets in a work object."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.robot.pose import build_pose
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.lines import LONGEST_LINE, count_lines, split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.robot_moves import NUMBER, Match, RobotProgram, Rule, split_fields

name = "rapid"
suffixes = (".mod", ".modx", ".prg", ".sys")

PROC = re.compile(r"(?:LOCAL\s+)?PROC\s+(\w+)\s*\(")
DATA = re.compile(
    r"(?:LOCAL\s+|TASK\s+)?(?:CONST|PERS|VAR)\s+(ROBTARGET|WOBJDATA|SPEEDDATA|JOINTTARGET|TOOLDATA)\s+(\w+)\s*:=\s*(.+)$"
)
#: Identifier of synchronised motion (\\ID:=20), after a target.
POINT_ID = re.compile(r"\\\s*ID\s*:=\s*\w+")
NUMBERS = re.compile(NUMBER)
#: Forms of data, # for a number: pose, target (any configuration), displacement, speed (first number), work object.
POSE = r"\[\[#,#,#\],\[#,#,#,#\]"
TARGET, STEP, SPEED = POSE + r",\[[^\[\]]*\],\[#,#,#,#,#,#\]\]", "#,#,#", r"\[#(,.*)?\]"
OBJECT = rf'\[(FALSE|TRUE),(FALSE|TRUE),"",{POSE}\],{POSE}\]\]'
#: Lines without a semicolon at the end.
BARE = re.compile(
    r"(MODULE|ENDMODULE|(LOCAL\s+)?(PROC|FUNC|TRAP|RECORD)|END(PROC|FUNC|TRAP|RECORD|IF|FOR|WHILE|TEST)|ELSE(IF)?|IF|FOR|"
    r"WHILE|TEST|CASE|DEFAULT|ERROR|UNDO|BACKWARD)\b"
)


def recognise(text: str) -> bool:
    """Return whether a text is a RAPID program."""
    head = r"^[ \t]*(%%%|MODULE[ \t]+\w+|PROC[ \t]+\w+[ \t]*\()"
    return re.search(head, text, re.MULTILINE | re.IGNORECASE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a RAPID module: its procedure main, or the first one, with the procedures of the module that it calls.

    The path is in the work object of the first move. MoveJ moves are rapid.
    """
    reader = _RapidReader(file, options)
    reader.run(text)
    return reader.robot.log.finish(file, "rapid", "mm", count_lines(text))


def split_statements(text: str, file: Path) -> Iterator[tuple[int, str]]:
    """Yield statements in capitals, without quoted text, with the first line of each."""
    pending, first = "", 0
    for number, raw in enumerate(split_lines(text), start=1):
        line = re.sub(r'"[^"]*"', '""', raw).partition("!")[0].upper()
        if line.replace('""', "").count('"'):
            raise InputError('a quote (") is opened and never closed', file=file, where=number)
        if not pending:
            first = number
            if raw.lstrip().startswith("!"):
                yield number, raw.strip()
                continue
            if re.match(r"\s*(%%%|VERSION:|LANGUAGE:)", line):
                continue
            line += ";" if BARE.match(line.strip()) and ";" not in line else ""
        *whole, pending = f"{pending} {line}".split(";")
        for statement in filter(None, (" ".join(part.split()) for part in whole)):
            yield first, statement
            first = number
        pending = pending.strip()
        if len(pending) > LONGEST_LINE:
            raise InputError(
                f"statement of more than {LONGEST_LINE} characters; no more are read", file=file, where=first
            )
    if pending:
        yield first, " ".join(pending.split())


def read_numbers(text: str, form: str) -> Array:
    """Return the numbers of data of a given form; refuse data of another form. Shape (n,)."""
    plain = "".join(text.split())
    if not re.fullmatch(form, NUMBERS.sub("#", plain)):
        expected = form.replace("\\", "").replace("[^[]]*", "..")
        raise InputError(f"{text.strip()[:40]!r} is not read, expected numbers as {expected}")
    numbers = np.array([float(number) for number in NUMBERS.findall(plain)])
    if not np.isfinite(numbers).all():
        raise InputError(f"a number of {text.strip()[:40]!r} is too great")
    return numbers


def read_pose(numbers: Array) -> Array:
    """Return the pose of a position [mm] and a quaternion, scalar first. Shape (7,) -> (4, 4)."""
    size = float(np.linalg.norm(numbers[3:]))
    if not abs(size - 1.0) <= 1e-2:
        raise InputError(f"quaternion {numbers[3:]} has length {size:.4g}, expected 1")
    return build_pose(numbers[:3], Rotation.from_quat(numbers[[4, 5, 6, 3]]).as_matrix())


class _RapidReader:
    """Interpret a module statement by statement."""

    def __init__(self, file: Path, options: CamTable) -> None:
        self.options = options
        self.robot = robot = RobotProgram(file, options)
        self.data: dict[tuple[str, str], str] = {}
        self.flow, self.note = robot.flow, robot.note
        self.flow.run_line = self._run_line
        self.tool = ""
        self.external: Array = np.empty(0)
        self.speed_override, self.speed_limit = 1.0, math.inf
        #: Rules of statements; a result END ends the procedure.
        self.rules: list[Rule] = [(re.compile(pattern), run) for pattern, run in (
            (r"!(.*)", lambda found: robot.log.add_event("comment", text=found.group(1).strip())),
            (r"(ERROR|UNDO|BACKWARD)\b", lambda found: END),
            (r"(RETURN|EXIT)\b", lambda found: 0 if robot.blocks else END),
            (r"(IF|FOR|WHILE|TEST)\b", self._branch), (r"END(IF|FOR|WHILE|TEST)\b", robot.count_block),
            (r"(MOVE(?:L|J|C)(?:DO|SYNC|AO|GO)?|TRIGG[LJC]|MOVEABSJ|MOVEEXTJ)\s*\\?\s*(.*)$", self._move),
            (r"((SEARCH[LC]|ARC\w+|SPOT\w*|PAINT\w*|CORRCON|PDISP\w+|EOFFS\w+|GOTO)\b|CSS\w+ACT|%|CALLBYVAR)",
             robot.refuse),
            (r"VELSET\s*(.*)$", self._limit_speed),
            (r"(?:(?P<on>SET|RESET)\s+|SETDO\s*(?:\\[^,]*,)?\s*)(?P<signal>\w+)(?(on)|\s*,\s*(?P<level>[01]))$",
             robot.switch("output")),
            (rf"WAITTIME\s*(?:\\INPOS\s*,)?\s*(?P<time>{NUMBER})$", robot.switch("dwell")),
            (r"STOP\b", robot.switch("stop")),
            (r"(WAIT\w*|SET[A-Z]O\w*|SET|RESET|PULSEDO|INVERTDO|TRIGGIO|TRIGGEQUIP|TRIGGINT)\b", robot.add_call_event),
            (r"(\w+)\s*([.{].*?)?\s*:=\s*(.+)$", self._assign),
            (r"(CONST|PERS|VAR|LOCAL|TASK|CONF[LJ]|ACCSET|SINGAREA|TP\w+|EXIT\w*|RETURN|CLK\w+|GRIPLOAD|PATHACCLIM|"
             r"WORLDACCLIM|MOTIONSUP|ACTUNIT|DEACTUNIT|INCR|DECR|ISIGNAL\w+|CONNECT|IDELETE|OPEN|CLOSE|WRITE|USE\w*|"
             r"RECORD|ENDRECORD|MODULE|ENDMODULE|PROC|ENDPROC|RAISE|RETRY|TRYNEXT|ELSE\w*)\b", None),
            (r"\S+", self._call),
        )]  # fmt: skip

    def run(self, text: str) -> None:
        """Execute main, or the first procedure, or all statements of a text without procedures."""
        programs: dict[str, list[tuple[int, str]]] = {"": []}
        current = ""
        for line, statement in split_statements(text, self.flow.file):
            if head := PROC.match(statement):
                current = head.group(1)
                programs.setdefault(current, [])
            elif statement.startswith("ENDPROC"):
                current = ""
            else:
                programs[current].append((line, statement))
                if found := DATA.match(statement):
                    self.data[found.group(1), found.group(2)] = found.group(3)
        for called, lines in programs.items():
            self.flow.programs[called] = CncProgram(lines, 0, len(lines), self.flow.file)
        first = "MAIN" if "MAIN" in programs else next(filter(None, programs), "")
        with self.flow.guard():
            self.flow.run(self.flow.programs[first])

    def _run_line(self, program: CncProgram, index: int) -> int:
        """Execute a statement; return the index of the next one, or END."""
        self.flow.line, statement = program.lines[index]
        return END if self.robot.run_statement(statement, self.rules) == END else index + 1

    def _branch(self, found: Match) -> None:
        """Begin a loop or a branch, or a conditional statement (IF without THEN)."""
        statement = found.string
        if found.group(1) != "IF" or statement.endswith(" THEN"):
            self.robot.count_block(found)
        if "MOVE" in statement or not self.flow.programs.keys().isdisjoint(re.findall(r"\w+", statement)):
            raise InputError(f"{statement[:30]!r} holds a move or a call in a branch; write the moves out in a row")
        if re.search(r"\b(SETDO|SET|RESET|PULSEDO|STOP)\b", statement):
            self.robot.add_call_event(statement)

    def _call(self, found: Match) -> None:
        """Execute a procedure of the module; note other statements."""
        called, statement = found.group(), found.string
        if called in self.flow.programs:
            self.robot.call(called, called)
            return
        self.note(f"statement {called[:20]} is not read")
        self.robot.add_call_event(statement)

    def _limit_speed(self, found: Match) -> None:
        """Set the speed override [%] and the speed limit [mm/s] of VelSet."""
        numbers = re.fullmatch(rf"({NUMBER})\s*,\s*({NUMBER})", found.group(1))
        if numbers is None or self.robot.blocks:
            raise InputError(f"{found.string[:30]!r} changes the speed and is not read, expected two numbers in a row")
        self.speed_override, self.speed_limit = float(numbers.group(1)) / 100.0, float(numbers.group(2))

    def _assign(self, found: Match) -> None:
        """Execute an assignment to a robtarget, work object or speed; note a change of tool data."""
        name, part, value = found.groups()
        kind = next((kind for kind in ("ROBTARGET", "WOBJDATA", "SPEEDDATA") if (kind, name) in self.data), None)
        if kind is not None:
            if part or self.robot.blocks or not value.startswith("["):
                raise InputError(f"{name} changes on the way ({found.string[:30]}) and is not read; write its values")
            self.data[kind, name] = value
        elif ("TOOLDATA", name) in self.data:
            self.robot.note_tool()

    def _move(self, statement: Match) -> None:
        self.robot.check_row(statement.string)
        word, rest = statement.groups()
        if word in ("MOVEABSJ", "MOVEEXTJ"):
            self.robot.forget_pose()
            return
        fields = split_fields(POINT_ID.sub("", re.sub(r"^\s*CONC\s*,", "", rest)))
        circle = word.startswith(("MOVEC", "TRIGGC"))
        count = 2 if circle else 1
        if len(fields) < count + 3:
            raise InputError(f"{word} with {len(fields)} arguments, expected target, speed, zone and tool")
        switches = " ".join(fields)
        if re.search(r"\\T\s*:=", switches):
            raise InputError(f"{word} with a time (\\T) is not read; remove \\T")
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
            self.robot.add_call_event(f"{word} {','.join(fields[count + 1 :])}")
        elif word.endswith("DO") and len(fields) >= count + 5:
            state = float(fields[-1].strip() not in ("0", "LOW"))
            self.robot.log.add_event("output", value=state, text=fields[-2].strip())

    def _work_object(self, wobj: str) -> Array | None:
        """Return the pose of a work object, None if the module does not state it."""
        if wobj == "WOBJ0":
            return np.eye(4)
        if ("WOBJDATA", wobj) not in self.data:
            return None
        text = self.data["WOBJDATA", wobj]
        numbers, (held, fixed) = read_numbers(text, OBJECT), re.findall("FALSE|TRUE", text)
        if held == "TRUE":
            raise InputError(f"work object {wobj} is held by the robot, which is not read; write the tool's path")
        if fixed == "FALSE":
            self.note(f"work object {wobj} moves with another unit: the path is taken in it as it is written")
            return None
        return read_pose(numbers[:7]) @ read_pose(numbers[7:])

    def _target(self, field: str) -> Array:
        """Return the pose of a robtarget: written out, by name, Offs(target, x, y, z) or RelTool(target, x, y, z)."""
        field = field.strip()
        for word, pattern in (("Offs", r"OFFS\s*\((.*)\)"), ("RelTool", r"RELTOOL\s*\(([^\\]*)\)")):
            if not (found := re.fullmatch(pattern, field)):
                continue
            target, *parts = split_fields(found.group(1))
            pose, step = self._target(target), read_numbers(",".join(parts), STEP)
            pose[:3, 3] += step if word == "Offs" else pose[:3, :3] @ step
            return pose
        if not field.startswith("["):
            if ("ROBTARGET", field) not in self.data:
                raise InputError(f"target {field[:32]!r} is not known in this module")
            field = self.data["ROBTARGET", field]
        numbers = read_numbers(field, TARGET)
        if any(abs(a - b) > 1e-6 for a, b in zip(numbers[-6:], self.external, strict=False)):
            self.note("external axes move: the path is taken in the work object as it is written")
        self.external = numbers[-6:]
        return read_pose(numbers[:7])

    def _speed(self, field: str) -> float:
        r"""Return the speed of the tip in mm/s, limited by VelSet: v100, [v, ..], a name, or the value of \V."""
        override = re.search(rf"\\V\s*:=\s*({NUMBER})\s*(?:\\|$)", field)
        name = field.partition("\\")[0].strip()
        text = self.data.get(("SPEEDDATA", name), name).strip()
        if override:
            speed = float(override.group(1))
        elif text.startswith("["):
            speed = float(read_numbers(text, SPEED)[0])
        elif found := re.fullmatch(r"V(\d+)", text):
            speed = float(found.group(1))
        elif self.options.feed_mm_s is not None:
            self.note(f"speed {name[:24]!r} is not known here")
            speed = 0.0
        else:
            raise InputError(f"speed {name[:24]!r} is not known, expected v100 or data of this module; state it with "
                             "feed_mm_s (--feed)")  # fmt: skip
        return min(speed * self.speed_override, self.speed_limit)
