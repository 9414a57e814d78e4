"""The virtual cell: what a robot really does with a command, computed without the planner's code.

The cell's robot may differ from the one that was planned with. Its loaded equilibrium is exact and solved by Pinocchio
(`compplan.simulation.exact`), pose by pose; effects of a robot folder (effects.toml) are added by their forward models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compplan.effects.attained import attain_with_effects, rest_robot
from compplan.robot import Array, Robot
from compplan.robot.pose import fit_displacement, see_position, see_rotation
from compplan.simulation.exact import ExactRobot, build_exact_robot, solve_exact_pose

#: The cell in which the planner's model is the truth.
AS_MODELLED = "as modelled"
#: Cells that a comparison shows beside it: factors on all compliances.
MISMATCHES = (1.2, 0.8)
#: Elastic coordinates are settled to this; half a nanometre at the tip of a large arm. [rad or m]
TOLERANCE = 1e-10
EXACT_EVALUATION = "Pinocchio, exact loaded equilibrium at every waypoint"


@dataclass(frozen=True)
class SimulatedRobot:
    """A cell."""

    name: str  #: What it is called in tables; says in what it differs from the planner's model.
    robot: Robot  #: The robot that stands in it, with its tool.
    exact_robot: ExactRobot  #: The robot as a Pinocchio model.
    #: From the part frame that a touch with this robot found to where the part stands; None where the frame is
    #: absolute. Shape (4, 4). [m]
    displacement: Array | None = None


class SimulatedRun(NamedTuple):
    """Where the loaded tool went, relative to the part frame as it was found; n waypoints, base axes."""

    position: Array  #: Attained tip. Shape (n, 3). [m]
    rotation: Array  #: Attained orientation of the TCP frame. Shape (n, 3, 3).


def build_simulated_robot(robot: Robot, name: str = AS_MODELLED) -> SimulatedRobot:
    """Build the cell of a robot."""
    return SimulatedRobot(name, robot, build_exact_robot(robot))


def standard_variants(robot: Robot) -> tuple[SimulatedRobot, ...]:
    """Build the cells of a comparison: the robot as modelled, then with all compliances times each mismatch."""
    others = [
        build_simulated_robot(robot.scale_compliance(factor), f"compliance x {factor:g}") for factor in MISMATCHES
    ]
    return (build_simulated_robot(robot), *others)


def run_simulated_robot(
    cell: SimulatedRobot, q: Array, wrench: Array, step_time: Array | None = None, bias: Array | None = None
) -> SimulatedRun:
    """Run a command in a cell.

    Args:
        cell: The cell.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the tip, base axes. Shape (n, 6). [N, N m]
        step_time: Time from each waypoint to the next, for effects of motion; 1 s if left out. Shape (n - 1,). [s]
        bias: Load of inertia on each elastic coordinate, none if left out. Shape (n, s). [N m or N]
    """
    position, rotation = _attain(cell, q, wrench, step_time, bias)
    if cell.displacement is None:
        return SimulatedRun(position, rotation)
    return SimulatedRun(see_position(position, cell.displacement), see_rotation(rotation, cell.displacement))


def touch_cell(cell: SimulatedRobot, q: Array, shown: Array) -> SimulatedRobot:
    """Return the cell in which the part was found by touching it with the cell's robot.

    q: joint positions at the touched points, (k, nq) [rad or m]; shown: where the controller shows the tip, (k, 3) [m].
    """
    resting = replace(cell, robot=rest_robot(cell.robot), displacement=None)
    loaded = _attain(resting, q, np.zeros((len(q), 6)), None, None)[0]
    return replace(cell, displacement=fit_displacement(shown, loaded))


def _attain(
    cell: SimulatedRobot, q: Array, wrench: Array, step_time: Array | None, bias: Array | None
) -> tuple[Array, Array]:
    position, rotation, _ = solve_exact_pose(cell.exact_robot, q, wrench, TOLERANCE, bias)
    if not cell.robot.effects:
        return position, rotation
    steps = np.ones(len(q) - 1) if step_time is None else step_time
    with_effects = attain_with_effects(cell.robot, q, wrench, steps)
    without = attain_with_effects(replace(cell.robot, effects=()), q, wrench, steps)
    turn = Rotation.from_matrix(with_effects[1] @ np.swapaxes(without[1], 1, 2)).as_matrix()
    return position + with_effects[0] - without[0], turn @ rotation


@dataclass(frozen=True)
class Evaluation:
    """A run in a cell against its path; n waypoints, base frame. Figures are of the waypoints of the cut."""

    position: Array  #: Attained tip. Shape (n, 3). [m]
    rotation: Array  #: Attained orientation of the TCP frame. Shape (n, 3, 3).
    deviation: Array  #: Attained minus nominal tip. Shape (n, 3). [m]
    tilt: Array  #: Angle between attained and nominal tool axis. Shape (n,). [rad]
    cut: NDArray[np.bool_]  #: Waypoints that are compensated and evaluated. Shape (n,).

    @cached_property
    def distance(self) -> Array:
        """Distance of the attained tip from the nominal one. Shape (n,). [m]"""
        return np.asarray(np.linalg.norm(self.deviation, axis=1))

    @property
    def rms_deviation(self) -> float:
        """Root mean square distance over the cut. [m]"""
        return float(np.sqrt(np.mean(self.distance[self.cut] ** 2)))

    @property
    def max_deviation(self) -> float:
        """Greatest distance over the cut. [m]"""
        return float(self.distance[self.cut].max())

    @property
    def max_tilt(self) -> float:
        """Greatest angle between attained and nominal tool axis over the cut. [rad]"""
        return float(self.tilt[self.cut].max())

    @property
    def figures(self) -> dict[str, float]:
        """Deviation over the cut as files hold it: rms, mean and max. [mm]"""
        sizes = {"rms": self.rms_deviation, "mean": float(self.distance[self.cut].mean()), "max": self.max_deviation}
        return {name: value * 1e3 for name, value in sizes.items()}

    def share_within(self, tolerance: float) -> float:
        """Return the share of the cut's waypoints within a distance [m] of the path."""
        return float((self.distance[self.cut] <= tolerance).mean())
