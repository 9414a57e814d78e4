"""Tool and part as the teach pendant has them: flange frame and angles of the maker, frames from points.

Oracles: the chains of robot_sources.py in plain numpy, and rotations multiplied out here.
"""

from __future__ import annotations

import json
import tomllib
from typing import Any

import numpy as np
import pytest
from commandline import run_command
from robot_sources import SOURCES

from compplan.controllers.writers.joint_convention import locate_pendant
from compplan.errors import InputError
from compplan.job.frames import PartTable, ToolTable
from compplan.job.job import check_job
from compplan.job.questions import check_spindle, check_tool
from compplan.robot import load_robot, robot_folders
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.simulation.exact_model import read_exact_robot
from compplan.statics.chain import build_chain, locate_frames
from tests.robot.test_robot_library import turn, walk

X, Y, Z = np.eye(3)


def maker(name: str) -> str:
    return "ur" if name.startswith("ur") else name.split("_")[0]


def about(axis: np.ndarray, degrees: float) -> np.ndarray:
    return turn(axis, np.radians(degrees))


@pytest.mark.parametrize("name", SOURCES)
def test_tool_data_of_the_pendant_count_from_tool0_of_the_makers_description(name: str) -> None:
    robot, source = load_robot(name), SOURCES[name]
    q = np.radians(source.work)
    tip, angles = np.array([12.0, 30.0, 280.0]), (20.0, -35.0, 70.0)
    mounted = ToolTable(frame="pendant", position_mm=tuple(tip), abc_deg=angles).mount(robot)
    frames = locate_frames(build_chain(mounted), q[None])
    _, origin, axes = walk(source, q)
    a, b, c = angles
    assert np.abs(1e3 * frames.tcp_position[0] - (1e3 * origin + axes @ tip)).max() < 1e-6
    assert frames.tcp_rotation[0] == pytest.approx(axes @ about(Z, a) @ about(Y, b) @ about(X, c), abs=2e-9)


def test_the_flange_frame_of_the_urdf_would_put_that_tool_396_mm_aside_on_a_kuka() -> None:
    robot, q = load_robot("kuka_kr240"), np.zeros((1, 6))
    tools = [ToolTable(frame=frame, position_mm=(0.0, 30.0, 280.0)) for frame in ("flange", "pendant")]
    tips = [locate_frames(build_chain(tool.mount(robot)), q).tcp_position[0] for tool in tools]
    assert 1e3 * np.linalg.norm(tips[0] - tips[1]) == pytest.approx(280.0 * np.sqrt(2.0), abs=1e-6)


FORMS = {
    "abc_deg": ((30.0, -20.0, 110.0), about(Z, 30) @ about(Y, -20) @ about(X, 110)),
    "wpr_deg": ((30.0, -20.0, 110.0), about(Z, 110) @ about(Y, -20) @ about(X, 30)),
    "quaternion": ((np.cos(0.3), 0.0, np.sin(0.3), 0.0), turn(Y, 0.6)),
    "rotation_deg": ((0.0, 90.0, 0.0), about(Y, 90)),
}


@pytest.mark.parametrize("form", FORMS)
def test_each_form_of_a_rotation_is_multiplied_out(form: str) -> None:
    numbers, wanted = FORMS[form]
    table: dict[str, Any] = {"position_mm": [1.0, 2.0, 3.0], form: list(numbers)}
    own = PartTable.model_validate(table).pose
    assert own[:3, :3] == pytest.approx(wanted, abs=1e-12)
    assert own[:3, 3] == pytest.approx([1e-3, 2e-3, 3e-3])


def test_two_forms_of_one_rotation_and_a_quaternion_of_another_length_are_refused() -> None:
    base = {"schema": 1, "robot": "ur10", "toolpath": "a.nc"}
    for table, said in (
        ({"abc_deg": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 0.0]}, "states its rotation in 2 forms"),
        ({"quaternion": [1.0, 1.0, 0.0, 0.0]}, "quaternion of length 1.414"),
    ):
        for key in ("tool", "part"):
            with pytest.raises(InputError, match=f"{key}: .*{said}"):
                check_job({**base, key: table}, "job.toml")


@pytest.mark.parametrize("name", ["kuka_kr240", "fanuc_m20ia", "ur10e", "staubli_tx200"])
def test_the_judge_mounts_pendant_tools_and_stands_at_the_same_tip(name: str) -> None:
    table: dict[str, Any] = {"frame": "pendant", "position_mm": [5.0, -30.0, 250.0], "wpr_deg": [10.0, 20.0, 30.0],
                             "mass_kg": 3.0, "centre_of_mass_mm": [0.0, 10.0, 80.0]}  # fmt: skip
    robot = ToolTable.model_validate(table).mount(load_robot(name))
    rng = np.random.default_rng(5)
    q, wrench = rng.uniform(-1.0, 1.0, (4, robot.nq)), rng.normal(size=(4, 6)) * [99, 99, 99, 9, 9, 9]
    theirs = solve_exact_pose(read_exact_robot(robot_folders()[name], table), q, wrench)
    ours = solve_exact_pose(build_exact_robot(robot), q, wrench)
    assert theirs[0] == pytest.approx(ours[0], abs=1e-9) and theirs[1] == pytest.approx(ours[1], abs=1e-9)


def test_a_robot_that_says_nothing_of_its_pendant_is_refused_and_one_with_tool0_is_read_by_it(tmp_path) -> None:
    folder = tmp_path / "own"
    folder.mkdir()
    for file in ("robot.urdf", "elasticity.toml"):
        (folder / file).write_text((robot_folders()["fanuc_m20ia"] / file).read_text())
    robot = load_robot(folder)
    found = locate_pendant(robot)
    assert found is not None and not found.stated and not found.confirmed and "tool0" in found.source
    text = (folder / "robot.urdf").read_text().replace("tool0", "tip")
    (folder / "robot.urdf").write_text(text)
    (folder / "elasticity.toml").write_text((folder / "elasticity.toml").read_text().replace("tool0", "tip"))
    with pytest.raises(InputError, match=r"tool.frame: is 'pendant', but .* is unknown; write \[pendant\]"):
        ToolTable(frame="pendant").mount(load_robot(folder))


@pytest.mark.parametrize(("text", "said"), [
    ("x = [1.0, 0.0, 0.0]\nz = [1.0, 0.0, 0.0]", "right angle"),
    ("x = [2.0, 0.0, 0.0]\nz = [0.0, 0.0, 1.0]", "of length 2"),
    ("x = [1.0, 0.0, 0.0]", "pendant.z: missing key"),
])  # fmt: skip
def test_a_pendant_frame_that_is_no_frame_is_refused(tmp_path, text: str, said: str) -> None:
    for file in ("robot.urdf", "elasticity.toml"):
        (tmp_path / file).write_text((robot_folders()["ur10"] / file).read_text())
    own = (robot_folders()["ur10"] / "controller.toml").read_text().partition("[pendant]")[0]
    (tmp_path / "controller.toml").write_text(f"{own}[pendant]\n{text}\n")
    with pytest.raises(InputError, match=said):
        locate_pendant(load_robot(tmp_path))


def test_a_part_frame_fits_its_points_best_and_says_what_is_left() -> None:
    rng = np.random.default_rng(3)
    wanted = turn(np.array([1.0, 2.0, -1.0]), 0.7)
    nominal = rng.uniform(-200.0, 200.0, (6, 3))
    origin = np.array([1500.0, -40.0, 700.0])
    clean = nominal @ wanted.T + origin
    points: dict[str, Any] = {"nominal": nominal.tolist(), "measured": clean.tolist()}
    fit = PartTable.model_validate({"points_mm": points}).fit
    assert fit is not None and fit.residual.max() < 1e-9
    assert fit.pose[:3, :3] == pytest.approx(wanted, abs=1e-12) and 1e3 * fit.pose[:3, 3] == pytest.approx(origin)
    points["measured"] = (clean + rng.normal(0.0, 0.05, clean.shape)).tolist()
    noisy = PartTable.model_validate({"points_mm": points}).fit
    assert noisy is not None and 0.02 < np.sqrt(np.mean(noisy.residual**2)) < 0.12
    assert "best fit of 6" in noisy.tell() and "mm (rms)" in noisy.tell()

    def left(pose: np.ndarray) -> float:
        seen = nominal @ pose[:3, :3].T + 1e3 * pose[:3, 3]
        return float(np.sum((seen - np.array(points["measured"])) ** 2))

    for k in range(3):  # no turn nearby leaves less
        for step in (1e-4, -1e-4):
            moved = noisy.pose.copy()
            moved[:3, :3] = moved[:3, :3] @ turn(np.eye(3)[k], step)
            assert left(moved) > left(noisy.pose)


@pytest.mark.parametrize(("table", "said"), [
    ({"points_mm": {"nominal": [[0.0, 0, 0], [1, 0, 0]], "measured": [[0.0, 0, 0], [1, 0, 0]]}}, "at least 3"),
    ({"points_mm": {"nominal": [[0.0, 0, 0], [90, 0, 0], [180, 0, 0]], "measured": [[0.0, 0, 0]] * 3}}, "on one line"),
    ({"points_mm": {"nominal": [[0.0, 0, 0]] * 3, "measured": [[0.0, 0, 0]] * 2}}, "as many of each"),
    ({"position_mm": [1.0, 0, 0], "points_mm": {"nominal": [[0.0, 0, 0], [90, 0, 0], [0, 90, 0]],
                                                "measured": [[0.0, 0, 0], [90, 0, 0], [0, 90, 0]]}}, "expected one of"),
])  # fmt: skip
def test_points_that_make_no_frame_are_refused(table: dict[str, Any], said: str) -> None:
    table = tomllib.loads(_toml(table))
    with pytest.raises(InputError, match=said):
        check_job({"schema": 1, "robot": "ur10", "toolpath": "a.nc", "part": table}, "job.toml")


def _toml(table: dict[str, Any]) -> str:
    import tomli_w

    return tomli_w.dumps(_floats(table))


def _floats(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _floats(entry) for key, entry in value.items()}
    return [_floats(entry) for entry in value] if isinstance(value, list) else float(value)


def test_an_unconfirmed_pendant_and_a_spindle_below_the_part_are_asked_about() -> None:
    base = {"schema": 1, "robot": "doosan_m1013", "toolpath": "a.nc"}
    job = check_job({**base, "tool": {"frame": "pendant", "abc_deg": [0.0, 0.0, 0.0]}})
    notes = check_tool(job, load_robot("doosan_m1013"))
    assert len(notes) == 1 and "not confirmed" in notes[0]
    assert not check_tool(job, load_robot("kuka_kr16_2"))
    up, down = np.tile(Z, (3, 1)), np.tile(-Z, (3, 1))
    assert not check_spindle(up, job) and "on the side of -z" in check_spindle(down, job)
    turned = check_job({**base, "part": {"rotation_deg": [180.0, 0.0, 0.0]}})
    assert not check_spindle(down, turned) and check_spindle(up, turned)


def test_doctor_says_which_way_tool_0_jogs(monkeypatch, capsys) -> None:
    done = run_command(["doctor", "kuka_kr16_2", "--json"], monkeypatch, capsys)
    said = {finding["about"]: finding for finding in json.loads(done.out)["findings"]}
    assert done.status == 0 and said["pendant"]["state"] == "fine"
    assert "x points along -z and z along x of 'flange' (tool0 of ros-industrial" in said["pendant"]["sentence"]
    # a KUKA with every axis at 0 stretches its arm level: its tool then has B = 90 deg, x down and z ahead
    jog = said["jog check"]["sentence"]
    assert "with every axis at 0, tool 0 must jog along +x towards -z and along +z towards x of" in jog
