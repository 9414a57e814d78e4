"""Draw jobs nobody wrote: any shipped robot, tool, place, path, force and wish, each from a seed.

    python -m benchmarks plan_check --out DIR --drawn 40 [--seed 0]

The part stands where some posture in the middle of the joints' ranges holds the tool, so that most of a path can be
followed; whether it all can is for the planner to say. Every answer but a wrong one will do: "solved" is judged.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.plan_check.cell import Kinematics
from benchmarks.plan_check.job import ROBOTS
from benchmarks.plan_check.paths import write_toolpath
from benchmarks.plan_check.robot import Arm, Array, mount_tool, read_arm, rotation_vector

#: Share of each joint's range, in its middle, that the first posture is drawn from; the most of it about a free joint.
MIDDLE, WIDEST = 0.6, np.radians(120.0)
#: Height of the tip over the base, and distance from its axis, in reaches of the arm.
HEIGHT, DISTANCE = (-0.1, 0.6), (0.35, 0.8)


def write_drawn(folder: Path, seed: int) -> Path:
    """Write one drawn job and its toolpath; return the job file."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    name = f"drawn_{seed}"
    while True:
        robot = str(rng.choice(sorted(p.parent.name for p in ROBOTS.glob("*/robot.urdf"))))
        tool = draw_tool(rng, read_arm(ROBOTS / robot))
        arm = mount_tool(read_arm(ROBOTS / robot), tool)
        posture = draw_posture(rng, arm)
        if posture is not None:
            pose = posture[1]
            break
    size = float(rng.uniform(0.03, 0.2)) * reach_of(arm) * 1e3
    tip, axis, feed = _draw_path(rng, size)
    write_toolpath(folder / f"{name}.csv", tip, feed, axis, lift=float(rng.uniform(5.0, 60.0)))
    rotation = turn_of(pose[:3, :3] @ np.diag([1.0, -1.0, -1.0]))  # the tool axis points back to the spindle: -z
    job = {
        "schema": 1, "name": name, "robot": robot, "toolpath": f"{name}.csv",
        "part": {"position_mm": (1e3 * pose[:3, 3]).round(3).tolist(), "rotation_deg": rotation.round(6).tolist(),
                 "touched_off": False},
        "tool": tool, "process": draw_force(rng, arm, pose), "plan": _draw_wishes(rng),
    }  # fmt: skip
    if rng.random() < 0.3:
        job["posture"] = {"preset": str(rng.choice(["accurate", "smooth", "fast"]))}
        if rng.random() < 0.3:
            job["posture"] |= {"lead_deg": 10.0, "lean_deg": 10.0}
    (folder / f"{name}.toml").write_text(tomli_w.dumps(job), encoding="utf-8")
    return folder / f"{name}.toml"


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


def _draw_path(rng: np.random.Generator, size: float) -> tuple[Array, Array, float]:
    """Draw tips [mm], tool axes and feed [mm/s] of a path as large as `size` [mm] about the part's origin."""
    n = int(rng.integers(30, 400))
    share = np.linspace(0.0, 1.0, n)
    kind = rng.choice(["circle", "wave", "corners", "helix", "line"])
    if kind == "circle":
        angle = 2.0 * np.pi * share
        tip = 0.5 * size * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    elif kind == "wave":
        tip = np.stack([size * (share - 0.5), 0.1 * size * np.sin(12.0 * share), 0.05 * size * np.cos(9.0 * share)], 1)
    elif kind == "helix":
        angle = 2.0 * np.pi * float(rng.uniform(1.0, 6.0)) * share
        tip = 0.5 * size * np.stack([np.cos(angle), np.sin(angle), -0.5 * share], axis=1)
    elif kind == "line":
        tip = size * (share - 0.5)[:, None] * draw_direction(rng) * np.array([1.0, 1.0, 0.2])
    else:
        corners = 0.5 * size * rng.uniform(-1.0, 1.0, (int(rng.integers(3, 8)), 3)) * np.array([1.0, 1.0, 0.1])
        along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))]
        at = np.union1d(along, np.linspace(0.0, along[-1], n))
        tip = np.stack([np.interp(at, along, column) for column in corners.T], axis=1)
    tilt = np.radians(float(rng.choice([0.0, 0.0, 10.0, 25.0]))) * np.sin(2.0 * np.pi * np.linspace(0, 1, len(tip)))
    axis = np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], axis=1)
    return tip, axis, float(rng.uniform(5.0, 120.0))


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


def _draw_wishes(rng: np.random.Generator) -> dict:
    wishes = {"strategy": "nlp", "tolerance_mm": float(rng.choice([0.02, 0.1, 0.3]))}
    if rng.random() < 0.2:
        wishes["inertia"] = False  # held at rest, as `paths.leave_inertia`; the draw keeps its order
    return wishes


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
