"""Fitted rows of a log, their relative weights, and their measuring frames."""

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

#: Standard deviation of encoder differences (assumed). [rad or m]
SIGMA_ENCODER = 1e-5
#: Folds of the cross-validation.
FOLDS = 5
#: The measuring frame is the robot base frame, the target the TCP, and neither is fitted.
KNOWN_FRAMES = Registration(np.eye(4), np.eye(4)[None], ("",), ())


@dataclass(frozen=True, eq=False)
class Rows:
    """Input of a fit; n rows of a log."""

    campaign: Campaign  #: The complete log, since some effects depend on earlier rows.
    row: NDArray[np.int_]  #: Indices of the fitted rows, from 0. Shape (n,).
    registration: Registration  #: Frames of the campaign; its `parts` are fitted, too.
    loss: str = "least_squares"  #: "least_squares", "huber" or "tukey" (both 95 % efficient).
    #: "absolute": poses as measured. "difference": rows of the same commanded pose are compared only with each other,
    #: so that errors of geometry and frames cancel [Klimchik2018, eqs. 4-6].
    reference: str = "absolute"
    #: "residuals": the stated standard deviations are relative weights within position and within orientation, and
    #: their scale is estimated from the residuals. "stated": they are used as stated.
    sigma: str = "residuals"

    def __len__(self) -> int:
        return len(self.row)

    @cached_property
    def taken(self) -> Campaign:
        """Return the fitted rows as a log."""
        return self.campaign.take(self.row)

    @cached_property
    def turned(self) -> bool:
        """Return whether orientation is measured; otherwise a tool is a point."""
        return self.taken.rotation is not None

    @cached_property
    def deviation(self) -> Array:
        """Return the stated standard deviation of position and orientation, per axis. Shape (n, 6). [m, rad]"""
        log, n = self.taken, len(self)
        place = np.full(n, ASSUMED_SIGMA_POSITION) if log.sigma is None else log.sigma
        turn = np.full(n, ASSUMED_SIGMA_ROTATION) if log.sigma_rotation is None else log.sigma_rotation
        return np.repeat(np.column_stack([place, turn]), 3, axis=1)

    @cached_property
    def encoder(self) -> Array | None:
        """Return link-side minus motor-side reading, commanded joints being those of the controlling side, or None."""
        log = self.taken
        if log.link is None and log.motor is None:
            return None
        nothing, by_link = np.full(log.q.shape, np.nan), log.link_controlled[:, None]
        link = np.where(by_link, log.q, nothing if log.link is None else log.link)
        motor = np.where(by_link, nothing if log.motor is None else log.motor, log.q)
        return link - motor if np.isfinite(link - motor).any() else None

    @cached_property
    def pose(self) -> NDArray[np.int_]:
        """Return the number of the commanded pose (0.006 deg or 0.1 mm), for any mode and target. Shape (n,)."""
        return number_rows(np.round(self.taken.q / 1e-4))

    @property
    def poses(self) -> int:
        """Return the number of distinct commanded poses, to 1e-4 rad or 0.1 mm."""
        return count_poses(self.taken.q)

    @cached_property
    def alike(self) -> NDArray[np.int_]:
        """Return the number of the commanded pose, mode and target. Shape (n,)."""
        log = self.taken
        return number_rows(np.column_stack([np.round(log.q / 1e-4), log.link_controlled, log.target_index]))

    @property
    def group(self) -> NDArray[np.int_] | None:
        """Return the groups in which rows are compared with each other; None for absolute poses. Shape (n,)."""
        return None if self.reference == "absolute" else self.alike

    @cached_property
    def fold(self) -> NDArray[np.int_]:
        """Return the fold of each row, in the order of measuring; rows of one pose are in one fold. Shape (n,)."""
        first = np.full(int(self.pose.max(initial=-1)) + 1, len(self))
        np.minimum.at(first, self.pose, np.arange(len(self)))
        rank = np.argsort(np.argsort(first))
        return np.asarray(rank[self.pose] * min(FOLDS, len(first)) // len(first))


def count_poses(q: Array) -> int:
    """Return the number of distinct joint positions, to 1e-4 rad or 0.1 mm. q: shape (n, nq)."""
    return len(np.unique(np.round(q, 4), axis=0))


def take_rows(campaign: Campaign, registration: Registration, loss: str) -> tuple[Rows, list[str]]:
    """Select the static poses of a log with joints, load and position; also return notes on omissions and assumptions.

    Raises:
        InputError: If no row is usable.
    """
    row = np.flatnonzero(usable_rows(campaign))
    notes = []
    passed = int((campaign.usable & campaign.on_path).sum())
    if passed:
        notes.append(f"{passed} rows that were sampled on the fly are left out: lag is not compliance")
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
    """Return which rows are static poses with joints, load and position. Shape (n,).

    Raises:
        InputError: If there is none.
    """
    rows = campaign.usable & ~campaign.on_path
    if not rows.any():
        message = 'no settled pose in this log; compliances are identified from runs whose label begins with "static"'
        raise InputError(message, file=campaign.file)
    return np.asarray(rows)
