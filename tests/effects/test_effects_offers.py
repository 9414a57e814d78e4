"""What each effect offers to the diagnosis, in numbers worked out by hand; laws of lags and clocks; bounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_campaigns import draw_robot_files, rail_arm

from compplan.effects import EFFECTS, Effect, apply_effects, build_model, solve_model_poses
from compplan.effects.checks import check_effect
from compplan.effects.linearization import Linearization, linearize_model
from compplan.effects.signature import pack_parameters
from compplan.effects.tool_frame import tool_twists
from compplan.effects.tracking_lag import lagged_speed
from compplan.errors import InputError, UnknownNameError
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot, load_robot
from tests.effects.test_effects_signatures import AT, make_campaign, make_linearization

MM, MRAD = 1e-3, 1e-3
#: What no calibrated robot would be surprised by, one number a parameter: (turning joint, sliding joint).
SIZES = {
    "backlash": (2e-4, 1e-4),
    "base_frame": ([MM] * 3 + [0.5 * MRAD] * 3,) * 2,
    "frame_shift": ([MM] * 3 + [0.5 * MRAD] * 3,) * 2,
    "tool_frame": ([MM] * 3 + [MRAD] * 3,) * 2,
    "tool_shift": ([MM] * 3 + [MRAD] * 3,) * 2,
    "joint_offset": (1e-3, 1e-3),
    "joint_coupling": (1e-3, 1e-3),
    "link_geometry": (5e-4, 5e-4),
    "payload": ([20.0, 5.0, 5.0, 5.0],) * 2,
    "thermal_drift": (1.5e-5, 1.5e-5),
    "tracking_lag": (0.01, 0.01),
    "transmission_error": (1e-4, 1e-4),
    "wrench_bias": ([50.0] * 3 + [10.0] * 3,) * 2,
    "wrench_scale": (0.1, 0.1),
}
#: Effects that have one sign only.
ONE_SIDED = {"backlash", "base_compliance", "gravity_sag", "link_compliance", "tracking_lag"}


@pytest.fixture(scope="module")
def rail(tmp_path_factory: pytest.TempPathFactory) -> Linearization:
    return make_linearization(draw_robot_files(rail_arm(), tmp_path_factory.mktemp("rail")).robot)


@pytest.mark.parametrize("name", sorted(SIZES))
def test_an_effect_is_offered_at_a_size_that_surprises_nobody(name: str, rail: Linearization) -> None:
    for at in (AT, rail):
        kinds = {joint.name: joint.kind for joint in at.robot.actuated}
        for signature in EFFECTS[name].signatures(at):
            expected = SIZES[name][kinds.get(str(signature.joint)) == "prismatic"]
            if signature.form.startswith("origin") or signature.form.startswith("offset "):
                expected = np.asarray(expected)[:3]
            if signature.form == "directions":
                expected = np.asarray(expected)[3:]
            if np.ndim(expected):
                expected = np.asarray(expected)[: len(signature.keys)]
            if signature.form.startswith("series"):  # overtones of a half and a third
                expected = np.repeat(np.asarray(expected) / [1.0, 2.0, 3.0], 2)
            assert signature.scale == pytest.approx(np.broadcast_to(expected, len(signature.keys)), rel=1e-12)
            assert signature.scale.shape == (len(signature.keys),) == signature.twist.shape[2:]


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - {"thermal_drift", "stiffness_nonlinearity"}))
def test_only_what_has_one_sign_is_offered_with_one(name: str) -> None:
    for signature in EFFECTS[name].signatures(AT):
        assert signature.positive == (name in ONE_SIDED), signature.place
        assert signature.name == name and signature.tried == 1


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_what_is_offered_can_stand_in_effects_toml_and_moves_readings_column_by_column(
    name: str, rail: Linearization
) -> None:
    for at in (AT, rail):
        for signature in EFFECTS[name].signatures(at):
            n, nq = at.scene.campaign.q.shape
            assert signature.twist.shape == (n, 6, len(signature.keys))
            assert signature.encoder is None or signature.encoder.shape == (n, nq, len(signature.keys))
            table = {"effect": name, "joint": signature.joint, "axis": signature.axis}
            parameters = pack_parameters(signature.keys, signature.scale, signature.fixed)
            place = {key: value for key, value in table.items() if value is not None}
            check_effect({**place, "parameters": parameters}, at.robot, None, "effect[0]")


def test_a_rigid_joint_is_offered_a_typical_compliance_where_the_load_varies() -> None:
    robot = replace(AT.robot, springs=())
    at = make_linearization(robot)
    assert [s.scale.tolist() for s in EFFECTS["joint_stiffness"].signatures(at)] == [[1e-6]] * 6
    still = replace(make_campaign(robot), wrench=np.zeros((120, 6)))
    scene = build_model(robot, still)
    at = linearize_model(scene, solve_model_poses(scene))
    assert not list(EFFECTS["joint_stiffness"].signatures(at))
    (sag,) = EFFECTS["gravity_sag"].signatures(at)
    # the first joint stands upright, and what turns about the last one is balanced: no weight acts about their axes
    assert sag.fixed == {"joints": list(robot.joint_names[1:5])} and sag.form == "joints" and sag.positive
    assert sag.keys == tuple(f"compliance_rad_per_Nm#{k}" for k in range(4))
    assert sag.scale == pytest.approx([1e-5] * 4)
    assert sag.encoder is not None and not sag.encoder[:, 0].any()
    for column in range(4):
        assert np.array_equal(sag.encoder[:, column + 1, column], at.own_weight_load[:, column + 1])
        small = np.eye(4)[column] * 1e-9
        moved = solve_model_poses(apply_effects(at.scene, [sag.effect(small)])).position - at.attained.position
        assert moved == pytest.approx(sag.twist[:, :3, column] * 1e-9, abs=2e-3 * np.abs(moved).max())


def test_transmission_errors_add_up_over_their_forms() -> None:
    robot = load_robot("kuka_kr270")
    q = np.linspace(-1.0, 1.0, 7)[:, None] * np.ones(6)
    scene = build_model(robot, path_campaign(q, np.arange(7.0)))
    waves = {"cycles_per_turn": [2.0, 5.0], "sine_rad": [1e-3, 2e-3], "cosine_rad": [3e-3, 4e-3]}
    bumps = {"height_rad": [5e-3], "centre_rad": [0.1], "width_rad": [0.4]}
    moved = apply_effects(scene, [Effect("transmission_error", robot.joint_names[1], None, waves | bumps)])
    a = q[:, 1]
    hand = 1e-3 * np.sin(2 * a) + 3e-3 * np.cos(2 * a) + 2e-3 * np.sin(5 * a) + 4e-3 * np.cos(5 * a)
    hand = hand + 5e-3 * np.exp(-0.5 * ((a - 0.1) / 0.4) ** 2)
    assert moved.drive[:, 1] == pytest.approx(hand) and not np.delete(moved.drive, 1, axis=1).any()


def test_backlash_is_offered_where_the_approach_of_most_poses_is_known() -> None:
    assert list(EFFECTS["backlash"].signatures(AT))
    campaign = make_campaign(AT.robot)
    single = replace(campaign, run=np.array([f"static_{k // 2}" for k in range(len(campaign))]))
    pairs = replace(single, q=np.repeat(single.q[::2], 2, axis=0))
    at = linearize_model(scene := build_model(AT.robot, pairs), solve_model_poses(scene))
    assert pairs.first_visit.all() and not list(EFFECTS["backlash"].signatures(at))


def path_campaign(q: np.ndarray, time: np.ndarray | None, runs: np.ndarray | None = None) -> Campaign:
    n = len(q)
    run = np.array(["path_1"] * n) if runs is None else runs
    return Campaign(run=run, q=q, wrench=np.zeros((n, 6)), position=np.zeros((n, 3)), time=time)


def test_a_lag_stands_behind_by_a_first_order_law() -> None:
    time = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    q = np.zeros((5, 6))
    q[:, 0] = [0.0, 0.2, 0.3, 0.3, 0.7]  # speeds 2, 1, 0, 4
    found = lagged_speed(path_campaign(q, time), 0.1)[:, 0]
    short, long = np.exp(-1.0), np.exp(-2.0)
    second = 1.0 + (2.0 - 1.0) * short
    third = second * long
    assert found == pytest.approx([2.0, 2.0, second, third, 4.0 + (third - 4.0) * short])
    assert lagged_speed(path_campaign(q, time), -0.1)[:, 0] == pytest.approx(found)
    assert np.array_equal(lagged_speed(path_campaign(q, time), 0.0), path_campaign(q, time).speed)


def test_a_lag_shows_in_each_path_run_alone_and_only_where_time_runs_on() -> None:
    time = np.array([0.0, 1.0, 2.0, 10.0, 11.0, 12.0, 20.0, 21.0, 30.0, 30.0, 31.0])
    runs = np.array(["path_1"] * 3 + ["static_1"] * 3 + ["path_2"] * 2 + ["path_3"] * 3)
    q = np.outer(time, np.ones(6))
    found = lagged_speed(path_campaign(q, time, runs), 0.5)
    assert found[:3] == pytest.approx(np.ones((3, 6)))
    assert not found[3:].any()
    three = lagged_speed(path_campaign(q[:3], time[:3]), 0.5)
    assert three == pytest.approx(np.ones((3, 6)))


def test_a_skew_takes_the_joints_where_they_stood_that_much_earlier() -> None:
    robot = load_robot("kuka_kr270")
    time = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    q = np.outer(time, [1.0, -2.0, 0.5, 0.0, 3.0, 0.2])

    def zero(skew: float, campaign: Campaign) -> np.ndarray:
        return apply_effects(build_model(robot, campaign), [Effect("time_skew", None, None, {"skew_s": skew})]).zero

    for skew in (0.03, -0.03, 0.17, -0.17):
        # in steady motion the same at every row, before the first and behind the last one, too
        assert zero(skew, path_campaign(q, time)) == pytest.approx(np.tile(-skew * q[1] / 0.1, (5, 1)), abs=1e-12)
    assert zero(0.03, path_campaign(q[:3], time[:3])) == pytest.approx(np.tile(-0.03 * q[1] / 0.1, (3, 1)), abs=1e-12)
    bent = q.copy()
    bent[2, 0] = 0.3  # 0.1 -> 0.3 -> 0.3
    assert zero(0.05, path_campaign(bent, time))[2, 0] == pytest.approx(0.2 - 0.3)
    assert zero(-0.05, path_campaign(bent, time))[2, 0] == pytest.approx(0.0, abs=1e-12)
    runs = np.array(["static_1", "static_1", "path_1", "path_1", "path_1"])
    mixed = zero(0.03, path_campaign(q, time, runs))
    assert not mixed[:2].any() and mixed[2:] == pytest.approx(np.tile(-0.03 * q[1] / 0.1, (3, 1)), abs=1e-12)
    assert not zero(0.03, path_campaign(q, None)).any()
    assert not zero(0.03, path_campaign(q[:2], time[:2])).any()
    assert not zero(0.03, path_campaign(q, np.array([0.0, 0.1, 0.1, 0.3, 0.4]))).any()


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("kuka_kr270")


#: Effect, key, greatest number that is taken for true; other parameters it needs.
BOUNDS = [
    ("joint_offset", "offset_rad", 2 * np.pi, {}),
    ("joint_offset", "offset_m", 10.0, {}),
    ("joint_stiffness", "compliance_change_rad_per_Nm", 1e-2, {}),
    ("backlash", "width_m", 10.0, {}),
    ("backlash", "start_ratio", 1.0, {"width_rad": 1e-4}),
    ("gravity_sag", "gravity_m_s2", 20.0, {}),
    ("thermal_drift", "growth_ratio", 0.1, {"time_constant_s": 900.0}),
    ("thermal_drift", "growth_per_K", 1e-2, {"reference_temperature_C": 20.0}),
    ("thermal_drift", "reference_temperature_C", 200.0, {}),
    ("thermal_drift", "time_constant_s", 1e7, {}),
    ("wrench_bias", "fx_N", 1e6, {"axes": "base"}),
    ("wrench_scale", "gain_error_ratio", 10.0, {}),
    ("tracking_lag", "lag_s", 10.0, {}),
    ("time_skew", "skew_s", 100.0, {}),
    ("time_skew", "stale_ratio", 10.0, {}),
    ("joint_coupling", "ratio", 100.0, {"other": "first"}),
    ("frame_shift", "tx_m", 10.0, {"row": 0}),
    ("gravity_compensator", "sine_Nm", 1e6, {}),
    ("payload", "mass_kg", 1e5, {"first_moment_kg_m": [0.0, 0.0, 0.0]}),
    ("stiffness_nonlinearity", "cubic_ratio", 1e3, {"compliance": 1e-6, "reference_load": 1.0, "zone_load": 1.0}),
]
OF_JOINTS = {"joint_offset", "joint_stiffness", "backlash", "joint_coupling", "gravity_compensator",
             "stiffness_nonlinearity", "transmission_error", "link_compliance", "link_geometry"}  # fmt: skip


def check(robot: Robot, effect: str, parameters: dict, **place: str) -> None:
    parameters = {k: robot.joint_names[0] if v == "first" else v for k, v in parameters.items()}
    if effect in OF_JOINTS:
        place.setdefault("joint", robot.joint_names[2])
    check_effect({"effect": effect, "parameters": parameters, **place}, robot, None, "effect[0]")


@pytest.mark.parametrize(("effect", "key", "bound", "others"), BOUNDS)
def test_a_number_is_taken_up_to_its_bound(robot: Robot, effect: str, key: str, bound: float, others: dict) -> None:
    check(robot, effect, {key: bound, **others})
    with pytest.raises(InputError, match="at most"):
        check(robot, effect, {key: 1.001 * bound, **others})
    if key not in ("time_constant_s", "compliance_change_rad_per_Nm"):
        check(robot, effect, {key: -bound, **others})
        with pytest.raises(InputError, match="at most"):
            check(robot, effect, {key: -1.001 * bound, **others})
    with pytest.raises(InputError, match="expected a number"):
        check(robot, effect, {key: "much", **others})
    with pytest.raises(InputError, match="expected a number"):
        check(robot, effect, {key: True, **others})


REFUSED = [
    ("thermal_drift", {"time_constant_s": 0.0}, {}, "more than 0"),
    ("thermal_drift", {"time_constant_s": 9.0, "segment_growth_ratio": [1e-5] * 6}, {}, "expected 7 numbers"),
    ("thermal_drift", {"growth_ratio": 1e-4}, {}, "missing key, expected time_constant_s or reference_temperature_C"),
    ("frame_shift", {"row": -1}, {}, "expected a row counted from 0"),
    ("frame_shift", {"row": True}, {}, "expected a row counted from 0"),
    ("frame_shift", {"row": 1.5}, {}, "expected a row counted from 0"),
    ("joint_coupling", {"reversed": 1}, {}, "expected true or false"),
    ("joint_coupling", {"other": "nobody", "ratio": 1.0}, {}, "no joint named 'nobody'"),
    ("joint_coupling", {"ratio": 1.0}, {}, "missing key"),
    ("wrench_bias", {"axes": "tool"}, {}, "choose from"),
    ("link_compliance", {"compliance_rad_per_Nm": 1e-7}, {}, "needs an axis"),
    ("link_compliance", {"compliance_rad_per_Nm": -1e-7}, {"axis": "rx"}, "expected 0 or more"),
    ("link_compliance", {"compliance_m_per_N": -1e-7}, {"axis": "tx"}, "expected 0 or more"),
    ("base_compliance", {"compliance_rad_per_Nm": 1e-7}, {}, "needs an axis"),
    ("base_compliance", {"compliance_rad_per_Nm": 1e-7}, {"axis": "tx"}, "has no axis 'tx', choose from"),
    ("wrench_scale", {"gain_error_ratio": 0.1}, {"axis": "rx"}, "has no axis 'rx', leave it out"),
    ("wrench_scale", {"gain_error_ratio": 0.1}, {"joint": "first"}, "takes no joint; remove this key"),
    ("wrench_scale", {"gain_error_ratio": float("nan")}, {}, "expected a finite number"),
    ("wrench_scale", {"gain": 0.1}, {}, "unknown key, choose from"),
    ("joint_offset", {"offset_rad": 0.1}, {"joint": "flange_fixed"}, "no joint that moves named"),
    ("joint_offset", {"offset_rad": [0.1]}, {}, "expected a number"),
    ("payload", {"mass_kg": 1.0, "first_moment_kg_m": [0.0, 1.0]}, {}, "expected three numbers"),
    ("payload", {"mass_kg": 1.0, "first_moment_kg_m": 1.0}, {}, "expected three numbers"),
    ("gravity_sag", {"joints": ["nobody"], "compliance_rad_per_Nm": [1e-6]}, {}, "no joint named 'nobody'"),
    ("gravity_sag", {"joints": ["first"], "compliance_rad_per_Nm": [1e-6, 1e-6]}, {}, "lists of equal length"),
    (
        "transmission_error",
        {"cycles_per_turn": [1.0], "sine_rad": [1e-4], "cosine_rad": []},
        {},
        "lists of equal length",
    ),
    ("transmission_error", {"height_m": [1.0], "centre_m": [1.0, 2.0], "width_m": [1.0]}, {}, "lists of equal length"),
    ("transmission_error", {"cycles_per_turn": [0.0], "sine_rad": [1e-4], "cosine_rad": [0.0]}, {}, "more than 0"),
    ("transmission_error", {"spline_rad": [1e-4], "knots_rad": [0.0, 1.0]}, {}, "needs n . 4 knots"),
    ("transmission_error", {"spline_m": [1e-4], "knots_m": [0.0, 1.0]}, {}, "needs n . 4 knots"),
]


@pytest.mark.parametrize(("effect", "parameters", "place", "said"), REFUSED)
def test_a_place_or_parameter_that_is_not_the_effects_own_is_refused(
    robot: Robot, effect: str, parameters: dict, place: dict, said: str
) -> None:
    names = {"first": robot.joint_names[0]}
    parameters = {k: [names.get(e, e) for e in v] if isinstance(v, list) else v for k, v in parameters.items()}
    with pytest.raises((InputError, UnknownNameError), match=said) as caught:
        check(robot, effect, parameters, **{k: names.get(v, v) for k, v in place.items()})
    assert "effect[0]" in str(caught.value)


def test_a_table_that_says_what_its_effect_needs_is_taken(robot: Robot) -> None:
    joint, fixed = robot.joint_names[0], next(j.name for j in robot.joints if j.name not in robot.joint_names)
    check(robot, "link_compliance", {"compliance_m_per_N": 1e-7}, axis="tx")
    check(robot, "link_geometry", {"tx_m": 1e-3}, joint=fixed)
    check(robot, "tracking_lag", {"lag_s": 0.01})
    check(robot, "tracking_lag", {"lag_s": 0.01}, joint=joint)
    check(robot, "gravity_sag", {"joints": [joint], "compliance_rad_per_Nm": [1e-6]})
    check(robot, "transmission_error", {"spline_rad": [1e-4], "knots_rad": [0.0, 1.0, 2.0, 3.0, 4.0]})
    check(robot, "thermal_drift", {"time_constant_s": 9.0, "segment_growth_ratio": [1e-5] * 7})
    check(robot, "joint_coupling", {"reversed": True})
    check(robot, "frame_shift", {"row": 0})
    check_effect({"effect": "of somebody else", "parameters": {"size": 3.0}}, robot, None, "effect[0]")
    with pytest.raises(InputError, match="needs a joint"):
        lonely = {"effect": "joint_offset", "parameters": {"offset_rad": 0.1}}
        check_effect(lonely, robot, Path("effects.toml"), "effect[0]")


def test_a_turned_tool_moves_a_target_beside_the_tip_by_angle_times_lever() -> None:
    R, lever = AT.attained.frames.tcp_rotation, np.array([0.0, 0.05, 0.02])
    beside = replace(AT, point=AT.attained.frames.tcp_position + R @ lever)
    turned = tool_twists(beside)[:, :3, 3:]
    assert turned[:, :, 0] == pytest.approx(R @ np.cross([1.0, 0.0, 0.0], lever))
    assert turned[:, :, 2] == pytest.approx(R @ np.cross([0.0, 0.0, 1.0], lever))
