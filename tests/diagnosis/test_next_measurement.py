"""What to measure next: gains in closed form, moves within limits, and a tie that the proposed measurement breaks."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_campaigns import measure, plan_rows, write_small_robot

from compplan.diagnosis import diagnose_campaign
from compplan.diagnosis.results.next_measurement import (
    expected_gain,
    list_rows,
    pick_poses,
    predict_columns,
    propose_measurements,
)
from compplan.effects import Effect
from compplan.effects.frame_shift import shift_at
from compplan.measurement.campaign import Campaign
from compplan.measurement.pose_selection import exchange_choice, explain_rows, odds_gains, take_greedily
from compplan.robot import Robot, load_robot
from tests.effects.test_effects_signatures import make_linearization

AT = make_linearization(replace(load_robot("kuka_kr270"), link_elasticities=()))
OFFSET = Effect("joint_offset", "joint_3", None, {"offset_rad": 5e-4})


def test_the_expected_gain_agrees_with_measuring_many_times() -> None:
    random = np.random.default_rng(0)
    information, log_odds, draws = 1.3, 0.7, 400_000
    prior = 1 / (1 + np.exp(-log_odds))
    first = random.random(draws) < prior
    ratio = np.where(first, 1, -1) * information + np.sqrt(2 * information) * random.normal(size=draws)
    after = 1 / (1 + np.exp(-(log_odds + ratio)))
    given_to_truth = np.where(first, after, 1 - after).mean()
    before = prior**2 + (1 - prior) ** 2
    assert expected_gain(log_odds, information) == pytest.approx(given_to_truth - before, abs=3e-3)


def test_moves_that_repeat_each_other_are_not_picked_twice() -> None:
    """Three readings, two of them of what is nearly the same, over noise of one."""
    shared = 1e3 * np.array([[1.0, 0.999, 0.0], [0.999, 1.0, 0.0], [0.0, 0.0, 1.0]])
    picked, _ = pick_poses(np.sqrt(1e3) * np.array([2.0, 2.0, 1.9]), shared, np.eye(3)[:, None])
    assert set(picked[:2]) in ({0, 2}, {1, 2})


def test_what_moves_tell_of_two_explanations_is_the_ratio_of_their_likelihoods_in_whatever_order() -> None:
    """D = d^T (N + S)^-1 d / 2 of all rows at once, by the whole matrix; the exchange finds the best pair of five."""
    random = np.random.default_rng(4)
    root, rows, mean = random.normal(size=(6, 6)), random.normal(size=(5, 2, 6)), random.normal(size=6)
    covariance = root @ root.T

    def told(moves: tuple[int, ...]) -> float:
        H = rows[list(moves)].reshape(-1, 6)
        d = H @ mean
        return 0.5 * float(d @ np.linalg.solve(H @ covariance @ H.T + np.eye(len(H)), d))

    left = explain_rows(mean, covariance, rows[[3, 1]], 1.0)
    gain = odds_gains(*left, rows)
    assert gain[4] == pytest.approx(told((3, 1, 4)) - told((3, 1)), rel=1e-9)

    def worth(taken: list[int]) -> np.ndarray:
        return odds_gains(*explain_rows(mean, covariance, rows[taken], 1.0), rows)

    chosen = exchange_choice(worth, take_greedily(worth, 2))
    best = max(itertools.combinations(range(5), 2), key=told)
    assert {number for number, _ in chosen} == set(best)
    assert sum(added for _, added in chosen) == pytest.approx(told(best))


def test_a_claim_that_no_further_rows_would_offer_is_foreseen_and_an_idle_one_is_not() -> None:
    """The instrument moved at row 5: each millimetre of it is one at every row since, over noise of 0.02 mm."""
    (shift,) = [s for s in shift_at(AT, 5) if s.form.startswith("origin")]
    residual, noise = np.zeros((1, 3)), SimpleNamespace(sigma=2e-5)
    equations = SimpleNamespace(
        p=3, signatures=[shift], columns=lambda number: np.arange(3), scale=np.full(3, 1e-3),
        source=[SimpleNamespace(name="position", residual=residual, noise=noise)],
    )  # fmt: skip
    since = np.arange(len(AT.campaign)) >= 5
    for claims, size in (([SimpleNamespace(signature=0)], 50.0), ([], 0.0)):
        fit = SimpleNamespace(
            search=SimpleNamespace(equations=equations), model=SimpleNamespace(claims=claims),
            problem=SimpleNamespace(register=()),
        )  # fmt: skip
        (columns,) = predict_columns(fit, AT)  # type: ignore[arg-type]
        assert columns == pytest.approx(size * since[:, None, None] * np.eye(3), abs=1e-4)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, Campaign]:
    """Measure an offset at poses of a narrow region, where a gear error of the same joint looks alike."""
    robot = write_small_robot(tmp_path_factory.mktemp("robot"))
    rows = plan_rows(robot, 5, poses=30, loads=1, region=0.15)
    return robot, measure(robot, rows, [OFFSET], 5)


def test_rows_stay_within_joint_limits_and_loads(measured: tuple[Robot, Campaign]) -> None:
    robot, campaign = measured
    rows = list_rows(robot, campaign)
    assert (rows.q >= robot.lower).all()
    assert (rows.q <= robot.upper).all()
    force = np.linalg.norm(rows.wrench[:, :3], axis=1)
    assert force.min() == 0.0 < force.max() <= np.linalg.norm(campaign.wrench[:, :3], axis=1).max() + 0.1


def test_what_is_proposed_says_poses_loads_and_gain(measured: tuple[Robot, Campaign]) -> None:
    found = propose_measurements(diagnose_campaign(*measured))
    steps = [step for step in found if step["poses"]]
    assert steps
    for step in steps:
        assert 5 <= len(step["poses"]) == len(step["wrenches"]) <= 10
        assert step["expected_probability_gain"] >= 0.02
