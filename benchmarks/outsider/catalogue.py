"""The fourteen nominal robots: dimensions after data sheets, from memory; masses and compliances assumed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from benchmarks.outsider.robots import BASE, MOUNT, TIP, Element, Robot, SizeClass, Spring, Vector
from benchmarks.outsider.turns import AXES, DEGREE

DIRECTIONS = {**AXES, **{f"-{name}": 0.0 - axis for name, axis in AXES.items()}}
POINTING: Mapping[str, Vector] = {
    "up": (0, 0, 0),
    "down": (0, np.pi, 0),
    "ahead": (0, np.pi / 2, 0),
    "left": (-np.pi / 2, 0, 0),
}


class Axis(NamedTuple):
    """A driven joint: origin [m], axis, range and speed [deg or m], effort [N m or N], mass [kg] and its centre [m]."""

    xyz: Vector
    axis: str
    limits: tuple[float, float]
    speed: float
    effort: float
    mass: float
    com: Vector
    kind: str = "revolute"


class Tool(NamedTuple):
    """The tool: where it is mounted [m], mass [kg], centre [m], tip [m], and where the tip's z axis points."""

    mount: Vector
    mass: float
    com: Vector
    tip: Vector
    pointing: str


class Plate(NamedTuple):
    """A plate of a parallelogram: it turns back by the angle of the joint `of`."""

    name: str
    link: str
    xyz: Vector
    mass: float
    com: Vector
    of: str


def build_robot(
    name: str,
    size: SizeClass,
    base_kg: float,
    axes: tuple[Axis, ...],
    tool: Tool,
    compliances: tuple[float, ...],
    extra: tuple[tuple[str, str, float], ...] = (),
    rail: bool = False,
    plates: Mapping[int, Plate] | None = None,
) -> Robot:
    """Chain a robot's elements from base to tip.

    Args:
        name: Name of the robot.
        size: Its class of size.
        base_kg: Mass of the base.
        axes: Driven joints.
        tool: The tool.
        compliances: Compliance of each joint about its own axis, 0 for none. [rad/(N m)]
        extra: Springs across: joint, axis, compliance.
        rail: Whether the first joint is a rail.
        plates: Plates of a parallelogram, by the column of the joint behind them.
    """
    chain = [Element(BASE, "fixed", "world", "base_link", np.zeros(3), mass=base_kg, com=np.array([0, 0, 0.1]))]
    for k, axis in enumerate(axes):
        if plates and k in plates:
            chain.append(_plate(plates[k], chain[-1].child))
        chain.append(_driven(k, axis, chain[-1].child))
    mount, com = np.array(tool.mount, float), np.array(tool.com, float)
    chain.append(Element(MOUNT, "fixed", chain[-1].child, "tool", mount, mass=tool.mass, com=com))
    chain.append(Element(TIP, "fixed", "tool", "tool0", np.array(tool.tip, float), rpy=POINTING[tool.pointing]))
    springs = [Spring(f"joint_{k + 1}", "own", c) for k, c in enumerate(compliances) if c]
    springs += [Spring(*spring) for spring in extra]
    return Robot(name, size, tuple(chain), tuple(springs), rail)


def _driven(column: int, axis: Axis, parent: str) -> Element:
    scale = DEGREE if axis.kind == "revolute" else 1.0
    return Element(
        f"joint_{column + 1}",
        axis.kind,
        parent,
        f"link_{column + 1}",
        np.array(axis.xyz, float),
        DIRECTIONS[axis.axis],
        axis.limits[0] * scale,
        axis.limits[1] * scale,
        axis.speed * scale,
        axis.effort,
        axis.mass,
        np.array(axis.com, float),
        column=column,
    )


def _plate(plate: Plate, parent: str) -> Element:
    return Element(
        plate.name,
        "revolute",
        parent,
        plate.link,
        np.array(plate.xyz, float),
        AXES["y"],
        -3.2,
        3.2,
        3,
        9000,
        plate.mass,
        np.array(plate.com, float),
        mimic=(plate.of, -1.0),
    )


CATALOGUE = (
    build_robot(
        "ur10e_like",
        "cobot",
        4,
        (
            Axis((0, 0, 0.1807), "z", (-360, 360), 120, 330, 7.4, (0.02, 0, 0.01)),
            Axis((0, 0.1756, 0), "y", (-360, 360), 120, 330, 13.05, (0.24, 0.01, 0)),
            Axis((0.6127, -0.1375, 0), "y", (-360, 360), 180, 150, 4, (0.25, 0, 0.01)),
            Axis((0.5716, 0, 0), "y", (-360, 360), 180, 56, 2.1, (0, 0.1, 0)),
            Axis((0, 0.1361, 0), "-z", (-360, 360), 180, 56, 1.98, (0, 0, -0.08)),
            Axis((0, 0, -0.11985), "y", (-360, 360), 180, 56, 0.6, (0, 0.08, 0)),
        ),
        Tool((0, 0.1166, 0), 1.3, (0.02, 0.05, 0), (0.05, 0.11, 0.03), "left"),
        (3.2e-05, 3.6e-05, 4.4e-05, 0.00013, 0.00014, 0.00018),
        extra=(("joint_1", "rx", 1.5e-06),),
    ),
    build_robot(
        "ur5e_like",
        "cobot",
        4,
        (
            Axis((0, 0, 0.1625), "z", (-360, 360), 180, 150, 3.76, (0, -0.01, -0.02)),
            Axis((0, 0.138, 0), "y", (-360, 360), 180, 150, 8.06, (0.2, 0, 0)),
            Axis((0.425, -0.131, 0), "y", (-360, 360), 180, 150, 2.85, (0.17, 0, 0.01)),
            Axis((0.3922, 0, 0), "y", (-360, 360), 180, 28, 1.37, (0, 0.09, 0)),
            Axis((0, 0.127, 0), "-z", (-360, 360), 180, 28, 1.3, (0, 0, -0.07)),
            Axis((0, 0, -0.0997), "y", (-360, 360), 180, 28, 0.37, (0, 0.07, 0)),
        ),
        Tool((0, 0.0996, 0), 0.9, (0.01, 0.04, 0.01), (-0.03, 0.1, 0.06), "left"),
        (5e-05, 5.5e-05, 7e-05, 0.00022, 0.00022, 0.00026),
    ),
    build_robot(
        "crx10_like",
        "cobot",
        12,
        (
            Axis((0, 0, 0.245), "z", (-190, 190), 120, 200, 11, (0, 0.02, 0)),
            Axis((0, 0, 0), "y", (-180, 180), 120, 200, 12, (0, 0.12, 0.25)),
            Axis((0, 0, 0.54), "y", (-270, 270), 180, 120, 5, (0.1, 0.03, 0)),
            Axis((0.15, 0, 0), "x", (-190, 190), 180, 40, 4, (0.25, 0, 0.01)),
            Axis((0.39, 0, 0), "y", (-180, 180), 180, 40, 2.5, (0, -0.06, 0)),
            Axis((0, -0.15, 0), "x", (-190, 190), 180, 30, 1, (0.08, 0, 0)),
        ),
        Tool((0.16, 0, 0), 1.1, (0.05, 0, 0.01), (0.1, 0.04, 0.02), "ahead"),
        (3e-05, 3e-05, 4.5e-05, 0.00012, 0.00015, 0.0002),
    ),
    build_robot(
        "iiwa14_like",
        "cobot",
        6,
        (
            Axis((0, 0, 0.1575), "z", (-170, 170), 85, 320, 6.4, (0, -0.03, 0.12)),
            Axis((0, 0, 0.2025), "y", (-120, 120), 85, 320, 7.9, (0, 0.04, 0.06)),
            Axis((0, 0, 0.2045), "z", (-170, 170), 100, 176, 4.1, (0, 0.03, 0.13)),
            Axis((0, 0, 0.2155), "-y", (-120, 120), 75, 176, 4, (0, 0.05, 0.07)),
            Axis((0, 0, 0.1845), "z", (-170, 170), 130, 110, 2.2, (0, -0.02, 0.1)),
            Axis((0, 0, 0.2155), "y", (-120, 120), 135, 40, 2.4, (0, 0, 0.01)),
            Axis((0, 0, 0.081), "z", (-175, 175), 135, 40, 0.6, (0, 0, 0.02)),
        ),
        Tool((0, 0, 0.045), 1.2, (0.01, 0, 0.04), (0.05, 0.02, 0.1), "up"),
        (6e-05, 5e-05, 8e-05, 8e-05, 0.00012, 0.00018, 0.0002),
        extra=(("joint_2", "rz", 4e-06),),
    ),
    build_robot(
        "panda_like",
        "cobot",
        3,
        (
            Axis((0, 0, 0.333), "z", (-165, 165), 150, 87, 3.5, (0, -0.02, -0.1)),
            Axis((0, 0, 0), "y", (-100, 100), 150, 87, 3.3, (0, 0.03, 0.1)),
            Axis((0, 0, 0.316), "z", (-165, 165), 150, 87, 3.2, (0.04, 0.02, -0.05)),
            Axis((0.0825, 0, 0), "-y", (-175, -4), 150, 87, 3.3, (-0.04, 0.03, 0.08)),
            Axis((-0.0825, 0, 0.384), "z", (-165, 165), 180, 12, 1.9, (0, 0.04, -0.1)),
            Axis((0, 0, 0), "-y", (-1, 215), 180, 12, 1.5, (0.05, 0, 0)),
            Axis((0.088, 0, 0), "-z", (-165, 165), 180, 12, 0.8, (0, 0, -0.08)),
        ),
        Tool((0, 0, -0.107), 0.7, (0, 0.01, -0.04), (0.03, 0.02, -0.1), "down"),
        (9e-05, 9e-05, 0.00011, 0.00011, 0.00026, 0.00026, 0.0003),
    ),
    build_robot(
        "irb1200_like",
        "small",
        18,
        (
            Axis((0, 0, 0.2), "z", (-170, 170), 288, 120, 14, (0.01, 0, 0.1)),
            Axis((0, 0, 0.199), "y", (-100, 130), 240, 120, 11, (0, -0.03, 0.18)),
            Axis((0, 0, 0.35), "y", (-200, 70), 300, 70, 8, (0.04, 0.02, 0.02)),
            Axis((0.1, 0, 0.042), "x", (-270, 270), 400, 20, 3.5, (0.14, 0, 0)),
            Axis((0.251, 0, 0), "y", (-125, 125), 405, 18, 1.3, (0.01, 0, 0)),
            Axis((0, 0, 0), "x", (-360, 360), 600, 12, 0.3, (0.06, 0, 0)),
        ),
        Tool((0.082, 0, 0), 1.6, (0.05, 0.01, 0.01), (0.12, -0.02, 0.05), "ahead"),
        (8e-06, 7e-06, 1.1e-05, 6e-05, 7e-05, 0.00011),
    ),
    build_robot(
        "tx2_90_like",
        "small",
        40,
        (
            Axis((0, 0, 0.478), "z", (-180, 180), 400, 318, 30, (0.02, 0.05, 0)),
            Axis((0.05, 0, 0), "y", (-130, 147), 400, 166, 24, (0, 0.13, 0.2)),
            Axis((0, 0.05, 0.425), "y", (-145, 145), 430, 76, 14, (0, -0.02, 0.08)),
            Axis((0, 0, 0.2), "z", (-270, 270), 540, 34, 7, (0, 0, 0.12)),
            Axis((0, 0, 0.225), "y", (-115, 140), 475, 29, 2, (0, 0, 0.02)),
            Axis((0, 0, 0.1), "z", (-270, 270), 760, 11, 0.4, (0, 0, 0.01)),
        ),
        Tool((0, 0, 0.01), 2.4, (0.02, 0, 0.06), (0.06, -0.03, 0.14), "up"),
        (5e-06, 5e-06, 8e-06, 4e-05, 7e-05, 9e-05),
        extra=(("joint_2", "rx", 6e-07),),
    ),
    build_robot(
        "gp25_like",
        "mid",
        60,
        (
            Axis((0, 0, 0.505), "z", (-180, 180), 210, 900, 70, (0.05, 0, -0.05)),
            Axis((0.15, 0, 0), "y", (-105, 155), 210, 900, 42, (0.01, -0.1, 0.33)),
            Axis((0, 0, 0.76), "y", (-160, 86), 265, 500, 40, (0.05, 0.02, 0.12)),
            Axis((0.2, 0, 0.2), "x", (-200, 200), 420, 120, 20, (0.3, 0, 0)),
            Axis((0.595, 0, 0), "y", (-150, 150), 420, 100, 4, (0.02, 0, 0)),
            Axis((0, 0, 0), "x", (-455, 455), 885, 60, 1, (0.08, 0, 0)),
        ),
        Tool((0.1, 0, 0), 7, (0.06, 0.02, 0), (0.16, 0.04, 0.08), "ahead"),
        (1.6e-06, 1.3e-06, 1.9e-06, 1.1e-05, 1.3e-05, 2.2e-05),
    ),
    build_robot(
        "kr16_like",
        "mid",
        70,
        (
            Axis((0, 0, 0.675), "z", (-185, 185), 156, 1200, 90, (0.08, 0, -0.1)),
            Axis((0.26, 0, 0), "y", (-65, 125), 156, 1200, 38, (0.02, -0.12, 0.3)),
            Axis((0, 0, 0.68), "y", (-210, 64), 156, 600, 42, (0.03, 0.03, 0.04)),
            Axis((0.3, 0, 0.035), "x", (-350, 350), 330, 100, 22, (0.2, 0, 0)),
            Axis((0.37, 0, 0), "y", (-130, 130), 330, 90, 5, (0.02, 0, 0)),
            Axis((0, 0, 0), "x", (-350, 350), 615, 50, 1, (0.1, 0, 0)),
        ),
        Tool((0.158, 0, 0), 8, (0.06, 0, 0.03), (0.15, 0.05, 0.06), "ahead"),
        (1.4e-06, 1.2e-06, 2e-06, 1.2e-05, 1.4e-05, 2e-05),
        extra=(("joint_1", "ry", 1e-07),),
    ),
    build_robot(
        "irb6700_like",
        "heavy",
        350,
        (
            Axis((0, 0, 0.78), "z", (-170, 170), 100, 9000, 380, (0.15, 0, -0.1)),
            Axis((0.32, 0, 0), "y", (-65, 85), 90, 12000, 190, (0.02, -0.15, 0.45)),
            Axis((0, 0, 1.125), "y", (-180, 70), 90, 7000, 210, (0.1, 0.05, 0.1)),
            Axis((0.3, 0, 0.2), "x", (-300, 300), 170, 1900, 90, (0.4, 0, 0)),
            Axis((0.8425, 0, 0), "y", (-130, 130), 120, 1600, 35, (0.04, 0, 0)),
            Axis((0, 0, 0), "x", (-360, 360), 190, 900, 8, (0.15, 0, 0)),
        ),
        Tool((0.2, 0, 0), 45, (0.12, 0.03, 0.02), (0.3, 0.08, 0.15), "ahead"),
        (2.6e-07, 1.9e-07, 2.8e-07, 1.7e-06, 2e-06, 2.6e-06),
        extra=(
            ("base_fixed", "ry", 6e-09),
            ("joint_2", "rx", 1.5e-08),
        ),
    ),
    build_robot(
        "m900_like",
        "heavy",
        500,
        (
            Axis((0, 0, 0.94), "z", (-180, 180), 110, 14000, 520, (0.2, 0, -0.1)),
            Axis((0.41, 0, 0), "y", (-75, 76), 105, 18000, 300, (0.02, -0.2, 0.5)),
            Axis((0, 0, 1.12), "y", (-160, 80), 100, 11000, 320, (0.1, 0.06, 0.12)),
            Axis((0.4, 0, 0.25), "x", (-360, 360), 110, 3000, 140, (0.5, 0, 0)),
            Axis((0.85, 0, 0), "y", (-122, 122), 110, 2500, 60, (0.05, 0, 0)),
            Axis((0, 0, 0), "x", (-360, 360), 180, 1400, 15, (0.2, 0, 0)),
        ),
        Tool((0.26, 0, 0), 90, (0.15, 0, 0.05), (0.35, -0.1, 0.2), "ahead"),
        (1.6e-07, 1.2e-07, 1.7e-07, 9e-07, 1.1e-06, 1.5e-06),
    ),
    build_robot(
        "kr60_rail_like",
        "mid",
        400,
        (
            Axis((0, 0, 0.35), "x", (-0.2, 4.3), 1.5, 8000, 300, (0, 0, -0.1), "prismatic"),
            Axis((0, 0, 0.815), "z", (-185, 185), 128, 3500, 220, (0.1, 0, -0.2)),
            Axis((0.35, 0, 0), "y", (-45, 125), 102, 3500, 100, (0.02, -0.15, 0.4)),
            Axis((0, 0, 0.85), "y", (-210, 68), 128, 2000, 110, (0.05, 0.04, 0.05)),
            Axis((0.35, 0, 0.145), "x", (-350, 350), 260, 350, 50, (0.25, 0, 0)),
            Axis((0.47, 0, 0), "y", (-119, 119), 245, 300, 12, (0.03, 0, 0)),
            Axis((0, 0, 0), "x", (-350, 350), 322, 160, 2, (0.12, 0, 0)),
        ),
        Tool((0.17, 0, 0), 18, (0.08, 0.02, 0.02), (0.2, 0.06, 0.1), "ahead"),
        (0, 6e-07, 4.5e-07, 6e-07, 4.5e-06, 5e-06, 7e-06),
        extra=(("joint_1", "ry", 2.5e-08),),
        rail=True,
    ),
    build_robot(
        "scara600_like",
        "scara",
        12,
        (
            Axis((0, 0, 0.18), "z", (-140, 140), 430, 90, 7, (0.16, 0, 0)),
            Axis((0.325, 0, 0.03), "z", (-150, 150), 700, 45, 5, (0.12, 0, 0.02)),
            Axis((0.275, 0, -0.02), "-z", (0, 0.2), 1.1, 300, 1, (0, 0, 0.05), "prismatic"),
            Axis((0, 0, -0.08), "-z", (-355, 355), 2000, 9, 0.2, (0, 0, -0.02)),
        ),
        Tool((0, 0, -0.02), 0.8, (0.02, 0.01, -0.04), (0.07, 0.03, -0.08), "down"),
        (1.1e-05, 1.8e-05, 0, 0.00012),
        extra=(
            ("joint_1", "ry", 2e-06),
            ("joint_2", "ry", 5e-06),
        ),
    ),
    build_robot(
        "kr180pa_like",
        "heavy",
        420,
        (
            Axis((0, 0, 0.68), "z", (-185, 185), 90, 9000, 560, (0.15, 0, 0)),
            Axis((0.35, 0, 0.07), "y", (-50, 55), 90, 12000, 240, (0.02, -0.1, 0.5)),
            Axis((0, 0, 0), "y", (-35, 90), 90, 9000, 230, (0.5, 0.05, 0.03)),
            Axis((0.25, 0, -0.12), "-z", (-350, 350), 230, 900, 25, (0, 0, -0.04)),
        ),
        Tool((0, 0, -0.15), 35, (0.03, 0.01, -0.1), (0.15, -0.06, -0.2), "down"),
        (3e-07, 2e-07, 2.6e-07, 1.8e-06),
        extra=(("joint_1", "ry", 8e-09),),
        plates={
            2: Plate("lever_3", "plate_3", (0, 0, 1.15), 30, (0.02, 0.04, 0.02), "joint_2"),
            3: Plate("lever_4", "plate_4", (1.5, 0, 0), 38, (0.1, 0, -0.03), "joint_3"),
        },
    ),
)
