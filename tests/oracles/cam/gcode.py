"""G-code read a second time: NIST RS274/NGC, the words of Fanuc and Haas, printers.

Inside a block things happen in the order of the standard's table, whatever the order in which they stand. Words of an
M code that moves nothing never become motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tests.oracles.cam.corners import cut_corner
from tests.oracles.cam.gcode_flow import KNOWN, MOVING_M, SILENT, Flow
from tests.oracles.cam.gcode_words import Words
from tests.oracles.cam.machine import PLANES, UNIT, DrivenMachine, Matrix, carry, multiply, turn_about
from tests.oracles.cam.moves import NAN, CannotTellError, Reading
from tests.oracles.cam.offsets import WorkOffsets
from tests.oracles.cam.rotary import point_tool

CYCLES = {73, 74, 76, 81, 82, 83, 84, 85, 86, 88, 89}
PECKS, FED_OUT = {73, 83}, {74, 84, 85, 89}
AXES = "XYZ"
#: Words that ask for a corner to be rounded or cut off.
CORNERS = {",R": "round", ",C": "side"}
ROTARY = "ABC"
#: G codes that use the axis words of their block themselves.
USERS = {4, 10, 28, 30, 52, 65, 66, 68, 68.2, 92, 92.1, 92.2, 92.3, 29, 11}


@dataclass
class GCode:
    """An interpreter of G-code.

    Args:
        inch: Whether lengths are inches where the file does not say; None: millimetres.
        centres: "incremental", "absolute" or "reversed" where the file does not say.
        expand: Whether drilling cycles are moves.
        rotary: What A, B, C turn: "head", "table", "head_table", or None.
        rotary_axes: The axes that turn, that which carries the other first, or None.
        tracking: Whether X, Y, Z are the tip whatever the rotary axes do.
        wcs: Name of the work offset that is the part frame, or None.
        printer: Whether it is a printer's file: values of G28 are flags.

    """

    inch: bool | None = None
    centres: str = "incremental"
    expand: bool = True
    rotary: str | None = None
    rotary_axes: list[str] | None = None
    tracking: bool = False
    wcs: str | None = None
    printer: bool = False
    machine: DrivenMachine = field(default_factory=DrivenMachine)
    scale: float = 1.0
    motion: float = 0.0
    modal: float = 0.0
    absolute: bool = True
    to_initial: bool = True
    polar: bool = False
    always: bool = False
    selected: int = -1
    changed: bool = False
    work: WorkOffsets = field(default_factory=WorkOffsets)
    base: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    tilt: tuple[Matrix, list[float]] | None = None
    corner: tuple[float, str] | None = None
    before: list[float] | None = None
    origin: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    kept: list[float] | None = None
    declared: bool = False
    adrift: bool = False
    local: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    turned: tuple[float, float, float] | None = None
    angles: dict[str, float] = field(default_factory=dict)
    cycle: dict[str, float] = field(default_factory=dict)

    def run(self, text: str) -> Reading:
        """Read a whole file.

        Raises:
            CannotTellError: If something in it is not known here.

        """
        self.scale = 25.4 if self.inch else 1.0
        self.always = self.tracking
        flow = Flow(text)
        while (words := flow.next_block()) is not None:
            self.machine.record.line = flow.line
            try:
                if words and self.block(words, flow):
                    break
            except CannotTellError as error:
                raise CannotTellError(error.reason, error.line or flow.line) from None
        if self.corner is not None:
            raise CannotTellError("a corner without a move after it", self.machine.record.line)
        for note in flow.notes:
            self.machine.record.note(note)
        return self.machine.record.finish()

    def block(self, words: Words, flow: Flow) -> bool:
        """Carry out a block; tell whether the program ends with it."""
        codes = [value for letter, value in words if letter == "G"]
        actions = [int(value) for letter, value in words if letter == "M"]
        has = {letter: value for letter, value in words if letter not in "GMN"}
        if any(action not in MOVING_M for action in actions) and not codes:
            return False  # its words are its own
        if 97 in actions or 98 in actions:
            flow.call(has, local=97 in actions)
            return False
        if 99 in actions:
            return flow.give_back()
        self._prepare(codes, has, actions)
        used = self._frames(codes, has)
        if not used:
            self._move(codes, has)
        return bool({2, 30} & set(actions))

    def _prepare(self, codes: list[float], has: dict[str, float], actions: list[int]) -> None:
        """Set what holds before anything moves: feed mode, feed, speed, tool, plane, unit, how words count."""
        machine = self.machine
        for code in codes:
            if code in (20, 70):
                self.scale = 25.4
            elif code in (21, 71):
                self.scale = 1.0
            elif code in (93, 94, 95):
                machine.feed_mode = int(code)
            elif code in PLANES:
                machine.plane = int(code)
            elif code in (90, 91):
                self.absolute = code == 90
            elif code in (90.1, 91.1):
                self.centres = "absolute" if code == 90.1 else "incremental"
            elif code in (98, 99):
                self.to_initial = code == 98
            elif code in (15, 16):
                self.polar = code == 16
            elif code in (43.4, 43.5):
                self.tracking = True
            elif code in (41, 42):
                raise CannotTellError("cutter radius compensation", machine.record.line)
            if code == 49:
                self.tracking = self.always
        if "F" in has:
            machine.feed = has["F"] * (1.0 if machine.feed_mode == 93 else self.scale)
        if "S" in has and 50 not in codes:
            machine.spindle = abs(has["S"])
        if "T" in has:
            self.selected = int(has["T"])
        if 6 in actions or ("T" in has and not self.changed):
            machine.record.tool = self.selected
        self.changed |= 6 in actions

    def _frames(self, codes: list[float], has: dict[str, float]) -> bool:
        """Carry out what changes frames or goes home; tell whether the words of the block are used up."""
        machine, line = self.machine, self.machine.record.line
        for code in codes:
            if 54 <= code < 60 or code == 154:
                name = f"G{code:g} P{has.get('P', 0.0):g}" if code in (54.1, 154) else f"G{code:g}"
                self.base = self.work.shift(name)
                self._set_frame()
            elif code == 68:
                self._turn(has)
            elif code == 68.2:
                self._tilt(has)
            elif code == 53.1:
                self.machine.axis = tuple(carry(UNIT if self.tilt is None else self.tilt[0], (0.0, 0.0, 1.0)))
                self.machine.at = [NAN, NAN, NAN]  # where the tip swings to is the machine's own
            elif code == 69:
                if self.tilt is not None:
                    self.machine.axis = (0.0, 0.0, 1.0)
                self.turned = self.tilt = None
                self._set_frame()
            elif code in (28, 30):
                self._home(has)
            elif code == 53:
                self.machine.forget([k for k, axis in enumerate(AXES) if axis in has])
                self.motion = self.modal = next((c for c in codes if c in (0, 1)), self.motion)
                return True
            elif code == 52:
                for k, axis in enumerate(AXES):
                    self.local[k] = has.get(axis, self.local[k] / self.scale) * self.scale
                self._set_frame()
            elif code == 92 or code in (92.1, 92.2, 92.3):
                self._declare(has, code)
            elif code == 10 and has.get("L", 0.0) in (2.0, 20.0):
                if has["L"] != 2.0 or not self.absolute or self.wcs is not None:
                    raise CannotTellError("G10 that counts on, or with a part frame that the job names", line)
                place = {k: has[axis] * self.scale for k, axis in enumerate(AXES) if axis in has}
                self.work.state(int(has.get("P", 0.0)), place, moved=bool(machine.record.rows))
            elif code not in SILENT and code not in KNOWN and int(code) not in CYCLES:
                raise CannotTellError(f"G{code:g}", line)
        if 5 in codes and any(axis in has for axis in "XYZIJ"):
            raise CannotTellError("G5 with a curve", line)
        return bool(USERS & set(codes))

    def _turn(self, has: dict[str, float]) -> None:
        i, j, _ = PLANES[self.machine.plane]
        at = self.machine.at
        if self.tilt is not None:
            raise CannotTellError("G68 in a tilted plane", self.machine.record.line)
        centre = [has[AXES[n]] * self.scale if AXES[n] in has else at[n] for n in (i, j)]
        if "R" not in has or not self.absolute:
            raise CannotTellError("G68 without R, or counted on", self.machine.record.line)
        self.turned = (centre[0], centre[1], has["R"])
        self._set_frame()

    def _tilt(self, has: dict[str, float]) -> None:
        """G68.2: a plane at X Y Z, turned by I about z, then J about the new x, then K about the newest z."""
        if any(self.local) or any(self.origin) or self.turned is not None or "P" in has:
            raise CannotTellError("G68.2 in a moved frame, or with P", self.machine.record.line)
        matrix = multiply(turn_about(2, has.get("I", 0.0)), turn_about(0, has.get("J", 0.0)))
        matrix = multiply(matrix, turn_about(2, has.get("K", 0.0)))
        self.tilt = matrix, [has.get(axis, 0.0) * self.scale for axis in AXES]
        self._set_frame()

    def _set_frame(self) -> None:
        """Put together work offset, local shift, rotation and what G92 declared."""
        self.before = None
        shift = [self.origin[k] + self.local[k] + self.base[k] for k in range(3)]
        if self.tilt is not None:
            self.machine.set_frame(self.tilt[0], [self.base[k] + self.tilt[1][k] for k in range(3)])
            return
        if self.turned is None:
            self.machine.set_frame(UNIT, shift)
            return
        i, j, k = PLANES[self.machine.plane]
        matrix = turn_about(k, self.turned[2])
        centre = [0.0, 0.0, 0.0]
        centre[i], centre[j] = self.turned[0], self.turned[1]
        moved = carry(matrix, centre)
        self.machine.set_frame(matrix, [shift[n] + centre[n] - moved[n] for n in range(3)])

    def _declare(self, has: dict[str, float], code: float) -> None:
        """G92: the place where the machine stands gets new numbers; where nobody knows it they are its place."""
        if code != 92:
            if code == 92.3 and self.kept is None:
                raise CannotTellError("G92.3 of an offset from before the file", self.machine.record.line)
            self.origin = list(self.kept or ()) if code == 92.3 else [0.0, 0.0, 0.0]
            self.adrift = self.declared and code != 92.3
            self.kept = [0.0, 0.0, 0.0] if code == 92.1 else self.kept
            self._set_frame()
            return
        if self.turned is not None or self.tilt is not None:
            raise CannotTellError("G92 in a turned frame", self.machine.record.line)
        here = self.machine.place(self.machine.at)
        for k, axis in enumerate(AXES):
            if axis in has:
                value = has[axis] * self.scale
                if math.isnan(here[k]):
                    here[k] = value + self.local[k] + self.origin[k] + self.base[k]
                    self.declared = True
                self.origin[k] = here[k] - value - self.local[k] - self.base[k]
        self.kept = list(self.origin)
        self.machine.shift = [self.origin[k] + self.local[k] + self.base[k] for k in range(3)]
        self.machine.at = [here[k] - self.machine.shift[k] for k in range(3)]

    def _home(self, has: dict[str, float]) -> None:
        """Go home by way of a place; home is no place of the part."""
        named = [k for k, axis in enumerate(AXES) if axis in has]
        if named and not self.printer:
            by = self._target(has)
            if any(by[k] != self.machine.at[k] and not math.isnan(by[k]) for k in named):
                self.machine.rapid(by)
        self.machine.forget(named or ([] if any(axis in has for axis in ROTARY) else [0, 1, 2]))

    def _target(self, has: dict[str, float]) -> list[float]:
        """Return where the axis words of a block lead, frame of the program."""
        target = list(self.machine.at)
        if self.polar:
            i, j, _ = PLANES[self.machine.plane]
            raise_polar = not self.absolute
            if raise_polar:
                raise CannotTellError("polar words counted on", self.machine.record.line)
            if AXES[i] in has or AXES[j] in has:
                radius = has[AXES[i]] * self.scale if AXES[i] in has else math.hypot(target[i], target[j])
                angle = math.radians(has[AXES[j]]) if AXES[j] in has else math.atan2(target[j], target[i])
                has = {key: value for key, value in has.items() if key not in (AXES[i], AXES[j])}
                target[i], target[j] = radius * math.cos(angle), radius * math.sin(angle)
        for k, axis in enumerate(AXES):
            if axis in has:
                value = has[axis] * self.scale
                target[k] = value if self.absolute else target[k] + value
        return target

    def _move(self, codes: list[float], has: dict[str, float]) -> None:
        """Carry out the motion of a block."""
        for code in codes:
            if code in (0, 1, 2, 3, 80) or int(code) in CYCLES:
                if code in CYCLES and self.motion not in CYCLES:
                    self.cycle = {"initial": self.machine.at[PLANES[self.machine.plane][2]]}
                self.motion = self.modal if code == 80 else code
                self.modal = code if code in (0, 1, 2, 3) else self.modal
        if "Z" in has and (49 in codes or (has.get("H") == 0.0 and not {43, 44} & set(codes))):
            self.machine.forget([2])  # the tool's length is cancelled: no place of the tip
            has = {letter: value for letter, value in has.items() if letter != "Z"}
        if not any(axis in has for axis in "XYZABCIJKRUVW"):
            return
        if self.work.part is None:
            self.work.part = self.work.used
            if self.wcs is not None and self.wcs != self.work.used:
                raise CannotTellError(f"moves in {self.work.used}, the part frame is {self.wcs}")
        if self.adrift:
            raise CannotTellError("moves after G92 is dropped that said where the tool is", self.machine.record.line)
        if any(axis in has for axis in "UVW"):
            raise CannotTellError("words U, V, W", self.machine.record.line)
        if any(axis in has for axis in ROTARY):
            self._swing(has)
        if self.motion in CYCLES:
            self._drill(has)
        elif self.motion in (2, 3):
            self._arc(has)
        elif self.motion in (0, 1) and any(axis in has for axis in "XYZABC"):
            self._line(has)

    def _line(self, has: dict[str, float]) -> None:
        """Move straight; over the corner before where the block before asked for it."""
        target, start, machine = self._target(has), list(self.machine.at), self.machine
        if self.corner is not None:
            if self.motion != 1 or self.before is None or not machine.record.rows:
                raise CannotTellError("a corner that no line follows", machine.record.line)
            size, form = self.corner
            cut_corner(machine, self.before, target, size, form=form, feed=machine.record.rows[-1][7])
        machine.straight(int(self.motion), target)
        self.before = start if self.motion == 1 else None
        self.corner = next(((has[word] * self.scale, form) for word, form in CORNERS.items() if word in has), None)

    def _swing(self, has: dict[str, float]) -> None:
        """Turn the tool axis by rotary words."""
        if not self.absolute:
            raise CannotTellError("rotary words counted on", self.machine.record.line)
        self.angles |= {axis: has[axis] for axis in ROTARY if axis in has}
        if self.rotary == "ignore" or (not any(self.angles.values()) and self.machine.axis == (0.0, 0.0, 1.0)):
            return
        if self.rotary not in ("head", "table", "head_table") or not self.tracking or self.tilt is not None:
            raise CannotTellError("rotary words without a machine whose tip is followed", self.machine.record.line)
        self.machine.axis = point_tool(self.rotary, self.rotary_axes, self.angles)

    def _arc(self, has: dict[str, float]) -> None:
        machine, self.before = self.machine, None
        if self.corner is not None or any(word in has for word in CORNERS):
            raise CannotTellError("a corner beside an arc", machine.record.line)
        machine.begin_cut(machine.at)
        target = self._target(has)
        i, j, _ = PLANES[machine.plane]
        clockwise = self.motion == 2
        offsets = ["IJK"[n] for n in (i, j)]
        if not any(letter in has for letter in offsets):
            if "R" not in has:
                raise CannotTellError("an arc without centre and radius", machine.record.line)
            machine.arc(target, machine.radius_centre(target, has["R"] * self.scale, clockwise), clockwise)
            return
        centre = list(machine.at)
        for n, letter in zip((i, j), offsets, strict=True):
            value = has.get(letter, 0.0) * self.scale
            if self.centres == "absolute":
                centre[n] = value if letter in has else NAN
            else:
                centre[n] = machine.at[n] + (value if self.centres == "incremental" else -value)
        turns = int(has.get("P", 1.0)) - 1 if "P" in has and has["P"] >= 1.0 else 0
        machine.arc(target, centre, clockwise, turns)

    def _drill(self, has: dict[str, float]) -> None:
        """Carry out a drilling cycle at a place."""
        machine, known = self.machine, self.cycle
        i, j, k = PLANES[machine.plane]
        rise = 0.0 if self.absolute else known["initial"]
        if "R" in has:
            known["plane"] = has["R"] * self.scale + rise
        if AXES[k] in has:
            known["depth"] = has[AXES[k]] * self.scale + (0.0 if self.absolute else known.get("plane", NAN))
        target, at = self._target({key: value for key, value in has.items() if key != AXES[k]}), machine.at
        self.before = None
        if math.isnan(known["initial"]) or self.corner is not None:
            raise CannotTellError("a cycle from an unknown height", machine.record.line)
        if not self.expand:
            return
        if "plane" not in known or "depth" not in known:
            raise CannotTellError("a cycle without R or depth", machine.record.line)
        plane, depth = known["plane"], known["depth"]
        out = max(known["initial"], plane) if self.to_initial else plane
        code, step = int(self.motion), [target[n] - at[n] for n in range(3)]
        for count in range(int(has.get("L", has.get("K", 1.0)))):
            if count and not self.absolute:
                target = [machine.at[n] + step[n] for n in range(3)]
            over = list(machine.at)
            if not over[k] >= plane and not math.isnan(over[k]):
                over[k] = plane
                machine.rapid(over)
            over[i], over[j] = target[i], target[j]
            if over != machine.at:
                machine.rapid(over)
            for height, cut in ((plane, False), (depth, True)):
                point = [over[n] if n != k else height for n in range(3)]
                if point != machine.at:
                    machine.straight(int(cut), point, drill=cut and code in PECKS)
            if code in FED_OUT:
                machine.line([over[n] if n != k else plane for n in range(3)])
            if out != plane or code not in FED_OUT:
                machine.rapid([over[n] if n != k else out for n in range(3)])
