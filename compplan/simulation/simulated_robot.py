"""Simulated robot: actual motion for a command, computed without the planner's code.

The simulated robot may differ from the planner's model. Its exact loaded equilibrium is solved by Pinocchio
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
from compplan.robot.pose import fit_displacement, see_position
from compplan.simulation.exact import ExactRobot, build_exact_robot, solve_exact_pose

#: Name of the simulated robot equal to the planner's model.
AS_MODELLED = "as modelled"
#: Factors on all compliances of further simulated robots in a comparison.
MISMATCHES = (1.2, 0.8)
#: Tolerance of the elastic coordinates; half a nanometre at the tip of a large arm. [rad or m]
TOLERANCE = 1e-10
EXACT_EVALUATION = "Pinocchio, exact loaded equilibrium at every waypoint"


@dataclass(frozen=True)
class SimulatedRobot:
    """Simulated robot with its part frame."""

    name: str  #: Name in tables; describes the difference from the planner's model.
    robot: Robot  #: Robot with its tool.
    exact_robot: ExactRobot  #: Robot as a Pinocchio model.
    #: Transformation from the part frame measured by touching with this robot to the true one; None for an absolute
    #: frame. Shape (4, 4). [m]
    displacement: Array | None = None


class SimulatedRun(NamedTuple):
    """Attained poses of the loaded tool, relative to the measured part frame; n waypoints, base axes."""

    position: Array  #: Attained tip. Shape (n, 3). [m]
    rotation: Array  #: Attained orientation of the TCP frame. Shape (n, 3, 3).


def build_simulated_robot(robot: Robot, name: str = AS_MODELLED) -> SimulatedRobot:
    """Build the simulated robot of a robot model."""
    return SimulatedRobot(name, robot, build_exact_robot(robot))


def standard_variants(robot: Robot) -> tuple[SimulatedRobot, ...]:
    """Build the simulated robots of a comparison: as modelled, then with all compliances times each mismatch."""
    others = [
        build_simulated_robot(robot.scale_compliance(factor), f"compliance x {factor:g}") for factor in MISMATCHES
    ]
    return (build_simulated_robot(robot), *others)


def run_simulated_robot(
    cell: SimulatedRobot, q: Array, wrench: Array, step_time: Array | None = None, bias: Array | None = None
) -> SimulatedRun:
    """Run a command on a simulated robot.

    Args:
        cell: The simulated robot.
        q: Commanded joint positions. Shape (n, nq). [rad or m]
        wrench: Wrench of the environment on the tool at the tip, base axes. Shape (n, 6). [N, N m]
        step_time: Time from each waypoint to the next, for effects of motion (default: 1 s). Shape (n - 1,). [s]
        bias: Load of inertia on each elastic coordinate (default: zero). Shape (n, s). [N m or N]
    """
    position, rotation = _attain(cell, q, wrench, step_time, bias)
    if cell.displacement is None:
        return SimulatedRun(position, rotation)
    return SimulatedRun(see_position(position, cell.displacement), cell.displacement[:3, :3].T @ rotation)


def with_touched_part(cell: SimulatedRobot, q: Array, shown: Array) -> SimulatedRobot:
    """Return the simulated robot with the part frame measured by touching with that robot.

    q: joint positions at the touched points, (k, nq) [rad or m]; shown: tip in the controller's display, (k, 3) [m].
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
    """Deviation of a simulated run from its path; n waypoints, base frame. Figures cover the cut only."""

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
        """Deviation over the cut, with the keys of the result files: rms, mean and max. [mm]"""
        sizes = {"rms": self.rms_deviation, "mean": float(self.distance[self.cut].mean()), "max": self.max_deviation}
        return {name: value * 1e3 for name, value in sizes.items()}

    def share_within(self, tolerance: float) -> float:
        """Return the share of the cut's waypoints within a distance [m] of the path."""
        return float((self.distance[self.cut] <= tolerance).mean())
