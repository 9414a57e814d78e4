"""Channels: what was measured minus what a model expects, with noise and with the stays that share an error.

Position, orientation and link-side encoders are three channels, each weighted by its own noise. Rows of one stay (the
robot did not move) and neighbouring samples of a path share whatever the model gets wrong there, so that they do not
count as independent witnesses against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from compplan.effects.scene import Attained, Scene
from compplan.measure.campaign import Campaign
from compplan.robot import Array

#: Neighbouring samples of a path share an error: a path is cut into about so many blocks, none shorter than the second.
PATH_BLOCKS, SHORTEST_BLOCK = 16, 8
#: Sources of the noise disagree where their variances differ by more than this factor.
DISAGREE = 1.8
#: Probability below which chance is no explanation of an estimate.
BY_CHANCE = 1e-3
#: Standard deviations where nothing tells them: assumed, and corrected by the fit. [m, rad, rad]
ASSUMED_SIGMA = {"position": 3e-5, "orientation": 1e-4, "encoder": 5e-6}


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviation of a channel per axis, and how well it is known.

    Attributes:
        sigma: Standard deviation. [m or rad]
        witnesses: Degrees of freedom that it rests on; 0 where it is assumed.
        source: "repeats", "sigma column", "path" or "assumed".
    """

    sigma: float
    witnesses: float
    source: str

    @property
    def leeway(self) -> float:
        """Factor by which the variance may exceed its estimate before chance no longer explains it (0.1 %)."""
        return float(self.witnesses / chi2.ppf(BY_CHANCE, self.witnesses)) if self.witnesses > 0 else np.inf


@dataclass(frozen=True, eq=False)
class Channel:
    """One kind of observation; r rows of it, c components.

    Attributes:
        name: "position", "orientation" or "encoder".
        rows: Rows of the campaign. Shape (r,).
        residual: Measured minus expected, base axes. Shape (r, c). [m or rad]
        group: Stay or path block of each row, ascending. Shape (r,).
        noise: Its noise.
    """

    name: str
    rows: NDArray[np.int_]
    residual: Array
    group: NDArray[np.int_]
    noise: Noise


def block_index(campaign: Campaign) -> NDArray[np.int_]:
    """Number the stays, and blocks of neighbouring samples on paths. Shape (n,), ascending."""
    start = np.r_[True, np.diff(campaign.stay) > 0]
    for number in np.unique(campaign.run_index[campaign.on_path]):
        rows = np.flatnonzero((campaign.run_index == number) & campaign.on_path)
        length = max(SHORTEST_BLOCK, len(rows) // PATH_BLOCKS)
        start[rows] = np.arange(len(rows)) % length == 0
        if len(rows) % length and len(rows) > length:
            start[rows[len(rows) - len(rows) % length]] = False
    return np.cumsum(start) - 1


def position_residual(campaign: Campaign, scene: Scene, attained: Attained) -> Array:
    """Return measured minus expected position, base axes. Shape (n, 3). [m]"""
    gap = campaign.position - attained.position
    return gap if scene.registration is None else gap @ scene.registration.base[:3, :3]


def build_channels(
    scene: Scene, attained: Attained, use: NDArray[np.bool_], noises: dict[str, Noise]
) -> tuple[Channel, ...]:
    """Compare a campaign with what a scene comes to.

    Args:
        scene: The scene; its campaign holds what was measured.
        attained: What the scene comes to.
        use: Rows to use. Shape (n,).
        noises: Noise of each channel by name.
    """
    campaign, block = scene.campaign, block_index(scene.campaign)
    use = use & campaign.usable
    rows = np.flatnonzero(use)
    channels = [
        Channel("position", rows, position_residual(campaign, scene, attained)[rows], block[rows], noises["position"])
    ]
    if campaign.rotation is not None and "orientation" in noises:
        rows = np.flatnonzero(use & np.isfinite(campaign.rotation).all((1, 2)))
        turn = campaign.rotation[rows] @ np.swapaxes(attained.rotation[rows], 1, 2)
        vector = Rotation.from_matrix(turn).as_rotvec() if len(rows) else np.zeros((0, 3))
        if scene.registration is not None:
            vector = vector @ scene.registration.base[:3, :3]
        channels.append(Channel("orientation", rows, vector, block[rows], noises["orientation"]))
    if campaign.link is not None and "encoder" in noises:
        motor = (
            campaign.q if campaign.motor is None else np.where(np.isfinite(campaign.motor), campaign.motor, campaign.q)
        )
        seen = campaign.link - motor - (attained.link - attained.motor)
        known = np.isfinite(campaign.link).all(0) | (np.isfinite(campaign.link).mean(0) > 0.5)
        rows = np.flatnonzero(use & ~campaign.link_controlled & np.isfinite(seen[:, known]).all(1) & known.any())
        channels.append(Channel("encoder", rows, np.where(known, seen, 0.0)[rows], block[rows], noises["encoder"]))
    return tuple(channel for channel in channels if len(channel.rows))


def estimate_noises(campaign: Campaign, attained: Attained) -> dict[str, Noise]:
    """Estimate the noise of every channel from repeats, from the roughness of paths, and from the stated sigma.

    Args:
        campaign: The campaign.
        attained: What the nominal model expects; it only removes motion between neighbouring samples.
    """
    use = campaign.usable
    noises = {}
    gap = np.where(use[:, None], campaign.position - attained.position, np.nan)
    noises["position"] = _channel_noise(campaign, gap, campaign.sigma, "position")
    if campaign.rotation is not None:
        known = use & np.isfinite(campaign.rotation).all((1, 2))
        turn = np.full((len(campaign), 3), np.nan)
        product = campaign.rotation[known] @ np.swapaxes(attained.rotation[known], 1, 2)
        turn[known] = Rotation.from_matrix(product).as_rotvec() if known.any() else np.zeros((0, 3))
        if known.sum() > 5:
            noises["orientation"] = _channel_noise(campaign, turn, campaign.sigma_rotation, "orientation")
    if campaign.link is not None and np.isfinite(campaign.link).any():
        noises["encoder"] = _channel_noise(campaign, campaign.link - attained.link, None, "encoder")
    return noises


def _channel_noise(campaign: Campaign, gap: Array, stated: Array | None, name: str) -> Noise:
    """Pool what repeats, paths and a stated sigma tell, as far as they agree."""
    told: list[tuple[str, float, float]] = []
    squares, count = _repeat_scatter(campaign, gap)
    if count > 0 and squares > 0:
        told.append(("repeats", squares / count, count))
    rough, rough_count = _path_roughness(campaign, gap)
    if rough_count > 30 and rough > 0:
        told.append(("path", rough, min(rough_count, 300.0)))
    known = None if stated is None or not np.isfinite(stated).any() else float(np.nanmedian(stated))
    if known is not None and known > 0:
        told.append(("sigma column", known**2, 60.0))
    if not told:
        return Noise(ASSUMED_SIGMA[name], 0.0, "assumed")
    # what shakes on a path, or between repeats, is no noise of the instrument: sources far above the least one do not
    # count
    firm = [variance for _, variance, weight in told if weight >= 10] or [told[0][1]]
    told = [source for source in told if source[1] < DISAGREE * min(firm) or source[2] < 10]
    weight = sum(w for _, _, w in told)
    variance = sum(v * w for _, v, w in told) / weight
    return Noise(float(np.sqrt(variance)), float(weight), " and ".join(label for label, _, _ in told))


def _repeat_scatter(campaign: Campaign, gap: Array) -> tuple[float, float]:
    """Return squares and degrees of freedom of repeated rows, outlying pairs left out."""
    static = ~campaign.on_path & np.isfinite(gap).all(1)
    rows = np.flatnonzero(static)
    if len(rows) < 2:
        return 0.0, 0.0
    pairs = rows[:-1][(np.diff(campaign.visit[rows]) == 0) & (np.diff(rows) == 1)]
    if not len(pairs):
        return 0.0, 0.0
    half = (gap[pairs + 1] - gap[pairs]) ** 2 / 2.0
    total = half.sum(1)
    keep = total <= 12.0 * max(float(np.median(total)), 1e-30)
    return float(half[keep].sum()), float(half[keep].size)


def _path_roughness(campaign: Campaign, gap: Array) -> tuple[float, float]:
    """Return variance and degrees of freedom from third differences along paths, robustly."""
    pieces = []
    for number in np.unique(campaign.run_index[campaign.on_path]):
        rows = np.flatnonzero((campaign.run_index == number) & campaign.on_path)
        values = gap[rows][np.isfinite(gap[rows]).all(1)]
        if len(values) > 20:
            pieces.append(np.diff(values, n=3, axis=0) / np.sqrt(20.0))
    if not pieces:
        return 0.0, 0.0
    rough = np.vstack(pieces)
    return float((1.4826 * np.median(np.abs(rough))) ** 2), rough.size / 3.0
