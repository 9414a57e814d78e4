"""Read a job, the CAM path that it means, and the joints.csv that a plan wrote; everything in SI and base axes."""

from __future__ import annotations

import csv
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.plan_check.robot import Arm, Array, mount_tool, pose_of, read_arm, said_rotation

ROBOTS = Path(__file__).resolve().parents[2] / "robots"
WRENCH = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
CHORD = 1e-6


@dataclass(frozen=True)
class Path3:
    """A CAM path: vertices, and of the move that ends at each its feed and whether it is rapid; base frame.

    `wrench` holds the columns of the file in base axes, or None.
    """

    position: Array
    axis: Array
    feed: Array
    rapid: np.ndarray
    wrench: Array | None

    @property
    def arc(self) -> Array:
        return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(self.position, axis=0), axis=1))]

    @property
    def cut_arc(self) -> Array:
        """Length cut up to each vertex."""
        steps = np.linalg.norm(np.diff(self.position, axis=0), axis=1)
        return np.r_[0.0, np.cumsum(np.where(self.rapid[1:], 0.0, steps))]


@dataclass(frozen=True)
class Job:
    """A job as the check understands it."""

    file: Path
    table: dict
    arm: Arm
    path: Path3
    R_base_part: Array
    T_base_part: Array

    @property
    def plan(self) -> dict:
        return self.table.get("plan", {})

    @property
    def tolerance(self) -> float:
        return self.plan.get("tolerance_mm", 0.1) * 1e-3

    @property
    def most_correction(self) -> float:
        return self.plan.get("max_correction_mm", 10.0) * 1e-3


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
    """Read a job file and all that it refers to."""
    table = tomllib.loads(file.read_text(encoding="utf-8"))
    name = table["robot"]
    folder = next(p for p in (file.parent / name, ROBOTS / name) if (p / "robot.urdf").is_file())
    part = table.get("part", {})
    turn = said_rotation(part)
    place = pose_of(turn, np.array(part.get("position_mm", [0.0, 0.0, 0.0])) * 1e-3)
    columns = _toolpath(file, table)
    position = columns["tip"] @ turn.T + place[:3, 3]
    axis = columns["axis"] / np.linalg.norm(columns["axis"], axis=1, keepdims=True)
    wrench = columns.get("wrench")
    if wrench is not None:
        wrench = np.hstack([wrench[:, :3] @ turn.T, wrench[:, 3:] @ turn.T])
    feed, rapid = columns["feed"], columns["rapid"].astype(bool)
    constant = table.get("feed", {}).get("constant_mm_s")
    if constant is not None:
        feed = np.where(rapid, feed, constant * 1e-3)
    path = Path3(position, axis @ turn.T, feed, rapid, wrench)
    return Job(file, table, mount_tool(read_arm(folder), table.get("tool")), path, turn, place)


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


def _toolpath(file: Path, table: dict) -> dict[str, Array]:
    """Return tip [m], axis, feed [m/s], rapid and perhaps wrench of the toolpath in the part frame."""
    source = table["toolpath"]
    if isinstance(source, dict):
        return _generate(source)
    path = file.parent / source
    if path.suffix == ".csv":
        return _read_csv(path)
    return _read_gcode(path)


def _read_csv(path: Path) -> dict[str, Array]:
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    n = len(rows)

    def column(name: str, default: float | None = None) -> Array:
        if name not in rows[0]:
            assert default is not None, f"{path}: no column {name}"
            return np.full(n, default)
        return np.array([float(row[name] or 0) for row in rows])

    found = {
        "tip": np.stack([column(f"{c}_mm") for c in "xyz"], axis=1) * 1e-3,
        "axis": np.stack([column("i", 0.0), column("j", 0.0), column("k", 1.0)], axis=1),
        "feed": column("feed_mm_s", 0.0) * 1e-3,
        "rapid": column("rapid", 0.0),
    }
    if "fx_N" in rows[0]:
        found["wrench"] = np.stack([column(name, 0.0) for name in WRENCH], axis=1)
    return found


def _read_gcode(path: Path) -> dict[str, Array]:
    """Follow G0 G1 G2 G3, G20 G21, G90 G91, X Y Z, I J and F; refuse what is more."""
    at, feed, motion, scale, absolute = np.zeros(3), 0.0, 0, 1e-3, True
    tips, feeds, rapids = [at], [0.0], [True]
    for line in path.read_text(encoding="utf-8").splitlines():
        words = re.findall(r"([A-Z])\s*([-+.\d]+)", re.sub(r"\(.*?\)|;.*", "", line.upper()))
        values = {}
        for letter, number in words:
            if letter == "G":
                code = float(number)
                if code in (0, 1, 2, 3):
                    motion = int(code)
                elif code in (20, 21):
                    scale = 25.4e-3 if code == 20 else 1e-3
                elif code in (90, 91):
                    absolute = code == 90
                elif code != 17:
                    raise ValueError(f"{path}: G{number} is not read here")
            else:
                values[letter] = float(number)
        feed = values["F"] * scale / 60.0 if "F" in values else feed
        if not values.keys() & set("XYZ"):
            continue
        target = at.copy()
        for k, letter in enumerate("XYZ"):
            if letter in values:
                target[k] = values[letter] * scale + (0.0 if absolute else at[k])
        centre = np.array([values.get("I", 0.0), values.get("J", 0.0)]) * scale
        points = [target] if motion < 2 else _arc(at, target, centre, motion)
        for point in points:
            if np.linalg.norm(point - tips[-1]) > 0:
                tips.append(point)
                feeds.append(0.0 if motion == 0 else feed)
                rapids.append(motion == 0)
        at = target
    return {
        "tip": np.array(tips),
        "axis": np.tile([0.0, 0, 1], (len(tips), 1)),
        "feed": np.array(feeds),
        "rapid": np.array(rapids, float),
    }


def _arc(start: Array, end: Array, to_centre: Array, motion: int) -> list[Array]:
    centre = start[:2] + to_centre
    radius = float(np.linalg.norm(to_centre))
    first, last = (np.arctan2(*(p[:2] - centre)[::-1]) for p in (start, end))
    sweep = (last - first) % (2 * np.pi) if motion == 3 else -((first - last) % (2 * np.pi))
    sweep = sweep or 2 * np.pi * (1 if motion == 3 else -1)
    pieces = int(np.ceil(abs(sweep) / (2 * np.sqrt(2 * CHORD / radius)))) + 1
    share = np.linspace(0, 1, pieces + 1)[1:]
    angle = first + share * sweep
    z = start[2] + share * (end[2] - start[2])
    points = np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle), z], axis=1)
    points[-1] = end
    return list(points)


def _generate(table: dict) -> dict[str, Array]:
    """Put waypoints at equal distances on a circle, a planar spiral or a helix on a cone."""
    kind = table["generator"]
    centre = np.array(table.get("centre_mm", [0.0, 0, 0])) * 1e-3
    if kind == "circle":
        turns, start = table.get("turns", 1.0), np.radians(table.get("start_deg", 0.0))
        first, second = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}[table.get("plane", "xy")]
        angle = start + np.sign(turns) * np.linspace(0, 2 * np.pi * abs(turns), 200001)
        fine = np.tile(centre, (len(angle), 1))
        fine[:, first] += table["radius_mm"] * 1e-3 * np.cos(angle)
        fine[:, second] += table["radius_mm"] * 1e-3 * np.sin(angle)
    elif kind == "spiral":
        inner, outer = table.get("inner_radius_mm", 0.0) * 1e-3, table["outer_radius_mm"] * 1e-3
        turns = table.get("turns") or _spiral_turns(inner, outer, table["length_mm"] * 1e-3)
        fine = _spiral(inner, outer, turns) + centre
    elif kind == "isf_cone" and table.get("path", "helical") == "helical":
        radius, depth = table["diameter_mm"] * 0.5e-3, table["depth_mm"] * 1e-3
        down = np.linspace(0, depth, 2000001)
        angle = 2 * np.pi * down / (table["pitch_mm"] * 1e-3)
        r = radius - down / np.tan(np.radians(table["wall_angle_deg"]))
        fine = np.stack([r * np.cos(angle), r * np.sin(angle), -down], axis=1)
    else:
        raise ValueError(f"generator {kind} is not read here")
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))]
    feed = table["feed_mm_s"] * 1e-3 if "feed_mm_s" in table else length[-1] / table["duration_s"]
    if "waypoints" in table:
        count = table["waypoints"]
    elif "rate_hz" in table:
        count = round(length[-1] / feed * table["rate_hz"])
    else:
        count = 1 + round(length[-1] / (table["step_mm"] * 1e-3))
    where = np.linspace(0, length[-1], max(2, count))
    tip = np.stack([np.interp(where, length, column) for column in fine.T], axis=1)
    axis = np.array(table.get("axis", [0.0, 0, 1]), float)
    axis /= np.linalg.norm(axis)
    rapid = np.zeros(len(tip))
    lift = table.get("approach_mm", 0.0) * 1e-3
    if lift:
        tip = np.vstack([tip[0] + lift * axis, tip, tip[-1] + lift * axis])
        rapid = np.r_[1.0, 1.0, rapid[1:], 1.0]
    return {"tip": tip, "axis": np.tile(axis, (len(tip), 1)), "feed": np.where(rapid > 0, 0.0, feed), "rapid": rapid}


def _spiral(inner: float, outer: float, turns: float) -> Array:
    angle = np.linspace(0, 2 * np.pi * turns, 400001)
    r = inner + (outer - inner) * angle / angle[-1]
    return np.stack([r * np.cos(angle), r * np.sin(angle), 0 * angle], axis=1)


def _spiral_turns(inner: float, outer: float, length: float) -> float:
    low, high = 1e-3, length / (np.pi * (inner + outer)) + 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        reached = np.linalg.norm(np.diff(_spiral(inner, outer, middle), axis=0), axis=1).sum()
        low, high = (middle, high) if reached < length else (low, middle)
    return 0.5 * (low + high)
