"""KUKA KRL programs read a second time as paths: PTP, LIN and CIRC to stated positions."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from compplan.controllers.readback.poses import NUMBER, kuka_pose
from tests.oracles.cam.moves import Array, CannotTellError, Reading
from tests.oracles.cam.robot_paths import RobotPath

LETTERS = "XYZABC"
_FIELD = re.compile(rf"\s*([A-Z]\w*)\s+({NUMBER})\s*")
_MOVE = re.compile(r"S?(PTP|LIN|CIRC)\b\s*(.*)")
_TARGET = re.compile(r"\{[^{}]*\}|[A-Z_]\w*(?:\[\d+\])?")
_HEAD = re.compile(r"\s*(?:GLOBAL\s+)?DEF\s+(\w+)\s*\(")
_ASSIGN = re.compile(r"(?:(?:GLOBAL|DECL)\s+)*(?:(?:E6POS|POS|FRAME|E6AXIS|AXIS)\s+)?([$\w.]+(?:\[\d+\])?)\s*=\s*(.+)")
#: Statements that move nothing and set nothing that counts here.
SILENT = re.compile(
    r"DEF\b|DEFDAT\b|END$|ENDDAT|DECL\b|INT\b|REAL\b|EXT\b|EXTERNAL\b|INTERRUPT\b|TRIGGER\b|WAIT\b|HALT|PULSE\b|INI$|"
    r"GLOBAL\b|SIGNAL\b|IMPORT\b|ENUM\b|STRUC\b|BOOL\b|"
    r"BAS\s*\(\s*#(?:INITMOV|PTP_PARAMS|CP_PARAMS|VEL_PTP|ACC_PTP|ACC_CP|PTP_DAT|EX_BASE)|&|CONTINUE|RETURN"
)
OPENS = re.compile(r"(?:IF|FOR|WHILE|LOOP|REPEAT|SWITCH)\b")
CLOSES = re.compile(r"(?:ENDIF|ENDFOR|ENDWHILE|ENDLOOP|UNTIL|ENDSWITCH)\b")


@dataclass
class KrlPath:
    """An interpreter of KRL statements that lead the tool.

    Args:
        folder: Folder that the program lies in, or None.
        path: What it does.

    """

    folder: Path | None
    path: RobotPath
    feed: float = 0.0
    base: str = "none"
    frames: dict[str, dict[str, float]] = field(default_factory=dict)
    points: dict[str, dict[str, float]] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    depth: int = 0
    routines: dict[str, tuple[int, list[str]]] = field(default_factory=dict)
    calls: int = 0

    def read(self, text: str, name: str) -> None:
        """Take in a file: its data file, its routines; run the first."""
        if self.folder is not None and (beside := self.folder / f"{name}.dat").is_file():
            for line in beside.read_text(encoding="utf-8", errors="replace").splitlines():
                if "=" in line and not line.lstrip().startswith((";", "&")):
                    self._assign(line.split(";")[0].strip().upper())
        first, lines = "", text.splitlines()
        heads = [(k, _HEAD.match(line.upper())) for k, line in enumerate(lines)]
        starts = [(k, match[1]) for k, match in heads if match]
        for (at, routine), after in zip(starts, [*[k for k, _ in starts[1:]], len(lines)], strict=True):
            self.routines[routine] = (at, lines[at:after])
            first = first or routine
        self.run(first)

    def run(self, routine: str) -> None:
        """Run a routine."""
        self.calls += 1
        if self.calls > 500:
            raise CannotTellError("routines that call each other", self.path.record.line)
        start, lines = self.routines[routine]
        for k, line in enumerate(lines):
            self.path.record.line = start + k + 1
            if text := line.split(";")[0].strip().upper():
                self.obey(text)
                if re.match(r"END$|RETURN", text):
                    return

    def obey(self, text: str) -> None:
        """Carry out a statement."""
        if OPENS.match(text):
            self.depth += 1
        elif CLOSES.match(text):
            self.depth -= 1
        elif match := _MOVE.fullmatch(text):
            if self.depth:
                raise CannotTellError("a move in a loop or a branch", self.path.record.line)
            self._move(match[1], match[2])
        elif match := re.fullmatch(rf"BAS\s*\(\s*#(VEL_CP|BASE)\s*,\s*({NUMBER})\s*\)", text):
            if match[1] == "VEL_CP":
                self.feed = 1e3 * float(match[2])
            else:
                self._set_base(f"BASE_DATA[{float(match[2]):.0f}]")
        elif match := re.fullmatch(r"(\w+)\s*\(\s*\)", text):
            self._call(match[1])
        elif "=" in text and not SILENT.match(text.replace("DECL ", "").replace("GLOBAL ", "")):
            self._assign(text)
        elif not SILENT.match(text) and not re.fullmatch(r"BAS\s*\(.*\)|[A-Z]\w*:|ELSE|CASE.*|DEFAULT", text):
            raise CannotTellError(f"the statement {text[:30]!r}", self.path.record.line)

    def _call(self, name: str) -> None:
        if name not in self.routines:
            beside = [] if self.folder is None else sorted(self.folder.glob("*.src"))
            files = [file for file in beside if file.stem.upper() == name]
            if not files or self.depth:
                raise CannotTellError(f"the routine {name}", self.path.record.line)
            other = KrlPath(self.folder, self.path, self.feed, self.base, self.frames, dict(self.points), self.last)
            other.calls = self.calls + 1
            if other.calls > 20:
                raise CannotTellError("routines that call each other", self.path.record.line)
            line = self.path.record.line
            other.read(files[0].read_text(encoding="utf-8", errors="replace"), files[0].stem)
            self.feed, self.base, self.last, self.path.record.line = other.feed, other.base, other.last, line
            return
        start = self.path.record.line
        self.run(name)
        self.path.record.line = start

    def _assign(self, text: str) -> None:
        match = _ASSIGN.fullmatch(text)
        if match is None:
            return
        name, value = match[1], match[2].strip()
        counts = name.startswith(("$VEL", "$BASE", "$IPO", "BASE_DATA", "$TOOL")) or value.startswith("{")
        if counts and self.depth:
            raise CannotTellError(f"{name} in a loop or a branch", self.path.record.line)
        if name == "$VEL.CP":
            if not re.fullmatch(NUMBER, value):
                raise CannotTellError(f"the speed {value}", self.path.record.line)
            self.feed = 1e3 * float(value)
        elif name == "$VEL" and value.startswith("{"):
            self.feed = 1e3 * self._fields(value).get("CP", 1e-3 * self.feed)
        elif name == "$BASE":
            if value.startswith("{"):
                self.frames[value] = self._fields(value)
            self._set_base(value)
        elif name.startswith("$IPO_MODE") and "BASE" not in value:
            raise CannotTellError("a tool that stands", self.path.record.line)
        elif name.startswith("BASE_DATA"):
            self.frames[name] = self._fields(value)
        elif value.startswith("{"):
            self.points[name] = self._fields(value) if self._plain(value) else {}

    def _plain(self, text: str) -> bool:
        inner = re.sub(r"^\w+\s*:", "", text.strip("{} "))
        return all(_FIELD.fullmatch(part) for part in inner.split(","))

    def _fields(self, text: str) -> dict[str, float]:
        inner = re.sub(r"^\w+\s*:", "", text.strip("{} "))
        found = {}
        for part in inner.split(","):
            match = _FIELD.fullmatch(part)
            if match is None:
                raise CannotTellError(f"the position {text[:30]}", self.path.record.line)
            found[match[1]] = float(match[2])
        return found

    def _set_base(self, name: str) -> None:
        if name != self.base and self.base != "none":
            self.last = {}
        self.base = name

    def _frame(self) -> Array | None:
        if self.base in ("none", "$NULLFRAME"):
            return np.eye(4) if self.base == "$NULLFRAME" else None
        stated = self.frames.get(self.base)
        return None if stated is None else kuka_pose(*(stated.get(key, 0.0) for key in LETTERS))

    def _pose(self, text: str, *, turns: bool = True) -> Array | None:
        """Return the pose of a position; None of joint values."""
        fields = self._fields(text) if text.startswith("{") else self.points.get(text)
        if not fields:
            raise CannotTellError(f"the position {text}", self.path.record.line)
        if any(re.fullmatch(r"A\d", key) for key in fields):
            return None
        known = {**self.last, **{key: value for key, value in fields.items() if key in LETTERS}}
        if len(known) < 6:
            raise CannotTellError("a position of which a part is not stated", self.path.record.line)
        if turns:
            self.last = known
        return self.path.place(kuka_pose(*(known[key] for key in LETTERS)), self._frame(), self.base)

    def _move(self, word: str, rest: str) -> None:
        if "WITH" in rest or re.search(r"\bREL\b", rest):
            raise CannotTellError(f"{word} {rest[:20]}", self.path.record.line)
        targets = _TARGET.findall(re.sub(r"\bC_\w+", " ", rest))
        angle = re.search(rf",\s*CA\s+({NUMBER})", rest)
        targets = [text for text in targets if text != "CA"]
        if len(targets) != (2 if word == "CIRC" else 1):
            raise CannotTellError(f"{word} {rest[:20]}", self.path.record.line)
        if word == "CIRC":
            middle, end = self._pose(targets[0], turns=False), self._pose(targets[1])
            if middle is None or end is None:
                raise CannotTellError("a circle to joint values", self.path.record.line)
            self.path.circle(middle, end, self.feed, None if angle is None else float(angle[1]))
            if angle is not None:
                self.last = {}
            return
        pose = self._pose(targets[0])
        if pose is None:
            self.path.pose, self.last = None, {}
            return
        self.path.lead(pose, self.feed, rapid=word == "PTP")


def read_krl_path(
    text: str, *, folder: Path | None = None, name: str = "", points: str | None = None,
    start: list[float] | None = None,
) -> Reading:  # fmt: skip
    """Read a KRL program as a path.

    Args:
        text: The .src file.
        folder: Folder that its data file and the programs that it calls lie in.
        name: Its name, without ending.
        points: Axis of the TCP frame that points out of the tool.
        start: Where cuts begin whose start the file leaves open. [mm]

    Raises:
        CannotTellError: If something in it is not known here.

    """
    path = RobotPath(points, start)
    try:
        KrlPath(folder, path).read(text, name)
    except (ValueError, KeyError, IndexError) as error:
        raise CannotTellError(f"{error}", path.record.line) from None
    return path.record.finish()
