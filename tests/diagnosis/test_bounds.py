"""Bounds: an effect of a size that no robot has is not named, and the reason is said in words of the robot."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compplan.diagnosis.validation.bounds import MOST_BENT, find_breach, stretched_moment
from compplan.effects import Effect, command_campaign, solve_model_poses
from compplan.effects.payload import carried_payload
from compplan.robot.folder import read_robot_folder
from compplan.uncertainty.sensitivities import build_varied_model

ROBOT = next(Path(__file__).parents[2].glob("robots/ur10*"))


@pytest.fixture(scope="module")
def fit() -> Any:
    """The shipped UR10, at rest in two poses: its shoulder carries 100 N m at the most."""
    robot = read_robot_folder(ROBOT)
    load = np.zeros((2, robot.nq))
    load[:, 1] = [-100.0, 60.0]
    # stretched out to the front, and up
    q = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]])
    attained = solve_model_poses(build_varied_model(robot, command_campaign(q, on_path=False)))
    return SimpleNamespace(
        problem=SimpleNamespace(robot=robot, campaign=SimpleNamespace(q=q)),
        at=SimpleNamespace(robot=robot, own_load=load, own_weight_load=load, attained=attained),
    )


def ask(fit: Any, name: str, joint: int | None, **values: Any) -> str:
    at = None if joint is None else fit.problem.robot.joint_names[joint]
    return find_breach(fit, Effect(name, at, None, values), 1e-3, 1e-3)


def test_a_payload_hangs_before_the_flange_and_weighs_what_the_arm_carries(fit: Any) -> None:
    """8.6 kg with their centre 22 cm behind the flange would sit in the wrist; the arm is sold for 10 kg."""
    assert not ask(fit, "payload", None, mass_kg=8.6, first_moment_kg_m=[0.3, 0.0, 0.9])
    assert "220 mm behind the flange" in ask(fit, "payload", None, mass_kg=8.6, first_moment_kg_m=[0, 0, -8.6 * 0.22])
    assert "41.6 kg on the flange" in ask(fit, "payload", None, mass_kg=41.6, first_moment_kg_m=[0.0, 0.0, 4.0])


def test_no_link_warms_up_by_more_than_forty_kelvin(fit: Any) -> None:
    """With a time constant of 1000 s, a link has 63 % of its growth after 1000 s."""
    campaign = replace(command_campaign(fit.problem.campaign.q, on_path=False), time=np.array([0.0, 1000.0]))
    scene = build_varied_model(fit.problem.robot, campaign)
    warm = SimpleNamespace(problem=fit.problem, at=SimpleNamespace(scene=scene))
    links = [1.4e-3, *[0.0] * fit.problem.robot.nq]
    assert not ask(warm, "thermal_drift", None, time_constant_s=1000.0, segment_growth_ratio=links)
    said = ask(warm, "thermal_drift", None, time_constant_s=1000.0, segment_growth_ratio=[2e-3, *links[1:]])
    assert said == "a link would grow by 1.3 mm per metre: aluminium 53 K warmer"


def test_what_a_lighter_tool_leaves_hangs_before_the_flange(fit: Any) -> None:
    """5 kg hang 64 mm before the TX200's flange: taken off, 2.5 kg cannot have hung 1.6 m before it."""
    robot = read_robot_folder(ROBOT.parent / "staubli_tx200")
    assert carried_payload(robot) == pytest.approx([5.0, 0.0, 0.0, 5.0 * 0.0643])
    own = SimpleNamespace(
        problem=SimpleNamespace(robot=robot),
        at=SimpleNamespace(robot=robot, own_weight_load=np.full((1, 6), np.inf), attained=None),
    )
    assert not ask(own, "payload", None, mass_kg=-2.5, first_moment_kg_m=[0.0, 0.0, -0.25])
    said = ask(own, "payload", None, mass_kg=-2.5, first_moment_kg_m=[1.3, 0.8, -4.1])
    assert said.startswith("2.5 kg less on the flange leave 2.5 kg with their centre 1511 mm behind")


def test_no_link_joint_or_base_plate_bends_by_a_fiftieth_under_the_stretched_arm(fit: Any) -> None:
    """A forearm of 1.1 mrad/(N m), once named of 15 poses, would hang down by centimetres under its own weight."""
    robot = fit.problem.robot
    elbow, moment = robot.joint_names[2], stretched_moment(robot, robot.joint_names[2])
    weight = sum(b.mass for b in robot.bodies)
    assert 20.0 < moment < stretched_moment(robot, None) < 9.81 * weight * robot.longest_reach
    for name, joint, key in (
        ("link_compliance", 2, "compliance_rad_per_Nm"), ("joint_stiffness", 2, "compliance_change_rad_per_Nm"),
    ):  # fmt: skip
        assert not ask(fit, name, joint, **{key: 0.9 * MOST_BENT / moment})
        assert f"{elbow} would bend by" in ask(fit, name, joint, **{key: 1.1e-3})
    assert "the base would bend" in ask(fit, "base_compliance", None, compliance_rad_per_Nm=5e-4)
    # of a robot with a data sheet, what it is sold for hangs at the flange
    rated = read_robot_folder(ROBOT.parent / "abb_irb6640_185_280")
    alone = stretched_moment(replace(rated, folder=None), rated.joint_names[1])
    assert 9.81 * 185.0 * 2.0 < stretched_moment(rated, rated.joint_names[1]) - alone < 9.81 * 185.0 * 3.0
    # along an axis as if bent half a metre away
    assert not ask(fit, "link_compliance", 2, compliance_m_per_N=0.9 * 0.25 * MOST_BENT / moment)
    assert ask(fit, "link_compliance", 2, compliance_m_per_N=1.1 * 0.25 * MOST_BENT / moment)
    sag = {"joints": list(robot.joint_names[1:3]), "compliance_rad_per_Nm": [1e-6, 1.1e-3]}
    assert ask(fit, "gravity_sag", None, **sag).startswith(f"{elbow} would bend")


def test_a_claim_does_not_move_the_target_many_times_as_far_as_the_gap(fit: Any) -> None:
    offset = Effect("joint_offset", fit.problem.robot.joint_names[1], None, {"offset_rad": 1e-3})
    assert not find_breach(fit, offset, 9e-3, 2.2e-3)
    assert find_breach(fit, offset, 0.493, 2.2e-3) == "it moves the target by 493 mm, the gap is 2.2 mm"
