"""Lost motion that a robot folder states: where each joint reverses along a path, and what its command leads by.

The link of a joint with play of width w follows its command q at q - s w / 2, s the side on which the command pushes:
1 as it rises, -1 as it falls. The command that puts the link where it has to be is q_link + s w / 2; at a reversal it
crosses the play at once. Swings too small to matter do not change the side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compplan.effects.backlash import CAME_FROM_BELOW, find_sides, is_play, list_plays, width_of
from compplan.planning.task import PlanTask
from compplan.robot import Array

#: Swings of a link that turn no side: this share of the play, and at least so much (assumed). [1, rad or m]
SWING, LEAST = 0.02, 1e-6


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
