"""A posed robot, and what each of its parts moves: the ground that the columns of the rival stand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.rival.chain import Array, Chain, Posed, dot, load_chain, spring_torque
from benchmarks.rival.log import Log


@dataclass(frozen=True)
class Spec:
    """One effect at one place, with what selects its shape."""

    effect: str  #: Name in the vocabulary.
    joint: str | None = None  #: Place, or None.
    axis: str | None = None  #: Axis, or None.
    shape: tuple[float | str, ...] = ()  #: Numbers or words that its columns need: a frequency, a row, another joint.
    tried: int = 1  #: How many shapes were tried for it (their price is the logarithm).

    @property
    def place(self) -> tuple[str, str | None, str | None]:
        """Effect, joint and axis."""
        return self.effect, self.joint, self.axis


@dataclass(frozen=True, eq=False)
class ForwardModel:
    """A chain posed at the rows of a log, ready for columns."""

    chain: Chain  #: The robot.
    log: Log  #: The rows.
    q: Array  #: Readings, conventions corrected. Shape (n, nq).
    posed: Posed  #: The loaded chain.
    cold: float | None  #: Temperature that growth counts from; None for the log's first.
    later: bool  #: Whether shifts happened before the first row.
    gravity: Array  #: What loads the chain. [m/s^2]


def stage(
    chain: Chain, log: Log, q: Array, sagging: bool, cold: float | None = None, later: bool = False
) -> ForwardModel:  # fmt: skip
    """Pose the chain at the rows of a log; `sagging`: weights load it even where the folder leaves them out."""
    gravity = chain.gravity if chain.has_gravity or sagging else np.zeros(3)
    return ForwardModel(chain, log, q, load_chain(chain, q, log.wrench, gravity), cold, later, gravity)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the target for each of k parameters: position (n, 3, k), rotation (n, 3, k), encoders (n, nq, k)."""

    position: Array
    rotation: Array
    encoder: Array


class Moves:
    """What every joint and spring of a scene moves."""

    def __init__(self, scene: ForwardModel) -> None:
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

    def behind(self, s: int) -> Array:
        segment, posed = self.scene.chain.segments[s], self.scene.posed
        if segment.kind != "prismatic":
            return posed.origin[s]
        value = segment.gain * self.scene.q[:, segment.reading] + segment.zero
        return np.asarray(posed.origin[s] + posed.axis[s] * value[:, None])

    def twist_on(self, s: int, k: int, turns: bool, force: Array, moment: Array) -> Array:
        axis, place = self.scene.posed.springs[s][k]
        return dot(axis, moment - np.cross(place, force)) if turns else dot(axis, force)

    def loaded(self, force: Array, moment: Array, beyond: int = 10_000) -> list[Array]:
        """Torque on every spring before a segment from a force and its moment about the base origin."""
        zero = np.zeros((self.n, 1))
        return [
            self.twist_on(s, k, spring.turns, force, moment) if s <= beyond else zero
            for s, k, spring, _, _ in self.springs
        ]
