"""Mechanistic force of a rotating cutter: mean wrench and ripple of every waypoint, from its engagement.

An edge slice at angle u (from the travel to the left) meets a chip h = f v.n + f^2 c / 2 (f: feed a tooth, v: direction
of travel, n: outward normal) [Altintas2012, generalised to any profile]: the tooth before it stood a feed back, and its
surface, of curvature c along the travel, bends away. So a tooth is in the cut up to v.n = -f c / 2: near the tip of a
ball that is a few per cent of its edge force (on a side, half a per cent, it is left out). The spindle turns clockwise,
seen from the spindle. The force on the slice is F_t (z x r) - F_r n - F_a e, e along the edge towards the spindle, so
that a positive axial coefficient draws the tool out of the spindle. Over a turn of a cutter with N teeth

    w = N / (2 pi) * sum over slices and angles of (K h^(1 - m) + K_edge) * length * du,

which is linear in the coefficients; their columns are kept, to first order in f c. Valid where a waypoint is many turns
long, teeth stand evenly, and the chip is thin beside the cutter's radius; that chips thin towards what an earlier pass
left is not followed. Path axes: x travel across the axis, z the tool axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.io.tables import Array
from compplan.process.cutter import Slices
from compplan.process.engagement import ROWS, Engagement, middle_angles
from compplan.process.materials import Coefficients

#: Angles of a turn, in a bin of the engagement, and pieces of a slice, that a ripple is followed with.
FINE, PIECES = 8, 24
#: The edge force stands in full where the edge moves outwards by this share of the feed, and from this feed a tooth on
#: [m]; below it grows from nothing (assumed): a floor that is slid over, or a tool at rest, is not ploughed. A smaller
#: share lets the force of vertical ramps jump within micrometres, which no arm can follow at feed.
PLOUGHS, PLOUGHING_FEED = 0.004, 1e-5
#: Least share of the feed that the curvature of a tooth's path is held against, in the cut and behind it.
STEEP, STEEP_BEHIND = 0.01, 0.002
#: Angles by which an arc reaches farther at most, in a ripple.
FARTHER = 10
#: Chip thickness below which no Kienzle exponent is trusted: it is held there. [mm]
THINNEST = 1e-4


@dataclass(frozen=True)
class Spindle:
    """How the cutter turns."""

    teeth: int  #: Number of teeth.
    speed: float  #: Turns a second. [1/s]
    helix: float = 0.0  #: Helix angle. [rad]

    def feed_per_tooth(self, feed: Array) -> Array:
        """Return the feed a tooth [m] from the feed [m/s]."""
        return np.asarray(feed / (self.speed * self.teeth))


@dataclass(frozen=True)
class MillingShape:
    """The geometry of the mean wrench: what each coefficient is multiplied with."""

    cutting: Array  #: By 1 N/mm^2 (tangential, radial, axial) at a feed a tooth of 1 mm. Shape (n, 3, 6). [N, N m]
    edge: Array  #: By 1 N/mm. Shape (n, 3, 6). [N, N m]
    curved: Array  #: What both grow by a mm of feed a tooth, as the path of a tooth is curved. Shape (n, 6, 6).

    def wrench(self, coefficients: Coefficients, feed_per_tooth: Array) -> Array:
        """Return the mean wrench on the tool's tip at a feed a tooth [m], path axes. (n,) -> (n, 6) [N, N m]"""
        size = np.array([*coefficients.cutting, *coefficients.edge])
        return np.asarray(np.einsum("c,ncw->nw", size, self.columns(coefficients.exponent, feed_per_tooth)))

    def columns(self, exponent: tuple[float, float, float], feed_per_tooth: Array) -> Array:
        """Return what each coefficient, cutting then edge ones, is multiplied with at a feed. Shape (n, 6, 6)."""
        feed = np.maximum(feed_per_tooth * 1e3, 0.0)[:, None]
        ploughing = np.clip(feed_per_tooth / PLOUGHING_FEED, 0.0, 1.0)[:, None].repeat(3, axis=1)
        by_size = np.concatenate([feed ** (1.0 - np.array(exponent)), ploughing], axis=1)
        straight = np.concatenate([self.cutting, self.edge], axis=1)
        return np.asarray(by_size[:, :, None] * (straight + feed[:, :, None] * self.curved))


def shape_milling(found: Engagement, teeth: int, exponent: tuple[float, float, float]) -> MillingShape:
    """Work out what each coefficient of a cutter adds to the mean wrench; `exponent` is Kienzle's of each part."""
    edge, angle = found.cutter.slices, found.angles
    at_low, by_rise = (part.reshape(3, -1, 6) for part in edge_wrenches(edge, angle))
    straight, curved = np.zeros((len(found), 6, 6)), np.zeros((len(found), 6, 6))
    turn = teeth / len(angle)  # N / (2 pi) du
    length = edge.length * 1e3
    for first in range(0, len(found), ROWS):
        rows = slice(first, first + ROWS)
        share = found.depth[rows].astype(np.float64)
        some = np.flatnonzero(share.any(axis=(1, 2)))
        if not len(some):
            continue
        share, here = share[some], first + some
        weight, bend = turn * share * length[:, None], 1e-3 * found.bend(angle, here)
        out, step = found.engaged_speed(angle, here)
        ploughs = weight * np.minimum(out / PLOUGHS, 1.0)
        behind = _find_behind(weight, out, bend, step)
        halves = 0.5 * share
        chips = {m: weight * (out if m == 0.0 else out ** (1.0 - m)) for m in set(exponent)}
        growth = 0.5 * bend / np.maximum(out, STEEP)
        for c, m in enumerate(exponent):
            more = (1.0 - m) * growth * chips[m]
            for target, k, part in ((straight, c, chips[m]), (curved, c, more), (straight, 3 + c, ploughs),
                                    (curved, 3 + c, behind)):  # fmt: skip
                low, rise = part.reshape(len(some), -1), (halves * part).reshape(len(some), -1)
                target[here, k] = low @ at_low[c] + rise @ by_rise[c]
    return MillingShape(straight[:, :3], straight[:, 3:], curved)


def _find_behind(weight: Array, out: Array, bend: Array, step: Array) -> Array:
    """Return how much more of slices is in the cut behind where their edge moves outwards, a mm of feed. (n, k, m).

    Integral of half the bend over the line where the speed is zero. The line is spread over the bins beside it: the
    weights of bins that are slower than `step`, by which the speed changes across a bin, fall linearly to zero there.
    """
    wide = np.maximum(step, STEEP_BEHIND)
    return np.asarray(weight * bend / wide * np.maximum(1.0 - out / wide, 0.0))


def edge_wrenches(edge: Slices, angle: Array) -> tuple[Array, Array]:
    """Return the wrench at the tip of a unit force (tangential, radial, axial) on slices at angles.

    At the lower end of each slice, and what is added when it acts at its upper end. Shapes (3, k, m, 6).
    """
    k, m = len(edge), len(angle)
    out, up = edge.normal[:, 0], edge.normal[:, 1]
    cos, sin = np.broadcast_to(np.cos(angle), (k, m)), np.broadcast_to(np.sin(angle), (k, m))
    ones = np.ones((k, m))
    along = np.stack([-sin, cos, 0.0 * ones], axis=-1)
    normal = np.stack([out[:, None] * cos, out[:, None] * sin, up[:, None] * ones], axis=-1)
    upward = np.stack([-up[:, None] * cos, -up[:, None] * sin, out[:, None] * ones], axis=-1)
    force = np.stack([along, -normal, -upward])
    arm = np.stack([edge.radius[:, None] * cos, edge.radius[:, None] * sin, edge.low[:, None] * ones], axis=-1)
    rise = np.zeros((k, m, 3))
    rise[:, :, 2] = edge.rise[:, None]
    at_low = np.concatenate([force, np.cross(arm[None], force)], axis=-1)
    by_rise = np.concatenate([np.zeros_like(force), np.cross(rise[None], force)], axis=-1)
    return at_low, by_rise


def ripple_force(
    found: Engagement, rows: NDArray[np.int_], coefficients: Coefficients, spindle: Spindle, feed_per_tooth: Array
) -> Array:
    """Return the force through one turn of the spindle at r waypoints, path axes. (r, a, 3) [N]

    `feed_per_tooth` has shape (r,) [m]; a are the angles of a turn.
    """
    edge = found.cutter.slices
    count = found.depth.shape[2] * FINE
    angle = middle_angles(count)
    feed, speed = feed_per_tooth[:, None, None] * 1e3, found.speed(angle, rows)
    out = feed * (speed + 0.5e-3 * feed * found.bend(angle, rows))
    share, height = _reach_behind(*_spread_arcs(found.depth[rows]), (speed <= 0.0) & (out > 0.0))
    force = np.zeros((len(rows), count, 3))
    directions = edge_wrenches(edge, angle)[0][..., :3]
    turning = np.arange(count)
    lead = np.tan(spindle.helix) / found.cutter.radius  # the same lead all along the edge
    for k in range(len(edge)):
        span = edge.rise[k] * lead * float(height[:, k].max(initial=0.0))
        pieces = int(np.clip(np.ceil(span / (2.0 * np.pi / count)), 1, PIECES))
        for piece in range(pieces):
            level = (piece + 0.5) / pieces
            top = height[:, k].max(axis=1)  # the pieces stand on the engaged part of the slice
            lag = (edge.low[k] + level * top * edge.rise[k]) * lead
            if edge.rise[k] > 0.0:
                covered = pieces * height[:, k] / np.maximum(top, 1e-30)[:, None] - piece
                engaged = share[:, k] * np.clip(covered, 0.0, 1.0)
            else:
                engaged, top = share[:, k] * height[:, k], np.ones(len(rows))
            width = edge.length[k] * 1e3 * top / pieces
            # higher parts of a right-hand helix lag behind; a clockwise spindle turns teeth to smaller angles
            shift = np.rint(lag / (2.0 * np.pi) * count).astype(int)
            at = (turning[None, :] + shift[:, None]) % count
            chip = np.take_along_axis(out[:, k], at, axis=1)
            on = np.take_along_axis(engaged, at, axis=1) * (chip > 0.0)
            ploughs = np.clip(chip / (PLOUGHS * 1e3 * feed_per_tooth[:, None]), 0.0, 1.0)
            force += _slice_force(chip, on * width[:, None], ploughs, coefficients, directions[:, k][:, at])
    shifts = [round(tooth * count / spindle.teeth) for tooth in range(spindle.teeth)]
    return np.asarray(sum(np.roll(force, shift, axis=1) for shift in shifts))


def _slice_force(chip: Array, width: Array, ploughs: Array, coefficients: Coefficients, directions: Array) -> Array:
    """Return the force of slices from chip thickness and width [mm], and the share of the edge force that acts.

    Shape (r, a, 3). [N]
    """
    total = np.zeros((*chip.shape, 3))
    thick = np.maximum(chip, THINNEST)
    for c in range(3):
        size = coefficients.cutting[c] * thick ** (1.0 - coefficients.exponent[c]) + coefficients.edge[c] * ploughs
        total += (size * width)[..., None] * directions[c]
    return total


def _spread_arcs(depth: NDArray[np.float32]) -> tuple[Array, Array]:
    """Divide the bins of an engagement; where one is engaged in part, that part lies beside its engaged neighbour.

    Returns:
        Whether each fine bin is engaged, and the height of its engaged part as a share of the slice.
        Shapes (r, k, fine m).
    """
    depth = depth.astype(np.float64)
    around = np.maximum(np.roll(depth, 1, axis=2), np.roll(depth, -1, axis=2))
    lonely = (np.roll(depth, 1, axis=2) > 0) & (np.roll(depth, -1, axis=2) > 0)
    part = np.where((depth < around) & ~lonely, depth / np.maximum(around, 1e-30), np.where(depth > 0, 1.0, 0.0))
    height = np.where((depth < around) & ~lonely, around, depth) * (depth > 0)
    after = np.roll(depth, -1, axis=2) > np.roll(depth, 1, axis=2)
    inner = (np.arange(FINE) + 0.5) / FINE
    fine = np.where(after[..., None], inner > 1.0 - part[..., None], inner < part[..., None])
    share = fine.reshape(*depth.shape[:2], -1).astype(np.float64)
    return share * (np.repeat(depth, FINE, axis=2) > 0), np.repeat(height, FINE, axis=2)


def _reach_behind(share: Array, height: Array, behind: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return shares and heights of arcs that go on behind where the edge moves outwards, see `_spread_arcs`."""
    for way in (1, -1):
        for _ in range(FARTHER if behind.any() else 0):
            more = behind & (share == 0.0)
            share, height = (np.where(more, np.roll(part, way, axis=2), part) for part in (share, height))
    return share, height


def ripple_amplitude(force: Array) -> Array:
    """Return half of the range of each component through a turn. Shape (r, 3) from (r, a, 3). [N]"""
    return np.asarray(0.5 * (force.max(axis=1) - force.min(axis=1)))
