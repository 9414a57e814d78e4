"""Loads beyond buckling, and the limit of depth of a cut, in closed form."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import compplan as cp
from compplan.job.job import check_job
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.stability import describe_depth_limit
from compplan.simulation.chatter import compute_depth_limit

CIRCLE = Path(__file__).parents[2] / "paths" / "circle_10mm.toml"


def circle(**tables):
    """Load the shipped circle with few waypoints, with some keys of some tables changed."""
    job = cp.load_job(CIRCLE)
    data = job.model_dump(by_alias=True, exclude_unset=True)
    for table, keys in {"toolpath": {"waypoints": 40}, **tables}.items():
        data[table] = data.get(table, {}) | keys
    return check_job(data, job.file)


def test_a_load_beyond_buckling_is_infeasible_and_names_waypoint_and_joint():
    robot, nominal, options = prepare_job(circle())
    soft = robot.scale_compliance(1e4)
    nominal = replace(nominal, wrench=np.tile([0.0, 0.0, 30e3, 0, 0, 0], (len(nominal), 1)))
    with pytest.raises(cp.InfeasibleError, match=r"buckles at waypoint \d+: .* spring of joint_\d") as fault:
        cp.plan_compensation(soft, nominal, options)
    assert fault.value.exit_status == 3 and fault.value.waypoints and "\n" not in str(fault.value)


def test_the_least_limit_over_the_speeds_is_the_critical_stiffness_of_one_mode() -> None:
    """Tlusty: the critical cutting stiffness of one mode is 2 k z (1 + z), whatever the spindle speed."""
    omega, mass, damping, cutting = 2.0 * np.pi * 100.0, 20.0, 0.03, 1e6
    shape = np.array([[1.0], [0.0], [0.0]]) / np.sqrt(mass)
    mean = -cutting * np.diag([1.0, 0.0, 0.0])
    scales = np.geomspace(0.01, 100.0, 2000)
    periods = np.linspace(0.6, 0.9, 60) * 2.0 * np.pi / omega
    modes = np.array([omega]), shape, np.array([damping])
    found = min(compute_depth_limit(mean, period, *modes, scales) for period in periods)
    assert found == pytest.approx(2.0 * mass * omega**2 * damping * (1.0 + damping) / cutting, rel=0.02)


def test_a_plan_takes_the_tool_mode_of_its_job_into_the_limit_of_depth(tmp_path) -> None:
    (tmp_path / "slot.csv").write_text("x_mm,y_mm,z_mm,feed_mm_s\n5,20,-2,20\n15,20,-2,20\n")
    data = {
        "schema": 1, "robot": "kuka_kr270", "toolpath": "slot.csv", "part": {"position_mm": [1900.0, 0.0, 900.0]},
        "process": {
            "model": "end_mill", "diameter_mm": 10.0, "teeth": 2, "spindle_rpm": 6000.0, "material": "al7075_t6",
            "stock": {"block_mm": [[0.0, 0.0, -20.0], [40.0, 40.0, 0.0]]},
        },
    }  # fmt: skip
    limits = []
    for stated in ({}, {"tool_mode": {"frequency_Hz": 400.0, "stiffness_N_mm": 300.0, "damping": 0.02}}):
        task = build_task(*prepare_job(check_job(data | {"process": data["process"] | stated}, tmp_path / "job.toml")))
        said = describe_depth_limit(task, task.q_start)
        assert ("tool mode of 400 Hz" in said) == bool(stated)
        limits.append(float(said.partition("limit of depth is ")[2].split()[0]) if said else np.inf)
    assert limits[1] < limits[0]
