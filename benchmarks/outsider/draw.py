"""One case of a seed: robot, campaigns, causes at their sizes, everyday errors, and what may be asked about each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from benchmarks.outsider.effects import EFFECTS, REPLACED, UNKNOWN, Place
from benchmarks.outsider.world import GRAVITY, Apply, Array, Rng, Rows, TrueRobot, World, observe
from benchmarks.simulated_robot.cell import Kinematics
from benchmarks.simulated_robot.robot import Arm, read_arm

SHIPPED = Path(__file__).resolve().parents[2] / "robots"
#: Robots, and what hangs on each in a campaign with dead weights. [kg]
ROBOTS: Mapping[str, float] = {
    "ur10e": 8.0, "franka_fr3": 2.5, "abb_irb1200_7_70": 6.0, "staubli_tx2_90": 7.0, "kuka_kr16_2": 14.0,
    "fanuc_m20ia": 18.0, "yaskawa_gp25": 22.0, "kuka_kr270": 200.0, "abb_irb6700_200_260": 180.0,
    "kuka_kr240_rail": 190.0,
}  # fmt: skip
KINDS: Mapping[str, float] = {
    "single": 0.38, "double": 0.18, "triple": 0.06, "quadruple": 0.03, "mixed": 0.12, "unknown": 0.15, "none": 0.03,
    "background": 0.05,
}  # fmt: skip
COUNT = {"single": 1, "double": 2, "triple": 3, "quadruple": 4, "mixed": 1}
ATTEMPTS, TRIALS = 14, 6
#: Standard deviations by which a cause stands out, as it is drawn, and the least that is asked about.
SEEN, VISIBLE = (6.5, 120.0), 4.5
#: A rival that leaves so little, or explains so much, is an acceptable answer.
ACCEPTED_DISTANCE, ACCEPTED_R2 = 2.0, 0.98
#: An unknown cause keeps this distance from every effect of the list, which explains at most this share.
UNLIKE_DISTANCE, UNLIKE_R2 = 5.0, 0.93
#: Everyday errors of an arm that was calibrated: zeros and turns [rad], lengths [m], lost motion and gears [rad].
EVERYDAY = {"joint_offset": 4e-5, "t": 4e-5, "r": 3e-5, "backlash": 3e-5, "transmission_error": 2e-5}


@dataclass(frozen=True)
class Cause:
    """A cause at a size; `unit` of a cause without a name is in its `note`."""

    effect: str
    place: Place
    size: float
    apply: Apply
    unit: str = "see note"
    note: str | None = None
    params: Mapping[str, Any] | None = None

    @property
    def key(self) -> tuple[str, str | None, str | None]:
        """Effect, joint and axis."""
        return self.effect, *self.place


@dataclass(frozen=True)
class Case:
    """A drawn case. `register`: frames unknown; `sigma` of a coordinate [m]; `scatter` of the joints in a stay."""

    seed: int
    kind: str
    robot: str
    gravity: bool
    register: bool
    given: World
    fresh: World
    sigma: float
    scatter: Array
    causes: Sequence[Cause]
    everyday: Sequence[Cause]
    labels: Sequence[dict[str, Any]]
    columns: frozenset[str]
    rng: Rng


def kind_of(seed: int) -> str:
    """Kind of the case of a seed, from a low-discrepancy sequence."""
    place = (seed * 0.6180339887498949 + 0.37) % 1.0
    return list(KINDS)[int(np.searchsorted(np.cumsum(list(KINDS.values())), place))]


def draw_case(seed: int) -> Case | None:
    """Draw the case of a seed; None if no attempt gave one that can be labelled fairly."""
    drawn = (_attempt(seed, np.random.default_rng([seed, 78, attempt])) for attempt in range(ATTEMPTS))
    return next((case for case in drawn if case is not None), None)


def _attempt(seed: int, rng: Rng) -> Case | None:
    kind, robot = kind_of(seed), list(ROBOTS)[seed % len(ROBOTS)]
    shares = np.array([effect.share for effect in EFFECTS.values()])
    names = [str(n) for n in rng.choice(list(EFFECTS), COUNT.get(kind, 0), p=shares / shares.sum())]
    needs = {EFFECTS[name].needs for name in names}
    if {"tracking_lag", "time_skew"} <= set(names):
        return None
    gravity = "no gravity" not in needs
    arm = replace(read_arm(SHIPPED / robot), gravity=GRAVITY if gravity else None)
    register = "known frames" not in needs and bool(rng.random() < 0.4)
    design = "sensor" if "sensor" in needs else str(rng.choice(["plain", "weights", "sensor"], p=[0.35, 0.5, 0.15]))
    given, fresh = (World(arm, _draw_rows(rng, robot, arm, design, "path" in needs, later)) for later in (False, True))
    sigma = float(rng.uniform(15e-6, 60e-6))
    scatter = np.where(given.slides, 1.0, 1.0 / given.reach) * float(rng.choice([0.0, 8e-6, 15e-6]))
    calm = kind == "none" or (kind != "background" and rng.random() < 0.15)
    everyday = [] if calm else _draw_everyday(rng, given, register)
    scale = _Scale(given, register, sigma, scatter, everyday)
    causes: list[Cause] = []
    for name in [*names, *["unknown"] * (kind in ("mixed", "unknown"))]:
        drawn = (_draw_cause(rng, given, scale, name) for _ in range(TRIALS))
        cause = next((c for c in drawn if c is not None and c.key not in {d.key for d in causes}), None)
        if cause is None:
            return None
        causes.append(cause)
    labels = _label_causes(given, scale, causes, everyday)
    if labels is None:
        return None
    columns = {"time"} if design != "plain" or "path" in needs or rng.random() < 0.6 else set()
    columns |= {"temperature"} if "thermal_drift" in names or rng.random() < 0.2 else set()
    columns |= {"sigma"} if rng.random() < 0.5 else set()
    columns |= {"wrench"} if design != "plain" or rng.random() < 0.3 else set()
    return Case(seed, kind, robot, gravity, register, given, fresh, sigma, scatter, causes, everyday, labels,
                frozenset(columns), rng)  # fmt: skip


# ------------------------------------------------------------------------------------------------------------ campaigns


def _draw_rows(rng: Rng, robot: str, arm: Arm, design: str, path: bool, fresh: bool) -> Rows:
    """Draw the rows of a campaign: poses with loads in time order, and a run along a path where one is asked for."""
    poses = _draw_poses(rng, arm, int(rng.integers(25, 40) if fresh else rng.integers(30, 56)))
    mass, hook = ROBOTS[robot] * float(rng.uniform(0.4, 1.0)), 0.03 * rng.normal(size=3)
    loads = [(q, run, load) for q in poses for run, load in _loads(rng, design)]
    if design == "weights" and rng.random() < 0.6:  # a run without the weight, then one with it
        loads.sort(key=lambda row: row[1])
    loads += [loads[k] for k in rng.integers(0, len(loads), 3)]
    q = np.array([row[0] for row in loads])
    runs, n = [row[1] for row in loads], len(loads)
    axes = Kinematics(arm).tip(q)[:, :3, :3]
    wrench = np.zeros((n, 6))
    for i, (_, _, load) in enumerate(loads):
        if load == "weight":
            force = mass * GRAVITY
            wrench[i] = np.r_[force, np.cross(axes[i] @ hook, force)]
        elif load == "pull":
            wrench[i, :3] = 9.81 * mass * rng.uniform(0.4, 1.2) * _direction(rng)
    time = np.cumsum(rng.uniform(20.0, 110.0, n))
    speed = np.zeros_like(q)
    if path:
        clock = np.arange(int(rng.integers(90, 140))) / 12.5
        swing = rng.uniform(0.08, 0.2, q.shape[1]) * np.where([j.slides for j in arm.commanded], 0.15, 1.0)
        rate, phase = rng.uniform(0.5, 1.3, q.shape[1]), rng.uniform(0, 6.3, q.shape[1])
        angle = rate * clock[:, None] + phase
        q = np.vstack([q, poses[0] + swing * np.sin(angle)])
        speed = np.vstack([speed, swing * rate * np.cos(angle)])
        runs, time = runs + ["path_1_free"] * len(clock), np.r_[time, time[-1] + 200.0 + clock]
        wrench = np.vstack([wrench, np.zeros((len(clock), 6))])
    static = np.arange(len(q)) < n
    warm = float(rng.uniform(4, 12)) * (1 - np.exp(-time / float(rng.uniform(900, 3000))))
    moves = np.diff(q, axis=0, prepend=q[:1])
    direction = np.where(moves == 0, np.nan, np.sign(moves))
    direction[0] = rng.choice([-1.0, 1.0], q.shape[1])
    for i in range(1, len(q)):
        direction[i] = np.where(np.isnan(direction[i]), direction[i - 1], direction[i])
    visit = np.cumsum(np.abs(moves).max(axis=1) > 0)
    return Rows(
        runs, q, speed, static, time, wrench, warm, direction, visit - visit[0], fresh, int(rng.integers(1 << 30))
    )


def _loads(rng: Rng, design: str) -> list[tuple[str, str]]:
    """Runs and loads of a pose."""
    if design == "plain":
        return [("static_1", "")]
    if design == "weights":
        return [("static_1", ""), ("static_2", "weight")]
    return [("static_1", ""), *[("static_1", "pull")] * int(rng.integers(1, 3))]


def _direction(rng: Rng) -> Array:
    v = rng.normal(size=3) - [0.0, 0.0, 0.6]
    return np.asarray(v / np.linalg.norm(v))


def _draw_poses(rng: Rng, arm: Arm, count: int) -> Array:
    """Draw postures as a person types them: whole or tenth degrees, tool off the floor and away from the column."""
    low, high = (np.array([getattr(j, side) for j in arm.commanded]) for side in ("lower", "upper"))
    slides = np.array([j.slides for j in arm.commanded])
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    half = np.where(
        slides, 0.8 * half, np.minimum(0.7 * half, np.radians([100, 50, 55, 110, 75, 150, 150])[: len(low)])
    )
    middle = np.where(~slides & (half > 0.45 * (high - low)), 0.0, middle)
    chosen: list[Array] = []
    decimals = int(rng.choice([0, 1]))
    reach = sum(float(np.linalg.norm(j.pose[:3, 3])) for j in arm.joints[1:])
    while len(chosen) < count:
        q = middle + half * rng.uniform(-1, 1, (64, len(low)))
        q = np.where(slides, np.round(q, 3), np.radians(np.round(np.degrees(q), decimals)))
        tip = Kinematics(arm).tip(q)[:, :3, 3]
        beside = tip[:, :2] - (np.where(slides, q, 0.0).sum(axis=1)[:, None] * arm.commanded[0].axis[:2])
        good = (tip[:, 2] > 0.1 * reach) & (np.hypot(*beside.T) > 0.25 * reach)
        good &= ((q > low) & (q < high)).all(axis=1)
        chosen += list(q[good])
    return np.array(chosen[:count])


# --------------------------------------------------------------------------------------------------------------- causes


def _build(name: str, place: Place, shape: int, weights: Array, distort: Apply | None) -> Apply:
    """What a known effect does at a place: its plain columns in some proportion, and what distorts them."""

    def apply(true: TrueRobot, size: float) -> None:
        if name not in REPLACED:
            columns = EFFECTS[name].columns(true.world, place)
            for column, weight in zip(columns[shape], weights, strict=True):
                column(true, size * weight)
        if distort is not None:
            distort(true, size)

    return apply


def _draw_cause(rng: Rng, world: World, scale: _Scale, name: str) -> Cause | None:
    """Draw a cause and its size; None where its range of sizes leaves it hidden."""
    if name == "unknown":
        note, apply, (least, most) = UNKNOWN[int(rng.integers(len(UNKNOWN)))](rng, world)
        cause = Cause("unknown", (None, None), 0.0, apply, note=note)
    else:
        effect = EFFECTS[name]
        places = list(effect.places(world))
        if not places:
            return None
        place = places[int(rng.integers(len(places)))]
        shapes = effect.columns(world, place)
        shape = int(rng.integers(len(shapes)))
        weights = rng.normal(size=len(shapes[shape])) if len(shapes[shape]) > 1 else np.ones(1)
        distort, params = (None, {}) if effect.distort is None else effect.distort(rng, world, place)
        weights /= np.linalg.norm(weights)
        params |= {"shape": shape, "weights": weights.round(4).tolist()}
        apply = _build(name, place, shape, weights, distort)
        (least, most) = effect.range
        cause = Cause(name, place, 0.0, apply, effect.unit, params=params)
    size, wanted = float(np.sqrt(least * most)), float(np.exp(rng.uniform(*np.log(SEEN))))
    sign = 1.0 if name == "unknown" or EFFECTS[name].grows else float(rng.choice([-1.0, 1.0]))
    most = 0.6 if name == "joint_stiffness" and sign < 0 else most  # a compliance stays positive
    for _ in range(2):
        seen = float(np.linalg.norm(scale.whiten(observe(world, [(apply, sign * size)])[0])))
        size = float(np.clip(size * wanted / max(seen, 1e-9), least, most))
    found = float(np.linalg.norm(scale.whiten(observe(world, [(apply, sign * size)])[0])))
    return replace(cause, size=sign * size) if found > 1.05 * VISIBLE else None


def _draw_everyday(rng: Rng, world: World, register: bool) -> list[Cause]:
    """Draw small errors of every joint, and of the frames where they count as known."""
    level, drawn = float(rng.uniform(0.3, 1.2)), []
    names = ["joint_offset", "link_geometry", *(["base_frame", "tool_frame"] if not register else [])]
    gears = set(rng.choice(world.turning, 3, replace=False).tolist())
    for name in [*names, "backlash", "transmission_error"]:
        for place in EFFECTS[name].places(world):
            if name in ("backlash", "transmission_error") and world.names.index(str(place[0])) not in gears:
                continue
            if name == "link_geometry" and rng.random() < 0.5:
                continue
            shapes = EFFECTS[name].columns(world, place)
            shape = int(rng.integers(len(shapes)))
            kind = str(place[1])[0] if name == "link_geometry" else name
            sd = level * EVERYDAY.get(kind, 5e-5) * (1.0 if name in ("base_frame", "tool_frame") else 1.0 / world.reach)
            sd = level * EVERYDAY["t"] if kind == "t" else sd
            for k in range(len(shapes[shape])):
                apply = _build_plain(name, place, shape, k)
                drawn.append(Cause(name, place, sd * float(rng.normal()), apply, params={"sd": sd}))
    return drawn


def _build_plain(name: str, place: Place, shape: int, k: int) -> Apply:
    return lambda true, size: EFFECTS[name].columns(true.world, place)[shape][k](true, size)


# --------------------------------------------------------------------------------------------------------------- labels


class _Scale:
    """The space in which a motion's length counts standard deviations of noise, scatter and everyday errors.

    Unknown frames are projected out.
    """

    def __init__(self, world: World, register: bool, sigma: float, scatter: Array, everyday: Sequence[Cause]) -> None:
        size = 3 * world.n
        covariance = sigma**2 * np.eye(size)
        moves = np.swapaxes(world.frames[1], 0, 1)[:3] * scatter  # (3, n, count)
        for k in range(world.count):
            column = np.zeros((world.n, 3, world.rows.visit[-1] + 1))
            column[np.arange(world.n), :, world.rows.visit] = moves[:, :, k].T * world.rows.static[:, None]
            flat = column.reshape(size, -1)
            covariance += flat @ flat.T
        if everyday:
            errors = [observe(world, [(e.apply, (e.params or {})["sd"])])[0][:, :3].ravel() for e in everyday]
            covariance += np.stack(errors, 1) @ np.stack(errors)
        self.root = cholesky(covariance, lower=True)
        self.frames = np.zeros((size, 0))
        if register:
            position, axes = world.pose
            arm = [np.cross(e, position) for e in np.eye(3)]
            free = [*(np.tile(e, (world.n, 1)) for e in np.eye(3)), *arm, *(axes[:, :, i] for i in range(3))]
            columns = solve_triangular(self.root, np.stack([f.ravel() for f in free], 1), lower=True)
            self.frames = np.linalg.qr(columns)[0]

    def whiten(self, gap: Array) -> Array:
        """A gap of shape (n, 6) in this space. Shape (rows,). [standard deviations]"""
        y = solve_triangular(self.root, gap[:, :3].ravel(), lower=True)
        return np.asarray(y - self.frames @ (self.frames.T @ y))


def _list_rivals(world: World, scale: _Scale) -> Iterator[tuple[str, Place, Array]]:
    """List whitened columns of every effect, place and shape of the list that the campaign can show."""
    for name, effect in EFFECTS.items():
        if effect.needs == "no gravity" and world.arm.gravity is not None:
            continue
        if effect.needs == "path" and world.rows.static.all():
            continue
        if effect.needs == "known frames" and scale.frames.shape[1]:
            continue
        small = 0.01 * effect.range[0] if name not in ("gravity_sag", "payload") else effect.range[0]
        for place in effect.places(world):
            for shape in effect.columns(world, place):
                columns = [scale.whiten(observe(world, [(column, small)])[0]) for column in shape]
                yield name, place, np.stack(columns, 1)


def _label_causes(world: World, scale: _Scale, causes: Sequence[Cause], everyday: Sequence[Cause]) -> list[dict] | None:
    """Label every cause; None if the case asks for what nobody could say."""
    if not causes:
        return []
    every = [(c.apply, c.size) for c in (*causes, *everyday)]
    whole, labels = observe(world, every)[0], []
    rivals = list(_list_rivals(world, scale))
    for i, cause in enumerate(causes):
        part = whole - observe(world, [*every[:i], *every[i + 1 :]])[0]
        y, near = scale.whiten(part), []
        visible = float(np.linalg.norm(y))
        if visible < VISIBLE:
            return None
        best: dict[tuple, float] = {}
        for name, place, columns in rivals:
            basis = np.linalg.qr(columns)[0][:, np.abs(np.linalg.qr(columns)[1].diagonal()) > 1e-9]
            size = float(columns[:, 0] @ y) if columns.shape[1] == 1 else 0.0
            if EFFECTS[name].grows and size < 0:
                continue
            left = float(np.linalg.norm(y - basis @ (basis.T @ y)))
            best[name, *place] = min(left, best.get((name, *place), np.inf))
        for key, left in sorted(best.items(), key=lambda pair: pair[1]):
            if key != cause.key:
                r2 = 1.0 - (left / visible) ** 2
                near.append(dict(zip(("effect", "joint", "axis"), key, strict=True))
                            | {"distance": round(left, 2), "r2": round(r2, 4)})  # fmt: skip
        accepted = [r for r in near if r["distance"] < ACCEPTED_DISTANCE or r["r2"] > ACCEPTED_R2]
        if cause.effect == "unknown" and (near[0]["distance"] < UNLIKE_DISTANCE or near[0]["r2"] > UNLIKE_R2):
            return None
        rms = 1e3 * float(np.sqrt((part[:, :3] ** 2).sum(1).mean()))
        labels.append({
            "effect": cause.effect, "joint": cause.place[0], "axis": cause.place[1], "size": cause.size,
            "unit": cause.unit, "params": dict(cause.params or {}), "note": cause.note,
            "in_vocabulary": cause.effect != "unknown", "required": True, "visible": round(visible, 2),
            "gap_rms_mm": rms, "acceptable": accepted, "nearest_rivals": near[:5],
        })  # fmt: skip
    return labels
