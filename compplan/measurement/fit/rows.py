"""The rows of a log that are fitted, how they are weighed against each other, and the frames they were measured in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.measurement.campaign import ASSUMED_SIGMA_POSITION, ASSUMED_SIGMA_ROTATION, Campaign, number_rows
from compplan.measurement.fit.least_squares import check_loss
from compplan.measurement.registration import Registration
from compplan.robot import Array

#: Assumed for encoder differences. [rad or m]
SIGMA_ENCODER = 1e-5
#: Blocks of poses that are left out in turn.
FOLDS = 5
#: The measuring frame is the robot base frame, the target the TCP, and neither is fitted.
KNOWN_FRAMES = Registration(np.eye(4), np.eye(4)[None], ("",), ())


@dataclass(frozen=True, eq=False)
class Rows:
    """What a fit is made to; n rows of a log."""

    campaign: Campaign  #: The whole log, since some effects remember where the robot came from.
    row: NDArray[np.int_]  #: The rows that are fitted, counted from 0. Shape (n,).
    registration: Registration  #: Frames of the campaign; its `parts` are fitted along.
    loss: str = "least_squares"  #: "least_squares", "huber" or "tukey" (both 95 % efficient).
    #: "absolute": poses as they were measured. "difference": rows of the same commanded pose are compared with each
    #: other only, so that errors of geometry and frames there drop out [Klimchik2018, eqs. 4-6].
    reference: str = "absolute"
    #: "residuals": the stated standard deviations give relative weights inside position and inside orientation, and the
    #: residuals say how large they are. "stated": they are trusted.
    sigma: str = "residuals"

    def __len__(self) -> int:
        return len(self.row)

    @cached_property
    def taken(self) -> Campaign:
        """The rows alone, as a log."""
        return self.campaign.take(self.row)

    @cached_property
    def turned(self) -> bool:
        """Whether orientation is measured; without it a tool is a point."""
        return self.taken.rotation is not None

    @cached_property
    def deviation(self) -> Array:
        """Stated standard deviation of position and orientation, per axis. Shape (n, 6). [m, rad]"""
        log, n = self.taken, len(self)
        place = np.full(n, ASSUMED_SIGMA_POSITION) if log.sigma is None else log.sigma
        turn = np.full(n, ASSUMED_SIGMA_ROTATION) if log.sigma_rotation is None else log.sigma_rotation
        return np.repeat(np.column_stack([place, turn]), 3, axis=1)

    @cached_property
    def encoder(self) -> Array | None:
        """Link-side minus motor-side reading, the commanded joints being those of the side that controls; or None."""
        log = self.taken
        if log.link is None and log.motor is None:
            return None
        nothing, by_link = np.full(log.q.shape, np.nan), log.link_controlled[:, None]
        link = np.where(by_link, log.q, nothing if log.link is None else log.link)
        motor = np.where(by_link, nothing if log.motor is None else log.motor, log.q)
        return link - motor if np.isfinite(link - motor).any() else None

    @cached_property
    def pose(self) -> NDArray[np.int_]:
        """Number of the commanded pose (within 0.006 deg or 0.1 mm), whatever mode and target. Shape (n,)."""
        return number_rows(np.round(self.taken.q / 1e-4))

    @property
    def poses(self) -> int:
        """Count the commanded poses, to 1e-4 rad or 0.1 mm."""
        return count_poses(self.taken.q)

    @cached_property
    def alike(self) -> NDArray[np.int_]:
        """Number of the commanded pose, mode and target. Shape (n,)."""
        log = self.taken
        return number_rows(np.column_stack([np.round(log.q / 1e-4), log.link_controlled, log.target_index]))

    @property
    def group(self) -> NDArray[np.int_] | None:
        """Groups in which rows are compared with each other; None for absolute poses. Shape (n,)."""
        return None if self.reference == "absolute" else self.alike

    @cached_property
    def fold(self) -> NDArray[np.int_]:
        """Block of each row, in the order of measuring; rows of one pose stay together. Shape (n,)."""
        first = np.full(int(self.pose.max(initial=-1)) + 1, len(self))
        np.minimum.at(first, self.pose, np.arange(len(self)))
        rank = np.argsort(np.argsort(first))
        return np.asarray(rank[self.pose] * min(FOLDS, len(first)) // len(first))


def count_poses(q: Array) -> int:
    """Count different joint positions, to 1e-4 rad or 0.1 mm. Shape (n, nq)."""
    return len(np.unique(np.round(q, 4), axis=0))


def take_rows(campaign: Campaign, registration: Registration, loss: str) -> tuple[Rows, list[str]]:
    """Take the settled poses with joints, load and position of a log, and say what was left out or assumed.

    Raises:
        InputError: If no row can be used.
    """
    row = np.flatnonzero(usable_rows(campaign))
    notes = [note for note in campaign.notes if "pasted" in note]
    passed = int((campaign.usable & campaign.on_path).sum())
    if passed:
        notes.append(f"{passed} rows that were sampled on the fly are left out: lag is no compliance")
    if missing := len(campaign) - len(row) - passed:
        notes.append(f"{missing} rows lack joints, load or position and are left out")
    stated: dict[str, Any] = {}
    for key, what, text, needed in (
        ("sigma", "position", "0.05 mm", True),
        ("sigma_rotation", "orientation", "0.1 mrad", campaign.rotation is not None),
    ):
        value = getattr(campaign, key)
        if value is not None and np.isfinite(value).any():
            stated[key] = np.where(np.isfinite(value) & (value > 0), value, np.nanmedian(value))
        elif needed:
            said = f"no standard deviation of {what} is stated: {text} is assumed to begin with"
            notes.append(f"{said}, then the residuals decide")
            stated[key] = None
    return Rows(replace(campaign, **stated), row, registration, check_loss(loss)), notes


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
