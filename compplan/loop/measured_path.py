"""Points measured on a cut part, brought to the path: deviation, place along it, and which directions count.

A point that says how far along the path it was taken (s_mm, rapid moves included) counts in all directions. One that
does not belongs to the nearest point of the path, and along the path it says nothing. A point that two stretches of the
path claim is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compplan.files.columns import FileColumn
from compplan.files.given import open_table
from compplan.files.tables import Table
from compplan.path.toolpath import Toolpath
from compplan.robot import Array

#: Points farther from the path are no measurement of it. [m]
FARTHEST = 0.02
#: Points whose stated length lies beyond an end of the path by no more belong to that end. [m]
BEYOND = 1e-3
#: Another stretch of the path claims a point where it is less than so many times as far.
CLAIMED = 2.0
#: Points without their place along the path: shares left out that are said, and that are too many (assumed).
STRANGE, MOST_OUT = 0.1, 0.5
#: Points nearer than this to the path are taken for so far off. [m]
NEAREST = 1e-4
#: Fewest points that teach anything.
FEWEST = 8
#: Distance between points that the path is sampled at, and how many at most. [m]
SPACING, MOST = 5e-4, 400000
#: Standard deviation of a point where the file states none (assumed). [m]
SIGMA = 2e-5


@dataclass(frozen=True, eq=False)
class MeasuredPath:
    """Measured points of a cut path, base frame; m of them.

    Attributes:
        length: Place along the path. Shape (m,). [m]
        deviation: Measured minus wanted tip. Shape (m, 3). [m]
        counts: Projector on the directions that count. Shape (m, 3, 3).
        sigma: Standard deviation of the measurement per axis. Shape (m,). [m]
        left_out: Points that are not of the cut, too far away, or claimed by two stretches.
        notes: What was read past.
    """

    length: Array
    deviation: Array
    counts: Array
    sigma: Array
    left_out: int
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.length)

    @property
    def seen(self) -> Array:
        """The part of the deviation that counts. Shape (m, 3). [m]."""
        return np.asarray(np.einsum("mij,mj->mi", self.counts, self.deviation))


def take_points(measured: MeasuredPath, rows: NDArray[np.bool_]) -> MeasuredPath:
    """Take some of the points."""
    parts = {name: getattr(measured, name)[rows] for name in ("length", "deviation", "counts", "sigma")}
    return replace(measured, **parts)


def read_measured_points(source: Any) -> Table:
    """Read measured points: x_mm y_mm z_mm, and where they are known s_mm and sigma_mm.

    Args:
        source: The file, or its columns.

    Raises:
        InputError: If the file is not such a table.
    """
    columns = [FileColumn(axis, "length", required=True) for axis in "xyz"]
    columns += [FileColumn("s", "length"), FileColumn("sigma", "length", missing=True)]
    table = open_table(source, columns, what="measured points", unknown="note")
    if not len(table):
        raise table.error("the table has no rows, expected one row a measured point")
    sigma = table.values.get("sigma", np.full(len(table), np.nan))
    wrong = (sigma <= 0.0) | (sigma > FARTHEST)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        message = f"sigma_mm is {sigma[row] * 1e3:g}, expected more than 0 and at most {FARTHEST * 1e3:g} mm"
        raise table.error(f"{message}; leave it empty where it is not known", row)
    return table


def match_points(table: Table, nominal: Toolpath, T_base_part: Array, *, in_base: bool) -> MeasuredPath:
    """Bring measured points to the path that was wanted.

    Args:
        table: The points, see `read_measured_points`.
        nominal: The path, base frame.
        T_base_part: Pose of the part frame. Shape (4, 4). [m]
        in_base: Whether the points are in the base frame; otherwise in the part frame.

    Raises:
        InputError: If too few of the points are of the cut.
    """
    point = table.stack(["x", "y", "z"])
    if not in_base:
        point = point @ T_base_part[:3, :3].T + T_base_part[:3, 3]
    sigma = table.values.get("sigma", np.full(len(table), SIGMA))
    sigma = np.where(np.isfinite(sigma), sigma, SIGMA)
    if "s" in table:
        found = _at_lengths(nominal, point, table.values["s"])
    else:
        found = _at_nearest(nominal, point)
    length, deviation, counts, good = found
    if good.sum() < FEWEST:
        far = float(np.median(np.linalg.norm(deviation, axis=1))) * 1e3
        raise table.error(
            f"{int(good.sum())} of {len(point)} points are of the cut, expected at least {FEWEST} within"
            f" {FARTHEST * 1e3:g} mm (median distance {far:.3g} mm); are they in the {'base' if in_base else 'part'}"
            " frame, in mm?"
        )
    places = len(np.unique(np.round(length[good], 6)))
    if places < FEWEST:
        raise table.error(f"{int(good.sum())} points are of {places} places of the cut, expected at least {FEWEST}")
    notes = (*table.notes, *_describe_left_out(table, good))
    return MeasuredPath(length[good], deviation[good], counts[good], sigma[good], int((~good).sum()), notes)


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


def _at_lengths(nominal: Toolpath, point: Array, length: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points with the path at stated lengths."""
    arc = nominal.arc_length
    stated, length = length, np.clip(length, 0.0, arc[-1])
    wanted = np.stack([np.interp(length, arc, nominal.position[:, k]) for k in range(3)], axis=1)
    row = np.clip(np.searchsorted(arc, length), 1, len(arc) - 1)
    along = (nominal.position[row] - nominal.position[row - 1]) / np.maximum(arc[row] - arc[row - 1], 1e-12)[:, None]
    beyond = stated - length  # a part is a little longer or shorter than the path: its ends go on straight
    deviation = point - wanted - beyond[:, None] * along
    near = (np.abs(beyond) <= BEYOND) & (np.linalg.norm(deviation, axis=1) <= FARTHEST)
    good = near & ~nominal.rapid[row]
    return length, deviation, np.broadcast_to(np.eye(3), (len(point), 3, 3)).copy(), good


def _at_nearest(nominal: Toolpath, point: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Compare points with the nearest ones of the cut; along the path nothing counts."""
    arc = nominal.arc_length
    cut = np.flatnonzero(~nominal.rapid[1:] & (nominal.steps > 0))
    count = np.clip(np.ceil(nominal.steps[cut] / max(SPACING, arc[-1] / MOST)), 1, 10000).astype(int)
    move = np.repeat(cut, count)
    share = (np.arange(len(move)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    place = nominal.position[move] * (1 - share[:, None]) + nominal.position[move + 1] * share[:, None]
    way = arc[move] + share * nominal.steps[move]
    tree = cKDTree(place)
    distance, index = tree.query(point, k=min(64, len(place)))
    distance, index = distance.reshape(len(point), -1), index.reshape(len(point), -1)
    nearest = index[:, 0]
    along = nominal.position[move + 1] - nominal.position[move]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
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
