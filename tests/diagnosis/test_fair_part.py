"""A claim has to take a fair part of what is left in one channel; channels do not outvote each other."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compplan.diagnosis.evidence.normal_equations import ChannelProducts, Products
from compplan.diagnosis.search.search import explains_enough

VALUES = 60


def make_channel(column: np.ndarray, observed: np.ndarray) -> ChannelProducts:
    gram = np.array([[column @ column]])
    total = Products(len(observed), gram, np.array([column @ observed]), float(observed @ observed))
    return ChannelProducts("any", total, {}, 10.0)


@pytest.mark.parametrize(("seen", "wanted"), [(1.0, True), (0.1, False)])
def test_a_cause_of_places_is_found_beside_angles_that_are_read_a_thousand_times_more_closely(
    seen: float, wanted: bool
) -> None:
    rng = np.random.default_rng(0)
    along, other = rng.normal(size=VALUES), rng.normal(size=VALUES)
    places = 3.0 * seen * along + 3.0 * np.sqrt(1.0 - seen**2) * other
    angles = 1000.0 * rng.normal(size=VALUES)
    channels = (make_channel(along, places), make_channel(np.zeros(VALUES), angles))
    ledger = SimpleNamespace(channels=channels, join_columns=lambda signatures: np.array(signatures, int))
    search: Any = SimpleNamespace(ledger=ledger, prior=SimpleNamespace(background=np.array([-1])))
    none: Any = SimpleNamespace(signatures=(), posterior=SimpleNamespace(columns=np.zeros(0, int), mean=np.zeros(0)))
    fitted = np.array([along @ places / (along @ along)])
    claimed: Any = SimpleNamespace(signatures=(0,), posterior=SimpleNamespace(columns=np.zeros(1, int), mean=fitted))
    assert explains_enough(search, none, claimed) is wanted
