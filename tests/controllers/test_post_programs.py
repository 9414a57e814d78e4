"""Each program is read back by a small reader of its own and holds the joints to the digits that are written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from compplan.controllers.readback.languages import read_fanuc, read_rapid, read_val3
from compplan.controllers.readback.languages import read_krl as read_krl_program
from compplan.controllers.readback.scripts import read_urscript
from compplan.controllers.writers import Program, build_program, write_program
from compplan.controllers.writers.krl import turn_bits
from compplan.controllers.writers.program import Post
from compplan.errors import InputError, UnknownNameError
from compplan.robot import load_robot

NUMBER = r"[-+]?\d+\.?\d*"
N = 45


def make_q(robot_name: str) -> np.ndarray:
    robot = load_robot(robot_name)
    rng = np.random.default_rng(7)
    return rng.uniform(np.maximum(robot.lower, -3), np.minimum(robot.upper, 3), (N, robot.nq))


def make_program(robot_name: str, **changes: object) -> Program:
    rapid = np.isin(np.arange(N), [0, 1, 20, N - 1])
    options: dict[str, object] = {"name": "ISF cone, 40 mm / 45 deg", "comments": ["made for a test"]}
    program = build_program(load_robot(robot_name), make_q(robot_name), np.full(N, 0.02), rapid, **(options | changes))
    return replace(program, post=Post(overwrite=True))


#: Shipped robots: language, what a main program of joint moves is called, its reader, feed and percent of rapid moves.
JOINTS = {
    "kuka_kr270": ("krl", "*_J.src", read_krl_program, None, 20.0),
    "kuka_kr240_rail": ("krl", "*_J.src", read_krl_program, None, 20.0),
    "staubli_tx200": ("val3", "*deg", read_val3, None, 20.0),
    "fanuc_m10ia": ("fanuc_ls", "*DEG.LS", read_fanuc, None, 20.0),
    "ur10": ("rapid", "*deg.mod", read_rapid, 500.0, None),
}


@pytest.mark.parametrize("name", JOINTS)
def test_programs_in_parts_hold_joints_and_feeds(name: str, tmp_path: Path) -> None:
    language, pattern, read, feed, percent = JOINTS[name]
    program = make_program(name)
    files = write_program(program, language, tmp_path, most=20, any_brand=True)
    (main,) = tmp_path.glob(pattern)
    moves = read(main)
    joints = np.array(
        [[*(move.external[:1] if program.prismatic.any() else ()), *(move.joints or ())] for move in moves]
    )
    assert np.abs(joints - program.joints).max() <= (5e-5 if program.prismatic.any() else 0.5e-6)
    for move, rapid in zip(moves, program.rapid.tolist(), strict=True):
        if rapid:
            assert (move.feed, move.percent) == (feed, percent)
        else:
            assert move.feed == 20.0 or (language == "krl" and 1.0 <= (move.percent or 0.0) <= 100.0)
    calls = {"krl": r"_J\d\(\)", "val3": r"call part\d", "fanuc_ls": r"CALL \w+_\d", "rapid": r"run_\w+_\d;"}[language]
    assert len(re.findall(calls, (main / "start.pgx" if main.is_dir() else main).read_text())) == 3
    assert {len(file.stem) <= {"krl": 24, "rapid": 32, "fanuc_ls": 36}.get(language, 36) for file in files} == {True}
    for file in files if language == "fanuc_ls" else ():
        count = re.search(r"LINE_COUNT\s*= (\d+)", file.read_text())
        assert count and int(count[1]) == len(re.findall(r"^ *\d+:", file.read_text().split("/POS")[0], re.M))
    if main.is_dir():
        listed = re.findall(r'<Program file="(.*?)"', next(main.glob("*.pjx")).read_text())
        assert {file.name for file in main.glob("*.pgx")} == set(listed)
        assert all(ElementTree.fromstring(file.read_text()) is not None for file in main.iterdir())


def test_a_fanuc_move_below_a_millimetre_a_second_is_in_the_unit_that_takes_it(tmp_path: Path) -> None:
    # a linear speed is 1 to 2000 mm/sec or 1 to 12000 cm/min
    program = make_program("fanuc_m10ia")
    slow = replace(program, feed=np.where(program.rapid, program.feed, np.linspace(0.1, 1.2, len(program))))
    file = write_program(slow, "fanuc_ls", tmp_path)[0]
    said = re.findall(rf":L P\[\d+\] ({NUMBER})(\S+) ", file.read_text())
    assert {unit for _, unit in said} == {"mm/sec", "cm/min"} and min(float(value) for value, _ in said) >= 1.0
    read = [move.feed for move in read_fanuc(file) if move.kind == "line"]
    assert read == pytest.approx(np.maximum(slow.feed[~slow.rapid], 1.0 / 6.0), abs=0.051)


def test_the_load_of_a_universal_robot_is_set_by_the_word_of_its_controller(tmp_path: Path) -> None:
    for name, word in (("ur10", "set_payload"), ("ur10e", "set_target_payload")):
        program = replace(make_program(name), mass=2.0, centre=np.array([0.0, 0.0, 0.05]))
        file = write_program(program, "urscript", tmp_path / name)[-1]
        assert f"\n  {word}(2.000, [0.000000, 0.000000, 0.050000])\n" in file.read_text()
        assert read_urscript(file)[-1].load == (2.0, 0.0, 0.0, 50.0)


#: Robots that ship, with the form that carries positions and the frame that it counts from, as SOURCES state them:
#: the Fanuc's and the Staubli's where axis 1 meets axis 2. [mm]
POSITIONS = {
    "kuka_kr270": ("krl", "x_L.src", read_krl_program, 0.0),
    "kuka_kr240_rail": ("krl", "x_L.src", read_krl_program, 0.0),
    "fanuc_m10ia": ("fanuc_ls", "X_L.LS", read_fanuc, 450.0),
    "staubli_tx200": ("val3", "x_L", read_val3, 642.0),
    "ur10": ("urscript", "x_L.script", read_urscript, 0.0),
}


@pytest.mark.parametrize("name", POSITIONS)
def test_positions_lead_back_to_the_poses_of_another_engine(name: str, tmp_path: Path) -> None:
    """Pinocchio reads the URDF; the tool, the part and the height of the world frame are put in by hand."""
    language, file, read, height = POSITIONS[name]
    robot = load_robot(name)
    tool, part = np.eye(4), np.eye(4)
    tool[:3, :3] = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True).as_matrix()
    tool[:3, 3] = [0.11, -0.03, 0.07]
    part[:3, :3] = Rotation.from_euler("ZYX", [-60, 25, 140], degrees=True).as_matrix()
    part[:3, 3] = [0.9, -0.4, 0.3]
    q = make_q(name)
    program = build_program(
        robot.with_tool(tool), q, np.full(N, 0.02), np.zeros(N, bool), name="x", part=part, time=np.arange(N) * 1.0
    )
    write_program(replace(program, words={}, bent=None, post=Post(overwrite=True)), language, tmp_path)
    moves = read(tmp_path / file)
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    world = np.eye(4)
    world[2, 3] = height
    for row, move in enumerate(moves):
        pin.framesForwardKinematics(model, data, q[row])
        wanted = data.oMf[model.getFrameId(robot.flange)].homogeneous @ tool
        found = world @ move.base @ move.pose
        assert np.abs(found[:3, 3] - wanted[:3, 3] * 1e3).max() < 1e-4
        turned = Rotation.from_matrix(found[:3, :3].T @ wanted[:3, :3]).magnitude()
        assert np.degrees(turned) < 1e-5
        if language == "krl":
            assert program.status is not None
            assert move.configuration == (program.status[row], turn_bits(program.joints[row, ~program.outer]))
    assert len(moves) == N


def test_programs_that_do_not_fit_a_language_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"KRL programs need joints named \['A1'"):
        write_program(make_program("ur10"), "krl", tmp_path, any_brand=True)
    with pytest.raises(InputError, match="six rotating joints"):
        write_program(make_program("kuka_kr240_rail"), "val3", tmp_path, any_brand=True)
    with pytest.raises(UnknownNameError, match="no program language named 'basic', choose from"):
        write_program(make_program("ur10"), "basic", tmp_path)
    with pytest.raises(InputError, match="max_points_per_file is -1"):
        write_program(make_program("ur10"), "urscript", tmp_path, most=-1)
    assert not list(tmp_path.iterdir())


def plain_program(rotating: int, sliding: int) -> Program:
    """Two rows of an arm that stands still, rails first, from arrays alone."""
    count = rotating + sliding
    names, slides = tuple(f"J{k}" for k in range(1, count + 1)), np.arange(count) < sliding
    return Program(
        "still", np.zeros((2, count)), names, slides, np.full(2, 20.0), np.zeros(2, bool), np.tile(np.eye(4), (2, 1, 1))
    )


@pytest.mark.parametrize(("language", "most"), [("fanuc_ls", 3), ("rapid", 6)])
def test_six_rotating_joints_and_as_many_rails_as_the_language_takes(language: str, most: int, tmp_path: Path) -> None:
    assert write_program(plain_program(6, most), language, tmp_path)
    for rotating, sliding in ((7, 0), (6, most + 1)):
        with pytest.raises(InputError, match="take six rotating and"):
            write_program(plain_program(rotating, sliding), language, tmp_path)
