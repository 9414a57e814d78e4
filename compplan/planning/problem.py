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
    """A path at k stations, and what the joint positions there have to fulfil; base frame, SI units.

    Attributes:
        chain: The elastic chain with the tool.
        joints: Names of the joints.
        waypoint: Waypoint of each station. Shape (k,).
        position: Wanted tool tip. Shape (k, 3). [m]
        rotation: Wanted orientation of the TCP frame; z (out of the tool) is binding, x where the spin is not free.
            Shape (k, 3, 3).
        wrench: Wrench of the environment on the tool at the TCP. Shape (k, 6). [N, N m]
        bias: Further load on each elastic coordinate, such as that of inertia. Shape (k, s). [N m or N]
        theta: Elastic coordinates at `guess` under these loads. Shape (k, s). [rad or m]
        loaded: Where the loaded tool has to be on the path; the unloaded one at the others. Shape (k,).
        q_start: Posture that the posture search chose. Shape (k, nq). [rad or m]
        guess: Where the solver begins. Shape (k, nq). [rad or m]
        lower: Lower bounds of the joint positions. Shape (k, nq). [rad or m]
        upper: Upper bounds. Shape (k, nq). [rad or m]
        spin_free: Whether the rotation about the tool axis is free.
        axis_free: Whether the tool axis follows from the tip: arms of four joints.
        limits: What has to hold.
        costs: What is minimised, the sum of all.
        along: Programmed time from the first station. Shape (k,). [s]
        runs: First and last station of every run from rest to rest.
        shift: What the model leaves out of the loaded tip at `guess`, None for nothing. Shape (k, 3). [m]
        turn: The same of its orientation, to be multiplied from the right. Shape (k, 3, 3).
        released: Stations whose pose may be missed at a price, None for none. Shape (k,).
        programmed: Tip that the correction is counted from, `position` if left out. Shape (k, 3). [m]
        speed: Share of the programmed feed at which the solver begins. Shape (k,) or one number.

    """

    chain: Chain
    joints: tuple[str, ...]
    waypoint: NDArray[np.int_]
    position: Array
    rotation: Array
    wrench: Array
    bias: Array
    theta: Array
    loaded: NDArray[np.bool_]
    q_start: Array
    guess: Array
    lower: Array
    upper: Array
    spin_free: bool
    axis_free: bool
    limits: tuple[Limit, ...]
    costs: tuple[Cost, ...]
    along: Array
    runs: tuple[tuple[int, int], ...] = ()
    shift: Array | None = None
    turn: Array | None = None
    released: NDArray[np.bool_] | None = None
    programmed: Array | None = None
    speed: Array | float = 0.5

    def __len__(self) -> int:
        return len(self.position)

    def __str__(self) -> str:
        """Print the problem as it is minimised."""
        costs = " + ".join(str(cost) for cost in self.costs) or "0"
        rows = "\n            ".join(str(limit) for limit in self.limits)
        over = ["joint positions", *(["squared speed"] if self.timed else []), *(["band"] if self.counts_band else [])]
        return f"minimise    {costs}\nover        {', '.join(over)} at {len(self)} stations\nsubject to  {rows}"

    @property
    def pose_rows(self) -> int:
        """Count the pose equations of a station."""
        return (3 if self.axis_free else 5) + (not self.spin_free)

    @property
    def timed(self) -> bool:
        """Tell whether the speed along the path is a variable."""
        return any(limit.timed for limit in self.limits) or any(cost.timed for cost in self.costs)

    @property
    def counts_band(self) -> bool:
        """Tell whether the widest 95 % band is a variable."""
        return any(cost.name == "band" for cost in self.costs)

    @property
    def most_band(self) -> float:
        """Greatest band that is allowed, as a share of that at the start."""
        return min((float(vars(limit)["most"]) for limit in self.limits if limit.name == "band"), default=float("inf"))

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
    """One station of the program as CasADi symbols; what a problem does not need is None.

    Attributes:
        q: Joint positions. Shape (nq). [rad or m]
        q_next: Those of the next station. Shape (nq). [rad or m]
        departure: q less the posture that was chosen. Shape (nq). [rad or m]
        rate: Derivative of q along the programmed time. Shape (nq). [rad/s or m/s]
        change: Its second derivative. Shape (nq). [rad/s^2 or m/s^2]
        square: Square of the speed as a share of the programmed feed.
        square_next: That of the next station.
        push: Half the derivative of the square along the programmed time. [1/s]
        push_before: The same of the way from the station before, 0 at the start of a run. [1/s]
        step: Programmed time to the next station, 0 at the end of a run. [s]
        pace: Its inverse, 0 at the end of a run. [1/s]
        band: Widest 95 % band as a share of that at the start.
        slack: Missed pose rows of a released station. Shape (rows).
        excess: Excess of the correction of a released station. [m]
        missed: Missed pose in the wanted frame: tip (3) [m], tool axis (2), spin (1) [rad]. Shape (rows).
        position: Tip, loaded where the station is. Shape (3). [m]
        rotation: Orientation of the TCP frame. Shape (3, 3).
        programmed: Tip that the correction is counted from. Shape (3). [m]
        deflection: Elastic coordinates. Shape (s). [rad or m]
        wrench: Wrench on the tool. Shape (6). [N, N m]
        frames: Frames of the unloaded arm.
        numbers: Numbers of the limits at this station, by the limit's name.

    """

    q: ca.SX
    q_next: ca.SX
    departure: ca.SX
    rate: ca.SX
    change: ca.SX
    square: ca.SX
    square_next: ca.SX
    push: ca.SX
    push_before: ca.SX
    step: ca.SX
    pace: ca.SX
    band: ca.SX
    slack: ca.SX
    excess: ca.SX
    missed: ca.SX
    position: ca.SX
    rotation: ca.SX
    programmed: ca.SX
    deflection: ca.SX
    wrench: ca.SX
    frames: SymbolicFrames
    numbers: Mapping[str, ca.SX]


class Limit:
    """What has to hold at every station; a limit is a class derived from this one, `str` its line of mathematics.

    Attributes:
        name: What plan.json calls it.
        timed: Whether it speaks of the speed along the path.
        of_joints: Whether its rows are one a joint.

    """

    name: ClassVar[str]
    timed: ClassVar[bool] = False
    of_joints: ClassVar[bool] = False

    @property
    def numbers(self) -> Array | None:
        """Its own numbers at every station, which its rows find in `Station.numbers`, or None. Shape (k, c)."""
        return None

    def rows(self, station: Station) -> ca.SX:
        """Return the rows of one station. Shape (r)."""
        raise NotImplementedError

    def bounds(self, problem: PlanningProblem) -> tuple[Array, Array]:
        """Return lower and upper bounds of the rows. Shapes (k, r)."""
        raise NotImplementedError


class Cost:
    """What is minimised; a cost is a class derived from this one, with `name`, `timed` and `str` as of a limit."""

    name: ClassVar[str]
    timed: ClassVar[bool] = False

    def term(self, station: Station) -> ca.SX:
        """Return what one station costs."""
        raise NotImplementedError
