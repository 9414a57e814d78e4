"""The pose equations of waypoints: by how much joint positions miss them, exactly, and their derivative."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compplan.planning.path_problem import PathProblem
from compplan.robot import Array
from compplan.statics.sensitivity import AttainedPose


def pose_equations(problem: PathProblem, attained: AttainedPose, rows: NDArray[np.int_]) -> Array:
    """Tell by how much some waypoints miss the pose equations: tip, tool axis (and spin).

    Args:
        problem: What the path has to fulfil.
        attained: What stands there: the loaded tool, or the unloaded one in rapid moves; k poses.
        rows: The waypoints. Shape (k,).

    Returns:
        Shape (k, 5), or (k, 6) where the spin is not free; two fewer for an arm of four joints. [m, rad]
    """
    missed = [attained.position - problem.position[rows]]
    missed += [np.einsum("ni,ni->n", a, b)[:, None] for a, b in _crossings(problem, attained, rows)]
    return np.hstack(missed)


def differentiate_equations(problem: PathProblem, attained: AttainedPose, rows: NDArray[np.int_]) -> Array:
    """Differentiate the pose equations with respect to the commanded joints. Shape (k, equations, nq)."""
    turns = [
        np.einsum("ni,nij->nj", np.cross(b, a), attained.jacobian[:, 3:])[:, None]
        for a, b in _crossings(problem, attained, rows)
    ]
    return np.concatenate([attained.jacobian[:, :3], *turns], axis=1)


def _crossings(problem: PathProblem, attained: AttainedPose, rows: NDArray[np.int_]) -> list[tuple[Array, Array]]:
    """Pair the directions that have to stand across each other: wanted with attained. Shapes (k, 3)."""
    x, y = problem.rotation[rows, :, 0], problem.rotation[rows, :, 1]
    pairs = [] if problem.axis_free else [(x, attained.rotation[:, :, 2]), (y, attained.rotation[:, :, 2])]
    return pairs if problem.spin_free else [*pairs, (y, attained.rotation[:, :, 0])]
