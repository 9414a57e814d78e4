"""Cycles of Heidenhain programs: frames, tilted planes (also PLANE), dwell, holes and hole patterns."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, set_levels
from compplan.toolpath.readers.cnc.cycles import (
    SKIPPED,
    WITHOUT_PECKS,
    Hole,
    drill,
    go_to_level,
    list_circle,
    list_grid,
)
from compplan.toolpath.readers.cnc.heidenhain_words import CYCLE, NUMBER, TILT_ANGLES, VALUE, KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import AXES
from compplan.toolpath.readers.frames import (
    ORIGIN,
    PLANE_AXES,
    PLANE_NORMALS,
    Frame,
    mirror,
    rotate,
    stretch,
)
from compplan.toolpath.readers.lines import match_form

#: Drilling cycles, and whether the tool retracts at the feed; old cycles, and the number of the part with their feed.
DRILLING = {1: False, 2: True, 17: True, 200: False, 201: True, 202: True, 203: False, 205: False, 206: True,
            207: True, 209: True, 240: False}  # fmt: skip
OLD = {1: 5, 2: 4, 17: 3}
#: Tapping cycles at the pitch of the thread, and its part or parameter.
PITCHES = {17: "3", 207: "Q239", 209: "Q239"}
#: Cycles that do not affect the path.
SILENT = {13, 32, 239, 332, 392}
#: Rapid retraction, written as a feed. [mm/min]
FASTEST = 99999.0
AXIS_VALUE = re.compile(rf"(I?)([XYZ])\s*({VALUE})")
NAMED = re.compile(rf"(SP[ABC])\s*({VALUE})")
#: Words of PLANE for the positioning of the rotary axes, without effect on the plane.
HOW = re.compile(
    r"\b(MOVE|TURN|STAY|SEQ\s*[-+]|SYM\s*[-+]|TABLE\s+ROT|COORD\s+ROT|F\s*MAX|F\s*AUTO|F\s*[\d.,]+|FQ\d+|"
    r"DIST\s*[-+]?[\d.,]+|MB\s*MAX|MB\s*[-+]?[\d.,]+|ABST\s*[-+]?[\d.,]+)"
)
CYCLE_VALUE = re.compile(rf"(Q\d+)\s*=\s*({VALUE}|F?MAX|F?AUTO|PREDEF)")


def find_spatial(a: float, b: float, c: float) -> Frame:
    """Return the frame of spatial angles: rotations about X, then Y, then Z of the untilted frame."""
    return rotate(2, c).then(rotate(1, b)).then(rotate(0, a))


@dataclass
class Cycle:
    """Defined cycle: its number and values, by Q parameters or numbers of its parts (1.2: "2")."""

    number: int
    values: dict[str, float] = field(default_factory=dict)

    def get(self, name: str) -> float:
        """Return a required value of the cycle."""
        if name not in self.values:
            raise InputError(f"cycle {self.number} has no {name if name[0] == 'Q' else f'part {self.number}.{name}'}")
        return self.values[name]


class HeidenhainCycles:
    """Cycles of a program: activation of frames, definition and execution of drilling cycles."""

    def __init__(self, it: Interpreter, words: KlartextWords) -> None:
        self.it, self.words, self.value, self.to_mm_s = it, words, words.value, it.state.to_mm_s
        #: Angle of the active rotation [deg]; number of the datum of cycle 247.
        self.turned = 0.0
        self.preset: float | None = None
        self.cycle: Cycle | None = None
        #: Whether the next lines may hold values of a cycle.
        self.defining = False
        #: Cycles of frames, executed part by part.
        self.frames: dict[int, Callable[[str], None]] = {
            7: self.shift_datum, 8: self._mirror, 10: self._rotate, 11: self._scale, 19: self._tilt,
        }  # fmt: skip
        words.turn_axis = self.use_axis

    def define(self, text: str) -> None:
        """Execute CYCL DEF."""
        found = match_form(CYCLE, text, "cycle: CYCL DEF and its number")
        number, part, rest = int(found.group(1)), int(found.group(2) or 0), found.group(3).strip()
        last = re.search(rf"([-+]?\s*{NUMBER}|Q\d+)\s*$", rest) if part else None
        if number in self.frames:
            if found.group(2) is None:
                raise InputError(f"CYCL DEF {number} in one block is not read, expected {number}.0 and {number}.1 ..")
            if part == 0 and number == 8:
                self.it.set_frames(mirror=None)
            elif part and (rest or number in (8, 19)):
                self.frames[number](rest)
        elif number == 247:
            self._name_preset(rest)
        elif number == 9:
            if last:
                self.it.log.add_event("dwell", value=self.value(last.group(1)))
        elif number in OLD:
            if not part or self.cycle is None or self.cycle.number != number:
                self.cycle = Cycle(number)
            if last:
                self.cycle.values[str(part)] = self.value(last.group(1))
        elif number in DRILLING or number in (220, 221):
            drilling, self.cycle, self.defining = self.cycle, Cycle(number), True
            self.add_values(rest, named=True)
            if number not in DRILLING:
                pattern, self.cycle = self.cycle, drilling
                self._drill_pattern(pattern)
        elif number not in SILENT:
            raise InputError(f"CYCL DEF {number} is not read; write its moves out in the CAM system")

    def add_values(self, text: str, *, named: bool = False) -> bool:
        """Add the values of a text to the cycle, and return whether it holds nothing else; `named`: after a name."""
        found = CYCLE_VALUE.findall(text)
        if self.cycle is None or (not named and CYCLE_VALUE.sub("", text).strip()):
            return False
        self.cycle.values.update({name: self._read_value(value) for name, value in found})
        self.words.values.update(self.cycle.values)
        return True

    def _read_value(self, text: str) -> float:
        if text.endswith("MAX"):
            return FASTEST
        if text.endswith("AUTO"):
            return self.words.tool_feed or 0.0
        if text == "PREDEF":
            raise InputError("values from GLOBAL DEF (PREDEF) are not read; write them out")
        return self.value(text)

    def call(self, place: Point | None = None) -> None:
        """Drill at the position of the tool, or at another one, whose height is added to the surface Q203."""
        if place is not None:
            above = self.words.values.get("Q203", 0.0) + place[self.words.tool_axis]
            self._drill_over(place, {"Q203": above}, "CYCL CALL at positions")
            return
        self.it.contour.refuse_open()
        if self.cycle is None:
            raise InputError("a cycle is called before a supported cycle is defined")
        self._drill(self.cycle)

    def _drill_over(self, place: Point, changes: dict[str, float], what: str) -> None:
        """Move rapidly above a position at the current height, and drill there with modified values of the cycle."""
        if self.cycle is None or self.cycle.number in OLD:
            raise InputError(f"{what} needs a cycle from 200 before it")
        height = self.it.course.position[self.words.tool_axis]
        self.it.course.rapid(set_levels(place, {self.words.tool_axis: height}), PLANE_AXES[self.it.state.plane])
        self._drill(self.cycle, changes)

    def _drill(self, cycle: Cycle, changes: dict[str, float] | None = None) -> None:
        """Execute a cycle at the position of the tool.

        It drills from the set-up clearance Q200 above the surface Q203 to the depth Q201 and retracts to Q204 above the
        surface, with the present values of its parameters. Cycles 1, 2 and 17 drill from the current level by set-up
        clearance plus depth, and retract to it.
        """
        course, axis, old = self.it.course, self.words.tool_axis, cycle.number in OLD
        if not old:
            cycle = Cycle(cycle.number, {name: self.value(name) for name in cycle.values} | (changes or {}))
        values = cycle.values
        if pitch := PITCHES.get(cycle.number):
            feed = abs(cycle.get(pitch)) * self.words.unit * self.it.state.spindle / 60.0
        else:
            feed = self.to_mm_s(cycle.get(str(OLD.get(cycle.number, "Q206"))))
        back = values.get("Q208", 0.0) if cycle.number in (201, 202) else 0.0
        out = None if not DRILLING[cycle.number] or back >= FASTEST else self.to_mm_s(back) if back > 0.0 else feed
        if old and self.it.options.cycles != "expand":
            with self.it.log.hole():
                self.it.note(f"drilling cycle {cycle.number} {SKIPPED}")
            return
        if old:
            course.begin_cut()
            clear = top = course.position[axis]
            depth = -abs(cycle.get("1")) - abs(cycle.get("2"))
            bottom = clear + depth
            if cycle.get("2") > 0.0 and cycle.get("1") >= 0.0:
                raise InputError(
                    f"CYCL DEF {cycle.number} ends above the surface, which is not read; give the depth a minus sign"
                )
        else:
            if cycle.number == 240 and values.get("Q343", 0.0) != 0.0:
                raise InputError("cycle 240 with a diameter (Q343=1) is not read; give it a depth")
            surface, depth = values.get("Q203", 0.0), cycle.get("Q201")
            if depth > 0.0:
                raise InputError(f"CYCL DEF {cycle.number} with a depth Q201 above the surface is not read")
            clear, bottom = surface + cycle.get("Q200"), surface + depth
            top = max(clear, surface + values.get("Q204", 0.0))
            self.it.state.motion = 0.0
        with self.it.log.hole():
            if depth != 0.0:
                if 0.0 < values.get("3" if old else "Q202", 0.0) < -depth:
                    self.it.note(WITHOUT_PECKS)
                hole = Hole(axis, clear, bottom, top, feed, out, by_clear=True)
                drill(course, hole, str(cycle.number))
            elif not old:
                go_to_level(course, axis, top)

    def _drill_pattern(self, pattern: Cycle) -> None:
        """Execute cycles 220 (holes on a circle) and 221 (holes in rows) with the drilling cycle defined before."""
        get, n, course, axis = pattern.get, pattern.values, self.it.course, self.words.tool_axis
        if n.get("Q365", 0.0) != 0.0:
            raise InputError("cycle 220 with arcs between its holes (Q365=1) is not read; set Q365=0")
        kept: dict[str, float] = {name: n[name] for name in ("Q200", "Q203", "Q204") if name in n}
        if n.get("Q301", 1.0) == 0.0:
            kept["Q204"] = 0.0
        if pattern.number == 220:
            count, start, span = int(get("Q241")), get("Q245"), n.get("Q246", 360.0) - get("Q245")
            step = n.get("Q247") or span / max(1, count if abs(abs(span) - 360.0) < 1e-9 else count - 1)
            places = list_circle((get("Q216"), get("Q217")), 0.5 * get("Q244"), start, step, count)
        else:
            counts, steps = (int(get("Q242")), int(get("Q243"))), (get("Q237"), get("Q238"))
            places = list_grid((get("Q225"), get("Q226")), n.get("Q224", 0.0), steps, counts)
        first, second = PLANE_AXES[self.it.state.plane]
        for u, v, _ in places:
            place = set_levels(ORIGIN, {first: u, second: v})
            self._drill_over(place, kept, f"cycle {pattern.number}")
        top = n.get("Q203", 0.0) + n.get("Q204", 0.0)
        if top > course.position[axis]:
            go_to_level(course, axis, top)

    def shift_datum(self, rest: str) -> None:
        """Execute cycle 7: datum shift, absolute from the original datum, or incremental (I) from the active one."""
        found = AXIS_VALUE.findall(rest)
        if re.match(r"(#|D\s*\d|DNO)", rest):
            raise InputError(f"datum table {rest[:20]!r} is not read; write the shift out")
        if not found or re.sub(r"[ABCUVW]\s*[-+]?0*\.?0*(?=\s|$)", "", AXIS_VALUE.sub("", rest)).strip():
            raise InputError(f"datum shift {rest[:30]!r} is not read, expected X Y Z with numbers")
        name = "shift" if self.it.tilted else "datum"
        new = self.it.frames.get(name, Frame()).origin
        for step, letter, text in found:
            axis = AXES.index(letter)
            new = set_levels(new, {axis: self.value(text) + (new[axis] if step else 0.0)})
        if any(new):
            self._refuse_within("a datum shift", "mirror", "rotation")
        self.it.set_frames(**{name: Frame(origin=new) if any(new) else None})

    def run_trans(self, rest: str) -> None:
        """TRANS DATUM: datum shift as in cycle 7."""
        if not rest.startswith(("DATUM AXIS", "DATUM RESET")):
            raise InputError(f"TRANS {rest[:30]!r} is not read; use cycles 7, 8, 10, 11")
        self.shift_datum("X0 Y0 Z0" if rest == "DATUM RESET" else rest[len("DATUM AXIS") :].strip())

    def _refuse_within(self, what: str, *names: str) -> None:
        """Refuse a frame that is stated inside other active frames."""
        if found := [name for name in names if name in self.it.frames]:
            raise InputError(f"{what} after a {found[0]} is not read; state it before, or cancel the {found[0]} first")

    def _name_preset(self, rest: str) -> None:
        """Execute cycle 247: the first datum is that of the path."""
        found = re.search(rf"Q339\s*=\s*({VALUE})", rest)
        preset = self.value(found.group(1)) if found else 0.0
        if self.preset not in (None, preset):
            self.it.note("datums (cycle 247) are not known: all coordinates are taken in one frame")
        self.preset = preset

    def _mirror(self, rest: str) -> None:
        """Execute cycle 8 (mirror image)."""
        letters = re.findall(r"[XYZ]", rest)
        if re.sub(r"[XYZ]|\s", "", rest):
            raise InputError(f"mirror {rest[:20]!r} is not read, expected X, Y, Z")
        if letters:
            self._refuse_within("a mirror", "rotation")
        self.it.set_frames(mirror=mirror(map(AXES.index, letters)) if letters else None)

    def _rotate(self, rest: str) -> None:
        """Execute cycle 10 (rotation)."""
        step, text = match_form(rf"(I?)ROT\s*({VALUE})", rest, "rotation: ROT and an angle").groups()
        angle = self.value(text) + (self.turned if step else 0.0)
        if angle:
            self._refuse_within("a rotation", "mirror")
        self.turned = angle
        self._turn()

    def _turn(self) -> None:
        """Activate the rotation about the tool axis."""
        self.it.set_frames(rotation=rotate(self.words.tool_axis, self.turned) if self.turned else None)

    def _scale(self, rest: str) -> None:
        """Execute cycle 11 (scaling factor)."""
        scale = self.value(match_form(rf"SCL\s*({VALUE})", rest, "scale: SCL and a factor").group(1))
        if not 1e-6 <= scale <= 100.0:
            raise InputError(f"scale {rest[:20]!r} is not read, expected 0.000001 to 100")
        self.it.set_frames(scale=stretch((scale, scale, scale)) if scale != 1.0 else None)

    def _tilt(self, rest: str) -> None:
        """Execute cycle 19 (working plane) with spatial angles; refuse it unless `tilt_angles` confirms them."""
        angles = {letter: self.value(text) for letter, text in re.findall(rf"([ABC])\s*({VALUE})", rest)}
        if any(angles.values()) and self.it.options.axes.tilt_angles != "spatial":
            raise InputError("cycle 19 states spatial angles on some machines, angles of rotary axes on others: say "
                             'tilt_angles = "spatial" in NAME.toml of [cam] machine, or use PLANE SPATIAL')  # fmt: skip
        self._set_tilt(find_spatial(*(angles.get(letter, 0.0) for letter in "ABC")))

    def _set_tilt(self, tilt: Frame) -> None:
        """Activate a tilted plane, or cancel it."""
        self.it.contour.refuse_open()
        if tilt == self.it.plane:
            return
        self._refuse_within("a plane that is tilted, or tilted back,", "shift", "rotation", "mirror", "scale")
        for name in TILT_ANGLES:
            self.words.forget(name, "the machine works it out from the tilted plane")
        if tilt.plain:
            self.words.values.update(dict.fromkeys(TILT_ANGLES, 0.0))
        self.it.set_frames(plane=None if tilt.plain else tilt)
        self.point_tool()

    def use_axis(self) -> None:
        """Apply the tool axis of TOOL CALL to rotation and tool direction."""
        self._turn()
        self.point_tool()

    def point_tool(self) -> None:
        """Orient the tool along the tool axis of the active plane."""
        axis = self.it.plane.turn(PLANE_NORMALS[self.it.state.plane])
        if axis != self.it.log.axis:
            self.it.course.set_tool_axis(axis)

    def run_plane(self, rest: str) -> None:
        """Execute PLANE SPATIAL and PLANE RESET."""
        kind, _, words = rest.partition(" ")
        if kind not in ("SPATIAL", "RESET"):
            raise InputError(f"PLANE {kind} is not read; use PLANE SPATIAL")
        words = HOW.sub(" ", f" {words} ")
        angles = {name: self.value(text) for name, text in NAMED.findall(words)}
        if NAMED.sub("", words).strip() or len(angles) != (3 if kind == "SPATIAL" else 0):
            raise InputError(f"PLANE {rest[:40]!r} is not read, expected SPA SPB SPC and how the axes turn")
        self._set_tilt(find_spatial(*(angles.get(name, 0.0) for name in ("SPA", "SPB", "SPC"))))
