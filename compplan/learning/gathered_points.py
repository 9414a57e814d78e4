"""Measured points averaged at rows of the path: mean deviation, measured directions, and variance."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from compplan.learning.measured_path import MeasuredPath
from compplan.robot import Array
from compplan.robot.pose import rigid_columns

#: Points within this distance along the path are averaged at a row. [m]
NEAR = 2e-3
#: Least share of the weight of a row's points along a direction that counts as measured (assumed).
LEAST_SHARE = 0.2
#: Length scale over which measured directions are averaged, so that both sides of a corner count (assumed). [m]
AROUND = 0.01
#: Quantile of the steps between neighbouring points that is the usual step (assumed: longer ones are gaps).
USUAL = 0.9
#: Scan points of one row that count as independent, at most (assumed: the errors of an instrument are smooth).
ALONE = 10.0
#: Singular values of shift and turn below this share of the largest are not observable (rounding).
OBSERVABLE = 1e-6
#: A rigid motion is not observable if the measured directions contain less than this share of it, such as the turn
#: about the axis of a circle that was probed radially (assumed: measuring directions are known to a degree, and to the
#: angle between the moves of the path, across which points are measured).
ACROSS = 0.02
#: Least share of the squared deviation that a reported rigid motion of the part explains, and least ratio to the noise
#: (assumed).
WHOLE, CLEAR = 0.6, 3.0


@dataclass(frozen=True, eq=False)
class Gathered:
    """Measured points averaged at rows of the path; b rows."""

    row: NDArray[np.int_]  #: Row of `Slopes`. Shape (b,).
    deviation: Array  #: Mean deviation in the measured directions. Shape (b, 3). [m]
    counts: Array  #: Projector on the measured directions. Shape (b, 3, 3).
    variance: Array  #: Variance of the mean per axis. Shape (b,). [m^2]
    points: NDArray[np.int_]  #: Number of points averaged. Shape (b,).

    def take(self, rows: NDArray[np.bool_]) -> Gathered:
        """Return the selected rows."""
        parts: dict[str, Any] = {f.name: getattr(self, f.name)[rows] for f in fields(self)}
        return replace(self, **parts)


def gather_points(measured: MeasuredPath, length: Array) -> Gathered:
    """Average measured points at the nearest rows of the path, whose arc lengths are (k,) [m]; drop distant points."""
    middle = 0.5 * (length[1:] + length[:-1])
    row = np.searchsorted(middle, measured.length)
    window = max(NEAR, 3.0 * (length[-1] - length[0]) / len(measured))
    near = np.abs(measured.length - length[row]) <= window
    row = row[near]
    rows, index, count = np.unique(row, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    weight = 1.0 / measured.sigma[near] ** 2
    total, inverse = np.zeros((len(rows), 3)), np.zeros(len(rows))
    information = np.zeros((len(rows), 3, 3))
    np.add.at(total, index, weight[:, None] * measured.seen[near])
    np.add.at(inverse, index, weight)
    np.add.at(information, index, weight[:, None, None] * measured.counts[near])
    # least squares in the directions of a row: one, or several at a corner and where a probe touched from several sides
    value, vector = np.linalg.eigh(information / inverse[:, None, None])
    kept = value > LEAST_SHARE
    counts = np.einsum("bik,bk,bjk->bij", vector, kept, vector)
    least = np.where(kept, value, 1.0)
    deviation = np.einsum("bik,bk,bjk,bj->bi", vector, kept / least, vector, total / inverse[:, None])
    variance = 1.0 / (inverse * least.min(axis=1))
    variance = variance * (np.maximum(count / ALONE, 1.0) if measured.scanned else 1.0)
    return Gathered(rows, deviation, counts, variance, count)


def measured_directions(gathered: Gathered, tip: Array, place: Array) -> Array:
    """Return weights from 0 to 1 of the directions measured around positions, (n, 3) [m]. Shape (n, 3, 3).

    A direction has weight 1 if half of the surrounding points measure it: both sides of a corner count. Weights are
    full within the usual distance of neighbouring points, and decay beyond it as a Gaussian of that width.
    tip: at the rows of the path, (k, 3) [m].
    """
    point = tip[gathered.row]
    away = cdist(place, point)
    nearest = away.min(axis=1, keepdims=True)
    weight = np.exp(-0.5 * (away**2 - nearest**2) / AROUND**2)
    around = np.einsum("nb,bij->nij", weight / weight.sum(axis=1, keepdims=True), gathered.counts)
    value, vector = np.linalg.eigh(around)
    directions = np.einsum("nik,nk,njk->nij", vector, np.clip(2.0 * value, 0.0, 1.0), vector)
    steps = np.linalg.norm(np.diff(point, axis=0), axis=1)
    reach = max(AROUND, float(np.quantile(steps, USUAL)) if len(steps) else 0.0)
    beyond = np.maximum(nearest[:, :, None] / reach - 1.0, 0.0)
    return np.asarray(np.exp(-0.5 * beyond**2) * directions)


def describe_whole(gathered: Gathered, tip: Array, R_base_part: Array, expected: Array) -> tuple[str, bool]:
    """Describe the rigid motion of the part if it dominates the deviations; also return whether it is unexpected.

    Only combinations of shift and turn that are observable and significant against the noise count.

    tip: at the rows of the path, (k, 3) [m]; R_base_part: part axes in the base frame, (3, 3); expected: prior
    covariance of the deviations (`expect_deviations`), (3 b, 3 b) [m^2].
    """
    size = max(float(np.ptp(tip, axis=0).max()), 1e-3)
    sigma = np.repeat(np.sqrt(gathered.variance), 3)
    rigid = rigid_columns(tip, tip.mean(axis=0))[gathered.row] / np.repeat([1.0, size], 3)
    matrix, seen = (gathered.counts @ rigid).reshape(-1, 6), gathered.deviation.reshape(-1)
    left, value, right = np.linalg.svd(matrix / sigma[:, None], full_matrices=False)
    shares = left.T @ (seen / sigma)  # each of variance 1
    across, moved = (np.linalg.norm(part @ right.T, axis=0) for part in (matrix, rigid.reshape(-1, 6)))
    ways = np.diff(tip, axis=0) / np.maximum(np.linalg.norm(np.diff(tip, axis=0), axis=1, keepdims=True), 1e-12)
    bend = float(np.median(np.linalg.norm(np.diff(ways, axis=0), axis=1))) if len(tip) > 2 else 0.0
    clear = (np.abs(shares) > CLEAR) & (value > OBSERVABLE * value.max(initial=0.0))
    clear &= across > max(ACROSS, bend) * moved
    motion = right[clear].T @ (shares[clear] / value[clear])
    rest = seen - matrix @ motion
    taken = 1.0 - float(rest @ rest) / max(float(seen @ seen), 1e-300)
    if taken < WHOLE or seen @ seen < CLEAR**2 * float(gathered.variance.sum()):
        return "", False
    usual = np.einsum("oc,op,pc->c", left, expected / np.outer(sigma, sigma), left)
    where = ", ".join(f"{round(1e3 * value, 6):.2g}" for value in motion[:3] @ R_base_part)
    text = (
        f"{100 * taken:.0f} % of the measured deviation is a shift of the whole part by [{where}] mm (at its centre,"
        f" part axes) and a turn of {round(float(np.degrees(np.linalg.norm(motion[3:]))) / size, 6):.2g} deg"
    )
    return text, bool((np.abs(shares[clear]) > CLEAR * np.sqrt(usual[clear])).any())
