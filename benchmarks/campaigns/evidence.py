"""How far an effect stands out of a campaign, and which other names the campaign cannot tell from it.

Everything is measured in standard deviations of what is not the effect: the instrument, the stay-to-stay scatter,
the everyday errors of the robot at the sizes that they were drawn with, frames that are registered, and the other
effects of the same campaign at any size. An effect is required where it stands out by 4.5; an alternative is acceptable
where what it leaves of the effect's deviation stands out by less than 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from benchmarks.campaigns.columns import Placed, Signature
from benchmarks.campaigns.description import Array
from benchmarks.campaigns.everyday import Small
from benchmarks.campaigns.simulate import Reading, Rows, Scenario, predict_rows

VISIBLE = 4.5
SAME = 3.0
FREE = 1.0  # standard deviation of registered frames [m, rad]: far above what they are known to
ANGLE_NOISE = float(np.deg2rad(0.005))


@dataclass(frozen=True)
class Measure:
    """Readings of chosen rows, whitened by everything that is not the effect.

    Args:
        signatures: The vocabulary on these rows.
        root: Lower triangular root of the covariance. Shape (m, m).
        orientation: Whether orientations are measured.
    """

    signatures: list[Signature]
    root: Array
    orientation: bool

    def flat(self, moves: Array) -> Array:
        """Lay displacements out as the measured values. Shape (n, 6, k) or (n, 6) to (m, k) or (m,)."""
        part = moves if self.orientation else moves[:, :3]
        return np.asarray(part.reshape(-1, *moves.shape[2:]))

    def white(self, values: Array) -> Array:
        """Divide values by their standard deviations. Shape (m, k) or (m,)."""
        return np.asarray(solve_triangular(self.root, values, lower=True, check_finite=False))

    def without(self, others: list[Array]) -> Measure:
        """Return the measure with other effects' deviations projected out. Each of shape (m,)."""
        if not others:
            return self
        wide = np.stack([o / (np.linalg.norm(o) + 1e-30) for o in others], axis=1)
        return Measure(self.signatures, cholesky(self.root @ self.root.T + wide @ wide.T, lower=True), self.orientation)

    def visible(self, deviation: Array) -> float:
        """Return how many standard deviations a deviation stands out by."""
        return float(np.linalg.norm(self.white(deviation)))

    def rivals(self, deviation: Array, own: tuple[str, str | None, str | None]) -> list[dict[str, Any]]:
        """Rank the other names by what they leave of a deviation.

        Args:
            deviation: Values of the effect. Shape (m,).
            own: Effect, joint and axis of the truth, which is no rival of its own.
        Returns:
            One entry a name, best first: effect, joint, axis, r2, r2_weighed, distance, parameters.
        """
        target = self.white(deviation)
        energy, plain = float(target @ target), float(deviation @ deviation)
        best: dict[tuple[str, str | None, str | None], dict[str, Any]] = {}
        for s in self.signatures:
            key = (s.effect, s.joint, s.axis)
            columns = self.flat(s.columns)
            if key == own or not np.any(columns):
                continue
            left = energy - _share(self.white(columns), target)
            if key in best and best[key]["distance"] <= left**0.5:
                continue
            best[key] = {
                "effect": s.effect,
                "joint": s.joint,
                "axis": s.axis,
                "r2": round(_share(columns, deviation) / plain, 5),
                "r2_weighed": round(1.0 - left / energy, 5),
                "distance": round(max(left, 0.0) ** 0.5, 3),
                "parameters": int(columns.shape[1]),
            }
        return sorted(best.values(), key=lambda r: (r["distance"], r["parameters"]))

    def left_by_two(self, deviation: Array) -> float:
        """Return by how many standard deviations a deviation stands out after the best two names, found in turn."""
        left = self.white(deviation)
        white = [self.white(self.flat(s.columns)) for s in self.signatures]
        basis = np.zeros((len(left), 0))
        for _ in range(2):
            shares = []
            for columns in white:
                free = columns - basis @ (basis.T @ columns)
                shares.append(_share(free, left) if np.linalg.norm(free) > 1e-6 * np.linalg.norm(columns) else 0.0)
            basis = _span(np.hstack([basis, white[int(np.argmax(shares))]]))
            left = left - basis @ (basis.T @ left)
        return float(np.linalg.norm(left))


def _span(columns: Array) -> Array:
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 1e-12 * (norms.max(initial=0.0) + 1e-300)]
    if kept.shape[1] == 0:
        return np.zeros((len(columns), 0))
    basis, size, _ = np.linalg.svd(kept / np.linalg.norm(kept, axis=0), full_matrices=False)
    return np.asarray(basis[:, size > 1e-7 * size[0]])


def _share(columns: Array, target: Array) -> float:
    """Return the energy of a target that columns can produce."""
    part = _span(columns).T @ target
    return float(part @ part)


def make_measure(
    placed: Placed,
    signatures: list[Signature],
    sigma: Array,
    everyday: list[Small],
    scatter: Array | None,
    *,
    registered: bool,
    orientation: bool,
) -> Measure:
    """Build the covariance of everything that is not the effect.

    Args:
        placed: The loaded robot on the chosen rows.
        signatures: The vocabulary on these rows.
        sigma: Standard deviation of positions, per axis. Shape (n,). [m]
        everyday: The robot's everyday errors.
        scatter: Standard deviation of each joint from stay to stay, or None. Shape (nq,). [rad or m]
        registered: Whether base and tool frames are fitted.
        orientation: Whether orientations are measured.
    """
    plain = Measure(signatures, np.zeros((0, 0)), orientation)
    n = len(placed.select)
    noise = np.repeat(sigma[:, None], 6, axis=1)
    noise[:, 3:] = ANGLE_NOISE
    covariance = np.diag(plain.flat(noise) ** 2)
    at = {(s.effect, s.joint, s.axis): s.columns for s in signatures}
    wide = []
    for small in everyday:
        columns = at.get((small.effect.name, small.effect.joint, small.effect.axis))
        if columns is None:
            continue
        sd = small.sd / (columns.shape[2] ** 0.5 if small.group == "frames" else 1.0)
        wide.append(plain.flat(columns) * sd)
    for name in ("base_frame", "tool_frame"):
        if registered:
            wide.append(plain.flat(at[(name, None, None)]) * FREE)
    if wide:
        stacked = np.hstack(wide)
        covariance += stacked @ stacked.T
    if scatter is not None:
        visit = placed.rows.visit[placed.select]
        still = ~placed.rows.is_path[placed.select]
        for joint, size in zip(placed.nominal.description.joint_names, scatter, strict=True):
            own = placed.own_motion(joint) * (size * still)[:, None]
            flat = plain.flat(own)
            same = np.repeat(visit, len(flat) // n)
            covariance += np.outer(flat, flat) * (same[:, None] == same[None, :])
    return Measure(signatures, cholesky(covariance, lower=True), orientation)


def rms(vectors: Array) -> float:
    """Return the rms length of vectors, 0 if there are none. Shape (n, 3)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) if len(vectors) else 0.0


def gap_of(nominal: Scenario, rows: Rows, real: Reading) -> Array:
    """Return true position minus what the nominal robot predicts from the reported wrench. Shape (n, 3). [m]"""
    return real.position - predict_rows(nominal, rows, real.wrench).position


def register_gap(gap: Array, real: Reading) -> Array:
    """Return what is left of a gap after base and tool frames were fitted to it, to first order. Shape (n, 3). [m]"""
    n = len(gap)
    p = real.position
    columns = np.zeros((n, 3, 9))
    columns[:, :, :3] = np.eye(3)
    for k in range(3):
        columns[:, :, 3 + k] = np.cross(np.eye(3)[k], p)
    columns[:, :, 6:] = real.rotation
    flat = columns.reshape(3 * n, 9)
    fit = np.linalg.lstsq(flat, gap.ravel(), rcond=1e-10)[0]
    return np.asarray((gap.ravel() - flat @ fit).reshape(n, 3))
