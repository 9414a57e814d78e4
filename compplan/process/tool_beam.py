"""The cutter and its holder as a beam that the spindle clamps: what it gives, and how it rings.

A Timoshenko beam of round pieces (fluted part, shank, holder), clamped where the holder leaves the spindle, in elements
with the bending and shear stiffness of a straight piece; masses and rotary inertias stand at the nodes. The fluted part
bends like a round bar of 0.8 of the cutter's diameter [Kops, Vo 1990, as it is commonly quoted: assumed]. The clamp and
the spindle count as rigid; x and y of the tool bend alike and do not twist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.linalg import eigh

from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable

#: Young's modulus [N/m^2], Poisson's ratio and density [kg/m^3] of what tools are made of: sizes of handbooks, assumed.
SOLIDS = {"carbide": (600e9, 0.22, 14.5e3), "hss": (220e9, 0.29, 8.0e3), "steel": (210e9, 0.30, 7.85e3)}
#: Diameter that the fluted part bends with, to the cutter's (assumed).
FLUTED = 0.8
#: Elements of the beam at least, and shear area of a round bar to its own.
ELEMENTS, SHEAR = 60, 0.9
#: Modes of each direction that are kept.
KEPT = 3


class ToolBeamTable(StrictTable):
    """[tool_beam]: cutter and holder as a beam: how far they stick out, how thick, of what; damping is assumed."""

    stickout_mm: float = Field(ge=1.0, le=1000.0)
    diameter_mm: float | None = Field(default=None, ge=0.05, le=500.0)
    material: Literal["carbide", "hss", "steel"] = "carbide"
    holder_length_mm: float = Field(default=0.0, ge=0.0, le=1000.0)
    holder_diameter_mm: float | None = Field(default=None, ge=1.0, le=500.0)
    damping: float = Field(default=0.02, gt=0.0, le=0.5)

    @model_validator(mode="after")
    def _check(self) -> ToolBeamTable:
        if (self.holder_length_mm > 0.0) != (self.holder_diameter_mm is not None):
            raise ValueError("holder_length_mm and holder_diameter_mm belong together")
        return self

    def build(self, cutter_diameter: float, flute: float) -> ToolBeam:
        """Build the beam of a cutter.

        Args:
            cutter_diameter: Diameter of the cutter. [m]
            flute: Length of its fluted part, from the tip. [m]

        """
        out = 1e-3 * self.stickout_mm
        shank = cutter_diameter if self.diameter_mm is None else 1e-3 * self.diameter_mm
        pieces = [(min(flute, out), FLUTED * cutter_diameter, self.material), (out - flute, shank, self.material),
                  (1e-3 * self.holder_length_mm, 1e-3 * (self.holder_diameter_mm or 0.0), "steel")]  # fmt: skip
        return ToolBeam(tuple(piece for piece in pieces if piece[0] > 1e-9), self.damping)


@dataclass(frozen=True)
class BeamModes:
    """Modes of one direction, scaled to a modal mass of 1 kg.

    Attributes:
        omega: Angular frequencies, rising. Shape (k,). [rad/s]
        tip: Motion of the tip. Shape (k,). [1/sqrt(kg)]
        pull: What a unit acceleration of the clamp across the axis puts on each. Shape (k,). [sqrt(kg)]

    """

    omega: Array
    tip: Array
    pull: Array


@dataclass(frozen=True)
class ToolBeam:
    """Round pieces in a row, clamped at the last one's end.

    Attributes:
        pieces: Length [m], diameter [m] and solid of each, from the tip.
        damping: Share of critical damping of its modes.

    """

    pieces: tuple[tuple[float, float, str], ...]
    damping: float

    @cached_property
    def _built(self) -> tuple[Array, Array, Array]:
        """Heights of the free nodes above the tip (n,) [m], stiffness and mass of (way, turn) at each (2n, 2n)."""
        whole = sum(piece[0] for piece in self.pieces)
        parts = [(length / count, size, solid) for length, size, solid in self.pieces
                 for count in [max(int(np.ceil(ELEMENTS * length / whole)), 4)] for _ in range(count)]  # fmt: skip
        n = len(parts)
        stiffness, mass = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros(2 * n + 2)
        for i, (length, size, solid) in enumerate(parts):
            young, poisson, density = SOLIDS[solid]
            area, inertia = 0.25 * np.pi * size**2, np.pi * size**4 / 64.0
            soft = 12.0 * young * inertia * 2.0 * (1.0 + poisson) / (SHEAR * young * area * length**2)
            a, b = 12.0, 6.0 * length
            c, d = (4.0 + soft) * length**2, (2.0 - soft) * length**2
            own = np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]])
            at = slice(2 * i, 2 * i + 4)
            stiffness[at, at] += young * inertia / (length**3 * (1.0 + soft)) * own
            mass[at] += 0.5 * density * length * np.array([area, inertia, area, inertia])
        height = np.concatenate([[0.0], np.cumsum([part[0] for part in parts])])
        return height[:-1], stiffness[:-2, :-2], mass[:-2]

    def compliance(self, at: Array, load: Array) -> Array:
        """Return how far the axis gives at heights `at` to a unit force across it at heights `load`.

        Args:
            at: Heights above the tip. Shape (a,). [m]
            load: The same. Shape (b,). [m]

        Returns:
            Shape (a, b). [m/N]

        """
        height, stiffness, _ = self._built
        ways = np.linalg.inv(stiffness)[::2, ::2]
        knots = np.append(height, sum(piece[0] for piece in self.pieces))
        ways = np.pad(ways, ((0, 1), (0, 1)))
        return np.asarray(_share(knots, at) @ ways @ _share(knots, load).T)

    @cached_property
    def modes(self) -> BeamModes:
        """The lowest modes of one direction, the clamp at rest."""
        _, stiffness, mass = self._built
        square, ways = eigh(stiffness, np.diag(mass), subset_by_index=[0, KEPT - 1])
        ways = ways * np.sign(ways[0])
        return BeamModes(np.sqrt(square), ways[0], ways[::2].T @ mass[::2])


def _share(knots: Array, places: Array) -> Array:
    """Return how each place lies between knots, shape (p, k): two weights a row."""
    places = np.clip(np.asarray(places, float), knots[0], knots[-1])
    after = np.clip(np.searchsorted(knots, places), 1, len(knots) - 1)
    part = (places - knots[after - 1]) / (knots[after] - knots[after - 1])
    weights = np.zeros((len(places), len(knots)))
    rows = np.arange(len(places))
    weights[rows, after - 1], weights[rows, after] = 1.0 - part, part
    return weights
