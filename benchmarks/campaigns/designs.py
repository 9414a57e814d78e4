"""Plans of measurement campaigns: poses, order of approach, loads, path runs, times and warm-up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaigns.description import Array, RobotDescription
from benchmarks.campaigns.engine import ElasticModel
from benchmarks.campaigns.simulate import Rows
from benchmarks.campaigns.templates import Template


@dataclass(frozen=True)
class Design:
    """How a campaign is run.

    Args:
        static_visits: Stays at a pose in every static run.
        paths: Kinds of the path runs: "circle", "spiral" or "cone".
        loads: "all" directions, "vertical" alone, "one" direction, or "none".
        unloaded: Whether stays begin with an unloaded reading.
        region: Share of the joint ranges that the poses cover, around a random posture.
        repeats: Share of the stays that come back to an earlier pose from another side.
        preload: Wrench that also acts in "unloaded" rows. Shape (6,). [N, N m]
        force_noise: Standard deviation of the force sensor. [N]
        moment_noise: Standard deviation of the moment sensor. [N m]
        sigma: Standard deviation of the position measurement, per axis. [m]
        sigma_rotation: Standard deviation of the orientation measurement, per axis. [rad]
        sigma_encoder: Standard deviation of the link-side encoders. [rad or m]
        orientation: Whether orientation columns are written.
        link_encoders: Whether link-side encoders are written.
        temperature: Whether the temperature column is written.
        sigma_column: Whether the standard deviation is written.
        si_units: Whether columns are in m and rad.
        outliers: Share of rows that are gross outliers.
        missing: Share of measured fields that are empty.
        pace: Typical seconds between readings. [s]
        warm_up: Rise [K], time constant [s], wobble [K] and its period [s].
        start_rise: Temperature above the reference when the campaign begins. [K]
    """

    static_visits: tuple[int, ...]
    paths: tuple[str, ...]
    loads: str = "all"
    unloaded: bool = True
    region: float = 1.0
    repeats: float = 0.22
    preload: tuple[float, ...] = (0.0,) * 6
    force_noise: float = 0.5
    moment_noise: float = 0.05
    sigma: float = 20e-6
    sigma_rotation: float = float(np.deg2rad(0.005))
    sigma_encoder: float = float(np.deg2rad(0.0003))
    orientation: bool = True
    link_encoders: bool = False
    temperature: bool = True
    sigma_column: bool = True
    si_units: bool = False
    outliers: float = 0.0
    missing: float = 0.0
    pace: float = 10.0
    warm_up: tuple[float, float, float, float] = (3.0, 3000.0, 0.2, 2500.0)
    start_rise: float = 0.0


def draw_design(rng: np.random.Generator, difficulty: str, template: Template) -> tuple[Design, list[str]]:
    """Draw the design of the campaign that a diagnosis is given, and the names of its handicaps.

    Args:
        rng: Source of randomness.
        difficulty: "clean" or "realistic".
        template: The robot's figures.
    """
    runs = int(rng.integers(1, 4))
    visits = tuple(int(v) for v in rng.integers(36, 136, runs))
    has_paths = rng.random() < 0.6
    paths = tuple(str(p) for p in rng.choice(["circle", "spiral", "cone"], int(rng.integers(1, 3)), replace=False))
    start = 20.0 if template.max_force < 500 else 75.0
    preload = np.zeros(6)
    if rng.random() < 0.2:
        preload[:3] = rng.normal(size=3) * start / 1.7
    noisy = rng.random() < 0.5
    distance = float(rng.uniform(0.0, 4.0))
    design = Design(
        static_visits=visits,
        paths=paths if has_paths else (),
        preload=tuple(float(v) for v in np.round(preload, 2)),
        force_noise=0.5 if noisy else 0.0,
        moment_noise=0.05 if noisy else 0.0,
        sigma=round((15.0 + 6.0 * distance) * 1e-6 * float(rng.uniform(0.95, 1.05)), 7),
        orientation=bool(rng.random() < 0.5),
        link_encoders=bool(rng.random() < 0.3),
        temperature=bool(rng.random() < 0.55),
        sigma_column=bool(rng.random() < 0.5),
        si_units=bool(rng.random() < 0.12),
        outliers=float(rng.uniform(0.004, 0.019)) if rng.random() < 0.35 else 0.0,
        missing=float(rng.uniform(0.002, 0.012)) if rng.random() < 0.2 else 0.0,
        pace=float(np.exp(rng.uniform(np.log(9.0), np.log(40.0)))),
        warm_up=_draw_warm_up(rng),
    )
    return _handicap(rng, design) if difficulty == "realistic" else (design, [])


def _handicap(rng: np.random.Generator, design: Design) -> tuple[Design, list[str]]:
    names: list[str] = []
    if rng.random() < 0.2:
        design, names = replace(design, static_visits=(35,), repeats=0.0), [*names, "35 poses"]
    if rng.random() < 0.2:
        design, names = replace(design, loads="vertical"), [*names, "vertical loads only"]
    if rng.random() < 0.15:
        design, names = replace(design, unloaded=False), [*names, "no unloaded rows"]
    if rng.random() < 0.2:
        design, names = replace(design, region=float(rng.uniform(0.2, 0.35))), [*names, "narrow region"]
    return design, names


def _draw_warm_up(rng: np.random.Generator) -> tuple[float, float, float, float]:
    rise = float(np.exp(rng.uniform(np.log(0.5), np.log(15.0))))
    return rise, float(rng.uniform(2000, 3600)), float(rng.uniform(0.1, 0.35)), float(rng.uniform(1600, 4000))


def later_design(rng: np.random.Generator, design: Design) -> Design:
    """Return the design of a later campaign of the same robot: new poses, loads of all directions, shorter."""
    loads = design.loads if design.loads == "none" else "all"
    rise, tau, wobble, period = design.warm_up
    if design.temperature:
        rise, tau, wobble, period = _draw_warm_up(rng)
    keep = 1 if design.paths else 0
    return replace(
        design,
        static_visits=(int(rng.integers(40, 70)),),
        paths=design.paths[:keep],
        loads=loads,
        unloaded=True,
        region=1.0 if design.region == 1.0 else min(1.0, 1.3 * design.region),
        warm_up=(rise, tau, wobble, period),
        start_rise=float(rng.uniform(0.0, 0.5) * rise) if design.temperature else 0.0,
        pace=float(np.clip(design.pace * rng.uniform(0.8, 1.3), 9.0, 40.0)),
    )


def plan_rows(
    rng: np.random.Generator,
    robot: RobotDescription,
    template: Template,
    design: Design,
    *,
    around: Array | None = None,
    later: bool = False,
) -> Rows:
    """Lay out the rows of a campaign.

    Args:
        rng: Source of randomness.
        robot: The nominal robot.
        template: The robot's figures.
        design: How the campaign is run.
        around: Centre of a narrow region; drawn if None. Shape (nq,). [rad or m]
        later: Whether this is the later campaign.
    """
    model = ElasticModel(robot, ())
    low, high = pose_ranges(rng, robot, template, design.region, around)
    parts: list[tuple[str, bool, Array, Array, Array]] = []
    clock = 0.0
    for number, visits in enumerate(design.static_visits):
        q, load, time = _static_run(rng, model, template, design, visits, low, high)
        parts.append((f"static_{number + 1}", False, q, load, clock + time))
        clock += float(time[-1]) + float(rng.uniform(200.0, 900.0))
    for number, kind in enumerate(design.paths):
        made = _path_run(rng, model, template, design, kind, low, high)
        if made is None:
            continue
        q, load, time = made
        parts.append((f"path_{number + 1}_{kind}", True, q, load, clock + time))
        clock += float(time[-1]) + float(rng.uniform(60.0, 250.0))
    time = np.concatenate([p[4] for p in parts])
    rise, tau, wobble, period = design.warm_up
    warm = design.start_rise + rise * (1.0 - np.exp(-time / tau)) + wobble * np.sin(2.0 * np.pi * time / period)
    return Rows(
        run=np.concatenate([[p[0]] * len(p[2]) for p in parts]),
        is_path=np.concatenate([[p[1]] * len(p[2]) for p in parts]),
        time=np.round(time, 4),
        q=np.concatenate([p[2] for p in parts]),
        wrench=np.concatenate([p[3] for p in parts]),
        rise=warm,
        later=later,
    )


def pose_ranges(
    rng: np.random.Generator, robot: RobotDescription, template: Template, region: float, around: Array | None
) -> tuple[Array, Array]:
    """Return the joint ranges that poses are drawn from. Shapes (nq,), (nq,). [rad or m]"""
    arm = np.deg2rad(np.array(template.region_deg))
    rail = len(robot.joint_names) > len(arm)
    low, high = arm[:, 0], arm[:, 1]
    if rail:
        low, high = np.r_[-2.4, low], np.r_[2.4, high]
    if region < 1.0:
        half = 0.5 * region * (high - low)
        centre = rng.uniform(low + half, high - half) if around is None else around
        low, high = np.maximum(low, centre - half), np.minimum(high, centre + half)
    return low, high


def reach_of(model: ElasticModel, q: Array) -> Array:
    """Return rigid TCP positions. Shape (n, 3). [m]"""
    return np.asarray(model.place(q, np.zeros((len(q), 0)), None)[3])


def _draw_poses(rng: np.random.Generator, model: ElasticModel, count: int, low: Array, high: Array) -> Array:
    """Draw poses whose TCP stands above the floor and clear of the column."""
    found = np.empty((0, len(low)))
    for _ in range(200):
        q = rng.uniform(low, high, (4 * count, len(low)))
        tip = reach_of(model, q)
        rail = float(model.hinge[model.motor_ids[0]] == 0)
        aside = tip[:, 1] - rail * q[:, 0]
        clear = (tip[:, 2] > 0.1) & (np.hypot(tip[:, 0], aside) > 0.3)
        found = np.vstack([found, q[clear]])
        if len(found) >= count:
            break
    return round_readings(found[:count])


def round_readings(q: Array) -> Array:
    """Round readings to what a controller logs."""
    return np.asarray(np.deg2rad(np.round(np.rad2deg(q), 6)), dtype=float)


def _static_run(
    rng: np.random.Generator,
    model: ElasticModel,
    template: Template,
    design: Design,
    visits: int,
    low: Array,
    high: Array,
) -> tuple[Array, Array, Array]:
    """Lay out one static run: stays with an unloaded reading and up to three loads, some poses approached twice."""
    poses = list(_draw_poses(rng, model, visits, low, high))
    stays: list[tuple[Array, bool]] = []
    while len(stays) < visits:
        back = rng.random()
        if stays and back < 0.5 * design.repeats:
            known = stays[int(rng.integers(max(0, len(stays) - 20), len(stays)))][0]
            aside = known + np.deg2rad(rng.uniform(1.5, 5.5)) * rng.choice([-1.0, 1.0], len(low))
            stays += [(np.round(np.clip(aside, low, high), 8), True), (known, False)]
        elif stays and back < design.repeats:
            stays.append((stays[int(rng.integers(len(stays)))][0], False))
        else:
            stays.append((poses.pop(), False))
    q, load = [], []
    preload = np.array(design.preload)
    for pose, passing in stays:
        readings = []
        if design.unloaded or design.loads == "none":
            readings.append(preload)
        extra = 0 if passing else int(rng.choice(4, p=[0.2, 0.32, 0.26, 0.22]))
        if not design.unloaded:
            extra = max(extra, 1)
        if design.loads == "none":
            readings += [preload] * (extra if rng.random() < 0.4 else 0)
        else:
            loads = [draw_load(rng, template, design.loads) + preload for _ in range(extra)]
            again = design.unloaded and rng.random() < 0.05
            readings += [preload, preload] if again else loads
        q += [pose] * len(readings)
        load += readings
    time = np.cumsum(design.pace * rng.uniform(0.5, 1.3, len(q)) * (1.0 + 0.7 * (np.diff(q, axis=0, prepend=0).any(1))))
    return np.array(q), np.array(load), time - time[0]


def draw_load(rng: np.random.Generator, template: Template, kind: str) -> Array:
    """Draw a wrench on the tool, base axes; with a moment in two of five. Shape (6,). [N, N m]"""
    size = template.max_force * float(rng.uniform(0.05, 1.0))
    if kind == "vertical":
        return np.array([0.0, 0.0, size * rng.choice([-1.0, 1.0]), 0.0, 0.0, 0.0])
    if kind == "one":
        return np.array([0.0, 0.0, -size, 0.0, 0.0, 0.0])
    direction = rng.normal(size=3)
    force = size * direction / np.linalg.norm(direction)
    moment = np.zeros(3)
    if rng.random() < 0.4:
        moment = np.cross(rng.normal(size=3) * 0.15, force) * (0.5 if template.max_force < 500 else 1.0)
    return np.asarray(np.round(np.r_[force, moment], 3), dtype=float)


def _path_run(
    rng: np.random.Generator,
    model: ElasticModel,
    template: Template,
    design: Design,
    kind: str,
    low: Array,
    high: Array,
) -> tuple[Array, Array, Array] | None:
    """Lay out one path run; None if no posture was found that reaches all of it."""
    count = int(rng.integers(300, 680))
    radius = float(rng.uniform(0.06, 0.15)) * (0.6 if template.max_force < 500 else 1.0)
    for _ in range(40):
        start = _draw_poses(rng, model, 1, low, high)[0]
        offsets, tangent, radial = path_points(rng, kind, count, radius)
        q = follow_path(model, start, offsets)
        if q is None or np.any(q < low - 0.3) or np.any(q > high + 0.3):
            continue
        speed = float(rng.uniform(0.018, 0.045))
        step = np.linalg.norm(np.diff(offsets, axis=0), axis=1)
        time = np.r_[0.0, np.cumsum(step / speed)]
        force = template.max_force * float(rng.uniform(0.25, 0.45))
        ramp = np.minimum(1.0, np.arange(count) / (0.04 * count))
        ripple = 1.0 + 0.12 * np.sin(np.linspace(0.0, rng.uniform(20, 60), count) + rng.uniform(0, 6))
        up = np.array([0.0, 0.0, 1.0])
        vertical = design.loads in ("vertical", "one")
        push = up if vertical else up - 0.35 * tangent + 0.15 * radial
        wrench = np.zeros((count, 6))
        if design.loads != "none":
            wrench[:, :3] = (force * ramp * ripple)[:, None] * push
        if design.loads == "one":
            wrench = -wrench
        return round_readings(q), wrench + np.array(design.preload), time
    return None


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
