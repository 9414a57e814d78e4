"""Ambiguity: which other effects explain the same motion of the target at the rows of a campaign."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.shared import NEGLIGIBLE, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_normal_equations
from compplan.diagnosis.evidence.normal_equations import project_out
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled import UNMODELLED
from compplan.effects.linearization import Place
from compplan.effects.signature import Signature
from compplan.robot import Array

#: Two effects cannot be told apart if one explains this share of what the other does, frames fitted to both (assumed),
ALIKE = 0.975
#: or if what it leaves of the other is this small: sum of squares over the campaign, in units of the noise variance
#: (theory: four standard deviations, log odds of 8).
BELOW_NOISE = 16.0


@dataclass(frozen=True)
class AlternativeEffect:
    """Another effect, of some parameters, that explains a share of the motion by a claim, frames fitted to both.

    `difference` is the sum of squares that it leaves of that motion, in units of the noise variance.
    """

    place: Place
    share: float
    difference: float
    parameters: int

    @property
    def alike(self) -> bool:
        """Tell whether the campaign cannot tell it from the claim."""
        return self.share >= ALIKE or self.difference < BELOW_NOISE


def find_alternatives(fit: Fit, signature: int, values: Array | None = None) -> list[AlternativeEffect]:
    """Compare a claim's motion with what every other effect can explain, best first.

    The share is the squared cosine of the angle between the claim's motion and the space of the other effect, base and
    tool frames projected out of both. `values` are those of all columns (p,); those of the fit's model where left out.
    """
    equations = fit.search.equations
    columns = equations.columns(signature)
    values = (fit.model.posterior.values(equations.p) if values is None else values)[columns]
    free, energy = _measure_trace(fit, columns, values)
    if energy <= 0:
        return []
    claim = equations.signatures[signature]
    best: dict[Place, AlternativeEffect] = {}
    for number, other in enumerate(equations.signatures):
        if other.place == claim.place or not is_comparable(other):
            continue
        theirs = _all_columns(fit, number)
        share = _share(free, columns, values, theirs, energy)
        rival = AlternativeEffect(other.place, share, (1.0 - share) * energy, len(theirs))
        if other.place not in best or rival.share > best[other.place].share:
            best[other.place] = rival
    return sorted(best.values(), key=lambda r: -rank_number(r.share))


def imitate_claim(fit: Fit, signature: int, place: Place, values: Array) -> tuple[int, Array, float]:
    """Fit the effect of another place to the motion by a claim of these values (k,), frames fitted to both.

    Returns:
        Number of the other signature, the best of its forms; values of its columns, in units of their scale; sum of
        squares that it leaves of the claim's motion, in units of the noise variance.
    """
    equations = fit.search.equations
    columns = equations.columns(signature)
    free, energy = _measure_trace(fit, columns, values)
    tries = []
    for number, other in enumerate(equations.signatures):
        if other.place == place and is_comparable(other):
            theirs = equations.columns(number)
            share = _share(free, columns, values, theirs, energy)
            tries.append((share, -number, _solve_trace(free, columns, values, theirs)))
    share, number, found = max(tries, key=lambda entry: (rank_number(entry[0]), entry[1]))
    return -number, found, (1.0 - share) * energy


def _measure_trace(fit: Fit, columns: NDArray[np.int_], values: Array) -> tuple[Array, float]:
    """Return the products of all columns, frames projected out, and the squares of a claim's motion."""
    gram, _, _, _ = combine_normal_equations(fit.search.equations, fit.model.posterior.hyper)
    whole = float(values @ gram[np.ix_(columns, columns)] @ values)
    frames = fit.search.equations.columns_named("base_frame", "tool_frame", REGISTRATION)
    free = project_out(gram, frames)
    energy = float(values @ free[np.ix_(columns, columns)] @ values)
    # what frames explain nearly whole counts as it is
    return (gram, whole) if energy < NEGLIGIBLE * whole else (free, energy)


def _all_columns(fit: Fit, number: int) -> NDArray[np.int_]:
    """Return what an effect may explain at its place: a law of deflection hardens and softens, so both its shapes."""
    equations = fit.search.equations
    own = equations.signatures[number]
    if own.form not in ("quadratic", "cubic"):
        return equations.columns(number)
    return equations.join_columns(
        n for n, s in enumerate(equations.signatures) if s.place == own.place and s.form in ("quadratic", "cubic")
    )


def _share(gram: Array, columns: NDArray[np.int_], values: Array, other: NDArray[np.int_], energy: float) -> float:
    against = gram[np.ix_(other, columns)] @ values
    return float(np.clip(against @ _solve_trace(gram, columns, values, other) / energy, 0.0, 1.0))


def _solve_trace(gram: Array, columns: NDArray[np.int_], values: Array, other: NDArray[np.int_]) -> Array:
    """Return the values of other columns that explain most of a motion; zero where they move nothing."""
    block = gram[np.ix_(other, other)]
    trace = float(np.trace(block))
    if trace <= 0:
        return np.zeros(len(other))
    against = gram[np.ix_(other, columns)] @ values
    return np.asarray(np.linalg.solve(block + 1e-9 * trace / len(block) * np.eye(len(block)), against))


def is_comparable(other: Signature) -> bool:
    """Leave out forms that contain the claim trivially: a general curve contains the straight line."""
    if other.name in (REGISTRATION, UNMODELLED) or other.tried > 1 or other.form == "spline":
        return False
    if other.name == "stiffness_nonlinearity":
        return other.form in ("quadratic", "cubic")
    if other.name == "transmission_error":
        return len(other.keys) == 2
    if other.name == "gravity_compensator":
        return other.form == "sine"
    return True
