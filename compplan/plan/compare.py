"""Strategies side by side: every strategy's command in every cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from compplan.cell.cell import AS_MODELLED, JUDGE, Cell, standard_cells
from compplan.job.job import Job
from compplan.plan.evaluate import Evaluation, evaluate_run
from compplan.plan.plan import build_task, prepare_job
from compplan.plan.strategies import STRATEGIES, command_path
from compplan.plan.task import Command, PlanTask


@dataclass(frozen=True)
class Comparison:
    """Strategies side by side, with everything that they were compared on.

    Attributes:
        name: Name of the job.
        task: Robot, nominal path, predicted wrench, posture, limits.
        cells: The cells; in the first the planner's model is the truth.
        commands: What each strategy commands.
        evaluations: By cell name and strategy, the run against the path.
        judge: Who computed the evaluations.
        job: The job, or None.

    """

    name: str
    task: PlanTask
    cells: tuple[Cell, ...]
    commands: Mapping[str, Command]
    evaluations: Mapping[str, Mapping[str, Evaluation]]
    judge: str = JUDGE
    job: Job | None = None

    @property
    def as_modelled(self) -> Mapping[str, Evaluation]:
        """The strategies in the cell where the planner's model is the truth."""
        return self.evaluations[AS_MODELLED]


def compare_job(job: Job, *, announce: Callable[[str], None] | None = None) -> Comparison:
    """Compare every strategy on a job.

    Args:
        job: The job.
        announce: Called with what is done next.

    Raises:
        InputError: If the job is not what it has to be, or the part is out of reach.

    """
    robot, nominal, options = prepare_job(job)
    task = build_task(robot, nominal, options, file=job.file)
    comparison = compare_task(task, name=job.name or job.file.stem, announce=announce)
    return replace(comparison, job=job)


def compare_task(
    task: PlanTask,
    *,
    name: str = "path",
    strategies: Sequence[str] | None = None,
    cells: Sequence[Cell] | None = None,
    announce: Callable[[str], None] | None = None,
) -> Comparison:
    """Let every strategy command a task, and run every command in every cell.

    Args:
        task: The task.
        name: What it is called.
        strategies: The strategies; all if left out.
        cells: The cells; left out: as modelled, and with compliances that differ from the model's.
        announce: Called with what is done next.

    """
    cells = tuple(cells) if cells is not None else standard_cells(task.robot)
    commands = {}
    for strategy in STRATEGIES if strategies is None else strategies:
        if announce:
            announce(f"command: {strategy}")
        commands[strategy] = command_path(task, strategy)
    evaluations: dict[str, dict[str, Evaluation]] = {}
    for cell in cells:
        for strategy, command in commands.items():
            if announce:
                announce(f"cell {cell.name}: {strategy}")
            evaluations.setdefault(cell.name, {})[strategy] = evaluate_run(task, command.q, cell)
    return Comparison(name, task, cells, commands, evaluations)
