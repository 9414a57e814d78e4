"""The calibration: few of many columns, robust against gross errors, one observation a stay."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from compplan.diagnosis.validation.calibration import SolvedMeans, StayMeans, average_stays, solve_means
from compplan.effects.signature import Signature

VALUES, COLUMNS = 120, 200
TRUE = {3: 2.0, 50: -1.5, 120: 1.0}


def campaign(seed: int = 0) -> StayMeans:
    """A campaign with fewer values than columns, of which three are not zero; noise .1."""
    rng = np.random.default_rng(seed)
    design, none = rng.normal(size=(VALUES, COLUMNS)), np.zeros(COLUMNS, bool)
    observed = sum(value * design[:, k] for k, value in TRUE.items()) + 0.1 * rng.normal(size=VALUES)
    rows, lengths = np.arange(VALUES), np.ones(COLUMNS, int)
    return StayMeans(
        design, observed, np.zeros(VALUES, int), rows, np.arange(COLUMNS), lengths, none, np.full(1, 1e-6)
    )  # fmt: skip


def list_values(solved: SolvedMeans) -> np.ndarray:
    """Return the values of all columns, zero where one was left out."""
    values = np.zeros(COLUMNS)
    values[solved.means.columns] = solved.mean
    return values


def test_few_of_many_columns_are_found_with_their_sizes() -> None:
    found = solve_means(campaign())
    values = list_values(found)
    for column, value in TRUE.items():
        assert abs(values[column] - value) < 0.1
    others = np.delete(values, list(TRUE))
    assert np.abs(others).max() < 0.1
    assert 0.05 < np.sqrt(found.noise[0]) < 0.15


def test_a_gross_error_hardly_moves_the_values() -> None:
    means = campaign()
    observed = means.observed.copy()
    observed[7] += 20.0
    values = list_values(solve_means(replace(means, observed=observed)))
    assert all(abs(values[column] - value) < 0.1 for column, value in TRUE.items())


def test_what_cannot_be_negative_is_left_out_where_it_would_be() -> None:
    positive = np.zeros(COLUMNS, bool)
    positive[[3, 50]] = True
    values = list_values(solve_means(replace(campaign(), positive=positive)))
    assert values[50] == 0.0 and values[3] > 0.0


def test_a_part_of_the_rows_tells_the_same_from_the_columns_of_the_whole() -> None:
    means = campaign()
    whole = solve_means(means)
    noise = whole.noise.copy()
    part = solve_means(means, means.row % 5 > 0, whole)
    assert set(part.means.columns) <= set(whole.means.columns)
    assert all(abs(list_values(part)[column] - value) < 0.1 for column, value in TRUE.items())
    np.testing.assert_array_equal(whole.noise, noise)


def test_a_stay_is_one_observation_however_many_rows_it_has() -> None:
    """Forty rows at each of two stays: two means in three axes, and none of their noise counts forty times."""
    rng = np.random.default_rng(1)
    group = np.repeat([0, 1], 40)
    one = Signature("joint_offset", "joint_1", None, "", ("offset_rad",), np.ones(1), np.zeros((0, 6, 1)))
    source = SimpleNamespace(rows=np.arange(80), group=group, direction=None)
    design, observed = rng.normal(size=(2, 3, 1))[group], rng.normal(size=(80, 3))
    equations: Any = SimpleNamespace(
        source=[source], designs=[design], observed=[observed], p=1, signatures=[one],
        columns=lambda number: np.array([0]), join_columns=lambda numbers: np.array([0]),
    )  # fmt: skip
    means = average_stays(equations, [], np.ones(1))
    assert means.observed.shape == (6,) and means.row.tolist() == [0, 0, 0, 40, 40, 40]
    np.testing.assert_allclose(means.observed[:3], observed[:40].mean(axis=0))
    np.testing.assert_allclose(means.least, 1.0 / 40.0)
