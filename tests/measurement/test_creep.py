"""Stands that creep while their poses are measured: found beyond chance, and only then."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.measurement.creep import find_creep
from compplan.measurement.observations import CONTACT, DISTANCE, READING, KnownDistances, Observations

EVERY = np.ones(60, bool)


def draw(kind: int, creep: float, seed: int) -> tuple[Observations, np.ndarray]:
    """Two labels one after the other, noise of 0.1 mm, and a creep of the whole stand along (2, 1, 2) / 3. [m]"""
    rng, contact = np.random.default_rng(seed), np.repeat([0, 1], 30)
    unit = rng.normal(size=(60, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    known = KnownDistances(np.array([[0, 1]]), np.array([0.05]), np.array([1e-4]))
    direction = unit if kind == READING else np.full((60, 3), np.nan)
    sights = Observations(np.full(60, kind), contact, ("a/0", "a/1"), np.zeros((60, 3)), direction, np.ones(60), known)
    gap = np.outer(np.linspace(-0.5, 0.5, 60), creep * np.array([2.0, 1.0, 2.0]) / 3.0)
    gap += 1e-4 * rng.normal(size=(60, 3))
    return sights, gap if kind == CONTACT else np.einsum("ni,nj,nj->ni", unit, unit, gap)


@pytest.mark.parametrize("kind", [CONTACT, READING, DISTANCE])
def test_a_stand_that_creeps_is_said_to_with_what_it_leaves(kind: int) -> None:
    (found,) = find_creep(*draw(kind, 1.2e-3, 1), EVERY)
    assert found.labels == ("a/0", "a/1")
    assert found.way == pytest.approx(1.2e-3, rel=0.2)
    assert found.after == pytest.approx(1e-4 * (np.sqrt(3.0) if kind == CONTACT else 1.0), rel=0.25)
    assert found.before > 1.3 * found.after
    assert "crept by 1." in found.describe()
    assert not find_creep(*draw(kind, 1.2e-3, 1), np.arange(60) < 3)


@pytest.mark.parametrize("kind", [CONTACT, READING])
def test_a_stand_that_rests_is_said_to_creep_hardly_ever(kind: int) -> None:
    assert sum(bool(find_creep(*draw(kind, 0.0, seed), EVERY)) for seed in range(200)) <= 2
