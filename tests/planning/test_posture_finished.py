"""A preset takes the best of the finished postures by its own measure, and says so where they tie."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from compplan.job.job import check_job
from compplan.planning import candidates
from compplan.planning.feed import time_run
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.task import PlanTask

PUSH = {"model": "constant", "force_N": [200.0, 100.0, 300.0], "frame": "base"}
RAIL: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr240_rail", "process": PUSH, "part": {"position_mm": [1590.0, 2000.0, 600.0]},
    "toolpath": {"generator": "circle", "radius_mm": 250.0, "feed_mm_s": 600.0, "waypoints": 12},
}  # fmt: skip
SPIN: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr270", "process": PUSH, "part": {"position_mm": [1700.0, 0.0, 800.0]},
    "tool": {"position_mm": [0.0, 0.0, 300.0], "abc_deg": [0.0, 30.0, 0.0], "mass_kg": 8.0},
    "toolpath": {"generator": "circle", "radius_mm": 120.0, "feed_mm_s": 500.0, "waypoints": 12},
}  # fmt: skip


JOBS = {"rail": RAIL, "spin": SPIN,
        "slow spin": {**SPIN, "toolpath": {**SPIN["toolpath"], "feed_mm_s": 5.0}}}  # fmt: skip


@cache
def stand(job: str, preset: str) -> tuple[PlanTask, float]:
    """Return the task of a job with the posture of a preset, and how long its run takes."""
    robot, nominal, options = prepare_job(check_job({**JOBS[job], "posture": {"preset": preset}}, "job.toml"))
    task = build_task(robot, nominal, options)
    return task, float(time_run(task, task.q_start, options.feed)[1].time[-1])


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
    assert any("one of the least time is driven" in note for note in task.start.notes)


def test_a_feed_that_every_posture_holds_is_a_tie_and_the_plan_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidates, "measure_runs", lambda *words: [])  # one program may start and end faster
    task, _ = stand("slow spin", "fast")
    assert task.start is not None and task.start.posture_choice is not None
    assert task.start.posture_choice.settings.preset == "fast"
    assert any("compared tie at a time of" in note for note in task.start.notes)


@pytest.mark.parametrize("preset", ["accurate", "smooth"])
def test_a_preset_that_is_asked_for_is_the_best_by_its_own_measure(preset: str) -> None:
    task, _ = stand("spin", preset)
    assert task.start is not None and (chosen := task.start.posture_choice) is not None
    assert chosen.compared_by == {"accurate": "band_mm", "smooth": "joint_travel_deg"}[preset]
    assert chosen.costs[chosen.compared_by] == min(chosen.compared.values()) and len(chosen.compared) >= 3
    assert any(note.startswith(f"Preset {preset}: ") for note in task.start.notes)


def test_a_preset_that_nobody_named_compares_nothing() -> None:
    robot, nominal, options = prepare_job(check_job(SPIN, "job.toml"))
    task = build_task(robot, nominal, options)
    assert task.start is not None and task.start.posture_choice is not None
    assert task.start.posture_choice.settings.preset == "accurate" and not task.start.posture_choice.compared
