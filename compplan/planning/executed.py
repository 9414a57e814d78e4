"""Executed path of a command: loaded tip under controller and drives.

The third checked path, in addition to joint-linear and straight moves: lines and arcs of the programs, blended in the
zones of their language, at the speed of the controller, followed by its drives and deflected by the load. Zones are
reduced where they would deviate from the path by more than `ROUNDED` of the tolerance.

A joint follows a command as F (q_cmd - T2 q_cmd''), F = 1 / (1 + T1 s), less half the lost motion
(`compplan.controllers.motion.run`). Without identified values exact drives are assumed; the verdict states it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compplan.controllers.motion.align import find_nearest
from compplan.controllers.motion.geometry import build_moves, build_path, follow_path
from compplan.controllers.motion.run import follow_command, schedule_path
from compplan.controllers.writers import widest_zone
from compplan.controllers.writers.fit import fit_moves
from compplan.controllers.writers.joint_convention import controller_robot, load_motion
from compplan.controllers.writers.motion_table import ASSUMED, ServoMotion
from compplan.controllers.writers.program import build_program
from compplan.controllers.writers.zones import BlendZone, find_zones
from compplan.errors import InfeasibleError
from compplan.job.job import ROUNDED
from compplan.job.output import OutputTable
from compplan.planning.task import PlanTask, attain_rows
from compplan.robot import Array
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm
from compplan.statics.stiffness import attain_pose
from compplan.toolpath.corners import find_corner_shifts
from compplan.toolpath.toolpath import interpolate

#: Segments of the path on either side in the search for the nearest.
NEAR = 8
#: Poses per block of computation.
BLOCK = 100_000
#: Most evaluated places of the executed path: of longer ones every second, third .. cycle.
MOST_PLACES = 200_000


@dataclass(frozen=True)
class ExecutedPath:
    """Distance of the loaded tip of the executed path from the path of the cut, across the path."""

    near: Array  #: Greatest distance on the moves adjacent to each waypoint. Shape (n,). [m]
    p95: float  #: 95th percentile over the executed path. [m]
    most: float  #: Greatest distance. [m]
    source: str  #: Source of the drive parameters, or "assumed".
    zone: BlendZone  #: Greatest distance before a corner at which blending begins.

    @property
    def known(self) -> bool:
        """Return whether the drives were identified."""
        return self.source != ASSUMED

    def describe(self) -> dict[str, object]:
        """Describe the executed path for plan.json."""
        return {
            "p95": 1e3 * self.p95,
            "max": 1e3 * self.most,
            "source": self.source,
            "zone_mm": 1e3 * self.zone.size,
            "zone_from": self.zone.source,
            "blend": "parabola, assumed",
        }


def evaluate_executed(task: PlanTask, q: Array, time: Array, output: OutputTable | None) -> ExecutedPath | None:
    """Simulate the controller on the program moves of a command (n, nq) at its times (n,) [s].

    None if a job writes no Cartesian lines and arcs, or the controller moves tip and part together.
    """
    languages = () if output is None else tuple(name for name in output.programs if name != "csv")
    if output is None or not languages or output.form == "joint" or task.robot.carrying or not task.cut.any():
        return None
    motion, zone = load_motion(task.robot)[0], widest_zone(languages)
    drives = np.abs([motion.lag, motion.acceleration_lag, motion.lost_motion])
    known = motion.source != ASSUMED and bool(drives.any())
    try:
        found = _follow_program(task, q, time, output, zone, motion, known=known)
    except InfeasibleError:  # a line out of reach in the controller's kinematics: the readback reports it
        return None
    return ExecutedPath(*_measure(task, q, *found), motion.source if known else ASSUMED, zone)


def _follow_program(
    task: PlanTask, q: Array, time: Array, output: OutputTable, zone: BlendZone, motion: ServoMotion, *, known: bool
) -> tuple[Array, Array]:
    """Follow the lines and arcs of the written program; drives that are not identified follow exactly.

    Returns joint positions, shape (k, nq) [rad or m], and their places in waypoint numbers from 0. Shape (k,).
    """
    believed, nominal = controller_robot(task.robot), task.nominal
    exact = task.rests.copy()
    exact[0] |= not nominal.rapid[0]  # an approach ends there
    program = build_program(task.robot, q, np.zeros(len(q)), nominal.rapid, name="executed", time=time,
                            exact=exact, events=nominal.events)  # fmt: skip
    tolerance = output.bound_fit(task.tolerance)
    program = replace(program, tolerance=tolerance, cycle=motion.cycle, free=task.lead,
                      form=output.form, arc_of=nominal.arc, asked=1e3 * nominal.feed,
                      **bound_zones(task, motion))  # fmt: skip
    assert program.tcp is not None and program.corner is not None
    shift = find_corner_shifts(nominal, program.tcp[:, :3, 3], program.corner)
    fitted = fit_moves(replace(program, corner_shift=shift))
    arm = build_arm(believed)
    zones = find_zones(fitted.program, zone)[0]
    nodes, rows = build_moves(fitted, q, arm, zones)
    path = build_path(nodes, arm, motion.blend_share)
    step = np.linalg.norm(np.diff(locate_frames(arm.chain, q).tcp_position, axis=0), axis=1)
    length = np.r_[0.0, np.cumsum(step + 1e-9)]
    reached, s = path.q, path.s
    if known:
        driven = schedule_path(path, motion)
        reached = follow_command(follow_path(path, driven), motion)
        s = np.r_[np.zeros(round(motion.lag.mean() / motion.cycle)), driven][: len(reached)]
    some = slice(None, None, -(-len(s) // MOST_PLACES))
    along = np.interp(s[some], path.ends, length[rows])
    return reached[some], np.interp(along, length, np.arange(len(q)))


def bound_zones(task: PlanTask, motion: ServoMotion) -> dict[str, Any]:
    """Return the allowed deviation of zones from the path of a task and the controller's blending, as in `Program`."""
    corner = np.full(len(task), ROUNDED * task.tolerance)
    return {"corner": corner, "blend_share": motion.blend_share, "smoothing": motion.smoothing}


def _measure(task: PlanTask, q: Array, reached: Array, place: Array) -> tuple[Array, float, float]:
    """Compute the distance of the executed loaded tip across the path: per waypoint, 95 % and greatest. [m]"""
    every, effect = np.arange(len(q)), np.zeros((len(q), 3))
    if task.robot.effects:  # tip displacement by effects: interpolated between waypoints
        effect = attain_rows(task, q, every, slope=False).position
        plain = attain_pose(task.chain, q, task.wrench, slope=False, torque_bias=task.bias).position
        effect = effect - task.to_part_frame(plain)
        effect[~task.compensated] = 0.0
    row = np.clip(np.ceil(place).astype(int), 1, len(q) - 1)
    cut = task.cut[row] & task.cut[row - 1]
    distance, nearby = np.zeros(len(row)), np.zeros(len(q))
    commanded = locate_frames(task.chain, q).tcp_position
    for rows in np.array_split(np.flatnonzero(cut), max(1, int(cut.sum()) // BLOCK)):
        # around a corner the force changes with the place: that of the nearest place, not of the same share of a move
        at = find_nearest(commanded, row[rows], locate_frames(task.chain, reached[rows]).tcp_position, NEAR)[1]
        load, moved = (interpolate(at, every, values) for values in (task.wrench, effect))
        bias = None if task.bias is None else interpolate(at, every, task.bias)
        tip = attain_pose(task.chain, reached[rows], load, slope=False, torque_bias=bias).position
        tip = task.to_part_frame(tip) + moved
        beside_it = np.clip(np.ceil(at).astype(int), 1, len(q) - 1)
        nearest = find_nearest(task.position, beside_it, tip, NEAR)[0]
        distance[rows] = np.linalg.norm(tip - nearest, axis=1)
    for ends in (row, row - 1):
        np.maximum.at(nearby, ends, distance)
    return nearby, float(np.percentile(distance[cut], 95)) if cut.any() else 0.0, float(distance.max(initial=0.0))
