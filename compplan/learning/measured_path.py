"""Match points measured on a cut part with the path: deviation, arc length, and measured directions.

A point with a stated arc length (s_mm, rapid moves included) counts in all directions. A point without one is assigned
to the nearest point of the path and counts only across the path. A point that fits two stretches of the path is left
out. A scan point counts along its normal, and only next to the path. With a nominal surface, points count along the
normal of the surface, up to the distance from the path that the tool reaches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compplan.io.tables import Table
from compplan.learning.alignment import describe_motion, fit_rigid, sample_cut
from compplan.measurement.part_points import FARTHEST, SCAN_SIGMA, Surface, find_repeated_points, is_scanned
from compplan.robot import Array
from compplan.toolpath.toolpath import Toolpath

#: Greatest stated arc length beyond an end of the path that is still assigned to that end. [m]
BEYOND = 1e-3
#: A point is ambiguous if another stretch of the path is nearer than this multiple of its distance.
CLAIMED = 2.0
#: Least extent of the points relative to that of the path (assumed: smaller ones are in another unit).
SPOT = 0.02
#: Points without arc length: shares left out from which on advice is given, and points are refused (assumed).
STRANGE, MOST_OUT = 0.1, 0.5
#: Least distance from the path in the test for ambiguous points. [m]
NEAREST = 1e-4
#: Fewest points of a model update.
FEWEST = 8
#: Default standard deviation of a point (assumed). [m]
SIGMA = 2e-5
#: Greatest distance of scan points from the path, along the surface. [m]
BESIDE = 1e-3
#: Neighbours of a normal estimate, and ratio of the two largest eigenvalues below which points form a line (assumed).
NEIGHBOURS, LINE = 12, 0.02
#: Least square of the component of a normal across the path (assumed: tilted by 60 degrees).
FLAT = 0.25


@dataclass(frozen=True, eq=False)
class MeasuredPath:
    """Measured points of a cut path, base frame; m points."""

    length: Array  #: Arc length along the path. Shape (m,). [m]
    deviation: Array  #: Measured minus nominal tip. Shape (m, 3). [m]
    counts: Array  #: Projector on the measured directions. Shape (m, 3, 3).
    sigma: Array  #: Standard deviation of the measurement per axis. Shape (m,). [m]
    left_out: int  #: Number of points left out: off the cut, too far away, or ambiguous.
    notes: tuple[str, ...] = ()  #: Notes on ignored or assumed input.
    scanned: bool = False  #: Whether the points are a scan: errors of neighbours are then correlated.
    motion: Array | None = None  #: Rigid motion applied by a best fit, or None. Shape (4, 4). [m]

    def __len__(self) -> int:
        return len(self.length)

    @property
    def seen(self) -> Array:
        """Return the deviation in the measured directions. Shape (m, 3). [m]."""
        return np.asarray(np.einsum("mij,mj->mi", self.counts, self.deviation))


def match_points(
    table: Table, nominal: Toolpath, T_base_part: Array, *, in_base: bool, align: str = "datum",
    sigma: float | None = None, accept_implausible: bool = False, surface: Surface | None = None,
) -> MeasuredPath:  # fmt: skip
    """Match measured points (`read_measured_points`) with the nominal path, base frame.

    Options: see `compplan.learning.part.learn_from_part`; T_base_part: pose of the part frame, (4, 4) [m]; surface: in
    the frame of the points.

    Raises:
        InputError: If too few points belong to the cut.
    """
    given, scanned = table.stack(["x", "y", "z"]), is_scanned(table)
    surface = surface if surface is None or in_base else surface.move(T_base_part)
    point, normal, motion, moved = _place_points(
        table, given, nominal, T_base_part, in_base=in_base, align=align, surface=surface
    )
    level = sigma or (SCAN_SIGMA if scanned else SIGMA)
    spread = table.values.get("sigma", np.full(len(table), level))
    spread = np.where(np.isfinite(spread), spread, level)
    if surface is not None:
        _check_surface(table, nominal, surface, "base" if in_base else "part")
        length, deviation, counts, good = _at_surface(nominal, point, surface)
    elif "s" in table:
        length, deviation, counts, good = _at_lengths(nominal, point, table.values["s"], normal)
    else:
        length, deviation, counts, good = (
            _at_nearest(nominal, point) if normal is None else _at_normals(nominal, point, normal)
        )
    distance = np.linalg.norm(deviation, axis=1)
    wide, whole = (np.ptp(np.quantile(part, (0.05, 0.95), axis=0), axis=0).max() for part in (given, nominal.position))
    if not accept_implausible and wide < SPOT * whole:
        raise table.error(
            f"the points extend over {wide * 1e3:.3g} mm, the path over {whole * 1e3:.3g} mm: are they in metres or"
            " inches, not in mm? --assume-ok learns them as they are"
        )
    strange = not scanned and not accept_implausible and float((distance > FARTHEST).mean()) > MOST_OUT
    if good.sum() < FEWEST or strange:
        raise table.error(
            f"{int(good.sum())} of {len(point)} points are on the cut; expected at least {FEWEST}, and half of all"
            f" within {FARTHEST * 1e3:g} mm of the path (median distance {float(np.median(distance)) * 1e3:.4g} mm)."
            f" In the {'part frame? Add --frame part' if in_base else 'robot base? Add --frame base'}."
            " Else: another part, not mm, or axes swapped?"
        )
    places = len(np.unique(np.round(length[good], 6)))
    if places < FEWEST:
        raise table.error(f"{int(good.sum())} points measure {places} places of the cut, expected at least {FEWEST}")
    notes = [*table.notes, *moved]
    if scanned and sigma is None:
        notes.append(f"no standard deviation of the scan is stated (--sigma-mm): {SCAN_SIGMA * 1e3:g} mm is assumed")
    notes += [] if scanned else _describe_left_out(table, good)
    left_out, again = int((~good).sum()), find_repeated_points(table)
    if again.any() and not scanned:
        notes.append(f"{int(again.sum())} rows are there twice, to the last digit: each counts once")
        good = good & ~again
    return MeasuredPath(
        length[good], deviation[good], counts[good], spread[good], left_out, tuple(notes), scanned,
        motion,
    )  # fmt: skip


def _place_points(
    table: Table, given: Array, nominal: Toolpath, T_base_part: Array, *, in_base: bool, align: str,
    surface: Surface | None,
) -> tuple[Array, Array | None, Array | None, tuple[str, ...]]:  # fmt: skip
    """Transform points to the base frame; return them, their normals, the best-fit motion, and its description."""
    point = given if in_base else given @ T_base_part[:3, :3].T + T_base_part[:3, 3]
    skin = surface is None and (is_scanned(table) or "nx" in table)
    normal = _find_normals(table, point, None if in_base else T_base_part) if skin else None
    if align == "datum":
        return point, normal, None, ()
    motion, left = fit_rigid(point, normal, nominal, FARTHEST, surface)
    if not np.isfinite(left):
        return point, normal, None, ()
    text = f"best fit: the points were moved by {describe_motion(motion, point.mean(axis=0))}"
    turned = None if normal is None else normal @ motion[:3, :3].T
    moved = point @ motion[:3, :3].T + motion[:3, 3]
    return moved, turned, motion, (f"{text}; a shift or turn of the whole part is then ignored",)


def reach_of(process: object) -> float:
    """Return the reach of a process: greatest distance of the cut surface from the tip, by the cutter's radius. [m]"""
    return 0.5e-3 * float(getattr(process, "diameter_mm", 0.0)) + BESIDE


def _find_normals(table: Table, point: Array, T_base_part: Array | None) -> Array | None:
    """Return the normals of a scan, given or fitted to neighbours; None if its points form a line. Shape (m, 3)."""
    if "nx" in table:
        normal = table.stack(["nx", "ny", "nz"])
        return normal if T_base_part is None else normal @ T_base_part[:3, :3].T
    _, index = cKDTree(point).query(point, k=min(NEIGHBOURS, len(point)))
    near = point[index.reshape(len(point), -1)]
    near = near - near.mean(axis=1, keepdims=True)
    value, vector = np.linalg.eigh(np.einsum("mki,mkj->mij", near, near))
    if np.median(value[:, 1] / np.maximum(value[:, 2], 1e-300)) < LINE:
        return None
    return np.asarray(vector[:, :, 0])


def _describe_left_out(table: Table, good: NDArray[np.bool_]) -> list[str]:
    """Describe how many points are left out.

    Raises:
        InputError: If more than half are left out and arc lengths are not stated: the rest would be a biased selection.
    """
    out = int((~good).sum())
    if not out:
        return []
    text = f"{out} of {len(good)} measured points are left out: they are off the cut, or near two stretches of it"
    if "s" in table or out < STRANGE * len(good):
        return [text]
    help_ = "the stretches are too close together for such deviations; state s_mm, the length of the path at each point"
    if out > MOST_OUT * len(good):
        raise table.error(f"{text}; {help_}")
    return [f"{text}; where {help_}"]


def _at_lengths(
    nominal: Toolpath, point: Array, length: Array, normal: Array | None
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points with the path at stated arc lengths, along their normals if given."""
    arc = nominal.arc_length
    stated, length = length, np.clip(length, 0.0, arc[-1])
    expected = np.stack([np.interp(length, arc, nominal.position[:, k]) for k in range(3)], axis=1)
    row = np.clip(np.searchsorted(arc, length), 1, len(arc) - 1)
    along = (nominal.position[row] - nominal.position[row - 1]) / np.maximum(arc[row] - arc[row - 1], 1e-12)[:, None]
    beyond = stated - length  # a part is slightly longer or shorter than the path: its ends are extended straight
    deviation = point - expected - beyond[:, None] * along
    near = (np.abs(beyond) <= BEYOND) & (np.linalg.norm(deviation, axis=1) <= FARTHEST)
    good = near & ~nominal.rapid[row]
    if normal is None:
        return length, deviation, np.broadcast_to(np.eye(3), (len(point), 3, 3)).copy(), good
    counts = np.einsum("mi,mj->mij", normal, normal)
    return length, np.einsum("mij,mj->mi", counts, deviation), counts, good


def _at_normals(nominal: Toolpath, point: Array, normal: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points of a surface with the nearest places of the cut, along the normals of the points."""
    way, place, tangent = sample_cut(nominal)
    _, index = cKDTree(place).query(point)
    gap, along = point - place[index], tangent[index]
    # gap = off n + slip t + rest on the surface; points whose normals are along the path are left out
    lean = np.einsum("mi,mi->m", normal, along)
    across = normal - lean[:, None] * along
    square = np.sum(across**2, axis=1)
    off = np.einsum("mi,mi->m", gap, across) / np.maximum(square, FLAT)
    deviation = off[:, None] * normal
    slip = np.einsum("mi,mi->m", gap - deviation, along)
    aside = np.linalg.norm(gap - deviation - slip[:, None] * along, axis=1)
    good = (aside <= BESIDE) & (np.abs(slip) <= BESIDE) & (np.abs(off) <= FARTHEST) & (square > FLAT)
    return way[index] + slip, deviation, np.einsum("mi,mj->mij", normal, normal), good


def _check_surface(table: Table, nominal: Toolpath, surface: Surface, frame: str) -> None:
    """Reject a nominal surface far from the cut: another part, frame or unit."""
    place = sample_cut(nominal)[1]
    place = place[:: max(1, len(place) // 1000)]
    away = float(np.median(np.linalg.norm(surface.find_nearest(place)[0] - place, axis=1)))
    if away > surface.reach:
        raise table.error(
            f"the nominal mesh lies {away * 1e3:.3g} mm from the cut (median), expected at most"
            f" {surface.reach * 1e3:.3g} mm; is it in the {frame} frame, in mm? --reach-mm states how far from the tip"
            " the tool cuts"
        )


def _at_surface(nominal: Toolpath, point: Array, surface: Surface) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points with the nominal surface along its normals; assign each to the nearest place of the cut.

    The tool cuts the surface within its reach from its axis, above the tip.
    """
    way, place, tangent = sample_cut(nominal)
    foot, normal, off = surface.find_nearest(point)
    index = cKDTree(place).query(foot)[1]
    away, along = foot - place[index], tangent[index]
    axis = nominal.axis[np.clip(np.searchsorted(nominal.arc_length, way[index]), 0, len(nominal) - 1)]
    height, slip = np.einsum("mi,mi->m", away, axis), np.einsum("mi,mi->m", away, along)
    near = (np.linalg.norm(away - height[:, None] * axis, axis=1) <= surface.reach) & (height >= -surface.reach)
    across = 1.0 - np.einsum("mi,mi->m", normal, along) ** 2
    off = np.nan_to_num(off, nan=np.inf)
    good = near & (np.abs(slip) <= BESIDE) & (np.abs(off) <= FARTHEST) & (across > FLAT)
    off = np.where(good, off, 2.0 * FARTHEST)
    return way[index] + slip, off[:, None] * normal, np.einsum("mi,mj->mij", normal, normal), good


def _at_nearest(nominal: Toolpath, point: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points with the nearest places of the cut, across the path only."""
    (way, place, along), arc = sample_cut(nominal), nominal.arc_length
    tree = cKDTree(place)
    distance, index = tree.query(point, k=min(64, len(place)))
    distance, index = distance.reshape(len(point), -1), index.reshape(len(point), -1)
    nearest = index[:, 0]
    tangent = along[nearest]
    deviation = point - place[nearest]
    slip = np.einsum("mi,mi->m", deviation, tangent)
    deviation = deviation - slip[:, None] * tangent
    size = np.maximum(np.linalg.norm(deviation, axis=1), NEAREST)
    apart = np.abs(way[index] - way[nearest][:, None])
    closed = arc[-1] - apart  # the ends of a closed path coincide
    elsewhere = (np.minimum(apart, closed) > 10 * size[:, None]) & (distance < CLAIMED * size[:, None])
    good = (distance[:, 0] <= FARTHEST) & ~elsewhere.any(axis=1)
    counts = np.eye(3) - np.einsum("mi,mj->mij", tangent, tangent)
    return way[nearest] + slip, deviation, counts, good
