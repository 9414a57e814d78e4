"""Costs of postures: sensitivity against perturbed robots, limits, dexterity, presets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compplan.errors import UnknownNameError
from compplan.planning.posture.costs import ModelScatter, choose_weights, error_columns, measure_limits, measure_nodes
from compplan.robot import load_robot
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.statics.chain import build_chain

ROBOT = load_robot("kuka_kr270")
CHAIN = build_chain(ROBOT)
LIMITS = (ROBOT.lower, ROBOT.upper)
WRENCH = np.array([250.0, -120.0, 400.0, 3.0, -8.0, 5.0])


def postures(n: int = 6) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.array([0.2, 0.3, -1.6, 0.4, 0.9, 0.1]) + 0.2 * rng.standard_normal((n, 6))


def test_each_error_column_is_what_the_exact_equilibrium_of_a_perturbed_robot_changes_by() -> None:
    q, size = postures(3), 1e-4
    columns = error_columns(CHAIN, q, np.tile(WRENCH, (3, 1)), ModelScatter(1.0, 1.0))
    small = 1e-3 * WRENCH  # so small that the levers do not change
    columns = columns * 1e-3
    base = solve_exact_pose(build_exact_robot(ROBOT), q, np.tile(small, (3, 1)))[0]
    for j in range(6):
        springs = tuple(
            replace(s, compliance=s.compliance * (1 + size * (k == j))) for k, s in enumerate(ROBOT.springs)
        )
        moved = solve_exact_pose(build_exact_robot(replace(ROBOT, springs=springs)), q, np.tile(small, (3, 1)))[0]
        assert (moved - base) / size == pytest.approx(columns[:, :, j], abs=2e-9)
        wrench = small * (1 + size * (np.arange(6) == j))
        moved = solve_exact_pose(build_exact_robot(ROBOT), q, np.tile(wrench, (3, 1)))[0]
        assert (moved - base) / size == pytest.approx(columns[:, :, 6 + j], abs=2e-9)


def test_the_expected_value_agrees_with_a_sample_of_perturbed_robots() -> None:
    q, rng, n = postures(1), np.random.default_rng(1), 300
    base = solve_exact_pose(build_exact_robot(ROBOT), q, WRENCH[None])[0]
    squares = []
    for _ in range(n):
        springs = tuple(replace(s, compliance=s.compliance * (1 + 0.1 * rng.standard_normal())) for s in ROBOT.springs)
        wrench = WRENCH * (1 + 0.1 * rng.standard_normal(6))
        moved = solve_exact_pose(build_exact_robot(replace(ROBOT, springs=springs)), q, wrench[None])[0]
        squares.append(float(((moved - base) ** 2).sum()))
    expected = measure_nodes(CHAIN, q, WRENCH[None], limits=LIMITS).sensitivity[0]
    spread = np.std(squares) / np.sqrt(n)
    assert abs(np.mean(squares) - expected**2) < 4 * spread


def test_sensitivity_grows_in_proportion_to_the_wrench_and_to_the_errors() -> None:
    q = postures()
    wrench = np.tile(WRENCH, (len(q), 1))
    one = measure_nodes(CHAIN, q, wrench, limits=LIMITS, uncertainty=ModelScatter(0.1, 0.1)).sensitivity
    two = measure_nodes(CHAIN, q, 2 * wrench, limits=LIMITS, uncertainty=ModelScatter(0.1, 0.1)).sensitivity
    three = measure_nodes(CHAIN, q, wrench, limits=LIMITS, uncertainty=ModelScatter(0.3, 0.3)).sensitivity
    assert two == pytest.approx(2 * one)
    assert three == pytest.approx(3 * one)


def test_turning_base_part_and_wrench_together_changes_nothing() -> None:
    q = postures()
    wrench = np.tile(WRENCH, (len(q), 1))
    turned = q.copy()
    turned[:, 0] += 0.7  # joint 1 stands upright: the whole cell turns
    c, s = np.cos(0.7), np.sin(0.7)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    load = np.hstack([wrench[:, :3] @ R.T, wrench[:, 3:] @ R.T])
    one = measure_nodes(CHAIN, q, wrench, limits=LIMITS)
    two = measure_nodes(CHAIN, turned, load, limits=LIMITS, axes=R)
    assert two.sensitivity == pytest.approx(one.sensitivity)


def test_dexterity_vanishes_where_the_wrist_is_straight() -> None:
    q = postures()
    q[:, 4] = 0.0
    assert (measure_nodes(CHAIN, q, np.zeros((len(q), 6)), limits=LIMITS).dexterity < 1e-6).all()
    assert (measure_nodes(CHAIN, postures(), np.zeros((len(q), 6)), limits=LIMITS).dexterity > 0.1).all()


def test_limits_cost_nothing_beyond_the_margin_and_one_at_a_limit() -> None:
    lower, upper = -np.ones(2), np.ones(2)
    q = np.array([[0.0, 0.0], [1.0, 0.0], [0.95, -0.95]])
    assert measure_limits(q, lower, upper, 0.1) == pytest.approx([0.0, 1.0, 0.5])


def test_presets_scale_with_the_least_sensitivity_and_unknown_ones_are_named() -> None:
    light, heavy = choose_weights("accurate", 1e-4), choose_weights("accurate", 1e-2)
    assert heavy.motion == pytest.approx(100 * light.motion)
    assert heavy.sensitivity == light.sensitivity == 1.0
    with pytest.raises(UnknownNameError, match="no preset named 'best', choose from"):
        choose_weights("best", 1.0)
