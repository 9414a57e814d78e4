"""Strategies side by side: every strategy's command in every cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compplan.io.display import Curve, Curves, Shown
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_length
from compplan.job.job import Job
from compplan.measurement.distance import LEVEL
from compplan.planning.evaluate import Evaluation, evaluate_run
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.strategies import STRATEGIES, command_path
from compplan.planning.task import Command, PlanTask
from compplan.robot import Array
from compplan.simulation.simulated_robot import AS_MODELLED, JUDGE, SimulatedRobot, standard_variants
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import draw_paths, linearise_path
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model, read_force_spread

#: Robots and forces that are drawn.
DRAWS = 200
#: Strategies that differ by less than this share leave the same (assumed).
SAME = 0.05


@dataclass(frozen=True, eq=False)
class Drawn:
    """What strategies leave on robots drawn from what is known of the robot, and with forces drawn from the job's.

    Attributes:
        source: Where the widths come from.
        rms: By strategy, rms deviation over the cut of every drawn robot. Shape (draws,). [m]
    """

    source: str
    rms: Mapping[str, Array]

    def median(self, strategy: str) -> float:
        """Return what every second robot stays below. [m]."""
        return float(np.median(self.rms[strategy]))

    def most(self, strategy: str) -> float:
        """Return what 95 % of the robots stay below. [m]."""
        return float(np.quantile(self.rms[strategy], LEVEL))


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Strategies side by side, with everything that they were compared on.

    Attributes:
        name: Name of the job.
        task: Robot, nominal path, predicted wrench, posture, limits.
        cells: The cells; in the first the planner's model is the truth.
        commands: What each strategy commands.
        evaluations: By cell name and strategy, the run against the path.
        judge: Who computed the evaluations.
        job: The job, or None.
        drawn: What the strategies leave on robots drawn from the folder's own uncertainty, or None.

    """

    name: str
    task: PlanTask
    cells: tuple[SimulatedRobot, ...]
    commands: Mapping[str, Command]
    evaluations: Mapping[str, Mapping[str, Evaluation]]
    judge: str = JUDGE
    job: Job | None = None
    drawn: Drawn | None = None

    @property
    def as_modelled(self) -> Mapping[str, Evaluation]:
        """The strategies in the cell where the planner's model is the truth."""
        return self.evaluations[AS_MODELLED]

    @property
    def least(self) -> tuple[str, ...]:
        """The strategies that leave least, on drawn robots where there are any, else as modelled."""
        drawn = self.drawn
        left = {name: run.rms_deviation if drawn is None else drawn.median(name)
                for name, run in self.as_modelled.items()}  # fmt: skip
        bound = (1.0 + SAME) * min(left.values())
        return tuple(name for name, value in left.items() if value <= bound)

    def summary(self) -> list[tuple[str, str]]:
        """Return what each strategy leaves."""
        drawn, rows = self.drawn, []
        for name, run in self.as_modelled.items():
            words = f"rms {format_length(run.rms_deviation)} as modelled"
            if drawn is not None:
                words += f"; {format_length(drawn.median(name))} on every second robot within the 95 % band, "
                words += f"{format_length(drawn.most(name))} on 95 % of them"
            rows.append((name, words if self.commands[name].status == "solved" else f"{words}; infeasible"))
        names = self.least
        said = f"{names[0]} leaves least"
        if len(names) > 1:
            said = f"{', '.join(names[:-1])} and {names[-1]} leave the same"
        return [("comparison", f"{self.name}, {self.task.robot.name}: {said}"), *rows]

    def columns(self) -> dict[str, Any]:
        """Return a row a strategy and cell: rms, mean and greatest deviation."""
        rows = [(strategy, cell.name, self.evaluations[cell.name][strategy].figures)
                for cell in self.cells for strategy in self.commands]  # fmt: skip
        figures = {f"{key}_mm": [row[2][key] for row in rows] for key in ("rms", "mean", "max")}
        return {"strategy": [row[0] for row in rows], "cell": [row[1] for row in rows], **figures}

    def curves(self) -> Curves:
        """Return what each strategy leaves along the path, as modelled. [mm]."""
        s, cut = self.task.nominal.arc_length * 1e3, self.task.cut
        lines = tuple(
            Curve(name, s, np.where(cut, np.maximum(run.distance, 1e-9), np.nan) * 1e3, number)
            for number, (name, run) in enumerate(self.as_modelled.items())
        )
        return Curves(self.name, "along the path [mm]", "deviation of the tip [mm]", lines,
                      (self.task.tolerance * 1e3, "tolerance"), logarithmic=True)  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return what compare.json holds."""
        return summarise_comparison(self)


def compare_job(job: Job, *, announce: Callable[[str], None] = lambda text: None) -> Comparison:
    """Compare every strategy on a job; `announce` is called with what is done next."""
    announce("robot, toolpath and posture")
    robot, nominal, options = prepare_job(job)
    task = build_task(robot, nominal, options, file=job.file)
    comparison = compare_task(task, name=job.name or job.file.stem, announce=announce)
    announce("robots drawn from what is known")
    return replace(comparison, job=job, drawn=draw_strategies(comparison, read_force_spread(job)))


def draw_strategies(comparison: Comparison, force: ForceSpread, draws: int = DRAWS) -> Drawn:
    """Draw robots from what is known, to first order about the posture of the task; every strategy meets the same ones.

    A strategy that only plans leaves what it leaves as modelled, and beside it what the robot does otherwise.
    """
    task = comparison.task
    known = robot_uncertainty(task.robot)
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    slopes = linearise_path(scene, known, force, task.cut, touched=task.touched)
    moved = draw_paths(slopes, known, draws)
    left = {name: run.deviation[slopes.rows, :, None] + moved for name, run in comparison.as_modelled.items()}
    rms = {name: np.sqrt(np.mean(np.sum(tips**2, axis=1), axis=0)) for name, tips in left.items()}
    return Drawn(f"{known.source}; force {force.source}", rms)


def compare_task(
    task: PlanTask, *, name: str = "path", strategies: Sequence[str] | None = None,
    cells: Sequence[SimulatedRobot] | None = None, announce: Callable[[str], None] = lambda text: None,
) -> Comparison:  # fmt: skip
    """Let every strategy command a task, and run every command in every cell.

    Strategies and cells left out are all of them, and those as modelled and with compliances that differ.
    """
    cells = tuple(cells) if cells is not None else standard_variants(task.robot)
    commands = {}
    for strategy in STRATEGIES if strategies is None else strategies:
        announce(f"command: {strategy}")
        commands[strategy] = command_path(task, strategy)
    evaluations: dict[str, dict[str, Evaluation]] = {}
    for cell in cells:
        for strategy, command in commands.items():
            announce(f"cell {cell.name}: {strategy}")
            evaluations.setdefault(cell.name, {})[strategy] = evaluate_run(task, command.q, cell)
    return Comparison(name, task, cells, commands, evaluations)


def summarise_comparison(comparison: Comparison) -> dict[str, Any]:
    """Return the content of compare.json."""
    nominal, *others = comparison.cells
    strategies = {}
    for strategy, evaluation in comparison.evaluations[nominal.name].items():
        mismatch = []
        for cell in others:
            figures = comparison.evaluations[cell.name][strategy].figures
            mismatch.append({"cell": cell.name, **{f"{key}_mm": value for key, value in figures.items()}})
        figures = {f"{key}_mm": value for key, value in evaluation.figures.items()}
        status = comparison.commands[strategy].status
        strategies[strategy] = {**figures, "status": status, "under_mismatch": mismatch}
        if (drawn := comparison.drawn) is not None:
            median, most = drawn.median(strategy), drawn.most(strategy)
            strategies[strategy]["drawn_rms_mm"] = {"median": median * 1e3, "p95": most * 1e3}
    return {
        "schema": 1,
        "name": comparison.name,
        "robot": comparison.task.robot.name,
        "waypoints": len(comparison.task),
        "cell": nominal.name,
        "judge": comparison.judge,
        **({"drawn_from": comparison.drawn.source} if comparison.drawn is not None else {}),
        "strategies": strategies,
        "made_by": describe_origin(),
    }
