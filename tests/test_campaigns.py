"""Campaigns of the independent simulator: equilibrium, conventions, logs and their truth."""

from __future__ import annotations

import ast
import csv
import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import benchmarks.campaigns
from benchmarks.campaigns.campaign import rms
from benchmarks.campaigns.description import Spring, read_description
from benchmarks.campaigns.designs import Design, plan_rows
from benchmarks.campaigns.draw import draw_campaign, with_effects
from benchmarks.campaigns.effects import Effect, lagged, play
from benchmarks.campaigns.engine import ElasticModel
from benchmarks.campaigns.shapes import VOCABULARY, draw_shape
from benchmarks.campaigns.signatures import list_signatures, observe, rank_rivals, registered_share
from benchmarks.campaigns.simulate import Rows, Scenario, nominal_scenario, simulate_rows
from benchmarks.campaigns.templates import TEMPLATES, draw_robot
from benchmarks.campaigns.unknowns import MEANING, draw_unknown


def _small_setting(seed: int = 3, *, rail: bool = False, name: str = "kr270_like") -> tuple[Scenario, Rows, Design]:
    rng = np.random.default_rng(seed)
    robot, template = draw_robot(rng, rail=rail, name=name)
    design = Design(static_visits=(30,), paths=("circle",))
    rows = plan_rows(rng, robot, template, design)
    keep = np.flatnonzero(~rows.is_path | (np.arange(len(rows.q)) % 6 == 0))
    rows = Rows(rows.run[keep], rows.is_path[keep], rows.time[keep], rows.q[keep], rows.wrench[keep], rows.rise[keep])
    return nominal_scenario(robot), rows, design


def test_the_generator_shares_no_code_with_the_product() -> None:
    folder = Path(benchmarks.campaigns.__file__).parent
    for file in folder.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.split(".")[0] == "compplan" for n in names), file.name


@pytest.mark.parametrize("rail", [False, True])
def test_the_equilibrium_is_the_one_of_mujoco_statics(rail: bool) -> None:
    scenario, rows, _ = _small_setting(rail=rail)
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
    scenario, rows, _ = _small_setting()
    robot = replace(scenario.description, gravity=None)
    only = Scenario(robot, (Spring("joint_1", "own", 1e-6, actuator=True),), np.array([1e-6]))
    rest = replace(rows, wrench=np.zeros_like(rows.wrench))
    start = simulate_rows(only, rest)
    push = np.zeros_like(rows.wrench)
    push[:, 5] = 100.0
    turned = simulate_rows(only, replace(rows, wrench=push))
    np.testing.assert_allclose(turned.theta[:, 0], 1e-4, rtol=1e-12)
    moved = np.linalg.norm(turned.position - start.position, axis=1)
    np.testing.assert_allclose(moved, 1e-4 * np.linalg.norm(start.position[:, :2], axis=1), rtol=1e-6)
    np.testing.assert_allclose(turned.link[:, 0] - rows.q[:, 0], 1e-4, rtol=1e-9)


def test_play_lags_behind_by_half_its_width_and_waits_for_the_full_width_at_a_reversal() -> None:
    reading = np.array([0.0, 1.0, 2.0, 1.95, 1.5, 1.0, 1.02])
    link = play(reading, 0.1, -0.5)
    np.testing.assert_allclose(link - reading, [-0.05, -0.05, -0.05, 0.0, 0.05, 0.05, 0.03], atol=1e-12)


def test_a_lag_of_first_order_is_steady_from_the_first_sample_of_a_ramp() -> None:
    t = np.linspace(0.0, 1.0, 30)
    np.testing.assert_allclose(lagged(t, 2.0 * t, 0.05), 2.0 * t - 0.1, atol=1e-12)


def test_link_side_encoders_share_the_zero_of_the_motor_side_but_see_backlash() -> None:
    scenario, rows, _ = _small_setting()
    plain = simulate_rows(scenario, rows)
    offset = simulate_rows(with_effects(scenario, [Effect("joint_offset", "joint_2", size=1e-3)]), rows)
    assert np.max(np.abs(offset.link - plain.link)) < 2e-5
    slack = simulate_rows(with_effects(scenario, [Effect("backlash", "joint_2", size=1e-3)]), rows)
    assert np.max(np.abs(slack.link - plain.link)[:, 1]) == pytest.approx(5e-4, rel=0.02)


def test_links_do_not_grow_at_the_reference_temperature() -> None:
    scenario, rows, _ = _small_setting()
    warm = with_effects(scenario, [Effect("thermal_drift", size=1e-5, params={"weights": [1.0] * 7})])
    moved = simulate_rows(warm, rows).position - simulate_rows(scenario, rows).position
    assert np.linalg.norm(moved[0]) < 1e-12
    assert np.linalg.norm(moved[-1]) > 1e-6


@pytest.mark.parametrize("name", VOCABULARY)
def test_every_effect_of_the_vocabulary_shows_in_the_readings(name: str) -> None:
    scenario, rows, design = _small_setting(5)
    if name == "gravity_sag":
        scenario = replace(scenario, description=replace(scenario.description, gravity=None))
    effect = draw_shape(np.random.default_rng(1), name, scenario, rows, design)
    before, after = simulate_rows(scenario, rows), simulate_rows(with_effects(scenario, [effect]), rows)
    seen = rms(after.position - before.position) > 1e-8 or np.max(np.abs(after.wrench - before.wrench)) > 1e-3
    assert seen


@pytest.mark.parametrize("name", sorted(MEANING))
def test_every_effect_outside_the_vocabulary_shows_in_the_readings(name: str) -> None:
    scenario, rows, _ = _small_setting(5)
    effect = draw_unknown(np.random.default_rng(1), name, scenario, rows)
    before, after = simulate_rows(scenario, rows), simulate_rows(with_effects(scenario, [effect]), rows)
    seen = rms(after.position - before.position) > 1e-8 or np.max(np.abs(after.wrench - before.wrench)) > 1e-3
    assert seen


def test_a_base_that_turns_about_the_axis_of_joint_1_cannot_be_told_from_its_spring() -> None:
    scenario, rows, design = _small_setting()
    watch = observe(scenario, rows, design.sigma, design.sigma_rotation)
    signatures = list_signatures(watch, [])
    effect = Effect("base_compliance", None, "rz", 1e-7)
    deviation = watch.deviation(with_effects(scenario, [effect]))
    rivals = rank_rivals(effect, deviation, 3 * len(watch.select), signatures, registered_share(deviation, signatures))
    assert (rivals[0]["effect"], rivals[0]["joint"]) == ("joint_stiffness", "joint_1")
    assert rivals[0]["r2"] > 0.9999
    assert rivals[1]["r2"] < 0.98


@pytest.mark.slow
def test_a_campaign_depends_on_its_seed_alone(tmp_path: Path) -> None:
    first = draw_campaign(11, "single", "clean", ["joint_stiffness"]).write(tmp_path / "a")
    second = draw_campaign(11, "single", "clean", ["joint_stiffness"]).write(tmp_path / "b")
    for file in ("measurements.csv", "fresh.csv", "robot/robot.urdf", "robot/elasticity.toml"):
        assert (first / file).read_bytes() == (second / file).read_bytes()


@pytest.mark.slow
def test_the_truth_put_into_the_written_robot_leaves_the_noise_floor(tmp_path: Path) -> None:
    campaign = draw_campaign(12, "double", "clean", ["joint_stiffness", "link_compliance"])
    folder = campaign.write(tmp_path / "case")
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    with (folder / "measurements.csv").open(encoding="utf-8") as file:
        log = list(csv.DictReader(file))
    rows = campaign.given.rows
    assert len(log) == len(rows.q) == truth["split"]["given"]["rows"]
    effects = [Effect(e["effect"], e["joint"], e["axis"], e["size"], e["unit"], e["params"]) for e in truth["effects"]]
    again = simulate_rows(with_effects(nominal_scenario(read_description(folder / "robot")), effects), rows)
    left = (campaign.given.position - again.position) * 1e3
    left = np.delete(left, truth["split"]["given"]["outlier_rows"], axis=0)
    assert rms(left) == pytest.approx(truth["noise_floor_rms_mm"], rel=0.1)
    assert truth["split"]["given"]["gap_rms_mm"] > 2.0 * truth["noise_floor_rms_mm"]


def test_a_background_has_one_to_two_times_the_rms_of_the_noise() -> None:
    truth = draw_campaign(13, "none", "realistic").truth
    assert 1.0 <= truth["background_rms_mm"] / truth["noise_floor_rms_mm"] <= 2.0
    assert truth["effects"] == []
    assert len(truth["background"]) > 20


def test_nothing_wrong_leaves_no_gap() -> None:
    truth = draw_campaign(14, "none", "clean").truth
    assert truth["split"]["given"]["gap_rms_mm"] == 0.0
    assert truth["split"]["fresh"]["gap_rms_mm"] == 0.0


def test_an_unknown_effect_is_one_that_the_vocabulary_does_not_explain() -> None:
    entry = draw_campaign(15, "unknown", "clean").truth["effects"][0]
    assert entry["effect"] not in VOCABULARY
    assert entry["nearest_rivals"][0]["r2"] <= 0.85


@pytest.mark.slow
def test_an_indistinguishable_campaign_names_what_cannot_be_told_apart() -> None:
    assert draw_campaign(16, "indistinguishable", "clean").truth["effects"][0]["acceptable"]


def test_a_rail_is_the_first_joint_and_is_logged_in_mm(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    robot, _ = draw_robot(rng, rail=True)
    assert robot.joint_names[0] == "rail"
    for seed in range(20, 60):
        campaign = draw_campaign(seed, "none", "clean")
        if campaign.nominal.joint_names[0] == "rail" and not campaign.design.si_units:
            header = (
                (campaign.write(tmp_path / "rail") / "measurements.csv").read_text(encoding="utf-8").splitlines()[0]
            )
            assert "q1_mm" in header and "q7_deg" in header
            return
    pytest.fail("no robot on a rail among forty campaigns")


def test_unknown_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="choose from"):
        draw_campaign(1, "quadruple")


def test_every_template_reaches_its_home_posture_within_its_limits() -> None:
    for template in TEMPLATES:
        limits = np.array(template.limits_deg)
        assert np.all(np.array(template.home_deg) >= limits[:, 0])
        assert np.all(np.array(template.home_deg) <= limits[:, 1])


def test_a_body_may_carry_more_springs_than_a_mujoco_body_has_room_for() -> None:
    scenario, rows, _ = _small_setting()
    axes = ("rx", "rz", "tx", "ty", "tz", "rx", "rz", "tx")
    apart = tuple(Spring("joint_3", a, 1e-8) for a in axes)
    joined = tuple(Spring("joint_3", a, 1e-8) for a in axes[:3])
    merged = Scenario(scenario.description, joined, np.full(3, 1e-12))
    split = Scenario(scenario.description, apart, np.full(8, 1e-12))
    np.testing.assert_allclose(simulate_rows(split, rows).position, simulate_rows(merged, rows).position, atol=1e-7)
    load = simulate_rows(split, rows).load
    np.testing.assert_allclose(load[:, 0], load[:, 5], atol=1e-5)
    np.testing.assert_allclose(load[:, 2], load[:, 7], atol=1e-5)
