"""Deflection maps of the tool over two planes, under the worst unit force and under a given wrench.

The worst unit force is the first right singular vector of the translational compliance, and the deflection under it the
first singular value [Mamedov2018, eqs. 14 to 16]. The deflection under a given wrench is that of the exact loaded
equilibrium. If several postures reach a point, the stiffest is used.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError, InputError
from compplan.reporting.maps.reach import Plane, make_plane, reach_plane, stand_of_arm, working_limits
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.ik import Arm, build_arm
from compplan.statics.quality import natural_length, quality_of_poses
from compplan.statics.stiffness import worst_unit_force
from compplan.toolpath.toolpath import WRENCH_HEADERS


@dataclass(frozen=True)
class DeflectionMap:
    """Deflection of a robot over a plane, in the stiffest posture at each point; NaN where the robot does not reach."""

    plane: Plane  #: The plane.
    wrench: Array  #: Given wrench of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
    q: Array  #: Joint positions. Shape (b, a, nq). [rad or m]
    worst: Array  #: Deflection under the worst unit force. Shape (b, a). [m/N]
    force: Array  #: Direction of that force, base axes. Shape (b, a, 3).
    under_wrench: Array  #: Deflection under the given wrench, relative to the arm without it. Shape (b, a). [m]

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Reached points. Shape (b, a)."""
        return np.isfinite(self.worst)


def map_deflection(robot: Robot, plane: Plane, candidates: Array, wrench: Array) -> DeflectionMap:
    """Compute the deflection of a robot over a plane.

    candidates: joint positions of `reach_plane`; wrench: of the environment on the tool at the TCP, base axes. Shape
    (6,). [N, N m]
    """
    chain = build_chain(robot)
    shape, nq = candidates.shape[:2], candidates.shape[-1]
    flat = candidates.reshape(-1, nq)
    valid = np.flatnonzero(np.isfinite(flat).all(axis=1))
    size, direction = np.full(len(flat), np.nan), np.full((len(flat), 3), np.nan)
    if len(valid):
        size[valid], direction[valid] = worst_unit_force(cartesian_compliance(chain, flat[valid]))
    cost = np.where(np.isfinite(size), size, np.inf).reshape(-1, candidates.shape[2])
    pick = np.arange(len(cost)) * candidates.shape[2] + cost.argmin(axis=1)
    size, direction, q = size[pick], direction[pick], flat[pick]
    rows = np.flatnonzero(np.isfinite(size))
    under = np.full(len(pick), np.nan)
    if len(rows):
        under[rows] = deflection_under(chain, q[rows], wrench)
    q = np.where(np.isfinite(size)[:, None], q, np.nan)
    return DeflectionMap(
        plane, wrench, q.reshape(*shape, nq), size.reshape(shape), direction.reshape(*shape, 3), under.reshape(shape),
    )  # fmt: skip


def deflection_under(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute the displacement of the TCP by a wrench, in exact equilibrium; NaN beyond buckling. Shape (n,) [m]."""
    try:
        moved = solve_equilibrium(chain, q, wrench).position - solve_equilibrium(chain, q).position
    except ConvergenceError:
        if len(q) == 1:
            return np.full(1, np.nan)
        half = len(q) // 2
        return np.r_[deflection_under(chain, q[:half], wrench), deflection_under(chain, q[half:], wrench)]
    return np.asarray(np.linalg.norm(moved, axis=1))


@dataclass(frozen=True)
class MapSettings:
    """Settings of the maps of a robot."""

    posture: str = "down"  #: Tool direction: straight, down or outward.
    #: Given wrench of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
    wrench: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1000.0, 0.0, 0.0, 0.0]))
    height: float = 0.5  #: Height of the horizontal plane. [m]
    azimuth: float = 0.0  #: Direction of the vertical plane. [rad]
    points: int = 100  #: Grid points along each side.


@dataclass(frozen=True)
class RobotMaps:
    """Maps of a robot."""

    robot: Robot  #: The robot.
    settings: MapSettings  #: Settings of the maps.
    planes: dict[str, DeflectionMap]  #: Deflection over the horizontal and the vertical plane.
    quality: dict[str, Array]  #: Inverse condition number at the postures of `planes`, by plane. Shape (b, a).
    length: float  #: Characteristic length of the dexterity. [m]
    reach: tuple[float, float, float]  #: Greatest distance from axis 1, lowest and highest TCP. [m]
    seconds: float  #: Computation time without pictures. [s]

    def summary(self) -> dict[str, Any]:
        """Summarise the maps, with units in the keys."""
        reach = zip(("radius_mm", "lowest_mm", "highest_mm"), self.reach, strict=True)
        return {
            "schema": 1, "robot": self.robot.name, "grade": self.robot.grade, "posture": self.settings.posture,
            "wrench": dict(zip(WRENCH_HEADERS, self.settings.wrench.tolist(), strict=True)),
            "poses": int(sum(plane.worst.size for plane in self.planes.values())), "map_time_s": round(self.seconds, 3),
            "reach": {name: round(value * 1e3, 1) for name, value in reach},
            "characteristic_length_mm": round(self.length * 1e3, 1),
            "planes": {name: _sum_up(m, self.quality[name]) for name, m in self.planes.items()},
        }  # fmt: skip


def map_planes(arm: Arm, settings: MapSettings) -> tuple[dict[str, DeflectionMap], tuple[float, float, float]]:
    """Compute the deflection of a robot over a horizontal and a vertical plane; also return `working_limits`."""
    radius, lowest, highest = working_limits(arm, settings.posture)
    side, stand = np.linspace(-radius, radius, settings.points), stand_of_arm(arm)
    outward, upward = np.linspace(0, radius, settings.points), np.linspace(lowest, highest, settings.points)
    grids = (
        make_plane("horizontal", stand[0] + side, stand[1] + side, settings.height),
        make_plane("vertical", outward, upward, settings.azimuth, stand),
    )
    planes = {
        grid.name: map_deflection(arm.robot, grid, reach_plane(arm, grid, settings.posture), settings.wrench)
        for grid in grids
    }
    return planes, (radius, lowest, highest)


def map_robot(robot: Robot, settings: MapSettings) -> RobotMaps:
    """Compute maps of stiffness and dexterity over a horizontal (`height`) and a vertical plane (`azimuth`).

    Raises:
        InputError: If the robot has no elasticity or fewer than six joints, or reaches no point of a plane.
    """
    chain = build_chain(robot)
    if not chain.compliance.any():
        raise InputError(f"robot {robot.name!r} has no elasticity to map; identify it first (compplan identify)")
    start = time.perf_counter()
    planes, reach = map_planes(build_arm(robot), settings)
    for name, plane in planes.items():
        if not (plane.reached & np.isfinite(plane.under_wrench)).any():
            raise InputError(
                f"robot {robot.name!r} reaches no point of the {name} plane; give another height or direction"
            )
    length = natural_length(chain, (robot.lower, robot.upper))
    quality = {}
    for name, plane in planes.items():
        quality[name], reached = np.full(plane.worst.shape, np.nan), plane.reached
        if reached.any():
            quality[name][reached] = quality_of_poses(chain, plane.q[reached], length)
    seconds = time.perf_counter() - start
    return RobotMaps(robot, settings, planes, quality, length, reach, seconds)


def _sum_up(plane: DeflectionMap, quality: Array) -> dict[str, Any]:
    return {
        "reached": round(float(plane.reached.mean()), 4), "worst_unit_force_um_per_N": _statistics(plane.worst * 1e6),
        "under_wrench_mm": _statistics(plane.under_wrench * 1e3), "inverse_condition": _statistics(quality),
    }  # fmt: skip


def _statistics(values: Array) -> dict[str, float | None]:
    known = values[np.isfinite(values)]
    if not known.size:
        return {"min": None, "mean": None, "max": None}
    return {key: float(f"{f(known):.5g}") for key, f in (("min", np.min), ("mean", np.mean), ("max", np.max))}
