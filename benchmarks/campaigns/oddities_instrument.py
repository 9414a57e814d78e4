"""Causes in instrument, target and log that have no name in the vocabulary, as metrologists meet them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.campaigns.description import Array
from benchmarks.campaigns.effects import Effect
from benchmarks.campaigns.oddities_robot import ROBOT_ODDITIES
from benchmarks.campaigns.oddity import Generator, Oddity, Place, Setting
from benchmarks.campaigns.simulate import Rows, Scenario, rotation_step


def _sight(e: Effect, p: Array) -> tuple[Array, Array, Array]:
    """Return lines of sight, distances and horizontal unit vectors across them. Shapes (n, 3), (n,), (n, 3)."""
    line = p - np.array(e.params["tracker_m"])
    distance = np.linalg.norm(line, axis=1)
    across = np.stack([-line[:, 1], line[:, 0], np.zeros(len(p))], axis=1)
    return line, distance, across / np.linalg.norm(across, axis=1)[:, None]


def _seen(e: Effect, s: Scenario, error: object, *, first: bool = False) -> Scenario:
    """Add an error of the measured position, a function of rows, position and rotation."""

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        return p + e.size * error(rows, p, r), r  # type: ignore[operator]

    return replace(s, instrument=(see, *s.instrument) if first else (*s.instrument, see))


def _nonsquare(e: Effect, s: Scenario) -> Scenario:
    """Standing and tilting axis of the tracker are not square: azimuth errs with the tangent of the elevation."""

    def error(rows: Rows, p: Array, r: Array) -> Array:
        line, distance, across = _sight(e, p)
        level = np.hypot(line[:, 0], line[:, 1])
        # an azimuth error of tan(elevation) moves the point by level * tan(elevation) = height
        return np.asarray(across * (line[:, 2] + 0.15 * distance - 0.15 * level)[:, None])

    return _seen(e, s, error)


def _scale(e: Effect, s: Scenario) -> Scenario:
    return _seen(e, s, lambda rows, p, r: _sight(e, p)[0])


def _range_cycle(e: Effect, s: Scenario) -> Scenario:
    """The distance meter has a cyclic error along the beam."""

    def error(rows: Rows, p: Array, r: Array) -> Array:
        line, distance, _ = _sight(e, p)
        wave = np.sin(2.0 * np.pi * distance / e.params["length_m"] + e.params["phase"])
        return np.asarray(line / distance[:, None] * wave[:, None])

    return _seen(e, s, error)


def _warm_column(e: Effect, s: Scenario) -> Scenario:
    """Warm air rises from the control cabinet: beams that pass near it are bent away from it."""

    def error(rows: Rows, p: Array, r: Array) -> Array:
        line, _, across = _sight(e, p)
        start = np.array(e.params["tracker_m"])[:2]
        level = line[:, :2] / np.linalg.norm(line[:, :2], axis=1)[:, None]
        to = np.array(e.params["column_m"]) - start
        along, aside = level @ to, level[:, 0] * to[1] - level[:, 1] * to[0]
        behind = np.maximum(np.linalg.norm(line[:, :2], axis=1) - along, 0.0)
        bend = -aside / e.params["wide_m"] / (1.0 + (aside / e.params["wide_m"]) ** 2) ** 2
        return np.asarray(across * (bend * behind)[:, None] + np.array([0, 0, 0.5]) * (np.abs(bend) * behind)[:, None])

    return _seen(e, s, error)


def _stand(e: Effect, s: Scenario) -> Scenario:
    """The tracker's stand turns to and fro with the hall's temperature, and sinks on one leg."""
    station = np.array(e.params["tracker_m"])

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        time = rows.time + (e.params["period_s"] * 3.3 if rows.later else 0.0)
        sway = e.size * (
            np.sin(2 * np.pi * time / e.params["period_s"] + 0.6) + 0.5 * np.cos(9.1 * time / e.params["period_s"])
        )
        turn = np.array([rotation_step(v * np.array(e.params["about"])) for v in sway])
        return np.einsum("nij,nj->ni", turn, p - station) + station, turn @ r

    return replace(s, instrument=(*s.instrument, see))


def _nest(e: Effect, s: Scenario) -> Scenario:
    """The target has play in its nest: it lies at the lower side, wherever that is."""

    def error(rows: Rows, p: Array, r: Array) -> Array:
        down = -r[:, 2, :]  # straight down, in TCP axes
        rest = np.sign(down) * np.minimum(np.abs(down) / 0.2, 1.0) * np.array(e.params["play"])
        return np.asarray(np.einsum("nij,nj->ni", r, rest))

    return _seen(e, s, error, first=True)


def _incidence(e: Effect, s: Scenario) -> Scenario:
    """The retroreflector's vertex is off centre and its glass lengthens the path where the beam comes in askew."""

    def error(rows: Rows, p: Array, r: Array) -> Array:
        line, distance, across = _sight(e, p)
        beam = line / distance[:, None]
        askew = 1.0 - np.abs(np.einsum("ni,nij,j->n", beam, r, np.array(e.params["facing"])))
        return np.asarray(beam * askew[:, None] ** 1.5 + 0.4 * across * (askew**3)[:, None])

    return _seen(e, s, error)


def _two_targets(e: Effect, s: Scenario) -> Scenario:
    """Two reflectors are used in turns, as the line of sight asks, and the log does not say which."""
    away = np.array(e.params["apart"])

    def error(rows: Rows, p: Array, r: Array) -> Array:
        line, distance, _ = _sight(e, p)
        facing = np.einsum("ni,nij,j->n", line / distance[:, None], r, np.array(e.params["facing"]))
        other = (facing > 0.0).astype(float)[:, None]
        return np.asarray(other * np.einsum("nij,j->ni", r, away))

    return _seen(e, s, error, first=True)


def _rounded(e: Effect, s: Scenario) -> Scenario:
    """The log's angles are rounded: the robot stood somewhere within the last digit."""

    def change(rows: Rows, q: Array) -> Array:
        visit = rows.visit
        rng = np.random.default_rng(e.params["seed"] + int(rows.later))
        lost = rng.uniform(-0.5, 0.5, (int(visit[-1]) + 1, q.shape[1]))[visit]
        return np.asarray(q + e.size * lost * (np.abs(rows.q) > 1e-9))

    return replace(s, readings=(*s.readings, change))


def _wrong_load(e: Effect, s: Scenario) -> Scenario:
    """Some loaded rows carry the label of another weight: the robot feels more than the log says, in part of a run."""

    def load(rows: Rows, p: Array, r: Array) -> Array:
        loaded = np.flatnonzero(np.any(rows.wrench != 0.0, axis=1))
        extra = np.zeros((len(p), 6))
        part = loaded[: max(3, int(e.params["share"] * len(loaded)))]
        extra[part] = e.size * rows.wrench[part]
        extra[part, 3:] = -extra[part, 3:]  # and hangs on the other side
        return extra

    return replace(s, loads=(*s.loads, load))


def _crane(e: Effect, s: Scenario) -> Scenario:
    """A crane or a press next door leans on the floor now and then: the base tilts and comes back."""

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        rng = np.random.default_rng(e.params["seed"] + int(rows.later))
        period = (rows.time[-1] + 1.0) / 9.0
        there = rng.random(11) < 0.45
        on = there[np.minimum((rows.time / period).astype(int), 10)]
        turn = np.array([rotation_step(e.size * v * np.array(e.params["about"])) for v in on.astype(float)])
        return np.einsum("nij,nj->ni", turn, p), turn @ r

    return replace(s, instrument=(*s.instrument, see))


def _lazy_filter(e: Effect, s: Scenario) -> Scenario:
    """The instrument averages too long: a reading still holds a share of the position before it."""

    def error(rows: Rows, p: Array, r: Array) -> Array:
        step = np.diff(p, axis=0, prepend=p[:1])
        length = np.linalg.norm(step, axis=1)
        new_run = np.r_[True, rows.run[1:] != rows.run[:-1]]
        return np.asarray(-step * np.where(new_run, 0.0, 1.0 / (0.2 + length))[:, None])

    return _seen(e, s, error)


def _at(rng: Generator, s: Setting) -> dict[str, object]:
    return {"tracker_m": list(s.visits.tracker)}


def _draw_plain(rng: Generator, s: Setting) -> Place:
    return None, 1e-4, _at(rng, s)


def _draw_cycle(rng: Generator, s: Setting) -> Place:
    params = {**_at(rng, s), "length_m": float(rng.uniform(0.25, 0.9)), "phase": float(rng.uniform(0, 6))}
    return None, 1e-4, params


def _draw_column(rng: Generator, s: Setting) -> Place:
    station = np.array(s.visits.tracker[:2])
    column = station * float(rng.uniform(0.3, 0.6)) + rng.normal(size=2) * 0.12 * s.machine.reach
    return None, 1e-4, {**_at(rng, s), "column_m": column.tolist(), "wide_m": 0.12 * s.machine.reach}


def _draw_stand(rng: Generator, s: Setting) -> Place:
    about = rng.normal(size=3)
    period = float(rng.uniform(0.35, 0.8)) * float(s.rows.time[-1])
    return None, 1e-4, {**_at(rng, s), "about": (about / np.linalg.norm(about)).tolist(), "period_s": period}


def _draw_nest(rng: Generator, s: Setting) -> Place:
    return None, 1e-4, {"play": [float(v) for v in rng.uniform(0.2, 1.0, 3)]}


def _draw_facing(rng: Generator, s: Setting) -> Place:
    facing, apart = rng.normal(size=3), rng.normal(size=3)
    params = {"facing": (facing / np.linalg.norm(facing)).tolist(), "apart": (apart / np.linalg.norm(apart)).tolist()}
    return None, 1e-4, {**_at(rng, s), **params}


def _draw_seed(rng: Generator, s: Setting) -> Place:
    about = rng.normal(size=3)
    params = {"seed": int(rng.integers(2**31)), "about": (about / np.linalg.norm(about)).tolist()}
    return None, 1e-4, params


def _draw_share(rng: Generator, s: Setting) -> Place:
    return None, 0.1, {"share": float(rng.uniform(0.3, 0.6))}


INSTRUMENT_ODDITIES: dict[str, Oddity] = {
    "axis_nonsquare": Oddity("the tracker's axes are not square to each other (rad)", _draw_plain, _nonsquare),
    "tracker_scale": Oddity("the tracker's distances are too long by a share (1)", _draw_plain, _scale),
    "range_cycle": Oddity("the distance meter errs periodically along the beam (m)", _draw_cycle, _range_cycle),
    "warm_column": Oddity("a column of warm air bends beams that pass near it (rad)", _draw_column, _warm_column),
    "swaying_stand": Oddity("the tracker's stand turns to and fro (rad)", _draw_stand, _stand),
    "nest_play": Oddity("the target has play in its nest and lies at the lower side (m)", _draw_nest, _nest),
    "skew_glass": Oddity("the target's glass lengthens beams that come in askew (m)", _draw_facing, _incidence),
    "two_targets": Oddity(
        "two targets are used by turns and the log does not say which (m)", _draw_facing, _two_targets
    ),
    "rounded_angles": Oddity("the log's angles are rounded (rad, last digit)", _draw_seed, _rounded),
    "wrong_weight": Oddity(
        "part of the loaded rows carry another weight's label (1)", _draw_share, _wrong_load, "weights"
    ),
    "crane": Oddity("a crane leans on the floor now and then (rad)", _draw_seed, _crane),
    "lazy_filter": Oddity("a reading holds a share of the position before it (m)", _draw_plain, _lazy_filter),
}

ODDITIES: dict[str, Oddity] = {**ROBOT_ODDITIES, **INSTRUMENT_ODDITIES}
