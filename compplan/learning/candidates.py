"""Candidates for measurements: postures that an arm can take and hold, loads that a shop has, both ways to approach.

Half of the postures lie around the path, half anywhere within the joint limits; those that touch something, or put the
tool below the base, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.effects import solve_model_poses
from compplan.measurement.campaign import Campaign
from compplan.measurement.observations import Observations
from compplan.measurement.poses.pool import take_clear
from compplan.planning.posture.clearance import measure_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.robot import Array, Robot
from compplan.robot.model import STANDARD_GRAVITY
from compplan.robot.uncertainty import Unknown
from compplan.statics.chain import build_chain, locate_frames
from compplan.uncertainty.perturbation import build_varied_model
from compplan.uncertainty.sensitivities import measure_slopes, select_model_rows

#: Postures that are kept, and drawn for it at most.
KEPT, DRAWN = 300, 3000
#: Spread around the path, and distance from the joint limits that is kept [rad, share of the range of slides].
AROUND, MARGIN = 0.35, np.radians(5.0)
#: Revolute joints are taken within this of zero, whatever their limits: cables. [rad]
TURN = np.radians(170.0)
#: A pose is approached over this distance of every joint: [rad], [m]. Longer than any play.
RUN_UP = (np.radians(1.5), 0.01)
#: Lowest place of the tip over the base plane, where the path is not lower itself. [m]
FLOOR = 0.05


@dataclass(frozen=True, eq=False)
class Candidates:
    """Measurements that could be taken; m of them, p parameters."""

    log: Campaign  #: Two rows a measurement, nothing measured yet: where its approach begins, and the pose.
    tip: Array  #: Where the tip goes. Shape (m, 3). [m]
    rotation: Array  #: Orientation of the TCP. Shape (m, 3, 3).
    slopes: Array  #: Motion of the tip per unit of every parameter. Shape (m, 3, p).
    sights: Observations | None = None  #: What another instrument than a tracker sees, or None.

    def __len__(self) -> int:
        return len(self.tip)

    @property
    def start(self) -> Array:
        """Where the approach of each begins. Shape (m, nq). [rad or m]"""
        return self.log.q[::2]

    @property
    def q(self) -> Array:
        """Joint positions. Shape (m, nq). [rad or m]"""
        return self.log.q[1::2]

    @property
    def rising(self) -> NDArray[np.bool_]:
        """Whether all joints come from below. Shape (m,)."""
        return np.asarray((self.q > self.start).all(axis=1))

    @property
    def wrench(self) -> Array:
        """Load at the TCP, base axes. Shape (m, 6). [N, N m]"""
        return self.log.wrench[1::2]

    @property
    def weight(self) -> Array:
        """Weight that hangs at the tool; pulls are horizontal. Shape (m,). [kg]"""
        return np.asarray(self.wrench[:, 2] / -STANDARD_GRAVITY)

    def take(self, rows: NDArray[np.int_]) -> Candidates:
        """Take some of them."""
        log = self.log.take(np.stack([2 * rows, 2 * rows + 1], axis=1).ravel())
        sights = None if self.sights is None else self.sights.take(rows)
        return Candidates(log, self.tip[rows], self.rotation[rows], self.slopes[rows], sights)


def run_up(robot: Robot) -> Array:
    """Return how far before a pose its approach begins, joint by joint. Shape (nq,). [rad or m]."""
    return np.where(robot.prismatic, RUN_UP[1], RUN_UP[0])


def find_postures(
    robot: Robot, path_q: Array, lowest: float, scene: CollisionScene | None, seed: int, kept: int = KEPT
) -> Array:
    """Draw at most `kept` postures that the arm can take. Shape (k, nq). [rad or m]

    path_q: joint positions along the path, (n, nq); lowest: its lowest place over the base plane [m]; scene: what may
    touch what, or None.
    """
    random = np.random.default_rng(seed)
    span = np.where(robot.prismatic, np.inf, TURN)
    low, high = np.maximum(robot.lower, -span), np.minimum(robot.upper, span)
    edge = np.where(robot.prismatic, 0.02 * (high - low), MARGIN) + run_up(robot)
    low, high = low + edge, high - edge
    near = path_q[random.integers(0, len(path_q), DRAWN // 2)] + AROUND * random.standard_normal((DRAWN // 2, robot.nq))
    far = low + (high - low) * random.random((DRAWN - len(near), robot.nq))
    drawn = np.stack([near, far], axis=1).reshape(-1, robot.nq)
    drawn = drawn[((drawn >= low) & (drawn <= high)).all(axis=1)]
    tip = locate_frames(build_chain(robot), drawn).tcp_position
    drawn = drawn[tip[:, 2] >= min(FLOOR, lowest)]
    if scene is None or not len(drawn):
        return np.asarray(drawn[:kept])
    batches = (drawn[start : start + kept] for start in range(0, len(drawn), kept))
    return take_clear(batches, lambda part: measure_margin(scene, part, 0.0) >= 0.0, kept)


def list_candidates(
    robot: Robot, postures: Array, weights: Sequence[float], pull: float, unknowns: tuple[Unknown, ...]
) -> Candidates:
    """Combine postures, (k, nq), with ways to approach, weights [kg] and pulls; differentiate what is measured.

    pull: force with which the tool can be pulled along x and y of the base, either way; 0 for none. [N]
    """
    k = len(postures)
    loads = [(0.0, 0.0, 0.0 - STANDARD_GRAVITY * weight) for weight in weights]
    loads += [(x * pull, y * pull, 0.0) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)) if pull > 0]
    q, sign = np.tile(postures, (2 * len(loads), 1)), np.tile(np.repeat([1, -1], k), len(loads))
    wrench = np.zeros((2 * len(q), 6))
    wrench[:, :3] = np.repeat(loads, 4 * k, axis=0)
    way = np.stack([q - sign[:, None] * run_up(robot), q], axis=1).reshape(-1, robot.nq)
    log = Campaign(np.array(["static_1"] * len(way)), way, wrench, np.full((len(way), 3), np.nan))
    scene, rows = build_varied_model(robot, log), np.arange(1, len(way), 2)
    attained = solve_model_poses(select_model_rows(scene, rows))
    return Candidates(log, attained.position, attained.rotation, measure_slopes(scene, unknowns, rows))
