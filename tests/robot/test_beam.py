from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.robot.elasticity import hollow_beam_compliance

L, D, d, E, G = 1.15, 0.35, 0.30, 70e9, 26.3e9
AREA = math.pi / 4 * (D**2 - d**2)
INERTIA = math.pi / 64 * (D**4 - d**4)


def test_a_cantilever_bends_as_the_textbook_says() -> None:
    compliance = hollow_beam_compliance(L, D, d, E, G)
    for force, rotation, sign in ((0, 4, 1), (1, 3, -1)):  # fx turns about y, fy about -x
        assert compliance[force, force] == pytest.approx(L**3 / (3 * E * INERTIA))
        assert compliance[rotation, force] == pytest.approx(sign * L**2 / (2 * E * INERTIA))
        assert compliance[rotation, rotation] == pytest.approx(L / (E * INERTIA))
    assert compliance[2, 2] == pytest.approx(L / (E * AREA))
    assert compliance[5, 5] == pytest.approx(L / (G * 2 * INERTIA))


@pytest.mark.parametrize("axis", ["x", "y", "z", "-x", "-y", "-z"])
def test_the_compliance_turns_with_the_axis_of_the_beam(axis: str) -> None:
    direction = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
    turn = Rotation.align_vectors([direction], [[0, 0, 1]])[0].as_matrix()
    both = np.kron(np.eye(2), turn)
    expected = both @ hollow_beam_compliance(L, D, d, E, G) @ both.T
    np.testing.assert_allclose(hollow_beam_compliance(L, D, d, E, G, axis), expected, atol=1e-18)


def test_the_compliance_is_symmetric_and_positive_definite() -> None:
    compliance = hollow_beam_compliance(L, D, 0.0, E, G, "x")
    assert np.array_equal(compliance, compliance.T)
    assert np.linalg.eigvalsh(compliance).min() > 0


@pytest.mark.parametrize("change", [{"length": 0.0}, {"inner_diameter": D}, {"young": -1.0}, {"axis": "w"}])
def test_an_impossible_beam_is_refused(change: dict[str, object]) -> None:
    arguments = {"length": L, "outer_diameter": D, "inner_diameter": d, "young": E, "shear": G, "axis": "z"} | change
    with pytest.raises(ValueError, match="beam"):
        hollow_beam_compliance(**arguments)  # type: ignore[arg-type]
