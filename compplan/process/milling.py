"""Mechanistic force of a rotating cutter: mean wrench at every waypoint, from its engagement.

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

from compplan.io.tables import Array
from compplan.process.cutter import Slices
from compplan.process.engagement import ROWS, Engagement
from compplan.process.materials import Coefficients

#: The edge force stands in full where the edge moves outwards by this share of the feed, and from this feed a tooth on
#: [m]; below it grows from nothing (assumed): a floor that is slid over, or a tool at rest, is not ploughed. A smaller
#: share lets the force of vertical ramps jump within micrometres, which no arm can follow at feed.
PLOUGHS, PLOUGHING_FEED = 0.004, 1e-5
#: Least share of the feed that the curvature of a tooth's path is held against, in the cut and behind it.
STEEP, STEEP_BEHIND = 0.01, 0.002


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
