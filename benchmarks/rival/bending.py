"""The columns of what bends: springs, links, weights, and loads that are not as read."""

from __future__ import annotations

import numpy as np

from benchmarks.rival.chain import dot
from benchmarks.rival.scene import Motion, Moves, Spec


class Bending(Moves):
    """Columns of the effects that bend the robot."""

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

    def _link_compliance(self, spec: Spec) -> Motion:
        s = next(i for i, g in enumerate(self.scene.chain.segments) if g.name == spec.joint)
        posed, axis, turns = self.scene.posed, str(spec.axis), str(spec.axis)[0] == "r"
        direction = posed.child[s][:, :, "xyz".index(axis[1])]
        place = self.behind(s)
        force, moment = posed.force[s], posed.moment[s]
        torque = dot(direction, moment - np.cross(place, force)) if turns else dot(direction, force)
        return self.motion([1e-6 * torque * self.move(direction, place, turns)])

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
            extra.append(self.twist_on(s, k, spring.turns, force, moment))
        return self.bent([extra])

    def _payload(self, spec: Spec) -> Motion:
        segments, posed = self.scene.chain.segments, self.scene.posed
        s = max(i for i, g in enumerate(segments) if g.mass > 0.0 or i == len(segments) - 1)
        weight = np.tile(self.scene.chain.gravity, (self.n, 1))
        parts = [self.loaded(weight, np.cross(posed.centres[s], weight), s)]
        zero = np.zeros((self.n, 3))
        parts += [self.loaded(zero, np.cross(posed.child[s][:, :, k], weight), s) for k in range(3)]
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
            parts.append([-t for t in self.loaded(force, moment)])
        return self.bent(parts)

    def _wrench_scale(self, spec: Spec) -> Motion:
        w, tip = self.scene.log.wrench, self.scene.posed.tip
        return self.bent([self.loaded(-w[:, :3], -w[:, 3:] - np.cross(tip, w[:, :3]))])
