"""Nominal robots of many kinds, every one with dimensions, masses and compliances of its own.

No figure is taken from a data sheet: a kind fixes the order of axes, the rest is drawn around what such robots weigh
and measure. Compliances follow gear size: a joint's compliance is the kind's typical one times a lognormal factor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaigns.description import Array, RobotDescription, Segment, Spring

Generator = np.random.Generator
Vector = tuple[float, float, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
NX, NY, NZ = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
ZERO = (0.0, 0.0, 0.0)
QUARTER = 1.5707963268


@dataclass(frozen=True)
class Machine:
    """A nominal robot and how one measures with it.

    Args:
        robot: The robot as its folder states it.
        low: Lower end of the joint ranges that poses are drawn from. Shape (nq,). [rad or m]
        high: Upper end. Shape (nq,). [rad or m]
        payload_kg: Heaviest dead weight that is hung on it.
        reach: Typical distance between base and TCP. [m]
        gears: Gear ratio of every joint, not an integer. Shape (nq,).
        balanced: Joint that may carry a balancer, or None.
    """

    robot: RobotDescription
    low: Array
    high: Array
    payload_kg: float
    reach: float
    gears: Array
    balanced: str | None

    @property
    def scale(self) -> float:
        """Size of the robot against one of 2.5 m reach."""
        return self.reach / 2.5


@dataclass
class _Chain:
    """A chain of joints under construction, with what the random numbers make of typical figures."""

    rng: Generator
    segments: list[Segment]
    springs: list[Spring]
    low: list[float]
    high: list[float]

    def length(self, typical: float, spread: float = 0.12) -> float:
        """Draw a length around a typical one, to a tenth of a millimetre. [m]"""
        return round(typical * float(np.exp(self.rng.normal(0.0, spread))), 4)

    def joint(
        self,
        xyz: Vector,
        axis: Vector,
        region_deg: tuple[float, float],
        compliance: float,
        mass: float,
        com: Vector,
        *,
        rpy: Vector = ZERO,
        kind: str = "revolute",
        name: str | None = None,
    ) -> None:
        """Add a motor's joint; a compliance of zero is a rigid one."""
        number = len(self.low) + 1
        name = name or f"joint_{number}"
        slide = kind == "prismatic"
        low, high = region_deg if slide else (np.deg2rad(region_deg[0]), np.deg2rad(region_deg[1]))
        room = 0.15 * (high - low)
        self.segments.append(
            Segment(
                name,
                kind,
                f"link_{number}",
                xyz,
                rpy,
                axis,
                float(low - room),
                float(high + room),
                float(self.rng.uniform(0.5, 1.5) if slide else self.rng.uniform(1.5, 4.0)),
                20000.0,
                *self._mass(mass, com),
            )
        )
        self.low.append(float(low))
        self.high.append(float(high))
        if compliance > 0.0:
            factor = float(np.exp(self.rng.normal(0.0, 0.3)))
            self.springs.append(Spring(name, "own", float(f"{compliance * factor:.3g}"), actuator=True))

    def lever(self, xyz: Vector, axis: Vector, leader: str, mass: float, com: Vector) -> None:
        """Add a joint that follows a motor's joint the other way round: a parallelogram."""
        name = f"lever_{len(self.segments)}"
        mimic = (leader, -1.0, 0.0)
        weight = self._mass(mass, com)
        self.segments.append(
            Segment(
                name, "revolute", f"plate_{len(self.segments)}", xyz, ZERO, axis, -3.2, 3.2, 3.0, 9e3, *weight, mimic
            )
        )

    def _mass(self, mass: float, com: Vector) -> tuple[float, Vector]:
        aside = self.rng.normal(size=3) * 0.06 * (np.linalg.norm(com) + 0.05)
        x, y, z = (round(float(c + d), 3) for c, d in zip(com, aside, strict=True))
        return round(mass * float(self.rng.uniform(0.8, 1.25)), 2), (x, y, z)


def _begin(rng: Generator, mass: float) -> _Chain:
    base = Segment("base_fixed", "fixed", "base_link", ZERO, mass=round(mass, 1), com=(-0.02, 0.0, 0.15))
    return _Chain(rng, [base], [], [], [])


def _finish(
    chain: _Chain,
    name: str,
    flange: Vector,
    tool_axis: str,
    tool_kg: float,
    payload: float,
    balanced: str | None = None,
) -> Machine:
    """Put tool and TCP at the end, and draw gears."""
    rng = chain.rng
    size = 0.06 + 0.004 * tool_kg
    along, aside = size * float(rng.uniform(0.8, 2.0)), size * float(rng.uniform(-0.8, 0.8))
    turn = {"z": ZERO, "x": (0.0, QUARTER, 0.0), "-z": (0.0, 2 * QUARTER, 0.0)}[tool_axis]
    tip = {"z": (aside, -0.3 * aside, along), "x": (along, -0.3 * aside, aside), "-z": (aside, -0.3 * aside, -along)}
    xyz = tuple(round(v, 4) for v in tip[tool_axis])
    mass, com = chain._mass(tool_kg, tuple(0.5 * v for v in xyz))
    chain.segments.append(Segment("tool_mount", "fixed", "tool", flange, mass=mass, com=com))
    chain.segments.append(Segment("tool_tip", "fixed", "tool0", (xyz[0], xyz[1], xyz[2]), turn))
    robot = RobotDescription(name, tuple(chain.segments), tuple(chain.springs), (0.0, 0.0, -9.81))
    origins = sum(float(np.linalg.norm(s.xyz)) for s in chain.segments)
    gears = rng.uniform(28.0, 175.0, len(chain.low))
    return Machine(
        robot, np.array(chain.low), np.array(chain.high), payload, 0.75 * origins, np.round(gears, 2), balanced
    )


def draw_cobot(rng: Generator) -> Machine:
    """A collaborative arm whose wrist axes do not meet: soft gears, light links."""
    c = _begin(rng, 4.0)
    f = float(np.exp(rng.uniform(np.log(0.7), np.log(1.25))))
    soft = 2.2e-5 / f**2
    c.joint((0, 0, c.length(0.16 * f)), Z, (-150, 150), soft, 6 * f, (0, -0.02, 0.02))
    c.joint((0, c.length(0.18 * f), 0), Y, (-60, 60), soft, 9 * f, (0, 0.02, 0.25 * f))
    c.joint((0, -c.length(0.13 * f), c.length(0.58 * f)), Y, (25, 130), 1.4 * soft, 4 * f, (0, 0, 0.22 * f))
    c.joint((0, 0, c.length(0.52 * f)), Y, (-110, 110), 6 * soft, 1.8 * f, (0, 0.08, 0))
    c.joint((0, c.length(0.15 * f), 0), Z, (-140, 140), 6 * soft, 1.8 * f, (0, 0, 0.06))
    c.joint((0, 0, c.length(0.12 * f)), Y, (-170, 170), 8 * soft, 0.8, (0, 0.05, 0))
    flange = (0.0, c.length(0.09 * f), 0.0)
    machine = _finish(c, "offset_cobot", flange, "z", float(rng.uniform(0.8, 3.0)), 9.0 * f)
    return machine


def draw_seven(rng: Generator) -> Machine:
    """A seven-axis arm with meeting shoulder, elbow and wrist axes."""
    c = _begin(rng, 6.0)
    s = 8e-6 * float(np.exp(rng.normal(0, 0.3)))
    upper, lower = c.length(0.42), c.length(0.4)
    c.joint((0, 0, c.length(0.34)), Z, (-140, 140), s, 5.0, (0, -0.03, 0.06))
    c.joint(ZERO, Y, (-75, 75), s, 5.0, (0, 0.04, 0.1))
    c.joint((0, 0, upper), Z, (-140, 140), 1.5 * s, 4.0, (0, 0.02, 0.05))
    c.joint(ZERO, NY, (25, 110), 1.5 * s, 3.5, (0, 0.03, 0.1))
    c.joint((0, 0, lower), Z, (-150, 150), 2 * s, 2.2, (0, -0.02, 0.04))
    c.joint(ZERO, Y, (-95, 95), 4 * s, 2.5, (0, 0.01, 0.02))
    c.joint((0, 0, c.length(0.13)), Z, (-165, 165), 5 * s, 0.7, (0, 0, 0.02))
    return _finish(c, "seven_axis", (0, 0, 0.04), "z", float(rng.uniform(0.8, 2.5)), 12.0)


def _six(rng: Generator, name: str, size: float, mass: float, soft: float, payload: float, tool: float) -> Machine:
    """A six-axis arm with spherical wrist, arm lying along x, of any size."""
    c = _begin(rng, 0.35 * mass)
    down = NZ if rng.random() < 0.3 else Z
    roll = NX if rng.random() < 0.3 else X
    a1, d1, a2 = c.length(0.15 * size, 0.2), c.length(0.28 * size), c.length(0.45 * size)
    a3, d4 = round(float(rng.uniform(-0.03, 0.06)) * size, 4), c.length(0.45 * size)
    wrist = 6.0 if size > 1.5 else 12.0
    c.joint((0, 0, d1), down, (-140, 140), soft, 0.3 * mass, (0.4 * a1, 0, -0.05 * size))
    c.joint((a1, 0, 0.0), Y, (-50, 70), 0.8 * soft, 0.2 * mass, (0, -0.04 * size, 0.45 * a2))
    c.joint((0, 0, a2), Y, (-55, 65), 1.1 * soft, 0.22 * mass, (0.1 * d4, 0.02 * size, a3))
    c.joint((0, 0, a3), roll, (-170, 170), wrist * soft, 0.07 * mass, (0.6 * d4, 0, 0))
    c.joint((d4, 0, 0), Y, (-110, 110), wrist * soft, 0.035 * mass, (0.02, 0, 0))
    c.joint((c.length(0.09 * size), 0, 0), roll, (-180, 180), 1.5 * wrist * soft, 0.012 * mass, (0.0, 0, 0))
    return _finish(c, name, (0.01 * size, 0, 0), "x", tool, payload, "joint_2" if size > 1.8 else None)


def draw_heavy(rng: Generator) -> Machine:
    """A 300 kg class arm."""
    size = float(rng.uniform(2.4, 3.3))
    return _six(rng, "heavy_arm", size, float(rng.uniform(1300, 2600)), 2.2e-7, float(rng.uniform(180, 320)), 60.0)


def draw_medium(rng: Generator) -> Machine:
    """An arm of the 50 kg to 150 kg class."""
    size = float(rng.uniform(1.7, 2.6))
    return _six(rng, "medium_arm", size, float(rng.uniform(500, 1100)), 5e-7, float(rng.uniform(50, 150)), 25.0)


def draw_bench(rng: Generator) -> Machine:
    """An 8 kg class arm that stands on a bench."""
    size = float(rng.uniform(0.7, 1.1))
    return _six(rng, "bench_arm", size, float(rng.uniform(35, 70)), 7e-6, float(rng.uniform(4, 9)), 1.2)


def draw_palletiser(rng: Generator) -> Machine:
    """A four-axis palletiser whose two parallelograms keep the tool upright."""
    c = _begin(rng, 420.0)
    upper, lower, low = c.length(1.2), c.length(1.35), c.length(0.6)
    c.joint((0, 0, low), Z, (-120, 120), 3e-7, 560, (0.12, 0.02, 0.1))
    c.joint((c.length(0.3), 0, c.length(0.35)), Y, (-25, 65), 3e-7, 210, (0, -0.08, 0.45 * upper))
    c.lever((0, 0, upper), Y, "joint_2", 30, (0.02, 0.04, 0.02))
    c.joint(ZERO, Y, (-20, 65), 3.5e-7, 190, (0.4 * lower, 0.03, 0.02))
    c.lever((lower, 0, 0), Y, "joint_3", 35, (0.1, 0, -0.03))
    c.joint((c.length(0.23), 0, -0.1), NZ, (-170, 170), 4e-6, 28, (0, 0, -0.05))
    return _finish(c, "palletiser", (0, 0, -0.12), "-z", 45.0, 160.0, "joint_2")


def draw_scara(rng: Generator) -> Machine:
    """A four-axis arm that bends in the plane and moves its quill up and down."""
    c = _begin(rng, 25.0)
    f = float(rng.uniform(0.8, 1.3))
    first, second = c.length(0.4 * f), c.length(0.4 * f)
    c.joint((0, 0, c.length(0.35)), Z, (-120, 120), 1.2e-5, 9.0, (0.5 * first, 0, 0))
    c.joint((first, 0, 0), Z, (-135, 135), 2e-5, 7.0, (0.4 * second, 0, 0.05))
    c.joint((second, 0, 0.05), Z, (-0.28, 0.0), 4e-7, 1.4, (0, 0, -0.05), kind="prismatic")
    c.joint(ZERO, NZ, (-170, 170), 9e-5, 0.4, (0, 0, -0.02))
    # the arm of such a robot bends mostly up and down, which its maker's model knows
    for joint, value in (("joint_1", 4e-6), ("joint_2", 6e-6)):
        c.springs.append(Spring(joint, "ry", float(f"{value * np.exp(rng.normal(0, 0.3)):.3g}")))
    return _finish(c, "flat_arm", (0, 0, -0.03), "-z", float(rng.uniform(0.6, 2.0)), 6.0)


def draw_rail(rng: Generator) -> Machine:
    """A medium arm that rides on a rail, which is its first joint."""
    machine = draw_medium(rng)
    length = float(rng.uniform(1.5, 3.0))
    slide = Segment(
        "rail",
        "prismatic",
        "carriage",
        (0.0, 0.0, round(float(rng.uniform(0.25, 0.6)), 3)),
        axis=Y if rng.random() < 0.7 else X,
        lower=-length - 0.3,
        upper=length + 0.3,
        velocity=1.5,
        effort=20000.0,
        mass=round(float(rng.uniform(300, 700))),
        com=(0.0, 0.0, -0.1),
    )
    robot = machine.robot
    segments = (robot.segments[0], slide, *robot.segments[1:])
    return replace(
        machine,
        robot=replace(robot, name="rail_arm", segments=segments),
        low=np.r_[-length, machine.low],
        high=np.r_[length, machine.high],
        gears=np.r_[200.0, machine.gears],
    )


KINDS_OF_MACHINE: dict[str, tuple[float, Callable[[Generator], Machine]]] = {
    "cobot": (0.2, draw_cobot),
    "seven": (0.15, draw_seven),
    "heavy": (0.15, draw_heavy),
    "medium": (0.12, draw_medium),
    "bench": (0.15, draw_bench),
    "palletiser": (0.1, draw_palletiser),
    "scara": (0.05, draw_scara),
    "rail": (0.08, draw_rail),
}


def draw_machine(rng: Generator, kind: str | None = None) -> Machine:
    """Draw a robot; now and then its model holds bearings or a base plate elastic, or names axes by letters.

    Args:
        rng: Source of randomness.
        kind: One of `KINDS_OF_MACHINE`; drawn if None.
    """
    names = list(KINDS_OF_MACHINE)
    weights = np.array([KINDS_OF_MACHINE[n][0] for n in names])
    kind = kind or str(rng.choice(names, p=weights / weights.sum()))
    machine = KINDS_OF_MACHINE[kind][1](rng)
    robot = machine.robot
    springs = list(robot.springs)
    typical = float(np.median([s.compliance for s in springs if s.axis == "own"]))
    if rng.random() < 0.4:
        plate = float(f"{0.02 * typical * np.exp(rng.normal(0, 0.5)):.3g}")
        joint = robot.segments[0].joint if rng.random() < 0.5 else next(n for n in robot.joint_names if n != "rail")
        springs += [Spring(joint, "rx", plate), Spring(joint, "ry", plate)]
    if rng.random() < 0.3:
        joint = [n for n in robot.joint_names if n != "rail"][2 if kind != "scara" else 1]
        own = np.abs(robot.segments[robot.index_of(joint)].axis)
        axis = str(rng.choice([a for a, v in zip(("rx", "ry", "rz"), own, strict=True) if v < 0.5]))
        if kind != "scara":
            springs.append(Spring(joint, axis, float(f"{0.1 * typical * np.exp(rng.normal(0, 0.4)):.3g}")))
    if rng.random() < 0.4:
        springs = [_spelled(robot, s) for s in springs]
    return replace(machine, robot=replace(robot, springs=tuple(springs)))


def _spelled(robot: RobotDescription, spring: Spring) -> Spring:
    """Write a spring about a joint's own axis by that axis's letter."""
    if spring.axis != "own":
        return spring
    segment = robot.segments[robot.index_of(spring.joint)]
    letter = "xyz"[int(np.argmax(np.abs(segment.axis)))]
    return replace(spring, axis=("r" if segment.kind == "revolute" else "t") + letter, actuator=True)
