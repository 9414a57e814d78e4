"""compplan: correct robot programs so that the loaded tool follows the CAM path.

One verb for each daily way from files, arrays or DataFrames to a result:

    import compplan as cp

    plan = cp.plan("paths/isf_cone.toml")                         # a job, or a path and a robot
    done = cp.post("part.nc", robot=.., part=.., program="krl")   # from a CAM file to the program
    comparison = cp.compare("paths/isf_cone.toml")                # every strategy side by side
    diagnosis = cp.diagnose("measurements.csv", "my_robot")       # what is wrong with the robot
    updated = cp.learn("job.toml", "part1.csv", "my_robot")        # the next program, from a measured part
    print(plan); plan.plot(); plan.to_frame(); plan.to_dict(); cp.write_plan(plan, "out")

`out="folder"` writes what the command of the same name writes. Long calls take `progress`, a callable that is given
what is being done; an exception raised in it ends the call, nothing is written.

The steps below each verb are here too: `load_job`, `plan_job`, `plan_compensation`; `read_campaign`,
`diagnose_campaign`; `build_simulated_robot`, `evaluate_run`. Everything else is imported from its module. Names are
loaded when they are first used.
"""

from __future__ import annotations

import ast as _ast
from importlib import import_module as _import_module
from pathlib import Path as _Path
from typing import TYPE_CHECKING
from typing import Any as _Any

from compplan.version import VERSION

if TYPE_CHECKING:
    from compplan.api.verbs import Posted, compare, diagnose, learn, plan, post
    from compplan.controllers.writers import Program, build_program, write_program
    from compplan.diagnosis.campaign_diagnosis import diagnose_campaign
    from compplan.diagnosis.results.next_measurement import propose_measurements
    from compplan.diagnosis.results.result import Diagnosis
    from compplan.diagnosis.results.where import split_diagnosis as split_diagnosis
    from compplan.effects import EFFECTS, Effect, fold_effects
    from compplan.errors import CompplanError, InfeasibleError, InputError
    from compplan.identification.campaign import Identification, identify_campaign
    from compplan.job.job import Job, check_job, load_job
    from compplan.job.loading import ForcePrediction, predict_forces
    from compplan.job.operations import split_job
    from compplan.learning.campaign import design_campaign
    from compplan.learning.part import LearnedPart, learn_from_part
    from compplan.measurement.campaign import Campaign
    from compplan.measurement.reading import read_campaign
    from compplan.planning.compare import Comparison
    from compplan.planning.evaluate import evaluate_run
    from compplan.planning.plan import Plan, PlanOptions, plan_compensation, plan_job
    from compplan.planning.posture.place import place_part
    from compplan.reporting.compare import write_comparison
    from compplan.reporting.maps.survey import map_robot
    from compplan.reporting.montecarlo import write_study
    from compplan.reporting.operations import write_operations
    from compplan.reporting.writers.plan import write_plan
    from compplan.robot import Robot, load_robot, write_robot_folder
    from compplan.simulation.predict import Prediction, predict_campaign
    from compplan.simulation.simulated_robot import (
        Evaluation,
        SimulatedRobot,
        build_simulated_robot,
        run_simulated_robot,
    )
    from compplan.studies.job_study import JobStudy, compare_job, study_job
    from compplan.studies.runner import Settings
    from compplan.studies.study import prepare_study as prepare_study
    from compplan.toolpath.reading import read_toolpath
    from compplan.toolpath.toolpath import Toolpath, place_toolpath, write_toolpath

__version__ = VERSION

#: The module of each name, without "compplan.": the imports above are read from the text, so that a name stands once.
_IMPORTS = {
    alias: node.module.removeprefix("compplan.")
    for node in _ast.walk(_ast.parse(_Path(__file__).read_text(encoding="utf-8")))
    if isinstance(node, _ast.ImportFrom) and node.module and node.module.startswith("compplan.")
    for alias in node.names
    if alias.name != "VERSION"
}
_HOME = {alias.name: module for alias, module in _IMPORTS.items()}
#: Public names; an import "X as X" is of a step that only notebooks of this repository need.
__all__ = [alias.name for alias in _IMPORTS if alias.asname is None]


def __getattr__(name: str) -> _Any:
    if name not in _HOME:
        raise AttributeError(f"module 'compplan' has no attribute {name!r}")
    value = getattr(_import_module(f"compplan.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
