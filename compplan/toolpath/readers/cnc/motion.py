"""Motion of CNC programs: straight moves, arcs and helices, poles, corners, and moves with changing tool axis."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import (
    MOST_TURNS,
    Point,
    arc_about,
    build_arc,
    centre_from_radius,
    combine,
    dot,
    normalise,
    orient,
    set_levels,
)
from compplan.toolpath.readers.cnc.contour import Contour, Corner, Element, find_tangent_arc
from compplan.toolpath.readers.cnc.course import Course
from compplan.toolpath.readers.cnc.rotary import Rotary, blend
from compplan.toolpath.readers.cnc.state import AXES, LETTERS, CncBlock, State
from compplan.toolpath.readers.frames import PLANE_AXES, PLANE_NORMALS
from compplan.toolpath.readers.lines import DECIMAL
from compplan.toolpath.readers.options import CHORD_MM, TURN_STEP

NUMBER = rf"({DECIMAL})"
#: Block of a plain straight cut with X Y Z F only, an optional block number and G1: G1 X1.5 Y-2. Z.3 F1000.
PLAIN = re.compile(
    rf"[ \t]*(?:N\d+[ \t]*)?(?:G0?1[ \t]*)?(?:X{NUMBER}[ \t]*)?(?:Y{NUMBER}[ \t]*)?(?:Z{NUMBER}[ \t]*)?"
    rf"(?:F{NUMBER}[ \t]*)?"
)
#: Greatest rotation of the rotary axes in one block: 100 turns (assumed). [deg]
MOST_TURN = 36_000.0
MIDDLES, DIRECTIONS = ("I1", "J1", "K1"), ("A3", "B3", "C3")
TURNING = frozenset((*LETTERS, *DIRECTIONS))
STRAIGHT = frozenset((*AXES, *TURNING))
POLAR, CENTRES = frozenset(("AP", "RP")), frozenset("IJK")
#: Words of corners: by radius, by the length from the corner, by the length of the chamfer.
CORNERS = {"RND": "ROUND", "CHR": "LEG", "CHF": "CHAMFER"}
ROUND = (2.0, 3.0, "CIP", "CT")
#: Limit of lengths without decimal point, beyond which they may be in increments of the control. [mm]
FARTHEST_WITHOUT_POINT = 10_000.0


class MotionReader:
    """Execute the motion of blocks."""

    def __init__(self, it: Any) -> None:
        self.it = it
        self.course: Course = it.course
        self.contour: Contour = it.contour
        self.rotary: Rotary = it.rotary
        self.state: State = it.state
        self.dialect, self.options, self.set_frame = it.dialect, it.options, it.set_frame
        self.keeps_polar = True
        #: Arcs that do not lie on a circle with incremental I J K.
        self.proofs: set[tuple[float, ...]] = set()

    def is_steady(self) -> bool:
        """Return whether a block of X Y Z F only is a straight cut to absolute coordinates."""
        state, course = self.state, self.course
        return bool(
            state.motion == 1.0 and state.feed and state.feed_mode == 94 and course.begun and not course.unknown
            and not (state.incremental or state.polar or state.cycle_code or course.suspended)
            and self.contour.idle
        )  # fmt: skip

    def cut_plain(self, found: re.Match[str]) -> bool:
        """Execute a block of X Y Z F only if `is_steady` holds; return whether it was executed."""
        x, y, z, feed = found.group(1, 2, 3, 4)
        if (x is None and y is None and z is None) or (feed is not None and float(feed) <= 0.0):
            return False
        state, course = self.state, self.course
        old, scale = course.position, state.scale
        point = (
            old[0] if x is None else float(x) * scale,
            old[1] if y is None else float(y) * scale,
            old[2] if z is None else float(z) * scale,
        )
        if max(map(abs, point)) >= FARTHEST_WITHOUT_POINT:
            return False
        if feed is not None:
            state.feed = float(feed) * state.feed_scale
        course.position = point
        if point != old:
            course.last_direction = old, point
        course.log.line(course.frame.apply(point), state.feed / 60.0)  # type: ignore[operator]
        return True

    def feed(self, length: float, block: CncBlock | None = None) -> float:
        """Return the feed of a move of this length [mm] in mm/s; 0 if unknown."""
        if block is not None and "FB" in block.values:
            return self.state.to_mm_s(block.values["FB"])
        if self.state.feed_mode == 93 and block is not None and "F" not in block.values:
            self.course.note("a cutting move with G93 and without F takes the number F of a block before")
        feed = self.state.feed_mm_s(length)
        if feed is None:
            self.course.note("cutting moves before any feed F have none")
        return feed or 0.0

    def target(self, block: CncBlock) -> tuple[Point, tuple[int, ...]]:
        """Return the end point of a block, and the axes of its absolute coordinates."""
        state, values = self.state, block.values
        point, named = state.place(block, self.contour.position)
        if block.has(POLAR):
            plane, pole = state.pole_plane or state.plane, state.pole or (0.0, 0.0, 0.0)
            first, second = PLANE_AXES[plane]
            dx, dy = point[first] - pole[first], point[second] - pole[second]
            now = {"RP": math.hypot(dx, dy) / state.scale, "AP": math.degrees(math.atan2(dy, dx))}
            if not self.keeps_polar:
                state.polar_words.clear()
            for address in ("RP", "AP"):
                if address not in values and address not in state.polar_words:
                    self.course.check_place(PLANE_AXES[plane])
                if address not in values:
                    state.polar_words.setdefault(address, now[address])
                else:
                    base = now[address] if state.is_incremental(block, address) else 0.0
                    state.polar_words[address] = values[address] + base
            radius, angle = state.polar_words["RP"] * state.scale, math.radians(state.polar_words["AP"])
            ends = {first: pole[first] + radius * math.cos(angle), second: pole[second] + radius * math.sin(angle)}
            point, named = set_levels(point, ends), [*named, first, second]
        return point, tuple(named)

    def move(self, block: CncBlock, corner: Corner | None = None) -> None:
        """Execute the motion of a block; `corner` is the corner at its end if another block states it."""
        state, course, contour = self.state, self.course, self.contour
        arc = state.motion in ROUND
        if not arc and not block.has(STRAIGHT) and not block.has(POLAR):
            return
        if state.motion is None:
            raise InputError("coordinates before any motion code: state G0 or G1 before them")
        rapid = state.motion == 0.0
        if not rapid and contour.idle:
            course.begin_cut()
        target, named = self.target(block)
        if arc:
            if block.has(TURNING) and not self.rotary.ignored:
                raise InputError("an arc on which the tool turns is not read; post-process it as straight moves")
            if not course.leave_out(target):
                self._go_round(block, target, corner or self._corner(block))
            return
        if block.has(CENTRES):
            course.note("I J K in straight moves are not read")
        before = dict(self.rotary.angles)
        axis, by_axes = self._turn(block, rapid=rapid) if block.has(TURNING) else (None, False)
        if rapid:
            contour.refuse_open()
            course.rapid(target, named, axis)
            return
        if contour.idle and course.leave_out(target):
            return
        start = contour.position
        feed = self.feed(math.dist(target, start), block)
        element = Element(start, target, feed, None, PLANE_NORMALS[state.plane], axis=axis)
        if by_axes and axis is not None:
            after = dict(self.rotary.angles)
            element = replace(element, run=lambda: self._cut_turning(element, before, after))
        contour.add(element, corner or self._corner(block))

    def _corner(self, block: CncBlock) -> Corner | None:
        """Return the corner at the end of a block, None without any."""
        values, state = block.values, self.state
        feed = state.to_mm_s(values["FRC"]) if values.get("FRC") else None
        for address, kind in CORNERS.items():
            if values.get(address):
                return Corner(kind, values[address] * state.scale, feed, self.course.reader.line)
        return None

    def _turn(self, block: CncBlock, *, rapid: bool) -> tuple[Point | None, bool]:
        """Return the tool axis of A3 B3 C3 or A B C (None: unchanged), and whether rotary axes move to it."""
        values, rotary, state = block.values, self.rotary, self.state
        named = [letter for letter in DIRECTIONS if letter in values]
        if named:
            vector = tuple(values.get(letter, 0.0) for letter in DIRECTIONS)
            if len(named) < 3 or not 1e-3 < math.hypot(*vector) < 1e3:
                raise InputError(f"tool direction is {vector}, expected three numbers that are not all 0")
            return normalise(self.course.frame.turn((vector[0], vector[1], vector[2]))), False
        if rotary.ignored:
            return None, False
        if self.it.tilted and (self.dialect.turns_to_plane or not state.tip_control or "TILT" in block.names):
            if self.dialect.turns_to_plane:
                state.turn(rotary.angles, block)
                return self.dialect.turn_to_plane(), False
            self.course.note("A B C in a tilted plane position the rotary axes as the plane asks: its axis is taken")
            return None, False
        turned = rotary.turned
        state.turn(rotary.angles, block)
        if rotary.spatial:
            return self.dialect.square(), False
        self.set_frame(carried=True)
        if not turned and not rotary.turned:
            return self.dialect.square(), False
        if rotary.unknown:
            return None, False
        if not (rapid or self.it.controls_tip or not self.dialect.tip_word):
            raise InputError(
                f"a cut on which rotary axes turn is read with control of the tip ({self.dialect.tip_word})"
            )
        return rotary.point_tool(), True

    def _cut_turning(self, element: Element, before: dict[str, float], after: dict[str, float]) -> None:
        """Cut to a point with uniform motion of the rotary axes, in pieces that count as one move."""
        course, rotary, log = self.course, self.rotary, self.course.log
        tip = self.it.controls_tip
        start, target, feed = element.start, element.end, element.feed
        pieces = self._count_pieces(target, before, after, tip=tip)
        travel = math.dist(target, start)
        whole = max(abs(after[letter] - before.get(letter, 0.0)) for letter in after)
        if self.state.feed_mode == 93 and self.state.feed:
            seconds = 60.0 / self.state.feed
        else:  # feed along X Y Z, in degrees if they do not move
            seconds = (travel if travel > 0.0 else whole * self.state.scale) / feed if feed > 0.0 else 0.0
        with log.one_move():
            for piece in range(1, pieces + 1):
                share = piece / pieces
                rotary.angles = blend(before, after, share)
                self.set_frame(carried=True)
                point = target if piece == pieces else combine(1.0 - share, start, share, target)
                if not tip and seconds > 0.0:
                    feed = math.dist(course.frame.apply(point), log.position) * pieces / seconds
                course.line(point, feed, rotary.point_tool() if rotary.turned else self.dialect.square())
        rotary.angles = after

    def _count_pieces(self, target: Point, before: dict[str, float], after: dict[str, float], *, tip: bool) -> int:
        """Return the number of pieces of a motion of rotary axes that limits the errors of tool axis and tip."""
        turn = max((abs(angle - before.get(letter, 0.0)) for letter, angle in after.items()), default=0.0)
        if turn > MOST_TURN:
            raise InputError(f"rotary axes turn by {turn:g} deg in one block, at most {MOST_TURN:g} are read")
        step = TURN_STEP
        if tip:
            if len({self.rotary.point_tool(blend(before, after, share)) for share in (0.0, 0.37, 0.71, 1.0)}) == 1:
                return 1
        elif self.rotary.axes[1]:
            x, y, z = self.options.axes.rotary_centre_mm or (0.0, 0.0, 0.0)
            radius = math.dist(target, (x, y, z))
            step = min(step, math.degrees(2.0 * math.acos(max(1.0 - CHORD_MM / max(radius, CHORD_MM), 0.0))))
        return max(1, math.ceil(turn / step - 1e-9))

    def find_direction(self, word: str = "") -> Point:
        """Return the direction at the end of the contour so far, in program coordinates."""
        if self.contour.held is not None:
            return self.contour.held[0].tangent(self.contour.held[0].end)
        if self.course.last_direction is None or self.contour.approach is not None:
            raise InputError(f"this block continues a contour tangentially, but no cutting move is before it{word}")
        return normalise(combine(1.0, self.course.last_direction[1], -1.0, self.course.last_direction[0]))

    def _go_round(self, block: CncBlock, target: Point, corner: Corner | None) -> None:
        """Cut along an arc: G2 clockwise, G3 counter-clockwise about the normal of the plane."""
        state, values, start = self.state, block.values, self.contour.position
        about_pole = "CC" in block.names or (block.has(POLAR) and not block.has(CENTRES))
        plane = (state.pole_plane or state.plane) if about_pole else state.plane
        normal = orient(PLANE_NORMALS[plane], right_hand=state.motion == 3.0)
        if state.motion == "CIP":
            if block.values.keys().isdisjoint(MIDDLES):
                raise InputError("CIP has no intermediate point, expected I1= J1= K1=")
            arc = build_arc(start, state.place(block, start, MIDDLES)[0], target)
            centre, normal = arc.centre, arc.normal
        elif state.motion == "CT":
            if abs(dot(combine(1.0, target, -1.0, start), normal)) > 1e-9:
                raise InputError("CT that leaves its plane is not read")
            found = find_tangent_arc(start, self.find_direction(" (CT)"), target, normal)
            if found is None:
                feed = self.feed(math.dist(start, target), block)
                self.contour.add(Element(start, target, feed, normal=normal), corner)
                return
            centre, normal = found
        elif "CR" in values:
            radius = values["CR"] * state.scale
            centre = centre_from_radius(start, target, normal, radius)
        elif any("IJK"[axis] in values for axis in PLANE_AXES[plane]):
            centre = state.centre(start, block, plane)
            offsets = tuple(values.get(letter, 0.0) for letter in "IJK")
            usual = combine(1.0, start, state.scale, (offsets[0], offsets[1], offsets[2]))
            if state.centres != "incremental" and not arc_about(start, target, usual, normal).fits_circle:
                ends = [place[axis] for place in (start, target) for axis in PLANE_AXES[plane]]
                self.proofs.add((*(round(number, 3) for number in ends), *offsets))
        elif about_pole and state.pole is not None:
            centre = set_levels(start, {axis: state.pole[axis] for axis in PLANE_AXES[plane]})
        else:
            names = " ".join("IJK"[axis] for axis in sorted(PLANE_AXES[plane]))
            raise InputError(f"arc has neither a centre ({names}) nor a radius (R); give it one")
        turns = values.get("TURN", 0.0)
        if not 0.0 <= turns < MOST_TURNS or turns != int(turns):
            raise InputError(f"arc of {turns:g} further turns, expected a whole number less than {MOST_TURNS}")
        count = int(turns) + 1
        way = arc_about(start, target, centre, normal, count).length
        feed = self.feed(way, block)
        self.contour.add(Element(start, target, feed, centre, normal, count), corner)
