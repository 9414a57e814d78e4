"""Statics against MuJoCo and Pinocchio: order and place of springs, elastic links, encoders, inverse kinematics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from drawn_campaigns import Drawn, draw_robot_files, rail_arm, turned_arm
from effect_cases import own_sense
from robot_library import over_robots

from benchmarks.campaigns.description import Array, RobotDescription, Segment, Spring
from benchmarks.campaigns.simulate import Rows, Scenario, nominal_scenario, simulate_rows
from compplan.robot import load_robot
from compplan.robot.model import LinkElasticity
from compplan.statics.chain import build_chain
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.encoders import control_equilibrium
from compplan.statics.ik import build_arm, solve_branches

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")


@pytest.fixture(scope="module", params=[turned_arm, rail_arm], ids=["turned", "rail"])
def drawn(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    return draw_robot_files(request.param(), tmp_path_factory.mktemp("drawn"))


def first(rows: Rows, n: int) -> Rows:
    return Rows(rows.run[:n], rows.is_path[:n], rows.time[:n], rows.q[:n], rows.wrench[:n], rows.rise[:n])


def test_springs_of_one_joint_act_in_the_order_listed_and_where_their_offset_puts_them(tmp_path: Path) -> None:
    soft = (  # so soft that another order, or another centre, is millimetres away
        Spring("joint_2", "own", 1e-5, actuator=True),
        Spring("joint_2", "rx", 2e-5, offset=(0.3, -0.2, 0.4)),
        Spring("joint_2", "tz", 2e-5, offset=(0.1, 0.1, 0.0)),
        Spring("joint_2", "rz", 3e-5),
    )
    places = []
    for order in (soft, (soft[3], soft[1], soft[0], soft[2]), tuple(replace(s, offset=(0.0, 0.0, 0.0)) for s in soft)):
        robot = draw_robot_files(replace(turned_arm(), springs=order), tmp_path)
        rows = first(robot.rows, 12)
        truth = simulate_rows(robot.nominal, rows)
        loaded = solve_equilibrium(build_chain(robot.robot), rows.q, rows.wrench)
        np.testing.assert_allclose(loaded.position, truth.position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(loaded.rotation, truth.rotation, rtol=0, atol=1e-9)
        places.append(truth.position)
    assert min(np.abs(places[0] - other).max() for other in places[1:]) > 1e-3


def with_elastic_link(robot: RobotDescription, joint: str, compliance: Array) -> Scenario:
    """Put six coupled springs between a joint's origin and the joint: the far end of the link before it."""
    index = robot.index_of(joint)
    origin = robot.segments[index]
    end = Segment("far_end", "fixed", "far_end", origin.xyz, origin.rpy)
    moved = robot.with_segment(index, xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0))
    moved = replace(moved, segments=(*moved.segments[:index], end, *moved.segments[index:]))
    scenario = nominal_scenario(moved)
    count = len(scenario.springs)
    for k, axis in enumerate(AXES):
        scenario = scenario.add_spring(Spring("far_end", axis, float(compliance[k, k])))
    pairs = [(i, j) for i in range(6) for j in range(6) if i != j]
    couplings = tuple((count + i, count + j, float(compliance[i, j])) for i, j in pairs)
    return replace(scenario, couplings=couplings)


def test_an_elastic_link_bends_at_its_far_end_in_the_axes_of_the_next_joint(drawn: Drawn) -> None:
    random = np.random.default_rng(3)
    size = np.diag([2e-4, 2e-4, 2e-4, 6e-4, 6e-4, 6e-4])
    half = size @ random.normal(size=(6, 6))
    compliance = half @ half.T + size**2
    link = "link_2"
    robot = replace(drawn.robot, link_elasticities=(LinkElasticity(link, compliance),))
    rows = first(drawn.rows, 20)
    truth = simulate_rows(with_elastic_link(drawn.description, "joint_3", compliance), rows)
    loaded = solve_equilibrium(build_chain(robot), rows.q, rows.wrench)
    plain = solve_equilibrium(build_chain(drawn.robot), rows.q, rows.wrench)
    assert np.abs(plain.position - truth.position).max() > 1e-3
    np.testing.assert_allclose(loaded.position, truth.position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(loaded.rotation, truth.rotation, rtol=0, atol=1e-8)


def test_a_wrench_turns_the_arm_about_each_spring_from_where_the_loaded_tcp_is(tmp_path: Path) -> None:
    # one spring about z at the base: theta = c (p x f + m)_z at the loaded p, worked out by hand
    robot = draw_robot_files(replace(turned_arm(), gravity=None, springs=(Spring("joint_1", "own", 1e-5),)), tmp_path)
    chain, q = build_chain(robot.robot), robot.rows.q[:4]
    wrench = np.array([900.0, -700.0, 400.0, 50.0, -30.0, 600.0])
    p = solve_equilibrium(chain, q, wrench).position
    loaded = solve_equilibrium(chain, q, wrench)
    about_z = p[:, 0] * wrench[1] - p[:, 1] * wrench[0] + wrench[5]
    np.testing.assert_allclose(loaded.theta[:, 0], -1e-5 * about_z, rtol=1e-9)  # joint 1 counts about -z


def test_the_cartesian_compliance_is_the_slope_of_mujocos_deflection(drawn: Drawn) -> None:
    # without weights, at no load: C = J c J^T, force before moment, metres before radians
    weightless = replace(drawn.description, gravity=None)
    robot, rows = replace(drawn.robot, gravity=None), first(drawn.rows, 5)
    compliance = cartesian_compliance(build_chain(robot), rows.q)
    for k, step in enumerate([10.0] * 3 + [5.0] * 3):
        sides = []
        for sign in (1.0, -1.0):
            wrench = np.tile(sign * step * np.eye(6)[k], (5, 1))
            sides.append(simulate_rows(nominal_scenario(weightless), replace(rows, wrench=wrench)))
        linear = (sides[0].position - sides[1].position) / (2 * step)
        turned = sides[0].rotation @ np.swapaxes(sides[1].rotation, 1, 2)
        turn = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1) / (2 * step)
        np.testing.assert_allclose(compliance[:, :3, k], linear, rtol=0, atol=1e-10)
        np.testing.assert_allclose(compliance[:, 3:, k], turn, rtol=0, atol=1e-10)


def test_encoders_read_both_sides_of_mujocos_gears(drawn: Drawn) -> None:
    gears = tuple(replace(spring, link_share=0.0) for spring in drawn.robot.springs)
    chain, rows = build_chain(replace(drawn.robot, springs=gears)), drawn.rows
    truth = simulate_rows(drawn.nominal, rows)
    held = np.array([spring.actuator for spring in drawn.description.springs])
    locked = replace(drawn.nominal, compliance=np.where(held, 0.0, drawn.nominal.compliance))
    by_motor = control_equilibrium(chain, rows.q, rows.wrench)
    by_link = control_equilibrium(chain, rows.q, rows.wrench, feedback="link")
    np.testing.assert_allclose(by_motor.link, truth.link, rtol=0, atol=1e-10)
    assert np.abs(by_motor.link - rows.q).max() > 1e-4
    stiff = simulate_rows(locked, rows)
    np.testing.assert_allclose(by_link.loaded.position, stiff.position, rtol=0, atol=1e-10)
    for k in np.flatnonzero(held):  # link minus motor: what the gear yields, c tau, about the joint's axis
        spring = drawn.description.springs[k]
        yielded = own_sense(drawn.description, spring.joint) * spring.compliance * stiff.load[:, k]
        difference = by_link.difference[:, drawn.description.joint_names.index(spring.joint)]
        np.testing.assert_allclose(difference, yielded, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", over_robots(redundant=False))
def test_every_branch_stands_at_the_pose_by_pinocchios_own_reading_of_the_urdf(name: str) -> None:
    robot = load_robot(name)
    assert robot.folder is not None
    model = pin.buildModelFromUrdf(str(robot.folder / "robot.urdf"))
    if model.nq != robot.nq:
        pytest.skip("Pinocchio knows no mimic joints")
    data, frame = model.createData(), model.getFrameId(robot.tcp)
    base = model.getFrameId(robot.base)

    def stand(q: Array) -> pin.SE3:
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[base].inverse() * data.oMf[frame]

    random = np.random.default_rng(4)
    q = random.uniform(np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5), (6, robot.nq))
    poses = [stand(row).copy() for row in q]
    arm = build_arm(robot)
    position, rotation = np.array([p.translation for p in poses]), np.array([p.rotation for p in poses])
    slots = solve_branches(arm, position, rotation, q[:, arm.held])
    found = 0
    for pose, branches in zip(poses, slots, strict=True):
        for branch in branches[np.isfinite(branches).all(axis=1)]:
            there = stand(branch)
            np.testing.assert_allclose(there.translation, pose.translation, rtol=0, atol=1e-8)
            np.testing.assert_allclose(there.rotation, pose.rotation, rtol=0, atol=1e-8)
            found += 1
    assert found >= 6
