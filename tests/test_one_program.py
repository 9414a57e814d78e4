"""One program of time, posture and promise: derivatives, closed forms, limits, and what it brings on a small job."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.limits import sample_use
from compplan.job.job import check_job
from compplan.known.assumed import known_uncertainty
from compplan.known.slopes import read_force_spread
from compplan.outputs.plan import write_plan
from compplan.plan.freedom import Freedom, find_freedom
from compplan.plan.plan import Plan, build_task, plan_job, prepare_job
from compplan.plan.program_step import _time_slopes
from compplan.plan.quadratic import StepRows, StepVariables, solve_quadratic
from compplan.plan.refine import _judge, measure_radius
from compplan.plan.reversals import describe_reversals, list_reversals
from compplan.plan.timing import cutting_runs
from compplan.posture.slides import count_reversals
from compplan.statics.sensitivity import attain_pose

PUSH = {"model": "constant", "force_N": [200.0, 100.0, 300.0], "frame": "base"}
CIRCLE: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr270", "process": PUSH, "part": {"position_mm": [1700.0, 0.0, 800.0]},
    "tool": {"position_mm": [0.0, 0.0, 300.0], "abc_deg": [0.0, 30.0, 0.0], "mass_kg": 8.0},
    "toolpath": {"generator": "circle", "radius_mm": 120.0, "feed_mm_s": 500.0, "waypoints": 60},
    "plan": {"tolerance_mm": 0.5, "inertia": False}, "sampling": {"chord_mm": 0.3},
}  # fmt: skip


def free(job: dict[str, Any], **posture: Any) -> Freedom:
    """Return what a job leaves free, by the graph's posture."""
    robot, nominal, options = prepare_job(check_job({**job, "posture": posture}, "job.toml"))
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    assert task.start is not None and task.start.stance is not None
    found = find_freedom(task, task.start.stance, nominal, np.asarray(options.tool_x, float), 100)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def rail() -> Freedom:
    path = {**CIRCLE["toolpath"], "waypoints": 12}
    part = {"position_mm": [1590.0, 2000.0, 600.0]}
    job = {**CIRCLE, "robot": "kuka_kr240_rail", "toolpath": path, "part": part}
    return free(job, lead_deg=5.0, lean_deg=5.0, spin_step_deg=60.0)


def test_joints_are_eliminated_with_their_exact_derivative_and_the_loaded_tip_stays_on_the_path(rail: Freedom) -> None:
    assert rail.names == ("spin", "lead", "lean", "joint_1")
    rng = np.random.default_rng(0)
    values = rail.start + rng.uniform(-0.02, 0.02, rail.start.shape)
    q, rate, reached = rail.pose(rail.task.q_start[rail.rows], values)
    assert reached.all()
    assert np.abs(attain_pose(rail.task.chain, q, rail.wrench).position - rail.task.position[rail.rows]).max() < 1e-9
    assert q[:, 0] == pytest.approx(values[:, 3])
    for k in range(4):
        step = 1e-5 * np.eye(4)[k]
        ahead, behind = (rail.pose(q, values + side * step)[0] for side in (1.0, -1.0))
        assert rate[:, :, k] == pytest.approx((ahead - behind) / 2e-5, abs=2e-5)


def test_the_time_of_a_run_answers_to_the_squares_of_its_speed_as_differences_say() -> None:
    rng = np.random.default_rng(1)
    along, square = np.cumsum(rng.uniform(0.1, 0.3, 8)), rng.uniform(0.2, 1.0, 8)

    def spend(x: np.ndarray) -> float:
        return float((2.0 * np.diff(along) / (np.sqrt(x[1:]) + np.sqrt(x[:-1]))).sum())

    slope, diagonal, beside = _time_slopes(along, np.sqrt(square))
    h, unit = 1e-4, np.eye(8)
    assert slope == pytest.approx([(spend(square + h * e) - spend(square - h * e)) / (2 * h) for e in unit], rel=1e-4)
    second = [(spend(square + h * e) - 2 * spend(square) + spend(square - h * e)) / h**2 for e in unit]
    assert diagonal == pytest.approx(second, rel=1e-2)
    a, b = h * unit[2], h * unit[3]
    mixed = spend(square + a + b) - spend(square + a - b) - spend(square - a + b) + spend(square - a - b)
    assert beside[2] == pytest.approx(mixed / (4 * h**2), rel=1e-2)


def test_a_step_of_two_coefficients_goes_to_the_corner_that_rows_and_size_leave() -> None:
    rows = StepRows(StepVariables(2, 2, 0, 0))
    rows.add(np.array([0.3]), c=np.array([[1.0, 1.0]]), b=-1.0)
    rows.add(np.array([0.0]), b=1.0)
    rows.add(np.array([0.0]), c=np.array([[-1.0, 0.0]]), x=((np.array([1]), np.array([1.0])),))
    found = solve_quadratic(
        rows, slope=np.array([0.0, -1.0]), bend=[np.zeros(2), np.zeros(2)], rapid=0.0, travel=0.0, band=0.0,
        square=np.array([0.5, 0.5]), ends=np.array([0]), size=0.4,
    )  # fmt: skip
    assert found is not None  # x_1 <= c_0: as far as the size lets it, c_1 gives way
    assert found[0] == pytest.approx(0.4, abs=1e-3) and found[1] <= -0.1 + 1e-3


def test_a_posture_wins_by_what_its_preset_is_for_alone() -> None:
    assert _judge("fast", 0.8, 3.0, 3.0) == 0.8
    assert _judge("accurate", 1.0, 1.0, 0.9) == 0.9 and _judge("promise", 1.1, 0.5, 0.5) == np.inf
    assert _judge("", 0.9, 1.0, 2.0) == pytest.approx(0.95) and _judge("", 0.5, 1.01, 0.9) == np.inf


def test_reversals_count_ways_of_a_stroke_and_more() -> None:
    way = np.sin(np.linspace(0.0, 5.0 * np.pi, 400))
    assert count_reversals(way, 0.01) == 5
    assert count_reversals(way + 1e-3 * np.sin(np.arange(400.0)), 0.01) == 5
    assert count_reversals(np.linspace(0.0, 1.0, 50), 0.01) == 0 and count_reversals(1e-3 * way, 0.01) == 0


@pytest.fixture(scope="module")
def plan() -> Plan:
    cone = {"generator": "isf_cone", "diameter_mm": 200.0, "depth_mm": 20.0, "wall_angle_deg": 60.0,
            "pitch_mm": 20.0, "feed_mm_s": 600.0, "step_mm": 12.0}  # fmt: skip
    push = {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"}
    job = {**CIRCLE, "toolpath": cone, "process": push, "part": {"position_mm": [1750.0, 200.0, 700.0]}}
    return plan_job(check_job(job, "job.toml"))


def test_a_plan_that_is_bettered_is_solved_shorter_and_promises_no_less(plan: Plan) -> None:
    assert plan.status == "solved", plan.explain_failures()
    assert plan.task.start is not None and (found := plan.task.start.bettered) is not None
    assert found.time[1] <= 1.001 * found.time[0] and found.band[1] <= 1.001 * found.band[0]
    assert found.time[1] / found.time[0] + found.band[1] / found.band[0] < 1.95
    assert found.least_time <= found.time[1]
    assert any(note == found.sentence(plan.task.start.push) for note in plan.notes)
    told = plan.to_dict()
    assert told["posture"]["program"]["time_s"] == {"graph": found.time[0], "program": found.time[1]}
    assert {entry["axis"] for entry in told["reversals"]} == {*plan.robot.joint_names, "spin"}


def test_its_page_and_programs_are_written(plan: Plan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "out")
    assert "widest 95 % band" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")


def test_its_run_holds_velocity_and_acceleration_at_every_millisecond(plan: Plan) -> None:
    task = plan.task
    runs = cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests)
    use = sample_use(plan.q, plan.timing.time, runs, task.velocity_limits, task.acceleration_limits)
    assert use["velocity"] < 1.001 and use["acceleration"] < 1.02


def test_reversals_are_priced_by_lost_motion_and_lever(plan: Plan) -> None:
    found = {entry.axis: entry for entry in list_reversals(plan.task, plan.q)}
    first = found[plan.robot.joint_names[0]]
    assert first.assumed and first.turns >= 1  # a circle turns the first axis twice
    reach = np.linalg.norm(plan.task.position[:, :2], axis=1)
    assert first.price == pytest.approx(first.lost * np.sqrt((reach**2).mean()), rel=0.05)
    assert "assumed" in describe_reversals(tuple(found.values()))


def test_knowing_more_makes_the_band_of_a_posture_narrower_in_the_program_too(plan: Plan) -> None:
    robot, rows = plan.robot, slice(10, 20)
    q, wrench, force = plan.q[rows], plan.task.wrench[rows], read_force_spread(None)
    known = known_uncertainty(robot)
    surer = replace(robot, uncertainty=replace(known, calibration=0.5 * known.calibration))
    assert (measure_radius(surer, force, q, wrench) < 0.9 * measure_radius(robot, force, q, wrench)).all()


def test_a_mirror_strategy_keeps_the_posture_of_the_graph() -> None:
    robot, nominal, options = prepare_job(check_job(CIRCLE, "job.toml"))
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    assert task.start is not None and task.start.bettered is None
