"""Blend zones: distance before a corner at which the controller may leave the path, for each language.

The distance is stated in the program, or is the manual's value for the word in the program; otherwise it is assumed. A
zone reaches at most half way to the nearer neighbour. `compplan trace` identifies the share of it that a controller
uses (`blend_share`).

A parabola that begins r before a corner and ends r behind it passes the corner at r |t' - t| / 4, with t and t' the
tangents before and behind it. Where that is more than the program allows there (`Program.corner`), the zone is made
smaller. At a corner that the plan rounds, the zone has the size that passes it at the same distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.controllers.shapes import find_arc
from compplan.controllers.writers.program import Program
from compplan.controllers.writers.text import LANGUAGES
from compplan.io.tables import Array

#: Speed of a move without a stated feed: the greatest plausible one. [m/s]
FASTEST = 20.0
#: Length below which a move is omitted. [m]
NOWHERE = 1e-8
#: Step to which smaller zones are rounded. [m]
STEP = 1e-6


@dataclass(frozen=True)
class BlendZone:
    """Default blend zone of a robot language."""

    size: float  #: Distance from the corner. [m]
    source: str  #: Origin of the number, or "assumed".
    share: float = 0.5  #: Greatest share of the shorter neighbouring move.
    #: Extra size due to the overlap of speed ramps: the distance at the feed in `overlap` times half the smoothing time
    #: of the controller.
    overlap: float = 0.0


ZONES = {name: BlendZone(**table["zone"]) for name, table in LANGUAGES.items()}
#: Zone of a language that is not listed, such as a custom post-processor.
OTHER = BlendZone(1e-4, "assumed")


def mark_moves(program: Program) -> NDArray[np.bool_]:
    """Return which moves of a fitted program have a length, or stop; a controller skips the others. Shape (m,)."""
    step = np.linalg.norm(np.diff(program.positions[:, :3, 3], axis=0), axis=1)
    alone, stops = program.alone(linear=True), program.stops(linear=True)
    return np.r_[True, step > NOWHERE] | alone | program.arcs | stops


def find_zones(program: Program, zone: BlendZone) -> tuple[Array, Array, Array]:
    """Return the blend zones at the ends of a fitted program's moves, and where they must be smaller than the default.

    Returns:
        Zones, 0 at exact stops, shape (m,) [m]; zones that the program must state because the default departs too far
        from the path, infinite elsewhere, shape (m,) [m]; default zones of the language, shape (m,) [m].
    """
    kept = mark_moves(program)
    position, via = program.positions[kept, :3, 3], program.via_positions[kept, :3, 3]
    stops, alone = program.stops(linear=True)[kept], program.alone(linear=True)[kept]
    feed = np.where(alone | (program.feed[kept] <= 0.0), FASTEST, 1e-3 * program.feed[kept])
    chord = np.diff(position, axis=0, prepend=position[:1])
    length = np.linalg.norm(chord, axis=1)
    room = zone.share * np.minimum(length, np.r_[length[1:], 0.0])
    size = zone.size + zone.overlap * 0.5 * program.smoothing * np.minimum(feed, np.r_[feed[1:], 0.0])
    size = np.where(stops, 0.0, np.minimum(size, room))
    row = np.cumsum(kept) - 1
    if program.corner is None:
        return size[row], np.full(len(row), np.inf), size[row]
    leaves = chord / np.maximum(length, 1e-12)[:, None]
    comes = leaves.copy()
    for k in np.flatnonzero(np.isfinite(via[:, 0]) & ~alone & (np.arange(len(via)) > 0)).tolist():
        arc = find_arc(position[k - 1], via[k], position[k])
        if arc is not None:
            leaves[k], comes[k] = arc.tangent(0.0), arc.tangent(arc.sweep)
    turn = np.linalg.norm(np.r_[leaves[1:], comes[-1:]] - comes, axis=1)
    corners, departure = program.corners[kept], program.corner[kept]
    if program.corner_shift is not None:
        departure = np.where(corners, np.linalg.norm(program.corner_shift[kept], axis=1), departure)
    most = 4.0 * departure / (np.maximum(program.blend_share, 1e-3) * np.maximum(turn, 1e-12))
    most = np.where(corners, np.minimum(most, room), most)
    stated = np.where((size > most) | (corners & ~stops), np.maximum(np.floor(most / STEP), 1.0) * STEP, np.inf)
    return np.where(corners & ~stops, stated, np.minimum(size, stated))[row], stated[row], size[row]


def mark_narrow(program: Program, language: str) -> NDArray[np.bool_]:
    """Return at which moves' ends the default zone of a language would depart too far from the path. Shape (m,)."""
    _, stated, own = find_zones(program, ZONES[language])
    return stated < own
