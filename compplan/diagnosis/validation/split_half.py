"""Repetition: whether halves of a campaign, drawn by poses, tell the same claims as the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import block_index
from compplan.diagnosis.data.shared import SEED
from compplan.diagnosis.evidence.evidence import find_posterior
from compplan.diagnosis.evidence.normal_equations import select_rows
from compplan.diagnosis.search.search import Claim
from compplan.diagnosis.search.state import Fit
from compplan.diagnosis.validation.unmodelled_causes import RevisedProbabilities
from compplan.measurement.campaign import Campaign

#: Pairs of halves that are drawn (assumed).
PAIRS = 4


def draw_halves(campaign: Campaign) -> NDArray[np.bool_]:
    """Draw halves of the poses; stretches of paths go with their block. Shape (2 PAIRS, n), bool."""
    _, pose = np.unique(campaign.pose, return_inverse=True)
    label = np.where(campaign.on_path, pose.max(initial=0) + 1 + block_index(campaign), pose.reshape(-1))
    _, group = np.unique(label, return_inverse=True)
    rng = np.random.default_rng(SEED)
    halves = []
    for _ in range(PAIRS):
        first = rng.permutation(int(group.max(initial=0)) + 1) % 2 == 0
        halves += [first[group], ~first[group]]
    return np.array(halves)


def count_repetitions(fit: Fit, doubt: RevisedProbabilities) -> dict[Claim, float]:
    """Return, for every claim, the share of halves in which it beats its absence.

    Noise and the sizes of all classes are those of the whole campaign.

    Args:
        fit: The fit.
        doubt: Its claims among errors that no effect makes.
    """
    search, model = doubt.search, doubt.model
    ledger, hyper = search.ledger, model.posterior.hyper
    told = dict.fromkeys(model.claims, 0.0)
    if not told:
        return told
    halves = draw_halves(fit.problem.campaign)
    every = search.prior_of(model.claims)
    less = {claim: search.prior_of([c for c in model.claims if c is not claim]) for claim in model.claims}
    # of what no model here holds nothing is asked
    columns = np.unique(np.concatenate([every.active, *(prior.active for prior in less.values())]))
    for rows in halves:
        part = replace(ledger, channels=select_rows(ledger, rows, columns))
        whole = find_posterior(part, every.of(columns), hyper, fit=False)
        for claim in model.claims:
            without = find_posterior(part, less[claim].of(columns), hyper, fit=False)
            gain = whole.log_evidence - without.log_evidence
            told[claim] += float(gain + search.log_prior[claim.signature] > 0.0) / len(halves)
    return told
