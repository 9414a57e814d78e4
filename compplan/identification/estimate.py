"""Fit the parameters to measured rows: weighted, robust Gauss-Newton of the exact loaded equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from compplan.errors import InputError, UnknownNameError
from compplan.identification.forward import RowState, attain_fit, frame_parameters, linearise
from compplan.identification.parameters import FreeRobot, Parameter
from compplan.identification.separability import Inseparable, explain_held, find_inseparable
from compplan.measurement.campaign import Campaign
from compplan.measurement.fit.intervals import HeldOutRows, condition_number, predict_left_out, state_spread
from compplan.measurement.fit.least_squares import (
    BLOCKS,
    System,
    check_loss,
    forget_turns,
    information,
    iterate_gauss_newton,
    loss_weights,
)
from compplan.measurement.fit.rows import KNOWN_FRAMES, Rows
from compplan.measurement.frames import move_frames
from compplan.measurement.registration import Registration
from compplan.robot import Array

REFERENCES = ("absolute", "difference")


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
        reach = stdtrit(self.freedom, tail) * self.standard_errors
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
    state = attain_fit(structure, structure.nominal, rows, rows.registration)
    system = linearise(rows, state)
    told = forget_turns(system, rows.taken.sights, rows.registration)
    matrix = information(told, told.whitener(np.ones(BLOCKS)), rows.group)
    free = find_inseparable(matrix, parameters)
    held = explain_held(rows.taken, state, matrix, parameters, free)
    _check_enough(system, free, held)
    p, sizes = len(state.values), np.array([parameter.size for parameter in parameters])

    def advance(at: RowState, step: Array) -> RowState:
        return attain_fit(structure, at.values + step[:p], rows, move_frames(at.frames, step[p:], rows.turned))

    state, system, noise, steps = iterate_gauss_newton(
        state, partial(linearise, rows), advance, sizes, free, group=rows.group, loss=rows.loss, sigma=rows.sigma
    )
    covariance, freedom, clustered = state_spread(system, rows.taken.q, noise, rows.loss, rows.group, free, rows.sigma)
    return Estimate(
        parameters=parameters,
        values=np.r_[state.values, np.zeros(len(parameters) - p)],
        covariance=covariance,
        free=free,
        held=held,
        condition=condition_number(information(system, system.whitener(noise), rows.group), free),
        freedom=freedom,
        state=state,
        system=system,
        weights=loss_weights(rows.loss, system.distance(noise), system.seen)[0],
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
    return predict_left_out(
        estimate.system if system is None else system, estimate.noise, estimate.weights,
        estimate.free if free is None else free, group=rows.group, fold=rows.fold, pose=rows.pose,
    )  # fmt: skip


def _check_enough(system: System, free: NDArray[np.bool_], held: tuple[Inseparable, ...]) -> None:
    """Refuse poses that tell nothing, or less than there are parameters."""
    if len(free) and not free.any():
        raise InputError(f"nothing can be identified: {'; '.join(item.sentence for item in held[:3])}")
    if system.known.sum() <= free.sum():
        raise InputError(f"{system.known.sum()} measured values for {free.sum()} parameters, expected more; add poses")
