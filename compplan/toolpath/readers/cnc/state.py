"""Block of a CNC program, modal state (millimetres), and machine functions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from compplan.io.notes import Stop
from compplan.toolpath.readers.arcs import Point, set_levels
from compplan.toolpath.readers.frames import PLANE_AXES
from compplan.toolpath.readers.moves import MoveLog

AXES, LETTERS = "XYZ", "ABC"
INCH = 25.4

#: M codes that are executed before the move of their block, in addition to M6, and the functions that they start.
STARTING = {3.0: ("spindle_cw",), 4.0: ("spindle_ccw",), 7.0: ("mist",), 8.0: ("coolant",),
            13.0: ("spindle_cw", "coolant"), 14.0: ("spindle_ccw", "coolant")}  # fmt: skip
#: M codes that are executed after the move of their block.
STOPPING = {0.0: "stop", 1.0: "optional_stop", 5.0: "spindle_off", 9.0: "coolant_off"}
#: G codes with which S is a speed limit or not a speed; M codes with which S is an angle of the spindle.
LIMITS = frozenset({4.0, 25.0, 26.0, 50.0, 92.0})
ANGLES = frozenset({19.0})
#: Least value P, X or U of a dwell that is read in milliseconds. [ms]
LEAST_MILLISECONDS = 100.0


@dataclass
class CncBlock:
    """Words of a block: numbers by address (X, CR, A3, I1 ..), G codes, M codes (`machine`), words without a number.

    `absolute` and `relative` are addresses whose numbers do not follow the distance mode. `calls` are names with their
    arguments as texts.
    """

    values: dict[str, float] = field(default_factory=dict)
    codes: list[float] = field(default_factory=list)
    machine: list[float] = field(default_factory=list)
    absolute: set[str] = field(default_factory=set)
    relative: set[str] = field(default_factory=set)
    names: list[str] = field(default_factory=list)
    calls: list[tuple[str, list[str]]] = field(default_factory=list)

    def put(self, address: str, number: float, *, once: bool = True) -> None:
        """Add a word; raise a ValueError if its address is in the block already and `once` allows one."""
        if address in "GM":
            (self.codes if address == "G" else self.machine).append(number)
        elif once and address in self.values:
            raise ValueError(f"word {address} stands twice in this block, expected once")
        else:
            self.values[address] = number

    def has(self, addresses: frozenset[str]) -> bool:
        """Return whether the block contains one of these addresses."""
        return not self.values.keys().isdisjoint(addresses)

    def list_axes(self) -> list[int]:
        """Return the numbers of the axes X Y Z in the block."""
        return [axis for axis, letter in enumerate(AXES) if letter in self.values]


@dataclass
class State:
    """Modal state of a program; `motion` is 0 to 3 for G0 to G3, "CIP", "CT", or None before the first one."""

    scale: float = 1.0
    unit_stated: bool = False
    units: list[str] = field(default_factory=list)
    motion: float | str | None = None
    plane: int = 17
    incremental: bool = False
    #: Meaning of I J K: incremental, absolute or reversed; whether the program states it.
    centres: str = "incremental"
    centres_stated: bool = False
    feed: float | None = None
    feed_mode: int = 94
    #: Millimetres of a unit of F.
    feed_scale: float = 1.0
    spindle: float = 0.0
    #: Whether S is the speed of the cutting edge (G96), so that the speed of the spindle is not known.
    surface_speed: bool = False
    turning: str = ""
    cooling: bool = False
    tool: float = 0.0
    tool_name: str = ""
    #: Whether T changes the tool without M6; whether the file is for a printer.
    changes_by_t: bool = False
    printer: bool = False
    tip_control: bool = False
    #: Whether X Y are radius and angle; pole, its plane, active radius and angle.
    polar: bool = False
    pole: Point | None = None
    pole_plane: int | None = None
    polar_words: dict[str, float] = field(default_factory=dict)
    #: Whether the current block cancels tool length compensation.
    cancels_length: bool = False
    retract_to_start: bool = True
    cycle_code: float = 0.0
    cycle_start: float | None = None
    cycle: dict[str, float] = field(default_factory=dict)

    def set_unit(self, scale: float, *, feeds: bool = True) -> None:
        """Set the unit [mm] of lengths, and of feeds if the word sets both."""
        self.scale, self.unit_stated = scale, True
        if feeds:
            self.feed_scale = scale
        word = "inch" if scale != 1.0 else "mm"
        if word not in self.units:
            self.units.append(word)

    def set_feed_mode(self, mode: int, scale: float | None = None) -> None:
        """Set the meaning of F (93 to 95), and its unit [mm]; an F from before with another meaning is dropped."""
        self.feed = self.feed if mode == self.feed_mode else None
        self.feed_mode, self.feed_scale = mode, self.feed_scale if scale is None else scale

    def set_feed(self, number: float) -> None:
        """Set the feed of an F word; the unit of length applies except in inverse time mode."""
        self.feed = number if self.feed_mode == 93 else number * self.feed_scale

    def to_mm_s(self, number: float) -> float:
        """Return the number of a feed per minute, or per revolution (G95), in mm/s."""
        return number * self.feed_scale * (self.spindle if self.feed_mode == 95 else 1.0) / 60.0

    def feed_mm_s(self, length: float) -> float | None:
        """Return the feed of a move of this length [mm] in mm/s, None if unknown."""
        if self.feed is None:
            return None
        if self.feed_mode == 93:
            return length * self.feed / 60.0
        if self.feed_mode == 95:
            return self.feed * self.spindle / 60.0 if self.spindle > 0.0 else None
        return self.feed / 60.0

    def is_incremental(self, block: CncBlock, address: str) -> bool:
        """Return whether a number of a block is incremental."""
        return address in block.relative or (self.incremental and address not in block.absolute)

    def lengths(self, block: CncBlock, letters: Sequence[str] = AXES) -> dict[int, float]:
        """Return the numbers of the coordinates in a block by axis [mm]."""
        stated = ((axis, letter) for axis, letter in enumerate(letters) if letter in block.values)
        return {axis: block.values[letter] * self.scale for axis, letter in stated}

    def place(self, block: CncBlock, base: Point, letters: Sequence[str] = AXES) -> tuple[Point, list[int]]:
        """Return the point of the coordinates in a block, and the axes of its absolute coordinates.

        Incremental coordinates are relative to `base`; those that are not stated are kept from it. [mm]
        """
        point, absolute = list(base), list[int]()
        for axis, letter in enumerate(letters):
            if letter in block.values:
                level = block.values[letter] * self.scale
                if self.is_incremental(block, letter):
                    point[axis] += level
                else:
                    point[axis] = level
                    absolute.append(axis)
        return (point[0], point[1], point[2]), absolute

    def turn(self, angles: dict[str, float], block: CncBlock) -> None:
        """Update the angles of rotary axes with those of a block."""
        for letter in LETTERS:
            if letter in block.values:
                base = angles.get(letter, 0.0) if self.is_incremental(block, letter) else 0.0
                angles[letter] = block.values[letter] + base

    def centre(self, start: Point, block: CncBlock, plane: int) -> Point:
        """Return the centre of an arc from I J K with their meaning in this program."""
        sense = -1.0 if self.centres == "reversed" else 1.0
        centre = {axis: level for axis, level in self.lengths(block, "IJK").items() if axis in PLANE_AXES[plane]}
        for axis, level in centre.items():
            if self.centres != "absolute" and "IJK"[axis] not in block.absolute:
                centre[axis] = start[axis] + sense * level
        return set_levels(start, centre)


class Machine:
    """Machine functions of M codes and the words S and T."""

    def __init__(self, state: State, log: MoveLog, silent: frozenset[float], ends: frozenset[float]) -> None:
        self.state, self.log, self.silent, self.ends = state, log, silent | ends, ends

    def start(self, block: CncBlock) -> None:
        """Execute the machine functions of a block before its move."""
        state, log, values, machine = self.state, self.log, block.values, block.machine
        by_t = state.changes_by_t and values.get("T", 0.0) not in (0.0, state.tool)
        changing = 6.0 in machine or 61.0 in machine
        if "T" in values:
            state.tool, state.tool_name = values["T"], ""
            if not changing and not state.changes_by_t:
                log.add_event("comment", text=f"tool T{values['T']:g} is called")  # changed by the next M6
        if 61.0 in machine:
            state.tool, state.tool_name = values.get("Q", state.tool), ""
        if changing or by_t:
            if by_t:
                log.note("T without M6 is read as a tool change: the file has no M6")
            self.change_tool()
        changed = "S" in values and LIMITS.isdisjoint(block.codes) and ANGLES.isdisjoint(machine)
        if changed and state.surface_speed:
            log.note("S with G96 is a cutting speed: the speed of the spindle, and feeds per revolution, are not known")
        elif changed:
            state.spindle = values["S"]
        self.switch_on(machine, changed=changed)
        if 4.0 in block.codes:
            wait = max(values.get("F", 0.0), 0.0)  # in seconds
            if state.printer:
                wait = values.get("S", 0.0) + 1e-3 * values.get("P", 0.0)
            elif letter := next((letter for letter in "PXU" if letter in values), ""):
                milli = values[letter] >= LEAST_MILLISECONDS
                if milli:
                    log.note(f"G4 {letter}{values[letter]:g} is taken in milliseconds")
                wait = max(values[letter], 0.0) * (1e-3 if milli else 1.0)
            elif "S" in values:  # in revolutions
                wait = 60.0 * values["S"] / state.spindle if state.spindle > 0.0 else 0.0
            log.add_event("dwell", value=wait)

    def change_tool(self) -> None:
        """Change to the selected tool."""
        self.log.add_event("tool", value=self.state.tool, text=self.state.tool_name)
        self.state.turning = ""

    def switch_on(self, machine: Iterable[float], *, changed: bool = False) -> None:
        """Execute M codes that switch on, and the change of speed of a running spindle."""
        state, log = self.state, self.log
        kinds = [kind for code in machine for kind in STARTING.get(code, ())]
        for kind in kinds:
            if kind.startswith("spindle"):
                state.turning, changed = kind, True
        if changed and state.turning:
            off = state.spindle == 0.0
            log.add_event("spindle_off" if off and not kinds else state.turning, value=state.spindle)
        for kind in kinds:
            if not kind.startswith("spindle"):
                state.cooling = True
                log.add_event(kind)
        for code in machine:
            if code not in STARTING and code not in STOPPING and code not in self.silent:
                self.leave_out(f"M{code:g}")

    def leave_out(self, code: str) -> None:
        """Note an unknown M code, which must be checked before the machine moves, and keep it as a comment."""
        self.log.note(Stop(f"{code} is unknown: programs have it as a comment; if it switches something, add it"))
        self.log.add_event("comment", text=f"{code} of the CAM file")

    def stop(self, machine: Iterable[float]) -> bool:
        """Execute M codes after the move of their block; return whether the program ends."""
        for code in machine:
            kind = STOPPING.get(code, "")
            if kind == "spindle_off":
                self.state.turning = ""
            elif kind == "coolant_off":
                self.state.cooling = False
            if kind:
                self.log.add_event(kind)
        return not self.ends.isdisjoint(machine)

    def end(self) -> None:
        """Stop running spindle and coolant at the end of the program."""
        for running, kind in ((self.state.turning, "spindle_off"), (self.state.cooling, "coolant_off")):
            if running:
                self.log.add_event(kind)
        self.state.turning, self.state.cooling = "", False
