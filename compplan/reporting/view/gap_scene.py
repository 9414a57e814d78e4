"""Measured poses of a diagnosis as a scene of plain data: an arrow a pose, coloured by what explains it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from compplan.io.quantities import format_length, format_percent
from compplan.reporting.scenes import choose_magnification
from compplan.reporting.view.motion import locate_chain
from compplan.reporting.view.paint import Lines, paint_names, pick_point
from compplan.reporting.view.recording import GapRecording
from compplan.robot import Array

#: Length and spread of an arrow's head, as shares of the arrow.
HEAD, SPREAD = 0.25, 0.1


@dataclass(frozen=True, eq=False)
class GapScene:
    """Measured poses to be shown.

    Attributes:
        recording: The poses.
    """

    recording: GapRecording

    @property
    def ways(self) -> dict[str, str]:
        """What can be shown, with what it is called."""
        return {way: f"gap, {way}" for way in self.recording.gap}

    @property
    def count(self) -> int:
        """Poses."""
        return len(self.recording.row)

    @cached_property
    def magnification(self) -> float:
        """By how much arrows are magnified at first."""
        gap = next(iter(self.recording.gap.values()))
        known = np.isfinite(gap).all(axis=1) & np.isfinite(self.recording.point).all(axis=1)
        return choose_magnification(self.recording.point[known], gap[known]) if known.any() else 1.0

    @cached_property
    def legend(self) -> dict[str, str]:
        """Colour of every cause."""
        return paint_names(self.recording.cause)[1]

    def draw_arrows(self, way: str, magnify: float) -> Lines:
        """Draw the gap of every pose as an arrow from the measured point, coloured by what explains most of it."""
        start, arrow = self.recording.point, magnify * self.recording.gap[way]
        known = np.isfinite(start).all(axis=1) & np.isfinite(arrow).all(axis=1)
        start, arrow, colours = start[known], arrow[known], paint_names(self.recording.cause)[0][known]
        aside = np.cross(arrow, np.where(np.abs(arrow[:, 2:]) < 0.9 * np.linalg.norm(arrow, axis=1)[:, None],
                                         [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))  # fmt: skip
        aside *= SPREAD * np.linalg.norm(arrow, axis=1)[:, None] / np.maximum(
            np.linalg.norm(aside, axis=1, keepdims=True), 1e-12)  # fmt: skip
        tip, neck = start + arrow, start + (1.0 - HEAD) * arrow
        pairs = ((start, tip), (tip, neck + aside), (tip, neck - aside))
        ends = np.concatenate([np.stack(pair, axis=1) for pair in pairs])
        return Lines(ends.astype(np.float32), np.repeat(np.tile(colours, (3, 1))[:, None], 2, axis=1))

    def pose_links(self, pose: int) -> dict[str, Array]:
        """Locate every link at a pose. Shape (4, 4) each. [m]"""
        return locate_chain(self.recording.cell, self.recording.q[pose])

    def pick(self, origin: Array, direction: Array) -> int:
        """Return the pose that a click means."""
        return pick_point(self.recording.point, origin, direction)

    def tell(self, pose: int) -> str:
        """Tell what is known of a pose, as markdown."""
        record = self.recording
        lines = [f"**Row {record.row[pose]}** of the log, run {record.run[pose]}", "", "| gap | |", "|---|---|"]
        for way, gap in record.gap.items():
            size = float(np.linalg.norm(gap[pose]))
            lines.append(f"| {way} | {format_length(size) if np.isfinite(size) else 'not measured'} |")
        cause, share = record.cause[pose], format_percent(float(record.share[pose]))
        said = f"{cause}: {share} of it"
        if cause == "not explained":
            said = "No named cause explains a quarter of it here."
        return "\n".join([*lines, "", said])
