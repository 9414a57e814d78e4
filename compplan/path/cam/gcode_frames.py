"""Frames of a G-code program: work offsets, shifts of the origin, machine coordinates, probes and home positions."""

from __future__ import annotations

import math

from compplan.path.cam.arcs import Point, combine
from compplan.path.cam.gcode_codes import NOTED, OFFSETS, PROBES
from compplan.path.cam.gcode_state import AXES
from compplan.path.cam.gcode_text import TextReader


class FrameReader(TextReader):
    """Follow where the program's origin stands, and moves that count from elsewhere."""

    def _use_offset(self, code: float, values: dict[str, float]) -> None:
        """Put a work offset in force; the first one before any coordinate is that of the path."""
        state = self.state
        if code in (58.0, 59.0) and self.siemens and not values.keys().isdisjoint(AXES):
            raise self.error(f"G{code:g} with coordinates shifts the frame and is not read; post-process without it")
        if code in (54.1, 154.0):
            code = 1000.0 + values.get("P", 0.0)
        if not state.moved and not state.known:
            state.offsets.active = code
            return
        step, note = state.offsets.switch(code)
        state.base = combine(1.0, state.base, 1.0, step)
        if note:
            self.log.note(note, self.line)

    def _set_offset(self, values: dict[str, float]) -> None:
        """Read G10: L2 sets a work offset."""
        state = self.state
        named = {axis: values[AXES[axis]] * state.scale for axis in range(3) if AXES[axis] in values}
        kind = values.get("L", 0.0)
        if kind == 20.0 or (kind == 2.0 and (state.incremental or values.get("R", 0.0) != 0.0)):
            raise self.error("G10 that turns a work offset, or counts from where the tool is, is not read")
        if kind != 2.0:
            self.log.note(NOTED[10.0], self.line)
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

    def _run_once(self, code: float, values: dict[str, float]) -> str:
        """Carry out a code that takes the coordinates of its block for itself."""
        state, named = self.state, [axis for axis in range(3) if AXES[axis] in values]
        if code in (92.0, 52.0):
            self._offset(code, {axis: values[AXES[axis]] for axis in named})
        elif code in OFFSETS:
            state.clear_origin()
        elif code == 10.0:
            self._set_offset(values)
        elif code in (28.0, 30.0):
            self.log.note(f"G{code:g} (home) is left out but for its intermediate point", self.line)
            if named and not state.incremental:
                self._rapid(state.target(values, range(3)))
        elif code in (53.0, 153.0):
            return "machine"
        elif code in PROBES:
            self.log.note(f"G{code:g} (probing) is left out; where it ended is not known", self.line)
            state.lost.update(named)
        return "once"

    def _offset(self, code: float, coordinates: dict[int, float]) -> None:
        """Carry out G52 and G92."""
        state = self.state
        if code == 52.0:
            state.set_shift(coordinates)
            return
        before, cutting = state.position, state.moved
        state.set_origin(coordinates)
        if not cutting:
            self.log.shift(combine(1.0, state.position, -1.0, before))
        elif state.position != before:
            self.log.rapid(state.position)

    def _move_in_machine(self, values: dict[str, float]) -> None:
        """Carry out a move in machine coordinates (G53) where the work offset in force is known, else leave it out."""
        state = self.state
        named = [axis for axis in range(3) if AXES[axis] in values]
        places = {axis: state.offsets.from_machine(axis, values[AXES[axis]] * state.scale) for axis in named}
        if not named:
            return
        if any(place is None for place in places.values()):
            self.log.note("moves in machine coordinates (G53) are left out", self.line)
            return
        point = [state.base[axis] + (places.get(axis) or 0.0) if axis in places else state.position[axis]
                 for axis in range(3)]  # fmt: skip
        target = (point[0], point[1], point[2])
        if state.motion == 1.0:
            state.note_start(self.log, self.line)
        state.known.update(named)
        if state.motion == 1.0:
            self.log.line(target, self._feed(math.dist(target, self.log.position)))
            state.position = target
        else:
            self._rapid(target)

    def _rapid(self, target: Point, axis: Point | None = None) -> None:
        state = self.state
        state.position = target
        if state.knows_position():
            self.log.rapid(target, axis)
        else:
            self.log.counts["rapid_moves"] += 1
            self.log.place(target, axis)

    def _feed(self, length: float) -> float:
        """Return the feed of a move of this length [mm] in mm/s; 0 where no feed is known."""
        feed = self.state.feed_mm_s(length)
        if feed is None:
            self.log.note("cutting moves before any feed F have none", self.line)
            return 0.0
        return feed
