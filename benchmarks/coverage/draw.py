"""Draw true arms about a robot folder: what the widths that compplan states allow, in this benchmark's own words."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.simulated_robot.robot import Arm, Array, Joint, Spring, pose_of, rotation_vector

#: Relative standard deviation of compliances by grade, of masses where assumed and where stated (docs/robots.md).
SOFTER = {"identified": 0.10, "literature": 0.20, "scaled": 0.50, "placeholder": 0.80}
HEAVIER = (0.30, 0.10)
#: Compliance of joints that a folder calls rigid: turning [rad/(N m)] and sliding [m/N], of which a grade's share acts.
RIGID = (1e-6, 1e-7)
#: Zeros [rad], lengths [m], directions [rad] of an arm as delivered, and of one that was calibrated.
DELIVERED = np.radians(0.010), 1e-4, np.radians(0.003)
CALIBRATED = np.radians(0.003), 3e-5, np.radians(0.001)
#: Lost motion (full width) and gear error once a turn [rad], tool tip and repeatability per axis [m].
PLAY = GEAR = np.radians(0.002)
TOOL, REPEAT = 3e-5, 2e-5
#: A smooth error over the workspace, rms [m] and scale [m].
FIELD, SCALE, WAVES = 5e-5, 0.3, 64
#: The force: size, direction [rad], variation from place to place and the distance that it forgets itself over [m].
LEVEL, TURN, PLACES, FORGETS = 0.15, np.radians(3.0), 0.05, 0.02
#: Damping of the modes, shares of critical: middle and factor.
DAMPING, FACTOR = 0.03, 1.6


@dataclass(frozen=True)
class Truth:
    """A true arm: bodies and springs, damping, and what is added to joints, tip and wrench."""

    arm: Arm
    damping: float
    gear: Array
    play: Array
    place: Array
    waves: tuple[Array, Array, Array]
    level: float
    turn: Array
    along: tuple[Array, Array, Array]

    def joints(self, q: Array, rate: Array) -> Array:
        """Return where the drives stand for commanded positions: gear error once a turn, lost motion. Shape (n, nq)."""
        wave = self.gear[0] * np.sin(q) + self.gear[1] * np.cos(q)
        return np.asarray(q + wave + 0.5 * self.play * np.tanh(rate / 1e-3))

    def shift(self, tip: Array) -> Array:
        """Return what no parameter explains, and the error of this run. Shape (n, 3). [m]"""
        frequency, phase, size = self.waves
        return np.asarray(np.cos(tip @ frequency.T + phase) @ size + self.place)

    def force(self, wrench: Array, length: Array) -> Array:
        """Return the wrench that really acts. Shape (n, 6). [N, N m]"""
        frequency, phase, size = self.along
        level = self.level + np.cos(length[:, None] * frequency + phase) @ size
        turn = rotation_vector(self.turn)
        return np.asarray(level[:, None] * np.hstack([wrench[:, :3] @ turn.T, wrench[:, 3:] @ turn.T]))


def read_grade(folder: Path) -> tuple[str, bool, float]:
    """Return grade of a folder's compliances, whether its masses are assumed, and its repeatability. [m]"""
    table = tomllib.loads((folder / "elasticity.toml").read_text(encoding="utf-8"))
    masses = str(table.get("sources", {}).get("masses", "assumed"))
    return str(table.get("grade", "placeholder")), "assumed" in masses, 1e-3 * table.get("repeatability_mm", 0.02)


def draw_truth(arm: Arm, folder: Path, rng: np.random.Generator) -> Truth:
    """Draw a true arm about the one that the folder describes."""
    grade, assumed, repeat = read_grade(folder)
    calibrated = grade == "identified" or (folder / "controller.urdf").is_file()
    widths = CALIBRATED if calibrated else DELIVERED
    heavier = HEAVIER[0] if assumed else HEAVIER[1]
    soft = SOFTER[grade]
    springs = {
        name: [replace(s, compliance=s.compliance * max(1.0 + soft * rng.standard_normal(), 0.05)) for s in own]
        for name, own in arm.springs.items()
    }
    for joint in arm.commanded:
        own = springs.get(joint.name, [])
        if not any(spring.slides == joint.slides and abs(spring.axis @ joint.axis) > 0.99 for spring in own):
            size = soft * RIGID[int(joint.slides)] * abs(float(rng.standard_normal()))
            springs[joint.name] = [*own, Spring(joint.axis, joint.slides, size + 1e-12, np.zeros(3))]
    elasticities = {
        link: [block * max(1.0 + soft * rng.standard_normal(), 0.05) for block in blocks]
        for link, blocks in arm.elasticities.items()
    }
    factor = float(np.exp(heavier * rng.standard_normal() - 0.5 * heavier**2))
    masses = tuple(replace(m, mass=factor * m.mass, inertia=factor * m.inertia) for m in arm.masses)
    joints = tuple(_move_joint(joint, widths, rng) for joint in arm.joints)
    last = joints[-1]
    tool = pose_of(np.eye(3), TOOL * rng.standard_normal(3))
    joints = (*joints[:-1], replace(last, pose=last.pose @ tool))
    nq = len(arm.commanded)
    slides = np.array([joint.slides for joint in arm.commanded])
    turns = np.where(slides, 0.0, 1.0)
    frequency, phase = rng.standard_normal((WAVES, 3)) / SCALE, rng.uniform(0.0, 2 * np.pi, WAVES)
    size = FIELD / np.sqrt(3.0) * np.sqrt(2.0 / WAVES) * rng.standard_normal((WAVES, 3))
    along = rng.standard_normal(WAVES) / FORGETS, rng.uniform(0.0, 2 * np.pi, WAVES)
    return Truth(
        arm=replace(arm, springs=springs, elasticities=elasticities, masses=masses, joints=joints),
        damping=float(np.clip(DAMPING * FACTOR ** rng.standard_normal(), 1e-3, 0.5)),
        gear=GEAR / np.sqrt(2.0) * rng.standard_normal((2, nq)) * turns,
        play=PLAY * rng.standard_normal(nq) * turns,
        place=repeat * rng.standard_normal(3),
        waves=(frequency, phase, size),
        level=1.0 + LEVEL * float(rng.standard_normal()),
        turn=TURN * rng.standard_normal(3),
        along=(*along, PLACES * np.sqrt(2.0 / WAVES) * rng.standard_normal(WAVES)),
    )


def _move_joint(joint: Joint, widths: tuple[float, float, float], rng: np.random.Generator) -> Joint:
    """Put errors of place, direction and zero into a joint that moves."""
    if joint.kind == "fixed":
        return joint
    zero, length, turn = widths
    turned, moved = turn * rng.standard_normal(3), length * rng.standard_normal(3)
    if not joint.slides:  # a turn about its own axis is its zero
        turned -= joint.axis * (joint.axis @ turned)
    pose = joint.pose @ pose_of(rotation_vector(turned), moved)
    if not joint.slides:
        pose = pose @ pose_of(rotation_vector(zero * float(rng.standard_normal()) * joint.axis), np.zeros(3))
    return replace(joint, pose=pose)
