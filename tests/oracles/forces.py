"""The wrench of a job at the feed that is driven, from its keys and commanded rows; shares nothing with the package."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compplan.job.frames import PartTable
from compplan.robot import Array

#: Models that are not read a second time: the wrench is the recorded one, checked by simulations of its own instead.
RECORDED = {
    "end_mill": "what the cutter meets of the stock is worked out once, for both",
    "drill": "what the cutter meets of the stock is worked out once, for both",
    "isf_regression": "its wall angle follows from the whole path",
}
COLUMNS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class DrivenRows:
    """What is driven; n rows, base frame. Row i ends the move that comes to it."""

    position: Array  #: Wanted tip. Shape (n, 3). [m]
    axis: Array  #: Tool axis, tip to spindle. Shape (n, 3).
    rapid: NDArray[np.bool_]  #: Shape (n,).
    #: Rows that bring the correction in before a cut or out after it, the wanted tip at rest. Shape (n,).
    lead: NDArray[np.bool_]
    time: Array  #: Shape (n,). [s]
    stock_top: float | None = None  #: Height of the stock's top in the part frame, or None. [m]
    rows_at: Array | None = None  #: Length along the path of each row of the toolpath file, or None. Shape (r,). [m]

    @property
    def arc(self) -> Array:
        """Length along the path. Shape (n,). [m]."""
        return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(self.position, axis=0), axis=1))]


def read_forces(job: Mapping[str, Any], folder: Path, rows: DrivenRows) -> Array | None:
    """Work out the wrench at every row, base axes (n, 6) [N, N m], or None where the file gives it another way."""
    process = job.get("process", {"model": "columns"})
    part = PartTable.model_validate(job.get("part", {})).pose
    turn = part[:3, :3]
    model = process.get("model", "columns")
    local = None if model in RECORDED else _local(model, process, job, folder, rows)
    if local is None:
        return None
    frame = process.get("frame", "part") if model in ("constant", "file") else "part" if model == "columns" else "path"
    frames = _frames(frame, turn, np.array(job.get("plan", {}).get("tool_x", (1.0, 0.0, 0.0)), float), rows)
    parts = (local[:, :3], local[:, 3:])
    wrench = np.concatenate([np.matmul(frames, part[..., None])[..., 0] for part in parts], axis=1)
    if process.get("during_rapid"):
        return wrench
    wrench *= _acting(process, rows)[:, None]
    if rows.stock_top is not None and model == "milling":
        depth = rows.stock_top - (rows.position - part[:3, 3]) @ turn[:, 2]
        wrench *= np.clip(depth * 1000.0 / process["depth_mm"], 0.0, 1.0)[:, None]
    marks = np.flatnonzero(np.diff(np.r_[0, rows.lead.astype(int), 0]))
    for first, after in zip(marks[::2], marks[1::2], strict=True):
        grown = np.linspace(0.0, 1.0, after - first + 1)[1:, None]
        left = after == len(wrench) or rows.rapid[after]
        wrench[first:after] = (1.0 - grown) * wrench[first - 1] if left else grown * wrench[after]
    return wrench


def _local(
    model: str, process: Mapping[str, Any], job: Mapping[str, Any], folder: Path, rows: DrivenRows
) -> Array | None:
    """Return the wrench in the frame of its process, contact aside. Shape (n, 6)."""
    n, arc = len(rows.position), rows.arc
    cut_arc = np.r_[0.0, np.cumsum(np.where(rows.rapid[1:], 0.0, np.diff(arc)))]
    if model == "constant":
        return np.tile([*process["force_N"], *process.get("moment_Nm", (0.0, 0.0, 0.0))], (n, 1)).astype(float)
    if model == "isf":
        begin = process.get("start_share", 0.3)
        side = -1.0 if process.get("wall_side", "right") == "left" else 1.0
        push = [0.0, side * process.get("lateral_N", 0.0), process["axial_N"], 0.0, 0.0, 0.0]
        return np.outer(begin + (1.0 - begin) * cut_arc / cut_arc[-1], push)
    way = np.diff(rows.position, axis=0)
    off = np.einsum("ni,ni->n", way, rows.axis[1:]) > 0.71 * np.linalg.norm(way, axis=1)  # lifted off the part
    down = 1.0 - np.r_[off[:1], off]
    if model == "friction_stir":
        return np.outer(down, _weld(process))
    if model == "grinding":
        return np.outer(down, _grind(process))
    if model == "milling":
        travel = np.diff(rows.position, axis=0)
        along = np.einsum("ni,ni->n", travel, rows.axis[1:])
        size = np.maximum(np.linalg.norm(travel, axis=1), 1e-300)
        across = np.sqrt(np.maximum(1.0 - (along / size) ** 2, 0.0))
        return np.outer(_speeds(rows) * np.r_[across[:1], across], _mean_of_a_turn(process))
    if model not in ("columns", "file"):  # a user's own
        return None
    named = process["file"] if model == "file" else job["toolpath"]
    if not isinstance(named, str) or not named.lower().endswith(".csv"):
        return np.zeros((n, 6)) if model == "columns" and not process.get("required", True) else None
    values, lengths = _read_columns(folder / named)
    if values is None:
        return None
    if lengths is not None:
        return _follow(lengths, values, cut_arc)
    return None if rows.rows_at is None else _follow(rows.rows_at, values, arc)


def _speeds(rows: DrivenRows) -> Array:
    """Return the speed of the wanted tip by the parabola through its neighbours in time, or of the rapid move. [m/s]"""
    step, way = np.diff(rows.time), np.diff(rows.arc)
    speed = np.divide(way, step, out=np.zeros(len(way)), where=step > 0)
    both = step[:-1] + step[1:]
    at = np.r_[speed[:1], speed]
    slope = np.divide(way[:-1] * step[1:] ** 2 + way[1:] * step[:-1] ** 2, step[:-1] * step[1:] * both,
                      out=at[1:-1].copy(), where=(step[:-1] > 0) & (step[1:] > 0))  # fmt: skip
    at[1:-1] = np.where(rows.rapid[1:-1] | rows.rapid[2:], at[1:-1], slope)
    return at


def _weld(process: Mapping[str, Any]) -> Array:
    """Return the wrench of a friction stir weld, path axes: shear stress on shoulder, probe side and probe tip."""
    big, small, down = process["shoulder_diameter_mm"] / 2.0, process["probe_diameter_mm"] / 2.0, process["axial_N"]
    faces = 2.0 * np.pi / 3.0 * (big**3 - small**3)
    faces += 2.0 * np.pi / 3.0 * small**3 + 2.0 * np.pi * small**2 * process["probe_length_mm"]
    sense = 1.0 if process.get("clockwise", True) else -1.0
    push = [-0.12 * down, sense * 0.05 * down, down]
    return np.array([*push, 0.0, 0.0, sense * process["shear_N_mm2"] * faces / 1000.0])


def _grind(process: Mapping[str, Any]) -> Array:
    """Return the wrench of grinding, path axes."""
    sense = 1.0 if process.get("direction") == "along" else -1.0
    return np.array([sense * 0.45 * process["normal_N"], 0.0, process["normal_N"], 0.0, 0.0, 0.0])


def _mean_of_a_turn(process: Mapping[str, Any]) -> Array:
    """Return the mean wrench of an end mill per unit of feed, path axes: a sum over a turn of one tooth [N s/m].

    The tooth stands at the angle u from the travel towards its left and is engaged where it is in the material; a
    clockwise spindle turns it towards smaller u.
    """
    radius, kt = process["diameter_mm"] / 2.0, process["kc_N_mm2"]
    kr = process.get("radial_ratio", 0.4) * kt
    edge = np.arcsin(np.clip(process["width_mm"] / radius - 1.0, -1.0, 1.0))
    right = process.get("material_side", "right") == "right"
    node, weight = np.polynomial.legendre.leggauss(48)
    low, high = (-np.pi / 2, edge) if right else (-edge, np.pi / 2)
    u, du = 0.5 * (low + high) + 0.5 * (high - low) * node, 0.5 * (high - low) * weight
    chip = np.cos(u) * du
    x, y = chip @ (-kt * np.sin(u) - kr * np.cos(u)), chip @ (kt * np.cos(u) - kr * np.sin(u))
    scale = process["depth_mm"] * 60e3 / process["spindle_rpm"] / (2.0 * np.pi)
    return np.asarray(scale * np.array([x, y, 0.0, 0.0, 0.0, kt * chip.sum() * radius * 1e-3]))


def _frames(frame: str, turn: Array, tool_x: Array, rows: DrivenRows) -> Array:
    """Return the frame of the process at every row, columns in base axes. Shape (n, 3, 3)."""
    n = len(rows.position)
    if frame in ("part", "base"):
        return np.tile(turn if frame == "part" else np.eye(3), (n, 1, 1))
    if frame == "tool":
        z, towards = -rows.axis, np.tile(turn @ tool_x, (n, 1))
    else:
        z, towards = rows.axis, _travel(rows)
    y = np.cross(z, towards)
    y /= np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1e-300)
    return np.stack([np.cross(y, z), y, z], axis=2)


def _travel(rows: DrivenRows) -> Array:
    """Return the travel of the move that ends at each row; moves along the axis keep the one before. Shape (n, 3)."""
    step = np.diff(rows.position, axis=0)
    step = np.concatenate([step[:1], step])
    length = np.linalg.norm(step, axis=1)
    sideways = np.linalg.norm(np.cross(step, rows.axis), axis=1) > 1e-6 * np.maximum(length, 1e-300)
    good = np.flatnonzero(sideways & ~rows.rapid & (length > 0))
    if not len(good):
        return np.tile([1.0, 0.0, 0.0], (len(step), 1))
    return np.asarray(step[good[np.maximum(np.searchsorted(good, np.arange(len(step)), side="right") - 1, 0)]])


def _acting(process: Mapping[str, Any], rows: DrivenRows) -> Array:
    """Return the share of the wrench that acts at every row: growing after contact."""
    arc, share = rows.arc, (~rows.rapid).astype(float)
    grow = process.get("ramp_mm", 0.0) / 1000.0
    rapid = np.flatnonzero(rows.rapid)
    for first, last in zip(np.r_[0, rapid], np.r_[rapid, len(arc)], strict=True):
        cut = slice(first, last)
        if grow > 0 and last > first:
            share[cut] *= np.minimum((arc[cut] - arc[first]) / grow, 1.0)
    return share


def _read_columns(file: Path) -> tuple[Array | None, Array | None]:
    """Return the wrench columns of a CSV file, and its lengths s_mm in metres where it has them."""
    with file.open(encoding="utf-8", newline="") as stream:
        table = list(csv.DictReader(line for line in stream if not line.lstrip().startswith("#")))
    if not table or not {"fx_N", "fy_N", "fz_N"} <= table[0].keys():
        return None, None
    values = np.array([[float(row.get(name) or 0.0) for name in COLUMNS] for row in table])
    lengths = np.array([float(row["s_mm"]) for row in table]) / 1000.0 if "s_mm" in table[0] else None
    return values, lengths


def _follow(lengths: Array, values: Array, where: Array) -> Array:
    return np.stack([np.interp(where, lengths, column) for column in values.T], axis=1)
