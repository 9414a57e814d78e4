"""In which order to measure: loads together, short ways between poses, and the first pose once more at the end."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.clearance import measure_margin
from compplan.planning.posture.collision_scene import CollisionScene
from compplan.robot import Array, Robot

#: Postures that are looked at on the way between two poses.
BETWEEN = 7
#: A way on which something touches counts as so much longer. [s]
DETOUR = 1e3


def order_poses(
    robot: Robot, q: Array, start: Array, load: Array, home: Array, scene: CollisionScene | None
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Order poses for short travel, one load after another; return the order, and to which the way touches something.

    q: poses, start: where the approach of each begins, home: where the robot comes from, (m, nq) or (nq,) [rad or m];
    load: (m, 6) [N, N m]; scene: what may touch what, or None.
    """
    way = measure_travel(robot, np.vstack([home[None], q]), np.vstack([home[None], start]), scene)
    _, group = np.unique(np.round(load, 3), axis=0, return_inverse=True)
    group = group.reshape(-1)
    size = np.array([np.abs(load[group == g]).sum() for g in range(group.max() + 1)])
    order: list[int] = []
    for number in np.argsort(size, kind="stable"):
        left, here = set(np.flatnonzero(group == number).tolist()), order[-1] + 1 if order else 0
        part: list[int] = []
        while left:
            nearest = min(left, key=lambda k: (way[here, k + 1], k))
            part.append(nearest)
            left.remove(nearest)
            here = nearest + 1
        order += _untangle(part, way, order[-1] + 1 if order else 0)
    steps = [way[a + 1, b + 1] for a, b in zip([-1, *order[:-1]], order, strict=True)]
    return np.array(order, int), np.flatnonzero(np.array(steps) >= DETOUR)


def measure_travel(robot: Robot, q: Array, start: Array, scene: CollisionScene | None) -> Array:
    """Return the time of the joint move from every pose to every start [s], ways that touch longer. Shape (m, m)."""
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


def _untangle(part: list[int], way: Array, before: int) -> list[int]:
    """Turn stretches of a round about while that makes it shorter."""

    def length(order: list[int]) -> float:
        at = [before, *(k + 1 for k in order)]
        return float(sum(way[a, b] for a, b in pairwise(at)))

    best, improved = length(part), True
    while improved:
        improved = False
        for i in range(len(part) - 1):
            for j in range(i + 1, len(part)):
                turned = part[:i] + part[i : j + 1][::-1] + part[j + 1 :]
                if (now := length(turned)) < best - 1e-9:
                    part, best, improved = turned, now, True
    return part
