"""Parts of drawn jobs: tool, posture, force and toolpath file, each from a random generator."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.simulated_robot.cell import Kinematics
from benchmarks.simulated_robot.robot import Arm, Array, rotation_vector

#: Share of each joint's range, in its middle, that the first posture is drawn from; the most of it about a free joint.
MIDDLE, WIDEST = 0.6, np.radians(120.0)
#: Height of the tip over the base, and distance from its axis, in reaches of the arm.
HEIGHT, DISTANCE = (-0.1, 0.6), (0.35, 0.8)


def write_toolpath(file: Path, tip: Array, feed: float, axis: Array, lift: float) -> None:
    """Write a toolpath [mm, mm/s]: a rapid to above its start and down, the cut, and a rapid up."""
    rows = [(tip[0] + lift * axis[0], axis[0], 0.0, 1), (tip[0], axis[0], 0.0, 1)]
    rows += [(tip[k], axis[k], feed, 0) for k in range(1, len(tip))]
    rows.append((tip[-1] + lift * axis[-1], axis[-1], 0.0, 1))
    lines = ["x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid"]
    lines += [",".join(f"{v:.9g}" for v in (*p, *a, f)) + f",{r}" for p, a, f, r in rows]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def draw_tool(rng: np.random.Generator, arm: Arm) -> dict:
    """Draw a tool in line with the flange or across it, as long as a tenth of the arm or two."""
    at = next((k for k, joint in enumerate(arm.joints) if joint.parent == arm.flange), len(arm.joints))
    flange = np.eye(4)
    for joint in arm.joints[at:]:
        flange = flange @ joint.pose
    turn, across = float(rng.uniform(0.0, 2.0 * np.pi)), float(np.radians(rng.choice([0.0, 0.0, 45.0, 90.0])))
    out = flange[:3, :3] @ rotation_vector(np.array([0.0, 0.0, turn])) @ rotation_vector(np.array([0.0, across, 0.0]))
    length = float(rng.uniform(0.06, 0.18)) * reach_of(arm)
    tip = flange[:3, :3] @ np.array([0.0, 0.0, 0.5 * length]) + out @ np.array([0.0, 0.0, length])
    tool = {"position_mm": (1e3 * tip).round(3).tolist(), "rotation_deg": turn_of(out).round(6).tolist()}
    if rng.random() < 0.5:
        tool["mass_kg"] = round(float(rng.uniform(0.5, 3.0)) * reach_of(arm) ** 2, 2)
        tool["centre_of_mass_mm"] = (500.0 * tip).round(1).tolist()
    return tool


def draw_posture(rng: np.random.Generator, arm: Arm) -> tuple[Array, Array] | None:
    """Draw joint positions whose tip is in the working range, and its pose; None where a thousand give none."""
    low = np.array([joint.lower for joint in arm.commanded])
    high = np.array([joint.upper for joint in arm.commanded])
    slides = np.array([joint.slides for joint in arm.commanded])
    centre, half = 0.5 * (low + high), 0.5 * MIDDLE * (high - low)
    half = np.where(slides, half, np.minimum(half, WIDEST))
    centre = np.where(~slides & (high - low > 2.0 * np.pi - 0.1), 0.0, centre)
    joints = centre + half * rng.uniform(-1.0, 1.0, (1000, len(low)))
    poses = Kinematics(arm).tip(joints)
    reach = reach_of(arm)
    held = np.zeros(2) if not slides.any() else poses[:, :2, 3].mean(axis=0)
    aside = np.linalg.norm(poses[:, :2, 3] - held, axis=1) / reach
    high_up = poses[:, 2, 3] / reach
    fit = (aside > DISTANCE[0]) & (aside < DISTANCE[1]) & (high_up > HEIGHT[0]) & (high_up < HEIGHT[1])
    fit &= poses[:, 2, 2] < 0.5  # not from below
    first = int(fit.argmax())
    return (joints[first], poses[first]) if fit.any() else None


def draw_force(rng: np.random.Generator, arm: Arm, pose: Array) -> dict:
    """Draw a force that takes a tenth to nine tenths of a joint's effort, with the levers of the tip."""
    frames, _ = Kinematics(arm).frames(np.zeros((1, len(arm.commanded))))
    wrist = np.linalg.norm(frames[arm.joints[-1].child][0, :3, 3] - frames[arm.commanded[-1].child][0, :3, 3])
    levers = [1.0 if joint.slides else np.linalg.norm(pose[:3, 3]) for joint in arm.commanded[:-3]] + [wrist] * 3
    efforts = [joint.effort for joint in arm.commanded]
    most = min(effort / max(lever, 0.05) for effort, lever in zip(efforts, levers, strict=True))
    size = float(rng.uniform(0.1, 0.9)) * min(most, 400.0 * reach_of(arm) ** 2)
    frame = str(rng.choice(["part", "path", "base"]))
    force = {"model": "constant", "force_N": (size * draw_direction(rng)).round(2).tolist(), "frame": frame}
    if rng.random() < 0.4:
        force["moment_Nm"] = (0.02 * size * draw_direction(rng)).round(3).tolist()
    if rng.random() < 0.5:
        force["ramp_mm"] = round(float(rng.uniform(1.0, 10.0)), 2)
    return force


def draw_direction(rng: np.random.Generator) -> Array:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def reach_of(arm: Arm) -> float:
    """Return the sum of the arm's links, rails left out. [m]"""
    return float(sum(np.linalg.norm(joint.pose[:3, 3]) for joint in arm.joints if not joint.slides))


def turn_of(rotation: Array) -> Array:
    """Return the rotation vector. Shape (3,). [deg]"""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(degrees=True))
