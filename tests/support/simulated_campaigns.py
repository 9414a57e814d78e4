"""Campaigns for tests: a small robot of our own, poses, loads and order from a seed, and effects put in exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.effects import Effect, apply_effects, build_model, solve_model_poses
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot
from compplan.robot.folder import read_robot_folder

SIGMA = 2e-5
LINKS = (
    # joint, origin xyz, axis, lower, upper, mass of its link, centre of mass, compliance
    ("joint_1", (0, 0, 0.5), (0, 0, 1), -2.5, 2.5, 150, (0.1, 0, 0.1), 5e-7),
    ("joint_2", (0.2, 0, 0.1), (0, 1, 0), -0.7, 1.3, 90, (0, 0.1, 0.4), 4e-7),
    ("joint_3", (0, 0, 0.9), (0, 1, 0), -1.4, 1.4, 70, (0.2, 0, 0.05), 6e-7),
    ("joint_4", (0.7, 0, 0.05), (1, 0, 0), -3, 3, 20, (0.05, 0, 0), 3e-6),
    ("joint_5", (0.2, 0, 0), (0, 1, 0), -1.9, 1.9, 10, (0.05, 0, 0), 3e-6),
    ("joint_6", (0.1, 0, 0), (1, 0, 0), -3, 3, 5, (0.02, 0, 0), 4e-6),
)


def write_small_robot(folder: Path, *, gravity: bool = True, joints: int = 6) -> Robot:
    """Write and read the folder of a six-axis arm of 1.9 m reach, or of its first joints alone."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = ['<robot name="small"><link name="world"/><link name="base_link"/>']
    parts.append('<joint name="base_fixed" type="fixed"><parent link="world"/><child link="base_link"/></joint>')
    parent = "base_link"
    springs = []
    for name, xyz, axis, lower, upper, mass, centre, compliance in LINKS[:joints]:
        child = name.replace("joint", "link")
        inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        parts.append(
            f'<link name="{child}"><inertial><origin xyz="{_text(centre)}"/><mass value="{mass}"/>'
            f"{inertia}</inertial></link>"
        )
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{_text(xyz)}"/>'
            f'<axis xyz="{_text(axis)}"/><limit lower="{lower}" upper="{upper}" velocity="2" effort="5000"/></joint>'
        )
        springs.append(f'[[spring]]\njoint = "{name}"\naxis = "own"\ncompliance = {compliance}\n')
        parent = child
    parts.append(
        f'<link name="flange"/><joint name="flange_fixed" type="fixed"><parent link="{parent}"/><child link="flange"/>'
    )
    parts.append('<origin xyz="0.08 0 0"/></joint><link name="tool0"/><joint name="tool_fixed" type="fixed">')
    parts.append('<parent link="flange"/><child link="tool0"/><origin xyz="0.15 0 0.1" rpy="0 1.2 0"/></joint></robot>')
    (folder / "robot.urdf").write_text("\n".join(parts))
    head = 'schema = 1\ntcp = "tool0"\nflange = "flange"\n' + ("gravity = [0.0, 0.0, -9.81]\n" if gravity else "")
    (folder / "elasticity.toml").write_text(head + "\n".join(springs))
    return read_robot_folder(folder)


def _text(values: Sequence[float]) -> str:
    return " ".join(str(v) for v in values)


def plan_rows(
    robot: Robot, seed: int, *, poses: int = 45, loads: int = 2, path: int = 0, region: float = 0.8, force: float =
        600.0,
    runs: int = 2,
) -> Campaign:  # fmt: skip
    """Plan the rows of a campaign: poses, each unloaded and under loads, in runs, and a path at the end."""
    random = np.random.default_rng(seed)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    each = middle + region * half * random.uniform(-1, 1, (poses, robot.nq))
    q = np.repeat(each, loads + 1, axis=0)
    wrench = np.concatenate([random.normal(0, force, (len(q), 3)), random.normal(0, force / 8, (len(q), 3))], axis=1)
    wrench[:: loads + 1] = 0.0
    run = np.array([f"static_{1 + k * runs // poses}" for k in range(poses) for _ in range(loads + 1)])
    time = np.arange(len(q)) * 20.0
    if path:
        phase = np.linspace(0, 4 * np.pi, path)[:, None]
        track = middle + 0.2 * half * np.sin(phase * np.array([1.0, 2, 1, 3, 1, 2])[: robot.nq] + np.arange(robot.nq))
        q, wrench = np.vstack([q, track]), np.vstack([wrench, np.zeros((path, 6))])
        run = np.r_[run, ["path_1"] * path]
        time = np.r_[time, time[-1] + 60 + 0.05 * np.arange(path)]
    nowhere = np.zeros((len(q), 3))
    return Campaign(run=run, q=q, wrench=wrench, position=nowhere, time=time, sigma=np.full(len(q), SIGMA))


def measure(
    robot: Robot, rows: Campaign, effects: Sequence[Effect], seed: int, *, orientation: bool = True,
    encoders: bool = False, sigma: float = SIGMA,
) -> Campaign:  # fmt: skip
    """Measure planned rows on a robot with effects."""
    random = np.random.default_rng(seed + 1000)
    attained = solve_model_poses(apply_effects(build_model(robot, rows), effects))
    position = attained.position + random.normal(0, sigma, attained.position.shape)
    link = attained.link + random.normal(0, 5e-6, rows.q.shape) if encoders else None
    rotation = None
    if orientation:
        rotation = Rotation.from_rotvec(random.normal(0, 1e-4, position.shape)).as_matrix() @ attained.rotation
    return replace(rows, position=position, rotation=rotation, link=link)
