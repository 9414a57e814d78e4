"""Probability of a claim: a logistic map of its evidence; and other effects that explain the same motion.

A true cause explains its complete error. A wrong effect of the same joint, frame or tool leaves part of it, and that
part moves the target in the same directions. With m_i the motion of the target by the claim at row i, u_i its unit
vector, r_i the residual of claims and small errors, and F the 95 % point of Fisher's F(n, (c - 1) n) for n poses and c
values a row (three of a position),

    similarity^2 = max(sum (u_i . r_i)^2 - F / (c - 1) sum |r_i - (u_i . r_i) u_i|^2, 0) / sum |m_i|^2,

the residual along its motion beyond chance: the largest of every channel in which the claim moves more than the noise,
with and without the unmodelled errors in the residual, since these may fit the rest of a wrong effect.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, expit, fdtri

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.data.shared import LEVEL, NEGLIGIBLE, ROUNDING, rank_number
from compplan.diagnosis.evidence.candidates import REGISTRATION
from compplan.diagnosis.evidence.evidence import combine_normal_equations
from compplan.diagnosis.evidence.normal_equations import project_out
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled import UNMODELLED, RevisedProbabilities
from compplan.effects.linearization import Place
from compplan.effects.signature import Signature
from compplan.robot import Array


@dataclass(frozen=True)
class ProbabilitySettings:
    """Settings of the map from evidence to probability."""

    #: Largest probability of a claim (assumed: one campaign in a hundred has a cause outside every model here).
    most_probable: float = 0.99
    #: Divisor of log odds: evidence of real campaigns is less sharp than its model (assumed).
    temper: float = 2.0
    #: Margins beyond this count logarithmically (assumed).
    margin_scale: float = 5.0
    #: Range of the similarity, clipped outside: a high one may come from a larger cause (assumed).
    similarity_range: tuple[float, float] = (0.1, 1.0)


MAP = ProbabilitySettings()
#: Map from evidence to log odds, fitted by penalised logistic regression to the claims of 221 labelled campaigns
#: (study: python -m benchmarks ablation SUITE.. prints the map of its suites): constant; weights of the margin (arsinh
#: of it over its scale) and of minus the logarithm of the residual similarity.
CONSTANT, WEIGHTS = -4.29, np.array([0.95, 1.68])


@dataclass(frozen=True)
class Evidence:
    """Evidence for a claim."""

    #: Log posterior odds against the best model without it, unmodelled errors in both; infinite if there is none.
    margin: float
    similarity: float  #: Residual along the claim's motion beyond chance, over that motion (`rate_similarities`).

    def to_table(self) -> dict[str, float]:
        """Return the content of diagnosis.json."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return the features of the map: margin, residual similarity. Shape (2,)."""
    similarity = np.clip(evidence.similarity, *MAP.similarity_range)
    return np.array([np.arcsinh(evidence.margin / MAP.margin_scale), -np.log(similarity)])


def calibrate_probability(evidence: Evidence) -> float:
    """Return the calibrated probability of a claim, or of one that the campaign cannot distinguish from it."""
    odds = CONSTANT + WEIGHTS @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MAP.most_probable))


def rate_similarities(fit: Fit, revised: RevisedProbabilities) -> dict[Claim, float]:
    """Compute the residual similarity of every claim."""
    equations, values = revised.search.equations, revised.model.posterior.values(revised.search.equations.p)
    foreign = np.concatenate([np.zeros(0, int), *revised.members]).astype(int)
    result = dict.fromkeys(revised.model.claims, 0.0)
    group = group_poses(fit.problem.campaign)
    for channel, design, rest in zip(equations.source, equations.designs, equations.left(values), strict=True):
        if rest.shape[1] == 1:
            continue
        left, pose = rest + design[..., foreign] @ values[foreign], group[channel.rows]
        for claim, found in result.items():
            columns = equations.columns(claim.signature)
            motion = design[..., columns] @ values[columns]
            if channel.name == "position" or np.mean(np.sum(motion**2, axis=1)) > rest.shape[1]:
                both = [measure_similarity(part, motion, pose) for part in (left, rest)]
                result[claim] = max(found, *both)
    return result


def measure_similarity(left: Array, motion: Array, pose: NDArray[np.int_]) -> float:
    """Return the residual (r, c) along a motion (r, c) beyond chance, over the motion; 0 without motion."""
    length = np.linalg.norm(motion, axis=1)
    moves = length > ROUNDING * length.max(initial=0.0)
    if not moves.any():
        return 0.0
    along = np.einsum("ni,ni->n", left[moves], motion[moves] / length[moves, None])
    across = np.sum(left[moves] ** 2) - along @ along
    poses = len(np.unique(pose[moves]))
    others = left.shape[1] - 1
    beyond = along @ along - across / others * fdtri(poses, others * poses, LEVEL)
    return float(np.sqrt(max(beyond, 0.0) / np.sum(motion[moves] ** 2)))


#: Two effects are indistinguishable if one explains this share of the other's motion, frames fitted to both (assumed),
ALIKE = 0.975
#: or if the residual of the other is this small: sum of squares over the campaign, in units of the noise variance
#: (theory: four standard deviations, log odds of 8).
BELOW_NOISE = 16.0


@dataclass(frozen=True)
class AlternativeEffect:
    """Another effect that explains a share of the motion by a claim, frames fitted to both.

    `difference` is the sum of squares that it leaves of that motion, in units of the noise variance.
    """

    place: Place
    share: float
    difference: float

    @property
    def alike(self) -> bool:
        """Whether the campaign cannot distinguish it from the claim."""
        return self.share >= ALIKE or self.difference < BELOW_NOISE

    @property
    def competes(self) -> bool:
        """Whether it is alike, but differs from the claim by more than chance, so that evidence can compare them."""
        return self.alike and self.difference > chdtri(1, 1.0 - LEVEL)


def find_alternatives(fit: Fit, signature: int, values: Array | None = None) -> list[AlternativeEffect]:
    """Find the effects that explain a claim's motion, and their shares, best first.

    The share is the squared cosine of the angle between the claim's motion and the space of the other effect, base and
    tool frames projected out of both. `values` are those of all columns (p,), by default those of the fit's model.
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
        rival = AlternativeEffect(other.place, share, (1.0 - share) * energy)
        if other.place not in best or rival.share > best[other.place].share:
            best[other.place] = rival
    return sorted(best.values(), key=lambda r: -rank_number(r.share))


def _measure_trace(fit: Fit, columns: NDArray[np.int_], values: Array) -> tuple[Array, float]:
    """Return the products of all columns, frames projected out, and the squares of a claim's motion."""
    gram, _ = combine_normal_equations(fit.search.equations, fit.model.posterior.hyper)
    whole = float(values @ gram[np.ix_(columns, columns)] @ values)
    frames = fit.search.equations.columns_named("base_frame", "tool_frame", REGISTRATION)
    free = project_out(gram, frames)
    energy = float(values @ free[np.ix_(columns, columns)] @ values)
    # frames that explain the motion almost completely are not projected out
    return (gram, whole) if energy < NEGLIGIBLE * whole else (free, energy)


def _all_columns(fit: Fit, number: int) -> NDArray[np.int_]:
    """Return the columns of an effect at its place: a nonlinear stiffness has both its shapes."""
    equations = fit.search.equations
    signature = equations.signatures[number]
    if signature.form not in ("quadratic", "cubic"):
        return equations.columns(number)
    return equations.join_columns(
        n for n, s in enumerate(equations.signatures) if s.place == signature.place and s.form in ("quadratic", "cubic")
    )


def _share(gram: Array, columns: NDArray[np.int_], values: Array, other: NDArray[np.int_], energy: float) -> float:
    """Return the share of a motion that other columns explain; zero if they move nothing."""
    block, against = gram[np.ix_(other, other)], gram[np.ix_(other, columns)] @ values
    trace = float(np.trace(block))
    if trace <= 0:
        return 0.0
    fitted = np.linalg.solve(block + 1e-9 * trace / len(block) * np.eye(len(block)), against)
    return float(np.clip(against @ fitted / energy, 0.0, 1.0))


def is_comparable(other: Signature) -> bool:
    """Check whether an effect is a rival: proposed forms, variants of stiffness laws, waves and balancers are not."""
    if other.name in (REGISTRATION, UNMODELLED) or other.tried > 1:
        return False
    if other.name == "stiffness_nonlinearity":
        return other.form in ("quadratic", "cubic")
    if other.name == "transmission_error":
        return len(other.keys) == 2
    if other.name == "gravity_compensator":
        return other.form == "sine"
    return True
