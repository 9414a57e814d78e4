"""The planning problem as an engineer states it: arm, path at stations, loads, what is free, limits and costs."""

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
    """A path at k stations, and what the joint positions there have to fulfil; base frame, SI units."""

    chain: Chain  #: The elastic chain with the tool.
    joints: tuple[str, ...]  #: Names of the joints.
    waypoint: NDArray[np.int_]  #: Waypoint of each station. Shape (k,).
    position: Array  #: Wanted tool tip. Shape (k, 3). [m]
    #: Wanted orientation of the TCP frame; z (out of the tool) is binding, x where the spin is not free. Shape (k, 3,
    #: 3).
    rotation: Array
    wrench: Array  #: Wrench of the environment on the tool at the TCP. Shape (k, 6). [N, N m]
    bias: Array  #: Further load on each elastic coordinate, such as that of inertia. Shape (k, s). [N m or N]
    theta: Array  #: Elastic coordinates at `guess` under these loads. Shape (k, s). [rad or m]
    #: Where the loaded tool has to be on the path; the unloaded one at the others. Shape (k,).
    loaded: NDArray[np.bool_]
    q_start: Array  #: Posture that the posture search chose. Shape (k, nq). [rad or m]
    guess: Array  #: Where the solver begins. Shape (k, nq). [rad or m]
    lower: Array  #: Lower bounds of the joint positions. Shape (k, nq). [rad or m]
    upper: Array  #: Upper bounds. Shape (k, nq). [rad or m]
    spin_free: bool  #: Whether the rotation about the tool axis is free.
    axis_free: bool  #: Whether the tool axis follows from the tip: arms of four joints.
    limits: tuple[Limit, ...]  #: What has to hold.
    costs: tuple[Cost, ...]  #: What is minimised, the sum of all.
    along: Array  #: Programmed time from the first station. Shape (k,). [s]
    runs: tuple[tuple[int, int], ...] = ()  #: First and last station of every run from rest to rest.
    #: Square of the speed where the solver begins, as a share of the programmed feed's, where it varies. Shape (k,).
    square: Array | None = None
    #: What the model leaves out of the loaded tip at `guess`, None for nothing. Shape (k, 3). [m]
    shift: Array | None = None
    turn: Array | None = None  #: The same of its orientation, to be multiplied from the right. Shape (k, 3, 3).
    #: Stations whose pose may be missed at a price, None for none. Shape (k,).
    released: NDArray[np.bool_] | None = None
    #: Tip that the correction is counted from, `position` if left out. Shape (k, 3). [m]
    programmed: Array | None = None

    def __len__(self) -> int:
        return len(self.position)

    def __str__(self) -> str:
        """Print the problem as it is minimised."""
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
        """Tell whether the speed along the path is a variable."""
        return any(each.timed for each in (*self.limits, *self.costs))

    @property
    def own_numbers(self) -> dict[str, Array]:
        """Numbers of limits and costs at every station, by their names. Shapes (k, c)."""
        every = {each.name: each.numbers for each in (*self.limits, *self.costs)}
        return {name: numbers for name, numbers in every.items() if numbers is not None}

    @cached_property
    def rates(self) -> tuple[Array, Array]:
        """First and second derivative along the programmed time as matrices on the stations. Shapes (k, k)."""
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
    """One station of the program as CasADi symbols; what a problem does not need is None."""

    q: ca.SX  #: Joint positions. Shape (nq). [rad or m]
    q_next: ca.SX  #: Those of the next station. Shape (nq). [rad or m]
    departure: ca.SX  #: q less the posture that was chosen. Shape (nq). [rad or m]
    rate: ca.SX  #: Derivative of q along the programmed time. Shape (nq). [rad/s or m/s]
    change: ca.SX  #: Its second derivative. Shape (nq). [rad/s^2 or m/s^2]
    square: ca.SX  #: Square of the speed as a share of the programmed feed.
    square_next: ca.SX  #: That of the next station.
    push: ca.SX  #: Half the derivative of the square along the programmed time. [1/s]
    push_before: ca.SX  #: The same of the way from the station before, 0 at the start of a run. [1/s]
    step: ca.SX  #: Programmed time to the next station, 0 at the end of a run. [s]
    pace: ca.SX  #: Its inverse, 0 at the end of a run. [1/s]
    slack: ca.SX  #: Missed pose rows of a released station. Shape (rows).
    excess: ca.SX  #: Excess of the correction of a released station. [m]
    missed: ca.SX  #: Missed pose in the wanted frame: tip (3) [m], tool axis (2), spin (1) [rad]. Shape (rows).
    position: ca.SX  #: Tip, loaded where the station is. Shape (3). [m]
    rotation: ca.SX  #: Orientation of the TCP frame. Shape (3, 3).
    programmed: ca.SX  #: Tip that the correction is counted from. Shape (3). [m]
    deflection: ca.SX  #: Elastic coordinates. Shape (s). [rad or m]
    wrench: ca.SX  #: Wrench on the tool. Shape (6). [N, N m]
    frames: SymbolicFrames  #: Frames of the unloaded arm.
    numbers: Mapping[str, ca.SX]  #: Numbers of the limits at this station, and costs at this station, by their names.


#: Lower and upper bounds of rows: one number, or an array that broadcasts to (k, r).
Bounds = tuple[Array | float, Array | float]


class Term:
    """What limits and costs have in common."""

    name: ClassVar[str]  #: What plan.json calls it.
    formula: ClassVar[str]  #: Its line of mathematics.
    timed: ClassVar[bool] = False  #: Whether it speaks of the speed along the path.

    def __str__(self) -> str:
        return self.formula

    @property
    def numbers(self) -> Array | None:
        """Its own numbers at every station, which it finds in `Station.numbers`, or None. Shape (k, c)."""
        return None


class Limit(Term):
    """What has to hold at every station; a limit is a class derived from this one."""

    of_joints: ClassVar[bool] = False  #: Whether its rows are one a joint.

    def rows(self, station: Station) -> ca.SX:
        """Return the rows of one station. Shape (r)."""
        raise NotImplementedError

    def bounds(self, problem: PlanningProblem) -> Bounds:
        """Return the bounds of the rows; rows are shares of a limit where a class says nothing else."""
        return -1.0, 1.0


class Cost(Term):
    """What is minimised; a cost is a class derived from this one."""

    def term(self, station: Station) -> ca.SX:
        """Return what one station costs."""
        raise NotImplementedError
