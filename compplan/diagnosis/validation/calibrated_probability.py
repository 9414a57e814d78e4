"""Probability of a claim: a logistic map of its margin, its spurious-fit probability and its residual similarity.

A true cause explains its whole error. A wrong effect of the same joint, frame or tool leaves part of it, and that part
moves the target in the same directions. With m_i the motion of the target by the claim at row i, u_i its unit vector,
r_i the residual of claims and small errors, and F the 95 % point of Fisher's F(n, (c - 1) n) for n poses and c values a
row (three of a position),

    similarity^2 = max(sum (u_i . r_i)^2 - F / (c - 1) sum |r_i - (u_i . r_i) u_i|^2, 0) / sum |m_i|^2,

the share of its motion that is left along it beyond chance. It is evaluated in every channel in which the claim moves
more than the noise, with and without the unmodelled errors in the residual, since these may fit the rest of a wrong
effect; the largest value counts.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, fdtri

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.data.shared import LEVEL, NEGLIGIBLE, ROUNDING
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.robot import Array

#: Largest probability of a claim (assumed: one campaign in a hundred has a cause outside every model here).
MOST_SURE = 0.99
#: Log odds are divided by this: evidence of real campaigns is less sharp than its model (assumed).
TEMPER = 2.0
#: The map from evidence to log odds, fitted by penalised logistic regression to claims of development campaigns and of
#: parts of measured ones (assumed: that study is not kept; python -m benchmarks ablation prints the map of a suite):
#: constant; weights of the margin (arsinh of it over its scale) and of minus the logarithms of spurious-fit probability
#: and residual similarity. No weight may be negative. The margin accounts for the number of parameters.
CONSTANT, WEIGHTS = -3.49, np.array([0.57, 0.69, 0.83])
#: Margins beyond this count by their logarithm alone (assumed).
MARGIN_SCALE = 5.0
#: Spurious-fit probabilities and similarities outside these ranges tell no more: beside a larger cause a high one says
#: nothing about this claim (assumed).
SPURIOUS_RANGE, SIMILARITY_RANGE = (NEGLIGIBLE, 0.15), (0.1, 1.0)


@dataclass(frozen=True)
class Evidence:
    """Evidence for a claim.

    Attributes:
        margin: Log posterior odds against the best model without it, unmodelled errors in both.
        plain: The same without unmodelled errors.
        floors: Motion that it explains, in noise floors.
        part: Motion that it explains over the gap.
        left: Residual beyond the noise floor over the gap.
        spurious: Spurious-fit probability (`validation.spurious_fit`).
        similarity: Residual along the claim's own motion beyond chance, over that motion (`rate_similarities`).
    """

    margin: float
    plain: float
    floors: float
    part: float
    left: float
    spurious: float
    similarity: float

    def to_table(self) -> dict[str, float]:
        """Return what diagnosis.json holds."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return what the map weighs: margin, spurious-fit probability, residual similarity. Shape (3,)."""
    margin = np.arcsinh(min(evidence.margin, evidence.plain) / MARGIN_SCALE)
    spurious = np.log(np.clip(evidence.spurious, *SPURIOUS_RANGE))
    return np.array([margin, -spurious, -np.log(np.clip(evidence.similarity, *SIMILARITY_RANGE))])


def calibrate_probability(evidence: Evidence) -> float:
    """Return the probability of a claim."""
    odds = CONSTANT + WEIGHTS @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MOST_SURE))


def rate_similarities(fit: Fit, doubt: RevisedProbabilities) -> dict[Claim, float]:
    """Return the residual similarity of every claim."""
    equations, values = doubt.search.equations, doubt.model.posterior.values(doubt.search.equations.p)
    foreign = np.concatenate([np.zeros(0, int), *doubt.members]).astype(int)
    result = dict.fromkeys(doubt.model.claims, 0.0)
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
    """Return the residual along a motion beyond chance, over the motion; 0 where nothing moves.

    Args:
        left: Residual of each row, in units of the noise. Shape (r, c), c at least 2.
        motion: Motion by the claim. Shape (r, c).
        pose: Pose of each row. Shape (r,).
    """
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
