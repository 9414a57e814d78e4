"""Follow a path from where the arm stands, joint by joint: the motion that goes on where the graph finds no way.

The graph knows an arm by its configurations and by positions of extra axes on a grid; an arm of seven joints can go on
between them. Each waypoint is reached from the one before by the least motion of all joints (a pseudo-inverse), drawn
a little towards the middle of the limits by what tip and tool axis leave free.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, joint_jacobian, locate_frames
from compplan.statics.ik import Arm, middle_of_limits
from compplan.toolpath.toolpath import interpolate, pick_even

#: Waypoints that are followed one by one; those between are reached from a line through these.
STATIONS = 500
#: Newton steps at a waypoint, the greatest motion of a joint in one, and what counts as reached. [rad or m]
STEPS, LARGEST, EXACT = 25, 0.2, 1e-8
#: A waypoint is reached where it misses the pose by less. [m and rad]
REACHED = 1e-6
#: Share of the way to the middle of the limits that the free motion takes in a step.
DRAWN = 0.02


def follow_from(
    robot: Robot, chain: Chain, position: Array, rotation: Array, start: Array, *, free_spin: bool, most_step: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Follow a path (n, 3), (n, 3, 3) from joint positions near its first waypoint (nq,).

    Returns joint positions (n, nq) [rad or m], and which waypoints are not reached without a jump (n,): no joint moves
    farther than `most_step` between neighbouring waypoints.
    """
    n = len(position)
    rows = pick_even(np.arange(n), STATIONS)
    stations = np.empty((len(rows), robot.nq))
    q = np.clip(start, robot.lower, robot.upper)[None]
    for k, row in enumerate(rows):
        q, _ = reach_with_all(robot, chain, q, position[[row]], rotation[[row]], free_spin=free_spin, draw=k > 0)
        stations[k] = q[0]
    path = interpolate(np.arange(n), rows, stations)
    path, reached = reach_with_all(robot, chain, path, position, rotation, free_spin=free_spin, draw=False)
    torn = np.r_[False, np.abs(np.diff(path, axis=0)).max(axis=1) > most_step]
    return path, ~reached | torn


def reach_with_all(
    robot: Robot, chain: Chain, q: Array, position: Array, rotation: Array, *, free_spin: bool, draw: bool
) -> tuple[Array, NDArray[np.bool_]]:
    """Put tool tips and axes right with all joints, within their limits, from nearby; shapes as of `follow_from`.

    The first step draws them a little to the middle of their limits where asked. Returns joint positions, and whether
    tip and axis (and x, where the spin is not free) are right.
    """
    q, rest = np.array(q), middle_of_limits(robot)
    for count in range(STEPS):
        frames = locate_frames(chain, q)
        error, task = _equations(chain, q, frames.tcp_position, frames.tcp_rotation, position, rotation, free_spin)
        size = np.abs(error).max(axis=1)
        if (size < 1e-11).all() and count:
            break
        columns = task * ~(((q <= robot.lower) | (q >= robot.upper)) & (count > 5))[:, None, :]
        gram = columns @ np.swapaxes(columns, 1, 2) + 1e-10 * np.eye(columns.shape[1])
        inverse = np.swapaxes(columns, 1, 2) @ np.linalg.inv(gram)
        step = (inverse @ error[..., None])[..., 0]
        if draw and count == 0:
            preference = DRAWN * np.where(np.isfinite(rest), rest - q, 0.0)
            step = step + preference - (inverse @ (columns @ preference[..., None]))[..., 0]
        step *= np.minimum(1.0, LARGEST / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        q = np.clip(q + step, robot.lower, robot.upper)
    frames = locate_frames(chain, q)
    error, _ = _equations(chain, q, frames.tcp_position, frames.tcp_rotation, position, rotation, free_spin)
    return q, np.abs(error).max(axis=1) < EXACT


def _equations(
    chain: Chain, q: Array, tip: Array, stood: Array, position: Array, rotation: Array, free_spin: bool
) -> tuple[Array, Array]:
    """Return by how much tips and axes are missed, and how that answers to the joints. Shapes (n, 5 or 6), (.., nq)."""
    columns = joint_jacobian(chain, locate_frames(chain, q))
    pairs = [(rotation[:, :, 0], stood[:, :, 2]), (rotation[:, :, 1], stood[:, :, 2])]
    pairs += [] if free_spin else [(rotation[:, :, 1], stood[:, :, 0])]
    missed = np.stack([np.einsum("ni,ni->n", a, b) for a, b in pairs], axis=1)
    behind = np.einsum("ni,ni->n", rotation[:, :, 2], stood[:, :, 2]) < 0
    missed[:, 0] += behind  # an axis that points the other way is no solution
    turns = np.stack([np.einsum("ni,nij->nj", np.cross(b, a), columns[:, 3:]) for a, b in pairs], axis=1)
    return np.concatenate([position - tip, -missed], axis=1), np.concatenate([columns[:, :3], turns], axis=1)


#: Starts that are tried for the first waypoint, drawn between the joint limits, and rounds that follow the path.
SEEDS, ROUNDS = 200, 40
#: Limits that stand for missing ones where starts are drawn. [rad or m]
WIDEST = float(np.pi)
#: A joint that moves more than this from one waypoint to the next has changed its branch. [rad or m]
BRANCH = 0.35


def follow_path(
    arm: Arm, position: Array, rotation: Array, *, spin_free: bool = True
) -> tuple[Array, NDArray[np.bool_]]:
    """Find joint positions that put the unloaded tool's tip and axis on a path, along one branch.

    rotation: frames whose z is the wanted direction out of the tool (n, 3, 3). Returns joint positions (n, nq)
    [rad or m], and which waypoints are not reached within the limits (n,).
    """
    robot, n = arm.robot, len(position)
    low, high = np.maximum(robot.lower, -WIDEST), np.minimum(robot.upper, WIDEST)
    seeds = low + (high - low) * np.random.default_rng(0).random((SEEDS, robot.nq))
    seeds[0] = middle_of_limits(robot)
    reach = partial(reach_tip_and_axis, arm, spin_free=spin_free)
    found, reached = reach(seeds, np.tile(position[0], (SEEDS, 1)), np.tile(rotation[0], (SEEDS, 1, 1)))
    room = np.minimum(found - robot.lower, robot.upper - found).min(axis=1)
    if not (reached & (room >= 0)).any():
        return np.tile(seeds[0], (n, 1)), np.ones(n, bool)
    q = np.tile(found[int(np.where(reached, room, -np.inf).argmax())], (n, 1))
    q, reached = reach(q, position, rotation)
    for _ in range(ROUNDS):
        off = np.r_[False, np.abs(np.diff(q, axis=0)).max(axis=1) > BRANCH] | ~reached
        off[0] = False
        if not off.any():
            break
        first = int(np.flatnonzero(off)[0])
        q[first:] = q[first - 1]
        q[first:], reached[first:] = reach(q[first:], position[first:], rotation[first:])
    outside = ((q < robot.lower - 1e-9) | (q > robot.upper + 1e-9)).any(axis=1)
    return q, ~reached | outside


def reach_tip_and_axis(
    arm: Arm, q: Array, position: Array, rotation: Array, *, spin_free: bool = True
) -> tuple[Array, NDArray[np.bool_]]:
    """Put the tool's tip and axis right from nearby, with least joint motion; the rotation about the axis gives way.

    Where `spin_free` is false it does not: that is for arms of four joints. Returns joint positions and whether tip and
    axis are right.
    """
    q = q.copy()
    for _ in range(20):
        frames = locate_frames(arm.chain, q)
        cross, across = np.cross(frames.tcp_rotation[:, :, 2], rotation[:, :, 2]), rotation[:, :, :2]
        if not spin_free:
            cross, across = cross + np.cross(frames.tcp_rotation[:, :, 0], rotation[:, :, 0]), rotation
        error = np.concatenate([position - frames.tcp_position, np.einsum("nij,ni->nj", across, cross)], axis=1)
        if np.abs(error).max() < 1e-10:
            break
        columns = joint_jacobian(arm.chain, frames)[:, :, arm.arm]
        task = np.concatenate([columns[:, :3], np.swapaxes(across, 1, 2) @ columns[:, 3:]], axis=1)
        gram = task @ np.swapaxes(task, 1, 2) + 1e-10 * np.eye(task.shape[1])
        step = (np.swapaxes(task, 1, 2) @ np.linalg.solve(gram, error[..., None]))[..., 0]
        q[:, arm.arm] += step * np.minimum(1.0, 0.3 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    return q, np.abs(error).max(axis=1) < REACHED


def turn_about_axis(x: Array, axis: Array) -> Array:
    """Return orientations with a tool axis (n, 3), tip to spindle, whose x is the nearest to `x` (n, 3)."""
    z = -axis
    x = x - np.einsum("ni,ni->n", z, x)[:, None] * z
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return np.stack([x, np.cross(z, x), z], axis=2)
