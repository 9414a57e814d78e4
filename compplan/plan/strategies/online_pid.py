"""Online elastic correction by a PID law, see `online_correction`."""

from __future__ import annotations

from dataclasses import replace

from compplan.plan.strategies.answer import Answer
from compplan.plan.strategies.online_correction import PID
from compplan.plan.strategies.path_map import PathMaps, correct_by_wrench
from compplan.plan.task import PlanTask

words = "online loop (PID)"


def prepare(task: PlanTask, maps: PathMaps) -> Answer:
    """Correct online by a PID law."""
    answer = correct_by_wrench("online_pid", "the full stiffness model", task, maps.full)
    return replace(answer, commands="the same through a PID law at 100 Hz, lag and delay", loop=PID)
