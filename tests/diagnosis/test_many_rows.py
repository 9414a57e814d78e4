"""Many rows: the evidence solved among the columns is that of the normal distribution, written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from compplan.diagnosis.data.channels import Channel
from compplan.diagnosis.data.noise import Noise
from compplan.diagnosis.evidence.likelihood import ManyRows, column_slopes, gather_products, solve_columns
from compplan.diagnosis.evidence.normal_equations import ChannelProducts, _multiply

NOISE, SHARED = np.log([1.7, 0.6]), np.log([0.8, 1.3])
#: Rows of each stay, for two channels of three values a row: longer stays among single rows, and single rows alone.
STAYS = {"mixed": np.array([0, 1, 1, 2, 2, 2, 3]), "single": np.arange(5)}
VARIANCE = np.exp(np.random.default_rng(4).normal(size=4))


def multiply(kind: str, seed: int) -> tuple[ChannelProducts, np.ndarray, np.ndarray]:
    rng, stay = np.random.default_rng(seed), STAYS[kind]
    design, observed = rng.normal(size=(len(stay), 3, 4)), rng.normal(size=(len(stay), 3))
    channel = Channel("position", np.arange(len(stay)), observed, stay, Noise(1.0, 9.0, "stated"))
    return _multiply(channel, design, observed), design.reshape(-1, 4), observed.reshape(-1)


def gather(kind: str) -> tuple[ManyRows, np.ndarray, np.ndarray]:
    parts = [multiply(kind, seed) for seed in (1, 2)]
    rows = gather_products([part[0] for part in parts], np.arange(4))
    return rows, np.concatenate([p[1] for p in parts]), np.concatenate([p[2] for p in parts])


@pytest.mark.parametrize("kind", STAYS)
def test_value_mean_and_covariance_are_those_of_the_normal_distribution(kind: str) -> None:
    rows, design, observed = gather(kind)
    done = solve_columns(rows, VARIANCE, NOISE, SHARED)
    stay, n = STAYS[kind], len(STAYS[kind]) * 3
    together = np.kron((stay[:, None] == stay[None]).astype(float), np.eye(3))
    noise = np.zeros((2 * n, 2 * n))
    for k in range(2):
        block = slice(k * n, (k + 1) * n)
        noise[block, block] = np.exp(NOISE[k]) * (np.eye(n) + np.exp(2 * SHARED[k]) * together)
    law = multivariate_normal(np.zeros(2 * n), noise + design * VARIANCE @ design.T)
    assert done.value == pytest.approx(law.logpdf(observed) + n * np.log(2 * np.pi), rel=1e-9)
    expected = np.linalg.inv(np.diag(1 / VARIANCE) + design.T @ np.linalg.solve(noise, design))
    assert done.covariance == pytest.approx(expected, rel=1e-9)
    assert done.mean == pytest.approx(expected @ design.T @ np.linalg.solve(noise, observed), rel=1e-9)


@pytest.mark.parametrize("kind", STAYS)
def test_slopes_agree_with_differences(kind: str) -> None:
    rows, _, _ = gather(kind)

    def value(vector: np.ndarray) -> float:
        return solve_columns(rows, vector[4:], vector[:2], vector[2:4]).value

    here = np.concatenate([NOISE, SHARED, VARIANCE])
    slopes = np.concatenate(column_slopes(rows, solve_columns(rows, VARIANCE, NOISE, SHARED), NOISE, SHARED))
    for k, step in enumerate(1e-5 * np.eye(len(here))):
        assert slopes[k] == pytest.approx((value(here + step) - value(here - step)) / 2e-5, rel=1e-5, abs=1e-7)


def test_where_every_stay_has_one_row_the_means_are_the_rows_and_are_multiplied_once() -> None:
    single, mixed = multiply("single", 1)[0], multiply("mixed", 1)[0]
    assert single.means == {1: single.total}
    assert gather_products([single], np.arange(4)).weights.whole.tolist() == [1.0]
    assert gather_products([mixed], np.arange(4)).weights.size.tolist() == [0.0, 1.0, 2.0, 3.0]
