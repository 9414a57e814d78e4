"""Points measured on a cut part, brought to the path: deviation, place along it, and which directions count.

A point that says how far along the path it was taken (s_mm, rapid moves included) counts in all directions. One that
does not belongs to the nearest point of the path, and along the path it says nothing. A point that two stretches of the
path claim is left out. A point of a scan has a normal: it counts along that, and only where it lies beside the path.
Where the nominal surface is given it counts along the normal of that, as far from the path as the tool makes it.
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

#: Points whose stated length lies beyond an end of the path by no more belong to that end. [m]
BEYOND = 1e-3
#: Another stretch of the path claims a point where it is less than so many times as far.
CLAIMED = 2.0
#: Points that extend over less than this share of the path are of one spot (assumed: nobody measures so little).
SPOT = 0.02
#: Points without their place along the path: shares left out that are said, and that are too many (assumed).
STRANGE, MOST_OUT = 0.1, 0.5
#: Points nearer than this to the path are taken for so far off. [m]
NEAREST = 1e-4
#: Fewest points that teach anything.
FEWEST = 8
#: Standard deviation of a point where the file states none (assumed). [m]
SIGMA = 2e-5
#: Points of a scan count within this distance of the path, along the surface. [m]
BESIDE = 1e-3
#: Neighbours that a normal is found from, and the share of its length to which a cloud is a line without (assumed).
NEIGHBOURS, LINE = 12, 0.02
#: Square of a normal's part across the path below which it tells nothing of it (assumed: 60 degrees).
FLAT = 0.25


@dataclass(frozen=True, eq=False)
class MeasuredPath:
    """Measured points of a cut path, base frame; m of them."""

    length: Array  #: Place along the path. Shape (m,). [m]
    deviation: Array  #: Measured minus wanted tip. Shape (m, 3). [m]
    counts: Array  #: Projector on the directions that count. Shape (m, 3, 3).
    sigma: Array  #: Standard deviation of the measurement per axis. Shape (m,). [m]
    left_out: int  #: Points that are not of the cut, too far away, or claimed by two stretches.
    notes: tuple[str, ...] = ()  #: What was read past.
    scanned: bool = False  #: Whether they are a scan: errors of neighbours are then one and the same.
    motion: Array | None = None  #: Rigid motion that a best fit took off, or None. Shape (4, 4). [m]

    def __len__(self) -> int:
        return len(self.length)

    @property
    def seen(self) -> Array:
        """The part of the deviation that counts. Shape (m, 3). [m]."""
        return np.asarray(np.einsum("mij,mj->mi", self.counts, self.deviation))


def match_points(
    table: Table, nominal: Toolpath, T_base_part: Array, *, in_base: bool, align: str = "datum",
    sigma: float | None = None, sure: bool = False, surface: Surface | None = None,
) -> MeasuredPath:  # fmt: skip
    """Bring measured points (`read_measured_points`) to the path that was wanted, nominal, base frame.

    Options as of `compplan.learning.part.learn_from_part`; T_base_part: pose of the part frame, (4, 4) [m]; surface: in
    the frame of the points.

    Raises:
        InputError: If too few of the points are of the cut.
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
    if not sure and wide < SPOT * whole:
        raise table.error(
            f"the points extend over {wide * 1e3:.3g} mm and the path over {whole * 1e3:.3g} mm, are they in metres or"
            " inches, not in mm? --assume-ok learns them as they are"
        )
    strange = not scanned and not sure and float((distance > FARTHEST).mean()) > MOST_OUT
    if good.sum() < FEWEST or strange:
        raise table.error(
            f"{int(good.sum())} of {len(point)} points are of the cut, expected at least {FEWEST} and half of all"
            f" within {FARTHEST * 1e3:g} mm (median distance {float(np.median(distance)) * 1e3:.3g} mm); are they of"
            f" this part, in the {'base' if in_base else 'part'} frame (--frame), in mm, with its axes?"
        )
    places = len(np.unique(np.round(length[good], 6)))
    if places < FEWEST:
        raise table.error(f"{int(good.sum())} points are of {places} places of the cut, expected at least {FEWEST}")
    notes = [*table.notes, *moved]
    if scanned and sigma is None:
        notes.append(f"no standard deviation of the scan is stated (--sigma-mm): {SCAN_SIGMA * 1e3:g} mm is assumed")
    notes += [] if scanned else _describe_left_out(table, good)
    left_out, again = int((~good).sum()), find_repeated_points(table)
    if again.any() and not scanned:
        notes.append(f"{int(again.sum())} rows are there twice, to the last digit: each counts once.")
        good = good & ~again
    return MeasuredPath(
        length[good], deviation[good], counts[good], spread[good], left_out, tuple(notes), scanned,
        motion,
    )  # fmt: skip


def _place_points(
    table: Table, given: Array, nominal: Toolpath, T_base_part: Array, *, in_base: bool, align: str,
    surface: Surface | None,
) -> tuple[Array, Array | None, Array | None, tuple[str, ...]]:  # fmt: skip
    """Bring points to the base frame; return them, their normals, the motion of a best fit, and what is said of it."""
    point = given if in_base else given @ T_base_part[:3, :3].T + T_base_part[:3, 3]
    skin = surface is None and (is_scanned(table) or "nx" in table)
    normal = _find_normals(table, point, None if in_base else T_base_part) if skin else None
    if align == "datum":
        return point, normal, None, ()
    motion, left = fit_rigid(point, normal, nominal, FARTHEST, surface)
    if not np.isfinite(left):
        return point, normal, None, ()
    said = f"best fit: the points were moved by {describe_motion(motion, point.mean(axis=0))}"
    turned = None if normal is None else normal @ motion[:3, :3].T
    moved = point @ motion[:3, :3].T + motion[:3, 3]
    return moved, turned, motion, (f"{said}; a shift or turn of the whole part is then ignored",)


def reach_of(process: object) -> float:
    """Return how far from the path of the tip a process makes the surface of the part: its cutter's radius. [m]"""
    return 0.5e-3 * float(getattr(process, "diameter_mm", 0.0)) + BESIDE


def _find_normals(table: Table, point: Array, T_base_part: Array | None) -> Array | None:
    """Return the normals of a scan, its own or of neighbours; None where its points lie on a line. Shape (m, 3)."""
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
    """Say how many points do not count.

    Raises:
        InputError: If most of them do not, and none says where along the path it was taken: what is left is a choice.
    """
    out = int((~good).sum())
    if not out:
        return []
    said = f"{out} of {len(good)} measured points are not of the cut, or two stretches claim them: left out"
    if "s" in table or out < STRANGE * len(good):
        return [said]
    help_ = "the stretches lie too close for parts so far off; state s_mm, the length of the path at each point"
    if out > MOST_OUT * len(good):
        raise table.error(f"{said}; {help_}")
    return [f"{said}; where {help_}"]


def _at_lengths(
    nominal: Toolpath, point: Array, length: Array, normal: Array | None
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points with the path at stated lengths, along their normals where they have them."""
    arc = nominal.arc_length
    stated, length = length, np.clip(length, 0.0, arc[-1])
    wanted = np.stack([np.interp(length, arc, nominal.position[:, k]) for k in range(3)], axis=1)
    row = np.clip(np.searchsorted(arc, length), 1, len(arc) - 1)
    along = (nominal.position[row] - nominal.position[row - 1]) / np.maximum(arc[row] - arc[row - 1], 1e-12)[:, None]
    beyond = stated - length  # a part is a little longer or shorter than the path: its ends go on straight
    deviation = point - wanted - beyond[:, None] * along
    near = (np.abs(beyond) <= BEYOND) & (np.linalg.norm(deviation, axis=1) <= FARTHEST)
    good = near & ~nominal.rapid[row]
    if normal is None:
        return length, deviation, np.broadcast_to(np.eye(3), (len(point), 3, 3)).copy(), good
    counts = np.einsum("mi,mj->mij", normal, normal)
    return length, np.einsum("mij,mj->mi", counts, deviation), counts, good


def _at_normals(nominal: Toolpath, point: Array, normal: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points of a surface with the cut beside them, along their normals."""
    way, place, tangent = sample_cut(nominal)
    _, index = cKDTree(place).query(point)
    gap, along = point - place[index], tangent[index]
    # gap = off n + slip t beside what lies on the surface; normals along the path tell nothing of it
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
    """Refuse a nominal surface that the cut does not come near: another part, frame or unit."""
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
    """Compare points with the nominal surface along its normals; each belongs to the nearest place of the cut.

    The tool makes what lies within its reach of its axis, above the tip.
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
    """Compare points with the nearest ones of the cut; along the path nothing counts."""
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
    closed = arc[-1] - apart  # a closed path meets itself at its ends
    elsewhere = (np.minimum(apart, closed) > 10 * size[:, None]) & (distance < CLAIMED * size[:, None])
    good = (distance[:, 0] <= FARTHEST) & ~elsewhere.any(axis=1)
    counts = np.eye(3) - np.einsum("mi,mj->mij", tangent, tangent)
    return way[nearest] + slip, deviation, counts, good
