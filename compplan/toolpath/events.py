"""Machine functions of a CAM file: spindle, coolant, tool changes, dwells, stops, outputs, comments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.io.tables import Array

#: Events that switch off: they follow all motion at their waypoint.
ENDING = frozenset({"spindle_off", "coolant_off"})
#: Events that do not stop the tool.
PASSING = frozenset({"comment"})


@dataclass(frozen=True)
class Event:
    """Machine function after a waypoint (`place`, -1: before the first move); `describe` lists the kinds.

    The value is a speed [1/min], a time [s], the number of a tool or the state of a signal (0 or 1). The text is a
    comment or the name of a tool, signal or program. Events at one waypoint are executed in their order.
    """

    place: int
    kind: str
    value: float = 0.0
    text: str = ""

    def describe(self) -> str:
        """Return a readable description of the event."""
        speed = f" at {self.value:g} 1/min" if self.value > 0.0 else ""
        return {
            "spindle_cw": f"spindle clockwise{speed}", "spindle_ccw": f"spindle counter-clockwise{speed}",
            "spindle_off": "spindle off", "coolant": "coolant on", "mist": "mist on", "coolant_off": "coolant off",
            "tool": f"tool {self.text or f'T{self.value:g}'}", "dwell": f"wait {self.value:g} s",
            "stop": self.text or "program stop", "optional_stop": "optional stop", "comment": self.text,
            "output": f"signal {self.text} {'on' if self.value else 'off'}", "call": f"source program: {self.text}",
        }[self.kind]  # fmt: skip


def move_events(events: Sequence[Event], places: Array) -> tuple[Event, ...]:
    """Assign the events of a path to the waypoints of a path derived from it.

    An event that switches on is executed when its waypoint is reached, one that switches off when it is left. `places`
    (m,) are the old waypoint numbers of the new waypoints, fractional within a move, non-decreasing.
    """
    if not events:
        return ()
    old = np.array([event.place for event in events], dtype=float)
    reached = np.searchsorted(places, old - 1e-6)
    left = np.searchsorted(places, old + 1e-6, side="right") - 1
    ending = np.array([event.kind in ENDING for event in events])
    new = np.where(old < 0, -1, np.where(ending, np.maximum(left, reached), reached))
    new = np.maximum.accumulate(np.minimum(new, len(places) - 1))
    return tuple(replace(event, place=int(place)) for event, place in zip(events, new.tolist(), strict=True))


def find_halts(events: Sequence[Event]) -> list[int]:
    """Return the waypoints at which the tool stops for an event, without -1."""
    return sorted({event.place for event in events if event.place >= 0 and event.kind not in PASSING})


def insert_spindle_stops(events: Sequence[Event], cut: Array) -> tuple[tuple[Event, ...], int]:
    """Insert a program stop before every cut with a stopped spindle, in files that start the spindle.

    A tool change stops the spindle. Files that never start a spindle are not changed. `cut` (n,) marks cutting moves;
    the move of row i ends at waypoint i. Return the events and the number of inserted stops.
    """
    if not any(event.kind in ("spindle_cw", "spindle_ccw") for event in events):
        return tuple(events), 0
    rows = np.flatnonzero(cut)
    guarded: list[Event] = []
    turning, place, added = False, -1, 0

    def check(until: int) -> None:
        nonlocal turning, added
        first = np.searchsorted(rows, place, side="right")
        if not turning and first < len(rows) and rows[first] <= until:
            text = "the file cuts from here with the spindle stopped: start it"
            guarded.append(Event(int(rows[first]) - 1, "stop", 0.0, text))
            added, turning = added + 1, True  # one stop: the operator starts the spindle

    for event in events:
        check(event.place)
        place = max(place, event.place)
        guarded.append(event)
        if event.kind in ("spindle_cw", "spindle_ccw"):
            turning = True
        elif event.kind in ("spindle_off", "tool"):
            turning = False
    check(len(cut))
    return tuple(guarded), added
