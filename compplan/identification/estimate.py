"""Fit parameters to measured rows by weighted, robust Gauss-Newton of the exact loaded equilibrium."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from compplan.errors import InputError, UnknownNameError
from compplan.identification.forward import RowState, attain_fit, frame_parameters, linearise
from compplan.identification.parameters import FreeRobot, Parameter
from compplan.measurement.campaign import Campaign
from compplan.measurement.fit.intervals import (
    HeldOutRows,
    condition_number,
    find_free,
    find_similar,
    predict_left_out,
    state_spread,
)
from compplan.measurement.fit.least_squares import (
    BLOCKS,
    System,
    check_loss,
    information,
    iterate_gauss_newton,
    loss_weights,
    project_out_rotations,
)
from compplan.measurement.fit.rows import KNOWN_FRAMES, Rows
from compplan.measurement.frames import move_frames
from compplan.measurement.registration import Registration
from compplan.robot import Array

REFERENCES = ("absolute", "difference")


@dataclass(frozen=True, eq=False)
class Estimate:
    """Identified parameters and their uncertainty."""

    parameters: tuple[Parameter, ...]  #: Parameters of the structure, then of the frames. Length p.
    values: Array  #: Estimates; frame changes against the registration are zero by construction. Shape (p,).
    covariance: Array  #: Zero for parameters that are held. Shape (p, p).
    free: NDArray[np.bool_]  #: Parameters that were estimated; the others are held at their nominal value. Shape (p,).
    held: tuple[Inseparable, ...]  #: Parameters that cannot be determined (separately), and why.
    condition: float  #: Condition number of the column-scaled system of the free parameters.
    freedom: Array  #: Degrees of freedom behind each standard error [Satterthwaite1946]. Shape (p,).
    state: RowState  #: Fitted model at the rows.
    system: System  #: Linearised problem at the fitted model.
    weights: Array  #: Robust weight of each row. Shape (n,).
    #: Ratio of residual to stated standard deviation: position, orientation, encoders. Shape (3,).
    noise: Array
    #: Whether neighbouring residuals are correlated; intervals then come from groups of poses.
    clustered: bool
    iterations: int  #: Number of steps.

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
        """Values of the structure's parameters, without the frames."""
        return self.state.values

    @property
    def standard_errors(self) -> Array:
        """Standard errors; zero for a parameter that is held. Shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def intervals(self) -> Array:
        """Compute 95 % confidence intervals. Shape (p, 2)."""
        reach = stdtrit(self.freedom, 0.975) * self.standard_errors
        return np.column_stack([self.values - reach, self.values + reach])


def estimate_parameters(
    structure: FreeRobot, campaign: Campaign, *, registration: Registration | None = None,
    loss: str = "least_squares", reference: str = "absolute", sigma: str = "residuals",
) -> Estimate:  # fmt: skip
    """Estimate the free parameters of a structure from every row of a log; loss, reference and sigma as in `Rows`.

    The `parts` of the registration are fitted too; without a registration, base frame and TCP are known.

    Raises:
        InputError: If no parameter can be identified, or there are fewer rows than parameters.
        UnknownNameError: If a loss or a reference does not exist.
        ConvergenceError: If the iteration does not converge.
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
        InputError: If no parameter can be identified, or there are fewer rows than parameters.
        ConvergenceError: If the iteration does not converge.
    """
    parameters = (*structure.parameters, *frame_parameters(rows.registration, rows.turned))
    state = attain_fit(structure, structure.nominal, rows, rows.registration)
    system = linearise(rows, state)
    identifiable_system = project_out_rotations(system, rows.taken.observations, rows.registration)
    matrix = information(identifiable_system, identifiable_system.whitener(np.ones(BLOCKS)), rows.group)
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
        weights=loss_weights(rows.loss, system.distance(noise), system.count_measured)[0],
        noise=noise,
        clustered=clustered,
        iterations=steps,
    )


def leave_poses_out(rows: Rows, estimate: Estimate, free: NDArray[np.bool_] | None = None) -> HeldOutRows:
    """Refit without each block of poses and predict that block; weights and noise of the estimate are held.

    Parameters `free` (p,) default to the estimate's. With the rows' reference "difference", rows of a pose are compared
    with each other only.
    """
    return predict_left_out(
        estimate.system, estimate.noise, estimate.weights, estimate.free if free is None else free,
        group=rows.group, fold=rows.fold, pose=rows.pose,
    )  # fmt: skip


def _check_enough(system: System, free: NDArray[np.bool_], held: tuple[Inseparable, ...]) -> None:
    """Raise InputError if no parameter is identifiable, or if there are no more values than parameters."""
    if len(free) and not free.any():
        raise InputError(f"nothing can be identified: {'; '.join(item.sentence for item in held[:3])}")
    if system.known.sum() <= free.sum():
        raise InputError(f"{system.known.sum()} measured values for {free.sum()} parameters, expected more; add poses")


#: Order in which inseparable parameters are held at nominal values: refinements before joints and frames.
PREFERENCE = {
    "spring": 1, "effect": 2, "geometry": 2, "offset": 3, "joint": 4, "tool": 5, "base": 6, "contact": 7,
}  # fmt: skip


@dataclass(frozen=True)
class Inseparable:
    """A parameter held at its nominal value, the parameters that it cannot be separated from, and the reason.

    `together_with` is empty if the parameter cannot be determined at all.
    """

    held: str
    together_with: tuple[str, ...]
    reason: str

    @property
    def sentence(self) -> str:
        """Description in one sentence."""
        if not self.together_with:
            return f"{self.held} cannot be determined at all: {self.reason}"
        return f"{self.held} cannot be determined apart from {' and '.join(self.together_with)}: {self.reason}"


def find_inseparable(information: Array, parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    """Find a largest set of parameters that the data can separate; the rest has to be held. Shape (p,)."""
    sizes = np.array([parameter.size for parameter in parameters])
    kinds = ["offset" if parameter.name.endswith(".offset") else parameter.kind for parameter in parameters]
    return find_free(information, sizes, [PREFERENCE[kind] for kind in kinds])


def explain_held(
    log: Campaign, state: RowState, information: Array, parameters: Sequence[Parameter], free: NDArray[np.bool_]
) -> tuple[Inseparable, ...]:
    """List the parameters held fixed, each with the reason and the parameters it cannot be separated from."""
    sizes = np.array([parameter.size for parameter in parameters])
    found = []
    for k, mates in find_similar(information, sizes, free):
        names = tuple(parameters[j].name for j in mates)
        if mates:
            reason = _explain_inseparable(log, state, [parameters[j] for j in (k, *mates)])
        else:
            reason = _explain_undetermined(log, state, parameters[k])
        found.append(Inseparable(parameters[k].name, names, reason))
    return tuple(found)


def _loads_are_vertical(load: Array) -> bool:
    """Check whether every external load is a vertical force without a moment (z of the frame is vertical)."""
    across = np.abs(load[:, [0, 1, 3, 4, 5]]).max(initial=0.0)
    return bool(across < 1e-9 * max(np.abs(load[:, 2]).max(initial=0.0), 1e-300))


def _explain_undetermined(log: Campaign, state: RowState, parameter: Parameter) -> str:
    load, chain = log.wrench, state.structure.chain
    gravity = chain.gravity.any() and chain.mass.any()
    if parameter.kind in ("geometry", "effect", "base", "tool", "contact"):
        return "these poses do not show it"
    if not np.abs(load).max(initial=0.0) > 0 and not gravity:
        return "no row carries a load, and the model has no gravity"
    at, frames = parameter.coordinate(state.scene.robot), state.loaded
    torque, element = np.abs(state.torque[:, at]).max(initial=0.0), state.attained.chain.spring_elements[at]
    axis, lever = frames.axis[:, element], frames.tcp_position - frames.origin[:, element]
    reach = max(float(np.linalg.norm(lever, axis=1).max()), 0.1)
    possible = float(np.linalg.norm(load[:, :3], axis=1).max(initial=0.0)) * reach
    if torque < 1e-6 * max(possible, 1.0):
        if not np.abs(load).max(initial=0.0) > 0:
            return "the weight of the links never acts about its axis, and no row carries another load"
        upright = np.abs(np.abs(axis[:, 2]) - 1).max() < 1e-9
        if _loads_are_vertical(load) and upright:
            return "its axis is vertical and all loads are vertical; add loads to the side"
        if not np.abs(load[:, 3:]).max(initial=0.0) > 0:
            return "every force passes through its axis or along it; add a lever or a moment about its axis"
        return "the load never acts about its axis"
    return "these loads hardly move the measured point by it; load it more, or measure orientation"


def _explain_inseparable(log: Campaign, state: RowState, parameters: Sequence[Parameter]) -> str:
    kinds, rigid = {parameter.kind for parameter in parameters}, {"base", "tool", "contact", "geometry"}
    if len(parameters) == 2 and _same_axis(state, parameters):
        return "both turn about (or slide along) the same axis under the same load, so only their sum acts"
    if kinds <= rigid:
        return "they are the same rigid motion of the measured point"
    if kinds & rigid and "effect" not in kinds:
        return "with these loads bending resembles an error of frame or geometry; load each pose in several ways"
    if _loads_are_vertical(log.wrench):
        return "all loads are vertical, and then they act in proportion; add loads to the side and moments"
    return "they move the measured point in proportion; add poses and load directions, or measure orientation"


def _same_axis(state: RowState, parameters: Sequence[Parameter]) -> bool:
    coordinates = [parameter.coordinate(state.scene.robot) for parameter in parameters]
    if min(coordinates) < 0:
        return False
    chain, frames = state.attained.chain, state.loaded
    first, second = (chain.spring_elements[at] for at in coordinates)
    if chain.translates[first] != chain.translates[second]:
        return False
    apart = frames.origin[:, first] - frames.origin[:, second]
    parallel = np.linalg.norm(np.cross(frames.axis[:, first], frames.axis[:, second]), axis=1).max() < 1e-3
    coincident = np.linalg.norm(np.cross(frames.axis[:, first], apart), axis=1).max() < 1e-3
    return bool(parallel and (chain.translates[first] or coincident))
