"""One program a language, from the job to the file, read back by its own reader and held against numbers by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from commandline import run_command
from golden_cell import CENTRE, COUNTING, FEED, MASS, PART, TOOL, WAYPOINTS, forward, write_job, write_robot

from compplan.controllers.readback.comparison import compare_declared, read_declared
from compplan.controllers.readback.joint_table import read_csv
from compplan.controllers.readback.languages import read_fanuc, read_krl, read_rapid, read_val3
from compplan.controllers.readback.poses import Move, kuka_pose, shift
from compplan.controllers.readback.scripts import read_inform, read_kawasaki, read_sinumerik, read_urscript
from compplan.controllers.writers import Program, build_program, write_program
from compplan.controllers.writers.program import Post
from compplan.robot import load_robot

AXES = ("E1", "A1", "A2", "A3", "A4", "A5", "A6")
#: What each language writes, by reader: file or folder in the output, and whether it carries the tool.
FORMS: dict[str, tuple[str, Callable[[Path], list[Move]], bool]] = {
    "krl joint": ("{}_J.src", read_krl, True),
    "krl linear": ("{}_L.src", read_krl, True),
    "val3 joint": ("{}", read_val3, True),
    "val3 linear": ("{}_L", read_val3, True),
    "fanuc_ls joint": ("{}.LS", read_fanuc, True),
    "fanuc_ls linear": ("{}_L.LS", read_fanuc, True),
    "rapid joint": ("{}.mod", read_rapid, True),
    "rapid linear": ("{}_L.mod", read_rapid, True),
    "urscript joint": ("{}.script", read_urscript, True),
    "urscript linear": ("{}_L.script", read_urscript, True),
    "sinumerik linear": ("{}.MPF", read_sinumerik, False),
    "inform joint": ("{}.JBI", read_inform, True),
    "inform linear": ("{}_L.JBI", read_inform, True),
    "kawasaki_as joint": ("{}.as", read_kawasaki, True),
    "kawasaki_as linear": ("{}_l.as", read_kawasaki, True),
    "csv joint": ("{}_joints.csv", lambda path: read_csv(path, AXES, [name == "E1" for name in AXES]), False),
}
#: The linear forms move joints in rapid moves only.
LINEAR_FORMS = [form for form in FORMS if form.endswith("linear")]
JOINT_FORMS = [form for form in FORMS if form not in LINEAR_FORMS]
RAPID = WAYPOINTS[:, 6] == 1
#: A cutting move stops where the next move is rapid (or there is none), and nowhere else.
LAST_CUT = ~RAPID & np.r_[RAPID[1:], True]


class Row(NamedTuple):
    """A move, and where it takes the flange and the tip when the counting is undone by hand."""

    move: Move
    flange: np.ndarray
    tip: np.ndarray


def read_form(form: str, folder: Path, name: str) -> list[Move]:
    file, read, _ = FORMS[form]
    upper = form.startswith(("fanuc", "inform", "sinumerik"))
    return read(folder / file.format(name.upper() if upper else name))


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Plan the golden job once a language; return its output folder."""
    folders: dict[str, Path] = {}

    def plan(language: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Path:
        if language not in folders:
            folder = tmp_path_factory.mktemp(language)
            answer = run_command(["plan", write_job(folder, language), "--out", folder / "out"], monkeypatch, capsys)
            assert answer.status == 0, answer.err
            folders[language] = folder / "out"
        return folders[language]

    return plan


@pytest.fixture
def rows(
    request: pytest.FixtureRequest,
    planned: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> list[Row]:
    """The moves of a form; joints are undone by hand, positions are taken as they are."""
    form: str = request.param
    language = form.split()[0]
    found = []
    for move in read_form(form, planned(language, monkeypatch, capsys), "golden"):
        tool = TOOL if move.tool is None else move.tool
        if move.joints is None:
            tip = place_tip(language, move)
            found.append(Row(move, tip @ np.linalg.inv(tool), tip))
        else:
            slide, *angles = undo(language, move)
            flange = forward(slide, tuple(angles))
            found.append(Row(move, flange, flange @ tool))
    return found


def place_tip(language: str, move: Move) -> np.ndarray:
    """Return where a position puts the tip, base frame. [mm]"""
    assert move.pose is not None and move.base is not None
    tip = COUNTING[language].world @ move.base @ move.pose
    if move.flange_turn:
        assert move.tool == pytest.approx(shift(-50, 30, 140))
        tip[:3, :3] = tip[:3, :3] @ TOOL[:3, :3]
    return np.asarray(tip)


def undo(language: str, move: Move) -> tuple[float, ...]:
    """Return slide [mm] and angles [deg] of the URDF."""
    counting = COUNTING[language]
    assert move.joints is not None
    if counting.rail:
        assert move.external and all(value == 0.0 for value in move.external[1:])
    return counting.undo(move.joints, move.external[0] if counting.rail else None)


def find_visits(rows: list[Row]) -> list[int]:
    """Return the rows in which the tip reaches the waypoints, in order; a plan may divide the moves between them."""
    visits, row = [], 0
    for x, y, z, *_ in WAYPOINTS.tolist():
        wanted = (1300 + z, -200 + x, 700 + y)
        while np.abs(rows[row].tip[:3, 3] - wanted).max() > 1e-4:
            row += 1
            assert row < len(rows), f"no row at {wanted}"
        visits.append(row)
    return visits


def split_cuts(rows: list[Row]) -> list[list[Row]]:
    """Return the rows of each cut: from the first waypoint that is cut to the last."""
    visits, cuts = find_visits(rows), []
    for index in np.flatnonzero(LAST_CUT):
        first = index
        while not RAPID[first - 1]:
            first -= 1
        cuts.append(rows[visits[first] : visits[index] + 1])
    return cuts


@pytest.mark.parametrize("rows", FORMS, indirect=True)
def test_every_program_brings_the_tip_onto_the_path_in_the_part(
    rows: list[Row], request: pytest.FixtureRequest
) -> None:
    step = 1e-4 if request.node.callspec.params["rows"] == "inform linear" else 1e-5  # its angles have four decimals
    for visit, (*_, i, j, k, _) in zip(find_visits(rows), WAYPOINTS.tolist(), strict=True):
        tip, length = rows[visit].tip, math.sqrt(i * i + j * j + k * k)
        assert np.abs(-tip[:3, 2] - np.array([k, i, j]) / length).max() < math.radians(step)
        # the part's z axis is the base's x axis: the tip's x axis has no part across it
        assert abs(tip[:3, 0] @ np.cross(tip[:3, 2], PART[:3, 2])) < math.radians(step)
        assert tip[:3, 0] @ PART[:3, 2] > 0.9


@pytest.mark.parametrize("rows", FORMS, indirect=True)
def test_between_waypoints_of_a_cut_the_tip_is_on_their_line(rows: list[Row]) -> None:
    visits = find_visits(rows)
    for index in np.flatnonzero(~RAPID & ~np.r_[True, RAPID[:-1]]):
        start, end = (rows[visits[k]].tip[:3, 3] for k in (index - 1, index))
        along = (end - start) / np.linalg.norm(end - start)
        for row in rows[visits[index - 1] : visits[index]]:
            assert np.abs(np.cross(row.tip[:3, 3] - start, along)).max() < 1e-3


@pytest.mark.parametrize("rows", FORMS, indirect=True)
def test_cutting_moves_keep_the_feed(rows: list[Row]) -> None:
    for cut in split_cuts(rows):
        for row in cut:
            if row.move.feed is None:
                assert 0 < (row.move.percent or row.move.rate) <= 115
            else:
                assert 0 < row.move.feed <= FEED * (1 + 1e-6)
    inner = [row.move.feed for row in split_cuts(rows)[0] if row.move.feed]
    assert not inner or max(inner) == pytest.approx(FEED, rel=1e-6)


@pytest.mark.parametrize("rows", FORMS, indirect=True)
def test_rapid_moves_are_joint_moves_that_stop(rows: list[Row]) -> None:
    visits = find_visits(rows)
    for visit in [visit for visit, rapid in zip(visits, RAPID, strict=True) if rapid]:
        move = rows[visit].move
        assert move.kind == "joint" and move.stops and (move.pose is None or move.flange_turn)
        assert move.feed in (None, 0.0, 500.0) and move.percent in (None, 20.0)
        assert move.rate in (None, pytest.approx(0.2 * math.degrees(2.0), rel=1e-5))


@pytest.mark.parametrize("rows", [form for form in FORMS if not form.startswith("csv")], indirect=True)
def test_programs_stop_at_the_end_of_a_cut_and_where_the_plan_rests_at_a_corner(rows: list[Row]) -> None:
    corners = [WAYPOINTS[k, :3] for k in (1, 2, 3, 7)]  # cuts turn there by 20 deg and more
    for row, last in [(row, row is cut[-1]) for cut in split_cuts(rows) for row in cut]:
        place = (np.linalg.inv(PART) @ row.tip)[:3, 3]
        assert row.move.stops == (last or any(np.abs(place - point).max() < 1e-3 for point in corners))


@pytest.mark.parametrize("rows", LINEAR_FORMS, indirect=True)
def test_linear_programs_cut_along_lines(rows: list[Row]) -> None:
    for cut in split_cuts(rows):
        assert all(row.move.kind == "line" and row.move.pose is not None for row in cut)


@pytest.mark.parametrize("rows", [form for form, (*_, tool) in FORMS.items() if tool], indirect=True)
def test_every_program_carries_the_tool(rows: list[Row]) -> None:
    for row in rows:
        assert row.move.tool == pytest.approx(TOOL, abs=1e-5)
        assert row.move.load in ((), pytest.approx((MASS, *CENTRE), abs=1e-3))


@pytest.mark.parametrize("rows", LINEAR_FORMS, indirect=True)
def test_positions_count_from_the_part_frame(rows: list[Row]) -> None:
    for visit, (x, y, z, *_) in zip(find_visits(rows), WAYPOINTS.tolist(), strict=True):
        row = rows[visit]
        if row.move.pose is not None:
            assert row.move.pose[:3, 3] == pytest.approx([x, y, z], abs=1e-4)


def test_the_tool_has_the_angles_and_the_quaternion_of_each_language(tmp_path: Path) -> None:
    """Numbers worked out by hand from R = Rz(30) Ry(20) Rx(10); see the matrix in golden_cell."""
    texts = {}
    for language in ("krl", "val3", "rapid"):
        write_program(make_program(tmp_path / language / "cell", language), language, tmp_path / language)
        files = [path for path in (tmp_path / language).rglob("*") if path.suffix in (".src", ".dtx", ".mod")]
        texts[language] = "\n".join(path.read_text() for path in files)
    assert "$TOOL={X -50.0000000,Y 30.0000000,Z 140.0000000,A 30.0000000,B 20.0000000,C 10.0000000}" in texts["krl"]
    assert 'x="-50.0000000" y="30.0000000" z="140.0000000"' in texts["val3"]
    assert 'rx="-1.1160547" ry="22.2421809" rz="28.4517753"' in texts["val3"]
    assert "[[-50.00000,30.00000,140.00000],[0.951548525,0.038134576,0.189307857,0.239298338]]" in texts["rapid"]


def make_program(folder: Path, language: str, sixth: float = 60.0) -> Program:
    """Two waypoints: slide 100 mm and joints at 10 .. 60 deg; a second later joint 1 has turned by 20 deg."""
    robot = load_robot(write_robot(folder, language))
    angles = np.radians([[10.0, 20, 30, 40, 50, sixth], [30.0, 20, 30, 40, 50, sixth]])
    q = np.column_stack([[0.1, 0.1], angles]) if COUNTING[language].rail else angles
    flange_tool = np.array(FLANGE_TOOL)
    flange_tool[:3, 3] *= 1e-3
    mounted = robot.with_tool(flange_tool)
    timing = {"time": np.array([0.0, 1.0])}
    program = build_program(mounted, q, np.full(2, 0.02), np.zeros(2, bool), name="two", **timing)
    return replace(program, post=Post(overwrite=True))


@pytest.mark.parametrize("language", ["fanuc_ls", "inform"])
def test_frames_that_a_program_asks_of_the_cell_are_read_back(language: str, tmp_path: Path) -> None:
    program = replace(make_program(tmp_path / "cell", language), post=Post())
    assert program.tool is not None
    write_program(program, language, tmp_path / "out")
    paths = [path for path in (tmp_path / "out").rglob("*") if read_declared(path)]
    assert paths
    millimetres = np.array([[1.0, 1, 1, 1e3]] * 3 + [[1.0, 1, 1, 1]])
    planned, tip = program.base_frame * millimetres, program.tool * millimetres
    for path in paths:
        assert compare_declared(path, planned, tip) == []
        for name, frame in read_declared(path).items():
            other = np.linalg.inv(frame)
            part, tool = (planned, other) if name == "tool" else (other, tip)
            assert compare_declared(path, part, tool) == [
                f"the {name} that it expects of the cell is not the planned one"
            ]


@pytest.mark.parametrize("base", [None, "G54"])
def test_tool_lengths_and_frame_that_a_sinumerik_program_asks_of_the_cell_are_read_back(base, tmp_path: Path) -> None:
    program = make_program(tmp_path / "cell", "sinumerik")
    assert program.tool is not None
    for overwrite in (False, True):
        post = Post(overwrite=overwrite, tool=3, base=base)
        (file,) = write_program(replace(program, post=post), "sinumerik", tmp_path / f"out{overwrite}")
        for move in read_sinumerik(file):
            assert move.tool is not None and move.base is not None
            assert move.tool[:3, 3] == pytest.approx(1e3 * program.tool[:3, 3], abs=1e-4)
            assert move.base[:3, 3] == pytest.approx(1e3 * program.base_frame[:3, 3], abs=1e-4)
            assert move.base[:3, :3] == pytest.approx(program.base_frame[:3, :3], abs=1e-7)


#: The tool as jobs state it, from the URDF's flange (x out of the flange): x = 140, y = 30, z = 50 mm, turned with it.
FLANGE_TOOL = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]) @ TOOL


@pytest.mark.parametrize("form", JOINT_FORMS)
def test_joints_are_counted_with_sign_zero_and_coupling(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    write_program(make_program(tmp_path / "cell", language), language, tmp_path / "out")
    first, second = read_form(form, tmp_path / "out", "two")
    counting = COUNTING[language]
    expected = list(counting.counted)
    shown = [*first.external[:1], *first.joints] if counting.rail else list(first.joints or ())
    assert shown == pytest.approx(expected, abs=1e-6)
    turned = np.subtract(second.joints, first.joints)
    assert np.abs(turned) == pytest.approx([20.0, 0, 0, 0, 0, 0], abs=1e-5)
    if second.percent is not None:  # 20 deg/s of 2 rad/s = 114.59 deg/s are 17.4533 %, whole percents in KRL
        assert second.percent == pytest.approx(17.4533, abs={"krl": 0.46, "inform": 0.005}.get(language, 1e-4))
    elif second.rate is not None:
        assert second.rate == pytest.approx(20.0, abs=1e-4)
    else:
        assert second.feed == pytest.approx(20.0)


#: Configuration at 10 .. 60 deg, where the wrist is in front, the elbow up (q3 < 90) and the wrist flipped (q5 > 5).
#: krl: A1 -5, A2 -110, A3 60, A4 20, A5 -45, A6 25: S is 2 (A3 from 0 up) + 4 (A5 below 0), T has bits 0, 1 and 4.
#: inform: flip 0, upper arm 0, front 0, no axis beyond half a turn.
#: rapid: axes 1, 4, 6 at 5, 40, 150: quadrants 0, 0, 1; cfx 1 for axis 5 below 0.
CONFIGURATION = {
    "krl": (6, 19),
    "fanuc_ls": ("F", "U", "T", "0", "0", "0"),
    "rapid": (0, 0, 1, 1),
    "val3": ("righty", "epositive", "wnegative"),
    "inform": (0, 0, 0, 0, 0, 0),
}


@pytest.mark.parametrize("form", LINEAR_FORMS)
def test_positions_carry_configuration_and_the_rail(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    write_program(make_program(tmp_path / "cell", language), language, tmp_path / "out")
    move = read_form(form, tmp_path / "out", "two")[0]
    counting = COUNTING[language]
    assert move.configuration == CONFIGURATION.get(language, ())
    assert move.external[:1] == (counting.counted[:1] if counting.rail else ())
    assert move.feed == pytest.approx(20.0)
    wanted = forward(100.0 if counting.rail else 0.0, (10.0, 20, 30, 40, 50, 60)) @ kuka_pose(-50, 30, 140, 30, 20, 10)
    step = 5.1e-4 if form == "inform linear" else 1e-4  # its places have three decimals
    assert place_tip(language, move) == pytest.approx(wanted, abs=step)


def test_rapid_moves_of_a_sinumerik_carry_stat_and_tu_as_krl_positions_do(tmp_path: Path) -> None:
    program = make_program(tmp_path / "cell", "sinumerik")
    write_program(replace(program, rapid=np.array([True, False])), "sinumerik", tmp_path / "out")
    first, second = read_sinumerik(tmp_path / "out" / "TWO.MPF")
    assert (first.configuration, second.configuration) == (CONFIGURATION["krl"], ())


def test_a_fanuc_counts_turns_of_its_first_fourth_and_sixth_joint(tmp_path: Path) -> None:
    program = make_program(tmp_path / "cell", "fanuc_ls")
    joints = np.array([[0.0, -190, 0, 0, 200, 185, 545], [0.0, -179, 0, 0, -181, 0, 179]])
    write_program(replace(program, joints=joints), "fanuc_ls", tmp_path)
    found = [move.configuration[3:] for move in read_form("fanuc_ls linear", tmp_path, "two")]
    assert found == [("-1", "1", "2"), ("0", "-1", "0")]


#: KRL and FANUC programs leave the controller's own tool where the program has none; these always write one.
OWN_TOOL = [form for form in LINEAR_FORMS if form.split()[0] not in ("krl", "fanuc_ls", "sinumerik")]


@pytest.mark.parametrize("form", OWN_TOOL)
def test_without_a_tool_the_flange_is_programmed(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    program = make_program(tmp_path / "cell", language)
    write_program(replace(program, tool=np.eye(4), mass=None), language, tmp_path / "out")
    for move in read_form(form, tmp_path / "out", "two"):
        assert move.tool == pytest.approx(np.eye(4))


@pytest.mark.parametrize("form", LINEAR_FORMS)
def test_where_the_wrist_flips_a_linear_program_swings_over_in_a_joint_move(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    robot = load_robot(write_robot(tmp_path / "cell", language))
    fifth = np.radians([-10.0, -6, -2, 20, 25])
    q = np.tile(np.radians([10.0, 20, 30, 40, 0, 60]), (5, 1))
    q[:, 4] = fifth
    q = np.column_stack([np.full(5, 0.1), q]) if COUNTING[language].rail else q
    program = build_program(robot, q, np.full(5, 0.02), np.zeros(5, bool), name="flip")
    program = replace(program, post=Post(overwrite=True))
    write_program(program, language, tmp_path / "out")
    moves = read_form(form, tmp_path / "out", "flip")
    assert [move.kind for move in moves] == ["line", "line", "line", "joint", "line"]
    assert [move.stops for move in moves] == [False, False, True, True, True]
    # Sinumerik joint moves go to positions with STAT and TU; the others name the joints, as no words could
    assert language == "sinumerik" or [move.joints is None for move in moves] == [True, True, True, False, True]
    texts = [path.read_text() for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert any("the configuration changes" in text for text in texts)
    joint = [] if language == "sinumerik" else read_form(f"{language} joint", tmp_path / "out", "flip")
    assert not joint or [move.stops for move in joint] == [False, False, False, False, True]


@pytest.mark.parametrize("form", [form for form in FORMS if not form.startswith("csv")])
def test_a_program_in_parts_makes_the_same_moves(form: str, tmp_path: Path) -> None:
    language = form.split()[0]
    two = make_program(tmp_path / "cell", language)
    rows = np.array([0, 1, 0, 1, 0, 1, 0])
    taken = {name: getattr(two, name)[rows] for name in ("joints", "feed", "tcp", "status", "bent")}
    words = {key: values[rows] for key, values in two.words.items()}
    native = {key: values[rows] for key, values in two.native.items()}
    rapid = np.array([True, False, False, False, True, False, False])
    program = replace(two, **taken, rapid=rapid, words=words, native=native, time=np.arange(7.0))
    found = []
    for most in (100, 3):
        write_program(program, language, tmp_path / str(most), most=most)
        found.append(read_form(form, tmp_path / str(most), "two"))
    assert [len(moves) for moves in found] == [7, 7]
    for whole, cut in zip(*found, strict=True):
        for key in ("kind", "stops", "joints", "external", "feed", "percent", "rate", "configuration"):
            assert getattr(whole, key) == getattr(cut, key)
        assert (whole.pose is None) == (cut.pose is None)
        assert whole.pose is None or np.array_equal(whole.pose, cut.pose)
        assert np.array_equal(whole.tool, cut.tool) and np.array_equal(whole.base, cut.base)


BLENDED = {
    "krl joint": ("_J1.src", " C_PTP", ""),
    "krl linear": ("_L1.src", " C_DIS", ""),
    "krl advance": ("_J.src", "$ADVANCE=3", "$ADVANCE=0"),
    "krl distance": ("_J.src", "$APO.CPTP=1", "$APO.CPTP=0"),
    "val3 joint": (".dtx", 'blend="joint"', 'blend="off"'),
    "fanuc_ls joint": (".LS", "CNT100", "FINE"),
    "rapid joint": (".mod", ",z0,", ",fine,"),
    "rapid linear": (".mod", ",z0,", ",fine,"),
    "fanuc_ls linear": (".LS", "CNT100", "FINE"),
    "val3 linear": (".dtx", 'blend="joint"', 'blend="off"'),
    "inform linear": (".JBI", "PL=1", "PL=0"),
    "kawasaki_as linear": (".as", "ACCURACY 0.1", "ACCURACY 0"),
}


@pytest.mark.parametrize("case", BLENDED)
def test_the_readers_notice_a_program_that_stops_at_every_cut(case: str, tmp_path: Path) -> None:
    ending, old, new = BLENDED[case]
    language = case.split()[0]
    form = case if case in FORMS else f"{language} joint"
    write_program(make_program(tmp_path / "cell", language), language, tmp_path / "out")
    assert not read_form(form, tmp_path / "out", "two")[0].stops
    for file in [path for path in (tmp_path / "out").rglob("*") if path.name.endswith(ending)]:
        file.write_text(file.read_text().replace(old, new), newline="\r\n")
    assert read_form(form, tmp_path / "out", "two")[0].stops
