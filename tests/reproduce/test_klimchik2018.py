from __future__ import annotations

import numpy as np
import pytest

from compplan.reproduce.klimchik2018 import (
    PRIMARY,
    SECONDARY,
    draw_poses,
    fit_two_scalars,
    random_load,
    reproduce,
    run_strategies,
    vertical_load,
)
from compplan.reproduce.paper import Reproduction
from compplan.robot import load_robot

SHIPPED = load_robot("kuka_kr120_r3900")


@pytest.fixture(scope="module")
def result() -> Reproduction:
    return reproduce(load_robot)


def test_two_scalars_bring_both_means_to_the_papers() -> None:
    q = draw_poses(SHIPPED)[:1000]
    wall, factor, robot = fit_two_scalars(SHIPPED, q)
    assert 3e-3 < wall < 7e-3 and 0.8 < factor < 1.3
    found = run_strategies(robot, q, vertical_load(len(q)))
    assert found.primary.mean() * 1e3 == pytest.approx(PRIMARY[0], rel=0.005)
    assert found.secondary.mean() * 1e3 == pytest.approx(SECONDARY[0], rel=0.005)


def test_a_stiffness_model_leaves_15_to_25_per_cent_only_where_loads_point_anywhere() -> None:
    q = draw_poses(SHIPPED)[:1000]
    robot = fit_two_scalars(SHIPPED, q)[2]
    anywhere, down = (run_strategies(robot, q, load(len(q))) for load in (random_load, vertical_load))
    assert 0.13 < anywhere.model.mean() / anywhere.primary.mean() < 0.25
    assert down.model.mean() / down.primary.mean() < 0.1
    assert anywhere.secondary.mean() / anywhere.primary.mean() == pytest.approx(0.45, abs=0.08)
    np.testing.assert_allclose(anywhere.combined, anywhere.model, atol=5e-5)


def test_what_was_fitted_is_labelled_so(result: Reproduction) -> None:
    fitted = [row.quantity for row in result.rows if row.verdict == "fitted"]
    assert "Table 1: mean error with primary encoders" in fitted
    assert "Table 1: mean error with secondary encoders" in fitted
    assert "Secondary encoders, vertical load: share of the mean error left" in fitted
    for row in result.rows:
        if "encoders" in row.quantity or "model" in row.quantity:
            assert row.assumption.startswith("two scalars fitted"), row.quantity


def test_the_encoder_table_comes_out_with_the_link_share_as_the_only_free_number(result: Reproduction) -> None:
    mean, most, both = (
        float(result.row(f"Link share: {name}").ours)
        for name in ("mean left with link-side feedback", "maximum left with link-side feedback",
                     "mean left with combined feedback")
    )  # fmt: skip
    assert mean == pytest.approx(44.7, abs=0.1)
    assert most == pytest.approx(50.4, rel=0.15)
    assert both < 20.0


def test_four_modes_separate_joint_and_link_compliances(result: Reproduction) -> None:
    rows = [row for row in result.rows if row.quantity.startswith("Eqs. 4 to 6")]
    assert [row.verdict for row in rows] == ["matches", "matches"]


def test_the_deviation_with_secondary_encoders_is_the_printed_share(result: Reproduction) -> None:
    row = result.row("Link share: standard deviation left with link-side feedback")
    assert row.paper == 44.8 and row.verdict == "matches"


def test_joint_one_is_unseen_under_vertical_loads(result: Reproduction) -> None:
    row = result.row("Joint 1 under vertical loads")
    assert row.verdict == "matches" and "joint_1 cannot be determined" in str(row.ours)


def test_the_papers_contradictions_are_named(result: Reproduction) -> None:
    row = result.row("Table 2: 1.08 mm as a share of 4.03 mm")
    assert (row.paper, row.ours, row.verdict) == ("19.5 %", "26.8%", "inconsistent in the paper")
