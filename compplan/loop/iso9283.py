"""Pose accuracy and repeatability as ISO 9283 defines them, from a measurement log that met poses again.

    AP = |mean of the attained positions - wanted one|,   RP = mean(l) + 3 S(l),   l: distance from that mean

The standard asks for five poses met thirty times each from one side under full load; here every pose counts that was
met at least twice in one way, and the numbers of visits are stated. Base and target are fitted to the log first (the
wanted position is the robot model's), so that AP is what is left of the model, not of the instrument's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.cell.predict import predict_campaign
from compplan.measure.campaign import Campaign
from compplan.robot import Array, Robot

#: Visits that the standard asks for.
VISITS = 30
#: Loads that are alike are rounded to this. [N]
SAME_FORCE = 5.0


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
    """

    poses: int
    again: int
    visits: NDArray[np.int_]
    repeatability: Array
    accuracy: Array
    left: Array
    registered: tuple[str, ...]

    @property
    def rms(self) -> float:
        """Root mean square distance of the rows from the model. [m]."""
        return float(np.sqrt(np.mean(np.sum(self.left**2, axis=1)))) if len(self.left) else 0.0

    @property
    def pooled(self) -> float:
        """RP of all poses met again, pooled. [m]; NaN where there are none."""
        weight = np.maximum(self.visits - 1, 1)
        return float(np.sqrt(np.average(self.repeatability**2, weights=weight))) if len(weight) else float("nan")


def measure_pose_accuracy(
    robot: Robot, campaign: Campaign, register: tuple[str, ...] = ("base", "tool")
) -> PoseAccuracy:
    """Measure accuracy and repeatability of a robot in a log.

    Args:
        robot: The robot, effects of its folder included.
        campaign: The log.
        register: Frames to fit first.
    """
    predicted = predict_campaign(robot, campaign, register=register, later=False)
    use = campaign.usable & ~campaign.on_path
    gap = predicted.gap[use]
    load = np.round(campaign.wrench[use][:, :3] / SAME_FORCE).astype(int)
    key = np.column_stack([campaign.pose[use], campaign.target_index[use], load])
    _, pose = np.unique(key, axis=0, return_inverse=True)
    pose, visit = pose.reshape(-1), campaign.visit[use]
    accuracy, repeatability, visits = [], [], []
    for number in range(int(pose.max(initial=-1)) + 1):
        rows = pose == number
        places = np.stack([gap[rows & (visit == v)].mean(axis=0) for v in np.unique(visit[rows])])
        accuracy.append(float(np.linalg.norm(places.mean(axis=0))))
        if len(places) > 1:
            distance = np.linalg.norm(places - places.mean(axis=0), axis=1)
            repeatability.append(float(distance.mean() + 3.0 * distance.std(ddof=1)))
            visits.append(len(places))
    return PoseAccuracy(
        len(accuracy), len(visits), np.array(visits, int), np.array(repeatability), np.array(accuracy), gap, register
    )
