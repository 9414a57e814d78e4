"""Bare: the campaign searched once more for a robot that is exact but for its causes.

The background of small errors is as large as the campaign lets it be, and errors without a name are larger still:
beside an unknown cause, or among several known ones, they may carry what a known cause makes. A bare robot has neither:
what is left belongs to its causes, and to a noise of any size. It names too much where a robot is a little wrong
everywhere; so what it finds is no verdict, but is weighed like every other claim.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from compplan.diagnose.evidence import TAU_RANGE, Prior
from compplan.diagnose.search import Model, Search, search_models
from compplan.diagnose.state import Fit

#: Most causes of a bare robot (assumed: more are small errors).
MOST_CAUSES = 8


@dataclass(frozen=True, eq=False)
class Bare:
    """A campaign as a robot without small errors explains it.

    Attributes:
        search: The search, its prior without background.
        model: The best set of causes.
    """

    search: Search
    model: Model


def strip_errors(fit: Fit, progress: Callable[[str], None] = lambda text: None) -> Bare:
    """Search a fit's ledger for the causes of a robot that has no small errors.

    Args:
        fit: The fit.
        progress: Told what is being done.
    """
    progress("bare robot")
    old, start = fit.search.prior, fit.search.start
    prior = Prior(np.full_like(old.background, -1), old.spread, old.free, old.slab)
    smallest = np.full_like(start.log_tau, TAU_RANGE[0])
    search = replace(fit.search, prior=prior, start=replace(start, log_tau=smallest), cache={})
    return Bare(search, search_models(search, (), MOST_CAUSES))
