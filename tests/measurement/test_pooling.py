"""Pooling: many rows of a pose are one row with their mean, its standard deviation from their scatter."""

import numpy as np
import pytest

from compplan.measurement import pooling
from compplan.measurement.campaign import Campaign
from compplan.measurement.pooling import pool_rows

SIGMA = 2e-5


def repeat(poses: int, times: int, *, stays: bool, seed: int = 1) -> Campaign:
    """A campaign of poses met again and again, row after row or round after round, with noise of 20 um."""
    rng = np.random.default_rng(seed)
    q, place = rng.uniform(-1.0, 1.0, (poses, 6)), rng.uniform(-1.0, 1.0, (poses, 3))
    at = np.repeat(np.arange(poses), times) if stays else np.tile(np.arange(poses), times)
    position = place[at] + SIGMA * rng.normal(size=(len(at), 3))
    return Campaign(np.full(len(at), "static"), q[at], np.zeros((len(at), 6)), position)


@pytest.mark.parametrize("stays", [True, False])
def test_rows_of_a_pose_become_their_mean_and_its_deviation(stays: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(10, 300, stays=stays)
    pooled = pool_rows(campaign)
    assert len(pooled) < 0.2 * len(campaign)
    assert pooled.scatter == pytest.approx(SIGMA, rel=0.03)
    for first in range(10):
        of_log = np.abs(campaign.q - campaign.q[first if not stays else 300 * first]).max(1) < 1e-9
        of_means = np.abs(pooled.q - campaign.q[of_log][0]).max(1) < 1e-9
        rows, means = campaign.position[of_log], pooled.position[of_means]
        weight = np.asarray(pooled.sigma)[of_means] ** -2.0
        assert np.allclose(weight @ means / weight.sum(), rows.mean(axis=0), atol=1e-8)
        assert weight.sum() ** -0.5 == pytest.approx(SIGMA / np.sqrt(len(rows)), rel=0.05)


def test_the_direction_of_the_last_move_outlives_pooling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(7, 100, stays=False)
    pooled = pool_rows(campaign)
    for row, sign in zip(pooled.q, pooled.approach, strict=True):
        alike = (np.abs(campaign.q - row).max(1) < 1e-9) & (campaign.approach == sign).all(1)
        assert alike.any()


def test_exact_copies_and_gross_rows_are_said_and_count_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(10, 50, stays=True)
    campaign.position[3] += 1e-3
    twice = campaign.take(np.tile(np.arange(len(campaign)), 2))
    pooled, once = pool_rows(twice), pool_rows(campaign)
    assert np.allclose(pooled.position, once.position) and np.allclose(pooled.sigma, once.sigma)
    assert any("500 of 1000 rows are exact copies" in note for note in pooled.notes)
    assert any("far from the others" in note for note in pooled.notes)
    assert np.abs(pooled.position[0] - campaign.position[4]).max() < 5.0 * SIGMA


def test_short_logs_stay_as_they_are_and_of_ever_new_poses_a_part_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = repeat(10, 20, stays=True)
    assert pool_rows(campaign) is campaign
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    many = pool_rows(repeat(390, 1, stays=True))
    assert len(many) == 98 and "every 4th" in many.notes[-1]


def test_visits_are_kept_apart_only_where_they_scatter_beyond_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(10, 300, stays=False)
    # the first row has no last move
    assert len(pool_rows(campaign)) == 11
    campaign.position[:, 0] += np.linspace(0.0, 2.0 * SIGMA, len(campaign))
    assert len(pool_rows(campaign)) > 200
