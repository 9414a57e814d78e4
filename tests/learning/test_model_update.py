"""Learning from cut parts: points brought to the path, three parts of a robot that hides errors, steps not taken."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commandline import run_command

from compplan.errors import InputError
from compplan.job.job import Job, load_job
from compplan.job.loading import load_nominal
from compplan.job.noise import NoiseTable
from compplan.learning.gathered_points import Gathered
from compplan.learning.measured_path import match_points
from compplan.learning.model_update import learn_part
from compplan.learning.part import LearnedPart, build_learned, learn_from_part
from compplan.learning.representable import Residual, fit_representable
from compplan.learning.transfer import build_part_terms
from compplan.measurement.part_points import read_measured_points
from compplan.reporting.learn import write_learning
from compplan.robot import load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.statics.chain import build_chain, locate_frames
from compplan.toolpath.toolpath import Toolpath
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import Slopes, linearise_path
from compplan.uncertainty.sensitivities import ForceSpread, build_path_model, read_force_spread

PATHS = Path(__file__).parents[2] / "paths"


def straight_path() -> Toolpath:
    x = np.linspace(0.0, 0.1, 11)
    position = np.column_stack([1.5 + x, np.zeros(11), np.full(11, 0.5)])
    return Toolpath(position, np.tile([0.0, 0, 1], (11, 1)), np.full(11, 0.05), np.zeros(11, bool), frame="base")


def write_points(file: Path, header: str, rows: np.ndarray) -> Path:
    lines = "\n".join(",".join(f"{value:.6f}" for value in row) for row in rows)
    file.write_text(f"{header}\n{lines}\n", encoding="utf-8")
    return file


def test_a_point_counts_across_the_path_and_with_its_length_along_it_too(tmp_path: Path) -> None:
    """Points off by (2, 0.3, -0.1) mm: without s the 2 mm along the path are a place, not a deviation."""
    s = np.linspace(20.0, 80.0, 12)
    points = np.column_stack([1500 + s + 2.0, np.full(12, 0.3), np.full(12, 499.9)])
    table = read_measured_points(write_points(tmp_path / "a.csv", "x_mm,y_mm,z_mm", points))
    plain = match_points(table, straight_path(), np.eye(4), in_base=True)
    assert plain.seen == pytest.approx(np.tile([0.0, 3e-4, -1e-4], (12, 1)), abs=1e-9)
    assert plain.length == pytest.approx((s + 2.0) * 1e-3, abs=1e-9)
    file = write_points(tmp_path / "b.csv", "x_mm,y_mm,z_mm,s_mm", np.column_stack([points, s]))
    placed = match_points(read_measured_points(file), straight_path(), np.eye(4), in_base=True)
    assert placed.seen == pytest.approx(np.tile([2e-3, 3e-4, -1e-4], (12, 1)), abs=1e-9)


def test_points_that_are_pasted_again_count_once(tmp_path: Path) -> None:
    points = np.column_stack([1500 + np.linspace(20.0, 80.0, 12), np.full(12, 0.3), np.full(12, 499.9)])
    table = read_measured_points(write_points(tmp_path / "a.csv", "x_mm,y_mm,z_mm", np.vstack([points, points[3:]])))
    once = match_points(table, straight_path(), np.eye(4), in_base=True)
    assert len(once.length) == 12 and any(note.startswith("9 rows are there twice") for note in once.notes)


def test_a_point_just_beyond_an_end_belongs_to_it_and_one_far_beyond_to_nothing(tmp_path: Path) -> None:
    """A part .03 mm longer than the path of 100 mm: its last point is off by (0, .2, 0), not by the .03 mm."""
    s = np.r_[-0.02, np.linspace(20.0, 80.0, 10), 100.03, 103.0]
    points = np.column_stack([1500 + s, np.full(13, 0.2), np.full(13, 500.0), s])
    file = write_points(tmp_path / "a.csv", "x_mm,y_mm,z_mm,s_mm", points)
    found = match_points(read_measured_points(file), straight_path(), np.eye(4), in_base=True)
    assert found.left_out == 1
    assert found.seen == pytest.approx(np.tile([0.0, 2e-4, 0.0], (12, 1)), abs=1e-9)
    assert found.length[[0, -1]] == pytest.approx([0.0, 0.1])


def test_a_point_with_a_spread_that_is_none_is_refused_and_an_empty_one_gets_the_assumed(tmp_path: Path) -> None:
    s = np.linspace(20.0, 80.0, 12)
    points = np.column_stack([1500 + s, np.zeros(12), np.full(12, 500.0), np.full(12, 0.03)])
    for wrong in (0.0, -0.03, 1000.0):
        points[4, 3] = wrong
        file = write_points(tmp_path / "a.csv", "x_mm,y_mm,z_mm,sigma_mm", points)
        with pytest.raises(InputError, match=r"a.csv:6: sigma_mm is .*expected 1e-06 to 20 mm"):
            read_measured_points(file)
    points[4, 3] = np.nan
    table = read_measured_points(write_points(tmp_path / "b.csv", "x_mm,y_mm,z_mm,sigma_mm", points))
    found = match_points(table, straight_path(), np.eye(4), in_base=True)
    assert found.sigma == pytest.approx([3e-5] * 4 + [2e-5] + [3e-5] * 7)


def hairpin_path() -> Toolpath:
    """Return a line there and 1 mm beside it back."""
    there = straight_path()
    back = there.position[::-1] + np.array([0.0, 1e-3, 0.0])
    return Toolpath(
        np.vstack([there.position, back]), np.tile(there.axis[:1], (22, 1)), np.full(22, 0.05), np.zeros(22, bool)
    )


def test_points_that_two_stretches_claim_are_left_out_and_foreign_ones_refused(tmp_path: Path) -> None:
    hairpin = hairpin_path()
    s = np.linspace(20.0, 80.0, 20)
    points = np.column_stack([1500 + s, np.where(np.arange(20) < 10, 0.05, 0.5), np.full(20, 500.0)])
    table = read_measured_points(write_points(tmp_path / "a.csv", "x_mm,y_mm,z_mm", points))
    found = match_points(table, hairpin, np.eye(4), in_base=True)
    assert len(found) == 10
    assert found.left_out == 10
    with pytest.raises(InputError, match="0 of 20 points are on the cut"):
        far = write_points(tmp_path / "b.csv", "x_mm,y_mm,z_mm", points + 300.0)
        match_points(read_measured_points(far), hairpin, np.eye(4), in_base=True)


def test_a_robot_folder_holds_of_a_negative_compliance_what_takes_its_spring_to_zero() -> None:
    """The KR 270 folder has no spring of joint 2 about rz; that of joint 3 about its own axis has its compliance c."""
    robot = load_robot("kuka_kr270")
    own = next(spring.compliance for spring in robot.springs if spring.joint == "joint_3")
    rigid = Unknown("link_compliance", "joint_2", "rz", ("compliance_rad_per_Nm",), np.array([1e-8]))
    soft = Unknown("joint_stiffness", "joint_3", None, ("compliance_change_rad_per_Nm",), np.array([1e-8]))
    cases = ((rigid, -2e-8, 0.0), (rigid, 2e-8, 2e-8), (soft, -3.0 * own, -own), (soft, -1e-9, -1e-9))
    for unknown, value, held in cases:
        taught, part = fit_representable(robot, unknown, np.array([value]))
        assert part == pytest.approx([held], abs=1e-15)
        before, after = (sum(spring.compliance for spring in r.springs) for r in (robot, taught))
        assert after - before == pytest.approx(held, abs=1e-15)


def test_a_part_off_as_a_whole_moves_the_program_by_what_is_expected_to_repeat() -> None:
    """.08 mm in y are five times what a run of .015 mm repeatability makes, .02 mm are not; 60 points of .01 mm."""
    k = 60
    tip = np.column_stack([np.linspace(0.0, 0.3, k), np.zeros(k), np.zeros(k)])
    slopes = Slopes(np.arange(k), tip, np.tile(np.eye(3), (k, 1, 1)), np.zeros((k, 3, 4)), np.zeros((k, 3, 1)))
    place = Unknown("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.full(3, 3e-4))
    known = Uncertainty("measured", "test", (place,), np.eye(3), unexplained=1e-4, repeatability=1.5e-5)
    noise = 1e-5 * np.random.default_rng(1).standard_normal((k, 3))
    eye = np.tile(np.eye(3), (k, 1, 1))
    for off in (8e-5, 2e-5):
        seen = Gathered(np.arange(k), noise + np.array([0.0, off, 0.0]), eye, np.full(k, 1e-10), np.ones(k, int))
        own = build_part_terms(NoiseTable(), tip[0], slopes, ForceSpread(0.0, 0.0, 0.0, "none"), fitted=False)
        model_update = learn_part(slopes, known, seen, lambda values, force: np.tile(values, (k, 1)), own)
        assert model_update.taken
        assert ("by chance" in model_update.reason) == (off < 5e-5)
        repeats = (model_update.physics + model_update.residual).mean(axis=0)
        assert repeats == pytest.approx([0.0, off, 0.0], abs=5e-6)
        # what is left open, and the next run: repeatability along three axes
        run = model_update.expected**2 - np.trace(model_update.tip) / k
        assert run == pytest.approx(3 * known.repeatability**2, rel=1e-3)


def test_a_choice_of_the_points_is_no_measurement_of_a_path_whose_stretches_lie_close(tmp_path: Path) -> None:
    """Lines 1 mm apart: at .05 mm one line claims a point, at .5 mm both do; 2, 24 and 30 of 48 points lie there."""
    hairpin = hairpin_path()
    s = np.linspace(20.0, 80.0, 48)
    for number in (2, 24, 30):
        y = np.where(np.arange(48) < number, 0.5, 0.05)
        file = write_points(tmp_path / "a.csv", "x_mm,y_mm,z_mm", np.column_stack([1500 + s, y, np.full(48, 500.0)]))
        if number == 30:
            with pytest.raises(InputError, match=r"30 of 48 .*state s_mm"):
                match_points(read_measured_points(file), hairpin, np.eye(4), in_base=True)
            continue
        found = match_points(read_measured_points(file), hairpin, np.eye(4), in_base=True)
        assert found.left_out == number
        assert ("s_mm" in found.notes[-1]) == (number == 24)


@pytest.fixture
def small_job(tmp_path: Path) -> Job:
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("waypoints = 500", "waypoints = 60")
    (tmp_path / "circle.toml").write_text(text, encoding="utf-8")
    return load_job(tmp_path / "circle.toml")


def test_bad_measurements_end_in_one_line(small_job, tmp_path, monkeypatch, capsys) -> None:
    for text, words in (
        ("x_mm,y_mm\n1,2\n", "z_mm"),
        ("x_mm,y_mm,z_mm\n", "no rows"),
        ("x_mm,y_mm,z_mm\n900,0,0\n901,0,0\n", "0 of 2 points"),
    ):
        file = tmp_path / "bad.csv"
        file.write_text(text, encoding="utf-8")
        arguments = ["learn", small_job.file, file, "--robot", "kuka_kr270", "--out", tmp_path / "out"]
        answer = run_command(arguments, monkeypatch, capsys)
        assert answer.status == 2
        assert answer.err.count("\n") == 1
        assert words in answer.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("header", ["x_mm,y_mm,z_mm", "x_mm,y_mm,z_mm,s_mm"])
def test_points_beside_a_rapid_move_are_of_no_cut(tmp_path: Path, header: str) -> None:
    """The path goes on 200 mm to the side without cutting: three points measured there count for nothing."""
    path = straight_path()
    end = path.position[-1] + [0.0, 0.2, 0.0]
    path = replace(
        path, position=np.vstack([path.position, end]), axis=np.vstack([path.axis, path.axis[-1]]),
        feed=np.r_[path.feed, 0.05], rapid=np.r_[path.rapid, True],
    )  # fmt: skip
    s = np.linspace(10.0, 90.0, 10)
    cut = np.column_stack([1500 + s, np.full(10, 0.2), np.full(10, 500.0), s])
    side = np.array([50.0, 100.0, 150.0])
    beside = np.column_stack([np.full(3, 1600.0), side, np.full(3, 500.0), 100.0 + side])
    rows = np.vstack([cut, beside])[:, : header.count(",") + 1]
    table = read_measured_points(write_points(tmp_path / "a.csv", header, rows))
    found = match_points(table, path, np.eye(4), in_base=True)
    assert (len(found), found.left_out) == (10, 3)


def test_the_residual_is_taken_off_the_path_and_joints_csv_is_held_against_what_was_wanted(small_job: Job) -> None:
    """1 mm to +x was left: the next program aims 1 mm to -x, and what is wanted is the path of the job."""
    robot, length = load_robot("kuka_kr270"), np.array([0.0, 10.0])
    q = np.tile(build_learned(small_job, robot, None)[1].q_start[30], (2, 1))
    left = Residual(length, np.tile([1e-3, 0.0, 0.0], (2, 1)), q)
    nominal, task, _ = build_learned(small_job, robot, left)
    rows = np.arange(len(nominal)) if len(task) == len(nominal) else task.origin
    path = np.stack([np.interp(rows, np.arange(len(nominal)), column) for column in nominal.position.T], axis=1)
    assert task.position == pytest.approx(path - [1e-3, 0.0, 0.0], abs=1e-9)
    model_update = SimpleNamespace(after=SimpleNamespace(task=task), path=nominal, residual=left)
    assert LearnedPart.nominal.__get__(model_update) == pytest.approx(path, abs=1e-9)


def test_a_second_part_is_learned_with_the_first(small_job: Job, tmp_path: Path) -> None:
    """A force 10 % above the predicted one, then a part off by a third of that: both teach; nothing moves farther."""
    text = small_job.file.read_text(encoding="utf-8")
    small_job.file.write_text(text.replace("[part]", "[part]\ntouched_off = false"), encoding="utf-8")
    small_job = load_job(small_job.file)
    robot, spread = load_robot("kuka_kr270"), read_force_spread(small_job)
    wanted, task = 1e3 * load_nominal(small_job).position, build_learned(small_job, robot, None)[1]
    scene = build_path_model(robot, task.q_start, task.wrench, task.step_time)
    push = linearise_path(scene, robot_uncertainty(robot), spread, task.cut).shared[:, :, 0].mean(axis=0) / spread.level
    told = []
    for number, share in enumerate((0.1, 0.03)):
        off = share * push
        columns = {f"{axis}_mm": wanted[:, k] + 1e3 * off[k] for k, axis in enumerate("xyz")}
        learned = learn_from_part(small_job, robot, columns, in_base=True, align="datum")
        assert learned.model_update.taken, learned.model_update.reason
        band = learned.model_update.band_after
        assert band.max() < 1.1 * np.median(band)  # the last row, without points of its own, as well
        write_learning(learned, tmp_path / str(number))
        chain = build_chain(robot)
        aims = [
            (locate_frames(chain, plan.q).tcp_position - plan.task.position).mean(axis=0)
            for plan in (learned.before, learned.after)
        ]
        assert np.linalg.norm(aims[1] - aims[0]) < 1.1 * np.linalg.norm(off)
        robot = load_robot(tmp_path / str(number) / "robot")
        assert learned.force is not None
        told.append(learned.force)
    assert [len(force.parts) for force in told] == [1, 2]
    assert 1.0 < told[0].level < told[1].level < 1.13
    assert told[1].common < told[0].common


@pytest.mark.parametrize(("frame", "lifted"), [("base", 0.2), ("path", 0.2), ("path", 0.0)])
def test_a_second_part_starts_from_the_band_that_the_first_one_left(
    frame: str, lifted: float, small_job: Job, tmp_path: Path
) -> None:
    """Whatever transfers to other paths: this path keeps what its part told, until the folder is changed by hand."""
    text = small_job.file.read_text(encoding="utf-8").replace('frame = "base"', f'frame = "{frame}"')
    small_job.file.write_text(text, encoding="utf-8")
    job = load_job(small_job.file)
    wanted = 1e3 * load_nominal(job).position
    columns = {f"{axis}_mm": wanted[:, k] + lifted * (axis == "z") for k, axis in enumerate("xyz")}
    learned = learn_from_part(job, "kuka_kr270", columns, in_base=True, align="datum")
    summary = write_learning(learned, tmp_path / "out")
    first, folder = learned.model_update, tmp_path / "out" / "robot"
    plan = json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8"))
    band, shares = plan["error_band_mm"], plan["error_band_mm"]["at_widest"]
    assert summary["band_after_mm"]["p95_max"] == pytest.approx(band["p95_max"])
    assert max(shares.values()) <= band["p95_max"] <= 1.05 * np.linalg.norm([*shares.values()])
    assert plan["verdict"]["basis"] == "robot and force learned from measured parts of this path"
    if learned.force is not None:  # [noise] wrench_level no longer counts
        assert plan["verdict"]["change"] == "Measure the next part, too: compplan learn JOB MEASURED --robot OUT/robot."
    page = (tmp_path / "out" / "plan.html").read_text(encoding="utf-8")
    assert "learned_circle" not in page[page.index("SHA-256, first 16 digits") :].split("</table>")[0]
    columns |= {f"{axis}_mm": wanted[:, k] for k, axis in enumerate("xyz")}
    second = learn_from_part(job, folder, columns, in_base=True, align="datum").model_update
    assert first.band_after.max() < 0.8 * first.band_before.max()
    assert 0.9 * first.band_after.max() < second.band_before.max() < 1.02 * first.band_after.max()
    assert second.band_after.max() < second.band_before.max()
    state = folder / "learned_circle.npz"
    spring = folder / "elasticity.toml"
    spring.write_text(spring.read_text(encoding="utf-8") + "# by hand\n", encoding="utf-8")
    again = learn_from_part(job, folder, columns, in_base=True, align="datum").model_update
    assert again.band_before.max() > second.band_before.max()
    state.write_bytes(state.read_bytes()[:1000])
    with pytest.raises(InputError, match=r"learned_circle\.npz: is not what compplan learn writes"):
        learn_from_part(job, folder, columns, in_base=True, align="datum")


@pytest.mark.parametrize("measured", ["across", "upwards", "half of it"])
def test_the_next_program_does_not_move_where_nothing_was_measured(measured: str, tmp_path: Path) -> None:
    """A part off by (.25, .15, -.1) mm that no parameter explains, measured across, upwards, or on half its circle."""
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("radius_mm = 10.0", "radius_mm = 200.0")
    text = text.replace("[part]", "[part]\ntouched_off = false")  # all of the shift repeats
    sure = "[noise]\nwrench_level = 0.0\nwrench_direction_deg = 0.0\nwrench_path = 0.0\n"
    (tmp_path / "circle.toml").write_text(f"{text}\n{sure}", encoding="utf-8")
    job = load_job(tmp_path / "circle.toml")
    tool = Unknown("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.full(3, 1e-9))
    known = Uncertainty("measured", "test", (tool,), np.eye(3), unexplained=3e-4, repeatability=1e-5)
    turn, off = job.T_base_part[:3, :3], np.array([0.25, 0.15, -0.1])
    circle = 1e3 * (load_nominal(job).position[::5] - job.T_base_part[:3, 3]) @ turn
    columns = {f"{axis}_mm": circle[:, k] for k, axis in enumerate("xyz")}
    if measured != "upwards":
        columns = {name: column + off["xyz".index(name[0])] for name, column in columns.items()}
    else:
        up = {f"dir_{axis}": np.full(len(circle), float(axis == "k")) for axis in "ijk"}
        columns |= {"reading_mm": np.full(len(circle), off[2]), **up}
    if measured == "half of it":
        columns = {name: column[: len(circle) // 2] for name, column in columns.items()}
    learned = learn_from_part(job, replace(load_robot("kuka_kr270"), uncertainty=known), columns, align="datum")
    assert learned.model_update.taken, learned.model_update.reason
    path, chain, places = learned.path, build_chain(learned.before.robot), []
    at = np.linspace(0.05, 0.95, 60) * path.arc_length[-1]
    for plan in (learned.before, learned.after):
        length = np.interp(plan.task.origin, np.arange(len(path)), path.arc_length)
        tip = locate_frames(chain, plan.q).tcp_position
        places.append(np.stack([np.interp(at, length, axis) for axis in tip.T], axis=1))
    move = 1e3 * (places[1] - places[0]) @ turn
    around = np.stack([np.interp(at, path.arc_length, axis) for axis in (path.position @ turn).T], axis=1)
    along, move = np.gradient(around, axis=0)[1:-1], move[1:-1]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    wanted = off * [0.0, 0.0, 1.0] if measured == "upwards" else off - np.sum(off * along, axis=1)[:, None] * along
    share = at[1:-1] / path.arc_length[-1]
    seen, far = (share < 0.48, (share > 0.56) & (share < 0.94)) if measured == "half of it" else (share > 0, share < 0)
    assert np.abs(np.sum(move * along, axis=1))[seen].max() < 0.005
    assert np.abs(move + wanted)[seen].max() < 0.01
    assert np.linalg.norm(move[far], axis=1).max(initial=0.0) < 0.001
    assert np.linalg.norm(move, axis=1).max() < 1.05 * np.linalg.norm(off)
