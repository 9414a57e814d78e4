"""The doctor sees what was spoilt in a robot folder or a log, and is silent about good ones."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.cli import doctor
from compplan.cli.doctor import examine_installation, examine_log, examine_robot
from compplan.errors import InputError
from compplan.robot import load_robot
from compplan.robot.folder import find_robot_folder
from compplan.statics.chain import build_chain, locate_frames


def odd(findings) -> str:
    return "\n".join(f"{finding.about}: {finding.sentence}" for finding in findings if finding.state == "odd")


def spoilt(tmp_path: Path, file: str, pattern: str, text: str, name: str = "staubli_tx200"):
    folder = tmp_path / name
    shutil.copytree(find_robot_folder(name), folder)
    content = (folder / file).read_text()
    changed = re.sub(pattern, text, content)
    assert changed != content, "the edit has to hit"
    (folder / file).write_text(changed)
    return load_robot(folder)


def test_the_installation_that_runs_the_tests_has_nothing_odd():
    findings = examine_installation()
    assert not odd(findings)
    assert {"casadi", "pinocchio", "eaik"} <= {finding.about for finding in findings}


def test_an_engine_that_answers_wrongly_or_not_at_all_is_odd(monkeypatch):
    def fails() -> bool:
        raise RuntimeError("no ipopt")

    monkeypatch.setattr(doctor, "_try_ipopt", fails)
    assert "no ipopt" in odd(examine_installation())
    monkeypatch.setattr(doctor, "_try_ipopt", lambda: False)
    assert "a wrong answer" in odd(examine_installation())


def test_compliances_without_their_exponent_bend_the_arm_by_metres(tmp_path):
    robot = spoilt(tmp_path, "elasticity.toml", r"(compliance\s*=\s*)([\d.]+e-\d)", r"\g<1>2\2")
    assert "forgot e-6" in "\n".join(f.advice for f in examine_robot(robot) if f.state == "odd")


def test_a_joint_limit_in_the_wrong_unit_is_odd(tmp_path):
    robot = spoilt(tmp_path, "robot.urdf", r'velocity="[\d.]+"', 'velocity="45"')
    assert "moves at 45 rad/s" in odd(examine_robot(robot))


def write_log(tmp_path: Path, scale: float = 1.0, poses: int = 30, hold: int | None = None) -> Path:
    robot = load_robot("ur10")
    generator = np.random.default_rng(4)
    q = generator.uniform(-1.5, 1.5, (poses, 6)) + np.array([0.0, -1.2, 0.8, 0.0, 0.8, 0.0])
    if hold is not None:
        q[:, hold] = 0.3
    q = np.vstack([q, q[:5]])
    position = locate_frames(build_chain(robot), q).tcp_position + generator.normal(0.0, 2e-5, (len(q), 3))
    lines = ["run," + ",".join(f"q{k}_rad" for k in range(1, 7)) + ",x_mm,y_mm,z_mm"]
    for joints, place in zip(q, position * 1e3 * scale, strict=True):
        lines.append("static1," + ",".join(f"{value:.6f}" for value in [*joints, *place]))
    file = tmp_path / "log.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_a_good_log_has_nothing_odd(tmp_path):
    findings = examine_log(write_log(tmp_path), load_robot("ur10"))
    assert not odd(findings)
    said = [finding.sentence for finding in findings]
    assert "30 different poses" in said and "5 poses are repeated" in said


def test_a_log_in_inches_is_odd(tmp_path):
    assert "in inches" in odd(examine_log(write_log(tmp_path, scale=1 / 25.4), load_robot("ur10")))


def test_a_joint_that_never_moves_and_few_poses_are_odd(tmp_path):
    said = odd(examine_log(write_log(tmp_path, poses=9, hold=3), load_robot("ur10")))
    assert "wrist_1_joint moves over 0.0 deg only" in said or "joint_4 moves over 0.0 deg only" in said
    assert "9 different poses" in said


def test_the_command_prints_json_and_refuses_what_it_cannot_read(tmp_path, monkeypatch, capsys):
    done = run_command(["doctor", "staubli_tx200", "--json"], monkeypatch, capsys)
    assert done.status == 0
    states = {finding["state"] for finding in json.loads(done.out)["findings"]}
    assert states <= {"fine", "note", "odd", "do"}
    for target in (tmp_path / "none.csv", "no_such_robot"):
        done = run_command(["doctor", target], monkeypatch, capsys)
        assert done.status == 2 and done.err.startswith("error: ") and done.err.count("\n") == 1


@pytest.mark.parametrize("text", ["q1_rad\n", "run,q1_rad,x_mm,y_mm,z_mm\n", "\x00"])
def test_a_file_that_is_no_log_ends_in_one_line(tmp_path, text, monkeypatch, capsys):
    file = tmp_path / "log.csv"
    file.write_text(text)
    done = run_command(["doctor", file], monkeypatch, capsys)
    assert done.status == 2 and done.err.count("\n") == 1


def test_columns_of_an_export_that_state_no_unit_are_named_as_a_log_has_them(tmp_path: Path) -> None:
    file = tmp_path / "export.csv"
    file.write_text("Point Name,X (mm),Measured Y [mm],z,J1 [deg],Joint 2\np1,1200.1,0.2,900.3,0,-60\n")
    named = r"rename columns: 'z' z_mm, 'Joint 2' q2_deg \(add the unit"
    with pytest.raises(InputError, match=named):
        examine_log(file)
