"""Probability of a claim: a logistic map of its margin, and of what it leaves along its own motion.

A true cause takes its whole error away. A name that is bent into another cause of the same joint, frame or tool leaves
part of it, and that part moves the target along the same lines. With m_i the motion of the target by the claim at row
i, u_i its unit vector, r_i what claims and small errors leave there, and F the 95 % point of Fisher's F(n, (c - 1) n)
for n poses and c values a row (three of a position),

    likeness^2 = max(sum (u_i . r_i)^2 - F / (c - 1) sum |r_i - (u_i . r_i) u_i|^2, 0) / sum |m_i|^2,

the part of its own motion that is left along it beyond what chance puts there in nineteen cases of twenty. It is
measured in every channel in which the claim moves more than the noise, with r_i what claims and small errors leave and
with what errors without a name leave besides, for these may have taken the rest of a wrong name away; the largest
counts.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, fdtri

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.data.shared import LEVEL, ROUNDING
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.robot import Array

#: No claim is surer than this (assumed: one campaign in a hundred holds what nobody thought of).
MOST_SURE = 0.99
#: Log odds are divided by this: evidence of real campaigns is less sharp than its model (assumed).
TEMPER = 2.0
#: The map from evidence to log odds, fitted by penalised logistic regression to 79 claims of 61 drawn and example
#: campaigns (study: python -m benchmarks.ablation prints the map of a suite): constant, margin (arsinh of it over its
#: scale), logarithm of the likeness of what is left with its sign turned, and of the motion in noise floors. No weight
#: may be negative. The number of values of a form does not stand here: the margin has paid for it.
CONSTANT, WEIGHTS = -4.86, np.array([0.74, 1.62, 1.24])
#: Margins beyond this count by their logarithm alone (assumed).
MARGIN_SCALE = 5.0
#: Less than a tenth of a claim's own motion left along it says nothing, and neither does more than all of it (assumed).
LEAST_ALIKE = 0.1
#: Motions below this are told apart no more (assumed). [noise floors]
LEAST_FLOORS = 0.05


@dataclass(frozen=True)
class Evidence:
    """What the probability of a claim rests on.

    Attributes:
        margin: Log posterior odds against the best model without it, errors that no effect makes allowed.
        plain: The same where nothing but effects and small errors is allowed.
        floors: Motion that it explains, in noise floors.
        part: Motion that it explains over the gap.
        left: What is left beyond the noise floor over the gap.
        likeness: What is left along the claim's own motion beyond chance, over that motion
            (compplan.diagnosis.validation.calibrated_probability).
    """

    margin: float
    plain: float
    floors: float
    part: float
    left: float
    likeness: float

    def to_table(self) -> dict[str, float]:
        """Return what diagnosis.json holds."""
        return {key: round(float(value), 4) for key, value in asdict(self).items()}


def features_of(evidence: Evidence) -> Array:
    """Return what the map weighs: margin, likeness, motion. Shape (3,)."""
    margin = np.arcsinh(min(evidence.margin, evidence.plain) / MARGIN_SCALE)
    alike = np.log(np.clip(evidence.likeness, LEAST_ALIKE, 1.0))
    return np.array([margin, -alike, np.log(max(evidence.floors, LEAST_FLOORS))])


def calibrate_probability(evidence: Evidence) -> float:
    """Return the probability that a claim is stated with."""
    odds = CONSTANT + WEIGHTS @ features_of(evidence)
    return float(np.clip(expit(odds), 0.0, MOST_SURE))


def rate_likenesses(fit: Fit, doubt: RevisedProbabilities) -> dict[Claim, float]:
    """Return, for every claim, what is left along its own motion beyond chance, over that motion."""
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
    """Return what is left along a motion beyond what chance leaves there, over the motion; 0 where nothing moves.

    Args:
        left: What is left of each row, in units of the noise. Shape (r, c), c at least 2.
        motion: What the claim makes of it. Shape (r, c).
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
