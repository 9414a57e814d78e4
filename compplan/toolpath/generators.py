"""Toolpaths that are computed: circle, planar spiral and the frustum cone of incremental sheet forming (ISF).

All of them stand in the part frame with the tool axis along z: the circle and the spiral around its origin, the cone
hangs below its upper rim.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.optimize import brentq

from compplan.errors import InputError
from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.toolpath.toolpath import MOST_WAYPOINTS, Toolpath

#: Feeds that are taken for true. [m/s]
SLOWEST, FASTEST = 1e-9, 1e3


@dataclass(frozen=True)
class ParametricCurve:
    """Describe a curve that waypoints are put on.

    Args:
        point: Position at parameter u, 0 <= u <= end. (n,) -> (n, 3) [m]
        end: Greatest parameter.
        grid: Parameters, 0 and end among them, close enough that chords between them tell the length. Shape (m,).
        corners: Parameters between 0 and end, in order, where the curve bends and a waypoint is put. Shape (k,).

    """

    point: Callable[[Array], Array]
    end: float
    grid: Array
    corners: Array = field(default_factory=lambda: np.zeros(0))

    def lengths(self) -> Array:
        """Return the length of the curve up to each parameter of the grid. Shape (m,) [m]."""
        steps = np.linalg.norm(np.diff(self.point(self.grid), axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True)
class Pace:
    """How fast a curve is followed and how densely: a feed, and one of step and waypoints.

    Args:
        feed: Feed. [m/s]
        step: Distance along the curve between waypoints; rounded so that the last waypoint is the end. [m]
        waypoints: Number of waypoints.

    Raises:
        InputError: If not exactly one of step and waypoints is given, or a number is out of range.

    """

    feed: float
    step: float | None = None
    waypoints: int | None = None

    def __post_init__(self) -> None:
        density = [value for value in (self.step, self.waypoints) if value is not None]
        if len(density) != 1:
            raise InputError(f"{len(density)} of step and waypoints are given, expected exactly one")
        if density[0] <= 0.0:
            raise InputError("step and waypoints must be greater than 0")
        if not SLOWEST <= self.feed <= FASTEST:
            message = f"feed is {self.feed * 1e3:g} mm/s, expected {SLOWEST * 1e3:g} to {FASTEST * 1e3:g} mm/s"
            raise InputError(message)

    def count_waypoints(self, length: float) -> int:
        """Return the number of waypoints for a curve of this length [m].

        Raises:
            InputError: If they are more than can be planned.
        """
        count = float(self.waypoints) if self.waypoints is not None else 1.0 + length / (self.step or length)
        if not count <= MOST_WAYPOINTS:
            raise InputError(f"this makes {count:.3g} waypoints, at most {MOST_WAYPOINTS} can be planned")
        return max(2, round(count))


def walk_curve(curve: ParametricCurve, pace: Pace, *, approach: float = 0.0) -> Toolpath:
    """Put waypoints on a curve at equal distances along it, between its corners where it has any.

    Args:
        curve: The curve, part frame.
        pace: Feed and density.
        approach: Height above the ends, along the tool axis, that rapid moves come from and go to; 0: none. [m]

    Returns:
        The toolpath in the part frame.

    """
    lengths = curve.lengths()
    count = pace.count_waypoints(float(lengths[-1]))
    corners = np.interp(curve.corners, curve.grid, lengths)
    position = curve.point(np.interp(_place_stations(np.r_[0.0, corners, lengths[-1]], count), lengths, curve.grid))
    count = len(position)
    direction = np.array([0.0, 0.0, 1.0])
    rapid = np.zeros(count, dtype=bool)
    if approach > 0.0:
        lift = direction * approach
        position = np.vstack([position[0] + lift, position, position[-1] + lift])
        rapid = np.concatenate([[True, True], rapid[1:], [True]])
    return Toolpath(
        position,
        np.tile(direction, (len(position), 1)),
        np.where(rapid, 0.0, pace.feed),
        rapid,
        None,
        "part",
        "generator",
    )


def _place_stations(bounds: Array, count: int) -> Array:
    """Return lengths along a curve: its bounds, and between them about equal distances, `count` in all if enough.

    Args:
        bounds: Start, corners and end, as lengths along the curve, in order. Shape (k,). [m]
        count: Number of stations.

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


def _angles(turns: float) -> Array:
    return np.linspace(0.0, 2.0 * np.pi * turns, max(200, int(np.ceil(2000 * turns))) + 1)


def generate_circle(radius: float, pace: Pace, *, turns: float = 1.0, approach: float = 0.0) -> Toolpath:
    """Generate a circle in the xy plane that begins on the x axis.

    Args:
        radius: Radius. [m]
        pace: Feed and density.
        turns: Number of turns; negative: the other way round.
        approach: Height of approach and retract, see `walk_curve`. [m]

    """
    sense = np.sign(turns)

    def point(u: Array) -> Array:
        return np.column_stack([radius * np.cos(sense * u), radius * np.sin(sense * u), np.zeros(len(u))])

    grid = _angles(abs(turns))
    return walk_curve(ParametricCurve(point, grid[-1], grid), pace, approach=approach)


def generate_spiral(
    outer_radius: float,
    pace: Pace,
    *,
    inner_radius: float = 0.0,
    turns: float | None = None,
    length: float | None = None,
    approach: float = 0.0,
) -> Toolpath:
    """Generate an Archimedean spiral in the xy plane, from inside to outside, counter-clockwise seen from +z.

    r(u) = inner + (outer - inner) u / (2 pi turns); where `length` is given the turns follow from it.

    Args:
        outer_radius: Radius at the end. [m]
        pace: Feed and density.
        inner_radius: Radius at the start. [m]
        turns: Number of turns.
        length: Length of the spiral. [m]
        approach: Height of approach and retract, see `walk_curve`. [m]

    Raises:
        InputError: If not exactly one of turns and length is given, or no spiral has this length.

    """
    if (turns is None) == (length is None):
        raise InputError("both or none of turns and length are given, expected exactly one")
    span = outer_radius - inner_radius

    def curve(count: float) -> ParametricCurve:
        def point(u: Array) -> Array:
            r = inner_radius + span * u / (2.0 * np.pi * count)
            return np.column_stack([r * np.cos(u), r * np.sin(u), np.zeros(len(u))])

        grid = _angles(count)
        return ParametricCurve(point, grid[-1], grid)

    if turns is None:
        wanted = float(length or 0.0)
        if wanted <= abs(span) * 1.01:
            raise InputError(f"spiral length {wanted * 1e3:g} mm, must exceed the difference of its radii")
        # The spiral is longer than the circles it passes, pi (outer + inner) a turn: this bounds the turns.
        most = wanted / (np.pi * (outer_radius + inner_radius)) + 1.0
        turns = float(brentq(lambda count: curve(count).lengths()[-1] - wanted, 1e-3, most, xtol=1e-12))
    return walk_curve(curve(turns), pace, approach=approach)


def generate_cone(
    diameter: float,
    depth: float,
    wall_angle: float,
    pitch: float,
    pace: Pace,
    *,
    levels: bool = False,
    approach: float = 0.0,
) -> Toolpath:
    """Generate the frustum cone of ISF: from the upper rim down and inwards, counter-clockwise seen from +z.

    The rim lies in z = 0 around the origin. The waypoints are the tool tip; there is no allowance for the tool radius.

    Args:
        diameter: Diameter of the upper rim. [m]
        depth: Depth. [m]
        wall_angle: Angle of the wall against the horizontal. [rad]
        pitch: Depth of one turn. [m]
        pace: Feed and density.
        levels: Circles at constant depth joined by straight steps down the wall (z-level), else one helix.
        approach: Height of approach and retract, see `walk_curve`. [m]

    Raises:
        InputError: If the cone closes above its depth.

    """
    radius = 0.5 * diameter
    lowest = radius - depth / np.tan(wall_angle)
    if lowest <= 0.0:
        closes = radius * np.tan(wall_angle) * 1e3
        raise InputError(f"cone depth is {depth * 1e3:g} mm, must stay below {closes:g} mm where the cone closes")

    def ring(angle: Array, down: Array) -> Array:
        r = radius - down / np.tan(wall_angle)
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), -down])

    if not levels:
        turns = depth / pitch
        grid = _angles(turns)
        helix = ParametricCurve(lambda u: ring(u, u / grid[-1] * depth), grid[-1], grid)
        return walk_curve(helix, pace, approach=approach)
    count = max(1, round(depth / pitch))
    # u runs from 0 to 2 on every level: the first half steps down the wall at angle 0, the second goes round

    def level_point(u: Array) -> Array:
        level = np.minimum(np.floor(u / 2.0), count - 1)
        part = u - 2.0 * level
        down = (level + np.minimum(part, 1.0)) * depth / count
        return ring(2.0 * np.pi * np.maximum(part - 1.0, 0.0), down)

    one = np.concatenate([[0.0], np.linspace(1.0, 2.0, 2001)[:-1]])
    grid = np.concatenate([2.0 * level + one for level in range(count)] + [np.array([2.0 * count])])
    corners = np.arange(1.0, 2.0 * count)
    return walk_curve(ParametricCurve(level_point, 2.0 * count, grid, corners), pace, approach=approach)


class GeneratorTable(StrictTable):
    """Keys that every generator has in a job."""

    feed_mm_s: float = Field(gt=0.0)
    step_mm: float | None = Field(default=None, gt=0.0)
    waypoints: int | None = Field(default=None, ge=2)
    approach_mm: float = Field(default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _check(self) -> GeneratorTable:
        if (self.step_mm is None) == (self.waypoints is None):
            raise ValueError("needs exactly one of step_mm and waypoints")
        return self

    def pace(self) -> Pace:
        """Return feed and density in SI."""
        return Pace(self.feed_mm_s * 1e-3, None if self.step_mm is None else self.step_mm * 1e-3, self.waypoints)

    def generate(self) -> Toolpath:
        """Generate the toolpath; an InputError where the parameters contradict each other."""
        raise NotImplementedError


class CircleTable(GeneratorTable):
    """A circle, see `generate_circle`."""

    generator: Literal["circle"]
    radius_mm: float = Field(gt=0.0)
    turns: float = 1.0

    def generate(self) -> Toolpath:
        """Generate the circle."""
        return generate_circle(self.radius_mm * 1e-3, self.pace(), turns=self.turns, approach=self.approach_mm * 1e-3)


class SpiralTable(GeneratorTable):
    """A planar spiral, see `generate_spiral`."""

    generator: Literal["spiral"]
    outer_radius_mm: float = Field(gt=0.0)
    inner_radius_mm: float = Field(default=0.0, ge=0.0)
    turns: float | None = Field(default=None, gt=0.0)
    length_mm: float | None = Field(default=None, gt=0.0)

    def generate(self) -> Toolpath:
        """Generate the spiral."""
        return generate_spiral(
            self.outer_radius_mm * 1e-3, self.pace(), inner_radius=self.inner_radius_mm * 1e-3, turns=self.turns,
            length=None if self.length_mm is None else self.length_mm * 1e-3,
            approach=self.approach_mm * 1e-3,
        )  # fmt: skip


class ConeTable(GeneratorTable):
    """A frustum cone, see `generate_cone`."""

    generator: Literal["isf_cone"]
    diameter_mm: float = Field(gt=0.0)
    depth_mm: float = Field(gt=0.0)
    wall_angle_deg: float = Field(gt=0.0, lt=90.0)
    pitch_mm: float = Field(gt=0.0)
    path: Literal["helical", "z_level"] = "helical"

    def generate(self) -> Toolpath:
        """Generate the cone."""
        return generate_cone(
            self.diameter_mm * 1e-3, self.depth_mm * 1e-3, float(np.radians(self.wall_angle_deg)), self.pitch_mm * 1e-3,
            self.pace(), levels=self.path == "z_level", approach=self.approach_mm * 1e-3,
        )  # fmt: skip


GENERATORS: dict[str, type[GeneratorTable]] = {"circle": CircleTable, "spiral": SpiralTable, "isf_cone": ConeTable}
