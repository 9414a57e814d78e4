"""The error band of postures to first order, and what a choice by it gains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from compplan.effects import solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.errors import InputError
from compplan.job.job import Job, check_job
from compplan.job.loading import load_nominal
from compplan.planning.plan import job_robot, plan_job
from compplan.planning.posture.choose import choose_posture_path
from compplan.planning.posture.settings import PostureProblem, read_settings
from compplan.robot import Robot, load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import estimate_band
from compplan.uncertainty.posture_errors import PostureErrors, derive_force, derive_unknowns, posture_errors
from compplan.uncertainty.sensitivities import (
    ForceSpread,
    build_path_model,
    measure_force_slopes,
    measure_slopes,
    read_force_spread,
)

FORCE = ForceSpread(0.1, 0.02, 0.03, "made up")


def stiffness(joint: str, deviation: float) -> Unknown:
    return Unknown("joint_stiffness", joint, None, ("compliance_change_rad_per_Nm",), np.array([deviation]))


def known_by(*unknowns: Unknown, **more: float) -> Uncertainty:
    tool = Unknown("tool_frame", None, None, ("tx_m",), np.zeros(1))
    p = sum(len(unknown.keys) for unknown in unknowns) + 1
    return Uncertainty("measured", "made up", (*unknowns, tool), np.eye(p), repeatability=0.0, **more)


@pytest.mark.parametrize("name", ["kuka_kr270", "staubli_tx200"])
def test_errors_of_postures_to_first_order_are_the_secants_of_the_exact_equilibrium(name: str) -> None:
    """Every assumed unknown, one that only a secant tells, and the force: within 3 % of the greatest column."""
    robot = load_robot(name)
    errors = PostureErrors(robot, robot_uncertainty(robot), FORCE)
    some = np.random.default_rng(5)
    q = 0.5 * (robot.lower + robot.upper) + np.array([0, 0.4, 0.6, 0.2, 0.7, 0.1]) + 0.2 * some.standard_normal((12, 6))
    wrench = np.tile([300.0, -200.0, 500.0, 5.0, 0, -8.0], (12, 1))
    hardening = Unknown(
        "stiffness_nonlinearity", "joint_2", None, ("quadratic_ratio",), np.array([0.02]),
        {"compliance": 1e-7, "reference_load": 2000.0, "zone_load": 2000.0},
    )  # fmt: skip
    unknowns = (*errors.known.unknowns, hardening)
    scene = build_path_model(robot, q, wrench)
    at = linearize_model(scene, solve_model_poses(scene))
    close, exact = derive_unknowns(at, unknowns), measure_slopes(scene, unknowns, np.arange(12))
    size = np.abs(exact).max(axis=(0, 1))
    seen = size > 1e-7  # equilibria settle to 1e-12 m, secants over 1e-4 are known to 1e-8
    assert seen.sum() > 55
    assert (np.abs(close - exact).max(axis=(0, 1)) < 0.03 * size)[seen].all()
    shared, local = measure_force_slopes(scene, np.arange(12), FORCE)
    force = derive_force(at, wrench, FORCE)
    assert force == pytest.approx(np.concatenate([shared, local], axis=2), abs=0.03 * np.abs(shared).max())


JOB: dict[str, Any] = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 60.0, "feed_mm_s": 20.0, "waypoints": 40},
    "part": {"position_mm": [1900.0, 0.0, 700.0], "touched_off": False},
    "tool": {"position_mm": [150.0, 0.0, 250.0], "rotation_deg": [0.0, 30.0, 0.0], "mass_kg": 20.0},
    "process": {"model": "constant", "force_N": [300.0, 400.0, 500.0]},
}


SURE = {"wrench_level": 0.02, "wrench_direction_deg": 0.3, "wrench_path": 0.0}


@pytest.mark.parametrize("joint", ["joint_4", "joint_5"])
def test_a_posture_chosen_for_the_promise_keeps_a_smaller_one_where_one_joint_is_badly_known(joint: str) -> None:
    """One compliance is known to 50 %, the others to 2 %; the accurate preset counts ten per cent of each."""
    bands = {}
    for preset in ("accurate", "error_band"):
        job = check_job({**JOB, "posture": {"preset": preset}, "noise": SURE}, "job.toml")
        robot = job_robot(job)
        own = {spring.joint: spring.compliance for spring in robot.springs if spring.axis == "own"}
        widths = [stiffness(name, (0.5 if name == joint else 0.02) * value) for name, value in own.items()]
        bands[preset] = measure_choice(job, replace(robot, uncertainty=known_by(*widths)))
    assert bands["error_band"] < 0.9 * bands["accurate"]


def measure_choice(job: Job, robot: Robot) -> float:
    """Return the rms of the exact band along the posture that a job's preset chooses."""
    nominal = load_nominal(job)
    settings = read_settings(job, robot, posture_errors(job, robot))
    posture_choice = choose_posture_path(PostureProblem(robot, nominal, job.tool_x_base, settings))
    scene = build_path_model(robot, posture_choice.q, nominal.wrench)
    error_band = estimate_band(robot, scene, ~nominal.rapid, read_force_spread(job))
    return float(np.sqrt(np.mean(error_band.radius[error_band.cut] ** 2)))


@pytest.mark.slow
def test_a_plan_for_the_promise_says_what_it_counts() -> None:
    few = {**JOB["toolpath"], "waypoints": 12}
    plan = plan_job(check_job({**JOB, "toolpath": few, "posture": {"preset": "error_band"}}, "job.toml"))
    posture_choice = plan.task.start.posture_choice
    assert posture_choice is not None and posture_choice.settings.errors is not None
    told = posture_choice.describe()
    assert "assumed" in told["error_band_from"] and "uncertainty_assumed" not in told
    assert plan.error_band is not None
    # what the search counted is what the plan promises: the rms error, and the quantile over errors and waypoints
    spread = np.sqrt(np.mean(np.trace(plan.error_band.covariance[plan.error_band.cut], axis1=1, axis2=2)))
    assert told["costs"]["sensitivity_rms_mm"] == pytest.approx(1e3 * spread, rel=0.03)


def test_presets_that_do_not_exist_are_refused() -> None:
    with pytest.raises(InputError, match="preset"):
        check_job({**JOB, "posture": {"preset": "error_bands"}}, "job.toml")
