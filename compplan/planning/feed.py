"""Feeds that a process asks for: one constant feed, and joint torques within their limits.

A constant feed is the highest that every waypoint of the cut holds: with q(s) along the path and s at unit feed f,

    |q'| f <= v_max,    |q''| f^2 <= a_max;

the tool still starts and stops from rest. Sharp corners hold it down: `compplan.toolpath.corners` rounds them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from compplan.planning.run_timing import Timing, cutting_runs, parameter_steps, time_command
from compplan.planning.task import PlanTask
from compplan.robot import Array, Robot
from compplan.simulation.exact import build_exact_robot
from compplan.statics.chain import build_chain, locate_frames

#: Torque left to move with where the static load alone is beyond a limit, as a share of the load.
STATIC_ROOM = 1.05


@dataclass(frozen=True)
class FeedRequest:
    """What the process asks of the feed.

    Attributes:
        constant: Whether the whole cut needs one feed.
        torque: Whether joint torques have to stay within the robot's efforts.

    """

    constant: bool = False
    torque: bool = False


@dataclass(frozen=True)
class ConstantFeed:
    """The highest feed that holds along the whole cut.

    Attributes:
        feed: The feed. [m/s]
        programmed: The lowest programmed feed of the cut, which bounds it. [m/s]
        waypoint: Waypoint that limits it, -1 where the programmed feed does.
        joint: Name of the joint that limits it, or "".
        kind: "velocity" or "acceleration".

    """

    feed: float
    programmed: float
    waypoint: int
    joint: str
    kind: str


def time_run(
    task: PlanTask, q: Array, wish: FeedRequest, slow: Array | None = None
) -> tuple[PlanTask, Timing, tuple[str, ...]]:
    """Time a command as the process asks.

    Args:
        task: The task that the command fulfils.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        wish: What the process asks of the feed.
        slow: Factor by which the run is to be slower than the limits ask for, or None. Shape (n,).

    Returns:
        The task with the feed that was programmed in the end, the run, and sentences for the user.

    """
    notes: list[str] = []
    if wish.constant:
        found = find_constant_feed(task, q)
        if found.waypoint >= 0:
            notes.append(
                f"One feed for the whole cut: {1e3 * found.feed:.4g} mm/s instead of {1e3 * found.programmed:.4g}, "
                f"held down by the {found.kind} limit of {found.joint} at waypoint {found.waypoint}."
            )
        task = program_feed(task, found.feed)
    rules = None
    if wish.torque:
        rules = TorqueRules(task.robot, q, task.wrench)
        notes += rules.notes
    return task, time_command(task, q, rules=rules, slow=slow, keep=wish.constant), tuple(notes)


def find_constant_feed(task: PlanTask, q: Array) -> ConstantFeed:
    """Find the highest feed that every waypoint of the cut holds, the programmed one at most.

    Args:
        task: The task: programmed feed, limits, rapid moves.
        q: Commanded joint positions. Shape (n, nq). [rad or m]

    """
    cutting = ~task.nominal.rapid & (task.nominal.feed > 0)
    cutting[0] = False
    programmed = float(task.nominal.feed[cutting].min())
    even = program_feed(task, programmed)
    best = ConstantFeed(programmed, programmed, -1, "", "")
    apart = even.nominal.rapid | even.lead  # what leads in or out stands still
    apart[0] = False
    for start, end in cutting_runs(apart):
        if end - start < 2:
            continue
        along = np.r_[0.0, np.cumsum(parameter_steps(even, q, start, end))]
        spline = CubicSpline(along, q[start : end + 1], bc_type="not-a-knot" if end - start > 2 else "natural")
        shares = {
            "velocity": task.velocity_limits / np.maximum(np.abs(spline(along, 1)), 1e-12),
            "acceleration": np.sqrt(task.acceleration_limits / np.maximum(np.abs(spline(along, 2)), 1e-12)),
        }
        for kind, share in shares.items():
            k, j = np.unravel_index(int(np.argmin(share)), share.shape)
            if programmed * share[k, j] < best.feed:
                joint = task.robot.joint_names[int(j)]
                best = ConstantFeed(float(programmed * share[k, j]), programmed, int(start + k), joint, kind)
    return best


def program_feed(task: PlanTask, feed: float) -> PlanTask:
    """Return the task with one feed [m/s] for all cutting moves."""
    nominal = replace(task.nominal, feed=np.where(task.nominal.rapid, task.nominal.feed, feed))
    cutting = ~task.nominal.rapid[1:]
    times = np.where(cutting, nominal.steps / feed, task.step_time)
    return replace(task, nominal=nominal, step_time=np.asarray(times))


class TorqueRules:
    """Joint torques along a path, as `compplan.planning.run_timing.TorqueRows` has them.

    Masses, weights and the wrench on the tool count; friction does not. Where the static load alone is beyond an effort
    limit, that limit is raised to it and a note says so.
    """

    def __init__(self, robot: Robot, q: Array, wrench: Array) -> None:
        weighed = replace(robot, springs=(), link_elasticities=(), gravity=np.array([0.0, 0.0, -9.81]))
        rigid = build_exact_robot(weighed, standing=True)
        if robot.ground:
            turn = np.swapaxes(locate_frames(build_chain(robot), q).ground, 1, 2)
            wrench = np.hstack([(turn @ part[..., None])[..., 0] for part in (wrench[:, :3], wrench[:, 3:])])
        self.model, self.tcp, self.commanded = rigid.model, rigid.tcp, rigid.commanded
        self.positions = q @ rigid.commanded.T + rigid.shift
        static = self.held = self._static(self.positions, wrench)
        efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1e9)
        greatest = np.abs(static).max(axis=0)
        self.limits = np.maximum(efforts, STATIC_ROOM * greatest)
        self.notes = [
            f"The static load of {robot.joint_names[j]} ({greatest[j]:.0f} N m) is beyond its effort limit "
            f"({efforts[j]:.0f} N m): the limit is left out."
            for j in np.flatnonzero(greatest > efforts)
        ]

    def rows(self, start: int, end: int, rate: Array, change: Array) -> tuple[Array, Array, Array, Array]:
        """Return a, b, c of the waypoints from `start` to `end`, shapes (k, nq), and the limits, shape (nq,) [N m]."""
        data, still = self.model.createData(), np.zeros(self.model.nv)
        place = self.positions[start : end + 1]
        speed, bend = rate @ self.commanded.T, change @ self.commanded.T
        a, b = np.empty((len(place), self.model.nv)), np.empty((len(place), self.model.nv))
        for i in range(len(place)):
            weight = pin.computeGeneralizedGravity(self.model, data, place[i])
            a[i] = pin.rnea(self.model, data, place[i], still, speed[i]) - weight
            b[i] = pin.rnea(self.model, data, place[i], speed[i], bend[i]) - weight
        return a @ self.commanded, b @ self.commanded, self.held[start : end + 1], self.limits

    def _static(self, place: Array, wrench: Array) -> Array:
        """Return the torques that hold weight and wrench: shape (k, nq) [N m]."""
        data = self.model.createData()
        torque = np.empty((len(place), self.model.nv))
        for i in range(len(place)):
            columns = pin.computeFrameJacobian(
                self.model, data, place[i], self.tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
            weight = pin.computeGeneralizedGravity(self.model, data, place[i])
            torque[i] = weight - columns.T @ wrench[i]
        return torque @ self.commanded
