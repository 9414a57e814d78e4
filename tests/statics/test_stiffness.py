from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.robot import load_robot
from compplan.statics.chain import build_chain, jacobian, locate_frames
from compplan.statics.elastic import cartesian_compliance, solve_equilibrium
from compplan.statics.stiffness import (
    complementary_influence,
    complementary_stiffness,
    displace_linearly,
    worst_unit_force,
)

Q = np.radians([[10, 60, -140, 45, 45, 45], [0, 20, -200, 30, -60, 10]])
WRENCH = np.array([300.0, -500, -2354, 40, -20, 60])


def test_the_complementary_stiffness_of_one_joint_is_minus_force_times_lever(tmp_path: Path) -> None:
    chain = build_chain(one_joint_arm(tmp_path, length=1.3))
    pull, push = np.array([500.0, 0, 0, 0, 0, 0]), np.array([-500.0, 0, 0, 0, 0, 0])
    assert complementary_stiffness(chain, np.zeros((1, 1)), pull)[0, 0, 0] == pytest.approx(-650)
    assert complementary_stiffness(chain, np.zeros((1, 1)), push)[0, 0, 0] == pytest.approx(650)


def test_pulling_stiffens_an_arm_sideways_and_pushing_softens_it(tmp_path: Path) -> None:
    chain = build_chain(one_joint_arm(tmp_path, length=1.0, compliance=1e-4))
    loads = (np.array([f, 0, -1.0, 0, 0, 0]) for f in (2000.0, -2000.0))
    pulled, pushed = (displace_linearly(chain, np.zeros((1, 1)), load) for load in loads)
    assert pulled[0, 2] == pytest.approx(-1e-4 / 1.2)
    assert pushed[0, 2] == pytest.approx(-1e-4 / 0.8)


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


def test_nu_p_and_nu_r_vanish_without_load_and_grow_with_it() -> None:
    chain = build_chain(load_robot("kuka_kr240"))
    small, large = (complementary_influence(chain, Q, share * WRENCH) for share in (0.01, 1.0))
    assert (large.nu_p > 50 * small.nu_p).all() and (large.nu_p < 0.05).all()
    assert (large.nu_r > 1000 * small.nu_r).all()
    assert not complementary_influence(chain, Q, np.zeros(6)).nu_p.any()


def test_the_worst_unit_force_beats_every_random_one() -> None:
    compliance = cartesian_compliance(build_chain(load_robot("kuka_kr270_full")), Q)
    size, direction = worst_unit_force(compliance)
    forces = np.random.default_rng(0).normal(size=(500, 3))
    forces /= np.linalg.norm(forces, axis=1, keepdims=True)
    tried = np.linalg.norm(np.einsum("nij,kj->nki", compliance[:, :3, :3], forces), axis=-1).max(axis=1)
    assert (tried <= size).all() and (tried > 0.9 * size).all()
    reached = np.linalg.norm(np.einsum("nij,nj->ni", compliance[:, :3, :3], direction), axis=1)
    np.testing.assert_allclose(reached, size)
