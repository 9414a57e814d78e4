"""What the choice of a posture may vary, and what it is chosen for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.costs import ErrorModel, ModelScatter
from compplan.planning.posture.motion import MotionFigures, list_plays
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.ik import Arm, build_arm
from compplan.toolpath.toolpath import Toolpath

if TYPE_CHECKING:
    from compplan.job.job import Job

#: By how much postures keep clear: (q (m, nq), waypoints (m,)) -> margin (m,) [m], negative where too near.
Margin = Callable[[Array, NDArray[np.int_]], Array]


@dataclass(frozen=True)
class PostureSettings:
    """What the search may vary and what it weighs.

    Attributes:
        free_spin: Whether the rotation about the tool axis is free.
        configuration: Words that the configuration has to have, such as {"elbow": "up"}; none: all are free.
        start: Joint positions to start near, or None. [rad or m]
        preset: "accurate", "error_band", "smooth" or "fast".
        compares: Whether the preset was asked for by name: finished postures are then measured beside those of others.
        weights: Weights in place of the preset's, see `compplan.planning.posture.costs.Weights`.
        uncertainty: How well wrench and compliance are known.
        spin_step: Step of the grid of rotations about the tool axis. [rad]
        lead: How far the tool axis may lean along the travel. [rad]
        lean: How far it may lean across the travel. [rad]
        held_steps: Grid positions of each extra axis (a rail), where there is one; of several together at most thrice
            as many.
        stations: Waypoints that the graph is built at, at most; those between follow.
        singularity_margin: Inverse condition number below which a posture counts as singular and costs steeply.
        limit_margin: Distance to a joint limit below which a posture costs. [rad or m]
        limit_room: Distance to a joint limit below which a posture is refused: room for the correction. [rad or m]
        most_step: Greatest motion of a joint between neighbouring waypoints of a cut. [rad or m]
        motion: What the motion of joints does to accuracy.
        errors: What the promise knows of the robot, in place of `uncertainty`; None for other presets.

    """

    free_spin: bool = True
    configuration: dict[str, str] = field(default_factory=dict)
    start: tuple[float, ...] | None = None
    preset: str = "accurate"
    compares: bool = False
    weights: dict[str, float] = field(default_factory=dict)
    uncertainty: ModelScatter = field(default_factory=ModelScatter)
    spin_step: float = float(np.radians(5.0))
    lead: float = 0.0
    lean: float = 0.0
    held_steps: int = 9
    stations: int = 240
    singularity_margin: float = 0.03
    limit_margin: float = float(np.radians(10.0))
    limit_room: float = float(np.radians(2.0))
    most_step: float = float(np.radians(20.0))
    motion: MotionFigures = field(default_factory=MotionFigures)
    errors: ErrorModel | None = None

    def count_positions(self, axes: int) -> int:
        """Return the grid positions of each of several extra axes, at least 3."""
        return self.held_steps if axes < 2 else max(3, int((3 * self.held_steps) ** (1.0 / axes) + 1e-9))

    @property
    def known(self) -> ModelScatter | ErrorModel:
        """What the sensitivity counts."""
        return self.uncertainty if self.errors is None else self.errors


@dataclass(frozen=True)
class PostureProblem:
    """The choice of a posture along a path, as every step of the search has it.

    Attributes:
        robot: The robot with its tool.
        nominal: Toolpath in the base frame, with its predicted wrench.
        tool_x: Where x of the TCP points at spin 0, base axes. Shape (3,).
        settings: What may vary and what it is chosen for.
        axes: Axes in whose components the wrench errs, as columns in base axes (the part's). Shape (3, 3).
        margin: By how much postures keep clear, or None where nothing is in the way.

    """

    robot: Robot
    nominal: Toolpath
    tool_x: Array
    settings: PostureSettings
    axes: Array = field(default_factory=lambda: np.eye(3))
    margin: Margin | None = None

    @cached_property
    def chain(self) -> Chain:
        """The elastic chain of the robot."""
        return build_chain(self.robot)

    @cached_property
    def arm(self) -> Arm:
        """The arm for inverse kinematics."""
        return build_arm(self.robot)

    @property
    def wrench(self) -> Array:
        """Predicted wrench, zero where the path carries none. Shape (n, 6). [N, N m]"""
        wrench = self.nominal.wrench
        return np.zeros((len(self.nominal), 6)) if wrench is None else wrench


def read_settings(job: Job, robot: Robot, errors: ErrorModel | None = None) -> PostureSettings:
    """Take the settings from a job's tables [plan] and [posture], and for the preset "error_band" what is known.

    A wrench that is given in tool axes would turn with the tool: the rotation then stays where the job has it.
    """
    words = job.plan.configuration.model_dump(exclude_none=True)
    table = job.posture
    start = job.plan.start_deg
    if start is not None and len(start) == robot.nq:
        scales = np.where(robot.prismatic, 1e-3, np.pi / 180)
        start = tuple(float(value) for value in np.asarray(start) * scales)
    return PostureSettings(
        free_spin=job.plan.rotate_about_tool_axis and getattr(job.process, "frame", "part") != "tool",
        configuration=words,
        start=start,
        preset=table.preset,
        compares="preset" in table.model_fields_set,
        weights=dict(table.weights),
        lead=float(np.radians(table.lead_deg)),
        lean=float(np.radians(table.lean_deg)),
        limit_margin=float(np.radians(table.limit_margin_deg)),
        motion=_read_motion(robot) if errors is None else _leave_to_band(_read_motion(robot)),
        errors=errors,
    )


def _leave_to_band(figures: MotionFigures) -> MotionFigures:
    """Gear error and lost motion are errors of the promise: motion pays for inertia alone."""
    return figures._replace(gear=0.0, lost=0.0, source="gear error and lost motion: in the 95 % band")


def _read_motion(robot: Robot) -> MotionFigures:
    """Take lost motion from the folder's effects where it has any; gear error and the rest are assumed."""
    widths = list_plays(robot)[~robot.prismatic]
    if not widths.any():
        return MotionFigures()
    return MotionFigures(lost=float(widths.max()), source="assumed, lost motion of the robot folder", stated=True)
