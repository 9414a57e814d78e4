"""Frames of a G-code program: work offsets, shifts of the origin, machine coordinates, probes and home positions."""

from __future__ import annotations

import math

from compplan.toolpath.readers.arcs import Point, combine
from compplan.toolpath.readers.cnc.frames import ProgramFrames
from compplan.toolpath.readers.cnc.path import PathWriter
from compplan.toolpath.readers.cnc.state import AXES, find_offset, name_offset

DECLARED = "moves after the G92 origin is dropped are left out: how it lies to the work offset is not known"
OUTSIDE = "cuts in other work offsets than the part frame's (wcs) are left out"


class Origins:
    """Follow where the program's origin stands, and moves that count from elsewhere.

    Args:
        path: Writer of the moves.
        frames: Frames on top of the origin.

    """

    def __init__(self, path: PathWriter, frames: ProgramFrames) -> None:
        self.path, self.state, self.log, self.error = path, path.state, path.log, path.error
        self.frames, options = frames, path.options
        self.wcs = find_offset(options.wcs) if options.wcs else None
        #: The work offset that the path stands in, and where the origins of those stood that were left [mm].
        self.part_offset = self.wcs or 54.0
        self.bases: dict[float, Point] = {}
        self.used_offsets = {54.0}
        if self.part_offset != 54.0:
            self.path.mute(OUTSIDE)

    def use_offset(self, code: float, values: dict[str, float]) -> None:
        """Put a work offset in force; the first one before any cut is that of the path."""
        state, path = self.state, self.path
        if code in (58.0, 59.0) and self.state.siemens and not values.keys().isdisjoint(AXES):
            raise self.error(f"G{code:g} with coordinates shifts the frame and is not read; post-process without it")
        if code in (54.1, 154.0):
            code = 1000.0 + values.get("P", 0.0)
        elif 110.0 <= code < 130.0:  # Haas: G110 is G154 P1
            code += 1000.0 - 109.0
        before = state.offsets.active
        self.used_offsets.add(code)
        if code == before:
            return
        if path.placement is not None and state.moved:
            raise self.error(f"{name_offset(code)} within a turned or scaled frame is not read; post-process without")
        fresh = self.wcs is None and not state.moved
        if fresh and not state.known:
            state.offsets.active = self.part_offset = code
            return
        step = state.offsets.switch(code)
        if OUTSIDE in path.muted and (code in self.bases or code == self.part_offset):
            state.base = self.bases.get(code, (0.0, 0.0, 0.0))
            path.unmute(OUTSIDE)
        elif step is not None and OUTSIDE not in path.muted:
            state.base = combine(1.0, state.base, 1.0, step)
        elif fresh:
            self.part_offset = code
            path.lose(range(3))
            self.log.forget()
        elif OUTSIDE not in path.muted:
            self.bases[before] = state.base
            self._leave_part_frame(code)

    def _leave_part_frame(self, code: float) -> None:
        """Leave out the moves in another work offset; refuse cuts there unless the part frame is stated."""
        here, there = name_offset(self.part_offset), name_offset(code)
        refusal = (
            f"the file cuts in {here} and in {there}, and how they lie to each other is not known; state which one "
            f'is the part frame with wcs = "{here}" (--wcs "{here}"), or set both with G10 L2 in the file'
        )
        note = f"rapid moves in {there} are left out: how it lies to {here} is not known"
        self.path.mute(OUTSIDE, *(("", "") if self.wcs is not None else (refusal, note)))

    def check_offsets(self) -> None:
        """Refuse a part frame that the file never uses."""
        if self.wcs is not None and self.wcs not in self.used_offsets:
            used = ", ".join(name_offset(code) for code in sorted(self.used_offsets))
            raise self.error(f"wcs is {name_offset(self.wcs)}, which the file does not use; it uses {used}")
        if self.path.left_out and self.wcs is not None:
            self.log.note(f"{OUTSIDE}: {self.path.left_out} of them", self.path.line)

    def set_offset(self, values: dict[str, float]) -> None:
        """Read G10: L2 sets a work offset."""
        state = self.state
        named = {axis: values[AXES[axis]] * state.scale for axis in range(3) if AXES[axis] in values}
        kind = values.get("L", 0.0)
        if kind == 20.0 or (kind == 2.0 and (state.incremental or values.get("R", 0.0) != 0.0)):
            raise self.error("G10 that turns a work offset, or counts from where the tool is, is not read")
        if kind != 2.0:
            self.log.note("G10 offsets are not read", self.path.line)
            return
        number = values.get("P", 0.0)
        if number not in range(16):
            raise self.error(f"G10 L2 P{number:g} names no work offset, expected P0 to P15")
        cutting = state.moved or bool(state.known)
        try:
            moved = state.offsets.set_origin(int(number), named)
        except ValueError:
            if cutting:
                raise self.error("G10 L2 moves the work offset in force, and what it was is not known") from None
            return
        if cutting:
            state.base = combine(1.0, state.base, 1.0, (moved.get(0, 0.0), moved.get(1, 0.0), moved.get(2, 0.0)))

    def go_home(self, code: float, values: dict[str, float]) -> None:
        """Carry out G28 and G30: through the intermediate point to the machine's home, which nobody knows.

        G91 of the same block acts before: G28 G91 Z0 goes home from where the tool is.
        """
        state = self.state
        named = [axis for axis in range(3) if AXES[axis] in values]
        self.log.note(f"G{code:g} goes to the machine's home, whose place is not known: it is left out", self.path.line)
        if named and not (state.incremental and all(values[AXES[axis]] == 0.0 for axis in named)):
            self.path.rapid(state.target(values, range(3)))
        axes = named if named or not values.keys().isdisjoint("ABC") else range(3)
        if 2 in axes:
            self.path.retreat()
        self.path.lose(axes)
        if letters := [letter for letter in "ABC" if letter in values]:
            self.frames.home_rotary(letters)

    def shift(self, code: float, values: dict[str, float]) -> None:
        """Carry out G52 and G92."""
        state = self.state
        coordinates = {axis: values[AXES[axis]] for axis in range(3) if AXES[axis] in values}
        if code == 52.0:
            state.set_shift(coordinates)
            return
        before, lost, cutting = state.position, set(state.lost), state.moved
        state.set_origin(coordinates)
        step = [0.0 if axis in lost else state.position[axis] - before[axis] for axis in range(3)]
        if not cutting:
            self.log.shift((step[0], step[1], step[2]))
        if lost != state.lost or (cutting and state.position != before):
            self.path.rapid(state.position)

    def drop_shift(self, code: float) -> None:
        """Carry out G92.1 and G92.2, which drop what G92 set, and G92.3, which brings back what G92.2 dropped.

        Raises:
            InputError: If an offset from before the program comes back.

        """
        state = self.state
        if code == 92.3:
            if state.kept_origin is None:
                raise self.error("G92.3 brings back an offset from before this program, which is not known; "
                                 "set it with G92 in the file")  # fmt: skip
            state.origin = state.kept_origin
            self.path.unmute(DECLARED)
            return
        state.clear_origin(keep=code == 92.2)
        if state.declared:
            self.log.note(DECLARED, self.path.line)
            refusal = (
                f"a cut after G{code:g}, which drops the origin that G92 set where the tool stood: how it lies to the "
                "work offset is not known; end the cuts before it, or let a move to X Y Z come before G92"
            )
            self.path.mute(DECLARED, refusal)

    def move_in_machine(self, values: dict[str, float]) -> None:
        """Carry out a move in machine coordinates (G53) where the work offset in force is known, else leave it out."""
        state = self.state
        named = [axis for axis in range(3) if AXES[axis] in values]
        places = {axis: state.offsets.from_machine(axis, values[AXES[axis]] * state.scale) for axis in named}
        if not named:
            return
        if any(place is None for place in places.values()) or self.path.placement is not None:
            self.log.note("moves in machine coordinates (G53) are left out", self.path.line)
            if 2 in named:
                self.path.retreat()
            self.path.lose(named)
            return
        if state.motion == 1.0:
            self.path.begin_cut()
        point = [state.base[axis] + (places.get(axis) or 0.0) if axis in places else state.position[axis]
                 for axis in range(3)]  # fmt: skip
        target = (point[0], point[1], point[2])
        cuts = state.motion == 1.0 and self.path.start_cut(target)
        state.settle(named)
        if cuts:
            self.path.cut_line(target, self.path.feed(math.dist(target, state.position)))
        elif state.motion != 1.0:
            self.path.rapid(target)
