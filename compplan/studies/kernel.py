"""Loaded equilibrium of the tool tip for many samples and waypoints at once.

The fixed-point iteration of `compplan.statics.elastic` with three savings: it starts from the deflections of the model,
it keeps only the tip, and it replaces the last forward kinematics by J (theta_k - theta_(k-1)), whose error is of
second order in that small change. Blocks of BLOCK poses fit the cache.

Every sampled robot locates a touched-off part before it cuts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from compplan.effects.attained import attain_with_effects
from compplan.errors import ConvergenceError
from compplan.robot import Array, Robot
from compplan.robot.pose import linear_displacement
from compplan.statics.chain import Chain
from compplan.statics.sweep import CompiledChain, apply_compliance, element_loads, joint_turns, walk_chain
from compplan.studies.posterior import MODES, RobotPosterior, build_posterior, move_by_parameters
from compplan.studies.sampling import TWIST, SampledRobots, grow_arm, shift_tip
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.touch_off import TouchedPart, build_touch_model, is_lasting, locate_touching

#: Poses solved at once.
BLOCK = 8192
#: Greatest error of the tip when the iteration stops. [m]
TOLERANCE = 1e-9
#: Assumed lever of a spring, which converts the tolerance to elastic coordinates. [m]
LEVER = 4.0
MOST_PASSES = 60


@dataclass(frozen=True)
class Kernel:
    """A compiled chain with its elastic elements."""

    compiled: CompiledChain  #: Chain prepared for forward kinematics.
    elements: tuple[int, ...]  #: Indices of the elastic elements.
    slides: tuple[bool, ...]  #: Whether each elastic coordinate translates.


def build_kernel(chain: Chain) -> Kernel:
    """Build the kernel of a chain."""
    elements = chain.spring_elements
    return Kernel(chain.compiled, tuple(int(k) for k in elements), tuple(bool(s) for s in chain.translates[elements]))


def solve_tips(kernel: Kernel, q: Array, wrench: Array, factor: Array, theta: Array) -> Array:
    """Solve the loaded equilibrium of n poses for the tip. Shape (3, n). [m]

    theta = f C (J^T w + tau_g), with a factor f on the compliance of every elastic coordinate, pose by pose.

    q: joint positions, drive errors included, (nq, n) [rad or m]; wrench: at the TCP, base axes, (6, n) [N, N m];
    factor: on the compliance of each elastic coordinate, (s, n); theta: initial coordinates, (s, n) [rad or m].

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
    message = f"equilibrium did not converge, last change {change:.3g} rad; the load is near or beyond buckling"
    raise ConvergenceError(message, residual=change)


def _move_tip(
    kernel: Kernel, position: Array, axes: Sequence[Array], origins: Sequence[Array], moved: Sequence[Array]
) -> Array:
    """Move the tip by the last change of the elastic coordinates, to first order."""
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


class Touch(NamedTuple):
    """Touched points, components first; k points."""

    q: Array  #: Joint positions at the points. Shape (nq, 1, k). [rad or m]
    shown: Array  #: The points in the found frame. Shape (3, k). [m]
    placements: Array  #: Motion of the tip per placement error. Shape (c, 3, k).
    offset: Array  #: Motion of the tip due to the effects of the robot folder. Shape (3, k). [m]
    fit: Array  #: Linear map from points to shift of their mean and rotation vector of the best fit. Shape (6, 3 k).
    posterior: RobotPosterior  #: Parameter uncertainty at the points, lost motion zero.


def prepare_touch(robot: Robot, touched: TouchedPart | None) -> Touch | None:
    """Prepare the points of a part that a robot touched; None if the part frame is absolute."""
    if touched is None:
        return None
    touched = replace(touched, robot=robot)
    scene, k = build_touch_model(touched), len(touched.q)
    robot = scene.robot
    posterior = build_posterior(robot, touched.q, np.zeros((robot.nq, k)))
    lasting = is_lasting(robot_uncertainty(robot).unknowns)
    posterior = replace(posterior, root=lasting[:, None] * posterior.root)
    moved = move_by_parameters(scene, np.arange(k), posterior)
    # the part does not move between touch and cut, and unexplained errors along the path count from it
    rates = [grow_arm(robot, touched.q)[None], np.zeros((TWIST, k, 3)), moved, np.zeros((3 * MODES, k, 3))]
    offset = np.zeros((k, 3))
    if robot.effects:
        plain = attain_with_effects(replace(robot, effects=()), touched.q, np.zeros((k, 6)), np.ones(k - 1))[0]
        offset = locate_touching(robot, touched.q) - plain
    return Touch(
        touched.q.T[:, None, :], touched.shown.T, np.swapaxes(np.concatenate(rates), 1, 2), offset.T,
        linear_displacement(touched.shown), posterior,
    )  # fmt: skip


def move_part(touch: Touch, kernel: Kernel, robots: SampledRobots, scale: Array, gain: Array, position: Array) -> Array:
    """Return the displacement of every sampled part from the found frame at positions (3, n). Shape (3, b, n). [m]

    scale, gain: shares of each spring's deflection, (s, b), and of each drive's error, (nq,), that remain under the
    feedback.
    """
    b, k = robots.zero.shape[1], touch.q.shape[2]
    drive = touch.posterior.draw_drives(robots.causes[1 + TWIST :], np.zeros((len(touch.q), b, k)))
    q = (touch.q + robots.zero[:, :, None] + gain[:, None, None] * drive).reshape(len(touch.q), -1)
    factor = np.repeat(robots.factor * scale, k, axis=1)
    tips = solve_tips(kernel, q, np.zeros((6, b * k)), factor, np.zeros_like(factor)).reshape(3, b, k)
    gap = tips + shift_tip(robots.causes, touch.placements) + (touch.offset - touch.shown)[:, None, :]
    twist = touch.fit @ np.moveaxis(gap, 1, 0).transpose(0, 2, 1).reshape(b, -1).T
    lever = position - touch.shown.mean(axis=1, keepdims=True)
    return np.asarray(twist[:3, :, None] + np.cross(twist[3:, :, None], lever[:, None, :], axis=0))
