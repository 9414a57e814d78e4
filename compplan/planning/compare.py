"""Comparison of strategies: command of each strategy on each simulated robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from compplan.io.display import Curve, Curves, Shown
from compplan.io.provenance import describe_origin
from compplan.io.quantities import format_mm
from compplan.job.job import Job
from compplan.measurement.distance import LEVEL
from compplan.planning.evaluate import evaluate_run
from compplan.planning.strategies import ONLINE, command_path, list_strategies
from compplan.planning.task import Command, PlanTask
from compplan.robot import Array
from compplan.simulation.simulated_robot import (
    AS_MODELLED,
    EXACT_EVALUATION,
    Evaluation,
    SimulatedRobot,
    build_simulated_robot,
    standard_variants,
)
from compplan.statics.encoders import feedback_gain, hold_robot

#: Relative difference below which deviations are equal (assumed).
SAME = 0.05


@dataclass(frozen=True, eq=False)
class MonteCarloResult:
    """Remaining deviations of strategies in a Monte Carlo study with random robots, forces and sensors."""

    source: str  #: Source of the standard deviations.
    rms: Mapping[str, Array]  #: By strategy: rms deviation over the cut of every random robot. Shape (draws,). [m]
    greatest: Mapping[str, float]  #: By strategy: greatest deviation over the cut that 95 % of the robots keep. [m]
    interval: Mapping[str, tuple[float, float]]  #: By strategy: 95 % interval of the median. [m]

    def median(self, strategy: str) -> float:
        """Return the median over the robots. [m]"""
        return float(np.median(self.rms[strategy]))

    def most(self, strategy: str) -> float:
        """Return the 95 % quantile over the robots. [m]"""
        return float(np.quantile(self.rms[strategy], LEVEL))


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Comparison of strategies on a task."""

    name: str  #: Name of the job.
    task: PlanTask  #: Robot, nominal path, predicted wrench, posture, limits.
    cells: tuple[SimulatedRobot, ...]  #: Simulated robots; the first equals the planner's model.
    commands: Mapping[str, Command]  #: Command of each strategy.
    evaluations: Mapping[str, Mapping[str, Evaluation]]  #: By robot name and strategy: deviation of the run.
    job: Job | None = None  #: The job, or None.
    drawn: MonteCarloResult | None = None  #: Deviations on robots sampled from the folder's uncertainty, or None.

    @property
    def as_modelled(self) -> Mapping[str, Evaluation]:
        """Evaluations on the simulated robot that equals the planner's model."""
        return self.evaluations[AS_MODELLED]

    @property
    def least(self) -> tuple[str, ...]:
        """Offline strategies with the least deviation, on sampled robots if any, otherwise as modelled."""
        drawn = self.drawn
        left = {name: run.rms_deviation if drawn is None else drawn.median(name)
                for name, run in self.as_modelled.items() if name not in ONLINE}  # fmt: skip
        bound = (1.0 + SAME) * min(left.values())
        return tuple(name for name, value in left.items() if value <= bound)

    def summary(self) -> list[tuple[str, str]]:
        """Return the remaining deviation of each strategy."""
        drawn, rows = self.drawn, []
        for name, run in self.as_modelled.items():
            words = f"rms {format_mm(run.rms_deviation)} as modelled"
            if drawn is not None:
                words += f", {format_mm(drawn.median(name))} on a typical robot, {format_mm(drawn.most(name))} on 95 % "
                words += "of robots"
            rows.append((name, words if self.commands[name].status == "solved" else f"{words}; infeasible"))
        names = self.least
        text = f"{names[0]} leaves least"
        if len(names) > 1:
            text = f"{', '.join(names[:-1])} and {names[-1]} leave the same"
        return [("comparison", f"{self.name}, {self.task.robot.name}: {text}"), *rows]

    def columns(self) -> dict[str, Any]:
        """Return a row per strategy and simulated robot: rms, mean and greatest deviation."""
        rows = [(strategy, cell.name, self.evaluations[cell.name][strategy].figures)
                for cell in self.cells for strategy in self.commands]  # fmt: skip
        figures = {f"{key}_mm": [row[2][key] for row in rows] for key in ("rms", "mean", "max")}
        return {"strategy": [row[0] for row in rows], "cell": [row[1] for row in rows], **figures}

    def curves(self) -> Curves:
        """Return the remaining deviation of each strategy along the path, as modelled. [mm]"""
        s, cut = self.task.nominal.arc_length * 1e3, self.task.cut
        lines = tuple(
            Curve(name, s, np.where(cut, np.maximum(run.distance, 1e-9), np.nan) * 1e3, number)
            for number, (name, run) in enumerate(self.as_modelled.items())
        )
        return Curves(self.name, "along the path [mm]", "deviation of the tip [mm]", lines,
                      (self.task.tolerance * 1e3, "tolerance"), logarithmic=True)  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of compare.json."""
        nominal, *others = self.cells
        strategies: dict[str, dict[str, Any]] = {}

        def describe(cell: str, strategy: str) -> dict[str, float]:
            figures = self.evaluations[cell][strategy].figures
            return {f"{key}_mm": value for key, value in figures.items()}

        for strategy, command in self.commands.items():
            mismatch = [{"cell": cell.name, **describe(cell.name, strategy)} for cell in others]
            strategies[strategy] = {**describe(nominal.name, strategy), "status": command.status,
                                    "under_mismatch": mismatch}  # fmt: skip
            if (drawn := self.drawn) is not None:
                median, most = drawn.median(strategy), drawn.most(strategy)
                ends = [1e3 * end for end in drawn.interval[strategy]]
                strategies[strategy]["drawn_rms_mm"] = {"median": median * 1e3, "median_ci95": ends, "p95": most * 1e3}
        return {
            "schema": 1,
            "name": self.name,
            "robot": self.task.robot.name,
            "waypoints": len(self.task),
            "cell": nominal.name,
            "judge": EXACT_EVALUATION,
            **({"drawn_from": self.drawn.source} if self.drawn is not None else {}),
            "strategies": strategies,
            "made_by": describe_origin(),
        }


def compare_task(
    task: PlanTask, *, name: str = "path", announce: Callable[[str], None] = lambda text: None
) -> Comparison:
    """Correct a task by every strategy applicable to the robot, and run every command on every simulated robot.

    Simulated robots are as modelled, and with other compliances. Sensors of online strategies have no error here.
    """
    cells, commands = standard_variants(task.robot), dict[str, Command]()
    for strategy in list_strategies(task.robot):
        announce(f"command: {strategy}")
        commands[strategy] = command_path(task, strategy)
    evaluations: dict[str, dict[str, Evaluation]] = {}
    for cell in cells:
        for strategy, command in commands.items():
            announce(f"cell {cell.name}: {strategy}")
            held = cell
            if command.feedback != "motor":
                gain = feedback_gain(command.feedback, command.beta, task.robot.nq)
                held = build_simulated_robot(hold_robot(cell.robot, gain), cell.name)
            evaluations.setdefault(cell.name, {})[strategy] = evaluate_run(task, command.q, held)
    return Comparison(name, task, cells, commands, evaluations)
