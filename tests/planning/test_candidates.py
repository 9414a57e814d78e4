"""Candidates of a start: finished postures of several presets, and one program of time, posture and band."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.limits import sample_use
from compplan.job.job import check_job, load_job
from compplan.planning import candidates
from compplan.planning.candidates import compute_gain
from compplan.planning.feed import time_run
from compplan.planning.fixed_point import resolve_starts
from compplan.planning.measured_runs import band_at_time
from compplan.planning.plan import Plan, build_task, plan_job, prepare_job
from compplan.planning.task import PlanTask
from compplan.planning.timing import time_command
from compplan.reporting.writers.plan import write_plan

PUSH = {"model": "constant", "force_N": [200.0, 100.0, 300.0], "frame": "base"}
CIRCLE: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr270", "process": PUSH, "part": {"position_mm": [1700.0, 0.0, 800.0]},
    "tool": {"position_mm": [0.0, 0.0, 300.0], "abc_deg": [0.0, 30.0, 0.0], "mass_kg": 8.0},
    "toolpath": {"generator": "circle", "radius_mm": 120.0, "feed_mm_s": 500.0, "waypoints": 60},
    "plan": {"tolerance_mm": 0.5, "inertia": False}, "sampling": {"chord_mm": 0.3},
}  # fmt: skip


def test_a_posture_wins_by_what_its_preset_is_for_alone() -> None:
    def exact_robot(preset: str, time: float, band: float, static_band: float) -> float:
        return compute_gain(preset, SimpleNamespace(time=time, band=band, static_band=static_band), base)

    base = SimpleNamespace(time=1.0, band=1.0, static_band=1.0)
    assert exact_robot("fast", 0.8, 3.0, 3.0) == 0.8
    assert exact_robot("accurate", 1.0, 1.0, 0.9) == 0.95 and exact_robot("error_band", 1.1, 0.5, 0.5) == np.inf
    assert exact_robot("error_band", 1.0, 0.5, 1.1) == 0.5 and exact_robot("accurate", 1.0, 0.5, 1.1) == 0.8
    assert exact_robot("", 0.9, 1.0, 2.0) == pytest.approx(0.95) and exact_robot("", 0.5, 1.01, 0.9) == np.inf


def test_the_band_of_a_run_is_estimated_at_the_time_of_another() -> None:
    time, bands = np.linspace(0.0, 2.0, 101), np.full(101, 1.0)
    bands[40:45] = 3.0
    task = SimpleNamespace(cut=np.ones(101, bool), smoothing=0.1)
    run = SimpleNamespace(task=task, passing=time, time=2.0, spare=0.2, bands=bands, static_bands=0.1 * np.ones(101),
                          band=3.0, static_band=0.1)  # fmt: skip

    def estimate(time: float) -> float:
        return band_at_time(run, SimpleNamespace(time=time))  # type: ignore[arg-type]

    assert estimate(2.0) == pytest.approx(3.0, rel=2e-3) and estimate(1.7) == np.inf
    assert estimate(1.9) == pytest.approx(3.0 * (2.0 / 1.9) ** 2, rel=2e-2)  # faster everywhere
    bound = 3.0 * (2.0 / 2.2) ** 2  # the same time spread over the whole run
    assert 1.0 < estimate(2.2) < 0.8 * bound and estimate(2.5) < estimate(2.2)


@pytest.fixture(scope="module")
def plan() -> Plan:
    cone = {"generator": "isf_cone", "diameter_mm": 200.0, "depth_mm": 20.0, "wall_angle_deg": 60.0,
            "pitch_mm": 20.0, "feed_mm_s": 600.0, "step_mm": 12.0}  # fmt: skip
    push = {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"}
    job = {**CIRCLE, "toolpath": cone, "process": push, "part": {"position_mm": [1750.0, 200.0, 700.0]}}
    return plan_job(check_job(job, "job.toml"))


def gains(program: Mapping[str, Any]) -> tuple[float, float]:
    """Return time and band of the program as shares of the graph's."""
    time, band = program["time_s"], program["band_p95_max_mm"]
    return time["program"] / time["graph"], band["program"] / band["graph"]


def test_a_plan_that_is_bettered_is_solved_shorter_and_promises_no_less(plan: Plan) -> None:
    assert plan.status == "solved", plan.explain_failures()
    assert plan.task.start is not None and plan.task.start.program is not None
    found = plan.task.start.program
    time, band = gains(found)
    assert max(time, band) <= 1.001 and time + band < 1.95
    assert found["least_time_s"] <= found["time_s"]["program"]
    assert any(note.startswith("Posture and speed are") for note in plan.notes)
    told = plan.to_dict()
    assert told["posture"]["program"] == found


def test_its_page_and_programs_are_written(plan: Plan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "out")
    assert "widest 95 % band" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")


def test_its_run_holds_velocity_and_acceleration_at_every_millisecond(plan: Plan) -> None:
    task = plan.task
    runs = task.runs
    use = sample_use(plan.q, plan.timing.time, runs, task.velocity_limits, task.acceleration_limits)
    assert use["velocity"] < 1.001 and plan.timing.acceleration_ratio < 1.001
    assert use["acceleration"] < 1.04  # a spline overshoots where acceleration jumps


@pytest.mark.slow
def test_a_tube_that_is_given_makes_a_wavy_run_shorter_and_its_deviation_is_judged(tmp_path: Path) -> None:
    u = np.linspace(0.0, 1.0, 120)
    rows = [f"{8.0 * np.sin(8.0 * np.pi * k):.6f},{500.0 * (k - 0.5):.6f},0,0,0,1,700" for k in u]
    (tmp_path / "wave.csv").write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_s\n" + "\n".join(rows) + "\n", encoding="utf-8")
    job = {**CIRCLE, "toolpath": str(tmp_path / "wave.csv"), "plan": {"tolerance_mm": 8.0, "inertia": False},
           "sampling": {"chord_mm": 1.0}, "posture": {"preset": "fast"}, "tolerance": {"tube": 0.8}}  # fmt: skip
    del job["tool"]
    plan = plan_job(check_job(job, "job.toml"))
    assert plan.status == "solved", plan.explain_failures()
    assert plan.task.start is not None and plan.task.start.program is not None
    found = plan.task.start.program
    assert {"left", "up"} <= set(found["free"]) and gains(found)[0] < 0.98
    assert 0.2e-3 < plan.after.max_deviation <= 6.41e-3
    off = plan.task.position - plan.task.programmed
    assert plan.after.deviation[plan.task.cut] == pytest.approx(off[plan.task.cut], abs=2e-6)
    assert plan.error_band is not None and plan.error_band.greatest > plan.after.max_deviation


def test_the_shipped_job_on_a_rail_is_solved_with_its_speed_eased_and_a_narrower_band_than_the_graphs_run() -> None:
    plan = plan_job(load_job(Path(__file__).parents[2] / "examples" / "rail" / "circle.toml"))
    assert (plan.status, plan.strategy) == ("solved", "nlp"), plan.explain_failures()
    assert plan.robot.prismatic[0] and plan.task.start is not None
    assert plan.task.start.program is not None
    time, band = gains(plan.task.start.program)
    assert time <= 1.0 and band < 0.9


def test_an_eased_run_rings_less_and_knows_where(plan: Plan) -> None:
    assert plan.task.start is not None and (run := plan.task.start.slowdown) is not None
    assert run.slower.min() >= 1.0 and run.slower.max() > 1.0
    assert (np.diff(run.places) >= 0.0).all() and plan.task.slowdown.max() == pytest.approx(run.slower.max(), rel=0.05)
    even = replace(plan.task, start=replace(plan.task.start, slowdown=None))
    assert time_command(even, plan.task.q_start).time[-1] < time_command(plan.task, plan.task.q_start).time[-1]


def test_a_mirror_strategy_keeps_the_posture_of_the_graph() -> None:
    robot, nominal, options = prepare_job(check_job(CIRCLE, "job.toml"))
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    assert task.start is not None and task.start.program is None


RAIL: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr240_rail", "process": PUSH, "part": {"position_mm": [1590.0, 2000.0, 600.0]},
    "toolpath": {"generator": "circle", "radius_mm": 250.0, "feed_mm_s": 600.0, "waypoints": 12},
}  # fmt: skip
SPIN = {**{key: CIRCLE[key] for key in ("schema", "robot", "process", "part", "tool")},
        "toolpath": {**CIRCLE["toolpath"], "waypoints": 12}}  # fmt: skip
JOBS = {"rail": RAIL, "spin": SPIN,
        "slow spin": {**SPIN, "toolpath": {**SPIN["toolpath"], "feed_mm_s": 5.0}}}  # fmt: skip


@cache
def stand(job: str, preset: str) -> tuple[PlanTask, float]:
    """Return the task of a job with the posture of a preset, and how long its run takes."""
    robot, nominal, options = prepare_job(check_job({**JOBS[job], "posture": {"preset": preset}}, "job.toml"))
    task = build_task(robot, nominal, options)
    driven = resolve_starts(task)
    return task, float(time_run(driven, driven.q_start)[1].time[-1])


@pytest.mark.parametrize(
    ("job", "presets"),
    [("rail", ["smooth"]), pytest.param("spin", ["accurate", "smooth"], marks=pytest.mark.slow)],
)
def test_no_other_preset_is_faster_than_fast(job: str, presets: list[str]) -> None:
    task, fast = stand(job, "fast")
    others = {preset: stand(job, preset)[1] for preset in presets}
    assert fast <= 1.0001 * min(others.values()), others
    assert task.start is not None and task.start.posture_choice is not None
    assert fast == pytest.approx(task.start.posture_choice.costs["driven_s"], rel=1e-9)
    assert task.start.posture_choice.costs["driven_s"] == min(task.start.posture_choice.compared.values())


def test_a_feed_that_every_posture_holds_is_told_with_its_figures(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(candidates, "measure_runs", lambda *words: [])  # one program may start and end faster
    task, _ = stand("slow spin", "fast")
    assert task.start is not None and task.start.posture_choice is not None
    assert task.start.posture_choice.settings.preset == "fast"
    assert len(task.start.posture_choice.describe()["postures_driven_s"]) >= 2


@pytest.mark.parametrize("preset", ["accurate", "smooth"])
def test_a_preset_that_is_asked_for_is_the_best_by_its_own_measure(preset: str) -> None:
    task, _ = stand("spin", preset)
    assert task.start is not None and (chosen := task.start.posture_choice) is not None
    assert chosen.compared_by == {"accurate": "band_mm", "smooth": "joint_travel_deg"}[preset]
    assert chosen.costs[chosen.compared_by] == min(chosen.compared.values()) and len(chosen.compared) >= 3


def test_a_preset_that_nobody_named_compares_nothing() -> None:
    robot, nominal, options = prepare_job(check_job(SPIN, "job.toml"))
    task = build_task(robot, nominal, options)
    assert task.start is not None and task.start.posture_choice is not None
    assert task.start.posture_choice.settings.preset == "accurate" and not task.start.posture_choice.compared
