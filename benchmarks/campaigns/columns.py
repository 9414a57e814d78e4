"""What every effect of the vocabulary can do to a campaign, to first order, from one solved pose of the engine each.

The loaded bodies of every row are placed once by MuJoCo. A small turn or slide anywhere in the chain moves the TCP by
axis x lever or along the axis; a compliance there moves it by that times the load which the engine's bodies put on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from benchmarks.campaigns.description import SPRING_AXES, Array
from benchmarks.campaigns.effects import lagged, path_runs, play
from benchmarks.campaigns.engine import ElasticModel
from benchmarks.campaigns.machines import Machine
from benchmarks.campaigns.simulate import Rows, Scenario, simulate_rows

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True)
class Signature:
    """What an effect can do to the readings.

    Args:
        effect: Name in the vocabulary.
        joint: Joint, or None.
        axis: Axis, or None.
        columns: Displacement and turn of the TCP for every parameter. Shape (n, 6, n_parameters). [m, rad]
    """

    effect: str
    joint: str | None
    axis: str | None
    columns: Array


@dataclass(frozen=True)
class Placed:
    """The loaded nominal robot on chosen rows.

    Args:
        machine: The robot.
        nominal: The robot as a scenario.
        rows: The whole plan.
        select: Chosen rows. Shape (n,).
    """

    machine: Machine
    nominal: Scenario
    rows: Rows
    select: np.ndarray

    @cached_property
    def bodies(self) -> tuple[Array, Array, Array]:
        """Positions, rotations and centres of mass of all bodies. Shapes (n, nb, 3), (n, nb, 3, 3), (n, nb, 3)."""
        theta = simulate_rows(self.nominal, self.rows, self.select).theta
        model, q = self.model, self.rows.q[self.select]
        found: list[tuple[Array, Array, Array]] = []
        for k in range(len(q)):
            model.place(q[k : k + 1], theta[k : k + 1], None)
            mujoco.mj_kinematics(model.model, model.data)
            turn = model.data.xmat.reshape(-1, 3, 3).copy()
            found.append((model.data.xpos.copy(), turn, model.data.xipos.copy()))
        at, turned, weight = zip(*found, strict=True)
        return np.array(at), np.array(turned), np.array(weight)

    @cached_property
    def model(self) -> ElasticModel:
        """The engine's model."""
        return ElasticModel(self.nominal.description, self.nominal.springs)

    @cached_property
    def tip(self) -> Array:
        """TCP positions. Shape (n, 3). [m]"""
        return np.asarray(self.bodies[0][:, -1])

    @property
    def wrench(self) -> Array:
        """Wrench on the tool. Shape (n, 6). [N, N m]"""
        return np.asarray(self.rows.wrench[self.select])

    def move(self, point: Array, axis: Array, turning: bool) -> Array:
        """Return what a unit turn about (or slide along) an axis through a point does to the TCP. Shape (n, 6)."""
        if turning:
            return np.concatenate([np.cross(axis, self.tip - point), axis], axis=1)
        return np.concatenate([axis, np.zeros_like(axis)], axis=1)

    def load(self, body: int, point: Array, axis: Array, turning: bool, wrench: Array, gravity: Array) -> Array:
        """Return the generalised load on such a motion from a wrench at the TCP and weights behind. Shape (n,)."""
        mass = np.array(self.model.model.body_mass)[body:]
        force = wrench[:, :3] + mass.sum() * gravity
        if not turning:
            return np.asarray(np.einsum("ni,ni->n", axis, force))
        arm = np.einsum("b,nbi->ni", mass, self.bodies[2][:, body:]) - mass.sum() * point
        moment = np.cross(self.tip - point, wrench[:, :3]) + wrench[:, 3:] + np.cross(arm, gravity)
        return np.asarray(np.einsum("ni,ni->n", axis, moment))

    def link_frame(self, segment: int) -> tuple[int, Array, Array]:
        """Return body, origin and rotation of a segment's child frame."""
        body = int(self.model.last_body[segment])
        return body, self.bodies[0][:, body], self.bodies[1][:, body]

    @cached_property
    def springs(self) -> list[tuple[Array, int, Array, Array, bool, float]]:
        """Motion, body, point, axis, kind and compliance of every nominal spring."""
        found = []
        robot = self.nominal.description
        for spring, compliance in zip(self.nominal.springs, self.nominal.compliance, strict=True):
            segment = robot.segments[robot.index_of(spring.joint)]
            body, origin, turn = self.link_frame(robot.index_of(spring.joint))
            turning = segment.kind == "revolute" if spring.axis == "own" else SPRING_AXES[spring.axis][0] == 1
            local = segment.axis if spring.axis == "own" else SPRING_AXES[spring.axis][1]
            axis, point = turn @ np.array(local), origin + turn @ np.array(spring.offset)
            found.append((self.move(point, axis, turning), body, point, axis, turning, float(compliance)))
        return found

    def yielding(self, wrench: Array, gravity: Array) -> Array:
        """Return how the nominal springs yield to a wrench at the TCP and a change of gravity. Shape (n, 6)."""
        out = np.zeros((len(self.select), 6))
        for motion, body, point, axis, turning, compliance in self.springs:
            out += motion * (compliance * self.load(body, point, axis, turning, wrench, gravity))[:, None]
        return out

    def own_motion(self, joint: str) -> Array:
        """Return what a joint's own motion does to the TCP, its followers moving along. Shape (n, 6)."""
        robot = self.nominal.description
        out = np.zeros((len(self.select), 6))
        for index, segment in enumerate(robot.segments):
            factor = 1.0 if segment.joint == joint else 0.0
            if segment.mimic is not None and segment.mimic[0] == joint:
                factor = segment.mimic[1]
            if factor:
                _, origin, turn = self.link_frame(index)
                out += factor * self.move(origin, turn @ np.array(segment.axis), segment.kind == "revolute")
        return out


def list_signatures(placed: Placed, shift_times: list[float]) -> list[Signature]:
    """Return the signatures of the whole vocabulary.

    Args:
        placed: The loaded robot.
        shift_times: Times at which shifts are tried. [s]
    """
    found = [*_elastic(placed), *_geometric(placed), *_motions(placed), *_sensors(placed)]
    base = next(s.columns for s in found if s.effect == "base_frame")
    tool = next(s.columns for s in found if s.effect == "tool_frame")
    for t in shift_times:
        on = (placed.rows.time[placed.select] >= t - 1e-9)[:, None, None]
        found.append(Signature("frame_shift", None, None, base * on))
        found.append(Signature("tool_shift", None, None, tool * on))
    return found


def _column(*moves: Array) -> Array:
    return np.stack(moves, axis=2)


def _elastic(p: Placed) -> Iterator[Signature]:
    nominal, robot = p.nominal, p.nominal.description
    gravity = np.zeros(3) if robot.gravity is None else np.array(robot.gravity)
    for joint in robot.joint_names:
        index = robot.index_of(joint)
        segment = robot.segments[index]
        body, origin, turn = p.link_frame(index)
        own = nominal.own_springs(joint)
        if own:
            axis, turning = turn @ np.array(segment.axis), segment.kind == "revolute"
            move = p.move(origin, axis, turning)
            torque = p.load(body, origin, axis, turning, p.wrench, gravity)
            c = float(nominal.compliance[own[0]])
            yield Signature("joint_stiffness", joint, None, _column(move * (c * torque)[:, None]))
            size = float(np.sqrt(np.mean(torque**2))) + 1e-9
            u = torque / size
            curves = [u, np.clip(u, -0.3, 0.3), u**3 / (1.0 + u**2)]
            yield Signature("stiffness_nonlinearity", joint, None, _column(*[move * v[:, None] for v in curves]))
            angle = p.rows.q[p.select, robot.joint_names.index(joint)]
            if p.machine.balanced == joint:
                waves = [move * (c * f(angle))[:, None] for f in (np.cos, np.sin)]
                yield Signature("gravity_compensator", joint, None, _column(*waves))
        for axis_name in AXES:
            local = np.array(SPRING_AXES[axis_name][1])
            turning = axis_name[0] == "r"
            if (turning == (segment.kind == "revolute")) and abs(float(local @ np.array(segment.axis))) > 1 - 1e-9:
                continue
            axis = turn @ local
            load = p.load(body, origin, axis, turning, p.wrench, gravity)
            yield Signature("link_compliance", joint, axis_name, _column(p.move(origin, axis, turning) * load[:, None]))
    first, ground, turn = p.link_frame(0)
    for k, axis_name in enumerate(AXES[3:]):
        axis = np.broadcast_to(np.eye(3)[k], ground.shape)
        load = p.load(first, ground, axis, True, p.wrench, gravity)
        yield Signature("base_compliance", None, axis_name, _column(p.move(ground, axis, True) * load[:, None]))
    yield from _weights(p, gravity)


def _weights(p: Placed, gravity: Array) -> Iterator[Signature]:
    """Payload: mass and moment of mass at the tool; gravity where the model has none."""
    robot = p.nominal.description
    none = np.zeros_like(p.wrench)
    if robot.gravity is None:
        yield Signature("gravity_sag", None, None, _column(p.yielding(none, np.array([0.0, 0.0, -9.81]))))
        return
    _, _, turn = p.link_frame(len(robot.segments) - 2)
    tool = robot.segments[-2]
    arm = p.bodies[0][:, int(p.model.last_body[-2])] + turn @ np.array(tool.com) - p.tip
    columns = []
    for k in range(4):
        wrench = none.copy()
        lever = arm if k == 0 else turn[:, :, k - 1]
        if k == 0:
            wrench[:, :3] = gravity
        wrench[:, 3:] = np.cross(lever, gravity)
        columns.append(p.yielding(wrench, np.zeros(3)))
    yield Signature("payload", None, None, _column(*columns))


def _geometric(p: Placed) -> Iterator[Signature]:
    robot = p.nominal.description
    for joint in robot.joint_names:
        index = robot.index_of(joint)
        _, before, turn = p.link_frame(index - 1)
        origin = before + turn @ np.array(robot.segments[index].xyz)
        moves = [p.move(origin, turn[:, :, k % 3], k > 2) for k in range(6)]
        for axis, move in zip(AXES, moves, strict=True):
            yield Signature("link_geometry", joint, axis, _column(move))
    ends = p.bodies[1][:, -1]
    eye = np.eye(3)
    zero = np.zeros_like(p.tip)
    base = [p.move(zero, np.broadcast_to(eye[k % 3], zero.shape), k > 2) for k in range(6)]
    yield Signature("base_frame", None, None, _column(*base))
    yield Signature("tool_frame", None, None, _column(*[p.move(p.tip, ends[:, :, k % 3], k > 2) for k in range(6)]))
    grown = np.zeros((len(p.select), 6))
    rise = p.rows.rise[p.select]
    for index, segment in enumerate(robot.segments):
        if segment.moves or segment.joint == "tool_mount":
            grown[:, :3] += p.link_frame(index - 1)[2] @ np.array(segment.xyz)
    yield Signature("thermal_drift", None, None, _column(grown * rise[:, None]))


def _motions(p: Placed) -> Iterator[Signature]:
    """Signatures that are the one of a joint's own motion times something known for every row."""
    robot, rows, pick = p.nominal.description, p.rows, p.select
    runs = path_runs(rows)
    together, speed_of_all = np.zeros((len(pick), 6)), np.zeros((len(pick), 6))
    for j, joint in enumerate(robot.joint_names):
        own, q = p.own_motion(joint), rows.q[:, j]
        yield Signature("joint_offset", joint, None, _column(own))
        for start in (-0.5, 0.5):
            lost = (play(q, 1e-4, start) - q) / 1e-4
            yield Signature("backlash", joint, None, _column(own * lost[pick, None]))
        scale = 1.0 if robot.segments[robot.index_of(joint)].kind == "revolute" else 60.0
        for n in (1.0, 2.0):
            waves = [own * f(n * scale * q[pick])[:, None] for f in (np.cos, np.sin)]
            yield Signature("transmission_error", joint, None, _column(*waves))
        for other in range(len(robot.joint_names)):
            if other != j and abs(other - j) < 3:
                yield Signature("joint_coupling", joint, None, _column(own * rows.q[pick, other, None]))
        if runs:
            behind, speed = np.zeros(len(q)), np.zeros(len(q))
            for k in runs:
                behind[k] = (lagged(rows.time[k], q[k], 0.01) - q[k]) / 0.01
                speed[k] = np.gradient(q[k], rows.time[k])
            yield Signature("tracking_lag", joint, None, _column(own * behind[pick, None]))
            together += own * behind[pick, None]
            speed_of_all += own * speed[pick, None]
    if runs:
        yield Signature("tracking_lag", None, None, _column(together))
        yield Signature("time_skew", None, None, _column(speed_of_all))


def _sensors(p: Placed) -> Iterator[Signature]:
    if not np.any(p.rows.wrench):
        return
    ends, none = p.bodies[1][:, -1], np.zeros(3)
    for local in (True, False):
        columns = []
        for k in range(6):
            wrench = np.zeros_like(p.wrench)
            part = slice(0, 3) if k < 3 else slice(3, 6)
            wrench[:, part] = ends[:, :, k % 3] if local else np.eye(3)[k % 3]
            columns.append(p.yielding(wrench, none))
        yield Signature("wrench_bias", None, None, _column(*columns))
    yield Signature("wrench_scale", None, None, _column(p.yielding(p.wrench, none)))
