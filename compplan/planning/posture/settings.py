"""What the choice of a posture may vary, what it is chosen for, and the choice along one path as a problem."""

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
    """What the search may vary and what it weighs."""

    #: Whether spin, leans and extra axes are chosen too; else they stay, and one configuration is chosen.
    search: bool = True
    free_spin: bool = True  #: Whether the rotation about the tool axis is free.
    #: Words that the configuration has to have, such as {"elbow": "up"}; none: all are free.
    configuration: dict[str, str] = field(default_factory=dict)
    start: Array | None = None  #: Joint positions to start near, or None. Shape (nq,). [rad or m]
    preset: str = "accurate"  #: "accurate", "error_band", "smooth" or "fast".
    #: Whether the preset was asked for by name: finished postures are then measured beside those of others.
    compares: bool = False
    spin_step: float = float(np.radians(5.0))  #: Step of the grid of rotations about the tool axis. [rad]
    lead: float = 0.0  #: How far the tool axis may lean along the travel. [rad]
    lean: float = 0.0  #: How far it may lean across the travel. [rad]
    held_steps: int = 9  #: Grid positions of each extra axis (a rail); of several together at most thrice as many.
    stations: int = 240  #: Waypoints that the graph is built at, at most; those between follow.
    limit_margin: float = float(np.radians(10.0))  #: Distance to a joint limit below which a posture costs. [rad or m]
    #: Distance to a joint limit below which a posture is refused: room for the correction. [rad or m]
    limit_room: float = float(np.radians(2.0))
    #: Greatest motion of a joint between neighbouring waypoints of a cut. [rad or m]
    most_step: float = float(np.radians(20.0))
    #: What the 95 % band knows of the robot, in place of what is assumed; None for other presets.
    errors: PostureErrors | None = None
    #: Axes in whose components the wrench errs, as columns in base axes (the part's). Shape (3, 3).
    axes: Array = field(default_factory=lambda: np.eye(3))
    scene: CollisionScene | None = None  #: What may touch what, or None.
    clearance: float = 0.0  #: Distance from part and fixture that is asked for. [m]

    def keep_plain(self) -> PostureSettings:
        """Return the settings that keep one configuration and the tool's x where the job points it."""
        return replace(self, search=False, free_spin=False, lead=0.0, lean=0.0)

    @property
    def known(self) -> ModelScatter | PostureErrors:
        """What the sensitivity counts."""
        return ASSUMED if self.errors is None else self.errors


@dataclass(frozen=True)
class PostureProblem:
    """The choice of a posture along a path, as every step of the search has it."""

    robot: Robot  #: The robot with its tool.
    nominal: Toolpath  #: Toolpath in the base frame, with its predicted wrench.
    tool_x: Array  #: Where x of the TCP points at spin 0, base axes. Shape (3,).
    settings: PostureSettings  #: What may vary and what it is chosen for.

    @cached_property
    def chain(self) -> Chain:
        """The elastic chain of the robot."""
        return build_chain(self.robot)

    @cached_property
    def arm(self) -> Arm:
        """The arm for inverse kinematics."""
        return build_arm(self.robot)

    def come_too_near(self, q: Array) -> NDArray[np.bool_]:
        """Tell which postures (m, nq) do not keep clear; none where nothing is in the way. Shape (m,)."""
        scene, wanted = self.settings.scene, self.settings.clearance
        return np.zeros(len(q), bool) if scene is None else measure_margin(scene, q, wanted) < 0

    @property
    def wrench(self) -> Array:
        """Predicted wrench, zero where the path carries none. Shape (n, 6). [N, N m]"""
        wrench = self.nominal.wrench
        return np.zeros((len(self.nominal), 6)) if wrench is None else wrench


def read_settings(job: Job, robot: Robot, errors: PostureErrors | None = None) -> PostureSettings:
    """Take the settings from a job's tables, and for the preset "error_band" what is known of the robot.

    A wrench that is given in tool axes would turn with the tool: the rotation then stays where the job has it.

    Raises:
        InputError: If a mesh that the job names is missing or cannot be read.
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
