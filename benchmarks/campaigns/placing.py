"""Where the effects of a drawn campaign sit and how rough they are; their sizes come from scaling to a gap."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.campaigns.description import SPRING_AXES
from benchmarks.campaigns.effects import Effect
from benchmarks.campaigns.oddities_instrument import ODDITIES
from benchmarks.campaigns.oddity import Setting

Generator = np.random.Generator
AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
UNSCALED = ("gravity_sag", "joint_coupling")
OF_MOTION = ("tracking_lag", "time_skew")
# How often each name is drawn; those that need a load, a path or free frames are left out where there is none.
CHANCES = {
    "joint_stiffness": 3.0,
    "joint_offset": 2.5,
    "link_geometry": 2.5,
    "backlash": 2.5,
    "transmission_error": 2.5,
    "link_compliance": 2.0,
    "stiffness_nonlinearity": 1.5,
    "thermal_drift": 1.5,
    "frame_shift": 1.3,
    "tool_shift": 1.3,
    "payload": 1.2,
    "gravity_compensator": 1.0,
    "base_compliance": 1.0,
    "tool_frame": 1.0,
    "joint_coupling": 0.8,
    "gravity_sag": 0.8,
    "wrench_scale": 0.7,
    "base_frame": 0.6,
    "wrench_bias": 0.6,
    "tracking_lag": 0.6,
    "time_skew": 0.6,
}


def draw_names(rng: Generator, setting: Setting, count: int, *, registered: bool, alone: bool) -> list[str]:
    """Draw the names of effects that this campaign could show; a wrong convention only where it is alone."""
    chances = dict(CHANCES)
    loaded, paths = setting.visits.loaded, bool(np.any(setting.rows.is_path))
    gone: list[str] = []
    if registered:
        gone += ["tool_frame", "base_frame"]
    if not loaded:
        gone += ["wrench_scale", "wrench_bias"]
    if setting.visits.weights_kg is not None:
        gone += ["wrench_bias"]
    if not paths:
        gone += list(OF_MOTION)
    if setting.machine.balanced is None:
        gone += ["gravity_compensator"]
    if setting.machine.robot.gravity is None:
        gone += ["payload", "gravity_compensator"]
        if not loaded:
            gone += ["joint_stiffness", "link_compliance", "base_compliance", "stiffness_nonlinearity"]
    if not alone:
        gone += ["joint_coupling"]
    names = [n for n in chances if n not in gone]
    weights = np.array([chances[n] for n in names])
    return [str(n) for n in rng.choice(names, count, replace=False, p=weights / weights.sum())]


def draw_odd(rng: Generator, setting: Setting) -> Effect:
    """Draw a cause without a name."""
    robot = setting.machine.robot
    have = {"": True, "rail": "rail" in robot.joint_names, "weights": setting.visits.loaded}
    name = str(rng.choice([n for n, o in ODDITIES.items() if have[o.needs]]))
    joint, size, params = ODDITIES[name].draw(rng, setting)
    return Effect(name, joint, None, size, "see note", params, known=False)


def draw_place(rng: Generator, name: str, s: Setting, joints: list[str] | None = None) -> Effect:
    """Draw place and shape of an effect with a name, at a small size.

    Args:
        rng: Source of randomness.
        name: Name in the vocabulary.
        s: What it is put into.
        joints: Joints to choose from; all if None.
    """
    robot = s.machine.robot
    arm = [j for j in (joints or s.arm) if j in s.arm] or s.arm
    sign = float(rng.choice([-1.0, 1.0]))
    joint = str(rng.choice(arm))
    sprung = [j for j in arm if s.nominal.own_springs(j)] or [j for j in s.arm if s.nominal.own_springs(j)]
    if name == "joint_stiffness":
        return Effect(
            name, str(rng.choice(sprung)), None, 0.05 * (sign if rng.random() < 0.4 else 1.0), "relative change"
        )
    if name in ("link_compliance", "base_compliance"):
        return _draw_bending(rng, name, s, joint)
    if name == "stiffness_nonlinearity":
        place = str(rng.choice(sorted(sprung, key=s.torque_of)[-3:]))
        shape = str(rng.choice(["hertz", "film", "pieces", "teeth"]))
        reference = s.torque_of(place) * float(rng.uniform(0.7, 1.4))
        params = {"shape": shape, "reference_Nm": reference, "knee": float(rng.uniform(0.2, 0.7))}
        return Effect(name, place, None, 0.2, "relative", {**params, "after": float(rng.uniform(0.0, 0.4))})
    if name == "gravity_sag":
        factors = np.round(np.exp(rng.normal(0.0, 0.08, len(robot.segments))), 4).tolist()
        return Effect(name, None, None, 1.0, "1", {"mass_factors": factors})
    if name == "payload":
        tool = max(seg.mass for seg in robot.segments if seg.child == "tool")
        shift = np.round(rng.normal(0.0, 0.02, 3), 4).tolist()
        return Effect(name, None, None, 0.3, "1", {"mass_kg": tool * sign, "centre_shift_m": shift})
    if name == "gravity_compensator":
        span = s.machine.scale
        params = {"a_m": float(rng.uniform(0.2, 0.4)) * span, "b_m": float(rng.uniform(0.5, 0.9)) * span}
        params.update(angle_at_zero_rad=float(rng.uniform(0, 6.28)), exponent=float(rng.uniform(0.9, 1.5)))
        return Effect(name, s.machine.balanced, None, 300.0, "N", params)
    if name in ("link_geometry", "tool_frame", "base_frame", "frame_shift", "tool_shift"):
        return _draw_shift(rng, name, s, arm, sign)
    return _draw_motion(rng, name, s, joint, sign)


def _draw_motion(rng: Generator, name: str, s: Setting, joint: str, sign: float) -> Effect:
    """Effects of joints' motion, warming, sensors and clocks."""
    robot = s.machine.robot
    if name == "joint_offset":
        return Effect(name, joint, None, 1e-4 * sign, "rad")
    if name == "backlash":
        params = {"uneven": float(rng.uniform(0.0, 0.5)), "worn_at_rad": float(rng.uniform(-1.5, 1.5))}
        return Effect(name, joint, None, 1e-4, "rad, full width", {**params, "start": float(rng.choice([-0.5, 0.5]))})
    if name == "transmission_error":
        gear = float(s.machine.gears[robot.joint_names.index(joint)])
        once = rng.random() < 0.6  # eccentric output wheel; else the mesh itself, many times a turn
        params = {"per_rev": float(rng.choice([1.0, 2.0])) if once else gear, "phase": float(rng.uniform(0, 6.28))}
        params.update(skew=float(rng.uniform(0.0, 0.6)), power=float(rng.uniform(0.7, 1.2)))
        return Effect(name, joint, None, 1e-4, "rad, amplitude", {**params, "once": 0.0 if once else 0.3})
    if name == "thermal_drift":
        rates = rng.uniform(0.7, 1.3, len(robot.segments))
        grown = [r if g.moves or g.joint == "tool_mount" else 0.0 for r, g in zip(rates, robot.segments, strict=True)]
        return Effect(name, None, None, 1e-5, "1/K", {"rates": [float(v) for v in grown]})
    if name == "joint_coupling":
        k = int(rng.integers(2, len(s.arm)))
        params: dict[str, Any] = {"kind": "other_joint", "other": s.arm[k - 1]}
        size = float(rng.choice([1.0, -1.0, 0.5, -0.02, 0.0125, 0.031]))
        if rng.random() < 0.3:
            return Effect(name, s.arm[-1], None, -1.0, "1", {"kind": "reversed", "zero": 0.0})
        return Effect(name, s.arm[k], None, size, "1", params)
    if name == "wrench_bias":
        direction = np.round(rng.normal(size=6) * np.array([1, 1, 1, 0.08, 0.08, 0.08]), 4).tolist()
        return Effect(name, None, None, 5.0, "N", {"axes": str(rng.choice(["sensor", "base"])), "direction": direction})
    if name == "wrench_scale":
        return Effect(name, None, None, 0.03 * sign, "1")
    if name == "tracking_lag":
        return Effect(name, None if rng.random() < 0.5 else joint, None, 0.005, "s")
    return Effect(name, None, None, 0.005 * sign, "s")


def _draw_bending(rng: Generator, name: str, s: Setting, joint: str) -> Effect:
    """A bearing or the base plate, about an axis up to 15 degrees beside the one that is named."""
    tilt = np.round(np.deg2rad(rng.uniform(3.0, 15.0)) * (lambda v: v / np.linalg.norm(v))(rng.normal(size=3)), 5)
    params = {"tilt_rad": tilt.tolist()}
    if name == "base_compliance":
        return Effect(name, None, str(rng.choice(["rx", "ry"])), 1e-9, "rad/(N m)", params)
    own = np.array(s.machine.robot.segments[s.machine.robot.index_of(joint)].axis)
    free = [a for a in AXES if a[0] == "t" or abs(float(own @ np.array(SPRING_AXES[a][1]))) < 0.5]
    weights = np.array([0.15 if a[0] == "t" else 1.0 for a in free])
    axis = str(rng.choice(free, p=weights / weights.sum()))
    return Effect(name, joint, axis, 1e-9, "rad/(N m)" if axis[0] == "r" else "m/N", params)


def _draw_shift(rng: Generator, name: str, s: Setting, arm: list[str], sign: float) -> Effect:
    """A length, a frame, or something that was bumped in the middle of the campaign."""
    robot, rows = s.machine.robot, s.rows
    if name == "link_geometry":
        joint = str(rng.choice([j for j in arm if j != robot.joint_names[0]] or s.arm[1:]))
        own = np.abs(robot.segments[robot.index_of(joint)].axis)
        axis = str(rng.choice([a for k, a in enumerate(AXES) if k < 3 or own[k - 3] < 0.5]))
        direction = [sign * float(a == axis) for a in AXES]
        return Effect(name, joint, axis, 1e-4, "m and rad", {"direction": direction})
    direction = np.zeros(6)
    direction[:3] = rng.normal(size=3)
    if name in ("base_frame", "frame_shift"):
        direction[3:] = rng.normal(size=3) * 0.4 / s.machine.reach
    params: dict[str, Any] = {"direction": np.round(direction / np.linalg.norm(direction), 6).tolist()}
    if name in ("frame_shift", "tool_shift"):
        still = np.flatnonzero(~rows.is_path)
        row = int(still[int(rng.uniform(0.25, 0.75) * len(still))])
        inside = np.flatnonzero(~np.r_[True, np.any(np.diff(rows.q, axis=0) != 0, axis=1)] & ~rows.is_path)
        inside = inside[(inside > 0.2 * len(still)) & (inside < 0.8 * len(still))]
        if len(inside):
            row = int(rng.choice(inside))  # in the middle of a stay
        params.update(row=row, time_s=float(rows.time[row]))
        if name == "frame_shift":
            params["pivot_m"] = list(s.visits.tracker)
    return Effect(name, None, None, 1e-4, "m and rad", params)
