"""What measured points cannot be: points of another part, unit, frame or handedness are asked about, never learned."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from compplan.io.tables import Table
from compplan.learning.scan import Surface
from compplan.robot import Array
from compplan.robot.pose import build_pose, rigid_columns
from compplan.toolpath.toolpath import Toolpath

#: Units that files are written in by mistake, against the millimetres that are read (theory).
UNITS = {"metres": 1e3, "inches": 25.4, "centimetres": 10.0, "micrometres": 1e-3}
#: What another reading of the points has to leave of their median distance before it is offered (assumed), and the
#: distance below which there is nothing to explain. [m]
CONVINCING, NEAR = 0.3, 2e-4
#: Points that extend over less than this share of the cut are of one spot of it (assumed: nobody measures so little).
SPOT = 0.02
#: Points that extend over less than this share of the cut may be of all of it in another unit (assumed).
SMALL = 0.3
#: Distance between places that the path is sampled at, and how many at most. [m]
SPACING, MOST = 5e-4, 400000
#: Points that readings are compared with (assumed: enough for a median).
SAMPLE = 1000
#: Bands that the median point may be off before somebody is asked (assumed: widths of a folder are rough).
POSSIBLE = 4.0
#: Steps of a best fit, and the points that it is made with (assumed).
STEPS, FITTED = 40, 20000


def find_pasted(table: Table) -> NDArray[np.bool_]:
    """Tell rows that say in every number what one before says; readings of a probe may agree by rounding. Shape (m,)"""
    if "reading" in table or "distance" in table:
        return np.zeros(len(table), bool)
    values = np.stack([np.nan_to_num(column, nan=np.inf) for column in table.values.values()], axis=1)
    again = np.ones(len(table), bool)
    again[np.unique(values, axis=0, return_index=True)[1]] = False
    return again


def sample_cut(nominal: Toolpath) -> tuple[Array, Array, Array]:
    """Return length, place and direction of many places of the cut. Shapes (k,), (k, 3), (k, 3). [m]"""
    arc = nominal.arc_length
    cut = np.flatnonzero(~nominal.rapid[1:] & (nominal.steps > 0))
    count = np.clip(np.ceil(nominal.steps[cut] / max(SPACING, arc[-1] / MOST)), 1, 10000).astype(int)
    move = np.repeat(cut, count)
    share = (np.arange(len(move)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    place = nominal.position[move] * (1 - share[:, None]) + nominal.position[move + 1] * share[:, None]
    along = nominal.position[move + 1] - nominal.position[move]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return arc[move] + share * nominal.steps[move], place, along


def check_extent(table: Table, point: Array, place: Array) -> None:
    """Refuse points that all lie at one spot of the path, as a path in metres does that is read in millimetres.

    point: shape (m, 3); place: places of the cut in the frame of the points, (k, 3). [m]
    """
    wide, whole = (float(np.ptp(np.quantile(part, (0.05, 0.95), axis=0), axis=0).max()) for part in (point, place))
    if wide < SPOT * whole:
        raise table.error(
            f"the points extend over {wide * 1e3:.3g} mm and the cut over {whole * 1e3:.3g} mm, are they in metres or"
            " inches, not in mm? --assume-ok learns them as they are"
        )
    few = point[:: max(1, len(point) // SAMPLE)]
    for unit, factor in UNITS.items():
        near = factor > 1.0 and wide < SMALL * whole < factor * wide
        if near and float(np.median(cKDTree(place).query(few * factor)[0])) < SMALL * wide:
            raise table.error(
                f"the points extend over {wide * 1e3:.3g} mm of the {whole * 1e3:.3g} mm of the cut, and over all of it"
                f" in {unit}: is that what they are? --assume-ok learns them as they are"
            )


def explain_points(point: Array, nominal: Toolpath, T_base_part: Array, *, in_base: bool, whole: bool) -> str:
    """Say how else measured points, (m, 3) [m], may be meant, "" where no other reading brings them to the path.

    in_base: whether they were read in the base frame; whole: whether all should be of the cut, of a scan a tenth may
    be.
    """
    _, place, _ = sample_cut(nominal)
    local = (place - T_base_part[:3, 3]) @ T_base_part[:3, :3]
    here, there = (cKDTree(place), cKDTree(local)) if in_base else (cKDTree(local), cKDTree(place))
    few = point[:: max(1, len(point) // SAMPLE)]

    def off(tree: cKDTree, points: Array) -> float:
        distance = tree.query(points)[0]
        return float(np.quantile(distance, 0.5 if whole else 0.1))

    now = off(here, few)
    if now < NEAR:
        return ""
    readings = [(off(there, few), f"in the {'part' if in_base else 'base'} frame (--frame)")]
    readings += [(off(here, few * factor), f"in {unit}, not in mm") for unit, factor in UNITS.items()]
    readings += [(off(here, few @ turn.T), f"with {words}") for turn, words in _exchanges()]
    best = min(readings)
    if best[0] > CONVINCING * now:
        return ""
    return f"; they fit to {best[0] * 1e3:.3g} mm {best[1]}: is that what they are?"


def _exchanges() -> Iterator[tuple[Array, str]]:
    """List the ways in which axes are exchanged or reversed."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            if order == (0, 1, 2) and sign == (1.0, 1.0, 1.0):
                continue
            turn = np.zeros((3, 3))
            turn[range(3), order] = sign
            words = " ".join(("" if s > 0 else "-") + "xyz"[k] for s, k in zip(sign, order, strict=True))
            yield turn, f"axes exchanged or reversed ({words} for x y z)"


def fit_rigid(
    point: Array, normal: Array | None, nominal: Toolpath, farthest: float, surface: Surface | None = None
) -> tuple[Array, float]:
    """Find the rigid motion, (4, 4), that brings points closest to the cut; also the median distance left. [m]

    Points count across the cut, along their normals, (m, 3), where they have them, and along those of a nominal surface
    where there is one; points, (m, 3), farther away than `farthest` [m] are of no cut. All in the base frame.
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
    """Say a rigid motion by the shift of a place and the turn. at: shape (3,). [m]"""
    shift = (at @ motion[:3, :3].T + motion[:3, 3] - at) * 1e3
    angle = np.degrees(np.linalg.norm(Rotation.from_matrix(motion[:3, :3]).as_rotvec()))
    return f"[{shift[0]:.3g}, {shift[1]:.3g}, {shift[2]:.3g}] mm and {angle:.2g} deg"
