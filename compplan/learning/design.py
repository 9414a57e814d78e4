"""Choose the measurements that narrow the 95 % band on a path most, and order them.

State x of parameters and unknown frames, covariance S. A measurement of the tip y = H x + noise of covariance R reduces

    S by S H^T (H S H^T + R)^-1 H S        and        tr(L S L^T) by tr(L S H^T (H S H^T + R)^-1 H S L^T),

the variance summed along the path, where L are its slopes. Poses are chosen greedily, then exchanged one by one while
that narrows the band. Poses with one load are measured together, each after the nearest one; the first is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.learning.candidates import Candidates, observe_rows
from compplan.measurement.distance import band_radius
from compplan.measurement.observations import Observations
from compplan.measurement.pose_selection import (
    exchange_choice,
    learn_rows,
    narrow_target,
    offer_once,
    take_greedily,
)
from compplan.planning.posture.clearance import measure_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.robot import Array, Robot
from compplan.robot.pose import rigid_columns
from compplan.robot.uncertainty import Uncertainty
from compplan.uncertainty.band import Slopes, split_covariance
from compplan.uncertainty.ladder import pose_variance
from compplan.uncertainty.poses import LOOSE

#: Least relative reduction of the band by a further pose.
WORTH = 0.005
#: Number of postures checked for collision on a joint move between two poses.
BETWEEN = 7
#: Time added to a joint move that collides. [s]
DETOUR = 1e3


@dataclass(frozen=True, eq=False)
class Design:
    """Linear-Gaussian model of the measurements; p parameters, f unknown coordinates of frames and contacts."""

    known: Uncertainty  #: Prior uncertainty of the robot.
    path: Slopes  #: Linearised path.
    sigma: float  #: Standard deviation of the instrument per axis. [m]
    frames: tuple[str, ...] = ()  #: Unknown frames, of "base" and "tool".
    places: int = 0  #: Number of unknown contact positions.

    @cached_property
    def start(self) -> Array:
        """Return the covariance before the first measurement. Shape (p + f, p + f)."""
        p = len(self.known.factor)
        loose = np.zeros(0)
        if "base" in self.frames:
            loose = np.repeat(LOOSE, 3)
        if "tool" in self.frames:
            loose = np.r_[loose, np.full(3, LOOSE[0])]
        loose = np.r_[loose, np.full(3 * self.places, LOOSE[0])]
        full = np.zeros((p + len(loose), p + len(loose)))
        full[:p, :p] = self.known.covariance
        full[p:, p:] = np.diag(loose**2)
        return full

    @cached_property
    def target(self) -> Array:
        """Return the slopes along the path, zero for frames, which do not move the tip. Shape (3 k, p + f)."""
        k, _, p = self.path.model.shape
        return np.concatenate([self.path.model.reshape(3 * k, p), np.zeros((3 * k, len(self.start) - p))], axis=1)

    @property
    def noise(self) -> float:
        """Return the variance of one measurement per axis. [m^2]."""
        return pose_variance(self.known, self.sigma)

    def rows(self, slopes: Array, tip: Array, rotation: Array, observations: Observations | None = None) -> Array:
        """Return the derivatives of measurements by parameters, frames and contact positions. Shape (m, 3, p + f)."""
        parts = [slopes]
        if "base" in self.frames:
            parts.append(rigid_columns(tip, np.zeros(3)))
        if "tool" in self.frames:
            parts.append(rotation)
        rows = np.concatenate(parts, axis=2)
        return rows if observations is None else observe_rows(rows, observations, tip)

    @cached_property
    def remaining(self) -> Array:
        """Return the covariance of the tip by unexplained errors, repeatability, force. Shape (k, 3, 3). [m^2]."""
        parts = split_covariance(self.path, self.known)
        return parts["unexplained"] + parts["repeatability"] + parts["force"]

    def model(self, covariance: Array) -> Array:
        """Return the covariance of the tip due to parameters, from that of the state. Shape (k, 3, 3). [m^2]."""
        p = len(self.known.factor)
        return np.asarray(self.path.model @ covariance[:p, :p] @ np.swapaxes(self.path.model, 1, 2))

    def band(self, covariance: Array) -> Array:
        """Return the 95 % band along the path with a covariance of the state. Shape (k,). [m]."""
        return band_radius(self.model(covariance) + self.remaining)

    def model_band(self, covariance: Array) -> float:
        """Return the root mean square along the path of the band due to parameters alone. [m]"""
        return float(np.sqrt(np.mean(band_radius(self.model(covariance)) ** 2)))

    @property
    def floor(self) -> Array:
        """Return the band if every parameter were known exactly. Shape (k,). [m]."""
        return self.band(np.zeros_like(self.start))


@dataclass(frozen=True, eq=False)
class Choice:
    """Chosen measurements."""

    rows: NDArray[np.int_]  #: Indices of the candidates: first visits, then by decreasing reduction of the band.
    greatest: Array  #: Greatest band along the path after 0, 1, 2 ... measurements. [m]
    rms: Array  #: Root mean square band after 0, 1, 2 ... measurements. [m]
    covariance: Array  #: Covariance of parameters after all measurements. Shape (p, p).

    @property
    def enough(self) -> int | None:
        """Return the number of poses after which no pose narrows the band by `WORTH`; None if the last one does."""
        gain = 1.0 - self.rms[1:] / np.maximum(self.rms[:-1], 1e-300)
        worth = np.flatnonzero(gain >= WORTH)
        last = int(worth[-1]) + 1 if len(worth) else 0
        return None if last == len(gain) else last


def choose_measurements(design: Design, candidates: Candidates, count: int, start: Array | None = None) -> Choice:
    """Choose `count` measurements: greedily, then exchanged one by one while that narrows the band.

    start: covariance before the first measurement; by default that of `design`.
    """
    before = design.start if start is None else start
    rows = design.rows(candidates.slopes, candidates.tip, candidates.rotation, candidates.observations)
    first = locating_rows(candidates)
    worth = narrow_target(design.target, learn_rows(before, rows[first], design.noise), rows, design.noise)
    posture = np.unique(candidates.q, axis=0, return_inverse=True)[1].reshape(-1)
    worth = offer_once(worth, posture)  # a diagnosis validates itself on postures that it leaves out
    chosen = exchange_choice(worth, take_greedily(worth, count - len(first)))
    return evaluate_choice(design, rows, [*first, *(number for number, _ in chosen)], before)


def locating_rows(candidates: Candidates) -> list[int]:
    """Return the row of the first visit to every unknown place: it locates the place; later visits measure the arm."""
    observations = candidates.observations
    return [] if observations is None else np.unique(observations.contact, return_index=True)[1].tolist()


def evaluate_choice(design: Design, rows: Array, chosen: Sequence[int], before: Array) -> Choice:
    """Compute the band along the path after 0, 1, 2 ... of the chosen measurements."""
    covariance, bands = before, [design.band(before)]
    for number in chosen:
        covariance = learn_rows(covariance, rows[[number]], design.noise)
        bands.append(design.band(covariance))
    p = len(design.known.factor)
    greatest = np.array([band.max() for band in bands])
    rms = np.array([np.sqrt(np.mean(band**2)) for band in bands])
    return Choice(np.array(chosen, int), greatest, rms, covariance[:p, :p])


def order_poses(
    robot: Robot, q: Array, start: Array, load: Array, home: Array, scene: CollisionScene | None
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Order poses for short joint moves, one load after another; also return the poses reached with a collision.

    q: poses, start: starts of their approaches, (m, nq), home: initial posture, (nq,) [rad or m]; load: (m, 6)
    [N, N m]; scene: collision scene, or None.
    """
    way = measure_travel(robot, np.vstack([home[None], q]), np.vstack([home[None], start]), scene)
    _, group = np.unique(np.round(load, 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    size = np.array([np.abs(load[group == g]).sum() for g in range(group.max() + 1)])
    order: list[int] = []
    for number in np.argsort(size, kind="stable"):
        left = set(np.flatnonzero(group == number).tolist())
        while left:
            here = order[-1] + 1 if order else 0
            order.append(min(left, key=lambda k: (way[here, k + 1], k)))
            left.remove(order[-1])
    steps = [way[a + 1, b + 1] for a, b in zip([-1, *order[:-1]], order, strict=True)]
    return np.array(order, int), np.flatnonzero(np.array(steps) >= DETOUR)


def measure_travel(robot: Robot, q: Array, start: Array, scene: CollisionScene | None) -> Array:
    """Return the time of the joint move from every pose to every start [s], `DETOUR` added if it collides. (m, m)."""
    speed = np.where(np.isfinite(robot.velocity_limits), robot.velocity_limits, 1.0)
    time = np.max(np.abs(start[None] - q[:, None]) / speed, axis=2)
    if scene is None:
        return np.asarray(time)
    m = len(q)
    pairs = np.array([(a, b) for a in range(m) for b in range(m) if a != b], int).reshape(-1, 2)
    share = np.linspace(0.0, 1.0, BETWEEN + 2)[1:-1]
    postures = q[pairs[:, 0], None] * (1 - share[:, None]) + start[pairs[:, 1], None] * share[:, None]
    margin = measure_margin(scene, postures.reshape(-1, robot.nq), 0.0).reshape(len(pairs), -1).min(axis=1)
    touching = pairs[margin < 0.0]
    time[touching[:, 0], touching[:, 1]] += DETOUR
    return np.asarray(time)
