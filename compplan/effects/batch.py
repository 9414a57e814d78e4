"""Many scenes of the same rows in one equilibrium: robots that differ by little, as slopes and draws ask for."""

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

#: Poses that are solved at once: enough that numpy's calls cost little, few enough to stay in the cache.
MOST_POSES = 2000


def attain_positions(scenes: Sequence[ForwardModel], *, tolerance: float, theta: Array) -> list[Array]:
    """Return where the targets of scenes are seen, as `solve_model_poses` tells of each. Shapes (n, 3). [m]

    Args:
        scenes: The scenes; n rows each.
        tolerance: Elastic coordinates are settled to this. [rad or m]
        theta: Elastic coordinates to begin at in scenes that have as many springs. Shape (n, s). [rad or m]

    Raises:
        ConvergenceError: If a robot buckles under the load.
    """
    positions: dict[int, Array] = {}
    loads: dict[int, Load] = {}
    robot: Robot | None = None
    alike: dict[bytes, list[int]] = {}
    for k, scene in enumerate(scenes):
        if scene.laws or scene.payload.any():
            positions[k] = solve_model_poses(scene, tolerance=tolerance, theta=theta).position
        else:
            if scene.robot is not robot:
                robot = scene.robot
                springs, chain = own_springs(robot), build_chain(robot)
            loads[k] = compute_model_loads(scene, springs, chain)
            alike.setdefault(loads[k].chain.structure, []).append(k)
    most = max(MOST_POSES // max(len(theta), 1), 1)
    for numbers in alike.values():
        for first in range(0, len(numbers), most):
            part = numbers[first : first + most]
            found = _attain_alike([scenes[k] for k in part], [loads[k] for k in part], tolerance, theta)
            positions.update(zip(part, found, strict=True))
    return [positions[k] for k in range(len(scenes))]


def _attain_alike(scenes: Sequence[ForwardModel], loads: Sequence[Load], tolerance: float, theta: Array) -> list[Array]:
    """Solve scenes whose chains have the same elements in one go."""
    n = len(theta)
    chain = stack_chains([load.chain for load in loads], n)
    biases = [np.zeros((n, chain.n_springs)) if load.bias is None else load.bias for load in loads]
    loaded = solve_equilibrium(
        chain, np.concatenate([load.q for load in loads]), np.concatenate([scene.wrench for scene in scenes]),
        tolerance=tolerance, torque_bias=np.concatenate(biases) if any(bias.any() for bias in biases) else None,
        theta=np.tile(theta, (len(scenes), 1)) if theta.shape[1] == chain.n_springs else None,
    )  # fmt: skip
    rows = [slice(k * n, (k + 1) * n) for k in range(len(scenes))]
    return [
        see_target(scene, Frames(*(part[own] for part in loaded.frames)), scene.wrench)[0]
        for scene, own in zip(scenes, rows, strict=True)
    ]
