"""Fit the parameters to measured rows: weighted, robust Gauss-Newton of the exact loaded equilibrium."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from compplan.errors import ConvergenceError, InputError, UnknownNameError
from compplan.identify.forward import KNOWN_FRAMES, PredictedRows, frame_parameters, move_frames, predict_rows
from compplan.identify.observations import Observations
from compplan.identify.parameters import FreeRobot, Parameter
from compplan.identify.robust import check_loss, loss_weights
from compplan.identify.separability import Inseparable, condition_number, explain_held, find_free
from compplan.identify.spread import state_spread
from compplan.identify.system import System, estimate_noise, information, invert, linearise, stack, weigh
from compplan.measure.registration import Registration
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
        covariance: Zero for parameters that are held. Shape (p, p).
        free: Which parameters were estimated; the others are held at their nominal value. Shape (p,).
        held: Names of what cannot be told (apart), and why.
        condition: Condition number of the column-scaled system of the free parameters.
        freedom: Degrees of freedom behind each standard error [Satterthwaite1946]. Shape (p,).
        registration: Frames of the campaign after the fit.
        prediction: What the fitted model says about the rows.
        residuals: Measured minus predicted, pose then encoders. Shape (n, 6 or 6 + nq). [m, rad]
        weights: Robust weight of each row. Shape (n,).
        noise: Standard deviation that the residuals show over the stated one: position, orientation, encoders.
            Shape (3,).
        clustered: Whether neighbouring residuals agree more than noise does; intervals then come from groups of poses.
        iterations: Steps that were taken.
    """

    structure: FreeRobot
    parameters: tuple[Parameter, ...]
    values: Array
    covariance: Array
    free: NDArray[np.bool_]
    held: tuple[Inseparable, ...]
    condition: float
    freedom: Array
    registration: Registration
    prediction: PredictedRows
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

    @property
    def standard_errors(self) -> Array:
        """Standard errors; zero for a parameter that is held. Shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def intervals(self, level: float = 0.95) -> Array:
        """State confidence intervals. Shape (p, 2)."""
        tail = 0.5 + level / 2
        reach = t.ppf(tail, self.freedom) * self.standard_errors
        return np.column_stack([self.values - reach, self.values + reach])


def estimate_parameters(
    structure: FreeRobot,
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
        registration: Frames of the campaign; its `parts` are fitted along. Base frame and TCP if left out.
        loss: "least_squares", "huber" or "tukey" (both 95 % efficient).
        reference: "absolute": poses as they were measured. "difference": rows of the same commanded pose are compared
            with each other only, so that errors of geometry and frames there drop out [Klimchik2018, eqs. 4-6].
        sigma: "residuals": the stated standard deviations give relative weights inside position and inside
            orientation, and the residuals say how large they are. "stated": they are trusted.

    Raises:
        InputError: If no parameter can be told, or there are fewer rows than parameters.
        UnknownNameError: If a loss or a reference does not exist.
        ConvergenceError: If the iteration does not settle.
    """
    _check_choices(loss, reference)
    start = KNOWN_FRAMES if registration is None else registration
    group = pose_groups(observations) if reference == "difference" else None
    parameters = (*structure.parameters, *frame_parameters(start, observations.rotation is not None))
    prediction = predict_rows(structure, structure.nominal, observations, start)
    system = linearise(structure, observations, start, prediction, structure.nominal)
    matrix = information(system, system.whitener(np.ones(3)), group)
    free = find_free(matrix, parameters)
    held = explain_held(structure, observations, prediction, matrix, parameters, free)
    _check_enough(system, free, held)
    values, frames, prediction, system, noise, steps = _iterate(
        structure, observations, start, parameters, free, group, loss, sigma, (prediction, system)
    )
    covariance, freedom, clustered = state_spread(system, observations.q, noise, loss, group, free, sigma)
    weights, _ = loss_weights(loss, system.distance(noise), system.known.sum(axis=1))
    return Estimate(
        structure=structure,
        parameters=parameters,
        values=np.r_[values, np.zeros(len(parameters) - len(values))],
        covariance=covariance,
        free=free,
        held=held,
        condition=condition_number(information(system, system.whitener(noise), group), free),
        freedom=freedom,
        registration=frames,
        prediction=prediction,
        residuals=np.where(system.known, system.residual, np.nan),
        weights=weights,
        noise=noise,
        clustered=clustered,
        iterations=steps,
    )


def _check_choices(loss: str, reference: str) -> None:
    """Refuse a loss or a reference that does not exist."""
    check_loss(loss)
    if reference not in REFERENCES:
        raise UnknownNameError("reference", reference, list(REFERENCES))


def _check_enough(system: System, free: NDArray[np.bool_], held: tuple[Inseparable, ...]) -> None:
    """Refuse poses that tell nothing, or less than there are parameters."""
    if len(free) and not free.any():
        raise InputError(f"nothing can be identified: {'; '.join(item.sentence for item in held[:3])}")
    if system.known.sum() <= free.sum():
        raise InputError(
            f"{system.known.sum()} measured numbers for {free.sum()} parameters, expected more; add poses"
        )


def pose_groups(observations: Observations) -> NDArray[np.int_]:
    """Group rows of the same commanded pose (within 0.006 deg or 0.1 mm), mode and target. Shape (n,)."""
    marks = [np.round(observations.q / 1e-4), observations.link_side[:, None], observations.target[:, None]]
    return np.asarray(np.unique(np.column_stack(marks), axis=0, return_inverse=True)[1]).ravel()


def _iterate(
    structure: FreeRobot,
    observations: Observations,
    frames: Registration,
    parameters: tuple[Parameter, ...],
    free: NDArray[np.bool_],
    group: NDArray[np.int_] | None,
    loss: str,
    sigma: str,
    state: tuple[PredictedRows, System],
) -> tuple[Array, Registration, PredictedRows, System, Array, int]:
    """Step until the values stand still against their standard errors."""
    (prediction, system), values, noise = state, structure.nominal, np.ones(3)
    sizes, previous = np.array([parameter.size for parameter in parameters])[free], np.inf
    for count in range(1, MAX_STEPS + 1):
        if sigma == "residuals":
            noise = estimate_noise(system, noise, free, group, loss)
        weights = loss_weights(loss, system.distance(noise), system.known.sum(axis=1))[0]
        residual, columns = weigh(system, system.whitener(noise) * np.sqrt(weights)[:, None], group)
        flat = stack(columns[:, :, free])
        inverse = invert(flat.T @ flat)
        step = np.zeros(len(free))
        step[free] = inverse @ (flat.T @ residual.ravel())
        values, frames, prediction = _advance(structure, observations, values, frames, step, prediction)
        system = linearise(structure, observations, frames, prediction, values)
        strides = np.abs(step[free]) / (1e-9 * sizes + 1e-3 * np.sqrt(np.diag(inverse)))
        size = float(strides.max(initial=0.0))
        if size < 1 or (count > 8 and size < 1e3 and size > 0.5 * previous):
            if sigma == "residuals":
                noise = estimate_noise(system, noise, free, group, loss)
            return values, frames, prediction, system, noise, count
        previous = size
    raise ConvergenceError("the fit did not settle; leave parameters out or check units and frames", residual=size)


def _advance(
    structure: FreeRobot,
    observations: Observations,
    values: Array,
    frames: Registration,
    step: Array,
    prediction: PredictedRows,
) -> tuple[Array, Registration, PredictedRows]:
    """Go along a step, halved until the loaded robot stands."""
    for _ in range(12):
        moved = move_frames(frames, step[len(values) :], observations.rotation is not None)
        try:
            ahead = predict_rows(structure, values + step[: len(values)], observations, moved, prediction.theta)
            return values + step[: len(values)], moved, ahead
        except ConvergenceError:
            step = 0.5 * step
    raise ConvergenceError("the fitted robot buckles under its loads; check the units of the wrench", residual=np.inf)
