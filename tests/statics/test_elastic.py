from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import beam_arm, one_joint_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from compplan.errors import ConvergenceError
from compplan.robot import Array, load_robot
from compplan.robot.beam import hollow_beam_compliance
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.statics.chain import Chain, build_chain, locate_frames
from compplan.statics.elastic import (
    cartesian_compliance,
    load_hessian,
    loaded_compliance,
    solve_equilibrium,
    spring_torque,
)

ROBOTS = ["kuka_kr270", "kuka_kr270_full", "staubli_tx200", "fanuc_m10ia", "kuka_kr240_rail"]


def draw(chain: Chain, n: int, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (n, chain.nq)), rng.normal(size=(n, 6)) * [400, 400, 400, 50, 50, 50]


@pytest.mark.parametrize("force", [10.0, 1000.0, 30000.0])
def test_a_one_joint_arm_follows_its_transcendental_equation(tmp_path: Path, force: float) -> None:
    length, compliance = 1.3, 1e-5
    chain = build_chain(one_joint_arm(tmp_path, length, compliance))
    angle = brentq(lambda a: a - compliance * length * force * np.cos(a), 0, 2)  # a force downwards turns it about +y
    loaded = solve_equilibrium(chain, np.zeros((1, 1)), np.array([0, 0, -force, 0, 0, 0.0]))
    assert loaded.theta[0, 0] == pytest.approx(angle, abs=1e-12)
    np.testing.assert_allclose(loaded.position[0], [length * np.cos(angle), 0, -length * np.sin(angle)], atol=1e-12)


def test_an_arm_bends_under_its_own_weight(tmp_path: Path) -> None:
    chain = build_chain(one_joint_arm(tmp_path, 1.0, 1e-5, mass=200.0, gravity=True))
    angle = brentq(lambda a: a - 1e-5 * 200 * 9.81 * np.cos(a), 0, 1)
    assert solve_equilibrium(chain, np.zeros((1, 1))).theta[0, 0] == pytest.approx(angle, abs=1e-12)
    assert not solve_equilibrium(build_chain(one_joint_arm(tmp_path, mass=200.0)), np.zeros((1, 1))).theta.any()


def test_a_balancing_torque_on_a_joint_adds_to_its_load(tmp_path: Path) -> None:
    chain = build_chain(one_joint_arm(tmp_path, 1.0, 1e-5, mass=200.0, gravity=True))
    balance = -0.8 * 200 * 9.81
    angle = brentq(lambda a: a - 1e-5 * (200 * 9.81 * np.cos(a) + balance), 0, 1)
    loaded = solve_equilibrium(chain, np.zeros((1, 1)), torque_bias=np.array([[balance]]))
    assert loaded.theta[0, 0] == pytest.approx(angle, abs=1e-12)


def test_a_compressed_arm_yields_by_the_buckling_formula_and_beyond_it_nothing_settles(tmp_path: Path) -> None:
    chain, side = build_chain(one_joint_arm(tmp_path, 1.0, 1e-5)), 1.0
    critical = 1 / 1e-5
    for share in (0.1, 0.5):
        load = np.array([[-share * critical, 0, -side, 0, 0, 0.0]])
        yielding = loaded_compliance(chain, np.zeros((1, 1)), load)[0, 2, 2]
        assert yielding == pytest.approx(1e-5 / (1 - share), rel=1e-4)
    with pytest.raises(ConvergenceError, match="buckling"):
        solve_equilibrium(chain, np.zeros((1, 1)), np.array([-300 * critical, 0, -side, 0, 0, 0]))


def test_an_elastic_link_bends_as_the_cantilever_does(tmp_path: Path) -> None:
    chain = build_chain(beam_arm(tmp_path, 1))
    expected = hollow_beam_compliance(2.0, 0.2, 0.16, 70e9, 26e9, "x")
    np.testing.assert_allclose(cartesian_compliance(chain, np.zeros((1, 1)))[0], expected, atol=1e-15)


@pytest.mark.parametrize("pieces", [2, 5])
def test_a_tube_cut_into_pieces_bends_like_the_whole(tmp_path: Path, pieces: int) -> None:
    whole = hollow_beam_compliance(2.0, 0.2, 0.16, 70e9, 26e9, "x")
    cut = cartesian_compliance(build_chain(beam_arm(tmp_path, pieces)), np.zeros((1, 1)))[0]
    np.testing.assert_allclose(cut, whole, atol=1e-15)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_equilibrium_agrees_with_the_judge(name: str) -> None:
    robot = replace(load_robot(name), gravity=np.array([0.0, 0.0, -9.81]))
    q, wrench = draw(build_chain(robot), 4)
    position, rotation, theta = solve_exact_pose(build_exact_robot(robot), q, wrench)
    loaded = solve_equilibrium(build_chain(robot), q, wrench)
    np.testing.assert_allclose(loaded.position, position, atol=1e-11)
    np.testing.assert_allclose(loaded.rotation, rotation, atol=1e-11)
    np.testing.assert_allclose(loaded.theta, theta, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_hessian_of_the_load_is_its_derivative(name: str) -> None:
    chain = build_chain(replace(load_robot(name), gravity=np.array([0.3, 0.0, -9.81])))
    q, wrench = draw(chain, 3)
    theta = np.random.default_rng(1).normal(size=(3, chain.n_springs)) * 1e-3
    exact = load_hessian(chain, q, theta, wrench)
    for j in range(chain.n_springs):
        sides = []
        for sign in (1, -1):
            moved = theta.copy()
            moved[:, j] += sign * 1e-5
            frames = locate_frames(chain, q, moved)
            sides.append(spring_torque(chain, frames, wrench)[:, chain.spring_elements])
        np.testing.assert_allclose(exact[:, :, j], (sides[0] - sides[1]) / 2e-5, atol=1e-3)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_loaded_compliance_is_the_derivative_of_the_equilibrium(name: str) -> None:
    chain = build_chain(replace(load_robot(name), gravity=np.array([0.0, 0.0, -9.81])))
    q, wrench = draw(chain, 3)
    compliance = loaded_compliance(chain, q, wrench)
    for j, step in enumerate([1.0] * 3 + [0.5] * 3):
        move = np.zeros(6)
        move[j] = step
        ahead, behind = solve_equilibrium(chain, q, wrench + move), solve_equilibrium(chain, q, wrench - move)
        linear = (ahead.position - behind.position) / (2 * step)
        turn = Rotation.from_matrix(ahead.rotation @ np.swapaxes(behind.rotation, 1, 2)).as_rotvec() / (2 * step)
        np.testing.assert_allclose(compliance[:, :, j], np.hstack([linear, turn]), atol=2e-12)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_turning_base_path_and_wrench_together_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = replace(load_robot("kuka_kr270_full"), gravity=np.array([0.0, 0.0, -9.81]))
    turn, shift = Rotation.random(random_state=seed % 2**31).as_matrix(), rng.normal(size=3)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, shift
    first = replace(robot.joints[0], placement=pose @ robot.joints[0].placement)
    assert robot.gravity is not None
    moved = replace(robot, joints=(first, *robot.joints[1:]), gravity=turn @ robot.gravity)
    chain, other = build_chain(robot), build_chain(moved)
    q, wrench = draw(chain, 3, seed)
    turned = np.hstack([wrench[:, :3] @ turn.T, wrench[:, 3:] @ turn.T])
    a, b = solve_equilibrium(chain, q, wrench), solve_equilibrium(other, q, turned)
    np.testing.assert_allclose(b.position, a.position @ turn.T + shift, atol=1e-12)
    np.testing.assert_allclose(b.rotation, turn @ a.rotation, atol=1e-12)
    np.testing.assert_allclose(b.theta, a.theta, atol=1e-12)


def test_the_first_order_deflection_misses_by_the_square_of_the_force() -> None:
    chain = build_chain(load_robot("staubli_tx200"))
    q, wrench = draw(chain, 20)
    start, compliance = locate_frames(chain, q).tcp_position, cartesian_compliance(chain, q)
    missed = []
    for share in (1.0, 0.5, 0.25, 0.125):
        linear = start + np.einsum("nij,nj->ni", compliance, share * wrench)[:, :3]
        missed.append(np.linalg.norm(solve_equilibrium(chain, q, share * wrench).position - linear, axis=1).max())
    rates = np.log2(np.array(missed[:-1]) / missed[1:])
    np.testing.assert_allclose(rates, 2.0, atol=0.1)


def test_a_rigid_robot_stands_where_its_joints_put_it() -> None:
    chain = build_chain(load_robot("ur10"))
    q, wrench = draw(chain, 3)
    np.testing.assert_array_equal(solve_equilibrium(chain, q, wrench).position, locate_frames(chain, q).tcp_position)
    assert not cartesian_compliance(chain, q).any()
