"""Singh et al. 2021: postures around a point, ranked by dexterity and stiffness (Fanuc M-10iA)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.io.display import Curve, Curves
from compplan.io.palette import CATEGORIES
from compplan.reporting.maps.reach import ON_LIMIT
from compplan.reporting.page import Picture
from compplan.reproduce.paper import (
    Reproduction,
    Row,
    cannot,
    describe_paper,
    draw_figure,
    draw_shares,
    recompute,
    unavailable,
)
from compplan.robot import Array, Robot
from compplan.robot.mounting import mounted_tool
from compplan.statics.chain import build_chain
from compplan.statics.elastic import cartesian_compliance
from compplan.statics.ik import Arm, build_arm, solve_branches

#: Table i: joint stiffness in non-dexterous and dexterous tests [1e6 N m/rad], and the stated improvement [%].
PLAIN = (13.212, 6.490, 6.436, 0.018, 0.039, 0.0300)
DEXTEROUS = (13.980, 6.600, 6.827, 0.0252, 0.0468, 0.0327)
IMPROVEMENT = (6, 2, 6, 40, 20, 9)
#: Largest measured deflections at r1, r3 and r5, non-dexterous and dexterous. [mm]
LARGEST_PLAIN, LARGEST_DEXTEROUS = (1.04, 1.29, 1.39), (0.81, 0.92, 1.00)
RADII, MIDDLE_HEIGHT, STEP = (0.4, 0.6, 0.8, 1.0, 1.2), 0.9, 0.2
TOOL_LENGTH, PEDESTALS = 0.15, (0.0, 0.5)
#: Number of tool directions around a point, and of angles about the tool axis per direction.
DIRECTIONS, ROLLS = 60, 8
LOADS = {"vertical": np.array([0, 0, 500.0, 0, 0, 0]), "lateral": np.array([0, 500.0, 0, 0, 0, 0])}
WRENCH = "the wrench of the torque tool"
SETUP = f"tool of {TOOL_LENGTH:g} m along the flange axis, pedestal of {PEDESTALS[1]:g} m (neither stated)"


@dataclass(frozen=True)
class CloudPoint:
    """A point of the cloud: its radius, and the deflections under each load, to first order. [m]"""

    radius: float
    around: dict[str, Array]  #: Of the stiffest posture of each reached tool direction, by load. Shape (m,).
    down: dict[str, float]  #: With the tool down, by load; empty if not reached.
    q: Array  #: The first of those postures under the lateral load. Shape (6,). [rad]


def reproduce(load: Callable[[str], Robot]) -> Reproduction:
    """Reproduce the paper."""
    bare = load("fanuc_m10ia")
    tool = np.eye(4)
    tool[2, 3] = TOOL_LENGTH
    pose = mounted_tool(bare) @ tool
    robot = replace(bare.with_tool(pose), name="fanuc_m10ia with a tool")
    arm = build_arm(robot)
    reached = {  # points of each radius that are reached with the tool down and the base on a pedestal
        height: [int(np.isfinite(_down(arm, cloud(radius) - [0, 0, height])).all(axis=1).sum()) for radius in RADII]
        for height in PEDESTALS
    }
    points = [examine_point(arm, radius) for radius in RADII]
    rows = [*_rows_of_cloud(reached), *_rows_of_growth(points), *_rows_of_improvement(points, robot), *_rows_of_table()]
    best = np.mean([1 - p.around["lateral"].min() / p.down["lateral"] for p in points if p.down])
    return Reproduction(
        **describe_paper("singh2021"),
        robots=(bare,),
        lede=(
            f"The method works: the best of {DIRECTIONS} tool directions around a point yields {best:.0%} less than "
            "tool down under a lateral force. The paper's own figures hang on a wrench it does not state, and its "
            "joint stiffness that changes with the posture contradicts the constant springs of its method."
        ),
        rows=tuple(rows),
        figures=tuple(_figures(points)),
    )


def cloud(radius: float) -> Array:
    """Compute the 25 points of a radius: five angles of 30 deg, five heights of 200 mm. Shape (25, 3). [m]"""
    angle, height = np.meshgrid(np.arange(-2, 3) * np.pi / 6, MIDDLE_HEIGHT + np.arange(-2, 3) * STEP)
    return np.column_stack([radius * np.cos(angle).ravel(), radius * np.sin(angle).ravel(), height.ravel()])


def examine_point(arm: Arm, radius: float) -> CloudPoint:
    """Rank the tool directions around the middle point of a radius under each load [AbdelMalek2004]."""
    point = np.array([radius, 0.0, MIDDLE_HEIGHT - PEDESTALS[1]])
    q, owner = reach_around(arm, point, np.vstack([spread_directions(DIRECTIONS), [[0.0, 0.0, -1.0]]]))
    compliance, around, least = cartesian_compliance(build_chain(arm.robot), q), {}, {}
    for name, wrench in LOADS.items():
        size = np.linalg.norm((compliance @ wrench)[:, :3], axis=1)
        order = np.lexsort((size, owner))
        least[name] = order[np.unique(owner[order], return_index=True)[1]]
        around[name] = size[least[name]]
    tool_down = _down(arm, point[None])
    down = {}
    if np.isfinite(tool_down).all():
        moved = cartesian_compliance(build_chain(arm.robot), tool_down)[0]
        down = {name: float(np.linalg.norm((moved @ wrench)[:3])) for name, wrench in LOADS.items()}
    return CloudPoint(radius, around, down, q[least["lateral"][0]])


def spread_directions(count: int) -> Array:
    """Compute evenly spread directions on the sphere (Fibonacci lattice). Shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def reach_around(arm: Arm, point: Array, direction: Array) -> tuple[Array, NDArray[np.int_]]:
    """Solve postures that reach a point along directions, (m, 3), and their direction indices. Shape (k, 6). [rad]"""
    rotation = _roll_frames(direction)
    slots = solve_branches(arm, np.tile(point, (len(rotation), 1)), rotation)
    inside = ((slots >= arm.robot.lower - ON_LIMIT) & (slots <= arm.robot.upper + ON_LIMIT)).all(axis=-1)
    rows, branch = np.nonzero(inside)
    return slots[rows, branch], rows // ROLLS


def _roll_frames(direction: Array) -> Array:
    """Build TCP frames that point in each direction, at every roll angle. Shape (m * ROLLS, 3, 3)."""
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = np.cross(helper, direction)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(direction, x)
    angle = np.arange(ROLLS) * 2 * np.pi / ROLLS
    rolled = np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None]
    z = np.broadcast_to(direction[:, None], rolled.shape)
    return np.stack([rolled, np.cross(z, rolled), z], axis=-1).reshape(-1, 3, 3)


def _down(arm: Arm, points: Array) -> Array:
    """Solve postures with the tool down, first reached configuration. Shape (n, 6) [rad], NaN if there is none."""
    turn = np.tile(np.diag([1.0, -1.0, -1.0]), (len(points), 1, 1))
    slots = solve_branches(arm, points, turn)
    inside = np.asarray(((slots >= arm.robot.lower) & (slots <= arm.robot.upper)).all(axis=-1))
    q = slots[np.arange(len(points)), inside.argmax(axis=1)]
    return np.where(inside.any(axis=1, keepdims=True), q, np.nan)


def _rows_of_cloud(reached: dict[float, list[int]]) -> list[Row]:
    rows = []
    for height, counts in reached.items():
        said = ", ".join(f"r = {radius:g} m: {count}" for radius, count in zip(RADII, counts, strict=True))
        verdict = "fitted" if height and sum(counts) == 125 else cannot("the height of the pedestal")
        note = f"tool of {TOOL_LENGTH:g} m" + ("; pedestal chosen so that the cloud is reached" if height else "")
        title = f"125 points reached tool down, base {height:g} m above the ground"
        rows.append(Row(title, "25 at every radius", said, "", None, verdict, note))
    return rows


def _rows_of_growth(points: list[CloudPoint]) -> list[Row]:
    rows = []
    for k in (2, 4):
        stated = LARGEST_PLAIN[k // 2] / LARGEST_PLAIN[0]
        ours = [
            f"{name} force {points[k].down[name] / points[0].down[name]:.2f}"
            for name in LOADS
            if name in points[k].down and name in points[0].down
        ]
        title = f"Growth of the largest deflection from r1 to r{k + 1}"
        rows.append(Row(title, round(stated, 3), ", ".join(ours), "", None, cannot(WRENCH), f"{SETUP}; tool down"))
    return rows


def _rows_of_improvement(points: list[CloudPoint], robot: Robot) -> list[Row]:
    rows = []
    note = f"{SETUP}; {DIRECTIONS} directions around the middle point of each radius, constant springs"
    for name in LOADS:
        known = [p for p in points if p.down]
        best = np.mean([1 - p.around[name].min() / p.down[name] for p in known])
        middle = np.mean([1 - np.median(p.around[name]) / p.down[name] for p in known])
        title = f"Average improvement of a posture against tool down, {name} force"
        ours, why = f"best {100 * best:.0f}, median {100 * middle:.0f}", cannot(f"the set of postures and {WRENCH}")
        rows.append(Row(title, 46.0, ours, "%", None, why, note))
    ratios = ", ".join(f"{1 - b / a:.0%}" for a, b in zip(LARGEST_PLAIN, LARGEST_DEXTEROUS, strict=True))
    title = "Improvement of the largest deflections at r1, r3, r5"
    own = "the paper's own largest deflections"
    rows.append(Row(title, "46 % on average", ratios, "", None, "inconsistent in the paper", own))
    factors = zip(robot.springs, PLAIN, DEXTEROUS, strict=True)
    stiffer = replace(robot, springs=tuple(replace(s, compliance=s.compliance * a / b) for s, a, b in factors))
    q = np.array([p.q for p in points])
    sizes = [
        np.linalg.norm((cartesian_compliance(build_chain(r), q) @ LOADS["lateral"])[:, :3], axis=1)
        for r in (robot, stiffer)
    ]
    gain = 1 - sizes[1] / sizes[0]
    title = "Improvement that the dexterous stiffness set of Table i alone makes"
    ours = f"{gain.min():.0%} to {gain.max():.0%}"
    same = f"{SETUP}; the same postures, lateral force"
    rows.append(Row(title, "46 % on average", ours, "", None, cannot(WRENCH), same))
    return rows


def _rows_of_table() -> list[Row]:
    note = "both stiffness columns are the paper's; rounded to whole per cent as there"
    rows = [
        recompute(f"Table i: improvement of joint {j + 1}", float(IMPROVEMENT[j]), round(100 * (b / a - 1)), "%", note)
        for j, (a, b) in enumerate(zip(PLAIN, DEXTEROUS, strict=True))
    ]
    rows.append(unavailable("Largest deflections at r1, r3, r5", "1.04, 1.29, 1.39 mm", WRENCH))
    rows.append(
        unavailable("Share of links 2, 3 and 4 in the deflection", "9, 0.9 and 11 %", "the section of the links")
    )
    return rows


def _figures(points: list[CloudPoint]) -> list[Picture]:
    radius, lines = np.array([p.radius for p in points]), list[Curve]()
    for number, name in enumerate(LOADS):
        best = np.array([float(p.around[name].min()) for p in points]) * 1e3
        down = np.array([p.down.get(name, np.nan) for p in points]) * 1e3
        dashed = number + len(CATEGORIES)
        lines.append(Curve(f"tool down, 500 N {name}", radius, down, dashed, "lines+markers"))
        lines.append(Curve(f"best direction, 500 N {name}", radius, best, number, "lines+markers"))
    ranges = {f"r = {p.radius:g} m": p.around["lateral"] * 1e3 for p in points}
    return [
        draw_figure("Deflection over the radius", Curves("", "radius [m]", "deflection [mm]", tuple(lines)),
                    "Middle points of the cloud; constant springs of Table i, non-dexterous column."),
        draw_shares("Spread around a point, 500 N lateral",
                    "One posture a direction, the least yielding branch and roll. The choice of direction decides.",
                    "deflection [mm]", "directions", ranges),
    ]  # fmt: skip
