"""The kernel of a study: where the loaded tool stands, for many samples and waypoints at once.

The fixed point of `compplan.statics.elastic` with three savings: it starts from the model's own deflections, it keeps
nothing but the tip, and instead of a last walk it moves the tip by J (theta_k - theta_(k-1)), whose error is of the
second order of a change that is already small. Blocks of BLOCK poses stay in the cache.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compplan.errors import ConvergenceError
from compplan.robot import Array
from compplan.statics.chain import Chain
from compplan.statics.sweep import CompiledChain, apply_compliance, element_loads, joint_turns, walk_chain

#: Poses solved at once.
BLOCK = 8192
#: Greatest error of the tip by stopping the iteration. [m]
TOLERANCE = 1e-9
#: Assumed lever of a spring, for translating the tolerance to elastic coordinates. [m]
LEVER = 4.0
MOST_PASSES = 60


@dataclass(frozen=True)
class Kernel:
    """A chain, ready to be settled."""

    compiled: CompiledChain  #: The chain prepared for walking.
    elements: tuple[int, ...]  #: Elements that are elastic.
    slides: tuple[bool, ...]  #: Which elastic coordinates translate.


def build_kernel(chain: Chain) -> Kernel:
    """Build the kernel of a chain."""
    elements = chain.spring_elements
    return Kernel(chain.compiled, tuple(int(k) for k in elements), tuple(bool(s) for s in chain.translates[elements]))


def settle_tips(kernel: Kernel, q: Array, wrench: Array, factor: Array, theta: Array) -> Array:
    """Solve the loaded equilibrium of n poses for the tip. Shape (3, n). [m]

    theta = f C (J^T w + tau_g), with a factor f on the compliance of every elastic coordinate, pose by pose.

    Args:
        kernel: The kernel.
        q: Joint positions, drive errors included. Shape (nq, n). [rad or m]
        wrench: Wrench of the environment on the tool at the TCP, base axes. Shape (6, n). [N, N m]
        factor: Factor on the compliance of each elastic coordinate. Shape (s, n).
        theta: Elastic coordinates to start from. Shape (s, n). [rad or m]

    Raises:
        ConvergenceError: If a load is near or beyond buckling.
    """
    n = q.shape[1]
    tips = np.empty((3, n))
    for start in range(0, n, BLOCK):
        part = slice(start, min(start + BLOCK, n))
        tips[:, part] = _settle_block(kernel, q[:, part], wrench[:, part], factor[:, part], theta[:, part])
    return tips


def _settle_block(kernel: Kernel, q: Array, wrench: Array, factor: Array, theta: Array) -> Array:
    compiled, elements = kernel.compiled, kernel.elements
    turns = joint_turns(compiled, q)
    if not elements:
        return np.broadcast_to(walk_chain(compiled, turns, None, bodies=False).position, (3, q.shape[1]))
    now: Sequence[Array] = list(theta)
    previous = np.inf
    for _ in range(MOST_PASSES):
        walk = walk_chain(compiled, turns, now, bodies=bool(compiled.weights))
        torque = element_loads(compiled, walk, wrench[:3], wrench[3:], elements)
        update = [f * bent for f, bent in zip(factor, apply_compliance(compiled, torque), strict=True)]
        moved = [new - old for new, old in zip(update, now, strict=True)]
        change = max(max(float(step.max()), -float(step.min())) for step in moved)
        ratio = min(change / previous, 0.5) if np.isfinite(previous) and previous > 0 else 0.5
        if change * ratio / (1.0 - ratio) * LEVER < TOLERANCE:
            return _move_tip(kernel, walk.position, walk.axis, walk.origin, moved)
        if not np.isfinite(change):
            break
        now, previous = update, change
    message = f"equilibrium did not settle, last change {change:.3g} rad; the load is near or beyond buckling"
    raise ConvergenceError(message, residual=change)


def _move_tip(
    kernel: Kernel, position: Array, axes: Sequence[Array], origins: Sequence[Array], moved: Sequence[Array]
) -> Array:
    """Move the tip by what the elastic coordinates still changed, to first order."""
    x, y, z = position
    total = [x, y, z]
    for element, slides, step in zip(kernel.elements, kernel.slides, moved, strict=True):
        a = axes[element]
        if slides:
            total = [total[i] + step * a[i] for i in range(3)]
            continue
        o = origins[element]
        lever = (x - o[0], y - o[1], z - o[2])
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            total[i] = total[i] + step * (a[j] * lever[k] - a[k] * lever[j])
    return np.array(total)
