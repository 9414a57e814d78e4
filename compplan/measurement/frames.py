"""Fit frames of a campaign (instrument, target, contacts), move them, and differentiate measured poses by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.measurement.campaign import Campaign
from compplan.measurement.observations import Observations, along
from compplan.measurement.registration import CONTACTS, PARTS, Registration
from compplan.robot import Array
from compplan.robot.pose import rigid_columns

#: Degrees of freedom of a frame: translations and rotations.
TURNS: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")
STEPS = 60
#: Fewest rows that determine a frame, and extent below which positions are equal. [m]
LEAST_ROWS, SAME_PLACE = 3, 1e-6
#: Step size of convergence. [m or rad]
CONVERGED = 1e-10
#: Weight of an orientation residual relative to a position residual. [m/rad]
ANGLE_WEIGHT = 0.5


def frame_columns(
    frames: Registration, position: Array, tcp_rotation: Array, target: NDArray[np.int_], turned: bool,
    observations: Observations | None = None,
) -> list[Array]:  # fmt: skip
    """Differentiate measured poses by the fitted frames, in the order of `move_frames`. Shapes (n, 6, 3 or 6).

    position: predicted measured points, measuring frame, (n, 3) [m]; tcp_rotation: base axes, (n, 3, 3); target: index
    of the measured point, (n,); turned: whether orientation is measured, otherwise a tool is a point; observations: of
    other instruments, which depend on contact positions and not on the base of a tracker.
    """
    n, parts = len(position), []
    if "base" in frames.parts:
        base = np.zeros((n, 6, 6))
        base[:] = np.eye(6)
        base[:, :3] = rigid_columns(position, frames.base[:3, 3])
        if observations is not None:
            base[observations.observed] = 0.0
        parts.append(base)
    if "tool" in frames.parts:
        size = 6 if turned else 3
        axes = frames.base[:3, :3] @ tcp_rotation
        for number in range(len(frames.tool)):
            tool = np.zeros((n, 6, size))
            own = np.flatnonzero(target == number)
            tool[own, :3, :3] = axes[own]
            if size == 6:
                tool[own, 3:, 3:] = axes[own]
            parts.append(tool)
    if CONTACTS in frames.parts and observations is not None:
        slopes = -np.einsum("ij,njlk->nilk", frames.base[:3, :3], observations.place_slopes()).reshape(n, 3, -1)
        parts.append(np.concatenate([slopes, np.zeros_like(slopes)], axis=1))
    return parts


def name_frames(frames: Registration, turned: bool) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return label, part, and degrees of freedom of each fitted frame, in the order of `move_frames`."""
    many = len(frames.tool) > 1
    found = [("base", "base", TURNS)] if "base" in frames.parts else []
    if "tool" in frames.parts:
        labels = [f"tool({label or k})" if many else "tool" for k, label in enumerate(frames.targets, 1)]
        found += [(label, "tool", TURNS if turned else TURNS[:3]) for label in labels]
    if CONTACTS in frames.parts:
        found += [(f"contact({label})", CONTACTS, TURNS[:3]) for label in frames.contacts]
    return found


def move_frames(frames: Registration, change: Array, turned: bool) -> Registration:
    """Move the fitted frames by a step: base in measuring axes, tools in TCP axes, rotation about their origins."""
    base, tools, used = frames.base.copy(), frames.tool.copy(), 0
    moved = [(base, 6)] if "base" in frames.parts else []
    if "tool" in frames.parts:
        moved += [(tool, 6 if turned else 3) for tool in tools]
    for pose, size in moved:
        step = np.zeros(6)
        step[:size] = change[used : used + size]
        pose[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += step[:3]
        used += size
    places = frames.places + change[used:].reshape(-1, 3) if CONTACTS in frames.parts else frames.places
    return replace(frames, base=base, tool=tools, places=places)


def fit_registration(
    campaign: Campaign,
    position: Array,
    rotation: Array,
    parts: Sequence[str],
    *,
    rows: NDArray[np.bool_] | None = None,
    start: Registration | None = None,
) -> Registration:
    """Fit frames and contact positions to a campaign, robustly; the poses of the robot are not changed.

    Minimises the distance of T_world_base T_base_tcp T_tcp_target from the measured targets, including orientation if
    measured, and the residuals of other instruments (`compplan.measurement.observations`), by Gauss-Newton steps with
    Huber weights, started from the best rigid fit of the positions.

    Args:
        campaign: The measurements.
        position: TCP predicted by the robot model, base frame. Shape (n, 3). [m]
        rotation: Predicted orientation of the TCP. Shape (n, 3, 3).
        parts: Frames to fit, of "base", "tool" and "contact".
        rows: Rows to use; all usable ones if left out. Shape (n,), bool.
        start: Initial frames, kept unless fitted; identity and target offset if left out.

    Raises:
        InputError: If the rows do not determine a frame: fewer than three, or the tool at one place in all of them.
    """
    use = campaign.usable if rows is None else np.asarray(rows, bool) & campaign.usable
    index = np.flatnonzero(use)
    registration = replace(start or Registration.identity(campaign, parts), parts=tuple(parts))
    if not len(index) or not parts:
        return registration
    _check_rows(campaign, position[index], len(index), parts)
    log, p, R = campaign.take(index), position[index], rotation[index]
    if "base" in parts:
        registration = replace(registration, base=_start_base(log, p, R))
    if campaign.observations is not None:
        tool = registration.tool[campaign.target_index, :3, 3]
        point = np.where(campaign.usable[:, None], position + np.einsum("nij,nj->ni", rotation, tool), np.nan)
        places = campaign.observations.start_places(point)
        registration = replace(registration, contacts=campaign.observations.names, places=places)
    for _ in range(STEPS):
        step = _step(log, p, R, registration)
        registration = move_frames(registration, step, log.rotation is not None)
        if np.abs(step).max(initial=0.0) < CONVERGED:
            break
    return registration


def _check_rows(campaign: Campaign, position: Array, count: int, parts: Sequence[str]) -> None:
    """Reject rows that do not determine the frames: too few, or without motion of the tool or the target."""
    asked = [part for part in parts if part in PARTS]
    words = f"--register {','.join(asked)}" if asked else "a log of contacts"
    if count < LEAST_ROWS:
        message = f"{words} needs at least {LEAST_ROWS} rows with joints and a measured position, the log has {count}"
        raise InputError(message, file=campaign.file)
    measured = campaign.position[campaign.usable & campaign.measured]
    for what, points in (("joints", position), ("measured positions", measured)):
        if len(points) and float(np.ptp(points, axis=0).max()) < SAME_PLACE:
            message = f"{words} needs poses that differ, the {what} leave the tool at one place in all {count} rows"
            raise InputError(message, file=campaign.file)


def _start_base(log: Campaign, position: Array, rotation: Array) -> Array:
    """Estimate the initial base frame from at least three orientations, otherwise by a rigid fit of the positions."""
    base, here = np.eye(4), log.measured
    p, R, measured = position[here], rotation[here], log.position[here]
    turned = np.full((len(p), 3, 3), np.nan) if log.rotation is None else log.rotation[here]
    known = np.isfinite(turned).all((1, 2))
    if known.sum() >= 3:
        base[:3, :3] = _base_rotation(R[known], turned[known])
    else:
        centred, aside = p - np.median(p, axis=0), measured - np.median(measured, axis=0)
        base[:3, :3] = Rotation.align_vectors(aside, centred)[0].as_matrix()
    base[:3, 3] = np.median(measured - p @ base[:3, :3].T, axis=0)
    return base


def _base_rotation(R: Array, turned: Array) -> Array:
    """Solve R_measured = X R Y for X: relative rotations of both sides have the same axis up to X."""
    pairs = np.random.default_rng(0).integers(0, len(R), (400, 2))
    a = Rotation.from_matrix(R[pairs[:, 0]] @ np.swapaxes(R[pairs[:, 1]], 1, 2)).as_rotvec()
    b = Rotation.from_matrix(turned[pairs[:, 0]] @ np.swapaxes(turned[pairs[:, 1]], 1, 2)).as_rotvec()
    fair = (np.linalg.norm(a, axis=1) > 0.2) & (np.linalg.norm(a, axis=1) < 2.8)
    if fair.sum() < 3:
        return np.eye(3)
    return np.asarray(Rotation.align_vectors(b[fair], a[fair])[0].as_matrix())


def _step(log: Campaign, p: Array, R: Array, frames: Registration) -> Array:
    """Compute a weighted Gauss-Newton step, in the order of `move_frames`. p, R: TCP of the model at the rows."""
    base, local, turned, observations = frames.base, frames.tool[log.target_index], log.rotation, log.observations
    point = p + np.einsum("nij,nj->ni", R, local[:, :3, 3])
    seen = point @ base[:3, :3].T + base[:3, 3]
    parts = frame_columns(frames, seen, R, log.target_index, turned is not None, observations)
    jacobian, residual = np.concatenate(parts, axis=2), np.zeros((len(p), 6))
    size = jacobian.shape[2]
    residual[:, :3] = log.position - seen
    if turned is not None:
        known, world = np.isfinite(turned).all((1, 2)), base[:3, :3] @ R @ local[:, :3, :3]
        residual[known, 3:] = Rotation.from_matrix(turned[known] @ np.swapaxes(world[known], 1, 2)).as_rotvec()
        jacobian[~known, 3:] = 0.0
    else:
        jacobian[:, 3:] = 0.0
    residual[:, 3:] *= ANGLE_WEIGHT
    jacobian[:, 3:] *= ANGLE_WEIGHT
    if observations is not None:
        sighted = observations.observed
        slopes = along(observations.directions(point, frames.places), base[:3, :3].T @ jacobian[:, :3])
        residual[:, :3] = np.where(sighted[:, None], observations.gap(point, frames.places), residual[:, :3])
        jacobian[:, :3] = np.where(sighted[:, None, None], slopes, jacobian[:, :3])
    length = np.linalg.norm(residual, axis=1)
    knee = 3.0 * max(float(np.median(length)), 1e-9)
    root = np.sqrt(np.minimum(1.0, knee / np.maximum(length, 1e-12)))
    a, b = (jacobian * root[:, None, None]).reshape(-1, size), (residual * root[:, None]).reshape(-1)
    if observations is not None and CONTACTS in frames.parts:
        sure, sigma = observations.known, 1.0 if log.sigma is None else float(np.nanmedian(log.sigma))
        weight, own = sigma / sure.sigma, sure.slopes(frames.places).reshape(len(sure), 3 * len(frames.places))
        slopes = np.hstack([np.zeros((len(sure), size - 3 * len(frames.places))), own])
        a, b = np.vstack([a, slopes * weight[:, None]]), np.r_[b, sure.gap(frames.places) * weight]
    return np.asarray(np.linalg.lstsq(a, b, rcond=1e-10)[0])
