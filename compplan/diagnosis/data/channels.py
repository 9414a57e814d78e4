"""Channels: measured minus expected values, with noise and groups of rows that share an error.

Position, orientation and link-side encoders are three channels, each weighted by its noise. Rows of one stay (the robot
did not move) and neighbouring samples of a path share the model error there, so that they are not independent
observations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.noise import NOISE, Noise, estimate_noise
from compplan.diagnosis.data.shared import ENOUGH_ROWS, FEW_ROWS
from compplan.effects.forward_model import Attained, ForwardModel
from compplan.measurement.campaign import Campaign
from compplan.measurement.registration import (
    CONTACTS,
    Registration,
    campaign_directions,
    campaign_gap,
    campaign_turn,
)
from compplan.robot import Array

#: Least number of samples in a block of a path; neighbouring samples share an error (assumed).
SHORTEST_BLOCK = 8


@dataclass(frozen=True, eq=False)
class Channel:
    """One kind of observation; r rows of it, c components."""

    name: str  #: "position", "orientation", "encoder" or "distance" (known distances between contacts).
    rows: NDArray[np.int_]  #: Rows of the campaign. Shape (r,).
    residual: Array  #: Measured minus expected, base axes. Shape (r, c). [m or rad]
    group: NDArray[np.int_]  #: Stay or path block of each row, ascending. Shape (r,).
    noise: Noise  #: Noise of the channel.
    #: Direction (r, 3) along which a row measures one value, NaN for rows that measure all; None: all rows do.
    direction: Array | None = None

    def take(self, keep: NDArray[np.bool_]) -> Channel:
        """Select rows. Shape of `keep`: (r,)."""
        direction = None if self.direction is None else self.direction[keep]
        return replace(
            self, rows=self.rows[keep], residual=self.residual[keep], group=self.group[keep], direction=direction
        )

    @cached_property
    def n_values(self) -> Array:
        """Number of values measured by each row. Shape (r,)."""
        width = np.full(len(self.rows), float(self.residual.shape[1]))
        if self.direction is not None:
            width[np.isfinite(self.direction).all(axis=1)] = 1.0
        return width

    @cached_property
    def axes(self) -> Array:
        """Projector on the measured components of each row: all c axes, or its direction. Shape (r, c, c)."""
        every = np.tile(np.eye(self.residual.shape[1]), (len(self.rows), 1, 1))
        if self.direction is None:
            return every
        along = self.direction[:, :, None] * self.direction[:, None, :]
        return np.asarray(np.where(np.isfinite(along), along, every))

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of each row. Shape (r, 1). [m or rad]"""
        return np.asarray(self.noise.sigma * self.noise.spread_of(self.rows)[:, None])


def block_index(campaign: Campaign) -> NDArray[np.int_]:
    """Number the stays, and blocks of neighbouring samples on paths. Shape (n,), ascending."""
    start = np.r_[True, np.diff(campaign.stay) > 0]
    for number in np.unique(campaign.run_index[campaign.on_path]):
        rows = np.flatnonzero((campaign.run_index == number) & campaign.on_path)
        length = max(SHORTEST_BLOCK, len(rows) // ENOUGH_ROWS)
        start[rows] = np.arange(len(rows)) % length == 0
        if len(rows) % length and len(rows) > length:
            start[rows[len(rows) - len(rows) % length]] = False
    return np.cumsum(start) - 1


def group_poses(campaign: Campaign) -> NDArray[np.int_]:
    """Number the poses of rows at rest, repeated poses alike, and the blocks of paths, below zero. Shape (n,)."""
    return np.where(campaign.on_path, -1 - block_index(campaign), campaign.pose)


def position_residual(campaign: Campaign, scene: ForwardModel, attained: Attained) -> Array:
    """Return measured minus expected position, base axes. Shape (n, 3). [m]"""
    return campaign_gap(campaign, attained.position, scene.registration)


def build_channels(
    scene: ForwardModel, attained: Attained, use: NDArray[np.bool_], noises: dict[str, Noise]
) -> tuple[Channel, ...]:
    """Compute the residuals of all channels of a solved scene in the rows to use, shape (n,)."""
    campaign, block = scene.campaign, block_index(scene.campaign)
    use = use & campaign.usable
    rows = np.flatnonzero(use)
    direction = campaign_directions(campaign, attained.position, scene.registration)
    channels = [
        Channel("position", rows, position_residual(campaign, scene, attained)[rows], block[rows], noises["position"],
                None if direction is None else direction[rows])
    ]  # fmt: skip
    if campaign.rotation is not None and "orientation" in noises:
        turn = campaign_turn(campaign, attained.rotation)
        rows = np.flatnonzero(use & np.isfinite(turn).all(axis=1))
        vector = turn[rows]
        if scene.registration is not None:
            vector = vector @ scene.registration.base[:3, :3]
        channels.append(Channel("orientation", rows, vector, block[rows], noises["orientation"]))
    if campaign.link is not None and "encoder" in noises:
        motor = (
            campaign.q if campaign.motor is None else np.where(np.isfinite(campaign.motor), campaign.motor, campaign.q)
        )
        seen = campaign.link - motor - (attained.link - attained.motor)
        read = np.median(np.isfinite(campaign.link), axis=0) > 0
        rows = np.flatnonzero(use & ~campaign.link_controlled & np.isfinite(seen[:, read]).all(1) & read.any())
        channels.append(Channel("encoder", rows, np.where(read, seen, 0.0)[rows], block[rows], noises["encoder"]))
    frames = scene.registration
    if "distance" in noises and campaign.observations is not None and frames is not None and CONTACTS in frames.parts:
        known, first = campaign.observations.known, campaign.observations.first_rows()
        gap = known.gap(frames.places) * noises["distance"].sigma / known.sigma
        channels.append(Channel("distance", first, gap[:, None], np.arange(len(known)), noises["distance"]))
    return tuple(channel for channel in channels if len(channel.rows))


def estimate_noises(
    campaign: Campaign, attained: Attained, repeatability: float | None = None, frames: Registration | None = None
) -> dict[str, Noise]:
    """Estimate the noise of every channel from the campaign and the robot folder.

    `attained` only removes motion between neighbouring samples and between visits; `repeatability` is that of the robot
    folder, per axis [m].
    """
    use = campaign.usable
    noises = {}
    gap = np.where(use[:, None], campaign_gap(campaign, attained.position, frames), np.nan)
    direction = campaign_directions(campaign, attained.position, frames)
    if direction is not None:
        # one value in three axes: scaled to its variance per axis
        gap[np.isfinite(direction).all(axis=1)] *= np.sqrt(3.0)
    if campaign.observations is not None and len(campaign.observations.known):
        mean = float(np.sqrt(np.mean(campaign.observations.known.sigma**2)))
        noises["distance"] = Noise(mean, NOISE.stated, "sigma of the known distances")
    noises["position"] = estimate_noise(campaign, gap, campaign.sigma, "position", repeatability)
    if campaign.rotation is not None:
        turn = campaign_turn(campaign, attained.rotation)
        if np.isfinite(turn).all(axis=1).sum() > FEW_ROWS:
            noises["orientation"] = estimate_noise(campaign, turn, campaign.sigma_rotation, "orientation")
    if campaign.link is not None and np.isfinite(campaign.link).any():
        noises["encoder"] = estimate_noise(campaign, campaign.link - attained.link, None, "encoder")
    return noises
