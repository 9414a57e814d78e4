"""Draw ordinary jobs for an arm in motion: short paths within reach, at feeds of three ranges."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.simulated_robot.cell import Kinematics
from benchmarks.simulated_robot.drawn import (
    draw_direction,
    draw_force,
    draw_posture,
    draw_tool,
    reach_of,
    turn_of,
    write_toolpath,
)
from benchmarks.simulated_robot.job import ROBOTS
from benchmarks.simulated_robot.robot import Arm, Array, mount_tool, read_arm

#: Feeds [mm/s], one range a job in turn; how long a cut takes at most [s]; its size in reaches of the arm.
FEEDS, DURATION, SIZE = ((6.0, 25.0), (25.0, 90.0), (90.0, 350.0)), (2.0, 5.0), (0.03, 0.15)
#: Distance between waypoints [mm], the fewest and the most.
SPACING, FEWEST, MOST = 1.0, 200, 400
#: Share of the jobs whose robot's compliances somebody has published or scaled; the others take any shipped robot.
PUBLISHED = 0.6
#: Share of the jobs whose robot is one that somebody has calibrated and identified.
CALIBRATED = 0.5
#: Least distance from joint limits that makes a job an ordinary one, and its share of a force that a joint just bears.
FREE, EASY = np.radians(3.0), 0.4
#: Tolerance [mm], powers of ten.
TOLERANCE = (-0.7, 0.7)


def write_job(folder: Path, seed: int, *, inertia: bool = True) -> Path:
    """Write one job, its toolpath beside it, and return the job file. It is redrawn until the arm reaches all of it."""
    rng = np.random.default_rng([seed, 26])
    folder.mkdir(parents=True, exist_ok=True)
    name, feed = f"moving_{seed}", float(np.exp(rng.uniform(*np.log(FEEDS[seed % len(FEEDS)]))))
    while True:
        robot = _draw_robot(rng)
        tool = draw_tool(rng, read_arm(ROBOTS / robot))
        arm = mount_tool(read_arm(ROBOTS / robot), tool)
        posture = draw_posture(rng, arm)
        if posture is None:
            continue
        tip, axis = _draw_path(rng, feed * float(rng.uniform(*DURATION)), 1e3 * reach_of(arm))
        if _is_reached(arm, *posture, tip, axis):
            break
    pose = posture[1]
    write_toolpath(folder / f"{name}.csv", tip, feed, axis, lift=float(rng.uniform(5.0, 60.0)))
    rotation = turn_of(pose[:3, :3] @ np.diag([1.0, -1.0, -1.0]))  # the tool axis points back to the spindle: -z
    force = draw_force(rng, arm, pose)
    for key in force.keys() & {"force_N", "moment_Nm"}:
        force[key] = [round(EASY * value, 3) for value in force[key]]
    if rng.random() < CALIBRATED:
        robot = _calibrate(folder, robot)
    table = {
        "schema": 1, "name": name, "robot": robot, "toolpath": f"{name}.csv",
        "part": {"position_mm": (1e3 * pose[:3, 3]).round(3).tolist(), "rotation_deg": rotation.round(6).tolist(),
                 "touched_off": False},
        "tool": tool, "process": force,
        "plan": {"tolerance_mm": round(float(10 ** rng.uniform(*TOLERANCE)), 3), "inertia": inertia},
    }  # fmt: skip
    (folder / f"{name}.toml").write_text(tomli_w.dumps(table), encoding="utf-8")
    return folder / f"{name}.toml"


def _draw_robot(rng: np.random.Generator) -> str:
    """Draw a shipped robot."""
    robots = sorted(p.parent for p in ROBOTS.glob("*/robot.urdf"))
    if rng.random() < PUBLISHED:
        tables = {p: tomllib.loads((p / "elasticity.toml").read_text(encoding="utf-8")) for p in robots}
        robots = [p for p in robots if tables[p].get("grade", "placeholder") != "placeholder"]
    return robots[int(rng.integers(len(robots)))].name


def _calibrate(folder: Path, robot: str) -> str:
    """Write a robot's folder beside the job, graded as identified: narrow widths. Return its name there."""
    name = f"identified_{robot}"
    shutil.copytree(ROBOTS / robot, folder / name, dirs_exist_ok=True)
    file = folder / name / "elasticity.toml"
    text = file.read_text(encoding="utf-8")
    text = re.sub(r'(?m)^grade\s*=\s*"[a-z]+"', 'grade = "identified"', text)
    file.write_text(text, encoding="utf-8")
    return name


def _draw_path(rng: np.random.Generator, length: float, reach: float) -> tuple[Array, Array]:
    """Draw tips [mm] and tool axes of a path so long at most, about the part's origin."""
    size = float(rng.uniform(*SIZE)) * reach
    share = np.linspace(0.0, 1.0, 4001)
    kind, angle = str(rng.choice(["circle", "wave", "corners", "helix", "line"])), 12.0 * np.pi * share
    if kind == "circle":
        tip = 0.5 * size * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    elif kind == "helix":
        tip = 0.5 * size * np.stack([np.cos(angle), np.sin(angle), -0.1 * angle], axis=1)
    elif kind == "wave":
        along = 2.0 * size * np.sin(np.pi * (share - 0.5))
        tip = np.stack([along, 0.2 * size * np.sin(2.0 * angle), 0.1 * size * np.cos(1.5 * angle)], axis=1)
    elif kind == "line":
        tip = 2.0 * size * (share - 0.5)[:, None] * draw_direction(rng) * np.array([1.0, 1.0, 0.2])
    else:
        corner = 0.5 * size * rng.uniform(-1.0, 1.0, (20, 3)) * np.array([1.0, 1.0, 0.1])
        way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corner, axis=0), axis=1))]
        at = np.union1d(way, np.linspace(0.0, way[-1], 4001))
        tip = np.stack([np.interp(at, way, column) for column in corner.T], axis=1)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))]
    end = min(length, float(way[-1]))
    at = np.linspace(0.0, end, int(np.clip(end / SPACING, FEWEST, MOST)))
    if kind == "corners":
        own = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(corner, axis=0), axis=1))]
        apart = np.abs(at[:, None] - own).min(axis=1) > 0.1 * (at[1] - at[0])
        at = np.unique(np.r_[at[apart], 0.0, own[own < end], end])
    tip = np.stack([np.interp(at, way, column) for column in tip.T], axis=1)
    tip -= 0.5 * (tip.min(axis=0) + tip.max(axis=0))
    tilt = np.radians(float(rng.choice([0.0, 0.0, 10.0]))) * np.sin(2.0 * np.pi * np.linspace(0, 1, len(tip)))
    return tip, np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], axis=1)


def _is_reached(arm: Arm, q: Array, pose: Array, tip: Array, axis: Array) -> bool:
    """Tell whether the arm follows the whole path from a posture, clear of the joint limits, by this file's own look.

    The rotation about the tool axis stays; the path is in the frame of the part, whose z is the tool axis.
    """
    part = pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    wanted = np.tile(np.eye(4), (len(tip), 1, 1))
    wanted[:, :3, 3] = pose[:3, 3] + 1e-3 * tip @ part.T
    for k, (x, _, z) in enumerate(axis):
        turn = np.array([[z, 0.0, x], [0.0, 1.0, 0.0], [-x, 0.0, z]])
        wanted[k, :3, :3] = part @ turn @ np.diag([1.0, -1.0, -1.0])
    few = np.unique(np.linspace(0, len(tip) - 1, 40).astype(int))
    found, left = Kinematics(arm).reach(np.tile(q, (len(few), 1)), wanted[few], rounds=20)
    low, high = (np.array([getattr(joint, name) for joint in arm.commanded]) for name in ("lower", "upper"))
    free = np.where([joint.slides for joint in arm.commanded], 0.0, FREE)
    return bool((left < 1e-9).all() and (found > low + free).all() and (found < high - free).all())
