"""Stated 95 % intervals hold: inject, simulate with tracker noise, identify."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.round_trip import MODELS, RoundTrip, measure_coverage, run_round_trip
from compplan.robot import load_robot, robot_folders


@cache
def repeat_trips(loss: str) -> list[RoundTrip]:
    """Return sixty seeded round trips of one robot."""
    robot = load_robot("kuka_kr240")
    return [run_round_trip(robot, "joints", seed, loss=loss) for seed in range(60)]


@pytest.mark.parametrize(
    "loss", [pytest.param("least_squares", marks=pytest.mark.slow), pytest.param("tukey", marks=pytest.mark.slow)]
)
def test_stated_intervals_hold_pooled_over_parameters_and_seeded_repeats(loss: str) -> None:
    coverage = measure_coverage(repeat_trips(loss))
    assert coverage.count == 360
    assert coverage.p_value > 0.01


@pytest.mark.parametrize("model", MODELS)
def test_every_model_runs_through_and_its_estimates_lie_near_the_truth(model: str) -> None:
    robot = load_robot("staubli_tx200")
    trips = [run_round_trip(robot, model, seed, poses=20) for seed in range(4)]
    for trip in trips:
        free = trip.estimate.free[: len(trip.truth)]
        score = (trip.estimate.model_values - trip.truth)[free] / trip.estimate.standard_errors[: len(trip.truth)][free]
        assert abs(score).max() < 6
    assert measure_coverage(trips).share > 0.8


@pytest.mark.slow
def test_500_repeats_over_every_robot_and_every_model_hold_what_they_state() -> None:
    cases = [(load_robot(name), model) for name in robot_folders() for model in MODELS]
    trips = [run_round_trip(*cases[seed % len(cases)], seed) for seed in range(500)]
    assert measure_coverage(trips).p_value > 0.01
