"""Held out: how far the gap shrinks on rows that a model never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compplan.diagnose.channels import block_index
from compplan.diagnose.evidence import Hyper, Prior, find_posterior
from compplan.diagnose.fit import Fit
from compplan.diagnose.ledger import Ledger, select_rows
from compplan.diagnose.search import Claim
from compplan.measure.campaign import Campaign
from compplan.robot import Array

FOLDS = 5
#: Consecutive blocks that stay in one fold.
RUN_OF_BLOCKS = 3


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residuals of rows that the model never saw.

    Attributes:
        rows: Rows of the campaign. Shape (r,).
        residual: Measured minus predicted positions. Shape (r, 3). [m]
    """

    rows: NDArray[np.int_]
    residual: Array

    @property
    def rms(self) -> float:
        """Root mean square distance. [m]"""
        return float(np.sqrt(np.mean(np.sum(self.residual**2, axis=1)))) if len(self.rows) else 0.0


def make_folds(campaign: Campaign, folds: int = FOLDS) -> NDArray[np.int_]:
    """Deal blocks of neighbouring stays to folds; the same pose is always in the same fold. Shape (n,).

    Args:
        campaign: The campaign.
        folds: Number of folds.
    """
    block = block_index(campaign)
    fold = (block // RUN_OF_BLOCKS) % folds
    static = ~campaign.on_path
    _, first = np.unique(campaign.pose, return_index=True)
    return np.where(static, fold[first[campaign.pose]], fold)


def hold_out(
    fit: Fit, prior: Prior, hyper: Hyper, folds: NDArray[np.int_], unseen: NDArray[np.int_] | None = None
) -> HeldOut:
    """Predict every row by a model that was fitted to the other folds.

    Args:
        fit: The fit that the ledger belongs to.
        prior: Prior of the model: its claims and its background.
        hyper: Noise and background.
        folds: Fold of each row. Shape (n,).
        unseen: Columns that are fitted, but not predicted with: what no robot model can hold.
    """
    ledger, active = fit.search.ledger, prior.active
    channel, design, observed = ledger.source[0], ledger.designs[0], ledger.observed[0]
    if not len(active):
        return HeldOut(channel.rows, observed * channel.noise.sigma)
    residual = np.zeros_like(observed)
    for fold in np.unique(folds[channel.rows]):
        train = _rows_ledger(ledger, folds != fold, active)
        values = find_posterior(train, _take(prior, active), hyper, fit=False).values(len(active))
        if unseen is not None:
            values[np.isin(active, unseen)] = 0.0
        test = folds[channel.rows] == fold
        residual[test] = observed[test] - design[test][..., active] @ values
    return HeldOut(channel.rows, residual * channel.noise.sigma)


def prior_of(fit: Fit, claims: Sequence[Claim], *, background: bool = True) -> Prior:
    """Return the prior of a model with these claims, with or without the background."""
    prior = fit.search.prior_of(claims)
    if background:
        return prior
    return Prior(np.full_like(prior.background, -1), prior.spread, prior.free, prior.slab)


def _rows_ledger(ledger: Ledger, rows: NDArray[np.bool_], columns: NDArray[np.int_]) -> Ledger:
    return Ledger((), (), tuple(ledger.names[c] for c in columns), ledger.scale[columns],
                  select_rows(ledger, rows, columns), (), (), ())  # fmt: skip


def _take(prior: Prior, columns: NDArray[np.int_]) -> Prior:
    return Prior(prior.background[columns], prior.spread[columns], prior.free[columns], prior.slab[columns])
