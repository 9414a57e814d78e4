"""Compensation strategies, one file each.

Each file holds `command_path(task) -> Command`: from the task (robot model, nominal path, predicted wrench, limits) to
the joint positions that are sent. A new strategy is one new file and one line here.
"""

from __future__ import annotations

from collections.abc import Callable

from compplan.errors import UnknownNameError
from compplan.plan.strategies import iterated_mirror, mirror, nlp, none
from compplan.plan.task import Command, PlanTask

#: Every strategy of a plan, by name.
STRATEGIES: dict[str, Callable[[PlanTask], Command]] = {
    "none": none.command_path,
    "mirror": mirror.command_path,
    "iterated_mirror": iterated_mirror.command_path,
    "nlp": nlp.command_path,
}


def command_path(task: PlanTask, strategy: str) -> Command:
    """Let a strategy command a path.

    Raises:
        UnknownNameError: If there is no such strategy.

    """
    if strategy not in STRATEGIES:
        raise UnknownNameError("strategy", strategy, list(STRATEGIES))
    return STRATEGIES[strategy](task)


__all__ = ["STRATEGIES", "command_path"]
