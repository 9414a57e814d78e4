"""Effects that have a name, as they look on a real robot: uneven, tilted, out of step with any textbook formula.

The truth of a campaign names the effect; how it looks shares no formula with the plain forms of `effects.py`: lost
motion whose width changes with the angle, bearings about axes that are no coordinate axes, gear errors of uneven ratio
and pointed shape, joints that follow Hertz's 2/3 power, a saturating film or a power law in pieces, warming by two
sources.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.campaigns.description import SPRING_AXES, Array, Spring
from benchmarks.campaigns.effects import APPLY, Apply, Effect, joint_index
from benchmarks.campaigns.simulate import Rows, Scenario, rotation_step

GEOMETRIC = ("joint_offset", "link_geometry", "tool_frame", "base_frame", "joint_coupling")


def apply_rough(effect: Effect, scenario: Scenario) -> Scenario:
    """Put an effect with a name into a scenario, in its rough form where there is one."""
    return (ROUGH.get(effect.name) or APPLY[effect.name])(effect, scenario)


def width_of(e: Effect, angle: Array) -> Array:
    """Return the width of lost motion over a joint's angle: worn where the joint works most."""
    wear = 1.0 + e.params["uneven"] * np.cos(angle - e.params["worn_at_rad"])
    return np.asarray(e.size * wear)


def uneven_play(reading: Array, width: Array, start: float) -> Array:
    """Follow a reading through lost motion whose width differs from row to row. Shapes (n,), (n,), (n,)."""
    link = np.empty_like(reading)
    at = reading[0] + start * width[0]
    for k, (value, w) in enumerate(zip(reading, width, strict=True)):
        half = 0.5 * abs(w)
        at = min(max(at, value - half), value + half)
        link[k] = at
    return link


def _backlash(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        q[:, j] = uneven_play(q[:, j], width_of(e, rows.q[:, j]), e.params["start"])
        return q

    return replace(s, transmission=(*s.transmission, change))


def gear_shape(e: Effect, angle: Array) -> Array:
    """Return a gear error of one unit: a wave whose flanks are uneven and whose crests are pointed."""
    turn = e.params["per_rev"] * angle + e.params["phase"]
    skewed = turn + e.params["skew"] * np.sin(turn)
    crest = np.sin(skewed)
    pointed = np.sign(crest) * np.abs(crest) ** e.params["power"]
    return np.asarray(pointed + e.params["once"] * np.sin(angle + 2.0 * e.params["phase"]))


def _transmission_error(e: Effect, s: Scenario) -> Scenario:
    j = joint_index(s.description, e.joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        q[:, j] += e.size * gear_shape(e, rows.q[:, j])
        return q

    return replace(s, transmission=(*s.transmission, change))


def law_of(e: Effect, compliance: float) -> Callable[[Array], Array]:
    """Return the extra deflection of a joint over its torque: Hertz, a film that saturates, or powers in pieces."""
    reference, shape = e.params["reference_Nm"], e.params["shape"]
    unit = e.size * compliance * reference

    def bend(tau: Array) -> Array:
        u = np.abs(tau) / reference
        if shape == "hertz":
            # the 2/3 power begins with infinite compliance: a preload of 2 % of the reference takes that away
            grown = (u + 0.02) ** (2.0 / 3.0) - 0.02 ** (2.0 / 3.0)
        elif shape == "film":
            grown = np.tanh(u / e.params["knee"])
        elif shape == "pieces":
            knee = e.params["knee"]
            grown = np.where(u < knee, u**1.4 / knee**0.4, knee + (u - knee) * e.params["after"])
        else:  # teeth share the load one after another
            grown = u * (1.0 - 0.5 * np.exp(-u / e.params["knee"])) - 0.5 * u * u / (1.0 + u)
        return np.asarray(unit * np.sign(tau) * grown)

    return bend


def _nonlinearity(e: Effect, s: Scenario) -> Scenario:
    k = s.own_springs(str(e.joint))[0]
    return replace(s, laws=(*s.laws, (k, law_of(e, float(s.compliance[k])))))


def _tilted_spring(e: Effect, s: Scenario) -> Scenario:
    """A bearing or plate that bends about an axis some degrees beside the named one, and across it a little."""
    joint = str(e.joint) if e.name == "link_compliance" else s.description.segments[0].joint
    axis = str(e.axis)
    plain = np.array(SPRING_AXES[axis][1])
    along = rotation_step(np.array(e.params["tilt_rad"])) @ plain
    direction = (float(along[0]), float(along[1]), float(along[2]))
    return s.add_spring(Spring(joint, axis, e.size, direction=direction))


def _gravity_sag(e: Effect, s: Scenario) -> Scenario:
    """The robot feels gravity, and its links weigh not quite what the model says."""
    robot = s.description
    segments = tuple(
        replace(seg, mass=seg.mass * f) for seg, f in zip(robot.segments, e.params["mass_factors"], strict=True)
    )
    return replace(s, description=replace(robot, segments=segments, gravity=(0.0, 0.0, -9.81 * e.size)))


def _payload(e: Effect, s: Scenario) -> Scenario:
    """The tool weighs something else; part of the difference hangs as a dress pack on the link before it."""
    robot = s.description
    heavy = [k for k, seg in enumerate(robot.segments) if seg.mass > 0.0]
    tool, before = heavy[-1], heavy[-2]
    old, wrist = robot.segments[tool], robot.segments[before]
    com = tuple(float(c + e.size * d) for c, d in zip(old.com, e.params["centre_shift_m"], strict=True))
    mass = max(old.mass + e.size * e.params["mass_kg"], 0.0)
    robot = robot.with_segment(tool, mass=mass, com=com)
    pack = max(wrist.mass + 0.15 * e.size * e.params["mass_kg"], 0.0)
    return replace(s, description=robot.with_segment(before, mass=pack))


def _balancer(e: Effect, s: Scenario) -> Scenario:
    """A gas cylinder: its force grows with a power of the volume swept, and its hinges are off the drawing."""
    j = joint_index(s.description, e.joint)
    k = s.own_springs(str(e.joint))[0]
    a, b, zero = (e.params[n] for n in ("a_m", "b_m", "angle_at_zero_rad"))

    def torque(rows: Rows) -> Array:
        angle = rows.q[:, j] + zero
        length = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(angle))
        stroke = (length - abs(b - a)) / (2.0 * min(a, b))
        force = e.size / (1.0 - 0.35 * stroke) ** e.params["exponent"]
        return np.asarray(-force * a * b * np.sin(angle) / length)

    return replace(s, torques=(*s.torques, (k, torque)))


def _thermal_drift(e: Effect, s: Scenario) -> Scenario:
    """Every moving joint's origin grows at a rate of its own; the temperature itself has two time constants."""
    old = np.zeros(len(s.description.segments)) if s.growth is None else s.growth
    return replace(s, growth=old + e.size * np.array(e.params["rates"]))


def _since_row(e: Effect) -> Callable[[Rows], Array]:
    return lambda rows: np.ones(len(rows.q), bool) if rows.later else rows.time >= e.params["time_s"] - 1e-9


def _frame_shift(e: Effect, s: Scenario) -> Scenario:
    """The instrument is bumped between two readings, in the middle of a stay where there is one."""
    step, active = e.size * np.array(e.params["direction"]), _since_row(e)
    pivot = np.array(e.params["pivot_m"])
    turn = rotation_step(step[3:])

    def see(rows: Rows, p: Array, r: Array) -> tuple[Array, Array]:
        on = active(rows)[:, None]
        moved = (p - pivot) @ turn.T + pivot + step[:3]
        return np.where(on, moved, p), np.where(on[:, :, None], turn @ r, r)

    return replace(s, instrument=(*s.instrument, see))


ROUGH: dict[str, Apply] = {
    "backlash": _backlash,
    "transmission_error": _transmission_error,
    "stiffness_nonlinearity": _nonlinearity,
    "link_compliance": _tilted_spring,
    "base_compliance": _tilted_spring,
    "gravity_sag": _gravity_sag,
    "payload": _payload,
    "gravity_compensator": _balancer,
    "thermal_drift": _thermal_drift,
    "frame_shift": _frame_shift,
}
