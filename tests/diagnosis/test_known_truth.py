"""Small campaigns of known truth: the causes that were put in are named, with their sizes, and every number stays."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from known_campaigns import CAMPAIGNS, FILE, Run, answer_run, differences, run_known

TRUTH = json.loads(FILE.read_text())
#: Campaigns of the weekly run: their causes are like those of others.
WEEKLY = {
    "a stiffer joint, noisier", "a zero near the noise", "play", "a gear", "a link", "the tool", "a scaled sensor",
    "a biased sensor", "a coupled wrist", "a cause beside errors of no effect", "two zeros that are one length",
    "met again, nothing stated",
}  # fmt: skip
NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in WEEKLY else name for name in CAMPAIGNS]


@pytest.fixture(scope="module", params=NAMES)
def run(request: pytest.FixtureRequest) -> tuple[str, Run]:
    """A known campaign, diagnosed once."""
    return request.param, run_known(request.param)


def test_a_known_campaign_is_diagnosed_as_it_is_and_as_before(run: tuple[str, Run]) -> None:
    known, answer = run[1].known, answer_run(run[1])
    assert not list(differences(TRUTH[run[0]], answer))
    if known.mistake:
        assert answer["questions"]
        return
    named = answer["verdict"]["effects"]
    wanted = tuple(effect.name for effect in known.effects) if known.named is None else known.named
    assert sorted(entry["effect"] for entry in named) == sorted(wanted)
    for effect in known.effects if known.named is None else ():
        entry = next(e for e in named if (e["effect"], e["joint"]) == (effect.name, effect.joint))
        assert all(close(entry["parameters"][key], value) for key, value in effect.parameters.items()), entry
    assert answer["outliers"] == list(known.spoiled)


def close(found: Any, true: Any) -> bool:
    """Tell whether a size was found within half of it; small parts are left to the numbers as before."""
    if isinstance(true, list):
        return all(close(*pair) for pair in zip(found, true, strict=True))
    if isinstance(true, str | bool) or isinstance(found, str | bool):
        return bool(found == true)
    return abs(true) < 2e-4 or bool(np.isclose(found, true, rtol=0.5))
