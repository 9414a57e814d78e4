"""A campaign as commanded, the nominal robot in it, and a true robot that causes change."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from benchmarks.simulated_robot.cell import Kinematics, SimulatedRobot, rotation_difference
from benchmarks.simulated_robot.robot import UNIT, Arm, Array, Joint, pose_of, rotation_vector

Rng = np.random.Generator
GRAVITY = np.array([0.0, 0.0, -9.81])
#: The fixed joint under the base, for a base plate that yields.
BASE = "base_fixed"


@dataclass(frozen=True)
class Rows:
    """Rows of a campaign in time order; runs sampled along a path are not `static`.

    `visit` numbers stays (rows without a move between them); `direction` is the sign of each joint's last move.
    """

    run: list[str]
    q: Array
    speed: Array
    static: np.ndarray
    time: Array
    wrench: Array
    warmth: Array
    direction: Array
    visit: np.ndarray
    fresh: bool
    seed: int

    def since(self, share: float) -> Array:
        """1 after a share of the rows, 0 before; 1 everywhere in the later campaign. Shape (n,)."""
        return (self.fresh | (np.arange(len(self.q)) >= share * len(self.q))).astype(float)


class World:
    """The nominal robot at the rows of a campaign."""

    def __init__(self, arm: Arm, rows: Rows) -> None:
        ground = Joint(BASE, "fixed", "ground", arm.base, np.eye(4), UNIT["z"], 0.0, 0.0, 0.0, 0.0, None)
        self.arm, self.rows = replace(arm, base="ground", joints=(ground, *arm.joints)), rows
        self.count, self.n = len(arm.commanded), len(rows.q)
        self.names = [joint.name for joint in arm.commanded]
        self.slides = np.array([joint.slides for joint in arm.commanded])
        self.turning = [k for k in range(self.count) if not self.slides[k]]

    @cached_property
    def cell(self) -> SimulatedRobot:
        """The nominal robot."""
        return SimulatedRobot(self.arm)

    @cached_property
    def pose(self) -> tuple[Array, Array]:
        """Nominal tip and its axes. Shapes (n, 3) [m] and (n, 3, 3)."""
        rest = self.cell.rest(self.rows.q, self.rows.wrench)
        return rest.position, rest.rotation

    @cached_property
    def frames(self) -> tuple[dict[str, Array], Array]:
        """Poses of the unbent links, shapes (n, 4, 4), and the Jacobian of the tip, (n, 6, count)."""
        return Kinematics(self.arm).frames(self.rows.q)

    @cached_property
    def torque(self) -> Array:
        """Load on every joint. Shape (n, count). [N m or N]"""
        return -self.cell.torques(self.rows.q, self.rows.wrench, self.arm.gravity)

    def compliance(self, k: int) -> float:
        """Compliance of a joint about its own axis, 0 without a spring. [rad/(N m)]"""
        joint = self.arm.commanded[k]
        own = self.arm.springs.get(joint.name, [])
        return sum(s.compliance for s in own if s.slides == joint.slides and abs(s.axis @ joint.axis) > 0.99)

    @cached_property
    def elastic(self) -> list[int]:
        """Turning joints with an own spring that some load bends."""
        bend = [self.compliance(k) * float(np.ptp(self.torque[:, k])) for k in range(self.count)]
        return [k for k in self.turning if bend[k] > 0.05 * max(bend)]

    def across(self, k: int) -> list[str]:
        """Names of the axes across a joint's own axis."""
        return [name for name, axis in UNIT.items() if abs(axis @ self.arm.commanded[k].axis) < 0.5]

    @cached_property
    def reach(self) -> float:
        """Sum of the links behind the first joint. [m]"""
        return sum(float(np.linalg.norm(j.pose[:3, 3])) for j in self.arm.joints if j.name != self.names[0])


@dataclass
class TrueRobot:
    """What causes change: the arm, joint values, motions of base and tip (base axes), and the logged wrench."""

    world: World
    arm: Arm
    q: Array
    wrench: Array
    logged: Array
    turn: Array
    shift: Array
    tip: Array
    seen: list[Callable[[Array], Array]] = field(default_factory=list)

    def turn_joint(self, k: int, by: Array | float) -> None:
        """Move a joint beside its command. [rad or m]"""
        self.q[:, k] += by

    def move_joint(self, name: str, turn: Array, shift: Array) -> None:
        """Turn and shift the origin of a joint. [rad, m]"""
        moved = pose_of(rotation_vector(turn), shift)
        joints = [replace(j, pose=j.pose @ moved) if j.name == name else j for j in self.arm.joints]
        self.arm = replace(self.arm, joints=tuple(joints))


Apply = Callable[[TrueRobot, float], None]


def observe(world: World, causes: Sequence[tuple[Apply, float]], noise: Array | None = None) -> tuple[Array, ...]:
    """Let causes change the robot.

    Args:
        world: The nominal robot in a campaign.
        causes: What changes it, each at a size.
        noise: Scatter of the joints. Shape (n, count). [rad or m]

    Returns:
        Gap to the prediction with the logged wrench (n, 6) [m, rad], true tip (n, 3), axes (n, 3, 3), logged wrench.
    """
    rows, n = world.rows, world.n
    true = TrueRobot(world, world.arm, rows.q.copy(), rows.wrench, rows.wrench.copy(), *np.zeros((3, n, 3)))
    for apply, size in causes:
        apply(true, size)
    if noise is not None:
        true.q += noise
    rest = (world.cell if true.arm is world.arm else SimulatedRobot(true.arm)).rest(true.q, true.wrench)
    position, axes = rest.position, rest.rotation
    position = position + np.einsum("nij,nj->ni", axes, true.tip)
    rigid = _rotations(true.turn)
    position, axes = np.einsum("nij,nj->ni", rigid, position) + true.shift, rigid @ axes
    for see in true.seen:
        position = position + see(position)
    nominal, at = world.pose
    if not np.array_equal(true.logged, rows.wrench):
        there = world.cell.rest(rows.q, true.logged)
        nominal, at = there.position, there.rotation
    gap = np.hstack([position - nominal, rotation_difference(axes @ np.swapaxes(at, 1, 2))])
    return gap, position, axes, true.logged


def _rotations(vectors: Array) -> Array:
    """Rotation matrices of rotation vectors. Shape (n, 3, 3)."""
    angle = np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None, None]
    x, y, z = (vectors / angle[:, 0]).T
    o = np.zeros_like(x)
    skew = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
    return np.asarray(np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew))


def unit(rng: Rng, size: int = 3) -> Array:
    """A random direction. Shape (size,)."""
    v = rng.normal(size=size)
    return np.asarray(v / np.linalg.norm(v))
