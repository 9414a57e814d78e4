"""compplan: make industrial robots cut where the CAM says.

Planning:

    import compplan as cp

    job = cp.load_job("paths/isf_cone.toml")
    plan = cp.plan_job(job)
    print(plan.status, plan.before.max_deviation, plan.after.max_deviation)
    cp.write_plan(plan, "out")

or native programs alone, from joint positions: `build_program`, `write_program`;
or from parts: `load_robot`, `read_toolpath`, `place_toolpath`, `plan_compensation`, `build_cell`, `evaluate_run`.

Diagnosis:

    robot = cp.load_robot("robot")
    campaign = cp.read_campaign("measurements.csv", robot)
    diagnosis = cp.diagnose_campaign(robot, campaign)
    print(diagnosis.verdict.status, diagnosis.gap.held_out_after)
    cp.predict_campaign(diagnosis.updated, campaign).position

with `Effect` and `fold_effects` to make a robot that is not as modelled, and `identify_campaign` for its compliances.

Studies:

    study = cp.study_job(job, cp.Settings(samples=200, seed=1), "out")
    cp.write_study(study, "out")

Long calls take a callable that is told what is being done; an exception raised in it ends the call, nothing is written.
Names are imported from their modules when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from compplan.version import VERSION

if TYPE_CHECKING:
    from compplan.cell.cell import Cell, build_cell, run_cell, standard_cells
    from compplan.cell.predict import Prediction, predict_campaign, write_prediction
    from compplan.diagnose.campaign_diagnosis import diagnose_campaign
    from compplan.diagnose.next_measurement import propose_measurements
    from compplan.diagnose.result import Diagnosis
    from compplan.diagnose.where import split_diagnosis
    from compplan.effects import EFFECTS, Effect, apply_effects, attain_scene, fold_effects, robot_effects, stage_scene
    from compplan.errors import CompplanError, InfeasibleError, InputError
    from compplan.identify.campaign import Identification, identify_campaign
    from compplan.identify.problem import IdentifyOptions
    from compplan.job.force_prediction import ForcePrediction, predict_forces
    from compplan.job.job import Job, check_job, load_job
    from compplan.job.loading import load_nominal
    from compplan.loop.campaign import PoseCampaign, Shop, design_campaign
    from compplan.loop.teach import Teaching, teach_part
    from compplan.maps.survey import MapSettings, RobotMaps, map_robot
    from compplan.measure.campaign import Campaign
    from compplan.measure.reading import read_campaign
    from compplan.measure.registration import Registration, fit_registration
    from compplan.outputs.identify import write_identification
    from compplan.outputs.montecarlo import write_study
    from compplan.outputs.plan import write_comparison, write_plan
    from compplan.path.events import Event
    from compplan.path.reading import read_toolpath
    from compplan.path.toolpath import Toolpath, place_toolpath, write_toolpath
    from compplan.plan.closed_loop import TimeCell, run_in_time
    from compplan.plan.compare import Comparison, compare_job, compare_task
    from compplan.plan.correction_loop import largest_pole
    from compplan.plan.evaluate import Evaluation, evaluate_run, path_accuracy
    from compplan.plan.nlp import build_nlp, solve_nlp
    from compplan.plan.path_problem import PathProblem, Rows
    from compplan.plan.plan import (
        Plan,
        PlanOptions,
        build_task,
        job_robot,
        plan_compensation,
        plan_job,
        plan_task,
        prepare_job,
    )
    from compplan.plan.strategies.online_correction import LOOPS
    from compplan.posture.place import PlaceResult, place_part
    from compplan.program import Program, Wiring, build_program, write_program
    from compplan.robot import Robot, load_robot, write_robot_folder
    from compplan.robot.skeleton import write_skeleton
    from compplan.statics.chain import build_chain, joint_jacobian, locate_frames
    from compplan.statics.elastic import solve_equilibrium
    from compplan.study.curves import trace_model_error
    from compplan.study.encoder_table import compare_encoders
    from compplan.study.job_study import JobStudy, study_job
    from compplan.study.runner import Run, Settings, run_study
    from compplan.study.sensitivity import measure_sensitivity
    from compplan.study.study import Study, prepare_study
    from compplan.study.summary import summarise_run

__version__ = VERSION

_MODULES = {
    "cell.cell": ("Cell", "build_cell", "run_cell", "standard_cells"),
    "cell.predict": ("Prediction", "predict_campaign", "write_prediction"),
    "diagnose.campaign_diagnosis": ("diagnose_campaign",),
    "diagnose.result": ("Diagnosis",),
    "effects": (
        "EFFECTS", "Effect", "apply_effects", "attain_scene", "fold_effects", "robot_effects", "stage_scene",
    ),
    "errors": ("CompplanError", "InfeasibleError", "InputError"),
    "identify.campaign": ("Identification", "identify_campaign"),
    "identify.problem": ("IdentifyOptions",),
    "job.job": ("Job", "check_job", "load_job"),
    "job.loading": ("load_nominal",),
    "measure.campaign": ("Campaign",),
    "measure.reading": ("read_campaign",),
    "measure.registration": ("Registration", "fit_registration"),
    "outputs.identify": ("write_identification",),
    "outputs.montecarlo": ("write_study",),
    "outputs.plan": ("write_comparison", "write_plan"),
    "path.events": ("Event",),
    "path.reading": ("read_toolpath",),
    "program": ("Program", "Wiring", "build_program", "write_program"),
    "path.toolpath": ("Toolpath", "place_toolpath", "write_toolpath"),
    "plan.compare": ("Comparison", "compare_job", "compare_task"),
    "plan.evaluate": ("Evaluation", "evaluate_run", "path_accuracy"),
    "plan.nlp": ("build_nlp", "solve_nlp"),
    "plan.path_problem": ("PathProblem", "Rows"),
    "plan.plan": (
        "Plan", "PlanOptions", "build_task", "job_robot", "plan_compensation", "plan_job", "plan_task", "prepare_job",
    ),
    "robot": ("Robot", "load_robot", "write_robot_folder"),
    "study.job_study": ("JobStudy", "study_job"),
    "study.runner": ("Run", "Settings", "run_study"),
    "study.study": ("Study", "prepare_study"),
    "study.summary": ("summarise_run",),
    "diagnose.next_measurement": ("propose_measurements",),
    "diagnose.where": ("split_diagnosis",),
    "job.force_prediction": ("ForcePrediction", "predict_forces"),
    "loop.campaign": ("PoseCampaign", "Shop", "design_campaign"),
    "loop.teach": ("Teaching", "teach_part"),
    "maps.survey": ("MapSettings", "RobotMaps", "map_robot"),
    "plan.closed_loop": ("TimeCell", "run_in_time"),
    "plan.correction_loop": ("largest_pole",),
    "plan.strategies.online_correction": ("LOOPS",),
    "posture.place": ("PlaceResult", "place_part"),
    "robot.skeleton": ("write_skeleton",),
    "statics.chain": ("build_chain", "joint_jacobian", "locate_frames"),
    "statics.elastic": ("solve_equilibrium",),
    "study.curves": ("trace_model_error",),
    "study.encoder_table": ("compare_encoders",),
    "study.sensitivity": ("measure_sensitivity",),
}  # fmt: skip
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "EFFECTS",
    "LOOPS",
    "Campaign",
    "Cell",
    "Comparison",
    "CompplanError",
    "Diagnosis",
    "Effect",
    "Evaluation",
    "Event",
    "ForcePrediction",
    "Identification",
    "IdentifyOptions",
    "InfeasibleError",
    "InputError",
    "Job",
    "JobStudy",
    "MapSettings",
    "PathProblem",
    "PlaceResult",
    "Plan",
    "PlanOptions",
    "PoseCampaign",
    "Prediction",
    "Program",
    "Registration",
    "Robot",
    "RobotMaps",
    "Rows",
    "Run",
    "Settings",
    "Shop",
    "Study",
    "Teaching",
    "TimeCell",
    "Toolpath",
    "Wiring",
    "apply_effects",
    "attain_scene",
    "build_cell",
    "build_chain",
    "build_nlp",
    "build_program",
    "build_task",
    "check_job",
    "compare_encoders",
    "compare_job",
    "compare_task",
    "design_campaign",
    "diagnose_campaign",
    "evaluate_run",
    "fit_registration",
    "fold_effects",
    "identify_campaign",
    "job_robot",
    "joint_jacobian",
    "largest_pole",
    "load_job",
    "load_nominal",
    "load_robot",
    "locate_frames",
    "map_robot",
    "measure_sensitivity",
    "path_accuracy",
    "place_part",
    "place_toolpath",
    "plan_compensation",
    "plan_job",
    "plan_task",
    "predict_campaign",
    "predict_forces",
    "prepare_job",
    "prepare_study",
    "propose_measurements",
    "read_campaign",
    "read_toolpath",
    "robot_effects",
    "run_cell",
    "run_in_time",
    "run_study",
    "solve_equilibrium",
    "solve_nlp",
    "split_diagnosis",
    "stage_scene",
    "standard_cells",
    "study_job",
    "summarise_run",
    "teach_part",
    "trace_model_error",
    "write_comparison",
    "write_identification",
    "write_plan",
    "write_prediction",
    "write_program",
    "write_robot_folder",
    "write_skeleton",
    "write_study",
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
