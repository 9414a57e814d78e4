"""Candidate poses of a measuring campaign, and what the poses that it would choose say of the robot.

Half of the postures are drawn around a path, half anywhere within the joint limits; each is approached from below or
above, without a load or with one. The forecast of a ladder chooses of them as the campaign does, apart from collisions.
"""

from __future__ import annotations

import numpy as np

from compplan.effects import solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.errors import ConvergenceError
from compplan.measurement.campaign import Campaign
from compplan.measurement.pose_selection import narrow_target, offer_once, take_greedily
from compplan.robot import Array, Robot
from compplan.robot.pose import rigid_columns
from compplan.robot.uncertainty import Uncertainty
from compplan.statics.chain import build_chain, locate_frames
from compplan.uncertainty.posture_errors import derive_unknowns
from compplan.uncertainty.sensitivities import build_varied_model

#: Standard deviation of joint positions around the path [rad or m], and margin to the limits of revolute joints [rad].
AROUND, MARGIN = 0.35, np.radians(5.0)
#: Greatest angle of a revolute joint from zero, even if its limits are wider: cables. [rad]
TURN = np.radians(170.0)
#: Distance of the approach to a pose in every joint, longer than any backlash. [rad], [m]
RUN_UP = (np.radians(1.5), 0.01)
#: Least height of the tip over the base plane, unless the path is lower. [m]
FLOOR = 0.05
#: Prior standard deviations of unknown frames. [m, rad]
LOOSE = (1.0, 0.5)
#: Postures drawn for a forecast, how many of them it chooses of, and their seed.
DRAWN, OFFERED, SEED = 300, 60, 0


def run_up(robot: Robot) -> Array:
    """Return the joint distance of the approach to a pose, 0 for a held joint. Shape (nq,). [rad or m]."""
    return np.where(robot.upper <= robot.lower, 0.0, np.where(robot.prismatic, RUN_UP[1], RUN_UP[0]))


def draw_postures(robot: Robot, path_q: Array, lowest: float, seed: int, drawn: int) -> Array:
    """Draw postures; return those within the joint limits and above the base plane. Shape (<= drawn, nq). [rad or m]

    path_q: joint positions along the path, (n, nq); lowest: least height of the path over the base plane. [m]
    """
    random = np.random.default_rng(seed)
    span = np.where(robot.prismatic, np.inf, TURN)
    low, high = np.maximum(robot.lower, -span), np.minimum(robot.upper, span)
    free = high > low
    edge = np.where(robot.prismatic, 0.02 * (high - low), free * MARGIN) + run_up(robot)
    low, high = low + edge, high - edge
    near = path_q[random.integers(0, len(path_q), drawn // 2)]
    near = near + free * AROUND * random.standard_normal(near.shape)
    far = low + (high - low) * random.random((drawn - len(near), robot.nq))
    found = np.stack([near, far], axis=1).reshape(-1, robot.nq)
    found = found[((found >= low) & (found <= high)).all(axis=1)]
    tip = locate_frames(build_chain(robot), found).tcp_position
    return np.asarray(found[tip[:, 2] >= min(FLOOR, lowest)])


def pull_aside(pull: float) -> list[tuple[float, float, float]]:
    """Return the pulls along +-x and +-y of the base; none for 0. [N]"""
    return [(x * pull, y * pull, 0.0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)) if pull > 0]


def approach_poses(robot: Robot, q: Array, sign: Array, force: Array) -> Campaign:
    """Return a campaign without measured values: two rows a pose, the start of its approach and the pose.

    q: (m, nq) [rad or m]; sign: direction of the approach, 1 or -1, (m,); force on the tool, base axes, (m, 3). [N]
    """
    wrench = np.zeros((2 * len(q), 6))
    wrench[:, :3] = np.repeat(force, 2, axis=0)
    way = np.stack([q - sign[:, None] * run_up(robot), q], axis=1).reshape(-1, robot.nq)
    return Campaign(np.array(["static_1"] * len(way)), way, wrench, np.full((len(way), 3), np.nan))


def observe_poses(
    robot: Robot, known: Uncertainty, target: Array, path_q: Array, lowest: float, count: int, pull: float,
    variance: float,
) -> Array:  # fmt: skip
    """Return what the poses of a campaign measure: derivatives by each z of `known`, freed of unknown frames. (m, r)

    Poses are chosen greedily of a sample, each posture once. The frame of the tracker and the place of its target on
    the tool are unknown: what they could explain is not observed. Empty if no posture is found, or one lacks an
    equilibrium.

    Args:
        robot: The robot with its tool.
        known: Uncertainty of its r independent parameters z.
        target: Motion of the tip along the path by each z. Shape (k, 3, r). [m]
        path_q: Joint positions along the path. Shape (n, nq). [rad or m]
        lowest: Least height of the path over the base plane. [m]
        count: Number of poses.
        pull: Force with which the tool can be pulled sideways. [N]
        variance: Of a measured pose per axis. [m^2]
    """
    r, postures = target.shape[2], draw_postures(robot, path_q, lowest, SEED, DRAWN)[:OFFERED]
    loads = np.array([(0.0, 0.0, 0.0), *pull_aside(pull)[::2]])  # the opposite pull shows the same
    k, posture = len(postures), np.tile(np.arange(len(postures)), len(loads))
    sign = np.where(np.arange(len(posture)) // k % 2 == posture % 2, 1.0, -1.0)
    if not k:
        return np.zeros((0, r))
    try:
        scene = build_varied_model(robot, approach_poses(robot, postures[posture], sign, np.repeat(loads, k, axis=0)))
        at = linearize_model(scene, solve_model_poses(scene))
    except ConvergenceError:
        return np.zeros((0, r))
    slopes = (derive_unknowns(at, known.unknowns) @ known.spread)[1::2]
    frames = np.concatenate([rigid_columns(at.point[1::2], np.zeros(3)), at.attained.rotation[1::2]], axis=2)
    rows = np.concatenate([slopes, frames * np.r_[np.repeat(LOOSE, 3), np.full(3, LOOSE[0])]], axis=2)
    motion = np.pad(target.reshape(-1, r), ((0, 0), (0, rows.shape[2] - r)))
    worth = narrow_target(motion, np.eye(motion.shape[1]), rows, variance)
    taken = take_greedily(offer_once(worth, posture), min(count, k))
    seen, hidden = slopes[taken].reshape(-1, r), frames[taken].reshape(-1, frames.shape[2])
    return np.asarray(seen - hidden @ np.linalg.lstsq(hidden, seen, rcond=1e-9)[0])
