"""Compensation strategies, one file each.

Each file holds its displayed name `words` and `command_path(task) -> Command`: from the task (robot model, nominal
path, predicted wrench, limits) to the commanded joint positions. A new strategy is one new file and one line in
`compplan.job.names`.
"""

from __future__ import annotations

from typing import Protocol

from compplan.errors import UnknownNameError
from compplan.io.registry import Registry
from compplan.job import names
from compplan.planning.task import Command, PlanTask


class Strategy(Protocol):
    """Interface of a strategy's file; `words` is the displayed name."""

    def command_path(self, task: PlanTask) -> Command:
        """Compute the command for the path of a task."""
        ...


#: Every strategy of a plan, by file name.
STRATEGIES: Registry[Strategy] = names.STRATEGIES.held_by(__name__)


def command_path(task: PlanTask, strategy: str) -> Command:
    """Compute the command for a path by a strategy.

    Raises:
        UnknownNameError: If there is no such strategy.

    """
    if strategy not in STRATEGIES:
        raise UnknownNameError("strategy", strategy, list(STRATEGIES))
    return STRATEGIES[strategy].command_path(task)
