"""Draw effects of the vocabulary: where they sit and what shape they have; their size comes from scaling to a gap."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.campaigns.description import is_own_axis
from benchmarks.campaigns.designs import Design
from benchmarks.campaigns.effects import Effect, apply_effect
from benchmarks.campaigns.simulate import Rows, Scenario, simulate_rows

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")
VOCABULARY = (
    "joint_stiffness",
    "link_compliance",
    "base_compliance",
    "stiffness_nonlinearity",
    "gravity_sag",
    "payload",
    "gravity_compensator",
    "joint_offset",
    "link_geometry",
    "tool_frame",
    "base_frame",
    "backlash",
    "transmission_error",
    "thermal_drift",
    "wrench_bias",
    "wrench_scale",
    "tracking_lag",
    "frame_shift",
    "tool_shift",
    "joint_coupling",
    "time_skew",
)
NEEDS_PATH = {"tracking_lag", "time_skew"}
NEEDS_LOAD = {"link_compliance", "base_compliance", "stiffness_nonlinearity", "wrench_bias", "wrench_scale"}
UNSCALED = {"gravity_sag", "joint_coupling"}


def needs_of(names: list[str]) -> tuple[bool, bool]:
    """Tell whether effects need path runs, and whether they need loads."""
    return any(n in NEEDS_PATH for n in names), any(n in NEEDS_LOAD for n in names)


def draw_shape(rng: np.random.Generator, name: str, nominal: Scenario, rows: Rows, design: Design) -> Effect:
    """Draw place and shape of an effect, at a small size that is yet to be scaled.

    Args:
        rng: Source of randomness.
        name: Name in the vocabulary.
        nominal: The nominal robot.
        rows: The campaign.
        design: Its design.
    """
    robot = nominal.description
    joints = robot.joint_names
    arm = [j for j in joints if j != "rail"]
    sprung = [j for j in arm if nominal.own_springs(j)]
    joint = str(rng.choice(arm))
    if name == "joint_stiffness":
        return Effect(name, str(rng.choice(sprung[:5])), None, 0.05, "relative change of the compliance")
    if name == "link_compliance":
        return _draw_link_compliance(rng, nominal, arm)
    if name == "base_compliance":
        return Effect(name, None, str(rng.choice(AXES[3:])), 1e-8, "rad/(N m)")
    if name == "stiffness_nonlinearity":
        return _draw_nonlinearity(rng, nominal, rows, sprung)
    if name == "gravity_sag":
        return Effect(name, None, None, 1.0, "share of 9.81 m/s^2")
    if name == "payload":
        shift = [round(float(v), 4) for v in rng.normal(0.0, 0.03, 3)] if rng.random() < 0.5 else [0.0, 0.0, 0.0]
        tool = max((seg for seg in robot.segments if seg.child == "tool"), key=lambda seg: seg.mass)
        change = {"mass_kg": tool.mass * _sign(rng), "centre_shift_m": shift}
        return Effect(name, None, None, 0.3, "share of the tool's mass", change)
    if name == "gravity_compensator":
        return _draw_compensator(rng, nominal, arm)
    if name == "joint_offset":
        return Effect(name, joint, None, 1e-4 * _sign(rng), "rad")
    if name in ("link_geometry", "tool_frame", "base_frame", "frame_shift", "tool_shift"):
        return _draw_geometry(rng, name, nominal, rows, design)
    if name == "backlash":
        start = float(rng.choice([-0.5, 0.5]))
        return Effect(name, str(rng.choice(arm[:5])), None, 1e-4, "rad, full width", {"start": start})
    if name == "transmission_error":
        return _draw_transmission(rng, arm, rows, joints)
    if name == "thermal_drift":
        weights = [1.0] * (len(joints) + 1)
        if rng.random() < 0.25:
            weights = [round(float(v), 3) for v in rng.uniform(0.6, 1.4, len(joints) + 1)]
        return Effect(name, None, None, 1e-5, "1/K", {"weights": weights})
    if name == "wrench_bias":
        direction = rng.normal(size=6) * np.array([1, 1, 1, 0.1, 0.1, 0.1])
        params = {"axes": str(rng.choice(["sensor", "base"])), "direction": np.round(direction, 4).tolist()}
        return Effect(name, None, None, 10.0, "N", params)
    if name == "wrench_scale":
        return Effect(name, None, None, 0.03 * _sign(rng), "1")
    if name == "tracking_lag":
        return Effect(name, None if rng.random() < 0.4 else joint, None, 0.005, "s")
    if name == "joint_coupling":
        return _draw_coupling(rng, arm, joints)
    if name == "time_skew":
        return Effect(name, None, None, 0.005 * _sign(rng), "s")
    raise KeyError(f"no effect named {name!r} in the vocabulary")


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _draw_link_compliance(rng: np.random.Generator, nominal: Scenario, arm: list[str]) -> Effect:
    while True:
        joint = str(rng.choice(arm, p=_weights(len(arm), [3, 3, 3, 1, 1, 1])))
        axis = str(rng.choice(AXES, p=[0.06, 0.06, 0.06, 0.28, 0.27, 0.27]))
        effect = Effect("link_compliance", joint, axis, 1e-9, "rad/(N m)" if axis[0] == "r" else "m/N")
        if not is_own_axis(nominal.description, apply_effect(effect, nominal).springs[-1]):
            return effect


def _weights(count: int, weights: list[float]) -> np.ndarray:
    w = np.array(weights[:count], dtype=float)
    return np.asarray(w / w.sum())


def _draw_nonlinearity(rng: np.random.Generator, nominal: Scenario, rows: Rows, sprung: list[str]) -> Effect:
    joint = str(rng.choice(sprung[:5]))
    load = simulate_rows(nominal, rows).load[:, nominal.own_springs(joint)[0]]
    reference = float(np.sqrt(np.mean(load**2))) * float(rng.uniform(0.8, 1.5)) + 1e-6
    shape = str(rng.choice(["hardening", "softening", "zone"]))
    params: dict[str, Any] = {"shape": shape, "reference_Nm": reference}
    if shape == "zone":
        params["zone_Nm"] = reference * float(rng.uniform(0.1, 0.35))
    return Effect("stiffness_nonlinearity", joint, None, 0.2, "relative change of the compliance", params)


def _draw_compensator(rng: np.random.Generator, nominal: Scenario, arm: list[str]) -> Effect:
    joint = arm[1] if rng.random() < 0.75 else arm[2]
    params = {
        "a_m": float(rng.uniform(0.2, 0.45)),
        "b_m": float(rng.uniform(0.5, 0.9)),
        "angle_at_zero_rad": float(rng.uniform(0.0, 2.0 * np.pi)),
        "rate_per_m": float(rng.uniform(0.0, 1.5)),
    }
    return Effect("gravity_compensator", joint, None, 500.0, "N", params)


def _draw_geometry(rng: np.random.Generator, name: str, nominal: Scenario, rows: Rows, design: Design) -> Effect:
    """Shifts and turns: one axis of a link, whole frames otherwise; 1 m of size goes with 1 rad."""
    direction = np.zeros(6)
    joint, axis = None, None
    params: dict[str, Any] = {}
    if name == "link_geometry":
        robot = nominal.description
        joint = str(rng.choice([j for j in robot.joint_names if j != "rail"][1:]))
        own = np.abs(np.array(robot.segments[robot.index_of(joint)].axis))
        choices = [a for k, a in enumerate(AXES) if k < 3 or own[k - 3] < 0.5]
        axis = str(rng.choice(choices))
        direction[AXES.index(axis)] = _sign(rng)
    elif name in ("tool_frame", "tool_shift"):
        direction[:3] = rng.normal(size=3)
        if design.orientation and rng.random() < 0.4:
            direction[3:] = rng.normal(size=3)
    else:
        direction[:3] = rng.normal(size=3)
        direction[3:] = rng.normal(size=3) * 0.6
    if name in ("frame_shift", "tool_shift"):
        statics = np.flatnonzero(~rows.is_path)
        row = int(rng.integers(int(0.2 * len(statics)), int(0.8 * len(statics))))
        visits = rows.visit
        while row < len(statics) - 1 and rng.random() < 0.7 and visits[row] == visits[row - 1]:
            row += 1
        params.update(row=row, time_s=float(rows.time[row]))
    if name not in ("link_geometry",):
        direction /= np.linalg.norm(direction)
    params["direction"] = np.round(direction, 6).tolist()
    return Effect(name, joint, axis, 1e-4, "m and rad", params)


def _draw_transmission(rng: np.random.Generator, arm: list[str], rows: Rows, joints: list[str]) -> Effect:
    joint = str(rng.choice(arm))
    kind = rng.random()
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    angle = rows.q[:, joints.index(joint)]
    if kind < 0.65:
        waves = [[1.0, int(rng.choice([1, 2])), phase]]
        if rng.random() < 0.3:
            waves = [[1.0, 1, phase], [float(rng.uniform(0.3, 0.8)), 2, float(rng.uniform(0.0, 6.28))]]
        params: dict[str, Any] = {"shape": "waves", "waves": waves}
    elif kind < 0.85:
        params = {"shape": "waves", "waves": [[1.0, int(rng.integers(8, 30)), phase]]}
    else:
        low, high = np.quantile(angle, [0.2, 0.8])
        width = float(rng.uniform(0.08, 0.16)) * float(high - low)
        params = {"shape": "bump", "centre": float(rng.uniform(low, high)), "width": width}
    return Effect("transmission_error", joint, None, 1e-4, "rad, amplitude", params)


def _draw_coupling(rng: np.random.Generator, arm: list[str], joints: list[str]) -> Effect:
    kind = str(rng.choice(["other_joint", "reversed", "zero"], p=[0.6, 0.2, 0.2]))
    if kind == "other_joint":
        pairs = [(arm[2], arm[1]), (arm[4], arm[3]), (arm[5], arm[4]), (arm[5], arm[3])]
        joint, other = pairs[int(rng.integers(len(pairs)))]
        size = float(rng.choice([1.0, -1.0, 0.5, 0.0125, -0.02, 0.04]))
        return Effect("joint_coupling", joint, None, size, "1", {"kind": kind, "other": other})
    # whole conventions go wrong at the wrist, where the gap is of centimetres; big axes get a few degrees
    wrist = rng.random() < 0.6 or kind == "reversed"
    joint = str(rng.choice(arm[3:] if wrist else arm[1:3]))
    if kind == "reversed":
        return Effect("joint_coupling", joint, None, -1.0, "1", {"kind": kind, "zero": 0.0})
    size = float(np.deg2rad(rng.choice([90.0, -90.0, 180.0] if wrist else [5.0, -5.0, -3.0, 2.0])))
    return Effect("joint_coupling", joint, None, size, "rad", {"kind": kind})


def draw_background(rng: np.random.Generator, nominal: Scenario, rows: Rows, design: Design) -> list[Effect]:
    """Draw a robot that is slightly wrong everywhere; all sizes share one factor that is yet to be found."""
    robot = nominal.description
    arm = [j for j in robot.joint_names if j != "rail"]
    found: list[Effect] = []
    for joint in arm:
        found.append(Effect("joint_offset", joint, None, float(rng.normal(0.0, 3e-5)), "rad"))
        if nominal.own_springs(joint):
            change = float(np.clip(rng.normal(0.0, 0.15), -0.4, 0.4))
            found.append(Effect("joint_stiffness", joint, None, change, "relative change of the compliance"))
        direction = np.r_[rng.normal(0.0, 1.0, 3), np.zeros(3)].tolist()
        found.append(Effect("link_geometry", joint, None, 3e-5, "m and rad", {"direction": direction}))
        waves = [[1.0, int(rng.choice([1, 2])), float(rng.uniform(0, 6.28))]]
        found.append(
            Effect(
                "transmission_error",
                joint,
                None,
                float(rng.uniform(0.3, 1.0)) * 2e-5,
                "rad, amplitude",
                {"shape": "waves", "waves": waves},
            )
        )
        found.append(
            Effect("backlash", joint, None, float(rng.uniform(0.2, 1.0)) * 2e-5, "rad, full width", {"start": -0.5})
        )
    stiffest = 0.1 * float(np.median(nominal.compliance[nominal.compliance > 0.0])) if len(nominal.springs) else 2e-8
    for joint in arm[:3]:
        bend = _draw_link_compliance(rng, nominal, [joint])
        while bend.axis is None or bend.axis[0] != "r":
            bend = _draw_link_compliance(rng, nominal, [joint])
        small = float(rng.uniform(0.2, 1.0)) * min(stiffest, 5e-8)
        found.append(Effect("link_compliance", joint, bend.axis, small, bend.unit))
    weights = [1.0] * (len(robot.joint_names) + 1)
    span = max(1.0, float(np.ptp(rows.rise)))
    found.append(
        Effect("thermal_drift", None, None, float(rng.uniform(1e-6, 3e-5)) / span, "1/K", {"weights": weights})
    )
    return found
