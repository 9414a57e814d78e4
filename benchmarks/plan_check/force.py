"""The force law of a job, worked out from its documented keys, at the feed that joints.csv drives.

A wrench is what the environment does to the tool at its tip. Path axes: z the tool axis (tip to spindle), x the travel
across it, y = z x x, the left of somebody who looks down the tool axis along the travel; a plunge keeps the last x.
"""

from __future__ import annotations

import csv

import numpy as np

from benchmarks.plan_check.job import WRENCH, Array, Job
from benchmarks.plan_check.match import Placed

STILL = 1e-6


def law(job: Job, placed: Placed, wanted: Array, axis: Array, feed: Array) -> Array:
    """Return the wrench in full contact at every row, base axes. Shape (n, 6) [N, N m].

    Args:
        job: The job.
        placed: Where each row lies on the CAM path, and whether its move cuts.
        wanted: Wanted tips. Shape (n, 3). [m]
        axis: Tool axes. Shape (n, 3).
        feed: Feed of the move that ends at each row. Shape (n,). [m/s]
    """
    table = job.table.get("process", {"model": "columns"})
    model = table.get("model", "columns")
    n = len(wanted)
    if model == "columns":
        columns = job.path.wrench
        return np.zeros((n, 6)) if columns is None else _along(job.path.arc, columns, placed.arc)
    if model == "constant":
        local = np.tile(np.r_[table["force_N"], table.get("moment_Nm", [0.0, 0, 0])], (n, 1))
        return _turn(_frame(table.get("frame", "part"), job, placed, wanted, axis), local)
    if model == "file":
        return _turn(_frame(table.get("frame", "part"), job, placed, wanted, axis), _file(job, table, placed))
    if model == "isf":
        share = table.get("start_share", 0.3)
        level = share + (1 - share) * placed.cut_arc / job.path.cut_arc[-1]
        side = 1.0 if table.get("wall_side", "right") == "right" else -1.0
        push = [-table.get("drag_N", 0.0), side * table.get("lateral_N", 0.0), table["axial_N"], 0, 0, 0]
        return _turn(path_frame(placed, wanted, axis), level[:, None] * np.array(push))
    if model == "milling":
        frame = path_frame(placed, wanted, axis)
        return _turn(frame, (feed * _across(wanted, axis))[:, None] * milling(table))
    raise ValueError(f"no force law {model!r} here")


def contact_share(job: Job, arc: Array, begin: Array, end: Array, wanted: Array) -> Array:
    """Return the share of the wrench that acts at a length of the path within a cut from `begin` to `end` [m].

    An end mill cuts as deep as its tip stands below the stock's top: `stock_top_mm` in the part frame, or z = 0 of a
    CAM program that cuts above and below it. `wanted` is the tip there, base frame. Shape (..., 3). [m]
    """
    table = job.table.get("process", {})
    share = np.ones(np.shape(arc))
    top = stock_top(job)
    if top is not None:
        height = (wanted - job.T_base_part[:3, 3]) @ job.R_base_part[:, 2]
        share = np.clip((top - height) / (table["depth_mm"] * 1e-3), 0, 1)
    if table.get("model", "columns") == "columns" or table.get("during_rapid"):
        return share
    if table.get("ramp_mm"):
        share = share * np.clip((arc - begin) / (table["ramp_mm"] * 1e-3), 0, 1)
    if table.get("ramp_out_mm"):
        share = share * np.clip((end - arc) / (table["ramp_out_mm"] * 1e-3), 0, 1)
    return share


def stock_top(job: Job) -> float | None:
    """Return the height of the stock's top in the part frame, None where none is known. [m]"""
    table = job.table.get("process", {})
    if table.get("model") != "milling":
        return None
    if "stock_top_mm" in table:
        return table["stock_top_mm"] * 1e-3
    source = job.table["toolpath"]
    height = (job.path.position[~job.path.rapid] - job.T_base_part[:3, 3]) @ job.R_base_part[:, 2]
    both = len(height) > 0 and height.min() < -1e-5 and height.max() > 1e-5
    return 0.0 if isinstance(source, str) and not source.endswith(".csv") and both else None


def _across(wanted: Array, axis: Array) -> Array:
    """Return the share of the travel that goes across the tool axis: a plunge makes no lateral chip."""
    travel = np.vstack([wanted[1:2] - wanted[:1], np.diff(wanted, axis=0)])
    length = np.linalg.norm(travel, axis=1)
    along = np.abs(np.einsum("ni,ni->n", travel, axis)) / np.maximum(length, 1e-300)
    return np.where(length > 0, np.sqrt(np.clip(1 - along**2, 0, 1)), 1.0)


def acts_in_rapids(job: Job) -> bool:
    """Tell whether the wrench acts in rapid moves too: a dead weight, or columns of the file."""
    table = job.table.get("process", {})
    return table.get("model", "columns") == "columns" or bool(table.get("during_rapid"))


def milling(table: dict) -> Array:
    """Integrate the mean force of an end mill over its engagement, per unit of feed, path axes [N s/m].

    Tooth at angle psi from the travel towards the left, clockwise spindle: chip f cos(psi), tangential force against
    the tooth's motion, radial force towards the spindle's axis; mean over a turn, by Gauss' rule.
    """
    radius = table["diameter_mm"] / 2
    inner = np.arcsin(np.clip(table["width_mm"] / radius - 1, -1, 1))
    low, high = (-np.pi / 2, inner) if table.get("material_side", "right") == "right" else (-inner, np.pi / 2)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    psi, dpsi = 0.5 * (high + low) + 0.5 * (high - low) * nodes, 0.5 * (high - low) * weights
    out = np.stack([np.cos(psi), np.sin(psi)])  # the tooth, seen from the spindle's axis
    ahead = np.stack([-np.sin(psi), np.cos(psi)])  # z x r: the tooth turns clockwise, so the chip pushes this way
    tangential, radial, axial = 1.0, table.get("radial_ratio", 0.4), table.get("axial_ratio", 0.0)
    plane = ((tangential * ahead - radial * out) * np.cos(psi) * dpsi).sum(axis=1)
    chips = float((np.cos(psi) * dpsi).sum())
    per_turn = 60.0 * 1e3 / table["spindle_rpm"]  # mm of feed a turn, for 1 m/s
    scale = table["kc_N_mm2"] * table["depth_mm"] * per_turn / (2 * np.pi)
    return scale * np.array([plane[0], plane[1], axial * chips, 0, 0, tangential * radius * 1e-3 * chips])


def path_frame(placed: Placed, wanted: Array, axis: Array) -> Array:
    """Return the path axes at every row as columns. Shape (n, 3, 3)."""
    travel = np.vstack([wanted[1:2] - wanted[:1], np.diff(wanted, axis=0)])
    travel /= np.maximum(np.linalg.norm(travel, axis=1, keepdims=True), 1e-300)
    across = travel - np.einsum("ni,ni->n", travel, axis)[:, None] * axis
    clear = (np.linalg.norm(across, axis=1) > STILL) & placed.cuts
    if not clear.any():
        clear = np.linalg.norm(across, axis=1) > STILL
    if not clear.any():  # nothing but plunges: any x across the tool axis
        across = np.cross(axis, np.where(np.abs(axis[:, :1]) < 0.9, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]]))
        clear = np.ones(len(wanted), bool)
    rows = np.flatnonzero(clear)
    source = rows[np.clip(np.searchsorted(rows, np.arange(len(wanted)), side="right") - 1, 0, None)]
    x = across[source]
    x -= np.einsum("ni,ni->n", x, axis)[:, None] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axis, x), axis], axis=2)


def _frame(name: str, job: Job, placed: Placed, wanted: Array, axis: Array) -> Array:
    if name == "path":
        return path_frame(placed, wanted, axis)
    if name == "tool":
        z = -axis
        x = job.R_base_part @ np.array(job.plan.get("tool_x", [1.0, 0, 0]))
        x = x - (z @ x)[:, None] * z
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        return np.stack([x, np.cross(z, x), z], axis=2)
    return np.tile(job.R_base_part if name == "part" else np.eye(3), (len(wanted), 1, 1))


def _file(job: Job, table: dict, placed: Placed) -> Array:
    with (job.file.parent / table["file"]).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    values = np.array([[float(row.get(name) or 0.0) for name in WRENCH] for row in rows])
    if "s_mm" in rows[0]:
        return _along(np.array([float(row["s_mm"]) for row in rows]) * 1e-3, values, placed.cut_arc)
    return _along(job.path.arc, values, placed.arc)


def _along(s: Array, values: Array, where: Array) -> Array:
    return np.stack([np.interp(where, s, column) for column in values.T], axis=1)


def _turn(axes: Array, local: Array) -> Array:
    return np.hstack([np.einsum("nij,nj->ni", axes, local[:, :3]), np.einsum("nij,nj->ni", axes, local[:, 3:])])
