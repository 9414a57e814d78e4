"""What chatter costs in the choice of a posture: a few nodes of the graph are judged, the others take the nearest's."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compplan.posture.lattice import Lattice
from compplan.robot import Array

#: A cut that is deeper than its limit by this factor or less is not counted as stable by the search: nodes between
#: those that are judged differ, and the zero-order solution is not exact (assumed).
RESERVE = 1.3
#: Stations of the cut whose nodes are judged at most, and nodes of each.
STATIONS, NODES = 8, 96
#: Waypoints of a finished posture that are judged at most.
LOOKED = 40


class ChatterPrice(Protocol):
    """How far cuts are beyond the limit of chatter."""

    @property
    def source(self) -> str:
        """Say what is assumed."""
        ...

    def touches(self, waypoints: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Tell where the cutter is in material. Shape (m,)."""
        ...

    def excess(self, q: Array, waypoints: NDArray[np.int_], reserve: float) -> Array:
        """Return by which share `reserve` times the cut's depth lies beyond the limit, 0 for none. Shape (m,)."""
        ...


class ChatterCount(NamedTuple):
    """Waypoints of a posture at which the cut chatters, of how many that were judged, and what that assumes."""

    at: int
    of: int
    source: str


def price_chatter(price: ChatterPrice | None, lattice: Lattice) -> Lattice:
    """Return a graph whose nodes know how far their cut is beyond the limit of chatter."""
    if price is None:
        return lattice
    chatter = np.zeros(lattice.reason.shape)
    cut = np.flatnonzero(price.touches(lattice.stations) & lattice.usable.any(axis=(1, 2)))
    if not len(cut):
        return replace(lattice, chatter=chatter)
    looked = cut[np.unique(np.linspace(0, len(cut) - 1, min(STATIONS, len(cut))).astype(int))]
    near = np.abs(cut[:, None] - looked[None, :]).argmin(axis=1)
    for number, station in enumerate(looked):
        nodes = np.argwhere(lattice.usable[station])
        few = nodes[np.unique(np.linspace(0, len(nodes) - 1, min(NODES, len(nodes))).astype(int))]
        q = lattice.q[station, few[:, 0], few[:, 1]]
        found = price.excess(q, np.full(len(q), lattice.stations[station]), RESERVE)
        for mine in cut[near == number]:
            every = np.argwhere(lattice.usable[mine])
            nearest = cKDTree(q).query(lattice.q[mine, every[:, 0], every[:, 1]])[1]
            chatter[mine, every[:, 0], every[:, 1]] = found[nearest]
    return replace(lattice, chatter=chatter)


def count_chatter(price: ChatterPrice | None, q: Array) -> ChatterCount | None:
    """Count the waypoints of a finished posture at which the cut chatters. q: shape (n, nq) [rad or m]."""
    if price is None:
        return None
    beyond = judge_chatter(price, q, 1.0)
    return ChatterCount(int((beyond > 0.0).sum()), len(beyond), price.source)


def judge_chatter(price: ChatterPrice, q: Array, reserve: float) -> Array:
    """Return how far a deeper cut is beyond its limit at some waypoints of a finished posture, as `excess` tells.

    Args:
        price: The cut.
        q: Joint positions. Shape (n, nq). [rad or m]
        reserve: Factor on the depth.

    """
    rows = np.flatnonzero(price.touches(np.arange(len(q))))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(LOOKED, len(rows))).astype(int))] if len(rows) else rows
    return price.excess(q[rows], rows, reserve)
