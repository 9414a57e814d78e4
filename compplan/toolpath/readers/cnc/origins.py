"""Frames of G-code: work offsets, shifts of the origin, reference positions; rotated, scaled and tilted frames.

`change_frame` and `swivel` execute the frame words of Sinumerik programs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Point, combine, set_levels
from compplan.toolpath.readers.cnc.interpreter import Interpreter
from compplan.toolpath.readers.cnc.state import AXES, LETTERS, CncBlock
from compplan.toolpath.readers.frames import (
    DEEP_AXIS,
    ORIGIN,
    PLANE_AXES,
    UP,
    Frame,
    mirror,
    rotate,
    stretch,
    turn_about,
)

DECLARED = "moves after the G92 origin is dropped are left out: how it lies to the work offset is not known"
OUTSIDE = "cuts in other work offsets than the part frame's (wcs) are left out"
#: Least scale P that is read in thousandths if it is a whole number.
LEAST_THOUSANDTHS = 100.0


def name_offset(code: float) -> str:
    """Return the name of a work offset: G54, G59.1, G54.1 P12."""
    return f"G54.1 P{code - 1000.0:g}" if code >= 1000.0 else f"G{code:g}"


class Origins:
    """Origin of the program in the part, frames on top of it, and moves in machine coordinates."""

    def __init__(self, it: Interpreter, setting: str = "") -> None:
        self.it, self.course, self.state, self.setting = it, it.course, it.state, setting
        found = re.search(r"(?:P(\d+)|G(\d+(?:\.\d)?))$", (it.options.wcs or "").upper())
        self.wcs = (1000.0 + float(found[1]) if found[1] else float(found[2])) if found else None
        #: Active work offset, work offset of the path, and work offsets used so far.
        self.active = 54.0
        self.part_offset = self.wcs or 54.0
        self.used = {54.0}
        #: Origins set by G10 L2, in machine coordinates by axis; origins of inactive offsets in that of the path.
        self.origins: dict[float, dict[int, float]] = {}
        self.bases: dict[float, Point] = {}
        #: Shifts of the origin by G92 and G52, origin of the work offset in that of the path; shift restored by G92.3.
        self.origin = self.shifted = self.base = ORIGIN
        self.kept: Point | None = None
        #: Axes with coordinates known from G92 only.
        self.declared: set[int] = set()
        #: Coordinates of the mirrors (G51.1) by axis; whether the tool was oriented to the tilted plane.
        self.mirrors: dict[int, float] = {}
        self.turned_to_plane = False
        if self.part_offset != 54.0:
            self.course.suspend(OUTSIDE)

    @property
    def zero(self) -> Point:
        """Origin of the program in the work offset of the path."""
        return combine(1.0, combine(1.0, self.origin, 1.0, self.shifted), 1.0, self.base)

    def use(self, code: float, number: float = 0.0) -> None:
        """Activate a work offset, or a numbered one (G54.1); without wcs and G10, that of the first cut is the part."""
        course, before, code = self.course, self.active, 1000.0 + number if number else code
        self.used.add(code)
        if code == before:
            return
        if course.begun and not course.frame.plain:
            raise InputError(f"{name_offset(code)} within a turned or scaled frame is not read; post-process without")
        self.active = code
        fresh = self.wcs is None and not course.begun
        if fresh and list(course.unknown.values()) == [False] * 3:
            self.part_offset = code
            return
        old, new = self.origins.get(before, {}), self.origins.get(code, {})
        if OUTSIDE in course.suspended and (code in self.bases or code == self.part_offset):
            self.base = self.bases.get(code, ORIGIN)
            course.resume(OUTSIDE)
        elif len(old) == 3 and len(new) == 3 and OUTSIDE not in course.suspended:
            self.base = combine(1.0, self.base, 1.0, (new[0] - old[0], new[1] - old[1], new[2] - old[2]))
        elif fresh:
            self.part_offset = code
            course.mark_unknown()
            self.it.log.clear()
        elif OUTSIDE not in course.suspended:
            self.bases[before] = self.base
            here, there = name_offset(self.part_offset), name_offset(code)
            setting = f", or set both with {self.setting} in the file" if self.setting else ""
            refusal = (
                f"the file cuts in {here} and in {there}, and how they lie to each other is not known; state which one "
                f'is the part frame with wcs = "{here}" (--wcs "{here}"){setting}'
            )
            note = f"rapid moves in {there} are left out: how it lies to {here} is not known"
            self.it.contour.refuse_open()
            course.suspend(OUTSIDE, *(("", "") if self.wcs is not None else (refusal, note)))
        self.it.set_frames(origin=Frame(origin=self.zero))

    def check_used(self) -> None:
        """Refuse a wcs that the file does not use."""
        if self.wcs is not None and self.wcs not in self.used:
            used = ", ".join(name_offset(code) for code in sorted(self.used))
            raise InputError(f"wcs is {name_offset(self.wcs)}, which the file does not use; it uses {used}")
        if self.course.left_out and self.wcs is not None:
            self.it.note(f"{OUTSIDE}: {self.course.left_out} of them")

    def set_offset(self, block: CncBlock) -> None:
        """Execute G10 L2, which sets a work offset; note other forms of G10."""
        values, kind = block.values, block.values.get("L", 0.0)
        if kind == 20.0 or (kind == 2.0 and (self.state.incremental or values.get("R", 0.0) != 0.0)):
            raise InputError("G10 that turns a work offset, or counts from the tool, is not read; state G10 L2")
        if kind != 2.0:
            self.it.note("G10 offsets are not read")
            return
        number = values.get("P", 0.0)
        if number not in range(16):
            raise InputError(f"G10 L2 P{number:g} names no work offset, expected P0 to P15")
        code = self.active if number == 0 else 53.0 + number if number <= 6 else 59.0 + (number - 6) / 10.0
        before, stated = self.origins.get(code, {}), self.state.lengths(block)
        self.origins[code] = {**before, **stated}
        if code == self.active and (self.course.begun or list(self.course.unknown.values()).count(False) < 3):
            if stated.keys() - before.keys():
                raise InputError("G10 L2 changes the active work offset, whose value the file does not state; "
                                 "state it by G10 L2 before the first move")  # fmt: skip
            moved = {axis: self.base[axis] + (level - before[axis]) for axis, level in stated.items()}
            self.base = set_levels(self.base, moved)
            self.it.set_frames(origin=Frame(origin=self.zero))

    def go_home(self, code: float, block: CncBlock) -> None:
        """Execute G28 and G30: rapidly through the intermediate point to the reference position, which is unknown.

        G91 of the same block is executed before: G28 G91 Z0 starts at the position of the tool.
        """
        named, values = block.list_axes(), block.values
        self.it.note(f"G{code:g} goes to the machine's home, whose place is not known: it is left out")
        self.it.contour.refuse_open()
        if named and not (self.state.incremental and all(values[AXES[axis]] == 0.0 for axis in named)):
            self.course.rapid(*self.it.motion.target(block))
        turned = [letter for letter in LETTERS if letter in values]
        axes = named if named or turned else [0, 1, 2]
        if 2 in axes:
            self.course.retreat()
        self.course.mark_unknown(axes)
        self.it.turn_home(dict.fromkeys(turned, 0.0))

    def shift(self, block: CncBlock) -> None:
        """Shift the origin of the program (G52)."""
        self.shifted = set_levels(self.shifted, self.state.lengths(block))
        self.it.set_frames(origin=Frame(origin=self.zero))

    def set_position(self, block: CncBlock) -> None:
        """Set the coordinates of the current position (G92).

        Unknown coordinates of the tool become known; for known ones the origin moves, before and after the first cut.
        """
        course, stated, position = self.course, self.state.lengths(block), self.course.position
        lost = {axis: level for axis, level in stated.items() if axis in course.unknown}
        found = {axis for axis in lost if course.unknown[axis]}
        step = set_levels(ORIGIN, {axis: lost[axis] - position[axis] for axis in lost.keys() - found})
        moved = {axis: self.origin[axis] + position[axis] - stated[axis] for axis in stated.keys() - lost.keys()}
        course.position = set_levels(position, lost)
        self.declared.update(lost)
        course.mark_known(self.declared)
        if not course.begun and any(step):
            self.it.log.shift(course.frame.turn(step))
        if found:
            course.rapid(course.position)
        self.origin = self.kept = set_levels(self.origin, moved)
        self.it.set_frames(origin=Frame(origin=self.zero))

    def cancel_shift(self, code: float) -> None:
        """Execute G92.1 and G92.2, which cancel the shift of G92, and G92.3, which restores it after G92.2."""
        if code == 92.3 and self.kept is None:
            raise InputError("G92.3 brings back an offset from before this program, which is not known; set it by G92")
        self.origin, self.kept = (
            (self.kept or ORIGIN) if code == 92.3 else ORIGIN,
            ORIGIN if code == 92.1 else self.kept,
        )
        if code == 92.3:
            self.course.resume(DECLARED)
        elif self.declared:
            self.it.note(DECLARED)
            self.course.suspend(DECLARED, (
                f"a cut after G{code:g}, which drops the origin that G92 set where the tool stood: how it lies to "
                "the work offset is not known; end the cuts before it, or let a move to X Y Z come before G92"
            ))  # fmt: skip
        self.it.set_frames(origin=Frame(origin=self.zero))

    def _find_centre(self, block: CncBlock, axes: Sequence[int] = (0, 1, 2)) -> Point:
        """Return the centre of a rotation or scaling: coordinates of the block, by default those of the tool."""
        stated = {axis: level for axis, level in self.state.lengths(block).items() if axis in axes}
        if stated and self.state.incremental:
            raise InputError("the centre of a rotation or scale in G91 has two meanings, state it in G90")
        if unknown := [axis for axis in axes if axis in self.course.unknown and axis not in stated]:
            raise InputError(f"a rotation or scale about the tool's place, whose {AXES[unknown[0]]} is not known")
        return combine(1.0, set_levels(self.course.position, stated), 1.0, self.zero)

    def rotate(self, block: CncBlock) -> None:
        """Execute G68: rotation by R degrees in the active plane, counter-clockwise."""
        plane = self.state.plane
        if "R" not in block.values or block.has(frozenset("IJK")) or self.state.incremental:
            raise InputError("G68 is read with an angle R in the plane, in G90; post-process other forms of it")
        centre = self._find_centre(block, PLANE_AXES[plane])
        scaled = self.it.frames.get("scale", Frame()).apply(centre)
        if len(self.mirrors.keys() & {*PLANE_AXES[plane]}) == 1 or math.dist(scaled, centre) > 1e-9:
            raise InputError("G68 under a mirror (G51.1), or a scale (G51) about another centre, has two meanings; "
                             "post-process without one of them")  # fmt: skip
        self.it.set_frames(rotation=turn_about(centre, rotate(DEEP_AXIS[plane], block.values["R"])))

    def scale(self, block: CncBlock) -> None:
        """Execute G51: P scales all axes, I J K single axes; whole numbers from 100 on are in thousandths."""
        scales = [block.values.get("P", block.values.get(letter, 1.0)) for letter in "IJK"]
        for number, scale in enumerate(scales):
            if abs(scale) >= LEAST_THOUSANDTHS and scale == int(scale):
                self.it.note(f"G51 scale {scale:g} is read in thousandths")
                scales[number] = scale * 1e-3
        if any(abs(scale) < 1e-4 or abs(scale) > LEAST_THOUSANDTHS for scale in scales):
            raise InputError(f"G51 scales by {scales}, expected factors from 0.0001 to 100")
        self.it.set_frames(scale=stretch((scales[0], scales[1], scales[2]), self._find_centre(block)))

    def mirror(self, code: float, block: CncBlock) -> None:
        """Execute G51.1 (mirror about X.. Y.. Z..) and G50.1 (cancel mirrors)."""
        stated = self.state.lengths(block)
        if code == 51.1:
            self.mirrors |= {axis: level + self.zero[axis] for axis, level in stated.items()}
        else:
            self.mirrors = {axis: level for axis, level in self.mirrors.items() if stated and axis not in stated}
        self.it.set_frames(mirror=mirror(self.mirrors, set_levels(ORIGIN, self.mirrors)) if self.mirrors else None)

    def tilt(self, block: CncBlock) -> None:
        """Execute G68.2: origin X Y Z, and I J K as Euler angles z x' z'', with P1 as rotations about fixed X Y Z."""
        values, form = block.values, block.values.get("P", 0.0)
        if form not in (0.0, 1.0) or (form == 1.0 and values.get("Q", 123.0) != 123.0) or self.state.incremental:
            raise InputError("G68.2 is read in G90, as Euler angles or with P1 and Q123; post-process it so")
        i, j, k = (values.get(letter, 0.0) for letter in "IJK")
        order = ((2, k), (1, j), (0, i)) if form == 1.0 else ((2, i), (0, j), (2, k))
        turn = rotate(*order[0]).then(rotate(*order[1])).then(rotate(*order[2]))
        corner = set_levels(ORIGIN, self.state.lengths(block))
        self.it.set_frames(plane=Frame(origin=corner).then(turn_about(self.zero, turn)), rotation=None)
        self.turned_to_plane = False

    def turn_to_plane(self, code: float, *, stays: bool) -> None:
        """Execute G53.1 and G53.6: orient the tool normal to the tilted plane; `stays`: its tip does not move."""
        if not self.it.tilted:
            raise InputError(f"G{code:g} without a tilted plane; define one by G68.2 before it")
        self.turned_to_plane = True
        if not stays:
            self.it.course.mark_unknown()
        self.it.log.axis = self.it.plane.turn(UP)

    def check_plane(self) -> None:
        """Refuse a cut in a tilted plane to which the tool is not oriented."""
        turned = self.turned_to_plane or math.dist(self.it.plane.turn(UP), self.it.log.axis) <= 1e-9
        if self.it.tilted and not turned:
            raise InputError("a cut in a tilted plane (G68.2) before the tool is oriented to it; add G53.1 or A B C")


FRAME_WORDS = frozenset(("TRANS", "ATRANS", "ROT", "AROT", "SCALE", "ASCALE", "MIRROR", "AMIRROR"))


def change_frame(it: Interpreter, word: str, block: CncBlock) -> None:
    """Execute TRANS, ROT, SCALE, MIRROR (replace the programmable frame) and ATRANS .. (added to it)."""
    values, kind = block.values, word.removeprefix("A")
    if unknown := values.keys() - {"X", "Y", "Z", "RPL"}:
        raise InputError(f"{word} with {min(unknown)} is not read, expected X Y Z")
    x, y, z = (values.get(letter, 0.0) for letter in AXES)
    if kind == "TRANS":
        step = Frame(origin=set_levels(ORIGIN, it.state.lengths(block)))
    elif kind == "ROT" and "RPL" in values:  # in the plane
        if len(values) > 1:
            raise InputError("RPL beside rotations about axes is not read")
        step = rotate(DEEP_AXIS[it.state.plane], values["RPL"])
    elif kind == "ROT":  # about Z, then the new Y, then the new X
        if any((x, y, z)[axis] for axis in PLANE_AXES[it.state.plane]) and not it.tilted:
            it.note("ROT tilts the coordinates; the tool axis stays until rotary axes or CYCLE800 turn it")
        step = rotate(2, z).then(rotate(1, y)).then(rotate(0, x))
    elif kind == "SCALE":
        factors = [values.get(letter, 1.0) for letter in AXES]
        if len(set(factors)) > 1 or not 1e-6 < abs(factors[0]) < 1e6:
            raise InputError(f"{word} with different factors of its axes is not read")
        step = stretch((factors[0], factors[0], factors[0]))
    else:
        step = mirror(block.list_axes())
    it.contour.refuse_open()
    it.set_frames(program=it.frames.get("program", Frame()).then(step) if word.startswith("A") else step)


def swivel(it: Interpreter, arguments: Sequence[float]) -> None:
    """Execute CYCLE800(_FR, _TC, _ST, _MODE, X0, Y0, Z0, A, B, C, X1, Y1, Z1, ..): a swivelled plane."""
    it.contour.refuse_open()
    numbers = [*arguments, *[0.0] * 14]
    status, mode = int(numbers[2]), int(numbers[3])
    x0, y0, z0, a, b, c, x1, y1, z1 = numbers[4:13]
    if any((a, b, c)) and not 0 < mode < 64:
        raise InputError(f"CYCLE800 with mode {mode} names angles of rotary axes or projections, which are not "
                         "read; swivel axis by axis (mode 57, 27 or 39)")  # fmt: skip
    turn = Frame()
    for place, angle in enumerate((a, b, c)):
        axis = ((mode >> (2 * place)) & 3) - 1
        if angle and axis < 0:
            raise InputError(f"CYCLE800 with mode {mode} names no axis for one of its angles")
        turn = turn.then(rotate(axis, angle)) if angle else turn
    k = it.state.scale
    step = Frame(origin=(x0 * k, y0 * k, z0 * k)).then(turn).then(Frame(origin=(x1 * k, y1 * k, z1 * k)))
    step = it.find_frame().then(step) if status % 10 == 1 else step
    it.set_frames(shift=step if step.plain else None, plane=None if step.plain else step, program=None)
