"""What the effects' forward model says about measured rows, and how that changes with the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.effects import EFFECTS, apply_effects, attain_scene, stage_scene
from compplan.effects.linearization import Linearization, linearize_scene, unit_twist
from compplan.effects.scene import Attained, Scene, own_springs
from compplan.identify.parameters import AXES, TYPICAL_SIZE, FreeRobot, Parameter
from compplan.identify.rows import SIGMA_ENCODER, Rows
from compplan.measure.fit.system import DISTANCES, ENCODERS, ORIENTATION, POSITION, System, stack
from compplan.measure.frames import frame_columns
from compplan.measure.registration import CONTACTS, Registration, campaign_gap
from compplan.measure.sights import CONTACT, DISTANCE, Sights
from compplan.robot import Array
from compplan.statics.chain import Frames, load_elements

#: Elastic coordinates are settled to this while a fit goes on. [rad or m]
SETTLED = 1e-12


@dataclass(frozen=True, eq=False)
class RowState:
    """A structure with some values at the n rows of a fit.

    Attributes:
        structure: Robot and parameters.
        values: Their values. Shape (p,).
        frames: Frames of the campaign.
        scene: The robot with all effects, at the rows; at the whole log where an effect remembers other rows.
        attained: What the scene comes to.
        index: The rows of the fit in the scene. Shape (n,).
    """

    structure: FreeRobot
    values: Array
    frames: Registration
    scene: Scene
    attained: Attained
    index: NDArray[np.int_]

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
        """Tell which rows carry link-side readings. Shape (n,)."""
        return self.scene.campaign.link_controlled[self.index]

    @cached_property
    def linear(self) -> Linearization:
        """First derivatives of the scene."""
        current = {effect.place: effect.parameters for effect in self.structure.effects(self.values)}
        return linearize_scene(self.scene, self.attained, current)


def attain_rows(structure: FreeRobot, values: Array, rows: Rows, frames: Registration) -> RowState:
    """Solve the loaded equilibrium of a structure with some values at the rows of a fit.

    Raises:
        ConvergenceError: If the equilibrium does not settle.
    """
    effects = [*structure.known, *structure.effects(values)]
    whole = any(effect.name not in ("joint_offset", "link_geometry") for effect in effects)
    log = rows.campaign if whole else rows.taken
    scene = apply_effects(stage_scene(structure.soften(values), log, registration=frames), effects)
    index = rows.row if whole else np.arange(len(rows))
    return RowState(structure, values, frames, scene, attain_scene(scene, tolerance=SETTLED), index)


def pose_residuals(rows: Rows, state: RowState) -> Array:
    """Take measured minus predicted, position then rotation vector, measuring axes; [m, rad]. Shape (n, 6)."""
    residual = np.full((len(rows), 6), np.nan)
    base = state.frames.base[:3, :3]
    residual[:, :3] = campaign_gap(rows.taken, state.position, state.frames) @ base.T
    if rows.taken.rotation is not None:
        known = np.isfinite(rows.taken.rotation).all(axis=(1, 2))
        turn = rows.taken.rotation[known] @ np.swapaxes(state.rotation[known], 1, 2)
        residual[known, 3:] = Rotation.from_matrix(turn).as_rotvec()
    return residual


def encoder_residuals(rows: Rows, state: RowState) -> Array | None:
    """Compare link-side minus motor-side readings with what the gears yield [Klimchik2018, eqs. 7-8]; None without."""
    if rows.encoder is None:
        return None
    attained = state.attained
    expected = (attained.link - attained.motor)[state.index]
    seen = [k for k, spring in own_springs(state.structure.robot).items() if spring.actuator]
    if not state.structure.forms:
        silent = np.setdiff1d(np.arange(expected.shape[1]), seen)
        expected[:, silent] = np.nan
    return np.asarray(rows.encoder - expected)


def differentiate(rows: Rows, state: RowState) -> tuple[Array, Array]:
    """Differentiate the measured pose and the encoders' difference by every parameter, those of the frames last.

    dx/dc_k = J E_k tau, effects by their signatures; the change of tau with theta is left out (it is of the order of
    load by buckling load), which changes the steps of Gauss-Newton but not where a consistent fit ends.

    Returns:
        Pose, linear rows first, measuring axes (n, 6, p + frame parameters); encoders (n, nq, p + frame parameters).
    """
    structure, n = state.structure, len(rows)
    pose = np.zeros((n, 6, len(structure.parameters)))
    encoder = np.zeros((n, structure.robot.nq, len(structure.parameters)))
    motion, own = _spring_motion(state), own_springs(state.scene.robot)
    seen = {spring.coordinate: spring for spring in own.values() if spring.actuator}
    for k, parameter in enumerate(structure.parameters):
        for i, j, coefficient in parameter.entries(state.scene.robot):
            pose[:, :, k] += coefficient * motion[:, :, i] * state.torque[:, None, j]
            if i != j:
                pose[:, :, k] += coefficient * motion[:, :, j] * state.torque[:, None, i]
            elif i in seen:
                encoder[:, seen[i].joint, k] += coefficient * seen[i].sign * state.torque[:, i]
    _add_effects(state, pose, encoder)
    R = state.frames.base[:3, :3]
    pose = np.concatenate([np.einsum("ij,njp->nip", R, pose[:, :3]), np.einsum("ij,njp->nip", R, pose[:, 3:])], axis=1)
    columns = frame_columns(
        state.frames, state.position, state.loaded.tcp_rotation, rows.taken.target_index, rows.turned, rows.taken.sights
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
    if rows.taken.sights is not None:
        residual, columns, sigma, block = _sight_rows(rows.taken.sights, state, residual, columns, sigma, block)
    missing = ~np.isfinite(residual)
    return System(np.where(missing, 0.0, residual), columns, np.where(missing, np.inf, sigma), block)


def _sight_rows(
    sights: Sights, state: RowState, residual: Array, columns: Array, sigma: Array, block: NDArray[np.int_]
) -> tuple[Array, Array, Array, NDArray[np.int_]]:
    """Put the one number of a row that tells no more first, and known distances beside the first row of a contact."""
    R, frames = state.frames.base[:3, :3], state.frames
    point = (state.position - frames.base[:3, 3]) @ R
    direction = sights.directions(point, frames.places) @ R.T
    one = np.isfinite(direction).all(axis=1)
    residual[one, 0] = np.einsum("ni,ni->n", direction[one], residual[one, :3])
    residual[one, 1:3] = np.nan
    columns[one, 0] = np.einsum("ni,nip->np", direction[one], columns[one, :3])
    columns[one, 1:3] = 0.0
    if CONTACTS not in frames.parts or not len(sights.known):
        return residual, columns, sigma, block
    known, count = sights.known, np.arange(len(sights.known))
    extra = np.full((len(residual), len(known)), np.nan)
    slopes = np.zeros((*extra.shape, columns.shape[2]))
    own = known.slopes(frames.places).reshape(len(known), -1)
    extra[sights.first_rows(), count] = known.gap(frames.places)
    slopes[sights.first_rows(), count, columns.shape[2] - own.shape[1] :] = own
    return (
        np.hstack([residual, extra]), np.concatenate([columns, slopes], axis=1),
        np.hstack([sigma, np.broadcast_to(known.sigma, extra.shape)]), np.r_[block, np.full(len(known), DISTANCES)],
    )  # fmt: skip


def forget_turns(rows: Rows, frames: Registration, system: System) -> System:
    """Take out of the derivatives what only seems to tell how the whole arm is turned about its base.

    Contacts and ball bars look the same however the base is turned with their unknown places: a turn w moves what is
    left of a contact's row, r, by w x r, which is noise. Left in, it would tell the turn to one radian over the root of
    the number of rows.
    """
    sights = rows.taken.sights
    if sights is None or CONTACTS not in frames.parts or not np.isin(sights.kind, (CONTACT, DISTANCE)).all():
        return system
    contact, turns = sights.kind == CONTACT, np.zeros((*system.residual.shape, 3))
    turns[contact, :3] = np.swapaxes(np.cross(np.eye(3)[None], system.residual[contact, None, :3]), 1, 2)
    basis, flat = np.linalg.qr(stack(turns))[0], stack(system.columns)
    return system._replace(columns=(flat - basis @ (basis.T @ flat)).reshape(system.columns.shape))


def _spring_motion(state: RowState) -> Array:
    """Motion of the target per elastic coordinate, base axes; none of actuators that are controlled. Shape (n, 6, s)"""
    chain, frames, point = state.attained.chain, state.loaded, state.attained.target[state.index]
    columns = [
        unit_twist(frames.axis[:, k], frames.origin[:, k], point, bool(chain.translates[k]))
        for k in chain.spring_elements
    ]
    motion = np.stack(columns, axis=-1) if columns else np.zeros((len(point), 6, 0))
    return np.asarray(motion * ~(state.link_side[:, None] & chain.actuator)[:, None, :])


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
    """List the parameters of the frames that are fitted: small changes of pose against where they stand.

    Args:
        frames: Frames of the campaign; its `parts` are fitted.
        turned: Whether orientation is measured; without it a tool is a point.
    """
    many = len(frames.tool) > 1
    labels = [f"tool({label or k})" if many else "tool" for k, label in enumerate(frames.targets, 1)]
    wanted: list[tuple[str, str, tuple[str, ...]]] = [("base", "base", AXES)] if "base" in frames.parts else []
    if "tool" in frames.parts:
        wanted += [(label, "tool", AXES if turned else AXES[:3]) for label in labels]
    if CONTACTS in frames.parts:
        wanted += [(f"contact({label})", CONTACTS, AXES[:3]) for label in frames.contacts]
    return tuple(
        Parameter(f"{label}.{axis}", kind, unit := "m" if axis[0] == "t" else "rad", 0.0, TYPICAL_SIZE[unit])
        for label, kind, axes in wanted
        for axis in axes
    )
