"""Restart: the search once more from where a plain path leads, greedy and without small errors everywhere.

A search that adds, exchanges and leaves out ends where no single change helps. The background of small errors may then
carry what a wrong first effect left over, and the size of noise and background that belongs to one set of effects is
not that of another. A plain path does without the background: each effect is the one that explains most of what is
left. From its end the search goes on as ever; the better posterior decides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.diagnosis.evidence.evidence import FIRST_STEPS
from compplan.diagnosis.search.search import (
    WORTHWHILE,
    Model,
    Search,
    add_claim,
    explains_enough,
    search_models,
)


def search_again_plainly(search: Search, found: Model, most: int) -> Model:
    """Return the better of what was found and of what a search finds that begins at the end of a plain path.

    Args:
        search: What was searched.
        found: The best model so far.
        most: Most effects to claim.
    """
    begin = follow_plain_path(search, most)
    # noise and background are fitted from their beginning: what is remembered belongs to another path
    afresh = replace(search, cache={})
    first = begin.claims if np.isfinite(afresh.model(begin.claims, search.start, steps=FIRST_STEPS).score) else ()
    other = search_models(afresh, first, most)
    return other if other.score > found.score + WORTHWHILE else found


def follow_plain_path(search: Search, most: int) -> Model:
    """Add the effects that explain most of what is left, one by one, in a model without small errors everywhere.

    Args:
        search: What is searched.
        most: Most effects to claim.
    """
    bare = replace(search.prior, background=np.full_like(search.prior.background, -1))
    plain = replace(search, prior=bare, cache={})
    model = plain.model([], search.start, steps=FIRST_STEPS)
    while len(model.claims) < most:
        grown = add_claim(plain, model)
        if grown.score < model.score + WORTHWHILE or not explains_enough(plain, model, grown):
            break
        model = grown
    return model
