"""Deflection maps: how far the tool yields all over two planes, under the worst unit force and under a given wrench.

The worst unit force is the first right singular vector of the translational compliance, and the deflection under it the
first singular value [Mamedov2018, eqs. 14 to 16]. A given wrench bends the arm in exact loaded equilibrium. Where elbow
up and elbow down both reach a point, the stiffer posture counts and both are kept.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.errors import ConvergenceError, InputError
from compplan.identification import reduce_model
from compplan.reporting.maps.reach import (
    ELBOWS,
    Plane,
    ReachedPlane,
    make_plane,
    reach_plane,
    stand_of_arm,
    working_limits,
)
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.ik import build_arm, middle_of_limits
from compplan.statics.quality import DexterityMap, map_dexterity, natural_length, quality_of_poses
from compplan.statics.stiffness import worst_unit_force
from compplan.toolpath.toolpath import WRENCH_HEADERS

#: Elbow down counts as stiffer where it is so by this share; where both are the same, elbow up is taken.
TIE = 1e-4
REDUCTION = "400 random poses inside the limits, random forces of 1000 N with moments of 300 N m, 1 rad counts as 1 m"
WRIST_FOR_QUALITY_DEG = 45.0


@dataclass(frozen=True)
class ElbowMap:
    """Deflection over a plane in one elbow configuration, or in the stiffer of both; NaN where it does not reach.

    Attributes:
        q: Joint positions. Shape (b, a, nq). [rad or m]
        worst: Deflection under the worst unit force. Shape (b, a). [m/N]
        force: Direction of that force, base axes. Shape (b, a, 3).
        under_wrench: Deflection under the given wrench, against the arm without it. Shape (b, a). [m]
        reduced_gap: Length of full minus reduced deflection under the full model's worst unit force. Shape (b, a).
            [m/N]
    """

    q: Array
    worst: Array
    force: Array
    under_wrench: Array
    reduced_gap: Array

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Tell which points are reached. Shape (b, a)."""
        return np.isfinite(self.worst)


@dataclass(frozen=True)
class DeflectionMap:
    """Deflection maps of a robot over a plane.

    Attributes:
        plane: The plane.
        posture: How the tool points.
        wrench: Given wrench of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
        elbows: The map of each elbow configuration, by name.
        best: The stiffer configuration at every point.
        chosen: Index of it in `ELBOWS`, -1 where nothing reaches. Shape (b, a).
    """

    plane: Plane
    posture: str
    wrench: Array
    elbows: dict[str, ElbowMap]
    best: ElbowMap
    chosen: NDArray[np.int_]


def map_deflection(robot: Robot, reached: ReachedPlane, wrench: Array, reduced: Robot | None = None) -> DeflectionMap:
    """Map the deflection of a robot over a plane, beside a reduced model of the same robot where one is given.

    wrench: of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
    """
    chain = build_chain(robot)
    other = None if reduced is None else build_chain(reduced)
    up, down = (_map_elbow(chain, other, reached.q[:, :, k], wrench) for k in range(len(ELBOWS)))
    softness = [np.where(up.reached, up.worst, np.inf), np.where(down.reached, down.worst * (1 + TIE), np.inf)]
    chosen = np.where(up.reached | down.reached, np.argmin(softness, axis=0), -1)

    def pick(name: str) -> Array:
        first, second = getattr(up, name), getattr(down, name)
        which = chosen if first.ndim == 2 else chosen[..., None]
        return np.asarray(np.select([which == 0, which == 1], [first, second], np.nan))

    best = ElbowMap(*(pick(field.name) for field in fields(ElbowMap)))
    return DeflectionMap(reached.plane, reached.posture, wrench, {"up": up, "down": down}, best, chosen)


def deflection_under(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute by how much a wrench moves the TCP, in exact equilibrium; NaN beyond buckling. Shape (n,) [m]."""
    try:
        moved = solve_equilibrium(chain, q, wrench).position - solve_equilibrium(chain, q).position
    except ConvergenceError:
        if len(q) == 1:
            return np.full(1, np.nan)
        half = len(q) // 2
        return np.r_[deflection_under(chain, q[:half], wrench), deflection_under(chain, q[half:], wrench)]
    return np.asarray(np.linalg.norm(moved, axis=1))


def _map_elbow(chain: Chain, other: Chain | None, candidates: Array, wrench: Array) -> ElbowMap:
    """Evaluate the candidates (b, a, k, nq) of an elbow and keep the stiffest at every point."""
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
    under, gap = np.full(len(pick), np.nan), np.full(len(pick), np.nan)
    if len(rows):
        under[rows] = deflection_under(chain, q[rows], wrench)
        if other is not None:
            change = cartesian_compliance(chain, q[rows]) - cartesian_compliance(other, q[rows])
            gap[rows] = np.linalg.norm(np.einsum("nij,nj->ni", change[:, :3, :3], direction[rows]), axis=1)
    q = np.where(np.isfinite(size)[:, None], q, np.nan)
    q, direction = q.reshape(*shape, nq), direction.reshape(*shape, 3)
    return ElbowMap(q, size.reshape(shape), direction, under.reshape(shape), gap.reshape(shape))


@dataclass(frozen=True)
class MapSettings:
    """What is mapped.

    Attributes:
        posture: How the tool points: straight, down or outward.
        wrench: Given wrench of the environment on the tool at the TCP, base axes. Shape (6,). [N, N m]
        height: Height of the horizontal plane. [m]
        azimuth: Direction of the vertical plane. [rad]
        points: Grid points along each side.
    """

    posture: str = "down"
    wrench: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1000.0, 0.0, 0.0, 0.0]))
    height: float = 0.5
    azimuth: float = 0.0
    points: int = 100


@dataclass(frozen=True)
class RobotMaps:
    """Maps of a robot.

    Attributes:
        robot: The robot.
        settings: What was mapped.
        planes: Deflection over the horizontal and the vertical plane.
        quality: Inverse condition number at the postures of `planes`, by plane. Shape (b, a).
        dexterity: Inverse condition number over joints two and three of the arm.
        reduced_note: Where the reduced model that was compared with comes from; "" for none.
        reach: Greatest distance from axis 1, lowest and highest TCP. [m]
        seconds: Time that the maps took, pictures apart. [s]
    """

    robot: Robot
    settings: MapSettings
    planes: dict[str, DeflectionMap]
    quality: dict[str, Array]
    dexterity: DexterityMap
    reduced_note: str
    reach: tuple[float, float, float]
    seconds: float

    def summary(self) -> dict[str, Any]:
        """Sum the maps up, units in the keys."""
        reach = zip(("radius_mm", "lowest_mm", "highest_mm"), self.reach, strict=True)
        return {
            "schema": 1, "robot": self.robot.name, "grade": self.robot.grade, "posture": self.settings.posture,
            "wrench": dict(zip(WRENCH_HEADERS, self.settings.wrench.tolist(), strict=True)),
            "poses": int(sum(m.chosen.size for m in self.planes.values())), "map_time_s": round(self.seconds, 3),
            "reach": {name: round(value * 1e3, 1) for name, value in reach},
            "reduced_model": self.reduced_note or None,
            "characteristic_length_mm": round(self.dexterity.length * 1e3, 1),
            "planes": {name: _sum_up(m, self.quality[name]) for name, m in self.planes.items()},
        }  # fmt: skip

    def lines(self) -> list[str]:
        """Say the summary in lines for people."""
        lines = []
        for name, plane in self.summary()["planes"].items():
            worst, under = plane["worst_unit_force_um_per_N"], plane["under_wrench_mm"]
            lines.append(
                f"{name:10s}  worst unit force: mean {worst['mean']:.2f}, max {worst['max']:.2f} um/N;  "
                f"given wrench: mean {under['mean']:.2f}, max {under['max']:.2f} mm;  reached {plane['reached']:.0%}"
            )
        return lines


def map_robot(robot: Robot, settings: MapSettings, reduced: Robot | None = None) -> RobotMaps:
    """Map a robot over a horizontal and a vertical plane; a reduced model to compare with is fitted if left out.

    Raises:
        InputError: If nothing bends in the robot, it has fewer than six joints, or it reaches no place of a plane.
    """
    chain = build_chain(robot)
    if not chain.compliance.any():
        raise InputError(f"robot {robot.name!r} has no elasticity to map; identify it first (compplan identify)")
    reduced, note = _choose_reduced(robot, reduced)
    start = time.perf_counter()
    arm = build_arm(robot)
    radius, lowest, highest = working_limits(arm, settings.posture)
    side, stand = np.linspace(-radius, radius, settings.points), stand_of_arm(arm)
    outward, upward = np.linspace(0, radius, settings.points), np.linspace(lowest, highest, settings.points)
    grids = {
        "horizontal": make_plane("horizontal", stand[0] + side, stand[1] + side, settings.height),
        "vertical": make_plane("vertical", outward, upward, settings.azimuth, stand),
    }
    planes = {
        name: map_deflection(robot, reach_plane(arm, grid, settings.posture), settings.wrench, reduced)
        for name, grid in grids.items()
    }
    for name, plane in planes.items():
        if not (np.isfinite(plane.best.worst) & np.isfinite(plane.best.under_wrench)).any():
            raise InputError(f"robot {robot.name!r} reaches no place of the {name} plane; ask for another one")
    first, second = int(arm.arm[1]), int(arm.arm[2])  # dexterity over the second and third joint of the arm
    q, wrist = middle_of_limits(robot), np.radians(WRIST_FOR_QUALITY_DEG)
    q[second + 1 :] = np.clip(wrist, robot.lower[second + 1 :], robot.upper[second + 1 :])
    lower, upper = np.maximum(robot.lower, -1.5 * np.pi), np.minimum(robot.upper, 1.5 * np.pi)
    sides = [np.linspace(lower[j], upper[j], 90) for j in (first, second)]
    length = natural_length(chain, (robot.lower, robot.upper))
    dexterity = map_dexterity(chain, q, (first, second), sides[0], sides[1], length)
    quality = {}
    for name, plane in planes.items():
        quality[name], reached = np.full(plane.chosen.shape, np.nan), plane.best.reached
        if reached.any():
            quality[name][reached] = quality_of_poses(chain, plane.best.q[reached], length)
    seconds = time.perf_counter() - start
    return RobotMaps(robot, settings, planes, quality, dexterity, note, (radius, lowest, highest), seconds)


def _choose_reduced(robot: Robot, reduced: Robot | None) -> tuple[Robot | None, str]:
    """Return the reduced model to compare with and where it comes from; none where the model is reduced already."""
    if reduced is not None:
        if reduced.joint_names != robot.joint_names:
            raise InputError(f"reduced model has joints {reduced.joint_names}, expected {robot.joint_names}")
        return reduced, f"robot folder {reduced.name}"
    if all(spring.axis == "own" for spring in robot.springs) and not robot.link_elasticities:
        return None, ""
    rng = np.random.default_rng(0)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    q = rng.uniform(lower, upper, (400, robot.nq))
    directions = rng.normal(size=(2, 400, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return reduce_model(robot, q, np.hstack([1000 * directions[0], 300 * directions[1]])).robot, f"fitted: {REDUCTION}"


def _sum_up(plane: DeflectionMap, quality: Array) -> dict[str, Any]:
    best, table = plane.best, {}
    if np.isfinite(best.reduced_gap).any():
        table["full_minus_reduced_um_per_N"] = _statistics(best.reduced_gap * 1e6)
    elbows = {
        name: {
            "reached": round(float(m.reached.mean()), 4),
            "stiffer_at": round(float((plane.chosen == ELBOWS.index(name)).mean()), 4),
            "worst_unit_force_um_per_N": _statistics(m.worst * 1e6),
        }
        for name, m in plane.elbows.items()
    }
    return {
        "reached": round(float(best.reached.mean()), 4), "worst_unit_force_um_per_N": _statistics(best.worst * 1e6),
        "under_wrench_mm": _statistics(best.under_wrench * 1e3), **table, "inverse_condition": _statistics(quality),
        "elbows": elbows,
    }  # fmt: skip


def _statistics(values: Array) -> dict[str, float | None]:
    known = values[np.isfinite(values)]
    if not known.size:
        return {"min": None, "mean": None, "max": None}
    return {key: float(f"{f(known):.5g}") for key, f in (("min", np.min), ("mean", np.mean), ("max", np.max))}
