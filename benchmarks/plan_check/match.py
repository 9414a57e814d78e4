"""Where the rows of joints.csv lie on the CAM path, in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.plan_check.job import Array, Path3, Rows

#: A detour of the CAM path between two rows may be this much longer than the straight way.
SLACK, ROOM = 2.0, 2e-3
#: How much a place off the expected length counts against its distance.
PULL, FAINT = 0.02, 1e-6
#: Tips nearer than this are one place. [m]
SAME = 1e-9


@dataclass(frozen=True)
class Placed:
    """Where rows lie; shapes (n,).

    Attributes:
        arc: Length along the CAM path, rapid moves included. [m]
        cut_arc: Length cut so far. [m]
        away: Distance of the wanted tip from there. [m]
        segment: CAM move that it lies on (move k ends at vertex k).
        cuts: Whether the move that ends at the row is a cut.
        on: Whether the row has a place on the CAM path.
        contact: Length at which the cut of this row began. [m]
        leave: Length at which it ends. [m]
        programmed: Feed that is programmed for the move that ends here. [m/s]
    """

    arc: Array
    cut_arc: Array
    away: Array
    segment: np.ndarray
    cuts: np.ndarray
    on: np.ndarray
    contact: Array
    leave: Array
    programmed: Array


def place_rows(path: Path3, rows: Rows) -> Placed:
    """Place every row on the CAM path, never backwards.

    Where the file tells the moves apart, only cuts (and the rows that they begin at) have a place on the path.
    """
    n, arc = len(rows), path.arc
    on = np.ones(n, bool)
    if rows.move is not None:
        cut = rows.move == "cut"
        stays = np.r_[False, np.linalg.norm(np.diff(rows.wanted, axis=0), axis=1) < SAME]
        begins = cut & stays & ~np.r_[False, cut[:-1]]  # the first row of a cut that is reached loaded: no move of it
        cut = cut & ~begins
        on = cut | np.r_[cut[1:], False]
    along, away, segment = np.zeros(n), np.zeros(n), np.zeros(n, int)
    members = np.flatnonzero(on)
    last, before = 0.0, None
    for i in members:
        here = rows.wanted[i]
        anew = before is None or not on[i - 1]
        step = 0.0 if anew else float(np.linalg.norm(here - before))
        expected = last + step
        first = max(1, int(np.searchsorted(arc, last - 1e-9, side="left")))
        farthest = arc[-1] if anew and rows.move is not None else last + SLACK * step + (0.0 if anew else ROOM)
        final = int(np.searchsorted(arc, farthest, side="left"))
        span = np.arange(first, min(max(final, first), len(arc) - 1) + 1)
        start, length = path.position[span - 1], arc[span] - arc[span - 1]
        direction = (path.position[span] - start) / np.maximum(length, 1e-300)[:, None]
        projected = np.einsum("ki,ki->k", here - start, direction)
        # two candidates a move: the nearest place, and the place at the expected length
        share = np.clip(np.stack([projected, expected - arc[span - 1]]), np.maximum(last - arc[span - 1], 0.0), length)
        distance = np.linalg.norm(start + share[:, :, None] * direction - here, axis=2)
        place = arc[span - 1] + share
        pull = FAINT if anew else PULL
        best = np.unravel_index(int(np.argmin(distance + pull * np.abs(place - expected))), distance.shape)
        along[i], away[i], segment[i] = place[best], distance[best], span[best[1]]
        last, before = along[i], here
    # a row at a vertex ends the move before it, the first row excepted
    segment = np.where(along <= arc[segment - 1] + 1e-9, np.maximum(segment - 1, 0), segment)
    cuts = on & ~path.rapid[segment]
    cuts[members[0]] = False
    if rows.move is not None:
        cuts &= cut
    begin, end = _cuts(path)
    at = np.clip(np.searchsorted(arc[begin], along - 1e-9, side="right") - 1, 0, len(begin) - 1)
    at = np.where(cuts & (along > arc[end][at] + 1e-9), np.minimum(at + 1, len(begin) - 1), at)
    cut_arc = np.interp(along, arc, path.cut_arc) if np.all(np.diff(arc) > 0) else _interp(along, arc, path.cut_arc)
    return Placed(along, cut_arc, away, segment, cuts, on, arc[begin][at], arc[end][at], path.feed[segment])


def _cuts(path: Path3) -> tuple[np.ndarray, np.ndarray]:
    """Return first and last vertex of every cut."""
    cutting = ~path.rapid
    cutting[0] = False
    edges = np.diff(np.r_[0, cutting.astype(int), 0])
    return np.flatnonzero(edges == 1) - 1, np.flatnonzero(edges == -1) - 1


def _interp(where: Array, arc: Array, values: Array) -> Array:
    keep = np.r_[True, np.diff(arc) > 0]
    return np.interp(where, arc[keep], values[keep])


def distance_to_path(path: Path3, low: Array, high: Array, points: Array) -> Array:
    """Return the distance of points from the stretch of the CAM path between two lengths. Shapes (n,), (n, 3)."""
    arc = path.arc
    best = np.full(len(points), np.inf)
    first = np.clip(np.searchsorted(arc, low + 1e-9, side="left"), 1, len(arc) - 1)
    final = np.clip(np.searchsorted(arc, high - 1e-9, side="left"), first, len(arc) - 1)
    for shift in range(int((final - first).max(initial=-1)) + 1):
        rows = np.flatnonzero(first + shift <= final)
        k = first[rows] + shift
        length = arc[k] - arc[k - 1]
        direction = (path.position[k] - path.position[k - 1]) / np.maximum(length, 1e-300)[:, None]
        share = np.einsum("ni,ni->n", points[rows] - path.position[k - 1], direction)
        share = np.clip(share, np.maximum(low[rows] - arc[k - 1], 0), np.minimum(high[rows] - arc[k - 1], length))
        foot = path.position[k - 1] + share[:, None] * direction
        best[rows] = np.minimum(best[rows], np.linalg.norm(points[rows] - foot, axis=1))
    return best
