"""Lost motion that a robot folder states: where each joint reverses along a path, and what its command leads by.

The link of a joint with play of width w follows its command q at q - s w / 2, s the side on which the command pushes:
1 as it rises, -1 as it falls. The command that puts the link where it has to be is q_link + s w / 2; at a reversal it
crosses the play at once. Swings too small to matter do not change the side.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compplan.effects.backlash import CAME_FROM_BELOW
from compplan.planning.posture.motion import (
    LEAST_STROKE,
    TIMES_LOST,
    MotionFigures,
    count_reversals,
    is_play,
    list_plays,
    width_of,
)
from compplan.planning.task import PlanTask
from compplan.robot import Array
from compplan.statics.chain import joint_jacobian, locate_frames
from compplan.toolpath.toolpath import pick_even

#: Swings of a link that turn no side: this share of the play, and at least so much (assumed). [1, rad or m]
SWING, LEAST = 0.02, 1e-6
#: A joint stands where it differs by less: rounding does not choose the row at which it turns. [rad or m]
STANDS = 1e-9


def without_play(task: PlanTask) -> PlanTask:
    """Return a task whose joints have no lost motion: the command of its links."""
    left = tuple(entry for entry in task.robot.effects if not is_play(entry))
    return replace(task, robot=replace(task.robot, effects=left))


def state_sides(task: PlanTask) -> PlanTask:
    """Return a task whose joints with lost motion stand at the first waypoint on the side of their first motion.

    The approach brings them there (`cross_first`). A path that begins with a rapid move takes them along.
    """
    widths = list_plays(task.robot)
    if not widths.any() or task.nominal.rapid[0]:
        return task
    effects = []
    for entry in task.robot.effects:
        if is_play(entry):
            joint = task.robot.joint_names.index(str(entry["joint"]))
            away = task.q_start[:, joint] - task.q_start[0, joint]
            far = np.flatnonzero(np.abs(away) > max(SWING * widths[joint], LEAST))
            side = float(np.sign(away[far[0]])) if len(far) else -2.0 * CAME_FROM_BELOW
            entry = {**entry, "parameters": {**entry["parameters"], "start_ratio": -0.5 * side}}
        effects.append(entry)
    return replace(task, robot=replace(task.robot, effects=tuple(effects)))


def cross_first(task: PlanTask) -> Array:
    """Return what takes a command at the first waypoint to the other side of each lost motion. Shape (nq,). [rad or m]

    From there the command pushes the links to the side on which the path begins, whichever way they came.
    """
    return -2.0 * lead_play(task, task.q_start[:1])[0]


def lead_play(task: PlanTask, links: Array) -> Array:
    """Return what a command adds to the links' positions to push them there. Shape (n, nq). [rad or m]

    links: where the links have to be, everything but lost motion compensated. Shape (n, nq). [rad or m]
    """
    lead = np.zeros_like(links)
    for entry in filter(is_play, task.robot.effects):
        index, width = task.robot.joint_names.index(str(entry["joint"])), width_of(entry)
        first = -np.sign(float(entry["parameters"].get("start_ratio", CAME_FROM_BELOW))) or 1.0
        sides = find_sides(links[:, index], max(SWING * width, LEAST), float(first))
        if len(sides) > 1:  # at a contact whose correction came in at rest the play is crossed before the cut
            contact = np.flatnonzero(task.lead[:-1] & ~task.lead[1:] & ~task.leaving[:-1]) + 1
            contact = contact[contact < len(sides) - 1]
            sides[contact] = sides[contact + 1]
        lead[:, index] += 0.5 * width * sides
    return lead


def find_crossings(q: Array, links: Array) -> NDArray[np.bool_]:
    """Tell which moves cross lost motion: a command leads its links by another amount than before. Shape (n - 1,)."""
    return np.asarray((np.abs(np.diff(q - links, axis=0)) > 0.5 * LEAST).any(axis=1))


def find_sides(position: Array, swing: float, first: float) -> Array:
    """Return on which side a joint is pushed at every row: 1 rising, -1 falling. Shape (n,).

    A joint turns at the farthest row before it goes back by more than a swing [rad or m]; that row is still pushed from
    before. `first` is the side at the first row.
    """
    sides, side, far = np.empty(len(position)), first, 0
    values = position.tolist()
    begin, most = 0, values[0] if values else 0.0
    for row, value in enumerate(values):
        if side * (value - most) >= -STANDS:
            far, most = row, max(value, most) if side > 0.0 else min(value, most)
        elif side * (most - value) > swing:
            sides[begin : far + 1] = side
            begin, side, far, most = far + 1, -side, row, value
    sides[begin:] = side
    return sides


#: Turns of the spin that count. [rad]
SPIN_STROKE = float(np.radians(1.0))
#: Postures whose levers are looked at.
LOOKED_AT = 100


class Reversals(NamedTuple):
    """How often an axis turns back."""

    axis: str  #: Name of the joint, or "spin".
    slides: bool  #: Whether it slides.
    turns: int  #: How often it turns back, ways shorter than thrice its lost motion left out.
    travel: float  #: How far it moves in all. [rad or m]
    lost: float  #: Its lost motion. [rad or m]
    assumed: bool  #: Whether that is assumed.
    #: What one turn costs at the tip: lost motion times the joint's mean lever; 0 for the spin, whose joints count by
    #: themselves. [m]
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
    """List how often every joint, and the spin, turns back along a command (n, nq)."""
    robot, widths, figures = task.robot, list_plays(task.robot), MotionFigures()
    some = pick_even(q, LOOKED_AT)
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
    if task.start is not None and task.start.posture_choice is not None:
        spin = task.start.posture_choice.spin
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
