"""How much of its tolerance a deviation uses, where parts of a path have others, across and along the travel apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.measurement.distance import band_radius
from compplan.robot import Array
from compplan.toolpath.toolpath import Toolpath

#: Turn of the travel from which on a waypoint is a corner: it has no one travel, and its whole distance counts. [rad]
CORNER = float(np.radians(10.0))


class Allowed(NamedTuple):
    """The tolerance of a path; n waypoints."""

    normal: Array  #: Greatest deviation across the travel, or in all where they do not count apart. Shape (n,). [m]
    tangential: Array  #: Greatest deviation along the travel. Shape (n,). [m]
    apart: NDArray[np.bool_]  #: Whether both count apart. Shape (n,).
    travel: Array  #: Unit vector of the travel. Shape (n, 3).
    moves: Array  #: The first of the move that ends at each waypoint but 0. Shape (n - 1,). [m]

    def use(self, away: Array) -> Array:
        """Return the share of its tolerance that a deviation (n, 3) [m] uses at each waypoint. Shape (n,)."""
        whole = np.linalg.norm(away, axis=1)
        along = np.abs(np.einsum("ni,ni->n", away, self.travel))
        across = np.sqrt(np.maximum(whole**2 - along**2, 0.0))
        return np.where(self.apart, np.maximum(across / self.normal, along / self.tangential), whole / self.normal)

    def use_of_band(self, radius: Array, covariance: Array, mean: Array | None) -> Array:
        """Return the share of its tolerance that a 95 % band (n,) [m] uses, across and along as its covariance has it.

        Only the shape of the covariance (n, 3, 3) counts; mean: of the deviation, zero if left out (n, 3). [m]
        """
        found, rows = radius / self.normal, np.flatnonzero(self.apart)
        if not len(rows):
            return found
        own = np.einsum("ni,nj->nij", self.travel[rows], self.travel[rows])
        whole = covariance[rows]
        shift = np.zeros((len(rows), 3)) if mean is None else mean[rows]
        sizes = []
        for side in (np.eye(3) - own, own):
            moved = (side @ shift[..., None])[..., 0]
            sizes.append(band_radius(side @ whole @ side, mean=moved))
        size = np.maximum(band_radius(whole, mean=shift), 1e-300)
        limits = self.normal[rows], self.tangential[rows]
        across, along = (part / size / limit for part, limit in zip(sizes, limits, strict=True))
        found[rows] = radius[rows] * np.maximum(across, along)
        return found


def find_allowed(nominal: Toolpath) -> Allowed | None:
    """Return the tolerance of a path; None where one is for all. At a waypoint the stricter of its two moves counts."""
    if nominal.tolerance is None:
        return None
    n, cutting = len(nominal), ~nominal.rapid
    limits = np.where(cutting[:, None], nominal.tolerance, np.inf)
    limits[0] = np.inf
    after = np.vstack([limits[1:], np.full((1, 2), np.inf)])
    normal, tangential = np.fmin(limits[:, 0], after[:, 0]), np.minimum(limits[:, 1], after[:, 1])
    alone = ~np.isfinite(normal)  # in rapid moves alone
    normal, moves = np.where(alone, nominal.tolerance[:, 0], normal), np.diff(nominal.position, axis=0)
    size = np.linalg.norm(moves, axis=1, keepdims=True)
    unit = np.divide(moves, size, out=np.zeros_like(moves), where=size > 1e-12)
    before, behind = np.vstack([unit[:1], unit]), np.vstack([unit, unit[-1:]])
    goes_on = np.r_[cutting[1:], False][:, None]
    before, behind = np.where(cutting[:, None], before, behind), np.where(goes_on, behind, before)
    travel = before + behind
    length = np.linalg.norm(travel, axis=1, keepdims=True)
    straight = np.einsum("ni,ni->n", before, behind) > np.cos(CORNER)
    travel = np.divide(travel, length, out=np.zeros((n, 3)), where=length > 1e-12)
    return Allowed(normal, tangential, np.isfinite(tangential) & straight, travel, nominal.tolerance[1:, 0])
