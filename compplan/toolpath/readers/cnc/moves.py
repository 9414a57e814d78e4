"""Moves of a CNC program: straight ones, arcs, corners, and those on which rotary axes turn."""

from __future__ import annotations

import math
import re

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import (
    Arc,
    Point,
    arc_about,
    centre_from_radius,
    combine,
    fits_circle,
)
from compplan.toolpath.readers.cnc.cycles import run_cycle
from compplan.toolpath.readers.cnc.frames import ProgramFrames
from compplan.toolpath.readers.cnc.path import PathWriter
from compplan.toolpath.readers.cnc.state import FARTHEST_WITHOUT_POINT, PLANE_AXES, PLANE_NORMALS
from compplan.toolpath.readers.cnc.words import CORNER_WORDS
from compplan.toolpath.readers.contour import Corner, Element, join_corner
from compplan.toolpath.readers.course import cut_turning
from compplan.toolpath.readers.plain import read_place

#: Greatest turn of the rotary axes between waypoints. [deg]
TURN_STEP = 1.0
#: Greatest number of turns of one helix.
MOST_TURNS = 10_000
#: Words that turn the tool: rotary axes, and its direction (Siemens).
ROTARY = (*"ABC", "A3", "B3", "C3")
#: Words that make a straight move.
STRAIGHT = frozenset(("X", "Y", "Z", *ROTARY))
CORNERS = frozenset(CORNER_WORDS.values())
TRAVEL = "moves of a printer after homing are travel until X Y Z are known: the path begins where they are"


class OffCircleError(InputError):
    """Tell that start and end of an arc do not lie on one circle, in one reading of I J K."""


class MotionBlock:
    """Carry out the motion of blocks.

    Args:
        path: Writer of the moves.
        frames: Frames and rotary axes in force.

    """

    def __init__(self, path: PathWriter, frames: ProgramFrames) -> None:
        self.path, self.state, self.log, self.options, self.error = path, path.state, path.log, path.options, path.error
        self.frames = frames
        #: A straight move that a corner ends, until the move after it is known.
        self.corner: tuple[Element, Corner] | None = None
        self.proofs: set[tuple[float, ...]] = set()

    def is_steady(self) -> bool:
        """Tell whether a block of X Y Z F alone cuts straight to where its numbers say, and nothing else."""
        state, path = self.state, self.path
        return bool(
            state.motion == 1.0 and state.moved and state.feed and state.feed_mode == 94
            and not (state.incremental or state.polar or state.cycle_code or state.lost or self.corner)
            and not self.frames.layers and len(state.known) == 3 and path.placement is None and not path.muted
            and not path.needs_start()
        )  # fmt: skip

    def cut_plain(self, found: re.Match[str]) -> bool:
        """Carry out a block of X Y Z F alone where the program is steady; return whether it was read."""
        state, feed = self.state, found.group(4)
        point = read_place(found, state.position, state.scale, (state.zero(0), state.zero(1), state.zero(2)))
        if point is None or (feed is not None and float(feed) <= 0.0) or max(map(abs, point)) >= FARTHEST_WITHOUT_POINT:
            return False
        if feed is not None:
            state.set_feed(float(feed))
        state.position = point
        assert state.feed is not None
        self.log.line(point, state.feed / 60.0)
        return True

    def move(self, values: dict[str, float]) -> None:
        """Carry out the motion of a block."""
        state = self.state
        words = values.keys()
        if not words.isdisjoint("UVWE"):
            self._check_axes(values)
        if state.polar and not words.isdisjoint("XY"):
            values = self._read_polar(values)
        if state.cycle_code:
            self.frames.check_plane()
            run_cycle(state.cycle_code, values, self.path, self.options.cycles == "expand")
            return
        if "L" in values and values["L"] != 1.0:
            raise self.error(f"L{values['L']:g} repeats a move or counts turns of an arc and is not read; write the "
                             "moves out, turns of an arc as P")  # fmt: skip
        if self.state.cancels_length and "Z" in values:
            self._leave_upwards(values)
            return
        corner = None if words.isdisjoint(CORNERS) else next(kind for kind in CORNERS if kind in values)
        if (corner or self.corner) and state.motion != 1.0:
            raise self.error("a corner is rounded or cut between two straight moves (G1) only; post-process without it")
        if state.motion in (2.0, 3.0):
            self._arc(values)
            return
        if not words.isdisjoint("IJKR"):
            self._check_straight(values)
        if words.isdisjoint(STRAIGHT):
            return
        if state.motion == 1.0:
            self._cut(values, (corner, values[corner] * state.scale) if corner else None)
        elif state.motion is None:
            raise self.error("coordinates before any motion code (G0 or G1): whether they cut is not known; state it")
        else:
            target = state.target(values, range(3))
            axis = None if words.isdisjoint(ROTARY) else self._turn(values)[0]
            self.path.rapid(target, axis)

    def _check_axes(self, values: dict[str, float]) -> None:
        """Refuse axes beside X Y Z that move tool or part; note a printer's extruder."""
        for letter in "UVW":
            if letter in values:
                raise self.error(f"axis {letter}{values[letter]:g} moves the tool or the part and is not read")
        if "E" in values:
            self.log.note("axis E is not read", self.path.line)

    def _leave_upwards(self, values: dict[str, float]) -> None:
        """Leave out Z of a block that cancels the tool's length (H0, G49): it is no place of the tip in the part."""
        if self.state.motion != 0.0:
            raise self.error("a cut to Z with the tool's length cancelled (H0, G49): the tip's place is not known")
        self.log.note("Z of a block that cancels the tool's length (H0, G49) is left out: it is no place in the part",
                      self.path.line)  # fmt: skip
        self.path.retreat()
        self.path.lose([2])
        self.path.rapid(self.state.target(values, range(2)))

    def _read_polar(self, values: dict[str, float]) -> dict[str, float]:
        """Return X (radius) and Y (angle) of polar coordinates as X and Y."""
        state = self.state
        if (state.incremental and "X" in values) or state.plane != 17:
            raise self.error("polar coordinates (G16) with a radius in G91, or outside of the plane G17, are not read")
        turned = state.polar_word[1] if state.incremental else 0.0
        named = turned + values["Y"] if "Y" in values else state.polar_word[1]
        state.polar_word = [values.get("X", state.polar_word[0]), named]
        radius, angle = state.polar_word[0], math.radians(state.polar_word[1])
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        if state.incremental:  # the radius stays, and with it the pole
            x -= (state.position[0] - state.zero(0)) / state.scale
            y -= (state.position[1] - state.zero(1)) / state.scale
        return {**values, "X": x, "Y": y}

    def _check_straight(self, values: dict[str, float]) -> None:
        """Refuse or note words of an arc in a straight move."""
        if values.get("R", 0.0) != 0.0:
            raise self.error(f"R{values['R']:g} in a straight move is not read; a rounded corner is written ,R")
        if not values.keys().isdisjoint("IJK"):
            self.log.note("I J K in straight moves are not read", self.path.line)

    def _cut(self, values: dict[str, float], corner: tuple[str, float] | None) -> None:
        """Cut straight."""
        state, path = self.state, self.path
        if self.state.printer and path.is_start_unknown() and ("E" not in values or not self.log.waypoints):
            self.log.note(TRAVEL, self.path.line)
            path.rapid(state.target(values, range(3)))
            return
        path.begin_cut()
        start = state.position
        target = state.target(values, range(3))
        axis, before = None, None
        if not values.keys().isdisjoint(ROTARY):
            axis, before = self._turn(values)
        if not path.start_cut(target):
            return
        if self.frames.layers:
            self.frames.check_plane()
        if corner or self.corner:
            self._cut_corner(start, target, path.feed(math.dist(target, start)), corner, axis)
        elif before is not None and axis is not None:
            self._cut_turning(start, target, before)
        elif axis is not None and "A3" in values:
            state.position = target
            cut_turning(self.log, path.map(start), path.map(target), path.feed(math.dist(target, start)), axis)
        else:
            path.cut_line(target, path.feed(math.dist(target, start)), axis)

    def _cut_corner(
        self, start: Point, target: Point, feed: float, asked: tuple[str, float] | None, axis: Point | None
    ) -> None:
        """Cut a straight move that a rounded or cut corner begins, ends, or both."""
        if axis is not None:
            raise self.error("a rounded or cut corner while rotary axes turn is not read")
        path, before = self.path, self.corner
        element = Element(start, target, (), feed, path.line)
        if before is not None:
            try:
                first, joint, element = join_corner(*before, element, " mm")
            except ValueError as fault:
                raise self.error(f"{fault}, in the block of line {before[0].line}") from None
            path.cut_line(first.end, first.feed)
            if joint is not None and joint.centre is not None:
                arc = arc_about(joint.start, joint.end, joint.centre, joint.normal, right_hand=joint.right_hand)
                path.cut_arc(arc, joint.end, feed)
            elif joint is not None:
                path.cut_line(joint.end, feed)
        self.corner = (element, Corner(*asked, None, path.line)) if asked else None
        if asked is None:
            path.cut_line(target, feed)
        self.state.position = target

    def _cut_turning(self, start: Point, target: Point, before: dict[str, float]) -> None:
        """Cut to a point while the rotary axes turn evenly: one move, in pieces."""
        state, path = self.state, self.path
        after = dict(state.rotary)
        pieces = self._count_pieces(target, before, after)
        travel, tip = math.dist(target, start), state.tip_control or self.options.tip_control
        feed = path.feed(travel)
        whole = max(abs(after[letter] - before.get(letter, 0.0)) for letter in after) if after else 0.0
        if state.feed_mode == 93 and state.feed:
            seconds = 60.0 / state.feed
        else:  # a feed counts along X Y Z, in degrees where they stand still
            seconds = (travel if travel > 0.0 else whole * state.scale) / feed if feed > 0.0 else 0.0
        counts, lines = dict(self.log.counts), self.log
        for piece in range(1, pieces + 1):
            share = piece / pieces
            state.rotary = {
                letter: before.get(letter, 0.0) * (1.0 - share) + angle * share for letter, angle in after.items()
            }
            self.frames.place_rotary(keep=False)
            point = target if piece == pieces else combine(1.0 - share, start, share, target)
            if not tip and seconds > 0.0:
                feed = math.dist(path.map(point), lines.position) * pieces / seconds
            path.cut_line(point, feed, self.frames.rotary_axis())
        state.rotary = after
        lines.count_one(counts)

    def _count_pieces(self, target: Point, before: dict[str, float], after: dict[str, float]) -> int:
        """Return in how many pieces rotary axes turn, so that tool axis and tip keep to their way."""
        turn = max((abs(angle - before.get(letter, 0.0)) for letter, angle in after.items()), default=0.0)
        step = TURN_STEP
        if self.state.tip_control or self.options.tip_control:
            machine, shares = self.frames.machine, (0.0, 0.37, 0.71, 1.0)
            ways = [{n: before.get(n, 0.0) * (1 - s) + a * s for n, a in after.items()} for s in shares]
            if machine is None or len({machine.point_tool(way) for way in ways}) == 1:
                return 1
        elif self.frames.machine is not None and self.frames.machine.table:
            radius = math.dist(target, self.frames.machine.centre or (0.0, 0.0, 0.0))
            chord = self.options.chord_tolerance_mm
            step = min(step, math.degrees(2.0 * math.acos(max(1.0 - chord / max(radius, chord), 0.0))))
        return max(1, math.ceil(turn / step - 1e-9))

    def _turn(self, values: dict[str, float]) -> tuple[Point | None, dict[str, float] | None]:
        """Return the tool axis that A B C or A3 B3 C3 ask for, and the angles before where A B C turn."""
        named = [letter for letter in ("A3", "B3", "C3") if letter in values]
        if named:
            axis = tuple(values.get(letter, 0.0) for letter in ("A3", "B3", "C3"))
            length = math.hypot(*axis)
            if len(named) < 3 or not 1e-3 < length < 1e3:
                raise self.error(f"tool direction A3 B3 C3 is {axis}, expected three numbers that are not all 0")
            unit = (axis[0] / length, axis[1] / length, axis[2] / length)
            return unit if self.path.placement is None else self.path.placement.turn(unit), None
        if self.options.rotary == "ignore":
            return None, None
        before = self.frames.turn_rotary(values)
        return self.frames.rotary_axis(), before

    def _arc(self, values: dict[str, float]) -> None:
        """Cut along an arc: G2 clockwise, G3 counter-clockwise, seen from the positive end of the plane's normal."""
        state, path = self.state, self.path
        if not values.keys().isdisjoint(ROTARY) and self.options.rotary != "ignore":
            raise self.error("an arc on which rotary axes turn is not read; post-process it as straight moves")
        path.begin_cut()
        start, target = state.position, state.target(values, range(3))
        if path.muted:
            path.start_cut(target)
            return
        if self.frames.layers:
            self.frames.check_plane()
        arc = self._find_arc(start, target, values)
        if "R" not in values and state.centres != "incremental":
            self._prove(start, target, values, right_hand=state.motion == 3.0)
        path.cut_arc(arc, target, path.feed(arc.length))

    def _find_arc(self, start: Point, target: Point, values: dict[str, float]) -> Arc:
        """Return the arc of a block.

        Raises:
            OffCircleError: If its ends do not lie on one circle, as I J K count.

        """
        state, right_hand = self.state, self.state.motion == 3.0
        normal, plane = PLANE_NORMALS[state.plane], PLANE_AXES[state.plane]
        if "R" in values:
            radius = values["R"] * state.scale
            found = centre_from_radius(start, target, normal, radius, right_hand=right_hand)
            if found is None:
                chord = math.dist([start[axis] for axis in plane], [target[axis] for axis in plane])
                message = f"arc of radius R {radius:g} mm cannot join ends that are {chord:g} mm apart"
                raise self.error(f"{message}, expected 0 < distance <= {2 * abs(radius):g} mm")
            centre = found
        elif any(("I", "J", "K")[axis] in values for axis in plane):
            centre = state.centre(start, values, plane)
        else:
            names = " ".join(("I", "J", "K")[axis] for axis in plane)
            raise self.error(f"arc has neither a centre ({names}) nor a radius (R)")
        turns = values.get("P", 1.0)
        if turns == 0.0:
            self.log.note("arc of P0 turns is read as a single arc", self.path.line)
        elif not 1.0 <= turns <= MOST_TURNS or turns != int(turns):
            raise self.error(f"arc of P{turns:g} turns, expected a whole number from 1 to {MOST_TURNS}")
        arc = arc_about(start, target, centre, normal, right_hand=right_hand, turns=max(1, int(turns)))
        if not fits_circle(arc.radius, arc.end_radius):
            message = f"arc starts {arc.radius:.4f} mm from its centre and ends {arc.end_radius:.4f} mm from it"
            hint = "expected the same radius; I J K may count otherwise (option arc_centres)"
            raise OffCircleError(f"{message}, {hint}", file=self.path.flow.file, where=self.path.line)
        return arc

    def _prove(self, start: Point, target: Point, values: dict[str, float], *, right_hand: bool) -> None:
        """Keep an arc that lies on no circle where its I J K count as usual."""
        state, plane = self.state, PLANE_AXES[self.state.plane]
        usual = combine(1.0, start, state.scale, tuple(values.get(letter, 0.0) for letter in "IJK"))  # type: ignore
        arc = arc_about(start, target, usual, PLANE_NORMALS[state.plane], right_hand=right_hand)
        if not fits_circle(arc.radius, arc.end_radius):
            ends = [place[axis] for place in (start, target) for axis in plane]
            self.proofs.add((*(round(number, 3) for number in ends), *(values.get(letter, 0.0) for letter in "IJK")))
