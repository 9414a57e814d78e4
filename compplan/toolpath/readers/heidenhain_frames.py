"""What a Heidenhain program says of frames: datum shifts, mirrors, rotations, tilted planes; its Q parameters."""

from __future__ import annotations

import re
from pathlib import Path

from compplan.toolpath.readers.arcs import Point
from compplan.toolpath.readers.expressions import evaluate
from compplan.toolpath.readers.followed import FollowedReader
from compplan.toolpath.readers.frames import NOWHERE, UNIT, Frame, rotate, shift, stand_on, stretch
from compplan.toolpath.readers.heidenhain_words import GRAMMAR, VALUE
from compplan.toolpath.readers.options import CamTable

INCH = 25.4
AXES = "XYZ"
AXIS_VALUE = re.compile(rf"(I?)([XYZ])\s*({VALUE})")
NAMED = re.compile(rf"(P\d[XYZ]|[A-Z]+)\s*({VALUE})")
#: Words of PLANE that say how the rotary axes go there, not where.
HOW = re.compile(
    r"\b(MOVE|TURN|STAY|SEQ\s*[-+]|SYM\s*[-+]|TABLE\s+ROT|COORD\s+ROT|F\s*MAX|F\s*AUTO|F\s*[\d.,]+|FQ\d+|"
    r"DIST\s*[-+]?[\d.,]+|MB\s*MAX|MB\s*[-+]?[\d.,]+|ABST\s*[-+]?[\d.,]+)"
)
#: Parameters that PLANE and cycle 19 set to the angles of the rotary axes.
TILT_ANGLES = {"Q120", "Q121", "Q122"}


class HeidenhainFrameReader(FollowedReader):
    """Hold what a program has said of frames, parameters and the tool; millimetres and seconds."""

    def __init__(self, file: Path, options: CamTable) -> None:
        super().__init__(file, options)
        self.values: dict[str, float] = {}
        self.unit = Frame()
        self.tool_axis = 2
        self.before, self.after = NOWHERE, NOWHERE
        self.tilt = Frame()
        self.mirror: Point = (1.0, 1.0, 1.0)
        self.turned, self.scale = 0.0, 1.0
        self.preset: float | None = None
        self.tilted = False
        self.values.update(dict.fromkeys(TILT_ANGLES, 0.0))

    def value(self, text: str) -> float:
        """Return a number or the value of a parameter, with its sign."""
        try:
            return float(text)
        except ValueError:
            pass
        try:
            return evaluate(text.replace(",", "."), GRAMMAR, self.look_up)
        except ValueError as fault:
            raise self.error(str(fault)) from None

    def look_up(self, name: str, indices: tuple[float, ...]) -> float:
        """Return the value of a parameter.

        Raises:
            ValueError: If it has none that is known.

        """
        if name in self.values and not indices:
            return self.values[name]
        why = self.unknown.get(name, "the program gives it none")
        raise ValueError(f"parameter {name} has no value that is known: {why}")

    def set_frame(self, *, carried: bool = False) -> None:
        """Put together what is in force; carried: rotary axes have carried tool or part along."""
        place = Frame() if self.tilted else self.rotary.place(tip_control=self.tip_control)
        frame = place.then(self.unit).then(shift(*self.before)).then(self.tilt).then(shift(*self.after))
        if self.mirror != (1.0, 1.0, 1.0):
            frame = frame.then(stretch(*self.mirror))
        if self.turned:
            frame = frame.then(rotate(self.tool_axis, self.turned))
        if self.scale != 1.0:
            frame = frame.then(stretch(self.scale, self.scale, self.scale))
        self.put_frame(frame, carried=carried)

    def define_frame(self, number: int, part: int | None, rest: str) -> bool:
        """Carry out CYCL DEF 7, 8, 10, 11, 19, 26 and 247; return whether the cycle is one of them."""
        if number == 247:
            found = re.search(rf"Q339\s*=\s*({VALUE})", rest)
            preset = self.value(found.group(1)) if found else 0.0
            if self.preset is not None and preset != self.preset:
                self.log.note("datums (cycle 247) are not known: all coordinates are taken in one frame", self.line)
            self.preset = preset
            return True
        if number not in (7, 8, 10, 11, 19, 26):
            return False
        if part is None:
            raise self.error(f"CYCL DEF {number} in one block is not read, expected {number}.0 and {number}.1 ..")
        if part == 0 or (not rest and number not in (8, 19)):
            if part == 0 and number == 8:
                self.mirror = (1.0, 1.0, 1.0)
            return True
        carry_out = {7: self._shift_datum, 8: self._mirror, 10: self._rotate, 11: self._scale, 19: self._tilt_19,
                     26: self._scale_26}  # fmt: skip
        carry_out[number](rest)
        return True

    def shift_datum(self, rest: str) -> None:
        """Carry out TRANS DATUM AXIS, as cycle 7."""
        self._shift_datum(rest)

    def _shift_datum(self, rest: str) -> None:
        """Carry out cycle 7: what counts from the datum before, or (I) from the present one."""
        found = AXIS_VALUE.findall(rest)
        if re.match(r"(#|D\s*\d|DNO)", rest):
            raise self.error(f"datum table {rest[:20]!r} is not read; write the shift out")
        if not found or re.sub(r"[ABCUVW]\s*[-+]?0*\.?0*(?=\s|$)", "", AXIS_VALUE.sub("", rest)).strip():
            raise self.error(f"datum shift {rest[:30]!r} is not read, expected X Y Z with numbers")
        tilted = self.tilt.rows != UNIT
        old = list(self.after if tilted else self.before)
        for step, letter, text in found:
            axis = AXES.index(letter)
            old[axis] = self.value(text) + (old[axis] if step else 0.0)
        new = old[0], old[1], old[2]
        if new != NOWHERE and (self.turned or self.mirror != (1.0, 1.0, 1.0)):
            raise self.error("a datum shift after a rotation or a mirror is not read; shift first")
        if tilted:
            self.after = new
        else:
            self.before = new
        self.set_frame()

    def _mirror(self, rest: str) -> None:
        letters = re.findall(r"[XYZ]", rest)
        if re.sub(r"[XYZ]|\s", "", rest):
            raise self.error(f"mirror {rest[:20]!r} is not read, expected X, Y, Z")
        x, y, z = (-1.0 if letter in letters else 1.0 for letter in AXES)
        self.mirror = x, y, z
        if letters and self.turned:
            raise self.error("a mirror after a rotation is not read; mirror first, rotate then")
        self.set_frame()

    def _rotate(self, rest: str) -> None:
        found = re.fullmatch(rf"(I?)ROT\s*({VALUE})", rest)
        if not found:
            raise self.error(f"rotation {rest[:20]!r} is not read, expected ROT and an angle")
        angle = self.value(found.group(2)) + (self.turned if found.group(1) else 0.0)
        if angle and self.mirror != (1.0, 1.0, 1.0):
            raise self.error("a rotation in a mirrored frame is not read")
        self.turned = angle
        self.set_frame()

    def _scale(self, rest: str) -> None:
        found = re.fullmatch(rf"SCL\s*({VALUE})", rest)
        if not found or not 1e-6 <= self.value(found.group(1)) <= 100.0:
            raise self.error(f"scale {rest[:20]!r} is not read, expected SCL and a factor")
        self.scale = self.value(found.group(1))
        self.set_frame()

    def _scale_26(self, rest: str) -> None:
        factors = [self.value(text) for _, _, text in AXIS_VALUE.findall(re.sub(r"CC[XYZ]\s*[-+\d.,]+", "", rest))]
        if any(factor != 1.0 for factor in factors):
            raise self.error("scales of single axes (cycle 26) are not read")

    def _tilt_19(self, rest: str) -> None:
        """Carry out cycle 19: spatial angles, or angles of rotary axes: the machine says which."""
        angles = {letter: self.value(text) for letter, text in re.findall(rf"([ABC])\s*({VALUE})", rest)}
        kind = self.options.tilt_angles
        if any(angles.values()) and kind is None:
            raise self.error("cycle 19 states spatial angles on some machines, angles of rotary axes on others: say "
                             'which with [cam] tilt_angles = "spatial", or use PLANE SPATIAL')  # fmt: skip
        if any(angles.values()) and kind != "spatial":
            raise self.error("cycle 19 with angles of rotary axes is not read; use PLANE SPATIAL")
        self._stand(self._spatial(*(angles.get(letter, 0.0) for letter in "ABC")))

    def _spatial(self, a: float, b: float, c: float) -> Frame:
        """Return the frame of spatial angles: first about X, then Y, then Z of the frame that is not tilted."""
        return rotate(2, c).then(rotate(1, b)).then(rotate(0, a))

    def _stand(self, tilt: Frame) -> None:
        """Put a tilted plane in force, or take it back."""
        self.contour.refuse_open()
        self.tilted = not tilt.plain
        if tilt == self.tilt:
            return
        if self.turned or self.scale != 1.0 or self.mirror != (1.0, 1.0, 1.0) or self.after != NOWHERE:
            raise self.error("a plane is tilted, or tilted back, while a shift made in it, a rotation, a mirror or a "
                             "scale is in force; take that back first")  # fmt: skip
        self.tilt = tilt
        for name in TILT_ANGLES:
            self.values.pop(name, None)
            self.unknown[name] = "the machine works it out from the tilted plane"
        if tilt.plain:
            self.values.update(dict.fromkeys(TILT_ANGLES, 0.0))
        self.set_frame()
        self.point_tool()

    def point_tool(self) -> None:
        """Point the tool along the tool axis of the plane in force."""
        x, y, z = (1.0 if axis == self.tool_axis else 0.0 for axis in range(3))
        axis = self.tilt.turn((x, y, z))
        if axis != self.log.axis:
            self.course.aim(axis)

    def run_plane(self, rest: str) -> None:
        """Carry out PLANE .. ."""
        kind, _, words = rest.partition(" ")
        words = HOW.sub(" ", f" {words} ")
        numbers = {name: self.value(text) for name, text in NAMED.findall(words)}
        if NAMED.sub("", words).strip():
            raise self.error(f"PLANE {rest[:40]!r} is not read, {NAMED.sub('', words).strip()[:20]!r} is not known")
        try:
            self._stand(self._find_plane(kind, numbers))
        except KeyError as missing:
            raise self.error(f"PLANE {kind} has no {missing.args[0]}") from None
        except ValueError as fault:
            raise self.error(str(fault)) from None

    def _find_plane(self, kind: str, n: dict[str, float]) -> Frame:
        if kind == "RESET":
            return Frame()
        if kind == "SPATIAL":
            return self._spatial(n["SPA"], n["SPB"], n["SPC"])
        if kind == "EULER":
            return rotate(2, n["EULPR"]).then(rotate(0, n["EULNU"])).then(rotate(2, n["EULROT"]))
        if kind == "VECTOR":
            return stand_on((n["BX"], n["BY"], n["BZ"]), (n["NX"], n["NY"], n["NZ"]))
        if kind == "POINTS":
            one, two, three = ((n[f"P{i}X"], n[f"P{i}Y"], n[f"P{i}Z"]) for i in (1, 2, 3))
            x = two[0] - one[0], two[1] - one[1], two[2] - one[2]
            y = three[0] - one[0], three[1] - one[1], three[2] - one[2]
            normal = x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
            if any(one):
                raise ValueError("PLANE POINTS is read with its first point at the datum; shift the datum there")
            return stand_on(x, normal)
        if kind == "RELATIV":
            (name, angle), *more = n.items()
            if more or name not in ("SPA", "SPB", "SPC"):
                raise ValueError("PLANE RELATIV takes one angle: SPA, SPB or SPC")
            return self.tilt.then(rotate("ABC".index(name[-1]), angle))
        raise ValueError(f"PLANE {kind} is not read; use PLANE SPATIAL")
