"""Elasticity of a straight beam as a 6x6 compliance at its free end."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_ROTATIONS = {
    "z": np.eye(3),
    "x": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "y": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-z": np.diag([1.0, -1, -1]),
}
_ROTATIONS["-x"] = np.diag([-1.0, -1, 1]) @ _ROTATIONS["x"]
_ROTATIONS["-y"] = np.diag([-1.0, -1, 1]) @ _ROTATIONS["y"]


def hollow_beam_compliance(
    length: float, outer_diameter: float, inner_diameter: float, young: float, shear: float, axis: str = "z"
) -> NDArray[np.float64]:
    """Compute the compliance of a cantilevered tube at its free end.

    Euler-Bernoulli, no shear deformation: tip translation L^3/(3EI), tip rotation L/(EI), coupling L^2/(2EI),
    axial L/(EA), torsion L/(G Ip) [Mamedov2018].

    Args:
        length: Length L of the beam, from the clamped end to the free end. [m]
        outer_diameter: Outer diameter. [m]
        inner_diameter: Inner diameter, 0 for a solid bar. [m]
        young: Young's modulus E. [Pa]
        shear: Shear modulus G. [Pa]
        axis: Direction from the clamped to the free end in the free end's frame: x y z -x -y -z.

    Returns:
        Rows tx ty tz rx ry rz, columns fx fy fz mx my mz, axes of the free end's frame. Shape (6, 6).
        [m, rad per N, N m]

    Raises:
        ValueError: If a dimension or a modulus is not positive, or the axis is not known.
    """
    if not (length > 0 and outer_diameter > inner_diameter >= 0 and young > 0 and shear > 0):
        raise ValueError("a beam needs length > 0, outer_diameter > inner_diameter >= 0, young > 0 and shear > 0")
    if axis not in _ROTATIONS:
        raise ValueError(f"no beam axis {axis!r}, choose from {sorted(_ROTATIONS)}")
    area = math.pi / 4 * (outer_diameter**2 - inner_diameter**2)
    inertia = math.pi / 64 * (outer_diameter**4 - inner_diameter**4)
    slope = length / (young * inertia)
    bend, couple = length**2 * slope / 3, length * slope / 2
    compliance = np.diag([bend, bend, length / (young * area), slope, slope, length / (2 * shear * inertia)])
    compliance[0, 4] = compliance[4, 0] = couple
    compliance[1, 3] = compliance[3, 1] = -couple
    rotation = np.kron(np.eye(2), _ROTATIONS[axis])
    return np.asarray(rotation @ compliance @ rotation.T)
