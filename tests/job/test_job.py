from __future__ import annotations

import copy
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.job.commented_job import write_job_text
from compplan.job.job import Job, check_job, load_job
from compplan.job.loading import load_nominal
from compplan.planning.plan import job_robot, read_options
from compplan.planning.posture.settings import read_settings
from compplan.process.force_models import FORCE_MODELS
from compplan.robot import robot_folders

PATHS = sorted((Path(__file__).parents[2] / "paths").glob("*.toml"))
BASE: dict[str, Any] = tomllib.loads("""
schema = 1
robot = "staubli_tx200"
[toolpath]
generator = "circle"
radius_mm = 10.0
feed_mm_s = 10.0
waypoints = 20
[part]
position_mm = [1500.0, 0.0, 300.0]
rotation_deg = [0.0, 0.0, 90.0]
[process]
model = "constant"
force_N = [1.0, 2.0, 3.0]
[plan]
""")


def changed(change: Callable[[dict[str, Any]], object]) -> Job:
    data = copy.deepcopy(BASE)
    change(data)
    return check_job(data, "job.toml")


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_every_shipped_job_loads_with_its_toolpath_and_wrench(path: Path) -> None:
    job = load_job(path)
    assert job.robot in robot_folders()
    nominal = load_nominal(job)
    assert nominal.frame == "base"
    assert nominal.wrench is not None and np.abs(nominal.wrench).max() > 1


def test_the_shipped_jobs_hold_what_the_papers_describe() -> None:
    jobs = {path.stem: load_nominal(load_job(path)) for path in PATHS}
    cone, many = jobs["isf_cone"], jobs["isf_cone_50k"]
    assert cone.wrench is not None and cone.wrench[:, 2].max() == pytest.approx(1200)
    assert 250 <= np.linalg.norm(cone.wrench[:, :2], axis=1).max() <= 500
    assert cone.position[:, 2].min() == pytest.approx(0.168)
    assert (~many.rapid).sum() + 1 == 50_000
    assert jobs["spiral"].cutting_length == pytest.approx(2.7, rel=1e-4)
    for name, radius in (("circle_10mm", 0.01), ("circle_500mm", 0.5)):
        assert jobs[name].wrench[3, :3].tolist() == [440.0, 1370.0, -635.0]
        assert np.ptp(jobs[name].position[:, 0]) == pytest.approx(2 * radius, rel=1e-3)


def test_the_part_pose_places_positions_and_wrenches() -> None:
    nominal = load_nominal(changed(lambda data: None))
    assert nominal.position[0] == pytest.approx([1.5, 0.01, 0.3])
    assert nominal.wrench is not None and nominal.wrench[0, :3] == pytest.approx([-2, 1, 3])
    assert changed(lambda data: data["plan"].update(tool_x=[1.0, 0.0, 0.0])).tool_x_base == pytest.approx([0, 1, 0])


def test_lengths_and_angles_of_a_job_are_read_in_millimetres_and_degrees() -> None:
    data = copy.deepcopy(BASE)
    third = 120.0 / np.sqrt(3.0)  # a third of a turn about the diagonal of a cube takes x to y, y to z, z to x
    data |= {
        "robot": "kuka_kr240_rail",
        "part": {"position_mm": [1500.0, -20.0, 300.0], "rotation_deg": [third] * 3},
        "tool": {"position_mm": [10.0, 20.0, 300.0], "rotation_deg": [0.0, 0.0, 90.0]},
        "plan": {"start_deg": [500.0, 0.0, 90.0, -90.0, 0.0, 45.0, 180.0], "tolerance_mm": 0.2, "max_correction_mm": 5},
        "sampling": {"chord_mm": 0.03},
        "posture": {"lead_deg": 6.0, "lean_deg": 3.0, "limit_margin_deg": 18.0},
        "limits": {"velocity_scale": 0.5, "acceleration_scale": 0.25}, "feed": {"torque_limits": True},
    }  # fmt: skip
    job = check_job(data, "job.toml")
    assert job.T_base_part == pytest.approx(np.array([[0, 0, 1, 1.5], [1, 0, 0, -0.02], [0, 1, 0, 0.3], [0, 0, 0, 1]]))
    assert job.tool is not None
    tool = np.array([[0, -1, 0, 0.01], [1, 0, 0, 0.02], [0, 0, 1, 0.3], [0, 0, 0, 1]])
    assert job.tool.pose == pytest.approx(tool, abs=1e-15)
    robot = job_robot(job)
    options = read_options(job, robot)
    start = np.array([0.5, 0.0, np.pi / 2, -np.pi / 2, 0.0, np.pi / 4, np.pi])  # the rail in metres
    assert robot.prismatic.tolist() == [True] + [False] * 6
    assert options.posture.start == pytest.approx(start)
    assert (options.tolerance, options.max_correction, options.chord) == pytest.approx((2e-4, 5e-3, 3e-5))
    assert (options.velocity_scale, options.acceleration_scale) == (0.5, 0.25)
    assert options.torque_limits and not options.constant_feed
    settings = read_settings(job, robot)
    assert settings.start == pytest.approx(start)
    angles = (settings.lead, settings.lean, settings.limit_margin)
    assert angles == pytest.approx((np.pi / 30, np.pi / 60, np.pi / 10))


def test_auto_leaves_the_configuration_free_and_words_bind_it() -> None:
    assert changed(lambda data: data["plan"].update(configuration="auto")).plan.configuration.elbow is None
    job = changed(lambda data: data["plan"].update(configuration={"elbow": "up"}, start_deg=[1, 2.0]))
    assert (job.plan.configuration.elbow, job.plan.start_deg) == ("up", (1.0, 2.0))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.update(colour="red"), r"job.toml: colour: unknown key, choose from \['schema', 'name'"),
        (lambda data: data["plan"].update(stategy="nlp"), r"job.toml: plan.stategy: unknown key, choose from"),
        (lambda data: data["process"].update(axial_N=1.0), r"job.toml: process.axial_N: unknown key"),
        (lambda data: data["process"].update(model="x"), r"job.toml: process.model: is 'x', choose from"),
        (lambda data: data["process"].pop("model"), r"job.toml: process.model: missing key"),
        (lambda data: data["toolpath"].update(depth_mm=1.0), r"job.toml: toolpath.depth_mm: unknown key"),
        (lambda data: data["toolpath"].update(generator="star"), r"toolpath.generator: is 'star', choose from"),
        (lambda data: data["toolpath"].update(step_mm=1.0), r"exactly one of step_mm and waypoints"),
        (lambda data: data.pop("robot"), r"job.toml: robot: missing key"),
        (lambda data: data.update(robot=" "), r"robot: is empty"),
        (lambda data: data.update(schema=2), r"schema: is 2, choose from 1"),
        (lambda data: data.update(part=1), r"part: is 1, must be a section"),
        (lambda data: data.update(toolpath=1), r"toolpath: is 1, must be a file or a section"),
        (lambda data: data["plan"].update(tolerance_mm="0.1"), r"plan.tolerance_mm: is '0.1', must be a number"),
        (
            lambda data: data["plan"].update(tolerance_mm=0.0),
            r"plan.tolerance_mm: is 0.0, must be greater than or equal",
        ),
        (lambda data: data["plan"].update(tolerance_mm=np.nan), r"plan.tolerance_mm: is nan, must be a finite"),
        (lambda data: data["plan"].update(configuration="up"), r"plan.configuration: is 'up', must be 'auto'"),
        (lambda data: data["plan"].update(tool_x=[0, 0, 0]), r"plan.tool_x: has length 0"),
        (lambda data: data["part"].update(position_mm=[1.0, 2.0, "3"]), r"part.position_mm\[2\]: is '3'"),
        (lambda data: data.update(output={"programs": ["gcode"]}), r"output.programs\[0\]: is 'gcode'"),
    ],
)
def test_each_mistake_in_a_job_has_its_sentence(change: Callable[[dict[str, Any]], object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        changed(change)


def test_a_file_that_is_no_toml_names_its_line(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text("schema = 1\nrobot = \n")
    with pytest.raises(InputError, match=r"job.toml:2: is not TOML"):
        load_job(tmp_path / "job.toml")


def test_a_missing_toolpath_file_is_named_with_its_key(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text('schema = 1\nrobot = "ur10"\ntoolpath = "nowhere.csv"\n')
    with pytest.raises(InputError, match=r"job.toml: toolpath: no toolpath file .*nowhere.csv"):
        load_nominal(load_job(tmp_path / "job.toml"))


def test_a_constant_feed_replaces_the_one_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "path.nc").write_text("G21 G0 X0 Y0 Z0\nG1 X10\n")
    (tmp_path / "job.toml").write_text(
        'schema = 1\nrobot = "ur10"\ntoolpath = "path.nc"\n[process]\nrequired = false\n'
        'model = "columns"\n[feed]\nconstant_mm_s = 7.0\n'
    )
    nominal = load_nominal(load_job(tmp_path / "job.toml"))
    assert nominal.feed[~nominal.rapid] == pytest.approx(7e-3)
    assert len(nominal) == 11  # divided at 1 mm


def test_the_commented_job_is_a_job_and_names_every_key() -> None:
    check_job(tomllib.loads(write_job_text()))
    for table in Job.model_fields.values():
        for key in getattr(table.annotation, "model_fields", {}):
            assert key in write_job_text(), key
    for model in FORCE_MODELS.values():
        for key in model.table.model_fields:
            assert f"{key} = " in write_job_text() or f"{key}, " in write_job_text(), (model.words, key)


def test_init_writes_the_commented_job_and_never_over_a_file(tmp_path: Path, monkeypatch, capsys) -> None:
    file = tmp_path / "new.toml"
    assert run_command(["init", file], monkeypatch, capsys).status == 0 and load_job(file).schema_ == 1
    again = run_command(["init", file], monkeypatch, capsys)
    assert again.status == 2 and "new.toml: exists already" in again.err
