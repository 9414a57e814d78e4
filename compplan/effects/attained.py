"""Loaded pose of the tool on a robot with effects, and equilibrium of many models of the same rows at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compplan.effects import (
    apply_effects,
    build_model,
    command_campaign,
    is_of_instrument,
    robot_effects,
    solve_model_poses,
)
from compplan.effects.forward_model import ForwardModel, Load, compute_model_loads, own_springs, see_target
from compplan.robot import Array, Robot
from compplan.statics.chain import Frames, build_chain, stack_chains
from compplan.statics.elastic import solve_equilibrium

#: Effects that depend on the motion before or on the time: they count as zero at the touched points.
TRANSIENT = ("backlash", "thermal_drift", "tracking_lag")
#: Poses solved at once: a compromise between call overhead and cache size.
MOST_POSES = 2000


def attain_with_effects(robot: Robot, q: Array, wrench: Array, step_time: Array) -> tuple[Array, Array]:
    """Predict the attained pose of a robot with the effects of its folder: position (n, 3) [m], orientation (n, 3, 3).

    The rows are passed in order at the programmed feed, in the state after the last shift.
    """
    campaign = command_campaign(q, wrench, time=np.r_[0.0, np.cumsum(step_time)])
    effects = [effect for effect in robot_effects(robot) if not is_of_instrument(effect.name)]
    attained = solve_model_poses(apply_effects(build_model(robot, campaign, later=True), effects))
    return attained.position, attained.rotation


def rest_robot(robot: Robot) -> Robot:
    """Return the robot without the effects that depend on the motion before or on the time."""
    kept = tuple(table for table in robot.effects if table.get("effect") not in TRANSIENT)
    return robot if len(kept) == len(robot.effects) else replace(robot, effects=kept)


def attain_positions(models: Sequence[ForwardModel], *, tolerance: float, theta: Array) -> list[Array]:
    """Return the observed positions of the targets of models; see `solve_model_poses`. Shapes (n, 3). [m]

    tolerance: of the elastic coordinates [rad or m]; theta: initial ones of models with as many springs, (n, s).

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
