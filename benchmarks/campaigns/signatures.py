"""Which other effects could produce the same deviation: the geometry of signature spaces.

The signature of an effect is what the simulated readings do when its parameters leave zero, by finite differences
around the nominal robot. An alternative whose signatures span nearly all of a true effect's deviation cannot be told
from it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.campaigns.description import Array, is_own_axis
from benchmarks.campaigns.effects import Effect, apply_effect, lagged, path_runs, play
from benchmarks.campaigns.simulate import Reading, Rows, Scenario, predict_rows, simulate_rows

R2_SAME = 0.98
ROWS = 320
ENERGY_SAME = 12.0


@dataclass(frozen=True)
class Signature:
    """What an effect can do to the readings, to first order.

    Args:
        effect: Name in the vocabulary.
        joint: Joint, or None.
        axis: Axis, or None.
        columns: Whitened deviation for every parameter. Shape (n_values, n_parameters).
    """

    effect: str
    joint: str | None
    axis: str | None
    columns: Array


@dataclass(frozen=True)
class Observer:
    """Readings of a campaign's chosen rows, divided by their standard deviation.

    Args:
        nominal: The nominal robot.
        rows: The plan.
        select: Chosen rows.
        sigma: Standard deviation of a position coordinate. [m]
        sigma_rotation: Standard deviation of an orientation coordinate, or None if it is not measured. [rad]
    """

    nominal: Scenario
    rows: Rows
    select: np.ndarray
    sigma: float
    sigma_rotation: float | None

    def deviation(self, truth: Scenario) -> Array:
        """Return truth minus what the nominal robot predicts from the reported wrench. Shape (n_values,)."""
        real = simulate_rows(truth, self.rows, self.select)
        model = self.expected
        if truth.sensor:
            model = predict_rows(self.nominal, self.rows, real.wrench, self.select)
        return self.whiten(real, model)

    @cached_property
    def expected(self) -> Reading:
        """What the nominal robot does on the chosen rows."""
        return simulate_rows(self.nominal, self.rows, self.select)

    def whiten(self, real: Reading, model: Reading) -> Array:
        """Return the difference of two readings over the standard deviations. Shape (n_values,)."""
        moved = (real.position - model.position) / self.sigma
        if self.sigma_rotation is None:
            return np.asarray(moved.ravel())
        turned = Rotation.from_matrix(real.rotation @ model.rotation.transpose(0, 2, 1)).as_rotvec()
        return np.concatenate([moved.ravel(), turned.ravel() / self.sigma_rotation])

    def chosen(self, real: Reading, model: Reading) -> Array:
        """Return the whitened difference on the chosen rows of readings of all rows. Shape (n_values,)."""
        k = self.select
        some = [
            Reading(r.position[k], r.rotation[k], r.wrench[k], r.link[k], r.load[k], r.theta[k]) for r in (real, model)
        ]
        return self.whiten(some[0], some[1])

    def slope(self, perturb: Callable[[Scenario], Scenario], step: float) -> Array:
        """Return the deviation of a small perturbation per unit of its size. Shape (n_values,)."""
        return self.deviation(perturb(self.nominal)) / step

    def times(self, column: Array, factor: Array) -> Array:
        """Multiply a signature by a factor for every row. Shapes (n_values,), (n_rows,)."""
        one = np.repeat(factor[self.select], 3)
        return column * (one if self.sigma_rotation is None else np.r_[one, one])


def observe(nominal: Scenario, rows: Rows, sigma: float, sigma_rotation: float | None, seed: int = 0) -> Observer:
    """Choose rows of a campaign, static ones and every eighth path sample, and return their observer."""
    chosen = np.flatnonzero(~rows.is_path | (np.arange(len(rows.q)) % 8 == 0))
    if len(chosen) > ROWS:
        chosen = np.sort(np.random.default_rng(seed).choice(chosen, ROWS, replace=False))
    return Observer(nominal, rows, chosen, sigma, sigma_rotation)


def list_signatures(watch: Observer, shift_times: list[float]) -> list[Signature]:
    """Return the signatures of the whole vocabulary.

    Args:
        watch: The campaign.
        shift_times: Times at which shifts are tried. [s]
    """
    found = [*_spring_signatures(watch), *_geometry_signatures(watch), *_sensor_signatures(watch)]
    found += _motion_signatures(watch)
    everywhere = next(s for s in found if s.effect == "base_frame").columns
    local = next(s for s in found if s.effect == "tool_frame").columns
    for t in shift_times:
        on = (watch.rows.time >= t - 1e-9).astype(float)
        for name, columns in (("frame_shift", everywhere), ("tool_shift", local)):
            masked = np.stack([watch.times(c, on) for c in columns.T], axis=1)
            found.append(Signature(name, None, None, masked))
    return found


def _spring_signatures(watch: Observer) -> Iterator[Signature]:
    nominal, description = watch.nominal, watch.nominal.description

    def of(effect: Effect) -> Array:
        return watch.slope(partial(apply_effect, effect), effect.size)[:, None]

    for joint in description.joint_names:
        own = nominal.own_springs(joint)
        if own:
            first = of(Effect("joint_stiffness", joint, size=1e-3))
            yield Signature("joint_stiffness", joint, None, first)
            load = simulate_rows(nominal, watch.rows, watch.select).load[:, own[0]]
            reference = float(np.sqrt(np.mean(load**2))) + 1e-9
            shapes = ({"shape": "softening"}, {"shape": "zone", "zone_Nm": 0.3 * reference})
            bends = [
                of(Effect("stiffness_nonlinearity", joint, size=1e-3, params={"reference_Nm": 3 * reference, **p}))
                for p in shapes
            ]
            yield Signature("stiffness_nonlinearity", joint, None, np.hstack(bends))
            if joint in [j for j in description.joint_names if j != "rail"][1:3]:
                yield Signature("gravity_compensator", joint, None, _compensator(watch, joint, own[0]))
        for axis in ("rx", "ry", "rz", "tx", "ty", "tz"):
            spring = Effect("link_compliance", joint, axis, 1e-10)
            added = apply_effect(spring, nominal)
            if is_own_axis(description, added.springs[-1]):
                continue
            yield Signature("link_compliance", joint, axis, of(spring))
    for axis in ("rx", "ry", "rz"):
        yield Signature("base_compliance", None, axis, of(Effect("base_compliance", None, axis, 1e-10)))
    if description.gravity is None:
        yield Signature("gravity_sag", None, None, of(Effect("gravity_sag", size=1e-2)))
    else:
        columns = [of(Effect("payload", size=1.0, params={"mass_kg": 0.1, "centre_shift_m": [0.0, 0.0, 0.0]}))]
        for k in range(3):
            shift = [0.01 * (k == i) for i in range(3)]
            columns.append(of(Effect("payload", size=1.0, params={"mass_kg": 0.0, "centre_shift_m": shift})))
        yield Signature("payload", None, None, np.hstack(columns))


def _compensator(watch: Observer, joint: str, k: int) -> Array:
    j = watch.nominal.description.joint_names.index(joint)

    def with_torque(wave: Callable[[Array], Array]) -> Callable[[Scenario], Scenario]:
        return lambda s: replace(s, torques=(*s.torques, (k, lambda rows: wave(rows.q[:, j]))))

    return np.stack([watch.slope(with_torque(np.cos), 1.0), watch.slope(with_torque(np.sin), 1.0)], axis=1)


def _geometry_signatures(watch: Observer) -> Iterator[Signature]:
    description = watch.nominal.description

    def moved(name: str, joint: str | None) -> Array:
        columns = []
        for k in range(6):
            direction = [float(k == i) for i in range(6)]
            effect = Effect(name, joint, size=1e-6, params={"direction": direction})
            columns.append(watch.slope(partial(apply_effect, effect), 1e-6))
        return np.stack(columns, axis=1)

    for joint in description.joint_names:
        columns = moved("link_geometry", joint)
        for k, axis in enumerate(("tx", "ty", "tz", "rx", "ry", "rz")):
            yield Signature("link_geometry", joint, axis, columns[:, [k]])
        segment = description.segments[description.index_of(joint)]
        if segment.kind == "revolute":
            own = watch.slope(partial(apply_effect, Effect("joint_offset", joint, size=1e-6)), 1e-6)
            flat = columns[:, 3:] - np.outer(own, own @ columns[:, 3:]) / (own @ own)
            u, size, _ = np.linalg.svd(flat, full_matrices=False)
            columns = np.hstack([columns[:, :3], u[:, :2] * size[:2]])
        yield Signature("link_geometry", joint, None, columns)
    yield Signature("base_frame", None, None, moved("base_frame", None))
    tool = moved("tool_frame", None)
    yield Signature("tool_frame", None, None, tool if watch.sigma_rotation is not None else tool[:, :3])
    weights = [1.0] * (len(description.joint_names) + 1)
    heat = Effect("thermal_drift", size=1e-6, params={"weights": weights})
    yield Signature("thermal_drift", None, None, watch.slope(partial(apply_effect, heat), 1e-6)[:, None])


def _sensor_signatures(watch: Observer) -> Iterator[Signature]:
    if not np.any(watch.rows.wrench):
        return
    for axes in ("sensor", "base"):
        columns = []
        for k in range(6):
            direction = [float(k == i) for i in range(6)]
            effect = Effect("wrench_bias", size=0.1, params={"direction": direction, "axes": axes})
            columns.append(watch.slope(partial(apply_effect, effect), 0.1))
        yield Signature("wrench_bias", None, None, np.stack(columns, axis=1))
    gain = Effect("wrench_scale", size=1e-3)
    yield Signature("wrench_scale", None, None, watch.slope(partial(apply_effect, gain), 1e-3)[:, None])


def _motion_signatures(watch: Observer) -> Iterator[Signature]:
    """Signatures that are the one of a joint's zero times something known for every row."""
    rows, names = watch.rows, watch.nominal.description.joint_names
    runs = path_runs(rows)
    everything = np.zeros(len(watch.select) * (3 if watch.sigma_rotation is None else 6))
    skew = everything.copy()
    for j, joint in enumerate(names):
        zero = watch.slope(partial(apply_effect, Effect("joint_offset", joint, size=1e-6)), 1e-6)
        yield Signature("joint_offset", joint, None, zero[:, None])
        q = rows.q[:, j]
        lost = [(play(q, 1e-4, start) - q) / 1e-4 for start in (-0.5, 0.5)]
        for move in lost:
            yield Signature("backlash", joint, None, watch.times(zero, move)[:, None])
        scale = (
            1.0
            if watch.nominal.description.segments[watch.nominal.description.index_of(joint)].kind == "revolute"
            else 60.0
        )
        for n in (1.0, 2.0):
            waves = [watch.times(zero, f(n * scale * q)) for f in (np.cos, np.sin)]
            yield Signature("transmission_error", joint, None, np.stack(waves, axis=1))
        others = [watch.times(zero, rows.q[:, k]) for k in range(len(names)) if k != j and k > 0]
        for column in others:
            yield Signature("joint_coupling", joint, None, column[:, None])
        if runs:
            behind, speed = np.zeros(len(q)), np.zeros(len(q))
            for k in runs:
                behind[k] = lagged(rows.time[k], q[k], 0.01) - q[k]
                speed[k] = np.gradient(q[k], rows.time[k])
            column = watch.times(zero, behind)
            yield Signature("tracking_lag", joint, None, column[:, None])
            everything += column
            skew += watch.times(zero, speed)
    if runs:
        yield Signature("tracking_lag", None, None, everything[:, None])
        yield Signature("time_skew", None, None, skew[:, None])


def orthonormal_basis(columns: Array) -> Array:
    """Return an orthonormal basis of what columns span, negligible directions left out. Shape (n_values, rank)."""
    norms = np.linalg.norm(columns, axis=0)
    usable = columns[:, norms > 1e-12 * max(1.0, float(norms.max(initial=0.0)))]
    if usable.shape[1] == 0:
        return np.zeros((len(columns), 0))
    basis, size, _ = np.linalg.svd(usable / np.linalg.norm(usable, axis=0), full_matrices=False)
    return np.asarray(basis[:, size > 1e-7 * size[0]])


def explained_share(deviation: Array, columns: Array) -> float:
    """Return the share of a deviation's energy that lies in the span of the columns."""
    energy = float(deviation @ deviation)
    if energy == 0.0:
        return 0.0
    part = orthonormal_basis(columns).T @ deviation
    return float(part @ part) / energy


def rank_rivals(
    effect: Effect, deviation: Array, position_values: int, signatures: list[Signature], share_registered: float
) -> list[dict[str, Any]]:
    """Rank the alternatives to an effect by how much of its deviation they can produce.

    The shares are those of what a registration (base and tool fitted) leaves, `r2`, and of the whole deviation,
    `r2_raw`. Where a registration leaves next to nothing of an effect, `r2` is the share of the whole.

    Args:
        effect: The true effect.
        deviation: Its whitened deviation. Shape (n_values,).
        position_values: How many of the values are positions (they come first).
        signatures: The vocabulary.
        share_registered: Share of the deviation's energy that a registration leaves.
    Returns:
        One entry an alternative, best first: effect, joint, axis, r2, r2_raw, r2_position, parameters.
    """
    frames = ("base_frame", "tool_frame")
    fitted = np.hstack([s.columns for s in signatures if s.effect in frames])
    basis = orthonormal_basis(fitted)
    use_registered = share_registered > 0.02 and effect.name not in frames
    left = deviation - basis @ (basis.T @ deviation)
    best: dict[tuple[str, str | None, str | None], dict[str, Any]] = {}
    for s in signatures:
        key = (s.effect, s.joint, s.axis)
        same_shift = s.effect == effect.name and effect.name in ("frame_shift", "tool_shift")
        if key == (effect.name, effect.joint, effect.axis) or same_shift:
            continue
        raw = explained_share(deviation, s.columns)
        if use_registered and s.effect not in frames:
            # slow effects stay in the comparison: a signature that registration eats up explains nothing of the rest
            columns = s.columns - basis @ (basis.T @ s.columns)
            kept = np.linalg.norm(columns, axis=0) > 1e-4 * np.linalg.norm(s.columns, axis=0)
            r2 = explained_share(left, columns[:, kept])
        else:
            r2 = 0.0 if use_registered else raw
        if key in best and best[key]["r2"] >= r2:
            continue
        best[key] = {
            "effect": s.effect,
            "joint": s.joint,
            "axis": s.axis,
            "r2": round(r2, 5),
            "r2_raw": round(raw, 5),
            "r2_position": round(explained_share(deviation[:position_values], s.columns[:position_values]), 5),
            "parameters": int(s.columns.shape[1]),
        }
    return sorted(best.values(), key=lambda r: (-r["r2"], r["parameters"]))


def registered_share(deviation: Array, signatures: list[Signature]) -> float:
    """Return the share of a deviation's energy that fitting base and tool frames leaves."""
    fitted = np.hstack([s.columns for s in signatures if s.effect in ("base_frame", "tool_frame")])
    return 1.0 - explained_share(deviation, fitted)


def best_pair_share(deviation: Array, signatures: list[Signature]) -> float:
    """Return the share of a registered deviation that two effects, found one after the other, explain."""
    basis = orthonormal_basis(np.hstack([s.columns for s in signatures if s.effect in ("base_frame", "tool_frame")]))
    left = deviation - basis @ (basis.T @ deviation)
    energy = float(left @ left)
    for _ in range(2):
        best, part = 0.0, np.zeros_like(left)
        for s in signatures:
            columns = s.columns - basis @ (basis.T @ s.columns)
            kept = np.linalg.norm(columns, axis=0) > 1e-4 * np.linalg.norm(s.columns, axis=0)
            span = orthonormal_basis(columns[:, kept])
            share = float(np.sum((span.T @ left) ** 2))
            if share > best:
                best, part = share, span
        if best == 0.0:
            break
        basis = np.hstack([basis, part])
        left = left - part @ (part.T @ left)
    return 1.0 - float(left @ left) / energy


def acceptable_rivals(rivals: list[dict[str, Any]], energy: float) -> list[dict[str, Any]]:
    """Return the alternatives that the campaign cannot tell from the true effect.

    Args:
        rivals: What `rank_rivals` returned.
        energy: Sum of squares of the whitened deviation over all rows of the campaign.
    """
    same = []
    for r in rivals:
        if r["r2"] >= R2_SAME:
            same.append({**r, "why": "R2"})
        elif (1.0 - r["r2_raw"]) * energy < ENERGY_SAME:
            same.append({**r, "why": "below noise"})
    return same
