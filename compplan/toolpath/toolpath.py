"""Toolpath: position of the tool tip, tool axis, feed and process wrench at waypoints.

Row i holds the feed and the rapid flag of the move that ends at waypoint i. Row 0 is the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError, ShapeError
from compplan.io.columns import FileColumn, to_unit
from compplan.io.display import Curve, Curves, Shown
from compplan.io.tables import Array, Table, write_table
from compplan.toolpath.events import Event, move_events

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
WRENCH_HEADERS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Greatest plausible extent of a toolpath. [m]
WIDEST = 100.0
#: Least plausible extent, and the extent below which a note questions the unit. [m]
NARROWEST, SMALL = 1e-5, 1e-3
#: Plausible range of the feed of cutting moves. [m/s]
SLOWEST, FASTEST = 1e-6, 1e2
#: Greatest number of waypoints after resampling.
MOST_WAYPOINTS = 5_000_000
#: Greatest deviation of |(i, j, k)| from 1 that counts as rounding.
AXIS_ROUNDING = 1e-3

#: Hint on the unit of a table for an implausible extent.
UNIT_HINTS = {
    "m": "; columns are read in m, name them x_mm y_mm z_mm if the file is in millimetres",
    "mm": "; columns are read in mm, name them x_um y_um z_um if the file is in micrometres",
}

COLUMNS = (
    *(FileColumn(name, "length", required=True) for name in "xyz"),
    *(FileColumn(name, "number", group="tool axis") for name in "ijk"),
    FileColumn("feed", "speed", missing=True),
    FileColumn("rapid", "number"),
    *(FileColumn(name, "force", group="force") for name in WRENCH[:3]),
    *(FileColumn(name, "moment", group="moment") for name in WRENCH[3:]),
)


@dataclass(frozen=True, repr=False)
class Toolpath(Shown):
    """Nominal toolpath in one frame.

    Args:
        position: Tool tip. Shape (n, 3). [m]
        axis: Tool axis, unit vector from the tip towards the spindle. Shape (n, 3).
        feed: Programmed feed of the move that ends here, 0 if unknown (rapid moves). Shape (n,). [m/s]
        rapid: Whether the move that ends here is rapid. Shape (n,).
        wrench: Predicted wrench of the environment on the tool, at the tip, or None. Shape (n, 6). [N, N m]
        frame: Frame of position, axis and wrench: "part" or "base".
        source: File or generator of the toolpath, for messages.
        notes: Assumptions and skipped statements of the reader, one sentence each.
        events: Machine functions, in order.
        rounded: Distance of each waypoint from the programmed path, due to a rounded corner, or None. Shape (n,). [m]
        arc: Number of the arc in the file of which the move that ends here is a chord, 0: none; or None. Shape (n,).
        line: Line of the file, from 1, of the move that ends here, 0 if unknown; or None.
            Shape (n,).

    Raises:
        ShapeError: If an array does not have the shape above.

    """

    position: Array
    axis: Array
    feed: Array
    rapid: NDArray[np.bool_]
    wrench: Array | None = None
    frame: Literal["part", "base"] = "part"
    source: str = ""
    notes: tuple[str, ...] = ()
    events: tuple[Event, ...] = ()
    rounded: Array | None = None
    arc: NDArray[np.int_] | None = None
    line: NDArray[np.int_] | None = None

    def __post_init__(self) -> None:
        n = len(self.position)
        needed = {"position": (n, 3), "axis": (n, 3), "feed": (n,), "rapid": (n,)}
        shapes = {**needed, "wrench": (n, 6), "rounded": (n,), "arc": (n,), "line": (n,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is None and name not in needed:
                continue
            array = np.array(array, dtype={"rapid": bool, "arc": np.int_, "line": np.int_}.get(name, np.float64))
            if array.shape != shape:
                raise ShapeError(f"toolpath {name} has shape {array.shape}, expected {shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.position)

    def summary(self) -> list[tuple[str, str]]:
        """Return length, extent, feed, force and the first notes."""
        feed = self.feed[1:][~self.rapid[1:]]
        span = " x ".join(f"{1e3 * size:.4g}" for size in np.ptp(self.position, axis=0)) if len(self) else "0"
        force = "none given" if self.wrench is None else (
            f"at most {float(np.linalg.norm(self.wrench[:, :3], axis=1).max(initial=0.0)):.4g} N")  # fmt: skip
        return [
            ("toolpath", f"{Path(self.source).name or 'in memory'}: {len(self)} waypoints, "
                         f"{1e3 * self.cutting_length:.5g} mm of cut, {self.frame} frame"),
            ("span", f"{span} mm"),
            ("feed", f"{1e3 * feed.min(initial=np.inf):.4g} to {1e3 * feed.max(initial=0.0):.4g} mm/s" if len(feed)
                     else "no cutting move"),
            ("force", force),
            *(("note", note) for note in self.notes[:8]),
        ]  # fmt: skip

    def columns(self) -> dict[str, Any]:
        """Return the columns of the CSV table that `write_toolpath` writes, one row per waypoint."""
        names = ("x_mm", "y_mm", "z_mm")
        columns: dict[str, Any] = {name: to_unit(self.position[:, k], name) for k, name in enumerate(names)}
        columns |= {name: self.axis[:, index] for index, name in enumerate("ijk")}
        columns |= {"feed_mm_s": to_unit(self.feed, "feed_mm_s"), "rapid": self.rapid.astype(np.int64)}
        if self.wrench is not None:
            columns |= {name: self.wrench[:, index] for index, name in enumerate(WRENCH_HEADERS)}
        return columns

    def curves(self) -> Curves:
        """Return the path in the xy plane. [mm]"""
        x, y = self.position[:, 0] * 1e3, self.position[:, 1] * 1e3
        cut = Curve("cut", np.where(self.rapid, np.nan, x), np.where(self.rapid, np.nan, y), "after")
        whole = Curve("rapid", x, y, "neutral")
        along, up = (f"{axis}, {self.frame} frame [mm]" for axis in "xy")
        lines = (whole, cut) if self.rapid[1:].any() else (cut,)
        return Curves(Path(self.source).name or "toolpath", along, up, lines, square=True)

    @property
    def steps(self) -> Array:
        """Distance from each waypoint to the next. Shape (n - 1,) [m]."""
        return np.linalg.norm(np.diff(self.position, axis=0), axis=1)

    @property
    def arc_length(self) -> Array:
        """Path length up to each waypoint, rapid moves included. Shape (n,). [m]"""
        return np.concatenate([[0.0], np.cumsum(self.steps)])

    @property
    def cutting_length(self) -> float:
        """Length of the moves that are not rapid [m]."""
        return float(self.steps[~self.rapid[1:]].sum())


def check_toolpath(
    toolpath: Toolpath, *, file: str | Path | None = None, table: Table | None = None, need_feed: bool = True
) -> Toolpath:
    """Check a toolpath and return it with normalised tool axes; raise an InputError if it is invalid.

    Required are at least two waypoints, a cutting length above 0, finite values, feeds above 0 on cutting moves
    (`need_feed`), unit tool axes, and a plausible extent. Messages name `file` (default: the source of the toolpath) or
    the line of the table.
    """
    file = file or (table.file if table is not None else None) or toolpath.source or None

    def refuse(message: str, row: int | None = None) -> None:
        if table is not None:
            raise table.error(message, row)
        raise InputError(message if row is None else f"{message}, at waypoint {row}", file=file)

    if len(toolpath) < 2:
        refuse(f"toolpath has {len(toolpath)} waypoints, needs at least 2")
    for name in ("position", "axis", "feed", "wrench"):
        array = getattr(toolpath, name)
        if array is not None and not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0])
            refuse(f"toolpath {name} is not a finite number", row)
    span = float(np.ptp(toolpath.position, axis=0).max())
    if span > WIDEST:
        hint = UNIT_HINTS.get("" if table is None else table.units["x"], f", at most {WIDEST:.0f} m are allowed")
        refuse(f"toolpath spans {span:.0f} m{hint}")
    if 0.0 < span < NARROWEST:
        refuse(f"toolpath spans {span * 1e3:.3g} mm, expected at least {NARROWEST * 1e3:g} mm; is it in metres?")
    if toolpath.steps.sum() <= 0.0:
        refuse("toolpath has zero length: all waypoints coincide")
    if toolpath.cutting_length <= 0.0:
        refuse("toolpath has zero cutting length: every move is rapid; mark cutting moves with rapid = 0")
    norms = np.linalg.norm(toolpath.axis, axis=1)
    crooked = np.flatnonzero(np.abs(norms - 1.0) > AXIS_ROUNDING)
    if len(crooked):
        refuse(f"tool axis (i, j, k) has length {norms[crooked[0]]:.6g}, expected 1", int(crooked[0]))
    cutting = ~toolpath.rapid.copy()
    cutting[0] = False
    odd = np.flatnonzero(cutting & (toolpath.feed > 0.0) & ~((toolpath.feed >= SLOWEST) & (toolpath.feed <= FASTEST)))
    if len(odd):
        feed = toolpath.feed[odd[0]] * 1e3
        refuse(f"feed is {feed:g} mm/s, expected {SLOWEST * 1e3:g} to {FASTEST * 1e3:g} mm/s", int(odd[0]))
    still = np.flatnonzero((cutting & need_feed & (toolpath.feed == 0.0)) | (toolpath.feed < 0.0))
    if len(still):
        feed = toolpath.feed[still[0]] * 1e3
        how = "; state it with feed_mm_s of [cam] (--feed) or feed.constant_mm_s of the job" if feed == 0.0 else ""
        refuse(f"feed is {feed:g} mm/s, expected more than 0 on a cutting move{how}", int(still[0]))
    hint = f"The whole toolpath spans {span * 1e3:.3g} mm: is it in metres, or in inches?"
    notes = toolpath.notes if span >= SMALL or hint in toolpath.notes else (*toolpath.notes, hint)
    return replace(toolpath, axis=toolpath.axis / norms[:, None], notes=notes)


def toolpath_from_table(table: Table, *, feed: float | None = None) -> Toolpath:
    """Build a toolpath from the columns of a table: x y z, i j k, feed, rapid, wrench; missing moments are 0."""
    n = len(table)
    position = table.stack(("x", "y", "z"))
    axis = table.stack(("i", "j", "k")) if "i" in table else np.tile([0.0, 0.0, 1.0], (n, 1))
    rapid = table.values["rapid"] if "rapid" in table else np.zeros(n)
    odd = np.flatnonzero((rapid != 0.0) & (rapid != 1.0))
    if len(odd):
        raise table.error(f"rapid is {rapid[odd[0]]:g}, expected 0 or 1", int(odd[0]))
    if "feed" not in table and feed is None and not rapid[1:].all():
        raise table.error("missing column feed_mm_s: cutting moves need a feed")
    feeds = table.values["feed"] if "feed" in table and feed is None else np.where(rapid == 1.0, 0.0, feed or 0.0)
    unknown = np.isnan(feeds)
    empty = np.flatnonzero(unknown & (rapid == 0.0))
    if len(empty):
        raise table.error(f"column '{table.headers['feed']}' is empty here; cutting moves need a feed", int(empty[0]))
    feeds = np.where(unknown, 0.0, feeds)
    wrench = None
    if "fx" in table or "mx" in table:
        wrench = np.column_stack([table.values[key] if key in table else np.zeros(n) for key in WRENCH])
    toolpath = Toolpath(position, axis, feeds, rapid == 1.0, wrench, "part", str(table.file))
    return check_toolpath(toolpath, table=table)


def write_toolpath(toolpath: Toolpath, path: str | Path) -> None:
    """Write a toolpath as CSV: x_mm y_mm z_mm i j k feed_mm_s rapid, and the wrench if present."""
    write_table(path, toolpath.columns())


def place_toolpath(toolpath: Toolpath, T_base_part: Array) -> Toolpath:
    """Transform a toolpath from the part frame to the base frame of the robot; the wrench remains at the tool tip.

    `T_base_part` is the pose of the part frame in the base frame. Shape (4, 4). [m]
    """
    rotation = T_base_part[:3, :3]
    wrench = toolpath.wrench
    if wrench is not None:
        wrench = np.hstack([wrench[:, :3] @ rotation.T, wrench[:, 3:] @ rotation.T])
    position = toolpath.position @ rotation.T + T_base_part[:3, 3]
    return replace(toolpath, position=position, axis=toolpath.axis @ rotation.T, wrench=wrench, frame="base")


def _select_moves(toolpath: Toolpath, index: NDArray[np.int_]) -> dict[str, Any]:
    """Return the columns that describe moves, at the waypoints where the moves end."""
    columns = {name: getattr(toolpath, name) for name in ("feed", "rapid", "arc", "line")}
    return {name: None if values is None else values[index] for name, values in columns.items()}


def select_waypoints(toolpath: Toolpath, index: NDArray[np.int64]) -> Toolpath:
    """Return the toolpath at selected waypoints."""
    wrench, rounded = (None if values is None else values[index] for values in (toolpath.wrench, toolpath.rounded))
    return replace(
        toolpath, position=toolpath.position[index], axis=toolpath.axis[index], wrench=wrench, rounded=rounded,
        events=move_events(toolpath.events, index.astype(float)), **_select_moves(toolpath, index),
    )  # fmt: skip


def resample_toolpath(toolpath: Toolpath, max_step: float) -> Toolpath:
    """Divide cutting moves so that no step is longer than `max_step` [m].

    Rapid moves are not divided. All waypoints are kept, so corners stay sharp. New waypoints lie on the straight move;
    the tool axis is interpolated on the great circle, the wrench linearly. Feed and rapid flag are those of the move.
    """
    if not max_step > 0.0:
        raise InputError(f"the longest step is {max_step * 1e3:g} mm, must be greater than 0")
    turn = np.arccos(np.clip(np.sum(toolpath.axis[:-1] * toolpath.axis[1:], axis=1), -1.0, 1.0))
    wanted = np.where(toolpath.rapid[1:], 1.0, np.ceil(toolpath.steps / max_step - 1e-9))
    pieces = np.maximum(wanted, 1.0).astype(np.int64)
    if pieces.sum() > MOST_WAYPOINTS:
        message = f"a step of {max_step * 1e3:g} mm makes {pieces.sum()} waypoints, allowed are {MOST_WAYPOINTS}"
        raise InputError(message, file=toolpath.source or None)
    move = np.repeat(np.arange(len(pieces)), pieces)  # the move that contains each new waypoint
    first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
    share = (np.arange(pieces.sum()) - first[move] + 1.0) / pieces[move]
    angle = turn[move]
    flat = angle < 1e-9
    sine = np.where(flat, 1.0, np.sin(angle))
    before = np.where(flat, 1.0 - share, np.sin((1.0 - share) * angle) / sine)[:, None]
    after = np.where(flat, share, np.sin(share * angle) / sine)[:, None]
    axis = np.vstack([toolpath.axis[:1], before * toolpath.axis[move] + after * toolpath.axis[move + 1]])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return replace(divide_toolpath(toolpath, np.concatenate([[0.0], move + share])), axis=axis)


def _chord_offset(toolpath: Toolpath, before: NDArray[np.int_], share: Array) -> Array:
    """Return the offset of points on rounded corners from the chords, by parabolas through 3 waypoints. (m, 3) [m]."""
    if toolpath.rounded is None:
        return np.zeros((len(before), 3))
    x, curved = toolpath.position, toolpath.rounded > 0.0
    steps = np.maximum(toolpath.steps, 1e-12)
    bend = np.zeros_like(x)  # second derivative of the parabola through a waypoint and its neighbours
    bend[1:-1] = 2.0 * (np.diff(x[1:], axis=0) / steps[1:, None] - np.diff(x[:-1], axis=0) / steps[:-1, None])
    bend[1:-1] /= (steps[1:] + steps[:-1])[:, None]
    bend[~curved] = 0.0
    alone = (curved[before] ^ curved[before + 1])[:, None]
    mean = np.where(alone, bend[before] + bend[before + 1], (1 - share) * bend[before] + share * bend[before + 1])
    return np.asarray(-0.5 * mean * share * (1 - share) * (steps[before] ** 2)[:, None])


def divide_toolpath(toolpath: Toolpath, places: Array) -> Toolpath:
    """Return the toolpath at fractional waypoints; feed and rapid flag are those of the move that contains a place.

    `places` (m,) are waypoint numbers, fractional between waypoints, non-decreasing. Places on a rounded corner lie on
    its curve, all others on the straight move.
    """
    before = np.clip(np.floor(places).astype(int), 0, len(toolpath) - 2)
    share = (places - before)[:, None]
    move = np.clip(np.ceil(places - 1e-12).astype(int), 0, len(toolpath) - 1)

    def between(values: Array) -> Array:
        return np.asarray(values[before] * (1 - share) + values[before + 1] * share)

    axis = between(toolpath.axis)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    wrench = None if toolpath.wrench is None else between(toolpath.wrench)
    return replace(
        toolpath, position=between(toolpath.position) + _chord_offset(toolpath, before, share), axis=axis,
        wrench=wrench, events=move_events(toolpath.events, places), **_select_moves(toolpath, move),
        rounded=None if toolpath.rounded is None else np.interp(places, np.arange(len(toolpath)), toolpath.rounded),
    )  # fmt: skip


def interpolate(length: NDArray[Any], places: NDArray[Any], values: Array) -> Array:
    """Interpolate values (b, ...) at path lengths `places` (b,) to other path lengths (n,). Shape (n, ...)."""
    flat = values.reshape(len(places), -1)
    return np.stack([np.interp(length, places, v) for v in flat.T], axis=1).reshape(-1, *values.shape[1:])


def select_even(values: NDArray[Any], most: int) -> NDArray[Any]:
    """Return at most `most` of the values (n, ...), evenly spaced, both ends included."""
    return values[np.unique(np.linspace(0, len(values) - 1, min(len(values), most)).astype(int))]
