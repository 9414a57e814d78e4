"""What a user is told of a program: brands, unknown counting, feeds that a form cannot hold, swings."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command
from golden_cell import write_job

from compplan.controllers.readback.languages import read_krl
from compplan.controllers.readback.scripts import read_urscript
from compplan.controllers.writers import Program, build_program, check_brand, describe_program, write_program
from compplan.errors import InputError, ShapeError
from compplan.robot import load_robot
from compplan.toolpath.events import Event
from tests.controllers.test_golden_programs import make_program


@pytest.mark.parametrize(
    ("controller", "language"),
    [
        ("KUKA KRC4", "krl"), ("KUKA KRC4", "csv"), ("KUKA KRC4", "sinumerik"), ("Staubli CS8C", "val3"),
        ("Fanuc R-30iA", "fanuc_ls"), ("ABB IRC5", "rapid"), ("Universal Robots CB3", "urscript"),
        ("Yaskawa YRC1000", "inform"), ("Kawasaki F60", "kawasaki_as"), ("", "krl"), ("home made", "rapid"),
    ],
)  # fmt: skip
def test_a_controller_gets_the_language_of_its_brand(controller: str, language: str) -> None:
    check_brand(controller, language)


@pytest.mark.parametrize(
    ("controller", "language", "choices"),
    [
        ("KUKA KRC2", "fanuc_ls", "['krl', 'sinumerik', 'own', 'csv']"),
        ("Staubli CS8C", "krl", "['val3', 'sinumerik', 'own', 'csv']"),
        ("Fanuc R-30iA", "rapid", "['fanuc_ls', 'sinumerik', 'own', 'csv']"),
    ],
)
def test_a_program_for_another_brand_is_refused(controller: str, language: str, choices: str) -> None:
    with pytest.raises(InputError, match=f"{language} is the language of .*, choose from {re.escape(choices)}"):
        check_brand(controller, language)


def test_a_job_that_asks_for_another_brand_leaves_with_2_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write_job(tmp_path, "krl")
    file = tmp_path / "cell" / "controller.toml"
    file.write_text(file.read_text().replace('controller = "golden"', 'controller = "KUKA KRC2"'))
    text = job.read_text()
    job.write_text(text.replace('"krl"', '"fanuc_ls"'))
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 2 and not (tmp_path / "out").exists()
    assert re.fullmatch(r"error: .*golden.toml: output.programs: fanuc_ls is the language of FANUC, .*\n", answer.err)
    job.write_text(text.replace('"krl"', '"rapid"').replace("[output]", "[output]\nany_brand = true"))
    assert run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys).status == 0
    assert list((tmp_path / "out").glob("*.mod"))


def test_a_robot_whose_counting_nobody_states_gets_a_loud_note_on_the_terminal_and_in_every_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = write_job(tmp_path, "rapid")
    (tmp_path / "cell" / "controller.toml").unlink()
    answer = run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys)
    assert answer.status == 0
    assert "rapid: SIGNS AND ZEROS OF THE JOINTS ARE NOT KNOWN" in answer.out
    for name in ("golden.mod", "golden_L.mod"):
        assert "! SIGNS AND ZEROS OF THE JOINTS ARE NOT KNOWN" in (tmp_path / "out" / name).read_text()
    stops = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))["stops"]
    assert any("SIGNS AND ZEROS OF THE JOINTS ARE NOT KNOWN" in stop for stop in stops)
    settle = "before the machine moves: "
    assert [line for line in answer.out.splitlines() if line.startswith(settle)] == [f"{settle}{s}" for s in stops]


def make_creeping_program(folder: Path) -> Program:
    """Joint 1 turns by 1, 2 and 20 deg in a second each: 0.87, 1.75 and 17.45 % of 2 rad/s."""
    two = make_program(folder, "krl")
    joints = two.joints[[0, 0, 0, 0]] + np.outer([0.0, 1, 3, 23], [0, 1, 0, 0, 0, 0, 0])
    rows = {name: getattr(two, name)[[0, 0, 0, 0]] for name in ("feed", "rapid", "tcp", "status", "bent")}
    words = {key: values[[0, 0, 0, 0]] for key, values in two.words.items()}
    return replace(two, joints=joints, **rows, words=words, native={}, time=np.arange(4.0))


def test_joint_moves_in_whole_percents_that_miss_their_feed_are_counted(tmp_path: Path) -> None:
    program = make_creeping_program(tmp_path / "cell")
    notes = describe_program(program, "krl")
    assert notes[0].startswith("krl: KRL joint moves have whole percents of the axis rates: 2 of 4 do not hold")
    assert notes[1] == "krl: the linear program (_L) holds it"
    write_program(program, "krl", tmp_path / "out")
    assert "2 of 4 do not hold their feed" in (tmp_path / "out" / "two_J.src").read_text()
    assert [move.percent for move in read_krl(tmp_path / "out" / "two_J.src")] == [10, 1, 2, 17]
    assert {move.feed for move in read_krl(tmp_path / "out" / "two_L.src")} == {20.0}


def test_feeds_that_a_language_rounds_are_counted(tmp_path: Path) -> None:
    program = make_program(tmp_path / "fanuc_ls", "fanuc_ls")
    slow = replace(program, feed=np.array([0.15, 12.5]))
    said, rest = "feeds are written in steps of 0.1 mm/s", ": 1 are off by more than 1 %, the slowest is 0.15 mm/s"
    assert describe_program(slow, "fanuc_ls") == [f"fanuc_ls: {said}, below 1 mm/s of 0.1 cm/min{rest}"]
    assert f"inform: {said}{rest}" in describe_program(slow, "inform")


def test_swings_are_told_by_waypoint(tmp_path: Path) -> None:
    robot = load_robot("kuka_kr270")
    q = np.tile(np.radians([0.0, 20, -100, 30, 0, 0]), (4, 1))
    q[:, 4] = np.radians([-10, -5, 5, 10])
    program = build_program(robot, q, np.full(4, 0.1), np.zeros(4, bool), name="x", time=np.arange(4.0) * 0.01)
    notes = describe_program(program, "krl")
    assert (
        "krl: the arm flips (shoulder, elbow or wrist) during the cut at waypoints 2: do not run the linear program"
        in notes
    )


def test_a_robot_on_a_rail_gets_no_urscript(tmp_path: Path) -> None:
    program = replace(make_program(tmp_path / "cell", "krl"), controller="")
    assert program.prismatic.any()
    with pytest.raises(InputError, match="URScript"):
        write_program(program, "urscript", tmp_path / "out")


@pytest.mark.parametrize("name", ["feed", "rapid", "time", "tcp", "status"])
def test_arrays_that_do_not_belong_together_are_no_program(name: str, tmp_path: Path) -> None:
    program = make_program(tmp_path / "cell", "krl")
    array = getattr(program, name)
    with pytest.raises(ShapeError, match=f"program {name} has shape"):
        replace(program, **{name: np.concatenate([array, array[:1]])})


def test_a_table_says_that_it_holds_no_events_where_there_are_some_and_comments_are_none(tmp_path: Path) -> None:
    program = make_program(tmp_path / "cell", "krl")
    said = "are not in this table"
    assert not any(said in note for note in describe_program(program, "csv"))
    comments = replace(program, events=(Event(0, "comment", 0.0, "roughing"),))
    assert not any(said in note for note in describe_program(comments, "csv"))
    assert any(said in note for note in describe_program(replace(program, events=(Event(0, "coolant"),)), "csv"))


@pytest.mark.parametrize("robot", ["kuka_kr270", "ur10"])
def test_the_tool_stands_where_a_cut_begins_that_the_plan_approaches(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    language, name, x = {"kuka_kr270": ("krl", "c_L.src", 1700), "ur10": ("urscript", "c_L.script", -700)}[robot]
    job = tmp_path / "c.toml"
    job.write_text(
        f'schema = 1\nrobot = "{robot}"\n[toolpath]\ngenerator = "circle"\nradius_mm = 10.0\nfeed_mm_s = 10.0\n'
        f"waypoints = 60\n[part]\nposition_mm = [{x}.0, 0.0, 300.0]\n"
        '[process]\nmodel = "constant"\nforce_N = [0.0, 10.0, -35.0]\n'
        f'[plan]\nrotate_about_tool_axis = false\n[output]\nprograms = ["{language}"]\n'
    )
    assert run_command(["plan", job, "--out", tmp_path / "out"], monkeypatch, capsys).status == 0
    moves = {"krl": read_krl, "urscript": read_urscript}[language](tmp_path / "out" / name)
    first = next(index for index, move in enumerate(moves) if move.kind != "joint")
    assert moves[first].stops and not moves[first + 1].stops
