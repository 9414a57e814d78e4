"""The interpreter of CNC programs: what a block says, and in which order it acts; a table says what each code does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from compplan.toolpath.readers.cnc.flow import Flow
from compplan.toolpath.readers.cnc.frames import ProgramFrames
from compplan.toolpath.readers.cnc.lexer import LENGTHS, Lexer, Words
from compplan.toolpath.readers.cnc.machine import (
    ENDS,
    PLACING,
    end_machine,
    owns_words,
    start_machine,
    stop_machine,
)
from compplan.toolpath.readers.cnc.moves import MotionBlock
from compplan.toolpath.readers.cnc.offsets import Origins
from compplan.toolpath.readers.cnc.path import PathWriter
from compplan.toolpath.readers.cnc.state import State
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.plain import PLAIN_CODE
from compplan.toolpath.readers.start import refuse_unit

#: Words that a move may have, and those of them that say where it goes.
MOVING = frozenset((*"XYZABCIJKRUVW", "A3", "B3", "C3"))
PLACES = frozenset((*"XYZABCUVW", "A3", "B3", "C3"))
MOTIONS = frozenset({0.0, 1.0, 2.0, 3.0})
CYCLES = frozenset({73.0, 74.0, 76.0, *(float(number) for number in range(81, 90))})
#: Codes of a unit, and those of blocks whose words are no lengths of the path.
UNITS = frozenset({20.0, 21.0, 70.0, 71.0})
UNITLESS = frozenset({4.0, 10.0, 53.0, 153.0})
#: Codes of which a block may hold one.
CONTRARY = (
    frozenset({20.0, 21.0}), frozenset({90.0, 91.0}), frozenset({17.0, 18.0, 19.0}), frozenset({93.0, 94.0, 95.0}),
    frozenset({98.0, 99.0}), MOTIONS | CYCLES,
)  # fmt: skip


@dataclass
class WordBlock:
    """Hold the words of a block.

    Args:
        values: Numbers by letter.
        codes: G codes.
        machine: M codes.

    """

    values: dict[str, float] = field(default_factory=dict)
    codes: list[float] = field(default_factory=list)
    machine: list[float] = field(default_factory=list)

    def names(self, letters: frozenset[str]) -> bool:
        """Return whether the block holds one of these letters."""
        return not self.values.keys().isdisjoint(letters)


@dataclass(frozen=True)
class Code:
    """Say what a G code does.

    Args:
        run: Carries it out: run(interpreter, block, code).
        rank: Codes of lower ranks act before others of their block.
        takes: "" where the coordinates of the block are a move, "once" where the code takes them for itself, "machine"
            where they are machine coordinates.

    """

    run: Callable[[Interpreter, WordBlock, float], None]
    rank: int = 0
    takes: str = ""


class Interpreter:
    """Carry out a program block by block.

    Args:
        file: Its file.
        options: What the program does not say by itself.
        state: State at the beginning.
        find_code: Gives what a G code does in this dialect, None where it is not known.

    """

    def __init__(self, file: Path, options: CamTable, state: State, find_code: Callable[[float], Code | None]) -> None:
        self.options, self.state, self.find_code = options, state, find_code
        self.flow = Flow(file, self.run_line)
        self.path = PathWriter(self.flow, state, options)
        self.log, self.error = self.path.log, self.flow.error
        self.frames = ProgramFrames(self.path)
        self.origins = Origins(self.path, self.frames)
        self.motion = MotionBlock(self.path, self.frames)
        self.lexer = Lexer(self.path)
        self.steady = False

    def run(self, lines: Sequence[str]) -> None:
        """Read every line; refuse a corner that no move follows, and stop what still turns."""
        self.flow.run(lines)
        if self.motion.corner is not None:
            self.flow.line = self.motion.corner[0].line
            raise self.error("a rounded or cut corner has no straight move after it")
        self.origins.check_offsets()
        end_machine(self.state, self.log, self.flow.line)

    def run_line(self, raw: str) -> bool:
        """Carry out one line; return whether the program ends."""
        if self.steady and (found := PLAIN_CODE.fullmatch(raw)) and self.motion.cut_plain(found):
            return False
        words = self.lexer.read(raw)
        ended = words is not None and self.run_block(words)
        self.steady = self.lexer.begun and self.motion.is_steady()
        return ended

    def run_block(self, words: Words) -> bool:
        """Carry out one block; return whether the program ends.

        What a block says acts in this order, however its words are shuffled: units, distance mode, plane, feed,
        spindle, tool, frames, then a code that takes the coordinates for itself or the motion, and what stops.
        """
        block = WordBlock()
        values, codes, machine = block.values, block.codes, block.machine
        for letter, number in words:
            if letter == "G":
                codes.append(number)
            elif letter == "M":
                machine.append(number)
            else:
                values[letter] = number
        if 65.0 in codes:
            self.flow.call_number(values, macro=True)
            return False
        if machine:
            machine.sort(key=lambda code: (code in ENDS or code < 2.0, code))
            if self._give_words(block):
                return False
            self._check_machine(block)
        state, dwells = self.state, 4.0 in codes
        if "E" in values and not state.printer and 187.0 not in codes:
            raise self.error(f"word E{values['E']:g} is read in files of printers only (M104, M109); elsewhere it may "
                             "move an axis or shift the frame; post-process without it")  # fmt: skip
        state.cancels_length = 49.0 in codes or (values.get("H") == 0.0 and not {43.0, 44.0} & set(codes))
        if not state.unit_stated and values:
            self._ask_for_unit(block)
        takes = self._run_codes(block) if codes else ""
        if "F" in values and not dwells:
            state.set_feed(values["F"])
        if machine or dwells or "S" in values or "T" in values:
            start_machine(machine, values, codes, state, self.log, self.flow.line)
        calls = 98.0 in machine or 97.0 in machine
        if takes == "machine":
            self.origins.move_in_machine(values)
        elif not takes and block.names(MOVING):
            self.motion.move({letter: values[letter] for letter in values if letter not in "PLK"} if calls else values)
        if not machine:
            return False
        if calls:
            self.flow.call_number(values, local=97.0 in machine)
        self.flow.over = self.flow.over or 2.0 in machine or (30.0 in machine and not state.siemens)
        return stop_machine(machine, state, self.log, self.flow.line)

    def _give_words(self, block: WordBlock) -> bool:
        """Give the words of a block to the M code that owns them; return whether nothing is left to be read.

        Raises:
            InputError: If an M code that is not known may own coordinates.

        """
        machine = block.machine
        owner = next((code for code in machine if owns_words(code)), None)
        if not block.codes and block.names(PLACES):
            doubtful = [code for code in machine if code not in PLACING and (owns_words(code) or code >= 200.0)]
            if doubtful:
                raise self.error(f"M{doubtful[0]:g} with coordinates and no G code: whose they are is not known; "
                                 "write the motion code (G0, G1) into the block")  # fmt: skip
        if owner is None:
            return False
        self.log.note(f"M{owner:g} is not read", self.flow.line)
        self.log.happen("comment", self.flow.line, text=f"M{owner:g} of the CAM file")
        if MOTIONS.isdisjoint(block.codes):
            return True
        for letter in "STPQ":
            block.values.pop(letter, None)
        machine.remove(owner)
        return False

    def _check_machine(self, block: WordBlock) -> None:
        """Refuse calls that are not read; follow M128 and M129."""
        if 198.0 in block.machine:
            raise self.error("subprogram call M198 of another file is not read; write the program into the file")
        if 99.0 in block.machine and "P" in block.values:
            raise self.error("M99 with a block to return to (P) is not read; write the program out in the CAM system")
        if 128.0 in block.machine or 129.0 in block.machine:
            self.frames.control_tip(128.0 in block.machine)

    def _ask_for_unit(self, block: WordBlock) -> None:
        """Refuse lengths before the file or the user states their unit; those of printers are millimetres."""
        if self.state.printer or self.options.unit or not (UNITS | UNITLESS).isdisjoint(block.codes):
            return
        if any(block.values.get(letter, 0.0) != 0.0 for letter in LENGTHS):
            raise self.error(refuse_unit("G20 or G21").message)

    def _run_codes(self, block: WordBlock) -> str:
        """Carry out the G codes; return what takes the coordinates of the block, "" where they are a move.

        Raises:
            InputError: If codes contradict each other, or one is not known and may move the tool.

        """
        takes, codes = "", block.codes
        if len(codes) == 1:
            entry = self.find_code(codes[0])
            if entry is None:
                self.pass_over(block, codes[0])
                return ""
            entry.run(self, block, codes[0])
            return entry.takes
        for group in CONTRARY:
            if len(said := sorted(group & set(codes))) > 1:
                names = " and ".join(f"G{code:g}" for code in said)
                one = ", expected one motion" if said[0] in MOTIONS else ""
                raise self.error(f"{names} stand in one block{one or ' and contradict each other'}")
        found = [(entry.rank if (entry := self.find_code(code)) else 0, code, entry) for code in codes]
        for _, code, entry in sorted(found, key=lambda item: item[:2]):
            if entry is None:
                self.pass_over(block, code)
                continue
            entry.run(self, block, code)
            takes = entry.takes if entry.takes == "machine" else takes or entry.takes
        return takes

    def pass_over(self, block: WordBlock, code: float) -> None:
        """Note a code that is not known.

        Raises:
            InputError: If it may claim the coordinates of its block.

        """
        if block.names(MOVING) and MOTIONS.isdisjoint(block.codes):
            raise self.error(f"G{code:g} with coordinates is not read and may move the tool; post-process without it")
        self.log.note(f"G{code:g} is not read", self.flow.line)
