"""What a Heidenhain program says of frames: datum shifts, mirrors, rotations, scales, tilted planes."""

from __future__ import annotations

import re

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import cross
from compplan.toolpath.readers.cnc.heidenhain_words import TILT_ANGLES, VALUE, KlartextWords
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import AXES
from compplan.toolpath.readers.frames import NOWHERE, PLANE_NORMALS, Frame, rotate, shift, stand_on, stretch
from compplan.toolpath.readers.lines import match_form

AXIS_VALUE = re.compile(rf"(I?)([XYZ])\s*({VALUE})")
NAMED = re.compile(rf"(P\d[XYZ]|[A-Z]+)\s*({VALUE})")
#: Words of PLANE that say how the rotary axes go there, not where.
HOW = re.compile(
    r"\b(MOVE|TURN|STAY|SEQ\s*[-+]|SYM\s*[-+]|TABLE\s+ROT|COORD\s+ROT|F\s*MAX|F\s*AUTO|F\s*[\d.,]+|FQ\d+|"
    r"DIST\s*[-+]?[\d.,]+|MB\s*MAX|MB\s*[-+]?[\d.,]+|ABST\s*[-+]?[\d.,]+)"
)


def find_spatial(a: float, b: float, c: float) -> Frame:
    """Return the frame of spatial angles: first about X, then Y, then Z of the frame that is not tilted."""
    return rotate(2, c).then(rotate(1, b)).then(rotate(0, a))


class KlartextDatums:
    """Put in force the frames that a program states."""

    def __init__(self, it: Interpreter, words: KlartextWords) -> None:
        self.it, self.words, self.value = it, words, words.value
        #: Angle of the rotation in force [deg]; the datum that cycle 247 named.
        self.turned = 0.0
        self.preset: float | None = None
        words.turn_axis = self.use_axis

    @property
    def tilt(self) -> Frame:
        """The tilted plane in force."""
        return self.it.frames.get("plane", Frame())

    def shift_datum(self, rest: str) -> None:
        """Carry out cycle 7: what counts from the datum before, or (I) from the present one."""
        found = AXIS_VALUE.findall(rest)
        if re.match(r"(#|D\s*\d|DNO)", rest):
            raise InputError(f"datum table {rest[:20]!r} is not read; write the shift out")
        if not found or re.sub(r"[ABCUVW]\s*[-+]?0*\.?0*(?=\s|$)", "", AXIS_VALUE.sub("", rest)).strip():
            raise InputError(f"datum shift {rest[:30]!r} is not read, expected X Y Z with numbers")
        name = "shift" if self.it.tilted else "datum"
        new = list(self.it.frames.get(name, Frame()).origin)
        for step, letter, text in found:
            axis = AXES.index(letter)
            new[axis] = self.value(text) + (new[axis] if step else 0.0)
        if any(new) and (self.turned or "mirror" in self.it.frames):
            raise InputError("a datum shift after a rotation or a mirror is not read; shift first")
        self.it.put(**{name: shift(new[0], new[1], new[2])})

    def name_preset(self, rest: str) -> None:
        """Carry out cycle 247: the first datum is that of the path."""
        found = re.search(rf"Q339\s*=\s*({VALUE})", rest)
        preset = self.value(found.group(1)) if found else 0.0
        if self.preset not in (None, preset):
            self.it.note("datums (cycle 247) are not known: all coordinates are taken in one frame")
        self.preset = preset

    def mirror(self, rest: str) -> None:
        """Carry out cycle 8."""
        letters = re.findall(r"[XYZ]", rest)
        if re.sub(r"[XYZ]|\s", "", rest):
            raise InputError(f"mirror {rest[:20]!r} is not read, expected X, Y, Z")
        if letters and self.turned:
            raise InputError("a mirror after a rotation is not read; mirror first, rotate then")
        x, y, z = (-1.0 if letter in letters else 1.0 for letter in AXES)
        self.it.put(mirror=stretch(x, y, z) if letters else None)

    def rotate(self, rest: str) -> None:
        """Carry out cycle 10."""
        step, text = match_form(rf"(I?)ROT\s*({VALUE})", rest, "rotation: ROT and an angle").groups()
        angle = self.value(text) + (self.turned if step else 0.0)
        if angle and "mirror" in self.it.frames:
            raise InputError("a rotation in a mirrored frame is not read")
        self.turned = angle
        self.it.put(rotation=rotate(self.words.tool_axis, angle))

    def scale(self, rest: str) -> None:
        """Carry out cycle 11."""
        scale = self.value(match_form(rf"SCL\s*({VALUE})", rest, "scale: SCL and a factor").group(1))
        if not 1e-6 <= scale <= 100.0:
            raise InputError(f"scale {rest[:20]!r} is not read, expected 0.000001 to 100")
        self.it.put(scale=stretch(scale, scale, scale) if scale != 1.0 else None)

    def tilt_by_cycle(self, rest: str) -> None:
        """Carry out cycle 19: spatial angles, or angles of rotary axes: the machine says which."""
        angles = {letter: self.value(text) for letter, text in re.findall(rf"([ABC])\s*({VALUE})", rest)}
        if any(angles.values()) and self.it.options.axes.tilt_angles != "spatial":
            raise InputError("cycle 19 states spatial angles on some machines, angles of rotary axes on others: say "
                             'tilt_angles = "spatial" in NAME.toml of [cam] machine, or use PLANE SPATIAL')  # fmt: skip
        self._stand(find_spatial(*(angles.get(letter, 0.0) for letter in "ABC")))

    def _stand(self, tilt: Frame) -> None:
        """Put a tilted plane in force, or take it back."""
        self.it.contour.refuse_open()
        if tilt == self.tilt:
            return
        moved = self.it.frames.get("shift", Frame()).origin != NOWHERE
        if self.turned or moved or not {"mirror", "scale"}.isdisjoint(self.it.frames):
            raise InputError("a plane is tilted, or tilted back, while a shift made in it, a rotation, a mirror or a "
                             "scale is in force; take that back first")  # fmt: skip
        for name in TILT_ANGLES:
            self.words.forget(name, "the machine works it out from the tilted plane")
        if tilt.plain:
            self.words.values.update(dict.fromkeys(TILT_ANGLES, 0.0))
        self.it.put(plane=None if tilt.plain else tilt)
        self.point_tool()

    def use_axis(self) -> None:
        """Take another tool axis, that of TOOL CALL."""
        self.it.put(rotation=rotate(self.words.tool_axis, self.turned))
        self.point_tool()

    def point_tool(self) -> None:
        """Point the tool along the tool axis of the plane in force."""
        axis = self.tilt.turn(PLANE_NORMALS[self.it.state.plane])
        if axis != self.it.log.axis:
            self.it.course.aim(axis)

    def run_plane(self, rest: str) -> None:
        """Carry out PLANE .. ."""
        kind, _, words = rest.partition(" ")
        words = HOW.sub(" ", f" {words} ")
        numbers = {name: self.value(text) for name, text in NAMED.findall(words)}
        if NAMED.sub("", words).strip():
            raise InputError(f"PLANE {rest[:40]!r} is not read, {NAMED.sub('', words).strip()[:20]!r} is not known")
        try:
            self._stand(self._find_plane(kind, numbers))
        except KeyError as missing:
            raise InputError(f"PLANE {kind} has no {missing.args[0]}") from None

    def _find_plane(self, kind: str, n: dict[str, float]) -> Frame:
        if kind == "RESET":
            return Frame()
        if kind == "SPATIAL":
            return find_spatial(n["SPA"], n["SPB"], n["SPC"])
        if kind == "EULER":
            return rotate(2, n["EULPR"]).then(rotate(0, n["EULNU"])).then(rotate(2, n["EULROT"]))
        if kind == "VECTOR":
            return stand_on((n["BX"], n["BY"], n["BZ"]), (n["NX"], n["NY"], n["NZ"]))
        if kind == "POINTS":
            one, two, three = ((n[f"P{i}X"], n[f"P{i}Y"], n[f"P{i}Z"]) for i in (1, 2, 3))
            if any(one):
                raise ValueError("PLANE POINTS is read with its first point at the datum; shift the datum there")
            return stand_on(two, cross(two, three))
        if kind == "RELATIV":
            (name, angle), *more = n.items()
            if more or name not in ("SPA", "SPB", "SPC"):
                raise ValueError("PLANE RELATIV takes one angle: SPA, SPB or SPC")
            return self.tilt.then(rotate("ABC".index(name[-1]), angle))
        raise ValueError(f"PLANE {kind} is not read; use PLANE SPATIAL")
