from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.robot import Array, load_robot
from compplan.statics.chain import (
    Chain,
    build_chain,
    jacobian,
    joint_jacobian,
    load_elements,
    locate_frames,
)
from compplan.statics.elastic import cartesian_compliance, loaded_compliance, solve_equilibrium
from compplan.statics.sweep import CHUNK

ROBOTS = ["kuka_kr270", "kuka_kr270_full", "staubli_tx200", "kuka_kr240_rail"]


def weighing_chain(name: str) -> Chain:
    return build_chain(replace(load_robot(name), gravity=np.array([0.3, 0.2, -9.81])))


def draw(chain: Chain, n: int, seed: int = 0) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(n, chain.n_springs)) * 1e-3
    return rng.uniform(-1.5, 1.5, (n, chain.nq)), theta, rng.normal(size=(n, 6)) * [400, 400, 400, 50, 50, 50]


@pytest.mark.parametrize("name", ROBOTS)
def test_the_jacobian_is_the_derivative_of_the_tcp_pose(name: str) -> None:
    chain = weighing_chain(name)
    q, theta, _ = draw(chain, 3)
    frames, step = locate_frames(chain, q, theta), 1e-6
    columns = jacobian(chain, frames)[:, :, chain.spring_elements]
    for j in range(chain.n_springs):
        move = np.zeros(chain.n_springs)
        move[j] = step
        ahead, behind = locate_frames(chain, q, theta + move), locate_frames(chain, q, theta - move)
        linear = (ahead.tcp_position - behind.tcp_position) / (2 * step)
        turned = ahead.tcp_rotation @ np.swapaxes(behind.tcp_rotation, 1, 2)
        turn = Rotation.from_matrix(turned).as_rotvec() / (2 * step)
        np.testing.assert_allclose(columns[:, :, j], np.hstack([linear, turn]), atol=1e-8)


def test_the_joint_jacobian_counts_mimic_joints_with_their_driver(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(
        """<robot name="pair"><link name="a"/><link name="b"/><link name="c"/><link name="tool0"/>
        <joint name="one" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
        <joint name="two" type="revolute"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
        <mimic joint="one" multiplier="-2" offset="0.3"/></joint>
        <joint name="tip" type="fixed"><parent link="c"/><child link="tool0"/><origin xyz="1 0 0"/></joint></robot>"""
    )
    (tmp_path / "elasticity.toml").write_text('schema = 1\ntcp = "tool0"\n')
    chain = build_chain(load_robot(tmp_path))
    q = np.array([[0.4]])
    tip = np.array([np.cos(0.4) + np.cos(0.3 - 0.4), np.sin(0.4) + np.sin(0.3 - 0.4), 0])
    frames = locate_frames(chain, q)
    np.testing.assert_allclose(frames.tcp_position[0], tip, atol=1e-15)
    expected = [-np.sin(0.4) + np.sin(0.3 - 0.4), np.cos(0.4) - np.cos(0.3 - 0.4), 0, 0, 0, -1]
    np.testing.assert_allclose(joint_jacobian(chain, frames)[0, :, 0], expected, atol=1e-15)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_load_of_the_weights_is_the_slope_of_their_energy(name: str) -> None:
    chain = weighing_chain(name)
    q, theta, _ = draw(chain, 2)

    def energy(coordinates: Array) -> Array:
        return -np.einsum("b,nbi,i->n", chain.mass, locate_frames(chain, q, coordinates).centre, chain.gravity)

    torque = load_elements(chain, locate_frames(chain, q, theta), np.zeros((1, 6)))[:, chain.spring_elements]
    for j in range(chain.n_springs):
        move = np.zeros(chain.n_springs)
        move[j] = 1e-5
        slope = (energy(theta + move) - energy(theta - move)) / 2e-5
        np.testing.assert_allclose(torque[:, j], -slope, atol=1e-4)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_wrench_loads_the_elements_by_the_transposed_jacobian(name: str) -> None:
    chain = build_chain(load_robot(name))
    q, theta, wrench = draw(chain, 5)
    frames = locate_frames(chain, q, theta)
    expected = np.einsum("nij,ni->nj", jacobian(chain, frames), wrench)
    np.testing.assert_allclose(load_elements(chain, frames, wrench), expected, atol=1e-9)


def test_parameters_that_differ_from_pose_to_pose_give_what_each_gives_alone() -> None:
    chain, rng, n = weighing_chain("staubli_tx200"), np.random.default_rng(3), CHUNK + 7
    q, _, wrench = draw(chain, n)
    m = len(chain.names)
    turns = Rotation.from_rotvec(rng.normal(size=(n * m, 3)) * 1e-3).as_matrix().reshape(n, m, 3, 3)
    axis = chain.axis + 1e-2 * rng.normal(size=(n, m, 3))
    changed = {
        "rotation": turns @ chain.rotation,
        "position": chain.position + 1e-3 * rng.normal(size=(n, m, 3)),
        "axis": axis / np.linalg.norm(axis, axis=-1, keepdims=True),
        "q_offset": chain.q_offset + 1e-3 * rng.normal(size=(n, m)),
        "mass": chain.mass * rng.uniform(0.5, 2, (n, 1)),
        "compliance": chain.compliance * rng.uniform(0.5, 2, (n, 1, 1)),
    }
    many = replace(chain, **changed)
    loaded, plain, exact = (
        solve_equilibrium(many, q, wrench), cartesian_compliance(many, q), loaded_compliance(many, q, wrench)
    )  # fmt: skip
    for row in (0, CHUNK - 1, CHUNK, n - 1):
        only = slice(row, row + 1)
        one = replace(chain, **{key: value[row] for key, value in changed.items()})
        alone = solve_equilibrium(one, q[only], wrench[row])
        np.testing.assert_allclose(loaded.position[row], alone.position[0], atol=1e-12)
        np.testing.assert_allclose(loaded.theta[row], alone.theta[0], atol=1e-12)
        np.testing.assert_allclose(plain[row], cartesian_compliance(one, q[only])[0], atol=1e-18)
        np.testing.assert_allclose(exact[row], loaded_compliance(one, q[only], wrench[only])[0], atol=1e-17)
