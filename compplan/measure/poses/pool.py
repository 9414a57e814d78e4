"""The pool: postures that an arm can take, and loads on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from compplan.errors import InputError
from compplan.measure.campaign import Campaign
from compplan.measure.made import make_log
from compplan.robot import Array, Robot
from compplan.statics.chain import build_chain, locate_frames

#: Batches that are drawn at most.
TRIES = 20
#: Poses whose TCP is lower than this above the base frame are left out. [m]
LEAST_HEIGHT = 0.1


def take_clear(batches: Iterable[Array], clear: Callable[[Array], NDArray[np.bool_]], count: int) -> Array:
    """Take postures from batches until enough of them are clear. Shape (<= count, nq). [rad or m]

    Args:
        batches: Postures that were drawn. Shape (k, nq) each. [rad or m]
        clear: Tells which the arm can take. Shape (k, nq) -> (k,).
        count: How many are wanted.
    """
    found: list[Array] = []
    for batch in batches:
        found.append(batch[clear(batch)])
        if sum(map(len, found)) >= count:
            break
    return np.concatenate(found)[:count]


def draw_candidates(
    robot: Robot,
    count: int,
    *,
    force: float = 1000.0,
    lever: float = 0.3,
    vertical: bool = False,
    seed: int = 0,
) -> Campaign:
    """Draw rows to choose from: poses inside the joint limits, each under a force in a random direction.

    The force acts on a lever beside the tool axis; nothing is measured yet.

    Args:
        robot: The robot.
        count: Number of candidates.
        force: Size of the force. [N]
        lever: Distance of its point of attack from the TCP, across the tool axis, on a random side. [m]
        vertical: Forces point down (weights) instead of anywhere.
        seed: Seed of the draw.

    Raises:
        InputError: If hardly any pose inside the limits is above the least height.
    """
    rng, chain = np.random.default_rng(seed), build_chain(robot)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    lower = np.where(robot.prismatic, np.maximum(robot.lower, -1e3), lower)
    upper = np.where(robot.prismatic, np.minimum(robot.upper, 1e3), upper)

    def high(q: Array) -> NDArray[np.bool_]:
        return np.asarray(locate_frames(chain, q).tcp_position[:, 2] >= LEAST_HEIGHT)

    q = take_clear((rng.uniform(lower, upper, (2 * count, robot.nq)) for _ in range(TRIES)), high, count)
    if len(q) < count:
        raise InputError(f"fewer than 1 pose in 40 lies {LEAST_HEIGHT} m above the base; check the joint limits")
    direction = rng.standard_normal((count, 3))
    if vertical:
        direction[:] = [0.0, 0.0, -1.0]
    pull = force * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    side = rng.uniform(0, 2 * np.pi, count)
    arm = lever * np.column_stack([np.cos(side), np.sin(side), np.zeros(count)])
    arm = np.einsum("nij,nj->ni", locate_frames(chain, q).tcp_rotation, arm)
    return make_log(q, np.hstack([pull, np.cross(arm, pull)]), np.zeros((count, 3)))
