"""Rows of a fit that other instruments than a tracker saw: their one number, and known distances between contacts."""

from __future__ import annotations

import numpy as np

from compplan.measurement.fit.linear_system import DISTANCES, System, stack
from compplan.measurement.observations import CONTACT, DISTANCE, Observations
from compplan.measurement.registration import CONTACTS, Registration
from compplan.robot import Array


def observe_rows(system: System, sights: Observations, frames: Registration, position: Array) -> System:
    """Put the one number of a row that tells no more first, and known distances beside the first row of a contact.

    Args:
        system: The problem, positions first, measuring axes; places of contacts last where they are fitted.
        sights: What was seen in its rows.
        frames: Frames of the campaign, places of contacts among them.
        position: Measured points as predicted, measuring frame. Shape (n, 3). [m]
    """
    residual, columns, sigma = system.residual.copy(), system.columns.copy(), system.sigma.copy()
    R = frames.base[:3, :3]
    direction = sights.directions((position - frames.base[:3, 3]) @ R, frames.places) @ R.T
    one = np.isfinite(direction).all(axis=1)
    residual[one, 0] = np.einsum("ni,ni->n", direction[one], residual[one, :3])
    columns[one, 0] = np.einsum("ni,nip->np", direction[one], columns[one, :3])
    residual[one, 1:3], columns[one, 1:3], sigma[one, 1:3] = 0.0, 0.0, np.inf
    if CONTACTS not in frames.parts or not len(sights.known):
        return System(residual, columns, sigma, system.block)
    known, first = sights.known, (sights.first_rows(), np.arange(len(sights.known)))
    extra, spread = np.zeros((len(residual), len(known))), np.full((len(residual), len(known)), np.inf)
    slopes = np.zeros((*extra.shape, columns.shape[2]))
    own = known.slopes(frames.places).reshape(len(known), -1)
    extra[first], spread[first] = known.gap(frames.places), known.sigma
    slopes[(*first, slice(columns.shape[2] - own.shape[1], None))] = own
    return System(
        np.hstack([residual, extra]), np.concatenate([columns, slopes], axis=1),
        np.hstack([sigma, spread]), np.r_[system.block, np.full(len(known), DISTANCES)],
    )  # fmt: skip


def forget_turns(system: System, sights: Observations | None, frames: Registration) -> System:
    """Take out of the derivatives what only seems to tell how the whole arm is turned about its base.

    Contacts and ball bars look the same however the base is turned with their unknown places: a turn w moves what is
    left of a contact's row, r, by w x r, which is noise. Left in, it would tell the turn to one radian over the root of
    the number of rows.
    """
    if sights is None or CONTACTS not in frames.parts or not np.isin(sights.kind, (CONTACT, DISTANCE)).all():
        return system
    contact, turns = sights.kind == CONTACT, np.zeros((*system.residual.shape, 3))
    turns[contact, :3] = np.swapaxes(np.cross(np.eye(3)[None], system.residual[contact, None, :3]), 1, 2)
    basis, flat = np.linalg.qr(stack(turns))[0], stack(system.columns)
    return system._replace(columns=(flat - basis @ (basis.T @ flat)).reshape(system.columns.shape))
