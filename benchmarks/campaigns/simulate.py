"""What a robot with effects does in a campaign, and what the instruments would read without noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.campaigns.description import Array, RobotDescription, Spring, is_own_axis
from benchmarks.campaigns.engine import ElasticModel


@dataclass(frozen=True)
class Rows:
    """The plan of a campaign, one entry a row of the log, in time order."""

    run: np.ndarray  #: Label of the run of every row. Shape (n,).
    is_path: np.ndarray  #: Whether the row is a sample of a path. Shape (n,).
    time: Array  #: Seconds since the campaign began. Shape (n,). [s]
    q: Array  #: Motor-side readings. Shape (n, nq). [rad or m]
    #: Wrench that the environment really exerts on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
    wrench: Array
    rise: Array  #: Temperature of the structure above the reference. Shape (n,). [K]
    later: bool = False  #: Whether this is the later campaign, after every shift.

    @property
    def visit(self) -> np.ndarray:
        """Number of the stay at a pose that a row belongs to; every path sample is its own. Shape (n,)."""
        moved = np.r_[True, np.any(np.abs(np.diff(self.q, axis=0)) > 1e-9, axis=1) | (self.run[1:] != self.run[:-1])]
        return np.cumsum(moved) - 1


QMap = Callable[[Rows, Array], Array]


@dataclass(frozen=True)
class Scenario:
    """A robot and everything that is wrong with it, as functions that the simulation calls."""

    description: RobotDescription  #: Geometry, masses, gravity.
    springs: tuple[Spring, ...]  #: All springs, those that effects added last.
    compliance: Array  #: Compliance of every spring. Shape (n_springs,).
    #: Extra deflection of a spring: index and function of its load.
    laws: tuple[tuple[int, Callable[[Array], Array]], ...] = ()
    #: Extra generalised load on a spring: index and function of the rows.
    torques: tuple[tuple[int, Callable[[Rows], Array]], ...] = ()
    #: Deflection of spring i under the load of spring k: (i, k, compliance).
    couplings: tuple[tuple[int, int, float], ...] = ()
    #: Changes between reading and link that encoders do not see (zeros, conventions, skew).
    readings: tuple[QMap, ...] = ()
    transmission: tuple[QMap, ...] = ()  #: Changes between motor and link that a link-side encoder sees.
    growth: Array | None = None  #: Growth of every segment's origin. Shape (n_segments,). [1/K]
    #: Wrench beside the planned one that no sensor reports, from rows, TCP position and rotation.
    loads: tuple[Callable[[Rows, Array, Array], Array], ...] = ()
    sensor: tuple[Callable[[Rows, Array, Array], Array], ...] = ()  #: What the force sensor makes of the true wrench.
    #: What frames and instrument make of the true pose.
    instrument: tuple[Callable[[Rows, Array, Array], tuple[Array, Array]], ...] = ()
    #: Changes of the link angles that need the load on the springs.
    after: tuple[Callable[[Rows, Array], Array], ...] = ()

    def own_springs(self, joint: str) -> list[int]:
        """Indices of the springs about (or along) a joint's own axis."""
        return [k for k, s in enumerate(self.springs) if s.joint == joint and is_own_axis(self.description, s)]

    def add_spring(self, spring: Spring) -> Scenario:
        """Return the scenario with one spring more, after those that its joint has already."""
        return replace(self, springs=(*self.springs, spring), compliance=np.append(self.compliance, spring.compliance))


@dataclass(frozen=True)
class Reading:
    """Readings without noise."""

    position: Array  #: TCP position, measurement frame. Shape (n, 3). [m]
    rotation: Array  #: TCP orientation, measurement frame. Shape (n, 3, 3).
    wrench: Array  #: Wrench that the sensor reports, base axes. Shape (n, 6). [N, N m]
    link: Array  #: Link-side encoder readings. Shape (n, nq). [rad or m]
    load: Array  #: Generalised load on every spring. Shape (n, n_springs). [N m or N]
    theta: Array  #: Elastic coordinates. Shape (n, n_springs). [rad or m]


def nominal_scenario(description: RobotDescription) -> Scenario:
    """Return the scenario in which the robot is what its folder says."""
    compliance = np.array([s.compliance for s in description.springs], dtype=float)
    return Scenario(description, description.springs, compliance)


_MODELS: dict[tuple[object, ...], ElasticModel] = {}


def _model_of(scenario: Scenario) -> ElasticModel:
    """Return a MuJoCo model of the scenario's chain; models are kept by their layout and loaded with its numbers."""
    joints = tuple((s.joint, s.kind) for s in scenario.description.segments)
    layout = tuple((s.joint, s.axis, s.offset) for s in scenario.springs)
    key = (scenario.description.name, joints, layout)
    if key not in _MODELS:
        if len(_MODELS) > 400:
            _MODELS.clear()
        _MODELS[key] = ElasticModel(scenario.description, scenario.springs)
    model = _MODELS[key]
    model.load_description(scenario.description)
    return model


def _deflect(scenario: Scenario, extra: Array) -> Callable[[Array], Array]:
    """Return the law of all springs together."""

    def law(load: Array) -> Array:
        tau = load + extra
        theta = tau * scenario.compliance
        for k, bend in scenario.laws:
            theta[:, k] += bend(tau[:, k])
        for i, k, compliance in scenario.couplings:
            theta[:, i] += compliance * tau[:, k]
        return theta

    return law


def _own_motion(scenario: Scenario, theta: Array) -> Array:
    """Return what the springs between motor-side and link-side encoder add to every joint. Shape (n, nq)."""
    description = scenario.description
    joints = description.joint_names
    moved = np.zeros((len(theta), len(joints)))
    for k, spring in enumerate(scenario.springs):
        if spring.actuator and spring.joint in joints:
            axis = np.array(description.segments[description.index_of(spring.joint)].axis)
            sign = 1.0
            if spring.axis != "own":
                sign = float(np.sign(axis["xyz".index(spring.axis[1])]))
            moved[:, joints.index(spring.joint)] += sign * theta[:, k]
    return moved


def simulate_rows(scenario: Scenario, rows: Rows, select: np.ndarray | None = None) -> Reading:
    """Simulate the rows of a campaign.

    Args:
        scenario: The robot and its effects.
        rows: The plan.
        select: Indices of the rows to solve; whatever depends on the order is worked out on all of them.
    """
    pick = np.arange(len(rows.q)) if select is None else select
    q = rows.q
    for change in scenario.readings:
        q = change(rows, q)
    seen = np.zeros_like(q)
    for change in scenario.transmission:
        seen = seen + (change(rows, rows.q) - rows.q)
    q = q + seen
    some = Rows(
        rows.run[pick],
        rows.is_path[pick],
        rows.time[pick],
        rows.q[pick],
        rows.wrench[pick],
        rows.rise[pick],
        rows.later,
    )
    q, seen, wrench = q[pick], seen[pick], some.wrench
    growth = None
    if scenario.growth is not None:
        growth = 1.0 + some.rise[:, None] * scenario.growth
    model = _model_of(scenario)
    extra = np.zeros((len(pick), len(scenario.springs)))
    for k, torque in scenario.torques:
        extra[:, k] += torque(some)
    law = _deflect(scenario, extra)
    solved = model.solve(q, wrench, law, growth=growth)
    for load in scenario.loads:
        acting = wrench
        for _ in range(3):
            acting = wrench + load(some, solved.position, solved.rotation)
            solved = model.solve(q, acting, law, growth=growth, start=solved.theta)
        wrench = acting
    for shift in scenario.after:
        delta = shift(some, solved.torque + extra)
        q, seen = q + delta, seen + delta
        solved = model.solve(q, wrench, law, growth=growth, start=solved.theta)
    reported = some.wrench
    for sense in scenario.sensor:
        reported = sense(some, reported, solved.rotation)
    position, rotation = solved.position, solved.rotation
    for see in scenario.instrument:
        position, rotation = see(some, position, rotation)
    link = some.q + seen + _own_motion(scenario, solved.theta)
    return Reading(position, rotation, reported, link, solved.torque + extra, solved.theta)


def predict_rows(scenario: Scenario, rows: Rows, reported: Array, select: np.ndarray | None = None) -> Reading:
    """Simulate the rows with the wrench that the sensor reported taken for true."""
    wrench = np.zeros_like(rows.wrench)
    wrench[np.arange(len(rows.q)) if select is None else select] = reported
    return simulate_rows(scenario, replace(rows, wrench=wrench), select)


def rotation_step(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector. Shape (3, 3)."""
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())
