"""A plan as a scene of plain data: where its path is drawn, in what colours, where the arm is, what a click tells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.io.quantities import format_length, format_number
from compplan.reporting.thinning import simplify_path
from compplan.reporting.view.motion import bend_arm, locate_chain
from compplan.reporting.view.paint import LAST, Bytes, Lines, join_rows, paint_sizes, pick_point
from compplan.reporting.view.recording import PlanRecording, ViewSolid
from compplan.robot import Array

#: A line is drawn this near to its path, as a share of the path's extent but no finer than the second figure [m], and
#: its deviation as near where the greatest one is drawn as long as the third, as a share of the extent; its colour this
#: near, in tolerances.
SLACK, FINE, MAGNIFIED, SHADE = 2e-4, 5e-5, 0.1, 0.02
#: Points of a path that are drawn at most, rings of the promise, and corners of a ring.
POINTS, RINGS, CORNERS = 20_000, 300, 16
#: A corner of the part takes the colour of the path within this distance of it. [m]
NEAR = 0.025
PROMISE = "error_band"
#: A length of deviation.csv that reads 0 is below this. [m]
TINY = 1e-12
#: Greatest magnification, and the share of the tolerance below which a deviation is not worth one.
MOST_MAGNIFIED, SEEN = 500.0, 0.02
Rows = NDArray[np.int_] | slice | int
EVERY = slice(None)


@dataclass(frozen=True, eq=False)
class PlanScene:
    """A plan to be shown.

    Attributes:
        recording: The plan.
    """

    recording: PlanRecording

    @cached_property
    def ways(self) -> dict[str, str]:
        """What can be shown, with what it is called."""
        factor = self.recording.cell.facts.get("softer", "softer")
        softer = f"as planned, robot softer than modelled ({factor}, assumed)"
        names = {"uncorrected": "without correction", "planned": "as planned, robot as modelled", "softer": softer}
        known = {way: name for way, name in names.items() if np.isfinite(self.recording.deviation[way]).any()}
        if np.isfinite(self.recording.promise).any():
            known[PROMISE] = "95 % band of the true tip"
        return known

    @property
    def count(self) -> int:
        """Rows."""
        return len(self.recording.time)

    @cached_property
    def start(self) -> int:
        """First row of the cut."""
        cut = np.flatnonzero(self.recording.move == "cut")
        return int(cut[0]) if len(cut) else 0

    @cached_property
    def sizes(self) -> dict[str, Array]:
        """Deviation by way; NaN where it is not known. Shape (n,) each. [m]"""
        cut = self.recording.move == "cut"
        sizes = {
            way: np.where(cut, np.linalg.norm(deviation, axis=1), np.nan)
            for way, deviation in self.recording.deviation.items()
        }
        return {**sizes, PROMISE: self.recording.promise}

    def top(self, way: str) -> float:
        """Deviation that has the last colour: the greatest of this way, but at least twice the tolerance. [m]."""
        return max(LAST * self.recording.tolerance, float(np.nanmax(self.sizes[way], initial=0.0)))

    def magnification(self, way: str) -> float:
        """Tell by how much a way's deviation is magnified so that it is seen at once."""
        size = float(np.nanmax(self.sizes[way], initial=0.0))
        if size < SEEN * self.recording.tolerance:
            return 1.0
        extent = float(np.ptp(self.recording.tip[self.recording.move == "cut"], axis=0).max())
        wanted = MAGNIFIED * extent / size
        return float(np.clip(round(wanted), 1.0, MOST_MAGNIFIED))

    def worst(self, way: str, count: int = 5) -> list[int]:
        """List the rows where a way strays most, the worst first, no two of them near each other."""
        size = np.nan_to_num(self.sizes[way], nan=-1.0)
        apart = max(len(size) // 20, 1)
        found: list[int] = []
        for row in np.argsort(-size).tolist():
            if size[row] <= 0.0 or len(found) == count:
                break
            if all(abs(row - other) >= apart for other in found):
                found.append(row)
        return found

    @cached_property
    def length(self) -> Array:
        """Length of the path up to each row. Shape (n,). [m]."""
        return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(self.recording.tip, axis=0), axis=1))]

    def name_row(self, row: int, way: str) -> str:
        """Name a row as the list of worst places does."""
        return f"{_describe_length(self.sizes[way][row])} at {1e3 * self.length[row]:.4g}\u00a0mm"

    def place(self, way: str, magnify: float, rows: Rows = EVERY) -> Array:
        """Where the loaded tip is drawn at rows, its deviation magnified. Shape (k, 3), or (3,) of one row. [m]"""
        if way == PROMISE:
            return np.asarray(self.recording.tip[rows])
        return np.asarray(self.recording.tip[rows] + magnify * np.nan_to_num(self.recording.deviation[way][rows]))

    @cached_property
    def rows(self) -> NDArray[np.int_]:
        """Rows that are drawn: those without which the line would pass another row by more than a pixel or a shade."""
        tip, deviations = self.recording.tip, [np.nan_to_num(each) for each in self.recording.deviation.values()]
        extent = float(np.ptp(tip, axis=0).max())
        slack = max(SLACK * extent, FINE)
        greatest = max(float(np.linalg.norm(each, axis=1).max()) for each in deviations)
        strays = [MAGNIFIED * extent / max(greatest, 1e-9) * each for each in deviations]
        shades = [np.clip(np.nan_to_num(self.sizes[way]) / self.recording.tolerance, 0.0, LAST) for way in self.ways]
        signals = [*strays, *(slack / SHADE * shade for shade in shades)]
        return simplify_path(np.column_stack([tip, *signals]), slack, POINTS)

    def draw_path(self, way: str, magnify: float) -> Lines:
        """Draw the path of the loaded tip, coloured by its deviation against the tolerance."""
        colours = paint_sizes(self.sizes[way][self.rows], self.top(way) / LAST)
        return join_rows(self.place(way, magnify, self.rows), colours)

    def draw_wanted(self) -> Lines:
        """Draw the wanted path in grey."""
        nothing = np.full(len(self.rows), np.nan)
        return join_rows(self.recording.tip[self.rows], paint_sizes(nothing, 1.0))

    def draw_error_band(self, magnify: float) -> Lines:
        """Draw rings about the path that hold the true tip with 95 %, magnified."""
        radius, tip = self.recording.promise, self.recording.tip
        known = np.flatnonzero(np.isfinite(radius))
        rows = known[np.unique(np.linspace(0, len(known) - 1, RINGS).astype(int))] if len(known) else known
        along = np.gradient(tip, axis=0)[rows]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        aside = np.cross(along, np.where(np.abs(along[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
        aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)
        angle = np.linspace(0.0, 2 * np.pi, CORNERS + 1)[:, None, None]
        ring = np.cos(angle) * aside + np.sin(angle) * np.cross(along, aside)
        points = tip[rows] + magnify * radius[rows][:, None] * ring
        ends = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 3).astype(np.float32)
        colours = np.tile(paint_sizes(radius[rows], self.top(PROMISE) / LAST), (CORNERS, 1))
        return Lines(ends, np.repeat(colours[:, None], 2, axis=1))

    def paint_solid(self, solid: ViewSolid, way: str) -> Bytes:
        """Colour the corners of the part by the deviation of the path beside them. Shape (v, 4)."""
        from scipy.spatial import cKDTree

        size = self.sizes[way]
        told = np.flatnonzero(np.isfinite(size))
        own = np.round(255 * np.tile(solid.colour, (len(solid.vertices), 1))).astype(np.uint8)
        if not len(told):
            return own
        distance, nearest = cKDTree(self.recording.tip[told]).query(solid.vertices)
        near = distance < NEAR
        own[near, :3] = paint_sizes(size[told[nearest[near]]], self.top(way) / LAST)
        return own

    def pose_links(self, row: int, way: str, magnify: float) -> dict[str, Array]:
        """Locate every link, the arm bent so that its tip is where the path is drawn. Shape (4, 4) each. [m]"""
        record = self.recording
        tip = self.place(way, magnify, row)
        return locate_chain(record.cell, bend_arm(record.cell, record.q[row], tip))

    @cached_property
    def greatest_force(self) -> float:
        """Greatest force on the tool [N]."""
        return float(np.linalg.norm(self.recording.wrench[:, :3], axis=1).max(initial=0.0))

    def force_arrow(self, row: int, length: float) -> Array:
        """Draw the force on the tool: from its tip, the greatest one so long. Shape (2, 3). [m]"""
        scale = length / max(self.greatest_force, 1e-9)
        return np.stack([np.zeros(3), scale * self.recording.wrench[row, :3]])

    def find_row(self, time: float) -> int:
        """Return the row at a time [s]."""
        return int(np.clip(np.searchsorted(self.recording.time, time), 0, self.count - 1))

    def pick(self, origin: Array, direction: Array, way: str, magnify: float) -> int:
        """Return the row that a click means."""
        return pick_point(self.place(way, magnify), origin, direction)

    def tell(self, row: int) -> str:
        """Tell what is known of a row, as markdown: deviations, joints, force, posture."""
        record = self.recording
        lines = [f"**Waypoint {row}** of {self.count}, {record.move[row]}, {record.time[row]:.2f} s", ""]
        lines += ["| deviation | |", "|---|---|"]
        lines += [f"| {name} | {_describe_length(self.sizes[way][row])} |" for way, name in self.ways.items()]
        lines += [f"| tolerance | {format_length(record.tolerance)} |", "", "| joint | |", "|---|---|"]
        for joint, value in zip(record.cell.actuated, record.q[row], strict=True):
            said = format_length(float(value)) if joint.kind == "prismatic" else f"{np.degrees(value):.2f}\u00a0deg"
            lines.append(f"| {joint.name} | {said} |")
        force = ", ".join(format_number(float(value)) for value in record.wrench[row, :3])
        lines += ["", f"Force on the tool: {force} N (x, y, z of the base)"]
        x, y, z = (format_number(1e3 * float(value), 5) for value in record.tip[row])
        words = ", ".join(f"{name} {word}" for name, word in record.cell.facts.get("configuration", {}).items())
        return "\n".join([*lines, "", f"Wanted tip: {x}, {y}, {z} mm", "", f"Posture: {words or 'not known'}"])


def _describe_length(metres: float) -> str:
    return format_length(max(float(metres), TINY)) if np.isfinite(metres) else "not known here"
