"""One campaign: its rows in time order, with what the nominal robot does in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from benchmarks.outsider.poses import choose_poses
from benchmarks.outsider.robots import CAPACITY_KG, SCALE, Robot
from benchmarks.outsider.settings import Settings
from benchmarks.outsider.statics import Solution, State, move_tip, solve_statics
from benchmarks.outsider.turns import DEGREE, Array, Rng


class Weight(NamedTuple):
    """A dead weight that hangs from the tool. [kg, m in the axes of the tip]"""

    mass: float
    hook: Array


PULL = "pull"  # a hand pulls at the force sensor


class Row(NamedTuple):
    """One measured pose: run, joint values, load."""

    run: str
    q: Array
    load: Weight | str | None


@dataclass(frozen=True)
class Motion:
    """Joint values, speeds, accelerations (n, count) and times (n,) of all rows, paths behind the static poses."""

    runs: list[str]
    loads: list[Weight | str | None]
    q: Array
    speed: Array
    acceleration: Array
    static: Array
    time: Array


@dataclass(frozen=True)
class Campaign:
    """A campaign as commanded, and the nominal robot in it.

    `visit` numbers stays (rows without a move between them); `direction` and `step` are the sign and length of each
    joint's last move; `start` is where each joint stands inside a lost motion at first, -1 to 1.
    """

    robot: Robot
    fresh: bool
    seed: int
    design: str
    register: bool
    runs: list[str]
    q: Array
    speed: Array
    acceleration: Array
    static: Array
    time: Array
    first: Array
    direction: Array
    step: Array
    start: Array
    visit: Array
    warmth: Array
    shown_C: Array
    tracker: Array
    wrench: Array
    nominal: Solution

    @property
    def rows(self) -> int:
        """How many rows."""
        return len(self.q)

    @property
    def position(self) -> Array:
        """Nominal position of the tip. Shape (n, 3). [m]"""
        return self.nominal.position

    @property
    def rotation(self) -> Array:
        """Nominal rotation of the tip. Shape (n, 3, 3)."""
        return self.nominal.rotation

    @property
    def base_moment(self) -> Array:
        """Moment about the base origin that the first joint carries. Shape (n, 3). [N m]"""
        return self.nominal.carried["joint_1"][1]

    @cached_property
    def motions(self) -> tuple[Array, dict[str, Array]]:
        """Motion of the tip by each driven joint, shape (count, n, 6), and by each element alone."""
        return move_tip(self.position, self.nominal.frames, self.robot)

    @property
    def jacobian(self) -> Array:
        """Motion of the tip by each driven joint. Shape (count, n, 6)."""
        return self.motions[0]

    def torque(self, joint: str) -> Array:
        """Torque on a joint's own spring. Shape (n,). [N m]"""
        return self.nominal.torque[self.robot.own[joint]]

    def since(self, row: int) -> Array:
        """1 from a row on, 0 before; 1 everywhere in a later campaign. Shape (n,)."""
        return (self.fresh | (np.arange(self.rows) >= row)).astype(float)

    def later(self, seconds: float) -> Array:
        """Times, in a later campaign this much later. Shape (n,). [s]"""
        return self.time + (seconds if self.fresh else 0)


def draw_campaign(rng: Rng, robot: Robot, settings: Settings, fresh: bool) -> Campaign:
    """Draw the rows of the given campaign, or of the later one with new poses and loads."""
    seed = int(rng.integers(1 << 30))
    count = int(rng.integers(25, 41)) if fresh else settings.poses
    style = str(rng.choice(["spread", "front", "stations"])) if fresh else settings.style
    rows = _draw_rows(rng, robot, settings, count, style)
    motion = _add_paths(rng, robot, settings, rows, _draw_times(rng, settings, rows), fresh)
    q, runs = motion.q, motion.runs
    first = np.array([i == 0 or runs[i] != runs[i - 1] for i in range(len(q))])
    direction, step = _follow_moves(rng, q)
    start = rng.uniform(-1, 1, robot.count)
    moved = (np.abs(np.diff(q, axis=0)).max(1) > 1e-9) | first[1:]
    warmth = settings.warm_up.at(motion.time, fresh)
    shown = settings.room_C + 0.9 * warmth + 0.1 * settings.warm_up.rise * (1 - np.exp(-motion.time / 200.0))
    wrench = _load_tip(rng, robot, motion)
    return Campaign(
        robot=robot,
        fresh=fresh,
        seed=seed,
        design=settings.design,
        register=settings.register,
        runs=runs,
        q=q,
        speed=motion.speed,
        acceleration=motion.acceleration,
        static=motion.static,
        time=motion.time,
        first=first,
        direction=direction,
        step=step,
        start=start,
        visit=np.cumsum(np.r_[0, moved]),
        warmth=warmth,
        shown_C=shown,
        tracker=settings.fresh_tracker if fresh else settings.tracker,
        wrench=wrench,
        nominal=solve_statics(State(robot, q, wrench)),
    )


def _draw_rows(rng: Rng, robot: Robot, settings: Settings, count: int, style: str) -> list[Row]:
    capacity = CAPACITY_KG[robot.size]
    weights: list[Weight] = []
    if settings.design == "weights":
        masses = sorted(capacity * rng.uniform(0.3, 1.05, settings.weights))
        weights = [Weight(float(np.round(m, 2)), settings.hook) for m in masses]
    if settings.design == "sensor":
        rows = _pull_rows(rng, choose_poses(rng, robot, max(14, count // 2), style))
    elif settings.design == "weights" and settings.order == "pairs":
        rows = _paired_rows(rng, choose_poses(rng, robot, max(14, count // 2), style), weights)
    else:
        if settings.design == "plain":
            rows = [Row("static_1", q, None) for q in choose_poses(rng, robot, count, style)]
        else:
            rows = _run_rows(rng, robot, count, style, [None, *weights])
        rows = _meet_again(rng, rows, settings.again)
    if settings.design == "plain" and len(rows) > 40 and rng.random() < 0.4:  # a break over lunch
        cut = len(rows) // 2
        rows = [row._replace(run="static_2") if i >= cut else row for i, row in enumerate(rows)]
    return rows


def _pull_rows(rng: Rng, poses: Array) -> list[Row]:
    """Every pose without load, then pulled at once or twice."""
    return [Row("static_1", q, PULL if k else None) for q in poses for k in range(2 + (rng.random() < 0.4))]


def _paired_rows(rng: Rng, poses: Array, weights: list[Weight]) -> list[Row]:
    """Every pose without load and with one of the weights, sometimes with all."""
    rows = []
    for i, q in enumerate(poses):
        every = len(weights) == 1 or rng.random() < 0.3
        rows.append(Row("static_1", q, None))
        rows += [Row("static_1", q, load) for load in (weights if every else [weights[i % len(weights)]])]
    return rows


def _run_rows(rng: Rng, robot: Robot, count: int, style: str, loads: list[Weight | None]) -> list[Row]:
    """A run a load, in the same poses or in others."""
    same = rng.random() < 0.5
    poses = choose_poses(rng, robot, count, style)
    each = max(10, int(count / len(loads)))
    rows = []
    for k, load in enumerate(loads):
        rows += [Row(f"static_{k + 1}", q, load) for q in (poses[:each] if same else poses[k * each : (k + 1) * each])]
    return rows


def _meet_again(rng: Rng, rows: list[Row], share: float) -> list[Row]:
    """Measure the first pose twice and at the end, and a share of the poses again."""
    out = []
    for i, row in enumerate(rows):
        out.append(row)
        if i == 0:
            out.append(row)
        elif rng.random() < share:
            before = [r for r in rows[:i] if r.run == row.run]
            if before:
                out.append(before[int(rng.integers(len(before)))])
    return [*out, rows[0]] if rows[0].run == rows[-1].run else out


def _draw_times(rng: Rng, settings: Settings, rows: list[Row]) -> Array:
    """When each row was taken: a pace, breaks between runs, a pause now and then. Shape (n,). [s]"""
    now, times = 0.0, []
    for i, row in enumerate(rows):
        if i:
            now += settings.pace_s * rng.uniform(0.6, 1.8)
            now += rng.uniform(400, 1500) if row.run != rows[i - 1].run else 0
            now += rng.uniform(100, 300) if rng.random() < 0.04 else 0
        times.append(now)
    return np.array(times)


def _add_paths(rng: Rng, robot: Robot, settings: Settings, rows: list[Row], times: Array, fresh: bool) -> Motion:
    """Append one or two runs along a smooth path, where the settings have one, and round joint values as logged."""
    q, runs, loads = np.array([row.q for row in rows]), [row.run for row in rows], [row.load for row in rows]
    speed, acceleration, static = np.zeros_like(q), np.zeros_like(q), np.ones(len(rows), bool)
    low, high = robot.limits
    for k in range((1 if fresh else int(rng.integers(1, 3))) if settings.path else 0):
        samples = int(rng.integers(90, 150))
        clock = np.arange(samples) / 12.5
        centre = choose_poses(rng, robot, 1, "front")[0]
        swing = rng.uniform(0.08, 0.22, robot.count) * np.where(robot.prismatic, 0.15, 1)
        rate, phase = rng.uniform(0.5, 1.3, robot.count), rng.uniform(0, 6.3, robot.count)
        swing = np.minimum(swing, 0.4 * np.minimum(centre - low, high - centre) + 1e-3)
        angle = rate * clock[:, None] + phase
        q = np.vstack([q, centre + swing * np.sin(angle)])
        speed = np.vstack([speed, swing * rate * np.cos(angle)])
        acceleration = np.vstack([acceleration, -swing * rate * rate * np.sin(angle)])
        runs, loads = runs + [f"path_{k + 1}_free"] * samples, loads + [None] * samples
        static = np.r_[static, np.zeros(samples, bool)]
        times = np.r_[times, times[-1] + rng.uniform(100, 300) + clock]
    q = np.where(robot.prismatic, np.round(q, 7), np.round(q / DEGREE, 6) * DEGREE)
    return Motion(runs, loads, q, speed, acceleration, static, times)


def _follow_moves(rng: Rng, q: Array) -> tuple[Array, Array]:
    """Sign and length of the last move of every joint at every row. Shapes (n, count). [-, rad or m]"""
    direction, step = np.zeros_like(q), np.zeros_like(q)
    last = rng.choice([-1.0, 1.0], q.shape[1])
    for i in range(len(q)):
        if i:
            move = q[i] - q[i - 1]
            moved = np.abs(move) > 1e-7
            last = np.where(moved, np.sign(move), last)
            step[i] = np.where(moved, np.abs(move), step[i - 1])
        direction[i] = last
    return direction, step


def _load_tip(rng: Rng, robot: Robot, motion: Motion) -> Array:
    """Wrench on the tool at the TCP, base axes, at the nominal pose without load. Shape (n, 6). [N, N m]"""
    wrench = np.zeros((len(motion.q), 6))
    R = solve_statics(State(robot, motion.q, wrench)).rotation
    for i, load in enumerate(motion.loads):
        if isinstance(load, Weight):
            force = np.array([0, 0, -9.81 * load.mass])
            wrench[i] = np.r_[force, np.cross(R[i] @ load.hook, force)]
        elif load == PULL:
            v = rng.normal(size=3)
            v[2] -= 0.6
            force = v / np.linalg.norm(v) * 9.81 * CAPACITY_KG[robot.size] * rng.uniform(0.35, 1.3)
            arm = rng.normal(size=3) * 0.05 * SCALE[robot.size]
            wrench[i] = np.r_[force, np.cross(R[i] @ arm, force) * (rng.random() < 0.5)]
    return wrench
