"""A robot controller of another author: zones, look-ahead, speed law and drives, drawn one a seed.

What makers publish, and what is drawn where they are silent:

- Zones. ABB (RAPID reference manual, zonedata): the corner path is a parabola that begins at the edge of the zone; a
  zone reaches at most half way to the nearer neighbour; z0 is 0.3 mm. KUKA (system variables): $APO.CDIS is the
  distance from the corner at which approximation may begin, at most half of a block. Universal
  Robots (URScript manual): a blend begins at radius r. None says of what degree the curve of KUKA
  and Universal Robots is: parabola, cubic and quintic curves are drawn, and which share of the zone is used.
- Look-ahead ($ADVANCE of KUKA is 3 by default, 5 at most; others do not say): the tip can always stop at the end of
  the last block that is known.
- Speed: feed of each block, tangential and lateral acceleration of the tip; then smoothed in time (jerk).
- Drives: position loop with a gain, velocity feed-forward, velocity loop with a bandwidth (the textbook cascade); dry
  friction pushes each joint back.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmarks.plan_check.cell import Kinematics, rotation_difference
from benchmarks.plan_check.robot import Arm, Array, rotation_vector

#: Step of the drives [s]; steps of the path [m] where it is straight, and least number of them in a blend.
STEP, FINE, BENDS = 1e-3, 2e-4, 12
#: How long an exact stop takes beyond what smooths the speed [s].
SETTLE = 0.1


@dataclass(frozen=True)
class Block:
    """A block of a program: where it ends, and through what it goes (arcs); base frame, SI.

    `zone` is the distance from its end at which a blend may begin (0: exact stop).
    """

    end: Array
    feed: float
    zone: float
    via: Array | None = None


@dataclass(frozen=True)
class Controller:
    """What one controller does. Gains in 1/s; `friction` is what a drive stays behind at any speed [rad]."""

    degree: int
    share: float
    lookahead: int
    along: float
    across: float
    jerk_time: float
    cycle: float
    gain: Array
    forward: Array
    bandwidth: Array
    friction: Array


def draw_controller(seed: int, joints: int, make: str) -> Controller:
    """Draw a controller of a make: gains differ a little from joint to joint, as tuned axes do."""
    rng = np.random.default_rng([seed, 32])
    gain = rng.uniform(20.0, 50.0) * np.exp(0.04 * rng.standard_normal(joints))
    return Controller(
        degree=2 if make == "rapid" else int(rng.choice([2, 3, 5])),
        share=1.0 if make == "rapid" else float(rng.uniform(0.6, 1.0)),
        lookahead=int(rng.integers(3, 6)) if make == "krl" else int(rng.integers(5, 40)),
        along=float(rng.uniform(1.0, 4.0)),
        across=float(rng.uniform(1.0, 4.0)),
        jerk_time=float(rng.uniform(0.01, 0.05)),
        cycle=float(rng.choice([0.002, 0.004, 0.008])),
        gain=gain,
        forward=np.clip(rng.uniform(0.3, 0.95) + 0.01 * rng.standard_normal(joints), 0.0, 1.0),
        bandwidth=rng.uniform(80.0, 250.0) * np.exp(0.05 * rng.standard_normal(joints)),
        friction=np.radians(rng.uniform(0.0, 0.0005, joints)),
    )


def lay_path(start: Array, blocks: list[Block], control: Controller) -> tuple[Array, Array, Array, Array]:
    """Lay the path that the controller steers: lines and arcs, a blend in every zone.

    Returns:
        Poses along it, shape (n, 4, 4); of each the greatest speed of its block [m/s], whether the tip stops there, and
        the number of its block.
    """
    pieces = [_Piece(a, block) for a, block in zip([start, *(b.end for b in blocks[:-1])], blocks, strict=True)]
    pieces = [piece for piece in pieces if piece.length > 1e-9]
    cut = [0.0] * (len(pieces) + 1)  # half the width of the blend between a piece and the next, as length along both
    for k, (one, other) in enumerate(pairwise(pieces), start=1):
        cut[k] = min(control.share * one.block.zone, 0.5 * one.length, 0.5 * other.length)
    poses, feeds, stops, numbers = [start[None]], [np.r_[pieces[0].block.feed]], [np.r_[True]], [np.r_[0]]

    def add(more: Array, feed: float, number: int, *, stop: bool = False) -> None:
        if len(more):
            poses.append(more)
            feeds.append(np.full(len(more), feed))
            stops.append(np.r_[np.zeros(len(more) - 1, bool), stop])
            numbers.append(np.full(len(more), number))

    for k, piece in enumerate(pieces):
        first, last = cut[k], piece.length - cut[k + 1]
        count = max(int(np.ceil((last - first) / FINE)), 2)  # between two stops there is a row that moves
        ends = k + 1 == len(pieces)
        add(piece.at(np.linspace(first, last, count + 1)[1:] / piece.length), piece.block.feed, k,
            stop=ends or cut[k + 1] == 0.0)  # fmt: skip
        if not ends and cut[k + 1] > 0.0:
            following = pieces[k + 1]
            share = np.linspace(0.0, 1.0, max(BENDS, int(np.ceil(2 * cut[k + 1] / FINE))) + 1)[1:]
            gone, come = 1.0 - quicken(1.0 - share, control.degree), quicken(share, control.degree)
            before, behind = (
                piece.at((last + gone * cut[k + 1]) / piece.length),
                following.at(come * cut[k + 1] / following.length),
            )
            blend = before.copy()
            blend[:, :3, 3] += behind[:, :3, 3] - piece.end[:3, 3]
            blend[:, :3, :3] = behind[:, :3, :3] @ piece.end[:3, :3].T @ before[:, :3, :3]
            add(blend, min(piece.block.feed, following.block.feed), k)
    return np.concatenate(poses), np.concatenate(feeds), np.concatenate(stops), np.concatenate(numbers)


class _Piece:
    """A line or an arc from pose to pose; the tool turns evenly along it."""

    def __init__(self, start: Array, block: Block) -> None:
        self.start, self.block, self.end = start, block, block.end
        self.turn = rotation_difference((block.end[:3, :3] @ start[:3, :3].T)[None])[0]
        a, b = start[:3, 3], block.end[:3, 3]
        self.round: tuple[Array, Array, Array, float] | None = None
        self.length = float(np.linalg.norm(b - a))
        if block.via is not None:
            self.round = _circle(a, block.via[:3, 3], b)
            if self.round is not None:
                self.length = float(np.linalg.norm(self.round[1]) * self.round[3])

    def at(self, share: Array) -> Array:
        """Return poses at shares of the length. Shape (n, 4, 4)."""
        poses = np.tile(np.eye(4), (len(share), 1, 1))
        poses[:, :3, :3] = [rotation_vector(s * self.turn) @ self.start[:3, :3] for s in share]
        if self.round is None:
            poses[:, :3, 3] = self.start[:3, 3] + share[:, None] * (self.end[:3, 3] - self.start[:3, 3])
        else:
            centre, arm, side, angle = self.round
            turned = (share * angle)[:, None]
            poses[:, :3, 3] = centre + np.cos(turned) * arm + np.sin(turned) * side
        return poses


def _circle(a: Array, via: Array, b: Array) -> tuple[Array, Array, Array, float] | None:
    """Return centre, the arm to `a`, its quarter turn, and the angle to `b` by way of `via`; None of a straight arc."""
    u, v = via - a, b - a
    normal = np.cross(u, v)
    size = normal @ normal
    if size < 1e-20 * (v @ v) * (u @ u) or size == 0.0:
        return None
    arm = -(np.cross(normal, u) * (v @ v) + np.cross(v, normal) * (u @ u)) / (2 * size)
    side = np.cross(normal / np.sqrt(size), arm)
    to = b - (a - arm)
    angle = float(np.arctan2(to @ side, to @ arm)) % (2 * np.pi)
    return a - arm, arm, side, angle


def quicken(share: Array, degree: int) -> Array:
    """Return how far the way out of a corner has come while the way into it slows: evenly (2), in S-curves (3, 5)."""
    if degree == 2:
        return share**2
    return 2.0 * share**3 - share**4 if degree == 3 else 2.0 * share**6 - 6.0 * share**5 + 5.0 * share**4


def time_path(poses: Array, feeds: Array, stops: Array, numbers: Array, control: Controller) -> tuple[Array, Array]:
    """Drive the path as fast as feed, acceleration of the tip and look-ahead let it.

    Returns:
        Times of the controller's cycles [s] and the poses steered to at them.
    """
    place = poses[:, :3, 3]
    step = np.linalg.norm(np.diff(place, axis=0), axis=1)
    kept = np.r_[True, step > 1e-9]
    poses, feeds, numbers, place = poses[kept], feeds[kept], numbers[kept], place[kept]
    stops = np.add.reduceat(stops, np.flatnonzero(kept)) > 0
    step = np.linalg.norm(np.diff(place, axis=0), axis=1)
    way = np.r_[0.0, np.cumsum(step)]
    ahead = np.diff(place, axis=0) / step[:, None]
    bend = np.r_[0.0, np.linalg.norm(np.diff(ahead, axis=0), axis=1) / (0.5 * (step[1:] + step[:-1])), 0.0]
    last = np.r_[np.flatnonzero(np.diff(numbers)), len(numbers) - 1]  # last row of each block
    known = last[np.minimum(np.searchsorted(last, np.arange(len(way))) + control.lookahead, len(last) - 1)]
    speed = np.minimum(feeds, np.sqrt(control.across / np.maximum(bend, 1e-9)))
    speed = np.minimum(speed, np.sqrt(2.0 * control.along * np.maximum(way[known] - way, 0.0)))
    speed[stops] = 0.0
    for rows in (range(1, len(way)), range(len(way) - 2, -1, -1)):
        for i in rows:
            j = i - 1 if rows.step > 0 else i + 1
            speed[i] = min(speed[i], np.sqrt(speed[j] ** 2 + 2.0 * control.along * abs(way[i] - way[j])))
    time = np.r_[0.0, np.cumsum(2.0 * step / np.maximum(speed[1:] + speed[:-1], 1e-6))]
    held = np.repeat(np.arange(len(way)), 1 + stops)  # the drives settle at an exact stop
    pause = np.r_[0.0, np.where(np.diff(held) == 0, SETTLE + control.jerk_time, 0.0)]
    time, way_held = time[held] + np.cumsum(pause), way[held]
    fine = np.arange(0.0, time[-1] + 4 * control.jerk_time, STEP)
    at, wide = np.interp(fine, time, way_held), max(round(control.jerk_time / STEP), 1)
    at = np.convolve(np.r_[np.full(wide, at[0]), at], np.full(wide, 1.0 / wide), mode="valid")[: len(fine)]
    ticks = np.arange(0.0, fine[-1], control.cycle)
    at = np.interp(ticks, fine, at)
    row = np.clip(np.searchsorted(way, at, side="right") - 1, 0, len(way) - 2)
    share = (at - way[row]) / step[row]
    found = np.tile(np.eye(4), (len(at), 1, 1))
    found[:, :3, 3] = place[row] + share[:, None] * (place[row + 1] - place[row])
    turn = rotation_difference(poses[row + 1, :3, :3] @ np.swapaxes(poses[row, :3, :3], 1, 2))
    found[:, :3, :3] = [rotation_vector(s * t) @ r for s, t, r in zip(share, turn, poses[row, :3, :3], strict=True)]
    return ticks, found


def steer_joints(arm: Arm, poses: Array, start: Array) -> Array:
    """Return the joints that have these poses, one branch from `start` on. Shape (n, nq). [rad or m]"""
    model, every = Kinematics(arm), 100
    few = np.unique(np.r_[np.arange(0, len(poses), every), len(poses) - 1])
    coarse = np.empty((len(few), len(start)))
    for k, row in enumerate(few):
        start = coarse[k] = model.reach(start[None], poses[row : row + 1], rounds=40)[0][0]
    guess = np.stack([np.interp(np.arange(len(poses)), few, column) for column in coarse.T], axis=1)
    q, left = model.reach(guess, poses)
    assert left.max() < 1e-7, "the arm does not reach the program"
    return q


def drive_joints(time: Array, steered: Array, control: Controller, rest: float = 0.3) -> tuple[Array, Array]:
    """Let the drives follow: position loop, velocity feed-forward, velocity loop, dry friction.

    Args:
        time: Times of the cycles [s].
        steered: Joints at them. Shape (n, nq). [rad or m]
        control: The controller.
        rest: How long the drives settle behind the end [s].

    Returns:
        Times one step apart and joints at them.
    """
    fine = np.arange(0.0, time[-1] + rest, STEP)
    aim = np.stack([np.interp(fine, time, column) for column in steered.T], axis=1)
    rate = np.gradient(aim, STEP, axis=0)
    q, v = aim[0].copy(), np.zeros(aim.shape[1])
    gone = np.empty_like(aim)
    decay = np.exp(-control.bandwidth * STEP)
    for i in range(len(fine)):
        gone[i] = q
        back = control.gain * control.friction * np.tanh(v / 1e-4)
        wish = control.gain * (aim[i] - q) + control.forward * rate[i] - back
        new = wish + (v - wish) * decay
        q = q + 0.5 * STEP * (v + new)
        v = new
    return fine, gone


def execute(arm: Arm, start: Array, pose: Array, blocks: list[Block], control: Controller) -> tuple[Array, Array]:
    """Run a program whose first block begins at `pose`, the arm near the joints `start`; return times and joints."""
    time, poses = time_path(*lay_path(pose, blocks, control), control)
    return drive_joints(time, steer_joints(arm, poses, start), control)
