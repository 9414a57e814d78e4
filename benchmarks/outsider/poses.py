"""Poses as a person chooses them: about a home posture, joint values typed with at most one decimal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.outsider.robots import Robot
from benchmarks.outsider.statics import State, solve_statics
from benchmarks.outsider.turns import DEGREE, Array, Rng

HOME: Mapping[str, Sequence[float]] = {
    "ur10e_like": [0, -60, 90, 20, 80, 0],
    "ur5e_like": [0, -60, 90, 20, 80, 0],
    "crx10_like": [0, 10, 80, 0, 20, 0],
    "iiwa14_like": [0, 35, 0, -70, 0, 60, 0],
    "panda_like": [0, -20, 0, -120, 0, 100, 0],
    "irb1200_like": [0, 15, 10, 0, 45, 0],
    "tx2_90_like": [0, 25, 75, 0, 60, 0],
    "gp25_like": [0, 10, -5, 0, 60, 0],
    "kr16_like": [0, 10, 10, 0, 60, 0],
    "irb6700_like": [0, 5, 5, 0, 60, 0],
    "m900_like": [0, 5, 5, 0, 60, 0],
    "kr60_rail_like": [2.0, 0, 5, 10, 0, 60, 0],
    "scara600_like": [20, 60, 0.1, 0],
    "kr180pa_like": [0, 5, 15, 0],
}
SPAN: Mapping[str, Sequence[float]] = {
    "cobot": [150, 55, 60, 90, 80, 160, 160],
    "small": [140, 50, 50, 130, 80, 160],
    "mid": [140, 35, 40, 120, 70, 160],
    "heavy": [140, 32, 35, 110, 65, 160],
    "scara": [110, 80, 0.09, 170],
    "kr60_rail_like": [2.0, 140, 35, 40, 120, 70, 160],
    "iiwa14_like": [130, 45, 70, 50, 120, 60, 150],
    "panda_like": [130, 45, 70, 50, 120, 60, 150],
    "kr180pa_like": [140, 35, 35, 170],
}
STYLES = {"spread": 1.0, "stations": 1.0, "front": 1.0, "axes": 0.8, "narrow": 0.3, "wristless": 1.0}


def choose_poses(rng: Rng, robot: Robot, count: int, style: str) -> Array:
    """Choose postures in a style, with the tool off the floor and away from the column.

    Args:
        rng: Random numbers.
        robot: The robot.
        count: How many.
        style: One of `STYLES`: how far and which joints move.

    Returns:
        Joint values, at stations in the order of the first joint. Shape (count, joints). [rad or m]
    """
    unit = np.where(robot.prismatic, 1.0, DEGREE)
    home = np.array(HOME[robot.name], float) * unit
    span = np.array(SPAN.get(robot.name, SPAN[robot.size])[: robot.count], float) * unit * STYLES[style]
    first = robot.column_1
    if style == "front":
        span[first] = min(span[first], 45 * DEGREE)
    stations = [home[first] + x * span[first] for x in np.linspace(-0.85, 0.85, int(rng.integers(3, 6)))]
    chosen: list[Array] = []
    for _ in range(400):
        if len(chosen) >= count:
            break
        q = _guess(rng, robot, home, span, style, stations)
        chosen += list(q[_reachable(robot, q)])
    poses = np.array(chosen[:count])
    return poses[np.argsort(poses[:, first], kind="stable")] if style == "stations" else poses


def _guess(rng: Rng, robot: Robot, home: Array, span: Array, style: str, stations: list[float]) -> Array:
    """Sixty-four postures in a style, within the limits and rounded as typed."""
    many, joints = 64, robot.count
    q = home + span * (2 * rng.random((many, joints)) - 1)
    if style == "stations":
        q[:, robot.column_1] = rng.choice(stations, many)
    if style == "wristless":
        q[:, -3:] = home[-3:] + 0.25 * (q[:, -3:] - home[-3:])
    if style == "axes":
        moved = np.zeros((many, joints), bool)
        for _ in range(2):
            moved[np.arange(many), rng.integers(0, joints, many)] = True
        q = np.where(moved, q, home)
    low, high = robot.limits
    q = np.clip(q, low + 0.02 * (high - low), high - 0.02 * (high - low))
    decimals = int(rng.choice([0, 1]))
    return np.where(robot.prismatic, np.round(q, 3), np.round(q / DEGREE, decimals) * DEGREE)


def _reachable(robot: Robot, q: Array) -> Array:
    """Which postures keep tool and links off the floor and the tool away from the column. Shape (n,), bool."""
    solution = solve_statics(State(robot, q, np.zeros((len(q), 6))), steps=1)
    tip = solution.position
    column = np.c_[q[:, 0], 0 * q[:, 0], 0 * q[:, 0]] if robot.rail else 0.0
    away = np.hypot(*(tip - column)[:, :2].T) > 0.18 * robot.reach
    if robot.size == "scara":
        return away & (tip[:, 2] > -0.98)
    lowest = np.min([solution.frames[e.name].origin[:, 2] for e in robot.elements[3:]], axis=0)
    return (tip[:, 2] > 0.04 * robot.reach) & away & (lowest > 0.02)
