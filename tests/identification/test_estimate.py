"""Estimates from arrays: exact, weighted, robust, reduced."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.round_trip import draw_candidates, simulate_observations
from compplan.errors import InputError, ShapeError, UnknownNameError
from compplan.identification import build_structure, estimate_parameters, reduce_model
from compplan.measurement.campaign import make_log
from compplan.robot import Robot, load_robot


def soften(robot: Robot, seed: int) -> Robot:
    factor = np.random.default_rng(seed).uniform(0.5, 1.8, len(robot.springs))
    springs = (replace(s, compliance=s.compliance * f) for s, f in zip(robot.springs, factor, strict=True))
    return replace(robot, springs=tuple(springs))


def compliances(robot: Robot) -> np.ndarray:
    return np.array([spring.compliance for spring in robot.springs])


@pytest.mark.parametrize("name", ["kuka_kr270", "staubli_tx200", "kuka_kr120_r3900", "kuka_kr240_rail"])
def test_without_noise_the_injected_compliances_come_back_exactly(name: str) -> None:
    robot = load_robot(name)
    truth = soften(robot, 3)
    drawn = draw_candidates(robot, 30, seed=1)
    estimate = estimate_parameters(build_structure(robot), simulate_observations(truth, drawn.q, drawn.wrench))
    np.testing.assert_allclose(estimate.model_values, compliances(truth), rtol=1e-5)


def test_the_estimate_is_of_the_exact_loaded_equilibrium_not_of_its_first_order() -> None:
    robot = load_robot("staubli_tx200").scale_compliance(20.0)
    drawn = draw_candidates(robot, 30, seed=1)
    rows = simulate_observations(robot, drawn.q, drawn.wrench)
    structure = build_structure(robot.scale_compliance(0.5))
    exact = estimate_parameters(structure, rows)
    np.testing.assert_allclose(exact.model_values, compliances(robot), rtol=1e-4)
    assert exact.iterations > 2


def test_own_weight_tells_compliances_as_a_load_does() -> None:
    robot = replace(load_robot("kuka_kr270"), gravity=np.array([0.0, 0.0, -9.81]))
    truth = soften(robot, 5)
    q = draw_candidates(robot, 40, seed=2).q
    estimate = estimate_parameters(build_structure(robot), simulate_observations(truth, q, np.zeros(6)))
    assert [item.held for item in estimate.held if item.held == "joint_1"] == ["joint_1"]
    told = estimate.free
    np.testing.assert_allclose(estimate.model_values[told], compliances(truth)[told], rtol=1e-4)


def test_a_row_that_is_stated_to_be_noisier_weighs_less() -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 40, seed=1)
    rows = simulate_observations(robot, drawn.q, drawn.wrench, seed=4)
    rng = np.random.default_rng(0)
    bad = np.arange(40) % 2 == 0
    position = rows.position + np.where(bad[:, None], 1e-3, 0.0) * rng.standard_normal((40, 3))
    even = replace(rows, position=position)
    stated = replace(even, sigma=np.where(bad, 1e-3, rows.sigma))
    errors = [estimate_parameters(build_structure(robot), r).standard_errors for r in (stated, even)]
    assert (errors[0][:3] < 0.5 * errors[1][:3]).all()


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_gross_outliers_do_not_pull_a_robust_estimate(loss: str) -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 100, seed=1)
    rows = simulate_observations(robot, drawn.q, drawn.wrench, seed=4)
    position = rows.position.copy()
    position[[10, 60]] += [0.02, -0.01, 0.03]
    clean, spoiled = replace(rows, rotation=None), replace(rows, rotation=None, position=position)
    structure = build_structure(robot)
    error = estimate_parameters(structure, clean).standard_errors
    plain, robust = (estimate_parameters(structure, spoiled, loss=kind) for kind in ("least_squares", loss))
    told = robust.free  # the target lies on axis 6, so joint 6 moves it by nothing
    assert told.tolist() == [True] * 5 + [False]
    score = [np.abs(e.model_values - compliances(robot))[told] / error[told] for e in (plain, robust)]
    assert score[0].max() > 20
    assert score[1].max() < 4
    assert set(np.flatnonzero(robust.weights < 0.1)) == {10, 60}


def test_differences_of_a_pose_under_several_loads_do_not_see_wrong_geometry() -> None:
    robot = load_robot("kuka_kr270")
    truth = soften(robot, 2)
    bent = list(truth.joints)
    moved = bent[2].placement.copy()
    moved[0, 3] += 2e-3
    bent[2] = replace(bent[2], placement=moved)
    drawn = draw_candidates(robot, 40, seed=1)
    q, wrench = np.vstack([drawn.q] * 2), np.vstack([drawn.wrench, np.zeros((40, 6))])
    rows = simulate_observations(replace(truth, joints=tuple(bent)), q, wrench, seed=3)
    relative = estimate_parameters(build_structure(robot), rows, reference="difference")
    score = (relative.model_values - compliances(truth)) / relative.standard_errors
    assert np.abs(score).max() < 4
    absolute = estimate_parameters(build_structure(robot), rows)
    assert absolute.noise[0] > 5 * relative.noise[0]


def test_the_reduced_model_of_the_kr270_lies_within_17_percent_of_the_papers_table() -> None:
    # Moments of 300 N m beside 1 kN, a rotation weighed as 1 m; both move joint 1 by a few percent.
    full = load_robot("kuka_kr270_full")
    rng = np.random.default_rng(0)
    q = rng.uniform(np.maximum(full.lower, -3), np.minimum(full.upper, 3), (400, 6))
    wrench = np.hstack([rng.uniform(-1000, 1000, (400, 3)), rng.uniform(-300, 300, (400, 3))])
    reduced = reduce_model(full, q, wrench, rotation_weight=1.0)
    table = np.array([0.56, 0.30, 0.43, 2.8, 3.2, 2.1]) * 1e-6
    assert np.abs(reduced.compliance / table - 1).max() < 0.17
    assert (
        np.linalg.norm(reduced.residual[:, :3], axis=1).mean()
        < 0.25 * np.linalg.norm(reduced.deflection[:, :3], axis=1).mean()
    )


def test_a_pure_force_through_the_last_axis_leaves_joint_6_of_the_reduced_model_unidentifiable() -> None:
    full = load_robot("kuka_kr270_full")
    rng = np.random.default_rng(0)
    q = rng.uniform(np.maximum(full.lower, -3), np.minimum(full.upper, 3), (100, 6))
    wrench = np.hstack([rng.uniform(-1000, 1000, (100, 3)), np.zeros((100, 3))])
    reduced = reduce_model(full, q, wrench)
    assert [item.held for item in reduced.estimate.held] == ["joint_6"]
    assert "every force passes through its axis" in reduced.estimate.held[0].reason
    assert reduced.compliance[5] == 0.0


def test_wrong_shapes_and_names_are_refused_with_what_is_allowed() -> None:
    robot = load_robot("kuka_kr270")
    q = np.zeros((3, 6))
    with pytest.raises(ShapeError, match=r"position has shape \(2, 3\), expected \(3, 3\)"):
        make_log(q, np.zeros(6), np.zeros((2, 3)))
    with pytest.raises(UnknownNameError, match="no spring named 'joint_9', choose from"):
        build_structure(robot, springs=["joint_9"])
    rows = make_log(q, np.zeros(6), np.zeros((3, 3)))
    with pytest.raises(InputError, match="nothing can be identified: joint_1 cannot be determined at all: no row"):
        estimate_parameters(build_structure(robot), rows)
    with pytest.raises(UnknownNameError, match="no loss named 'cauchy'"):
        estimate_parameters(build_structure(robot), rows, loss="cauchy")
