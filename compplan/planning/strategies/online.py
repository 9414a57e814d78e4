"""The strategies of a study: those of a plan, which command blindly, and those that read sensors while the part is cut.

A new online strategy is one new file with `prepare(task, maps) -> Answer` and one line in
`compplan.job.names`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from compplan.errors import UnknownNameError
from compplan.io.plugins import Registry
from compplan.job import names
from compplan.planning.strategies import STRATEGIES, command_path
from compplan.planning.strategies.answer import Answer
from compplan.planning.strategies.path_map import PathMaps
from compplan.planning.task import PlanTask


class OnlineStrategy(Protocol):
    """What the file of a strategy that reads sensors offers; `words` say in a few words what it is, on pages."""

    def prepare(self, task: PlanTask, maps: PathMaps) -> Answer:
        """Prepare for a task, from its own model of the robot."""
        ...


#: Every strategy that reads sensors, by the name of its file.
ONLINE: Registry[OnlineStrategy] = names.ONLINE.held_by(str(__package__))

_OFFLINE_KNOWLEDGE = {"none": "geometry"}


def list_strategies() -> tuple[str, ...]:
    """List every strategy of a study by name: those of a plan, and those that read sensors."""
    return (*STRATEGIES, *ONLINE)


def prepare_answers(task: PlanTask, strategies: Sequence[str] | None = None) -> dict[str, Answer]:
    """Let strategies prepare themselves for a task.

    Args:
        task: The task.
        strategies: Names of the strategies; all if left out.

    Raises:
        UnknownNameError: If there is no such strategy.
        InputError: If a strategy does not suit the robot.

    """
    maps, answers = PathMaps(task), {}
    for name in list_strategies() if strategies is None else strategies:
        if name in ONLINE:
            answers[name] = ONLINE[name].prepare(task, maps)
        elif name in STRATEGIES:
            command = command_path(task, name)
            answers[name] = Answer(
                name=name,
                knows=_OFFLINE_KNOWLEDGE.get(name, "the full stiffness model and the predicted wrench"),
                measures="nothing",
                commands="a joint program made beforehand",
                q=command.q,
            )
        else:
            raise UnknownNameError("strategy", name, list(list_strategies()))
    return {name: replace(answer, touched=task.touched) for name, answer in answers.items()}
