"""Reader of G-code of the RS-274 family (Fanuc, Haas, LinuxCNC, printers), with one table entry per code.

A new code is one line of `G_CODES`: `ignore()` if it does not affect the path, `note(text)` if it is skipped with a
note, `refuse(what)` if it changes the path and is not supported, `set_mode(name=value)` if it sets modal state, or
`Code(operation)` with a function operation(dialect, block, code).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import MOST_TURNS, OffCircleError, Point
from compplan.toolpath.readers.cnc.cycles import begin_cycle, run_cycle
from compplan.toolpath.readers.cnc.flow import END, CncProgram, Flow
from compplan.toolpath.readers.cnc.interpreter import COMMON, MOTIONS, Code, Interpreter, ignore, note, refuse, set_mode
from compplan.toolpath.readers.cnc.motion import DIRECTIONS, PLAIN, STRAIGHT
from compplan.toolpath.readers.cnc.origins import Origins
from compplan.toolpath.readers.cnc.rs274_lexer import LENGTHS, WITH_COORDINATES, Lexer, owns_words
from compplan.toolpath.readers.cnc.rs274_macro import Macros
from compplan.toolpath.readers.cnc.state import INCH, CncBlock, State
from compplan.toolpath.readers.frames import UP
from compplan.toolpath.readers.lines import split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable

CENTRE_READINGS = ("incremental", "absolute", "reversed")
#: Least number of different arcs that lie on circles with another meaning of I J K only, before it is assumed.
FEWEST_PROOFS = 2
#: Beginning of a block with a G code.
BEGINNING = re.compile(
    r"^[ \t]*(/\d?[ \t]*)?([A-FH-Z:][ \t]*[-+]?[\d.]+[ \t]*){0,9}G[ \t]*\d", re.MULTILINE | re.IGNORECASE
)
#: Tool change code.
CHANGE = re.compile(r"M0*6(?!\d)", re.IGNORECASE)

#: Temperatures of hot end and bed mark printer files, with lengths in millimetres and E as the extruder.
PRINTER = re.compile(
    r"^[ \t]*(?:N\d+[ \t]*)?M(?:104|109|140|190)[ \t]*(?:T\d+[ \t]*)?[SR][ \t]*\d", re.MULTILINE | re.IGNORECASE
)

#: Marks of a turning program, if it has no Y: a constant cutting speed, a limit of S, tools with offsets (T0101).
TURNED = re.compile(
    r"^[^(;\n]*?(?:G0*96(?![\d.])|G0*(?:50|92)\s*S|LIMS\s*=|T\d{4}(?!\d|[^(;\n]*M0*6))", re.MULTILINE | re.IGNORECASE
)
WITH_Y = re.compile(r"^[^(;\n]*?Y\s*=?\s*[-+.\d#\[]", re.MULTILINE | re.IGNORECASE)

name = "gcode"
suffixes = (
    ".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".iso", ".eia", ".h", ".ptp", ".min", ".gc", ".g",
    ".fnc", ".dnc", ".din", ".pim", ".anc",
)  # fmt: skip
#: Words of a move, and those of its end point.
MOVING, PLACES = frozenset("XYZABCIJKRUVW"), frozenset("XYZABCUVW")
CYCLES = frozenset({73.0, 74.0, 76.0, *(float(number) for number in range(81, 90))})
#: Codes that set the unit, and those with which a block needs none: its words are not lengths of the path.
UNITS = frozenset({20.0, 21.0, 70.0, 71.0})
UNITLESS = UNITS | {4.0, 10.0, 53.0, 153.0}
#: Modal groups; a block may hold one code of each.
CONTRARY = (
    frozenset({20.0, 21.0}), frozenset({90.0, 91.0}), frozenset({17.0, 18.0, 19.0}), frozenset({93.0, 94.0, 95.0}),
    frozenset({98.0, 99.0}), MOTIONS | CYCLES,
)  # fmt: skip
#: Words of the tool axis with G43.5, and their addresses in all dialects.
VECTOR = tuple(zip("IJK", DIRECTIONS, strict=True))
#: Codes that own a word H.
TOOL_CONTROL = frozenset({43.0, 43.4, 43.5, 44.0, 234.0})
#: Codes in a block with G54 that own no word P.
WITHOUT_P = UNITS | {0.0, 1.0, 17.0, 18.0, 19.0, 40.0, 43.0, 49.0, 54.0, 80.0, 90.0, 91.0, 94.0}
LENGTH_NOTE = "tool length compensation (G43) is not applied: the path is that of the tool tip"
HOMING_NOTE = "moves of a printer after homing are travel until X Y Z are known: the path begins where they are"
#: Block of X Y Z F only, with the extruder of a printer.
PRINTED = re.compile(PLAIN.pattern + r"(E[-+]?[\d.]+[ \t]*)?")
#: Work offsets of Haas: G110 is G154 P1.
HAAS_OFFSETS = (110.0, 111.0, *(float(number) for number in range(114, 130)))
ENDS = frozenset({2.0, 30.0, 99.0})


def recognise(text: str) -> bool:
    """Return whether a text is G-code: one of its lines begins with words that include a G code."""
    return BEGINNING.search(text) is not None


def refuse_turning(text: str, file: Path) -> None:
    """Refuse a program of a lathe."""
    if not WITH_Y.search(text) and (turned := TURNED.search(text)):
        message = "a turning program (no Y) is not read: X may be a diameter; in a milling program state Y before a cut"
        raise InputError(message, file=file, where=text.count("\n", 0, turned.start()) + 1)


def read(text: str, file: Path, options: CamTable) -> CamFile:
    """Read G-code.

    I J K are relative to the start of an arc. If arcs then do not lie on circles, I J K are read as absolute or
    reversed, provided that all arcs of the file lie on circles and at least two different arcs do so only then.
    """
    first_fault: OffCircleError | None = None
    refuse_turning(text, file)
    lines = split_lines(text)
    changes_by_t, printer = CHANGE.search(text) is None, PRINTER.search(text) is not None
    for reading in CENTRE_READINGS:
        scale = INCH if options.unit == "inch" else 1.0
        state = State(scale, feed_scale=scale, centres=reading, changes_by_t=changes_by_t, printer=printer)
        reader = Rs274(file, options, state)
        try:
            reader.run(lines)
        except OffCircleError as fault:
            first_fault = first_fault or fault
            if state.centres_stated:
                break
            continue
        if first_fault is not None:
            if len(reader.it.motion.proofs) < FEWEST_PROOFS:
                continue
            meaning = {"absolute": "absolute", "reversed": "counted from the centre to the start"}[reading]
            note = f"arc centres I J K are read as {meaning}: only so every arc of the file lies on a circle"
            reader.it.log.note(note, int(first_fault.where or 1))
        return reader.it.log.finish(file, "gcode", ", ".join(state.units) or "not stated", len(lines))
    assert first_fault is not None
    raise first_fault


class Rs274:
    """Dialect of the RS-274 family: executes the lines and blocks of a program."""

    tip_word, turns_to_plane, unit_words = "", True, "G20 or G21"
    frames: tuple[str, ...] = ("plane", "rotation", "scale", "mirror", "origin")
    ends, moving = ENDS, MOVING
    silent = frozenset({6.0, 48.0, 49.0, 61.0, 97.0, 98.0, 128.0, 129.0})

    def __init__(self, file: Path, options: CamTable, state: State) -> None:
        self.it = Interpreter(file, options, state, self, Flow(file), starts_at_zero=True)
        self.origins = Origins(self.it, "G10 L2")
        self.macros = Macros(self.it.flow)
        self.plain = PRINTED if state.printer else PLAIN
        self.lexer = Lexer(self.it, self.macros)
        #: Whether I J K of straight moves are the tool axis (G43.5).
        self.vectors = False

    def run(self, lines: Sequence[str]) -> None:
        """Execute the first program of a file."""
        self.it.run(lambda: self.macros.find_programs(lines, self.it.file), self.origins.check_used)

    def square(self) -> Point:
        """Return the tool axis with all rotary axes at 0."""
        return UP

    def turn_to_plane(self) -> Point:
        """Orient the tool normal to the tilted plane by rotary words; the position of its tip is then unknown."""
        self.origins.turn_to_plane(53.1, stays=False)
        return self.it.plane.turn(UP)

    def run_line(self, program: CncProgram, index: int) -> int:
        """Execute a line; return the index of the next one, or END."""
        it, raw = self.it, program.lines[index]
        if it.steady and (found := self.plain.fullmatch(raw)) and it.motion.cut_plain(found):
            return index + 1
        block = self.lexer.read(raw)
        ended = block is not None and self.run_block(block)
        it.steady = self.lexer.begun and self.it.frames.keys() <= {"origin"} and it.motion.is_steady()
        if self.macros.next is not None:
            index, self.macros.next = self.macros.next - 1, None
        return END if ended else index + 1

    def run_block(self, block: CncBlock) -> bool:
        """Execute one block; return whether the program ends.

        The order of execution does not depend on the order of the words: units, distance mode, plane, feed mode; other
        G codes, including those that use the coordinates; F, S, T and M codes; the motion; calls; stops and ends.
        """
        it, values, codes, machine = self.it, block.values, block.codes, block.machine
        if 65.0 in codes:
            self.macros.call_number(values, macro=True)
            return False
        if machine:
            machine.sort(key=lambda code: (code in ENDS or code < 2.0, code))
            if machine[0] in (72.0, 73.0) and not values.keys() - {"N"}:
                raise InputError("M72 and M73 alone bring back stored modes, or mirror an axis; write the G codes")
            if self._give_words(block):
                return False
            if 198.0 in machine or (99.0 in machine and "P" in values):
                raise InputError("a call of another file (M198), or a block to return to (M99 P), is not read; write "
                                 "the program out in the CAM system")  # fmt: skip
            if 128.0 in machine or 129.0 in machine:
                it.control_tip(128.0 in machine)
        state = it.state
        if "E" in values and not state.printer and 187.0 not in codes:
            raise InputError(f"word E{values['E']:g} is read in files of printers only (M104, M109); leave it out")
        state.cancels_length = 49.0 in codes or (values.get("H") == 0.0 and not {43.0, 44.0} & set(codes))
        if not (state.unit_stated or state.printer) and UNITLESS.isdisjoint(codes):
            it.check_unit(values.get(letter) for letter in LENGTHS)
        for group in CONTRARY if len(codes) > 1 else ():
            if len(conflicts := sorted(group & set(codes))) > 1:
                raise InputError(f"G{conflicts[0]:g} and G{conflicts[1]:g} stand in one block, expected one of them")
        coordinate_use = it.run_words(block, codes, find_code) if codes else ""
        if "F" in values and 4.0 not in codes:
            state.set_feed(values["F"])
        if machine or 4.0 in codes or "S" in values or "T" in values:
            it.machine.start(block)
        calls = 98.0 in machine or 97.0 in machine
        if coordinate_use == "machine":
            it.leave_out_machine_move(block, "G53")
        elif not coordinate_use and block.has(MOVING):
            if calls:
                block.values = {letter: number for letter, number in values.items() if letter not in "PLK"}
            self.move(block)
        if not machine:
            return False
        if calls:
            self.macros.call_number(values, local=97.0 in machine)
        it.flow.over = it.flow.over or not {2.0, 30.0}.isdisjoint(machine)
        return it.machine.stop(machine)

    def _give_words(self, block: CncBlock) -> bool:
        """Assign the words of a block to the M code that owns them; return whether the block is complete."""
        machine, it = block.machine, self.it
        owner = next((code for code in machine if owns_words(code) and code not in self.silent), None)
        if not block.codes and block.has(PLACES):
            unclear = [code for code in machine if code not in WITH_COORDINATES and (owns_words(code) or code >= 200.0)]
            if unclear:
                raise InputError(f"M{unclear[0]:g} with coordinates and no G code: whose they are is not known; "
                                 "write the motion code (G0, G1) into the block")  # fmt: skip
        if owner is None:
            return False
        it.note(f"M{owner:g} is not read")
        it.log.add_event("comment", text=f"M{owner:g} of the CAM file")
        if MOTIONS.isdisjoint(block.codes):
            return True
        for letter in "STPQ":
            block.values.pop(letter, None)
        machine.remove(owner)
        return False

    def move(self, block: CncBlock) -> None:
        """Execute the motion of a block, translated to the words that all dialects share."""
        it, state, values = self.it, self.it.state, block.values
        if other := next((letter for letter in "UVW" if letter in values), ""):
            raise InputError(f"axis {other}{values[other]:g} moves the tool or the part and is not read; leave it out")
        if state.polar and ("X" in values or "Y" in values):
            if (state.incremental and "X" in values) or state.plane != 17:
                raise InputError("polar coordinates (G16) are not read outside of the plane G17, nor a radius in G91")
            for letter, address in (("X", "RP"), ("Y", "AP")):
                if letter in values:
                    values[address] = values.pop(letter)
        if state.cycle_code:
            self.origins.check_plane()
            run_cycle(it, block)
            return
        if values.get("L", 1.0) != 1.0:
            raise InputError(f"L{values['L']:g} of a move is not read; write the moves out, turns of an arc as P")
        if state.cancels_length and "Z" in values:
            it.leave_without_length(block, "H0, G49")
            return
        if self.vectors and state.motion in (0.0, 1.0):
            values.update({direction: values.pop(letter) for letter, direction in VECTOR if letter in values})
        if state.motion in (2.0, 3.0):
            turns = values.get("P", 1.0)
            if turns == 0.0:
                it.note("arc of P0 turns is read as a single arc")
            elif not 1.0 <= turns <= MOST_TURNS or turns != int(turns):
                raise InputError(f"arc of P{turns:g} turns, expected a whole number from 1 to {MOST_TURNS}")
            values["TURN"] = max(turns - 1.0, 0.0)
            values.update({"CR": values["R"]} if "R" in values else {})
        elif "R" in values and values["R"] != 0.0:
            raise InputError(f"R{values['R']:g} in a straight move is not read; a rounded corner is written ,R")
        unknown = bool(it.course.unknown) and not it.course.suspended
        if state.printer and state.motion == 1.0 and unknown and ("E" not in values or not it.log.waypoints):
            it.note(HOMING_NOTE)
            it.course.rapid(*it.motion.target(block))
            return
        if state.motion != 0.0 and block.has(STRAIGHT):
            self.origins.check_plane()
        it.motion.move(block)

    def set_unit(self, block: CncBlock, code: float) -> None:
        """G20, G21 (G70, G71): inches or millimetres."""
        it, inch = self.it, code in (20.0, 70.0)
        if code in (70.0, 71.0) and block.has(frozenset("PQUWIJL")):
            raise InputError(f"G{code:g} as a lathe cycle or bolt circle is not read; post-process without it")
        if inch and not it.state.unit_stated and it.options.unit is None and self.origins.origins:
            raise InputError("inches are stated after G10 has set work offsets; state the unit before them")
        it.state.set_unit(INCH if inch else 1.0)

    def use_offset(self, block: CncBlock, code: float) -> None:
        """G54 to G59, G154, G500 to G599: work offsets; P numbers further ones, with G54 if no other word owns it."""
        numbered = code in (54.1, 154.0) or (code == 54.0 and not block.machine and {*block.codes} <= WITHOUT_P)
        self.origins.use(code, block.values.get("P", 0.0) if numbered else 0.0)

    def use_haas_offset(self, block: CncBlock, code: float) -> None:
        """G110 to G129: a work offset of Haas; on other controls a move."""
        if block.has(MOVING) and MOTIONS.isdisjoint(block.codes):
            self.it.skip_unknown(block, code)
        self.origins.use(code + 1000.0 - 109.0)

    def set_dynamic_offset(self, block: CncBlock, code: float) -> None:
        """G54.2 P, G254, G255: dynamic work offset, which rotates with the table, on or off."""
        self.it.rotary.dynamic = block.values.get("P", 0.0) != 0.0 if code == 54.2 else code == 254.0
        self.it.set_frame()

    def compensate_length(self, block: CncBlock, code: float) -> None:
        """G43, G44, G49 (tool length compensation), G43.4, G43.5, G234 (tool centre point control)."""
        self.it.control_tip(code in (43.4, 43.5, 234.0))
        self.vectors = code == 43.5
        if code in (43.0, 44.0):
            self.it.note(LENGTH_NOTE)

    def probe(self, block: CncBlock, code: float) -> None:
        """G31, G38: probing; G29: bed levelling of printers."""
        self.it.note(f"G{code:g} (probing) is left out; where it ended is not known")
        self.it.course.mark_unknown(block.list_axes() or range(3))

    def set_polar(self, block: CncBlock, code: float) -> None:
        """G15, G16: end or begin polar coordinates, X radius, Y angle; by default those of the tool position.

        With H of their own they activate a work offset (Okuma).
        """
        if "H" in block.values and TOOL_CONTROL.isdisjoint(block.codes):
            self.origins.use(54.1, block.values["H"])
            return
        self.it.state.polar = code == 16.0
        self.it.state.polar_words.clear()


#: Codes that change the path and are not supported.
REFUSED = {
    "NURBS": (5.2, 6.2), "lathe diameters": (7.0,), "pocket cycles": (12.0, 13.0), "threading": (32.0,),
    "rigid tapping": (33.1,), "modal macro calls": (66.0, 66.1), "coordinate rotation": (68.1,),
    "another tilted work plane": (68.3, 68.4, 268.0), "cylindrical or polar interpolation": (7.1, 12.1, 107.0, 112.0),
    "workpiece setting errors": (54.4,),
}  # fmt: skip
PROBE, POLAR = Code(Rs274.probe, 2, "once"), Code(Rs274.set_polar)
DROP = Code(lambda dialect, block, code: dialect.origins.cancel_shift(code), 2, "once")
HOME = Code(lambda dialect, block, code: dialect.origins.go_home(code, block), 2, "once")
MIRROR = Code(lambda dialect, block, code: dialect.origins.mirror(code, block), 2, "once")
TO_PLANE = Code(lambda dialect, block, code: dialect.origins.turn_to_plane(code, stays=code == 53.6), 2, "once")
DYNAMIC = Code(Rs274.set_dynamic_offset, 2, "once")
OFFSET = Code(Rs274.use_offset)

G_CODES: dict[float | str, Code] = {
    **COMMON,
    **{code: set_mode(1, motion=code, cycle_code=0.0) for code in MOTIONS},
    **dict.fromkeys(CYCLES, Code(lambda dialect, block, code: begin_cycle(dialect.it, code), 1)),
    80.0: set_mode(cycle_code=0.0),
    # modes
    15.0: POLAR, 16.0: POLAR, 17.0: set_mode(plane=17), 18.0: set_mode(plane=18), 19.0: set_mode(plane=19),
    90.1: set_mode(centres="absolute", centres_stated=True), 91.1: set_mode(centres="incremental", centres_stated=True),
    98.0: set_mode(retract_to_start=True), 99.0: set_mode(retract_to_start=False),
    **dict.fromkeys(UNITS, Code(Rs274.set_unit)),
    # origins and frames
    **{float(code): OFFSET for code in range(54, 60)}, 154.0: OFFSET, 54.2: Code(Rs274.set_dynamic_offset),
    **dict.fromkeys(HAAS_OFFSETS, Code(Rs274.use_haas_offset)),
    10.0: Code(lambda dialect, block, code: dialect.origins.set_offset(block), 2, "once"),
    28.0: HOME, 30.0: HOME, 52.0: Code(lambda dialect, block, code: dialect.origins.shift(block), 2, "once"),
    92.0: Code(lambda dialect, block, code: dialect.origins.set_position(block), 2, "once"),
    92.1: DROP, 92.2: DROP, 92.3: DROP,
    50.0: Code(lambda dialect, block, code: dialect.it.set_frames(scale=None), 2, "once"),
    51.0: Code(lambda dialect, block, code: dialect.origins.scale(block), 2, "once"),
    50.1: MIRROR, 51.1: MIRROR, 53.1: TO_PLANE, 53.6: TO_PLANE, 254.0: DYNAMIC, 255.0: DYNAMIC,
    68.0: Code(lambda dialect, block, code: dialect.origins.rotate(block), 2, "once"),
    68.2: Code(lambda dialect, block, code: dialect.origins.tilt(block), 2, "once"),
    69.0: Code(lambda dialect, block, code: dialect.it.set_frames(rotation=None, plane=None), 2, "once"),
    # compensation and probing
    **dict.fromkeys((*TOOL_CONTROL, 49.0), Code(Rs274.compensate_length)),
    43.1: note(LENGTH_NOTE, "once"), 22.0: note("limits of the working space (G22) are not read", "once"),
    **dict.fromkeys((29.0, 31.0, 38.2, 38.3, 38.4, 38.5), PROBE),
    # no effect on the path
    61.1: ignore(), 67.0: ignore(), 113.0: ignore(), 269.0: ignore(),
    # refused
    **{code: refuse(what) for what, codes in REFUSED.items() for code in codes},
}  # fmt: skip


def find_code(code: float | str) -> Code | None:
    """Return the operation of a G code, None if unknown; G54 to G59.9 and G500 to G599 are work offsets."""
    found = G_CODES.get(float(code))
    return found or (OFFSET if 54.0 <= float(code) < 60.0 or 500.0 <= float(code) < 600.0 else None)
