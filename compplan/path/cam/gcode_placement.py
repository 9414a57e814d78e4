"""Where the coordinates of a G-code program stand in the part frame: rotations, scales, mirrors, tilted planes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.path.cam.arcs import Arc, Point, combine, dot

Rows = tuple[Point, Point, Point]
IDENTITY: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Placement:
    """Hold an affine map: point -> rows point + step.

    Args:
        rows: Rows of its matrix: a rotation, times a scale for each axis, perhaps mirrored.
        step: Its shift. [mm]

    """

    rows: Rows = IDENTITY
    step: Point = (0.0, 0.0, 0.0)

    def place(self, point: Point) -> Point:
        """Return where a point comes to lie [mm]."""
        return combine(1.0, self.turn(point), 1.0, self.step)

    def turn(self, direction: Point) -> Point:
        """Return what becomes of a direction; its length is scaled too."""
        one, two, three = self.rows
        return dot(one, direction), dot(two, direction), dot(three, direction)

    def undo(self, point: Point) -> Point:
        """Return the point that is placed here [mm]."""
        return as_point(np.linalg.solve(np.array(self.rows), np.subtract(point, self.step)))

    def then(self, outer: Placement) -> Placement:
        """Return the map that does this one first and another one after it."""
        rows = np.array(outer.rows) @ np.array(self.rows)
        return Placement((as_point(rows[0]), as_point(rows[1]), as_point(rows[2])), outer.place(self.step))

    def measure_scale(self) -> float | None:
        """Return by what lengths grow, negative where it mirrors; None where not all directions grow alike."""
        gram = np.array(self.rows) @ np.array(self.rows).T
        if not np.allclose(gram, gram[0, 0] * np.eye(3), rtol=1e-9, atol=1e-12):
            return None
        return math.copysign(math.sqrt(gram[0, 0]), float(np.linalg.det(np.array(self.rows))))

    def place_arc(self, arc: Arc) -> Arc | None:
        """Return what becomes of an arc; None where it would be one of an ellipse."""
        scale = self.measure_scale()
        if scale is None:
            return None
        size, sense = abs(scale), math.copysign(1.0, scale)
        return replace(
            arc, centre=self.place(arc.centre), first=combine(1.0 / size, self.turn(arc.first), 0.0, arc.first),
            normal=combine(1.0 / size, self.turn(arc.normal), 0.0, arc.normal), radius=arc.radius * size,
            end_radius=arc.end_radius * size, sweep=arc.sweep * sense, rise=arc.rise * size,
        )  # fmt: skip


def as_point(numbers: Sequence[float] | np.ndarray) -> Point:
    """Return three numbers as a point, without negative zeros."""
    return float(numbers[0]) + 0.0, float(numbers[1]) + 0.0, float(numbers[2]) + 0.0


def turn_about(centre: Point, turn: Rotation) -> Placement:
    """Return a rotation about a point [mm]."""
    matrix = turn.as_matrix()
    rows = as_point(matrix[0]), as_point(matrix[1]), as_point(matrix[2])
    return Placement(rows, combine(1.0, centre, -1.0, as_point(matrix @ np.array(centre))))


def scale_about(centre: Point, scales: Point) -> Placement:
    """Return a scaling of each axis about a point [mm]; negative scales mirror."""
    rows = (scales[0], 0.0, 0.0), (0.0, scales[1], 0.0), (0.0, 0.0, scales[2])
    return Placement(rows, as_point([centre[axis] * (1.0 - scales[axis]) for axis in range(3)]))


def tilt_plane(origin: Point, turn: Rotation, zero: Point) -> Placement:
    """Return a tilted work plane: its coordinates count from `origin`, which itself counts from the program's zero.

    Args:
        origin: Origin of the plane. [mm]
        turn: Rotation of its axes, as seen from the part.
        zero: Where the program's zero stands. [mm]

    """
    turned = turn_about(zero, turn)
    return replace(turned, step=combine(1.0, turned.step, 1.0, origin))
