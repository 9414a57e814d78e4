"""Shape of a rotating cutter and its engagement: slices of its edge, and angles at which they touch the stock.

At the end of a move, the part of the cutter's surface that moves outwards is compared with the stock before the move.
The angle u counts from the travel (its part across the axis) to the left, viewed down the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array

#: Rows that are computed at once.
ROWS = 512
#: Radius around the tip within which an edge cuts at all angles, half of a usual feed a tooth (assumed). [m]
TIP = 3e-5
#: Slices of the flat bottom, of a corner (per quarter turn) and of a drill's point.
BOTTOM_SLICES, CORNER_SLICES, POINT_SLICES = 4, 18, 5
#: Distance from the cutter's side within which material counts as removed: a wall is not cut twice. [m]
TOUCHING = 1e-8


@dataclass(frozen=True)
class Cutter:
    """A solid of revolution about the tool axis; its tip is the lowest point of the axis."""

    radius: float  #: Radius of the cutting part. [m]
    flute: float  #: Length of the cutting edges along the axis, from the tip. [m]
    corner: float = 0.0  #: Radius of the corner: 0 is a flat end mill, `radius` a ball end mill. [m]
    point: float = float(np.pi)  #: Full angle of a drill's point; pi is flat. [rad]
    pieces: int = 1  #: Slices of the side.

    def height(self, distance: Array) -> Array:
        """Return the height of the cutter's lower surface above its tip, at a distance from its axis. [m]

        Infinite beyond the radius.
        """
        inside = distance <= self.radius + TOUCHING
        if self.even:
            return np.where(inside, 0.0, np.inf)
        ring = np.clip(distance - (self.radius - self.corner), 0.0, self.corner)
        height = self.corner - np.sqrt(np.maximum(self.corner**2 - ring**2, 0.0))
        if self.point < np.pi:
            height = np.minimum(distance, self.radius) / np.tan(0.5 * self.point)
        return np.where(inside, height, np.inf)

    @property
    def even(self) -> bool:
        """Whether the lower surface is a plane, as for a flat end mill."""
        return self.corner == 0.0 and self.point >= np.pi

    @property
    def round(self) -> bool:
        """Whether the lower surface is a hemisphere."""
        return self.corner >= self.radius

    @property
    def end(self) -> float:
        """Height above the tip at which the cylindrical side begins. [m]"""
        return float(self.height(np.array(self.radius)))

    @cached_property
    def slices(self) -> Slices:
        """The cutting edge from the tip up to the end of the flute."""
        flat = self.radius - self.corner
        if self.point < np.pi:
            rho = np.linspace(0.0, self.radius, POINT_SLICES + 1)
            knots = np.column_stack([rho, self.height(rho)])
        elif self.corner > 0.0:
            turn = np.linspace(0.0, 0.5 * np.pi, CORNER_SLICES + 1)
            knots = np.column_stack([flat + self.corner * np.sin(turn), self.corner * (1.0 - np.cos(turn))])
        else:
            knots = np.array([[flat, 0.0]])
        if flat > 1e-3 * self.radius and self.point >= np.pi:
            rho = np.linspace(0.0, flat, BOTTOM_SLICES + 1)[:-1]
            knots = np.vstack([np.column_stack([rho, np.zeros_like(rho)]), knots])
        if self.flute > knots[-1, 1]:
            up = np.linspace(knots[-1, 1], self.flute, self.pieces + 1)[1:]
            knots = np.vstack([knots, np.column_stack([np.full(self.pieces, self.radius), up])])
        return Slices(knots)

    @cached_property
    def rounded(self) -> NDArray[np.bool_]:
        """Slices of the corner. Shape (k,)."""
        edge = self.slices
        return np.asarray((edge.normal[:, 1] < -1e-9) & (edge.normal[:, 0] > 1e-9) & (self.corner > 0.0))

    @cached_property
    def lower(self) -> NDArray[np.bool_]:
        """Slices of bottom and corner of a mill; none for a drill. Shape (k,)."""
        return np.asarray((self.slices.normal[:, 1] < -1e-9) & (self.point >= np.pi))

    def edge_point(self, number: NDArray[np.int_], share: Array) -> tuple[Array, Array]:
        """Return points of the edge at shares of slices: distance from the axis, height above the tip. (s,) [m]"""
        knots = self.slices.knots
        rho = knots[number, 0] + share * (knots[number + 1, 0] - knots[number, 0])
        height = knots[number, 1] + share * (knots[number + 1, 1] - knots[number, 1])
        if self.corner > 0.0:  # chords of the corner lie inside it
            turn = np.arccos(np.clip(1.0 - knots[:, 1] / self.corner, 0.0, 1.0))
            angle = turn[number] + share * (turn[number + 1] - turn[number])
            rho = np.where(self.rounded[number], self.radius - self.corner + self.corner * np.sin(angle), rho)
            height = np.where(self.rounded[number], self.corner * (1.0 - np.cos(angle)), height)
        return rho, height


@dataclass(frozen=True)
class Slices:
    """The cutting edge as straight slices between knots (distance from the axis, height above the tip)."""

    knots: Array  #: Shape (k + 1, 2). [m]

    def __len__(self) -> int:
        return len(self.knots) - 1

    @property
    def radius(self) -> Array:
        """Distance from the axis, middle of each slice. Shape (k,). [m]"""
        return 0.5 * (self.knots[1:, 0] + self.knots[:-1, 0])

    @property
    def low(self) -> Array:
        """Lower end above the tip. Shape (k,). [m]"""
        return self.knots[:-1, 1]

    @property
    def rise(self) -> Array:
        """Extent along the axis. Shape (k,). [m]"""
        return np.diff(self.knots[:, 1])

    @property
    def length(self) -> Array:
        """Length of the edge, without helix. Shape (k,). [m]"""
        return np.linalg.norm(np.diff(self.knots, axis=0), axis=1)

    @property
    def normal(self) -> Array:
        """Outward normal: away from the axis, along the axis. Shape (k, 2)."""
        step = np.diff(self.knots, axis=0)
        return np.column_stack([step[:, 1], -step[:, 0]]) / self.length[:, None]


@dataclass(frozen=True)
class Engagement:
    """Engagement of a cutter at n waypoints; k slices of its edge, m angles."""

    cutter: Cutter  #: The cutter.
    depth: NDArray[np.float32]  #: Engaged share of the slice (k) in the bin at the angle (m), 0 to 1. Shape (n, k, m).
    travel: Array  #: Direction of the move that ends at the waypoint: across the axis, along it. Shape (n, 2).
    #: Rotation of the axis per length of travel: along the travel, to its left; None for a fixed axis. Shape (n, 2).
    #: [rad/m]
    turning: Array | None = None

    def __len__(self) -> int:
        return len(self.depth)

    def take(self, rows: NDArray[np.int_]) -> Engagement:
        """Return the engagement at some waypoints."""
        turning = None if self.turning is None else self.turning[rows]
        return Engagement(self.cutter, self.depth[rows], self.travel[rows], turning)

    def speed(self, angle: Array, rows: NDArray[np.int_] | slice = slice(None)) -> Array:
        """Return the outward speed of middles of slices, negative inwards, as a share of the feed. Shape (n, k, m)."""
        edge, turning = self.cutter.slices, None if self.turning is None else self.turning[rows]
        middle = np.column_stack([edge.radius, edge.low + 0.5 * edge.rise])
        return surface_speed(edge.normal, middle, self.travel[rows], angle, turning)

    def lower_speeds(self, angle: Array, rows: NDArray[np.int_] | slice) -> tuple[Array, Array]:
        """Return the outward speeds of both ends of each slice of the lower surface. Shapes (n, c, m)."""
        cutter, turning = self.cutter, None if self.turning is None else self.turning[rows]
        knots = cutter.slices.knots[np.append(cutter.lower, False) | np.append(False, cutter.lower)]
        turn = np.arccos(np.clip(1.0 - knots[:, 1] / max(cutter.corner, 1e-12), 0.0, 1.0))
        normal = np.column_stack([np.sin(turn), -np.cos(turn)])
        speed = surface_speed(normal, knots, self.travel[rows], angle, turning)
        return speed[:, :-1], speed[:, 1:]

    def engaged_speed(self, angle: Array, rows: NDArray[np.int_] | slice) -> tuple[Array, Array]:
        """Return the outward speed of the engaged part of each slice, and its change across a bin.

        The angles are those of the bins; the change is computed for the lower surface of a mill. The engaged part of a
        partly engaged slice begins where the slice begins to move outwards, or at the end next to the neighbour with
        the larger engaged share. Shapes (n, k, m).
        """
        speed = np.maximum(self.speed(angle, rows), 0.0)
        step = np.ones(speed.shape)
        lower = self.cutter.lower
        if not lower.any():
            return speed, step
        low, high = self.lower_speeds(angle, rows)
        begin, end = outward_span(low, high)
        depth = self.depth[rows]
        around = np.pad(depth, ((0, 0), (1, 1), (0, 0)))
        below, above = around[:, :-2][:, lower], around[:, 2:][:, lower]
        share = depth[:, lower]
        from_end, from_begin = above > below, (above < below) | (above == 0.0)
        middle = np.where(from_end, end - 0.5 * share, np.where(from_begin, begin + 0.5 * share, 0.5 * (begin + end)))
        speed[:, lower] = np.maximum(low + (high - low) * np.clip(middle, begin, end), 0.0)
        around_axis = 0.25 * (np.roll(low + high, -1, axis=2) - np.roll(low + high, 1, axis=2))
        crosses = low < -1e-9  # the speed is zero in the slice or in the next lower one
        crosses[:, 1:] |= crosses[:, :-1].copy()
        step[:, lower] = np.where(crosses, np.abs(high - low), 0.0) + np.abs(around_axis)
        return speed, step

    def curvature(self, angle: Array, rows: NDArray[np.int_] | slice = slice(None)) -> Array:
        """Return the curvature of a corner's surface along the travel, times its share along the surface squared.

        Neglected for the side: its relative effect there is feed a tooth over radius. Shape (n, k, m). [1/m]
        """
        edge, travel = self.cutter.slices, self.travel[rows]
        bent = np.zeros((len(travel), len(edge), len(angle)))
        rounded = self.cutter.rounded
        if not rounded.any():
            return bent
        out, up = edge.normal[rounded, :1], edge.normal[rounded, 1:]
        inner, outer = edge.knots[:-1, :1][rounded], edge.knots[1:, :1][rounded]
        tip = inner < TIP  # the mean of 1 / radius over a slice
        mean = (np.log(outer / np.maximum(inner, TIP)) + tip) / (outer - inner)
        along = travel[:, 1, None, None] * out - travel[:, 0, None, None] * (up * np.cos(angle))
        bent[:, rounded] = travel[:, 0, None, None] ** 2 * (out * mean * np.sin(angle) ** 2)
        bent[:, rounded] += along**2 / self.cutter.corner
        return bent

    @property
    def angles(self) -> Array:
        """Middle of each bin. Shape (m,). [rad]"""
        return middle_angles(self.depth.shape[2])

    @cached_property
    def touches(self) -> NDArray[np.bool_]:
        """Waypoints where the cutter is in material. Shape (n,)."""
        return np.asarray(self.depth.any(axis=(1, 2)))

    @cached_property
    def axial(self) -> Array:
        """Axial depth: from the lowest to the highest engaged point of the edge. Shape (n,). [m]"""
        edge = self.cutter.slices
        whole = self.depth.max(axis=2)
        top = np.where(whole > 0.0, edge.low + whole * edge.rise, -np.inf).max(axis=1)
        bottom = np.where(whole > 0.0, edge.low, np.inf).min(axis=1)
        return np.where(self.touches, np.maximum(top - bottom, 0.0), 0.0)

    @cached_property
    def section(self) -> Array:
        """Area swept through material: removed volume per length of path. Shape (n,). [m^2]"""
        edge = self.cutter.slices
        turn, area = 2.0 * np.pi / self.depth.shape[2], edge.radius * edge.length
        parts = [np.zeros(0)]
        for first in range(0, len(self), ROWS):
            rows = slice(first, first + ROWS)
            speed = self.engaged_speed(self.angles, rows)[0]
            parts.append(turn * np.einsum("nkm,nkm,k->n", self.depth[rows], speed, area))
        return np.concatenate(parts)

    @cached_property
    def radial(self) -> Array:
        """Radial width: extent of the engaged surface across the travel. Shape (n,). [m]"""
        left, right = self._sides()
        return np.where(self.touches, np.maximum(left - right, 0.0), 0.0)

    @cached_property
    def arc(self) -> Array:
        """First and last engaged angle from the travel to the left, NaN in the air. Shape (n, 2). [rad]"""
        weight = self.depth.max(axis=1)
        half = np.pi / self.depth.shape[2]
        angle = (self.angles + np.pi) % (2.0 * np.pi) - np.pi
        order = np.argsort(angle)
        some = weight[:, order] > 0.0
        first = some.argmax(axis=1)
        last = some.shape[1] - 1 - some[:, ::-1].argmax(axis=1)
        rows = np.arange(len(self))
        share = weight[:, order] / np.maximum(weight.max(axis=1, keepdims=True), 1e-30)
        lowest = angle[order][first] + half - 2.0 * half * share[rows, first]
        highest = angle[order][last] - half + 2.0 * half * share[rows, last]
        arc = np.column_stack([lowest, highest])
        arc[~self.touches] = np.nan
        return arc

    def _sides(self) -> tuple[Array, Array]:
        """Return the reach of the engaged surface to the left and to the right. Shapes (n,). [m]"""
        half = np.pi / self.depth.shape[2]
        knots, here = self.cutter.slices.knots[:, 0], self.depth
        whole = here.max(axis=2, keepdims=True)
        radius = knots[:-1, None] + whole * np.diff(knots)[:, None]
        # the engaged part of a partly engaged bin is next to its engaged neighbour
        gap = 2.0 * half * (1.0 - here / np.maximum(whole, 1e-30))
        before, after = np.roll(here, 1, axis=2), np.roll(here, -1, axis=2)
        start = np.sin(self.angles - half + np.where(after > before, gap, 0.0))
        end = np.sin(self.angles + half - np.where(before > after, gap, 0.0))
        left = np.where(here > 0.0, radius * np.maximum(start, end), -np.inf)
        right = np.where(here > 0.0, radius * np.minimum(start, end), np.inf)
        return left.max(axis=(1, 2)), right.min(axis=(1, 2))


def middle_angles(count: int) -> Array:
    """Return the middle of each of `count` bins of a turn. [rad]"""
    return np.asarray((np.arange(count) + 0.5) * (2.0 * np.pi / count), dtype=np.float64)


def surface_speed(normal: Array, place: Array, travel: Array, angle: Array, turning: Array | None) -> Array:
    """Return the outward speed of points of the surface, as a share of the feed. Shape (n, k, m).

    An axis z that rotates by w per length of travel moves a point at rho u + h z by h w - rho (w u) z.

    Args:
        normal: Outward normal: away from the axis, along it. Shape (k, 2).
        place: Distance from the axis and height above the tip. Shape (k, 2). [m]
        travel: Direction of travel: across the axis, along it. Shape (n, 2).
        angle: Angle u from the travel. Shape (m,). [rad]
        turning: w along the travel and to its left. Shape (n, 2). [rad/m]
    """
    out, up = normal[:, :1], normal[:, 1:]
    speed = travel[:, 0, None, None] * (out * np.cos(angle)) + travel[:, 1, None, None] * up
    if turning is not None:
        lever = out * place[:, 1:] - up * place[:, :1]
        for way, side in zip(turning.T, (np.cos(angle), np.sin(angle)), strict=True):
            speed = speed + way[:, None, None] * (lever * side)
    return np.asarray(speed)


def outward_span(low: Array, high: Array) -> tuple[Array, Array]:
    """Return the range of shares along a slice in which it moves outwards, from the speeds of its ends."""
    zero = np.clip(low / np.where(low == high, 1.0, low - high), 0.0, 1.0)
    return np.where(low > 0.0, 0.0, np.where(high > 0.0, zero, 0.0)), np.where(high > 0.0, 1.0, zero * (low > 0.0))
