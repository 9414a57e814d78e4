"""What a cause without a name is made of, and the ways in which one is put into a scenario."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.campaigns.description import Array, Spring
from benchmarks.campaigns.effects import Effect, joint_index
from benchmarks.campaigns.machines import Machine
from benchmarks.campaigns.simulate import Rows, Scenario, simulate_rows
from benchmarks.campaigns.visits import Visits

Generator = np.random.Generator
Place = tuple[str | None, float, dict[str, Any]]


@dataclass(frozen=True)
class Setting:
    """What a cause is put into.

    Args:
        machine: The robot.
        nominal: The nominal robot as a scenario.
        rows: The plan.
        visits: How the campaign is run.
    """

    machine: Machine
    nominal: Scenario
    rows: Rows
    visits: Visits

    @property
    def arm(self) -> list[str]:
        """Turning joints, base first."""
        robot = self.machine.robot
        return [n for n in robot.joint_names if robot.segments[robot.index_of(n)].kind == "revolute"]

    def torque_of(self, joint: str) -> float:
        """Return the rms torque on a joint's own spring. [N m]"""
        load = simulate_rows(self.nominal, self.rows).load[:, self.nominal.own_springs(joint)[0]]
        return float(np.sqrt(np.mean(load**2))) + 1e-3


@dataclass(frozen=True)
class Oddity:
    """A cause without a name.

    Args:
        note: What it is, for truth.json; with the unit of its size.
        draw: Draws joint, a first size and parameters.
        apply: Puts it into a scenario.
        needs: "" or what the campaign must have: "weights", "rail", "slow" (a time column is not needed).
    """

    note: str
    draw: Callable[[Generator, Setting], Place]
    apply: Callable[[Effect, Scenario], Scenario]
    needs: str = ""


def draw_joint(rng: Generator, s: Setting, first: int = 0, last: int = 5) -> str:
    """Draw one of the turning joints, counted from the base."""
    return str(rng.choice(s.arm[first:last]))


def add_turn(s: Scenario, joint: str | None, shape: Callable[[Rows], Array], size: float) -> Scenario:
    """Add a function of the rows to what a joint's link really does."""
    j = joint_index(s.description, joint)

    def change(rows: Rows, q: Array) -> Array:
        q = q.copy()
        q[:, j] += size * shape(rows)
        return q

    return replace(s, transmission=(*s.transmission, change))


def add_bend(s: Scenario, joint: str, about: Array, drive: Callable[[Rows], Array]) -> Scenario:
    """Turn everything behind a joint about an axis of its link, by an angle known for every row."""
    way = (float(about[0]), float(about[1]), float(about[2]))
    s = s.add_spring(Spring(joint, "rx", 1e-12, direction=way))
    return replace(s, torques=(*s.torques, (len(s.springs) - 1, lambda rows: drive(rows) / 1e-12)))


def draw_unit(rng: Generator) -> list[float]:
    """Draw a direction. Shape (3,)."""
    v = rng.normal(size=3)
    return [float(x) for x in v / np.linalg.norm(v)]
