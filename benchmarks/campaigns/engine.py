"""Exact static equilibrium of an elastic serial robot, with MuJoCo as the rigid-body engine.

Motors and springs are joints of a MuJoCo model that is built from the robot's description: on every body first the
motor, then its springs in the order listed. MuJoCo moves the bodies; the equilibrium theta = f(tau(q, theta)) of all
rows is then sought by a fixed point of the springs' laws, which contracts as springs are stiff against the load.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from benchmarks.campaigns.description import SPRING_AXES, Array, RobotDescription, Segment, Spring, rotation_from_rpy

TOLERANCE = 1e-13
MAX_ITERATIONS = 60
MOST_JOINTS = 6  # a MuJoCo body takes no more; further ones go to a massless body in the same place
ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Equilibrium:
    """Where the TCP stands when every spring balances its load."""

    position: Array  #: TCP position in the base frame. Shape (n, 3). [m]
    rotation: Array  #: TCP orientation in the base frame. Shape (n, 3, 3).
    theta: Array  #: Elastic coordinates. Shape (n, n_springs). [rad or m]
    torque: Array  #: Generalised load on every spring. Shape (n, n_springs). [N m or N]


@dataclass
class ElasticModel:
    """A robot in MuJoCo with a joint for every motor and every spring."""

    description: RobotDescription  #: The robot.
    springs: tuple[Spring, ...]  #: All springs that the model holds; those of zero compliance stay rigid.
    model: mujoco.MjModel = field(init=False, repr=False)
    data: mujoco.MjData = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(build_mjcf(self.description, self.springs))
        self.data = mujoco.MjData(self.model)
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        self.motor_ids = np.array([names.index(f"motor:{n}") for n in self.description.joint_names], dtype=int)
        self.followers = [(names.index(f"motor:{s.joint}"), i, *s.mimic) for i, s in self._mimics()]
        self.spring_ids = np.array([names.index(f"spring:{k}") for k in range(len(self.springs))], dtype=int)
        bodies = [self.model.body(i).name for i in range(self.model.nbody)]
        owner = [int(name[1:].split(".")[0]) if name.startswith("b") else -1 for name in bodies]
        count = len(self.description.segments)
        self.first_body = np.array([owner.index(i) for i in range(count)], dtype=int)
        self.last_body = np.array([len(owner) - 1 - owner[::-1].index(i) for i in range(count)], dtype=int)
        self.body_of_joint = np.array(self.model.jnt_bodyid)
        self.hinge = np.array(self.model.jnt_type) == mujoco.mjtJoint.mjJNT_HINGE
        self.load_description(self.description)

    def _mimics(self) -> list[tuple[int, Segment]]:
        return [(i, s) for i, s in enumerate(self.description.segments) if s.mimic is not None]

    def load_description(self, description: RobotDescription) -> None:
        """Take geometry and masses of another description of the same chain (its springs are not looked at)."""
        self.description = description
        for i, s in enumerate(description.segments):
            first, last = self.first_body[i], self.last_body[i]
            self.model.body_pos[first] = s.xyz
            quat = np.zeros(4)
            mujoco.mju_mat2Quat(quat, rotation_from_rpy(s.rpy).ravel())
            self.model.body_quat[first] = quat
            self.model.body_mass[last] = s.mass
            self.model.body_ipos[last] = s.com
            if s.actuated:
                self.model.jnt_axis[self.motor_ids[description.actuated.index(i)]] = s.axis
        for joint, i, *_ in self.followers:
            self.model.jnt_axis[joint] = description.segments[i].axis
        self.body_pos = self.model.body_pos.copy()
        gravity = description.gravity
        self.gravity = np.zeros(3) if gravity is None else np.array(gravity)

    def place(self, q: Array, theta: Array, growth: Array | None) -> tuple[Array, ...]:
        """Move the bodies of every row and return joint axes, anchors, centres of mass, TCP position and rotation.

        Args:
            q: Motor-side joint positions that the links follow. Shape (n, nq). [rad or m]
            theta: Elastic coordinates. Shape (n, n_springs).
            growth: Factor on every segment's origin, or None. Shape (n, n_segments).
        """
        model, data = self.model, self.data
        n = len(q)
        nj, nb = model.njnt, model.nbody
        axes, anchors = np.empty((n, nj, 3)), np.empty((n, nj, 3))
        coms, tip, turn = np.empty((n, nb, 3)), np.empty((n, 3)), np.empty((n, 9))
        qpos = np.zeros((n, nj))
        qpos[:, self.motor_ids] = q
        qpos[:, self.spring_ids] = theta
        for joint, _, leader, multiplier, offset in self.followers:
            qpos[:, joint] = multiplier * q[:, self.description.joint_names.index(leader)] + offset
        xaxis, xanchor, xipos, xpos, xmat = data.xaxis, data.xanchor, data.xipos, data.xpos, data.xmat
        kinematics = mujoco.mj_kinematics
        for k in range(n):
            if growth is not None:
                model.body_pos[self.first_body] = self.body_pos[self.first_body] * growth[k][:, None]
            data.qpos[:] = qpos[k]
            kinematics(model, data)
            axes[k], anchors[k], coms[k] = xaxis, xanchor, xipos
            tip[k], turn[k] = xpos[-1], xmat[-1]
        if growth is not None:
            model.body_pos[:] = self.body_pos
        return axes, anchors, coms, tip, turn.reshape(n, 3, 3)

    def spring_loads(self, placed: tuple[Array, ...], wrench: Array) -> Array:
        """Return the generalised load on every spring: wrench on the tool plus the weight that it carries.

        Args:
            placed: What `place` returned.
            wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
        """
        axes, anchors, coms, tip, _ = placed
        ids = self.spring_ids
        a, o = axes[:, ids], anchors[:, ids]
        mass = np.array(self.model.body_mass)
        carried = np.cumsum(mass[::-1])[::-1]
        moment = np.cumsum((mass[:, None] * coms)[:, ::-1], axis=1)[:, ::-1]
        body = self.body_of_joint[ids]
        force, couple = wrench[:, None, :3], wrench[:, None, 3:]
        pull = force + carried[body][:, None] * self.gravity
        arm_weight = moment[:, body] - carried[body][:, None] * o
        turn = np.cross(tip[:, None] - o, force) + couple + np.cross(arm_weight, self.gravity)
        return np.where(self.hinge[ids], np.einsum("nij,nij->ni", a, turn), np.einsum("nij,nij->ni", a, pull))

    def solve(
        self,
        q: Array,
        wrench: Array,
        law: Callable[[Array], Array],
        *,
        growth: Array | None = None,
        start: Array | None = None,
    ) -> Equilibrium:
        """Find the equilibrium of every row.

        Args:
            q: Joint positions that the links follow. Shape (n, nq). [rad or m]
            wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]
            law: Deflection of every spring under its load, (n, n_springs) to (n, n_springs).
            growth: Factor on every segment's origin, or None. Shape (n, n_segments).
            start: Elastic coordinates to start from. Shape (n, n_springs).
        Raises:
            RuntimeError: If the fixed point is not reached.
        """
        theta = np.zeros((len(q), len(self.springs))) if start is None else start.copy()
        for _ in range(MAX_ITERATIONS):
            placed = self.place(q, theta, growth)
            torque = self.spring_loads(placed, wrench)
            deflected = law(torque)
            step = np.max(np.abs(deflected - theta), initial=0.0)
            theta = deflected
            if step < TOLERANCE:
                return Equilibrium(placed[3], placed[4], theta, torque)
        raise RuntimeError(f"no static equilibrium within {MAX_ITERATIONS} steps, last step {step:.2e} rad")


def build_mjcf(description: RobotDescription, springs: tuple[Spring, ...]) -> str:
    """Write the MuJoCo model of a chain: motor first on every body, then its springs in the order listed."""
    lines = ['<mujoco><compiler angle="radian" inertiafromgeom="false" balanceinertia="true"/>']
    gravity = description.gravity or (0.0, 0.0, 0.0)
    lines += [f'<option gravity="{_row(gravity)}"/>', "<worldbody>"]
    depth = 0
    for i, s in enumerate(description.segments):
        kind = "hinge" if s.kind == "revolute" else "slide"
        joints = (
            [f'<joint name="motor:{s.joint}" type="{kind}" axis="{_row(s.axis)}" armature="1"/>'] if s.moves else []
        )
        joints += [_spring_joint(s, k, spring) for k, spring in enumerate(springs) if spring.joint == s.joint]
        groups = [joints[k : k + MOST_JOINTS] for k in range(0, len(joints), MOST_JOINTS)] or [[]]
        for k, group in enumerate(groups):
            last = k == len(groups) - 1
            pos, mass, com = (s.xyz if k == 0 else ZERO), (s.mass if last else 0.0), (s.com if last else ZERO)
            lines.append(f'<body name="b{i}.{k}" pos="{_row(pos)}">')
            lines.append(f'<inertial pos="{_row(com)}" mass="{max(mass, 1e-12)!r}" diaginertia="1e-3 1e-3 1e-3"/>')
            lines += group
            depth += 1
    lines += ["</body>"] * depth + ["</worldbody></mujoco>"]
    return "\n".join(lines)


def _spring_joint(segment: Segment, k: int, spring: Spring) -> str:
    if spring.axis == "own":
        hinge, axis = segment.kind == "revolute", segment.axis
    else:
        code, axis = SPRING_AXES[spring.axis]
        hinge = code == 1
    axis = spring.direction or axis
    kind = "hinge" if hinge else "slide"
    stiffness = 1.0 / spring.compliance if spring.compliance > 0.0 else 0.0
    place = f'axis="{_row(axis)}" pos="{_row(spring.offset)}"'
    return f'<joint name="spring:{k}" type="{kind}" {place} stiffness="{stiffness!r}" armature="1"/>'


def _row(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(v)) for v in values)
