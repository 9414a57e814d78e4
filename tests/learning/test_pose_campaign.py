"""Designed measurements: the bookkeeping in closed form, the choice against chance, order, files, a partial log."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.job.job import load_job
from compplan.learning import candidates as contacts
from compplan.learning.campaign import add_places, design_campaign
from compplan.learning.candidates import find_postures, find_touching, list_candidates, list_fixtures, solve_tips
from compplan.learning.design import Design, choose_measurements, evaluate_choice, locating_rows, order_poses
from compplan.measurement.equipment import Equipment
from compplan.measurement.instrument import read_instrument
from compplan.measurement.observations import CONTACT
from compplan.measurement.reading import read_campaign
from compplan.planning.plan import plan_job
from compplan.reporting.campaign import open_campaign
from compplan.robot import Robot, load_robot
from compplan.robot.folder import write_robot_folder
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.statics.chain import build_chain, locate_frames
from compplan.uncertainty.band import linearise_path
from compplan.uncertainty.ladder import observe_poses
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model

PATHS = Path(__file__).parents[2] / "paths"


def stiffness_unknowns(deviation: float = 1e-7) -> Uncertainty:
    unknowns = tuple(
        Unknown("joint_stiffness", f"joint_{k}", None, ("compliance_change_rad_per_Nm",), np.array([deviation]))
        for k in range(1, 7)
    )
    return Uncertainty("assumed", "made up", unknowns, np.eye(6), repeatability=1e-5)


def make_design(frames: tuple[str, ...] = ()) -> tuple[Design, np.ndarray]:
    robot = load_robot("kuka_kr270")
    q = np.radians([0.0, -60, 80, 10, 50, 5]) + 0.2 * np.sin(np.linspace(0, 6, 30)[:, None] + np.arange(6))
    wrench = np.tile([400.0, 900.0, -600.0, 0, 0, 0], (30, 1))
    known = stiffness_unknowns()
    path = linearise_path(build_path_model(robot, q, wrench), known, ForceSpread(0, 0, 0, "known"), np.ones(30, bool))
    return Design(known, path, 3e-5, frames), q


def test_an_unknown_base_and_tool_are_seen_as_they_move_the_target() -> None:
    design, _ = make_design(("base", "tool"))
    random = np.random.default_rng(2)
    tip, turn = random.normal(size=(1, 3)), np.linalg.qr(random.normal(size=(3, 3)))[0][None]
    rows = design.rows(np.zeros((1, 3, 6)), tip, turn)
    step = random.normal(size=9) * 1e-3
    moved = step[:3] + np.cross(step[3:6], tip[0]) + turn[0] @ step[6:]
    assert rows[0, :, 6:] @ step == pytest.approx(moved)


def test_designed_poses_beat_random_ones_and_never_widen_the_band() -> None:
    design, q = make_design()
    robot = load_robot("kuka_kr270")
    postures = find_postures(robot, q, 0.5, None, seed=1, kept=60)
    assert (postures > robot.lower).all()
    assert (postures < robot.upper).all()
    candidates = list_candidates(robot, postures, [0.0, 100.0], 300.0, design.known.unknowns)
    choice = choose_measurements(design, candidates, 6)
    rows = design.rows(candidates.slopes, candidates.tip, candidates.rotation, candidates.observations)
    drawn = [np.random.default_rng(seed).choice(len(rows), size=6, replace=False) for seed in range(9)]
    chance = [evaluate_choice(design, rows, picked.tolist(), design.start).rms[-1] for picked in drawn]
    assert (np.diff(choice.rms) <= 1e-12).all()
    assert choice.rms[-1] < min(chance)
    assert len(np.unique(candidates.q[choice.rows], axis=0)) == 6
    after = design.known.with_covariance(choice.covariance)
    assert after.covariance == pytest.approx(choice.covariance, rel=1e-9, abs=1e-28)
    # weights alone cannot turn joint 1 about its vertical axis
    still = choose_measurements(design, list_candidates(robot, postures, [100.0], 0.0, design.known.unknowns), 6)
    assert still.covariance[0, 0] == pytest.approx(1e-14, rel=1e-3)
    assert choice.covariance[0, 0] < 0.1e-14


def test_a_forecast_of_few_sampled_postures_leaves_what_a_campaign_leaves() -> None:
    design, q = make_design(("base", "tool"))
    robot, known = load_robot("kuka_kr270"), design.known
    candidates = list_candidates(robot, find_postures(robot, q, 0.5, None, seed=3), [0.0], 400.0, known.unknowns)
    chosen = choose_measurements(design, candidates, 12)
    seen = observe_poses(robot, known, design.path.model @ known.spread, q, 0.5, 12, 400.0, design.noise)
    after = known.spread @ np.linalg.inv(np.eye(6) + seen.T @ seen / design.noise) @ known.spread.T
    assert 1.0 <= design.model_band(after) / design.model_band(chosen.covariance) < 1.5
    assert design.model_band(after) < 0.2 * design.model_band(known.covariance)


def test_poses_of_one_load_are_measured_together_and_on_a_short_way() -> None:
    robot = load_robot("kuka_kr270")
    home = np.radians([0.0, -90, 90, 0, 0, 0])
    q = home + np.radians([[40.0], [10.0], [30.0], [20.0]]) * np.array([1.0, 0, 0, 0, 0, 0])
    load = np.zeros((4, 6))
    load[2, 2] = -500.0
    order, touching = order_poses(robot, q, q, load, home, None)
    assert order.tolist() == [1, 3, 0, 2]
    assert not len(touching)


@pytest.fixture
def small_job(tmp_path: Path) -> Path:
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("waypoints = 500", "waypoints = 16")
    file = tmp_path / "circle.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_a_campaign_without_a_load_asks_for_one(small_job) -> None:
    """Compliances make most of the band of a KR 270 that pushes with 1.6 kN; unloaded poses do not see them."""
    plan = plan_job(load_job(small_job))
    shops = Equipment(register=()), Equipment((0.0, 60.0), register=())
    asked, loaded = (design_campaign(plan, equipment, 3) for equipment in shops)
    assert open_campaign(asked).next.startswith("Run it again with --weights-kg") and not loaded.lacks_load
    # 1.4 kN sideways is what no weight shows
    assert any("sideways with up to 1439 N" in note and "--pull-N 400" in note for note in loaded.notes)
    pulled = design_campaign(plan, Equipment((0.0, 60.0), 400.0, register=()), 3).notes
    assert not any("--pull-N" in note for note in pulled)


def test_poses_for_a_tracker_tell_base_and_tool_from_the_arm_unless_these_are_known() -> None:
    assert Equipment().frames == ("base", "tool")
    assert Equipment(register=()).frames == ()
    assert Equipment(instrument="sockets").frames == ()
    assert Equipment(register=("base", "tool"), instrument="sockets").frames == ("tool",)


def test_a_plan_takes_another_robot_than_its_job_names(small_job, tmp_path, monkeypatch) -> None:
    """A path of a folder counts from the working directory, a name is that of a shipped robot."""
    write_robot_folder(load_robot("kuka_kr270"), tmp_path / "mine")
    monkeypatch.chdir(tmp_path)
    assert Path(load_job(small_job, "mine").robot) == (tmp_path / "mine").resolve()
    assert Path(load_job(small_job, "ur10").robot).name == "ur10"
    with pytest.raises(InputError, match="nobody"):
        load_job(small_job, "nobody")


def test_a_campaign_is_refused_in_one_line(small_job, tmp_path, monkeypatch, capsys) -> None:
    for more, words in ((["--weights-kg", "0,heavy"], "--weights-kg"), (["--register", "tip"], "--register")):
        arguments = ["campaign", small_job, "--poses", "3", *more, "--out", tmp_path / "out"]
        answer = run_command(arguments, monkeypatch, capsys)
        assert answer.status == 2
        assert answer.err.count("\n") == 1
        assert words in answer.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("instrument", ["sockets", "gauge"])
def test_poses_for_an_instrument_without_positions_meet_its_places_and_narrow_the_band(instrument: str) -> None:
    """In closed form: a row tells nothing beside its unknown place alone, and later ones no more than a position."""
    design, q = make_design(("tool",))
    robot = load_robot("kuka_kr270")
    postures = find_postures(robot, q, 0.5, None, seed=1, kept=150)
    middle = locate_frames(build_chain(robot), q).tcp_position.mean(axis=0)
    found, observations = find_touching(robot, postures, middle, 0.5, instrument, 3, 0.2, None)
    tip = locate_frames(build_chain(robot), found).tcp_position
    for number in range(len(observations.names)):
        away = np.ptp(tip[observations.contact == number], axis=0)
        assert (away < 1e-8).all(), away
    candidates = list_candidates(robot, found, [0.0, 100.0], 300.0, design.known.unknowns)
    candidates = replace(candidates, observations=observations.repeat(len(candidates) // len(found)))
    design, start = add_places(design, design.start, observations, tip, 12)
    choice = choose_measurements(design, candidates, 30, start)
    assert choice.rms[-1] < 0.9 * choice.rms[0] and (np.diff(choice.rms) <= 1e-12).all()
    first = locating_rows(candidates)
    assert len(first) == len(observations.names)
    assert choice.rms[len(first)] == pytest.approx(choice.rms[0], rel=2e-3)
    stands = list_fixtures(instrument, observations, tip)
    assert [stand.label for stand in stands] == list(observations.names)
    for number, stand in enumerate(stands):
        off = np.linalg.norm(tip[observations.contact == number] - stand.place, axis=1)
        assert off.max() < 1e-6
    free = replace(candidates, observations=None)
    plain, _ = make_design(("tool",))
    assert choose_measurements(plain, free, 30).rms[-1] < choice.rms[-1]


def test_sockets_are_put_up_elsewhere_where_the_arm_does_not_meet_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("kuka_kr270")
    q = make_design(("tool",))[1]
    postures = find_postures(robot, q, 0.5, None, seed=1, kept=60)
    middle = locate_frames(build_chain(robot), q).tcp_position.mean(axis=0)

    def place(low: float) -> np.ndarray:
        def bring(robot: Robot, q: np.ndarray, wanted: np.ndarray) -> np.ndarray:
            return solve_tips(robot, q, wanted)[: 2 if np.linalg.norm(wanted[0] - middle) <= low else None]

        monkeypatch.setattr(contacts, "solve_tips", bring)
        found, observations = find_touching(robot, postures, middle, 0.5, "sockets", 2, 0.0, None)
        tip = locate_frames(build_chain(robot), found).tcp_position
        return np.array([tip[observations.contact == k][0] for k in range(2)])

    away = np.linalg.norm(place(0.0)[0] - middle)
    moved = np.linalg.norm(place(1.01 * away) - middle, axis=1)
    assert (moved > 1.01 * away).all()
    with pytest.raises(InputError, match="in 2 postures, expected at least 3, wherever it lies near the path"):
        place(9.0)


def test_a_campaign_for_sockets_writes_a_log_that_is_read_and_counts(small_job, tmp_path, monkeypatch, capsys) -> None:
    """Joints are what is measured: the log is whole as it is written for a robot that is as modelled."""
    out = tmp_path / "poses"
    text = small_job.read_text(encoding="utf-8")
    small_job.write_text(text.replace("[part]\n", "[part]\ntouched_off = false\n"), encoding="utf-8")
    words = ["campaign", small_job, "--poses", "24", "--with", "sockets", "--length-mm", "200", "--register", "tool",
             "--weights-kg", "0,60", "--sigma-mm", "0.02", "--out", out]  # fmt: skip
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 0, answer.err
    assert "instrument.toml" in (told := answer.out)
    robot = load_robot("kuka_kr270")
    log = read_campaign(out / "campaign.csv", robot, read_instrument(out / "instrument.toml"))
    assert log.observations is not None and len(log.observations.names) == 6 and len(log.observations.known) == 3
    assert log.usable.sum() == 25 and (log.observations.kind[log.usable] == CONTACT).all()
    assert np.bincount(log.observations.contact[log.usable]).min() >= 2
    again = [*words[:-1], tmp_path / "next", "--log", out / "campaign.csv", "--instrument", out / "instrument.toml"]
    assert run_command(again, monkeypatch, capsys).status == 0
    first, second = (json.loads((f / "campaign.json").read_text("utf-8")) for f in (out, tmp_path / "next"))
    assert second["error_band_mm"]["p95_max_now"] == pytest.approx(first["error_band_mm"]["p95_max_after"], rel=0.1)
    stands = first["stands"]
    assert sorted(stand["label"] for stand in stands) == sorted(log.observations.names)
    assert all(f"put up {stand['says']}" in told for stand in stands)
    assert "Where it stands" in (out / "report.html").read_text("utf-8")
    assert np.linalg.norm(np.subtract(stands[0]["position_mm"], stands[1]["position_mm"])) == pytest.approx(200, abs=3)
    few = [*words[:3], "8", *words[4:-1], tmp_path / "few"]
    answer = run_command(few, monkeypatch, capsys)
    assert answer.status == 2 and "at least two per place" in answer.err
