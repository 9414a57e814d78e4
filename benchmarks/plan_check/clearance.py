"""How near arm and tool come to the meshes of a job: points on the meshes against the arm's primitives.

The distance is read off sampled points and comes out up to their spacing too great, never too small.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.plan_check.cell import Kinematics
from benchmarks.plan_check.job import Array, Job

#: Spacing of points on a mesh [m], and their greatest number; postures looked at.
SPACING, MOST_POINTS, POSTURES = 5e-3, 60000, 80
#: Distances beyond this are not told apart. [m]
FAR = 0.5
UNITS = {"mm": 1e-3, "m": 1.0, "inch": 0.0254}


def least_clearance(job: Job, kinematics: Kinematics, q: Array) -> dict[str, object] | None:
    """Return the least distance [mm] of arm and tool from part and fixture, and who is nearest; None without meshes."""
    table = job.table.get("collision")
    if not table:
        return None
    scale = UNITS[table.get("unit", "mm")]
    obstacles = {name: _points(job, table[name], scale) for name in ("part", "fixture") if name in table}
    obstacles = {name: p @ job.R_base_part.T + job.T_base_part[:3, 3] for name, p in obstacles.items()}
    zone = table.get("tip_zone_mm", 30.0) * 1e-3
    tool = _points(job, table["tool"], scale) if "tool" in table else _line(job)
    off_tip = np.ones(len(tool), bool)
    if job.arm.tool is not None:
        off_tip = np.linalg.norm(tool - job.arm.tool[:3, 3], axis=1) > zone
    rows = np.unique(np.linspace(0, len(q) - 1, min(len(q), POSTURES)).astype(int))
    frames, _ = kinematics.frames(q[rows])
    best, pair = FAR, ("", "")
    for name, points in obstacles.items():
        tree, middle = cKDTree(points), points.mean(axis=0)
        span = float(np.linalg.norm(points - middle, axis=1).max())
        near = tool[off_tip] if name == "part" else tool  # the tip may touch the part alone
        for k in range(len(rows)):
            if len(near):
                flange = frames[job.arm.flange][k]
                placed = near @ flange[:3, :3].T + flange[:3, 3]
                distance = float(tree.query(placed, distance_upper_bound=best)[0].min())
                if distance < best:
                    best, pair = distance, ("tool", name)
            for shape in job.arm.shapes:
                pose = frames[shape.link][k] @ shape.pose
                if np.linalg.norm(pose[:3, 3] - middle) - span - _radius(shape.kind, shape.sizes) > best:
                    continue
                distance = float(_outside(shape.kind, shape.sizes, (points - pose[:3, 3]) @ pose[:3, :3]).min())
                if distance < best:
                    best, pair = distance, (shape.link, name)
    return {"least_mm": best * 1e3, "between": pair, "tool": "mesh" if "tool" in table else "line from flange to tip"}


def _points(job: Job, name: str, scale: float) -> Array:
    import trimesh

    mesh = trimesh.load(job.file.parent / name, force="mesh")
    count = min(MOST_POINTS, int(mesh.area * scale**2 / SPACING**2) + 100)
    sampled, _ = trimesh.sample.sample_surface(mesh, count, seed=12)
    return np.vstack([sampled, mesh.vertices]) * scale


def _line(job: Job) -> Array:
    if job.arm.tool is None:
        return np.zeros((0, 3))
    return np.linspace(0, 1, 200)[:, None] * job.arm.tool[:3, 3]


def _radius(kind: str, sizes: tuple[float, ...]) -> float:
    """Return the radius of a primitive's bounding sphere."""
    if kind == "box":
        return 0.5 * float(np.linalg.norm(sizes))
    return sizes[0] if kind == "sphere" else float(np.hypot(sizes[0], 0.5 * sizes[1]))


def _outside(kind: str, sizes: tuple[float, ...], points: Array) -> Array:
    """Return signed distances of points from a primitive in its own frame."""
    if kind == "sphere":
        return np.linalg.norm(points, axis=1) - sizes[0]
    if kind == "box":
        beyond = np.abs(points) - 0.5 * np.array(sizes)
    else:
        radial = np.linalg.norm(points[:, :2], axis=1) - sizes[0]
        beyond = np.stack([radial, np.abs(points[:, 2]) - 0.5 * sizes[1]], axis=1)
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
