"""Factors and inverses are those of the matrices, and a matrix that rounding broke is mended."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.diagnosis.evidence.likelihood import (
    factorize,
    invert_factor,
    invert_triangle,
    mirror_lower,
    multiply_triangle,
    solve_factor,
)
from compplan.errors import ConvergenceError


@pytest.mark.parametrize("size", [0, 1, 65, 211])
def test_triangle_and_inverse_undo_the_matrix(size: int) -> None:
    columns = np.random.default_rng(size).normal(size=(2 * size + 1, size))
    matrix, right = columns.T @ columns, np.arange(size, dtype=float)
    lower = factorize(matrix)
    assert np.allclose(lower @ lower.T, matrix, rtol=1e-12, atol=1e-10)
    assert not np.triu(lower, 1).any()
    assert np.allclose(invert_triangle(lower) @ lower, np.eye(size), atol=1e-10)
    assert not np.triu(invert_triangle(lower), 1).any()
    assert np.allclose(mirror_lower(invert_factor(lower)) @ matrix, np.eye(size), atol=1e-8)
    assert np.allclose(multiply_triangle(lower, columns.T), lower @ columns.T, rtol=1e-12)
    assert np.allclose(matrix @ solve_factor(lower, right), right, atol=1e-8)


def test_a_matrix_that_rounding_made_indefinite_is_mended_and_a_wrong_one_refused() -> None:
    broken = np.diag([1.0, 1.0, -1e-12])
    lower = factorize(broken)
    assert lower @ lower.T == pytest.approx(broken, abs=1e-8)
    assert broken[2, 2] == -1e-12
    with pytest.raises(ConvergenceError, match="degenerate"):
        factorize(-np.eye(3))
