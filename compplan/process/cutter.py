"""The shape of a rotating cutter: its profile, and its cutting edge in slices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array

#: Slices of the flat bottom, of a corner (per quarter turn) and of a drill's point.
BOTTOM_SLICES, CORNER_SLICES, POINT_SLICES = 4, 18, 5
#: What stands this near to the cutter's side counts as taken away: a wall that was cut there is not cut twice. [m]
TOUCHING = 1e-8


@dataclass(frozen=True)
class Cutter:
    """A solid of revolution about the tool axis; its tip is the lowest point of the axis."""

    radius: float  #: Radius of the shank's cutting part. [m]
    flute: float  #: Length of the cutting edges along the axis, from the tip. [m]
    corner: float = 0.0  #: Radius of the corner: 0 is a flat end mill, `radius` a ball end mill. [m]
    point: float = float(np.pi)  #: Full angle of a drill's point; pi is flat. [rad]
    pieces: int = 1  #: Slices of its side.

    def height(self, distance: Array) -> Array:
        """Return how high the cutter's lower surface stands above its tip, at a distance from its axis [m].

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
        """Tell whether the lower surface is a plane, as that of a flat end mill."""
        return self.corner == 0.0 and self.point >= np.pi

    @property
    def round(self) -> bool:
        """Tell whether the lower surface is half a ball."""
        return self.corner >= self.radius

    @property
    def end(self) -> float:
        """Height above the tip from which on the cutter is a cylinder. [m]"""
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
        """Slices of bottom and corner of a mill, none of a drill. Shape (k,)."""
        return np.asarray((self.slices.normal[:, 1] < -1e-9) & (self.point >= np.pi))

    def edge_point(self, number: NDArray[np.int_], share: Array) -> tuple[Array, Array]:
        """Return where the edge stands at shares of slices: distance from the axis, height above the tip. (s,) [m]"""
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
        """Length of the edge, helix aside. Shape (k,). [m]"""
        return np.linalg.norm(np.diff(self.knots, axis=0), axis=1)

    @property
    def normal(self) -> Array:
        """Outward normal: away from the axis, along the axis. Shape (k, 2)."""
        step = np.diff(self.knots, axis=0)
        return np.column_stack([step[:, 1], -step[:, 0]]) / self.length[:, None]
