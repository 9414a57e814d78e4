"""Fit the parameters to measured rows: weighted, robust Gauss-Newton of the exact loaded equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from compplan.errors import ConvergenceError, InputError, UnknownNameError
from compplan.identify.forward import Prediction, Registration, pose_residuals, predict_rows, sensitivities
from compplan.identify.observations import Observations
from compplan.identify.parameters import Parameter, Structure
from compplan.identify.robust import check_loss, loss_weights, robust_scale
from compplan.identify.separability import Inseparable, condition_number, explain_held, find_free
from compplan.identify.spread import cluster_covariance, neighbours_agree
from compplan.robot import Array

REFERENCES = ("absolute", "difference")
MAX_STEPS = 40


@dataclass(frozen=True)
class Estimate:
    """Identified parameters and how sure they are.

    Attributes:
        structure: Robot and parameters.
        parameters: The structure's parameters, then those of the frames. Length p.
        values: Estimates; changes of the frames against the registration are zero by construction. Shape (p,).
        standard_errors: Zero for a parameter that is held. Shape (p,).
        covariance: Shape (p, p).
        free: Which parameters were estimated; the others are held at their nominal value. Shape (p,).
        held: Names of what cannot be told (apart), and why.
        condition: Condition number of the column-scaled system of the free parameters.
        freedom: Degrees of freedom of the residuals.
        registration: Frames of the campaign after the fit.
        prediction: What the fitted model says about the rows.
        residuals: Measured minus predicted. Shape (n, 6). [m, rad]
        weights: Robust weight of each row. Shape (n,).
        noise: Standard deviation that the residuals show over the stated one: position, orientation, encoders. Shape (3,).
        clustered: Whether neighbouring residuals agree more than noise does, so that intervals come from groups of poses.
        iterations: Steps that were taken.
    """

    structure: Structure
    parameters: tuple[Parameter, ...]
    values: Array
    standard_errors: Array
    covariance: Array
    free: NDArray[np.bool_]
    held: tuple[Inseparable, ...]
    condition: float
    freedom: float
    registration: Registration
    prediction: Prediction
    residuals: Array
    weights: Array
    noise: Array
    clustered: bool
    iterations: int

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def model_values(self) -> Array:
        """Values of the structure's own parameters, without the frames."""
        return self.values[: len(self.structure.parameters)]

    def intervals(self, level: float = 0.95) -> Array:
        """State confidence intervals. Shape (p, 2)."""
        tail = 0.5 + level / 2
        factor = float(t.ppf(tail, self.freedom)) if np.isfinite(self.freedom) else float(norm.ppf(tail))
        return np.column_stack([self.values - factor * self.standard_errors, self.values + factor * self.standard_errors])


class _System(NamedTuple):
    """The linearised problem at one state, before weighting. m components a row: 6 of the pose, then the encoders."""

    residual: Array  # (n, m)
    columns: Array  # (n, m, p)
    sigma: Array  # (n, m), infinite where nothing was measured
    block: NDArray[np.int_]  # (m,): 0 position, 1 orientation, 2 encoders


def estimate_parameters(
    structure: Structure,
    observations: Observations,
    *,
    registration: Registration | None = None,
    loss: str = "least_squares",
    reference: str = "absolute",
    sigma: str = "residuals",
) -> Estimate:
    """Estimate the free parameters of a structure.

    Minimises sum_i rho(|W_i (x_i - x(p, q_i, w_i))|) where x(p, ...) is the exact loaded equilibrium. Linear in the
    compliance to first order, x = J (sum_k c_k E_k) J^T w [Klimchik2018; Dumas2011], so that few steps suffice.

    Args:
        structure: Robot and free parameters.
        observations: The measured rows.
        registration: Frames of the campaign, with which of them are free; measuring frame = base frame if left out.
        loss: "least_squares", "huber" or "tukey" (both 95 % efficient).
        reference: "absolute": poses as they were measured. "difference": rows of the same commanded pose are compared with
            each other only, so that errors of geometry and frames at that pose drop out [Klimchik2018, eqs. 4-6].
        sigma: "residuals": the stated standard deviations give relative weights inside position and orientation, and the
            residuals say how large they are. "stated": they are trusted.

    Raises:
        InputError: If no parameter can be told, or there are fewer rows than parameters.
        UnknownNameError: If a loss or a reference does not exist.
        ConvergenceError: If the iteration does not settle.
    """
    check_loss(loss)
    if reference not in REFERENCES:
        raise UnknownNameError("reference", reference, list(REFERENCES))
    frames = Registration() if registration is None else registration
    orientation = observations.rotation is not None
    parameters = (*structure.parameters, *frames.parameters(orientation))
    count, group = len(structure.parameters), _pose_groups(observations) if reference == "difference" else None
    values, noise = structure.nominal, np.ones(3)
    prediction = predict_rows(structure, values, observations, frames)
    system = _linearise(structure, observations, frames, prediction, values)
    information = _information(system, _whiten(system, np.ones(3)), group)
    free = find_free(information, parameters)
    if not free.any():
        held = explain_held(structure, observations, prediction, information, parameters, free)
        raise InputError(f"nothing can be identified: {'; '.join(item.sentence for item in held[:3])}")
    rows = np.isfinite(system.sigma).sum()
    if rows <= free.sum():
        raise InputError(f"{rows} measured numbers for {free.sum()} parameters, expected more; add poses")
    held_information, previous = information, np.inf
    for step_count in range(1, MAX_STEPS + 1):
        if sigma == "residuals":
            noise = _noise(system, noise, free, group, loss, first=step_count == 1)
        weights = _row_weights(system, noise, loss)
        whitener = _whiten(system, noise) * np.sqrt(weights)[:, None]
        step, error = _solve(system, whitener, group, free)
        values, frames, prediction = _advance(structure, observations, values, frames, step, count, prediction)
        system = _linearise(structure, observations, frames, prediction, values)
        size = float(np.max(np.abs(step[free]) / (1e-9 * _sizes(parameters)[free] + 1e-4 * error[free])))
        if size < 1 or (size < 1e3 and size > 0.5 * previous and step_count > 8):
            break
        previous = size
    else:
        raise ConvergenceError("the fit did not settle; leave parameters out or check units and frames", residual=size)
    if sigma == "residuals":
        noise = _noise(system, noise, free, group, loss)
    held = explain_held(structure, observations, prediction, held_information, parameters, free)
    covariance, clustered, freedom, weights, condition = _spread(system, noise, loss, group, free, observations, sigma)
    return Estimate(
        structure=structure,
        parameters=parameters,
        values=np.r_[values, np.zeros(len(parameters) - count)],
        standard_errors=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        free=free,
        held=held,
        condition=condition,
        freedom=freedom,
        registration=frames,
        prediction=prediction,
        residuals=system.residual[:, :6],
        weights=weights,
        noise=noise,
        clustered=clustered,
        iterations=step_count,
    )


def _linearise(
    structure: Structure, observations: Observations, frames: Registration, prediction: Prediction, values: Array
) -> _System:
    residual = pose_residuals(observations, prediction)
    columns = sensitivities(structure, observations, frames, prediction)
    n = len(observations)
    sigma = np.repeat(np.column_stack([observations.sigma_position, observations.sigma_rotation]), 3, axis=1)
    block = np.repeat([0, 1], 3)
    if observations.encoder is not None:
        extra, slopes = _encoder_rows(structure, observations, prediction, values)
        slopes = np.concatenate([slopes, np.zeros((n, slopes.shape[1], columns.shape[2] - slopes.shape[2]))], axis=2)
        residual, columns = np.hstack([residual, extra]), np.concatenate([columns, slopes], axis=1)
        sigma = np.hstack([sigma, np.full(extra.shape, observations.sigma_encoder)])
        block = np.r_[block, np.full(extra.shape[1], 2)]
    missing = ~np.isfinite(residual)
    return _System(np.where(missing, 0.0, residual), columns, np.where(missing, np.inf, sigma), block)


def _encoder_rows(
    structure: Structure, observations: Observations, prediction: Prediction, values: Array
) -> tuple[Array, Array]:
    """Link-side minus motor-side reading = deflection of the actuator about its own axis [Klimchik2018, eqs. 7-8]."""
    chain = structure.chain
    assert observations.encoder is not None
    deflection = prediction.torque @ structure.compliance(values)
    n, joints = observations.encoder.shape
    expected, slopes = np.zeros((n, joints)), np.zeros((n, joints, len(structure.parameters)))
    elements = chain.spring_elements
    for column, element in enumerate(chain.joint_elements):
        mates = [
            s for s in np.flatnonzero(chain.actuator) if chain.names[elements[s]].split(".")[0] == chain.names[element]
        ]
        sign = {s: float(chain.axis[elements[s]] @ chain.axis[element]) for s in mates}
        for s in mates:
            expected[:, column] += sign[s] * deflection[:, s]
            for k, parameter in enumerate(structure.parameters):
                for i, j, coefficient in parameter.entries:
                    if i == j == s:
                        slopes[:, column, k] += sign[s] * coefficient * prediction.torque[:, s]
        if not mates:
            expected[:, column] = np.nan
    return observations.encoder - expected, slopes


def _whiten(system: _System, noise: Array) -> Array:
    """One over the standard deviation; zero where nothing was measured. Shape (n, m)."""
    return 1.0 / (system.sigma * noise[system.block])


def _row_weights(system: _System, noise: Array, loss: str) -> Array:
    known = np.isfinite(system.sigma)
    distance = np.linalg.norm(system.residual * _whiten(system, noise), axis=1)
    return loss_weights(loss, distance, known.sum(axis=1))[0]


def _weighted(system: _System, whitener: Array, group: NDArray[np.int_] | None) -> tuple[Array, Array]:
    """Weigh the system; with groups, take off each group's weighted mean first. Shapes (n, m), (n, m, p)."""
    residual, columns = system.residual, system.columns
    if group is not None:
        power = whitener**2
        total = np.zeros((int(group.max()) + 1, power.shape[1]))
        np.add.at(total, group, power)
        share = power / np.where(total > 0, total, 1.0)[group]
        mean, mean_columns = np.zeros_like(total), np.zeros((*total.shape, columns.shape[2]))
        np.add.at(mean, group, share * residual)
        np.add.at(mean_columns, group, share[..., None] * columns)
        residual, columns = residual - mean[group], columns - mean_columns[group]
    return residual * whitener, columns * whitener[..., None]


def _information(system: _System, whitener: Array, group: NDArray[np.int_] | None) -> Array:
    flat = _weighted(system, whitener, group)[1].reshape(-1, system.columns.shape[2])
    return np.asarray(flat.T @ flat)


def _solve(
    system: _System, whitener: Array, group: NDArray[np.int_] | None, free: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Take one Gauss-Newton step; returns the step and its standard errors."""
    residual, columns = _weighted(system, whitener, group)
    flat = columns[:, :, free].reshape(-1, int(free.sum()))
    norms = np.sqrt(np.einsum("ij,ij->j", flat, flat))
    normal = flat.T @ flat / np.outer(norms, norms)
    inverse = np.linalg.inv(normal)
    step, error = np.zeros(len(free)), np.zeros(len(free))
    step[free] = inverse @ (flat.T @ residual.ravel() / norms) / norms
    error[free] = np.sqrt(np.diag(inverse)) / norms
    return step, error


def _advance(
    structure: Structure,
    observations: Observations,
    values: Array,
    frames: Registration,
    step: Array,
    count: int,
    prediction: Prediction,
) -> tuple[Array, Registration, Prediction]:
    """Go along a step, halved until the loaded robot stands."""
    orientation = observations.rotation is not None
    for _ in range(12):
        moved = frames.moved(step[count:], orientation)
        try:
            ahead = predict_rows(structure, values + step[:count], observations, moved)
            return values + step[:count], moved, ahead
        except ConvergenceError:
            step = 0.5 * step
    raise ConvergenceError("the fitted robot buckles under its loads; check units and signs of the wrench", residual=np.inf)


def _noise(
    system: _System,
    noise: Array,
    free: NDArray[np.bool_],
    group: NDArray[np.int_] | None,
    loss: str,
    *,
    first: bool = False,
) -> Array:
    """Estimate how large the noise is against the stated one, for position, orientation and encoders apart [Foerstner1979]."""
    result = noise.copy()
    if loss != "least_squares":
        white = _weighted(system, np.where(np.isfinite(system.sigma), 1.0 / system.sigma, 0.0), group)[0]
        leave = _leverage(system, _whiten(system, noise), group, free)
        for block in range(3):
            part, known = white[:, system.block == block], np.isfinite(system.sigma[:, system.block == block])
            if known.any():
                rows = known.all(axis=1)
                size = robust_scale(np.linalg.norm(part[rows], axis=1), part.shape[1])
                result[block] = max(size / np.sqrt(max(1 - leave[block] / known.sum(), 0.02)), 1e-6)
        return result
    whitener = _whiten(system, noise)
    residual = _weighted(system, whitener, group)[0]
    leave = _leverage(system, whitener, group, free)
    for block in range(3):
        columns = system.block == block
        known = np.isfinite(system.sigma[:, columns]).sum()
        if known:
            spare = known - (0 if first else leave[block])
            result[block] = max(noise[block] * np.sqrt((residual[:, columns] ** 2).sum() / max(spare, 1.0)), 1e-6)
    return result


def _leverage(system: _System, whitener: Array, group: NDArray[np.int_] | None, free: NDArray[np.bool_]) -> Array:
    """Count how many measured numbers of each block the fit uses up. Shape (3,)."""
    columns = _weighted(system, whitener, group)[1][:, :, free]
    flat = columns.reshape(-1, columns.shape[2])
    norms = np.sqrt(np.einsum("ij,ij->j", flat, flat))
    inverse = np.linalg.inv(flat.T @ flat / np.outer(norms, norms))
    used = np.zeros(3)
    for block in range(3):
        part = (columns[:, system.block == block] / norms).reshape(-1, columns.shape[2])
        used[block] = np.sum((part.T @ part) * inverse)
        if group is not None:
            known = np.isfinite(system.sigma[:, system.block == block])
            used[block] += sum(len(np.unique(group[known[:, c]])) for c in range(known.shape[1]))
    return used


def _spread(
    system: _System,
    noise: Array,
    loss: str,
    group: NDArray[np.int_] | None,
    free: NDArray[np.bool_],
    observations: Observations,
    sigma: str,
) -> tuple[Array, bool, float, Array, float]:
    """Compute covariance, whether it is clustered, degrees of freedom, row weights and condition number."""
    known = np.isfinite(system.sigma)
    count = known.sum(axis=1)
    distance = np.linalg.norm(system.residual * _whiten(system, noise), axis=1)
    weights, slopes = loss_weights(loss, distance, count)
    whitener = _whiten(system, noise)
    information = _information(system, whitener, group)
    index = np.flatnonzero(free)
    norms = np.sqrt(np.diag(information)[index])
    inverse = np.linalg.inv(information[np.ix_(index, index)] / np.outer(norms, norms)) / np.outer(norms, norms)
    freedom = float(known.sum() - _leverage(system, whitener, group, free).sum())
    if freedom <= 0:
        raise InputError(f"{known.sum()} measured numbers leave no freedom for {len(index)} parameters; add poses")
    factor = 1.0
    if loss != "least_squares":
        seen = np.maximum(count, 1)
        spread = np.sum((weights * distance) ** 2) / np.sum(seen)
        steep = np.sum(seen * weights + slopes * distance) / np.sum(seen)
        factor = spread / steep**2 * known.sum() / freedom
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(index, index)] = factor * inverse
    clustered = False
    if sigma == "residuals":
        residual, columns = _weighted(system, whitener * np.sqrt(weights)[:, None], group)
        clustered = neighbours_agree(observations.q, residual)
        if clustered:
            wide = cluster_covariance(observations.q, residual, columns[:, :, free], len(index))
            if wide is not None:
                scale = np.sqrt(np.maximum(np.diag(wide) / np.diag(factor * inverse), 1.0))
                covariance[np.ix_(index, index)] = factor * inverse * np.outer(scale, scale)
    return covariance, clustered, np.inf if sigma == "stated" else freedom, weights, condition_number(information, free)


def _pose_groups(observations: Observations) -> NDArray[np.int_]:
    """Number the rows of the same commanded pose, mode and target. Shape (n,)."""
    return pose_groups(observations.q, observations.link_side, observations.target)


def pose_groups(q: Array, *marks: NDArray) -> NDArray[np.int_]:  # type: ignore[type-arg]
    """Number rows by commanded pose (within 0.005 deg or 0.1 mm) and further marks. Shape (n,)."""
    keys = np.column_stack([np.round(q / 1e-4), *[np.asarray(mark, float) for mark in marks]])
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()


def _sizes(parameters: tuple[Parameter, ...]) -> Array:
    return np.array([parameter.size for parameter in parameters])
