"""Engagement beside a fine voxel sweep, and its cost: `python -m benchmarks engagement [--cost]`.

The sweep shares nothing with the product: a block of cubes, a cutter that is moved on by less than a cube, and the
cubes that it takes away in each move. What is compared a path: the volume removed in each move (section times step),
the axial depth and the radial width.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import time

import numpy as np

from compplan.process.cutting import shape_milling
from compplan.process.engagement import Cutter, Engagement
from compplan.process.engagement_search import find_engagement
from compplan.process.stock import build_block

CUBE = 0.0625  # mm: depths and widths of the straight cuts are whole cubes
WINDOW = 8  # moves
BLOCK = np.array([[-15.0, -15.0, -8.0], [15.0, 15.0, 0.0]])  # mm


def sweep_cubes(radius: float, corner: float, path: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return volume [mm3], axial depth and radial width [mm] of what each move takes away. Shapes (n,)."""
    count = np.round((BLOCK[1] - BLOCK[0]) / CUBE).astype(int)
    solid = np.ones(tuple(count), bool)
    centre = [BLOCK[0, a] + (np.arange(count[a]) + 0.5) * CUBE for a in range(3)]
    volume, axial, radial = np.zeros(len(path)), np.zeros(len(path)), np.zeros(len(path))
    for i in range(1, len(path)):
        step = path[i] - path[i - 1]
        pieces = max(int(np.ceil(np.linalg.norm(step) / (0.5 * CUBE))), 1)
        low = np.minimum(path[i], path[i - 1])[:2] - radius
        high = np.maximum(path[i], path[i - 1])[:2] + radius
        a = [max(int((low[k] - BLOCK[0, k]) / CUBE) - 1, 0) for k in range(2)]
        b = [min(int((high[k] - BLOCK[0, k]) / CUBE) + 2, count[k]) for k in range(2)]
        if a[0] >= b[0] or a[1] >= b[1]:
            continue
        box = solid[a[0] : b[0], a[1] : b[1]]
        before = box.copy()
        x, y = np.meshgrid(centre[0][a[0] : b[0]], centre[1][a[1] : b[1]], indexing="ij")
        for share in np.linspace(0, 1, pieces + 1):
            tip = path[i - 1] + share * step
            distance = np.hypot(x - tip[0], y - tip[1])
            floor = np.full(x.shape, np.inf)
            on = distance < radius
            ring = np.clip(distance[on] - (radius - corner), 0, corner)
            floor[on] = tip[2] + corner - np.sqrt(np.maximum(corner**2 - ring**2, 0))
            box &= centre[2] < floor[:, :, None]
        gone = before & ~box
        volume[i] = gone.sum() * CUBE**3
        if gone.any():
            heights = np.flatnonzero(gone.any(axis=(0, 1)))
            axial[i] = (heights[-1] - heights[0] + 1) * CUBE
            flat = step[:2] / max(np.linalg.norm(step[:2]), 1e-12)
            where = gone.any(axis=2)
            off = (y - path[i][1])[where] * flat[0] - (x - path[i][0])[where] * flat[1]
            radial[i] = off.max() - off.min() + CUBE * (abs(flat[0]) + abs(flat[1]))
    return volume, axial, radial


def line(*knots: tuple[float, float, float], step: float = 0.5) -> np.ndarray:
    parts = [np.array([knots[0]], float)]
    for a, b in itertools.pairwise(knots):
        count = max(int(np.ceil(np.linalg.norm(np.subtract(b, a)) / step)), 1)
        share = np.linspace(0, 1, count + 1)[1:, None]
        parts.append(np.array(a) + share * (np.array(b, float) - a))
    return np.vstack(parts)


def paths() -> dict[str, tuple[float, float, np.ndarray]]:
    turn = np.linspace(0, 4 * np.pi, 200)
    return {
        "slot": (4.0, 0.0, line((-22, 0.03, -2), (12, 0.03, -2))),
        "half immersion, down": (4.0, 0.0, line((-22, -15.02, -3), (12, -15.02, -3))),
        "half immersion, up": (4.0, 0.0, line((-22, 15.02, -3), (12, 15.02, -3))),
        "narrow pass": (4.0, 0.0, line((-22, -18.0, -3), (12, -18.0, -3))),
        "ramp": (4.0, 0.0, line((-10, 0, 1), (10, 0, -4))),
        "plunge": (4.0, 0.0, line((0.04, 0.02, 1), (0.04, 0.02, -5))),
        "corner": (4.0, 0.0, line((-22, -10, -2), (8, -10, -2), (8, 10, -2))),
        "overlapping passes": (4.0, 0.0, line((-20, -10, -2), (20, -10, -2), (20, -7.5, -2), (-20, -7.5, -2),
                                              (-20, -5, -2), (20, -5, -2))),
        "spiral with a rounded cutter": (4.0, 1.5, np.vstack([line((0.8, 0, 1), (0.8, 0, -2)), np.column_stack([
            (1 + turn) * np.cos(turn) * 0.8, (1 + turn) * np.sin(turn) * 0.8, np.full(200, -2.0)])])),
        "ball on a slope": (3.0, 3.0, line((-10, -2, 1), (-10, -2, -1), (10, -2, -3),
                                         (10, 0, -3), (-10, 0, -1))),
    }  # fmt: skip


def engage(radius: float, corner: float, path: np.ndarray) -> Engagement:
    block = build_block(BLOCK[0] * 1e-3, BLOCK[1] * 1e-3, np.eye(3))
    cutter = Cutter(radius * 1e-3, 0.03, corner * 1e-3)
    return find_engagement(cutter, path * 1e-3, np.ones(len(path), bool), block)


def compare() -> list[tuple[str, float, float, float]]:
    """Return name and differences of volume, axial depth, radial width, as shares; means over each path."""
    rows = []
    for name, (radius, corner, path) in paths().items():
        found = engage(radius, corner, path)
        volume, axial, radial = sweep_cubes(radius, corner, path)
        step = np.r_[0, np.linalg.norm(np.diff(path, axis=0), axis=1)]
        section = found.section * 1e6
        claimed = 0.5 * (section + np.r_[0, section[:-1]]) * step
        steady = (volume > 0.2 * np.median(volume[volume > 0])) & (section > 0) & (np.r_[0, section[:-1]] > 0)
        turned = np.zeros(len(path), bool)
        way = np.diff(path, axis=0) / np.maximum(step[1:, None], 1e-12)
        turned[2:] = np.einsum("ni,ni->n", way[1:], way[:-1]) < 0.9
        steady &= ~turned
        window = np.ones(WINDOW)  # cubes go in layers: single moves are grained
        mine, theirs = (np.convolve(np.where(steady, v, 0.0), window, "same") for v in (claimed, volume))
        worst = [float(np.abs(mine - theirs).sum() / theirs.sum())]
        level = np.abs(np.diff(path[:, 2], prepend=path[0, 2])) < 1e-9
        for mine, theirs in ((found.axial * 1e3, axial), (found.radial * 1e3, radial)):
            some = steady & (theirs > 0) & level
            off = np.abs(mine - theirs)[some].sum()
            worst.append(float(off / theirs[some].sum()) if some.any() else float("nan"))
        rows.append((name, *worst))
    return rows


def measure_cost(corner: float, lean: float, count: int = 50_000) -> tuple[float, float]:
    """Return CPU seconds and gigabytes for waypoints in a block of 300 mm.

    Args:
        corner: Radius of the cutter's corner; it is 10 mm wide. [m]
        lean: How far the axis swings, along the travel and across it. [rad]
        count: Number of waypoints, 1 mm apart.

    """
    block = build_block(np.array([0, 0, -0.05]), np.array([0.3, 0.3, 0.0]), np.eye(3))
    rows, z = [], -2e-3
    while len(rows) < count:
        for number, y in enumerate(np.arange(0.01, 0.29, 5e-3)):
            x = np.arange(0.01, 0.29, 1e-3)[:: -1 if number % 2 else 1]
            rows += list(zip(x, np.full(len(x), y), np.full(len(x), z), strict=True))
        z -= 2e-3
    path = np.array(rows[:count])
    turn = lean * np.sin(path[:, :2] / 0.02)
    axis = np.column_stack([np.sin(turn), np.sqrt(1.0 - (np.sin(turn) ** 2).sum(axis=1))])
    start = time.process_time()
    found = find_engagement(Cutter(5e-3, 0.03, corner), path, np.ones(len(path), bool), block, axis=axis)
    shape_milling(found, 2, (0.0, 0.0, 0.0))
    return time.process_time() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--cost", action="store_true", help="time 50,000 waypoints too")
    chosen = arguments.parse_args()
    print(f"{'path':30s} {'volume':>8s} {'axial':>8s} {'radial':>8s}   mean difference from cubes of {CUBE} mm")
    for name, *shares in compare():
        print(f"{name:30s} " + " ".join("       -" if np.isnan(s) else f"{100 * s:7.2f}%" for s in shares))
    for name, corner, lean in (("flat", 0.0, 0.0), ("ball", 5e-3, 0.0), ("ball, axis +-10 deg", 5e-3, 0.17)):
        if chosen.cost:
            seconds, gigabytes = measure_cost(corner, lean)
            print(f"50,000 waypoints, block of 300 mm, {name}: {seconds:.1f} s of CPU, {gigabytes:.2f} GB so far")


if __name__ == "__main__":
    main()
