"""Read a job's robot and tool, and the joints.csv that a plan wrote; everything in SI and base axes."""

from __future__ import annotations

import csv
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.simulated_robot.robot import Arm, Array, mount_tool, read_arm

ROBOTS = Path(__file__).resolve().parents[2] / "robots"
WRENCH = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")


@dataclass(frozen=True)
class Job:
    """A job: its table, and the arm with the job's tool."""

    file: Path
    table: dict
    arm: Arm


@dataclass(frozen=True)
class Rows:
    """joints.csv: time, commanded joints, wanted tip and tool axis, predicted wrench; `move` where the file says it."""

    time: Array
    q: Array
    wanted: Array
    axis: Array
    wrench: Array
    move: np.ndarray | None

    def __len__(self) -> int:
        return len(self.time)


def read_job(file: Path) -> Job:
    """Read a job file and the robot folder that it names."""
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    name = table["robot"]
    folder = next(p for p in (file.parent / name, ROBOTS / name) if (p / "robot.urdf").is_file())
    return Job(file, table, mount_tool(read_arm(folder), table.get("tool")))


def read_joints(file: Path, arm: Arm) -> Rows:
    """Read joints.csv."""
    with file.open(encoding="utf-8", newline="") as stream:
        lines = csv.reader(stream)
        header = next(lines)
        body = list(lines)
    words = header.index("move") if "move" in header else None
    move = None if words is None else np.array([row[words] for row in body])
    numbers = {name: np.array([float(row[k]) for row in body]) for k, name in enumerate(header) if k != words}
    joints = []
    for k, joint in enumerate(arm.commanded, start=1):
        joints.append(numbers[f"q{k}_mm"] * 1e-3 if joint.slides else np.radians(numbers[f"q{k}_deg"]))
    return Rows(
        numbers["time_s"],
        np.stack(joints, axis=1),
        np.stack([numbers[f"{c}_mm"] for c in "xyz"], axis=1) * 1e-3,
        np.stack([numbers[c] for c in "ijk"], axis=1),
        np.stack([numbers[c] for c in WRENCH], axis=1),
        move,
    )
