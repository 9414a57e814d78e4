"""Reader of KUKA KRL programs (.src, with positions in .dat files): LIN, CIRC and PTP in a base frame.

Statements are executed in their order. FOR loops with numeric bounds and called programs are executed in place.
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
from compplan.robot.pose import build_pose
from compplan.toolpath.readers.cnc.flow import END, CncProgram
from compplan.toolpath.readers.lines import count_lines, match_form, read_bounded, split_lines
from compplan.toolpath.readers.moves import FARTHEST, CamFile
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.robot_moves import NUMBER, Match, RobotProgram, Rule, split_fields

name = "krl"
suffixes = (".src", ".sub")

ITEM = re.compile(rf"\s*([A-Z]\w*)\s+({NUMBER}|'[BH][0-9A-F]+')\s*(?:,|$)")
AGGREGATE = re.compile(r"\{\s*(?:[A-Z]\w*\s*:)?([^{}]*)\}")
ASSIGN = re.compile(
    r"(?:DECL\s+|GLOBAL\s+|CONST\s+)*(?:[A-Z]\w*\s+)?(\$?[A-Z][\w.]*(?:\[\s*\d+\s*\])?(?:\.\w+)?)\s*=\s*(.+)$"
)
#: Position, written out or by name, and its approximation (C_DIS, ..).
TARGET = re.compile(r"(\{[^{}]*\}|\$?[A-Z]\w*(?:\[\w+\])?)(\s*C_[A-Z]+|\s*CA\s.*)*")
MOTION = re.compile(r"(S?LIN|S?CIRC|S?PTP)\b(?!\s*[=(])\s*(.*?)(?:\s*\bWITH\s(.*))?$")
PLACE, ANGLES, AXES = ("X", "Y", "Z"), ("A", "B", "C"), tuple(f"A{number}" for number in range(1, 7))
EXTERNAL = tuple(f"E{number}" for number in range(1, 7))
#: Name, loop with numeric bounds, head of a program.
NAME = re.compile(r"\$?[A-Z]\w*(\[\w+\])?")
FOR = re.compile(r"FOR\s+([A-Z]\w*)\s*=\s*([-+]?\d+)\s+TO\s+([-+]?\d+)(?:\s+STEP\s+([-+]?\d+))?\s*$")
HEAD = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+(\w+)\s*\(")
#: Public data list, its global variables; greatest number of data files that are searched.
PUBLIC = re.compile(r"DEFDAT\s+\w+\s+PUBLIC\b")
SHARED = re.compile(r"(?:DECL\s+)?GLOBAL\s+(?:DECL\s+)?(?:CONST\s+)?\w+\s+(\w+)")
MOST_FILES = 200


def recognise(text: str) -> bool:
    """Return whether a text is a KRL program."""
    head = r"^[ \t]*(&ACCESS|(GLOBAL )?DEF +\w+ *\([^()\r\n]*\)[ \t]*(;.*)?\r?$)"
    return re.search(head, text, re.MULTILINE | re.IGNORECASE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read a KRL program: the first one of the file, with called programs of the file or of its folder.

    The path is in the base that is active at the first position. PTP moves are rapid.
    """
    reader = _KrlReader(file, options)
    reader.run(text)
    return reader.robot.log.finish(file, "krl", "mm", count_lines(text))


def read_pose(numbers: Mapping[str, float]) -> Array:
    """Return the pose of X Y Z A B C: R = Rz(A) Ry(B) Rx(C)."""
    turn = Rotation.from_euler("ZYX", [numbers[key] for key in ANGLES], degrees=True)
    return build_pose([numbers[key] for key in PLACE], turn.as_matrix())


def clean_line(raw: str) -> str:
    """Return a statement in capitals, without its comment."""
    text = raw.partition(";")[0].strip()
    return "" if text.startswith("&") else text.upper()


def find_sibling(file: Path, suffix: str) -> Sequence[str]:
    """Return the lines of the file of the same name with a suffix in lower or upper case, empty if there is none."""
    beside = next((path for end in (suffix, suffix.upper()) if (path := file.with_suffix(end)).is_file()), None)
    return split_lines(read_bounded(beside)) if beside else ()


class _KrlReader:
    """Interpret a program statement by statement."""

    def __init__(self, file: Path, options: CamTable) -> None:
        self.options = options
        self.robot = robot = RobotProgram(file, options)
        self.flow, self.note = robot.flow, robot.note
        self.flow.run_line = self._run_line
        self.feed = 0.0
        #: Speed of the current move only (WITH). [mm/s]
        self.move_feed: float | None = None
        #: Positions and frames by name; values of loop counters; first call that is not read.
        self.positions: dict[str, str | dict[str, float]] = {"$NULLFRAME": "{X 0}"}
        self.counters: dict[str, int] = {}
        self.called = self.tool = ""
        self.last: dict[str, float] = {}
        #: Rules of statements.
        self.rules: list[Rule] = [(re.compile(pattern), run) for pattern, run in (
            (r"((END)?(IF|FOR|WHILE|LOOP|SWITCH)|REPEAT|UNTIL)\b", robot.count_block),
            (r"(GOTO|ASY?S?PTP|LIN_REL|PTP_REL|CIRC_REL|S\w+_REL|SPL(?:INE)?)\b(?!\s*[=(])", robot.refuse),
            (MOTION, self._move), (r"BAS\s*\(\s*#(\w+)\s*,\s*([^)]*)\)", self._set_up),
            (r"(?P<signal>\$OUT\[\d+\])\s*=\s*(?P<on>TRUE|FALSE)$", robot.switch("output")),
            (rf"WAIT\s+SEC\s+(?P<time>{NUMBER})$", robot.switch("dwell")), ("HALT$", robot.switch("stop")),
            (r"WAIT\b|PULSE\b|TRIGGER\b|\$A?N?OUT|ANOUT\b", robot.add_call_event), (ASSIGN, self._assign),
            (r"DECL|INT|REAL|BOOL|CHAR|EXT|INTERRUPT|GLOBAL|WAIT|HALT|CONTINUE|TRIGGER|SIGNAL|RETURN|BRAKE|PULSE|ENUM|"
             r"ENDFCT|STRUC|DEFDAT|ENDDAT|ANOUT|ANIN|CASE|DEFAULT|ELSE|IMPORT|RESUME|CREAD|CWRITE|COPEN|CCLOSE|E6POS|"
             r"E6AXIS|FRAME|POS|AXIS|CHANNEL|CONFIRM|FDAT|LDAT|PDAT|ON_ERROR_PROCEED|TIME_BLOCK|CONST_VEL|.*:$", None),
            (r"([A-Z_]\w{0,60})\s*\((.*)\)\s*$", self._call),
            (r"\S{1,20}", lambda found: self.note(f"statement {found.group(0)} is not read")),
        )]  # fmt: skip

    def run(self, text: str) -> None:
        """Execute the first program of the file."""
        self._load_shared(text.upper())
        with self.flow.guard():
            self._load_data(self.flow.file)
            self.flow.run(self._find_programs(split_lines(text), self.flow.file))

    def _load_shared(self, text: str) -> None:
        """Load the GLOBAL positions that the text names from public .dat files in the folder of the program."""
        own, keepers = self.flow.file.stem.lower(), dict[str, str]()
        data = sorted(path for path in self.flow.file.parent.glob("*.[dD][aA][tT]") if path.stem.lower() != own)
        for path in data[:MOST_FILES]:
            lines = [clean_line(raw) for raw in split_lines(read_bounded(path))]
            if not any(PUBLIC.match(line) for line in lines[:50]):
                continue
            names = {found.group(1) for line in lines if "GLOBAL" in line and (found := SHARED.match(line))}
            names = {name for name in names if re.search(rf"(?<!\w){name}(?!\w)", text)}
            for name in sorted(names & keepers.keys()):
                raise self.flow.error(f"{name} stands in {keepers[name]} and in {path.name}, both public; keep one")
            keepers.update(dict.fromkeys(names, path.name))
            for line in lines:
                if "GLOBAL" in line or re.split(r"[\s\[=.]", line)[0] in names:
                    self._assign(ASSIGN.match(line))
        if keepers:
            files = ", ".join(sorted(set(keepers.values())))
            self.robot.log.note(f"positions of other files are read: {files}", 1)

    def _load_data(self, file: Path) -> None:
        """Load the positions and frames of the .dat file of a program."""
        for raw in find_sibling(file, ".dat"):
            self._assign(ASSIGN.match(clean_line(raw)))

    def _find_programs(self, lines: Sequence[str], file: Path) -> CncProgram:
        """Register the programs DEF NAME() of a file; return the first one."""
        first: CncProgram | None = None
        for index, raw in enumerate(lines):
            if "DEF" in raw.upper() and (head := HEAD.match(clean_line(raw))):
                found = self.flow.programs[head.group(1)] = CncProgram(lines, index + 1, len(lines), file)
                first = first or found
        return first or CncProgram(lines, 0, len(lines), file)

    def _run_line(self, program: CncProgram, index: int) -> int:
        """Execute a statement; return the index of the next one, or END."""
        raw = program.lines[index]
        statement, comment = clean_line(raw), raw.partition(";")[2].strip()
        if comment and not re.match(r"(END)?FOLD\b|%\{", comment, re.IGNORECASE):  # without folds of the editor
            self.robot.log.add_event("comment", text=comment)
        if statement in ("END", "ENDFCT") or (statement == "RETURN" and not self.robot.blocks):
            return END
        for counter, value in self.counters.items():  # replace counters in indices and bounds by their values
            place = rf"(?<=\[)\s*{counter}\s*(?=\])|(?<![\w.$\[]){counter}(?![\w.\[])(?!\s*=)"
            statement = re.sub(place, str(value), statement)
        if not self.robot.blocks and (loop := FOR.match(statement)):
            return self._run_for(program, index, *loop.groups())
        self.robot.run_statement(statement, self.rules)
        return index + 1

    def _run_for(self, program: CncProgram, index: int, counter: str, first: str, last: str, step: str | None) -> int:
        """Execute a loop with numeric bounds; return the next line, or END."""
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
        """Return the line of the ENDFOR of a loop; refuse EXIT and assignments to its counter."""
        depth = 0
        for index in range(first, program.last):
            statement = clean_line(program.lines[index])
            depth += statement.startswith("FOR ") - statement.startswith("ENDFOR")
            if depth == 0:
                return index
            if statement == "EXIT" or (index > first and re.match(rf"{counter}\s*=(?!=)", statement)):
                raise InputError(f"the loop ends at {statement[:24]!r}, which is not read; write it without a loop")
        raise InputError("FOR has no ENDFOR")

    def _call(self, found: Match) -> None:
        """Execute a program of the file, or NAME.src in its folder; note other calls."""
        programs, file, statement, called = self.flow.programs, self.flow.file, found.string, found.group(1)
        for word in (called, called.lower()):
            beside = file.with_name(f"{word}.src")
            if called not in programs:
                self._find_programs(find_sibling(beside, ".src"), beside)
        if called not in programs:
            self.called = self.called or f"{statement[:24]} in line {self.flow.line}"
            self.note(f"call of {called[:24]}() is not read: it is neither here nor beside the file")
            self.robot.add_call_event(statement)
            return
        if programs[called].file != file:
            self._load_data(programs[called].file)
        self.robot.call(called, f"{called}()")

    def _assign(self, found: Match | None) -> None:
        """Execute an assignment, if there is one."""
        if found is None:
            return
        target, value = found.group(1).replace(" ", ""), found.group(2)
        whole, _, part = target.partition(".")
        if target == "FDAT_ACT" and not self.robot.blocks:
            self._use_frames(str(self.positions.get(value.strip(), "")))
        if target in ("$OV_PRO", "$OV_ROB"):
            self.note(f"{target} (a share of all speeds) is not applied")
        if target in ("$BASE", "$TOOL", "$IPO_MODE", "$VEL", "$VEL.CP"):
            if self.robot.blocks and target != "$TOOL":
                raise InputError(f"{target} is set in a loop or a branch; write the program out")
            self._set_system(target, value.strip(), found.string)
        elif whole in ("$BASE", "$TOOL"):
            raise InputError(f"a part of {whole} is set ({found.string[:30]}); write the whole frame")
        elif whole in self.positions:  # removed if the new value is unknown
            position = self.positions.pop(whole)
            if not self.robot.blocks and not part and (AGGREGATE.match(value) or value in self.positions):
                self.positions[whole] = self.positions.get(value, value)
            elif not self.robot.blocks and part and re.fullmatch(NUMBER, value):
                self.positions[whole] = {**self._numbers(position), part: float(value)}
        elif (target.startswith("BASE_DATA[") or AGGREGATE.match(value)) and target[0] != "$" and not self.robot.blocks:
            self.positions[target] = value
            if target.startswith("BASE_DATA["):
                self._numbers(value)

    def _set_up(self, found: Match) -> None:
        """Execute BAS(#word, value)."""
        word, value = found.group(1), found.group(2).strip()
        if word == "BASE":
            value = "$NULLFRAME" if value == "0" else f"BASE_DATA[{value}]"
        targets = {"VEL_CP": "$VEL.CP", "CP_PARAMS": "$VEL.CP", "BASE": "$BASE", "TOOL": "$TOOL"}
        self._set_system(targets.get(word, ""), value, f"CP {value}")

    def _set_system(self, target: str, value: str, statement: str) -> None:
        if target == "$BASE":
            self._use_base(value)
        elif target == "$TOOL":
            self.robot.note_tool()
        elif target == "$IPO_MODE" and "TCP" in value:
            raise InputError("$IPO_MODE=#TCP (the part in the robot's hand) is not read")
        elif target.startswith("$VEL") and re.search(r"\bCP\b", statement):
            self.feed = self._read_speed(statement)

    def _read_speed(self, text: str) -> float:
        """Return the speed in a text [mm/s]; 0 if it has none and feed_mm_s is given."""
        speed = re.search(rf"\bCP\s*=?\s*({NUMBER})\s*(?:[,}}]|$)", text)
        if not speed and self.options.feed_mm_s is None:
            raise InputError(f"{text.strip()[:40]!r} sets no speed in m/s; state one with feed_mm_s (--feed)")
        return float(speed.group(1)) * 1e3 if speed else 0.0

    def _use_frames(self, data: str) -> None:
        """Activate base and tool of an inline form (FDAT)."""
        if "#TCP" in data:
            raise InputError("IPO_FRAME #TCP (the part in the robot's hand) is not read")
        if base := re.search(r"BASE_NO\s+(\d+)", data):
            self._use_base(f"BASE_DATA[{base.group(1)}]" if base.group(1) != "0" else "$NULLFRAME")
        if tool := re.search(r"TOOL_NO\s+(\d+)", data):
            if self.tool not in ("", tool.group()):
                self.robot.note_tool()
            self.tool = tool.group()

    def _use_base(self, value: str) -> None:
        """Activate a base; the path stays in the base of its first position."""
        text = value if value.startswith("{") else self.positions.get(value)
        known = None if text is None else read_pose({**dict.fromkeys((*PLACE, *ANGLES), 0.0), **self._numbers(text)})
        if self.robot.placed and not (known is None and value == self.robot.frame_name):
            self.last = {}
        self.robot.use_frame(value, known, "base")

    def _numbers(self, position: str | dict[str, float]) -> dict[str, float]:
        """Return the numbers of {X 1,Y 2,..}."""
        if isinstance(position, dict):
            return position
        found = AGGREGATE.match(position.strip())
        if not found:
            raise InputError(f"position {position.strip()[:30]!r} is not read, expected {{X 1,Y 2,Z 3,A 0,B 0,C 0}}")
        items, odd = ITEM.findall(found.group(1)), ITEM.sub("", found.group(1)).strip()
        numbers = {name: 0.0 if text[0] == "'" else float(text) for name, text in items}
        if odd or len(numbers) < len(items) or not all(abs(number) < FARTHEST for number in numbers.values()):
            odd = odd or found.group(1).strip()
            raise InputError(
                f"position {odd[:20]!r} is not read, expected numbers by name, each once, below {FARTHEST:g}"
            )
        return numbers

    def _target(self, text: str) -> dict[str, float]:
        """Return the numbers of a position: written out, or declared by name."""
        word = match_form(TARGET, text.strip(), "position: {X 1,Y 2,..} or a name, and C_DIS and such").group(1)
        if word[0] != "{" and word not in self.positions:
            raise InputError(f"position {word[:24]!r} has no known value here: it is not declared with numbers, or was "
                             "computed since; write it out as {X .., Y .., ..}")  # fmt: skip
        return self._numbers(self.positions.get(word, word))

    def _read_with(self, extra: str) -> None:
        """Read the settings of one move (WITH): its speed; frames and modes are refused."""
        self.move_feed = None
        for item in split_fields(extra, "{", "}"):
            if re.match(r"\s*\$(BASE|TOOL|IPO_MODE)\b", item):
                raise InputError(f"{item.strip()[:30]!r} for one move is not read; write it as a statement")
            if "$VEL" in item and "CP" in item:
                self.move_feed = self._read_speed(item)

    def _pose(self, numbers: dict[str, float]) -> Array:
        """Return a pose; coordinates that are not named keep their last values."""
        turned = {key: abs(value - self.last.get(key, value)) for key, value in numbers.items() if key in EXTERNAL}
        if max(turned.values(), default=0.0) > 1e-6:
            self.note("external axes move: the path is taken in the base as it is written")
        full = {**self.last, **numbers}
        missing = [key for key in (*PLACE, *ANGLES) if key not in full]
        if missing:
            raise InputError(f"position without {' '.join(missing)}, which nothing before it states")
        self.last, self.robot.placed = full, True
        return read_pose(full)

    def _move(self, found: Match) -> None:
        self.robot.check_row(found.string)
        kind, rest, extra = found.groups()
        self._read_with(extra or "")
        joints = kind in ("PTP", "SPTP")
        parts = split_fields(rest, "{", "}")
        named = NAME.match(parts[0])
        if joints and named and named.group(0) not in self.positions:
            unknown = named.group(0)[:24]
            self.robot.forget_pose(f"joint move to {unknown} is left out: it is not known here or in the .dat file")
            return
        numbers = self._target(parts[0])
        if joints and numbers.keys() & set(AXES):
            self.robot.forget_pose()
        elif joints:
            self.robot.rapid(self._pose(numbers))
        elif kind in ("LIN", "SLIN"):
            self.robot.straight(self._pose(numbers), self._speed())
        else:
            middle, ends = {**self.last, **numbers}, parts[1:2]
            if not ends or not middle.keys() >= set(PLACE):
                raise InputError("circle has no end position, or no middle")
            words = re.search(rf"\bCA\s*=?\s*({NUMBER})", " ".join(parts[1:]))
            angle = math.radians(float(words.group(1))) if words else None
            via = np.array([middle[key] for key in PLACE])
            self.robot.circle(via, self._pose(self._target(ends[0])), self._speed(), angle=angle)

    def _speed(self) -> float:
        feed = self.feed if self.move_feed is None else self.move_feed
        if feed <= 0.0:
            where = f", {self.called} may set it" if self.called else ""
            self.note(f"cutting moves before any speed $VEL.CP have none{where}; state it with feed_mm_s (--feed)")
        return feed
