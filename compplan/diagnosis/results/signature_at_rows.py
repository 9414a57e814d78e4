"""Probe: what a claimed effect does at further rows, by finite differences of its exact forward model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.diagnosis.data.shared import ROUNDING
from compplan.effects import apply_effects, solve_model_poses, transmission_error
from compplan.effects.forward_model import Attained
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Signature
from compplan.robot import Array

#: Step of the finite differences of an exact model, in units of a parameter's scale (theory: its error, and that of a
#: model solved to rounding, are alike there).
NUDGE = float(np.sqrt(ROUNDING))


def probe_signature(at: Linearization, signature: Signature) -> Signature:
    """Return a claimed signature at further rows by finite differences of its exact forward model."""
    if signature.name == transmission_error.name:
        return _probe_curve(at, signature)
    twists, encoders = [], []
    for k, scale in enumerate(signature.scale):
        values = np.zeros(len(signature.scale))
        values[k] = NUDGE * scale
        moved = solve_model_poses(apply_effects(at.scene, [signature.effect(values)]))
        twist, encoder = _difference(at, moved, values[k])
        twists.append(twist)
        encoders.append(encoder)
    return replace(signature, twist=np.stack(twists, axis=-1), encoder=np.stack(encoders, axis=-1))


def _probe_curve(at: Linearization, signature: Signature) -> Signature:
    """Return a curve over a joint's angle at further rows: each row knows the joint's error there alone."""
    index, scene = at.scene.joint_index(signature.joint), at.scene
    nudge = NUDGE * float(signature.scale[0])
    moved = solve_model_poses(replace(scene, drive=scene.drive + nudge * (np.arange(at.robot.nq) == index)))
    twist, encoder = _difference(at, moved, nudge)
    angle, units = np.nan_to_num(at.campaign.q[:, index]), np.eye(len(signature.scale))
    shape = np.column_stack([transmission_error.error_at(signature.effect(unit), angle) for unit in units])
    return replace(signature, twist=twist[..., None] * shape[:, None], encoder=encoder[..., None] * shape[:, None])


def _difference(at: Linearization, moved: Attained, nudge: float) -> tuple[Array, Array]:
    """Return how target and link-side readings have moved per unit of a parameter. Shapes (n, 6), (n, nq)."""
    step = (moved.position - at.attained.position) / nudge
    turn = np.einsum("nij,nkj->nik", moved.rotation, at.attained.rotation) / nudge
    spin = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1
    )
    return np.concatenate([step, spin], axis=1), (moved.link - at.attained.link) / nudge
