"""Designs of drawn campaigns: poses, order of approach, loads, paths, times, warm-up and handicaps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compplan.effects import attain_scene, stage_scene
from compplan.measure.campaign import Campaign
from compplan.robot import Array, Robot

#: Largest force on a robot of this total mass and less, and on a larger one (assumed). [kg, N]
LIGHT, LIGHT_FORCE, HEAVY_FORCE = 300.0, 80.0, 1500.0
#: Joint ranges that campaigns use at most, first joint and others. [rad]
FIRST_RANGE, JOINT_RANGE = np.deg2rad(110.0), np.deg2rad(150.0)
#: Room that the tool keeps from floor and column. [m]
FLOOR, COLUMN = 0.15, 0.35
PATH_STEP, PATH_SWING = 0.12, np.deg2rad(8.0)


@dataclass(frozen=True)
class Design:
    """How a campaign is run.

    Attributes:
        stays: Stays in every static run.
        paths: Number of path runs.
        loads: "all" directions, "vertical", or "none".
        unloaded: Whether stays begin with an unloaded reading.
        region: Share of the joint ranges that poses cover.
        repeats: Share of the stays that come back to an earlier pose.
        sigma: Standard deviation of the position per axis. [m]
        orientation: Whether orientation is measured.
        encoders: Whether link-side encoders are read.
        temperature: Whether the temperature is logged.
        stated: Whether sigma is logged.
        outliers: Share of gross outliers.
        force_noise: Standard deviation of the force sensor. [N]
        pace: Seconds between readings. [s]
        rise: Rise of the temperature. [K]
        time_constant: Its time constant. [s]
        handicaps: Names of what makes the campaign hard.
    """

    stays: tuple[int, ...]
    paths: int
    loads: str = "all"
    unloaded: bool = True
    region: float = 1.0
    repeats: float = 0.2
    sigma: float = 2.5e-5
    orientation: bool = True
    encoders: bool = False
    temperature: bool = True
    stated: bool = True
    outliers: float = 0.0
    force_noise: float = 0.5
    pace: float = 15.0
    rise: float = 3.0
    time_constant: float = 3000.0
    handicaps: tuple[str, ...] = ()


def draw_design(random: np.random.Generator, difficulty: str) -> Design:
    """Draw the design of a campaign; realistic ones have handicaps."""
    design = Design(
        stays=tuple(int(v) for v in random.integers(36, 110, int(random.integers(1, 3)))),
        paths=int(random.integers(1, 3)) if random.random() < 0.5 else 0,
        sigma=1e-6 * float(random.uniform(15.0, 39.0)),
        orientation=bool(random.random() < 0.5),
        encoders=bool(random.random() < 0.25),
        temperature=bool(random.random() < 0.6),
        stated=bool(random.random() < 0.5),
        outliers=float(random.uniform(0.004, 0.018)) if random.random() < 0.3 else 0.0,
        force_noise=0.5 if random.random() < 0.5 else 0.0,
        pace=float(np.exp(random.uniform(np.log(9.0), np.log(40.0)))),
        rise=float(np.exp(random.uniform(np.log(0.5), np.log(12.0)))),
        time_constant=float(random.uniform(2000.0, 3600.0)),
    )
    if difficulty != "realistic":
        return design
    for name, chance, changes in (
        ("35 poses", 0.2, {"stays": (35,), "repeats": 0.05}),
        ("vertical loads only", 0.2, {"loads": "vertical"}),
        ("no unloaded rows", 0.15, {"unloaded": False}),
        ("narrow region", 0.2, {"region": float(random.uniform(0.25, 0.4))}),
    ):
        if random.random() < chance:
            design = replace(design, handicaps=(*design.handicaps, name), **changes)  # type: ignore[arg-type]
    return design


def later_design(random: np.random.Generator, design: Design) -> Design:
    """Return the design of a later campaign: shorter, loads of all directions."""
    loads = "none" if design.loads == "none" else "all"
    return replace(
        design, stays=(int(random.integers(40, 60)),), paths=min(design.paths, 1), loads=loads, unloaded=True,
        region=min(1.0, 1.2 * design.region), handicaps=(),
    )  # fmt: skip


def largest_force(robot: Robot) -> float:
    """Return the largest force that campaigns put on a robot (assumed by its mass). [N]"""
    return LIGHT_FORCE if sum(body.mass for body in robot.bodies) < LIGHT else HEAVY_FORCE


def lay_out_campaign(
    random: np.random.Generator, robot: Robot, design: Design, around: Array | None = None
) -> Campaign:
    """Lay out joints, loads, times and temperatures of a campaign; nothing is measured yet.

    Args:
        random: Source of randomness.
        robot: The nominal robot.
        design: How the campaign is run.
        around: Centre of a narrow region, as a share of the joint ranges. Shape (nq,).
    """
    lower, upper = pose_range(robot, design.region, around)
    parts: list[tuple[str, Array, Array, Array]] = []
    clock = 0.0
    for number, stays in enumerate(design.stays):
        q, wrench = _static_run(random, robot, design, stays, lower, upper)
        time = np.asarray(clock + np.cumsum(design.pace * random.uniform(0.6, 1.4, len(q))))
        parts.append((f"static_{number + 1}", q, wrench, time))
        clock = float(time[-1]) + float(random.uniform(100.0, 600.0))
    for number in range(design.paths):
        q, wrench = _path_run(random, robot, design, lower, upper)
        time = np.asarray(clock + PATH_STEP * np.arange(len(q)))
        parts.append((f"path_{number + 1}", q, wrench, time))
        clock = float(time[-1]) + float(random.uniform(60.0, 200.0))
    time = np.concatenate([part[3] for part in parts])
    time = time - time[0]
    q = np.round(np.concatenate([part[1] for part in parts]), 7)
    rise = design.rise * (1.0 - np.exp(-time / design.time_constant)) + 0.15 * np.sin(time / 400.0)
    return Campaign(
        run=np.concatenate([np.array([part[0]] * len(part[1]), dtype=np.str_) for part in parts]),
        q=q,
        wrench=np.concatenate([part[2] for part in parts]),
        position=np.zeros((len(q), 3)),
        rotation=np.broadcast_to(np.eye(3), (len(q), 3, 3)) if design.orientation else None,
        time=time,
        temperature=22.0 + rise - rise[0] if design.temperature else None,
        link=np.zeros_like(q) if design.encoders else None,
    )


def pose_range(robot: Robot, region: float, around: Array | None = None) -> tuple[Array, Array]:
    """Return the joint range of a campaign. Shapes (nq,). [rad or m]"""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    revolute = np.flatnonzero(~robot.prismatic)
    widest = np.full(robot.nq, JOINT_RANGE)
    widest[revolute[0]] = FIRST_RANGE
    lower[revolute] = np.maximum(lower, -widest)[revolute]
    upper[revolute] = np.minimum(upper, widest)[revolute]
    if region < 1.0:
        share = np.full(robot.nq, 0.5) if around is None else around
        centre = lower + (0.5 * region + (1.0 - region) * share) * (upper - lower)
        half = 0.5 * region * (upper - lower)
        lower, upper = np.maximum(lower, centre - half), np.minimum(upper, centre + half)
    return lower, upper


def draw_poses(random: np.random.Generator, robot: Robot, count: int, lower: Array, upper: Array) -> Array:
    """Draw poses whose tool stands clear of floor and column. Shape (count, nq).

    Raises:
        LookupError: If hardly any pose of the range is clear.
    """
    found = np.zeros((0, robot.nq))
    for _ in range(30):
        q = random.uniform(lower, upper, (4 * count, robot.nq))
        run = np.array(["static"] * len(q), dtype=np.str_)
        tip = attain_scene(stage_scene(robot, Campaign(run, q, np.zeros((len(q), 6)), np.zeros((len(q), 3))))).position
        rail = q[:, 0] if robot.prismatic[0] else np.zeros(len(q))
        across = np.minimum(np.abs(tip[:, 0] - rail), np.hypot(tip[:, 0], tip[:, 1])) if robot.prismatic[0] else 0.0
        clear = (tip[:, 2] > FLOOR) & (np.hypot(tip[:, 0], tip[:, 1]) + across > COLUMN)
        found = np.vstack([found, q[clear]])
        if len(found) >= count:
            return found[:count]
    raise LookupError("no clear poses in this region")


def _static_run(
    random: np.random.Generator, robot: Robot, design: Design, count: int, lower: Array, upper: Array
) -> tuple[Array, Array]:
    poses = draw_poses(random, robot, count, lower, upper)
    force = largest_force(robot)
    q: list[Array] = []
    wrench: list[Array] = []
    for number, fresh in enumerate(poses):
        pose = fresh
        if number > 3 and random.random() < design.repeats:
            pose = poses[int(random.integers(max(0, number - 15), number))]
            aside = np.deg2rad(random.uniform(2.0, 6.0)) * random.choice([-1.0, 1.0], robot.nq)
            q.append(np.clip(pose + aside, lower, upper))
            wrench.append(np.zeros(6) if design.unloaded else _draw_load(random, force, design.loads))
        readings = [np.zeros(6)] if design.unloaded or design.loads == "none" else []
        extra = 0 if design.loads == "none" else int(random.choice(4, p=[0.2, 0.35, 0.25, 0.2]))
        readings += [_draw_load(random, force, design.loads) for _ in range(max(extra, 1 - len(readings)))]
        if random.random() < 0.1:
            readings.append(readings[-1])
        q += [pose] * len(readings)
        wrench += readings
    return np.array(q), np.array(wrench)


def _draw_load(random: np.random.Generator, force: float, loads: str) -> Array:
    size = force * float(random.uniform(0.1, 1.0))
    if loads == "vertical":
        return np.array([0.0, 0.0, size * random.choice([-1.0, 1.0]), 0.0, 0.0, 0.0])
    direction = random.normal(size=3)
    direction = size * direction / np.linalg.norm(direction)
    moment = np.cross(random.normal(size=3) * 0.1, direction) if random.random() < 0.4 else np.zeros(3)
    return np.asarray(np.round(np.r_[direction, moment], 3))


def _path_run(
    random: np.random.Generator, robot: Robot, design: Design, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """Swing all joints smoothly around a pose, each at its own period, under a load that ramps up."""
    centre = draw_poses(random, robot, 1, lower, upper)[0]
    count = int(random.integers(200, 420))
    phase = 2.0 * np.pi * np.linspace(0.0, 1.0, count)[:, None] * random.choice([1.0, 2.0, 3.0], robot.nq)
    swing = np.where(robot.prismatic, 0.05, PATH_SWING) * random.uniform(0.3, 1.0, robot.nq)
    q = centre + swing * np.sin(phase + random.uniform(0.0, 2.0 * np.pi, robot.nq))
    q = np.clip(q, robot.lower, robot.upper)
    wrench = np.zeros((count, 6))
    if design.loads != "none":
        direction = np.array([0.0, 0.0, 1.0]) if design.loads == "vertical" else np.asarray(random.normal(size=3))
        ramp = np.minimum(1.0, np.arange(count) / (0.05 * count))
        size = largest_force(robot) * random.uniform(0.25, 0.5)
        wrench[:, :3] = (size * ramp)[:, None] * direction / np.linalg.norm(direction)
    return q, wrench
