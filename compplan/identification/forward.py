"""Predict measured rows with the forward model of the effects; differentiate by the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compplan.effects import EFFECTS, apply_effects, build_model, solve_model_poses
from compplan.effects.forward_model import Attained, ForwardModel, own_springs
from compplan.effects.linearization import Linearization, linearize_model
from compplan.identification.parameters import TYPICAL_SIZE, FreeRobot, Parameter
from compplan.measurement.fit.least_squares import ENCODERS, ORIENTATION, POSITION, System, observe_rows
from compplan.measurement.fit.rows import SIGMA_ENCODER, Rows
from compplan.measurement.frames import frame_columns, name_frames
from compplan.measurement.registration import Registration, campaign_gap, campaign_turn
from compplan.robot import Array
from compplan.statics.chain import Frames, load_elements

#: Tolerance of the elastic coordinates during a fit. [rad or m]
EQUILIBRIUM_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class RowState:
    """A structure with given values at the n rows of a fit."""

    structure: FreeRobot  #: Robot and parameters.
    values: Array  #: Values of the parameters. Shape (p,).
    frames: Registration  #: Frames of the campaign.
    #: The robot with all effects, at the rows; at the complete log if an effect depends on preceding rows.
    scene: ForwardModel
    attained: Attained  #: Loaded equilibrium of the scene.
    index: NDArray[np.int_]  #: Indices of the fitted rows in the scene. Shape (n,).

    @property
    def position(self) -> Array:
        """Measured point, measuring frame. Shape (n, 3). [m]"""
        return self.attained.position[self.index]

    @property
    def rotation(self) -> Array:
        """Measured orientation, measuring frame. Shape (n, 3, 3)."""
        return self.attained.rotation[self.index]

    @cached_property
    def loaded(self) -> Frames:
        """Frames of the loaded chain at the rows, base axes."""
        return Frames(*(part[self.index] for part in self.attained.frames))

    @cached_property
    def torque(self) -> Array:
        """Load on each elastic coordinate. Shape (n, s). [N m or N]"""
        load = load_elements(self.attained.chain, self.attained.frames, self.attained.wrench)
        return np.asarray(load[self.index][:, self.attained.chain.spring_elements])

    @cached_property
    def link_side(self) -> NDArray[np.bool_]:
        """Rows with link-side readings. Shape (n,)."""
        return self.scene.campaign.link_controlled[self.index]

    @cached_property
    def linear(self) -> Linearization:
        """First derivatives of the scene."""
        current = {effect.place: effect.parameters for effect in self.structure.effects(self.values)}
        return linearize_model(self.scene, self.attained, current)


def attain_fit(structure: FreeRobot, values: Array, rows: Rows, frames: Registration) -> RowState:
    """Solve the loaded equilibrium of a structure with given values at the rows of a fit.

    Raises:
        ConvergenceError: If the equilibrium is not found.
    """
    effects = [*structure.known, *structure.effects(values)]
    whole = any(effect.name not in ("joint_offset", "link_geometry") for effect in effects)
    log = rows.campaign if whole else rows.taken
    scene = apply_effects(build_model(structure.set_compliances(values), log, registration=frames), effects)
    index = rows.row if whole else np.arange(len(rows))
    return RowState(structure, values, frames, scene, solve_model_poses(scene, tolerance=EQUILIBRIUM_TOLERANCE), index)


def pose_residuals(rows: Rows, state: RowState) -> Array:
    """Compute measured minus predicted, position then rotation vector, measuring axes; [m, rad]. Shape (n, 6)."""
    position = campaign_gap(rows.taken, state.position, state.frames) @ state.frames.base[:3, :3].T
    return np.hstack([position, campaign_turn(rows.taken, state.rotation)])


def encoder_residuals(rows: Rows, state: RowState) -> Array | None:
    """Compare link-side minus motor-side readings with gear deflections [Klimchik2018, eqs. 7-8]; None without."""
    if rows.encoder is None:
        return None
    attained = state.attained
    expected = (attained.link - attained.motor)[state.index]
    measured = [k for k, spring in own_springs(state.structure.robot).items() if spring.actuator]
    if not state.structure.forms:
        unmeasured = np.setdiff1d(np.arange(expected.shape[1]), measured)
        expected[:, unmeasured] = np.nan
    return np.asarray(rows.encoder - expected)


def differentiate(rows: Rows, state: RowState) -> tuple[Array, Array]:
    """Differentiate measured pose and encoder difference by every parameter, those of the frames last.

    dx/dc_k = J_k tau_k; effects by their signatures. The change of tau with theta is neglected (of the order of load by
    buckling load): it changes the steps of Gauss-Newton, not the solution of a consistent fit. Shapes (n, 6, p), linear
    rows first, measuring axes, and (n, nq, p).
    """
    structure, n = state.structure, len(rows)
    pose = np.zeros((n, 6, len(structure.parameters)))
    encoder = np.zeros((n, structure.robot.nq, len(structure.parameters)))
    chain, springs = state.attained.chain, own_springs(state.scene.robot)
    motion = state.attained.jacobian[state.index][:, :, chain.spring_elements]
    # actuators controlled by their link-side encoder do not deflect
    motion = motion * ~(state.link_side[:, None] & chain.actuator)[:, None, :]
    measured = {spring.coordinate: spring for spring in springs.values() if spring.actuator}
    for k, parameter in enumerate(structure.parameters):
        at = parameter.coordinate(state.scene.robot)
        if at >= 0:
            pose[:, :, k] = motion[:, :, at] * state.torque[:, None, at]
        if at in measured:
            encoder[:, measured[at].joint, k] = measured[at].sign * state.torque[:, at]
    _add_effects(state, pose, encoder)
    R, log = state.frames.base[:3, :3], rows.taken
    pose = np.concatenate([np.einsum("ij,njp->nip", R, pose[:, :3]), np.einsum("ij,njp->nip", R, pose[:, 3:])], axis=1)
    columns = frame_columns(
        state.frames, state.position, state.loaded.tcp_rotation, log.target_index, rows.turned, log.observations
    )
    pose = np.concatenate([pose, *columns], axis=2)
    encoder = np.concatenate([encoder, np.zeros((n, encoder.shape[1], pose.shape[2] - encoder.shape[2]))], axis=2)
    return pose, encoder


def linearise(rows: Rows, state: RowState) -> System:
    """Build the linearised problem at a state."""
    residual, extra = pose_residuals(rows, state), encoder_residuals(rows, state)
    columns, slopes = differentiate(rows, state)
    sigma, block = rows.deviation, np.repeat([POSITION, ORIENTATION], 3)
    if extra is not None:
        residual, columns = np.hstack([residual, extra]), np.concatenate([columns, slopes], axis=1)
        sigma = np.hstack([sigma, np.full(extra.shape, SIGMA_ENCODER)])
        block = np.r_[block, np.full(extra.shape[1], ENCODERS)]
    missing = ~np.isfinite(residual)
    system = System(np.where(missing, 0.0, residual), columns, np.where(missing, np.inf, sigma), block)
    observations = rows.taken.observations
    return system if observations is None else observe_rows(system, observations, state.frames, state.position)


def _add_effects(state: RowState, pose: Array, encoder: Array) -> None:
    """Add the columns of effects, from their signatures at the state."""
    forms = state.structure.forms
    offered = [s for name in {form.name for form in forms} for s in EFFECTS[name].signatures(state.linear)]
    found = {(signature.place, signature.form): signature for signature in offered}
    for k, parameter in enumerate(state.structure.parameters):
        if parameter.form is None or (parameter.form.place, parameter.form.form) not in found:
            continue
        signature = found[parameter.form.place, parameter.form.form]
        pose[:, :, k] = signature.twist[state.index, :, parameter.item]
        if signature.encoder is not None:
            encoder[:, :, k] = signature.encoder[state.index, :, parameter.item]


def frame_parameters(frames: Registration, turned: bool) -> tuple[Parameter, ...]:
    """List the parameters of the fitted frames: small changes of pose against the registration.

    `turned`: whether orientation is measured; without it a tool is a point.
    """
    return tuple(
        Parameter(f"{label}.{axis}", part, unit := "m" if axis[0] == "t" else "rad", 0.0, TYPICAL_SIZE[unit])
        for label, part, axes in name_frames(frames, turned)
        for axis in axes
    )
