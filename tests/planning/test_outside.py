"""What a job reads from outside its folder is said, in plan.json and on the terminal."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
import trimesh
from commandline import run_command

from compplan.job.job import load_job
from compplan.planning.notes import describe_outside, list_outside
from compplan.robot import load_robot

GOOD = Path(__file__).parents[1] / "bad_inputs" / "good"


@pytest.fixture
def work(tmp_path: Path) -> Path:
    shutil.copytree(GOOD, tmp_path / "work")
    (tmp_path / "secret.txt").write_text("; a line\n")
    return tmp_path / "work"


def change_job(work: Path, old: str, new: str) -> Path:
    file = work / "job.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    return file


def test_a_job_that_stays_in_its_folder_says_nothing(work: Path) -> None:
    job = load_job(work / "job.toml")
    assert describe_outside(job, load_robot(work / "robot")) == ""


@pytest.mark.parametrize("how", ["relative", "absolute", "link"])
def test_a_header_from_elsewhere_is_said_in_plan_and_terminal(how, work, tmp_path, monkeypatch, capsys) -> None:
    secret = tmp_path / "secret.txt"
    name = {"relative": "../secret.txt", "absolute": str(secret), "link": "inside.txt"}[how]
    if how == "link":
        (work / "inside.txt").symlink_to(secret)
    file = change_job(work, 'programs = ["krl"]', f'programs = ["krl"]\nheader = {{ krl = "{name}" }}')
    answer = run_command(["plan", file, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0
    said = f"output.header.krl = {secret} (its lines go into the program)"
    assert said in answer.out
    assert any(said in note for note in json.loads((tmp_path / "out" / "plan.json").read_text())["notes"])


def test_toolpaths_meshes_and_robots_from_elsewhere_are_listed(work: Path, tmp_path: Path) -> None:
    shutil.move(work / "path.csv", tmp_path / "path.csv")
    shutil.move(work / "robot", tmp_path / "robot")
    shutil.move(work / "block.stl", tmp_path / "block.stl")
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "link.stl")
    urdf = tmp_path / "robot" / "robot.urdf"
    shape = f'<visual><geometry><mesh filename="file://{tmp_path / "link.stl"}"/></geometry></visual>'
    urdf.write_text(urdf.read_text().replace('<link name="link_2">', f'<link name="link_2">{shape}', 1))
    change_job(work, 'robot = "robot"', 'robot = "../robot"')
    change_job(work, "[plan]", '[collision]\npart = "../block.stl"\n[plan]')
    file = change_job(work, 'toolpath = "path.csv"', 'toolpath = "../path.csv"')
    found = dict(list_outside(load_job(file), load_robot(tmp_path / "robot")))
    mesh = f"mesh 'file://{tmp_path / 'link.stl'}' of robot.urdf"
    assert found == {
        "toolpath": tmp_path / "path.csv",
        "collision.part": tmp_path / "block.stl",
        "robot": tmp_path / "robot",
        mesh: tmp_path / "link.stl",
    }
