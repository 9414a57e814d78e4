"""Turned, scaled and tilted frames of a G-code program: G51, G51.1, G68, G68.2, G53.1."""

from __future__ import annotations

import math

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine
from compplan.toolpath.readers.cnc.course import UP
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.origins import Origins
from compplan.toolpath.readers.cnc.state import AXES, DEEP_AXIS, CncBlock
from compplan.toolpath.readers.frames import rotate, scale_about, shift, turn_about

#: From this factor on, a scale P without a decimal point counts in thousandths.
LEAST_THOUSANDTHS = 100.0


class Layers:
    """Put frames in force on top of the program's origin."""

    def __init__(self, it: Interpreter, origins: Origins) -> None:
        self.it, self.origins = it, origins
        self.mirrors: dict[int, float] = {}
        self.turned_to_plane = False

    @property
    def plane_axis(self) -> Point | None:
        """Axis of the tilted plane in force, None without one."""
        return self.it.frames["plane"].turn(UP) if self.it.tilted else None

    def _find_centre(self, block: CncBlock, letters: str = AXES) -> Point:
        """Return the centre of a rotation or scale: coordinates of the block, the tool's place where there is none."""
        course, state, values = self.it.course, self.it.state, block.values
        centre = list(course.position)
        for axis, letter in enumerate(AXES):
            if letter in values and letter in letters:
                if state.incremental:
                    raise InputError("the centre of a rotation or scale in G91 has two meanings, state it in G90")
                centre[axis] = values[letter] * state.scale
            elif letter in letters and (axis in course.lost or axis in course.untold):
                raise InputError(f"a rotation or scale about the tool's place, whose {letter} is not known; state it")
        return combine(1.0, (centre[0], centre[1], centre[2]), 1.0, self.origins.zero)

    def rotate(self, block: CncBlock) -> None:
        """Carry out G68: a turn by R degrees in the plane in force, counter-clockwise."""
        values, plane = block.values, self.it.state.plane
        if self.it.tilted and not values.keys().isdisjoint("IJK"):
            raise InputError("G68 in space within a tilted plane is not read; post-process without it")
        if "R" not in values or not values.keys().isdisjoint("IJK"):
            raise InputError("G68 has no angle R in the plane, other forms of it are not read; post-process without it")
        if self.it.state.incremental:
            raise InputError("G68 in G91 has two meanings, state it in G90")
        axis = DEEP_AXIS[plane]
        centre = self._find_centre(block, "".join(letter for letter in AXES if letter != AXES[axis]))
        self.it.put(rotation=turn_about(centre, rotate(axis, values["R"])))

    def scale(self, block: CncBlock) -> None:
        """Carry out G51: P scales all axes, I J K each its own; whole numbers from 100 on count in thousandths."""
        scales = [block.values.get("P", block.values.get(letter, 1.0)) for letter in "IJK"]
        for number, scale in enumerate(scales):
            if abs(scale) >= LEAST_THOUSANDTHS and scale == int(scale):
                self.it.note(f"G51 scale {scale:g} is read in thousandths")
                scales[number] = scale * 1e-3
        if any(abs(scale) < 1e-4 or abs(scale) > LEAST_THOUSANDTHS for scale in scales):
            raise InputError(f"G51 scales by {scales}, expected factors from 0.0001 to 100")
        self.it.put(scale=scale_about(self._find_centre(block), (scales[0], scales[1], scales[2])))

    def mirror(self, code: float, block: CncBlock) -> None:
        """Carry out G51.1 (mirror about X.. Y.. Z..) and G50.1 (take mirrors back)."""
        named, zero = block.list_axes(), self.origins.zero
        for axis in named if code == 51.1 or named else list(self.mirrors):
            if code == 51.1:
                self.mirrors[axis] = block.values[AXES[axis]] * self.it.state.scale + zero[axis]
            else:
                self.mirrors.pop(axis, None)
        at = [self.mirrors.get(axis, 0.0) for axis in range(3)]
        sense = [-1.0 if axis in self.mirrors else 1.0 for axis in range(3)]
        centre, senses = (at[0], at[1], at[2]), (sense[0], sense[1], sense[2])
        self.it.put(mirror=scale_about(centre, senses) if self.mirrors else None)

    def tilt(self, block: CncBlock) -> None:
        """Carry out G68.2: origin X Y Z, and I J K as Euler angles z x' z'', or with P1 as turns about fixed X Y Z."""
        values, form = block.values, block.values.get("P", 0.0)
        if form not in (0.0, 1.0) or (form == 1.0 and values.get("Q", 123.0) != 123.0) or self.it.state.incremental:
            raise InputError("G68.2 is read in G90, as Euler angles or with P1 and Q123; post-process it so")
        i, j, k = (values.get(letter, 0.0) for letter in "IJK")
        order = ((2, k), (1, j), (0, i)) if form == 1.0 else ((2, i), (0, j), (2, k))
        turn = rotate(*order[0]).then(rotate(*order[1])).then(rotate(*order[2]))
        x, y, z = (values.get(letter, 0.0) * self.it.state.scale for letter in AXES)
        self.it.put(plane=shift(x, y, z).then(turn_about(self.origins.zero, turn)), rotation=None)
        self.turned_to_plane = False

    def turn_to_plane(self, code: float, *, stays: bool) -> None:
        """Carry out G53.1 and G53.6: the rotary axes set the tool square to the tilted plane, its tip stays or not."""
        axis = self.plane_axis
        if axis is None:
            raise InputError(f"G{code:g} without a tilted plane (G68.2) has nothing to turn to")
        self.turned_to_plane = True
        if not stays:
            self.it.course.lose()
        self.it.log.axis = axis

    def check_plane(self) -> None:
        """Refuse a cut in a tilted plane that the tool was not turned to."""
        axis = self.plane_axis
        if axis is not None and not self.turned_to_plane and math.dist(axis, self.it.log.axis) > 1e-9:
            raise InputError("a cut in a tilted plane (G68.2) that the tool is not turned to (G53.1, or A B C)")
