"""What `compplan init` writes can be used at once: a job of a robot and a toolpath, a robot folder, an empty log."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.controllers.writers.joint_convention import load_controller, locate_pendant
from compplan.job.job import load_job
from compplan.measurement.reading import read_campaign
from compplan.robot import load_robot
from compplan.robot.folder import find_robot_folder, robot_folders
from compplan.robot.folder_template import build_skeleton
from compplan.robot.mounting import name_axis, outward_axis
from compplan.statics.chain import build_chain, locate_frames


def test_a_job_names_the_robot_its_own_language_and_the_toolpath(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "part.nc").write_text("G21 G90\nG1 X10 F600\nX20\n")
    file = tmp_path / "part.toml"
    done = run_command(["init", file, "--robot", "kuka_kr240", "--toolpath", "part.nc"], monkeypatch, capsys)
    assert done.status == 0
    job = load_job(file)
    data = tomllib.loads(file.read_text())
    assert data["toolpath"] == "part.nc" and "generator" not in file.read_text().partition("[part]")[0]
    assert job.robot == "kuka_kr240" and data["output"]["programs"] == ["krl"]
    assert data["process"]["model"] == "milling" and "axial_N" not in data["process"]
    assert "assumed: put yours" in file.read_text()


def test_two_tools_are_numbered_where_the_folder_has_a_tool_of_its_own(tmp_path: Path, monkeypatch, capsys) -> None:
    # the table [tool] is a comment then, with comments in it
    code = "G21 G90 G54\nT1 M6\nG0 X0 Y0 Z5\nG1 Z-1 F600\nG1 X20\nG0 Z5\nT2 M6\nG0 X0 Y5\nG1 Z-1\nG1 X20\nG0 Z5\nM30\n"
    (tmp_path / "two.nc").write_text(code, encoding="utf-8")
    two = ["init", tmp_path / "two.toml", "--robot", "staubli_tx200", "--toolpath", "two.nc"]
    assert run_command(two, monkeypatch, capsys).status == 0
    tools = tomllib.loads((tmp_path / "two.toml").read_text(encoding="utf-8"))["tool"]
    assert [tool["number"] for tool in tools] == [1, 2] and tools[1]["position_mm"][2] == 150.0


def test_a_table_of_waypoints_brings_its_own_forces_or_none(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "path.csv").write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_s\n0,0,0,0,0,1,20\n10,0,0,0,0,1,20\n")
    file = tmp_path / "part.toml"
    done = run_command(["init", file, "--toolpath", "path.csv"], monkeypatch, capsys)
    assert done.status == 0, done.err
    assert tomllib.loads(file.read_text())["process"] == {"model": "columns"}
    assert load_job(file).process.model == "columns"


@pytest.mark.parametrize("name", sorted(robot_folders()))
def test_a_robot_folder_is_made_from_its_urdf_alone(name: str, tmp_path: Path, monkeypatch, capsys) -> None:
    urdf = tmp_path / "arm.urdf"
    shutil.copy(find_robot_folder(name) / "robot.urdf", urdf)
    (tmp_path / "arm").mkdir()  # empty, as a run that was killed may leave it
    done = run_command(["init", "robot", urdf, "--out", tmp_path / "arm"], monkeypatch, capsys)
    assert done.status == 0, done.err
    made, shipped = load_robot(tmp_path / "arm"), load_robot(name)
    assert made.joint_names == shipped.joint_names and made.springs == () and made.grade == "placeholder"
    np.testing.assert_allclose(made.acceleration_limits, 2.0 * made.velocity_limits, rtol=0.01)
    file = tmp_path / "arm" / "elasticity.toml"
    head, *springs = file.read_text().split("\n# [[spring]]\n")
    file.write_text(head + "".join("\n[[spring]]\n" + block.replace("# ", "") for block in springs))
    assert len(load_robot(tmp_path / "arm").springs) == made.nq


def test_the_empty_log_is_read_once_it_has_rows(tmp_path: Path, monkeypatch, capsys) -> None:
    file = tmp_path / "log.csv"
    assert run_command(["init", "log", "--robot", "kuka_kr240_rail", "--out", file], monkeypatch, capsys).status == 0
    robot = load_robot("kuka_kr240_rail")
    assert "q1_mm,q2_deg" in file.read_text()
    rows = [f"static1,{k},{100 * k},0,-90,90,0,10,0,0,0,-{100 * k},0,0,0,{1500 + k},0,1800,20,0.03" for k in range(4)]
    file.write_text(file.read_text() + "\n".join(rows) + "\n")
    campaign = read_campaign(file, robot)
    assert len(campaign) == 4 and campaign.q[2, 0] == pytest.approx(0.2) and campaign.wrench[3, 2] == -300.0


@pytest.mark.parametrize(
    "words",
    [
        ["init", "robot"],
        ["init", "log"],
        ["init", "a.toml", "b.toml"],
        ["init", "robot", "no.urdf"],
        ["init", "x.toml", "--tcp", "tool0"],
        ["init", "x.toml", "--toolpath", "no.nc"],
        ["init", "x.toml", "--robot", "no_robot"],
        ["init", "x.csv"],
        ["init", "x.toml", "--toolpath", __file__],
        ["doctor", "ur10", "--robot", "kuka_kr270"],
        ["convert", "no.nc", "--out", "x.nc"],
    ],
)
def test_words_that_make_no_sense_end_in_one_line_and_write_nothing(words, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and done.err.startswith("error: ") and done.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_first_job_of_a_small_arm_has_a_force_that_its_joints_bear(tmp_path, monkeypatch, capsys) -> None:
    answer = run_command(["init", tmp_path / "job.toml", "--robot", "fanuc_lrmate200id7l"], monkeypatch, capsys)
    assert answer.status == 0, answer.err
    job = load_job(tmp_path / "job.toml")
    push, lever = job.process.axial_N, 1e-3 * job.part.position_mm[0]  # of a push along the axis on the second joint
    effort = load_robot("fanuc_lrmate200id7l").effort_limits[1]
    assert push * lever < effort < 1200.0 * lever and push > 10.0
    assert job.process.lateral_N == pytest.approx(push / 3.0, rel=0.1)


EE_LINK = """<robot name="arm"><link name="base_link"/><link name="a"/><link name="b"/><link name="ee_link"/>
<joint name="j1" type="revolute"><parent link="base_link"/><child link="a"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="2" effort="9"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="9"/></joint>
<joint name="fixed" type="fixed"><parent link="b"/><child link="ee_link"/><origin xyz="0 0.1 0"
rpy="0 0 1.5707963267948966"/></joint></robot>
"""


def test_a_urdf_that_does_not_say_which_axis_leaves_the_tool_is_refused_until_it_is_told(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    (tmp_path / "arm.urdf").write_text(EE_LINK)
    words = ["init", "robot", tmp_path / "arm.urdf", "--out", tmp_path / "arm"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 2 and "does not state which axis of 'ee_link' points out of the tool" in done.err
    assert "turns about x of it: a straight tool leaves along x or -x" in done.err and not (tmp_path / "arm").exists()
    done = run_command([*words, "--tool-axis", "x"], monkeypatch, capsys)
    assert done.status == 0, done.err
    robot = load_robot(tmp_path / "arm")
    assert (robot.tcp, robot.flange) == ("tool0", "ee_link") and outward_axis(robot).tolist() == [1.0, 0.0, 0.0]
    frames = locate_frames(build_chain(robot), np.zeros((1, 2)))
    assert frames.tcp_position[0] == pytest.approx([0.5, 0.1, 0.4])
    assert frames.tcp_rotation[0][:, 2] == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)  # x of ee_link is y of the base
    counting = load_controller(robot)
    assert counting.unchecked and counting.joint_names == ("J1", "J2")
    text = (tmp_path / "arm" / "controller.toml").read_text()
    assert "# z         = [1.0, 0.0, 0.0]" in text and "checked     = false" in text
    done = run_command(["doctor", tmp_path / "arm"], monkeypatch, capsys)
    assert done.status == 0 and "checked = false" in done.out


@pytest.mark.parametrize("axis", ["x", "-x", "y", "-y", "z", "-z"])
def test_z_of_the_new_frame_points_along_the_axis_that_was_named(tmp_path: Path, axis: str) -> None:
    (tmp_path / "arm.urdf").write_text(EE_LINK)
    for name, text in build_skeleton(tmp_path / "arm.urdf", tool_axis=axis).texts.items():
        (tmp_path / name).write_text(text)
    assert name_axis(outward_axis(load_robot(tmp_path))) == axis


def test_a_tool0_gives_the_pendant_its_frame_and_counts_as_unconfirmed(tmp_path: Path) -> None:
    for name, text in build_skeleton(find_robot_folder("fanuc_m20ia") / "robot.urdf").texts.items():
        (tmp_path / name).write_text(text)
    found, shipped = locate_pendant(load_robot(tmp_path)), locate_pendant(load_robot("fanuc_m20ia"))
    assert found is not None and shipped is not None and found.stated and not found.confirmed
    assert found.pose == pytest.approx(shipped.pose, abs=1e-8)
