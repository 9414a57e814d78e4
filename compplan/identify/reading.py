"""From a measurement log to observations: rows that can be used, their weights, frames, and effects that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.effects import apply_effects, attain_scene, robot_effects, stage_scene
from compplan.effects.scene import Attained
from compplan.errors import InputError
from compplan.identify.observations import (
    ASSUMED_SIGMA_POSITION,
    ASSUMED_SIGMA_ROTATION,
    Observations,
    make_observations,
)
from compplan.measure.campaign import Campaign
from compplan.measure.registration import Registration, fit_registration, match_targets, read_registration
from compplan.robot import Array, Robot

#: Fewest unloaded poses from which frames are fitted on their own.
UNLOADED_POSES = 10


def place_frames(robot: Robot, campaign: Campaign, parts: tuple[str, ...]) -> Registration:
    """Find the frames to start from: fitted to unloaded poses, read from the robot folder, or known.

    Args:
        robot: The nominal robot.
        campaign: The log.
        parts: Frames to fit: "base", "tool".
    """
    if parts:
        rows = usable_rows(campaign)
        quiet = rows & campaign.unloaded
        if len(np.unique(np.round(campaign.q[quiet], 4), axis=0)) >= UNLOADED_POSES:
            rows = quiet
        seen = _attain(robot, campaign, None)
        return fit_registration(campaign, seen.position, seen.rotation, parts, rows=rows)  # type: ignore[arg-type]
    file = None if robot.folder is None else Path(robot.folder) / "registration.toml"
    if file is not None and file.exists():
        return replace(match_targets(read_registration(file), campaign), parts=())
    return Registration.identity(campaign, ())


def usable_rows(campaign: Campaign) -> NDArray[np.bool_]:
    """Tell which rows are settled poses with joints, load and position. Shape (n,).

    Raises:
        InputError: If there is none.
    """
    rows = campaign.usable & ~campaign.on_path
    if not rows.any():
        message = 'no settled pose in this log; compliances are identified from runs whose label begins with "static"'
        raise InputError(message, file=campaign.file)
    return np.asarray(rows)


def observe_campaign(robot: Robot, campaign: Campaign, frames: Registration) -> tuple[Observations, list[str]]:
    """Take the rows of a log that identification can use.

    What the effects of the robot folder do is taken off the measurements first, so that they are identified beside it.

    Args:
        robot: The nominal robot.
        campaign: The log.
        frames: Frames of the campaign.

    Returns:
        The observations, and sentences on what was left out or assumed.

    Raises:
        InputError: If no row can be used.
    """
    rows = np.flatnonzero(usable_rows(campaign))
    notes = _notes_on_rows(campaign, len(rows))
    position, rotation = campaign.position, campaign.rotation
    if robot_effects(robot):
        with_effects, without = _attain(robot, campaign, frames), _attain(replace(robot, effects=()), campaign, frames)
        position = position - (with_effects.position - without.position)
        if rotation is not None:
            rotation = without.rotation @ np.swapaxes(with_effects.rotation, 1, 2) @ rotation
        notes.append("the effects of the robot folder were taken off the measurements before identifying")
    sigma_p, said = _standard_deviation(campaign.sigma, ASSUMED_SIGMA_POSITION, "position", "0.05 mm")
    notes += said
    sigma_r = None
    if rotation is not None:
        sigma_r, said = _standard_deviation(campaign.sigma_rotation, ASSUMED_SIGMA_ROTATION, "orientation", "0.1 mrad")
        notes += said
    observations = make_observations(
        campaign.q[rows],
        campaign.wrench[rows],
        position[rows],
        None if rotation is None else rotation[rows],
        sigma_position=sigma_p if np.ndim(sigma_p) == 0 else np.asarray(sigma_p)[rows],
        sigma_rotation=sigma_r if sigma_r is None or np.ndim(sigma_r) == 0 else np.asarray(sigma_r)[rows],
        link_side=campaign.link_controlled[rows],
        target=campaign.target_index[rows],
        encoder=_encoder_difference(campaign, rows),
    )
    return replace(observations, row=rows), notes


def _notes_on_rows(campaign: Campaign, used: int) -> list[str]:
    notes = [note for note in campaign.notes if "pasted" in note]
    passed = int((campaign.usable & campaign.on_path).sum())
    if passed:
        notes.append(f"{passed} rows that were sampled on the fly are left out: lag is no compliance")
    missing = len(campaign) - used - passed
    if missing:
        notes.append(f"{missing} rows lack joints, load or position and are left out")
    return notes


def _standard_deviation(
    stated: Array | None, assumed: float, what: str, text: str
) -> tuple[Array | float, list[str]]:
    if stated is None or not np.isfinite(stated).any():
        said = f"no standard deviation of {what} is stated: {text} is assumed to begin with, then the residuals decide"
        return assumed, [said]
    return np.where(np.isfinite(stated) & (stated > 0), stated, np.nanmedian(stated)), []


def _encoder_difference(campaign: Campaign, rows: NDArray[np.int_]) -> Array | None:
    """Take link-side minus motor-side readings; the commanded joints are the readings of the side that controls."""
    by_link = campaign.link_controlled[:, None]
    if campaign.link is None and campaign.motor is None:
        return None
    nothing = np.full(campaign.q.shape, np.nan)
    link = np.where(by_link, campaign.q, nothing if campaign.link is None else campaign.link)
    motor = np.where(by_link, nothing if campaign.motor is None else campaign.motor, campaign.q)
    difference = (link - motor)[rows]
    return difference if np.isfinite(difference).any() else None


def _attain(robot: Robot, campaign: Campaign, frames: Registration | None) -> Attained:
    return attain_scene(apply_effects(stage_scene(robot, campaign, registration=frames), robot_effects(robot)))
