"""Put the moves of a G-code program down in the part frame; what happens where nobody knows stays out."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from compplan.errors import InputError
from compplan.toolpath.readers.arcs import Arc, Point
from compplan.toolpath.readers.frames import Frame
from compplan.toolpath.readers.gcode_state import State
from compplan.toolpath.readers.moves import MoveLog

HOME = "the tool comes from the machine's home or another frame: its moves are left out until X Y Z are said"


class PathWriter:
    """Write moves down.

    Points are those of the work offset in force; `placement` says where they stand in the part frame.

    Args:
        log: Log of the moves, in the part frame.
        state: State of the program; its position follows the moves.
        fail: Makes an error at the line that is read.

    """

    def __init__(self, log: MoveLog, state: State, fail: Callable[[str], InputError]) -> None:
        self.log, self.state, self.fail = log, state, fail
        self.placement: Frame | None = None
        #: Line of the block that is read.
        self.line = 0
        #: Why moves are left out, and what to say where one of them cuts ("": nothing).
        self.muted: dict[str, str] = {}
        #: Greatest height of a rapid move under the placement in force [mm].
        self.height: float | None = None
        self.left_out = 0
        self._broken = False

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
                state.lose(range(3))
                self._broken = True
            else:
                place = self.map(state.position)
                state.position = place if placement is None else placement.undo(place)
        self.placement, self.height = placement, None

    def mute(self, reason: str, refusal: str = "") -> None:
        """Leave moves out from here on; a cut among them is refused if there is a sentence for it."""
        self.muted[reason] = refusal

    def unmute(self, reason: str) -> None:
        """Let moves in again, from a place that nobody knows."""
        if self.muted.pop(reason, None) is not None:
            self.lose(range(3))

    def lose(self, axes: Iterable[int]) -> None:
        """Take axes to a place that nobody knows."""
        self.state.lose(axes)
        self._broken = True

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

    def note_start(self) -> None:
        """Note where the first cut starts, before its block says where it ends."""
        if not (self.muted or self.state.lost or self._broken):
            self.state.note_start(self.log, self.line)

    def start_cut(self, target: Point) -> bool:
        """Prepare a cut from where the tool is; return whether it can be put down.

        Raises:
            InputError: If it would cut where nobody knows.

        """
        state = self.state
        if self.muted:
            if refusal := next(filter(None, self.muted.values()), ""):
                raise self.fail(refusal)
            self.left_out += 1
            state.position = target
            return False
        return self._start_from_home(target) if state.lost or self._broken else True

    def _start_from_home(self, target: Point) -> bool:
        """Prepare a cut that starts where nobody knows; its end may be known."""
        state = self.state
        if state.lost or (not state.moved and len(state.known) < 3):
            if state.turning and 2 not in state.lost:
                raise self.fail("a cut begins where X or Y are not known: at the machine's home, or in another frame; "
                                "let a rapid move (G0) come first")  # fmt: skip
            self.log.note(HOME, self.line)
            state.position = target
            return False
        if self.height is None and state.turning:
            raise self.fail("a cut begins at the machine's home, whose place in the part is not known; "
                            "let a rapid move (G0) above the part come first")  # fmt: skip
        height = target[2] if self.height is None else max(self.height, target[2])
        self.rapid((target[0], target[1], height))
        state.moved = True
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
                raise self.fail("an arc under a scale that differs between axes would be an ellipse and is not read")
            arc = placed
        self.log.arc(arc, self.map(end), feed)
