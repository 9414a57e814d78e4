"""Twelve jobs that leave the arm a choice: rails, free spin, leans, and corners in a tube of tolerance."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PUSH = {"model": "constant", "force_N": [200.0, 100.0, 300.0], "frame": "base"}
LIGHT = {"model": "constant", "force_N": [10.0, 5.0, 20.0], "frame": "base"}
ALONG = {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"}
OFFSET = {"position_mm": [0.0, 0.0, 300.0], "abc_deg": [0.0, 30.0, 0.0], "mass_kg": 8.0}
SPINDLE = {"position_mm": [320.0, 0.0, 0.0], "rotation_deg": [0.0, 90.0, 0.0], "mass_kg": 24.0,
           "centre_of_mass_mm": [140.0, 0.0, 0.0]}  # fmt: skip
LEANING = {"lead_deg": 10.0, "lean_deg": 10.0}


def _circle(radius: float, feed: float, **more: float) -> dict[str, Any]:
    return {"generator": "circle", "radius_mm": radius, "feed_mm_s": feed, "waypoints": 110, **more}


def _cone(diameter: float, feed: float, step: float) -> dict[str, Any]:
    return {"generator": "isf_cone", "diameter_mm": diameter, "depth_mm": 40.0, "wall_angle_deg": 60.0,
            "pitch_mm": 20.0, "feed_mm_s": feed, "step_mm": step}  # fmt: skip


def _wave(length: float, height: float, waves: float, dome: float = 0.0) -> Array:
    """Return a wave along y that may climb over a dome. Shape (160, 3). [mm]."""
    u = np.linspace(0.0, 1.0, 160)
    return np.column_stack([height * np.sin(2 * np.pi * waves * u), length * (u - 0.5), dome * np.sin(np.pi * u)])


def _frame(length: float, width: float, corner: float) -> Array:
    """Return a rectangle with rounded corners, sharp ones at a radius of 0. Shape (k, 3). [mm]."""
    points = []
    for k, (sx, sy) in enumerate(((1, -1), (1, 1), (-1, 1), (-1, -1))):
        angle = np.radians(90.0 * k - 90.0 + np.linspace(0.0, 90.0, 16 if corner else 1))
        centre = np.array([sx * (0.5 * width - corner), sy * (0.5 * length - corner)])
        points.append(centre + corner * np.column_stack([np.cos(angle), np.sin(angle)]))
    corners = np.vstack([*points, points[0][:1]])
    fine = [np.linspace(a, b, max(2, int(np.linalg.norm(b - a) / 25.0))) for a, b in pairwise(corners)]
    flat = np.vstack([part[:-1] for part in fine] + [corners[-1:]])
    return np.column_stack([flat, np.zeros(len(flat))])


#: Robot, place of the part [mm], what moves along it [mm] and its feed [mm/s] or a generator, and the rest of the job.
JOBS: dict[str, dict[str, Any]] = {
    "rail_circle": {"robot": "kuka_kr240_rail", "at": [1590.0, 2000.0, 600.0], "path": _circle(250.0, 1200.0),
                    "process": PUSH},
    "rail_wave": {"robot": "kuka_kr240_rail", "at": [1700.0, 2000.0, 700.0], "path": _wave(2600.0, 100.0, 2.0),
                  "feed": 1500.0, "process": PUSH},
    "rail_cone": {"robot": "kuka_kr240_rail", "at": [1800.0, 2000.0, 600.0], "path": _cone(400.0, 800.0, 12.0),
                  "process": ALONG},
    "rail_frame": {"robot": "kuka_kr240_rail", "at": [1750.0, 2200.0, 800.0], "path": _frame(1500.0, 500.0, 60.0),
                   "feed": 1000.0, "process": PUSH, "tool": OFFSET},
    "spin_circle": {"robot": "kuka_kr270", "at": [1700.0, 0.0, 800.0], "path": _circle(120.0, 500.0), "process": PUSH,
                    "tool": OFFSET},
    "spin_cone": {"robot": "kuka_kr270", "at": [1750.0, 200.0, 700.0], "path": _cone(200.0, 600.0, 8.0),
                  "process": ALONG, "tool": OFFSET},
    "spin_frame": {"robot": "abb_irb6700_200_260", "at": [1700.0, -50.0, 900.0], "path": _frame(700.0, 400.0, 40.0),
                   "feed": 900.0, "process": PUSH, "tool": SPINDLE},
    "spin_small": {"robot": "ur10e", "at": [700.0, 100.0, 250.0], "path": _circle(120.0, 700.0), "process": LIGHT},
    "spin_spiral": {"robot": "kuka_kr270", "at": [1650.0, -150.0, 750.0], "process": PUSH, "tool": OFFSET,
                    "path": {"generator": "spiral", "outer_radius_mm": 150.0, "inner_radius_mm": 60.0, "turns": 2.0,
                             "feed_mm_s": 700.0, "waypoints": 140}},
    "lean_wave": {"robot": "kuka_kr270", "at": [1800.0, 0.0, 700.0], "path": _wave(1000.0, 40.0, 2.0), "feed": 1000.0,
                  "process": PUSH, "tool": OFFSET, "posture": LEANING},
    "lean_dome": {"robot": "abb_irb6700_200_260", "at": [1700.0, 0.0, 800.0], "path": _wave(900.0, 30.0, 2.0, 120.0),
                  "feed": 1000.0, "process": PUSH, "tool": SPINDLE, "posture": LEANING},
    "tube_frame": {"robot": "kuka_kr270", "at": [1700.0, 0.0, 700.0], "path": _frame(600.0, 400.0, 0.0),
                   "feed": 900.0, "process": PUSH, "tool": OFFSET, "more": {"feed": {"corner_tolerance_mm": 0.5}}},
}  # fmt: skip


def write_job(name: str, folder: Path, preset: str = "") -> dict[str, Any]:
    """Return the table of a job; its path, where it is not a generator's, is written into the folder."""
    entry = JOBS[name]
    path = entry["path"]
    if isinstance(path, np.ndarray):
        file = folder / f"{name}.csv"
        rows = [f"{x:.9g},{y:.9g},{z:.9g},0,0,1,{entry['feed']}" for x, y, z in path]
        file.write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,feed_mm_s", *rows]) + "\n", encoding="utf-8")
        path = str(file)
    posture = {**entry.get("posture", {}), **({"preset": preset} if preset else {})}
    table = {"schema": 1, "name": name, "robot": entry["robot"], "part": {"position_mm": entry["at"]},
             "toolpath": path, "process": entry["process"], "plan": {"tolerance_mm": 0.2}, "posture": posture,
             "sampling": {"max_step_mm": 50.0},
             **entry.get("more", {})}  # fmt: skip
    return table | ({"tool": entry["tool"]} if "tool" in entry else {})
