"""Cholesky: factors and inverses of covariances, which the evidence asks for thousands of times."""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dlauum, dpotrf, dpotrs, dtrtri

from compplan.errors import ConvergenceError
from compplan.robot import Array


def factorize(matrix: Array) -> Array:
    """Return the lower factor of a symmetric matrix that rounding may have made slightly indefinite. Shape (p, p)."""
    tried, jitter = matrix, float(np.finfo(float).eps)
    while jitter < 1.0:
        lower, failed = dpotrf(tried.T, lower=1, clean=1)
        if not failed:
            return np.asarray(lower)
        # a rounding of all entries first, then a hundred times as much each time
        jitter *= 100.0
        tried = matrix + jitter * float(np.trace(matrix)) * np.eye(len(matrix))
    raise ConvergenceError("the evidence of a model cannot be computed, its columns are degenerate", residual=jitter)


def solve_factor(lower: Array, right: Array) -> Array:
    """Return (L L^T)^-1 b. Shape of b: (p,) or (p, k)."""
    return np.asarray(dpotrs(lower, right, lower=1)[0]) if len(lower) else right


def invert_triangle(lower: Array) -> Array:
    """Return L^-1, zeros above its diagonal included. Shape (p, p)."""
    return np.asarray(dtrtri(lower, lower=1)[0]) if len(lower) else lower


def multiply_triangle(lower: Array, right: Array) -> Array:
    """Return L B, which takes half as long as a product of full matrices. Shape (p, p), (p, k) -> (p, k)."""
    return np.asarray(dtrmm(1.0, lower, right, lower=1)) if right.size else right


def invert_factor(lower: Array) -> Array:
    """Return the lower triangle of (L L^T)^-1, zeros above. Shape (p, p)."""
    return np.asarray(dlauum(invert_triangle(lower), lower=1, overwrite_c=1)[0]) if len(lower) else lower


def mirror_lower(triangle: Array) -> Array:
    """Return the symmetric matrix with a lower triangle above which there are zeros. Shape (p, p)."""
    full = triangle + triangle.T
    full[np.diag_indices_from(full)] *= 0.5
    return np.asarray(full)
