"""Whether a cut is stable: regenerative chatter by zero-order solution and semi-discretisation, and mode coupling.

A tooth at angle u cuts h = f v.n + n.(r(t) - r(t - T)): its own motion r beside what the tooth before it left, T the
tooth period. To first order the force on the tool is B(t) (r(t) - r(t - T)), B the sum over teeth of
A(u) = sum over slices of dF/dh n^T, and the tool answers by its modes, q'' + 2 z w q' + w^2 q = U^T F with r = U q.

Zero-order solution [Altintas, Budak 1995]: B is replaced by its mean B0; det(1 - (1 - exp(-i w T)) G(w) B0) must not
turn round the origin. Semi-discretisation [Insperger, Stepan 2004]: B and the delayed motion stand still over short
steps, the greatest multiplier of a tooth period must stay below 1. Mode coupling: the delayed motion is left out, as
where successive cuts do not overlap. Helix (it only smooths B) and process damping (it only steadies) are left out;
the chip must stay unbroken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.special import ndtr, ndtri

from compplan.io.tables import Array
from compplan.process.engagement import Engagement
from compplan.process.materials import Coefficients
from compplan.process.milling import THINNEST, edge_wrenches

#: Steps of a tooth period: at least, at most, and in a period of the fastest mode.
STEPS, A_PERIOD = (24, 120), 24
#: Frequencies that a determinant is followed over: evenly, and beside each mode in widths of its peak.
EVEN, NEAR = 600, np.sinh(np.linspace(-6.0, 6.0, 81))
#: Draws of a probability; standard deviations of the logarithms of a measured frequency and damping (assumed).
DRAWS, MEASURED = 8, (0.01, 0.15)
#: Depths that the limit of mode coupling is sought among, shares of the depth that is cut.
SCALES = np.geomspace(0.02, 50.0, 400)


@dataclass(frozen=True)
class Modes:
    """The modes of a tool on its arm.

    Attributes:
        omega: Angular frequencies, rising. Shape (m,). [rad/s]
        shape: Motion of the tip, scaled to a modal mass of 1 kg. Shape (3, m).
        damping: Share of critical damping, of all modes or of each. Shape (m,).
        measured: Which are measured ones of the tool; None for none. Shape (m,).

    """

    omega: Array
    shape: Array
    damping: float | Array
    measured: NDArray[np.bool_] | None = None

    def turn(self, axes: Array) -> Modes:
        """Return the same, seen in other axes (columns). Shape of `axes`: (3, 3)."""
        return replace(self, shape=axes.T @ self.shape)


@dataclass(frozen=True)
class CutDynamics:
    """One place of a cut.

    Attributes:
        gain: A at m angles of a turn: force on the tool per motion of one tooth. Shape (m, 3, 3). [N/m]
        teeth: Number of teeth.
        period: Tooth period. [s]
        modes: Of the tool, same axes.

    """

    gain: Array
    teeth: int
    period: float
    modes: Modes

    @property
    def mean(self) -> Array:
        """B0. Shape (3, 3). [N/m]"""
        return np.asarray(self.teeth * self.gain.mean(axis=0))

    def scaled(self, depth: float = 1.0, speed: float = 1.0) -> CutDynamics:
        """Return the same with depth and spindle speed multiplied."""
        return replace(self, gain=self.gain * depth, period=self.period / speed)


@dataclass(frozen=True)
class Spread:
    """How surely a cut is known, standard deviations.

    Attributes:
        frequency: Of the logarithm of the arm's frequencies, all alike.
        damping: Of the logarithm of their damping, all alike.
        force: Relative, of the coefficients.

    """

    frequency: float
    damping: float
    force: float


def find_gains(found: Engagement, coefficients: Coefficients, feed_per_tooth: Array) -> Array:
    """Return A at every waypoint and angle, path axes.

    Args:
        found: The engagement.
        coefficients: Of the material; a Kienzle exponent is taken at the chip that is cut.
        feed_per_tooth: Shape (n,). [m]

    Returns:
        Shape (n, m, 3, 3). [N/m]

    """
    edge, angle = found.cutter.slices, found.angles
    force = edge_wrenches(edge, angle)[0][..., :3]
    cos, sin = np.cos(angle), np.sin(angle)
    out, up = edge.normal[:, :1], edge.normal[:, 1:]
    normal = np.stack([out * cos, out * sin, up * np.ones_like(cos)], axis=-1)
    pairs = force[..., :, None] * normal[..., None, :]  # (3, k, m, 3, 3)
    speed = found.outward(angle)
    chip = np.maximum(1e3 * feed_per_tooth[:, None, None] * speed, THINNEST)
    gains = np.zeros((len(found), len(angle), 3, 3))
    for c in range(3):
        m = coefficients.exponent[c]
        slope = 1e6 * coefficients.cutting[c] * (1.0 - m) * chip**-m
        weight = found.depth * slope * (edge.length[:, None] * (speed > 0.0))
        gains += np.einsum("nkm,kmij->nmij", weight, pairs[c])
    return gains


def count_turns(cut: CutDynamics, scales: Array) -> Array:
    """Count the unstable pairs of the zero-order solution at some depths, shares of the one that is cut. Shape (k,)."""
    omega = _frequencies(cut)
    peak = cut.modes.omega**2 - omega[:, None] ** 2 + 2j * cut.modes.damping * cut.modes.omega * omega[:, None]
    answer = np.einsum("im,wm,jm->wij", cut.modes.shape, 1.0 / peak, cut.modes.shape)
    loop = (1.0 - np.exp(-1j * omega * cut.period))[:, None, None] * (answer @ cut.mean)
    trace = np.einsum("wii->w", loop)
    square = 0.5 * (trace**2 - np.einsum("wij,wji->w", loop, loop))
    cube = np.linalg.det(loop)
    b = np.asarray(scales, float)[:, None]
    turned = np.unwrap(np.angle(1.0 - b * trace + b**2 * square - b**3 * cube), axis=1)
    return np.asarray(np.rint(-(turned[:, -1] - turned[:, 0]) / np.pi), int)


def _frequencies(cut: CutDynamics) -> Array:
    """Return the angular frequencies that the determinant is followed over, from 0 to where nothing answers."""
    modes = cut.modes
    last = 20.0 * modes.omega[-1]
    most = int(np.clip(last * cut.period, EVEN, 20 * EVEN))
    damping = np.broadcast_to(modes.damping, modes.omega.shape)
    near = modes.omega[:, None] * (1.0 + damping[:, None] * NEAR / 2.0)
    grid = np.concatenate([np.linspace(0.0, last, most), near.ravel()])
    return np.unique(np.clip(grid, 0.0, last))


def find_multiplier(cut: CutDynamics) -> float:
    """Return the greatest multiplier of a tooth period by semi-discretisation; the cut is stable below 1."""
    modes, size = cut.modes, len(cut.modes.omega)
    steps = int(np.clip(np.ceil(A_PERIOD * cut.period * modes.omega[-1] / (2 * np.pi)), *STEPS))
    gain = np.einsum("ai,sab->sib", modes.shape, _divide_period(cut, steps))
    # the modes, their rates, and the tip a period ago
    rate = np.zeros((steps, 2 * size, 2 * size + 3))
    rate[:, :size, size : 2 * size] = np.eye(size)
    rate[:, size:, :size] = gain @ modes.shape - np.diag(modes.omega**2)
    rate[:, size:, size : 2 * size] = -np.diag(2 * modes.damping * modes.omega)
    rate[:, size:, 2 * size :] = -gain
    whole = np.zeros((steps, 2 * size + 3, 2 * size + 3))
    whole[:, : 2 * size] = rate * (cut.period / steps)
    move = expm(whole)[:, : 2 * size]
    # the state at the start, and the tip at each step of the period before, newest last
    count = 2 * size + 3 * steps
    state = np.eye(2 * size, count)
    past = [np.eye(3, count, 2 * size + 3 * k) for k in range(steps)] + [modes.shape @ state[:size]]
    kept = []
    for k in range(steps):
        kept.append(modes.shape @ state[:size])
        delayed = 0.5 * (past[k] + past[k + 1])
        state = move[k][:, : 2 * size] @ state + move[k][:, 2 * size :] @ delayed
    return float(np.abs(np.linalg.eigvals(np.vstack([state, *kept]))).max())


def find_odds(cut: CutDynamics, spread: Spread) -> float:
    """Return the probability of chatter: semi-discretised draws, their growths smoothed by a normal kernel."""
    growth = np.zeros(DRAWS)
    for k, draw in enumerate(_draw_normal()):
        gain = cut.gain * max(1.0 + draw[4] * spread.force, 0.05)
        drawn = draw_modes(cut.modes, spread, draw)
        growth[k] = np.log(find_multiplier(CutDynamics(gain, cut.teeth, cut.period, drawn)))
    width = max(float(growth.std()) * DRAWS**-0.2, 1e-6)
    return float(ndtr(growth / width).mean())


def draw_modes(modes: Modes, spread: Spread, draw: Array) -> Modes:
    """Return modes as they may be, by four normal numbers: one that is heavier is as stiff as before, and slower."""
    measured = np.zeros(len(modes.omega), bool) if modes.measured is None else modes.measured
    faster = np.exp(draw[0] * np.where(measured, 0.0, spread.frequency) + draw[1] * measured * MEASURED[0])
    damped = np.exp(draw[2] * np.where(measured, 0.0, spread.damping) + draw[3] * measured * MEASURED[1])
    return Modes(modes.omega * faster, modes.shape * faster, np.clip(modes.damping * damped, 1e-4, 0.9))


def _draw_normal() -> Array:
    """Return the draws, evenly spread, the same for every cut. Shape (DRAWS, 5)."""
    from scipy.stats import qmc

    return np.asarray(ndtri(qmc.Sobol(5, seed=0).random(DRAWS)))


def _divide_period(cut: CutDynamics, steps: int) -> Array:
    """Return B in the steps of one tooth period: the sum over teeth, of the mean over each step. Shape (s, 3, 3)."""
    bins = len(cut.gain)
    total = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(cut.gain, axis=0)]) / bins
    # teeth turn to smaller angles
    edges = 1.0 - np.arange(steps * cut.teeth + 1) / (steps * cut.teeth)
    at = edges * bins
    low = np.minimum(at.astype(int), bins - 1)
    passed = total[low] + (at - low)[:, None, None] * (total[low + 1] - total[low])
    parts = -np.diff(passed, axis=0) * steps * cut.teeth
    return np.asarray(parts.reshape(cut.teeth, steps, 3, 3).sum(axis=0))


def find_limit(cut: CutDynamics, scales: Array = SCALES) -> float:
    """Return the least depth that the zero-order solution calls unstable, a share of the one cut; inf for none."""
    unstable = np.flatnonzero(count_turns(cut, scales) > 0)
    return float(scales[unstable[0]]) if len(unstable) else float("inf")


def find_coupling_limit(cut: CutDynamics, scales: Array = SCALES) -> float:
    """Return the least depth at which modes couple without any delay, a share of the one cut; inf for none."""
    modes, size = cut.modes, len(cut.modes.omega)
    gain = modes.shape.T @ cut.mean @ modes.shape
    rate = np.zeros((len(scales), 2 * size, 2 * size))
    rate[:, :size, size:] = np.eye(size)
    rate[:, size:, :size] = scales[:, None, None] * gain - np.diag(modes.omega**2)
    rate[:, size:, size:] = -np.diag(2 * modes.damping * modes.omega)
    unstable = np.flatnonzero(np.linalg.eigvals(rate).real.max(axis=1) > 0.0)
    return float(scales[unstable[0]]) if len(unstable) else float("inf")
