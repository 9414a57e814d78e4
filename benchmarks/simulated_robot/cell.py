"""The cell: MuJoCo's bodies of an arm, its springs as hinges and slides, brought to rest under weight and wrench."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np

from benchmarks.simulated_robot.robot import STANDARD_GRAVITY, Arm, Array, Joint, Mass

ROUNDS = 200
AT_REST = 1e-13
MOST_MOTIONS = 6


@dataclass(frozen=True)
class Rest:
    """Tip and orientation at rest, shapes (n, 3) [m] and (n, 3, 3); `settled` is False where no rest was found."""

    position: Array
    rotation: Array
    settled: np.ndarray


class SimulatedRobot:
    """An arm in MuJoCo. Commanded joints are set, elastic ones (6x6 links with their coupling) come to rest.

    theta = C (J^T w + weight [- inertia]) is iterated until it stands still; it holds exactly there, whatever the load.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        names = [joint.name for joint in arm.commanded]
        self._drive: list[tuple[int, float, float]] = []  # of each set coordinate: commanded joint, multiplier, offset
        self._set: list[int] = []
        self._elastic: list[int] = []
        self._blocks: list[Array] = []
        root = ElementTree.Element("mujoco")
        ElementTree.SubElement(
            root, "compiler", angle="radian", boundmass="1e-12", boundinertia="1e-12", balanceinertia="true"
        )
        ElementTree.SubElement(root, "option", gravity=_text(np.zeros(3) if arm.gravity is None else arm.gravity))
        self._place, self._coordinates = ElementTree.SubElement(root, "worldbody"), 0
        self._load(arm, arm.base)
        waiting: list[Array] = []  # elasticities of the link before, at its far end
        for joint in arm.joints:
            self._nest(joint.pose)
            for block in waiting:
                self._add_block(block)
            if joint.kind != "fixed":
                driver, multiplier, offset = joint.follows or (joint.name, 1.0, 0.0)
                self._drive.append((names.index(driver), multiplier, offset))
                self._set.append(self._add(joint.axis, joint.slides))
            for spring in arm.springs.get(joint.name, []):
                self._elastic.append(self._add(spring.axis, spring.slides, spring.offset))
                self._blocks.append(np.array([[spring.compliance]]))
            waiting = arm.elasticities.get(joint.child, [])
            self._load(arm, joint.child)
        if waiting:  # the last link: its own frame
            self._nest(np.eye(4))
            for block in waiting:
                self._add_block(block)
        self._place.set("name", "tip")
        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)
        self.tip = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "tip")
        size = sum(len(block) for block in self._blocks)
        self.compliance, at = np.zeros((size, size)), 0
        for block in self._blocks:
            self.compliance[at : at + len(block), at : at + len(block)] = block
            at += len(block)
        self.elastic, self.set = np.array(self._elastic, int), np.array(self._set, int)
        self.driver = np.array([row[0] for row in self._drive], int)
        self.multiplier = np.array([row[1] for row in self._drive])
        self.offset = np.array([row[2] for row in self._drive])
        body_of = mujoco.mjtObj.mjOBJ_BODY
        self.carrier = {m.link: mujoco.mj_name2id(self.model, body_of, f"at {m.link}") for m in arm.weights}

    def rest(
        self, q: Array, wrench: Array, *, weights: bool = True, rate: Array | None = None, change: Array | None = None
    ) -> Rest:
        """Bring the arm to rest at every row.

        Args:
            q: Commanded joint positions. Shape (n, nq). [rad or m]
            wrench: Wrench of the environment on the tool at the tip, base axes. Shape (n, 6). [N, N m]
            weights: Whether a tool's weight loads an arm whose folder carries no gravity.
            rate: Joint velocities of the motion, whose inertia then loads the springs too. Shape (n, nq).
            change: Joint accelerations. Shape (n, nq).
        """
        model, data, n = self.model, self.data, len(q)
        position, rotation, settled = np.empty((n, 3)), np.empty((n, 3, 3)), np.ones(n, bool)
        bias, applied = np.zeros(model.nv), np.zeros(model.nv)
        heavy = bool(np.any(model.opt.gravity)) or rate is not None
        extra = self.arm.weights if weights else ()
        theta = np.zeros(len(self.elastic))
        values = q[:, self.driver] * self.multiplier + self.offset
        data.qvel[:], data.qacc[:] = 0, 0
        for i in range(n):
            data.qpos[self.set] = values[i]
            if rate is not None:
                data.qvel[self.set] = rate[i, self.driver] * self.multiplier
                data.qacc[self.set] = change[i, self.driver] * self.multiplier
            for _ in range(ROUNDS):
                data.qpos[self.elastic] = theta
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                if heavy:
                    if rate is not None:
                        mujoco.mj_comVel(model, data)
                    mujoco.mj_rne(model, data, int(rate is not None), bias)
                applied[:] = 0
                mujoco.mj_applyFT(model, data, wrench[i, :3], wrench[i, 3:], data.xpos[self.tip], self.tip, applied)
                for mass in extra:
                    self.weigh(mass, applied)
                new = self.compliance @ (applied - bias)[self.elastic]
                step = np.abs(new - theta).max(initial=0.0)
                theta = new
                if step < AT_REST or not np.isfinite(step):
                    break
            if not step < 1e-9:
                settled[i], theta = False, np.zeros(len(self.elastic))
            position[i], rotation[i] = data.xpos[self.tip], data.xmat[self.tip].reshape(3, 3)
        return Rest(position, rotation, settled)

    def torques(
        self, q: Array, wrench: Array, gravity: Array | None, rate: Array | None = None, change: Array | None = None
    ) -> Array:
        """Return the torques that hold the unbent arm, or move it: one a commanded joint, shape (n, nq) [N m or N]."""
        model, data = self.model, self.data
        before = model.opt.gravity.copy()
        model.opt.gravity[:] = 0 if gravity is None else gravity
        bias, applied = np.zeros(model.nv), np.zeros(model.nv)
        held = np.zeros(q.shape)
        data.qpos[:], data.qvel[:], data.qacc[:] = 0, 0, 0
        for i in range(len(q)):
            data.qpos[self.set] = q[i, self.driver] * self.multiplier + self.offset
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            if rate is not None and change is not None:
                data.qvel[self.set] = rate[i, self.driver] * self.multiplier
                data.qacc[self.set] = change[i, self.driver] * self.multiplier
                mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, int(rate is not None), bias)
            applied[:] = 0
            mujoco.mj_applyFT(model, data, wrench[i, :3], wrench[i, 3:], data.xpos[self.tip], self.tip, applied)
            if gravity is None:
                for mass in self.arm.weights:
                    self.weigh(mass, applied)
            np.add.at(held[i], self.driver, (bias - applied)[self.set] * self.multiplier)
        model.opt.gravity[:] = before
        return held

    def weigh(self, mass: Mass, applied: Array) -> None:
        """Add the weight of a mass that hangs on a link to generalised forces, where the bodies are now."""
        body = self.carrier[mass.link]
        point = self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ mass.centre
        mujoco.mj_applyFT(self.model, self.data, mass.mass * STANDARD_GRAVITY, np.zeros(3), point, body, applied)

    def _nest(self, pose: Array) -> None:
        self._place = ElementTree.SubElement(
            self._place, "body", pos=_text(pose[:3, 3]), quat=_text(_quaternion(pose[:3, :3]))
        )

    def _add(self, axis: Array, slides: bool, at: Array | None = None) -> int:
        """Add a motion to the present body, after those that it has (MuJoCo takes six); return its coordinate.

        The armature matters to no equilibrium; it keeps MuJoCo's mass matrix regular where a body has no mass.
        """
        if len(self._place.findall("joint")) == MOST_MOTIONS:
            self._nest(np.eye(4))
        place = {} if at is None or slides else {"pos": _text(at)}
        kind = "slide" if slides else "hinge"
        ElementTree.SubElement(self._place, "joint", type=kind, axis=_text(axis), armature="1", **place)
        self._coordinates += 1
        return self._coordinates - 1

    def _add_block(self, block: Array) -> None:
        for axis in np.eye(3):
            self._elastic.append(self._add(axis, True))
        for axis in np.eye(3):
            self._elastic.append(self._add(axis, False))
        self._blocks.append(block)

    def _load(self, arm: Arm, link: str) -> None:
        """Hang the masses of a link on its body; name the body where a weight needs it."""
        if self._place.tag == "body" and any(mass.link == link for mass in arm.weights):
            self._place.set("name", f"at {link}")
        for mass in arm.masses:
            if mass.link != link:
                continue
            body = ElementTree.SubElement(self._place, "body", pos=_text(mass.centre))
            m = mass.inertia + 1e-9 * np.eye(3)
            full = _text(np.array([m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]]))
            ElementTree.SubElement(body, "inertial", pos="0 0 0", mass=_text(mass.mass), fullinertia=full)


class Kinematics:
    """The unbent arm for many rows at once: tip, orientation, Jacobian, frames of links."""

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.column = {joint.name: k for k, joint in enumerate(arm.commanded)}

    def frames(self, q: Array) -> tuple[dict[str, Array], Array]:
        """Return the pose of every link, shapes (n, 4, 4), and the geometric Jacobian of the tip, (n, 6, nq)."""
        n = len(q)
        pose = np.tile(np.eye(4), (n, 1, 1))
        frames, motions = {self.arm.base: pose}, []
        for joint in self.arm.joints:
            pose = pose @ joint.pose
            if joint.kind != "fixed":
                driver, multiplier, offset = joint.follows or (joint.name, 1.0, 0.0)
                value = multiplier * q[:, self.column[driver]] + offset
                motions.append((self.column[driver], multiplier, joint, pose))
                pose = pose @ _motion(joint, value)
            frames[joint.child] = pose
        tip = pose[:, :3, 3]
        jacobian = np.zeros((n, 6, q.shape[1]))
        for column, multiplier, joint, place in motions:
            axis = place[:, :3, :3] @ joint.axis * multiplier
            if joint.slides:
                jacobian[:, :3, column] += axis
            else:
                jacobian[:, :3, column] += np.cross(axis, tip - place[:, :3, 3])
                jacobian[:, 3:, column] += axis
        return frames, jacobian

    def tip(self, q: Array) -> Array:
        """Return the pose of the tip, shape (n, 4, 4)."""
        frames, _ = self.frames(q)
        return frames[self.arm.joints[-1].child]

    def reach(self, start: Array, wanted: Array, rounds: int = 12) -> tuple[Array, Array]:
        """Find joint positions near `start` whose tip has the wanted pose; return what is left [m, rad] too."""
        q = start.copy()
        left = np.full(len(q), np.inf)
        for _ in range(rounds):
            frames, jacobian = self.frames(q)
            pose = frames[self.arm.joints[-1].child]
            turn = rotation_difference(wanted[:, :3, :3] @ np.swapaxes(pose[:, :3, :3], 1, 2))
            gap = np.hstack([wanted[:, :3, 3] - pose[:, :3, 3], turn])
            left = np.linalg.norm(gap, axis=1)
            if left.max(initial=0.0) < 1e-12:
                break
            step = np.einsum("nij,nj->ni", np.linalg.pinv(jacobian, rcond=1e-9), gap)
            q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.3)
        return q, left


def rotation_difference(turn: Array) -> Array:
    """Return the rotation vectors of rotation matrices. Shape (n, 3) [rad]."""
    odd = 0.5 * (turn - np.swapaxes(turn, 1, 2))
    vector = np.stack([odd[:, 2, 1], odd[:, 0, 2], odd[:, 1, 0]], axis=1)
    sine, cosine = np.linalg.norm(vector, axis=1), 0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    return vector * (angle / np.maximum(sine, 1e-300))[:, None]


def _motion(joint: Joint, value: Array) -> Array:
    motion = np.tile(np.eye(4), (len(value), 1, 1))
    if joint.slides:
        motion[:, :3, 3] = value[:, None] * joint.axis
        return motion
    x, y, z = joint.axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    motion[:, :3, :3] += np.sin(value)[:, None, None] * skew + (1 - np.cos(value))[:, None, None] * (skew @ skew)
    return motion


def _quaternion(rotation: Array) -> Array:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion


def _text(values: Array | float) -> str:
    return " ".join(repr(float(value)) for value in np.atleast_1d(values))
