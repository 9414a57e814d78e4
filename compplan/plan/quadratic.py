"""One step of the program of time and posture: a sparse quadratic program, solved by PIQP where CasADi has it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from compplan.robot import Array

#: Solvers of CasADi that are taken, the first that there is.
SOLVERS = ("piqp", "proxqp", "osqp", "qrqp")
OPTIONS: dict[str, dict[str, Any]] = {
    "osqp": {"osqp": {"verbose": False, "eps_abs": 1e-5, "eps_rel": 1e-5}}, "qrqp": {"print_iter": False},
}  # fmt: skip
#: Weight that keeps steps of the coefficients small where nothing else does, and least bend of the time.
STILL, LEAST_BEND = 1e-5, 1e-9
#: Derivatives below this share of the greatest are none: splines fade away from their knot.
FADED = 1e-5


@dataclass(frozen=True)
class StepVariables:
    """Numbers of coefficients c, squares of speed x, rapid times r, travels t; then the band b."""

    c: int
    x: int
    r: int
    t: int

    def first(self, name: str) -> int:
        """Return the first place of a kind of variable."""
        sizes = {"c": self.c, "x": self.x, "r": self.r, "t": self.t, "b": 1}
        names = list(sizes)
        return sum(sizes[other] for other in names[: names.index(name)])

    @property
    def size(self) -> int:
        """Count all variables."""
        return self.first("b") + 1


@dataclass
class StepRows:
    """Rows a . variables <= bound, added one group at a time."""

    variables: StepVariables
    parts: list[sparse.csr_matrix] = field(default_factory=list)
    bounds: list[Array] = field(default_factory=list)

    def add(
        self, bound: Array, *, c: Array | None = None, x: tuple[tuple[NDArray[np.int_], Array], ...] = (),
        r: tuple[NDArray[np.int_], float] | None = None, t: tuple[NDArray[np.int_], float] | None = None,
        b: float = 0.0,
    ) -> None:  # fmt: skip
        """Add k rows.

        Args:
            bound: Right-hand sides. Shape (k,).
            c: Factors of the coefficients. Shape (k, c).
            x: Places and factors of squares of speed, shapes (k,), several of them.
            r: Places and factor of rapid times.
            t: Places and factor of travels.
            b: Factor of the band.

        """
        count = len(bound)
        if not count:
            return
        every, size = np.arange(count), self.variables.size
        rows, places, values = [], [], []
        if c is not None:
            k, at = np.nonzero(np.abs(c) > FADED * np.abs(c).max(initial=1e-300))
            rows, places, values = [k], [at], [c[k, at]]
        sides = [("x", *part) for part in x] + [(name, *part) for name, part in (("r", r), ("t", t)) if part]
        for name, at, factor in sides:
            rows.append(every)
            places.append(self.variables.first(name) + at)
            values.append(np.broadcast_to(factor, (count,)))
        if b:
            rows.append(every)
            places.append(np.full(count, size - 1))
            values.append(np.full(count, b))
        index = np.concatenate(rows), np.concatenate(places)
        self.parts.append(sparse.csr_matrix((np.concatenate(values), index), shape=(count, size)))
        self.bounds.append(bound)


def solve_quadratic(
    rows: StepRows, *, slope: Array, pull: Array, fixed: NDArray[np.bool_], bend: list[Array], rapid: float,
    travel: float, band: float, square: Array, ends: NDArray[np.int_], size: float,
) -> Array | None:  # fmt: skip
    """Solve a step; all variables are changes but the travels.

    Args:
        rows: The rows.
        slope: Derivative of the cost by the squares of speed. Shape (x,).
        pull: The same by the coefficients. Shape (c,).
        fixed: Coefficients that stay. Shape (c,).
        bend: Second derivative, diagonal and beside it. Shapes (x,).
        rapid: Cost of a second of rapid moves.
        travel: Cost of a unit of travel.
        band: Cost of the band.
        square: Squares of speed now, between 0 and 1. Shape (x,).
        ends: Those that stay. Shape (e,).
        size: Greatest change of a coefficient.

    Returns:
        The change of the coefficients, None where the solver finds none. Shape (c,).

    """
    v = rows.variables
    gradient = np.r_[pull, slope, np.full(v.r, rapid), np.full(v.t, travel), band]
    diagonal = np.r_[np.full(v.c, STILL), bend[0] + LEAST_BEND, np.zeros(v.r + v.t), 1e-6]
    beside = np.r_[np.zeros(v.c), bend[1], np.zeros(v.r + v.t + 1)][:-1]
    hessian = sparse.diags([beside, diagonal, beside], [-1, 0, 1]).tocsc()
    matrix = sparse.vstack(rows.parts).tocsc()
    low, high = -square, 1.0 - square
    low[ends] = high[ends] = 0.0
    high = np.maximum(high, 0.0)
    reach = np.where(fixed, 0.0, size)
    lower = np.r_[-reach, low, np.full(v.r, -np.inf), np.zeros(v.t), -np.inf]
    upper = np.r_[reach, high, np.full(v.r + v.t + 1, np.inf)]
    found = solve_conic(hessian, gradient, matrix, np.concatenate(rows.bounds), lower, upper)[: v.c]
    return np.clip(found, -reach, reach) if np.isfinite(found).all() else None


def solve_conic(
    hessian: sparse.csc_matrix, gradient: Array, matrix: sparse.csc_matrix, most: Array, lower: Array, upper: Array
) -> Array:
    """Return x of least x'Hx / 2 + g'x with A x <= most and lower <= x <= upper; not finite where none is found."""
    matrices = {"h": hessian, "a": matrix}
    shapes = {name: _pattern(value) for name, value in matrices.items()}
    name = next(solver for solver in SOLVERS if ca.has_conic(solver))
    solver = ca.conic("step", name, shapes, {"error_on_fail": False, **OPTIONS.get(name, {})})
    answer = solver(
        h=ca.DM(shapes["h"], hessian.data), a=ca.DM(shapes["a"], matrix.data), g=gradient, lbx=lower, ubx=upper,
        lba=-np.inf, uba=most,
    )  # fmt: skip
    return np.array(answer["x"])[:, 0]


def _pattern(matrix: sparse.csc_matrix) -> ca.Sparsity:
    matrix.sort_indices()
    return ca.Sparsity(matrix.shape[0], matrix.shape[1], matrix.indptr.tolist(), matrix.indices.tolist())
