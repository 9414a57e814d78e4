"""The certificate: accuracy and repeatability by hand, stiffness intervals in closed form, drift, the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.effects import Effect, fold_effects
from compplan.errors import InputError
from compplan.job.job import check_job
from compplan.learning.certificate import measure_drift, measure_drives, measure_stiffness
from compplan.learning.iso9283 import measure_pose_accuracy
from compplan.learning.reference import Reference, plan_jobs, plan_references, promise_plan
from compplan.measurement.campaign import Campaign
from compplan.measurement.sights import POSITION, READING, Sights
from compplan.plan.plan import PlanOptions, plan_compensation
from compplan.robot import load_robot, write_robot_folder
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.simulation.predict import predict_campaign
from compplan.toolpath.toolpath import Toolpath
from compplan.uncertainty.assumed import known_uncertainty

pytestmark = pytest.mark.usefixtures("graph_alone")


def known_stiffness(deviation: float) -> Uncertainty:
    unknown = Unknown("joint_stiffness", "joint_2", None, ("compliance_change_rad_per_Nm",), np.array([deviation]))
    play = Unknown("backlash", "joint_3", None, ("width_rad",), np.array([1e-5]))
    return Uncertainty("measured", "made up", (unknown, play), np.eye(2))


def test_accuracy_and_repeatability_are_those_of_the_standard() -> None:
    """Visits off by (0, 0, 3), (0, 0, 5), (0, 0, 4) mm: AP 4, l = 1, 1, 0, RP = 2/3 + 3 sqrt(1/3) mm."""
    robot = load_robot("kuka_kr270")
    a, b = np.radians([10.0, -70, 80, 20, 40, 5]), np.radians([-20.0, -60, 90, 10, 60, 5])
    q = np.stack([a, b, a, b, a, b])
    off = np.array([3.0, 1, 5, 1, 4, 1]) * 1e-3
    log = Campaign(run=np.array(["static_1"] * 6), q=q, wrench=np.zeros((6, 6)), position=np.zeros((6, 3)))
    log = replace(log, position=predict_campaign(robot, log).position + np.outer(off, [0, 0, 1.0]))
    found = measure_pose_accuracy(robot, log, register=())
    assert (found.poses, found.again, found.visits.tolist()) == (2, 2, [3, 3])
    assert sorted(found.accuracy * 1e3) == pytest.approx([1.0, 4.0])
    assert sorted(found.repeatability * 1e3) == pytest.approx([0.0, 2 / 3 + 3 * np.sqrt(1 / 3)], abs=1e-9)
    # of pose b a gauge reads one number: it tells neither
    kind, up = np.array([POSITION, READING] * 3), np.tile([0.0, 0.0, 1.0], (6, 1))
    sights = Sights(kind, np.full(6, -1), (), np.zeros((6, 3)), up, log.position[:, 2] + 1e-3)
    mixed = replace(log, position=np.where((kind == POSITION)[:, None], log.position, np.nan), sights=sights)
    found = measure_pose_accuracy(robot, mixed, register=())
    assert found is not None and found.accuracy * 1e3 == pytest.approx([4.0])
    assert measure_pose_accuracy(robot, mixed.take(np.array([1, 3, 5])), register=()) is None


def test_two_visits_a_pose_tell_what_thirty_are_expected_to_give_the_instrument_taken_out() -> None:
    """Robot .015 mm, instrument .01 mm per axis: RP = (2 sqrt(2 / pi) + 3 sqrt(3 - 8 / pi)) .015 mm."""
    robot, rng = load_robot("kuka_kr270"), np.random.default_rng(4)
    q = np.radians([10.0, -70, 80, 20, 40, 5]) + np.radians(20.0) * rng.uniform(-1, 1, (60, 6))
    q = np.vstack([q, q])
    log = Campaign(run=np.array(["static_1"] * 120), q=q, wrench=np.zeros((120, 6)), position=np.zeros((120, 3)))
    seen = predict_campaign(robot, log).position + np.hypot(1.5e-5, 1e-5) * rng.standard_normal((120, 3))
    log = replace(log, position=seen + np.array([0.3, 0.0, 0.0]), sigma=np.full(120, 1e-5))
    found = measure_pose_accuracy(robot, log)
    true = (2 * np.sqrt(2 / np.pi) + 3 * np.sqrt(3 - 8 / np.pi)) * 1.5e-5
    assert found.pooled == pytest.approx(true, rel=0.2)
    assert found.pooled_interval[0] < true < found.pooled_interval[1]
    assert (found.freedom, found.fitted, found.instrument) == (60, 9, pytest.approx(1e-5))
    plain = measure_pose_accuracy(robot, replace(log, sigma=None)).pooled
    assert plain == pytest.approx(true * np.hypot(1.5, 1.0) / 1.5, rel=0.15)
    assert found.raw == pytest.approx(np.full(60, 0.3), abs=1e-3)
    assert np.median(found.accuracy) <= np.median(found.unseen) < 5e-5


def test_the_interval_of_a_stiffness_is_that_of_its_compliance() -> None:
    robot = load_robot("kuka_kr270")
    nominal = next(s.compliance for s in robot.springs if s.joint == "joint_2")
    known = known_stiffness(0.1 * nominal)
    older = replace(robot, uncertainty=known_stiffness(0.0))
    change = Effect("joint_stiffness", "joint_2", None, {"compliance_change_rad_per_Nm": nominal})
    softer = fold_effects(robot, [change])
    entry = measure_stiffness(replace(softer, uncertainty=known), known, robot, older)[1]
    assert entry.value == pytest.approx(0.5 / nominal)
    assert entry.low == pytest.approx(1 / (2 * nominal + 0.1959964 * nominal), rel=1e-6)
    assert entry.high == pytest.approx(1 / (2 * nominal - 0.1959964 * nominal), rel=1e-6)
    assert entry.literature == pytest.approx(1 / nominal)
    assert entry.change == pytest.approx(10.0)


def test_lost_motion_and_drift_are_what_was_put_in() -> None:
    robot = replace(load_robot("kuka_kr270"), uncertainty=known_stiffness(1e-8))
    worn = fold_effects(robot, [Effect("backlash", "joint_3", None, {"width_rad": 2e-4})])
    path = Toolpath(
        position=np.array([1.8, 0, 0.9]) + np.linspace(0, 0.1, 12)[:, None] * np.array([0.0, 1.0, 0.0]),
        axis=np.tile([0.0, 0, 1.0], (12, 1)), feed=np.full(12, 0.05), rapid=np.zeros(12, bool),
        wrench=np.zeros((12, 6)),
    )  # fmt: skip
    plan = plan_compensation(robot, path, PlanOptions(chord=1.0))
    reference = Reference("line", np.zeros(3), np.zeros(3), plan, promise_plan(plan))
    drive = measure_drives(worn, known_uncertainty(worn), (reference,), robot)[2]
    assert (drive.play, drive.older_play) == (pytest.approx(2e-4), 0.0)
    assert drive.play_spread == pytest.approx(1.959964e-5)
    assert 1.0 < drive.lever < 2.5
    ((name, rms, most),) = measure_drift(worn, robot, (reference,))
    assert name == "line"
    assert 0.3 * 1e-4 * drive.lever < rms <= most < 1.1e-4 * drive.lever
    with pytest.raises(InputError, match=r"robot 'kuka_kr240' puts the tip \d+ mm from where .*another robot"):
        measure_drift(robot, load_robot("kuka_kr240"), (reference,))


def test_the_calibration_factor_widens_every_interval_and_that_of_the_older_folder() -> None:
    robot = load_robot("kuka_kr270")
    nominal = next(s.compliance for s in robot.springs if s.joint == "joint_2")
    once, thrice = known_stiffness(0.1 * nominal), replace(known_stiffness(0.1 * nominal), calibration=3.0)
    plain, wide = (measure_drives(robot, known, (), None)[2] for known in (once, thrice))
    assert plain.play_spread is not None and wide.play_spread == pytest.approx(3 * plain.play_spread)
    assumed = known_uncertainty(robot)
    gears = [measure_drives(robot, replace(assumed, calibration=k), (), None)[2].gear_spread or 0.0 for k in (1.0, 3.0)]
    assert gears[1] == pytest.approx(3 * gears[0]) and gears[0] > 0.0
    soft = fold_effects(robot, [Effect("joint_stiffness", "joint_2", None, {"compliance_change_rad_per_Nm": nominal})])
    changes = [
        measure_stiffness(soft, once, robot, replace(robot, uncertainty=older))[1].change for older in (once, thrice)
    ]
    assert changes == pytest.approx([10 / np.sqrt(2), 10 / np.sqrt(10)])


def test_a_folder_that_nobody_measured_hides_no_change_behind_its_assumed_widths() -> None:
    robot = load_robot("ur5e")
    nominal = next(s.compliance for s in robot.springs if s.joint == robot.joint_names[2])
    unknown = Unknown("joint_stiffness", robot.joint_names[2], None, ("compliance_change_rad_per_Nm",),
                      np.array([0.075 * nominal]))  # fmt: skip
    known = Uncertainty("measured", "made up", (unknown,), np.eye(1))
    change = Effect("joint_stiffness", robot.joint_names[2], None, {"compliance_change_rad_per_Nm": 0.77 * nominal})
    softer = replace(fold_effects(robot, [change]), uncertainty=known)
    assert known_uncertainty(robot).grade != "measured"
    assert measure_stiffness(softer, known, robot, robot)[2].change == pytest.approx(0.77 / 0.075)
    # and widths that are assumed today cannot tell a change at all
    assert measure_stiffness(robot, known_uncertainty(robot), robot, robot)[2].change is None


@pytest.mark.slow
def test_certificate_and_diagnosis_of_one_log_say_the_same(tmp_path, monkeypatch, capsys) -> None:
    log = Path(__file__).parents[1] / "docs/notebooks/diagnose_campaign/measurements.csv"
    arguments = ["diagnose", log, "--robot", "kuka_kr270", "--out", tmp_path / "d"]
    assert run_command(arguments, monkeypatch, capsys).status == 0
    told = json.loads((tmp_path / "d" / "diagnosis.json").read_text())["verdict"]["effects"]
    for robot, since in (("kuka_kr270", []), (tmp_path / "d" / "robot", ["--since", "kuka_kr270"])):
        arguments = ["certificate", robot, "--log", log, *since, "--out", tmp_path / "c.html", "--json"]
        said = json.loads(run_command(arguments, monkeypatch, capsys).out)
        assert [(e["effect"], e["joint"]) for e in said["diagnosis"]] == [(e["effect"], e["joint"]) for e in told]
        soft = [e["joint"] for e in told if e["effect"] == "joint_stiffness"]
        assert set(soft) <= set(said["changed_beyond_chance"])
        text = (tmp_path / "c.html").read_text(encoding="utf-8")
        assert "no stiffness differs" not in text and "ISF cone" not in text


def test_the_paths_of_a_certificate_are_the_users_or_of_the_robots_own_size() -> None:
    robot = load_robot("ur5e")
    references = plan_references(robot)
    for reference, radius in zip(references, (0.15 * robot.longest_reach,) * 2, strict=True):
        assert reference.name.startswith("circle, radius") and reference.plan is not None
        assert np.ptp(reference.plan.task.position[:, 0]) < 2.2 * radius
        assert reference.force == pytest.approx([0.0, 0.0, -49.0], abs=0.1)  # the weight of the rated 5 kg
    assert "ISF" not in "".join(r.name for r in references)
    job = check_job({
        "schema": 1, "robot": "ur5e", "name": "my circle", "part": {"position_mm": [450.0, 100.0, 250.0]},
        "toolpath": {"generator": "circle", "radius_mm": 60.0, "waypoints": 30, "feed_mm_s": 40.0},
        "process": {"model": "constant", "force_N": [0.0, 0.0, 30.0]},
    }, Path("mine.toml"))  # fmt: skip
    (mine,) = plan_jobs([job])
    assert mine.name == "my circle" and mine.promise is not None
    assert np.linalg.norm(mine.force) == pytest.approx(30.0)


def test_the_command_writes_one_page_and_says_what_to_do_next(tmp_path, monkeypatch, capsys) -> None:
    robot = load_robot("kuka_kr240")
    write_robot_folder(replace(robot, uncertainty=known_stiffness(1e-8)), tmp_path / "today")
    page = tmp_path / "certificate.html"
    arguments = ["certificate", tmp_path / "today", "--since", "kuka_kr240", "--out", page, "--json"]
    answer = run_command(arguments, monkeypatch, capsys)
    assert answer.status == 0
    said = json.loads(answer.out)
    assert said["known"]["grade"] == "measured"
    assert said["drift_mm"][0]["max"] == pytest.approx(0.0, abs=1e-9)
    assert said["next"]
    text = page.read_text(encoding="utf-8")
    assert "Tolerance within reach" in text
    assert "joint_6" in text


def test_a_certificate_is_refused_in_one_line(tmp_path, monkeypatch, capsys) -> None:
    for arguments, words in (
        (["kuka_kr270", "--out", tmp_path / "page.pdf"], ".html"),
        (["kuka_kr270", "--since", "kuka_kr240_rail", "--out", tmp_path / "page.html"], "other joints"),
    ):
        answer = run_command(["certificate", *arguments], monkeypatch, capsys)
        assert answer.status == 2
        assert answer.err.count("\n") == 1
        assert words in answer.err
    assert not list(tmp_path.iterdir())
