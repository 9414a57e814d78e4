"""Put the moves of a G-code program down in the part frame; what happens where nobody knows stays out."""

from __future__ import annotations

from collections.abc import Iterable

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Arc, Point
from compplan.toolpath.readers.cnc.flow import Flow
from compplan.toolpath.readers.cnc.state import State
from compplan.toolpath.readers.frames import Frame
from compplan.toolpath.readers.moves import MoveLog
from compplan.toolpath.readers.options import CamTable
from compplan.toolpath.readers.start import find_start


class PathWriter:
    """Write moves down.

    Points are those of the work offset in force; `placement` says where they stand in the part frame.

    Args:
        flow: Knows at which line the program is.
        state: State of the program; its position follows the moves.
        options: What the program does not say by itself.

    """

    def __init__(self, flow: Flow, state: State, options: CamTable) -> None:
        self.flow, self.state, self.options, self.error = flow, state, options, flow.error
        #: Log of the moves, in the part frame.
        self.log = MoveLog(options.chord_tolerance_mm, flow)
        self.placement: Frame | None = None
        #: Why moves are left out, and what to say where one of them cuts ("": nothing).
        self.muted: dict[str, str] = {}
        #: Greatest height of a rapid move under the placement in force [mm].
        self.height: float | None = None
        self.left_out = 0
        #: What is noted of rapid moves that are left out, by reason.
        self.left_notes: dict[str, str] = {}
        #: Why the place of the tool is not known.
        self.reason = ""
        self._broken = False

    @property
    def line(self) -> int:
        """Line of the block that is read."""
        return self.flow.line

    def feed(self, length: float) -> float:
        """Return the feed of a move of this length [mm] in mm/s; 0 where no feed is known."""
        feed = self.state.feed_mm_s(length)
        if feed is None:
            self.log.note("cutting moves before any feed F have none", self.line)
            return 0.0
        return feed

    def map(self, point: Point) -> Point:
        """Return where a point stands in the part frame [mm]."""
        return point if self.placement is None else self.placement.apply(point)

    def replace(self, placement: Frame | None, *, keep: bool = True) -> None:
        """Put another placement in force.

        Args:
            placement: The placement.
            keep: Whether the tool stays where it is in the part (a new frame), not on its coordinates (rotary axes).

        """
        state, before = self.state, self.placement
        if placement == before:
            return
        if keep:
            if state.lost or len(state.known) < 3:
                self.lose(range(3), "after a change of the frame")
            else:
                place = self.map(state.position)
                state.position = place if placement is None else placement.undo(place)
        self.placement, self.height = placement, None

    def mute(self, reason: str, refusal: str = "", note: str = "") -> None:
        """Leave moves out from here on; refuse a cut among them and note a rapid one where there is a text for it."""
        self.muted[reason] = refusal
        self.left_notes[reason] = note

    def unmute(self, reason: str) -> None:
        """Let moves in again, from a place that nobody knows."""
        if self.muted.pop(reason, None) is not None:
            self.lose(range(3), "after a change of the frame")

    def lose(self, axes: Iterable[int], reason: str = "after a move of the machine's axes") -> None:
        """Take axes to a place that nobody knows."""
        axes = list(axes)
        self.state.lose(axes)
        self._broken = self._broken or bool(axes)
        self.reason = reason

    def retreat(self) -> None:
        """Go straight up to the greatest height of a rapid so far: on the way to the machine's home."""
        state = self.state
        if self.muted or self.height is None or not state.knows_position() or not self.log.waypoints:
            return
        if state.position[2] < self.height:
            state.position = (*state.position[:2], self.height)
            self.log.note(f"the way home begins straight up to Z{self.height:g}, the highest rapid so far", self.line)
            self.log.rapid(self.map(state.position))

    def rapid(self, target: Point, axis: Point | None = None) -> None:
        """Move rapidly."""
        state, log = self.state, self.log
        before, state.position = state.position, target
        if self.muted:
            for note in filter(None, map(self.left_notes.get, self.muted)):
                log.note(note, self.line)
            return
        if not state.knows_position():
            log.counts["rapid_moves"] += 1
            if not log.waypoints:
                log.place(self.map(target), axis)
            elif axis is not None:
                log.axis = axis
            return
        if self._broken:
            self._come_back(before, axis)
        self.height = target[2] if self.height is None else max(self.height, target[2])
        log.rapid(self.map(target), axis)

    def _come_back(self, before: Point, axis: Point | None) -> None:
        """Go sideways above a point before going down to it, where the tool comes from the machine's home."""
        self._broken = False
        target = self.state.position
        if self.log.waypoints and self.height is not None and axis in (None, self.log.axis):
            self.log.rapid(self.map((target[0], target[1], max(self.height, target[2], before[2]))))

    def needs_start(self) -> bool:
        """Return whether nobody knows where the tool is, for a reason that the file gives."""
        return not self.muted and (bool(self.state.lost) or self._broken)

    def begin_cut(self) -> None:
        """Let a cut begin where the tool is, before its block says where it ends.

        Raises:
            InputError: If that is not known, and the user states no place.

        """
        if self.muted:
            return
        state = self.state
        unknown = state.list_unknown()
        if unknown:
            stated = self.options.from_mm
            if stated is None and not (state.lost or self._broken):
                names = " ".join("XYZ"[axis] for axis in unknown)
                self.log.note(f"the first cut starts at no stated {names}: 0 is assumed (or state --from)", self.line)
                stated = [0.0, 0.0, 0.0]
            elif stated is not None and self.placement is not None:
                stated = list(self.placement.undo((stated[0], stated[1], stated[2])))
            try:
                start = find_start(state.position, unknown, stated, self.reason if state.lost or self._broken else "")
            except InputError as fault:
                raise self.error(fault.message) from None
            state.settle(unknown)
            if self.log.waypoints:
                self.rapid(start)
            else:
                state.position, self.height, self._broken = start, start[2], False
                self.log.place(self.map(start))
        state.moved = True

    def check_place(self, axes: Iterable[int]) -> None:
        """Refuse a hole while a coordinate of the tool that its block does not state is not known."""
        unknown = set(axes).intersection(self.state.list_unknown())
        if unknown and not self.muted:
            try:
                find_start(self.state.position, unknown, None, self.reason)
            except InputError as fault:
                raise self.error(fault.message) from None

    def is_start_unknown(self) -> bool:
        """Return whether a cut from here would begin at an unknown place."""
        return not self.muted and bool(self.state.list_unknown())

    def start_cut(self, target: Point) -> bool:
        """Prepare a cut after `begin_cut`; return whether it can be put down.

        Raises:
            InputError: If it would cut where nobody knows.

        """
        if self.muted:
            if refusal := next(filter(None, self.muted.values()), ""):
                raise self.error(refusal)
            self.left_out += 1
            self.state.position = target
            return False
        if self.needs_start():
            raise self.error("a cut begins where the tool is not known: rotary axes or a change of the frame moved it; "
                            "let a rapid move (G0) to X Y Z come first")  # fmt: skip
        return True

    def cut_line(self, target: Point, feed: float, axis: Point | None = None) -> None:
        """Cut straight with a feed in mm/s, after `start_cut`."""
        self.state.position = target
        self.log.line(self.map(target), feed, axis)

    def cut_arc(self, arc: Arc, end: Point, feed: float) -> None:
        """Cut along an arc with a feed in mm/s, after `start_cut`."""
        self.state.position = end
        if self.placement is not None:
            placed = self.placement.place_arc(arc)
            if placed is None:
                raise self.error("an arc under a scale that differs between axes would be an ellipse and is not read")
            arc = placed
        self.log.arc(arc, self.map(end), feed)
