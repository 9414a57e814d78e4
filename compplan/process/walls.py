"""How far finished walls lie from where the path wants them: by the arm, by the tool's beam, by a wall that gives.

A wall is what the cutter's side leaves: a stretch of cut whose engaged arc reaches square to the travel, and that no
later cut takes away. Its surface stands where the edges leave it that pass it beside that angle, one feed after the
other, height by height along the helix; a tool that springs out behind its cut meets the wall again, and its edge force
holds it off.
The arm is slow beside the teeth and stands where the mean force puts it; the tool answers the force of that instant
(its lowest mode amplifies the harmonics of a turn, and the cut damps it), and so does a thin wall, without inertia.
The force acts in the middle of the edge that is engaged then. It is that of the tool where it really is: to first
order, from one further engagement of the path shifted by what was found. A vibration that grows (chatter) is left out.
Above 0: into the wall, too much is taken; below 0: material is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.linalg import circulant
from scipy.spatial import cKDTree

from compplan.io.tables import Array
from compplan.io.tomlfile import StrictTable
from compplan.process.cutting import CuttingForce
from compplan.process.engagement import Engagement
from compplan.process.milling import PLOUGHS, ripple_force
from compplan.process.thin_wall import ThinWallTable
from compplan.process.tool_beam import ToolBeam
from compplan.toolpath.contact import path_axes, travel_across
from compplan.toolpath.toolpath import Toolpath

#: Angle to the travel from which on an engaged arc leaves a wall, and turn of the travel that ends one. [rad]
SQUARE, CORNER = np.radians(85.0), np.radians(15.0)
#: A wall is at least this long, in radii of the cutter; it is looked at in so many places, at so many heights.
SHORTEST, PLACES, HEIGHTS = 1.0, 7, 5
#: Walls that are looked at, the longest. Depth from which on a later cut takes a wall away. [m]
MOST, TAKEN = 80, 2e-5
#: A shift of the path below this is not felt by the angles of an engagement. [m]
FELT = 5e-5
#: Angle beside a wall's at which an edge may still reach it. [rad]
BESIDE = np.radians(8.0)
#: Passes of teeth at a wall that are followed on either side.
MOST_PASSES = 60
#: Parts of an error.
PARTS = ("arm", "tool", "thin wall")


class SurfaceTable(StrictTable):
    """[surface]: how far finished walls lie off, in `compplan forces` and in a plan; [[surface.wall]] are thin ones."""

    wall: tuple[ThinWallTable, ...] = Field(default=(), strict=False)


@dataclass(frozen=True)
class WallError:
    """One finished wall; p places along it, h heights.

    Attributes:
        first: First waypoint of the path.
        last: Last waypoint.
        side: "left" or "right" of the travel.
        length: Its length. [m]
        parts: Error by each of `PARTS`, mean over the height. Shape (3, p). [m]
        error: Error in all. Shape (p, h). [m]

    """

    first: int
    last: int
    side: str
    length: float
    parts: Array
    error: Array

    @property
    def mean(self) -> float:
        """Mean over places and heights. [m]"""
        return float(self.error.mean())

    @property
    def greatest(self) -> float:
        """The error that is farthest from 0. [m]"""
        return float(self.error.ravel()[np.abs(self.error).argmax()])

    def describe(self) -> dict[str, Any]:
        """Describe it for a file."""
        return {
            "first": self.first, "last": self.last, "side": self.side, "length_mm": 1e3 * self.length,
            "error_mm": {"mean": 1e3 * self.mean, "greatest": 1e3 * self.greatest},
            "parts_mm": {name: 1e3 * float(part.mean()) for name, part in zip(PARTS, self.parts, strict=True)},
        }  # fmt: skip


@dataclass(frozen=True)
class WallStretch:
    """A stretch of cut that leaves a wall: waypoints, side (1 left, -1 right), and the places that are looked at."""

    rows: NDArray[np.int_]
    side: float
    places: NDArray[np.int_]


def judge_walls(
    cutting: CuttingForce, feed: Array, away: Array, beam: ToolBeam | None, thin: Sequence[ThinWallTable]
) -> tuple[WallError, ...]:
    """Work out the error of every finished wall.

    Args:
        cutting: Engagement along the path; r waypoints.
        feed: Feed that is driven. Shape (r,). [m/s]
        away: Where the arm puts the tip, minus path, part frame. Shape (r, 3). [m]
        beam: Cutter and holder, None where they count as rigid.
        thin: Walls that give.

    """
    bench = cutting.bench
    part = Toolpath(bench.position @ bench.R_view.T, bench.axis @ bench.R_view.T, feed, cutting.rapid)
    axes = path_axes(part)
    stretches = find_stretches(cutting, part, axes)
    if not stretches:
        return ()
    parts = [_give(cutting, feed, each, axes, part, away, beam, thin) for each in stretches]
    shift, sizes = np.zeros_like(part.position), []
    for each, found in zip(stretches, parts, strict=True):
        error = found.sum(axis=0).mean(axis=1)
        sizes.append(np.where(error < 0.0, -1.0, 1.0) * np.maximum(np.abs(error), FELT))
        along = np.interp(each.rows, each.places, sizes[-1])
        shift[each.rows] += (each.side * along)[:, None] * axes[each.rows, :, 1]
    moved = cutting.shift(shift)
    again = [_give(moved, feed, each, axes, part, away, beam, thin) for each in stretches]
    return tuple(_settle(each, part, *found) for each, *found in zip(stretches, parts, again, sizes, strict=True))


def _settle(stretch: WallStretch, part: Toolpath, found: Array, again: Array, size: Array) -> WallError:
    """Return the error that agrees with its own force, from that on the path and that of the path shifted by sizes."""
    arm, own, there = (each.mean(axis=1) for each in (found[0], found[1] + found[2], again[1] + again[2]))
    settled = (arm + own) / np.maximum(1.0 - (there - own) / size, 0.2)
    scale = np.divide(settled - arm, own, out=np.ones_like(own), where=np.abs(own) > 1e-12)
    parts = np.concatenate([found[:1], found[1:] * scale[None, :, None]])
    length = float(part.arc_length[stretch.rows[-1]] - part.arc_length[stretch.rows[0]])
    side = "left" if stretch.side > 0.0 else "right"
    return WallError(int(stretch.rows[0]), int(stretch.rows[-1]), side, length, parts.mean(axis=2), parts.sum(axis=0))


def find_stretches(cutting: CuttingForce, part: Toolpath, axes: Array) -> list[WallStretch]:
    """Return the stretches of a path that leave a wall which no later cut takes away.

    Args:
        cutting: Engagement along the path.
        part: The path, part frame.
        axes: Its path axes. Shape (r, 3, 3).

    """
    found, radius = cutting.engagement, cutting.bench.cutter.radius
    flank = found.depth[:, found.cutter.slices.low >= cutting.bench.cutter.end - 1e-12].any(axis=(1, 2))
    cuts = found.touches & ~cutting.rapid & flank & (travel_across(part) > 0.9)
    turn = np.arccos(np.clip(np.einsum("ni,ni->n", axes[1:, :, 0], axes[:-1, :, 0]), -1.0, 1.0))
    corner = np.r_[True, turn > CORNER]
    tree, stretches = cKDTree(part.position), []
    for side in (1.0, -1.0):
        reach = found.arc[:, 1] if side > 0.0 else -found.arc[:, 0]
        with np.errstate(invalid="ignore"):
            on = cuts & (reach >= SQUARE)
        number = np.cumsum(corner | ~on | np.r_[True, ~on[:-1]])
        for each in np.unique(number[on]):
            rows = np.flatnonzero(on & (number == each))
            if part.arc_length[rows[-1]] - part.arc_length[rows[0]] < SHORTEST * radius:
                continue
            inner = rows[len(rows) // 10 : len(rows) - len(rows) // 10]
            places = inner[np.unique(np.linspace(0, len(inner) - 1, min(PLACES, len(inner))).astype(int))]
            places = places[[not _is_taken(cutting, part, axes, tree, int(i), side, int(rows[-1])) for i in places]]
            if len(places):
                stretches.append(WallStretch(rows, side, places))
    return sorted(sorted(stretches, key=lambda each: -len(each.rows))[:MOST], key=lambda each: int(each.rows[0]))


def _is_taken(
    cutting: CuttingForce, part: Toolpath, axes: Array, tree: cKDTree, row: int, side: float, last: int
) -> bool:
    """Tell whether a later cut goes through the middle of the wall at a waypoint."""
    cutter, deep = cutting.bench.cutter, 0.5 * float(cutting.engagement.axial[row])
    point = part.position[row] + side * cutter.radius * axes[row, :, 1] + deep * part.axis[row]
    near = np.array(tree.query_ball_point(point, np.hypot(cutter.radius, 2.0 * deep + 1e-3)), int)
    near = near[(near > last) & ~cutting.rapid[near]]
    from_tip = point - part.position[near]
    up = np.einsum("ni,ni->n", from_tip, part.axis[near])
    out = np.linalg.norm(from_tip - up[:, None] * part.axis[near], axis=1)
    return bool(((out < cutter.radius - TAKEN) & (up > 0.0) & (up < cutter.flute)).any())


def _give(
    cutting: CuttingForce, feed: Array, stretch: WallStretch, axes: Array, part: Toolpath, away: Array,
    beam: ToolBeam | None, thin: Sequence[ThinWallTable],
) -> Array:  # fmt: skip
    """Return what each of `PARTS` gives into the wall at its places and heights. Shape (3, p, h). [m]"""
    rows, found, spindle = stretch.places, cutting.engagement, cutting.process.spindle()
    edge, radius = found.cutter.slices, found.cutter.radius
    whole = found.depth[rows].max(axis=2)
    low = np.where(whole > 0.0, edge.low, np.inf).min(axis=1)
    low = np.where(np.isfinite(low), low, 0.0)
    levels = (np.arange(HEIGHTS) + 0.5) / HEIGHTS
    height = low[:, None] + levels * found.axial[rows][:, None]  # (p, h) above the tip
    per_tooth = spindle.feed_per_tooth(feed[rows])
    force = stretch.side * ripple_force(found, rows, cutting.process.resistance, spindle, per_tooth)[:, :, 1]  # (p, a)
    lead = np.tan(spindle.helix) / radius
    load = find_load(height, low, found, rows, stretch.side, lead)
    into = np.einsum("pi,pi->p", away[rows], stretch.side * axes[rows, :, 1])
    gives = np.zeros((3, len(rows), HEIGHTS))
    gives[0] = into[:, None]
    shaken = force
    if beam is not None:
        middle = low + 0.5 * found.axial[rows]
        soft_tip = np.array([beam.compliance(each[None], each[None])[0, 0] for each in middle])
        shaken = amplify(force, spindle.speed, beam, _drag(cutting, rows, spindle.speed, per_tooth, soft_tip))
    edge_force = cutting.process.resistance.edge[1]
    for i, row in enumerate(rows):
        apart = max(float(per_tooth[i]) / radius, BESIDE / MOST_PASSES)
        passes = apart * np.arange(-int(BESIDE / apart), int(BESIDE / apart) + 1)
        gone = np.maximum(passes, 0.0) / max(lead, 1e-9)  # length of the edge that has left the cut
        at, place = _pass(stretch.side, height[i] * lead, force.shape[1], spindle.teeth, passes)
        soft = np.zeros((2, HEIGHTS))
        if beam is not None:
            soft[0] = beam.compliance(height[i], load[i]).diagonal()
        face = part.position[row] + stretch.side * radius * axes[row, :, 1]
        for wall in thin:
            foot = wall.find(face + height[i].mean() * part.axis[row])
            if foot is not None:
                up, pushed = (foot[1] + (each[i] - height[i].mean()) * float(part.axis[row] @ wall.rise)
                              for each in (height, load))  # fmt: skip
                soft[1] = wall.compliance(foot[0], up, pushed).diagonal()
                break
        there = soft[:, :, None, None] * np.stack([shaken[i, at], force[i, at]])  # (2, h, teeth, w)
        hold = 1e3 * edge_force * soft.sum(axis=0)[:, None] * np.minimum(gone, found.axial[row])  # (h, q)
        level = _pass_wall(there.sum(axis=0), place, radius, hold, passes, float(per_tooth[i]))
        at_wall = there[..., at.shape[2] // 2 - 1]
        rest = level - at_wall.sum(axis=0)
        gives[1:, i] = (at_wall + (soft / np.maximum(soft.sum(axis=0), 1e-30))[:, :, None] * rest).mean(axis=2)
    return gives


def find_load(
    height: Array, low: Array, found: Engagement, rows: NDArray[np.int_], side: float, lead: float
) -> Array:
    """Return where the edge is engaged in the mean as it makes the wall at heights above the tip. Shape (p, h). [m]

    On the left teeth come in at the wall and lower parts are ahead in the cut, on the right they leave there.
    """
    wide = np.ptp(found.arc[rows], axis=1) / max(lead, 1e-9)
    ends = np.stack([height, height - side * wide[:, None]])
    return np.asarray(np.clip(ends, low[:, None], (low + found.axial[rows])[:, None]).mean(axis=0))


def _pass(side: float, lag: Array, count: int, teeth: int, passes: Array) -> tuple[NDArray[np.int_], Array]:
    """Return which angles of a turn lie beside that at which each tooth passes the wall.

    Args:
        side: Of the wall.
        lag: Of the edge at each height. Shape (h,). [rad]
        count: Angles of a turn.
        teeth: Number of teeth.
        passes: Angles beside the wall's that are asked for. Shape (q,). [rad]

    Returns:
        Numbers of the angles, the first half in the cut and the other behind it, shape (h, teeth, w); where the passes
        lie among them, shape (h, teeth, q).

    """
    most = int(BESIDE / (2.0 * np.pi) * count) + 1
    angle = 0.5 * np.pi - side * (lag[:, None] + 2.0 * np.pi * np.arange(teeth) / teeth)
    wall = angle / (2.0 * np.pi) * count - 0.5 * side  # numbers count along the travel to the wall, and on behind it
    last = np.floor(wall)
    at = side * (last[:, :, None] + np.arange(1 - most, most + 1))
    return at.astype(int) % count, (wall - last)[:, :, None] + passes / (2.0 * np.pi) * count + most - 1


def _pass_wall(gives: Array, place: Array, radius: float, hold: Array, passes: Array, feed: float) -> Array:
    """Return where a wall stands once every tooth has passed, a feed farther on each time.

    Beside the wall's angle an edge stands back by its roundness. Behind the cut it springs out and meets the wall
    again: what it bites there brings back the edge force, which holds it off, in full from `PLOUGHS` of the feed on.

    Args:
        gives: Where edges stand at angles beside the wall's without that, but for their roundness; the first half in
            the cut, where the force of straight teeth ends. Shape (h, t, w). [m]
        place: Where the passes lie among these angles. Shape (h, t, q).
        radius: Of the cutter. [m]
        hold: By how much the whole edge force of what has left the cut holds the edge off at a pass. Shape (h, q). [m]
        passes: Angles at which teeth pass, one after the other. Shape (q,). [rad]
        feed: A tooth. [m]

    Returns:
        Shape (h, t). [m]

    """
    half, bite = gives.shape[2] // 2, PLOUGHS * max(feed, 1e-6)
    behind = passes > 0.0
    low = np.clip(place.astype(int), np.where(behind, half, 0), np.where(behind, 2 * half - 2, half - 2))
    near, far = (np.take_along_axis(gives, low + k, axis=2) for k in (0, 1))
    edges = near + (place - low) * (far - near) - 0.5 * radius * passes**2
    level = edges[..., 0]
    for q in range(1, len(passes)):
        ahead, held = edges[..., q] - level, hold[:, q, None]
        level = level + np.maximum(np.where(ahead > bite + held, ahead - held, ahead * bite / (bite + held)), 0.0)
    return np.asarray(level)


def amplify(force: Array, speed: float, beam: ToolBeam, drag: Array | None = None) -> Array:
    """Return the force through a turn as the lowest mode of a beam answers it, over its static answer.

    Args:
        force: At even angles of a turn; the spindle turns to smaller ones. Shape (p, a). [N]
        speed: Turns a second. [1/s]
        beam: The tool.
        drag: What the cut takes off a tool that moves, times the beam's compliance. Shape (p, a). [s]

    """
    omega, count = beam.modes.omega[0], force.shape[1]
    ratio = 2.0 * np.pi * speed * np.arange(count // 2 + 1) / omega
    stiff = 1.0 - ratio**2 - 2j * beam.damping * ratio
    if drag is None:
        return np.asarray(np.fft.irfft(np.fft.rfft(force, axis=1) / stiff, n=count, axis=1))
    own, rate = (circulant(np.fft.irfft(part, n=count)) for part in (stiff, -1j * omega * ratio))
    return np.asarray(np.linalg.solve(own + drag[:, :, None] * rate, force[:, :, None])[..., 0])


def _drag(
    cutting: CuttingForce, rows: NDArray[np.int_], speed: float, per_tooth: Array, compliance: Array
) -> Array:  # fmt: skip
    """Return how much a cut damps a tool that moves into the wall, see `amplify`. Shape (p, a). [s]

    An edge meets what the tooth before left a feed aside of it, so that it cuts deeper by the way that the tool went
    meanwhile: a feed over the speed of the edge. The slope of the chip's law is taken at half the feed.
    """
    found, spindle, resistance = cutting.engagement, cutting.process.spindle(), cutting.process.resistance
    edges = replace(resistance, cutting=(0.0, 0.0, 0.0), edge=(0.0, 1.0, 0.0))
    width = np.abs(ripple_force(found, rows, edges, spindle, per_tooth)[:, :, 1])  # [mm]
    power = resistance.exponent[1]
    slope = 1e3 * resistance.cutting[1] * (1.0 - power) * np.maximum(0.5e3 * per_tooth, 1e-3) ** -power  # [N/m/mm]
    turn = per_tooth / (2.0 * np.pi * found.cutter.radius * speed)
    return np.asarray((slope * turn * compliance)[:, None] * width)
