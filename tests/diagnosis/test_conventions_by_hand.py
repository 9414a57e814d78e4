"""Conventions written a second time by hand, for what the engine cannot draw: modes, clocks, frames, later logs."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_campaigns import REFERENCE_C, Drawn, draw_robot_files, lay_out_rows, rail_arm, turned_arm
from effect_cases import KEYS, STEP, caused, named
from scipy.spatial.transform import Rotation

from benchmarks.campaigns.description import write_robot_folder
from benchmarks.campaigns.effects import play
from benchmarks.campaigns.simulate import Scenario, nominal_scenario, simulate_rows
from compplan.diagnosis.search.fit import fit_effects
from compplan.diagnosis.search.state import Problem
from compplan.effects import EFFECTS, Effect
from compplan.measurement.campaign import Campaign
from compplan.measurement.registration import write_registration
from compplan.robot.folder import read_robot_folder
from compplan.simulation.predict import predict_campaign


@pytest.fixture(scope="module")
def rail(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    return draw_robot_files(rail_arm(), tmp_path_factory.mktemp("rail"))


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    return draw_robot_files(turned_arm(), tmp_path_factory.mktemp("turned"))


def gears_locked(scenario: Scenario) -> Scenario:
    """Return the robot whose controller holds the link-side readings: what its gears yield never reaches the link."""
    held = np.array([spring.actuator for spring in scenario.springs])
    return replace(scenario, compliance=np.where(held, 0.0, scenario.compliance))


@pytest.mark.parametrize("mode", ["U2", "L2"])
def test_with_link_side_feedback_gears_yield_to_the_motor_and_not_to_the_link(rail: Drawn, mode: str) -> None:
    campaign, _ = rail.measure(rail.nominal)
    campaign = replace(campaign, mode=np.array([mode] * len(campaign)))
    truth = simulate_rows(gears_locked(rail.nominal), rail.rows)
    slack = Effect("backlash", "joint_2", None, {"width_rad": 4e-4})
    seen = rail.predict(campaign, []), rail.predict(campaign, [slack])
    for prediction in seen:
        np.testing.assert_allclose(prediction.position, truth.position, rtol=0, atol=1e-8)
        np.testing.assert_allclose(prediction.attained.link, rail.rows.q, rtol=0, atol=1e-8)
    yielded = np.zeros_like(rail.rows.q)  # link minus motor: c tau about the joint's axis, -y here where springs say +y
    for k, spring in enumerate(rail.description.springs):
        sense = -1.0 if spring.axis == "ry" else 1.0
        yielded[:, rail.description.joint_names.index(spring.joint)] += sense * spring.compliance * truth.load[:, k]
    np.testing.assert_allclose(seen[0].attained.motor, rail.rows.q - yielded, rtol=0, atol=1e-8)
    yielded[:, 2] += play(rail.rows.q[:, 2], 4e-4, -0.5) - rail.rows.q[:, 2]  # behind the rail, joint_2 is the third
    np.testing.assert_allclose(seen[1].attained.motor, rail.rows.q - yielded, rtol=0, atol=1e-8)


def test_a_shared_zero_that_is_off_shows_in_both_modes_and_in_neither_reading(rail: Drawn) -> None:
    campaign, _ = rail.measure(rail.nominal)
    held = replace(campaign, mode=np.array(["L2"] * len(campaign)))
    real = caused("joint_offset", "joint_3", size=7e-4)(rail.nominal)
    effect = Effect("joint_offset", "joint_3", None, {"offset_rad": 7e-4})
    for log, scenario in ((campaign, real), (held, gears_locked(real))):
        seen = rail.predict(log, [effect])
        np.testing.assert_allclose(seen.position, simulate_rows(scenario, rail.rows).position, rtol=0, atol=1e-8)
        moved = seen.attained.link - rail.predict(log, []).attained.link
        assert np.abs(moved).max() < 1e-5


def test_readings_that_are_logged_too_early_miss_a_share_of_the_last_move(turned: Drawn) -> None:
    campaign, _ = turned.measure(turned.nominal)
    q, share = turned.rows.q.copy(), 1e-3
    last = np.zeros_like(q)
    for row in range(1, len(q)):
        if turned.rows.is_path[row] or turned.rows.run[row] != turned.rows.run[row - 1]:
            continue
        moved = q[row] - q[row - 1]
        last[row] = moved if np.abs(moved).max() > 1e-3 else last[row - 1]
    truth = simulate_rows(turned.nominal, replace(turned.rows, q=q + share * last))
    seen = turned.predict(campaign, [Effect("time_skew", None, None, {"stale_ratio": share})])
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=1e-8)


def test_encoders_read_later_than_the_rest_show_where_the_joint_has_got_to(turned: Drawn) -> None:
    campaign, truth = turned.measure(turned.nominal)
    seen = turned.predict(campaign, [Effect("time_skew", None, None, {"encoder_skew_s": 0.004})])
    path = np.flatnonzero(turned.rows.is_path)
    ahead = np.gradient(turned.rows.q[path], turned.rows.time[path], axis=0) * 0.004
    np.testing.assert_allclose((seen.attained.link - truth.link)[path], ahead, rtol=0, atol=1e-8)
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=1e-9)


def test_a_base_that_no_joint_can_carry_tilts_about_its_origin_under_all_loads(turned: Drawn, tmp_path: Path) -> None:
    standing = turned.description.with_segment(0, mass=0.0)
    bolted = replace(standing, segments=standing.segments[1:])
    write_robot_folder(bolted, tmp_path / "robot", {"masses": "assumed"})
    robot = read_robot_folder(tmp_path / "robot")
    campaign, _ = turned.measure(turned.nominal)
    for axis in ("rx", "ry", "rz"):
        truth = simulate_rows(caused("base_compliance", None, axis, 2e-7)(nominal_scenario(standing)), turned.rows)
        effect = Effect("base_compliance", None, axis, {"compliance_rad_per_Nm": 2e-7})
        drawn = replace(turned, robot=robot, folder=tmp_path)
        moved = truth.position - drawn.predict(campaign, []).position
        left = truth.position - drawn.predict(campaign, [effect]).position
        assert np.abs(left).max() < 0.01 * np.abs(moved).max()


# --- registration ------------------------------------------------------------------------------------------------


def seen_from(turned: Drawn) -> tuple[Campaign, Rotation, np.ndarray, list[tuple[Rotation, np.ndarray]]]:
    """Measure two targets on the tool with an instrument that stands elsewhere: x_world = R_b (p + R t) + p_b."""
    campaign, truth = turned.measure(turned.nominal)
    turn, place = Rotation.from_rotvec([0.4, -1.1, 2.0]), np.array([2.5, -1.5, 0.8])
    targets = [
        (Rotation.from_rotvec([0.3, 0.2, -0.1]), np.array([0.04, -0.03, 0.11])),
        (Rotation.from_rotvec([0.0, 0.5, 0.4]), np.array([-0.08, 0.02, 0.05])),
    ]
    which = np.arange(len(campaign)) % 2
    position, rotation = np.empty((len(which), 3)), np.empty((len(which), 3, 3))
    for row, target in enumerate(which):
        own, offset = targets[target]
        position[row] = turn.apply(truth.position[row] + truth.rotation[row] @ offset) + place
        rotation[row] = turn.as_matrix() @ truth.rotation[row] @ own.as_matrix()
    log = replace(campaign, position=position, rotation=rotation, target=which, target_names=("a", "b"))
    return log, turn, place, targets


def test_registration_finds_the_base_in_the_instrument_and_each_target_in_the_tool(
    turned: Drawn, tmp_path: Path
) -> None:
    log, turn, place, targets = seen_from(turned)
    seen = predict_campaign(turned.robot, log, register=("base", "tool"))
    assert seen.registration is not None
    np.testing.assert_allclose(seen.registration.base[:3, :3], turn.as_matrix(), atol=1e-8)
    np.testing.assert_allclose(seen.registration.base[:3, 3], place, atol=1e-8)
    for pose, (own, offset) in zip(seen.registration.tool, targets, strict=True):
        np.testing.assert_allclose(pose[:3, :3], own.as_matrix(), atol=1e-8)
        np.testing.assert_allclose(pose[:3, 3], offset, atol=1e-8)
    np.testing.assert_allclose(seen.position, log.position, rtol=0, atol=1e-8)
    write_registration(seen.registration, tmp_path / "registration.toml")
    base = tomllib.loads((tmp_path / "registration.toml").read_text(encoding="utf-8"))["base"]
    assert base["position_mm"] == pytest.approx([2500.0, -1500.0, 800.0], abs=1e-5)
    assert base["rotation_deg"] == pytest.approx(np.rad2deg([0.4, -1.1, 2.0]), abs=1e-6)


# --- later campaigns ---------------------------------------------------------------------------------------------


def test_a_later_campaign_that_begins_warm_is_grown_from_its_first_row(rail: Drawn) -> None:
    rows = lay_out_rows(rail.description, 8, later=True, first_rise=6.0)
    campaign, truth = rail.measure(caused("thermal_drift", size=2e-5, weights=[1.0] * 8)(rail.nominal), rows=rows)
    effect = Effect("thermal_drift", None, None, {"reference_temperature_C": REFERENCE_C, "growth_per_K": 2e-5})
    seen = rail.predict(campaign, [effect], later=True)
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=5e-7)
    assert np.linalg.norm(truth.position[0] - rail.predict(campaign, []).position[0]) > 1e-4


def test_without_a_thermometer_links_grow_with_time(rail: Drawn) -> None:
    course = 1.0 - np.exp(-rail.rows.time / 900.0)
    rows = replace(rail.rows, rise=course)
    campaign, truth = rail.measure(caused("thermal_drift", size=3e-4, weights=[1.0] * 8)(rail.nominal), rows=rows)
    effect = Effect("thermal_drift", None, None, {"time_constant_s": 900.0, "growth_ratio": 3e-4})
    seen = rail.predict(replace(campaign, temperature=None), [effect])
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=1e-7)


def test_growth_counts_from_the_temperature_of_the_first_row(rail: Drawn) -> None:
    campaign, _ = rail.measure(rail.nominal)
    assert campaign.reference_temperature == pytest.approx(REFERENCE_C, abs=0.02)
    assert campaign.warming is not None
    assert campaign.warming[-1] == pytest.approx(rail.rows.rise[-1], abs=0.02)


@pytest.mark.parametrize("name", ["frame_shift", "tool_shift"])
def test_a_later_campaign_stands_after_the_shift_at_every_row(turned: Drawn, name: str) -> None:
    rows = lay_out_rows(turned.description, 9, later=True)
    real = caused(name, size=1e-3, row=40, time_s=1200.0, direction=STEP.tolist())
    campaign, truth = turned.measure(real(turned.nominal), rows=rows)
    seen = turned.predict(campaign, [Effect(name, None, None, {"row": 40, **named(KEYS, 1e-3 * STEP)})], later=True)
    np.testing.assert_allclose(seen.position, truth.position, rtol=0, atol=1e-8)


# --- names -------------------------------------------------------------------------------------------------------


def test_a_rigid_model_is_told_which_joints_bend_under_their_weights(tmp_path: Path) -> None:
    rigid = replace(turned_arm(), springs=(), gravity=None)
    robot = draw_robot_files(rigid, tmp_path)
    rows = replace(robot.rows, wrench=np.zeros_like(robot.rows.wrench))
    soft = {"joint_2": 4e-7, "joint_3": 6e-7}
    springs = [{"joint": joint, "compliance": size} for joint, size in soft.items()]
    campaign, _ = robot.measure(caused("gravity_sag", springs=springs)(robot.nominal), rows=rows, noise=1e-5)
    others = tuple(name for name in EFFECTS if name != "gravity_sag")
    fit = fit_effects(Problem(robot.robot, campaign, (), others), None)
    (found,) = fit.state.effects
    sizes = dict(zip(found.parameters["joints"], found.parameters["compliance_rad_per_Nm"], strict=True))
    for joint, size in soft.items():
        assert sizes[joint] == pytest.approx(size, rel=0.03)
    assert sizes["joint_5"] == pytest.approx(0.0, abs=3e-7)
