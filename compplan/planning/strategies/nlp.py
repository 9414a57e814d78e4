"""Compensation by the nonlinear program: exact where possible, within all limits.

`compplan.planning` solves the program at stations of the path and refines its solution at every waypoint. Waypoints
that cannot keep the limits fail; the command there is as near to the path as the limits allow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compplan.effects.backlash import lead_play, list_plays, without_play
from compplan.planning.dense import KEPT, correct_pose, solve_path
from compplan.planning.task import OUT_OF_REACH, Command, PlanTask, check_limits, name_failures
from compplan.robot import Array

words = "optimised (nlp)"


def command_path(task: PlanTask, near: Command | None = None) -> Command:
    """Solve for joint positions with the loaded tool on the path; `near`: warm start, a command for similar loads.

    Waypoints that cannot be reached within the limits make the status "infeasible"; they are listed as failures, and
    the command there is as near to the path as the limits allow.
    """
    real, task = task, without_lost_motion(task)
    found = solve_path(task, None if near is None else near.links)
    facts = found.describe()
    if near is not None and near.nlp:
        facts |= {name: near.nlp[name] + facts[name] for name in ("solves", "iterations", "cpu_s")}
    return _finish(real, found.q, found.missed, Command(found.q, solve_time=found.cpu, nlp=facts))


def approach_path(task: PlanTask) -> Command:
    """Command a path by Newton steps from the chosen posture; by the program if these violate a limit."""
    found = correct_command(task, Command(task.q_start))
    return command_path(task) if found.failures else found


def correct_command(task: PlanTask, command: Command) -> Command:
    """Update a command after a small change of the load, by Newton steps of least joint motion.

    Failed waypoints keep their joint positions.
    """
    failing = np.array(sorted(command.failures), int)
    return _finish(task, *correct_pose(without_lost_motion(task), command.links, failing), command)


def without_lost_motion(task: PlanTask) -> PlanTask:
    """Return the task without lost motion: link-side joint positions."""
    return replace(task, robot=without_play(task.robot))


def _finish(task: PlanTask, q: Array, missed: Array, command: Command) -> Command:
    """Compensate lost motion, and list waypoints that violate the pose equations or a limit.

    q: link side, shape (n, nq) [rad or m]; missed: their greatest pose errors, shape (n,). [m, rad]
    """
    failures = name_failures(task, q, np.flatnonzero(missed > KEPT))
    # at a contact whose correction is added at rest, the play is crossed before the cut
    contacts = np.flatnonzero(task.lead[:-1] & ~task.lead[1:] & ~task.leaving[:-1]) + 1
    lead = lead_play(task.robot, q, contacts.tolist()) if list_plays(task.robot).any() else 0.0
    q = q + lead
    if task.robot.effects:
        # lost motion at a reversal cannot be compensated; it does not count as out of reach: the evaluation includes it
        failures = {k: name for k, name in failures.items() if name != OUT_OF_REACH or task.missed[k]}
    failures |= check_limits(replace(task, missed=np.zeros_like(task.missed)), q).failures
    return replace(command, q=q, lead=lead, status="infeasible" if failures else "solved", failures=failures)
