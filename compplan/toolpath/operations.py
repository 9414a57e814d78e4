"""Operations of a CAM file: the cuts between two tool changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compplan.errors import InputError
from compplan.toolpath.events import Event
from compplan.toolpath.toolpath import Toolpath, select_waypoints


@dataclass(frozen=True)
class Operation:
    """Section of a file that one tool cuts; the tool change is the first event of its toolpath.

    `number` is the T number, 0 before the first tool call or for a tool called by `name` (otherwise "").
    """

    number: int
    name: str
    toolpath: Toolpath

    @property
    def tool(self) -> str:
        """Tool of the operation, by its T number (T3) or name."""
        return repr(self.name) if self.name else f"T{self.number}"


def split_operations(toolpath: Toolpath) -> tuple[Operation, ...]:
    """Divide a toolpath at its tool changes; consecutive sections of one tool are joined, sections without cut dropped.

    A path of one tool is returned unchanged.
    """
    changes = [k for k, event in enumerate(toolpath.events) if event.kind == "tool"]
    cuts = np.flatnonzero(~toolpath.rapid[1:]) + 1
    edges = [0, *changes, len(toolpath.events)]
    rows = [-1, *[toolpath.events[k].place for k in changes], len(toolpath) - 1]
    pieces: list[tuple[tuple[int, str], int, int, list[Event]]] = []  # tool, row before, last row, events
    for k in range(len(edges) - 1):
        first, last = rows[k], rows[k + 1]
        if not ((cuts > first) & (cuts <= last)).any():
            continue
        called = toolpath.events[edges[k]] if k else None
        tool = (0, "") if called is None else (int(called.value), called.text)
        events = list(toolpath.events[edges[k] if pieces else 0 : edges[k + 1]])
        if pieces and pieces[-1][0] == tool:
            before = pieces.pop()
            first, events = before[1], [*before[3], *events]
        pieces.append((tool, first, last, events))
    if len(pieces) <= 1:
        tool = pieces[0][0] if pieces else (0, "")
        return (Operation(*tool, toolpath),)
    return tuple(
        Operation(*tool, _select_rows(toolpath, first, last, stop_all(events, last)))
        for tool, first, last, events in pieces
    )


def stop_all(events: Sequence[Event], last: int) -> list[Event]:
    """Append spindle and coolant off to events, if they are on, as a tool change does."""
    turning = cooling = False
    for event in events:
        turning = event.kind in ("spindle_cw", "spindle_ccw") or (turning and event.kind != "spindle_off")
        cooling = event.kind in ("coolant", "mist") or (cooling and event.kind != "coolant_off")
    off = [Event(last, "spindle_off")] if turning else []
    return [*events, *off, *([Event(last, "coolant_off")] if cooling else [])]


def _select_rows(toolpath: Toolpath, before: int, last: int, events: Sequence[Event]) -> Toolpath:
    """Return the rows after `before` up to `last`; row `before` is the start if the first move is a cut."""
    begin = before + 1 if before < 0 or toolpath.rapid[before + 1] else before
    path = select_waypoints(toolpath, np.arange(begin, last + 1))
    rapid, feed = path.rapid.copy(), path.feed.copy()
    rapid[0], feed[0] = True, 0.0
    placed = tuple(
        replace(event, place=-1 if event.place <= before else min(event.place, last) - begin) for event in events
    )
    return replace(path, rapid=rapid, feed=feed, events=placed)


def select_operation(toolpath: Toolpath, number: int) -> Toolpath:
    """Return one operation of a toolpath, counted from 1; raise an InputError if there are fewer."""
    found = split_operations(toolpath)
    if number > len(found):
        tools = ", ".join(operation.tool for operation in found)
        message = f"operation {number} is selected, the file has {len(found)} (tools {tools})"
        raise InputError(message, file=toolpath.source or None)
    return found[number - 1].toolpath
