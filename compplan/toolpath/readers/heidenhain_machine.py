"""What Heidenhain programs switch: tools, spindle, coolant, stops, feeds, M functions."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.toolpath.readers.cnc.machine import STARTING, STOPPING, stop_machine
from compplan.toolpath.readers.frames import UNIT
from compplan.toolpath.readers.heidenhain_frames import INCH, HeidenhainFrameReader
from compplan.toolpath.readers.heidenhain_words import VALUE
from compplan.toolpath.readers.options import CamTable

ENDS = {2, 30}
#: M functions that change nothing of the path or the machine that a robot has.
SILENT = {6, 10, 11, 16, 17, 21, 22, 25, 26, 31, 32, 52, 53, 54, 57, 59, 89, 90, 91, 92, 94, 97, 98, 99, 101, 102, 103,
          *range(107, 114), *range(115, 119), 120, 124, 126, 127, 128, 129, *range(134, 139), *range(140, 146), 148,
          149}  # fmt: skip
REFUSED_M = {130: "coordinates that are not tilted", 114: "the old compensation of rotary axes", 200: "laser"}

TOOL = re.compile(r"TOOL\s+CALL\s*(\"[^\"]*\"|\d+(?:\.\d+)?|Q[LRS]?\d+)?\s*([XYZUVW](?=\s|$))?\s*(.*)")
TOOL_DEF = re.compile(
    rf"TOOL\s+DEF\s*(\"[^\"]*\"|\d+|Q\d+)?\s*(?:L\s*({VALUE}))?\s*(?:R\s*({VALUE}))?\s*"
    rf"(?:F\s*{VALUE})?\s*$"
)
TOOL_WORD = re.compile(rf"(D[LR]2?|S|F[UZ]?)\s*:?\s*(?:=\s*)?({VALUE})")


class HeidenhainMachineReader(HeidenhainFrameReader):
    """Follow tools, spindle, coolant and feeds."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.tool_feed: float | None = None
        self.per_turn = self.spatial = self.calls = False
        #: Whether the program states lengths of tools, as on old controls, and whether its feed is rapid there.
        self.old = self.fast = False
        self.radii: dict[str, float] = {}
        self.tool = ""
        self.ends = False

    def _note_function(self, number: int, words: str) -> None:
        if number == 140 and "MB" in words and "MAX" not in words:
            self._retract(self.value(re.search(r"MB\s*([-+]?[\d.,]+)", words).group(1)), words)  # type: ignore[union-attr]
        elif number == 140:
            self.log.note("retracts to the end of the machine's travel (M140 MB MAX) are left out", self.line)
            self.course.lose((self.tool_axis,))

    def _retract(self, way: float, words: str) -> None:
        """Go back along the tool axis (M140 MB)."""
        self.contour.refuse_open()
        target = list(self.course.position)
        target[self.tool_axis] += way
        feed = re.search(r"F\s*([\d.]+)", words)
        end = target[0], target[1], target[2]
        if feed:
            self.course.line(end, (), self.to_mm_s(float(feed.group(1))), self.line)
        else:
            self.course.rapid(end, ())

    def start_functions(self, functions: set[int]) -> None:
        """Let happen what M functions switch before the move of their block."""
        if not functions:
            return
        for number in sorted(functions & STARTING.keys()):
            for kind in STARTING[number]:
                self.turning, self.cooling = (kind, self.cooling) if "spindle" in kind else (self.turning, True)
                self.log.happen(kind, self.line, value=self.spindle if "spindle" in kind else 0.0)
        for number in sorted(functions):
            if number in REFUSED_M or 200 <= number <= 204:
                raise self.error(f"M{number} ({REFUSED_M.get(number, 'laser')}) is not read; post-process without it")
            if number not in STARTING and number not in STOPPING and number not in ENDS and number not in SILENT:
                self.log.note(f"M{number} is not read", self.line)
                self.log.happen("comment", self.line, text=f"M{number} of the CAM file")
        if 128 in functions:
            self.control_tip(True)
        if functions & {136, 137}:
            self.per_turn = 136 in functions

    def stop_functions(self, functions: set[int]) -> None:
        """Let happen what M functions switch after it."""
        if not functions:
            return
        if 129 in functions:
            self.control_tip(False)
        stop_machine(sorted(functions), self, self.log, self.line)
        self.ends = self.ends or bool(functions & ENDS)

    def control_tip(self, on: bool, *, spatial: bool = False) -> None:
        """Let X Y Z be the tip in the part frame, however the rotary axes stand, or not."""
        self.contour.refuse_open()
        self.tip_control, self.spatial = on, spatial
        self.set_frame()

    def call_where_asked(self, functions: set[int]) -> None:
        """Carry out the cycle after a move that calls it: M99 once, M89 from here on."""
        self.calls = self.calls or 89 in functions
        if self.calls or 99 in functions:
            self.call_cycle()
        if 99 in functions:
            self.calls = False

    def call_cycle(self) -> None:
        """Carry out the cycle that is defined."""
        raise NotImplementedError

    def to_mm_s(self, number: float) -> float:
        """Return a feed in mm/s; in programs in inches F counts tenths of an inch a minute."""
        if self.per_turn:
            return number * self.unit.scale * self.spindle / 60.0
        return number * (1.0 if self.unit.rows == UNIT else 0.1 * INCH) / 60.0

    def set_speed(self, speed: float) -> None:
        """Take a speed of the spindle; one that turns changes its speed."""
        self.spindle = speed
        if self.turning:
            self.log.happen(self.turning, self.line, value=speed)

    def _length(self, text: str) -> float:
        return self.value(text) * self.unit.scale

    def speed(self) -> float:
        """Return the feed in mm/s, 0 where none is known."""
        if self.feed is None:
            self.log.note("cutting moves before any feed F have none", self.line)
        return self.feed or 0.0

    def change_tool(self, text: str) -> None:
        """Carry out TOOL CALL and TOOL DEF."""
        if re.match(r"TOOL\s+DEF(?![A-Z])", text):
            found = TOOL_DEF.match(text)
            if not found:
                raise self.error(f"tool {text[:40]!r} is not read")
            self.old = self.old or found.group(2) is not None
            if found.group(3) is not None:
                self.radii[found.group(1) or ""] = self.value(found.group(3))
            return
        found = TOOL.match(text)
        if not found:
            raise self.error(f"tool call {text[:40]!r} is not read")
        called, axis, rest = found.groups()
        self.contour.refuse_open()
        words = dict(TOOL_WORD.findall(rest))
        if re.sub(r"M\s*\d+|\"[^\"]*\"", "", TOOL_WORD.sub("", rest)).strip():
            raise self.error(f"cannot read {rest[:30]!r} in the tool call")
        if any(self.value(words[key]) for key in ("DL", "DR") if key in words):
            self.log.note("oversizes DL, DR of TOOL CALL are not applied: the path is that of the tool tip", self.line)
        if "S" in words:
            self.spindle = self.value(words["S"])
        if "F" in words:
            self.tool_feed = self.feed = self.to_mm_s(self.value(words["F"]))
        self._take_tool(called)
        if axis in ("X", "Y", "Z") and "XYZ".index(axis) != self.tool_axis:
            self.tool_axis = "XYZ".index(axis)
            self.set_frame()
            self.point_tool()
        if "S" in words and self.turning:
            self.log.happen(self.turning, self.line, value=self.spindle)
        if functions := {int(number) for number in re.findall(r"M\s*(\d+)", TOOL_WORD.sub("", rest))}:
            self.start_functions(functions)
            self.stop_functions(functions)

    def _take_tool(self, called: str | None) -> None:
        if called is None:
            return
        if called.startswith('"'):
            number, text, key = 0.0, called[1:-1], called
        else:
            number = self.value(called)
            text, key = "", f"{number:g}"
        if key != self.tool:
            self.tool, self.turning = key, ""
            self.log.happen("tool", self.line, value=number, text=text)
