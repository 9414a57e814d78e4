"""Settings of the posture search, and the posture problem along one path."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from compplan.planning.posture.clearance import measure_margin
from compplan.planning.posture.collision_scene import CollisionScene, read_scene
from compplan.planning.posture.costs import ASSUMED, ModelScatter
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.ik import Arm, build_arm
from compplan.toolpath.toolpath import Toolpath
from compplan.uncertainty.posture_errors import PostureErrors

if TYPE_CHECKING:
    from compplan.job.job import Job


@dataclass(frozen=True, eq=False)
class PostureSettings:
    """Degrees of freedom and criteria of the posture search."""

    #: Whether spin, tilts and extra axes are chosen too; otherwise they are fixed, and one configuration is chosen.
    search: bool = True
    free_spin: bool = True  #: Whether the rotation about the tool axis is free.
    #: Required parts of the configuration, such as {"elbow": "up"}; empty: all are free.
    configuration: dict[str, str] = field(default_factory=dict)
    start: Array | None = None  #: Joint positions to start near, or None. Shape (nq,). [rad or m]
    preset: str = "accurate"  #: "accurate", "error_band", "smooth" or "fast".
    #: Whether the job names the preset: finished postures are then compared with those of other presets.
    compares: bool = False
    spin_step: float = float(np.radians(5.0))  #: Step of the spin grid. [rad]
    lead: float = 0.0  #: Greatest tilt of the tool axis along the path. [rad]
    lean: float = 0.0  #: Greatest tilt of the tool axis across the path. [rad]
    held_steps: int = 9  #: Grid positions of one extra axis (a rail); of several together at most 3 times as many.
    stations: int = 240  #: Greatest number of stations of the graph; other waypoints are interpolated.
    limit_margin: float = float(np.radians(10.0))  #: Distance from a joint limit below which it costs. [rad or m]
    #: Distance from a joint limit below which a posture is excluded: room for the correction. [rad or m]
    limit_room: float = float(np.radians(2.0))
    #: Greatest motion of a joint between neighbouring waypoints of a cut. [rad or m]
    most_step: float = float(np.radians(20.0))
    #: Parameter errors of the robot as in the 95 % band; None: assumed uncertainty (other presets).
    errors: PostureErrors | None = None
    #: Axes of the wrench errors (part axes) as columns, base axes. Shape (3, 3).
    axes: Array = field(default_factory=lambda: np.eye(3))
    scene: CollisionScene | None = None  #: Solids for the clearance, or None.
    clearance: float = 0.0  #: Required distance from part and fixture. [m]

    def keep_plain(self) -> PostureSettings:
        """Return the settings with one configuration and the tool orientation of the job."""
        return replace(self, search=False, free_spin=False, lead=0.0, lean=0.0)

    @property
    def known(self) -> ModelScatter | PostureErrors:
        """Uncertainty behind the sensitivity."""
        return ASSUMED if self.errors is None else self.errors


@dataclass(frozen=True)
class PostureProblem:
    """Posture search along a path."""

    robot: Robot  #: Robot with its tool.
    nominal: Toolpath  #: Toolpath in the base frame, with its predicted wrench.
    tool_x: Array  #: Direction of x of the TCP at spin 0, base axes. Shape (3,).
    settings: PostureSettings  #: Degrees of freedom and criteria.

    @cached_property
    def chain(self) -> Chain:
        """Elastic chain of the robot."""
        return build_chain(self.robot)

    @cached_property
    def arm(self) -> Arm:
        """Arm for inverse kinematics."""
        return build_arm(self.robot)

    def violates_clearance(self, q: Array) -> NDArray[np.bool_]:
        """Return which postures (m, nq) violate the clearance; none without a collision scene. Shape (m,)."""
        scene, wanted = self.settings.scene, self.settings.clearance
        return np.zeros(len(q), bool) if scene is None else measure_margin(scene, q, wanted) < 0

    @property
    def wrench(self) -> Array:
        """Predicted wrench, zero where the path carries none. Shape (n, 6). [N, N m]"""
        wrench = self.nominal.wrench
        return np.zeros((len(self.nominal), 6)) if wrench is None else wrench


def read_settings(job: Job, robot: Robot, errors: PostureErrors | None = None) -> PostureSettings:
    """Read the settings from the sections of a job; `errors`: parameter errors for the preset "error_band".

    With a wrench in tool axes, which would rotate with the tool, the spin is that of the job.

    Raises:
        InputError: If a mesh of the job is missing or cannot be read.
    """
    words = job.plan.configuration.model_dump(exclude_none=True)
    start = None if job.plan.start_deg is None else np.asarray(job.plan.start_deg, float)
    if start is not None and len(start) == robot.nq:
        start = np.where(robot.prismatic, start * 1e-3, np.radians(start))
    table = job.posture
    return PostureSettings(
        free_spin=job.plan.rotate_about_tool_axis and getattr(job.process, "frame", "part") != "tool",
        configuration=words,
        start=start,
        preset=table.preset,
        compares="preset" in table.model_fields_set,
        lead=float(np.radians(table.lead_deg)),
        lean=float(np.radians(table.lean_deg)),
        limit_margin=float(np.radians(table.limit_margin_deg)),
        errors=errors,
        axes=job.T_base_part[:3, :3],
        scene=read_scene(job, robot),
        clearance=0.0 if job.collision is None else job.collision.clearance_mm * 1e-3,
    )
