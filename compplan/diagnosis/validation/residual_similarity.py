"""Likeness: whether what a claim leaves moves the target as the claim itself does.

A true cause takes its whole error away. A name that is bent into another cause of the same joint, frame or tool leaves
part of it, and that part moves the target along the same lines. With m_i the motion of the target by the claim at row
i, u_i its unit vector, r_i what claims and small errors leave there, and F the 95 % point of Fisher's F(n, (c - 1) n)
for n poses and c values a row (three of a position),

    likeness^2 = max(sum (u_i . r_i)^2 - F / (c - 1) sum |r_i - (u_i . r_i) u_i|^2, 0) / sum |m_i|^2,

the part of its own motion that is left along it beyond what chance puts there, with errors alike in all directions, in
nineteen cases of twenty. It says how wrong a name may be, however many rows there are. It is measured twice
in every channel in which the claim moves more than the noise (a target's place and turn, encoders), and the largest
counts: with r_i what claims and small errors leave, and with what errors without a name leave besides, for these may
have taken the rest of a wrong name away.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from compplan.diagnosis.data.channels import group_poses
from compplan.diagnosis.data.shared import LEVEL, ROUNDING
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.robot import Array


def rate_likenesses(fit: Fit, doubt: RevisedProbabilities) -> dict[Claim, float]:
    """Return, for every claim, what is left along its own motion beyond chance, over that motion.

    Args:
        fit: The fit.
        doubt: Its claims among errors that no effect makes.
    """
    ledger, values = doubt.search.ledger, doubt.model.posterior.values(doubt.search.ledger.p)
    foreign = np.concatenate([np.zeros(0, int), *doubt.members]).astype(int)
    result = dict.fromkeys(doubt.model.claims, 0.0)
    group = group_poses(fit.problem.campaign)
    for channel, design, rest in zip(ledger.source, ledger.designs, ledger.left(values), strict=True):
        if rest.shape[1] == 1:
            continue
        left, pose = rest + design[..., foreign] @ values[foreign], group[channel.rows]
        for claim, found in result.items():
            columns = ledger.columns(claim.signature)
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
