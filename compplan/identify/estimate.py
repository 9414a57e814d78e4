"""Fit the parameters to measured rows: weighted, robust Gauss-Newton of the exact loaded equilibrium."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from compplan.errors import ConvergenceError, InputError, UnknownNameError
from compplan.identify.forward import RowState, attain_rows, forget_turns, frame_parameters, linearise
from compplan.identify.parameters import FreeRobot, Parameter
from compplan.identify.rows import KNOWN_FRAMES, Rows
from compplan.identify.separability import Inseparable, explain_held, tell_apart
from compplan.measure.campaign import Campaign
from compplan.measure.fit.heldout import HeldOutRows, leave_out
from compplan.measure.fit.robust import check_loss, loss_weights
from compplan.measure.fit.separable import condition_number
from compplan.measure.fit.spread import state_spread
from compplan.measure.fit.system import BLOCKS, System, estimate_noise, information, invert, stack, weigh
from compplan.measure.frames import move_frames
from compplan.measure.registration import Registration
from compplan.robot import Array

REFERENCES = ("absolute", "difference")
MAX_STEPS = 40


@dataclass(frozen=True, eq=False)
class Estimate:
    """Identified parameters and how sure they are.

    Attributes:
        parameters: The structure's parameters, then those of the frames. Length p.
        values: Estimates; changes of the frames against the registration are zero by construction. Shape (p,).
        covariance: Zero for parameters that are held. Shape (p, p).
        free: Which parameters were estimated; the others are held at their nominal value. Shape (p,).
        held: Names of what cannot be told (apart), and why.
        condition: Condition number of the column-scaled system of the free parameters.
        freedom: Degrees of freedom behind each standard error [Satterthwaite1946]. Shape (p,).
        state: What the fitted model says about the rows.
        system: The linearised problem there.
        weights: Robust weight of each row. Shape (n,).
        noise: Standard deviation that the residuals show over the stated one: position, orientation, encoders.
            Shape (3,).
        clustered: Whether neighbouring residuals agree more than noise does; intervals then come from groups of poses.
        iterations: Steps that were taken.
    """

    parameters: tuple[Parameter, ...]
    values: Array
    covariance: Array
    free: NDArray[np.bool_]
    held: tuple[Inseparable, ...]
    condition: float
    freedom: Array
    state: RowState
    system: System
    weights: Array
    noise: Array
    clustered: bool
    iterations: int

    @property
    def structure(self) -> FreeRobot:
        """Robot and parameters."""
        return self.state.structure

    @property
    def registration(self) -> Registration:
        """Frames of the campaign after the fit."""
        return self.state.frames

    @property
    def residuals(self) -> Array:
        """Measured minus predicted, pose then encoders. Shape (n, 6 or 6 + nq). [m, rad]"""
        return np.where(self.system.known, self.system.residual, np.nan)

    @property
    def names(self) -> tuple[str, ...]:
        """List the names of the parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def free_names(self) -> list[str]:
        """List the names of the parameters that were estimated."""
        return [name for name, free in zip(self.names, self.free, strict=True) if free]

    @property
    def model_values(self) -> Array:
        """Values of the structure's own parameters, without the frames."""
        return self.state.values

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
    structure: FreeRobot, campaign: Campaign, *, registration: Registration | None = None,
    loss: str = "least_squares", reference: str = "absolute", sigma: str = "residuals",
) -> Estimate:  # fmt: skip
    """Estimate the free parameters of a structure from every row of a log.

    Args:
        structure: Robot and free parameters.
        campaign: The measured rows.
        registration: Frames of the campaign; its `parts` are fitted along. Base frame and TCP if left out.
        loss: As in `Rows`.
        reference: As in `Rows`.
        sigma: As in `Rows`.

    Raises:
        InputError: If no parameter can be told, or there are fewer rows than parameters.
        UnknownNameError: If a loss or a reference does not exist.
        ConvergenceError: If the iteration does not settle.
    """
    if reference not in REFERENCES:
        raise UnknownNameError("reference", reference, list(REFERENCES))
    frames = KNOWN_FRAMES if registration is None else registration
    return fit_rows(structure, Rows(campaign, np.arange(len(campaign)), frames, check_loss(loss), reference, sigma))


def fit_rows(structure: FreeRobot, rows: Rows) -> Estimate:
    """Estimate the free parameters of a structure.

    Minimises sum_i rho(|W_i (x_i - x(p, q_i, w_i))|) where x(p, ...) is the exact loaded equilibrium. Linear in the
    compliance to first order, x = J (sum_k c_k E_k) J^T w [Klimchik2018; Dumas2011], so that few steps suffice.

    Raises:
        InputError: If no parameter can be told, or there are fewer rows than parameters.
        ConvergenceError: If the iteration does not settle.
    """
    parameters = (*structure.parameters, *frame_parameters(rows.registration, rows.turned))
    state = attain_rows(structure, structure.nominal, rows, rows.registration)
    system = linearise(rows, state)
    told = forget_turns(rows, rows.registration, system)
    matrix = information(told, told.whitener(np.ones(BLOCKS)), rows.group)
    free = tell_apart(matrix, parameters)
    held = explain_held(rows.taken, state, matrix, parameters, free)
    _check_enough(system, free, held)
    state, system, noise, steps = _iterate(rows, parameters, free, state, system)
    covariance, freedom, clustered = state_spread(
        system, rows.taken.q, noise, rows.loss, rows.group, free, rows.sigma
    )
    return Estimate(
        parameters=parameters,
        values=np.r_[state.values, np.zeros(len(parameters) - len(state.values))],
        covariance=covariance,
        free=free,
        held=held,
        condition=condition_number(information(system, system.whitener(noise), rows.group), free),
        freedom=freedom,
        state=state,
        system=system,
        weights=loss_weights(rows.loss, system.distance(noise), system.known.sum(axis=1))[0],
        noise=noise,
        clustered=clustered,
        iterations=steps,
    )


def leave_poses_out(
    rows: Rows, estimate: Estimate, free: NDArray[np.bool_] | None = None, system: System | None = None
) -> HeldOutRows:
    """Refit without each block of poses and predict it.

    Args:
        rows: The measured rows; under its reference "difference", rows of a pose are compared with each other only.
        estimate: The fitted state: weights and noise.
        free: Which parameters are refitted; those of the estimate if left out. Shape (p,).
        system: The linearised problem at the fitted state; the estimate's own if left out. Shape (n, m, p).
    """
    return leave_out(
        estimate.system if system is None else system, estimate.noise, estimate.weights,
        estimate.free if free is None else free, group=rows.group, fold=rows.fold, pose=rows.pose,
    )  # fmt: skip


def _check_enough(system: System, free: NDArray[np.bool_], held: tuple[Inseparable, ...]) -> None:
    """Refuse poses that tell nothing, or less than there are parameters."""
    if len(free) and not free.any():
        raise InputError(f"nothing can be identified: {'; '.join(item.sentence for item in held[:3])}")
    if system.known.sum() <= free.sum():
        raise InputError(
            f"{system.known.sum()} measured numbers for {free.sum()} parameters, expected more; add poses"
        )


def _iterate(
    rows: Rows, parameters: tuple[Parameter, ...], free: NDArray[np.bool_], state: RowState, system: System
) -> tuple[RowState, System, Array, int]:
    """Step until the values stand still against their standard errors."""
    group, noise = rows.group, np.ones(BLOCKS)
    sizes, previous = np.array([parameter.size for parameter in parameters])[free], np.inf
    for count in range(1, MAX_STEPS + 1):
        if rows.sigma == "residuals":
            noise = estimate_noise(system, noise, free, group, rows.loss)
        weights = loss_weights(rows.loss, system.distance(noise), system.known.sum(axis=1))[0]
        residual, columns = weigh(system, system.whitener(noise) * np.sqrt(weights)[:, None], group)
        flat = stack(columns[:, :, free])
        inverse = invert(flat.T @ flat)
        step = np.zeros(len(free))
        step[free] = inverse @ (flat.T @ residual.ravel())
        state = _advance(rows, state, step)
        system = linearise(rows, state)
        strides = np.abs(step[free]) / (1e-9 * sizes + 1e-3 * np.sqrt(np.diag(inverse)))
        size = float(strides.max(initial=0.0))
        if size < 1 or (count > 8 and size < 1e3 and size > 0.5 * previous):
            if rows.sigma == "residuals":
                noise = estimate_noise(system, noise, free, group, rows.loss)
            return state, system, noise, count
        previous = size
    raise ConvergenceError("the fit did not settle; leave parameters out or check units and frames", residual=size)


def _advance(rows: Rows, state: RowState, step: Array) -> RowState:
    """Go along a step, halved until the loaded robot stands."""
    p = len(state.values)
    for _ in range(12):
        frames = move_frames(state.frames, step[p:], rows.turned)
        try:
            return attain_rows(state.structure, state.values + step[:p], rows, frames)
        except ConvergenceError:
            step = 0.5 * step
    raise ConvergenceError("the fitted robot buckles under its loads; check the units of the wrench", residual=np.inf)
