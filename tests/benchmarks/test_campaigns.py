"""Campaigns of the independent simulator: equilibrium, conventions, logs and their truth."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from drawn_campaigns import lay_out_rows, rail_arm, turned_arm

import benchmarks.campaigns
from benchmarks.campaigns.description import Spring
from benchmarks.campaigns.effects import Effect, apply_effect, lagged, play
from benchmarks.campaigns.engine import ElasticModel
from benchmarks.campaigns.simulate import Rows, Scenario, nominal_scenario, simulate_rows


def _small_setting(*, rail: bool = False) -> tuple[Scenario, Rows]:
    robot = rail_arm() if rail else turned_arm()
    return nominal_scenario(robot), lay_out_rows(robot, 3)


def test_the_generator_shares_no_code_with_the_product() -> None:
    folder = Path(benchmarks.campaigns.__file__).parent
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] == "compplan" for n in names), file.name


@pytest.mark.parametrize("rail", [False, True])
def test_the_equilibrium_is_the_one_of_mujoco_statics(rail: bool) -> None:
    scenario, rows = _small_setting(rail=rail)
    springs = (
        *scenario.springs,
        Spring("base_fixed", "rx", 2e-8),
        Spring("joint_2", "tx", 1e-8),
        Spring("joint_3", "rx", 4e-7),
    )
    model = ElasticModel(scenario.description, springs)
    compliance = np.array([s.compliance for s in springs])
    solved = model.solve(rows.q, rows.wrench, lambda tau: tau * compliance)
    mj, data = model.model, mujoco.MjData(model.model)
    for k in range(0, len(rows.q), 9):
        data.qpos[model.motor_ids] = rows.q[k]
        data.qpos[model.spring_ids] = solved.theta[k]
        data.qvel[:] = 0.0
        mujoco.mj_forward(mj, data)
        applied = np.zeros(mj.nv)
        tip = solved.position[k].reshape(3, 1)
        mujoco.mj_applyFT(
            mj, data, rows.wrench[k, :3].reshape(3, 1), rows.wrench[k, 3:].reshape(3, 1), tip, mj.nbody - 1, applied
        )
        left = data.qfrc_passive + applied - data.qfrc_bias
        assert np.max(np.abs(left[model.spring_ids])) < 1e-6 * max(1.0, np.max(np.abs(data.qfrc_bias)))
        np.testing.assert_allclose(data.xpos[-1], solved.position[k], atol=1e-12)


def test_a_single_spring_deflects_as_its_closed_form_says() -> None:
    scenario, rows = _small_setting()
    robot = replace(scenario.description, gravity=None)
    only = Scenario(robot, (Spring("joint_1", "own", 1e-6, actuator=True),), np.array([1e-6]))
    rest = replace(rows, wrench=np.zeros_like(rows.wrench))
    start = simulate_rows(only, rest)
    push = np.zeros_like(rows.wrench)
    push[:, 5] = 100.0
    turned = simulate_rows(only, replace(rows, wrench=push))
    np.testing.assert_allclose(turned.theta[:, 0], -1e-4, rtol=1e-12)  # joint 1 counts about -z
    moved = np.linalg.norm(turned.position - start.position, axis=1)
    np.testing.assert_allclose(moved, 1e-4 * np.linalg.norm(start.position[:, :2], axis=1), rtol=1e-6)
    np.testing.assert_allclose(turned.link[:, 0] - rows.q[:, 0], -1e-4, rtol=1e-9)


def test_play_lags_behind_by_half_its_width_and_waits_for_the_full_width_at_a_reversal() -> None:
    reading = np.array([0.0, 1.0, 2.0, 1.95, 1.5, 1.0, 1.02])
    link = play(reading, 0.1, -0.5)
    np.testing.assert_allclose(link - reading, [-0.05, -0.05, -0.05, 0.0, 0.05, 0.05, 0.03], atol=1e-12)


def test_a_lag_of_first_order_is_steady_from_the_first_sample_of_a_ramp() -> None:
    t = np.linspace(0.0, 1.0, 30)
    np.testing.assert_allclose(lagged(t, 2.0 * t, 0.05), 2.0 * t - 0.1, atol=1e-12)


def test_link_side_encoders_share_the_zero_of_the_motor_side_but_see_backlash() -> None:
    scenario, rows = _small_setting()
    plain = simulate_rows(scenario, rows)
    offset = simulate_rows(apply_effect(Effect("joint_offset", "joint_2", size=1e-3), scenario), rows)
    assert np.max(np.abs(offset.link - plain.link)) < 2e-5
    slack = simulate_rows(apply_effect(Effect("backlash", "joint_2", size=1e-3), scenario), rows)
    assert np.max(np.abs(slack.link - plain.link)[:, 1]) == pytest.approx(5e-4, rel=0.02)


def test_links_do_not_grow_at_the_reference_temperature() -> None:
    scenario, rows = _small_setting()
    warm = apply_effect(Effect("thermal_drift", size=1e-5, params={"weights": [1.0] * 7}), scenario)
    moved = simulate_rows(warm, rows).position - simulate_rows(scenario, rows).position
    assert np.linalg.norm(moved[0]) < 1e-12
    assert np.linalg.norm(moved[-1]) > 1e-6


def test_a_body_may_carry_more_springs_than_a_mujoco_body_has_room_for() -> None:
    scenario, rows = _small_setting()
    axes = ("rx", "rz", "tx", "ty", "tz", "rx", "rz", "tx")
    apart = tuple(Spring("joint_3", a, 1e-8) for a in axes)
    joined = tuple(Spring("joint_3", a, 1e-8) for a in axes[:3])
    merged = Scenario(scenario.description, joined, np.full(3, 1e-12))
    split = Scenario(scenario.description, apart, np.full(8, 1e-12))
    np.testing.assert_allclose(simulate_rows(split, rows).position, simulate_rows(merged, rows).position, atol=1e-7)
    load = simulate_rows(split, rows).load
    np.testing.assert_allclose(load[:, 0], load[:, 5], atol=1e-5)
    np.testing.assert_allclose(load[:, 2], load[:, 7], atol=1e-5)
