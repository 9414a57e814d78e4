"""Elastostatics: where a chain stands under load, and how it yields.

A wrench is what the environment does to the tool, at the TCP, in base axes, force first. Equilibrium is taken in the
loaded state with finite rotations: theta = C (J(q, theta)^T w + tau_gravity(q, theta)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from compplan.errors import ConvergenceError, ShapeError
from compplan.robot import Array
from compplan.statics.chain import (
    Chain,
    Frames,
    chunks,
    empty_frames,
    fill_frames,
    jacobian,
    load_elements,
    locate_frames,
)
from compplan.statics.sweep import Walk, apply_compliance, element_loads, joint_turns, walk_chain

MAX_ITERATIONS = 200


class LoadedPose(NamedTuple):
    """Equilibrium of a chain at n poses.

    Attributes:
        theta: Elastic coordinates. Shape (n, s). [rad or m]
        frames: Frames of the loaded chain; `frames.tcp_position` and `frames.tcp_rotation` are the attained pose.
        torque: Load on each elastic coordinate. Shape (n, s). [N m or N]
    """

    theta: Array
    frames: Frames
    torque: Array

    @property
    def position(self) -> Array:
        """Attained TCP, base frame. Shape (n, 3). [m]."""
        return self.frames.tcp_position

    @property
    def rotation(self) -> Array:
        """Attained orientation of the TCP, base frame. Shape (n, 3, 3)."""
        return self.frames.tcp_rotation


def solve_equilibrium(
    chain: Chain, q: Array, wrench: Array | None = None, *, tolerance: float = 1e-13, torque_bias: Array | None = None
) -> LoadedPose:
    """Solve the static equilibrium of the loaded chain.

    Fixed point theta <- C (J^T w + tau_g), which contracts while the load is far below the buckling load.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes; none if left out.
            Shape (n, 6) or (6,). [N, N m]
        tolerance: Largest change of an elastic coordinate in the last iteration. [rad or m]
        torque_bias: Further load on each elastic coordinate. Shape (n, s). [N m or N]

    Raises:
        ShapeError: If an array does not have the shape above.
        ConvergenceError: If the iteration does not settle, as beyond the buckling load.
    """
    q = np.atleast_2d(np.asarray(q, float))
    load = _wrench_rows(wrench, len(q))
    if not chain.n_springs:
        return LoadedPose(np.zeros((len(q), 0)), locate_frames(chain, q), np.zeros((len(q), 0)))
    bias = None if torque_bias is None else np.broadcast_to(torque_bias, (len(q), chain.n_springs))
    frames, theta, torque = empty_frames(chain, len(q)), *(np.empty((chain.n_springs, len(q))).T for _ in range(2))
    for rows in chunks(len(q)):
        part = chain.take(rows)
        extra = None if bias is None else list(np.ascontiguousarray(bias[rows].T))
        columns = np.ascontiguousarray((load[:1] if _one_row(load) else load[rows]).T)
        solution = _iterate(part, np.ascontiguousarray(q[rows].T), columns, extra, tolerance, rows.start)
        fill_frames(frames, rows, solution.walk)
        for j, (coordinate, moment) in enumerate(zip(solution.theta, solution.torque, strict=True)):
            theta[rows, j], torque[rows, j] = coordinate, moment
    return LoadedPose(theta, frames, torque)


class _Solution(NamedTuple):
    """Equilibrium of a piece, components first."""

    theta: list[Array]
    torque: list[Array]
    walk: Walk


def _iterate(
    chain: Chain, q: Array, wrench: Array, bias: list[Array] | None, tolerance: float, first: int = 0
) -> _Solution:
    """Iterate theta <- C (J^T w + tau_g) until the geometric series of the changes falls below the tolerance."""
    compiled, elements = chain.compiled, [int(k) for k in chain.spring_elements]
    turns = joint_turns(compiled, q)
    theta: list[Array] | None = None
    change = previous = np.inf
    for _ in range(MAX_ITERATIONS):
        walk = walk_chain(compiled, turns, theta, bodies=bool(compiled.weights))
        torque = element_loads(compiled, walk, wrench[:3], wrench[3:], elements)
        if bias is not None:
            torque = [a + b for a, b in zip(torque, bias, strict=True)]
        update = apply_compliance(compiled, torque)
        before = [np.zeros(1)] * len(update) if theta is None else theta
        change = max(float(np.abs(a - b).max(initial=0.0)) for a, b in zip(update, before, strict=True))
        theta = update
        ratio = min(change / previous, 1.0) if np.isfinite(previous) and previous > 0 else 1.0
        if change < tolerance or (ratio < 0.5 and change * ratio < 0.5 * tolerance):
            return _Solution(theta, torque, walk_chain(compiled, turns, theta))
        if not np.isfinite(change):
            break
        previous = change
    steps = np.stack([np.broadcast_to(np.nan_to_num(np.abs(a - b), nan=np.inf), q.shape[1:])
                      for a, b in zip(update, before, strict=True)])  # fmt: skip
    spring, row = np.unravel_index(int(np.argmax(steps)), steps.shape)
    message = (
        f"equilibrium did not settle at waypoint {first + int(row)}, spring {chain.spring_names[int(spring)]!r}, last "
        f"change {change:.3g} rad or m; the load is near or beyond buckling: check forces, and compliances of the robot"
    )
    raise ConvergenceError(message, residual=change)


def _one_row(load: Array) -> bool:
    return load.strides[0] == 0


def spring_torque(chain: Chain, frames: Frames, wrench: Array) -> Array:
    """Compute the load of wrench and weights on every element: J^T w + tau_g. Shape (n, m). [N m or N]."""
    return load_elements(chain, frames, np.asarray(wrench, float))


def cartesian_compliance(chain: Chain, q: Array, theta: Array | None = None) -> Array:
    """Compute the compliance of the TCP, J C J^T, at a pose (loaded if theta is given).

    Valid for a small change of the wrench where the stiffness by the change of the Jacobian is negligible
    [Salisbury1980]; `loaded_compliance` holds without that condition.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        theta: Elastic coordinates. Shape (n, s). [rad or m]

    Returns:
        Rows tx ty tz rx ry rz, columns fx fy fz mx my mz, base axes. Shape (n, 6, 6).
    """
    q = np.atleast_2d(np.asarray(q, float))
    result = np.empty((6, 6, len(q)))
    for rows in chunks(len(q)):
        part = chain.take(rows)
        frames = locate_frames(part, q[rows], None if theta is None else theta[rows])
        columns = np.moveaxis(jacobian(part, frames), 0, -1)[:, part.spring_elements]
        bent = np.empty_like(columns)
        for i in range(6):
            for j, displacement in enumerate(apply_compliance(part.compiled, columns[i])):
                bent[i, j] = displacement
            for k in range(i + 1):
                result[i, k, rows] = result[k, i, rows] = np.einsum("sn,sn->n", bent[i], columns[k])
    return np.moveaxis(result, -1, 0)


def loaded_compliance(chain: Chain, q: Array, wrench: Array) -> Array:
    """Compute the exact compliance of the TCP in the loaded state.

    dx/dw = J (1 - C H)^-1 C J^T with H = d(J^T w + tau_g)/dtheta at the equilibrium: this carries the complementary
    stiffness K_C [Chen2000; Dumas2011].

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Twist of the TCP per wrench, base axes. Shape (n, 6, 6).
    """
    q = np.atleast_2d(np.asarray(q, float))
    loaded = solve_equilibrium(chain, q, wrench)
    columns = jacobian(chain, loaded.frames)[:, :, chain.spring_elements]
    hessian = load_hessian(chain, q, loaded.theta, _wrench_rows(wrench, len(q)))
    inner = np.eye(chain.n_springs) - chain.compliance @ hessian
    return np.asarray(columns @ np.linalg.solve(inner, chain.compliance @ np.swapaxes(columns, 1, 2)))


def load_hessian(chain: Chain, q: Array, theta: Array, wrench: Array) -> Array:
    """Differentiate the load on the elastic coordinates with respect to them: H = d(J^T w + tau_g)/dtheta.

    Args:
        chain: The chain.
        q: Joint positions. Shape (n, nq). [rad or m]
        theta: Elastic coordinates. Shape (n, s). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        Shape (n, s, s). [N m/rad and kin]
    """
    n, springs = len(q), chain.spring_elements
    hessian, load = np.empty((n, len(springs), len(springs))), _wrench_rows(wrench, n)
    for rows in chunks(n):
        part = chain.take(rows)
        change = load_derivative(part, locate_frames(part, q[rows], theta[rows]), load[rows])
        hessian[rows] = change[:, springs][:, :, springs]
    return hessian


def load_derivative(chain: Chain, frames: Frames, wrench: Array) -> Array:
    """Differentiate the load on every element with respect to the motion of every element, in closed form.

    An element k feels tau_k = a_k . sum_b (r_b - o_k) x f_b + a_k . m over the loads beyond it: the wrench (f, m)
    at the TCP and the weights. Element j turns or shifts everything beyond it while the loads keep their base axes.

    Args:
        chain: The chain.
        frames: Its frames at n poses.
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (n, 6). [N, N m]

    Returns:
        d tau_k / d x_j. Shape (n, m, m).

    """
    m = len(chain.names)
    axis, slides = frames.axis, chain.translates
    force, moment, dyad = _loads_beyond(chain, frames, wrench)
    swing = np.einsum("nkab,nkb->nka", dyad, axis) - axis * np.trace(dyad, axis1=2, axis2=3)[..., None]
    swing = np.where(slides[None, :, None], np.cross(axis, force), swing)
    later = np.einsum("nka,nja->nkj", axis, swing)
    turned = np.einsum("nka,nja->nkj", np.cross(np.where(slides[:, None], force, moment), axis) * -1.0, axis)
    lever = np.einsum("nkab,nka->nkb", dyad, axis)
    spread = np.trace(dyad, axis1=2, axis2=3)
    same = np.einsum("nkb,njb->nkj", lever, axis) - spread[:, :, None] * np.einsum("nka,nja->nkj", axis, axis)
    earlier = turned + np.where(slides[None, :, None], 0.0, same)
    earlier = np.where(slides[None, None, :], 0.0, earlier)
    beyond = np.arange(m)[None, :] > np.arange(m)[:, None]
    derivative = np.where(beyond, later, earlier)
    derivative[:, slides[:, None] & beyond] = 0.0
    return np.asarray(derivative)


def _loads_beyond(chain: Chain, frames: Frames, wrench: Array) -> tuple[Array, Array, Array]:
    """Sum the loads beyond each element: force (n, m, 3), moment at its origin (n, m, 3), sum of l f^T (n, m, 3, 3)."""
    lever = frames.tcp_position[:, None, :] - frames.origin
    force = np.broadcast_to(wrench[:, None, :3], lever.shape)
    moment = wrench[:, None, 3:] + np.cross(lever, force)
    dyad = lever[..., :, None] * force[..., None, :]
    if chain.gravity.any() and len(chain.body_element):
        weight = np.broadcast_to(np.asarray(chain.mass)[..., None] * chain.gravity, frames.centre.shape)
        beyond = (chain.body_element[:, None] >= np.arange(len(chain.names))[None, :]).astype(float)
        total = np.einsum("bm,nbi->nmi", beyond, weight)
        first = np.einsum("bm,nbi,nbj->nmij", beyond, frames.centre, weight)
        dyad = dyad + first - frames.origin[..., :, None] * total[..., None, :]
        arm = np.einsum("bm,nbi->nmi", beyond, np.cross(frames.centre, weight))
        moment = moment + arm - np.cross(frames.origin, total)
        force = force + total
    return force, moment, dyad


def _wrench_rows(wrench: Array | None, n: int) -> Array:
    if wrench is None:
        return np.zeros((n, 6))
    rows = np.asarray(wrench, float)
    if rows.shape not in ((6,), (n, 6)):
        raise ShapeError(f"wrench has shape {rows.shape}, expected ({n}, 6) or (6,)")
    return np.broadcast_to(rows, (n, 6))
