"""Make the toolpaths and the mesh of this folder: `python examples/forces/make_paths.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

HERE = Path(__file__).parent
HEADER = "x_mm,y_mm,z_mm,feed_mm_s,rapid"


def write(name: str, rows: list[tuple[float, float, float, float, int]]) -> None:
    """Write a toolpath: rows of x, y, z [mm], feed [mm/s], rapid."""
    lines = [HEADER, *(f"{x:.4f},{y:.4f},{z:.4f},{feed:g},{rapid}" for x, y, z, feed, rapid in rows)]
    (HERE / name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def make_pocket() -> None:
    """A pocket of 60 x 40 mm, two levels of 3 mm: ramp down, zigzag, once round the wall."""
    rows = [(6.0, 6.0, 20.0, 0.0, 1), (6.0, 6.0, 1.0, 0.0, 1)]
    for level in (-3.0, -6.0):
        rows += [(34.0, 6.0, level, 15.0, 0), (6.0, 6.0, level, 25.0, 0)]
        for number, y in enumerate(np.arange(6.0, 34.1, 4.0)):
            ends = (6.0, 54.0) if number % 2 == 0 else (54.0, 6.0)
            rows += [(x, y, level, 25.0, 0) for x in (ends if number else ends[1:])]
        rows += [(x, y, level, 25.0, 0) for x, y in ((5, 35), (5, 5), (55, 5), (55, 35), (5, 35))]
        rows += [(5.0, 35.0, level + 5.0, 25.0, 0), (5.0, 35.0, 5.0, 0.0, 1)]
        rows += [(6.0, 6.0, 5.0, 0.0, 1), (6.0, 6.0, level + 0.5, 0.0, 1)] if level == -3.0 else []
    write("pocket.csv", [*rows[:-1], (5.0, 35.0, 20.0, 0.0, 1)])


def dome(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the finished surface [mm]."""
    return 8.0 * np.exp(-(((x - 40.0) / 18.0) ** 2) - ((y - 30.0) / 14.0) ** 2) + 10.0


def make_finishing() -> None:
    """A dome that a ball end mill of 8 mm finishes in parallel lines; 0.4 mm of stock are left on it, as a mesh."""
    side = np.meshgrid(np.linspace(0, 80, 41), np.linspace(0, 60, 31), indexing="ij")
    top = np.stack([*side, dome(*side) + 0.4], axis=-1).reshape(-1, 3)
    floor = top * [1, 1, 0]
    index = np.arange(41 * 31).reshape(41, 31)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    up = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    ahead = np.roll(rim, -1)
    count = len(top)
    wall = np.vstack([np.column_stack([rim, rim + count, ahead]), np.column_stack([ahead, rim + count, ahead + count])])
    faces = np.vstack([up, up[:, ::-1] + count, wall])
    mesh = trimesh.Trimesh(np.vstack([top, floor]), faces, process=False)
    assert mesh.is_watertight and mesh.volume > 0, mesh.volume
    mesh.export(HERE / "dome_stock.stl")
    radius, rows = 4.0, []
    for number, y in enumerate(np.arange(4.0, 56.1, 2.0)):
        x = np.arange(4.0, 76.1, 1.0)[:: -1 if number % 2 else 1]
        h = 1e-4
        slope = np.stack([(dome(x + h, y) - dome(x - h, y)) / (2 * h), (dome(x, y + h) - dome(x, y - h)) / (2 * h)])
        normal = np.column_stack([-slope[0], -slope[1], np.ones_like(x)])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        centre = np.column_stack([x, np.full_like(x, y), dome(x, y)]) + radius * normal
        tip = centre - [0, 0, radius]
        if not rows:
            rows += [(*tip[0, :2], 40.0, 0.0, 1), (*tip[0, :2], tip[0, 2] + 2.0, 0.0, 1)]
        rows += [(*p, 30.0, 0) for p in tip]
    write("finishing.csv", [*rows, (*rows[-1][:2], 40.0, 0.0, 1)])


def make_plate() -> None:
    """Twelve holes of 6 mm through a plate of 8 mm."""
    rows: list[tuple[float, float, float, float, int]] = []
    for y in (15.0, 40.0, 65.0):
        for x in (15.0, 45.0, 75.0, 105.0):
            rows += [(x, y, 15.0, 0.0, 1), (x, y, 2.0, 0.0, 1), (x, y, -11.0, 5.0, 0), (x, y, 2.0, 20.0, 0),
                     (x, y, 15.0, 0.0, 1)]  # fmt: skip
    write("plate.csv", rows)


def make_seam() -> None:
    """A butt weld of 200 mm, 0.1 mm of plunge under the shoulder."""
    write("seam.csv", [(0, 0, 30, 0, 1), (0, 0, 0.5, 0, 1), (0, 0, -0.1, 0.5, 0), (200, 0, -0.1, 5, 0),
                       (200, 0, 5, 2, 0), (200, 0, 30, 0, 1)])  # fmt: skip


if __name__ == "__main__":
    make_pocket()
    make_finishing()
    make_plate()
    make_seam()
