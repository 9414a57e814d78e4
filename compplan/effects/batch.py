"""Equilibrium of many models of the same rows at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compplan.effects.forward_model import (
    ForwardModel,
    Load,
    compute_model_loads,
    own_springs,
    see_target,
    solve_model_poses,
)
from compplan.robot import Array, Robot
from compplan.statics.chain import Frames, build_chain, stack_chains
from compplan.statics.elastic import solve_equilibrium

#: Poses solved at once: a compromise between call overhead and cache size.
MOST_POSES = 2000


def attain_positions(models: Sequence[ForwardModel], *, tolerance: float, theta: Array) -> list[Array]:
    """Return the observed positions of the targets of models; see `solve_model_poses`. Shapes (n, 3). [m]

    Args:
        models: The models; n rows each.
        tolerance: Tolerance of the elastic coordinates. [rad or m]
        theta: Initial elastic coordinates of models with as many springs. Shape (n, s). [rad or m]

    Raises:
        ConvergenceError: If a robot buckles under the load.
    """
    positions: dict[int, Array] = {}
    loads: dict[int, Load] = {}
    robot: Robot | None = None
    alike: dict[bytes, list[int]] = {}
    for k, model in enumerate(models):
        if model.laws or model.payload.any():
            positions[k] = solve_model_poses(model, tolerance=tolerance, theta=theta).position
        else:
            if model.robot is not robot:
                robot = model.robot
                springs, chain = own_springs(robot), build_chain(robot)
            loads[k] = compute_model_loads(model, springs, chain)
            alike.setdefault(loads[k].chain.structure, []).append(k)
    most = max(MOST_POSES // max(len(theta), 1), 1)
    for numbers in alike.values():
        for first in range(0, len(numbers), most):
            part = numbers[first : first + most]
            found = _attain_alike([models[k] for k in part], [loads[k] for k in part], tolerance, theta)
            positions.update(zip(part, found, strict=True))
    return [positions[k] for k in range(len(models))]


def _attain_alike(models: Sequence[ForwardModel], loads: Sequence[Load], tolerance: float, theta: Array) -> list[Array]:
    """Solve models whose chains have the same elements."""
    n = len(theta)
    chain = stack_chains([load.chain for load in loads], n)
    biases = [np.zeros((n, chain.n_springs)) if load.bias is None else load.bias for load in loads]
    loaded = solve_equilibrium(
        chain, np.concatenate([load.q for load in loads]), np.concatenate([model.wrench for model in models]),
        tolerance=tolerance, torque_bias=np.concatenate(biases) if any(bias.any() for bias in biases) else None,
        theta=np.tile(theta, (len(models), 1)) if theta.shape[1] == chain.n_springs else None,
    )  # fmt: skip
    rows = [slice(k * n, (k + 1) * n) for k in range(len(models))]
    return [
        see_target(model, Frames(*(part[own] for part in loaded.frames)), model.wrench)[0]
        for model, own in zip(models, rows, strict=True)
    ]
