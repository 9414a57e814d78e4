"""Lag of drives: a plan counts it where it was identified, and is not confirmed where it leaves the tolerance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tomli_w

import compplan as cp
from compplan.robot import load_robot, write_robot_folder

LAG = np.array([30.0, 25.0, 20.0, 15.0, 12.0, 10.0])


def folder_with(folder: Path, name: str = "ur10", **motion: object) -> Path:
    """Write a robot with a table [motion]."""
    write_robot_folder(load_robot(name), folder)
    with (folder / "controller.toml").open("ab") as file:
        file.write(("\n" + tomli_w.dumps({"motion": motion})).encode())
    return folder


def write_job(folder: Path, robot: Path, place: str = "600.0, 100.0, 200.0") -> Path:
    """Write a small circle with a force."""
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    still = 0.0 * angle
    rows = [20.0 * np.cos(angle), 20.0 * np.sin(angle), still, still + 60.0, still, still, still + 20.0]
    rows, head = np.column_stack(rows), "x_mm,y_mm,z_mm,feed_mm_s,fx_N,fy_N,fz_N"
    np.savetxt(folder / "circle.csv", rows, delimiter=",", header=head, comments="", fmt="%.9g")
    (folder / "job.toml").write_text(
        f'schema = 1\nrobot = "{robot}"\ntoolpath = "circle.csv"\n[part]\nposition_mm = [{place}]\n'
        '[output]\nprograms = ["urscript"]\n'
    )
    return folder / "job.toml"


@pytest.fixture(scope="module")
def plans(tmp_path_factory) -> dict[str, cp.Plan]:
    """Plan one job for drives that were identified, and for the same that somebody assumed."""
    found = {}
    for source in ("identified by compplan trace from run.csv", "assumed"):
        folder = tmp_path_factory.mktemp("lag")
        robot = folder_with(folder / "robot", lag_ms=LAG.tolist(), source=source)
        found[source.split()[0]] = cp.plan_job(cp.load_job(write_job(folder, robot)))
    return found


def test_drives_that_nobody_measured_are_taken_to_follow(plans) -> None:
    plan, identified = plans["assumed"], plans["identified"]
    assert plan.executed is not None and not plan.executed.known
    assert plan.executed.most < 1e-5  # lines, arcs and zones alone
    assert identified.executed is not None and identified.executed.known and identified.executed.most > 1e-5
    assert "path errors of the controller (no trace of it)" in plan.verdict.left_out
    assert "path errors of the controller (no trace of it)" not in identified.verdict.left_out


def test_a_plan_whose_identified_drives_leave_the_tolerance_is_not_confirmed(tmp_path: Path) -> None:
    motion = {"lag_ms": LAG.tolist(), "lost_motion_deg": [0.02] * 6, "source": "identified by compplan trace"}
    job = write_job(tmp_path, folder_with(tmp_path / "robot", **motion))
    job.write_text(job.read_text() + "[plan]\ntolerance_mm = 0.02\n")
    plan = cp.plan_job(cp.load_job(job))
    assert plan.executed is not None and 1e3 * plan.executed.most > 0.02 and plan.status == "not_confirmed"
    assert any("the controller, drives as identified, takes" in text for text in plan.breaches)
