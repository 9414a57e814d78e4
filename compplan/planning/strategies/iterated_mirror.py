"""Iterated mirror compensation: repeat until the model predicts no deviation."""

from __future__ import annotations

from compplan.planning.strategies.mirror import mirror_deviation
from compplan.planning.task import Command, PlanTask, check_limits

words = "iterated mirror"

MOST_PASSES = 20
#: Deviation below which the iteration has converged. [m]
CONVERGED = 1e-9


def command_path(task: PlanTask) -> Command:
    """Mirror the predicted deviation until it vanishes; return the last command if it does not."""
    q, position, rotation = task.q_start, task.position, task.rotation
    passes, deviation = 0, float("inf")
    while deviation >= CONVERGED and passes < MOST_PASSES:
        q, position, rotation, deviation = mirror_deviation(task, q, position, rotation)
        passes += 1
    return check_limits(task, q)
