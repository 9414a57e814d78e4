"""The 21 effects of the format's list: places, plain columns, and the size and form in which a true robot has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.outsider.world import BASE, Apply, Array, Rng, TrueRobot, World, unit
from benchmarks.simulated_robot.robot import UNIT, Mass, Spring

Place = tuple[str | None, str | None]
#: A place's plain formula: columns whose sizes are free, one list for each shape that is tried (a frequency, a row).
Columns = list[list[Apply]]
WAVES = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 17.0, 29.0, 40.0, 57.3, 81.0, 101.0)
#: Shares of a campaign at which a shift is tried.
MOMENTS = tuple(np.round(np.arange(0.1, 0.95, 0.05), 3))


@dataclass(frozen=True)
class Effect:
    """An effect of the list."""

    share: float  #: How often it is drawn.
    unit: str  #: Unit of its size.
    range: tuple[float, float]  #: Least and largest size of a drawn cause.
    places: Callable[[World], Iterable[Place]]  #: Places that a campaign can show.
    columns: Callable[[World, Place], Columns]  #: Its plain formula at a place.
    #: Draws what a true robot has beside the plain formula: an `Apply` that takes the size, or None.
    distort: Callable[[Rng, World, Place], tuple[Apply, dict[str, Any]]] | None = None
    grows: bool = False  #: Whether a negative size is impossible.
    needs: str = ""  #: "path", "sensor", "known frames", "no gravity" or "".


def index_of(world: World, place: Place) -> int:
    """Column of a place's joint."""
    return world.names.index(str(place[0]))


def _joint(effect: Callable[[World, int], Iterable[Callable[[TrueRobot], Array]]]) -> Callable[[World, Place], Columns]:
    """Columns of an effect that moves a joint beside its command: functions of the true robot, each a shape."""

    def columns(world: World, place: Place) -> Columns:
        k = index_of(world, place)

        def by(value: Callable[[TrueRobot], Array]) -> Apply:
            return lambda true, size: true.turn_joint(k, size * value(true))

        return [[by(value)] for value in effect(world, k)]

    return columns


def follow_play(true: TrueRobot, k: int) -> Array:
    """Side of the lost motion on which a link is, -0.5 to 0.5, by the direction of the last move. Shape (n,)."""
    return -0.5 * true.world.rows.direction[:, k]


def _rigid(world: World, since: Array) -> list[Apply]:
    """Three shifts and three turns of the base about its origin, from some rows on."""

    def shift(axis: Array) -> Apply:
        def apply(true: TrueRobot, size: float) -> None:
            true.shift += size * since[:, None] * axis

        return apply

    def turn(axis: Array) -> Apply:
        def apply(true: TrueRobot, size: float) -> None:
            true.turn += size / world.reach * since[:, None] * axis

        return apply

    return [shift(a) for a in np.eye(3)] + [turn(a) for a in np.eye(3)]


def _tip(since: Array) -> list[Apply]:
    """Three shifts of the measured point in the axes of the tip, from some rows on."""

    def shift(axis: Array) -> Apply:
        def apply(true: TrueRobot, size: float) -> None:
            true.tip += size * since[:, None] * axis

        return apply

    return [shift(a) for a in np.eye(3)]


def _add_spring(name: str, axis: Array) -> Apply:
    def apply(true: TrueRobot, size: float) -> None:
        springs = {**true.arm.springs, name: [*true.arm.springs.get(name, []), Spring(axis, False, size, np.zeros(3))]}
        true.arm = replace(true.arm, springs=springs)

    return apply


def _geometry(world: World, place: Place) -> Columns:
    name, axis = str(place[0]), str(place[1])
    v = UNIT[axis[1]]
    if axis[0] == "t":
        return [[lambda true, size: true.move_joint(name, np.zeros(3), size * v)]]
    return [[lambda true, size: true.move_joint(name, size * v, np.zeros(3))]]


def _payload(world: World, place: Place) -> Columns:
    link = world.arm.joints[-1].parent

    def weigh(centre: Array) -> Apply:
        def apply(true: TrueRobot, size: float) -> None:
            added = Mass(link, size, centre, np.zeros((3, 3)))
            true.arm = replace(true.arm, masses=(*true.arm.masses, added))

        return apply

    return [[weigh(c) for c in (np.zeros(3), *(0.2 * np.eye(3)))]]


def _hung_mass(rng: Rng, world: World, place: Place) -> tuple[Apply, dict[str, Any]]:
    link, centre = world.arm.joints[-1].parent, 0.05 * world.reach * rng.normal(size=3)

    def apply(true: TrueRobot, size: float) -> None:
        added = Mass(link, size, centre, np.zeros((3, 3)))
        true.arm = replace(true.arm, masses=(*true.arm.masses, added))

    return apply, {"centre_m": centre.round(4).tolist()}


def _bias(world: World, place: Place) -> Columns:
    def add(k: int, sensor: bool) -> Apply:
        def apply(true: TrueRobot, size: float) -> None:
            axis = world.pose[1][:, :, k % 3] if sensor else np.eye(3)[k % 3]
            true.logged[:, 3 * (k // 3) : 3 * (k // 3) + 3] += size * (1.0 if k < 3 else 0.1) * axis

        return apply

    return [[add(k, sensor) for k in range(6)] for sensor in (False, True)]


def _gain(world: World, place: Place) -> Columns:
    def apply(true: TrueRobot, size: float) -> None:
        true.logged += size * world.rows.wrench

    return [[apply]]


def _sag(world: World, place: Place) -> Columns:
    def apply(true: TrueRobot, size: float) -> None:
        true.arm = replace(true.arm, gravity=np.array([0.0, 0.0, -9.81 * size]))

    return [[apply]]


def _heat(world: World, place: Place) -> Columns:
    frames, _ = world.frames
    growth = sum(
        np.einsum("nij,j->ni", frames[j.parent][:, :3, :3], j.pose[:3, 3])
        for j in world.arm.joints
        if j.parent in frames
    )

    def apply(true: TrueRobot, size: float) -> None:
        true.shift += size * world.rows.warmth[:, None] * growth

    return [[apply]]


def _late(sign: float) -> Callable[[World, Place], Columns]:
    def columns(world: World, place: Place) -> Columns:
        chosen = range(world.count) if place[0] is None else [index_of(world, place)]

        def apply(true: TrueRobot, size: float) -> None:
            for k in chosen:
                true.turn_joint(k, sign * size * world.rows.speed[:, k])

        return [[apply]]

    return columns


def _waves(world: World, place: Place) -> Columns:
    k = index_of(world, place)

    def wave(rate: float, phase: float) -> Apply:
        return lambda true, size: true.turn_joint(k, size * np.sin(rate * world.rows.q[:, k] + phase))

    return [[wave(rate, 0.0), wave(rate, np.pi / 2)] for rate in WAVES]


def _bend(form: str, zone: float) -> Callable[[Array], Array]:
    if form == "soft zone":
        return lambda x: 0.5 * np.tanh(x / zone)
    return lambda x: x * np.abs(x) * (-1.0 if form == "hardening" else 1.0)


def _nonlinear(world: World, k: int) -> Iterable[Callable[[TrueRobot], Array]]:
    scale = 0.3 * world.arm.commanded[k].effort  # of the largest torque: where a robot mostly works (assumed)
    for form, zone in (("hardening", 0.0), ("soft zone", 0.15)):
        bent = world.compliance(k) * scale * _bend(form, zone)(world.torque[:, k] / scale)
        yield lambda true, bent=bent: bent


# What a true robot has beside the plain formula: each takes the size and returns what it drew.


def _uneven_play(rng: Rng, world: World, place: Place) -> tuple[Apply, dict[str, Any]]:
    k, uneven, phase = index_of(world, place), float(rng.uniform(0, 0.35)), float(rng.uniform(0, 6.3))

    def apply(true: TrueRobot, size: float) -> None:
        true.turn_joint(k, size * uneven * np.sin(2 * true.world.rows.q[:, k] + phase) * follow_play(true, k))

    return apply, {"uneven": uneven}


def _harmonics(rng: Rng, world: World, place: Place) -> tuple[Apply, dict[str, Any]]:
    k, second, phase = index_of(world, place), float(rng.uniform(0.15, 0.5)), float(rng.uniform(0, 6.3))
    rate = float(rng.choice(WAVES))

    def apply(true: TrueRobot, size: float) -> None:
        angle = rate * true.world.rows.q[:, k] + phase
        true.turn_joint(k, size * (np.sin(angle) + second * np.sin(2 * angle)))

    return apply, {"per_rev": rate, "phase": phase, "second": second}


def _tilted_spring(rng: Rng, world: World, place: Place) -> tuple[Apply, dict[str, Any]]:
    axis = UNIT[str(place[1])[1]] + 0.08 * rng.normal(size=3)
    return _add_spring(place[0] or BASE, axis / np.linalg.norm(axis)), {"axis": axis.round(4).tolist()}


def _uneven_gain(rng: Rng, world: World, place: Place) -> tuple[Apply, dict[str, Any]]:
    uneven = 0.1 * rng.normal(size=6)

    def apply(true: TrueRobot, size: float) -> None:
        true.logged += size * uneven * true.world.rows.wrench

    return apply, {"channels": uneven.round(4).tolist()}


#: Effects whose true form replaces the plain formula instead of adding to it.
REPLACED = ("transmission_error", "payload", "link_compliance", "base_compliance")


def _each(of: Callable[[World], Iterable[int]]) -> Callable[[World], Iterable[Place]]:
    return lambda world: [(world.names[k], None) for k in of(world)]


def _only(world: World) -> Iterable[Place]:
    return [(None, None)]


def _links(world: World) -> Iterable[Place]:
    return [(name, kind + axis) for name in world.names[1:] for kind in "tr" for axis in "xyz"]


def _bends(world: World) -> Iterable[Place]:
    return [(world.names[k], "r" + axis) for k in world.turning[: max(3, world.count - 2)] for axis in world.across(k)]


def _soften(world: World, k: int) -> Iterable[Callable[[TrueRobot], Array]]:
    return [lambda true: world.compliance(k) * world.torque[:, k]]


def _pairs(world: World, k: int) -> Iterable[Callable[[TrueRobot], Array]]:
    return [lambda true, other=other: world.rows.q[:, other] for other in world.turning if other != k]


def _balance(world: World, k: int) -> Iterable[Callable[[TrueRobot], Array]]:
    return [
        lambda true, phase=phase: -world.compliance(k) * np.sin(world.rows.q[:, k] + phase)
        for phase in (-0.15, 0.0, 0.15)
    ]


def _leaning(world: World) -> list[int]:
    return [k for k in world.elastic if abs(world.arm.commanded[k].axis[1]) > 0.9][:2]


EFFECTS: dict[str, Effect] = {
    "joint_offset": Effect(12, "rad or m", (8e-5, 8e-3), _each(lambda w: range(w.count)),
                           _joint(lambda w, k: [lambda true: np.ones(w.n)])),
    "link_geometry": Effect(8, "rad or m", (1e-4, 5e-3), _links, _geometry),
    "joint_stiffness": Effect(12, "relative change of the compliance", (0.04, 1.6), _each(lambda w: w.elastic),
                              _joint(_soften)),
    "link_compliance": Effect(6, "rad/(N m)", (1e-9, 1e-4), _bends,
                              lambda w, p: [[_add_spring(str(p[0]), UNIT[str(p[1])[1]])]], _tilted_spring, True),
    "base_compliance": Effect(4, "rad/(N m)", (1e-9, 1e-4), lambda w: [(None, "rx"), (None, "ry")],
                              lambda w, p: [[_add_spring(BASE, UNIT[str(p[1])[1]])]], _tilted_spring, True),
    "stiffness_nonlinearity": Effect(4, "parts of the linear deflection", (0.15, 1.5), _each(lambda w: w.elastic),
                                     _joint(_nonlinear), None, True),
    "gravity_sag": Effect(4, "1", (1.0, 1.0), _only, _sag, None, True, "no gravity"),
    "payload": Effect(5, "kg", (0.1, 80.0), _only, _payload, _hung_mass, True),
    "gravity_compensator": Effect(3, "N m", (5.0, 1e4), _each(_leaning), _joint(_balance), None, True),
    "wrench_bias": Effect(3, "N", (2.0, 500.0), _only, _bias, None, False, "sensor"),
    "wrench_scale": Effect(3, "relative", (0.03, 0.5), _only, _gain, _uneven_gain, False, "sensor"),
    "backlash": Effect(12, "rad or m, full width", (6e-5, 2.5e-3), _each(lambda w: w.turning),
                       _joint(lambda w, k: [lambda true: follow_play(true, k)]), _uneven_play, True),
    "transmission_error": Effect(10, "rad", (5e-5, 2.5e-3), _each(lambda w: w.turning), _waves, _harmonics),
    "thermal_drift": Effect(4, "1/K", (4e-6, 4e-5), _only, _heat, None, True),
    "tracking_lag": Effect(3, "s", (1e-3, 0.08), lambda w: [(None, None), *((w.names[k], None) for k in w.turning[:4])],
                           _late(-1.0), None, True, "path"),
    "time_skew": Effect(2, "s", (1e-3, 0.08), _only, _late(1.0), None, False, "path"),
    "tool_frame": Effect(3, "m", (1e-4, 5e-3), _only, lambda w, p: [_tip(np.ones(w.n))], None, False, "known frames"),
    "base_frame": Effect(3, "m", (1e-4, 6e-3), _only, lambda w, p: [_rigid(w, np.ones(w.n))], None, False,
                         "known frames"),
    "frame_shift": Effect(3, "m", (1e-4, 8e-3), _only, lambda w, p: [_rigid(w, w.rows.since(m)) for m in MOMENTS]),
    "tool_shift": Effect(3, "m", (1e-4, 5e-3), _only, lambda w, p: [_tip(w.rows.since(m)) for m in MOMENTS]),
    "joint_coupling": Effect(2, "rad/rad", (6e-3, 0.05), _each(lambda w: w.turning[1:]), _joint(_pairs)),
}  # fmt: skip


# ---------------------------------------------------------------------------------- causes that the list does not name

Unknown = Callable[[Rng, World], tuple[str, Apply, tuple[float, float]]]


def _rounded_targets(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    coarse = rng.uniform(0.4, 1.0, world.count) * np.where(world.slides, 0.3, 1.0)

    def apply(true: TrueRobot, size: float) -> None:
        true.q += size * coarse * np.round(true.world.rows.q / (size * coarse)) - true.world.rows.q

    return "the controller rounds the target of every joint to a coarse grid (rad)", apply, (1e-4, 2.5e-3)


def _belt_teeth(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    k, rate, phase = int(rng.choice(world.elastic)), float(rng.uniform(9, 40)), float(rng.uniform(0, 6.3))
    top = float(np.abs(world.torque[:, k]).max())

    def apply(true: TrueRobot, size: float) -> None:
        q, load = true.world.rows.q[:, k], true.world.torque[:, k] / top
        true.turn_joint(k, size * load * (np.sin(rate * q + phase) + 0.5 * np.sin(2.5 * rate * q)))

    return f"belt teeth of {world.names[k]} climb in their grooves with the torque (rad)", apply, (3e-5, 8e-3)


def _stale_labels(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    share, spread = rng.uniform(0.15, 0.3), rng.uniform(0.5, 1.0, world.count) * np.where(world.slides, 0.3, 1.0)

    def apply(true: TrueRobot, size: float) -> None:
        rows, hand = true.world.rows, np.random.default_rng(true.world.rows.seed)
        stays = rows.visit[-1] + 1
        moves = (hand.random(stays) < share)[:, None] * hand.normal(size=(stays, world.count))
        true.q += size * spread * moves[rows.visit]

    return "some poses were touched up by hand and the log has their old joint values (rad)", apply, (3e-5, 8e-3)


def _crosstalk(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    k, source = int(world.turning[-1 - int(rng.integers(2))]), int(rng.choice(world.elastic[:3]))

    def apply(true: TrueRobot, size: float) -> None:
        true.turn_joint(k, size * true.world.torque[:, source])

    return f"the torque of {world.names[source]} twists {world.names[k]} (rad/(N m))", apply, (1e-9, 1e-3)


def _cardan(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    third, before, last = world.turning[-3:]
    phases = rng.uniform(0, 6.3, 2)

    def apply(true: TrueRobot, size: float) -> None:
        q = true.world.rows.q
        true.turn_joint(last, size * np.sin(2 * q[:, third] + phases[0]))
        true.turn_joint(before, 0.8 * size * np.sin(2 * q[:, third] + phases[1]) * np.cos(q[:, last]))

    return "universal joints in the shafts of the wrist run unevenly (rad)", apply, (1e-4, 8e-3)


def _zero_jump(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    k, other = (int(i) for i in rng.choice(world.turning[1:], 2, replace=False))
    share = float(rng.uniform(0.3, 0.7))

    def apply(true: TrueRobot, size: float) -> None:
        true.turn_joint(k, size * true.world.rows.since(share))
        true.turn_joint(other, -0.6 * size * true.world.rows.since(share))

    pair = f"{world.names[k]} and {world.names[other]}"
    return f"a power cut: {pair} come back with another zero (rad)", apply, (3e-5, 8e-3)


def _sun(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    beam, warming, bow = rng.uniform(0, 6.3), rng.uniform(1800, 5000), unit(rng)

    def apply(true: TrueRobot, size: float) -> None:
        at = true.world.pose[0]
        warm = np.maximum(0, np.cos(np.arctan2(at[:, 1], at[:, 0]) - beam))
        warm *= 1 - np.exp(-(true.world.rows.time + 3000.0 * true.world.rows.fresh) / warming)
        true.shift += size * warm[:, None] * bow * np.linalg.norm(at, axis=1, keepdims=True)

    return "the sun bows the arm while it is in the beam, more as the day goes on (rad)", apply, (3e-5, 8e-3)


def _warped_space(rng: Rng, world: World) -> tuple[str, Apply, tuple[float, float]]:
    rate, phase, size_of = (
        rng.normal(size=(4, 3)) / (0.35 * world.reach),
        rng.uniform(0, 6.3, 4),
        rng.normal(size=(4, 3)),
    )

    def apply(true: TrueRobot, size: float) -> None:
        true.seen.append(lambda at: size * np.sin(at @ rate.T + phase) @ size_of)

    return "a scale error of the instrument that varies over the hall (m)", apply, (2e-5, 5e-3)


UNKNOWN: tuple[Unknown, ...] = (
    _rounded_targets, _belt_teeth, _stale_labels, _crosstalk, _cardan, _zero_jump, _sun, _warped_space,
)  # fmt: skip
