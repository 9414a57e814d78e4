"""Approach to the first waypoint and retract from the last one, if the toolpath has none.

The unloaded tool moves along its axis to the first point; there the correction grows with the force, so that the tool
does not move into the part before the force acts. The retract is the reverse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.effects.backlash import lead_play
from compplan.planning.task import PlanTask
from compplan.planning.timing import ease, ease_duration
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, reach_pose
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.contact import tool_axes
from compplan.toolpath.toolpath import select_waypoints

#: Height of approach and retract along the tool axis, if the toolpath has none. [m]
APPROACH = 0.05
#: Rows of the motion down and of the loading, evenly spaced in time.
DOWN_ROWS, LOADING_ROWS = 48, 16
#: Time at rest where the cut begins or ends. [s]
DWELL = 0.02


@dataclass(frozen=True)
class AuxiliaryMotion:
    """Rows before the first waypoint or after the last one, in order of time."""

    #: Program positions: above, unloaded tool at the point, and the other side of lost motion. Shape (k', nq).
    key_q: Array
    key_gap: Array  #: Time from each of them to the next, the last one to the waypoint. Shape (k',). [s]
    q: Array  #: Joint positions of the rows. Shape (k, nq). [rad or m]
    position: Array  #: Required tip position. Shape (k, 3). [m]
    wrench: Array  #: Wrench on the tool. Shape (k, 6). [N, N m]
    gap: Array  #: Time from each row to the next, the last one to the waypoint. Shape (k,). [s]


def plan_approach(task: PlanTask, q: Array) -> AuxiliaryMotion:
    """Plan the motion to the first waypoint; empty if the toolpath begins with a rapid move."""
    return _pass(task, q, 0)


def plan_retract(task: PlanTask, q: Array) -> AuxiliaryMotion:
    """Plan the motion from the last waypoint; empty if the toolpath ends with a rapid move."""
    way = _pass(task, q, len(task) - 1)
    backwards = (part[::-1] for part in (way.key_q, way.key_gap, way.q, way.position, way.wrench, way.gap))
    return AuxiliaryMotion(*backwards)


def _pass(task: PlanTask, q: Array, end: int) -> AuxiliaryMotion:
    nq = q.shape[1]
    none = np.zeros((0, nq))
    nothing = AuxiliaryMotion(none, np.zeros(0), none, np.zeros((0, 3)), np.zeros((0, 6)), np.zeros(0))
    if task.nominal.rapid[end]:
        return nothing
    loaded, point = q[end], task.position[end]
    free = _unload(task, loaded, end)
    legs = []
    above, top = _above(task, free, end)
    if len(above):
        legs.append((above[0], free, point + top, point, np.zeros(6), np.zeros(6), DOWN_ROWS))
    # the command comes from the other side of each lost motion, so that the links are at the first point
    cross = -2.0 * lead_play(task.robot, task.q_start[:1])[0] if end == 0 else np.zeros(nq)
    if np.abs(loaded + cross - free).max() > 1e-9:
        legs.append((free, loaded + cross, point, point, np.zeros(6), task.wrench[end], LOADING_ROWS))
    if cross.any():
        legs.append((loaded + cross, loaded, point, point, task.wrench[end], task.wrench[end], LOADING_ROWS))
    if not legs:
        return nothing
    parts = [_leg(task, *leg) for leg in legs]
    parts.append((loaded[None], point[None], task.wrench[end : end + 1], np.array([DWELL])))
    q_rows, position, wrench, gap = (np.concatenate(column) for column in zip(*parts, strict=True))
    key_gap = np.array([float(part[3].sum()) for part in parts[:-1]])
    key_gap[-1] += DWELL
    return AuxiliaryMotion(np.array([leg[0] for leg in legs]), key_gap, q_rows, position, wrench, gap)


def _leg(
    task: PlanTask, start: Array, end: Array, here: Array, there: Array, before: Array, after: Array, rows: int
) -> tuple[Array, Array, Array, Array]:
    """Return the rows of a smooth joint move without its end, and the times to the next row."""
    u = np.arange(rows + 1) / rows
    share = ease(u)[:, None]
    duration = 1.05 * ease_duration(np.abs(end - start), task.velocity_limits, task.acceleration_limits)
    feed = float(np.median(task.nominal.feed[task.nominal.feed > 0])) if (task.nominal.feed > 0).any() else 0.1
    if not np.any(here - there):
        tips = locate_frames(task.chain, np.array([start, end])).tcp_position
        duration = max(duration, 1.875 * float(np.linalg.norm(tips[1] - tips[0])) / feed)
    time = u * max(duration, task.gentle_time)
    q, wrench = start * (1 - share) + end * share, before * (1 - share) + after * share
    # a joint move is not straight: the rows hold the actual tip positions
    position = task.to_part_frame(attain_pose(task.chain, q, wrench, slope=False).position)
    return q[:-1], position[:-1], wrench[:-1], np.diff(time)


def _unload(task: PlanTask, q: Array, end: int) -> Array:
    """Return the joint positions nearest to q with the tool at a waypoint without wrench, under weights only."""
    found = q[None].copy()
    wanted = task.to_part_frame_pose(attain_pose(task.chain, q[None], task.wrench[end : end + 1], slope=False))
    none = np.zeros((1, 6))
    for _ in range(8):
        here = task.to_part_frame_pose(attain_pose(task.chain, found, none))
        lean = np.cross(wanted.rotation[0, :, 2], here.rotation[0, :, 2])
        missed = np.r_[here.position[0] - task.position[end], lean]
        if np.abs(missed).max() < 1e-11:
            break
        found -= (np.linalg.pinv(here.jacobian[0], rcond=1e-6) @ missed)[None]
    return np.clip(found[0], task.robot.lower, task.robot.upper)


def _above(task: PlanTask, q: Array, end: int) -> tuple[Array, Array]:
    """Return joint positions with the unloaded tool above a waypoint, shape (0 or 1, nq), and the offset from it."""
    row, arm = slice(end, end + 1), build_arm(task.robot)
    top = APPROACH * task.nominal.axis[end]
    rotation = task.rotation[row]
    if task.spin_free:
        x = locate_frames(task.chain, q[None]).tcp_rotation[0, :, 0]
        rotation = tool_axes(select_waypoints(task.nominal, np.array([end])), x)
    above, reached = reach_pose(arm, q[None], task.position[row] + top, rotation)
    return above[reached], top
