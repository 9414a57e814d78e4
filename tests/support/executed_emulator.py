"""A controller of another author, none of compplan.controllers.motion: constant speed, corners that turn evenly."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compplan.robot import load_robot
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, refine_ik

Array = NDArray[np.float64]
STEP = 1e-3
READY = np.radians([0.0, -100.0, -110.0, -60.0, 90.0, 0.0])


@dataclass(frozen=True)
class SimulatedRobot:
    """What the emulated controller does: share of the zone that it blends, acceleration, lags, lost motion."""

    zone_share: float = 1.0
    acceleration: float = 2.0
    lag: Array = field(default_factory=lambda: np.full(6, 0.02))
    lost: Array = field(default_factory=lambda: np.zeros(6))
    noise: float = 2e-6


def command_tip(points: Array, feed: float, zone: float, cell: SimulatedRobot) -> Array:
    """Tip every millisecond: speed ramps up, is constant through the corners, and ramps down. Shape (k, 3). [m]."""
    ways = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reach = np.r_[0.0, np.minimum(cell.zone_share * zone, 0.5 * np.minimum(ways[:-1], ways[1:])), 0.0]
    total, ramp = ways.sum(), feed / cell.acceleration
    end = total / feed + ramp
    t = np.arange(0.0, end + STEP, STEP)
    s = np.where(t < ramp, 0.5 * cell.acceleration * t**2, feed * (t - 0.5 * ramp))
    left = np.clip(end - t, 0.0, None)
    s = np.clip(np.where(left < ramp, total - 0.5 * cell.acceleration * left**2, s), 0.0, total)
    at = np.r_[0.0, np.cumsum(ways)]
    tip = np.stack([np.interp(s, at, column) for column in points.T], axis=1)
    unit = np.diff(points, axis=0) / ways[:, None]
    for k in range(1, len(points) - 1):
        if reach[k] > 0.0:
            inside = np.abs(s - at[k]) < reach[k]
            u = (s[inside] - at[k] + reach[k])[:, None]
            tip[inside] = points[k] - reach[k] * unit[k - 1] + u * unit[k - 1]
            tip[inside] += u**2 / (4 * reach[k]) * (unit[k] - unit[k - 1])
    return tip


def drive(command: Array, cell: SimulatedRobot) -> Array:
    """Joints that drives reach, in quarters of a millisecond. Shape (k, 6)."""
    q, out = command[0].copy(), np.empty_like(command)
    for k, wanted in enumerate(command):
        begin = command[max(k - 1, 0)]
        for part in range(1, 5):
            q = q + 0.25 * STEP / cell.lag * (begin + part / 4 * (wanted - begin) - q)
        out[k] = q
    rate = np.diff(command, axis=0, prepend=command[:1])
    sign = np.zeros_like(rate)
    last = np.zeros(6)
    for k, row in enumerate(rate):
        last = np.where(np.abs(row) > 1e-9, np.sign(row), last)
        sign[k] = last
    return out - 0.5 * cell.lost * sign


def emulate(points: Array, feed: float, zone: float, cell: SimulatedRobot, robot: str = "ur10") -> tuple[Array, Array]:
    """Execute a polyline from the joints READY on: time and joints every millisecond, with a rest at the end."""
    arm = build_arm(load_robot(robot))
    tip = command_tip(points, feed, zone, cell)
    tip = np.vstack([tip, np.tile(tip[-1], (300, 1))])
    turn = locate_frames(arm.chain, READY[None]).tcp_rotation[0]
    anchors = np.arange(0, len(tip), 20)
    q = READY[None]
    guesses = []
    for k in anchors:
        q = refine_ik(arm, q, tip[k : k + 1], turn[None])
        guesses.append(q[0])
    guess = np.stack([np.interp(np.arange(len(tip)), anchors, column) for column in np.array(guesses).T], axis=1)
    command = refine_ik(arm, guess, tip, np.tile(turn, (len(tip), 1, 1)))
    return np.arange(len(command)) * STEP, drive(command, cell)


def zigzag(seed: int, count: int = 30, size: float = 0.02) -> Array:
    """Corners of a wandering path near the tip of READY. Shape (count, 3). [m]."""
    arm = build_arm(load_robot("ur10"))
    start = locate_frames(arm.chain, READY[None]).tcp_position[0]
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.uniform(-1.2, 1.2, count))
    steps = size * rng.uniform(0.6, 1.4, count)[:, None] * np.stack(
        [np.cos(heading), np.sin(heading), 0.3 * np.sin(3 * heading)], axis=1)  # fmt: skip
    return np.asarray(start + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]))


def write_program(file: Path, points: Array, feed: float, zone: float) -> Path:
    """Write PROGRAM.csv: the joints READY first, then lines with the tool axis of READY."""
    arm = build_arm(load_robot("ur10"))
    axis = -locate_frames(arm.chain, READY[None]).tcp_rotation[0][:, 2]
    joints = ",".join(f"{value:.9f}" for value in np.degrees(READY))
    rows = ["move,x_mm,y_mm,z_mm,i,j,k,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,feed_mm_s,zone_mm"]
    for k, point in enumerate(points):
        place = ",".join(f"{value:.9f}" for value in [*(1e3 * point), *axis])
        bent = joints if k == 0 else ",,,,,"
        stop = 0.0 if k in (0, len(points) - 1) else 1e3 * zone
        rows.append(f"{'line' if k else 'joint'},{place},{bent},{1e3 * feed:g},{stop:g}")
    file.write_text("\n".join(rows) + "\n")
    return file


def write_log(
    file: Path, time: Array, q: Array, *, cycle: float = 0.004, seed: int = 0, noise: float = 2e-6, torn: float = 0.0,
    begin: float = 0.0, clock: float = 0.0, late: float = 0.0, missing: float = 0.0,
) -> Path:  # fmt: skip
    """Write LOG.csv as a careless logger does."""
    rng = np.random.default_rng(seed)
    at = np.arange(begin, time[-1], cycle)
    rows = np.stack([np.interp(at, time, column) for column in q.T], axis=1)
    old = np.stack([np.interp(at - cycle, time, column) for column in q.T], axis=1)
    hit = np.flatnonzero(rng.random(len(at)) < torn)
    joint = rng.integers(0, 6, len(hit))
    rows[hit, joint] = old[hit, joint]
    rows += noise * rng.standard_normal(rows.shape)
    stamp = at + clock + late * cycle * (rng.random(len(at)) < 0.05)
    keep = rng.random(len(at)) >= missing
    table = np.column_stack([stamp, np.degrees(rows)])[keep]
    np.savetxt(file, table, delimiter=",", comments="", fmt="%.7f",
               header="time_s," + ",".join(f"q{j}_deg" for j in range(1, 7)))  # fmt: skip
    return file


def measure_beside(path: Array, tip: Array) -> Array:
    """Return how far tips lie from a polyline. Shape (n,). [mm]."""
    start, edge = path[:-1], np.diff(path, axis=0)
    along = np.einsum("nkj,kj->nk", tip[:, None] - start, edge) / np.maximum((edge**2).sum(axis=1), 1e-24)
    near = start + np.clip(along, 0.0, 1.0)[..., None] * edge
    return 1e3 * np.linalg.norm(tip[:, None] - near, axis=2).min(axis=1)
