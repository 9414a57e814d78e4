"""The virtual cell: what a robot really does with a command, computed without the planner's code.

The cell's robot may differ from the one that was planned with. Its loaded equilibrium is exact and solved by Pinocchio
(`compplan.simulation.judge`), pose by pose; effects of a robot folder (effects.toml) are added by their forward models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.effects.attained import attain_with_effects
from compplan.robot import Array, Robot
from compplan.simulation.judge import Judge, build_judge, judge_pose

#: The cell in which the planner's model is the truth.
AS_MODELLED = "as modelled"
#: Cells that a comparison shows beside it: factors on all compliances.
MISMATCHES = (1.2, 0.8)
#: Elastic coordinates are settled to this; half a nanometre at the tip of a large arm. [rad or m]
TOLERANCE = 1e-10
JUDGE = "Pinocchio, exact loaded equilibrium at every waypoint"


@dataclass(frozen=True)
class Cell:
    """A cell.

    Attributes:
        name: What it is called in tables; says in what it differs from the planner's model.
        robot: The robot that stands in it, with its tool.
        judge: That robot as a Pinocchio model.

    """

    name: str
    robot: Robot
    judge: Judge


class CellRun(NamedTuple):
    """Where the loaded tool went; n waypoints, base frame.

    Attributes:
        position: Attained tip. Shape (n, 3). [m]
        rotation: Attained orientation of the TCP frame. Shape (n, 3, 3).

    """

    position: Array
    rotation: Array


def build_cell(robot: Robot, name: str = AS_MODELLED) -> Cell:
    """Build the cell of a robot."""
    return Cell(name, robot, build_judge(robot))


def standard_cells(robot: Robot) -> tuple[Cell, ...]:
    """Build the cells of a comparison: the robot as modelled, then with all compliances times each mismatch."""
    others = [build_cell(robot.scale_compliance(factor), f"compliance x {factor:g}") for factor in MISMATCHES]
    return (build_cell(robot), *others)


def run_cell(
    cell: Cell, q: Array, wrench: Array, step_time: Array | None = None, bias: Array | None = None
) -> CellRun:
    """Run a command in a cell.

    Args:
        cell: The cell.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the tip, base axes. Shape (n, 6). [N, N m]
        step_time: Time from each waypoint to the next, for effects of motion; 1 s if left out. Shape (n - 1,). [s]
        bias: Load of inertia on each elastic coordinate, none if left out. Shape (n, s). [N m or N]

    """
    position, rotation, _ = judge_pose(cell.judge, q, wrench, TOLERANCE, bias)
    if not cell.robot.effects:
        return CellRun(position, rotation)
    steps = np.ones(len(q) - 1) if step_time is None else step_time
    with_effects = attain_with_effects(cell.robot, q, wrench, steps)
    without = attain_with_effects(replace(cell.robot, effects=()), q, wrench, steps)
    turn = Rotation.from_matrix(with_effects[1] @ np.swapaxes(without[1], 1, 2)).as_matrix()
    return CellRun(position + with_effects[0] - without[0], turn @ rotation)
