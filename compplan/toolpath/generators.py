"""Generated toolpaths: circle, planar spiral and the frustum cone of incremental sheet forming (ISF).

All are in the part frame, around its origin; the upper rim of the cone is at z = 0.
Each is a section of a job; a new one is a model with `generate` and one line of `GENERATORS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.optimize import brentq

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.toolpath import MOST_WAYPOINTS, Toolpath

#: Greatest number of turns.
MOST_TURNS = 1e4
#: Position at parameter u of a curve. (n,) -> (n, 3) [m]
Curve = Callable[[Array], Array]
NO_CORNERS: Array = np.zeros(0)


class GeneratorTable(StrictTable):
    """Keys of every generator: feed and density of waypoints; the tool axis is z of the part frame.

    approach_mm is the height above both ends, along the tool axis, of the rapid approach and retract; 0: none.
    """

    feed_mm_s: float = Field(gt=0.0)
    step_mm: float | None = Field(default=None, gt=0.0)
    waypoints: int | None = Field(default=None, ge=2)
    approach_mm: float = Field(default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _check(self) -> GeneratorTable:
        if (self.step_mm is None) == (self.waypoints is None):
            raise ValueError("needs exactly one of step_mm and waypoints")
        return self

    def generate(self) -> Toolpath:
        """Generate the toolpath; raise an InputError if the parameters are inconsistent."""
        raise NotImplementedError

    def _count_waypoints(self, length: float) -> int:
        """Return the number of waypoints for a curve of this length [m]."""
        step = length if self.step_mm is None else self.step_mm * 1e-3
        count = 1.0 + length / step if self.waypoints is None else float(self.waypoints)
        if not count <= MOST_WAYPOINTS:
            raise InputError(f"this makes {count:.3g} waypoints, at most {MOST_WAYPOINTS} are planned; raise step_mm")
        return max(2, round(count))

    def _place_waypoints(self, curve: Curve, grid: Array, corners: Array = NO_CORNERS) -> Toolpath:
        """Place waypoints on a curve, equidistant between its ends and corners (k,).

        The grid (m,) holds parameters dense enough that the sum of the chords is the length of the curve.
        """
        lengths = _measure(curve, grid)
        if not lengths[-1] > 0.0:
            raise InputError("the generator makes a path without length")
        count = self._count_waypoints(float(lengths[-1]))
        bounds = np.r_[0.0, np.interp(corners, grid, lengths), lengths[-1]]
        position = curve(np.interp(_place_stations(bounds, count), lengths, grid))
        direction = np.array([0.0, 0.0, 1.0])
        rapid = np.zeros(len(position), dtype=bool)
        if self.approach_mm > 0.0:
            lift = direction * (self.approach_mm * 1e-3)
            position = np.vstack([position[0] + lift, position, position[-1] + lift])
            rapid = np.concatenate([[True, True], rapid[1:], [True]])
        axes = np.tile(direction, (len(position), 1))
        return Toolpath(position, axes, np.where(rapid, 0.0, self.feed_mm_s * 1e-3), rapid, source="generator")


def _measure(curve: Curve, grid: Array) -> Array:
    """Return the length of a curve up to each parameter of a grid. Shape (m,) [m]."""
    return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve(grid), axis=0), axis=1))]


def _place_stations(bounds: Array, count: int) -> Array:
    """Return `count` lengths along a curve [m], nearly equidistant, that include its bounds (more if needed for them).

    `bounds` are start, corners and end, in order.
    """
    spans = np.diff(bounds)
    ideal = spans / spans.sum() * max(count - 1, len(spans))
    pieces = np.maximum(np.floor(ideal), 1.0).astype(int)
    missing = count - 1 - int(pieces.sum())
    if missing > 0:
        pieces[np.argsort(pieces - ideal)[:missing]] += 1
    elif missing < 0:
        pieces[np.argsort(-pieces)[:-missing]] -= 1
        pieces = np.maximum(pieces, 1)
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(bounds, bounds[1:], pieces.tolist(), strict=False)]
    return np.concatenate([*parts, bounds[-1:]])


def _refuse_turns(turns: float) -> None:
    if turns > MOST_TURNS:
        raise InputError(f"this makes {turns:.3g} turns, at most {MOST_TURNS:g} are generated")


def _angles(turns: float) -> Array:
    _refuse_turns(turns)
    return np.linspace(0.0, 2.0 * np.pi * turns, max(200, int(np.ceil(2000 * turns))) + 1)


class CircleTable(GeneratorTable):
    """Circle in the xy plane that starts on the x axis, counter-clockwise about +z; clockwise for turns < 0."""

    generator: Literal["circle"] = "circle"
    radius_mm: float = Field(gt=0.0)
    turns: float = 1.0

    def generate(self) -> Toolpath:
        """Generate the circle."""
        radius, sense = self.radius_mm * 1e-3, np.sign(self.turns)

        def circle(u: Array) -> Array:
            return np.column_stack([radius * np.cos(sense * u), radius * np.sin(sense * u), np.zeros(len(u))])

        return self._place_waypoints(circle, _angles(abs(self.turns)))


class SpiralTable(GeneratorTable):
    """Archimedean spiral in the xy plane, from inside to outside, counter-clockwise about +z.

    r(u) = inner + (outer - inner) u / (2 pi turns); the turns follow from length_mm if it is given.
    """

    generator: Literal["spiral"] = "spiral"
    outer_radius_mm: float = Field(gt=0.0)
    inner_radius_mm: float = Field(default=0.0, ge=0.0)
    turns: float | None = Field(default=None, gt=0.0)
    length_mm: float | None = Field(default=None, gt=0.0)

    def generate(self) -> Toolpath:
        """Generate the spiral."""
        if (self.turns is None) == (self.length_mm is None):
            raise InputError("both or none of turns and length are given, expected exactly one")
        inner, outer = self.inner_radius_mm * 1e-3, self.outer_radius_mm * 1e-3

        def spiral(turns: float) -> Curve:
            def point(u: Array) -> Array:
                r = inner + (outer - inner) * u / (2.0 * np.pi * turns)
                return np.column_stack([r * np.cos(u), r * np.sin(u), np.zeros(len(u))])

            return point

        turns = self.turns
        if turns is None:
            length = (self.length_mm or 0.0) * 1e-3
            if length <= abs(outer - inner) * 1.01:
                raise InputError(f"spiral length {length * 1e3:g} mm, must exceed the difference of its radii")
            if length < _measure(spiral(1e-3), _angles(1e-3))[-1]:
                raise InputError(f"spiral length {length * 1e3:g} mm, must be more than a thousandth of a turn")
            # Upper bound of the turns: a turn of the spiral is longer than a circle of mean radius, pi (outer + inner).
            most = length / (np.pi * (outer + inner)) + 1.0
            turns = float(brentq(lambda n: _measure(spiral(n), _angles(n))[-1] - length, 1e-3, most, xtol=1e-12))
        return self._place_waypoints(spiral(turns), _angles(turns))


class ConeTable(GeneratorTable):
    """Frustum cone of ISF, from the upper rim down and inwards, counter-clockwise about +z.

    The rim is a circle around the origin at z = 0, wall_angle_deg is the angle of the wall to the horizontal. pitch_mm
    is the depth of one turn of the helix, or of one circle; circles are joined by straight steps down the wall
    (z_level). The waypoints are the tool tip, without compensation of the tool radius.
    """

    generator: Literal["isf_cone"] = "isf_cone"
    diameter_mm: float = Field(gt=0.0)
    depth_mm: float = Field(gt=0.0)
    wall_angle_deg: float = Field(gt=0.0, lt=90.0)
    pitch_mm: float = Field(gt=0.0)
    path: Literal["helical", "z_level"] = "helical"

    def generate(self) -> Toolpath:
        """Generate the cone."""
        radius, depth = 0.5 * (self.diameter_mm * 1e-3), self.depth_mm * 1e-3
        slope = np.tan(np.radians(self.wall_angle_deg))
        if radius - depth / slope <= 0.0:
            closes = radius * slope * 1e3
            raise InputError(f"cone depth is {depth * 1e3:g} mm, must stay below {closes:g} mm where the cone closes")

        def ring(angle: Array, down: Array) -> Array:
            r = radius - down / slope
            return np.column_stack([r * np.cos(angle), r * np.sin(angle), -down])

        turns = depth / (self.pitch_mm * 1e-3)
        if self.path == "helical":
            grid = _angles(turns)
            return self._place_waypoints(lambda u: ring(u, u / grid[-1] * depth), grid)
        count = max(1, round(turns))

        def level_point(u: Array) -> Array:
            """Return points at u, 2 per level: the step down the wall at angle 0, then from 1 on the circle."""
            level = np.minimum(np.floor(u / 2.0), count - 1)
            part = u - 2.0 * level
            down = (level + np.minimum(part, 1.0)) * depth / count
            return ring(2.0 * np.pi * np.maximum(part - 1.0, 0.0), down)

        one = np.concatenate([[0.0], np.linspace(1.0, 2.0, 2001)[:-1]])
        _refuse_turns(turns)
        grid = np.concatenate([2.0 * level + one for level in range(count)] + [np.array([2.0 * count])])
        return self._place_waypoints(level_point, grid, np.arange(1.0, 2.0 * count))


GENERATORS: dict[str, type[GeneratorTable]] = {"circle": CircleTable, "spiral": SpiralTable, "isf_cone": ConeTable}
