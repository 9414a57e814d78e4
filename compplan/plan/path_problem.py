"""A path as the program sees it: what it has to fulfil, which rows count, and its matrices and numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from compplan.errors import ShapeError
from compplan.robot import Array
from compplan.statics.chain import Chain, joint_jacobian, locate_frames
from compplan.statics.sensitivity import AttainedPose, chunk_rows

#: l: swings of the free rotation over fewer than 2 pi l waypoints are smoothed away.
SMOOTHING = 20.0
ANCHOR_WEIGHT = SMOOTHING**-4
#: Steps of time shorter than this share of the median count as this long in the measure of smoothness.
SHORTEST_STEP = 0.05


def leaves_axis(chain: Chain) -> bool:
    """Tell whether an arm has too few joints to choose where its tool points (palletisers, arms like a SCARA)."""
    return chain.nq < 5


def count_equations(chain: Chain, *, spin_free: bool) -> int:
    """Count the pose equations of a waypoint: tip, tool axis where the arm chooses it, spin where it is not free."""
    return (3 if leaves_axis(chain) else 5) + (not spin_free)


@dataclass(frozen=True)
class PathProblem:
    """What a compensated path has to fulfil; n waypoints, nq joints, base frame.

    Attributes:
        chain: The elastic chain with the tool.
        position: Wanted tool tip. Shape (n, 3). [m]
        rotation: Wanted orientation of the TCP frame; its z (out of the tool) is binding, its x only where the spin is
            not free. Shape (n, 3, 3).
        wrench: Wrench of the environment on the tool at the TCP. Shape (n, 6). [N, N m]
        compensated: Waypoints where the loaded tool is to stand on the path, at the others the unloaded. Shape (n,).
        q_start: Posture that the plan keeps near. Shape (n, nq). [rad or m]
        step_time: Time from each waypoint to the next at the programmed feed. Shape (n - 1,). [s]
        lower: Lower position limits. Shape (nq,). [rad or m]
        upper: Upper position limits. Shape (nq,). [rad or m]
        velocity_limits: Velocity limits. Shape (nq,). [rad/s or m/s]
        acceleration_limits: Acceleration limits. Shape (nq,). [rad/s^2 or m/s^2]
        max_correction: Greatest distance of the unloaded tip from the path. [m]
        spin_free: Whether the rotation about the tool axis is free.
        hold: Weight of the departure from q_start at each waypoint, ANCHOR_WEIGHT if left out. Shape (n,).
        keeps_shape: Whether smoothness counts for the departure from q_start alone: q_start is then a motion that was
            chosen, not only a place to begin.
        still: Joints that keep q_start: rails, whose small motions are lost. Shape (nq,); none if left out.
        weight: What smoothness of each joint is worth, see `weigh_joints`. Shape (nq,); 1 if left out.

    """

    chain: Chain
    position: Array
    rotation: Array
    wrench: Array
    compensated: NDArray[np.bool_]
    q_start: Array
    step_time: Array
    lower: Array
    upper: Array
    velocity_limits: Array
    acceleration_limits: Array
    max_correction: float = np.inf
    spin_free: bool = True
    keeps_shape: bool = False
    hold: Array | None = None
    still: NDArray[np.bool_] | None = None
    weight: Array | None = None

    def __post_init__(self) -> None:
        n, nq = len(self.position), self.chain.nq
        shapes = {"position": (n, 3), "rotation": (n, 3, 3), "wrench": (n, 6), "compensated": (n,), "q_start": (n, nq)}
        shapes |= {"step_time": (n - 1,), "lower": (nq,), "upper": (nq,)}
        shapes |= {"velocity_limits": (nq,), "acceleration_limits": (nq,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ShapeError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")

    @property
    def anchor(self) -> Array:
        """Weight of the departure from q_start. Shape (n,)."""
        return np.full(len(self.position), ANCHOR_WEIGHT) if self.hold is None else self.hold

    @property
    def stays(self) -> NDArray[np.bool_]:
        """Tell which joints keep q_start. Shape (nq,)."""
        return np.zeros(self.chain.nq, bool) if self.still is None else self.still

    @property
    def worth(self) -> Array:
        """What smoothness of each joint is worth. Shape (nq,)."""
        return np.ones(self.chain.nq) if self.weight is None else self.weight

    @property
    def equations(self) -> int:
        """Count the pose equations of a waypoint."""
        return count_equations(self.chain, spin_free=self.spin_free)

    @property
    def axis_free(self) -> bool:
        """Tell whether the tool axis follows from the tip: four joints cannot choose it."""
        return leaves_axis(self.chain)

    @property
    def redundant(self) -> bool:
        """Tell whether a waypoint leaves the joints any freedom."""
        return self.chain.nq - int(self.stays.sum()) > self.equations


@dataclass(frozen=True)
class ProgramRows:
    """Which rows stand in the program beside the pose equations; indices of waypoints, and joints where it says pairs.

    Attributes:
        bounded: Joint positions that are bounded. Shape (n, nq).
        limited: Waypoints whose correction is limited. Shape (c,).
        released: Waypoints whose joint positions are given, their pose equations may be missed. Shape (r,).
        velocity: Pairs (waypoint i, joint) whose step from i to i + 1 is limited. Shape (v, 2).
        acceleration: Pairs (waypoint i, joint) whose change of velocity at i is limited. Shape (a, 2).

    """

    bounded: NDArray[np.bool_]
    limited: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, int))
    released: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, int))
    velocity: NDArray[np.int_] = field(default_factory=lambda: np.zeros((0, 2), int))
    acceleration: NDArray[np.int_] = field(default_factory=lambda: np.zeros((0, 2), int))

    @property
    def free(self) -> bool:
        """Tell whether none stands in it beside the pose equations; the range of a joint is only a number."""
        return not any(len(getattr(self, name)) for name in ("limited", "released", "velocity", "acceleration"))

    def same_program(self, other: ProgramRows) -> bool:
        """Tell whether the program has the same rows; bounds are only numbers in it."""
        names = ("limited", "released", "velocity", "acceleration")
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)


def bound_axes(problem: PathProblem) -> tuple[int, ...]:
    """List the axes of the TCP frame that the pose equations speak of: z, its direction out of the tool, and x."""
    return (() if problem.axis_free else (2,)) + (() if problem.spin_free else (0,))


def pose_data(problem: PathProblem, q: Array, attained: AttainedPose) -> Array:
    """Put the numbers of every waypoint side by side: q_0, wanted pose, deflection and its derivative. Shape (n, k)."""
    n, nq = q.shape
    out = [q, problem.position, *_normals(problem)]
    loaded = problem.compensated[:, None]
    shift, turned = np.empty((n, 3)), np.empty((n, 3, 3))
    shift_rate, turn_rate = np.empty((n, 3, nq)), np.empty((n, 3, nq))
    for rows in chunk_rows(n, problem.chain):
        frames = locate_frames(problem.chain, q[rows])
        columns = joint_jacobian(problem.chain, frames)
        back = np.swapaxes(frames.tcp_rotation, 1, 2)
        gap = attained.position[rows] - frames.tcp_position
        shift[rows] = (back @ gap[..., None])[..., 0]
        turned[rows] = back @ attained.rotation[rows]
        change = attained.jacobian[rows] - columns
        swing = np.cross(np.swapaxes(columns[:, 3:], 1, 2), gap[:, None, :])
        shift_rate[rows] = back @ (change[:, :3] - np.swapaxes(swing, 1, 2))
        turn_rate[rows] = back @ change[:, 3:]
    shift, shift_rate = np.where(loaded, shift, 0.0), np.where(loaded[..., None], shift_rate, 0.0)
    turned = np.where(loaded[..., None], turned, np.eye(3))
    turn_rate = np.where(loaded[..., None], turn_rate, 0.0)
    out += [shift, _flat(shift_rate)]
    for axis in bound_axes(problem):
        direction = turned[:, :, axis]
        rate = np.cross(np.swapaxes(turn_rate, 1, 2), direction[:, None, :])
        out += [direction, rate.reshape(n, -1)]
    return np.hstack(out)


def smoothness_matrix(problem: PathProblem) -> sparse.csr_matrix:
    """Build the matrix of q'' over the waypoints, by divided differences in time. Shape (n - 2, n)."""
    n, h = len(problem.position), problem.step_time
    if n < 3:
        return sparse.csr_matrix((0, n))
    median = float(np.median(h))
    h = np.maximum(h / median, SHORTEST_STEP) if median > 0 else np.ones(n - 1)
    mean = 0.5 * (h[1:] + h[:-1])
    left, right = 1.0 / (h[:-1] * mean), 1.0 / (h[1:] * mean)
    weight = np.sqrt(mean)
    bands = [weight * left, -weight * (left + right), weight * right]
    rows = np.tile(np.arange(n - 2), 3)
    columns = np.concatenate([np.arange(n - 2) + k for k in range(3)])
    return sparse.csr_matrix((np.concatenate(bands), (rows, columns)), shape=(n - 2, n))


def rate_matrix(problem: PathProblem, rows: ProgramRows) -> tuple[sparse.csc_matrix, Array]:
    """Build the rate rows: change of joint position a step, change of velocity at a waypoint, and their bounds.

    Returns:
        Matrix on the joint positions in the order of the variables, shape (v + a, n nq), and bounds, shape (v + a,).
        [rad or m, rad/s or m/s]

    """
    n, nq = problem.q_start.shape
    h = np.maximum(problem.step_time, 1e-9)
    i, j = rows.velocity.T
    k, m = rows.acceleration.T
    count = np.arange(len(i))
    blocks = [(count, i * nq + j, -np.ones(len(i))), (count, (i + 1) * nq + j, np.ones(len(i)))]
    later = len(i) + np.arange(len(k))
    before, after = 1.0 / h[k - 1], 1.0 / h[np.minimum(k, n - 2)]
    blocks += [
        (later, (k - 1) * nq + m, before),
        (later, k * nq + m, -before - after),
        (later, (k + 1) * nq + m, after),
    ]
    row, column, value = (np.concatenate(part) for part in zip(*blocks, strict=True))
    bound = np.r_[problem.velocity_limits[j] * h[i], problem.acceleration_limits[m] * 0.5 * (h[k - 1] + h[k])]
    return sparse.csc_matrix((value, (row, column)), shape=(len(bound), n * nq)), bound


def _normals(problem: PathProblem) -> list[Array]:
    """Return the directions across which the tool axis (and the tool's x) may not lean. Shapes (n, 3)."""
    x, y = problem.rotation[:, :, 0], problem.rotation[:, :, 1]
    return [x, y] if problem.spin_free else [x, y, y]


def _flat(rate: Array) -> Array:
    """Flatten (n, 3, nq) column by column, as CasADi reads it."""
    return np.swapaxes(rate, 1, 2).reshape(len(rate), -1)
