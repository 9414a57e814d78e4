"""Few rows: the evidence solved among the values is that of the normal distribution, written out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from compplan.diagnosis.campaign_diagnosis import _rms
from compplan.diagnosis.evidence.likelihood import (
    FewRows,
    gather_rows,
    row_covariance,
    row_mean,
    row_slopes,
    solve_rows,
)
from compplan.diagnosis.evidence.normal_equations import ChannelProducts, Products, turn_rows

#: Rows of each stay; three values a row.
STAYS = np.array([0, 1, 1, 2, 2, 2, 3])
NOISE, SHARED = np.log(1.7), np.log(0.8)


@dataclass(frozen=True)
class Case:
    """Columns as they come, values, prior variances, and the same turned."""

    design: np.ndarray
    observed: np.ndarray
    variance: np.ndarray
    rows: FewRows


@pytest.fixture(scope="module")
def case() -> Case:
    rng = np.random.default_rng(3)
    design, observed = rng.normal(size=(len(STAYS), 3, 40)), rng.normal(size=(len(STAYS), 3))
    variance = np.exp(rng.normal(size=40))
    variance[:2] = 1e6  # frames that are fitted freely
    turned = turn_rows(STAYS, design, observed)
    empty = Products(21, np.zeros((40, 40)), np.zeros(40), 0.0)
    rows = gather_rows([ChannelProducts("position", empty, {}, 9.0, turned)], np.arange(40), variance > 1e5)
    assert rows is not None
    return Case(design, observed, variance, rows)


def covariance_of(case: Case, variance: np.ndarray, noise: float, shared: float) -> np.ndarray:
    """Covariance of the values as they come: noise, an error that the rows of a stay share, and the columns."""
    together = np.kron((STAYS[:, None] == STAYS[None]).astype(float), np.eye(3))
    flat = case.design.reshape(-1, 40)
    return np.exp(noise) * (np.eye(21) + np.exp(2 * shared) * together) + flat * variance @ flat.T


def test_the_value_is_the_density_of_the_normal_distribution(case: Case) -> None:
    done = solve_rows(case.rows, case.variance, np.array([NOISE]), np.array([SHARED]))
    law = multivariate_normal(np.zeros(21), covariance_of(case, case.variance, NOISE, SHARED))
    assert done.value == pytest.approx(law.logpdf(case.observed.reshape(-1)) + 10.5 * np.log(2 * np.pi), rel=1e-9)


def test_mean_and_covariance_are_those_of_conditioning(case: Case) -> None:
    done = solve_rows(case.rows, case.variance, np.array([NOISE]), np.array([SHARED]))
    mean, covariance = row_mean(case.rows, done), row_covariance(case.rows, done)
    flat, prior = case.design.reshape(-1, 40), np.diag(case.variance)
    noise = covariance_of(case, np.zeros(40), NOISE, SHARED)
    expected = np.linalg.inv(np.linalg.inv(prior) + flat.T @ np.linalg.solve(noise, flat))
    assert np.allclose(covariance, expected, rtol=1e-6, atol=1e-8)
    assert np.allclose(mean, expected @ flat.T @ np.linalg.solve(noise, case.observed.reshape(-1)), atol=1e-7)


def test_slopes_agree_with_differences(case: Case) -> None:
    def value(variance: np.ndarray, noise: float, shared: float) -> float:
        return solve_rows(case.rows, variance, np.array([noise]), np.array([shared])).value

    here = solve_rows(case.rows, case.variance, np.array([NOISE]), np.array([SHARED]))
    of_noise, of_shared, of_columns = row_slopes(case.rows, here, 1)
    step = 1e-5
    ahead, back = value(case.variance, NOISE + step, SHARED), value(case.variance, NOISE - step, SHARED)
    assert of_noise[0] == pytest.approx((ahead - back) / (2 * step), rel=1e-5)
    ahead, back = value(case.variance, NOISE, SHARED + step), value(case.variance, NOISE, SHARED - step)
    assert of_shared[0] == pytest.approx((ahead - back) / (2 * step), rel=1e-5)
    for column in (2, 17):
        moved = case.variance.copy()
        moved[column] += step
        assert of_columns[column] == pytest.approx((value(moved, NOISE, SHARED) - here.value) / step, rel=1e-3)
    assert not of_columns[:2].any()


def test_a_campaign_of_many_values_is_solved_among_its_columns(case: Case) -> None:
    turned = turn_rows(STAYS, case.design, case.observed)
    empty = Products(21, np.zeros((40, 40)), np.zeros(40), 0.0)
    channel = ChannelProducts("position", empty, {}, 9.0, turned)
    assert gather_rows([channel], np.arange(21), np.zeros(21, bool)) is None
    assert gather_rows([channel], np.arange(22), np.zeros(22, bool)) is not None


def test_no_rows_are_no_values() -> None:
    turned = turn_rows(np.zeros(0, int), np.zeros((0, 3, 4)), np.zeros((0, 3)))
    assert turned.design.shape == (0, 4)
    assert turned.observed.shape == turned.size.shape == (0,)


def test_the_size_of_a_gap_is_that_of_its_distances_and_nothing_where_there_are_no_rows() -> None:
    assert _rms(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])) == pytest.approx(np.sqrt(25.0 / 2))
    assert _rms(np.zeros((0, 3))) == 0.0
