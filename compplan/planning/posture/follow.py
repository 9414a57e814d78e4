"""Follow a path joint by joint: put tip and tool axis right from nearby, by the least motion of the joints.

The ladder graph knows an arm of six joints by its configurations, and extra axes by positions on a grid. Arms of fewer
joints, and of seven that start where a job says, go on from waypoint to waypoint.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array
from compplan.statics.chain import joint_jacobian, locate_frames
from compplan.statics.ik import CLOSE, Arm, middle_of_limits, reach_pose
from compplan.statics.sweep import CHUNK
from compplan.toolpath.toolpath import Toolpath, interpolate, pick_even

#: Waypoints that are followed one by one; those between are reached from a line through these.
STATIONS = 500
#: Newton steps, the greatest motion of a joint in one, and the step from which on a joint at a limit stays. [rad or m]
STEPS, LARGEST, HELD_FROM = 25, 0.3, 5
#: Share of the way to the middle of the limits that the free motion of joints takes at a waypoint.
DRAWN = 0.02
#: Starts that are tried for the first waypoint, and limits that stand for missing ones where they are drawn. [rad or m]
SEEDS, WIDEST = 200, float(np.pi)


def follow_path(
    arm: Arm, nominal: Toolpath, rotation: Array, *, spin_free: bool, most_step: float, start: Array | None = None
) -> tuple[Array, NDArray[np.bool_]]:
    """Find joint positions that put the unloaded tool's tip and axis on a path, every waypoint from the one before.

    rotation: frames whose z is the wanted direction out of the tool (n, 3, 3); `start`: joint positions near the first
    waypoint (nq,), searched if left out. Returns joint positions (n, nq) [rad or m], and which waypoints are not
    reached within the limits, or not without a jump: a joint moves by `most_step` at most between waypoints of a cut.
    """
    n, robot = len(nominal), arm.robot
    start = _search_start(arm, nominal.position[0], rotation[0], spin_free=spin_free) if start is None else start
    if start is None:
        return np.tile(middle_of_limits(robot), (n, 1)), np.ones(n, bool)
    rows = pick_even(np.arange(n), STATIONS)
    stations, q = np.empty((len(rows), robot.nq)), np.clip(start, robot.lower, robot.upper)[None]
    for k, row in enumerate(rows):
        found, reached = reach_tip_and_axis(arm, q, nominal.position[[row]], rotation[[row]], spin_free=spin_free,
                                            every_joint=True, draw=k > 0)  # fmt: skip
        q = found if reached.all() else q
        stations[k] = q[0]
    path = interpolate(np.arange(n), rows, stations)
    path, reached = reach_tip_and_axis(arm, path, nominal.position, rotation, spin_free=spin_free, every_joint=True)
    return path, ~reached | find_torn(path, nominal, most_step)


def find_torn(q: Array, nominal: Toolpath, most_step: float) -> NDArray[np.bool_]:
    """Tell which waypoints of a cut a joint would have to jump to."""
    torn = np.zeros(len(q), bool)
    torn[1:] = np.abs(np.diff(q, axis=0)).max(axis=1) > most_step
    return torn & ~nominal.rapid


def _search_start(arm: Arm, position: Array, rotation: Array, *, spin_free: bool) -> Array | None:
    """Return joint positions that reach the first waypoint, the farthest from their limits of many tries, or None."""
    robot = arm.robot
    low, high = np.maximum(robot.lower, -WIDEST), np.minimum(robot.upper, WIDEST)
    seeds = low + (high - low) * np.random.default_rng(0).random((SEEDS, robot.nq))
    seeds[0] = middle_of_limits(robot)
    wanted = np.tile(position, (SEEDS, 1)), np.tile(rotation, (SEEDS, 1, 1))
    found, reached = reach_tip_and_axis(arm, seeds, *wanted, spin_free=spin_free)
    room = np.where(reached, np.minimum(found - robot.lower, robot.upper - found).min(axis=1), -np.inf)
    return None if room.max() < 0.0 else np.asarray(found[int(room.argmax())])


def reach_tip_and_axis(
    arm: Arm, q: Array, position: Array, rotation: Array, *, spin_free: bool = True, every_joint: bool = False,
    draw: bool = False,
) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """Put tip and tool axis right from nearby, q (n, nq) [rad or m], with least joint motion.

    The rotation about the axis gives way where `spin_free`. The joints of the arm move, without regard to their limits,
    or `every_joint` within its limits, with `draw` first a little to the middle of them as far as the rest leaves free.
    Returns joint positions, and where tip and axis are right.
    """
    if len(q) > CHUNK:
        parts = [slice(k, k + CHUNK) for k in range(0, len(q), CHUNK)]
        options = {"spin_free": spin_free, "every_joint": every_joint, "draw": draw}
        found = [reach_tip_and_axis(arm, q[part], position[part], rotation[part], **options) for part in parts]
        return np.vstack([joints for joints, _ in found]), np.hstack([reached for _, reached in found])
    q, robot = q.copy(), arm.robot
    moved = np.arange(robot.nq) if every_joint else arm.arm
    for count in range(STEPS):
        frames = locate_frames(arm.chain, q)
        cross, across = np.cross(frames.tcp_rotation[:, :, 2], rotation[:, :, 2]), rotation[:, :, :2]
        if not spin_free:
            cross, across = 0.5 * np.cross(frames.tcp_rotation, rotation, axis=1).sum(axis=2), rotation
        error = np.concatenate([position - frames.tcp_position, np.einsum("nij,ni->nj", across, cross)], axis=1)
        if np.abs(error).max() < 1e-10 and (count or not draw):
            break
        columns = joint_jacobian(arm.chain, frames)[:, :, moved]
        task = np.concatenate([columns[:, :3], np.swapaxes(across, 1, 2) @ columns[:, 3:]], axis=1)
        if every_joint and count > HELD_FROM:
            task = task * ~((q <= robot.lower) | (q >= robot.upper))[:, None]
        gram = task @ np.swapaxes(task, 1, 2) + 1e-10 * np.eye(task.shape[1])
        rest = (DRAWN if draw and not count else 0.0) * (middle_of_limits(robot) - q)[:, moved, None]
        step = (rest + np.swapaxes(task, 1, 2) @ np.linalg.solve(gram, error[..., None] - task @ rest))[..., 0]
        q[:, moved] += step * np.minimum(1.0, LARGEST / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        q = np.clip(q, robot.lower, robot.upper) if every_joint else q
    return q, np.abs(error).max(axis=1) < CLOSE


def solve_posture_near(
    arm: Arm, q: Array, position: Array, rotation: Array, *, spin_free: bool
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Put the tool on poses (n, 3), (n, 3, 3) from nearby, q (n, nq) [rad or m].

    Where the arm has fewer than six joints its tip and axis are put there (and the rotation where it is not free); all
    of more than six joints help where six do not reach. Returns joint positions, orientations, and where that is
    reached within the joint limits.
    """
    if arm.robot.nq < 6:
        q, reached = reach_tip_and_axis(arm, q, position, rotation, spin_free=spin_free)
        reached &= ((q >= arm.robot.lower - 1e-9) & (q <= arm.robot.upper + 1e-9)).all(axis=1)
        return q, locate_frames(arm.chain, q).tcp_rotation, reached
    near, (q, reached), rotation = q, reach_pose(arm, q, position, rotation), rotation.copy()
    if arm.robot.nq > 6 and len(lost := np.flatnonzero(~reached)):
        found, helped = reach_tip_and_axis(arm, near[lost], position[lost], rotation[lost], spin_free=spin_free,
                                           every_joint=True)  # fmt: skip
        lost, found = lost[helped], found[helped]
        q[lost], reached[lost] = found, True
        if spin_free:
            rotation[lost] = locate_frames(arm.chain, found).tcp_rotation
    return q, rotation, reached


def turn_about_axis(x: Array, axis: Array) -> Array:
    """Return rotations (n, 3, 3) with z = -axis (it points from tip to spindle) and x as near to `x` as that allows."""
    z = -axis
    x = x - np.einsum("ni,ni->n", z, x)[:, None] * z
    x = x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return np.stack([x, np.cross(z, x), z], axis=2)
