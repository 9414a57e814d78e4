"""Rigid best fit of measured points to the cut path or to the nominal surface of the part."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from compplan.measurement.part_points import Surface
from compplan.robot import Array
from compplan.robot.pose import build_pose, rigid_columns
from compplan.toolpath.toolpath import Toolpath

#: Sampling distance along the path [m], and greatest number of samples.
SPACING, MOST = 5e-4, 400000
#: Iterations of a best fit, and number of points that it uses (assumed).
STEPS, FITTED = 40, 20000


def sample_cut(nominal: Toolpath) -> tuple[Array, Array, Array]:
    """Return arc length, position and unit tangent of dense samples of the cut. Shapes (k,), (k, 3), (k, 3). [m]"""
    arc = nominal.arc_length
    cut = np.flatnonzero(~nominal.rapid[1:] & (nominal.steps > 0))
    count = np.clip(np.ceil(nominal.steps[cut] / max(SPACING, arc[-1] / MOST)), 1, 10000).astype(int)
    move = np.repeat(cut, count)
    share = (np.arange(len(move)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    place = nominal.position[move] * (1 - share[:, None]) + nominal.position[move + 1] * share[:, None]
    along = nominal.position[move + 1] - nominal.position[move]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return arc[move] + share * nominal.steps[move], place, along


def fit_rigid(
    point: Array, normal: Array | None, nominal: Toolpath, farthest: float, surface: Surface | None = None
) -> tuple[Array, float]:
    """Fit the rigid motion, (4, 4), of points to the cut; also return the median remaining distance. [m]

    Distances are measured along the normals of a nominal surface if it is given, otherwise along those of the points,
    (m, 3), otherwise across the cut. Points, (m, 3), farther away than `farthest` [m] are ignored. All: base frame.
    """
    _, place, along = sample_cut(nominal)
    tree, motion, left = cKDTree(place), np.eye(4), np.inf
    chosen = slice(None, None, max(1, len(point) // (FITTED if surface is None else FITTED // 4)))
    here = point[chosen]
    unit = None if normal is None else normal[chosen]
    for _ in range(STEPS):
        moved = here @ motion[:3, :3].T + motion[:3, 3]
        if surface is None:
            distance, index = tree.query(moved, distance_upper_bound=farthest)
            near, turned = np.isfinite(distance), None if unit is None else unit @ motion[:3, :3].T
            index = np.where(near, index, 0)
            gap, tangent = moved - place[index], along[index]
        else:
            foot, turned, off = surface.find_nearest(moved)
            near, gap = np.abs(np.nan_to_num(off, nan=np.inf)) <= farthest, moved - foot
        if near.sum() < 8:
            return np.eye(4), np.inf
        if turned is None:
            across = np.eye(3) - np.einsum("mi,mj->mij", tangent, tangent)
        else:
            across = np.einsum("mi,mj->mij", turned, turned)
        gap, across = gap[near], across[near]
        residual = np.einsum("mij,mj->mi", across, gap)
        size = np.linalg.norm(residual, axis=1)
        left = float(np.median(size))
        weight = np.sqrt(np.minimum(1.0, 3.0 * max(left, 1e-7) / np.maximum(size, 1e-12)))
        middle = moved[near].mean(axis=0)
        columns = rigid_columns(moved[near], middle)
        a = (np.einsum("mij,mjk->mik", across, columns) * weight[:, None, None]).reshape(-1, 6)
        step = -np.linalg.lstsq(a, (residual * weight[:, None]).reshape(-1), rcond=1e-6)[0]
        turn = Rotation.from_rotvec(step[3:]).as_matrix()
        motion = build_pose(middle - turn @ middle + step[:3], turn) @ motion
        if np.abs(step).max() < 1e-8:
            break
    return motion, left


def describe_motion(motion: Array, at: Array) -> str:
    """Format a rigid motion as the shift of a point and the angle; at: the point [m], shape (3,)."""
    shift = (at @ motion[:3, :3].T + motion[:3, 3] - at) * 1e3
    angle = np.degrees(np.linalg.norm(Rotation.from_matrix(motion[:3, :3]).as_rotvec()))
    return f"[{shift[0]:.3g}, {shift[1]:.3g}, {shift[2]:.3g}] mm and {angle:.2g} deg"
