"""tool_shift: tool or target moved on the flange during the campaign."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from compplan.effects.forward_model import ForwardModel
from compplan.effects.frame_shift import since
from compplan.effects.linearization import Linearization
from compplan.effects.signature import Effect, Signature
from compplan.effects.tool_frame import KEYS, SCALE, shows_turn, tool_twists, twist_values

name = "tool_shift"
words = "tool or target moved on the flange during the campaign"
sits, follows = "tool", "temperature and time"


def signatures(at: Linearization) -> Iterable[Signature]:
    """Return a shift at the beginning of every run but the first; see `shift_at` for other rows."""
    for row in np.flatnonzero(np.diff(at.campaign.run_index) > 0) + 1:
        yield from shift_at(at, int(row))


def shift_at(at: Linearization, row: int, tried: int = 1) -> Iterable[Signature]:
    """Return a shift before a row: an offset, or one with a rotation if the data show it."""
    twist = tool_twists(at) * since(at.scene, row)[:, None, None]
    form, fixed, columns = f"offset+turn {row}", {"row": row}, tuple(f"{key} {row}" for key in KEYS)
    both = Signature(name, None, None, form, KEYS, SCALE, twist, None, fixed, tried=tried, columns=columns)
    yield both.part(f"offset {row}", slice(3))
    if shows_turn(at, twist):
        yield both


def apply(model: ForwardModel, effect: Effect) -> ForwardModel:
    """Move the target on the tool from the row on."""
    step = since(model, int(effect.parameters["row"]))[:, None] * twist_values(effect)
    return replace(model, tool_twist=model.tool_twist + step)
