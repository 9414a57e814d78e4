"""Chatter of an end mill on a flexible arm: zero-order depth limit by Nyquist's criterion [Altintas2012]."""

from __future__ import annotations

import numpy as np

from compplan.process.cutting import edge_wrenches
from compplan.process.engagement import Engagement
from compplan.process.materials import Coefficients
from compplan.robot import Array

#: Least chip thickness in the Kienzle law. [mm]
THINNEST = 1e-4
#: Frequencies of the determinant: least number of even ones, and distances from each mode in widths of its peak.
EVEN, NEAR = 600, np.sinh(np.linspace(-6.0, 6.0, 81))
#: Depths of the search, as shares of the depth of cut.
SCALES = np.geomspace(0.02, 20.0, 120)


def compute_gains(found: Engagement, coefficients: Coefficients, feed_per_tooth: Array) -> Array:
    """Compute dF/dx of one tooth, mean over a turn, at every waypoint, path axes. Shape (n, 3, 3). [N/m]

    x is the displacement since the previous tooth. With a Kienzle exponent, dF/dx is evaluated at the actual chip
    thickness, from `feed_per_tooth` (n,) [m].
    """
    edge, angle = found.cutter.slices, found.angles
    force = edge_wrenches(edge, angle)[0][..., :3]
    cos, sin = np.cos(angle), np.sin(angle)
    out, up = edge.normal[:, :1], edge.normal[:, 1:]
    normal = np.stack([out * cos, out * sin, up * np.ones_like(cos)], axis=-1)
    speed = np.maximum(found.speed(angle), 0.0)
    chip = np.maximum(1e3 * feed_per_tooth[:, None, None] * speed, THINNEST)
    gains = np.zeros((len(found), 3, 3))
    for c in range(3):
        m = coefficients.exponent[c]
        slope = 1e6 * coefficients.cutting[c] * (1.0 - m) * chip**-m
        weight = found.depth * slope * (edge.length[:, None] * (speed > 0.0)) / len(angle)
        gains += np.einsum("nkm,kmi,kmj->nij", weight, force[c], normal)
    return gains


def compute_depth_limit(
    mean: Array, period: float, omega: Array, shape: Array, damping: Array, scales: Array = SCALES
) -> float:
    """Compute the least unstable depth as a share of the depth of cut; inf if all scales are stable.

    Args:
        mean: B0 at the depth of cut. Shape (3, 3). [N/m]
        period: Time from tooth to tooth. [s]
        omega: Angular frequencies of the modes of tool and arm. Shape (m,). [rad/s]
        shape: Tip motion of each mode, modal mass 1 kg, axes of `mean`. Shape (3, m).
        damping: Damping ratio of each mode. Shape (m,).
        scales: Depths of the search as shares, ascending.
    """
    last = 20.0 * omega.max()
    near = omega[:, None] * (1.0 + damping[:, None] * NEAR / 2.0)
    grid = np.linspace(0.0, last, int(np.clip(last * period, EVEN, 20 * EVEN)))
    at = np.unique(np.clip(np.concatenate([grid, near.ravel()]), 0.0, last))
    peak = omega**2 - at[:, None] ** 2 + 2j * damping * omega * at[:, None]
    receptance = np.einsum("im,wm,jm->wij", shape, 1.0 / peak, shape)
    loop = (1.0 - np.exp(-1j * at * period))[:, None, None] * (receptance @ mean)
    trace = np.einsum("wii->w", loop)
    square = 0.5 * (trace**2 - np.einsum("wij,wji->w", loop, loop))
    b = np.asarray(scales, float)[:, None]
    turned = np.unwrap(np.angle(1.0 - b * trace + b**2 * square - b**3 * np.linalg.det(loop)), axis=1)
    unstable = np.flatnonzero(np.rint(-(turned[:, -1] - turned[:, 0]) / np.pi) > 0)
    return float(scales[unstable[0]]) if len(unstable) else float("inf")
