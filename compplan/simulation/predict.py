"""Prediction of the instrument readings by the model of the robot folder, effects included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.effects import apply_effects, robot_effects
from compplan.effects.forward_model import Attained, build_model, solve_model_poses
from compplan.io.columns import to_unit
from compplan.io.tables import write_table
from compplan.measurement.campaign import Campaign
from compplan.measurement.frames import fit_registration
from compplan.measurement.registration import (
    Registration,
    campaign_gap,
    fitted_parts,
    match_targets,
    stated_registration,
)
from compplan.robot import Array, Robot


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted instrument readings; n rows, NaN in rows without joint positions."""

    #: Target in the instrument frame; in the base frame for rows without a measured position. Shape (n, 3). [m]
    position: Array
    rotation: Array  #: Orientation of the target. Shape (n, 3, 3).
    attained: Attained  #: Attained poses of the forward model.
    registration: Registration | None  #: Frames used, or None.
    gap: Array  #: Measured minus predicted, base axes; places of contacts fitted. Shape (n, 3). [m]


def predict_campaign(
    robot: Robot, campaign: Campaign, *, register: Sequence[str] = (), registration: Registration | None = None,
    later: bool = True,
) -> Prediction:  # fmt: skip
    """Predict every row of a campaign from a robot, its effects included.

    Args:
        robot: The robot.
        campaign: The rows. Measured positions are used for the registration only.
        register: Which of "base" and "tool" to fit to the campaign, other parameters fixed.
        registration: Frames to use if none are fitted.
        later: Whether the shifts of effects happened before this campaign; otherwise at their rows.
    """
    effects = robot_effects(robot)
    scene = apply_effects(build_model(robot, campaign, later=later), effects)
    attained = solve_model_poses(scene)
    start = stated_registration(campaign) if registration is None else match_targets(registration, campaign)
    parts = fitted_parts(campaign, register)
    if parts:
        kept = None if register else start
        registration = fit_registration(campaign, attained.position, attained.rotation, parts, start=kept)
    else:
        registration = start
    if registration is not None:
        attained = solve_model_poses(replace(scene, registration=registration))
    known = np.asarray(np.isfinite(campaign.q).all(axis=1), bool)
    position = np.where(known[:, None], attained.position, np.nan)
    rotation = np.where(known[:, None, None], attained.rotation, np.nan)
    gap = campaign_gap(campaign, position, registration)
    if campaign.observations is not None and registration is not None:
        own = (position - registration.base[:3, 3]) @ registration.base[:3, :3]
        position = np.where(campaign.observations.observed[:, None], own, position)
    return Prediction(position, rotation, attained, registration, gap)


def write_prediction(prediction: Prediction, file: str | Path) -> None:
    """Write x_mm y_mm z_mm rx_deg ry_deg rz_deg of every row."""
    position = to_unit(prediction.position, "x_mm")
    known = np.isfinite(prediction.rotation).all((1, 2))
    vector = np.full_like(position, np.nan)
    vector[known] = np.rad2deg(Rotation.from_matrix(prediction.rotation[known]).as_rotvec())
    columns = {f"{axis}_mm": position[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"r{axis}_deg": vector[:, k] for k, axis in enumerate("xyz")}
    write_table(file, columns)
