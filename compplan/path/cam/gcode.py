"""G-code (RS-274, ISO 6983) of milling dialects: motion, arcs, planes, units, distance modes, offsets, feeds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

from compplan.errors import InputError
from compplan.path.cam.arcs import Point, arc_about, centre_from_radius, combine, cross, dot, fits_circle
from compplan.path.cam.gcode_cycles import run_cycle
from compplan.path.cam.gcode_state import AXES, PLANE_AXES, PLANE_NORMALS, State
from compplan.path.cam.gcode_words import CONTROL, CONVERSATIONAL, TIP_CONTROL, split_words, strip_comments
from compplan.path.cam.moves import CamFile, MoveLog
from compplan.path.cam.options import CamTable

CENTRE_READINGS = ("incremental", "absolute", "reversed")
REFUSED = {
    5.2: "NURBS", 6.2: "NURBS", 7.0: "lathe diameters", 12.0: "pocket cycles",
    13.0: "pocket cycles", 16.0: "polar coordinates", 32.0: "threading", 33.0: "threading", 33.1: "rigid tapping",
    34.0: "threading", 51.0: "scaling", 51.1: "mirroring", 65.0: "macro calls", 66.0: "modal macro calls",
    68.0: "coordinate rotation", 68.1: "coordinate rotation", 68.2: "tilted work planes",
    107.0: "cylindrical interpolation", 112.0: "polar interpolation",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation",
}
CYCLES = {73.0, 74.0, 76.0, *(float(number) for number in range(81, 90))}
#: Codes that say nothing about the programmed path.
SILENT = {4.0, 9.0, 15.0, 40.0, 49.0, 50.0, 50.1, 61.0, 61.1, 64.0, 67.0, 69.0, 80.0, 94.0, 96.0, 97.0}
NOTED = {
    10.0: "G10 offsets are not read",
    41.0: "cutter compensation (G41, G42) is not applied: the path is taken as programmed",
    43.0: "tool length compensation (G43) is not applied: the path is that of the tool tip",
    54.0: "work offsets (G54 ..) are not known: all coordinates are taken in one frame",
}
NOTED |= {41.1: NOTED[41.0], 42.0: NOTED[41.0], 42.1: NOTED[41.0], 43.1: NOTED[43.0], 44.0: NOTED[43.0]}


class _OffCircleError(InputError):
    """Tell that start and end of an arc do not lie on one circle, in one reading of I J K."""


name = "gcode"
suffixes = (".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".mpf", ".spf", ".iso", ".eia", ".h")


def recognise(text: str) -> bool:
    """Tell whether a text of unknown suffix is G-code."""
    return re.search(r"^\s*(N\d+\s*)?G\d", text, re.MULTILINE | re.IGNORECASE) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read G-code.

    Args:
        text: The program.
        file: Its file, for messages.
        options: What the program does not say by itself.

    Raises:
        InputError: With file and line, if the program has an arc without centre or off its circle, or uses what is not
            read here: expressions, subprograms, splines, rotated or scaled coordinates, conversational blocks.

    """
    readings = CENTRE_READINGS if options.arc_centres is None else (options.arc_centres,)
    first_fault: _OffCircleError | None = None
    lines = text.splitlines()
    for reading in readings:
        reader = _Reader(file, options, reading)
        try:
            reader.run(lines)
        except _OffCircleError as fault:
            first_fault = first_fault or fault
            if reader.state.centres_stated:
                break
            continue
        if reading != "incremental" and options.arc_centres is None and first_fault is not None:
            meaning = {"absolute": "absolute", "reversed": "counted from the centre to the start"}[reading]
            note = f"arc centres I J K are read as {meaning}: only so every arc of the file lies on a circle"
            reader.log.note(note, int(first_fault.where or 1))
        return reader.log.finish(file, "gcode", reader.state.unit_words(), len(lines))
    assert first_fault is not None
    raise first_fault


class _Reader:
    """Follow a program line by line."""

    def __init__(self, file: Path, options: CamTable, reading: str) -> None:
        self.file, self.options = file, options
        self.log = MoveLog(options.chord_tolerance_mm)
        self.state = State(scale=25.4 if options.unit == "inch" else 1.0, centres=reading)
        self.line = 0

    def error(self, message: str) -> InputError:
        return InputError(message, file=self.file, where=self.line)

    def run(self, lines: list[str]) -> None:
        """Read every line up to the end of the program."""
        for self.line, raw in enumerate(lines, start=1):
            line = strip_comments(raw)
            if not line or line == "%":
                if line and self.state.moved:
                    break
                continue
            if line[0] == "/":
                self.log.note("blocks marked with / are read", self.line)
                line = line[1:].lstrip()
            words, rest = split_words(line)
            if rest and not self._explain(line, rest):
                continue
            if self._run_block(words):
                break
        if not self.state.unit_stated:
            unit = self.options.unit or "mm"
            self.log.note(f"no unit is stated (G20, G21): {unit} is assumed", 1)

    def _explain(self, line: str, rest: str) -> bool:
        """Deal with text that is no word; return whether the words of the line are to be read all the same."""
        line = re.sub(r"^N\d+\s*", "", line)
        if CONVERSATIONAL.match(line):
            raise self.error(f"conversational block {line[:40]!r}; post-process the program to ISO G-code (G0 to G3)")
        if "#" in rest or "[" in rest or re.search(r"\bR\d+\s*=|=\s*[A-Z(]", line):
            raise self.error(f"expression {line[:40]!r} is not read, only numbers are; write the program out")
        if CONTROL.match(line):
            raise self.error(f"program control {line[:40]!r} is not read; write the program out in the CAM system")
        if TIP_CONTROL.search(line):
            self.state.tip_control = True
        if line.startswith("SUPA") or " SUPA" in line:
            self.log.note("moves in machine coordinates (SUPA) are left out", self.line)
            return False
        word = re.match(r"[A-Z]{2,}\w*", line)
        if word:
            self.log.note(f"vendor word {word.group(0)[:20]} is not read", self.line)
            return False
        if line.startswith(":"):
            return False
        if set(rest) <= set("*%,:$!") or re.fullmatch(r"[A-Z]", rest):
            self.log.note(f"character {rest[0]!r} is not read", self.line)
            return True
        raise self.error(f"cannot read {rest[:40]!r}, expected words such as X12.5")

    def _run_block(self, words: list[tuple[str, float]]) -> bool:
        """Carry out one block; return whether the program ends."""
        values: dict[str, float] = {}
        codes: list[float] = []
        ends = False
        for letter, number in words:
            if letter == "G":
                codes.append(number)
            elif letter == "M":
                ends = self._run_m(number, ends)
            else:
                values[letter] = number
        once = self._run_codes(codes, values) if codes else ""
        state = self.state
        if "F" in values:
            state.set_feed(values["F"])
        if "S" in values:
            state.spindle = values["S"]
        if not once and not values.keys().isdisjoint("XYZABCIJKRUVW"):
            self._move(values)
        return ends

    def _run_m(self, number: float, ends: bool) -> bool:
        if number in (97.0, 98.0):
            raise self.error(f"subprogram call M{number:g} is not read; write the program out in the CAM system")
        if number == 128.0:
            self.state.tip_control = True
        return ends or number in (2.0, 30.0, 99.0)

    def _run_codes(self, codes: list[float], values: dict[str, float]) -> str:
        """Set what G codes set; return a reason where the coordinates of the block are no move."""
        once = ""
        state = self.state
        for code in codes:
            if code in (0.0, 1.0, 2.0, 3.0):
                state.motion = code
            elif code in CYCLES:
                state.motion, state.cycle_start = code, state.position[2]
            elif code in REFUSED:
                raise self.error(f"G{code:g} ({REFUSED[code]}) is not read; post-process without it")
            elif code in (5.0, 5.1):
                if not values.keys().isdisjoint("XYZIJ"):
                    raise self.error(f"G{code:g} (splines) is not read; post-process without it")
            elif code in MODES:
                MODES[code](state)
            elif code in (70.0, 71.0) and values.keys() & {"P", "Q", "U", "W"}:
                raise self.error(f"G{code:g} as a lathe cycle is not read; post-process without it")
            elif code in (20.0, 21.0, 70.0, 71.0):
                state.set_unit(25.4 if code in (20.0, 70.0) else 1.0)
            elif code in (28.0, 30.0, 53.0) or code in PROBES or code in OFFSETS or code in (4.0, 10.0):
                once = self._run_once(code, values)
            elif 54.0 <= code < 60.0:
                self._use_offset(code)
            elif code in (43.4, 43.5):
                state.tip_control = True
            elif code in NOTED:
                self.log.note(NOTED[code], self.line)
            elif code not in SILENT:
                self.log.note(f"G{code:g} is not read", self.line)
            if code == 80.0:
                state.motion = None
        return once

    def _use_offset(self, code: float) -> None:
        if self.state.work_offset not in (None, code):
            self.log.note(NOTED[54.0], self.line)
        self.state.work_offset = code

    def _run_once(self, code: float, values: dict[str, float]) -> str:
        """Carry out a code that takes the coordinates of its block for itself."""
        state, named = self.state, [axis for axis in range(3) if AXES[axis] in values]
        if code in OFFSETS:
            if code == 92.0:
                before, cutting = state.position, state.moved
                state.set_origin({axis: values[AXES[axis]] for axis in named})
                if not cutting:
                    self.log.shift(combine(1.0, state.position, -1.0, before))
                elif state.position != before:
                    self.log.rapid(state.position)
            elif code == 52.0:
                state.set_shift({axis: values[AXES[axis]] for axis in named})
            else:
                state.clear_origin()
            return "offset"
        if code in (28.0, 30.0):
            self.log.note(f"G{code:g} (home) is left out but for its intermediate point", self.line)
            if named and not state.incremental:
                self._rapid(state.target(values, range(3)))
        elif code == 53.0:
            if named:
                self.log.note("moves in machine coordinates (G53) are left out", self.line)
        elif code in PROBES:
            self.log.note(f"G{code:g} (probing) is left out; where it ended is not known", self.line)
            state.lost.update(named)
        return "once"

    def _move(self, values: dict[str, float]) -> None:
        """Carry out the motion of a block."""
        state = self.state
        if state.motion in CYCLES:
            run_cycle(state.motion or 0.0, values, state, self.log, self.options.cycles == "expand", self.line)
            return
        if not values.keys().isdisjoint("UVW"):
            self.log.note("axes U V W are not read", self.line)
        if state.motion in (2.0, 3.0):
            self._arc(values)
            return
        if values.keys().isdisjoint("XYZABC"):
            return
        target = state.target(values, range(3))
        axis = self._turn(values)
        if state.motion == 1.0:
            state.note_start(self.log, self.line)
            before = self.log.axis
            pieces = 1 if axis is None else math.ceil(math.degrees(_angle(before, axis)) / TURN_STEP - 1e-9) or 1
            feed = self._feed(math.dist(target, self.log.position))
            if axis is None or pieces == 1:
                self.log.line(target, feed, axis)
            else:
                self._turning_line(target, feed, pieces)
            state.position = target
        else:
            if state.motion is None:
                self.log.note("coordinates without G0 or G1 are read as rapid moves", self.line)
            self._rapid(target, axis)

    def _turning_line(self, target: Point, feed: float, pieces: int) -> None:
        """Cut to a point while the rotary axes turn evenly: one move, in pieces."""
        state, log = self.state, self.log
        start, counts = log.position, dict(log.counts)
        for piece in range(1, pieces + 1):
            share = piece / pieces
            point = target if piece == pieces else combine(1.0 - share, start, share, target)
            log.line(point, feed, state.rotary_axis(self.options.rotary, share))
        for name in ("cutting_moves", "rotary_only_moves"):
            log.counts[name] = min(log.counts[name], counts[name] + 1)

    def _turn(self, values: dict[str, float]) -> Point | None:
        """Return the tool axis that A B C words ask for, or None where they ask for nothing."""
        state = self.state
        if values.keys().isdisjoint("ABC") or self.options.rotary == "ignore":
            return None
        state.turn(values)
        if any(state.rotary) and not state.tip_control:
            note = (
                "rotary words without tool centre point control: X Y Z are read as the tip in the part frame, "
                f"A B C as axes of the {self.options.rotary}"
            )
            self.log.note(note, self.line)
        return state.rotary_axis(self.options.rotary, 1.0)

    def _rapid(self, target: Point, axis: Point | None = None) -> None:
        state = self.state
        state.position = target
        if state.knows_position():
            self.log.rapid(target, axis)
        else:
            self.log.counts["rapid_moves"] += 1
            self.log.place(target, axis)

    def _feed(self, length: float) -> float:
        """Return the feed of a move of this length [mm] in mm/s; 0 where no feed is known."""
        feed = self.state.feed_mm_s(length)
        if feed is None:
            self.log.note("cutting moves before any feed F have none", self.line)
            return 0.0
        return feed

    def _arc(self, values: dict[str, float]) -> None:
        """Cut along an arc: G2 clockwise, G3 counter-clockwise, seen from the positive end of the plane's normal."""
        state = self.state
        state.note_start(self.log, self.line)
        normal = PLANE_NORMALS[state.plane]
        plane = PLANE_AXES[state.plane]
        target, start = state.target(values, range(3)), state.position
        right_hand = state.motion == 3.0
        letters = [letter for letter in (("I", "J", "K")[axis] for axis in plane) if letter in values]
        if "R" in values:
            radius = values["R"] * state.scale
            found = centre_from_radius(start, target, normal, radius, right_hand=right_hand)
            if found is None:
                chord = math.dist([start[axis] for axis in plane], [target[axis] for axis in plane])
                message = f"arc of radius R {radius:g} mm cannot join ends that are {chord:g} mm apart"
                raise self.error(f"{message}, expected 0 < distance <= {2 * abs(radius):g} mm")
            centre = found
        elif letters:
            centre = state.centre(start, values, plane)
        else:
            names = " ".join(("I", "J", "K")[axis] for axis in plane)
            raise self.error(f"arc has neither a centre ({names}) nor a radius (R)")
        turns = int(values["P"]) if values.get("P", 1.0) >= 1.0 and "P" in values else 1
        arc = arc_about(start, target, centre, normal, right_hand=right_hand, turns=turns)
        if not fits_circle(arc.radius, arc.end_radius):
            message = f"arc starts {arc.radius:.4f} mm from its centre and ends {arc.end_radius:.4f} mm from it"
            hint = "expected the same radius; I J K may count otherwise (option arc_centres)"
            raise _OffCircleError(f"{message}, {hint}", file=self.file, where=self.line)
        self.log.arc(arc, target, self._feed(arc.length))
        state.position = target


#: Greatest turn of the rotary axes between waypoints. [deg]
TURN_STEP = 1.0
PROBES = {31.0, 38.2, 38.3, 38.4, 38.5}
OFFSETS = {52.0, 92.0, 92.1, 92.2, 92.3}


def _angle(before: Point, after: Point) -> float:
    return math.atan2(math.hypot(*cross(before, after)), dot(before, after))


def _setter(**changes: object) -> Callable[[State], None]:
    def change(state: State) -> None:
        for name, value in changes.items():
            setattr(state, name, value)

    return change


MODES: dict[float, Callable[[State], None]] = {
    17.0: _setter(plane=17), 18.0: _setter(plane=18), 19.0: _setter(plane=19),
    90.0: _setter(incremental=False), 91.0: _setter(incremental=True),
    90.1: _setter(centres="absolute", centres_stated=True), 91.1: _setter(centres="incremental", centres_stated=True),
    93.0: _setter(feed_mode=93), 94.0: _setter(feed_mode=94), 95.0: _setter(feed_mode=95),
    98.0: _setter(retract_to_start=True), 99.0: _setter(retract_to_start=False),
}
