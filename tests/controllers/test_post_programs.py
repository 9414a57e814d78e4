"""Each program is read back by a small reader of its own and holds the joints to the digits that are written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from program_readers import read_fanuc, read_val3
from program_readers import read_krl as read_krl_program
from scipy.spatial.transform import Rotation
from script_readers import read_urscript

from compplan.controllers.writers import Program, build_program, write_program
from compplan.controllers.writers.krl import turn_bits
from compplan.controllers.writers.program import Post, split_parts
from compplan.controllers.writers.text import legal_name
from compplan.errors import InputError, UnknownNameError
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames

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


def read_krl(point: str) -> list[float]:
    return [float(value) for value in re.findall(rf"[A-Z]\d? ({NUMBER})", point)]


def test_krl_programs_hold_joints_and_poses(tmp_path: Path) -> None:
    program = make_program("kuka_kr270")
    files = write_program(program, "krl", tmp_path, most=20)
    assert {len(file.stem) <= 24 for file in files} == {True}
    for kind, columns in (("J", 6), ("L", 8)):
        rows = []
        for part in (1, 2, 3):
            ending, point = ("dat", r"^PT\[\d+\]=\{(.*)\}") if kind == "J" else ("src", r"^LIN \{(.*)\}")
            text = (tmp_path / f"{legal_name(program.name, 21)}_{kind}{part}.{ending}").read_text()
            points = re.findall(point, text, re.M)
            assert len(points) <= 20
            rows += [read_krl(point)[:columns] for point in points]
        table, kept = np.array(rows), np.full(N, True) if kind == "J" else ~program.alone(linear=True)
        assert len(table) == kept.sum()
        if kind == "J":
            assert np.abs(table - program.joints).max() <= 0.5e-6
        else:
            pose = locate_frames(build_chain(load_robot("kuka_kr270")), make_q("kuka_kr270"))
            assert np.abs(table[:, :3] - pose.tcp_position[kept] * 1e3).max() < 1e-5
            turned = Rotation.from_euler("ZYX", table[:, 3:6], degrees=True).as_matrix()
            assert np.abs(turned - pose.tcp_rotation[kept]).max() < 1e-7
            assert program.status is not None and np.array_equal(table[:, 6], program.status[kept])
            assert table[:, 7].tolist() == [turn_bits(row) for row in program.joints[kept]]
    main = (tmp_path / f"{legal_name(program.name, 21)}_L.src").read_text()
    assert len(re.findall(r"_L\d\(\)", main)) == 3
    assert "$TOOL={X 0.0000000,Y 0.0000000,Z 0.0000000,A 0.0000000,B 0.0000000,C 0.0000000}" in main


def test_krl_programs_of_a_rail_move_the_external_axis(tmp_path: Path) -> None:
    program = make_program("kuka_kr240_rail")
    write_program(program, "krl", tmp_path)
    text = next(tmp_path.glob("*_J1.dat")).read_text()
    rail = [float(value) for value in re.findall(rf"E1 ({NUMBER})", text)][:N]
    assert rail == pytest.approx(program.joints[:, 0], abs=1e-4)


def test_val3_projects_hold_joints_feeds_and_the_tool(tmp_path: Path) -> None:
    program = make_program("staubli_tx200")
    files = write_program(program, "val3", tmp_path, most=20)
    project = files[0].parent
    for file in project.iterdir():
        ElementTree.fromstring(file.read_text())
    space = {"v": "http://www.staubli.com/robotics/VAL3/Data/2"}
    root = ElementTree.fromstring(next(project.glob("*.dtx")).read_text())
    data = {element.get("name"): element for element in root.iterfind(".//v:Data", space)}
    joints, feeds = [], []
    for part in (1, 2, 3):
        points = data[f"jPath{part}"].findall("v:Value", space)
        assert int(data[f"jPath{part}"].get("size", 0)) == len(points) <= 20
        joints += [[float(point.get(f"j{index}", "nan")) for index in range(1, 7)] for point in points]
        feeds += [float(value.get("value", "nan")) for value in data[f"nFeed{part}"].findall("v:Value", space)]
    assert np.abs(np.array(joints) - program.joints).max() <= 0.5e-6
    assert np.array(feeds) == pytest.approx(np.where(program.rapid, 0, 20))
    tool = data["tTool"].find("v:Value", space)
    assert tool is not None and float(tool.get("z", "nan")) == pytest.approx(275.7)
    listed = re.findall(r'<Program file="(.*?)"', next(project.glob("*.pjx")).read_text())
    assert {file.name for file in project.glob("*.pgx")} == set(listed)


def test_fanuc_programs_hold_joints_and_feeds(tmp_path: Path) -> None:
    program = make_program("fanuc_m10ia")
    files = [file for file in write_program(program, "fanuc_ls", tmp_path, most=20) if "_L" not in file.stem]
    rows, feeds = [], []
    for file in files[:-1]:
        text = file.read_text()
        moves, positions = text.split("/POS")
        points = positions.split("P[")[1:]
        rows += [[float(value) for value in re.findall(rf"J\d= +({NUMBER}) deg", point)] for point in points]
        feeds += [float(speed or 0) for speed in re.findall(rf":[JL] P\[\d+\] (?:20%|({NUMBER})mm/sec)", moves)]
        count = re.search(r"LINE_COUNT\s*= (\d+)", text)
        assert count is not None and int(count.group(1)) == len(re.findall(r"^ *\d+:", moves, re.M))
    assert np.abs(np.array(rows) - program.joints).max() <= 0.5e-6
    assert np.array(feeds) == pytest.approx(np.where(program.rapid, 0, 20))
    assert re.findall(r"CALL (\w+)", files[-1].read_text()) == [file.stem for file in files[:-1]]


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


@pytest.mark.parametrize("name", ["ur10", "kuka_kr240_rail"])
def test_rapid_modules_hold_joints_feeds_and_external_axes(tmp_path: Path, name: str) -> None:
    program = make_program(name)
    written = write_program(program, "rapid", tmp_path, most=20, any_brand=True)
    files = [file for file in written if "_L" not in file.stem]
    rows = []
    for file in files[:-1]:
        rows += re.findall(r"MoveAbsJ \[\[(.*?)\],\[(.*?)\]\],\[([\d.]+),", file.read_text())
    axes = np.array([[float(value) for value in arm.split(",")] for arm, _, _ in rows])
    assert np.abs(axes - program.joints[:, ~program.prismatic]).max() <= 0.5e-6
    if program.prismatic.any():
        rail = [float(external.split(",")[0]) for _, external, _ in rows]
        assert rail == pytest.approx(program.joints[:, 0], abs=1e-5)
    assert [float(speed) for *_, speed in rows] == pytest.approx(np.where(program.rapid, 500, 20))
    assert len(re.findall(r"run_\w+;", files[-1].read_text())) == len(files) - 1


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
    assert len(moves) == N


def test_programs_that_do_not_fit_a_language_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"KRL programs need joints named \['A1'"):
        write_program(make_program("ur10"), "krl", tmp_path, any_brand=True)
    with pytest.raises(InputError, match="six rotating joints"):
        write_program(make_program("kuka_kr240_rail"), "val3", tmp_path, any_brand=True)
    with pytest.raises(UnknownNameError, match="no program language named 'basic', choose from"):
        write_program(make_program("ur10"), "basic", tmp_path)
    with pytest.raises(InputError, match="max_points_per_file is 0"):
        split_parts(10, 0)
    assert not list(tmp_path.iterdir())


def plain_program(rotating: int, sliding: int) -> Program:
    """Two rows of an arm that stands still, rails first, from arrays alone."""
    count = rotating + sliding
    names, slides = tuple(f"J{k}" for k in range(1, count + 1)), np.arange(count) < sliding
    return Program("still", np.zeros((2, count)), names, slides, np.full(2, 20.0), np.zeros(2, bool))


@pytest.mark.parametrize(("language", "most"), [("fanuc_ls", 3), ("rapid", 6)])
def test_six_rotating_joints_and_as_many_rails_as_the_language_takes(language: str, most: int, tmp_path: Path) -> None:
    assert write_program(plain_program(6, most), language, tmp_path)
    for rotating, sliding in ((7, 0), (6, most + 1)):
        with pytest.raises(InputError, match="take six rotating and"):
            write_program(plain_program(rotating, sliding), language, tmp_path)
