"""ABB RAPID modules read a second time as paths: MoveJ, MoveL and MoveC to stated targets, procedures in order."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

import numpy as np

from compplan.controllers.readback.poses import NUMBER, abb_pose
from tests.oracles.cam.moves import Array, CannotTellError, Reading
from tests.oracles.cam.robot_paths import RobotPath

_DATA = re.compile(r"(?:LOCAL\s+|TASK\s+)?(?:CONST|PERS|VAR)\s+(ROBTARGET|SPEEDDATA|WOBJDATA)\s+(\w+)\s*(?::=\s*(.*))?")
_MOVE = re.compile(r"MOVE(ABSJ|J|L|C)(?:DO|AO|GO|SYNC)?\s+(.*)$", re.S)
_OUTLINE = re.compile(
    r"(?:LOCAL\s+)?PROC\s+(\w+)\s*\(\s*\)\s*|ENDPROC\b\s*|ENDMODULE\b\s*|MODULE\s+\w+(?:\s*\([^)]*\))?\s*"
)
#: Statements that move nothing.
SILENT = re.compile(
    r"CONFL|CONFJ|SINGAREA|ACCSET|SETDO|SETAO|SETGO|SET\b|RESET\b|WAITTIME|WAITDI|WAITROB|STOP\b|TPWRITE|TPERASE|EXIT\b|PULSEDO|"
    r"ACTUNIT|DEACTUNIT|GRIPLOAD|CLKSTART|CLKSTOP|CLKRESET|RETURN|INCR|\w+\s*:=|(?:LOCAL\s+|TASK\s+)?(?:CONST|PERS|VAR)\b|"
    r"TOOLDATA|BREAK\b"
)
STEERS = re.compile(r"(?:IF|FOR|WHILE|TEST|GOTO)\b|\w+:$")


@dataclass
class RapidPath:
    """An interpreter of RAPID statements that lead the tool.

    Args:
        path: What they do.

    """

    path: RobotPath
    targets: dict[str, Array] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    objects: dict[str, Array] = field(default_factory=lambda: {"WOBJ0": np.eye(4)})
    procedures: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    calls: int = 0

    def read(self, text: str) -> None:
        """Take in a module and run procedure main, or the only one."""
        inside, first = "", ""
        for line, statement in _cut_statements(text):
            self.path.record.line = line
            while match := _OUTLINE.match(statement):
                if match[1]:
                    inside, first = match[1], first or match[1]
                    self.procedures[inside] = []
                elif statement.startswith("END"):
                    inside = ""
                statement = statement[match.end() :].strip()
            if not statement:
                continue
            if inside:
                self.procedures[inside].append((line, statement))
            elif match := _DATA.match(statement):
                self._define(match[1], match[2], match[3])
        self.run("MAIN" if "MAIN" in self.procedures else first)

    def _define(self, kind: str, name: str, value: str | None) -> None:
        numbers = [] if value is None else [float(text) for text in re.findall(NUMBER, value)]
        if kind == "SPEEDDATA" and numbers:
            self.speeds[name] = numbers[0]
        elif kind == "WOBJDATA" and len(numbers) == 14:
            if value is not None and not re.match(r"\[\s*FALSE\s*,\s*TRUE\s*,", value):
                return  # held by the robot, or carried by a unit
            self.objects[name] = abb_pose(numbers[:3], numbers[3:7]) @ abb_pose(numbers[7:10], numbers[10:14])
        elif kind == "ROBTARGET" and value is not None and len(numbers) >= 11:
            self.targets[name] = abb_pose(numbers[:3], numbers[3:7])

    def run(self, procedure: str) -> None:
        """Run a procedure."""
        self.calls += 1
        if self.calls > 500 or procedure not in self.procedures:
            raise CannotTellError(f"the procedure {procedure}", self.path.record.line)
        for line, statement in self.procedures[procedure]:
            self.path.record.line = line
            if match := _MOVE.match(statement):
                self._move(match[1], match[2])
            elif re.fullmatch(r"\w+", statement) and statement in self.procedures:
                self.run(statement)
            elif (match := _DATA.match(statement)) and match[3]:
                self._define(match[1], match[2], match[3])
            elif STEERS.match(statement) or not SILENT.match(statement):
                raise CannotTellError(f"the statement {statement[:30]!r}", line)
            else:
                self._keep(statement)

    def _keep(self, statement: str) -> None:
        """See that an assignment leaves alone what moves count from."""
        match = re.match(r"(\w+)\s*:=", statement)
        if match and match[1] in {*self.targets, *self.speeds, *self.objects}:
            raise CannotTellError(f"{match[1]} changes on the way", self.path.record.line)

    def _move(self, word: str, rest: str) -> None:
        parts = [part.strip() for part in _split(rest)]
        parts = [re.sub(r"\\(?:CONC|ID:=\w+)$", "", part) for part in parts]
        if word == "ABSJ":
            self.path.pose = None
            return
        count = 2 if word == "C" else 1
        if len(parts) < count + 3 or any(re.match(r"\\(?!WOBJ)", part) for part in parts):
            raise CannotTellError(f"MOVE{word} with {len(parts)} arguments", self.path.record.line)
        options = re.findall(r"\\\s*(\w+)(?:\s*:=\s*([\w.+-]+))?", ",".join(parts[count:]))
        frame, feed = "WOBJ0", None
        for name, value in options:
            if name == "WOBJ":
                frame = value
            elif name == "V":
                feed = float(value)
            elif name not in ("CONC", "Z", "INPOS", "ID"):
                raise CannotTellError(f"MOVE{word} with {name}", self.path.record.line)
        poses = [self.path.place(self._pose(part), self.objects.get(frame), frame) for part in parts[:count]]
        speed = self._speed(parts[count].split("\\")[0].strip()) if feed is None else feed
        if word == "C":
            self.path.circle(poses[0], poses[1], speed)
        else:
            self.path.lead(poses[0], speed, rapid=word == "J")

    def _speed(self, text: str) -> float:
        if text in self.speeds:
            return self.speeds[text]
        if match := re.fullmatch(r"V(\d+)", text):
            return float(match[1])
        if text == "VMAX":
            raise CannotTellError("the speed vmax", self.path.record.line)
        if text.startswith("["):
            return float(re.findall(NUMBER, text)[0])
        raise CannotTellError(f"the speed {text}", self.path.record.line)

    def _pose(self, text: str) -> Array:
        if match := re.fullmatch(r"OFFS\s*\((.*)\)", text, re.S):
            parts = [part.strip() for part in _split(match[1])]
            pose = self._pose(parts[0]).copy()
            pose[:3, 3] += [float(part) for part in parts[1:4]]
            return pose
        if text.startswith("["):
            numbers = [float(number) for number in re.findall(NUMBER, text)]
            if len(numbers) < 11 or re.search(r"[A-DF-Z_]", text):
                raise CannotTellError(f"the target {text[:30]}", self.path.record.line)
            return abb_pose(numbers[:3], numbers[3:7])
        if text not in self.targets:
            raise CannotTellError(f"the target {text[:30]}", self.path.record.line)
        return self.targets[text]


def _split(text: str) -> list[str]:
    """Cut arguments at the commas outside of brackets."""
    parts, depth = [""], 0
    for letter in text:
        depth += {"[": 1, "(": 1, "]": -1, ")": -1}.get(letter, 0)
        if letter == "," and not depth:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _cut_statements(text: str) -> list[tuple[int, str]]:
    """Return statements in capitals, texts and comments stripped, each with the number of its first line."""
    found, kept, first = [], "", 1
    for number, line in enumerate(text.splitlines(), 1):
        bare = re.sub(r'"[^"]*"', '""', line).split("!")[0].strip().upper()
        if not kept and (not bare or bare.startswith("%") or re.match(r"\s*(?:VERSION|LANGUAGE):", bare)):
            continue
        whole = bool(re.fullmatch(
            r"(?:ENDPROC|ENDMODULE|ENDIF|ENDFOR|ENDWHILE|ENDTEST|ELSE|MODULE\s+\w+.*|(?:LOCAL\s+)?PROC\s+\w+\s*\(.*\)|"
            r"(?:IF\b.*\bTHEN|FOR\b.*\bDO|WHILE\b.*\bDO|TEST\b.*))", bare,
        ))  # fmt: skip
        first = first if kept else number
        kept = f"{kept} {bare}".strip()
        while ";" in kept:
            part, _, kept = kept.partition(";")
            found.append((first, part.strip()))
            kept, first = kept.strip(), number
        if whole and kept:
            found.append((first, kept))
            kept = ""
    return found


def read_rapid_path(text: str, *, points: str | None = None, start: list[float] | None = None) -> Reading:
    """Read a RAPID module as a path.

    Args:
        text: The module.
        points: Axis of the TCP frame that points out of the tool.
        start: Where cuts begin whose start the file leaves open. [mm]

    Raises:
        CannotTellError: If something in it is not known here.

    """
    path = RobotPath(points, start)
    try:
        RapidPath(path).read(text)
    except (ValueError, KeyError, IndexError, AssertionError) as error:
        raise CannotTellError(f"{error}", path.record.line) from None
    reading = path.record.finish()
    if not all(math.isfinite(value) for value in reading.end.ravel().tolist()):
        raise CannotTellError("a target that is no place")
    return reading
