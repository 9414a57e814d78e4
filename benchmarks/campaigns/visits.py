"""How engineers with a tracker measure: few poses, dead weights, poses met again later; and the richer campaigns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaigns.description import Array
from benchmarks.campaigns.engine import ElasticModel
from benchmarks.campaigns.machines import Machine
from benchmarks.campaigns.simulate import Rows

Generator = np.random.Generator
DESIGNS = ("plain", "weights", "rich", "many")


@dataclass(frozen=True)
class Visits:
    """How a campaign is run and what its log says.

    Args:
        design: "plain" (no load), "weights" (dead weights), "rich" (loads of all directions, paths) or "many" (100-500
            poses).
        stays: Poses approached in every static run. Shape (n_runs,).
        weights_kg: Dead weight of every static run, 0 for none; None where forces have any direction.
        hang: Where weights hang, TCP frame. Shape (3,). [m]
        paths: Number of path runs.
        again: Share of stays that go back to an earlier pose, not the last one.
        pace: Typical seconds between readings. [s]
        warm_up: Rise [K], two time constants [s], share of the first, wander [K] and its period [s].
        start_rise: Temperature above the reference when the campaign begins. [K]
        region: Share of the joint ranges covered, around a drawn posture.
        outliers: Share of rows that are gross outliers.
        missing: Share of measured fields that are empty.
        tracker: Where the instrument stands, base frame. Shape (3,). [m]
        noise: Standard deviation per axis of the instrument: constant part [m] and part per metre of distance.
        force_noise: Standard deviation of the force sensor [N]; moments a tenth [N m].
        orientation, link_encoders, temperature, time, sigma_column, si_units: Columns and units of the log.
    """

    design: str
    stays: tuple[int, ...]
    weights_kg: tuple[float, ...] | None
    hang: tuple[float, float, float]
    paths: int
    again: float
    pace: float
    warm_up: tuple[float, float, float, float, float, float]
    region: float
    outliers: float
    missing: float
    tracker: tuple[float, float, float]
    noise: tuple[float, float]
    force_noise: float
    start_rise: float = 0.0
    orientation: bool = False
    link_encoders: bool = False
    temperature: bool = False
    time: bool = False
    sigma_column: bool = False
    si_units: bool = False

    @property
    def loaded(self) -> bool:
        """Tell whether the log has wrench columns."""
        return self.weights_kg is None or any(self.weights_kg)

    def sigma(self, position: Array) -> Array:
        """Return the instrument's standard deviation per axis at TCP positions. Shape (n,). [m]"""
        distance = np.linalg.norm(position - np.array(self.tracker), axis=1)
        return np.asarray(self.noise[0] + self.noise[1] * distance)


def draw_visits(rng: Generator, machine: Machine, suite: str) -> Visits:
    """Draw how a campaign is run.

    Args:
        rng: Source of randomness.
        machine: The robot.
        suite: "tracker" or "realistic".
    """
    chances = (0.34, 0.5, 0.08, 0.08) if suite == "tracker" else (0.0, 0.05, 0.75, 0.2)
    design = str(rng.choice(DESIGNS, p=chances))
    payload = machine.payload_kg
    weights: tuple[float, ...] | None = (0.0,)
    count = int(rng.integers(20, 61))
    stays: tuple[int, ...] = (count,)
    if design == "plain" and rng.random() < 0.25 and count > 30:
        stays, weights = (count // 2, count - count // 2), (0.0, 0.0)
    if design == "weights":
        heavy = tuple(round(payload * float(v), 2) for v in rng.uniform(0.3, 1.0, 1 + int(rng.random() < 0.6)))
        shares = rng.dirichlet(np.full(len(heavy) + 1, 12.0))
        stays, weights = tuple(max(7, int(v)) for v in shares * max(count, 12 * (len(heavy) + 1))), (0.0, *heavy)
    if design == "rich":
        stays = tuple(int(v) for v in rng.integers(25, 90, int(rng.integers(1, 3))))
        weights = None
    if design == "many":
        stays = (int(np.exp(rng.uniform(np.log(100), np.log(500)))),)
        weights = None if rng.random() < 0.35 else ((0.0,) if rng.random() < 0.5 else (0.0, round(0.7 * payload, 2)))
        if weights and len(weights) == 2:
            stays = (stays[0] // 2, stays[0] // 2)
    away = machine.reach * float(rng.uniform(1.2, 2.2)) + 0.7
    bearing = float(rng.uniform(-1.0, 1.0))
    tracker = (away * np.cos(bearing), away * np.sin(bearing), float(rng.uniform(0.8, 1.9)))
    full = design in ("rich", "many")
    hang = rng.normal(size=3) * 0.08 * min(machine.scale, 1.0) ** 0.5
    return Visits(
        design,
        stays,
        weights,
        (float(hang[0]), float(hang[1]), float(abs(hang[2]))),
        int(rng.integers(0, 3)) if design == "rich" else 0,
        float(rng.choice([0.0, 0.03, 0.08, 0.15])) if design != "rich" else 0.2,
        float(np.exp(rng.uniform(np.log(20), np.log(110)))) * (0.4 if full else 1.0),
        _draw_warm_up(rng),
        float(rng.uniform(0.3, 0.6)) if rng.random() < 0.25 else 1.0,
        float(rng.uniform(0.004, 0.018)) if rng.random() < 0.3 else 0.0,
        float(rng.uniform(0.002, 0.01)) if rng.random() < 0.15 else 0.0,
        (round(tracker[0], 2), round(tracker[1], 2), round(tracker[2], 2)),
        (float(rng.uniform(6e-6, 16e-6)), float(rng.uniform(2.5e-6, 7e-6))),
        (0.5 if machine.payload_kg > 30 else 0.15) if design == "rich" and rng.random() < 0.7 else 0.0,
        orientation=bool(rng.random() < (0.5 if design == "rich" else 0.08)),
        link_encoders=bool(design == "rich" and rng.random() < 0.2),
        temperature=bool(rng.random() < (0.5 if full else 0.15)),
        time=bool(rng.random() < 0.5) or design == "rich",
        sigma_column=bool(rng.random() < 0.4),
        si_units=bool(rng.random() < 0.1),
    )


def _draw_warm_up(rng: Generator) -> tuple[float, float, float, float, float, float]:
    rise = float(np.exp(rng.uniform(np.log(0.8), np.log(8.0))))
    fast, slow = float(rng.uniform(250, 900)), float(rng.uniform(2500, 7000))
    return rise, fast, slow, float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.05, 0.4)), float(rng.uniform(1200, 5000))


def later_visits(rng: Generator, visits: Visits) -> Visits:
    """Return how the same robot is measured later: new poses, the weights in another order, no paths beyond one."""
    stays = tuple(int(np.clip(0.75 * n, 12 if len(visits.stays) > 1 else 25, 60)) for n in visits.stays)
    weights = visits.weights_kg
    if weights is not None:
        weights = tuple(round(w * float(rng.uniform(0.75, 1.15)), 2) for w in weights)
    warm, start = visits.warm_up, 0.0
    if visits.temperature:
        warm = _draw_warm_up(rng)
        start = float(rng.uniform(0.0, 0.5)) * warm[0]
    return replace(
        visits, stays=stays, weights_kg=weights, paths=min(visits.paths, 1), warm_up=warm, start_rise=start, region=1.0
    )


def plan_visits(rng: Generator, machine: Machine, visits: Visits, *, later: bool = False) -> Rows:
    """Lay out the rows of a campaign.

    Args:
        rng: Source of randomness.
        machine: The robot.
        visits: How the campaign is run.
        later: Whether this is the later campaign.
    """
    model = ElasticModel(machine.robot, ())
    low, high = machine.low, machine.high
    if visits.region < 1.0:
        half = 0.5 * visits.region * (high - low)
        centre = rng.uniform(low + half, high - half)
        low, high = centre - half, centre + half
    parts: list[tuple[str, bool, Array, Array, Array]] = []
    clock = 0.0
    for number, count in enumerate(visits.stays):
        kilos = None if visits.weights_kg is None else visits.weights_kg[number]
        q, wrench = _static_run(rng, model, machine, visits, count, low, high, kilos)
        moved = np.r_[True, np.any(np.diff(q, axis=0) != 0.0, axis=1)]
        steps = visits.pace * rng.uniform(0.6, 1.5, len(q)) * np.where(moved, 1.0, 0.45)
        steps[0] = 0.0
        time = np.cumsum(steps)
        parts.append((f"static_{number + 1}", False, q, wrench, clock + time))
        clock += float(time[-1] + rng.uniform(300.0, 1200.0))
    for number in range(visits.paths):
        made = _path_run(rng, model, machine, low, high)
        if made is None:
            continue
        kind, q, wrench, time = made
        parts.append((f"path_{number + 1}_{kind}", True, q, wrench, clock + time))
        clock += float(time[-1] + rng.uniform(60.0, 250.0))
    time = np.round(np.concatenate([p[4] for p in parts]), 4)
    return Rows(
        np.concatenate([[p[0]] * len(p[2]) for p in parts]),
        np.concatenate([[p[1]] * len(p[2]) for p in parts]),
        time,
        np.concatenate([p[2] for p in parts]),
        np.concatenate([p[3] for p in parts]),
        temperature_rise(visits, time),
        later,
    )


def temperature_rise(visits: Visits, time: Array) -> Array:
    """Return the warming of the structure: motors' heat and the hall's, with two time constants. Shape (n,). [K]"""
    rise, fast, slow, share, wander, period = visits.warm_up
    own = share * (1.0 - np.exp(-time / fast)) + (1.0 - share) * (1.0 - np.exp(-time / slow))
    hall = wander * (np.sin(2 * np.pi * time / period) + 0.4 * np.sin(5.3 * time / period))
    return np.asarray(visits.start_rise + rise * own + hall)


def _draw_poses(rng: Generator, model: ElasticModel, machine: Machine, count: int, low: Array, high: Array) -> Array:
    """Draw poses whose TCP stands above the floor and clear of the column."""
    found = np.empty((0, len(low)))
    for clearance in (0.12, 0.12, 0.12, 0.06, 0.0):
        q = rng.uniform(low, high, (6 * count, len(low)))
        tip = model.place(q, np.zeros((len(q), 0)), None)[3]
        column = np.hypot(tip[:, 0], tip[:, 1]) if machine.robot.segments[1].joint != "rail" else np.inf
        clear = (tip[:, 2] > 0.04 * machine.reach) & (column > clearance * machine.reach)
        found = np.vstack([found, q[clear]])
        if len(found) >= count:
            break
    if len(found) < count:
        raise LookupError("no poses clear of floor and column")
    return round_readings(found[:count])


def _static_run(
    rng: Generator,
    model: ElasticModel,
    machine: Machine,
    visits: Visits,
    count: int,
    low: Array,
    high: Array,
    kilos: float | None,
) -> tuple[Array, Array]:
    """Lay out one static run: poses, some met again, and the wrench on the tool in each reading."""
    fresh = iter(_draw_poses(rng, model, machine, count, low, high))
    poses = [next(fresh)]
    if kilos is not None and rng.random() < 0.5:
        poses.append(poses[0])  # the first pose is read twice, to see that the instrument is awake
    while len(poses) < count:
        if len(poses) > 3 and rng.random() < visits.again:
            poses.append(poses[int(rng.integers(0, len(poses) - 2))])
        else:
            poses.append(next(fresh))
    q = np.array(poses)
    if kilos is not None:
        rotation = model.place(q, np.zeros((len(q), 0)), None)[4]
        return q, dead_weight(kilos, rotation @ np.array(visits.hang))
    readings = [_draw_loads(rng, machine) for _ in poses]
    return np.repeat(q, [len(r) for r in readings], axis=0), np.concatenate(readings)


def dead_weight(kilos: float, arm: Array) -> Array:
    """Return the wrench of a weight at arms from the TCP, base axes. Shapes (n, 3), (n, 6)."""
    wrench = np.zeros((len(arm), 6))
    wrench[:, 2] = -9.81 * kilos
    wrench[:, 3:] = np.cross(arm, wrench[:, :3])
    return np.asarray(np.round(wrench, 3) + 0.0)


def _draw_loads(rng: Generator, machine: Machine) -> Array:
    """Draw the loads of one stay: none first, then up to two of any direction. Shape (k, 6). [N, N m]"""
    wrenches = [np.zeros(6)]
    for _ in range(int(rng.choice(3, p=[0.3, 0.45, 0.25]))):
        force = rng.normal(size=3)
        force *= 9.81 * machine.payload_kg * float(rng.uniform(0.1, 1.0)) / np.linalg.norm(force)
        moment = np.cross(rng.normal(size=3) * 0.06 * machine.scale**0.5, force) if rng.random() < 0.4 else np.zeros(3)
        wrenches.append(np.round(np.r_[force, moment], 3))
    return np.array(wrenches)


def _path_run(
    rng: Generator, model: ElasticModel, machine: Machine, low: Array, high: Array
) -> tuple[str, Array, Array, Array] | None:
    """Lay out one path run with a process force; None if no posture was found that reaches all of it."""
    kind = str(rng.choice(["circle", "spiral", "cone"]))
    for _ in range(15):
        count = int(rng.integers(150, 400))
        start = _draw_poses(rng, model, machine, 1, low, high)[0]
        offsets, tangent, inward = path_points(rng, kind, count, float(rng.uniform(0.04, 0.06)) * machine.reach)
        q = follow_path(model, start, offsets)
        if q is None or np.any(q < low - 0.3) or np.any(q > high + 0.3):
            continue
        speed = float(rng.uniform(0.02, 0.06))
        time = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(offsets, axis=0), axis=1) / speed)]
        force = 9.81 * machine.payload_kg * float(rng.uniform(0.15, 0.4))
        ramp = np.minimum(1.0, np.arange(count) / (0.05 * count))
        wrench = np.zeros((count, 6))
        wrench[:, :3] = (force * ramp)[:, None] * (np.array([0.0, 0.0, 1.0]) - 0.4 * tangent + 0.2 * inward)
        return kind, round_readings(q), wrench, time
    return None


def round_readings(q: Array) -> Array:
    """Round readings to what a controller logs."""
    return np.asarray(np.deg2rad(np.round(np.rad2deg(q), 6)), dtype=float)


def path_points(rng: np.random.Generator, kind: str, count: int, radius: float) -> tuple[Array, Array, Array]:
    """Return offsets from the first point, tangents and inward directions, all in base axes. Shapes (n, 3)."""
    turns = 1.0 if kind == "circle" else float(rng.uniform(2.0, 4.0))
    along = np.linspace(0.0, 1.0, count)
    # wobble of the sampling: equal angles in circles, changing distances elsewhere
    angle = 2.0 * np.pi * turns * along * rng.choice([-1.0, 1.0]) + rng.uniform(0.0, 2.0 * np.pi)
    size = np.full(count, radius) if kind == "circle" else radius * (1.0 - 0.6 * along)
    z = -0.05 * along if kind == "cone" else np.zeros(count)
    points = np.stack([size * np.cos(angle), size * np.sin(angle), z], axis=1)
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    inward = -np.stack([np.cos(angle), np.sin(angle), 0 * z], axis=1)
    return points - points[0], tangent, inward


def follow_path(model: ElasticModel, start: Array, offsets: Array) -> Array | None:
    """Find joint positions that move the TCP by the offsets with its orientation kept; the rail stays where it is."""
    n = len(offsets)
    q = np.tile(start, (n, 1))
    none = np.zeros((n, 0))
    ids = model.motor_ids
    hinge = model.hinge[ids]
    first = model.place(q[:1], none[:1], None)
    target, turn = first[3][0] + offsets, first[4][0]
    for _ in range(30):
        axes, anchors, _, tip, rotation = model.place(q, none, None)
        a, o = axes[:, ids][:, hinge], anchors[:, ids][:, hinge]
        jacobian = np.concatenate([np.cross(a, tip[:, None] - o), a], axis=2).transpose(0, 2, 1)
        twist = np.einsum("ij,nkj->nik", turn, rotation)
        spin = 0.5 * np.stack(
            [twist[:, 2, 1] - twist[:, 1, 2], twist[:, 0, 2] - twist[:, 2, 0], twist[:, 1, 0] - twist[:, 0, 1]], axis=1
        )
        miss = np.concatenate([target - tip, spin], axis=1)
        if np.max(np.abs(miss)) < 1e-9:
            return q if np.max(np.abs(np.diff(q, axis=0))) < 0.05 else None
        square = jacobian.transpose(0, 2, 1) @ jacobian + 1e-8 * np.eye(a.shape[1])
        step = np.linalg.solve(square, np.einsum("nij,ni->nj", jacobian, miss)[:, :, None])[:, :, 0]
        q[:, hinge] += np.clip(step, -0.2, 0.2)
    return None
