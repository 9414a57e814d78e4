"""Where the axes turn back along a path, and what each turn costs at the tip by lost motion."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from compplan.planning.posture.motion import MotionFigures
from compplan.planning.posture.slides import LEAST_STROKE, TIMES_LOST, count_reversals
from compplan.planning.strategies.lost_motion import list_plays
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.chain import joint_jacobian, locate_frames

#: Turns of the spin that count. [rad]
SPIN_STROKE = float(np.radians(1.0))
#: Postures whose levers are looked at.
LOOKED_AT = 100


class Reversals(NamedTuple):
    """How often an axis turns back.

    Attributes:
        axis: Name of the joint, or "spin".
        slides: Whether it slides.
        turns: How often it turns back, ways shorter than thrice its lost motion left out.
        travel: How far it moves in all. [rad or m]
        lost: Its lost motion. [rad or m]
        assumed: Whether that is assumed.
        price: What one turn costs at the tip: lost motion times the joint's mean lever; 0 for the spin, whose joints
            count by themselves. [m]

    """

    axis: str
    slides: bool
    turns: int
    travel: float
    lost: float
    assumed: bool
    price: float

    def describe(self) -> dict[str, Any]:
        """Describe it for plan.json."""
        scale, unit = (1e3, "mm") if self.slides else (180.0 / np.pi, "deg")
        return {
            "axis": self.axis, "count": self.turns, f"travel_{unit}": scale * self.travel,
            f"lost_motion_{unit}": scale * self.lost, "lost_motion_assumed": self.assumed,
            "price_each_mm": 1e3 * self.price,
        }  # fmt: skip


def list_reversals(task: PlanTask, q: Array) -> tuple[Reversals, ...]:
    """List how often every joint, and the spin, turns back along a command.

    Args:
        task: The task.
        q: Commanded joint positions. Shape (n, nq). [rad or m]

    """
    robot, widths, figures = task.robot, list_plays(task.robot), MotionFigures()
    some = q[np.unique(np.linspace(0, len(q) - 1, min(len(q), LOOKED_AT)).astype(int))]
    columns = joint_jacobian(task.chain, locate_frames(task.chain, some))[:, :3]
    lever = np.sqrt(np.einsum("nij,nij->j", columns, columns) / len(some))
    assumed = np.where(robot.prismatic, LEAST_STROKE / TIMES_LOST, figures.lost)
    lost = np.where(widths > 0.0, widths, assumed)
    found = [
        Reversals(name, bool(robot.prismatic[j]), count_reversals(q[:, j], TIMES_LOST * float(lost[j])),
                  float(np.abs(np.diff(q[:, j])).sum()), float(lost[j]), bool(widths[j] == 0.0),
                  float(lost[j] * lever[j]))
        for j, name in enumerate(robot.joint_names)
    ]  # fmt: skip
    if task.start is not None and task.start.stance is not None:
        spin = task.start.stance.spin
        travel = float(np.abs(np.diff(spin)).sum())
        found.append(Reversals("spin", False, count_reversals(spin, SPIN_STROKE), travel, 0.0, False, 0.0))
    return tuple(found)


def describe_reversals(found: tuple[Reversals, ...]) -> str:
    """Say how often axes turn back and what each turn costs, the assumed figures named."""
    turning = [entry for entry in found if entry.turns]
    if not turning:
        return "none"
    parts = [f"{entry.axis} {entry.turns}" + (f" at {1e3 * entry.price:.2g} mm" if entry.price > 1e-9 else "")
             for entry in turning]  # fmt: skip
    return ", ".join(parts) + (" (lost motion assumed)" if any(entry.assumed for entry in turning) else "")
