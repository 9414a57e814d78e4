"""The table of [Klimchik2018] for any robot and path: what each encoder feedback leaves of the deflection.

Loads of one level, at the postures of the path: straight down, and in all directions. The arm is its own model here, so
that the table shows what a strategy can do at best.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compplan.identification.reduce import reduce_model
from compplan.plan.strategies.both_encoders import gear_shares
from compplan.plan.strategies.path_map import TYPICAL_FORCE, spread_wrenches
from compplan.plan.task import PlanTask
from compplan.robot import Array, Robot
from compplan.statics.chain import Chain, build_chain, locate_frames
from compplan.statics.encoders import actuator_selection, control_equilibrium
from compplan.statics.sensitivity import attain_pose

#: Postures and loads of the table.
ROWS = 400


@dataclass(frozen=True)
class EncoderRow:
    """What one strategy leaves of the deflection of the tip.

    Attributes:
        load: "vertical" or "all directions".
        strategy: Which feedback holds the axes.
        mean: [m]
        std: Standard deviation. [m]
        max: [m]
        left: Mean over the mean with motor-side feedback.

    """

    load: str
    strategy: str
    mean: float
    std: float
    max: float
    left: float


@dataclass(frozen=True)
class EncoderTable:
    """Rows for vertical loads and for loads of all directions, and the level of the load [N]."""

    rows: tuple[EncoderRow, ...]
    level: float


def tabulate_encoders(task: PlanTask) -> EncoderTable | None:
    """Tabulate encoder strategies at the postures of a path; None where no joint has two encoders to compare."""
    if not task.chain.actuator.any():
        return None
    rng = np.random.default_rng(2018)
    cut = np.flatnonzero(task.compensated)
    q = task.q_start[rng.choice(cut, ROWS)]
    level = float(np.linalg.norm(task.wrench[cut, :3], axis=1).mean()) or TYPICAL_FORCE
    return compare_encoders(task.robot, q, level, rng)


def compare_encoders(robot: Robot, q: Array, level: float, rng: np.random.Generator) -> EncoderTable:
    """Compare encoder strategies at postures under vertical loads and under loads of all directions.

    Args:
        robot: The robot, whose model is the truth.
        q: Postures. Shape (n, nq). [rad or m]
        level: Level of the force at the tip. [N]
        rng: Draws the directions.

    """
    chain = build_chain(robot, gravity=False)
    gear = np.abs(actuator_selection(chain)) @ np.diag(chain.compliance)
    fit = spread_wrenches(len(q), level, rng)
    reduced = reduce_model(robot, q, fit)
    beta = gear_shares(gear, reduced.compliance)
    down = np.tile([0.0, 0.0, -level, 0.0, 0.0, 0.0], (len(q), 1))
    around = spread_wrenches(len(q), level, rng) * np.repeat([1.0, 0.0], 3)
    model = build_chain(reduced.robot, gravity=False)
    rows: list[EncoderRow] = []
    for load, wrench in (("vertical", down), ("all directions", around)):
        left = {
            feedback: _deflection(chain, q, wrench, feedback, beta) for feedback in ("motor", "link", "combined")
        }
        left["reduced model"] = _deflection_by_model(chain, model, q, wrench)
        rows += [
            EncoderRow(load, name, float(size.mean()), float(size.std()), float(size.max()),
                       float(size.mean() / left["motor"].mean()))
            for name, size in left.items()
        ]  # fmt: skip
    return EncoderTable(tuple(rows), level)


def _deflection(chain: Chain, q: Array, wrench: Array, feedback: str, beta: Array) -> Array:
    state = control_equilibrium(chain, q, wrench, feedback=feedback, beta=beta)
    return np.asarray(np.linalg.norm(state.loaded.position - locate_frames(chain, q).tcp_position, axis=1))


def _deflection_by_model(chain: Chain, model: Chain, q: Array, wrench: Array) -> Array:
    """What is left where the known force goes through the reduced model: the command mirrors the model's pose twist."""
    from scipy.spatial.transform import Rotation

    start = locate_frames(model, q)
    command = q
    for _ in range(3):
        attained = attain_pose(model, command, wrench)
        turn = Rotation.from_matrix(attained.rotation @ np.swapaxes(start.tcp_rotation, 1, 2)).as_rotvec()
        twist = np.hstack([attained.position - start.tcp_position, turn])
        command = command - np.einsum("nij,nj->ni", np.linalg.pinv(attained.jacobian, rcond=1e-3), twist)
    loaded = control_equilibrium(chain, command, wrench).loaded
    return np.asarray(np.linalg.norm(loaded.position - start.tcp_position, axis=1))
