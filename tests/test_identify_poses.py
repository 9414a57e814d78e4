"""Poses and loads that tell the most."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.round_trip import simulate_observations
from compplan.errors import InputError
from compplan.identify import build_structure, estimate_parameters
from compplan.identify.plan_campaign import plan_campaign, weigh_candidates
from compplan.identify.problem import IdentifyOptions
from compplan.measure.poses.determinant import PoseInformation, choose_poses, compare_with_random
from compplan.measure.poses.pool import draw_candidates
from compplan.robot import load_robot
from compplan.robot.springs import missing_springs
from compplan.statics.chain import build_chain
from compplan.statics.quality import find_characteristic_length, quality_of_poses


@pytest.mark.parametrize("name", ["kuka_kr270", "staubli_tx200", "kuka_kr240"])
def test_d_optimal_poses_have_four_fifths_of_the_error_of_random_ones_and_no_parameter_worse(name: str) -> None:
    robot = load_robot(name)
    candidates = draw_candidates(robot, 1000, seed=1)
    information = weigh_candidates(build_structure(robot, add=missing_springs(robot)), candidates)
    limits = compare_with_random(information, 20, seed=2)
    best = information.standard_errors(choose_poses(information, 20, limits=limits))
    random = compare_with_random(information, 20, draws=400, seed=4)
    chain = build_chain(robot)
    quality = quality_of_poses(chain, candidates.q, find_characteristic_length(chain, candidates.q))
    dexterous = np.flatnonzero(quality >= np.quantile(quality, 0.75))  # as the zones of [Dumas2011, Table I]
    zones = compare_with_random(information, 20, seed=5, allowed=dexterous)
    assert np.exp(np.mean(np.log(best / random))) <= 0.8
    assert (best <= random).all()
    assert np.exp(np.mean(np.log(best / zones))) <= 0.8


def test_predicted_standard_errors_are_those_of_the_fit() -> None:
    robot = load_robot("kuka_kr270")
    candidates = draw_candidates(robot, 60, seed=1)
    structure = build_structure(robot)
    rows = replace(simulate_observations(robot, candidates.q, candidates.wrench), sigma=np.full(60, 3e-5))
    estimate = estimate_parameters(structure, rows, sigma="stated")
    information = weigh_candidates(structure, candidates, sigma_position=3e-5, sigma_rotation=5e-5)
    np.testing.assert_allclose(information.standard_errors(np.arange(60)), estimate.standard_errors, rtol=1e-6)


def test_the_exchange_finds_the_best_of_all_subsets_of_a_small_set() -> None:
    rng = np.random.default_rng(2)
    robot = load_robot("kuka_kr270")
    told = weigh_candidates(build_structure(robot), draw_candidates(robot, 5))
    rows = rng.standard_normal((9, 1, 2)) * 30
    information = PoseInformation(told.names[:2], told.units[:2], told.sizes[:2], rows)

    def determinant(chosen: tuple[int, ...]) -> float:
        flat = information.rows[list(chosen)].reshape(-1, 2)
        return float(np.linalg.det(flat.T @ flat))

    best = max(itertools.combinations(range(9), 3), key=determinant)
    assert tuple(choose_poses(information, 3)) == best


def test_candidates_stay_inside_the_limits_and_above_the_floor() -> None:
    robot = load_robot("kuka_kr240_rail")
    candidates = draw_candidates(robot, 200, force=500.0, lever=0.0, seed=3)
    assert (candidates.q >= robot.lower).all() and (candidates.q <= robot.upper).all()
    np.testing.assert_allclose(np.linalg.norm(candidates.wrench[:, :3], axis=1), 500.0)
    assert not candidates.wrench[:, 3:].any()


def test_the_same_seed_plans_the_same_campaign() -> None:
    robot = load_robot("kuka_kr270")
    plans = [plan_campaign(robot, IdentifyOptions(), 8, force=800.0, lever=0.2, seed=5) for _ in range(2)]
    np.testing.assert_array_equal(plans[0].poses.q, plans[1].poses.q)
    assert np.exp(np.mean(np.log(plans[0].promised / plans[0].random))) < 0.8


def test_too_few_poses_and_impossible_loads_are_refused() -> None:
    robot = load_robot("kuka_kr270")
    with pytest.raises(InputError, match="1 poses for 6 parameters, expected at least 2"):
        plan_campaign(robot, IdentifyOptions(), 1, force=800.0, lever=0.2)
    with pytest.raises(InputError, match="force -1 N on a lever of 200 mm, expected a force above 0"):
        plan_campaign(robot, IdentifyOptions(), 8, force=-1.0, lever=0.2)
    candidates = draw_candidates(robot, 5, seed=1)
    with pytest.raises(InputError, match="6 poses wanted of 5 candidates"):
        choose_poses(weigh_candidates(build_structure(robot), candidates), 6)
