"""Write the own jobs of the check: job files, the toolpaths that they follow, and robots that are not shipped."""

from __future__ import annotations

import itertools
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import tomli_w

from benchmarks.plan_check.job import ROBOTS
from benchmarks.plan_check.mistakes import MISTAKES
from benchmarks.plan_check.robot import Array

JOBS = Path(__file__).parent / "jobs"
#: Robots without gravity in their folder: place of the part, and whether z (or x) leads out of the flange.
HEAVY = {
    "fanuc_m10ia": ([800.0, 0.0, 150.0], "x"),
    "kuka_kr120_r3900": ([2000.0, 0.0, 900.0], "x"),
    "kuka_kr240": ([1700.0, 0.0, 700.0], "x"),
    "kuka_kr240_rail": ([1900.0, 2000.0, 1200.0], "x"),
    "kuka_kr270": ([1700.0, 0.0, 800.0], "x"),
    "kuka_kr270_full": ([1700.0, 0.0, 800.0], "x"),
    "staubli_tx200": ([1400.0, 0.0, 300.0], "z"),
}


def write_jobs(folder: Path) -> dict[str, Path]:
    """Write every own job into a folder; return the job files by name."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in JOBS.glob("*.toml"):
        shutil.copy(file, folder / file.name)
    template = (JOBS / "heavy_tool.txt").read_text(encoding="utf-8")
    for robot, (place, out) in HEAVY.items():
        along = [200.0, 0.0, 0.0] if out == "x" else [0.0, 0.0, 200.0]
        text = template.format(
            robot=robot, place=place, tip=along, turn=[0.0, 90.0, 0.0] if out == "x" else [0.0, 0.0, 0.0],
            centre=[0.5 * value for value in along], force=100.0 if robot.startswith("fanuc") else 300.0,
        )  # fmt: skip
        (folder / f"heavy_{robot}.toml").write_text(text, encoding="utf-8")
    template = (JOBS / "mistake.txt").read_text(encoding="utf-8")
    for name, (mistake, _) in MISTAKES.items():
        (folder / f"{name}.toml").write_text(template.format(mistake=mistake), encoding="utf-8")
    for name, make in TOOLPATHS.items():
        write_toolpath(folder / name, *make())
    _write_slab(folder / "slab.stl")
    _vary_robot("kuka_kr240_rail", folder / "robots" / "rail_gravity", gravity=True)
    _vary_robot("staubli_tx200", folder / "robots" / "absurd_springs", softer=1e4)
    for robot in ("seven_axis", "parallelogram"):
        shutil.copytree(JOBS / "robots" / robot, folder / "robots" / robot, dirs_exist_ok=True)
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}


def leave_inertia(file: Path) -> Path:
    """Let a job leave the inertia of the motion alone, unless it asks for it: the cell holds the arm at rest.

    Its part frame is absolute, as the cell's is.
    """
    job = tomllib.loads(file.read_text(encoding="utf-8"))
    job.setdefault("plan", {}).setdefault("inertia", False)
    job.setdefault("part", {}).setdefault("touched_off", False)
    file.write_text(tomli_w.dumps(job), encoding="utf-8")
    return file


def write_toolpath(file: Path, tip: Array, feed: float, axis: Array | None = None, lift: float = 50.0) -> None:
    """Write a toolpath [mm, mm/s]: a rapid to above its start and down, the cut, and a rapid up."""
    axes = np.tile([0.0, 0.0, 1.0], (len(tip), 1)) if axis is None else axis
    rows = [(tip[0] + lift * axes[0], axes[0], 0.0, 1), (tip[0], axes[0], 0.0, 1)]
    rows += [(tip[k], axes[k], feed, 0) for k in range(1, len(tip))]
    rows.append((tip[-1] + lift * axes[-1], axes[-1], 0.0, 1))
    lines = ["x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid"]
    lines += [",".join(f"{v:.9g}" for v in (*p, *a, f)) + f",{r}" for p, a, f, r in rows]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _line(start: list[float], end: list[float], count: int) -> Array:
    return np.linspace(np.array(start), np.array(end), count)


def _zigzag() -> tuple[Array, float]:
    """Six lines of 160 mm, 20 mm apart, with square corners; a point every 4 mm."""
    corners = []
    for k in range(6):
        ends = [-80.0, 80.0] if k % 2 == 0 else [80.0, -80.0]
        corners += [[x, 20.0 * k - 50.0, 0.0] for x in ends]
    pieces = [np.array(corners[:1])]
    for a, b in itertools.pairwise(corners):
        count = int(np.linalg.norm(np.subtract(b, a)) / 4.0)
        pieces.append(_line(a, b, count + 1)[1:])
    return np.vstack(pieces), 60.0


def _wave() -> tuple[Array, float]:
    x = np.linspace(-150.0, 150.0, 301)
    return np.stack([x, 25.0 * np.sin(2 * np.pi * x / 60.0), 0 * x], axis=1), 150.0


def _out_and_back() -> tuple[Array, float]:
    angle = np.radians(np.linspace(-50.0, 50.0, 176))
    out = np.stack([200.0 * np.cos(angle) - 200.0, 200.0 * np.sin(angle), 0 * angle], axis=1)
    return np.vstack([out, out[-2::-1]]), 40.0


def _five_axis() -> tuple[Array, float, Array]:
    share = np.linspace(0.0, 1.0, 51)
    tip = np.stack([60.0 * np.sin(2 * np.pi * share), 400.0 * (share - 0.5), 15.0 * np.cos(4 * np.pi * share)], axis=1)
    tilt, turn = np.radians(30.0) * np.sin(2 * np.pi * share), 2 * np.pi * share
    axis = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    return tip, 25.0, axis


def _rail() -> tuple[Array, float, Array]:
    y = np.linspace(0.0, 3000.0, 20000)
    tip = np.stack([80.0 * np.sin(2 * np.pi * y / 400.0), y, 20.0 * np.sin(2 * np.pi * y / 750.0)], axis=1)
    tilt = np.radians(20.0) * np.sin(2 * np.pi * y / 600.0)
    return tip, 50.0, np.stack([np.sin(tilt), 0 * tilt, np.cos(tilt)], axis=1)


def _circle() -> tuple[Array, float]:
    angle = np.linspace(0.0, 2 * np.pi, 126)
    return np.stack([100.0 * np.cos(angle), 100.0 * np.sin(angle), 0 * angle], axis=1), 40.0


TOOLPATHS = {
    "three_points.csv": lambda: (np.array([[-100.0, -300.0, 0.0], [0.0, 0.0, 0.0], [100.0, 300.0, 0.0]]), 50.0),
    "long_line_45.csv": lambda: (_line([0.0, -600.0, 0.0], [0.0, 600.0, 0.0], 13), 50.0),
    "short_line.csv": lambda: (_line([0.0, -50.0, 0.0], [0.0, 50.0, 0.0], 51), 20.0),
    "singularity.csv": lambda: (
        _line([0.0, -150.0, 0.0], [0.0, 150.0, 0.0], 301), 20.0, np.tile([-1.0, 0.0, 0.0], (301, 1)),
    ),
    "zigzag.csv": _zigzag,
    "wave.csv": _wave,
    "out_and_back.csv": _out_and_back,
    "five_axis.csv": _five_axis,
    "rail.csv": _rail,
    "circle_csv.csv": _circle,
}  # fmt: skip


def _write_slab(file: Path) -> None:
    """Write a slab of 300 x 300 x 20 mm, 80 mm above the cut: through the spindle, below the flange."""
    import trimesh

    place = trimesh.transformations.translation_matrix((0.0, 0.0, 90.0))
    trimesh.creation.box((300.0, 300.0, 20.0), place).export(file)


def _vary_robot(name: str, folder: Path, *, gravity: bool = False, softer: float = 1.0) -> None:
    """Copy a shipped robot with the weight of its parts loading the springs, or with softer springs."""
    shutil.copytree(ROBOTS / name, folder, dirs_exist_ok=True)
    file = folder / "elasticity.toml"
    text = file.read_text(encoding="utf-8")
    if gravity:
        text = re.sub(r"^tcp ", "gravity = [0.0, 0.0, -9.81]\ntcp ", text, count=1, flags=re.MULTILINE)
    if softer != 1.0:
        text = re.sub(r"^(compliance = )(\S+)", lambda m: f"{m[1]}{softer * float(m[2])!r}", text, flags=re.MULTILINE)
    file.write_text(text, encoding="utf-8")
