"""Lag of drives: the lead by it takes an independent drive to the path, and is written where it was identified only."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
from executed_emulator import STEP, SimulatedRobot, drive, measure_beside

import compplan as cp
from compplan.controllers.writers.joint_convention import load_motion
from compplan.planning.executed import lead_lag
from compplan.robot import load_robot, write_robot_folder
from compplan.statics.chain import build_chain, locate_frames

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


def test_an_independent_drive_stays_ten_times_nearer_to_the_path_of_a_led_command(tmp_path) -> None:
    motion = load_motion(load_robot(folder_with(tmp_path / "r", lag_ms=LAG.tolist(), source="identified")))[0]
    time = np.arange(0.0, 3.0 + STEP / 2, STEP)
    share = (time / 3.0) ** 3 * (10.0 - 15.0 * time / 3.0 + 6.0 * (time / 3.0) ** 2)
    q = np.stack([0.1 * np.sin(2.0 * np.pi * share + j) for j in range(6)], axis=1)
    nominal = SimpleNamespace(rapid=np.zeros(len(q), bool), steps=np.ones(len(q) - 1))
    chain = build_chain(load_robot("ur10"))
    led = lead_lag(SimpleNamespace(nominal=nominal, runs=[(0, len(q) - 1)], chain=chain), q, time, motion)
    cell = SimulatedRobot(lag=1e-3 * LAG)
    wanted, *reached = (locate_frames(chain, way).tcp_position for way in (q, drive(q, cell), drive(led, cell)))
    plain, better = (measure_beside(wanted, tip).max() for tip in reached)
    assert better < 0.1 * plain
    assert (led[[0, -1]] == q[[0, -1]]).all()
    along = ((locate_frames(chain, led).tcp_position - wanted) * np.gradient(wanted, axis=0)).sum(axis=1)
    assert np.abs(along / np.linalg.norm(np.gradient(wanted, axis=0), axis=1))[5:-5].max() < 5e-5  # nor a stop overrun


@pytest.fixture(scope="module")
def plans(tmp_path_factory) -> dict[str, tuple[cp.Plan, Path]]:
    """Plan one job for drives that were identified, and for the same that somebody assumed."""
    found = {}
    for source in ("identified by compplan trace from run.csv", "assumed"):
        folder = tmp_path_factory.mktemp("lead")
        robot = folder_with(folder / "robot", lag_ms=LAG.tolist(), source=source)
        found[source.split()[0]] = (cp.plan_job(cp.load_job(write_job(folder, robot))), folder)
    return found


def test_the_lead_is_judged_written_and_read_back_where_the_lag_was_identified(plans) -> None:
    from compplan.reporting.writers.plan import deliver_plan, note_programs

    plan, folder = plans["identified"]
    found = plan.executed
    assert found is not None and found.leads
    assert found.most < 0.2 * found.plain[1] and found.plain[1] > 1e-5
    delivered, _ = deliver_plan(note_programs(plan), folder / "out")
    assert delivered.status == "solved", delivered.breaches
    said = json.loads((folder / "out" / "plan.json").read_text())
    assert said["executed_mm"]["lag_led"] and said["executed_mm"]["max"] == pytest.approx(1e3 * found.most)
    assert any("lead by their lag" in note for note in said["notes"])
    table = np.genfromtxt(folder / "out" / "joints.csv", delimiter=",", names=True)
    kept = np.isin(np.round(np.degrees(plan.q[:, 0]), 6), np.round(table["q1_deg"], 6))
    assert kept.mean() > 0.5  # joints.csv holds the joints that are wanted, not what leads
    shutil.rmtree(folder / "out")


def test_nothing_leads_by_a_lag_that_nobody_measured(plans) -> None:
    plan = plans["assumed"][0]
    assert plan.executed is not None and not plan.executed.known and not plan.executed.leads
    assert plan.sent is plan.q and plan.executed.most < 1e-5  # lines, arcs and zones alone
    assert "path errors of the controller (no trace of it)" in plan.verdict.left_out
    assert "path errors of the controller (no trace of it)" not in plans["identified"][0].verdict.left_out


def test_a_plan_whose_identified_drives_leave_the_tolerance_is_not_confirmed(tmp_path: Path) -> None:
    motion = {"lag_ms": LAG.tolist(), "lost_motion_deg": [0.02] * 6, "source": "identified by compplan trace"}
    job = write_job(tmp_path, folder_with(tmp_path / "robot", **motion))
    job.write_text(job.read_text() + "[plan]\ntolerance_mm = 0.02\n")
    plan = cp.plan_job(cp.load_job(job))
    assert plan.executed is not None and 1e3 * plan.executed.most > 0.02 and plan.status == "not_confirmed"
    assert any("the controller, drives as identified, takes" in text for text in plan.breaches)
