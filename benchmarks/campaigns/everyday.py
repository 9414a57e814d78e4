"""A robot's everyday errors: slightly wrong everywhere, by amounts with long tails, with and without a name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaigns.description import Spring, is_own_axis
from benchmarks.campaigns.effects import Effect, joint_index
from benchmarks.campaigns.machines import Machine
from benchmarks.campaigns.oddities_instrument import ODDITIES
from benchmarks.campaigns.rough import apply_rough
from benchmarks.campaigns.simulate import Rows, Scenario
from benchmarks.campaigns.visits import Visits

Generator = np.random.Generator
AXES = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True)
class Small:
    """One everyday error: an effect with the standard deviation that it was drawn with.

    Args:
        effect: The effect; its size is the error's.
        sd: Typical size.
        group: Group that shares one scale.
    """

    effect: Effect
    sd: float
    group: str

    def scaled(self, factor: float) -> Small:
        """Return the error with its size and standard deviation times a factor."""
        return replace(self, effect=self.effect.scaled(factor), sd=self.sd * factor)


def draw_everyday(rng: Generator, machine: Machine, nominal: Scenario, rows: Rows, visits: Visits) -> list[Small]:
    """Draw everyday errors; one factor that is yet to be found scales them all.

    Args:
        rng: Source of randomness.
        machine: The robot.
        nominal: The nominal robot as a scenario.
        rows: The plan.
        visits: How the campaign is run.
    """
    robot = machine.robot
    groups = {g: float(np.exp(rng.normal(0.0, 0.5))) for g in ("geometry", "compliance", "off_axis", "gear", "frames")}
    found: list[Small] = []

    def add(name: str, joint: str | None, axis: str | None, sd: float, group: str, **params: object) -> None:
        sd *= groups.get(group, 1.0)
        size = sd * float(rng.laplace(0.0, 0.7))
        if group in ("off_axis", "gear", "hysteresis", "warm_up"):
            size = abs(size)
        found.append(Small(Effect(name, joint, axis, size, params=dict(params)), sd, group))

    metre = 2.0e-5
    for joint in robot.joint_names:
        segment = robot.segments[robot.index_of(joint)]
        turning = segment.kind == "revolute"
        for k, axis in enumerate(AXES):
            if k < 3 or not turning or abs(segment.axis[k - 3]) < 0.5:
                direction = [float(k == i) for i in range(6)]
                add("link_geometry", joint, axis, metre if k < 3 else 0.5 * metre, "geometry", direction=direction)
        add("joint_offset", joint, None, 0.5 * metre, "geometry")
        own = nominal.own_springs(joint)
        if own:
            add("joint_stiffness", joint, None, 0.04, "compliance")
            for axis in AXES[3:]:
                spring = Spring(joint, axis, 1.0)
                held = any(s.joint == joint and s.axis == axis for s in robot.springs)
                if turning and not is_own_axis(robot, spring) and not held:
                    small = 0.02 * float(nominal.compliance[own[0]])
                    add("link_compliance", joint, axis, small, "off_axis", tilt_rad=[0.0, 0.0, 0.0])
    arm = [n for n in robot.joint_names if robot.segments[robot.index_of(n)].kind == "revolute"]
    for joint in rng.choice(arm, 3, replace=False):
        gear = float(machine.gears[joint_index(robot, str(joint))])
        shape = {"per_rev": gear, "phase": float(rng.uniform(0, 6)), "skew": 0.3, "power": 0.8, "once": 0.4}
        add("transmission_error", str(joint), None, 1.0e-5, "gear", **shape)
        add("backlash", str(joint), None, 1.0e-5, "hysteresis", uneven=0.3, worn_at_rad=1.0, start=-0.5)
    add("tool_frame", None, None, metre, "frames", direction=_direction(rng, 0.0))
    add("base_frame", None, None, metre, "frames", direction=_direction(rng, 0.3))
    rates = [float(v) for v in rng.uniform(0.5, 1.5, len(robot.segments))]
    span = max(0.5, float(np.ptp(rows.rise)))
    add("thermal_drift", None, None, 1.2e-5 / span, "warm_up", rates=_grow(machine, rates))
    add("axis_nonsquare", None, None, 4.0e-6, "nameless", tracker_m=list(visits.tracker))
    runout = {"axes": ["tx", "tz"] if abs(robot.segments[robot.index_of(arm[1])].axis[1]) > 0.5 else ["tx", "ty"]}
    add("oval_bearing", arm[1], None, 1.0e-5, "nameless", **runout, phase=float(rng.uniform(0, 6)))
    return found


def _grow(machine: Machine, rates: list[float]) -> list[float]:
    """Keep the rates of links that grow: moving joints' origins and the flange."""
    segments = machine.robot.segments
    return [r if s.moves or s.joint == "tool_mount" else 0.0 for r, s in zip(rates, segments, strict=True)]


def _direction(rng: Generator, turn: float) -> list[float]:
    v = np.r_[rng.normal(size=3), turn * rng.normal(size=3)]
    return [float(x) for x in v / np.linalg.norm(v)]


def apply_small(effect: Effect, scenario: Scenario) -> Scenario:
    """Put an everyday error, with or without a name, into a scenario."""
    if effect.name in ODDITIES:
        return ODDITIES[effect.name].apply(effect, scenario)
    return apply_rough(effect, scenario)


def scatter_joints(rng: Generator, machine: Machine, size: float) -> Effect:
    """Return the stay-to-stay scatter: every stay ends a little beside the last one, joint by joint.

    Args:
        rng: Source of randomness.
        machine: The robot.
        size: Standard deviation of the TCP that is aimed at. [m]
    """
    joints = len(machine.robot.joint_names)
    weights = np.exp(rng.normal(0.0, 0.4, joints)) * np.linspace(1.0, 2.5, joints) / (machine.reach * joints**0.5)
    slide = [machine.robot.segments[i].kind == "prismatic" for i in machine.robot.actuated]
    weights[np.array(slide)] = 0.5
    params = {"weights": np.round(weights, 4).tolist(), "seed": int(rng.integers(2**31))}
    return Effect("repeatability", None, None, size, "m", params)


def apply_scatter(e: Effect, s: Scenario) -> Scenario:
    """Put the stay-to-stay scatter into a scenario."""

    def change(rows: Rows, q: np.ndarray) -> np.ndarray:
        visit = rows.visit
        rng = np.random.default_rng([e.params["seed"], int(rows.later)])
        steps = rng.normal(size=(int(visit[-1]) + 1, q.shape[1])) * np.array(e.params["weights"])
        return np.asarray(q + e.size * steps[visit] * ~rows.is_path[:, None])

    return replace(s, transmission=(*s.transmission, change))
