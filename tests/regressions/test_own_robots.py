"""Own robots: from a description as ROS-Industrial publishes it to a Cartesian program, and what doctor says of it."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

import compplan as cp
from tests.regressions.own_descriptions import ABB, FANUC, KUKA, Arm, write_package

ROBOTS = Path(__file__).parents[2] / "robots"
SLOT = "G21 G90 G54 G17\nT1 M6\nS8000 M3\nG0 X0 Y0 Z20\nG0 Z5\nG1 Z-1 F300\nG1 X15 F600\nG0 Z50\nM30\n"
RATING = ["--payload", 20, "--reach", 1.7]
#: Option --controller by the controller that a shipped folder names.
OPTIONS = {
    "KUKA KRC2": "krc2", "KUKA KRC4": "krc4", "ABB IRC5": "irc5", "Fanuc R-30iA": "r30ia", "Fanuc R-30iB": "r30ib",
    "Yaskawa YRC1000": "yrc1000", "Staubli CS8C": "cs8c", "Kawasaki F series": "kawasaki_f",
}  # fmt: skip


def controller_of(folder: Path) -> dict:
    return tomllib.loads((folder / "controller.toml").read_text(encoding="utf-8"))


SHIPPED = {folder.name: OPTIONS[name] for folder in sorted(ROBOTS.iterdir())
           if folder.is_dir() and (folder / "controller.toml").is_file()
           and (name := controller_of(folder)["controller"]) in OPTIONS}  # fmt: skip


@pytest.mark.parametrize("name", SHIPPED)
def test_the_geometry_gives_signs_zeros_words_and_pendant_of_every_shipped_arm(name, tmp_path, monkeypatch, capsys):
    words = ["init", "robot", ROBOTS / name / "robot.urdf", "--controller", SHIPPED[name], "--out", tmp_path / "arm"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0, done.err
    made, shipped = controller_of(tmp_path / "arm"), controller_of(ROBOTS / name)
    for key in ("joint_names", "sign", "zero_deg", "coupling", "world"):
        assert made.get(key) == shipped.get(key), key
    assert set(made["configuration"]) == {"shoulder", "elbow", "wrist"}
    for key, word in shipped["configuration"].items():
        for entry in ("axis", "frame", "joint", "above", "below", "status"):
            assert made["configuration"][key].get(entry) == word.get(entry), (key, entry)
        assert made["configuration"][key].get("threshold_deg", 0.0) == pytest.approx(word.get("threshold_deg", 0.0),
                                                                                      abs=2e-3)  # fmt: skip
    for axis in ("x", "z"):
        assert made["pendant"][axis] == pytest.approx(shipped["pendant"][axis], abs=1e-6)
    assert made["checked"] is False and made["pendant"]["confirmed"] is False


@pytest.mark.parametrize(
    ("arm", "package", "model", "xacro", "controller", "program", "line"),
    [
        pytest.param(
            KUKA, "kuka_kr12_support", "kr12r1450", True, "krc4", "*_L1.src", "LIN {X ", marks=pytest.mark.slow
        ),
        pytest.param(
            ABB, "abb_irb2420_support", "irb2420_16_155", False, "irc5", "*_L_1.mod", "MoveL ", marks=pytest.mark.slow
        ),
        (FANUC, "fanuc_m16_support", "m16ib20", False, "r30ib", "*_L.LS", ":L P["),
    ],
    ids=["kuka", "abb", "fanuc"],
)
def test_four_commands_lead_from_a_description_to_a_cartesian_program(
    arm: Arm, package, model, xacro, controller, program, line, tmp_path, monkeypatch, capsys
) -> None:
    file = write_package(tmp_path / "src", arm, package, model, xacro=xacro)
    monkeypatch.chdir(tmp_path)
    Path("part.nc").write_text(SLOT, encoding="utf-8")
    words = ["init", "robot", file, "--controller", controller, *RATING, "--out", "arm"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0 and "Cartesian programs lack" not in done.out, done.err + done.out
    shutil.rmtree(tmp_path / "src")  # the folder stands by itself: its meshes were copied
    robot = cp.load_robot("arm")
    assert np.isinf(robot.effort_limits).all() and robot.effort_limits.shape == (6,)  # effort="0": not stated
    assert len(robot.springs) == 6 and robot.sources["compliance"].startswith("assumed")
    done = run_command(["doctor", "arm", "--json"], monkeypatch, capsys)
    remarks = json.loads(done.out)["findings"]
    assert done.status == 0 and [each["about"] for each in remarks if each["state"] == "odd"] == ["robot model"]
    assert any("shapes of each link: base_link 1, link_1 1" in each["sentence"] for each in remarks)
    done = run_command(["init", "part.toml", "--robot", "arm", "--toolpath", "part.nc"], monkeypatch, capsys)
    assert done.status == 0, done.err
    done = run_command(["plan", "part.toml", "--out", "out"], monkeypatch, capsys)
    assert done.status == 0 and "controller.toml says checked = false" in done.out.replace("\n", " "), done.err
    assert "no controller.toml" not in done.out
    assert json.loads(Path("out/plan.json").read_text(encoding="utf-8"))["status"] == "solved"
    (written,) = Path("out").glob(program)
    assert line in written.read_text(encoding="utf-8")
    page = Path("out/report.html").read_text(encoding="utf-8")
    _, _, tool = page.partition("Tool centre point, in the pendant")
    assert "X 0  Y 0  Z 150 mm, not turned" in tool[:200], tool[:200]  # not the URDF's flange, whose x points out


def test_a_light_and_a_heavy_arm_get_the_springs_of_the_documented_rule(tmp_path, monkeypatch, capsys) -> None:
    for payload, reach, twist, grade in (
        (16, 1.6, (2.0, 1.5, 1.9, 7.7, 3.6, 4.6), "placeholder"), (200, 2.6, (2.0, 1.5, 1.9, 19, 31, 14), "scaled"),
    ):  # fmt: skip
        out = tmp_path / grade
        words = ["init", "robot", ROBOTS / "kuka_kr16_2" / "robot.urdf", "--payload", payload, "--reach", reach]
        assert run_command([*words, "--out", out], monkeypatch, capsys).status == 0
        robot = cp.load_robot(out)
        found = [spring.compliance * payload * 9.81 * reach for spring in robot.springs]
        assert found == pytest.approx([1e-3 * value for value in twist], rel=5e-3) and robot.grade == grade


@pytest.mark.parametrize("rating", [RATING, [*RATING, "--mass", 230], []])
def test_a_description_of_5_tonnes_is_reported_and_its_weight_bends_nothing(
    rating, tmp_path, monkeypatch, capsys
) -> None:
    file = write_package(tmp_path / "src", FANUC, "fanuc_m16_support", "m16ib20", xacro=False, mass=4879.0)
    done = run_command(["init", "robot", file, *rating, "--out", tmp_path / "arm"], monkeypatch, capsys)
    assert done.status == 0 and "masses: 4879 kg" in done.out and "are left out" in done.out
    assert not cp.load_robot(tmp_path / "arm").bodies


def test_doctor_asks_for_payload_and_own_weight_and_reports_impossible_masses(tmp_path, monkeypatch, capsys) -> None:
    file = write_package(tmp_path / "src", FANUC, "fanuc_m16_support", "m16ib20", xacro=False, mass=240.0)
    arm = tmp_path / "arm"
    assert run_command(["init", "robot", file, "--out", arm], monkeypatch, capsys).status == 0

    def masses() -> list[tuple[str, str]]:
        done = run_command(["doctor", arm, "--json"], monkeypatch, capsys)
        findings = json.loads(done.out)["findings"]
        return [(each["state"], each["sentence"]) for each in findings if each["about"] in ("masses", "rating")]

    asked, unchecked = masses()
    assert asked[0] == "note" and "payload, reach and own weight are not stated" in asked[1] and unchecked[0] == "note"
    (arm / "SOURCE.md").write_text("Payload 20 kg and reach 1700 mm\n", encoding="utf-8")
    assert [state for state, _ in masses()] == ["fine"]  # the heaviest shipped arm of 20 kg weighs 250 kg
    (arm / "SOURCE.md").write_text("Payload 20 kg and reach 1700 mm, own weight 120 kg\n", encoding="utf-8")
    assert masses() == [("odd", "240 kg in all, 120 kg is stated as own weight")]
    urdf = (arm / "robot.urdf").read_text(encoding="utf-8")
    (arm / "robot.urdf").write_text(urdf.replace(f"{240.0 / 7.0}", "697"), encoding="utf-8")
    (arm / "SOURCE.md").unlink()
    assert masses()[1] == ("odd", "4879 kg in all, more than any shipped arm weighs (2550 kg)")


def test_no_shipped_arm_is_heavier_than_the_rule_allows(monkeypatch, capsys) -> None:
    for name in sorted(folder.name for folder in ROBOTS.iterdir() if (folder / "SOURCE.md").is_file()):
        findings = json.loads(run_command(["doctor", name, "--json"], monkeypatch, capsys).out)["findings"]
        assert not [each for each in findings if each["about"] == "masses" and each["state"] == "odd"], name


def test_doctor_and_pendant_agree_with_the_tool_axis_that_init_was_told(tmp_path, monkeypatch, capsys) -> None:
    # z of tool0 points out in this URDF; the user says x of it does
    words = ["init", "robot", ROBOTS / "kuka_kr16_2" / "robot.urdf", "--tool-axis", "x", "--out", tmp_path / "arm"]
    assert run_command(words, monkeypatch, capsys).status == 0
    done = run_command(["doctor", tmp_path / "arm", "--json"], monkeypatch, capsys)
    findings = json.loads(done.out)["findings"]
    assert not [each for each in findings if each["about"] == "tcp" and each["state"] == "odd"]
    assert any("z along x of 'tool0'" in each["sentence"] for each in findings if each["about"] == "pendant")
    assert not any("no controller.toml" in each["sentence"] for each in findings)


@pytest.mark.parametrize(
    "expression",
    ["(lambda: ().__class__.__base__.__subclasses__())()", "[x.gi_frame for x in [1]]", "python.vars(1)._x", "9**9**9"],
)
def test_a_xacro_file_is_data(expression, tmp_path, monkeypatch, capsys) -> None:
    file = tmp_path / "arm.xacro"
    file.write_text('<robot name="a" xmlns:xacro="http://wiki.ros.org/xacro">'
                    f'<link name="l${{{expression}}}"/></robot>', encoding="utf-8")  # fmt: skip
    done = run_command(["init", "robot", file, "--out", tmp_path / "arm"], monkeypatch, capsys)
    assert done.status == 2 and "is more than arithmetic and calls" in done.err and done.err.count("\n") == 1
    assert not (tmp_path / "arm").exists()


def test_faults_of_a_xacro_file_are_told_in_one_line(tmp_path, monkeypatch, capsys) -> None:
    file = write_package(tmp_path / "src", KUKA, "kuka_kr12_support", "kr12r1450", xacro=True)
    macro = file.with_name("kr12r1450_macro.xacro")
    shutil.rmtree(tmp_path / "src" / "arm_resources")
    for path, said in ((file, "package 'arm_resources' is not found"), (macro, "package 'arm_resources' is not found")):
        done = run_command(["init", "robot", path, "--out", tmp_path / "arm"], monkeypatch, capsys)
        assert done.status == 2 and said in done.err and done.err.count("\n") == 1
    done = run_command(["init", "robot", file, "--payload", 16, "--out", tmp_path / "arm"], monkeypatch, capsys)
    assert done.status == 2 and "give payload and reach together" in done.err
    assert not (tmp_path / "arm").exists()


def test_init_says_what_is_missing_for_cartesian_programs(tmp_path, monkeypatch, capsys) -> None:
    file = write_package(tmp_path / "src", KUKA, "kuka_kr12_support", "kr12r1450", xacro=False)
    done = run_command(["init", "robot", file, "--out", tmp_path / "plain"], monkeypatch, capsys)
    assert done.status == 0 and "Cartesian programs lack joint names, configuration words and pendant" in done.out
    file.write_text(file.read_text(encoding="utf-8").replace('rpy="0 0 0"/><parent link="link_2"',
                                                             'rpy="0 0.3 0"/><parent link="link_2"'),
                    encoding="utf-8")  # fmt: skip
    words = ["init", "robot", file, "--controller", "krc4", "--out", tmp_path / "turned"]
    done = run_command(words, monkeypatch, capsys)
    assert done.status == 0 and "Cartesian programs lack signs and zeros: an arm lies" in done.out
    assert controller_of(tmp_path / "turned")["joint_names"] == ["A1", "A2", "A3", "A4", "A5", "A6"]
