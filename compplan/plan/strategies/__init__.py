"""Compensation strategies, one file each.

Each file holds `command_path(task) -> Command`: from the task (robot model, nominal path, predicted wrench, limits) to
the joint positions that are sent. A new strategy is one new file and one line in `compplan.job.names`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from compplan.errors import UnknownNameError
from compplan.job.names import STRATEGIES
from compplan.plan.task import Command, PlanTask


def load_strategy(name: str) -> Callable[[PlanTask], Command]:
    """Find the function of a strategy by its name.

    Raises:
        UnknownNameError: If there is no such strategy.

    """
    if name not in STRATEGIES:
        raise UnknownNameError("strategy", name, list(STRATEGIES))
    function: Callable[[PlanTask], Command] = import_module(STRATEGIES[name]).command_path
    return function


def command_path(task: PlanTask, strategy: str) -> Command:
    """Let a strategy command a path.

    Raises:
        UnknownNameError: If there is no such strategy.

    """
    return load_strategy(strategy)(task)


__all__ = ["STRATEGIES", "command_path", "load_strategy"]
