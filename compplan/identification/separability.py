"""What a set of poses and loads can tell, what it can tell together only, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.identification.forward import RowState
from compplan.identification.parameters import Parameter
from compplan.measurement.campaign import Campaign
from compplan.measurement.fit.intervals import find_free, find_mates
from compplan.robot import Array

#: Held at its nominal value first: what is refinement rather than the joints and frames themselves.
PREFERENCE = {
    "link": 0, "spring": 1, "effect": 2, "geometry": 2, "offset": 3, "joint": 4, "tool": 5, "base": 6, "contact": 7,
}  # fmt: skip


@dataclass(frozen=True)
class Inseparable:
    """Parameters that the data cannot tell, alone or apart from others.

    Attributes:
        held: The parameter that is held at its nominal value.
        together_with: Parameters that move the measured pose in the same way; empty if it cannot be determined at all.
        reason: Why, in a sentence.
    """

    held: str
    together_with: tuple[str, ...]
    reason: str

    @property
    def sentence(self) -> str:
        """Say it in one sentence."""
        if not self.together_with:
            return f"{self.held} cannot be determined at all: {self.reason}"
        return f"{self.held} cannot be determined apart from {' and '.join(self.together_with)}: {self.reason}"


def find_inseparable(information: Array, parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    """Find a largest set of parameters that the data tell apart; the rest has to be held. Shape (p,)."""
    sizes = np.array([parameter.size for parameter in parameters])
    kinds = ["offset" if parameter.name.endswith(".offset") else parameter.kind for parameter in parameters]
    return find_free(information, sizes, [PREFERENCE[kind] for kind in kinds])


def explain_held(
    log: Campaign, state: RowState, information: Array, parameters: Sequence[Parameter], free: NDArray[np.bool_]
) -> tuple[Inseparable, ...]:
    """Name every parameter that is held, what it cannot be determined apart from, and why.

    Args:
        log: The measured rows.
        state: What the model says about them.
        information: Information matrix. Shape (p, p).
        parameters: All parameters, frames included.
        free: Which of them are free. Shape (p,).
    """
    sizes = np.array([parameter.size for parameter in parameters])
    found = []
    for k, mates in find_mates(information, sizes, free):
        names = tuple(parameters[j].name for j in mates)
        if mates:
            reason = _why_together(log, state, [parameters[j] for j in (k, *mates)])
        else:
            reason = _why_never(log, state, parameters[k])
        found.append(Inseparable(parameters[k].name, names, reason))
    return tuple(found)


def _loads_are_vertical(load: Array) -> bool:
    """Tell whether every external load is a vertical force without a moment (the frame's z being vertical)."""
    across = np.abs(load[:, [0, 1, 3, 4, 5]]).max(initial=0.0)
    return bool(across < 1e-9 * max(np.abs(load[:, 2]).max(initial=0.0), 1e-300))


def _why_never(log: Campaign, state: RowState, parameter: Parameter) -> str:
    load, chain = log.wrench, state.structure.chain
    gravity = chain.gravity.any() and chain.mass.any()
    if parameter.kind in ("geometry", "effect", "base", "tool", "contact"):
        return "these poses do not show it"
    if not np.abs(load).max(initial=0.0) > 0 and not gravity:
        return "no row carries a load, and the model has no gravity"
    elastic = sorted({index for i, j, _ in parameter.entries(state.scene.robot) for index in (i, j)})
    torque, frames = np.abs(state.torque[:, elastic]).max(initial=0.0), state.loaded
    element = state.attained.chain.spring_elements[elastic[0]]
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
    if log.rotation is None and parameter.kind in ("joint", "spring"):
        return "its motion hardly moves the measured point; measure orientation, or a point off its axis"
    unit = "N" if parameter.unit == "m/N" else "N m"
    return f"the load about it, at most {torque:.3g} {unit}, is too small for this noise"


def _why_together(log: Campaign, state: RowState, parameters: Sequence[Parameter]) -> str:
    kinds, rigid = {parameter.kind for parameter in parameters}, {"base", "tool", "contact", "geometry"}
    if len(parameters) == 2 and _same_axis(state, parameters):
        return "both turn about (or slide along) the same axis under the same load, so only their sum acts"
    if kinds <= rigid:
        return "they are the same rigid motion of the measured point"
    if "effect" in kinds:
        return "they move the measured point in proportion in these rows; add poses, loads and ways to approach"
    if kinds & rigid:
        return "with these loads bending resembles an error of frame or geometry; load each pose in several ways"
    if _loads_are_vertical(log.wrench):
        return "all loads are vertical, and then they act in proportion; add loads to the side and moments"
    if state.structure.chain.gravity.any() and not np.abs(log.wrench).max(initial=0.0) > 0:
        return "own weight is the only load, and under it they act in proportion; add external loads"
    if log.rotation is None:
        return "they move the measured point in proportion; measure orientation or several points of the tool"
    return "they move the tool in proportion at these poses and loads; add poses and load directions"


def _same_axis(state: RowState, parameters: Sequence[Parameter]) -> bool:
    entries = [parameter.entries(state.scene.robot) for parameter in parameters]
    if any(len(own) != 1 or own[0][0] != own[0][1] for own in entries):
        return False
    chain, frames = state.attained.chain, state.loaded
    first, second = (chain.spring_elements[own[0][0]] for own in entries)
    if chain.translates[first] != chain.translates[second]:
        return False
    apart = frames.origin[:, first] - frames.origin[:, second]
    parallel = np.linalg.norm(np.cross(frames.axis[:, first], frames.axis[:, second]), axis=1).max() < 1e-3
    coincident = np.linalg.norm(np.cross(frames.axis[:, first], apart), axis=1).max() < 1e-3
    return bool(parallel and (chain.translates[first] or coincident))
