"""Scenes of plain data: drawn path and colours, link poses, text of a selected row."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.io.palette import NEUTRAL
from compplan.io.quantities import format_length, format_number
from compplan.reporting.charts import SEQUENTIAL
from compplan.reporting.writers.recording import PlanRecording
from compplan.robot import Array

Bytes = NDArray[np.uint8]
Rows = NDArray[np.int_] | slice | int
#: Deviation of the last colour, in tolerances; the middle colour is one tolerance.
LAST = 2.0
#: Display mode of the tip that is a band.
ERROR_BAND = "error_band"
#: Upper bound of lengths that are 0 in deviation.csv. [m]
TINY = 1e-12
#: Length of the greatest drawn deviation as a share of the extent of the path, greatest magnification, and share of the
#: tolerance below which a deviation is not magnified.
MAGNIFIED, MOST_MAGNIFIED, SEEN = 0.1, 500.0, 0.02


class Lines(NamedTuple):
    """Segments of lines: both ends, shape (k, 2, 3) [m], and red, green, blue of both, shape (k, 2, 3)."""

    points: NDArray[np.float32]
    colours: Bytes


def read_colour(text: str) -> Bytes:
    """Return #rrggbb as three bytes."""
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)], np.uint8)


def paint_sizes(size: Array, tolerance: float) -> Bytes:
    """Return colours of deviations (n,) [m]: blue for zero, yellow for the tolerance [m], dark red for twice that."""
    place = np.clip(np.nan_to_num(size) / (LAST * tolerance), 0.0, 1.0)
    stops = [stop for stop, _ in SEQUENTIAL]
    shades = np.stack([read_colour(colour) for _, colour in SEQUENTIAL]).astype(float)
    colours = np.column_stack([np.interp(place, stops, shade) for shade in shades.T])
    return np.where(np.isfinite(size)[:, None], colours, read_colour(NEUTRAL)).astype(np.uint8)


def join_rows(points: Array, colours: Bytes) -> Lines:
    """Join neighbouring points by segments; points that are not finite leave a gap."""
    both = np.isfinite(points[:-1]).all(axis=1) & np.isfinite(points[1:]).all(axis=1)
    ends = np.stack([points[:-1], points[1:]], axis=1)[both].astype(np.float32)
    return Lines(ends, np.stack([colours[:-1], colours[1:]], axis=1)[both])


def pick_point(points: Array, origin: Array, direction: Array) -> int:
    """Return the index of the point (n, 3) nearest to a ray from the camera by angle, among points in front of it."""
    away, unit = points - origin, direction / np.linalg.norm(direction)
    along, across = away @ unit, np.linalg.norm(np.cross(away, unit), axis=1)
    angle = np.where(along > 0, across / np.maximum(along, 1e-9), np.inf)
    return int(np.argmin(np.where(np.isfinite(angle), angle, np.inf)))


@dataclass(frozen=True, eq=False)
class PlanScene:
    """Scene of a recorded plan."""

    recording: PlanRecording

    @cached_property
    def ways(self) -> dict[str, str]:
        """Display modes of the tip, with their labels."""
        names = {"uncorrected": "without correction", "planned": "as planned, robot as modelled"}
        known = {way: name for way, name in names.items() if np.isfinite(self.recording.deviation[way]).any()}
        if np.isfinite(self.recording.error_band).any():
            known[ERROR_BAND] = "95 % band of the true tip"
        return known

    @cached_property
    def cut(self) -> NDArray[np.bool_]:
        """Rows of the cut. Shape (n,)."""
        return np.asarray(self.recording.move == "cut")

    @property
    def start(self) -> int:
        """First row of the cut."""
        return int(np.argmax(self.cut))

    @cached_property
    def sizes(self) -> dict[str, Array]:
        """Deviation by display mode; NaN if unknown. Shape (n,) each. [m]"""
        lengths = {way: np.linalg.norm(values, axis=1) for way, values in self.recording.deviation.items()}
        return {way: np.where(self.cut, size, np.nan) for way, size in lengths.items()} | {
            ERROR_BAND: self.recording.error_band
        }

    def top(self, way: str) -> float:
        """Return the deviation of the last colour: the greatest of this mode, at least twice the tolerance. [m]"""
        return max(LAST * self.recording.tolerance, float(np.nanmax(self.sizes[way], initial=0.0)))

    def magnification(self, way: str) -> float:
        """Return the magnification that makes the deviation of a display mode visible."""
        size = float(np.nanmax(self.sizes[way], initial=0.0))
        if size < SEEN * self.recording.tolerance:
            return 1.0
        extent = float(np.ptp(self.recording.tip[self.cut], axis=0).max())
        return float(np.clip(round(MAGNIFIED * extent / size), 1.0, MOST_MAGNIFIED))

    def find_worst(self, way: str) -> int:
        """Return the row of the greatest deviation of a display mode."""
        return int(np.argmax(np.nan_to_num(self.sizes[way], nan=-1.0)))

    def place(self, way: str, magnify: float, rows: Rows = slice(None)) -> Array:
        """Return the drawn loaded tip at rows, deviations magnified. Shape (k, 3), or (3,) of one row. [m]"""
        tip = self.recording.tip[rows]
        return np.asarray(
            tip if way == ERROR_BAND else tip + magnify * np.nan_to_num(self.recording.deviation[way][rows])
        )

    def pose_links(self, row: int) -> dict[str, Array]:
        """Return the pose of every link as commanded. Shape (4, 4) each. [m]"""
        return dict(zip(self.recording.facts["links"], self.recording.poses[row], strict=True))

    def tell(self, row: int) -> str:
        """Describe a row as markdown: deviations, joints, force, posture."""
        record = self.recording
        lines = [f"**Row {record.row[row]}** of joints.csv, {record.move[row]}, {record.time[row]:.2f} s", ""]
        lines += ["| deviation | |", "|---|---|"]
        lines += [f"| {name} | {_describe_length(self.sizes[way][row])} |" for way, name in self.ways.items()]
        lines += [f"| tolerance | {format_length(record.tolerance)} |", "", "| joint | |", "|---|---|"]
        for header, value in zip(record.facts["joints"], record.joints[row], strict=True):
            name, _, unit = header.rpartition("_")
            lines.append(f"| {name} | {value:.2f}\u00a0{unit} |")
        force = ", ".join(format_number(float(value)) for value in record.force[row])
        x, y, z = (format_number(1e3 * float(value), 5) for value in record.tip[row])
        words = ", ".join(f"{name} {word}" for name, word in record.facts["configuration"].items())
        lines += ["", f"Force on the tool: {force} N (x, y, z of the base)", "", f"Wanted tip: {x}, {y}, {z} mm"]
        return "\n".join([*lines, "", f"Posture: {words or 'not known'}"])


def _describe_length(metres: float) -> str:
    return format_length(max(float(metres), TINY)) if np.isfinite(metres) else "not known here"
