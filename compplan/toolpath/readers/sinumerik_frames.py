"""What a Sinumerik program says of frames, variables and the machine: TRANS, ROT, CYCLE800, tools, spindle, feeds."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.cnc.machine import STARTING, STOPPING, stop_machine
from compplan.toolpath.readers.expressions import evaluate
from compplan.toolpath.readers.followed import FollowedReader
from compplan.toolpath.readers.frames import Frame, rotate, shift, stretch
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.sinumerik_words import GRAMMAR, Words
from compplan.toolpath.readers.start import refuse_unit

AXES = "XYZ"
INCH = 25.4
NORMALS: dict[int, Point] = {17: (0.0, 0.0, 1.0), 18: (0.0, 1.0, 0.0), 19: (1.0, 0.0, 0.0)}
#: First and second axis of the planes.
PLANES = {17: (0, 1), 18: (2, 0), 19: (1, 2)}
#: Value of a variable that is not known, where the move that it stands in is left out.
ELSEWHERE = 1e30
FRAME_WORDS = {"TRANS", "ATRANS", "ROT", "AROT", "SCALE", "ASCALE", "MIRROR", "AMIRROR"}
#: System variables that have one value while a program runs.
SYSTEM = {"$PI": 3.141592653589793, "TRUE": 1.0, "FALSE": 0.0, "$P_SEARCH": 0.0, "$P_ISTEST": 0.0, "$P_SIM": 0.0,
          "$P_SEARCH1": 0.0, "$P_SEARCH2": 0.0, "$P_DRYRUN": 0.0, "$P_PROGTEST": 0.0}  # fmt: skip
ENDS = {2, 17, 30}
SILENT_M = {6, 40, 41, 42, 43, 44, 45, 70, 19, 10, 11, 21, 22}


class SinumerikFrameReader(FollowedReader):
    """Hold what a program has said of frames, variables, tool and machine; millimetres."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.scale = INCH if options.unit == "inch" else 1.0
        #: Millimetres of a unit of F: G700 and G710 set it, G70 and G71 leave it as the control's basic system has it.
        self.feed_scale = self.scale
        self.units: list[str] = []
        self.numbers: dict[tuple[str, tuple[float, ...]], float] = {}
        self.variables: set[str] = set()
        self.plane = 17
        self.program, self.swivel = Frame(), Frame()
        self.swivelled = False
        self.outside = ""
        self.offset: float | None = None
        self.feed_mode = 94
        self.tool, self.tool_name = 0.0, ""

    def look_up(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a variable.

        Raises:
            ValueError: If it has none that is known.

        """
        if name in SYSTEM:
            return SYSTEM[name]
        if name[0] == "R" and name[1:].isdigit():
            name, indices = "R", (float(name[1:]),)
        try:
            return self.numbers[name, indices]
        except KeyError:
            pass
        if name in self.variables:
            return 0.0
        shown = f"{name}[{', '.join(f'{index:g}' for index in indices)}]" if indices else name
        raise ValueError(f"{shown} has no value that is known: {self.unknown.get(name, 'the program gives it none')}")

    def look_up_home(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a variable in a move that is left out; ELSEWHERE where it has none that is known."""
        try:
            return self.look_up(name, indices)
        except ValueError:
            return ELSEWHERE

    def evaluate(self, text: str) -> float:
        """Return the value of an expression."""
        try:
            return evaluate(text, GRAMMAR, self.look_up)
        except ValueError as fault:
            raise self.error(str(fault)) from None

    def set_frame(self, *, carried: bool = False) -> None:
        """Put together what is in force; carried: rotary axes have carried tool or part along."""
        self.contour.refuse_open()
        place = Frame() if self.swivelled else self.rotary.place(tip_control=self.tip_control)
        self.put_frame(place.then(self.swivel).then(self.program), carried=carried)

    def change_frame(self, word: str, words: Words) -> None:
        """Carry out TRANS, ROT, SCALE, MIRROR (in place of what was) and ATRANS .. (on top of it)."""
        values = words.values
        if unknown := values.keys() - {"X", "Y", "Z", "RPL"}:
            raise self.error(f"{word} with {sorted(unknown)[0]} is not read, expected X Y Z")
        numbers = [values.get(letter, 0.0) for letter in AXES]
        kind = word.removeprefix("A")
        self.ask_for_unit(numbers if kind == "TRANS" else ())
        if kind == "TRANS":
            step = shift(*(number * self.scale for number in numbers))
        elif kind == "ROT":
            step = self._find_rotation(values, numbers)
        elif kind == "SCALE":
            factors = [values.get(letter, 1.0) for letter in AXES]
            if len(set(factors)) > 1 or not 1e-6 < abs(factors[0]) < 1e6:
                raise self.error(f"{word} with different factors of its axes is not read")
            step = stretch(factors[0], factors[0], factors[0])
        else:
            step = stretch(*(-1.0 if letter in values else 1.0 for letter in AXES))
        self.program = self.program.then(step) if word.startswith("A") else step
        self.set_frame()

    def _find_rotation(self, values: dict[str, float], numbers: list[float]) -> Frame:
        """Return a rotation: in the plane (RPL), or about Z, then the new Y, then the new X."""
        if "RPL" in values:
            if len(values) > 1:
                raise self.error("RPL beside rotations about axes is not read")
            axis = NORMALS[self.plane].index(1.0)
            return rotate(axis, values["RPL"])
        normal = NORMALS[self.plane].index(1.0)
        if any(numbers[axis] for axis in range(3) if axis != normal) and not self.swivelled:
            note = "ROT tilts the coordinates; the tool axis stays until rotary axes or CYCLE800 turn it"
            self.log.note(note, self.line)
        return rotate(2, numbers[2]).then(rotate(1, numbers[1])).then(rotate(0, numbers[0]))

    def run_cycle_800(self, arguments: list[str]) -> None:
        """Carry out CYCLE800(_FR, _TC, _ST, _MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, ..): a swivelled plane."""
        self.contour.refuse_open()
        texts = [*arguments, *[""] * 14]
        numbers = [0.0 if not text or text.startswith('"') else self.evaluate(text) for text in texts]
        status, mode = int(numbers[2]), int(numbers[3])
        x0, y0, z0, a, b, c, x1, y1, z1 = numbers[4:13]
        if any((a, b, c)) and not 0 < mode < 64:
            raise self.error(f"CYCLE800 with mode {mode} names angles of rotary axes or projections, which are not "
                             "read; swivel axis by axis (mode 57, 27 or 39)")  # fmt: skip
        order = [((mode >> (2 * place)) & 3) - 1 for place in range(3)]
        turn = Frame()
        for axis, angle in zip(order, (a, b, c), strict=True):
            if angle and axis < 0:
                raise self.error(f"CYCLE800 with mode {mode} names no axis for one of its angles")
            turn = turn.then(rotate(max(axis, 0), angle)) if angle else turn
        k = self.scale
        step = shift(x0 * k, y0 * k, z0 * k).then(turn).then(shift(x1 * k, y1 * k, z1 * k))
        if status % 10 == 1:
            self.swivel = self.swivel.then(self.program).then(step)
        else:
            self.swivel = step
        self.swivelled = not self.swivel.plain
        self.program = Frame()
        self.set_frame()
        self.course.aim(self.swivel.turn(NORMALS[self.plane]))

    def use_offset(self, code: float) -> None:
        """Take a work offset; that of the first cut is the part frame, and cuts in others are refused."""
        part = float(self.options.wcs[1:]) if self.options.wcs and self.options.wcs[1:].isdigit() else None
        if self.offset is None or not self.log.counts["cutting_moves"]:
            self.offset = part or code
        self.outside = "" if code == self.offset else f"G{code:g}"
        if self.outside:
            self.contour.refuse_open()
            self.course.lose()

    def check_offset(self) -> None:
        """Refuse a cut in another work offset than the part frame's."""
        if self.outside:
            raise self.error(
                f"the file cuts in G{self.offset or 54.0:g} and in {self.outside}, and how they stand to each other is "
                "not known; write a program for each work offset"
            )

    def set_unit(self, scale: float, *, feeds: bool) -> None:
        """Take millimetres or inches for lengths, and for feeds where the code sets those too."""
        self.scale = scale
        if feeds:
            self.feed_scale = scale
        elif scale != self.feed_scale:
            basic = "mm" if self.feed_scale == 1.0 else "inch"
            self.log.note(f"G70 and G71 set lengths only: F counts in {basic}/min, the control's basic system (taken "
                          "from --unit, else mm)", self.line)  # fmt: skip
        word = "inch" if scale != 1.0 else "mm"
        if word not in self.units:
            self.units.append(word)

    def ask_for_unit(self, lengths: Iterable[float | None]) -> None:
        """Refuse lengths that are not 0 before the program or the user states their unit."""
        if not self.units and self.options.unit is None and any(lengths):
            raise refuse_unit("G70, G71, G700 or G710; the control's own setting is not in the file")

    def speed(self, length: float) -> float:
        """Return the feed of a move of this length [mm] in mm/s, 0 where none is known."""
        feed = self.feed
        if feed is not None and self.feed_mode == 93:
            return length * feed / 60.0
        if feed is not None and self.feed_mode == 95:
            feed = feed * self.spindle if self.spindle > 0.0 else None
        if feed is None:
            self.log.note("cutting moves before any feed F have none", self.line)
            return 0.0
        return feed * self.feed_scale / 60.0

    def start_machine(self, words: Words) -> None:
        """Let happen what a block switches before its move."""
        values, machine = words.values, words.machine
        if "T" in values:
            self.tool, self.tool_name = values["T"], ""
        if 6.0 in machine:
            self.log.happen("tool", self.line, value=self.tool, text=self.tool_name)
            self.turning = ""
        elif "T" in values:
            self.log.happen("comment", self.line, text=f"tool T{values['T']:g} is called")
        changed = "S" in values and not {4.0, 25.0, 26.0, 92.0}.intersection(words.codes)
        if changed:
            self.spindle = values["S"]
        kinds = [kind for code in machine for kind in STARTING.get(int(code), ())]
        for kind in kinds:
            if kind.startswith("spindle"):
                self.turning, changed = kind, True
        if changed and self.turning:
            self.log.happen(self.turning, self.line, value=self.spindle)
        for kind in kinds:
            if not kind.startswith("spindle"):
                self.cooling = True
                self.log.happen(kind, self.line)
        for code in machine:
            if not {int(code)} & (STARTING.keys() | STOPPING.keys() | ENDS | SILENT_M):
                self.log.note(f"M{code:g} is not read", self.line)
                self.log.happen("comment", self.line, text=f"M{code:g} of the CAM file")

    def stop_machine(self, words: Words) -> bool:
        """Let happen what a block switches after its move; return whether the program ends."""
        stop_machine([int(code) for code in words.machine], self, self.log, self.line)
        return any(int(code) in ENDS for code in words.machine)

    def name_tool(self, raw: str) -> str | None:
        """Return the name in T="NAME", as it is written."""
        found = re.search(r"\bT\d*\s*=\s*\"([^\"]*)\"", raw, re.IGNORECASE)
        return found.group(1) if found else None
