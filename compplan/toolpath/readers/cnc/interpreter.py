"""Interpreter of CNC programs for all dialects: modal state, frames, motion and machine functions.

A dialect consists of a lexer that yields blocks of words, and a table of operations (`Code`) by word. It holds an
interpreter, which alone computes the path. Its methods: `run_line(program, index)` executes a line and returns the
index of the next one or END; `square()` returns the tool axis with all rotary axes at 0. Its attributes: `frames`,
names of its frames from the outermost ("plane": the tilted plane); `moving`, addresses of a move; `silent` and `ends`,
M codes; `unit_words`, words that set the unit; `tip_word`, word of tool centre point control if cuts with moving rotary
axes require it, otherwise ""; `turns_to_plane`, whether rotary words in a tilted plane turn the tool to it
(`turn_to_plane()`) or are ignored.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compplan.errors import InputError
from compplan.toolpath.readers.cnc.contour import Contour
from compplan.toolpath.readers.cnc.course import Course
from compplan.toolpath.readers.cnc.flow import CncProgram, Flow
from compplan.toolpath.readers.cnc.motion import TURNING, MotionReader
from compplan.toolpath.readers.cnc.rotary import Rotary
from compplan.toolpath.readers.cnc.state import AXES, LETTERS, CncBlock, Machine, State
from compplan.toolpath.readers.frames import Frame
from compplan.toolpath.readers.options import CamTable, refuse_unit

#: Addresses that make a move.
MOVING = frozenset((*AXES, *TURNING, "I", "J", "K", "I1", "J1", "K1", "CR", "AP", "RP", "TURN"))
MOTIONS = frozenset({0.0, 1.0, 2.0, 3.0})
#: Head of a subprogram that brings back the modes of the program that calls it, and these modes.
SAVING = re.compile(r"\s*(?:N\d+\s*)?PROC\b[^;]*\bSAVE\b", re.IGNORECASE)
SAVED = ("motion", "plane", "incremental", "scale", "feed_mode", "feed_scale")
UNKNOWN_MACHINE = "moves while rotary axes stand turned whose machine is not stated"


@dataclass(frozen=True)
class Code:
    """Operation of a word: run(dialect, block, code); words of lower rank are executed first.

    `coordinate_use` states what the coordinates of the block are: "" for a move, "once" for arguments of the word,
    "machine" for machine coordinates.
    """

    run: Callable[..., None]
    rank: int = 0
    coordinate_use: str = ""


def ignore(coordinate_use: str = "") -> Code:
    """Return the operation of a word that does not affect the programmed path."""
    return note("", coordinate_use)


def note(text: str, coordinate_use: str = "") -> Code:
    """Return the operation of a word that is skipped with a note, silently if that is empty."""

    def run(dialect: Any, block: CncBlock, code: float) -> None:
        if coordinate_use == "once" and block.has(dialect.moving) and not MOTIONS.isdisjoint(block.codes):
            raise InputError(f"G{code:g} and a motion share the coordinates of a block; write two blocks")
        if text:
            dialect.it.note(text)

    return Code(run, 2 if coordinate_use else 0, coordinate_use)


def refuse(what: str) -> Code:
    """Return the operation of a word that is refused."""

    def run(dialect: object, block: CncBlock, code: float | str) -> None:
        word = code if isinstance(code, str) else f"G{code:g}"
        raise InputError(f"{word} ({what}) is not read; post-process without it")

    return Code(run)


def set_mode(rank: int = 0, **changes: object) -> Code:
    """Return the operation of a word that sets modal state."""
    return Code(lambda dialect, block, code: vars(dialect.it.state).update(changes), rank)


def compensate_radius(dialect: Any, block: CncBlock, code: float | str) -> None:
    """G41, G42: cutter radius compensation; G41.1 and G42.1 with a diameter D imply a contour of the part."""
    if code in (41.1, 42.1) and block.values.get("D"):
        raise InputError(f"G{code:g} with a cutter diameter D is not read; post-process the tool centre's path")
    if block.values.get("D") != 0.0:
        dialect.it.compensate_radius(f"G{code:g}")


#: Codes with the same meaning in every dialect of G-code.
COMMON: dict[float | str, Code] = {
    90.0: set_mode(incremental=False), 91.0: set_mode(incremental=True),
    **dict.fromkeys((93.0, 94.0, 95.0), Code(lambda dialect, block, code: dialect.it.state.set_feed_mode(int(code)))),
    96.0: set_mode(surface_speed=True, spindle=0.0), 97.0: set_mode(surface_speed=False),
    **dict.fromkeys((41.0, 42.0, 41.1, 42.1), Code(compensate_radius)),
    4.0: ignore("once"), 53.0: ignore("machine"), 153.0: ignore("machine"), 33.0: refuse("threading"),
    34.0: refuse("threading"), **dict.fromkeys((9.0, 40.0, 61.0, 64.0), ignore()),
}  # fmt: skip


class Interpreter:
    """Interpreter of one program: its modal state, frames, and the components that execute its words."""

    def __init__(self, file: Path, options: CamTable, state: State, dialect: Any, flow: Flow, *,
                 starts_at_zero: bool = False) -> None:  # fmt: skip
        self.file, self.options, self.state, self.dialect, self.flow = file, options, state, dialect, flow
        self.course = Course(flow, options, starts_at_zero=starts_at_zero)
        self.log, self.note = self.course.log, self.course.note
        self.contour = Contour(self.course)
        self.rotary = Rotary(options)
        #: Active frames by their names in the dialect.
        self.frames: dict[str, Frame] = {}
        self.motion = MotionReader(self)
        self.machine = Machine(state, self.log, dialect.silent, dialect.ends)
        #: Reasons why variables have no value, by name.
        self.unknown: dict[str, str] = {}
        #: Whether a block of X Y Z F only is a plain straight cut.
        self.steady = False
        flow.run_line = dialect.run_line

    def run(self, load: Callable[[], CncProgram], finish: Callable[[], None] = lambda: None) -> None:
        """Load and execute a program, refuse a corner without a following move, and stop spindle and coolant."""
        with self.flow.guard():
            self.flow.run(load())
            self.contour.refuse_open()
            finish()
        self.machine.end()

    def run_words(
        self, block: CncBlock, words: Iterable[float | str], find: Callable[[float | str], Code | None]
    ) -> str:
        """Execute the G codes and names of a block in the order of their ranks.

        Return the use of the coordinates of the block, as in `Code.coordinate_use`. `find` returns the operation of a
        word, None if it is unknown.
        """
        use = ""
        found = [((entry.rank if (entry := find(word)) else 0, isinstance(word, str), word), entry) for word in words]
        for (_, _, word), entry in sorted(found, key=lambda item: item[0]) if len(found) > 1 else found:
            if entry is None:
                self.skip_unknown(block, word)
                continue
            entry.run(self.dialect, block, word)
            use = entry.coordinate_use if entry.coordinate_use == "machine" else use or entry.coordinate_use
        return use

    def skip_unknown(self, block: CncBlock, word: float | str) -> None:
        """Note an unknown G code; refuse it if it may use the coordinates of the block, and refuse any other word."""
        name = word[:24] if isinstance(word, str) else f"G{word:g} with coordinates"
        if isinstance(word, str) or (block.has(self.dialect.moving) and MOTIONS.isdisjoint(block.codes)):
            raise InputError(f"word {name} is not read and may move the tool; post-process without it")
        self.note(f"G{word:g} is not read")

    @property
    def tilted(self) -> bool:
        """Whether a tilted plane is active."""
        return "plane" in self.frames

    @property
    def plane(self) -> Frame:
        """Active tilted plane, or the untilted one."""
        return self.frames.get("plane", Frame())

    @property
    def controls_tip(self) -> bool:
        """Whether X Y Z are the tip in the part while rotary axes turn."""
        return self.state.tip_control or self.options.axes.tip_control

    def find_frame(self) -> Frame:
        """Return the frame of the program coordinates in the part, without rotary axes."""
        whole = Frame()
        for name in self.dialect.frames:
            whole = whole.then(self.frames[name]) if name in self.frames else whole
        return whole

    def set_frames(self, **frames: Frame | None) -> None:
        """Activate frames by name, or cancel them (None)."""
        for name, frame in frames.items():
            self.frames.pop(name, None)
            if frame is not None:
                self.frames[name] = frame
        self.set_frame()

    def set_frame(self, *, carried: bool = False) -> None:
        """Update the frame of the coordinates; `carried`: rotary axes have moved the tool or the part along.

        Moves with rotary axes away from 0 are left out if the machine, or a dimension of it that they need, is not
        stated; cuts are refused.
        """
        frame, missing = self.find_frame(), ""
        if not (self.tilted or self.controls_tip) and self.rotary.turned:
            try:
                frame = self.rotary.place().then(frame)
            except InputError as fault:
                missing = fault.message
        if carried:
            self.course.move_frame(frame)
        elif frame != self.course.frame:
            self.contour.refuse_open()
            self.course.use(frame)
        if self.rotary.unknown and not self.tilted:
            missing = (
                f"rotary words {self.rotary.words} (line {self.flow.line}) turn the tool or the part; state which "
                'with rotary = "head", "table" or "head_table" (--rotary), or machine = "NAME"'
            )
        if missing:
            if UNKNOWN_MACHINE not in self.course.suspended:
                self.course.suspend(UNKNOWN_MACHINE, missing, f"rapid {UNKNOWN_MACHINE} are left out")
        else:
            self.course.resume(UNKNOWN_MACHINE)

    def control_tip(self, on: bool, *, spatial: bool = False) -> None:
        """Switch tool centre point control (X Y Z are the tip in the part); `spatial`: A B C are spatial angles."""
        if (self.state.tip_control, self.rotary.spatial) != (on, spatial):
            self.contour.refuse_open()
            self.state.tip_control, self.rotary.spatial = on, spatial
            self.set_frame()

    def leave_out_machine_move(self, block: CncBlock, words: str) -> None:
        """Leave out a move in machine coordinates; the position at its end is unknown."""
        axes = block.list_axes()
        self.contour.refuse_open()
        if axes:
            self.note(f"moves in machine coordinates ({words}) are left out")
            if 2 in axes:
                self.course.retreat()
            self.course.mark_unknown(axes)
        self.turn_home({letter: block.values[letter] for letter in LETTERS if letter in block.values})

    def leave_without_length(self, block: CncBlock, words: str) -> None:
        """Execute a block that cancels tool length compensation; its Z is left out: it is not a tip position."""
        course = self.course
        if self.state.motion != 0.0:
            raise InputError(f"a cut to Z without tool length compensation ({words}); call the tool's length before it")
        self.note(f"Z of a block that cancels the tool's length ({words}) is left out: it is not a place in the part")
        course.retreat()
        course.mark_unknown([2])
        del block.values["Z"]
        course.rapid(*self.motion.target(block))

    def turn_home(self, angles: dict[str, float]) -> None:
        """Set the angles of rotary axes after a move that is left out."""
        if angles:
            self.rotary.angles.update(angles)
            self.set_frame(carried=True)

    def check_unit(self, lengths: Iterable[float | None]) -> None:
        """Refuse non-zero lengths if neither the program so far nor the options state their unit."""
        if not self.state.unit_stated and self.options.unit is None and any(lengths):
            raise refuse_unit(self.dialect.unit_words)

    def compensate_radius(self, word: str) -> None:
        """Note cutter radius compensation, or refuse it without the option `compensation`."""
        if self.options.compensation is None:
            raise InputError(f"{word} compensates the radius of the cutter. If the file holds the path of the cutter's "
                             "centre: --compensation centre_line ([cam] compensation). If it holds the contour of the "
                             "part: post-process it without radius compensation")  # fmt: skip
        self.note(
            f"{word} compensates wear alone: the path is that of the tool's centre, as compensation = centre_line says"
        )

    def call(self, name: str, times: float) -> None:
        """Execute a subprogram of the file or of its folder."""
        if not self.flow.find_sibling(name):
            where = f"neither %_N_{name}_SPF in this file nor {name}.SPF beside it is there"
            raise InputError(f"subprogram call {name[:40]} is not read: {where}")
        self.contour.refuse_open()
        program, state = self.flow.programs[name], self.state
        kept, frame = {mode: getattr(state, mode) for mode in SAVED}, self.frames.get("program")
        self.flow.run_program(name, program, times)
        if any(SAVING.match(line) for line in program.lines[program.first : min(program.first + 20, program.last)]):
            state.set_feed_mode(kept["feed_mode"])
            vars(state).update(kept)
            self.set_frames(program=frame)
