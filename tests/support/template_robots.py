"""Nominal robots of drawn campaigns: two robots from published figures, with masses and tools drawn at random.

Geometry, limits and joint compliances of kr240_like are those of Dumas 2011 (lengths of the series assumed), of
kr120_like published machine data (compliances assumed); masses and centres of mass are assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.campaigns.description import RobotDescription, Segment, Spring

HALF_TURN = 1.570796327
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Template:
    """Published figures of one robot."""

    name: str  #: Name of the robot.
    origins: tuple[Vector, ...]  #: Origin of every revolute joint in its parent link, then of the flange. [m]
    turns: dict[int, Vector]  #: Roll, pitch, yaw of these origins, where not zero, by index. [rad]
    axes: tuple[Vector, ...]  #: Axis of every joint.
    limits_deg: tuple[tuple[float, float], ...]  #: Position limits. [deg]
    velocity_deg_s: tuple[float, ...]  #: Velocity limits. [deg/s]
    compliance: tuple[float, ...]  #: Compliance of every joint, 0 where it is taken as rigid. [rad/(N m)]
    masses: tuple[tuple[float, Vector], ...]  #: Mass and centre of every moving link, as assumed. [kg, m]
    max_force: float  #: Largest force that campaigns apply. [N]
    tool_z: str  #: Direction of the tool in the flange frame: "x" or "z".
    home_deg: tuple[float, ...]  #: A posture in the middle of the workspace. [deg]


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
NX, NY, NZ = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
ZERO = (0.0, 0.0, 0.0)

TEMPLATES: tuple[Template, ...] = (
    Template(
        "kr240_like",
        ((0, 0, 0.75), (0.35, 0, 0), (1.25, 0, 0), (1.1, 0, -0.055), ZERO, ZERO, (0.23, 0, 0)),
        {2: (0.0, -HALF_TURN, 0.0)},
        (Z, NY, NY, X, Y, X),
        ((-185, 185), (0, 146), (-245, 29), (-350, 350), (-125, 125), (-350, 350)),
        (105, 107, 114, 136, 129, 206),
        (2.63e-7, 1.52e-7, 2.56e-7, 1.79e-6, 1.52e-6, 2.13e-6),
        (
            (340, (0.13, 0.02, -0.12)),
            (185, (0.52, -0.1, 0.01)),
            (215, (0.2, 0.02, 0.02)),
            (46, (-0.4, 0, 0)),
            (30, (0.03, 0, 0)),
            (12, (0.18, 0, 0)),
        ),
        1500.0,
        "x",
        (0, 70, -165, 0, 30, 0),
    ),
    Template(
        "kr120_like",
        ((0, 0, 0.55), (0.73, 0, 0), (1.35, 0, 0), (1.82, 0, 0.115), ZERO, ZERO, (0.215, 0, 0)),
        {},
        (NZ, Y, Y, NX, Y, NX),
        ((-185, 185), (-140, -5), (-120, 168), (-350, 350), (-125, 125), (-350, 350)),
        (105, 101, 110, 190, 180, 260),
        (4.7e-7, 3.3e-7, 3.3e-7, 2.93e-6, 3.28e-6, 2.34e-6),
        (
            (380, (0.3, 0.02, -0.1)),
            (240, (0.6, 0.12, 0.0)),
            (260, (0.35, 0.02, 0.08)),
            (52, (-0.6, 0, 0)),
            (30, (0.03, 0, 0)),
            (12, (0.16, 0, 0)),
        ),
        1100.0,
        "x",
        (0, -75, 85, 0, 40, 0),
    ),
)


def draw_robot(rng: np.random.Generator, name: str, *, rail: bool = False) -> tuple[RobotDescription, Template]:
    """Draw one of the templates with masses, centres and tool of its own, or on a rail, which is its first joint."""
    template = next(t for t in TEMPLATES if t.name == name)
    total = sum(m for m, _ in template.masses)
    base_mass = round(float(rng.uniform(0.25, 0.4) * total))
    segments = [Segment("base_fixed", "fixed", "base_link", ZERO, mass=base_mass, com=(-0.02, 0.0, 0.2))]
    springs: list[Spring] = []
    if rail:
        height = round(float(rng.uniform(0.3, 0.6)), 3)
        segments.append(
            Segment(
                "rail",
                "prismatic",
                "carriage",
                (0.0, 0.0, height),
                axis=Y,
                lower=-3.0,
                upper=3.0,
                velocity=1.5,
                effort=20000.0,
                mass=round(0.5 * total),
                com=(0.0, 0.0, -0.1),
            )
        )
        if rng.random() < 0.5:
            springs.append(Spring("rail", "own", float(rng.uniform(0.5e-8, 2e-8)), actuator=True))
    for j, axis in enumerate(template.axes):
        mass, com = template.masses[j]
        mass = round(mass * float(rng.uniform(0.8, 1.2)), 1)
        cx, cy, cz = (round(float(c + 0.1 * abs(c) * rng.normal()), 3) for c in com)
        low, high = np.deg2rad(template.limits_deg[j])
        x, y, z = template.origins[j]
        segments.append(
            Segment(
                f"joint_{j + 1}",
                "revolute",
                f"link_{j + 1}",
                (float(x), float(y), float(z)),
                template.turns.get(j, ZERO),
                axis,
                float(low),
                float(high),
                float(np.deg2rad(template.velocity_deg_s[j])),
                9000.0,
                mass,
                (cx, cy, cz),
            )
        )
        if template.compliance[j] > 0.0:
            springs.append(Spring(f"joint_{j + 1}", "own", template.compliance[j], actuator=True))
    return _with_tool(rng, template, segments, springs), template


def _with_tool(
    rng: np.random.Generator, template: Template, segments: list[Segment], springs: list[Spring]
) -> RobotDescription:
    """Put flange, tool and TCP at the end of the chain."""
    reach, aside = float(rng.uniform(0.08, 0.35)), float(rng.uniform(-0.2, 0.2))
    if rng.random() < 0.15:
        reach, aside = 0.0, 0.0
    reach, aside = round(reach, 4), round(aside, 4)
    mass = round(float(rng.uniform(12, 40)), 1)
    offset = (reach, 0.0, aside) if template.tool_z == "x" else (aside, 0.0, reach)
    cx, cy, cz = (round(0.5 * v + 0.02 * float(rng.normal()), 3) for v in offset)
    x, y, z = (float(v) for v in template.origins[6])
    turn = (0.0, HALF_TURN, 0.0) if template.tool_z == "x" else ZERO
    segments.append(Segment("tool_mount", "fixed", "tool", (x, y, z), mass=mass, com=(cx, cy, cz)))
    segments.append(Segment("tool_tip", "fixed", "tool0", offset, turn))
    return RobotDescription(template.name, tuple(segments), tuple(springs), (0.0, 0.0, -9.81))
