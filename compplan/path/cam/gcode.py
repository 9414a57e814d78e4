"""G-code (RS-274, ISO 6983) of milling dialects: motion, arcs, planes, units, distance modes, offsets, feeds."""

from __future__ import annotations

import math
import re
from pathlib import Path

from compplan.errors import InputError
from compplan.path.cam.arcs import Point, arc_about, centre_from_radius, combine, cross, dot, fits_circle
from compplan.path.cam.gcode_codes import (
    ALONE,
    CYCLES,
    MODES,
    MOST_TURNS,
    NOTED,
    REFUSED,
    SILENT,
    TURN_STEP,
)
from compplan.path.cam.gcode_corners import Corner, cut_corner
from compplan.path.cam.gcode_cycles import run_cycle
from compplan.path.cam.gcode_frames import FrameReader
from compplan.path.cam.gcode_machine import end_machine, start_machine, stop_machine
from compplan.path.cam.gcode_state import PLANE_AXES, PLANE_NORMALS, State
from compplan.path.cam.gcode_words import CORNER_WORDS
from compplan.path.cam.lines import split_lines
from compplan.path.cam.moves import CamFile
from compplan.path.cam.options import CamTable

CENTRE_READINGS = ("incremental", "absolute", "reversed")
#: Words that turn the tool: rotary axes, and its direction (Siemens).
ROTARY = (*"ABC", "A3", "B3", "C3")
#: Words that a move may have.
MOVING = frozenset((*"XYZABCIJKRUVW", "A3", "B3", "C3"))
#: Different arcs that must fit another reading of I J K, and not the usual one, before it is taken.
FEWEST_PROOFS = 2
#: Beginning of a block that holds a G code.
BEGINNING = re.compile(
    r"^[ \t]*(/\d?[ \t]*)?([A-FH-Z:][ \t]*[-+]?[\d.]+[ \t]*){0,9}G[ \t]*\d", re.MULTILINE | re.IGNORECASE
)
#: Codes of which a block may hold one.
CONTRARY = ({20.0, 21.0}, {90.0, 91.0})


class _OffCircleError(InputError):
    """Tell that start and end of an arc do not lie on one circle, in one reading of I J K."""


name = "gcode"
suffixes = (
    ".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".mpf", ".spf", ".iso", ".eia", ".h", ".ptp", ".min", ".gc", ".g",
    ".fnc", ".dnc", ".din", ".pim", ".anc",
)


def recognise(text: str) -> bool:
    """Tell whether a text is G-code: one of its lines begins with words, a G code among them."""
    return BEGINNING.search(text) is not None


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read G-code.

    I J K count from the start of an arc. Where that leaves arcs off their circles, another reading is taken if every
    arc of the file then lies on its circle and at least two different ones prove it: a full circle fits any reading.

    Args:
        text: The program.
        file: Its file, for messages.
        options: What the program does not say by itself.

    Raises:
        InputError: With file and line, if the program has an arc without centre or off its circle, or uses what is not
            read here: expressions, splines, rotated or scaled coordinates, conversational blocks.

    """
    readings = CENTRE_READINGS if options.arc_centres is None else (options.arc_centres,)
    first_fault: _OffCircleError | None = None
    lines = list(split_lines(text))
    for reading in readings:
        reader = _Reader(file, options, reading)
        try:
            reader.run(lines)
        except _OffCircleError as fault:
            first_fault = first_fault or fault
            if reader.state.centres_stated:
                break
            continue
        except InputError as fault:
            raise fault if fault.file else reader.error(fault.message) from None
        if first_fault is not None:
            if len(reader.proofs) < FEWEST_PROOFS:
                continue
            meaning = {"absolute": "absolute", "reversed": "counted from the centre to the start"}[reading]
            note = f"arc centres I J K are read as {meaning}: only so every arc of the file lies on a circle"
            reader.log.note(note, int(first_fault.where or 1))
        return reader.log.finish(file, "gcode", reader.state.unit_words(), len(lines))
    assert first_fault is not None
    raise first_fault


class _Reader(FrameReader):
    """Carry out a program block by block."""

    def __init__(self, file: Path, options: CamTable, reading: str) -> None:
        super().__init__(file, options, State(scale=25.4 if options.unit == "inch" else 1.0, centres=reading))
        self.corner: Corner | None = None
        self.proofs: set[tuple[float, ...]] = set()

    def finish(self) -> None:
        """Refuse a corner that no move follows; stop what still turns."""
        if self.corner is not None:
            self.line = self.corner.line
            raise self.error("a rounded or cut corner has no straight move after it")
        end_machine(self.state, self.log, self.line)

    def run_block(self, words: list[tuple[str, float]]) -> bool:
        """Carry out one block; return whether the program ends."""
        values: dict[str, float] = {}
        codes: list[float] = []
        machine: list[float] = []
        for letter, number in words:
            if letter in "GM":
                (codes if letter == "G" else machine).append(number)
            else:
                values[letter] = number
        if machine:
            self._check_machine(machine)
        once = self._run_codes(codes, values) if codes else ""
        state, dwells = self.state, 4.0 in codes
        if "F" in values and not dwells:
            state.set_feed(values["F"])
        if machine or dwells or "S" in values or "T" in values:
            start_machine(machine, values, codes, state, self.log, self.line)
        if once == "machine":
            self._move_in_machine(values)
        elif not once and not values.keys().isdisjoint(MOVING):
            self._move(values)
        return stop_machine(machine, state, self.log, self.line) if machine else False

    def _check_machine(self, machine: list[float]) -> None:
        if called := {97.0, 98.0}.intersection(machine):
            code = called.pop()
            raise self.error(f"subprogram call M{code:g} is not read; write the program out in the CAM system")
        self.state.tip_control = self.state.tip_control or 128.0 in machine

    def _run_codes(self, codes: list[float], values: dict[str, float]) -> str:
        """Set what G codes set; return a reason where the coordinates of the block are no move."""
        once = ""
        state = self.state
        for group in CONTRARY:
            if len(group & set(codes)) > 1:
                said = " and ".join(f"G{code:g}" for code in sorted(group & set(codes)))
                raise self.error(f"{said} in one block contradict each other")
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
            elif code in (70.0, 71.0) and values.keys() & set("PQUWIJL"):
                raise self.error(f"G{code:g} as a lathe cycle or bolt circle is not read; post-process without it")
            elif code in (20.0, 21.0, 70.0, 71.0):
                state.set_unit(25.4 if code in (20.0, 70.0) else 1.0)
            elif code in ALONE:
                once = self._run_once(code, values)
            elif 54.0 <= code < 60.0 or 500.0 <= code < 600.0 or code == 154.0:
                self._use_offset(code, values)
            elif code in (43.4, 43.5):
                state.tip_control = True
            elif code in NOTED:
                self.log.note(NOTED[code], self.line)
            elif code not in SILENT:
                self._pass_over(code, codes, values)
            if code == 80.0:
                state.motion = None
        return once

    def _pass_over(self, code: float, codes: list[float], values: dict[str, float]) -> None:
        """Note a code that is not known; refuse it where it may claim the coordinates of its block."""
        if not values.keys().isdisjoint(MOVING) and not {0.0, 1.0, 2.0, 3.0} & set(codes):
            raise self.error(f"G{code:g} with coordinates is not read and may move the tool; post-process without it")
        self.log.note(f"G{code:g} is not read", self.line)

    def _move(self, values: dict[str, float]) -> None:
        """Carry out the motion of a block."""
        state = self.state
        if state.motion in CYCLES:
            run_cycle(state.motion or 0.0, values, state, self.log, self.options.cycles == "expand", self.line)
            return
        if not values.keys().isdisjoint("UVW"):
            self.log.note("axes U V W are not read", self.line)
        if "E" in values:
            self.log.note("axis E is not read", self.line)
        corner = next((kind for kind in set(CORNER_WORDS.values()) if kind in values), None)
        if (corner or self.corner) and state.motion != 1.0:
            raise self.error("a corner is rounded or cut between two straight moves (G1) only; post-process without it")
        if state.motion in (2.0, 3.0):
            self._arc(values)
            return
        self._check_straight(values)
        if values.keys().isdisjoint(("X", "Y", "Z", *ROTARY)):
            return
        if state.motion == 1.0:
            state.note_start(self.log, self.line)  # before the block says where its own axes go
        target = state.target(values, range(3))
        axis = self._turn(values)
        if state.motion == 1.0:
            before = self.log.axis
            pieces = 1 if axis is None else math.ceil(math.degrees(_angle(before, axis)) / TURN_STEP - 1e-9) or 1
            feed = self._feed(math.dist(target, self.log.position))
            if corner or self.corner:
                self._cut_corner(target, feed, (corner, values[corner] * state.scale) if corner else None, axis)
            elif axis is None or pieces == 1:
                self.log.line(target, feed, axis)
            else:
                self._turning_line(target, feed, pieces, values, axis)
            state.position = target
        else:
            if state.motion is None:
                self.log.note("coordinates without G0 or G1 are read as rapid moves", self.line)
            self._rapid(target, axis)

    def _check_straight(self, values: dict[str, float]) -> None:
        """Refuse or note words of an arc in a straight move."""
        if values.get("R", 0.0) != 0.0:
            raise self.error(f"R{values['R']:g} in a straight move is not read; a rounded corner is written ,R")
        if not values.keys().isdisjoint("IJK"):
            self.log.note("I J K in straight moves are not read", self.line)

    def _cut_corner(self, target: Point, feed: float, asked: tuple[str, float] | None, axis: Point | None) -> None:
        """Cut a straight move that a rounded or cut corner begins, ends, or both."""
        if axis is not None:
            raise self.error("a rounded or cut corner while rotary axes turn is not read")
        log, before, start = self.log, self.corner, self.log.position
        if before is not None:
            try:
                first, start, arc = cut_corner(before, target)
            except ValueError as fault:
                raise self.error(f"{fault}, in the block of line {before.line}") from None
            log.line(first, before.feed)
            if arc is not None:
                log.arc(arc, start, feed)
            elif start != first:
                log.line(start, feed)
        self.corner = Corner(*asked, start, target, feed, self.line) if asked else None
        if asked is None:
            log.line(target, feed)

    def _turning_line(
        self, target: Point, feed: float, pieces: int, values: dict[str, float], end: Point
    ) -> None:
        """Cut to a point while the rotary axes, or the tool's direction, turn evenly: one move, in pieces."""
        state, log = self.state, self.log
        start, before, counts = log.position, log.axis, dict(log.counts)
        for piece in range(1, pieces + 1):
            share = piece / pieces
            point = target if piece == pieces else combine(1.0 - share, start, share, target)
            on_way = turn_towards(before, end, share)
            axis = on_way if "A3" in values else state.rotary_axis(self.options.rotary, share)
            log.line(point, feed, axis)
        for name in ("cutting_moves", "rotary_only_moves"):
            log.counts[name] = min(log.counts[name], counts[name] + 1)

    def _turn(self, values: dict[str, float]) -> Point | None:
        """Return the tool axis that A B C or A3 B3 C3 ask for, or None where they ask for nothing."""
        state = self.state
        named = [letter for letter in ("A3", "B3", "C3") if letter in values]
        if named:
            axis = tuple(values.get(letter, 0.0) for letter in ("A3", "B3", "C3"))
            length = math.hypot(*axis)
            if len(named) < 3 or not 1e-3 < length < 1e3:
                raise self.error(f"tool direction A3 B3 C3 is {axis}, expected three numbers that are not all 0")
            return axis[0] / length, axis[1] / length, axis[2] / length
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
        turns = values.get("P", 1.0)
        if turns == 0.0:
            self.log.note("arc of P0 turns is read as a single arc", self.line)
        elif not 1.0 <= turns <= MOST_TURNS or turns != int(turns):
            raise self.error(f"arc of P{turns:g} turns, expected a whole number from 1 to {MOST_TURNS}")
        arc = arc_about(start, target, centre, normal, right_hand=right_hand, turns=max(1, int(turns)))
        if not fits_circle(arc.radius, arc.end_radius):
            message = f"arc starts {arc.radius:.4f} mm from its centre and ends {arc.end_radius:.4f} mm from it"
            hint = "expected the same radius; I J K may count otherwise (option arc_centres)"
            raise _OffCircleError(f"{message}, {hint}", file=self.file, where=self.line)
        if letters and "R" not in values and state.centres != "incremental":
            self._prove(start, target, values, right_hand=right_hand)
        self.log.arc(arc, target, self._feed(arc.length))
        state.position = target

    def _prove(self, start: Point, target: Point, values: dict[str, float], *, right_hand: bool) -> None:
        """Keep an arc that lies on no circle where its I J K count as usual."""
        state, plane = self.state, PLANE_AXES[self.state.plane]
        usual = combine(1.0, start, state.scale, tuple(values.get(letter, 0.0) for letter in "IJK"))  # type: ignore
        arc = arc_about(start, target, usual, PLANE_NORMALS[state.plane], right_hand=right_hand)
        if not fits_circle(arc.radius, arc.end_radius):
            ends = [place[axis] for place in (start, target) for axis in plane]
            self.proofs.add((*(round(number, 3) for number in ends), *(values.get(letter, 0.0) for letter in "IJK")))


def _angle(before: Point, after: Point) -> float:
    return math.atan2(math.hypot(*cross(before, after)), dot(before, after))


def turn_towards(start: Point, end: Point, share: float) -> Point:
    """Return a direction on the great circle between two, which are not opposite, after a share of the turn."""
    angle = _angle(start, end)
    if angle < 1e-9 or share == 1.0:
        return end
    sine = math.sin(angle)
    return combine(math.sin((1.0 - share) * angle) / sine, start, math.sin(share * angle) / sine, end)
