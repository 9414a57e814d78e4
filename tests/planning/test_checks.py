"""A planted mistake in any part of a plan is seen: by the checks of the plan itself, or by independent readers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import compplan.job.loading as loading
import compplan.planning.inertia as inertia
import compplan.planning.posture.lattice as lattice
from compplan.job.job import Job, ToolTable, load_job
from compplan.planning import plan as planning
from compplan.planning.plan import plan_job
from compplan.planning.timing import Timing
from compplan.robot import Array, Robot, load_robot
from compplan.simulation.exact import build_exact_robot, hold_load
from compplan.simulation.inertia import fit_parabolas
from compplan.statics.chain import build_chain, locate_frames
from compplan.toolpath.toolpath import Toolpath, place_toolpath
from tests.oracles.plan_check import check_plan

pytestmark = pytest.mark.usefixtures("graph_alone")

NC = "G21 G90 G17\nG0 X0 Y0 Z20\nG1 Z0 F600\nX30\nG3 X40 Y10 I0 J10\nG1 Y25\nG0 Z20\n"
CUT = [[30.0, 0.0, 0.0], [40.0, 10.0, 0.0], [40.0, 25.0, 0.0]]  # where the cut of NC passes
JOB = """schema = 1
robot = "kuka_kr240"
toolpath = "part.nc"
[part]
position_mm = [1800.0, 100.0, 700.0]
rotation_deg = [0.0, 0.0, 20.0]
[process]
model = "constant"
force_N = [50.0, 0.0, 100.0]
[tool]
position_mm = [200.0, 0.0, 30.0]
rotation_deg = [0.0, 90.0, 0.0]
mass_kg = 10.0
centre_of_mass_mm = [90.0, 0.0, 0.0]
"""


@pytest.fixture
def job(tmp_path: Path) -> Job:
    (tmp_path / "part.nc").write_text(NC)
    (tmp_path / "part.toml").write_text(JOB)
    return load_job(tmp_path / "part.toml")


def test_a_sound_plan_is_confirmed_by_all_checks(job: Job) -> None:
    plan = plan_job(job)
    assert (plan.status, plan.breaches, check_plan(plan, CUT, 10.0)) == ("solved", (), ())
    assert not [note for note in plan.notes if "not checked" in note]


def test_a_tool_that_leans_takes_its_x_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "part.nc").write_text(NC)
    leaning = "[plan]\nrotate_about_tool_axis = false\n[posture]\nlead_deg = 8.0\nlean_deg = 8.0\n"
    absolute = JOB.replace("[part]\n", "[part]\ntouched_off = false\n")
    (tmp_path / "part.toml").write_text(absolute + leaning)
    plan = plan_job(load_job(tmp_path / "part.toml"))
    leant = np.arccos(np.clip((plan.task.nominal.axis * plan.task.programmed_axis).sum(axis=1), -1.0, 1.0))
    assert np.degrees(leant).max() > 5.0 and plan.breaches == ()
    turn, true = Rotation.from_rotvec([0.0, 0.0, np.radians(0.3)]).as_matrix(), lattice.tool_axes
    monkeypatch.setattr(lattice, "tool_axes", lambda *words: true(*words) @ turn)
    assert "turned 0.3 deg about its axis" in " ".join(plan_job(load_job(tmp_path / "part.toml")).breaches)


def test_the_torque_that_holds_a_wrench_is_its_virtual_work_with_the_sign_turned() -> None:
    robot = load_robot("ur20")
    exact_robot, q, wrench = (
        build_exact_robot(robot),
        np.array([0.3, -1.2, 1.4, -0.9, 0.7, 0.2]),
        np.array([40.0, -70.0, 90.0]),
    )
    step = 1e-6 * np.vstack([np.eye(6), -np.eye(6)])
    place = locate_frames(build_chain(robot), q + step).tcp_position
    work = (place[:6] - place[6:]) @ wrench / 2e-6
    held = hold_load(exact_robot, np.array([q, q]), np.array([np.r_[wrench, 0, 0, 0], np.zeros(6)]))
    assert held[0] - held[1] == pytest.approx(-work, abs=1e-4)
    assert abs(held[1, 1]) > 50.0  # the weight alone


def _reads(change: Callable[[Toolpath], Toolpath]) -> Callable[[pytest.MonkeyPatch], None]:
    true = loading.read_toolpath

    def plant(patch: pytest.MonkeyPatch) -> None:
        patch.setattr(loading, "read_toolpath", lambda *words, **named: change(true(*words, **named)))

    return plant


def _scaled(by: Any) -> Callable[[Toolpath], Toolpath]:
    return lambda path: replace(path, position=path.position * np.array(by))


def _turned_part(patch: pytest.MonkeyPatch) -> None:
    def place(path: Toolpath, pose: Array) -> Toolpath:
        other = pose.copy()
        other[:3, :3] = pose[:3, :3].T
        return place_toolpath(path, other)

    patch.setattr(loading, "place_toolpath", place)


def _turned_tool(patch: pytest.MonkeyPatch) -> None:
    def mount(tool: ToolTable, robot: Robot) -> Robot:
        pose = tool.pose.copy()
        pose[:3, :3] = pose[:3, :3].T
        return robot.with_tool(pose, tool.mass_kg, np.asarray(tool.centre_of_mass_mm) * 1e-3)

    patch.setattr(ToolTable, "mount", mount)


def _hasty(patch: pytest.MonkeyPatch) -> None:
    true = planning.compensate

    def compensate(*words: Any) -> Any:
        found = true(*words)
        timing: Timing = replace(found.timing, time=0.5 * found.timing.time)
        return replace(found, timing=timing)

    patch.setattr(planning, "compensate", compensate)


def _without_last(path: Toolpath) -> Toolpath:
    columns = {each.name: getattr(path, each.name) for each in fields(path)}
    kept = {name: value[:-2] for name, value in columns.items() if isinstance(value, np.ndarray)}
    return replace(path, **kept)


def _heavy(patch: pytest.MonkeyPatch) -> None:
    true = inertia.load_motion
    patch.setattr(inertia, "load_motion", lambda *words: 2.0 * true(*words))


MISTAKES: dict[str, tuple[Callable[[pytest.MonkeyPatch], None], str]] = {
    "y mirrored": (_reads(_scaled([1.0, -1.0, 1.0])), "passes a point"),
    "another unit": (_reads(_scaled([0.5, 0.5, 0.5])), "passes a point"),
    "the last move missing": (_reads(_without_last), "passes a point"),
    "feed a minute": (_reads(lambda path: replace(path, feed=path.feed * 6.0)), "feed"),
    "part turned the other way": (_turned_part, "passes a point"),
    "tool turned the other way": (_turned_tool, "tool axis|correction"),
    "times halved": (_hasty, "mm/min"),
    "inertia doubled": (_heavy, "inverse dynamics"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_planted_mistake_is_seen(name: str, job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    plant, word = MISTAKES[name]
    plant(monkeypatch)
    plan = plan_job(job)
    found = (*plan.breaches, *check_plan(plan, CUT, 10.0))
    assert any(part in "; ".join(found) for part in word.split("|")), found


def test_parabolas_through_uneven_times_are_exact() -> None:
    time = np.array([0.0, 0.1, 0.35, 0.4, 1.0])
    q = (1.0 + 2.0 * time - 3.0 * time**2)[:, None]
    velocity, change = fit_parabolas(q, time, np.array([1, 2, 3]))
    assert velocity[:, 0] == pytest.approx(2.0 - 6.0 * time[1:4])
    assert change[:, 0] == pytest.approx(-6.0)
