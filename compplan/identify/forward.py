"""What the model says about measured rows, and how that changes with the parameters.

It stands beside the forward model of `compplan.effects` on purpose: single terms of a link's 6x6 compliance and the
place where a spring sits are no effects of the vocabulary, and a step of the fit needs the derivative by each of them
at the loaded equilibrium. What both know of springs, links and geometry is the same to 1e-9 m, which
`tests/test_identify_forward.py` checks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import ConvergenceError
from compplan.identify.observations import Observations
from compplan.identify.parameters import AXES, TYPICAL_SIZE, FreeRobot, Parameter
from compplan.measure.registration import Registration
from compplan.robot import Array
from compplan.statics.chain import Frames, jacobian, locate_frames
from compplan.statics.elastic import spring_torque

EQUILIBRIUM_TOLERANCE = 1e-12
MAX_ITERATIONS = 100


#: The measuring frame is the robot base frame, the target the TCP, and neither is fitted.
KNOWN_FRAMES = Registration(np.eye(4), np.eye(4)[None], ("",), ())


def frame_parameters(registration: Registration, orientation: bool) -> tuple[Parameter, ...]:
    """List the parameters of the frames that are fitted: small changes of pose against where they stand.

    Args:
        registration: Frames of the campaign; its `parts` are fitted.
        orientation: Whether orientation is measured; without it a tool is a point.
    """
    free = [_frame_parameter("base", "base", axis) for axis in AXES] if "base" in registration.parts else []
    if "tool" in registration.parts:
        for label in _tool_labels(registration):
            free += [_frame_parameter(label, "tool", axis) for axis in (AXES if orientation else AXES[:3])]
    return tuple(free)


def move_frames(registration: Registration, change: Array, orientation: bool) -> Registration:
    """Move the fitted frames by a step: each turns about its own origin, in measuring axes and in TCP axes."""
    base, tools, used = registration.base.copy(), registration.tool.copy(), 0
    if "base" in registration.parts:
        base[:3, :3], used = _rotation(change[3:6]) @ base[:3, :3], 6
        base[:3, 3] += change[:3]
    if "tool" in registration.parts:
        size = 6 if orientation else 3
        for tool in tools:
            step = np.zeros(6)
            step[:size] = change[used : used + size]
            tool[:3, :3] = _rotation(step[3:]) @ tool[:3, :3]
            tool[:3, 3] += step[:3]
            used += size
    return replace(registration, base=base, tool=tools)


@dataclass(frozen=True)
class PredictedRows:
    """What the model says about n rows.

    Attributes:
        position: Measured point, measuring frame. Shape (n, 3). [m]
        rotation: Measured orientation, measuring frame. Shape (n, 3, 3).
        theta: Elastic coordinates. Shape (n, s). [rad or m]
        torque: Load on each elastic coordinate. Shape (n, s). [N m or N]
        frames: Frames of the loaded chain, base frame.
    """

    position: Array
    rotation: Array
    theta: Array
    torque: Array
    frames: Frames


def predict_rows(
    structure: FreeRobot,
    values: Array,
    observations: Observations,
    registration: Registration,
    start: Array | None = None,
) -> PredictedRows:
    """Predict what is measured, in exact loaded equilibrium: theta = C(p) tau(q, theta) + shift(p).

    Args:
        structure: Robot and free parameters.
        values: Values of the parameters. Shape (p,).
        observations: The measured rows; only their q, wrench, mode and target are used.
        registration: Frames of the campaign.
        start: Elastic coordinates to start from. Shape (n, s).

    Raises:
        ConvergenceError: If the equilibrium does not settle.
    """
    chain, compliance, shift = structure.chain, structure.compliance(values), structure.shift(values)
    n, s = len(observations), chain.n_springs
    free = ~(observations.link_side[:, None] & chain.actuator[None, :])
    theta = np.broadcast_to(shift, (n, s)) * free if start is None else start
    change = np.inf
    for _ in range(MAX_ITERATIONS):
        frames = locate_frames(chain, observations.q, theta if s else None)
        torque = spring_torque(chain, frames, observations.wrench)[:, chain.spring_elements]
        if change < EQUILIBRIUM_TOLERANCE:
            break
        update = (torque @ compliance) * free + shift
        change = float(np.abs(update - theta).max(initial=0.0))
        theta = update
        if not np.isfinite(change):
            break
    else:
        change = np.inf
    if not np.isfinite(change):
        raise ConvergenceError("equilibrium did not settle while identifying; a load is near buckling", residual=change)
    offset = registration.tool[observations.target]
    R, p = registration.base[:3, :3], registration.base[:3, 3]
    lever = np.einsum("nij,nj->ni", frames.tcp_rotation, offset[:, :3, 3])
    return PredictedRows(
        position=(frames.tcp_position + lever) @ R.T + p,
        rotation=R @ frames.tcp_rotation @ offset[:, :3, :3],
        theta=theta,
        torque=torque,
        frames=frames,
    )


def sensitivities(
    structure: FreeRobot, observations: Observations, registration: Registration, prediction: PredictedRows
) -> Array:
    """Differentiate the measured pose with respect to every parameter, frames last.

    dx/dc_k = J E_k tau, geometry: dx/dg = J e; the change of tau with theta is left out (it is of the order of load by
    buckling load), which changes the steps of Gauss-Newton but not where a consistent fit ends.

    Returns:
        Linear rows first, measuring axes. Shape (n, 6, p + frame parameters).
    """
    chain = structure.chain
    R = registration.base[:3, :3]
    lever = prediction.position - (prediction.frames.tcp_position @ R.T + registration.base[:3, 3])
    columns = jacobian(chain, prediction.frames)[:, :, chain.spring_elements]
    free = ~(observations.link_side[:, None] & chain.actuator[None, :])
    turned = np.empty_like(columns)
    turned[:, 3:] = np.einsum("ij,njs->nis", R, columns[:, 3:])
    turned[:, :3] = np.einsum("ij,njs->nis", R, columns[:, :3]) + np.cross(turned[:, 3:], lever[:, :, None], axis=1)
    turned *= free[:, None, :]
    parts = [_elastic_columns(structure, columns=turned, torque=prediction.torque)]
    parts += _frame_columns(observations, registration, prediction, R)
    return np.concatenate(parts, axis=2)


def pose_residuals(observations: Observations, prediction: PredictedRows) -> Array:
    """Take measured minus predicted, position then rotation vector, measuring axes; [m, rad]. Shape (n, 6)."""
    residual = np.full((len(observations), 6), np.nan)
    residual[:, :3] = observations.position - prediction.position
    if observations.rotation is not None:
        known = np.isfinite(observations.rotation).all(axis=(1, 2))
        turn = observations.rotation[known] @ np.swapaxes(prediction.rotation[known], 1, 2)
        residual[known, 3:] = Rotation.from_matrix(turn).as_rotvec()
    return residual


def _elastic_columns(structure: FreeRobot, columns: Array, torque: Array) -> Array:
    result = np.zeros((len(columns), 6, len(structure.parameters)))
    entries = [(k, *e) for k, p in enumerate(structure.parameters) for e in p.entries]
    if entries:
        k, i, j, coefficient = (np.array(column) for column in zip(*entries, strict=True))
        pushed = columns[:, :, i] * torque[:, None, j]
        pushed += np.where(i == j, 0.0, 1.0) * columns[:, :, j] * torque[:, None, i]
        mixing = np.zeros((len(k), result.shape[2]))
        mixing[np.arange(len(k)), k] = coefficient
        result = pushed @ mixing
    for number, parameter in enumerate(structure.parameters):
        if parameter.shift >= 0:
            result[:, :, number] += columns[:, :, parameter.shift]
    return result


def _frame_columns(
    observations: Observations, registration: Registration, prediction: PredictedRows, R: Array
) -> list[Array]:
    n = len(observations)
    parts: list[Array] = []
    if "base" in registration.parts:
        base = np.zeros((n, 6, 6))
        base[:] = np.eye(6)
        base[:, :3, 3:] = -_skew(prediction.position - registration.base[:3, 3])
        parts.append(base)
    if "tool" in registration.parts:
        size = 6 if observations.rotation is not None else 3
        turned = R @ prediction.frames.tcp_rotation
        for number in range(len(registration.tool)):
            tool = np.zeros((n, 6, size))
            own = np.flatnonzero(observations.target == number)
            tool[own, :3, :3] = turned[own]
            if size == 6:
                tool[own, 3:, 3:] = turned[own]
            parts.append(tool)
    return parts


def _skew(vectors: Array) -> Array:
    matrix = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2] = -z, y, -x
    return matrix - np.swapaxes(matrix, 1, 2)


def _rotation(vector: Array) -> Array:
    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _frame_parameter(label: str, kind: str, axis: str) -> Parameter:
    unit = "m" if axis.startswith("t") else "rad"
    return Parameter(f"{label}.{axis}", kind, unit, 0.0, TYPICAL_SIZE[unit])


def _tool_labels(registration: Registration) -> list[str]:
    if len(registration.tool) == 1:
        return ["tool"]
    return [f"tool({label or number})" for number, label in enumerate(registration.targets, 1)]
