"""Planning problem: arm, path at stations, loads, degrees of freedom, limits and costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from compplan.robot import Array
from compplan.statics.chain import Chain
from compplan.statics.kinematics import SymbolicFrames


@dataclass(frozen=True)
class PlanningProblem:
    """Path at k stations, with the limits and costs of the joint positions there; base frame, SI units."""

    chain: Chain  #: Elastic chain with the tool.
    joints: tuple[str, ...]  #: Names of the joints.
    waypoint: NDArray[np.int_]  #: Waypoint of each station. Shape (k,).
    position: Array  #: Required tool tip. Shape (k, 3). [m]
    #: Required orientation of the TCP frame: z (out of the tool), and x if the spin is not free.
    #: Shape (k, 3, 3).
    rotation: Array
    wrench: Array  #: Wrench of the environment on the tool at the TCP. Shape (k, 6). [N, N m]
    bias: Array  #: Further load on each elastic coordinate, such as inertia. Shape (k, s). [N m or N]
    theta: Array  #: Elastic coordinates at `guess` under these loads. Shape (k, s). [rad or m]
    #: Stations with the loaded tool on the path; with the unloaded tool at the others. Shape (k,).
    loaded: NDArray[np.bool_]
    q_start: Array  #: Posture of the posture search. Shape (k, nq). [rad or m]
    guess: Array  #: Initial guess of the joint positions. Shape (k, nq). [rad or m]
    lower: Array  #: Lower bounds of the joint positions. Shape (k, nq). [rad or m]
    upper: Array  #: Upper bounds. Shape (k, nq). [rad or m]
    spin_free: bool  #: Whether the rotation about the tool axis is free.
    axis_free: bool  #: Whether the tip determines the tool axis: arms of four joints.
    limits: tuple[Limit, ...]  #: Constraints.
    costs: tuple[Cost, ...]  #: Terms of the objective.
    along: Array  #: Programmed time from the first station. Shape (k,). [s]
    runs: tuple[tuple[int, int], ...] = ()  #: First and last station of every run from rest to rest.
    #: Initial guess of the squared speed as a share of the squared programmed feed, if a variable. Shape (k,).
    square: Array | None = None
    #: Tip displacement at `guess` that the model does not include, None for zero. Shape (k, 3). [m]
    shift: Array | None = None
    turn: Array | None = None  #: The same for the orientation, multiplied from the right. Shape (k, 3, 3).
    #: Stations whose pose may be missed at a cost, None for none. Shape (k,).
    released: NDArray[np.bool_] | None = None
    #: Reference tip of the correction (default: `position`). Shape (k, 3). [m]
    programmed: Array | None = None

    def __len__(self) -> int:
        return len(self.position)

    def __str__(self) -> str:
        """Format the problem as objective, variables and constraints."""
        costs = " + ".join(str(cost) for cost in self.costs) or "0"
        rows = "\n            ".join(str(limit) for limit in self.limits)
        over = ["joint positions", *(["squared speed"] if self.timed else [])]
        return f"minimise    {costs}\nover        {', '.join(over)} at {len(self)} stations\nsubject to  {rows}"

    @property
    def pose_rows(self) -> int:
        """Count the pose equations of a station."""
        return (3 if self.axis_free else 5) + (not self.spin_free)

    @property
    def timed(self) -> bool:
        """Return whether the speed along the path is a variable."""
        return any(each.timed for each in (*self.limits, *self.costs))

    @property
    def term_data(self) -> dict[str, Array]:
        """Data of limits and costs at every station, by name. Shapes (k, c)."""
        every = {each.name: each.numbers for each in (*self.limits, *self.costs)}
        return {name: numbers for name, numbers in every.items() if numbers is not None}

    @cached_property
    def rates(self) -> tuple[Array, Array]:
        """Matrices of the first and second derivative with respect to the programmed time. Shapes (k, k)."""
        first, second = np.zeros((len(self), len(self))), np.zeros((len(self), len(self)))
        for start, end in self.runs:
            for i in range(start, end + 1):
                j = min(max(i, start + 1), end - 1)
                a, b = self.along[j] - self.along[j - 1], self.along[j + 1] - self.along[j]
                at = float(self.along[i] - self.along[j])
                near = slice(j - 1, j + 2)
                left, right, whole = a * (a + b), b * (a + b), a * b
                first[i, near] = [(2 * at - b) / left, (b - a - 2 * at) / whole, (2 * at + a) / right]
                second[i, near] = [2 / left, -2 / whole, 2 / right]
        return first, second

    @cached_property
    def steps(self) -> Array:
        """Programmed time to the next station of the run, 0 at its end. Shape (k,). [s]"""
        steps = np.zeros(len(self))
        for start, end in self.runs:
            steps[start:end] = np.diff(self.along[start : end + 1])
        return steps


@dataclass(frozen=True)
class Station:
    """One station of the program as CasADi symbols; symbols that a problem does not need are empty."""

    q: ca.SX  #: Joint positions. Shape (nq). [rad or m]
    q_next: ca.SX  #: Joint positions of the next station. Shape (nq). [rad or m]
    departure: ca.SX  #: q less the chosen posture. Shape (nq). [rad or m]
    rate: ca.SX  #: Derivative of q with respect to the programmed time. Shape (nq). [rad/s or m/s]
    change: ca.SX  #: Second derivative. Shape (nq). [rad/s^2 or m/s^2]
    square: ca.SX  #: Square of the speed as a share of the programmed feed.
    square_next: ca.SX  #: The same at the next station.
    half_rate: ca.SX  #: Half the derivative of the square with respect to the programmed time. [1/s]
    half_rate_before: ca.SX  #: The same from the station before, 0 at the start of a run. [1/s]
    step: ca.SX  #: Programmed time to the next station, 0 at the end of a run. [s]
    inverse_step: ca.SX  #: Inverse of `step`, 0 at the end of a run. [1/s]
    slack: ca.SX  #: Pose error of a released station. Shape (rows).
    excess: ca.SX  #: Correction beyond its limit at a released station. [m]
    missed: ca.SX  #: Pose error in the required frame: tip (3) [m], tool axis (2), spin (1) [rad]. Shape (rows).
    position: ca.SX  #: Tip, loaded at loaded stations. Shape (3). [m]
    rotation: ca.SX  #: Orientation of the TCP frame. Shape (3, 3).
    programmed: ca.SX  #: Reference tip of the correction. Shape (3). [m]
    deflection: ca.SX  #: Elastic coordinates. Shape (s). [rad or m]
    wrench: ca.SX  #: Wrench on the tool. Shape (6). [N, N m]
    frames: SymbolicFrames  #: Frames of the unloaded arm.
    numbers: Mapping[str, ca.SX]  #: Data of limits and costs at this station, by name.


#: Lower and upper bounds of rows: one number, or an array that broadcasts to (k, r).
Bounds = tuple[Array | float, Array | float]


class Term:
    """Base class of limits and costs."""

    name: ClassVar[str]  #: Name in plan.json.
    formula: ClassVar[str]  #: Formula as text; fields in braces.
    timed: ClassVar[bool] = False  #: Whether the term depends on the speed along the path.

    def __str__(self) -> str:
        return self.formula.format_map(vars(self))

    @property
    def numbers(self) -> Array | None:
        """Data of the term at every station, passed in `Station.numbers`, or None. Shape (k, c)."""
        return None


class Limit(Term):
    """Base class of constraints at every station."""

    of_joints: ClassVar[bool] = False  #: Whether there is one row per joint.

    def rows(self, station: Station) -> ca.SX:
        """Return the rows of one station. Shape (r)."""
        raise NotImplementedError

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds of the rows; by default rows are shares of a limit."""
        return -1.0, 1.0


class Cost(Term):
    """Base class of terms of the objective."""

    def term(self, station: Station) -> ca.SX:
        """Return the cost of one station."""
        raise NotImplementedError
