"""Pose accuracy and repeatability as ISO 9283 defines them, from a measurement log that met poses again.

    AP = |mean of the attained positions - wanted one|,   RP = mean(l) + 3 S(l),   l: distance from that mean

The standard asks for five poses met thirty times each from one side under full load. Here every pose counts that was
met at least twice in one way: the scatter of its visits about their mean, S = sum d d^T / sum (n - 1), the instrument's
own taken out, tells what RP thirty visits are expected to give, E|x| + 3 sd|x| with x ~ N(0, S). Two visits alone have
equal distances and no S(l), so that the plain figure of few visits is far too small.

AP is stated raw, as the log's frame has it; after base and target are fitted (the wanted position is the robot
model's), with the numbers that took; and at poses that the fit never saw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from compplan.measurement.campaign import Campaign
from compplan.robot import Array, Robot
from compplan.simulation.predict import predict_campaign

#: Visits that the standard asks for.
VISITS = 30
#: Loads that are alike are rounded to this. [N]
SAME_FORCE = 5.0
#: Draws of a visit, and their seed; parts that poses are dealt to, and fewest poses of which some are left out.
DRAWS, SEED, FOLDS, FEWEST_POSES = 20000, 9283, 5, 8


@dataclass(frozen=True, eq=False)
class PoseAccuracy:
    """Accuracy and repeatability of a log; k poses that were met again.

    Attributes:
        poses: Poses of the log.
        again: Poses that were met at least twice.
        visits: Visits to each of those. Shape (k,).
        repeatability: RP of each of those. Shape (k,). [m]
        accuracy: AP of every pose. Shape (poses,). [m]
        left: Measured minus predicted position of every usable row. Shape (r, 3). [m]
        registered: Frames that were fitted first.
        scatter: Covariance of a visit about the mean of its pose, the instrument's taken out. Shape (3, 3). [m^2]
        freedom: Visits beyond the first of each pose, which it rests on.
        instrument: Standard deviation of the instrument per axis that was taken out; 0 where none is stated. [m]
        raw: AP of every pose before anything was fitted. Shape (poses,). [m]
        unseen: AP of every pose by frames that were fitted without it. Shape (poses,). [m]; empty for too few poses.
        fitted: Numbers that the fit of the frames took.
    """

    poses: int
    again: int
    visits: NDArray[np.int_]
    repeatability: Array
    accuracy: Array
    left: Array
    registered: tuple[str, ...]
    scatter: Array
    freedom: int
    instrument: float
    raw: Array
    unseen: Array
    fitted: int

    @property
    def rms(self) -> float:
        """Root mean square distance of the rows from the model. [m]."""
        return float(np.sqrt(np.mean(np.sum(self.left**2, axis=1)))) if len(self.left) else 0.0

    @property
    def pooled(self) -> float:
        """RP that thirty visits are expected to give, all poses met again together. [m]; NaN where there are none."""
        if not self.freedom:
            return float("nan")
        value, vector = np.linalg.eigh(self.scatter)
        drawn = np.random.default_rng(SEED).standard_normal((DRAWS, 3)) * np.sqrt(np.maximum(value, 0.0)) @ vector.T
        distance = np.linalg.norm(drawn, axis=1)
        return float(distance.mean() + 3.0 * distance.std())

    @property
    def pooled_interval(self) -> tuple[float, float]:
        """95 % interval of `pooled` by the number of visits, three numbers each, the instrument known. [m]"""
        n, own, noise = 3 * max(self.freedom, 1), float(np.trace(self.scatter)) / 3.0, self.instrument**2
        seen = [(own + noise) * n / float(chi2.ppf(share, n)) for share in (0.975, 0.025)]
        low, high = (float(np.sqrt(max(one - noise, 0.0) / max(own, 1e-300))) for one in seen)
        return self.pooled * low, self.pooled * high


def measure_pose_accuracy(
    robot: Robot, campaign: Campaign, register: tuple[str, ...] = ("base", "tool")
) -> PoseAccuracy | None:
    """Measure accuracy and repeatability of a robot in a log; None where no row holds a position at rest.

    Args:
        robot: The robot, effects of its folder included.
        campaign: The log.
        register: Frames to fit first.
    """
    use = campaign.usable & campaign.measured & ~campaign.on_path
    if not use.any():
        return None
    predicted = predict_campaign(robot, campaign, register=register, later=False)
    gap = predicted.gap[use]
    load = np.round(campaign.wrench[use][:, :3] / SAME_FORCE).astype(int)
    key = np.column_stack([campaign.pose[use], campaign.target_index[use], load])
    _, pose = np.unique(key, axis=0, return_inverse=True)
    pose, visit = pose.reshape(-1), campaign.visit[use]
    accuracy, repeatability, visits = [], [], []
    spread, own, count = np.zeros((3, 3)), np.zeros(0), 0
    sigma = np.zeros(len(campaign)) if campaign.sigma is None else np.nan_to_num(campaign.sigma)
    for number in range(int(pose.max(initial=-1)) + 1):
        rows = pose == number
        places = np.stack([gap[rows & (visit == v)].mean(axis=0) for v in np.unique(visit[rows])])
        accuracy.append(float(np.linalg.norm(places.mean(axis=0))))
        if len(places) > 1:
            distance = np.linalg.norm(places - places.mean(axis=0), axis=1)
            repeatability.append(float(distance.mean() + 3.0 * distance.std(ddof=1)))
            visits.append(len(places))
            away = places - places.mean(axis=0)
            spread, count = spread + away.T @ away, count + len(places) - 1
            # rows of one visit are averaged
            noise = [float(np.mean(sigma[use][rows & (visit == v)] ** 2)) / int((rows & (visit == v)).sum())
                     for v in np.unique(visit[rows])]  # fmt: skip
            own = np.append(own, noise)
    instrument = float(np.mean(own)) if len(own) else 0.0
    value, vector = np.linalg.eigh(spread / max(count, 1) - instrument * np.eye(3))
    raw = predict_campaign(robot, campaign, later=False).gap[use] if register else gap
    return PoseAccuracy(
        len(accuracy), len(visits), np.array(visits, int), np.array(repeatability), np.array(accuracy), gap, register,
        (vector * np.maximum(value, 0.0)) @ vector.T, count, float(np.sqrt(instrument)), _accuracy_of(raw, pose),
        leave_poses_out(robot, campaign, register, np.flatnonzero(use), pose),
        6 * ("base" in register) + 3 * ("tool" in register) * (int(campaign.target_index[use].max(initial=0)) + 1),
    )  # fmt: skip


def _accuracy_of(gap: Array, pose: NDArray[np.int_]) -> Array:
    """Return the distance of the mean of each pose. Shape (poses,). [m]"""
    count = int(pose.max(initial=-1)) + 1
    return np.array([np.linalg.norm(gap[pose == number].mean(axis=0)) for number in range(count)])


def leave_poses_out(
    robot: Robot, campaign: Campaign, register: tuple[str, ...], rows: NDArray[np.int_], pose: NDArray[np.int_]
) -> Array:
    """Return AP of every pose by frames that were fitted to the others. Shape (poses,). [m]; empty for too few poses.

    Args:
        robot: The robot.
        campaign: The log.
        register: Frames to fit.
        rows: Rows that count. Shape (r,).
        pose: Pose of each. Shape (r,).
    """
    count = int(pose.max(initial=-1)) + 1
    if not register or count < FEWEST_POSES:
        return np.zeros(0)
    found = np.zeros(count)
    for fold in range(FOLDS):
        test = pose % FOLDS == fold
        if not test.any() or test.all():
            continue
        frames = predict_campaign(robot, campaign.take(rows[~test]), register=register, later=False).registration
        gap = predict_campaign(robot, campaign.take(rows[test]), registration=frames, later=False).gap
        for number in np.unique(pose[test]):
            found[number] = float(np.linalg.norm(gap[pose[test] == number].mean(axis=0)))
    return found
