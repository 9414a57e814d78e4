"""Signatures against the exact forward model, by finite differences, for every effect, place and form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn_campaigns import draw_robot_files, rail_arm
from scipy.spatial.transform import Rotation

from compplan.effects import (
    EFFECTS,
    Effect,
    apply_effects,
    build_model,
    command_campaign,
    fold_effects,
    solve_model_poses,
)
from compplan.effects.frame_shift import shift_at
from compplan.effects.joint_stiffness import signatures
from compplan.effects.linearization import Linearization, linearize_model
from compplan.effects.signature import Signature
from compplan.measurement.campaign import Campaign
from compplan.robot import Robot, load_robot
from compplan.robot.folder import read_robot_folder

FOLLOWS, ZERO, COMPLIANCE = -2.0, 0.3, 1e-6


def make_campaign(robot: Robot, seed: int = 3) -> Campaign:
    """Make a campaign with two static runs and a path, loads, encoders and a warm-up."""
    random = np.random.default_rng(seed)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.25 * (robot.upper - robot.lower)
    static = np.repeat(middle + half * random.uniform(-1, 1, (30, robot.nq)), 2, axis=0)
    phase = np.linspace(0, 3.0, 60)[:, None]
    path = middle + 0.1 * half * np.sin(phase + np.arange(robot.nq))
    q = np.vstack([static, path])
    wrench = np.concatenate([random.normal(0, 400, (len(q), 3)), random.normal(0, 60, (len(q), 3))], axis=1)
    run = np.array(["static_1"] * 30 + ["static_2"] * 30 + ["path_1"] * 60)
    time = np.r_[np.arange(60) * 20.0, 1300.0 + 0.05 * np.arange(60)]
    n = len(q)
    return Campaign(
        run=run, q=q, wrench=wrench, position=np.zeros((n, 3)), rotation=np.broadcast_to(np.eye(3), (n, 3, 3)),
        time=time, temperature=20 + 10 * (1 - np.exp(-time / 1000)), link=q.copy(),
    )  # fmt: skip


def make_linearization(robot: Robot) -> Linearization:
    scene = build_model(robot, make_campaign(robot))
    return linearize_model(scene, solve_model_poses(scene))


def all_signatures(at: Linearization) -> list[Signature]:
    found = [s for model in EFFECTS.values() for s in model.signatures(at)]
    return [*found, *shift_at(at, 17)]


def worst_disagreement(at: Linearization, signature: Signature) -> float:
    """Compare a signature with central differences of the exact model; relative to its largest motion."""
    worst = 0.0
    for k, scale in enumerate(signature.scale):
        sides = []
        # play is not a smooth function of its width: its signature is the secant between zero and half its scale
        ends = (0.5, 1e-9) if signature.name == "backlash" else (1e-2, -1e-2)
        for end in ends:
            values = np.zeros(len(signature.scale))
            values[k] = end * scale
            effect = signature.effect(values)
            scene = apply_effects(at.scene, [effect])
            sides.append(solve_model_poses(scene))
        step = (ends[0] - ends[1]) * scale
        linear = (sides[0].position - sides[1].position) / step
        turn = Rotation.from_matrix(sides[0].rotation @ np.swapaxes(sides[1].rotation, 1, 2)).as_rotvec() / step
        exact = np.concatenate([linear, turn], axis=1)
        twist = signature.twist[:, :, k]
        link = (sides[0].link - sides[1].link) / step
        encoder = np.zeros_like(link) if signature.encoder is None else signature.encoder[:, :, k]
        size = max(np.abs(exact).max(), np.abs(link).max(), 1e-12)
        worst = max(worst, np.abs(exact - twist).max() / size, np.abs(link - encoder).max() / size)
    return worst


ROBOT = replace(load_robot("kuka_kr270"), link_elasticities=())
AT = make_linearization(ROBOT)
EVERY = all_signatures(AT)
#: Effects whose signatures depend on slides that have travelled, and on a tool that stands askew.
OF_SLIDES_AND_TOOLS = ("joint_offset", "link_geometry", "payload", "thermal_drift", "tool_frame")


@pytest.mark.parametrize("name", sorted({s.name for s in EVERY}))
def test_signature_agrees_with_the_exact_model_at_every_place(name: str) -> None:
    # one-sided models (compliances from zero, play) are compared where they are smooth
    tolerance = {"time_skew": 0.08, "tracking_lag": 0.15, "backlash": 0.02}.get(name, 0.02)
    for signature in (s for s in EVERY if s.name == name):
        if name in ("link_compliance", "base_compliance"):
            continue
        assert worst_disagreement(AT, signature) < tolerance, (signature.place, signature.form)


@pytest.fixture(scope="module")
def rail(tmp_path_factory: pytest.TempPathFactory) -> Linearization:
    return make_linearization(draw_robot_files(rail_arm(), tmp_path_factory.mktemp("rail")).robot)


def test_signatures_hold_on_a_rail_and_with_a_tool_that_stands_askew(rail: Linearization) -> None:
    for signature in (s for name in OF_SLIDES_AND_TOOLS for s in EFFECTS[name].signatures(rail)):
        assert worst_disagreement(rail, signature) < 0.02, (signature.place, signature.form)


def test_compliance_of_rigid_links_agrees_with_the_exact_model() -> None:
    for signature in (s for s in EVERY if s.name in ("link_compliance", "base_compliance")):
        value = np.array([0.05 * signature.scale[0]])
        after = solve_model_poses(apply_effects(AT.scene, [signature.effect(value)]))
        moved = (after.position - AT.attained.position) / value[0]
        assert np.abs(moved - signature.twist[:, :3, 0]).max() <= 0.02 * np.abs(moved).max() + 1e-3, signature.place


def test_every_effect_of_the_vocabulary_is_offered_somewhere() -> None:
    without_gravity = make_linearization(replace(ROBOT, gravity=None))
    offered = {s.name for s in [*EVERY, *all_signatures(without_gravity)]}
    assert offered == set(EFFECTS)


def test_behind_link_side_feedback_a_softer_drive_shows_nothing() -> None:
    mode = np.where(np.arange(120) % 2 == 0, "U2", "U1")
    scene = build_model(ROBOT, replace(make_campaign(ROBOT), mode=mode))
    at = linearize_model(scene, solve_model_poses(scene))
    held = at.campaign.link_controlled
    assert held.sum() == 60
    for signature in EFFECTS["joint_stiffness"].signatures(at):
        assert np.isfinite(signature.twist).all() and not signature.twist[held].any()
        assert signature.twist[~held].any()


def test_no_offset_of_a_sensor_is_offered_where_rows_read_exactly_nothing() -> None:
    campaign = make_campaign(ROBOT)
    for zeros, offered in ((2, True), (3, False)):
        wrench = campaign.wrench.copy()
        wrench[:zeros] = 0.0
        scene = build_model(ROBOT, replace(campaign, wrench=wrench))
        at = linearize_model(scene, solve_model_poses(scene))
        assert bool(list(EFFECTS["wrench_bias"].signatures(at))) == offered


@pytest.mark.parametrize(
    ("parameters", "factor", "constant"), [({"zero_m": 0.05}, 1.0, 0.05), ({"reversed": True}, -1.0, 0.0)]
)
def test_a_slide_whose_zero_is_moved_or_that_counts_backwards_carries_the_arm_along_its_axis(
    parameters: dict[str, object], factor: float, constant: float, rail: Linearization
) -> None:
    robot = replace(rail.robot, springs=(), link_elasticities=(), gravity=None)
    slide = next(joint for joint in robot.actuated if joint.kind == "prismatic")
    q = np.full((2, robot.nq), 0.3)
    q[:, robot.joint_names.index(slide.name)] = [0.2, -0.4]
    scene = build_model(robot, command_campaign(q, on_path=False))
    effect = Effect("joint_coupling", slide.name, None, parameters)
    moved = solve_model_poses(apply_effects(scene, [effect])).position - solve_model_poses(scene).position
    before = robot.joints[: robot.joints.index(slide) + 1]
    assert all(joint.kind == "fixed" for joint in before[:-1])
    along = np.linalg.multi_dot([np.eye(3), *(joint.placement[:3, :3] for joint in before)]) @ slide.axis
    travel = np.array([0.2, -0.4])
    assert moved == pytest.approx(np.outer((factor - 1.0) * travel + constant, along), abs=1e-12)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    """Two links of a metre each; the second joint follows the first."""
    (tmp_path / "robot.urdf").write_text(
        f"""<robot name="pair"><link name="a"/><link name="b"/><link name="c"/><link name="tool0"/>
        <joint name="one" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
        <joint name="two" type="revolute"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
        <limit lower="-6" upper="6" velocity="1" effort="1"/>
        <mimic joint="one" multiplier="{FOLLOWS}" offset="{ZERO}"/></joint>
        <joint name="tip" type="fixed"><parent link="c"/><child link="tool0"/><origin xyz="1 0 0"/></joint></robot>"""
    )
    (tmp_path / "elasticity.toml").write_text(
        f'schema = 1\ntcp = "tool0"\n[[spring]]\njoint = "one"\naxis = "own"\ncompliance = {COMPLIANCE}\n'
    )
    return read_robot_folder(tmp_path)


def tip(first: float, follower: float) -> np.ndarray:
    """Return the tip where the first joint and its follower stand at these angles."""
    return np.array([np.cos(first) + np.cos(first + follower), np.sin(first) + np.sin(first + follower), 0.0])


def test_a_follower_follows_the_true_position_of_an_offset_joint(robot: Robot) -> None:
    offset, q = 0.01, 0.4
    shifted = fold_effects(robot, [Effect("joint_offset", "one", None, {"offset_rad": offset})])
    attained = solve_model_poses(build_model(shifted, command_campaign(np.array([[q]]))))
    true = q + offset
    np.testing.assert_allclose(attained.position[0], tip(true, ZERO + FOLLOWS * true), atol=1e-12)


def test_a_follower_stays_where_its_driver_bends(robot: Robot) -> None:
    q, force = 0.4, np.array([[0.0, 50.0, 0.0, 0.0, 0.0, 0.0]])
    attained = solve_model_poses(build_model(robot, command_campaign(np.array([[q]]), force)))
    bent = float(attained.theta[0, 0])
    moment = force[0, 1] * attained.position[0, 0]
    assert bent == pytest.approx(COMPLIANCE * moment, rel=1e-6)
    np.testing.assert_allclose(attained.position[0], tip(q + bent, ZERO + FOLLOWS * q), atol=1e-12)


def test_the_signature_of_a_soft_joint_is_the_derivative_of_the_exact_model(robot: Robot) -> None:
    force = np.array([[30.0, 50.0, 0.0, 0.0, 0.0, 0.0]] * 3) * np.array([[1.0], [-0.5], [0.2]])
    scene = build_model(robot, command_campaign(np.array([[0.4], [0.9], [-0.7]]), force))
    attained = solve_model_poses(scene)
    (signature,) = signatures(linearize_model(scene, attained))
    step = 1e-9
    softer = apply_effects(scene, [Effect("joint_stiffness", "one", None, {signature.keys[0]: step})])
    slope = (solve_model_poses(softer).position - attained.position) / step
    np.testing.assert_allclose(signature.twist[:, :3, 0], slope, rtol=2e-3, atol=1e-3)
