"""Inverse kinematics: all solutions of an unloaded arm, for many poses at once.

Six revolute joints with a spherical wrist or three parallel axes have a closed form, solved by EAIK with the tool
included. For a calibrated geometry (a wrist whose axes miss each other by micrometres) the nearest geometry with a
closed form is solved, followed by Newton steps on the true chain. Other arms are solved numerically.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.errors import ShapeError
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, Frames, build_chain, joint_jacobian, locate_frames
from compplan.statics.sweep import CHUNK, cross, dot

#: Names of the eight slots of solutions; slot = 4 * back + 2 * down + flip.
CONFIGURATIONS: tuple[dict[str, str], ...] = tuple(
    {"shoulder": shoulder, "elbow": elbow, "wrist": wrist}
    for shoulder in ("front", "back")
    for elbow in ("up", "down")
    for wrist in ("noflip", "flip")
)
#: Tolerance of a solution, and error of a pose that counts as reached. [m and rad]
REACHED, CLOSE = 1e-9, 1e-6
#: Deviation from parallel [rad] and intersecting [m] axes that the nearest closed-form geometry removes.
NEARLY_PARALLEL, NEARLY_MEETING = 0.02, 0.005
#: Number of waypoints between two that are solved from random starts, without a closed form.
STRIDE = 25
#: Number of Newton steps, greatest joint motion per step [rad or m], and step from which joints at a limit are held.
STEPS, LARGEST, HELD_FROM = 25, 0.3, 5
#: Share of the distance to the middle of the limits in a null-space step at a waypoint.
DRAWN = 0.02


@dataclass(frozen=True)
class Arm:
    """A robot prepared for inverse kinematics."""

    robot: Robot  #: The robot.
    chain: Chain  #: Its chain without springs.
    arm: NDArray[np.int_]  #: The six joints that are solved (or fewer); the others are held. Shape (6,).
    solver: Any  #: EAIK's robot for the arm at held joints zero, or None if no closed form is known.
    exact: bool  #: Whether the closed form is that of the true geometry.
    base_turn: Array  #: Orientation of the TCP at zero joint positions. Shape (3, 3).
    front: float  #: +1 or -1: side of the first axis that is the front.

    @property
    def held(self) -> NDArray[np.int_]:
        """Commanded joints that are held: extra axes before the arm."""
        return np.setdiff1d(np.arange(self.chain.nq), self.arm)


def build_arm(robot: Robot) -> Arm:
    """Prepare a robot for inverse kinematics, without springs."""
    chain = build_chain(replace(robot, springs=(), link_elasticities=(), gravity=None))
    arm = np.arange(max(0, chain.nq - 6), chain.nq)
    mimics = len(chain.names) != chain.nq
    frames = locate_frames(chain, np.zeros((1, chain.nq)))
    solver, exact = None, False
    elements = chain.joint_elements[arm]
    if len(arm) == 6 and not mimics and not chain.translates[elements].any():
        axes, origins = frames.axis[0, elements], frames.origin[0, elements]
        solver = _closed_form(axes, origins, frames.tcp_position[0])
        exact = solver is not None and _returns_probes(
            Arm(robot, chain, arm, solver, True, frames.tcp_rotation[0], 1.0)
        )
        if not exact:
            solver = _closed_form(*snap_geometry(axes, origins), frames.tcp_position[0])
    plain = Arm(robot, chain, arm, solver, exact, frames.tcp_rotation[0], 1.0)
    return replace(plain, front=_front_side(plain))


def _returns_probes(arm: Arm) -> bool:
    """Return whether a closed form finds the postures of a few test poses.

    EAIK returns least-squares solutions for arms whose axes are parallel or intersect up to microradians.
    """
    bent = 0.25 * np.linspace(0.8, 1.2, arm.chain.nq)
    sign = np.array([[1.0], [-1.0], [0.5]])
    low, high = np.maximum(arm.robot.lower, -np.pi), np.minimum(arm.robot.upper, np.pi)
    q = np.clip(0.5 * (low + high) + sign * bent * np.where(np.arange(arm.chain.nq) % 2, 1.0, -1.0), low, high)
    frames = locate_frames(arm.chain, q)
    rows, found = _solve_closed(arm, frames.tcp_position, frames.tcp_rotation, q[:, arm.held])
    fits = np.abs(_miss(locate_frames(arm.chain, found), frames.tcp_position[rows], frames.tcp_rotation[rows])) < 1e-6
    return len(np.unique(rows[fits.all(axis=1)])) == len(q)


def stretch_arm(arm: Arm) -> float:
    """Return the length of the stretched arm. [m]"""
    frames = locate_frames(arm.chain, np.zeros((1, arm.chain.nq)))
    points = np.vstack([frames.origin[0, arm.chain.joint_elements[arm.arm]], frames.tcp_position])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def solve_branches(arm: Arm, position: Array, rotation: Array, held: Array | None = None) -> Array:
    """Find every solution, sorted by configuration, revolute joints within half a turn of the middle of their limits.

    Args:
        arm: The arm.
        position: Target TCP positions, base frame. Shape (n, 3). [m]
        rotation: Target orientations of the TCP frame. Shape (n, 3, 3).
        held: Positions of the held joints (default: middle of their limits, or zero). Shape (n, nq - 6). [rad or m]

    Returns:
        Slots as `CONFIGURATIONS`, NaN if a configuration does not reach the pose. Shape (n, 8, nq). [rad or m]

    Raises:
        ShapeError: If the arrays do not belong together.

    """
    _check_poses(position, rotation)
    rest = middle_of_limits(arm.robot)
    slots = np.full((len(position), 8, arm.chain.nq), np.nan)
    rows, q = _solve_all(arm, position, rotation, np.tile(rest[arm.held], (len(position), 1)) if held is None else held)
    if len(rows):
        if not arm.exact:
            q = refine_ik(arm, q, position[rows], rotation[rows])
        frames = locate_frames(arm.chain, q)
        fits = _fit_pose(frames, position[rows], rotation[rows])
        names = _name_slots(arm, frames)[fits]  # full turns do not change the configuration
        rows, q = rows[fits], _wrap(arm, q[fits], rest)
        slots[rows, _assign_slots(rows, names)] = q
    return slots


def solve_nearest(arm: Arm, position: Array, rotation: Array, near: Array) -> Array:
    """Find the solution nearest to joint positions `near` (n, nq), whose held joints it keeps; NaN if none is found.

    Poses as of `solve_branches`; nearest by the joint that moves the most. Shape (n, nq). [rad or m]
    """
    _check_poses(position, rotation)
    rows, q = _solve_all(arm, position, rotation, near[:, arm.held])
    q = near[rows] + _wrap(arm, q - near[rows], np.zeros(arm.chain.nq))
    order = np.lexsort((np.abs(q - near[rows]).max(axis=1), rows))
    found, left = np.full(near.shape, np.nan), np.ones(len(near), bool)
    while len(order):
        first = np.flatnonzero(np.diff(rows[order], prepend=-1))
        own = order[first]
        place = rows[own]
        trial = q[own] if arm.exact else refine_ik(arm, q[own], position[place], rotation[place])
        fits = _fit_pose(locate_frames(arm.chain, trial), position[place], rotation[place])
        found[place[fits]], left[place[fits]] = trial[fits], False
        order = np.delete(order, first)
        order = order[left[rows[order]]]
    return found


def _check_poses(position: Array, rotation: Array) -> None:
    n = len(position)
    if position.shape != (n, 3) or rotation.shape != (n, 3, 3):
        raise ShapeError(f"poses have shapes {position.shape} and {rotation.shape}, expected (n, 3) and (n, 3, 3)")


def _solve_all(arm: Arm, position: Array, rotation: Array, held: Array) -> tuple[NDArray[np.int_], Array]:
    """Return waypoint and joint positions of every solution, of the nearest geometry with a closed form if any."""
    return (_solve_numerically if arm.solver is None else _solve_closed)(arm, position, rotation, held)


def _fit_pose(frames: Frames, position: Array, rotation: Array) -> NDArray[np.bool_]:
    fits = np.abs(frames.tcp_position - position).max(axis=1) < 1e-6
    return np.asarray(fits & (np.abs(frames.tcp_rotation - rotation).max(axis=(1, 2)) < 1e-6))


def name_configuration(arm: Arm, q: Array) -> NDArray[np.int_]:
    """Return the configuration of joint positions: index into `CONFIGURATIONS`. Shape (n, nq) -> (n,).

    Shoulder: side of axis one on which the wrist lies, in the plane in which joint two moves. Elbow: third joint above
    or below the line from the second one to the wrist, for an arm reaching forward. Wrist: sign of the fifth joint
    from the alignment of axes four and six.
    """
    return _name_slots(arm, locate_frames(arm.chain, q))


def _name_slots(arm: Arm, frames: Frames) -> NDArray[np.int_]:
    if len(arm.arm) < 6:
        return np.zeros(len(frames.tcp_position), int)
    axis, origin = _place_arm(arm, frames)
    wrist = _wrist(axis, origin)
    back = _shoulder_side(axis, origin, wrist) * arm.front < 0
    lateral = cross(axis[0], cross(axis[1], axis[0]))
    bend = cross(origin[2] - origin[1], wrist - origin[1])
    down = dot(bend, lateral) * arm.front < 0
    flip = dot(cross(axis[3], axis[5]), axis[4]) < 0
    return np.asarray(4 * back + 2 * down + flip)


def _place_arm(arm: Arm, frames: Frames) -> tuple[Array, Array]:
    """Return axes and origins of the six joints, component by component. Shapes (6, 3, n)."""
    elements = arm.chain.joint_elements[arm.arm]
    axis, origin = (np.ascontiguousarray(part[:, elements].transpose(1, 2, 0)) for part in (frames.axis, frames.origin))
    return axis, origin


def refine_ik(arm: Arm, q: Array, position: Array, rotation: Array, *, iterations: int = 12) -> Array:
    """Refine joint positions by damped Newton steps on the true chain; held joints are fixed.

    Args:
        arm: The arm.
        q: Joint positions near a solution. Shape (n, nq). [rad or m]
        position: Target TCP positions. Shape (n, 3). [m]
        rotation: Target orientations of the TCP frame. Shape (n, 3, 3).
        iterations: Greatest number of steps.

    Returns:
        Joint positions, to be checked with `pose_error`. Shape (n, nq). [rad or m]

    """
    q = np.array(q)
    damping = np.full(len(q), 1e-9)
    error = pose_error(arm.chain, q, position, rotation)
    for _ in range(iterations):
        size = np.linalg.norm(error, axis=1)
        busy = np.flatnonzero(size > 1e-13)
        if not len(busy):
            break
        columns = joint_jacobian(arm.chain, locate_frames(arm.chain, q[busy]))[:, :, arm.arm]
        normal = np.swapaxes(columns, 1, 2) @ columns + damping[busy, None, None] * np.eye(len(arm.arm))
        wanted = np.swapaxes(columns, 1, 2) @ error[busy, :, None]
        try:
            step = np.linalg.solve(normal, wanted)[..., 0]
        except np.linalg.LinAlgError:  # singular, the damping lost in rounding
            step = (np.linalg.pinv(normal) @ wanted)[..., 0]
        trial = q[busy]
        trial[:, arm.arm] += step * np.minimum(1.0, 0.7 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        trial_error = pose_error(arm.chain, trial, position[busy], rotation[busy])
        better = np.linalg.norm(trial_error, axis=1) < size[busy]
        q[busy[better]], error[busy[better]] = trial[better], trial_error[better]
        damping[busy] = np.where(better, damping[busy] * 0.1, np.maximum(damping[busy], 1e-9) * 30.0)
    return q


def reach_pose(arm: Arm, q: Array, position: Array, rotation: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Refine joint positions as `refine_ik`; also return which poses are reached within the joint limits. (n,)"""
    q = refine_ik(arm, q, position, rotation)
    reached = np.abs(pose_error(arm.chain, q, position, rotation)).max(axis=1) < CLOSE
    return q, reached & ((q >= arm.robot.lower - 1e-9) & (q <= arm.robot.upper + 1e-9)).all(axis=1)


def reach_tip_and_axis(
    arm: Arm, q: Array, position: Array, rotation: Array, *, spin_free: bool = True, every_joint: bool = False,
    draw: bool = False,
) -> tuple[Array, NDArray[np.bool_]]:  # fmt: skip
    """Solve for tip and tool axis from nearby positions q (n, nq) [rad or m], with least joint motion.

    The rotation about the axis is free with `spin_free`. The joints of the arm move without limits; with `every_joint`
    all joints move within their limits. `draw` adds one null-space step to the middle of the limits.
    Returns joint positions, and whether tip and axis are reached.
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
        off, across = np.cross(frames.tcp_rotation[:, :, 2], rotation[:, :, 2]), rotation[:, :, :2]
        if not spin_free:
            off, across = 0.5 * np.cross(frames.tcp_rotation, rotation, axis=1).sum(axis=2), rotation
        error = np.concatenate([position - frames.tcp_position, np.einsum("nij,ni->nj", across, off)], axis=1)
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
    """Solve the inverse kinematics of poses (n, 3), (n, 3, 3) from nearby joint positions q (n, nq) [rad or m].

    With fewer than six joints only tip and tool axis are solved for (and the spin if it is not free); with more than
    six, all joints move where six do not reach. Returns joint positions, orientations, and which poses are reached
    within the joint limits.
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


def pose_error(chain: Chain, q: Array, position: Array, rotation: Array) -> Array:
    """Return the pose error, target minus attained, rotation vector last, base axes. Shape (n, 6)."""
    return _miss(locate_frames(chain, q), position, rotation)


def _miss(frames: Frames, position: Array, rotation: Array) -> Array:
    turn = Rotation.from_matrix(rotation @ np.swapaxes(frames.tcp_rotation, 1, 2)).as_rotvec()
    return np.hstack([position - frames.tcp_position, turn])


def middle_of_limits(robot: Robot) -> Array:
    """Return the middle of every joint's limits, zero if they are infinite; shape (nq,) [rad or m]."""
    bounded = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    with np.errstate(invalid="ignore"):
        return np.where(bounded, 0.5 * (robot.lower + robot.upper), 0.0)


def snap_geometry(axes: Array, origins: Array) -> tuple[Array, Array]:
    """Return the nearest arm with a closed form: exactly parallel axes, exactly intersecting wrist axes.

    Args:
        axes: Joint axes at zero joint positions. Shape (6, 3).
        origins: A point on each. Shape (6, 3). [m]

    Returns:
        Axes and points of the snapped arm.

    """
    axes, origins = axes.copy(), origins.copy()
    for j in range(1, 6):
        for i in range(j):
            cosine = float(axes[i] @ axes[j])
            if np.linalg.norm(np.cross(axes[i], axes[j])) < NEARLY_PARALLEL:
                axes[j] = np.sign(cosine) * axes[i]
                break
            if abs(cosine) < NEARLY_PARALLEL and j == i + 1:
                axes[j] -= cosine * axes[i]
                axes[j] /= np.linalg.norm(axes[j])
    across = [np.eye(3) - np.outer(a, a) for a in axes[3:]]
    normal = sum(across[1:], across[0])
    target = sum((p @ o for p, o in zip(across[1:], origins[4:], strict=True)), across[0] @ origins[3])
    centre = np.linalg.lstsq(normal, target, rcond=1e-6)[0]
    misses = [float(np.linalg.norm(p @ (o - centre))) for p, o in zip(across, origins[3:], strict=True)]
    if max(misses) < NEARLY_MEETING:
        origins[3:] = centre
    return axes, origins


def _closed_form(axes: Array, origins: Array, tip: Array) -> Any:
    from eaik.IK_HP import HPRobot

    offsets = np.vstack([origins[:1], np.diff(origins, axis=0), (tip - origins[-1])[None]])
    try:
        solver = HPRobot(axes, offsets)
    except RuntimeError:  # axes that are neither parallel nor intersecting within EAIK's tolerances
        return None
    return solver if solver.hasKnownDecomposition() else None


def _solve_closed(arm: Arm, position: Array, rotation: Array, held: Array) -> tuple[NDArray[np.int_], Array]:
    """Return waypoint and joint positions of every closed-form solution."""
    pose = np.tile(np.eye(4), (len(position), 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = rotation, position
    if len(arm.held):
        pose = _carry_to_arm(arm, pose, held)
    pose[:, :3, :3] = pose[:, :3, :3] @ arm.base_turn.T
    answers = arm.solver.IK_batched(pose, 1)
    found = [answer.Q for answer in answers]  # read once: each access copies
    counts = np.array([len(each) for each in found])
    if not counts.sum():
        return np.zeros(0, int), np.zeros((0, arm.chain.nq))
    rows = np.repeat(np.arange(len(position)), counts)
    q = np.empty((len(rows), arm.chain.nq))
    q[:, arm.arm] = np.vstack([each for each in found if len(each)])
    q[:, arm.held] = held[rows]
    if arm.exact:
        least = [answer.is_LS for answer, each in zip(answers, found, strict=True) if len(each)]
        rigid = ~np.hstack(least).astype(bool)
        rows, q = rows[rigid], q[rigid]
    return rows, q


def _carry_to_arm(arm: Arm, pose: Array, held: Array) -> Array:
    """Express poses with the held joints at zero."""
    chain, first = arm.chain, arm.chain.joint_elements[arm.arm[0]]
    at_zero, here = np.zeros((1, chain.nq)), np.zeros((len(held), chain.nq))
    here[:, arm.held] = held
    zero, moved = locate_frames(chain, at_zero), locate_frames(chain, here)
    turn = moved.tcp_rotation @ zero.tcp_rotation[0].T
    carried = np.array(pose)
    back = np.swapaxes(turn, 1, 2)
    carried[:, :3, :3] = back @ pose[:, :3, :3]
    carried[:, :3, 3] = (back @ (pose[:, :3, 3] - moved.origin[:, first])[..., None])[..., 0] + zero.origin[0, first]
    return carried


def _solve_numerically(arm: Arm, position: Array, rotation: Array, held: Array) -> tuple[NDArray[np.int_], Array]:
    """Return waypoint and joint positions of solutions from many starts, continued to the waypoints between."""
    n = len(position)
    anchors = np.unique(np.r_[np.arange(0, n, STRIDE), n - 1])
    starts = sample_limits(arm.robot, 96)
    rows = np.repeat(anchors, len(starts))
    q = np.tile(starts, (len(anchors), 1))
    q[:, arm.held] = held[rows]
    q = refine_ik(arm, q, position[rows], rotation[rows], iterations=40)
    rows, q = _keep_distinct(arm, rows, q, position, rotation)
    nearest = anchors[np.abs(np.arange(n)[:, None] - anchors[None, :]).argmin(axis=1)] if n else anchors
    members = [np.flatnonzero(rows == anchor) for anchor in nearest]
    all_rows = np.repeat(np.arange(n), [len(member) for member in members])
    start = q[np.concatenate(members)] if len(all_rows) else np.zeros((0, arm.chain.nq))
    start[:, arm.held] = held[all_rows]
    return all_rows, refine_ik(arm, start, position[all_rows], rotation[all_rows], iterations=30)


def sample_limits(robot: Robot, count: int) -> Array:
    """Sample joint positions evenly inside the limits, at most half a turn from zero. Shape (count, nq). [rad or m]"""
    from scipy.stats import qmc

    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return np.asarray(low + qmc.Halton(robot.nq, seed=0).random(count) * (high - low))


def _keep_distinct(
    arm: Arm, rows: NDArray[np.int_], q: Array, position: Array, rotation: Array
) -> tuple[NDArray[np.int_], Array]:
    """Keep converged starts, one per configuration and waypoint."""
    fits = np.abs(pose_error(arm.chain, q, position[rows], rotation[rows])).max(axis=1, initial=0.0) < REACHED
    rows, q = rows[fits], q[fits]
    if not len(rows):
        return rows, q
    keys = rows * 8 + name_configuration(arm, q)
    first = np.unique(keys, return_index=True)[1]
    return rows[first], q[first]


def _assign_slots(rows: NDArray[np.int_], names: NDArray[np.int_]) -> NDArray[np.int_]:
    """Assign a separate slot to every solution of a waypoint; of two with one name the later gets a free slot.

    rows: ascending, shape (r,).
    """
    slots = names.copy()
    later = np.ones(len(rows), bool)
    later[np.unique(rows * 8 + names, return_index=True)[1]] = False
    for k in np.flatnonzero(later):
        low, high = np.searchsorted(rows, rows[k], "left"), np.searchsorted(rows, rows[k], "right")
        taken = np.delete(slots[low:high], k - low)
        slots[k] = np.setdiff1d(np.arange(8), taken)[0] if len(set(taken)) < 8 else names[k]
    return slots


def _front_side(arm: Arm) -> float:
    """Return +1 or -1: the front is the side of the offset of the second axis, otherwise of the zero pose."""
    if len(arm.arm) < 6:
        return 1.0
    frames = locate_frames(arm.chain, np.zeros((1, arm.chain.nq)))
    first, second = arm.chain.joint_elements[arm.arm[:2]]
    direction = np.cross(frames.axis[0, second], frames.axis[0, first])
    offset = float((frames.origin[0, second] - frames.origin[0, first]) @ direction)
    placed = _place_arm(arm, frames)
    side = offset if abs(offset) > 1e-3 else float(_shoulder_side(*placed, _wrist(*placed))[0])
    return -1.0 if side < 0 else 1.0


def _wrap(arm: Arm, q: Array, rest: Array) -> Array:
    """Shift revolute joints to within half a turn of the middle of their limits."""
    turns = np.where(arm.robot.prismatic, 0.0, np.round((q - rest) / (2 * np.pi)))
    return q - 2 * np.pi * turns


def _wrist(axis: Array, origin: Array) -> Array:
    """Return the point of axis five that is nearest to axis four: the wrist centre of a spherical wrist. (3, n)."""
    between = origin[3] - origin[4]
    cosine = dot(axis[3], axis[4])
    along = dot(between, axis[4]) - cosine * dot(between, axis[3])
    return np.asarray(origin[4] + along / np.maximum(1.0 - cosine**2, 1e-6) * axis[4])


def _shoulder_side(axis: Array, origin: Array, wrist: Array) -> Array:
    """Return the wrist's distance from the first axis along the second joint's plane, signed; shape (n,) [m]."""
    return dot(wrist - origin[0], cross(axis[1], axis[0]))
