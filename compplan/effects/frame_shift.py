"""frame_shift: base or measuring instrument moved during the campaign."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.base_frame import SCALE, base_twists
from compplan.effects.forward_model import ForwardModel
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.effects.tool_frame import KEYS, twist_values
from compplan.robot import Array

name = "frame_shift"
words = "base or measuring instrument moved during the campaign"
sits, follows = "instrument or base", "temperature and time"
of_instrument = True


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a shift at the beginning of every run but the first; see `shift_at` for other rows."""
    for row in np.flatnonzero(np.diff(at.campaign.run_index) > 0) + 1:
        yield from shift_at(at, int(row))


def shift_at(at: Linearization, row: int, tried: int = 1) -> Iterable[Signature]:
    """Return a shift before a row: of the complete frame, or of its origin only."""
    twist = base_twists(at) * since(at.scene, row)[:, None, None]
    fixed, columns = {"row": row}, tuple(f"{key} {row}" for key in KEYS)
    frame = Signature(name, None, None, f"frame {row}", KEYS, SCALE, twist, None, fixed, tried=tried, columns=columns)
    yield from (frame, frame.part(f"origin {row}", slice(3)))


def since(model: ForwardModel, row: int) -> Array:
    """Return 1 from a row on and 0 before; 1 everywhere in a later campaign. Shape (n,)."""
    rows = np.arange(len(model.campaign))
    return np.ones(len(rows)) if model.later else (rows >= row).astype(float)


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Displace the robot in the measurement frame from the row on."""
    step = since(model, int(effect.parameters["row"]))[:, None] * twist_values(effect)
    return replace(model, base_twist=model.base_twist + step)
