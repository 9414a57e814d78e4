"""Let the structure of the model grow: a spring is added where it earns its place on poses it never saw [Johra2022].

A model is tested, the candidate that shrinks the held-out gap most is added, the model is fitted anew, and so on until
no candidate gains more than the scatter of the gain from pose to pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.identification.estimate import Estimate, find_inseparable, fit_rows, leave_poses_out
from compplan.identification.forward import linearise
from compplan.identification.parameters import FreeRobot, Parameter
from compplan.measurement.fit.intervals import distance_rms, gain_score
from compplan.measurement.fit.least_squares import invert, stack, weigh
from compplan.measurement.fit.rows import Rows
from compplan.robot import Array

#: Standard errors by which a candidate has to shrink the held-out score; about one in 700 by chance for each.
GAIN_LIMIT = 3.0
MAX_ADDED = 12


@dataclass(frozen=True)
class RoundCandidate:
    """One candidate in one round of refinement: what it would take, and what that would bring.

    `value` and `standard_error` in the parameter's unit, `held_out_rms` with it [m], `gain` the mean gain of the held-
    out score over its standard error; `told` whether the data tell it apart from the present parameters at all.
    """

    name: str
    value: float
    standard_error: float
    held_out_rms: float
    gain: float
    told: bool = True


@dataclass(frozen=True)
class RefinementRound:
    """One test of a model: its held-out rms [m], what was tried, best first, and what was added ("" for none)."""

    held_out_rms: float
    candidates: tuple[RoundCandidate, ...]
    added: str


@dataclass(frozen=True)
class Refinement:
    """A stepwise selection: names of the final parameters, their fit, and the rounds in order."""

    names: tuple[str, ...]
    estimate: Estimate
    rounds: tuple[RefinementRound, ...]


def refine_structure(structure: FreeRobot, start: Sequence[str], rows: Rows) -> Refinement:
    """Grow a model from the names of `start` towards all parameters of a structure, as far as each earns its place."""
    names: list[str] = list(start)
    rounds: list[RefinementRound] = []
    signed = {p.name for p in structure.parameters if p.form is not None or "*" in p.name}
    while True:
        present = fit_rows(structure.select(names), rows)
        tested = probe_model(structure, present, rows)
        earns = [c for c in tested.candidates if c.gain > GAIN_LIMIT and (c.value > 0 or c.name in signed)]
        if not earns or len(rounds) >= MAX_ADDED:
            rounds.append(tested)
            return Refinement(tuple(names), present, tuple(rounds))
        rounds.append(replace(tested, added=earns[0].name))
        names.append(earns[0].name)


def probe_model(structure: FreeRobot, present: Estimate, rows: Rows) -> RefinementRound:
    """Test a fitted model against every parameter of a structure that it leaves out."""
    values, names = structure.nominal, list(structure.names)
    places = [names.index(name) for name in present.structure.names]
    values[places] = present.model_values
    system = linearise(rows, replace(present.state, structure=structure, values=values))
    parameters = (*structure.parameters, *present.parameters[len(places) :])
    base = np.zeros(len(parameters), bool)
    base[places] = present.free[: len(places)]
    base[len(names) :] = present.free[len(places) :]
    before = leave_poses_out(rows, present, base, system)
    counted = present.weights > 0
    residual, columns = weigh(system, system.whitener(present.noise) * np.sqrt(present.weights)[:, None], rows.group)
    flat = stack(columns)
    matrix, side = flat.T @ flat, flat.T @ residual.ravel()
    found = []
    for k in (k for k in range(len(names)) if k not in places):
        free = base.copy()
        free[k] = True
        if not _tellable(matrix, parameters, free, k):
            found.append(RoundCandidate(names[k], 0.0, 0.0, distance_rms(before.residual, counted), 0.0, told=False))
            continue
        inverse = invert(matrix[np.ix_(free, free)])
        place = int(np.flatnonzero(free).searchsorted(k))
        after = leave_poses_out(rows, present, free, system)
        found.append(
            RoundCandidate(
                name=names[k],
                value=float(values[k] + inverse[place] @ side[free]),
                standard_error=float(np.sqrt(inverse[place, place])),
                held_out_rms=distance_rms(after.residual, counted),
                gain=gain_score(before.score, after.score),
            )
        )
    ranked = sorted(found, key=lambda candidate: -candidate.gain)
    best_first = sorted(ranked, key=lambda c: c.held_out_rms if c.gain > GAIN_LIMIT else np.inf)
    return RefinementRound(distance_rms(before.residual, counted), tuple(best_first), "")


def _tellable(matrix: Array, parameters: Sequence[Parameter], free: NDArray[np.bool_], k: int) -> bool:
    """Tell whether the data tell a candidate apart from the present parameters."""
    index = np.flatnonzero(free)
    told = find_inseparable(matrix[np.ix_(index, index)], [parameters[int(j)] for j in index])
    return bool(told[index.searchsorted(k)] and told.sum() == len(index))
