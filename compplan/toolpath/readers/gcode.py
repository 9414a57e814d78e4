"""G-code (RS-274, ISO 6983) of milling dialects: what a block says, and in which order it acts."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.errors import InputError
from compplan.toolpath.readers.gcode_codes import (
    ALONE,
    COMPENSATED,
    CONTRARY,
    CYCLES,
    FRAMES,
    HAAS_OFFSETS,
    MODES,
    NOTED,
    PRINTER,
    RANKS,
    REFUSED,
    SILENT,
    TIP_OFF,
    TIP_ON,
)
from compplan.toolpath.readers.gcode_machine import ENDS, PLACING, end_machine, owns_words, start_machine, stop_machine
from compplan.toolpath.readers.gcode_moves import MotionReader, OffCircleError
from compplan.toolpath.readers.gcode_state import PLANE_AXES, State
from compplan.toolpath.readers.gcode_text import LENGTHS
from compplan.toolpath.readers.lines import split_lines
from compplan.toolpath.readers.moves import CamFile
from compplan.toolpath.readers.options import CamTable, ask_compensation
from compplan.toolpath.readers.start import refuse_unit

CENTRE_READINGS = ("incremental", "absolute", "reversed")
#: Words that a move may have.
MOVING = frozenset((*"XYZABCIJKRUVW", "A3", "B3", "C3"))
#: ... and those of them that say where it goes.
PLACES = frozenset((*"XYZABCUVW", "A3", "B3", "C3"))
MOTIONS = frozenset({0.0, 1.0, 2.0, 3.0})
#: Codes of a unit, and those of blocks whose words are no lengths of the path.
UNITS = frozenset({20.0, 21.0, 70.0, 71.0})
UNITLESS = frozenset({4.0, 10.0, 53.0, 153.0})
#: Different arcs that must fit another reading of I J K, and not the usual one, before it is taken.
FEWEST_PROOFS = 2
#: Beginning of a block that holds a G code.
BEGINNING = re.compile(
    r"^[ \t]*(/\d?[ \t]*)?([A-FH-Z:][ \t]*[-+]?[\d.]+[ \t]*){0,9}G[ \t]*\d", re.MULTILINE | re.IGNORECASE
)
#: A tool change code.
CHANGE = re.compile(r"M0*6(?!\d)", re.IGNORECASE)

name = "gcode"
suffixes = (
    ".nc", ".gcode", ".tap", ".ngc", ".cnc", ".ncc", ".iso", ".eia", ".h", ".ptp", ".min", ".gc", ".g",
    ".fnc", ".dnc", ".din", ".pim", ".anc",
)  # fmt: skip


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
        InputError: With file and line, if the program has an arc without centre or off its circle, has two meanings
            that the options do not settle, or uses what is not read here: splines, conversational blocks.

    """
    readings = CENTRE_READINGS if options.arc_centres is None else (options.arc_centres,)
    first_fault: OffCircleError | None = None
    lines = split_lines(text)
    changes_by_t, printer = CHANGE.search(text) is None, PRINTER.search(text) is not None
    for reading in readings:
        reader = _GcodeReader(file, options, reading)
        reader.state.changes_by_t, reader.printer = changes_by_t, printer
        try:
            reader.run(lines)
        except OffCircleError as fault:
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
        return reader.log.finish(file, "gcode", ", ".join(reader.state.units) or "not stated", len(lines))
    assert first_fault is not None
    raise first_fault


class _GcodeReader(MotionReader):
    """Carry out a program block by block."""

    def __init__(self, file: Path, options: CamTable, reading: str) -> None:
        super().__init__(file, options, State(scale=25.4 if options.unit == "inch" else 1.0, centres=reading))

    def finish(self) -> None:
        """Refuse a corner that no move follows; stop what still turns."""
        if self.corner is not None:
            self.line = self.corner.line
            raise self.error("a rounded or cut corner has no straight move after it")
        self.check_offsets()
        end_machine(self.state, self.log, self.line)

    def run_block(self, words: list[tuple[str, float]]) -> bool:
        """Carry out one block; return whether the program ends.

        What a block says acts in this order, however its words are shuffled: units, distance mode, plane, feed,
        spindle, tool, frames, then a code that takes the coordinates for itself or the motion, and what stops.
        """
        values: dict[str, float] = {}
        codes: list[float] = []
        machine: list[float] = []
        for letter, number in words:
            if letter == "G":
                codes.append(number)
            elif letter == "M":
                machine.append(number)
            else:
                values[letter] = number
        self.path.line = self.line
        if 65.0 in codes:
            self.call_number(values, macro=True)
            return False
        if machine:
            machine.sort(key=lambda code: (code in ENDS or code < 2.0, code))
            if self._give_words(machine, codes, values):
                return False
            self._check_machine(machine, values)
        if "E" in values and not self.printer and 187.0 not in codes:
            raise self.error(f"word E{values['E']:g} is read in files of printers only (M104, M109); elsewhere it may "
                             "move an axis or shift the frame; post-process without it")  # fmt: skip
        self.cancels_length = 49.0 in codes or (values.get("H") == 0.0 and not {43.0, 44.0} & set(codes))
        if not self.state.unit_stated and values:
            self._ask_for_unit(codes, values)
        once = self._run_codes(codes, values) if codes else ""
        state, dwells = self.state, 4.0 in codes
        if "F" in values and not dwells:
            state.set_feed(values["F"])
        if machine or dwells or "S" in values or "T" in values:
            start_machine(machine, values, codes, state, self.log, self.line)
        if once == "machine":
            self._move_in_machine(values)
        elif not once and not values.keys().isdisjoint(MOVING):
            self._move(drop_call(values) if 98.0 in machine or 97.0 in machine else values)
        return self._end_block(machine, values) if machine else False

    def _end_block(self, machine: list[float], values: dict[str, float]) -> bool:
        """Carry out what a block calls or stops after its move; return whether the program ends."""
        if 98.0 in machine or 97.0 in machine:
            self.call_number(values, local=97.0 in machine)
        self.over = self.over or 2.0 in machine or (30.0 in machine and not self.siemens)
        return stop_machine(machine, self.state, self.log, self.line)

    def _give_words(self, machine: list[float], codes: list[float], values: dict[str, float]) -> bool:
        """Give the words of a block to the M code that owns them; return whether nothing is left to be read.

        Raises:
            InputError: If an M code that is not known may own coordinates.

        """
        owner = next((code for code in machine if owns_words(code)), None)
        if not codes and not values.keys().isdisjoint(PLACES):
            doubtful = [code for code in machine if code not in PLACING and (owns_words(code) or code >= 200.0)]
            if doubtful:
                raise self.error(f"M{doubtful[0]:g} with coordinates and no G code: whose they are is not known; "
                                 "write the motion code (G0, G1) into the block")  # fmt: skip
        if owner is None:
            return False
        self.log.note(f"M{owner:g} is not read", self.line)
        self.log.happen("comment", self.line, text=f"M{owner:g} of the CAM file")
        if MOTIONS.isdisjoint(codes):
            return True
        for letter in "STPQ":
            values.pop(letter, None)
        machine.remove(owner)
        return False

    def _check_machine(self, machine: list[float], values: dict[str, float]) -> None:
        if 198.0 in machine:
            raise self.error("subprogram call M198 of another file is not read; write the program into the file")
        if 99.0 in machine and "P" in values:
            raise self.error("M99 with a block to return to (P) is not read; write the program out in the CAM system")
        if 128.0 in machine or 129.0 in machine:
            self._control_tip(128.0 in machine)

    def _ask_for_unit(self, codes: list[float], values: dict[str, float]) -> None:
        """Refuse lengths before the file or the user states their unit; those of printers are millimetres."""
        if self.printer or self.options.unit or not UNITS.isdisjoint(codes) or not UNITLESS.isdisjoint(codes):
            return
        if any(values.get(letter, 0.0) != 0.0 for letter in LENGTHS):
            raise self.error(refuse_unit("G20 or G21").message)

    def _control_tip(self, on: bool) -> None:
        """Begin or end that X Y Z are the tip in the part frame."""
        if self.state.tip_control != on:
            self.state.tip_control = on
            if self.state.rotary:
                self.place_rotary(keep=True)

    def _check_codes(self, codes: list[float]) -> None:
        """Refuse codes that contradict each other."""
        for group in CONTRARY:
            if len(said := sorted(group & set(codes))) > 1:
                names = " and ".join(f"G{code:g}" for code in said)
                one = ", expected one motion" if said[0] in MOTIONS else ""
                raise self.error(f"{names} stand in one block{one or ' and contradict each other'}")

    def _run_codes(self, codes: list[float], values: dict[str, float]) -> str:
        """Set what G codes set; return a reason where the coordinates of the block are no move."""
        once = ""
        state = self.state
        if len(codes) > 1:
            self._check_codes(codes)
            codes = sorted(codes, key=lambda code: (RANKS.get(code, 0), code))
        for code in codes:
            if code in MOTIONS:
                state.motion, state.cycle_code = code, 0.0
            elif code in MODES:
                MODES[code](state)
            elif code in CYCLES:
                self._begin_cycle(code)
            elif code == 80.0:
                state.cycle_code = 0.0
            elif code in (5.0, 5.1):
                if not values.keys().isdisjoint("XYZIJ"):
                    raise self.error(f"G{code:g} (splines) is not read; post-process without it")
            elif code in REFUSED:
                raise self.error(f"G{code:g} ({REFUSED[code]}) is not read; post-process without it")
            elif code in UNITS:
                self._set_unit(code, values)
            elif code in (53.0, 153.0):
                once = "machine"
            elif code in ALONE:
                self._run_alone(code, values)
                once = once or "once"
            elif code not in SILENT:
                self._run_others(code, codes, values)
        return once

    def _run_alone(self, code: float, values: dict[str, float]) -> None:
        """Carry out a code that takes the coordinates of its block."""
        if code in FRAMES:
            self.run_frame(code, values)
        else:
            self._run_once(code, values)

    def _set_unit(self, code: float, values: dict[str, float]) -> None:
        if code in (70.0, 71.0) and values.keys() & set("PQUWIJL"):
            raise self.error(f"G{code:g} as a lathe cycle or bolt circle is not read; post-process without it")
        unscaled = not self.state.unit_stated and self.options.unit is None and self.state.offsets.origins
        if code in (20.0, 70.0) and unscaled:
            raise self.error("inches are stated after G10 has set work offsets; state the unit before them")
        self.state.set_unit(25.4 if code in (20.0, 70.0) else 1.0)

    def _begin_cycle(self, code: float) -> None:
        """Begin a cycle; the level it began at stays until it is cancelled."""
        state = self.state
        if not state.cycle_code:
            axis = 3 - sum(PLANE_AXES[state.plane])
            unknown = axis in state.lost or (axis not in state.known and not state.moved)
            state.cycle_start = None if unknown else state.position[axis]
            state.cycle = {}
        state.cycle_code = code

    def _run_others(self, code: float, codes: list[float], values: dict[str, float]) -> None:
        """Carry out offsets, compensations and the rest."""
        if code in (54.2,):
            self.dynamic_offset = values.get("P", 0.0) != 0.0
            self.place_rotary(keep=True)
        elif code in HAAS_OFFSETS:
            if not values.keys().isdisjoint(MOVING) and MOTIONS.isdisjoint(codes):
                self._pass_over(code, codes, values)
            self._use_offset(code, values)
        elif 54.0 <= code < 60.0 or 500.0 <= code < 600.0 or code == 154.0:
            self._use_offset(code, values)
        elif code in TIP_ON or code in TIP_OFF:
            self._control_tip(code in TIP_ON)
            if code in NOTED:
                self.log.note(NOTED[code], self.line)
        elif code in (41.1, 42.1) and values.get("D", 0.0) != 0.0:
            raise self.error(f"G{code:g} with a cutter diameter D is not read; post-process the tool centre's path")
        elif code in COMPENSATED:
            if values.get("D") != 0.0:
                self.log.note(ask_compensation(self.options, f"G{code:g}"), self.line)
        elif code in NOTED:
            self.log.note(NOTED[code], self.line)
            if code == 29.0 and values.keys().isdisjoint(PLACES):
                self.path.lose(range(3))
        else:
            self._pass_over(code, codes, values)

    def _pass_over(self, code: float, codes: list[float], values: dict[str, float]) -> None:
        """Note a code that is not known; refuse it where it may claim the coordinates of its block."""
        if not values.keys().isdisjoint(MOVING) and MOTIONS.isdisjoint(codes):
            raise self.error(f"G{code:g} with coordinates is not read and may move the tool; post-process without it")
        self.log.note(f"G{code:g} is not read", self.line)


def drop_call(values: dict[str, float]) -> dict[str, float]:
    """Return the words of a block that calls a subprogram without those of the call."""
    return {letter: value for letter, value in values.items() if letter not in "PLK"}
