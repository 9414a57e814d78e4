"""Make the freeform example: a part with a wavy top, the tool that mills it, its fixture, and the raster path on it.

Run `python examples/freeform.py` to write paths/freeform.csv and the meshes beside it anew.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from compplan.io.tables import write_table

Array = NDArray[np.float64]

PATHS = Path(__file__).resolve().parent.parent / "paths"
#: Half extents of the part and height of its flat bottom below the part frame. [mm]
HALF = (150.0, 110.0)
BOTTOM = -60.0
#: Mount of the spindle on the flange, length of bracket and of spindle with cutter. [mm]
BRACKET, SPINDLE = 150.0, 300.0


def height(x: Array, y: Array) -> Array:
    """Return the height of the top [mm] at places [mm]."""
    return 16.0 * np.cos(2 * np.pi * x / 280.0) + 10.0 * np.sin(2 * np.pi * (y + 0.3 * x) / 240.0)


def normal(x: Array, y: Array) -> Array:
    """Return the unit normal of the top. Shape (n, 3)."""
    step = 1e-3
    slope_x = (height(x + step, y) - height(x - step, y)) / (2 * step)
    slope_y = (height(x, y + step) - height(x, y - step)) / (2 * step)
    up = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def make_part(columns: int = 31, rows: int = 23) -> trimesh.Trimesh:
    """Make the part as a closed mesh. [mm]"""
    x, y = np.meshgrid(np.linspace(-HALF[0], HALF[0], columns), np.linspace(-HALF[1], HALF[1], rows), indexing="ij")
    top = np.stack([x.ravel(), y.ravel(), height(x.ravel(), y.ravel())], axis=1)
    bottom = np.stack([x.ravel(), y.ravel(), np.full(x.size, BOTTOM)], axis=1)
    index = np.arange(x.size).reshape(columns, rows)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    upper = np.vstack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    rim = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]])
    after = np.roll(rim, -1)
    n = x.size
    walls = np.vstack([np.stack([rim, rim + n, after + n], axis=1), np.stack([rim, after + n, after], axis=1)])
    return trimesh.Trimesh(np.vstack([top, bottom]), np.vstack([upper, upper[:, ::-1] + n, walls]), process=True)


def make_fixture() -> trimesh.Trimesh:
    """Make a table and two clamps beside the part. [mm]"""
    parts = [
        trimesh.creation.box((620.0, 460.0, 30.0), trimesh.transformations.translation_matrix((0, 0, BOTTOM - 15)))
    ]
    for side in (-1.0, 1.0):
        place = trimesh.transformations.translation_matrix((0.0, side * (HALF[1] + 35.0), BOTTOM + 25.0))
        parts.append(trimesh.creation.box((60.0, 50.0, 50.0), place))
    return trimesh.util.concatenate(parts)


def make_tool(angle_deg: float = 45.0) -> trimesh.Trimesh:
    """Make bracket, spindle, holder and cutter, in a KUKA flange frame (x out of the flange). [mm]"""
    angle = np.radians(angle_deg)
    out = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    elbow = np.array([BRACKET, 0.0, 0.0])
    pieces = [
        (55.0, np.zeros(3), elbow),
        (50.0, elbow - 70.0 * out, elbow + 200.0 * out),
        (22.0, elbow + 200.0 * out, elbow + 245.0 * out),
        (6.0, elbow + 245.0 * out, elbow + SPINDLE * out),
    ]
    return trimesh.util.concatenate(
        [trimesh.creation.cylinder(radius, segment=(start, end), sections=16) for radius, start, end in pieces]
    )


def make_path(lines: int = 15, step: float = 4.0, lift: float = 60.0, feed: float = 30.0) -> dict[str, Array]:
    """Make the raster: columns of a toolpath file, part frame."""
    half_x, half_y = 110.0, 75.0
    x_line = np.linspace(-half_x, half_x, round(2 * half_x / step) + 1)
    x, y = [], []
    for k, offset in enumerate(np.linspace(-half_y, half_y, lines)):
        x.append(x_line if k % 2 == 0 else x_line[::-1])
        y.append(np.full(len(x_line), offset))
    xs, ys = np.concatenate(x), np.concatenate(y)
    axis = normal(xs, ys)
    tip = np.stack([xs, ys, height(xs, ys)], axis=1)
    tip = np.vstack([tip[:1] + lift * axis[:1], tip, tip[-1:] + lift * axis[-1:]])
    axis = np.vstack([axis[:1], axis, axis[-1:]])
    rapid = np.zeros(len(tip))
    rapid[[0, 1, -1]] = 1.0
    columns = {f"{name}_mm": tip[:, k] for k, name in enumerate("xyz")}
    columns |= {name: axis[:, k] for k, name in enumerate("ijk")}
    return columns | {"feed_mm_s": np.where(rapid > 0, 0.0, feed), "rapid": rapid}


def main() -> None:
    """Write the files."""
    write_table(PATHS / "freeform.csv", make_path(), decimals=5)
    for name, mesh in (("part", make_part()), ("fixture", make_fixture()), ("tool", make_tool())):
        mesh.export(PATHS / f"freeform_{name}.ply", encoding="binary")


if __name__ == "__main__":
    main()
