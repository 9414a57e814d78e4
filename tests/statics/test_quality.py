from __future__ import annotations

import numpy as np
import pytest

from compplan.robot import load_robot
from compplan.statics.chain import build_chain
from compplan.statics.quality import (
    find_characteristic_length,
    inverse_condition,
    normalise_jacobian,
    quality_of_poses,
)


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
