"""The vocabulary of the diagnosis as columns of a least squares: what one unit of an effect moves, to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.rival.chain import Array, Chain, Posed, dot, load_chain, spring_torque
from benchmarks.rival.log import Log


@dataclass(frozen=True)
class Spec:
    """One effect at one place, with what selects its shape.

    Attributes:
        effect: Name in the vocabulary.
        joint: Place, or None.
        axis: Axis, or None.
        shape: Numbers or words that its columns need: a frequency, a row, another joint.
        tried: How many shapes were tried for it (their price is the logarithm).
    """

    effect: str
    joint: str | None = None
    axis: str | None = None
    shape: tuple[float | str, ...] = ()
    tried: int = 1

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Effect, joint and axis."""
        return self.effect, self.joint, self.axis


@dataclass(frozen=True, eq=False)
class Scene:
    """A chain posed at the rows of a log, ready for columns.

    Attributes:
        chain: The robot.
        log: The rows.
        q: Readings, conventions corrected. Shape (n, nq).
        posed: The loaded chain.
        cold: Temperature that growth counts from; None for the log's first.
        later: Whether shifts happened before the first row.
        gravity: What loads the chain. [m/s^2]
    """

    chain: Chain
    log: Log
    q: Array
    posed: Posed
    cold: float | None
    later: bool
    gravity: Array


def stage(
    chain: Chain, log: Log, q: Array, sagging: bool, cold: float | None = None, later: bool = False
) -> Scene:  # fmt: skip
    """Pose the chain at the rows of a log; `sagging`: weights load it even where the folder leaves them out."""
    gravity = chain.gravity if chain.has_gravity or sagging else np.zeros(3)
    return Scene(chain, log, q, load_chain(chain, q, log.wrench, gravity), cold, later, gravity)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the target for each of k parameters: position (n, 3, k), rotation (n, 3, k), encoders (n, nq, k)."""

    position: Array
    rotation: Array
    encoder: Array


class Columns:
    """Columns of every effect over one scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.n, self.nq = scene, len(scene.q), len(scene.chain.joints)
        posed, segments = scene.posed, scene.chain.segments
        self.reading = []
        for j in range(self.nq):
            parts = [(s, g) for s, g in enumerate(segments) if g.reading == j]
            moves = [self.move(posed.axis[s], posed.origin[s], g.kind != "prismatic") for s, g in parts]
            gains = [g.gain for _, g in parts]
            self.reading.append(sum((g * m for g, m in zip(gains, moves, strict=True)), np.zeros((self.n, 6))))
        self.springs = [
            (s, k, spring, self.move(*posed.springs[s][k], spring.turns), spring_torque(posed, s, k))
            for s, segment in enumerate(segments)
            for k, spring in enumerate(segment.springs)
        ]  # fmt: skip
        self.known = {name: k for k, name in enumerate(scene.chain.joints)}

    def move(self, axis: Array, place: Array, turns: bool = True) -> Array:
        """Return what the tip does for one unit about (along) an axis. Shape (n, 6)."""
        if not turns:
            return np.hstack([axis, np.zeros_like(axis)])
        return np.hstack([np.cross(axis, self.scene.posed.tip - place), axis])

    def own(self, joint: int) -> list[tuple[float, Array, Array]]:
        """Compliance, move and torque of a joint's own springs."""
        name = self.scene.chain.joints[joint]
        return [
            (spring.compliance, move, torque)
            for s, _, spring, move, torque in self.springs
            if spring.own and self.scene.chain.segments[s].name == name
        ]

    def motion(self, columns: list[Array], encoders: list[Array] | None = None) -> Motion:
        """Stack moves (n, 6) and encoder columns (n, nq)."""
        moves = np.stack(columns, axis=2)
        seen = np.zeros((self.n, self.nq, len(columns))) if encoders is None else np.stack(encoders, axis=2)
        return Motion(moves[:, :3], moves[:, 3:], seen)

    def of_reading(self, joint: int, values: list[Array], seen: bool) -> Motion:
        """Return the motion of a joint by values (n,), which its link-side encoder shows or not."""
        marks = [np.eye(self.nq)[joint] * v[:, None] * seen for v in values]
        return self.motion([self.reading[joint] * v[:, None] for v in values], marks)

    def bent(self, extra: list[list[Array]]) -> Motion:
        """Return the motion when every spring carries more torque: a list of (n, 1) a spring, for each parameter."""
        moves, marks = [], []
        for torques in extra:
            move, mark = np.zeros((self.n, 6)), np.zeros((self.n, self.nq))
            for (s, _, spring, jacobian, _), torque in zip(self.springs, torques, strict=True):
                move += spring.compliance * torque * jacobian
                name = self.scene.chain.segments[s].name
                if spring.own and name in self.known:
                    mark[:, self.known[name]] += spring.compliance * torque[:, 0]
            moves.append(move)
            marks.append(mark)
        return self.motion(moves, marks)

    def of(self, spec: Spec) -> Motion:
        """Return the columns of an effect."""
        return getattr(self, f"_{spec.effect}")(spec)  # type: ignore[no-any-return]

    # --- what bends ---

    def _joint_stiffness(self, spec: Spec) -> Motion:
        return self._of_torque(spec, [lambda t: t])

    def _stiffness_nonlinearity(self, spec: Spec) -> Motion:
        word, size = spec.shape
        size = float(size)
        laws = {
            "cubic": lambda t: t * (t / size) ** 2,
            "soft": lambda t: t * (t / size) ** 2 / (1.0 + (t / size) ** 2),
            "zone": lambda t: np.clip(t, -size, size),
        }
        return self._of_torque(spec, [lambda t: t, laws[str(word)]])

    def _of_torque(self, spec: Spec, laws: list) -> Motion:  # type: ignore[type-arg]
        joint = self.known[str(spec.joint)]
        own = self.own(joint)
        if not own:
            torque = self.torque_of_reading(joint)
            own = [(1e-6, self.reading[joint], torque)]
        moves = [sum((c * law(t) * m for c, m, t in own), np.zeros((self.n, 6))) for law in laws]
        marks = [np.eye(self.nq)[joint] * sum(c * law(t) for c, _, t in own) for law in laws]
        return self.motion(moves, marks)

    def torque_of_reading(self, joint: int, wrench: bool = True) -> Array:
        """Return the torque about a joint's axis. Shape (n, 1)."""
        posed, name = self.scene.posed, self.scene.chain.joints[joint]
        s = next(i for i, g in enumerate(self.scene.chain.segments) if g.name == name)
        force, moment = posed.force[s], posed.moment[s]
        if not wrench:
            w = self.scene.log.wrench
            force, moment = force - w[:, :3], moment - w[:, 3:] - np.cross(posed.tip, w[:, :3])
        if self.scene.chain.segments[s].kind == "prismatic":
            return dot(posed.axis[s], force)
        return dot(posed.axis[s], moment - np.cross(posed.origin[s], force))

    def _link_compliance(self, spec: Spec) -> Motion:
        s = next(i for i, g in enumerate(self.scene.chain.segments) if g.name == spec.joint)
        posed, axis, turns = self.scene.posed, str(spec.axis), str(spec.axis)[0] == "r"
        direction = posed.child[s][:, :, "xyz".index(axis[1])]
        place = self._behind(s)
        force, moment = posed.force[s], posed.moment[s]
        torque = dot(direction, moment - np.cross(place, force)) if turns else dot(direction, force)
        return self.motion([1e-6 * torque * self.move(direction, place, turns)])

    def _behind(self, s: int) -> Array:
        segment, posed = self.scene.chain.segments[s], self.scene.posed
        if segment.kind != "prismatic":
            return posed.origin[s]
        value = segment.gain * self.scene.q[:, segment.reading] + segment.zero
        return np.asarray(posed.origin[s] + posed.axis[s] * value[:, None])

    def _base_compliance(self, spec: Spec) -> Motion:
        direction = np.tile(np.eye(3)["xyz".index(str(spec.axis)[1])], (self.n, 1))
        torque = dot(direction, self.scene.posed.moment[0])
        return self.motion([1e-6 * torque * self.move(direction, np.zeros((self.n, 3)))])

    def _gravity_sag(self, spec: Spec) -> Motion:
        if not self.springs:
            parts = [1e-6 * self.torque_of_reading(j, wrench=False) * self.reading[j] for j in range(self.nq)]
            return self.motion([p for p in parts if np.abs(p).max() > 1e-9])
        extra = []
        for s, k, spring, _, _ in self.springs:
            force = np.zeros((self.n, 3))
            moment = np.zeros((self.n, 3))
            for g, centre in zip(self.scene.chain.segments[s:], self.scene.posed.centres[s:], strict=True):
                weight = np.tile(g.mass * self.scene.chain.gravity, (self.n, 1))
                force, moment = force + weight, moment + np.cross(centre, weight)
            extra.append(self._twist_on(s, k, spring.turns, force, moment))
        return self.bent([extra])

    def _twist_on(self, s: int, k: int, turns: bool, force: Array, moment: Array) -> Array:
        axis, place = self.scene.posed.springs[s][k]
        return dot(axis, moment - np.cross(place, force)) if turns else dot(axis, force)

    def _loaded(self, force: Array, moment: Array, beyond: int = 10_000) -> list[Array]:
        """Torque on every spring before a segment from a force and its moment about the base origin."""
        zero = np.zeros((self.n, 1))
        return [
            self._twist_on(s, k, spring.turns, force, moment) if s <= beyond else zero
            for s, k, spring, _, _ in self.springs
        ]

    def _payload(self, spec: Spec) -> Motion:
        segments, posed = self.scene.chain.segments, self.scene.posed
        s = max(i for i, g in enumerate(segments) if g.mass > 0.0 or i == len(segments) - 1)
        weight = np.tile(self.scene.chain.gravity, (self.n, 1))
        parts = [self._loaded(weight, np.cross(posed.centres[s], weight), s)]
        zero = np.zeros((self.n, 3))
        parts += [self._loaded(zero, np.cross(posed.child[s][:, :, k], weight), s) for k in range(3)]
        return self.bent(parts)

    def _gravity_compensator(self, spec: Spec) -> Motion:
        joint = self.known[str(spec.joint)]
        angle = self.scene.q[:, joint]
        own = self.own(joint) or [(1e-6, self.reading[joint], angle[:, None])]
        values = [np.sin(angle), np.cos(angle)]
        moves = [sum((1e3 * c * v[:, None] * m for c, m, _ in own), np.zeros((self.n, 6))) for v in values]
        return self.motion(moves, [np.eye(self.nq)[joint] * (1e3 * own[0][0] * v)[:, None] for v in values])

    def _wrench_bias(self, spec: Spec) -> Motion:
        parts, tip = [], self.scene.posed.tip
        for k in range(6):
            unit = np.tile(np.eye(3)[k % 3], (self.n, 1))
            if spec.shape[0] == "sensor":
                unit = self.scene.posed.attitude[:, :, k % 3]
            force, moment = (unit, np.cross(tip, unit)) if k < 3 else (np.zeros_like(unit), unit)
            parts.append([-t for t in self._loaded(force, moment)])
        return self.bent(parts)

    def _wrench_scale(self, spec: Spec) -> Motion:
        w, tip = self.scene.log.wrench, self.scene.posed.tip
        return self.bent([self._loaded(-w[:, :3], -w[:, 3:] - np.cross(tip, w[:, :3]))])

    # --- geometry and frames ---

    def _joint_offset(self, spec: Spec) -> Motion:
        return self.of_reading(self.known[str(spec.joint)], [np.ones(self.n)], seen=False)

    def _link_geometry(self, spec: Spec) -> Motion:
        s = next(i for i, g in enumerate(self.scene.chain.segments) if g.name == spec.joint)
        posed, axis = self.scene.posed, str(spec.axis)
        direction = posed.parent[s][:, :, "xyz".index(axis[1])]
        return self.motion([self.move(direction, posed.origin[s], axis[0] == "r")])

    def _tool_frame(self, spec: Spec) -> Motion:
        return self._at_tool(np.ones(self.n, bool))

    def _at_tool(self, active: np.ndarray) -> Motion:
        axes, tip = self.scene.posed.attitude, self.scene.posed.tip
        moves = [self.move(axes[:, :, k], tip, turns=False) for k in range(3)]
        if self.scene.log.attitude is not None:
            moves += [self.move(axes[:, :, k], tip) for k in range(3)]
        return self.motion([m * active[:, None] for m in moves])

    def _base_frame(self, spec: Spec) -> Motion:
        return self._at_base(np.ones(self.n, bool))

    def _at_base(self, active: np.ndarray) -> Motion:
        units = [np.tile(np.eye(3)[k], (self.n, 1)) for k in range(3)]
        centre = np.zeros((self.n, 3))
        moves = [self.move(u, centre, turns) for turns in (False, True) for u in units]
        return self.motion([m * active[:, None] for m in moves])

    def _since(self, spec: Spec) -> np.ndarray:
        return np.asarray((np.arange(self.n) >= float(spec.shape[0])) | self.scene.later)

    def _frame_shift(self, spec: Spec) -> Motion:
        return self._at_base(self._since(spec))

    def _tool_shift(self, spec: Spec) -> Motion:
        return self._at_tool(self._since(spec))

    def _thermal_drift(self, spec: Spec) -> Motion:
        segments, posed = self.scene.chain.segments, self.scene.posed
        moving = [i for i, g in enumerate(segments) if g.kind != "fixed"]
        grown = np.zeros((self.n, 3))
        for s in [*moving, moving[-1] + 1]:
            if s < len(segments):
                grown = grown + posed.parent[s] @ segments[s].place
        rise = self._rise(spec)
        return self.motion([1e-5 * np.hstack([grown * rise[:, None], np.zeros((self.n, 3))])])

    def _rise(self, spec: Spec) -> Array:
        log = self.scene.log
        if spec.shape and log.timed:
            return np.asarray(10.0 * (1.0 - np.exp(-(log.time - log.time[0]) / float(spec.shape[0]))))
        heat = log.heat if log.heat is not None else np.zeros(self.n)
        good = np.isfinite(heat)
        heat = np.interp(np.arange(self.n), np.flatnonzero(good), heat[good]) if good.any() else np.zeros(self.n)
        return np.asarray(heat - (np.mean(heat[:3]) if self.scene.cold is None else self.scene.cold))

    # --- gears, motion, readings ---

    def _backlash(self, spec: Spec) -> Motion:
        joint = self.known[str(spec.joint)]
        return self.of_reading(joint, [-0.5 * direction_of(self.scene.q[:, joint])], seen=True)

    def _transmission_error(self, spec: Spec) -> Motion:
        joint = self.known[str(spec.joint)]
        phase = float(spec.shape[0]) * self.scene.q[:, joint]
        return self.of_reading(joint, [np.sin(phase), np.cos(phase)], seen=True)

    def speed(self, joint: int) -> Array:
        """Speed of a joint in path runs, zero elsewhere. Shape (n,). [rad/s]"""
        log, out = self.scene.log, np.zeros(self.n)
        for label in dict.fromkeys(log.run[log.moving]):
            k = np.flatnonzero(log.run == label)
            if len(k) > 2 and np.all(np.diff(log.time[k]) > 0.0):
                out[k] = np.gradient(self.scene.q[k, joint], log.time[k])
        return np.nan_to_num(out)

    def _tracking_lag(self, spec: Spec) -> Motion:
        joints = range(self.nq) if spec.joint is None else [self.known[spec.joint]]
        moves = sum((self.reading[j] * -self.speed(j)[:, None] for j in joints), np.zeros((self.n, 6)))
        mark = np.zeros((self.n, self.nq))
        for j in joints:
            mark[:, j] = -self.speed(j)
        return self.motion([moves], [mark])

    def _time_skew(self, spec: Spec) -> Motion:
        moves = sum((self.reading[j] * -self.speed(j)[:, None] for j in range(self.nq)), np.zeros((self.n, 6)))
        return self.motion([moves])

    def _joint_coupling(self, spec: Spec) -> Motion:
        joint, other = self.known[str(spec.joint)], self.known[str(spec.shape[0])]
        return self.of_reading(joint, [self.scene.q[:, other]], seen=False)


def direction_of(reading: Array) -> Array:
    """Return the direction of the last move, 0 before the first. Shape (n,)."""
    out, last = np.zeros(len(reading)), 0.0
    for k in range(1, len(reading)):
        step = reading[k] - reading[k - 1]
        if abs(step) > 1e-7:
            last = float(np.sign(step))
        out[k] = last
    return out


def rotation_gap(measured: Array, model: Array) -> Array:
    """Return the turn from model to measured axes, base axes. Shape (n, 3). [rad]"""
    out = np.full((len(model), 3), np.nan)
    good = np.isfinite(measured).all(axis=(1, 2))
    out[good] = Rotation.from_matrix(measured[good] @ model[good].transpose(0, 2, 1)).as_rotvec()
    return out
