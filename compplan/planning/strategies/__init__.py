"""Compensation strategies, one file each.

Each file holds its displayed name `words` and `command_path(task) -> Command`: from the task (robot model, nominal
path, predicted wrench, limits) to the commanded joint positions, and the sensor feedback of an online strategy. A new
strategy is one new file and one line in `compplan.job.names`.
"""

from __future__ import annotations

from typing import Protocol

from compplan.errors import UnknownNameError
from compplan.io.registry import Registry
from compplan.job import names
from compplan.planning.task import Command, PlanTask
from compplan.robot import Robot


class Strategy(Protocol):
    """Interface of a strategy's file."""

    words: str  #: Displayed name.

    def command_path(self, task: PlanTask) -> Command:
        """Compute the command for the path of a task."""
        ...


#: Offline strategies of a plan, and online ones, which read sensors during the cut; by file name.
STRATEGIES: Registry[Strategy] = names.STRATEGIES.held_by(__name__)
ONLINE: Registry[Strategy] = names.ONLINE.held_by(__name__)


def list_strategies(robot: Robot | None = None) -> tuple[str, ...]:
    """List the names of all offline and online strategies; with a robot, only those applicable to it."""
    gears = robot is None or any(spring.actuator for spring in robot.springs)
    return tuple(name for name in (*STRATEGIES, *ONLINE) if gears or "encoder" not in name)


def command_path(task: PlanTask, strategy: str, *, online: bool = True) -> Command:
    """Compute the command for a path by a strategy; online: whether it may read sensors during the cut.

    Raises:
        UnknownNameError: If there is no such strategy.
        InputError: If the strategy is not applicable to the robot.
    """
    if strategy not in (known := list_strategies() if online else tuple(STRATEGIES)):
        raise UnknownNameError("strategy", strategy, list(known))
    return (STRATEGIES.get(strategy) or ONLINE[strategy]).command_path(task)
