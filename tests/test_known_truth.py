"""Small campaigns of known truth: the causes that were put in are named, with their sizes, and every number stays.

They stand for the numbers that decide in the diagnosis: `python tests/known_campaigns.py --study 20` moves twenty of
them to twice and to half their value and says which of these campaigns sees it.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from known_campaigns import CAMPAIGNS, FILE, diagnose_known, differences, make_robot, moved

from compplan.robot import Robot

TRUTH = json.loads(FILE.read_text())


@pytest.fixture(scope="module")
def robot() -> Robot:
    return make_robot()


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_known_campaign_is_diagnosed_as_it_is_and_as_before(name: str, robot: Robot) -> None:
    known, answer = CAMPAIGNS[name], diagnose_known(CAMPAIGNS[name], robot)
    named = answer["verdict"]["effects"]
    wanted = tuple(effect.name for effect in known.effects) if known.named is None else known.named
    assert sorted(entry["effect"] for entry in named) == sorted(wanted)
    for effect in known.effects if known.named is None else ():
        entry = next(e for e in named if (e["effect"], e["joint"]) == (effect.name, effect.joint))
        assert all(close(entry["parameters"][key], value) for key, value in effect.parameters.items()), entry
    assert answer["outliers"] == list(known.spoiled)
    assert not list(differences(TRUTH[name], answer))


def close(found: Any, true: Any) -> bool:
    """Tell whether a size was found within half of it; small parts are left to the numbers as before."""
    if isinstance(true, list):
        return all(close(*pair) for pair in zip(found, true, strict=True))
    if isinstance(true, str | bool) or isinstance(found, str | bool):
        return bool(found == true)
    return abs(true) < 2e-4 or bool(np.isclose(found, true, rtol=0.5))


def test_a_number_at_twice_its_value_is_seen(robot: Robot) -> None:
    with moved("compplan.diagnose.ledger.background", "NO_CAUSE", 2.0):
        changed = list(differences(TRUTH["nothing"], diagnose_known(CAMPAIGNS["nothing"], robot)))
    assert changed
