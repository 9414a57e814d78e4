"""What the page of a plan shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.plan.evaluate import Mismatch
from compplan.promise.band import Promise
from compplan.report.along_path import Stations, find_spans
from compplan.report.force_moves import mark_force
from compplan.report.page import Section
from compplan.report.robot_scene import Shape
from compplan.robot import Array, Robot

#: The feed counts as lowered below this share of the programmed one.
LOWERED = 0.995


@dataclass(frozen=True)
class PlanView:
    """What the page of a plan shows, waypoint by waypoint; n waypoints, nq joints, base frame.

    Attributes:
        title: Name of the job.
        robot: The robot, with the tool that the job mounts.
        strategy: How the corrections were found.
        status: "solved" or "infeasible".
        nominal: Wanted tool tip. Shape (n, 3). [m]
        rapid: Moves that are not compensated. Shape (n,).
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        time: Time of each waypoint. Shape (n,). [s]
        before: Deviation of the tip without correction. Shape (n, 3). [m]
        after: Deviation of the tip as planned. Shape (n, 3). [m]
        mismatch: What the plan leaves in a cell that differs from the model, or None.
        tilt_before: Angle between wanted and attained tool axis without correction, or None. Shape (n,). [rad]
        tilt_after: The same as planned, or None. Shape (n,). [rad]
        correction: Unloaded tip of the command minus nominal. Shape (n, 3). [m]
        wrench: Predicted wrench of the environment on the tool at the tip. Shape (n, 6). [N, N m]
        velocity: Joint velocities. Shape (n, nq). [rad/s or m/s]
        acceleration: Joint accelerations. Shape (n, nq). [rad/s^2 or m/s^2]
        feed_wanted: Programmed feed; NaN where there is none. Shape (n,). [m/s]
        feed: Feed as planned. Shape (n,). [m/s]
        tolerance: Greatest deviation that counts as within tolerance. [m]
        max_correction: Greatest correction allowed. [m]
        velocity_limits: Limits that the plan kept; the robot's if left out. Shape (nq,). [rad/s or m/s]
        acceleration_limits: The same. Shape (nq,). [rad/s^2 or m/s^2]
        slowed: Waypoints whose feed had to be lowered; found from the feeds if left out. Shape (n,).
        slow_causes: Sentence that says where and why, "" for none.
        failures: Waypoints that fail, each with the limit that stops it.
        breaches: What keeps the judge from confirming the plan, one sentence each.
        bending: Further rows of figures: name and value.
        between: Greatest distance of the loaded tip from the path between waypoints, by the way a controller goes. [m]
        inertia: How far the inertia of the motion bends the arm where the plan does not compensate it. [m]
        judge: Who computed the deviations.
        uncoupled: Root mean square and greatest uncorrected distance if the force did not ask where the tool is, or
            None where it does not. [m]
        facts: Rows of name and value for the foot of the page.
        notes: Warnings of the plan, one sentence each.
        assumptions: What was assumed, one sentence each.
        extra: Further sections, such as the map of postures.
        promise: The band that holds the true tip with 95 %, or None.
        verdict: Whether the part may be expected within its tolerance, one sentence.
        around: Part, fixture and tool where their meshes are known, as they stand at the first waypoint of the cut.
    """

    title: str
    robot: Robot
    strategy: str
    status: str
    nominal: Array
    rapid: NDArray[np.bool_]
    q: Array
    time: Array
    before: Array
    after: Array
    correction: Array
    wrench: Array
    velocity: Array
    acceleration: Array
    feed_wanted: Array
    feed: Array
    tolerance: float
    max_correction: float
    velocity_limits: Array | None = None
    acceleration_limits: Array | None = None
    slowed: NDArray[np.bool_] | None = None
    slow_causes: str = ""
    mismatch: Mismatch | None = None
    tilt_before: Array | None = None
    tilt_after: Array | None = None
    failures: Mapping[int, str] = field(default_factory=dict)
    breaches: Sequence[str] = ()
    between: Mapping[str, float] = field(default_factory=dict)
    bending: Mapping[str, str] = field(default_factory=dict)
    inertia: float = 0.0
    judge: str = ""
    uncoupled: tuple[float, float] | None = None
    facts: Sequence[tuple[str, str]] = ()
    notes: Sequence[str] = ()
    assumptions: Sequence[str] = ()
    extra: Sequence[Section] = ()
    promise: Promise | None = None
    verdict: str = ""
    around: Sequence[Shape] = ()

    @property
    def start(self) -> int:
        """The first waypoint of the cut."""
        return int(np.flatnonzero(self.cut)[0])

    @cached_property
    def pushed(self) -> NDArray[np.bool_]:
        """Moves of the cut that carry force, by the waypoint that they end at. Shape (n,)."""
        return mark_force(self.wrench, self.cut)

    @cached_property
    def cut(self) -> NDArray[np.bool_]:
        """Waypoints that are compensated and judged. Shape (n,)."""
        return ~self.rapid if (~self.rapid).any() else np.ones(len(self.rapid), bool)

    @cached_property
    def length(self) -> Array:
        """Path length up to each waypoint, rapid moves included [m]. Shape (n,)."""
        steps = np.linalg.norm(np.diff(self.nominal, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def stations(self) -> Stations:
        """Where the waypoints are, for the charts."""
        spans = find_spans(self.rapid)
        last = np.minimum(spans[:, 1] + 1, len(self.rapid) - 1)  # the point of contact ends a rapid move, and counts
        spans = np.column_stack([np.maximum(spans[:, 0] - 1, 0), last]).astype(int)
        return Stations(self.length, self.time, np.array(sorted(self.failures), int), self.length[spans].reshape(-1, 2))

    @cached_property
    def lowered(self) -> NDArray[np.bool_]:
        """Waypoints whose feed had to be lowered. Shape (n,)."""
        return self.cut & (self.feed < LOWERED * self.feed_wanted if self.slowed is None else self.slowed)

    @cached_property
    def rates(self) -> list[tuple[str, Array, Array]]:
        """Name, joint rates and their limits, where there are any."""
        speeds = self.robot.velocity_limits if self.velocity_limits is None else self.velocity_limits
        pushes = self.robot.acceleration_limits if self.acceleration_limits is None else self.acceleration_limits
        pairs = [("velocity", self.velocity, speeds), ("acceleration", self.acceleration, pushes)]
        return [(name, rates, limits) for name, rates, limits in pairs if np.isfinite(limits).any()]
