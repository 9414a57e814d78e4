"""The effects of the diagnosis's vocabulary, written a second time for the simulated campaigns.

An effect has one size and a shape (`params`); `apply_effect` puts it into a scenario. Sizes are in SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.campaigns.description import Array, RobotDescription, Spring, rotation_from_rpy, rpy_from_rotation
from benchmarks.campaigns.simulate import Rows, Scenario, rotation_step


@dataclass(frozen=True)
class Effect:
    """One thing that is wrong with a robot or its instruments."""

    name: str  #: Name in the vocabulary, or of an effect outside it.
    joint: str | None = None  #: Joint it sits at, or None.
    axis: str | None = None  #: Axis it acts about or along, or None.
    size: float = 1.0  #: Its size, in `unit`.
    unit: str = ""  #: Unit of the size.
    params: dict[str, Any] = field(default_factory=dict)  #: Its shape.
    known: bool = True  #: Whether it stands in the vocabulary.

    def scaled(self, factor: float) -> Effect:
        """Return the effect with its size times a factor."""
        return replace(self, size=self.size * factor)


Apply = Callable[[Effect, Scenario], Scenario]


def apply_effect(effect: Effect, scenario: Scenario) -> Scenario:
    """Put an effect of the vocabulary into a scenario.

    Raises:
        KeyError: If the vocabulary has no such effect.
    """
    return APPLY[effect.name](effect, scenario)


def joint_index(description: RobotDescription, joint: str | None) -> int:
    """Return the number of an actuated joint, counted from 0 at the base."""
    return description.joint_names.index(str(joint))


# --- springs -----------------------------------------------------------------------------------------------------


def _joint_stiffness(e: Effect, s: Scenario) -> Scenario:
    compliance = s.compliance.copy()
    compliance[s.own_springs(str(e.joint))] *= 1.0 + e.size
    return replace(s, compliance=compliance)


def _link_compliance(e: Effect, s: Scenario) -> Scenario:
    return s.add_spring(Spring(str(e.joint), str(e.axis), e.size))


def _base_compliance(e: Effect, s: Scenario) -> Scenario:
    return s.add_spring(Spring(s.description.segments[0].joint, str(e.axis), e.size))


def _stiffness_nonlinearity(e: Effect, s: Scenario) -> Scenario:
    k = s.own_springs(str(e.joint))[0]
    c, reference, shape = s.compliance[k], e.params["reference_Nm"], e.params["shape"]
    if shape == "hardening":

        def bend(tau: Array) -> Array:
            # theta + size (theta / theta_ref)^2 theta = c tau, theta_ref = c reference
            u = tau / reference
            x = u / (1.0 + e.size * np.minimum(np.abs(u), 1.0) ** 2)
            for _ in range(60):
                step = (x + e.size * x**3 - u) / (1.0 + 3.0 * e.size * x**2)
                x = x - step
                if np.max(np.abs(step), initial=0.0) < 1e-15:
                    break
            return np.asarray(c * reference * x - c * tau)

    elif shape == "softening":

        def bend(tau: Array) -> Array:
            u2 = (tau / reference) ** 2
            return np.asarray(e.size * c * tau * u2 / (1.0 + u2))

    else:

        def bend(tau: Array) -> Array:
            edge = e.params["zone_Nm"]
            return np.asarray(e.size * c * np.clip(tau, -edge, edge))

    return replace(s, laws=(*s.laws, (k, bend)))


def _gravity_sag(e: Effect, s: Scenario) -> Scenario:
    gravity = (0.0, 0.0, -9.81 * e.size)
    s = replace(s, description=replace(s.description, gravity=gravity))
    for entry in e.params.get("springs", []):
        s = s.add_spring(Spring(entry["joint"], "own", entry["compliance"], actuator=True))
    return s


def _payload(e: Effect, s: Scenario) -> Scenario:
    i = [k for k, seg in enumerate(s.description.segments) if seg.mass > 0.0][-1]
    old = s.description.segments[i]
    com = np.array(old.com) + e.size * np.array(e.params["centre_shift_m"])
    mass = old.mass + e.size * e.params["mass_kg"]
    return replace(s, description=s.description.with_segment(i, mass=max(mass, 0.0), com=tuple(com)))


def _gravity_compensator(e: Effect, s: Scenario) -> Scenario:
    """A gas spring between the link before the joint and the link behind it, at distances a and b from the axis."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]
    a, b, zero, rate = (e.params[n] for n in ("a_m", "b_m", "angle_at_zero_rad", "rate_per_m"))

    def torque(rows: Rows) -> Array:
        angle = rows.q[:, j] + zero
        length = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(angle))
        force = e.size * (1.0 + rate * (length - abs(b - a)))
        return np.asarray(-force * a * b * np.sin(angle) / length)

    return replace(s, torques=(*s.torques, (k, torque)))


# --- geometry ----------------------------------------------------------------------------------------------------


def _joint_offset(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        q[:, j] += e.size
        return q

    return replace(s, readings=(*s.readings, change))


def move_origin(description: RobotDescription, index: int, step: Array) -> RobotDescription:
    """Shift and turn a joint's origin, all in the axes of the parent link. Shape of step (6,). [m, rad]"""
    segment = description.segments[index]
    turned = rotation_step(step[3:]) @ rotation_from_rpy(segment.rpy)
    xyz = tuple(float(v) for v in np.array(segment.xyz) + step[:3])
    rpy = segment.rpy if not np.any(step[3:]) else rpy_from_rotation(turned)
    return description.with_segment(index, xyz=xyz, rpy=rpy)


def _link_geometry(e: Effect, s: Scenario) -> Scenario:
    step = e.size * np.array(e.params["direction"])
    return replace(s, description=move_origin(s.description, s.description.index_of(str(e.joint)), step))


def _tool_frame(e: Effect, s: Scenario) -> Scenario:
    last = len(s.description.segments) - 1
    return replace(s, description=move_origin(s.description, last, e.size * np.array(e.params["direction"])))


def _move_frame(step: Array, active: Callable[[Rows], Array]) -> Callable[[Rows, Array, Array], tuple[Array, Array]]:
    """Move whole poses in the measurement frame where `active` says so."""

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        turn = rotation_step(step[3:])
        on = active(rows)
        moved, turned = p @ turn.T + step[:3], turn @ r
        return np.where(on[:, None], moved, p), np.where(on[:, None, None], turned, r)

    return see


def _base_frame(e: Effect, s: Scenario) -> Scenario:
    step = e.size * np.array(e.params["direction"])
    return replace(s, instrument=(*s.instrument, _move_frame(step, lambda rows: np.ones(len(rows.q), bool))))


def _since(e: Effect) -> Callable[[Rows], Array]:
    return lambda rows: np.ones(len(rows.q), bool) if rows.later else rows.time >= e.params["time_s"] - 1e-9


def _frame_shift(e: Effect, s: Scenario) -> Scenario:
    step = e.size * np.array(e.params["direction"])
    return replace(s, instrument=(*s.instrument, _move_frame(step, _since(e))))


def _tool_shift(e: Effect, s: Scenario) -> Scenario:
    step, active = e.size * np.array(e.params["direction"]), _since(e)

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        on = active(rows)
        return np.where(on[:, None], p + r @ step[:3], p), np.where(on[:, None, None], r @ rotation_step(step[3:]), r)

    return replace(s, instrument=(see, *s.instrument))


def _thermal_drift(e: Effect, s: Scenario) -> Scenario:
    old = np.zeros(len(s.description.segments)) if s.growth is None else s.growth
    return replace(s, growth=old + e.size * segment_weights(s.description, e.params["weights"]))


def segment_weights(description: RobotDescription, weights: list[float]) -> Array:
    """Spread the weights of growing links (origins of the actuated joints, then the flange) over all segments."""
    grown = np.zeros(len(description.segments))
    actuated = description.actuated
    grown[actuated] = weights[: len(actuated)]
    grown[actuated[-1] + 1] = weights[len(actuated)]
    return grown


# --- between motor and link --------------------------------------------------------------------------------------


def play(reading: Array, width: float, start: float) -> Array:
    """Follow a reading with lost motion: the link stays until the reading has crossed the full width.

    Args:
        reading: Motor-side readings in time order. Shape (n,).
        width: Full width of the lost motion.
        start: Link minus reading before the first row, in widths, from -0.5 (came from below) to 0.5.
    """
    half = 0.5 * abs(width)
    link = np.empty_like(reading)
    at = reading[0] + start * abs(width)
    for k, value in enumerate(reading):
        at = min(max(at, value - half), value + half)
        link[k] = at
    return link if width >= 0.0 else 2.0 * reading - link


def _backlash(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        q[:, j] = play(q[:, j], e.size, e.params.get("start", -0.5))
        return q

    return replace(s, transmission=(*s.transmission, change))


def transmission_wave(e: Effect, angle: Array) -> Array:
    """Return the transmission error of one unit over a joint's position."""
    if e.params["shape"] == "bump":
        return np.asarray(np.exp(-0.5 * ((angle - e.params["centre"]) / e.params["width"]) ** 2))
    waves = [w * np.sin(n * angle + f) for w, n, f in e.params["waves"]]
    return np.asarray(np.sum(waves, axis=0))


def _transmission_error(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        q[:, j] += e.size * transmission_wave(e, rows.q[:, j])
        return q

    return replace(s, transmission=(*s.transmission, change))


def _tracking_lag(e: Effect, s: Scenario) -> Scenario:
    """A first-order lag behind the command, already steady when the path run begins."""
    joints = range(len(s.description.joint_names)) if e.joint is None else [joint_index(s.description, e.joint)]

    def change(rows: Rows, q: Array) -> Array:
        out = q.copy()
        for k in path_runs(rows):
            t = rows.time[k]
            for j in joints:
                out[k, j] = lagged(t, q[k, j], e.size)
        return out

    return replace(s, transmission=(*s.transmission, change))


def lagged(t: Array, command: Array, tau: float) -> Array:
    """Pass a sampled command, linear between samples, through a first-order lag that begins in steady motion."""
    out = np.empty_like(command)
    speed = np.diff(command) / np.diff(t)
    behind = tau * speed[0]
    out[0] = command[0] - behind
    for i, v in enumerate(speed):
        decay = np.exp(-(t[i + 1] - t[i]) / tau) if tau > 0.0 else 0.0
        behind = tau * v + (behind - tau * v) * decay
        out[i + 1] = command[i + 1] - behind
    return out


def path_runs(rows: Rows) -> list[np.ndarray]:
    """Return the row numbers of every path run."""
    labels = list(dict.fromkeys(rows.run[rows.is_path].tolist()))
    return [np.flatnonzero(rows.run == label) for label in labels]


# --- readings and sensors ----------------------------------------------------------------------------------------


def _joint_coupling(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)
    kind = e.params["kind"]

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        if kind == "other_joint":
            q[:, j] += e.size * rows.q[:, joint_index(s.description, e.params["other"])]
        elif kind == "reversed":
            q[:, j] = -q[:, j] + e.params["zero"]
        else:
            q[:, j] += e.size
        return q

    return replace(s, readings=(change, *s.readings))


def _time_skew(e: Effect, s: Scenario) -> Scenario:
    """Positions are taken e.size seconds before the joint readings of the same row."""

    def change(rows: Rows, q: Array) -> Array:
        out = q.copy()
        for k in path_runs(rows):
            t = rows.time[k]
            for j in range(q.shape[1]):
                out[k, j] = _extrapolated(t - e.size, t, q[k, j])
        return out

    return replace(s, readings=(*s.readings, change))


def _extrapolated(at: Array, t: Array, value: Array) -> Array:
    inside = np.interp(at, t, value)
    first = value[0] + (at - t[0]) * (value[1] - value[0]) / (t[1] - t[0])
    last = value[-1] + (at - t[-1]) * (value[-1] - value[-2]) / (t[-1] - t[-2])
    return np.where(at < t[0], first, np.where(at > t[-1], last, inside))


def _wrench_bias(e: Effect, s: Scenario) -> Scenario:
    bias, axes = e.size * np.array(e.params["direction"]), e.params["axes"]

    def sense(rows: Rows, wrench: Array, rotation: Array) -> Array:
        if axes == "base":
            return wrench + bias
        return wrench + np.concatenate([rotation @ bias[:3], rotation @ bias[3:]], axis=1)

    return replace(s, sensor=(*s.sensor, sense))


def _wrench_scale(e: Effect, s: Scenario) -> Scenario:
    def sense(rows: Rows, wrench: Array, rotation: Array) -> Array:
        return wrench * (1.0 + e.size)

    return replace(s, sensor=(*s.sensor, sense))


APPLY: dict[str, Apply] = {
    "joint_stiffness": _joint_stiffness,
    "link_compliance": _link_compliance,
    "base_compliance": _base_compliance,
    "stiffness_nonlinearity": _stiffness_nonlinearity,
    "gravity_sag": _gravity_sag,
    "payload": _payload,
    "gravity_compensator": _gravity_compensator,
    "joint_offset": _joint_offset,
    "link_geometry": _link_geometry,
    "tool_frame": _tool_frame,
    "base_frame": _base_frame,
    "backlash": _backlash,
    "transmission_error": _transmission_error,
    "thermal_drift": _thermal_drift,
    "wrench_bias": _wrench_bias,
    "wrench_scale": _wrench_scale,
    "tracking_lag": _tracking_lag,
    "frame_shift": _frame_shift,
    "tool_shift": _tool_shift,
    "joint_coupling": _joint_coupling,
    "time_skew": _time_skew,
}
