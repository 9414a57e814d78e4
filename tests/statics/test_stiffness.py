from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.robot import load_robot
from compplan.statics.chain import build_chain, jacobian, locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.statics.quality import find_characteristic_length, inverse_condition, normalise_jacobian, quality_of_poses
from compplan.statics.stiffness import complementary_stiffness, displace_linearly

Q = np.radians([[10, 60, -140, 45, 45, 45], [0, 20, -200, 30, -60, 10]])
WRENCH = np.array([300.0, -500, -2354, 40, -20, 60])


def test_the_complementary_stiffness_of_one_joint_is_minus_force_times_lever(tmp_path: Path) -> None:
    chain = build_chain(one_joint_arm(tmp_path, length=1.3))
    pull, push = np.array([500.0, 0, 0, 0, 0, 0]), np.array([-500.0, 0, 0, 0, 0, 0])
    assert complementary_stiffness(chain, np.zeros((1, 1)), pull)[0, 0, 0] == pytest.approx(-650)
    assert complementary_stiffness(chain, np.zeros((1, 1)), push)[0, 0, 0] == pytest.approx(650)


def test_dumas_formula_gives_the_same_stiffness_as_the_general_one() -> None:
    chain = build_chain(load_robot("kuka_kr240"))
    J = jacobian(chain, locate_frames(chain, Q))[:, :, chain.spring_elements]
    K = np.linalg.inv(chain.compliance) - complementary_stiffness(chain, Q, WRENCH)
    K_X = np.linalg.inv(J).swapaxes(1, 2) @ K @ np.linalg.inv(J)
    np.testing.assert_allclose(np.linalg.solve(K_X, np.tile(WRENCH, (2, 1))[..., None])[..., 0],
                               displace_linearly(chain, Q, WRENCH), rtol=1e-9)  # fmt: skip


def test_k_c_makes_the_elastic_coordinates_right_to_second_order() -> None:
    chain = build_chain(load_robot("kuka_kr240"))
    columns = jacobian(chain, locate_frames(chain, Q))[:, :, chain.spring_elements]
    missed: dict[bool, list[float]] = {True: [], False: []}
    for share in (1.0, 0.5):
        load = np.tile(share * WRENCH, (2, 1))
        exact = solve_equilibrium(chain, Q, load).theta
        torque = np.einsum("nij,ni->nj", columns, load)
        for complementary, gaps in missed.items():
            stiffness = np.linalg.inv(chain.compliance) - complementary * complementary_stiffness(chain, Q, load)
            gaps.append(np.abs(exact - np.linalg.solve(stiffness, torque[..., None])[..., 0]).max())
    assert missed[True][0] < 0.05 * missed[False][0]
    assert missed[False][0] / missed[False][1] == pytest.approx(4, rel=0.1)
    assert missed[True][0] / missed[True][1] == pytest.approx(8, rel=0.1)


def test_an_isotropic_jacobian_has_quality_one_and_a_singular_one_zero() -> None:
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))[0]
    assert inverse_condition(3.7 * turned) == pytest.approx(1)
    turned[:, 2] = turned[:, 4]
    assert inverse_condition(turned) == pytest.approx(0, abs=1e-12)


def test_the_inverse_condition_number_is_dumas_formula() -> None:
    J = np.random.default_rng(1).normal(size=(5, 6, 6))
    gram = J @ np.swapaxes(J, 1, 2)
    kappa = np.sqrt(np.trace(gram, axis1=1, axis2=2) * np.trace(np.linalg.inv(gram), axis1=1, axis2=2)) / 6
    np.testing.assert_allclose(inverse_condition(J), 1 / kappa)


def test_the_quality_does_not_depend_on_the_unit_of_length_once_normalised() -> None:
    J = np.random.default_rng(2).normal(size=(3, 6, 6))
    in_millimetres = J * np.array([1e3] * 3 + [1.0] * 3)[:, None]
    np.testing.assert_allclose(normalise_jacobian(J, 0.8), normalise_jacobian(in_millimetres, 800.0))


def test_the_characteristic_length_is_the_best_there_is() -> None:
    chain = build_chain(load_robot("kuka_kr240"))
    q = np.random.default_rng(3).uniform(-1, 1, (200, 6))
    length = find_characteristic_length(chain, q)
    best = quality_of_poses(chain, q, length).max()
    assert all(quality_of_poses(chain, q, factor * length).max() < best for factor in (0.8, 0.95, 1.05, 1.25))
