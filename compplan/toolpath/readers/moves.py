"""Moves of a CAM file in their order, and the facts about them. Millimetres throughout."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.toolpath.events import Event, insert_spindle_stops
from compplan.toolpath.readers.arcs import FARTHEST, LARGEST_RADIUS, Arc, Point, combine, count_chords, sample_arc
from compplan.toolpath.toolpath import Toolpath

#: Greatest number of waypoints of a file, chords of arcs included.
MOST_WAYPOINTS = 2_000_000
#: Least length of a move. [mm]
STILL = 1e-9
#: Greatest number of events and of comments of a file.
MOST_EVENTS, MOST_COMMENTS = 1_000_000, 2_000
#: Greatest length of a comment; the rest is dropped. [characters]
LONGEST_TEXT = 200
#: Columns of a row: tip (3), tool axis (3), feed, rapid, number of the flat arc that ends here (0: none), line.
WIDTH = 10
COUNTERS = ("cutting_moves", "rapid_moves", "arcs", "full_circles", "helical_arcs", "unmoved_blocks",
            "rotary_only_moves", "cycles")  # fmt: skip


@dataclass(frozen=True)
class CamFacts:
    """Facts about a CAM file.

    A cutting move is a block with feed that moves the tip; lengths of arcs are exact, not those of their chords.

    Args:
        unit: "mm", "inch", "mm, inch" if the unit changes, or "not stated".
        box_mm: Bounding box of the cutting moves: least and greatest x, y, z; or None without any.
        full_circles, helical_arcs: Number of full circles and helices among the arcs; an arc is a cutting move.
        unmoved_blocks: Blocks with feed and without motion.
        rotary_only_moves: Blocks with feed that rotate the tool axis at a constant tip.
        cycles: Canned or drilling cycles, counted by holes.
        waypoints: Rows of the toolpath.
        events: Machine functions (spindle, coolant, tools, dwells, stops, signals) without comments.
        notes: Assumptions and skipped statements, with the line of the first occurrence.

    """

    file: str
    kind: str
    unit: str
    lines: int
    cutting_moves: int
    cutting_length_mm: float
    box_mm: tuple[tuple[float, ...], tuple[float, ...]] | None
    rapid_moves: int
    arcs: int
    full_circles: int
    helical_arcs: int
    arc_length_mm: float
    unmoved_blocks: int
    rotary_only_moves: int
    cycles: int
    waypoints: int
    events: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class CamFile:
    """Contents of a CAM file: its toolpath in the part frame, and the facts about it."""

    toolpath: Toolpath
    facts: CamFacts


@dataclass
class MoveLog:
    """Collect the moves of a file; `chord` is the chord error of arcs [mm], `reader.line` the line that is read."""

    chord: float
    reader: Any
    position: Point = (0.0, 0.0, 0.0)
    axis: Point = (0.0, 0.0, 1.0)
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))
    length: float = 0.0
    arc_length: float = 0.0
    notes: dict[str, tuple[int, int]] = field(default_factory=dict)
    waypoints: int = 0
    events: list[Event] = field(default_factory=list)
    comments: int = 0
    #: First and last row (exclusive) of each hole; holes are not counted as cutting moves.
    _holes: list[tuple[int, int]] = field(default_factory=list)
    _rows: array[float] = field(default_factory=lambda: array("d"))
    _arcs: dict[int, Arc] = field(default_factory=dict)

    def place(self, point: Point, axis: Point | None = None) -> None:
        """Set the position of the tool without a move, after an unknown position."""
        self.position, self.axis = point, axis or self.axis

    def shift(self, step: Point) -> None:
        """Displace all moves so far by a change of the origin [mm]."""
        rows = np.array(self._rows).reshape(-1, WIDTH)
        rows[:, :3] += step
        self._rows = array("d", rows.ravel())
        self.position = combine(1.0, self.position, 1.0, step)

    def clear(self) -> None:
        """Drop all moves so far, which are not in the part frame."""
        self._rows, self._arcs, self.waypoints = array("d"), {}, 0
        self.events = [replace(event, place=-1) for event in self.events]

    def rapid(self, point: Point, axis: Point | None = None) -> None:
        """Move rapidly to a point."""
        axis = axis or self.axis
        if point != self.position or axis != self.axis or not self._rows:
            self.counts["rapid_moves"] += 1
            self.position, self.axis = point, axis
            self._append(point, 0.0, 1.0)

    def line(self, point: Point, feed: float, axis: Point | None = None) -> None:
        """Cut straight to a point with a feed in mm/s and a change of the tool axis."""
        axis = axis or self.axis
        before = self.position
        dx, dy, dz = point[0] - before[0], point[1] - before[1], point[2] - before[2]
        length = (dx * dx + dy * dy + dz * dz) ** 0.5
        if length <= STILL and axis == self.axis:
            self.counts["unmoved_blocks"] += 1
            return
        self._start()
        if length > STILL:
            self.counts["cutting_moves"] += 1
            self.length += length
        else:
            self.counts["rotary_only_moves"] += 1
        self.position, self.axis = point, axis
        self._append(point, feed, 0.0)

    def arc(self, arc: Arc, end: Point, feed: float) -> None:
        """Cut along an arc that ends at a point, with a constant tool axis."""
        self._start()
        if not arc.radius <= LARGEST_RADIUS:
            raise InputError(f"arc of radius {arc.radius:g} mm, at most {LARGEST_RADIUS:g} mm is read")
        self.waypoints += count_chords(arc, self.chord)
        self._arcs[len(self._rows) // WIDTH] = arc
        self._append(end, feed, 0.0, len(self._arcs) if abs(arc.rise) <= STILL else 0)
        self.counts["cutting_moves"] += 1
        self.counts["arcs"] += 1
        self.counts["full_circles"] += int(abs(arc.sweep) > 2.0 * math.pi - 1e-9)
        self.counts["helical_arcs"] += int(abs(arc.rise) > STILL)
        self.length += arc.length
        self.arc_length += arc.length
        self.position = end

    @contextmanager
    def one_move(self) -> Iterator[None]:
        """Count the pieces of a divided move in this context as one cutting move."""
        before = dict(self.counts)
        yield
        for name in ("cutting_moves", "rotary_only_moves"):
            self.counts[name] = min(self.counts[name], before[name] + 1)

    @contextmanager
    def hole(self) -> Iterator[None]:
        """Count the cuts in this context as one hole, not as cutting moves or cutting length."""
        counts, length, first = dict(self.counts), self.length, len(self._rows) // WIDTH
        self.counts["cycles"] += 1
        yield
        for name in ("cutting_moves", "unmoved_blocks"):
            self.counts[name] = counts[name]
        self.length = length
        self._holes.append((first, len(self._rows) // WIDTH))

    def note(self, message: str, line: int | None = None) -> None:
        """Note an assumption or a skipped statement of a line, by default of the current one."""
        first, times = self.notes.get(message, (self.reader.line if line is None else line, 0))
        self.notes[message] = (first, times + 1)

    def add_event(self, kind: str, *, value: float = 0.0, text: str = "") -> None:
        """Append a machine function at the current waypoint."""
        place = len(self._rows) // WIDTH - 1
        if kind == "comment":
            self.comments += 1
            if self.comments > MOST_COMMENTS:
                self.note(f"comments after the first {MOST_COMMENTS} are not kept")
                return
        elif len(self.events) - min(self.comments, MOST_COMMENTS) >= MOST_EVENTS:
            raise InputError(f"more than {MOST_EVENTS} events beside motion; no more are read")
        self.events.append(Event(place, kind, value, text[:LONGEST_TEXT]))

    def _append(self, point: Point, feed: float, rapid: float, arc: float = 0.0) -> None:
        """Append a row at a point."""
        self.waypoints += 1
        if self.waypoints > MOST_WAYPOINTS:
            raise InputError(f"more than {MOST_WAYPOINTS} waypoints, arcs as chords; split the file")
        if not (abs(point[0]) < FARTHEST and abs(point[1]) < FARTHEST and abs(point[2]) < FARTHEST):
            raise InputError(f"coordinate {max(map(abs, point)):g} mm, less than {FARTHEST:g} mm is allowed")
        self._rows.extend((*point, *self.axis, feed, rapid, arc, self.reader.line))

    def _start(self) -> None:
        """Append the start of the first cut if there is no row yet."""
        if not self._rows:
            self._append(self.position, 0.0, 1.0)

    def _tabulate(self) -> tuple[Array, list[Event], NDArray[np.bool_]]:
        """Return rows with arcs divided into chords, shape (n, WIDTH), their events, and a mask of holes (n,)."""
        table = np.array(self._rows, dtype=np.float64).reshape(-1, WIDTH)
        points = [sample_arc(arc, self.chord) for arc in self._arcs.values()]
        ends = np.array(list(self._arcs), dtype=np.int64)
        repeats = np.ones(len(table), dtype=np.int64)
        repeats[ends] = [len(on_arc) for on_arc in points]
        first = np.concatenate([[0], np.cumsum(repeats)])
        full, last = np.repeat(table, repeats, axis=0), first[ends + 1] - 1
        programmed = full[last, :3]  # programmed end of each arc, kept exactly
        full[np.repeat(np.isin(np.arange(len(table)), ends), repeats), :3] = np.concatenate([np.empty((0, 3)), *points])
        full[last, :3] = programmed
        drilled = np.zeros(len(full), dtype=bool)
        for begin, end in self._holes:
            drilled[first[begin] : first[end]] = True
        events = [replace(event, place=int(first[event.place + 1]) - 1) for event in self.events]
        return full, events, drilled

    def finish(self, file: Path, kind: str, unit: str, lines: int) -> CamFile:
        """Return the toolpath and the facts about the file."""
        table, found, drilled = self._tabulate()
        if not np.isfinite(table).all():
            raise InputError("a coordinate is too large", file=file)
        rapid = table[:, 7] == 1.0
        moved = np.concatenate([[False], np.any(np.abs(np.diff(table[:, :3], axis=0)) > STILL, axis=1)])[: len(table)]
        cut = ~rapid & moved
        milled = cut & ~drilled
        touched = milled | np.concatenate([milled[1:], [False]])[: len(table)]
        box = None
        if touched.any():
            lowest, greatest = table[touched, :3].min(axis=0), table[touched, :3].max(axis=0)
            box = (tuple(lowest.round(9).tolist()), tuple(greatest.round(9).tolist()))
        events, stopped = insert_spindle_stops(found, cut)
        if stopped:
            first = f"the file cuts with a spindle that it has stopped, {stopped} times: the program stops before"
            self.note(first, 1)
        facts: dict[str, Any] = dict(self.counts)
        facts["events"] = sum(event.kind != "comment" for event in events)
        notes = tuple(
            type(message)(f"line {first}: {message}" + (f" ({times} times)" if times > 1 else ""))
            for message, (first, times) in self.notes.items()
        )
        prefixed = tuple(type(note)(f"{file.name}, {note}.") for note in notes)
        arc, line = table[:, 8:].astype(int).T
        rows = (table[:, :3] * 1e-3, table[:, 3:6], table[:, 6] * 1e-3, rapid)
        toolpath = Toolpath(*rows, None, "part", str(file), prefixed, events, arc=arc if arc.any() else None, line=line)
        return CamFile(toolpath, CamFacts(
            str(file), kind, unit, lines, cutting_length_mm=self.length, box_mm=box, arc_length_mm=self.arc_length,
            waypoints=len(table), notes=notes, **facts,
        ))  # fmt: skip
