"""Compensation strategies, one file each.

Each file holds what it is called in `words` and `command_path(task) -> Command`: from the task (robot model, nominal
path, predicted wrench, limits) to the joint positions that are sent. A new strategy is one new file and one line in
`compplan.job.names`.
"""

from __future__ import annotations

from typing import Protocol

from compplan.errors import UnknownNameError
from compplan.io.registry import Registry
from compplan.job import names
from compplan.planning.task import Command, PlanTask


class Strategy(Protocol):
    """Interface of the file of a strategy; `words` is its name on pages."""

    def command_path(self, task: PlanTask) -> Command:
        """Command the path of a task."""
        ...


#: Every strategy of a plan, by the name of its file.
STRATEGIES: Registry[Strategy] = names.STRATEGIES.held_by(__name__)


def command_path(task: PlanTask, strategy: str) -> Command:
    """Correct a path by a strategy.

    Raises:
        UnknownNameError: If there is no such strategy.

    """
    if strategy not in STRATEGIES:
        raise UnknownNameError("strategy", strategy, list(STRATEGIES))
    return STRATEGIES[strategy].command_path(task)
