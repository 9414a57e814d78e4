"""Costs of a posture: remaining deviation, nearness to joint limits, dexterity.

The sensitivity is the deviation that remains after compensation because wrench, compliance and joint zeros are
uncertain. To first order, with theta = C tau the elastic coordinates under the load,

    remaining deviation = J (e_c * theta) + J C J^T (e_w * w) + J_q e_q,

where e_c, e_w and e_q are independent errors of each elastic coordinate (relative), each component of the wrench
(relative) and each joint zero. The correction does not change it; the posture does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from compplan.errors import UnknownNameError
from compplan.robot import Array
from compplan.statics.chain import Chain, Frames, jacobian, joint_jacobian, load_elements, locate_frames
from compplan.statics.quality import natural_length
from compplan.uncertainty.posture_errors import PostureErrors

CHUNK = 4096
#: Smallest squared sensitivity that scales the presets: (0.1 um)^2, far below that of any robot. [mm^2]
LEAST_LEVEL = 1e-8


@dataclass(frozen=True)
class ModelScatter:
    """Assumed standard deviations of the inputs of a plan; errors are independent and normal."""

    wrench: float = 0.1  #: Relative error of each component of the wrench, part axes.
    compliance: float = 0.1  #: Relative error of each elastic coordinate.


#: Default uncertainty (assumed).
ASSUMED = ModelScatter()
#: Inverse condition number below which a posture counts as singular and has a steep cost (assumed).
SINGULARITY_MARGIN = 0.03


@dataclass(frozen=True)
class Weights:
    """Weights of the criteria, in mm^2 of squared sensitivity."""

    sensitivity: float = 1.0  #: Per mm^2 of remaining deviation, mean square along the cut.
    #: Per unit of nearness to joint limits: 1 at a limit, 0 from the margin on, squared, summed over joints.
    limits: float = 0.0
    dexterity: float = 0.0  #: Per unit of (0.1 / inverse condition number)^2, mean along the path.
    #: Per unit of (margin / inverse condition number - 1)^2 below the singularity margin, mean along the path.
    singularity: float = 0.0
    #: Per (rad per 100 mm of path)^2 of joint motion, mean along the path; 1 m of a rail counts as 1 rad.
    motion: float = 0.0
    time: float = 0.0  #: Per second of motion.
    #: Per share of the programmed time that joints at half their velocity limits need in addition, over the cut.
    rate: float = 0.0


#: Presets: least remaining deviation, least band, least joint motion, shortest cycle; the other weights decide between
#: equal postures. All but `sensitivity` are multiplied by the smallest squared sensitivity of the postures along the
#: path, so that a preset is independent of the load.
PRESETS: dict[str, Weights] = {
    "accurate": Weights(limits=0.001, dexterity=0.0001, singularity=10.0, motion=2e-4, rate=3.0),
    "error_band": Weights(limits=0.005, dexterity=0.0005, singularity=10.0, motion=0.001, rate=3.0),
    "smooth": Weights(sensitivity=0.001, limits=0.002, dexterity=0.0002, singularity=10.0, motion=5.0, rate=3.0),
    "fast": Weights(sensitivity=0.01, limits=0.01, dexterity=0.002, singularity=10.0, motion=0.02, time=10.0,
                    rate=1000.0),
}  # fmt: skip
RELATIVE = ("limits", "dexterity", "singularity", "motion", "time", "rate")


class NodeCosts(NamedTuple):
    """Criteria of n postures."""

    sensitivity: Array  #: Expected (root mean square) remaining deviation of the tool tip. Shape (n,). [m]
    limits: Array  #: Nearness to joint limits, see `measure_limits`. Shape (n,).
    #: Inverse Frobenius condition number of the length-normalised Jacobian, 0 singular to 1. Shape (n,).
    dexterity: Array


def choose_weights(preset: str, level: float) -> Weights:
    """Scale the weights of a preset by the level: smallest squared sensitivity, mean over the cut. [mm^2]

    Raises:
        UnknownNameError: If preset does not exist.
    """
    if preset not in PRESETS:
        raise UnknownNameError("preset", preset, list(PRESETS))
    base, scale = PRESETS[preset], max(level, LEAST_LEVEL)
    return replace(base, **{name: getattr(base, name) * scale for name in RELATIVE})


def measure_nodes(
    chain: Chain, q: Array, wrench: Array, *, limits: tuple[Array, Array],
    uncertainty: ModelScatter | PostureErrors | None = None, axes: Array | None = None,
    margin: float = np.radians(10.0),
) -> NodeCosts:  # fmt: skip
    """Compute the criteria of postures q (n, nq) [rad or m] under a wrench (n, 6) [N, N m] at the TCP, base axes.

    `limits`: lower and upper joint limits (nq,); `uncertainty`: standard deviations of the inputs; `axes` (3, 3): axes
    of the wrench errors; `margin` [rad or m]: distance from a limit beyond which a joint does not count as near.
    """
    known, n, length = uncertainty or ASSUMED, len(q), natural_length(chain, limits)
    sensitivity, dexterity = np.empty(n), np.empty(n)
    for start in range(0, n, CHUNK):
        rows = slice(start, min(start + CHUNK, n))
        frames = locate_frames(chain, q[rows])
        spread = error_columns(chain, q[rows], wrench[rows], known, axes, frames)
        sensitivity[rows] = np.sqrt(np.einsum("nij,nij->n", spread, spread))
        dexterity[rows] = measure_dexterity(joint_jacobian(chain, frames), length)
    return NodeCosts(sensitivity, measure_limits(q, *limits, margin), dexterity)


def error_columns(
    chain: Chain, q: Array, wrench: Array, known: ModelScatter | PostureErrors, axes: Array | None = None,
    frames: Frames | None = None,
) -> Array:  # fmt: skip
    """Compute the remaining deviation per standard deviation of each error; `frames`: of the postures, if known.

    Shape (n, 3, errors). [m]
    """
    if not isinstance(known, ModelScatter):
        return known.columns(q, wrench)
    frames = locate_frames(chain, q) if frames is None else frames
    columns = jacobian(chain, frames)
    springs = chain.spring_elements
    elastic = np.ascontiguousarray(columns[:, :, springs])
    torque = load_elements(chain, frames, wrench)[:, springs]
    theta = torque @ chain.compliance
    by_spring = elastic[:, :3] * theta[:, None, :]
    compliance = (elastic[:, :3] @ chain.compliance) @ np.swapaxes(elastic, 1, 2)
    turn = np.eye(3) if axes is None else axes
    by_force = (compliance[:, :, :3] @ turn) * (wrench[:, None, :3] @ turn)
    by_moment = (compliance[:, :, 3:] @ turn) * (wrench[:, None, 3:] @ turn)
    parts = [known.compliance * by_spring, known.wrench * by_force, known.wrench * by_moment]
    return np.concatenate(parts, axis=2)


def measure_limits(q: Array, lower: Array, upper: Array, margin: float) -> Array:
    """Compute the nearness to joint limits: sum over the joints of max(0, 1 - distance / margin)^2. Shape (n,)."""
    distance = np.minimum(q - lower, upper - q)
    return np.asarray((np.maximum(0.0, 1.0 - distance / margin) ** 2).sum(axis=1))


def measure_dexterity(joint_columns: Array, length: float) -> Array:
    """Compute the inverse Frobenius condition number of the length-normalised Jacobian [Dumas2011]. Shape (n,).

    1 / kappa = 6 / sqrt(tr(N N^T) tr((N N^T)^-1)), N the Jacobian of the commanded joints (n, 6, nq) with its linear
    rows divided by a characteristic length [m]: 1 where the tool moves equally well in all directions, 0 at a
    singularity. All joints of a redundant arm are included.
    """
    scaled = joint_columns.copy()
    scaled[:, :3] /= length
    gram = scaled @ np.swapaxes(scaled, 1, 2)
    trace = np.trace(gram, axis1=1, axis2=2)
    gram += (1e-14 * trace)[:, None, None] * np.eye(6)
    inverse = np.trace(np.linalg.inv(gram), axis1=1, axis2=2)
    return np.asarray(6.0 / np.sqrt(np.maximum(trace * inverse, 36.0)))
