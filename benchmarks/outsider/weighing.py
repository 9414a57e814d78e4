"""How far two motions of the tip are apart, in standard deviations of noise, scatter and everyday errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from benchmarks.outsider.campaign import Campaign
from benchmarks.outsider.cause import Key
from benchmarks.outsider.robots import Robot
from benchmarks.outsider.settings import Settings
from benchmarks.outsider.signatures import Signatures
from benchmarks.outsider.turns import DEGREE, Array, Rng

REPEATABILITY_M = {"cobot": 25e-6, "small": 12e-6, "mid": 30e-6, "heavy": 45e-6, "scara": 10e-6}


@dataclass(frozen=True)
class Instrument:
    """Noise of the measured position, constant or growing with the distance, and scatter of the joints a stay."""

    constant: float | None
    factor: float
    scatter: Array | None
    repeatability: float

    def sigma(self, campaign: Campaign) -> Array:
        """Standard deviation of the measured position, per axis. Shape (n,). [m]"""
        if self.constant:
            return np.full(campaign.rows, self.constant)
        away = np.linalg.norm(campaign.position - campaign.tracker, axis=1)
        return self.factor * (15e-6 + 6e-6 * away)

    def sigma_rms(self, campaign: Campaign) -> float:
        """Root mean square of `sigma`. [m]"""
        return float(np.sqrt((self.sigma(campaign) ** 2).mean()))

    def floor(self, campaign: Campaign) -> float:
        """Noise and scatter together, of a whole position. [m]"""
        return float(np.sqrt(3 * self.sigma_rms(campaign) ** 2 + self.repeatability**2))


def draw_instrument(rng: Rng, robot: Robot, campaign: Campaign) -> Instrument:
    """Draw the noise of an instrument and the repeatability of the robot."""
    constant = float(rng.uniform(10e-6, 60e-6)) if rng.random() < 0.5 else None
    factor, scatter, repeatability = float(rng.uniform(0.7, 1.6)), None, 0.0
    if rng.random() < 0.65:
        scatter = rng.uniform(0.5, 1.5, robot.count) * np.where(robot.prismatic, 1.0, 1 / robot.reach)
        moves = (campaign.jacobian[:, :, :3] ** 2).sum(2).mean(1)
        wanted = REPEATABILITY_M[robot.size] * rng.uniform(0.5, 1.6)
        scatter *= wanted * np.sqrt(3) / np.sqrt((moves * scatter**2).sum())
        repeatability = float(wanted * np.sqrt(3))
    return Instrument(constant, factor, scatter, repeatability)


class Scale:
    """The space in which a motion's length counts standard deviations.

    Whitened by the covariance of noise, scatter (shared by the rows of a stay) and everyday errors; unknown frames, and
    the motions of other causes whose sizes stay free, are projected out.
    """

    def __init__(
        self,
        campaign: Campaign,
        settings: Settings,
        instrument: Instrument,
        frames: Array,
        everyday: Sequence[Array] = (),
        free: Sequence[Array] = (),
    ) -> None:
        self.width = 6 if settings.orientation else 3
        size = campaign.rows * self.width
        covariance = _noise(campaign, settings, instrument, self.width)
        if instrument.scatter is not None:
            spread = _scatter(campaign, instrument.scatter, self.width)
            covariance += spread @ spread.T
        if everyday:
            errors = np.hstack([columns[:, : self.width].reshape(size, -1) for columns in everyday])
            covariance += errors @ errors.T
        self.root = cholesky(covariance, lower=True)
        out = [frames] if campaign.register else []
        out += [x[:, :, None] for x in free]
        self.left_out = None
        if out:
            columns = np.hstack([x[:, : self.width].reshape(size, -1) for x in out])
            self.left_out = span(solve_triangular(self.root, columns, lower=True))

    def whiten(self, motion: Array) -> Array:
        """Motions of shape (n, 6) or (n, 6, m) in this space. Shape (rows, m). [standard deviations]"""
        kept = motion[:, : self.width]
        y = solve_triangular(self.root, kept.reshape(len(kept) * self.width, -1), lower=True)
        before = np.linalg.norm(y, axis=0)
        if self.left_out is not None:
            for _ in range(2):
                y = y - self.left_out @ (self.left_out.T @ y)
        y[:, np.linalg.norm(y, axis=0) < 1e-7 * before] = 0
        return y


def _noise(campaign: Campaign, settings: Settings, instrument: Instrument, width: int) -> Array:
    variances = np.zeros((campaign.rows, width))
    variances[:, :3] = instrument.sigma(campaign)[:, None] ** 2
    if width == 6:
        variances[:, 3:] = (settings.sigma_deg * DEGREE) ** 2
    return np.diag(variances.ravel())


def _scatter(campaign: Campaign, scatter: Array, width: int) -> Array:
    """Motions by one standard deviation of every joint in every stay; paths have none. Shape (rows, stays x joints)."""
    moves = np.swapaxes(campaign.jacobian, 0, 1) * campaign.static[:, None, None]
    moves = np.swapaxes(moves, 1, 2)[:, :width] * scatter
    spread = np.zeros((campaign.rows, width, campaign.visit[-1] + 1, len(scatter)))
    spread[np.arange(campaign.rows), :, campaign.visit, :] = moves
    columns = spread.reshape(campaign.rows * width, -1)
    return columns[:, np.any(columns, axis=0)]


def span(columns: Array) -> Array:
    """An orthonormal basis of what columns span, each taken at unit length. Shape (rows, rank)."""
    length = np.linalg.norm(columns, axis=0)
    columns = columns[:, length > 0] / length[length > 0]
    if columns.shape[1] == 0:
        return columns
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return U[:, s > 1e-5 * s[0]]


def rms(vectors: Array) -> float:
    """Root mean square length of vectors of shape (n, 3)."""
    return float(np.sqrt((vectors**2).sum(1).mean()))


def register(gap: Array, frames: Array) -> Array:
    """What base (6) and target (3) leave of a gap. Shape (n, 3). [m]"""
    columns, y = frames[:, :3, :9].reshape(-1, 9), gap.reshape(-1)
    return (y - columns @ np.linalg.lstsq(columns, y, rcond=1e-9)[0]).reshape(-1, 3)


# -------------------------------------------------------------------------------------------------- imitations


class Imitation(NamedTuple):
    """What one effect at one place leaves of a motion: length left, share explained, basis of the best variant."""

    distance: float
    explained: float
    basis: Array


class _Fit(NamedTuple):
    left: float
    basis: Array


def imitate(scale: Scale, motion: Array, signatures: Signatures) -> tuple[Array, dict[Key, Imitation]]:
    """Fit every effect and place of the list to a motion, each alone and with its best variant.

    Signs that physics forbids (a negative added compliance, a joint stiffer by more than 95 %) do not count.

    Returns:
        The motion in the whitened space, shape (rows,), and the imitations by effect, joint and axis.
    """
    y = scale.whiten(motion)[:, 0]
    total = y @ y
    white = scale.whiten(np.concatenate([v for variants in signatures.variants.values() for v in variants], 2))
    found, at = {}, 0
    for key, variants in signatures.variants.items():
        widths = [v.shape[2] for v in variants]
        columns = white[:, at : at + sum(widths)]
        at += sum(widths)
        if len(variants) > 20 and set(widths) == {2}:
            fit = _fit_pairs(columns, y)
        else:
            fit = _fit_variants(key[0], np.split(columns, np.cumsum(widths)[:-1], axis=1), y)
        if fit is not None:
            explained = float(1 - fit.left / total) if total > 0 else 0.0
            found[key] = Imitation(float(np.sqrt(max(fit.left, 0))), explained, fit.basis)
    return y, found


def _fit_pairs(columns: Array, y: Array) -> _Fit | None:
    """The best of many pairs of columns, by the normal equations of all at once."""
    a, b = columns[:, ::2], columns[:, 1::2]
    aa, bb, ab = (a * a).sum(0) + 1e-300, (b * b).sum(0) + 1e-300, (a * b).sum(0)
    ay, by, det = a.T @ y, b.T @ y, aa * bb - ab**2
    two = det > 1e-8 * aa * bb
    both = (ay * ay * bb - 2 * ay * by * ab + by * by * aa) / np.where(two, det, 1)
    i = int(np.argmax(np.where(two, both, ay * ay / aa)))
    basis = span(columns[:, 2 * i : 2 * i + 2])
    if basis.shape[1] == 0:
        return None
    z = basis.T @ y
    return _Fit(float(y @ y - z @ z), basis)


def _fit_variants(effect: str, variants: Sequence[Array], y: Array) -> _Fit | None:
    """The best of some variants, those of one column with a sign that physics allows."""
    best: _Fit | None = None
    for columns in variants:
        if not np.any(columns):
            continue
        if columns.shape[1] == 1:
            a = columns[:, 0]
            size = a @ y / (a @ a)
            if effect in ("link_compliance", "base_compliance") and size <= 0:
                continue
            if effect == "joint_stiffness" and size < -0.95:
                continue
            fit = _Fit(float(y @ y - size * size * (a @ a)), columns / np.linalg.norm(a))
        else:
            basis = span(columns)
            z = basis.T @ y
            fit = _Fit(float(y @ y - z @ z), basis)
        if best is None or fit.left < best.left:
            best = fit
    return best


def best_second(scale: Scale, y: Array, first: Array, signatures: Signatures) -> tuple[float, Key | None]:
    """The effect that leaves least of a motion beside a first one: squared length left, effect and place.

    Of effects with very many variants every third is tried.
    """
    y = y - first @ (first.T @ y)
    best: tuple[float, Key | None] = (1e9, None)
    for key, variants in signatures.variants.items():
        many = key[0] in ("frame_shift", "tool_shift", "joint_coupling", "transmission_error")
        for variant in variants[::3] if many else variants:
            columns = scale.whiten(variant)
            columns = columns - first @ (first.T @ columns)
            if not np.any(np.linalg.norm(columns, axis=0) > 1e-9 * np.sqrt(len(columns))):
                continue
            z = span(columns).T @ y
            left = float(y @ y - z @ z)
            if left < best[0]:
                best = (left, key)
    return best
