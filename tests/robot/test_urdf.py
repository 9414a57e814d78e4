"""URDFs that are odd in a lawful way: colours that are none, more links than an arm has."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.reporting.scenes import UNPAINTED, place_shapes
from compplan.robot import load_robot
from compplan.simulation.exact_model import read_exact_robot

GOOD = Path(__file__).parents[1] / "bad_inputs" / "good"


def write_robot(folder: Path, *, into_joint: str = "", before_end: str = "", encoding: str = "utf-8") -> Path:
    """Copy the good robot; put XML into joint_1 and before the end."""
    shutil.copytree(GOOD / "robot", folder)
    text = (folder / "robot.urdf").read_text(encoding="utf-8")
    start = text.index("</joint>", text.index('name="joint_1"'))
    text = text[:start] + into_joint + text[start:].replace("</robot>", f"{before_end}</robot>")
    (folder / "robot.urdf").write_text(text, encoding=encoding)
    return folder


def hang_links(count: int, *, chain: bool) -> str:
    """Return links that hang on the base, or on one another."""
    above = ["base_link", *(f"x{k}" if chain else "base_link" for k in range(count))]
    return "".join(
        f'<link name="x{k}"/><joint name="j{k}" type="fixed"><parent link="{above[k]}"/><child link="x{k}"/></joint>'
        for k in range(count)
    )


@pytest.mark.parametrize("colour", ["orange", "1 0 0", "nan 0 0 1", "255 0 0 1", ""])
def test_a_colour_that_is_none_is_drawn_grey_and_stops_no_plan(colour, tmp_path, capfd) -> None:
    paint = f'<material name="m"><color rgba="{colour}"/></material>'
    shown = f'<link name="deco"><visual><geometry><box size="1 1 1"/></geometry>{paint}</visual></link>'
    hung = '<joint name="hang" type="fixed"><parent link="base_link"/><child link="deco"/></joint>'
    robot = load_robot(write_robot(tmp_path / "robot", before_end=paint.replace('"m"', '"n"') + shown + hung))
    deco = [shape for shape in place_shapes(robot, np.zeros(robot.nq)) if shape.link == "deco"]
    assert [shape.colour for shape in deco] == [UNPAINTED]
    read_exact_robot(tmp_path / "robot")
    assert capfd.readouterr().err == ""


def test_the_judge_reads_a_robot_that_is_written_in_latin_1(tmp_path) -> None:
    folder = write_robot(tmp_path / "robot", before_end="<!-- f\u00fcr -->", encoding="latin-1")
    text = (folder / "elasticity.toml").read_text(encoding="utf-8")
    (folder / "elasticity.toml").write_bytes(f"# f\u00fcr\n{text}".encode("latin-1"))
    plain = read_exact_robot(GOOD / "robot")
    assert read_exact_robot(folder).model.nq == plain.model.nq


@pytest.mark.parametrize(
    "extra", ["<safety_controller/>", "<dynamics damping='x'/>", "<calibration rising='x'/>", "<limit/>", "<axis/>"]
)
def test_the_judge_reads_past_what_moves_nothing(extra, tmp_path, capfd) -> None:
    folder = write_robot(tmp_path / "robot", into_joint=extra, before_end="<transmission/><gazebo><a/></gazebo>")
    text = (folder / "robot.urdf").read_text()
    (folder / "robot.urdf").write_text(re.sub(r' effort="[^"]*"', "", text, count=2))
    plain, robot = load_robot(GOOD / "robot"), load_robot(folder)
    assert [joint.upper for joint in robot.joints] == [joint.upper for joint in plain.joints]
    judges = [read_exact_robot(place).model for place in (GOOD / "robot", folder)]
    assert [str(joint) for joint in judges[0].joints] == [str(joint) for joint in judges[1].joints]
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("chain", [True, False])
def test_a_urdf_of_20000_links_is_refused_in_one_line(chain, tmp_path, monkeypatch, capsys) -> None:
    extra = hang_links(20_000, chain=chain)
    shutil.copytree(GOOD, tmp_path / "work")
    shutil.rmtree(tmp_path / "work" / "robot")
    write_robot(tmp_path / "work" / "robot", before_end=extra)
    answer = run_command(["plan", tmp_path / "work" / "job.toml", "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2
    assert "at most 1000 are read" in answer.err
    assert not (tmp_path / "out").exists()


def test_the_judge_reads_a_chain_of_as_many_links_as_are_allowed(tmp_path) -> None:
    known = len(load_robot(GOOD / "robot").joints) + 1
    load_robot(write_robot(tmp_path / "robot", before_end=hang_links(1000 - known, chain=True)))
    assert read_exact_robot(tmp_path / "robot").model.nq > 0


def test_a_mass_beside_the_chain_counts_with_the_link_that_carries_it_turned_and_moved(tmp_path) -> None:
    box = (
        '<link name="box"><inertial><origin xyz="0.1 0 0" rpy="0 0 0"/><mass value="7"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial></link>'
        '<joint name="hold" type="fixed"><origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/>'
        '<parent link="link_2"/><child link="box"/></joint>'
    )
    robot = load_robot(write_robot(tmp_path / "robot", before_end=box))
    (found,) = (body for body in robot.bodies if body.mass == 7.0)
    assert found.link == "link_2" and found.centre == pytest.approx([0.0, 0.1, 0.5])
    assert found.inertia == pytest.approx(np.diag([2.0, 1.0, 3.0]))
