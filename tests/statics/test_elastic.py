from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import beam_arm, one_joint_arm
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from compplan.errors import ConvergenceError
from compplan.robot import Array, load_robot
from compplan.robot.elasticity import hollow_beam_compliance
from compplan.statics.chain import Chain, build_chain, load_elements, locate_frames
from compplan.statics.elastic import (
    cartesian_compliance,
    load_hessian,
    loaded_compliance,
    solve_equilibrium,
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
            sides.append(load_elements(chain, frames, wrench)[:, chain.spring_elements])
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
