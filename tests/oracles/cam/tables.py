"""Toolpath tables and generated paths read a second time."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracles.cam.moves import ARC, LINE, RAPID, Array, CannotTellError, Reading, Recorder

#: What a column's unit is in millimetres, and in millimetres a second.
LENGTHS = {"mm": 1.0, "m": 1e3, "um": 1e-3, "cm": 10.0, "in": 25.4, "inch": 25.4}
SPEEDS = {"mm_s": 1.0, "m_s": 1e3, "mm_min": 1.0 / 60.0, "m_min": 1e3 / 60.0}


def read_table(file: Path) -> Reading:
    """Read a toolpath table.

    Raises:
        CannotTellError: If a column is written in a way that is not known here.

    """
    with file.open(encoding="utf-8-sig", newline="") as stream:
        rows = [row for row in csv.reader(line for line in stream if not line.lstrip().startswith("#")) if any(row)]
    head = [name.strip() for name in rows[0]]
    columns = {name: [row[k].strip() if k < len(row) else "" for row in rows[1:]] for k, name in enumerate(head)}

    def take(name: str, units: dict[str, float], blank: float = math.nan) -> Array | None:
        for unit, factor in units.items():
            key = f"{name}_{unit}" if unit else name
            if key in columns:
                return np.array([float(text) * factor if text else blank for text in columns[key]])
        return None

    place = [take(name, LENGTHS) for name in "xyz"]
    if any(column is None for column in place):
        raise CannotTellError("columns of x, y, z")
    n = len(rows) - 1
    axis = [take(name, {"": 1.0}) for name in "ijk"]
    rapid, feed = take("rapid", {"": 1.0}, 0.0), take("feed", SPEEDS, 0.0)
    kind = np.where(np.zeros(n) if rapid is None else rapid, RAPID, LINE).astype(int)
    known = [column for column in axis if column is not None]
    way = np.column_stack(known) if len(known) == 3 else np.tile([0.0, 0.0, 1.0], (n, 1))
    nothing = np.full((n, 3), math.nan)
    return Reading(
        kind, np.column_stack([column for column in place if column is not None]) * 1e-3,
        way / np.linalg.norm(way, axis=1, keepdims=True),
        np.where(kind == RAPID, 0.0, np.zeros(n) if feed is None else feed * 1e-3), np.full(n, -1),
        np.arange(2, n + 2), nothing, np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(n), np.zeros(n, bool),
    )  # fmt: skip


def read_generator(table: Mapping[str, Any]) -> tuple[Reading, float]:
    """Return the moves of a generated path, and how far chords between its waypoints may stray from them.

    Raises:
        CannotTellError: If the generator is not known here.

    """
    record, kind = Recorder(), table.get("generator")
    axis = tuple(float(value) for value in table.get("axis", (0.0, 0.0, 1.0)))
    size = math.hypot(*axis)
    lift = [float(table.get("approach_mm", 0.0)) * value / size for value in axis]
    if kind == "circle":
        start, end, centre, normal, sweep, least = _circle(table)
    elif kind == "spiral":
        start, end, centre, normal, sweep, least = _spiral(table)
    elif kind == "isf_cone" and table.get("path", "helical") == "helical":
        start, end, centre, normal, sweep, least = _cone(table)
    elif kind == "isf_cone" and table["path"] == "z_level":
        return _read_levels(table, axis, lift)
    else:
        raise CannotTellError(f"the generator {kind!r} {table.get('path', '')}".rstrip())
    flat0, flat1 = math.dist(start[:2], centre[:2]), math.dist(end[:2], centre[:2])
    mean = 0.5 * (flat0 + flat1) if kind != "circle" else float(table["radius_mm"])
    feed, step = _read_pace(table, abs(sweep) * mean)
    if any(lift):
        record.move(RAPID, [s + u for s, u in zip(start, lift, strict=True)], 0.0, axis)
    record.move(RAPID, start, 0.0, axis)
    record.move(ARC, end, feed, axis, centre=tuple(centre), normal=tuple(normal), sweep=sweep)
    if any(lift):
        record.move(RAPID, [s + u for s, u in zip(end, lift, strict=True)], 0.0, axis)
    return record.finish(), 1.2e-3 * step * step / (8.0 * least) + 1e-7


def _read_pace(table: Mapping[str, Any], length: float) -> tuple[float, float]:
    """Return the feed of a path of a length [mm] and the distance of its waypoints. [mm/s], [mm]"""
    feed = float(table.get("feed_mm_s") or length / float(table.get("duration_s") or math.inf))
    step = table.get("step_mm") or (feed / table["rate_hz"] if table.get("rate_hz") else None)
    return feed, float(step) if step else 1.2 * length / max(float(table["waypoints"]) - 1.0, 1.0)


def _read_levels(table: Mapping[str, Any], axis: tuple[float, ...], lift: list[float]) -> tuple[Reading, float]:
    """Return the moves of a cone of circles at constant depth, joined by steps down its wall at angle 0."""
    radius, depth = 0.5 * float(table["diameter_mm"]), float(table["depth_mm"])
    levels = max(1, round(depth / float(table["pitch_mm"])))
    down = depth / levels
    inward = down / math.tan(math.radians(table["wall_angle_deg"]))
    radii = [radius - inward * level for level in range(1, levels + 1)]
    feed, step = _read_pace(table, levels * math.hypot(down, inward) + 2.0 * math.pi * sum(radii))
    record = Recorder()
    if any(lift):
        record.move(RAPID, [radius + lift[0], lift[1], lift[2]], 0.0, axis)
    record.move(RAPID, [radius, 0.0, 0.0], 0.0, axis)
    for level, around in enumerate(radii, start=1):
        start = [around, 0.0, -down * level]
        record.move(LINE, start, feed, axis)
        record.move(ARC, start, feed, axis, centre=(0.0, 0.0, start[2]), sweep=2.0 * math.pi)
    if any(lift):
        record.move(RAPID, [radii[-1] + lift[0], lift[1], lift[2] - depth], 0.0, axis)
    return record.finish(), 1.2e-3 * step * step / (8.0 * radii[-1]) + 1e-7


Shape = tuple[list[float], list[float], list[float], list[float], float, float]


def _circle(table: Mapping[str, Any]) -> Shape:
    i, j = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}[table.get("plane", "xy")]
    radius, turns = float(table["radius_mm"]), float(table.get("turns", 1.0))
    first, centre = math.radians(table.get("start_deg", 0.0)), [float(v) for v in table.get("centre_mm", (0, 0, 0))]
    ends = []
    for angle in (first, first + 2.0 * math.pi * turns):
        point = list(centre)
        point[i] += radius * math.cos(angle)
        point[j] += radius * math.sin(angle)
        ends.append(point)
    normal = [0.0, 0.0, 0.0]
    normal[3 - i - j] = -1.0 if (i, j) == (0, 2) else 1.0  # x towards z turns about -y
    return ends[0], ends[1], centre, normal, 2.0 * math.pi * turns, radius


def _spiral(table: Mapping[str, Any]) -> Shape:
    inner, outer = float(table.get("inner_radius_mm", 0.0)), float(table["outer_radius_mm"])
    turns = table.get("turns") or _spiral_turns(inner, outer, float(table["length_mm"]))
    centre, sweep = [float(v) for v in table.get("centre_mm", (0, 0, 0))], 2.0 * math.pi * float(turns)
    start = [centre[0] + inner, centre[1], centre[2]]
    end = [centre[0] + outer * math.cos(sweep), centre[1] + outer * math.sin(sweep), centre[2]]
    return start, end, centre, [0.0, 0.0, 1.0], sweep, max(inner, (outer - inner) / sweep / 2.0)


def _spiral_turns(inner: float, outer: float, length: float) -> float:
    """Return the turns of an Archimedean spiral of a length, by halving; r' = b, ds^2 = (r^2 + b^2) du^2."""

    def measure(sweep: float) -> float:
        b = (outer - inner) / sweep
        low, high = inner / b, outer / b
        area = [0.5 * (x * math.sqrt(1 + x * x) + math.asinh(x)) for x in (low, high)]
        return b * (area[1] - area[0])

    low, high = 1e-6, 1e6
    for _ in range(200):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if measure(middle) < length else (low, middle)
    return low / (2.0 * math.pi)


def _cone(table: Mapping[str, Any]) -> Shape:
    radius, depth = 0.5 * float(table["diameter_mm"]), float(table["depth_mm"])
    last = radius - depth / math.tan(math.radians(table["wall_angle_deg"]))
    sweep = 2.0 * math.pi * depth / float(table["pitch_mm"])
    end = [last * math.cos(sweep), last * math.sin(sweep), -depth]
    return [radius, 0.0, 0.0], end, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], sweep, last
