"""compplan: make industrial robots cut where the CAM says.

    import compplan as cp

    job = cp.load_job("paths/isf_cone.toml")
    plan = cp.plan_job(job)
    print(plan.status, plan.before.max_deviation, plan.after.max_deviation)
    cp.write_plan(plan, "out")

or from parts: `load_robot`, `read_toolpath`, `place_toolpath`, `plan_compensation`, `build_cell`, `evaluate_run`.
Names are imported from their modules when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from compplan.cell.cell import Cell, build_cell, run_cell, standard_cells
    from compplan.errors import CompplanError, InfeasibleError, InputError
    from compplan.job.job import Job, check_job, load_job, load_nominal
    from compplan.outputs.plan import write_comparison, write_plan
    from compplan.path.reading import read_toolpath
    from compplan.path.toolpath import Toolpath, place_toolpath, write_toolpath
    from compplan.plan.compare import Comparison, compare_job, compare_task
    from compplan.plan.evaluate import Evaluation, evaluate_run, path_accuracy
    from compplan.plan.nlp import build_nlp, solve_nlp
    from compplan.plan.path_problem import PathProblem, Rows
    from compplan.plan.plan import Plan, PlanOptions, build_task, plan_compensation, plan_job, plan_task
    from compplan.robot import Robot, load_robot

__version__ = "0.1.0"

_MODULES = {
    "cell.cell": ("Cell", "build_cell", "run_cell", "standard_cells"),
    "plan.compare": ("Comparison", "compare_job", "compare_task"),
    "errors": ("CompplanError", "InfeasibleError", "InputError"),
    "plan.evaluate": ("Evaluation", "evaluate_run", "path_accuracy"),
    "job.job": ("Job", "check_job", "load_job", "load_nominal"),
    "plan.nlp": ("build_nlp", "solve_nlp"),
    "plan.path_problem": ("PathProblem", "Rows"),
    "outputs.plan": ("write_comparison", "write_plan"),
    "plan.plan": ("Plan", "PlanOptions", "build_task", "plan_compensation", "plan_job", "plan_task"),
    "robot": ("Robot", "load_robot"),
    "path.reading": ("read_toolpath",),
    "path.toolpath": ("Toolpath", "place_toolpath", "write_toolpath"),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "Cell",
    "Comparison",
    "CompplanError",
    "Evaluation",
    "InfeasibleError",
    "InputError",
    "Job",
    "PathProblem",
    "Plan",
    "PlanOptions",
    "Robot",
    "Rows",
    "Toolpath",
    "build_cell",
    "build_nlp",
    "build_task",
    "check_job",
    "compare_job",
    "compare_task",
    "evaluate_run",
    "load_job",
    "load_nominal",
    "load_robot",
    "path_accuracy",
    "place_toolpath",
    "plan_compensation",
    "plan_job",
    "plan_task",
    "read_toolpath",
    "run_cell",
    "solve_nlp",
    "standard_cells",
    "write_comparison",
    "write_plan",
    "write_toolpath",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'compplan' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"compplan.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
