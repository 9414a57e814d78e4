"""Thin walls: what a wall gives to a force across it, as stated or as a plate that its foot clamps.

The plate is Kirchhoff's, w(x, z) = sum over polynomials z^(2+i) P_j(x), clamped at its foot, its ends free or held;
the energy (D / 2) [ (w_xx + w_zz)^2 - 2 (1 - nu) (w_xx w_zz - w_xz^2) ] is integrated exactly [Timoshenko, Woinowsky-
Krieger 1959]. A long wall is looked at within `REACH` heights of the force. It has the thickness that is left after the
cut, and no inertia.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from numpy.polynomial.legendre import leggauss
from pydantic import Field, model_validator

from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable, Vector3

#: Length of a wall that answers, to either side of the force, in heights.
REACH = 2.0
#: Polynomials along the wall and up it, and points of the quadrature.
ALONG, UP, POINTS = 26, 7, 44


class ThinWallTable(StrictTable):
    """[[surface.wall]]: a wall that gives: the line of its foot in the middle of its thickness, part frame."""

    from_mm: Annotated[Vector3, Field(strict=False)]
    to_mm: Annotated[Vector3, Field(strict=False)]
    up: Vector3 = (0.0, 0.0, 1.0)
    height_mm: float = Field(gt=0.0, le=5000.0)
    thickness_mm: float = Field(gt=0.0, le=500.0)
    young_N_mm2: float | None = Field(default=None, ge=10.0, le=1e6)
    poisson: float = Field(default=0.33, ge=0.0, le=0.49)
    ends: Literal["free", "held"] = "free"
    stiffness_N_mm: float | None = Field(default=None, ge=0.1, le=1e8)

    @model_validator(mode="after")
    def _check(self) -> ThinWallTable:
        if (self.young_N_mm2 is None) == (self.stiffness_N_mm is None):
            raise ValueError("needs one of young_N_mm2 (a plate) and stiffness_N_mm (measured), not both")
        if not np.linalg.norm(self.along) > 0.0 or not np.linalg.norm(self.rise) > 0.0:
            raise ValueError("from_mm and to_mm are one point, or up has length 0")
        return self

    @property
    def along(self) -> Array:
        """From one end of the foot to the other. Shape (3,). [m]"""
        return np.asarray(1e-3 * (np.array(self.to_mm) - np.array(self.from_mm)))

    @property
    def rise(self) -> Array:
        """Up the wall, across its foot; unit vector. Shape (3,)."""
        way = self.along / max(float(np.linalg.norm(self.along)), 1e-12)
        up = np.array(self.up) - (np.array(self.up) @ way) * way
        return np.asarray(up / max(float(np.linalg.norm(up)), 1e-12))

    def find(self, point: Array) -> tuple[float, float] | None:
        """Return how far along its foot and above it a point of its face lies [m], None for a point elsewhere.

        Args:
            point: Part frame. Shape (3,). [m]

        """
        length = float(np.linalg.norm(self.along))
        from_foot = point - 1e-3 * np.array(self.from_mm)
        x, z = float(from_foot @ self.along) / length, float(from_foot @ self.rise)
        aside = float(from_foot @ np.cross(self.along / length, self.rise))
        near = abs(aside) <= 1e-3 * self.thickness_mm  # half of it, and as much for what a cut leaves
        return (x, z) if near and 0.0 <= x <= length and 0.0 <= z <= 1e-3 * self.height_mm else None

    def compliance(self, x: float, at: Array, load: Array) -> Array:
        """Return how far the wall gives at heights to a unit force at heights, x along its foot.

        Args:
            x: Along its foot. [m]
            at: Heights above it. Shape (a,). [m]
            load: The same. Shape (b,). [m]

        Returns:
            Shape (a, b); a stated stiffness holds at every height. [m/N]

        """
        if self.stiffness_N_mm is not None:
            return np.full((len(at), len(load)), 1e-3 / self.stiffness_N_mm)
        height, length = 1e-3 * self.height_mm, float(np.linalg.norm(self.along))
        ends = max(x - REACH * height, 0.0), min(x + REACH * height, length)
        held = self.ends == "held", self.ends == "held"
        held = held[0] and ends[0] == 0.0, held[1] and ends[1] == length
        stiff = 1e6 * float(self.young_N_mm2 or 0.0) * (1e-3 * self.thickness_mm) ** 3
        stiff /= 12.0 * (1.0 - self.poisson**2)
        size = (ends[1] - ends[0], height)
        at, load = np.clip(at, 0.0, height), np.clip(load, 0.0, height)
        return bend_plate(size, stiff, self.poisson, held, x - ends[0], at, load)


def bend_plate(
    size: tuple[float, float], stiffness: float, poisson: float, held: tuple[bool, bool], x: float, at: Array,
    load: Array,
) -> Array:  # fmt: skip
    """Return the deflections of a plate, clamped at its foot, to unit forces across it.

    Args:
        size: Length and height. [m]
        stiffness: D = E t^3 / (12 (1 - nu^2)). [N m]
        poisson: nu. []
        held: Whether its two ends are clamped too.
        x: Where the force and the places are along it. [m]
        at: Heights of the places. Shape (a,). [m]
        load: Heights of the forces. Shape (b,). [m]

    Returns:
        Shape (a, b). [m/N]

    """
    length, height = size
    points, weights = leggauss(POINTS)
    ends = Polynomial([1.0, 1.0]) ** (2 * held[0]) * Polynomial([1.0, -1.0]) ** (2 * held[1])
    across = [ends * Legendre.basis(j).convert(kind=Polynomial) for j in range(ALONG)] if any(held) else [
        Legendre.basis(j) for j in range(ALONG)]  # fmt: skip
    rising = [Polynomial([0.0, 0.0, 1.0]) * Legendre.basis(i, domain=[0.0, 1.0]).convert(kind=Polynomial)
              for i in range(UP)]  # fmt: skip
    u, v = ([np.array([(each.deriv(k) if k else each)(places) for each in basis]) * scale**k for k in range(3)]
            for basis, places, scale in ((across, points, 2.0 / length), (rising, 0.5 * points + 0.5, 1.0 / height)))
    wx, wz = 0.5 * length * weights, 0.5 * height * weights

    def mix(a: int, b: int, c: int, d: int) -> Array:
        return np.asarray(np.einsum("ij,kl->ikjl", (u[a] * wx) @ u[b].T, (v[c] * wz) @ v[d].T))

    both = mix(2, 0, 0, 2)
    energy = (mix(2, 2, 0, 0) + mix(0, 0, 2, 2) + poisson * (both + both.transpose(2, 3, 0, 1))
              + 2.0 * (1.0 - poisson) * mix(1, 1, 1, 1))  # fmt: skip
    count = ALONG * UP
    here = np.array([each(2.0 * x / length - 1.0) for each in across])
    places = np.array([each(np.append(at, load) / height) for each in rising])
    shape = np.einsum("j,ip->pji", here, places).reshape(-1, count)
    whole = stiffness * energy.reshape(count, count)
    scale = 1.0 / np.sqrt(np.diag(whole))
    shape = shape * scale
    return np.asarray(shape[: len(at)] @ np.linalg.solve(whole * np.outer(scale, scale), shape[len(at) :].T))
