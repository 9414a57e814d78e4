"""Instruments other than a tracker, and every kind of row in every command: taken, or refused with a reason."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from commandline import Answer, run_command
from simulated_campaigns import write_small_robot

from compplan.diagnosis import diagnose_campaign
from compplan.diagnosis.campaign_diagnosis import refuse_open_frames
from compplan.diagnosis.data.channels import estimate_noises
from compplan.effects import Effect, apply_effects, build_model, command_campaign, solve_model_poses
from compplan.errors import InputError
from compplan.learning.measured_path import match_points
from compplan.measurement.campaign import Campaign
from compplan.measurement.frames import fit_registration
from compplan.measurement.instrument import read_instrument
from compplan.measurement.observations import READING, KnownDistances, Observations
from compplan.measurement.part_points import read_measured_points
from compplan.measurement.reading import read_campaign
from compplan.measurement.registration import campaign_gap, fitted_parts
from compplan.robot import Array, Robot
from compplan.toolpath.toolpath import Toolpath
from compplan.uncertainty.assumed import robot_uncertainty

TOOL = np.array([0.02, -0.03, 0.12])
PLANTED = (
    Effect("joint_offset", "joint_2", None, {"offset_rad": 1.2e-3}),
    Effect("joint_offset", "joint_4", None, {"offset_rad": -2e-3}),
    Effect("joint_offset", "joint_5", None, {"offset_rad": 1.5e-3}),
)
JOINTS = ",".join(f"q{k}_deg" for k in range(1, 7))
SIGMA = 2e-5
Run = Callable[..., Answer]
Effects = tuple[Effect, ...]
Logs = tuple[Path, Path | None]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return lambda *words: run_command(words, monkeypatch, capsys)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small") / "small", gravity=False)


def see(robot: Robot, q: Array, effects: Effects = PLANTED) -> Array:
    """Return where the point of the tool truly is. Shape (n, 3). [m]"""
    campaign = Campaign(np.array(["static"] * len(q)), q, np.zeros((len(q), 6)), np.zeros((len(q), 3)))
    attained = solve_model_poses(apply_effects(build_model(robot, campaign), effects))
    return attained.position + attained.rotation @ TOOL


def draw_poses(robot: Robot, count: int, seed: int) -> Array:
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.nq)) * 0.9


def touch(
    robot: Robot, place: Array, count: int, rng: np.random.Generator, effects: Effects = PLANTED, sigma: float = SIGMA,
    onto: Callable[[Array], Array] | None = None,
) -> Array:  # fmt: skip
    """Return poses, settled to the noise, with the true point at a place, or by it on a surface. Shape (count, nq)."""
    start = see(robot, draws := draw_poses(robot, 400, int(rng.integers(1000))), effects)
    q = draws[np.argsort(np.linalg.norm(start - place, axis=1))[: 2 * count]]
    wanted = (place if onto is None else onto(see(robot, q, effects))) + rng.normal(0.0, sigma, (len(q), 3))
    for _ in range(9):
        point = see(robot, q, effects)
        slopes = np.stack([(see(robot, q + 1e-6 * one, effects) - point) / 1e-6 for one in np.eye(robot.nq)], axis=-1)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slopes, rcond=1e-3), wanted - point)
        q = q + np.clip(step, -0.2, 0.2)
    good = np.linalg.norm(see(robot, q, effects) - wanted, axis=1) < 1e-7
    good &= ((q > robot.lower) & (q < robot.upper)).all(axis=1)
    assert good.sum() >= count
    return q[good][:count]


def write_log(file: Path, columns: str, rows: list[str]) -> Path:
    file.write_text("\n".join([columns, *rows]) + "\n")
    return file


def degrees(q: Array) -> str:
    return ",".join(f"{value:.7f}" for value in np.rad2deg(q))


def socket_log(robot: Robot, folder: Path, effects: Effects = PLANTED, sigma: float = SIGMA) -> tuple[Path, Path]:
    """Write a log of two sockets 200 mm apart at three places, and its instrument file."""
    rng, rows, said = np.random.default_rng(3), [], ["schema = 1", "[instrument]", "sigma_mm = 0.02"]
    for number, place in enumerate(([1.0, 0.2, 0.7], [0.3, 1.0, 0.9], [0.8, -0.8, 1.1])):
        along = rng.normal(size=3)
        for socket in (0, 1):
            middle = np.array(place) + socket * 0.2 * along / np.linalg.norm(along)
            poses = touch(robot, middle, 15, rng, effects, sigma)
            rows += [f"static{number},{number}/{socket},{degrees(q)}" for q in poses]
        said += ["[[distance]]", f'between = ["{number}/0", "{number}/1"]', "mm = 200.0", "sigma_mm = 0.01"]
    (folder / "sockets.toml").write_text("\n".join(said))
    return write_log(folder / "sockets.csv", f"run,contact,{JOINTS}", rows), folder / "sockets.toml"


def gauge_log(robot: Robot, folder: Path, effects: Effects = PLANTED, sigma: float = SIGMA) -> tuple[Path, Path]:
    """Write a log of six dial gauges whose zeros nobody knows, and its instrument file."""
    rng, q = np.random.default_rng(4), draw_poses(robot, 150, 5)
    unit = np.repeat(rng.normal(size=(6, 3)), 25, axis=0)
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    zero = np.repeat(rng.uniform(-0.5, 0.5, 6), 25)
    reading = np.einsum("ni,ni->n", unit, see(robot, q, effects)) - zero + rng.normal(0.0, sigma, 150)
    rows = [
        f"static,g{k // 25},{degrees(q[k])},{unit[k, 0]:.9f},{unit[k, 1]:.9f},{unit[k, 2]:.9f},{reading[k] * 1e3:.6f}"
        for k in range(150)
    ]
    (folder / "gauge.toml").write_text("schema = 1\n[instrument]\nsigma_mm = 0.02\n")
    head = f"run,contact,{JOINTS},dir_i,dir_j,dir_k,reading_mm"
    return write_log(folder / "gauge.csv", head, rows), folder / "gauge.toml"


def bar_log(robot: Robot, folder: Path, effects: Effects = PLANTED, sigma: float = SIGMA) -> tuple[Path, Path]:
    """Write a log of a ball bar about three centres that nobody knows, and its instrument file."""
    rng, q = np.random.default_rng(6), draw_poses(robot, 150, 7)
    centre = np.repeat([[0.9, 0.4, 0.2], [-0.2, 0.9, 0.4], [-0.7, -0.5, 0.6]], 50, axis=0)
    length = np.linalg.norm(see(robot, q, effects) - centre, axis=1) + rng.normal(0.0, sigma, 150)
    rows = [f"static,c{k // 50},{degrees(q[k])},{length[k] * 1e3:.6f}" for k in range(150)]
    (folder / "bar.toml").write_text("schema = 1\n[instrument]\nsigma_mm = 0.02\n")
    return write_log(folder / "bar.csv", f"run,contact,{JOINTS},distance_mm", rows), folder / "bar.toml"


LOGS = {"sockets": socket_log, "gauge": gauge_log, "bar": bar_log}


def test_a_turned_instrument_reads_along_its_own_axes(robot: Robot, tmp_path: Path) -> None:
    said = "schema = 1\n[instrument]\nposition_mm = [100.0, 0.0, 0.0]\nrotation_deg = [0.0, 0.0, 90.0]\n"
    (tmp_path / "gauge.toml").write_text(said)
    rows = [f"static,g,{k},2,3,4,5,6,1,0,0,5" for k in range(1, 13)]
    log = write_log(tmp_path / "gauge.csv", f"run,contact,{JOINTS},dir_i,dir_j,dir_k,reading_mm", rows)
    observations = read_campaign(log, robot, read_instrument(tmp_path / "gauge.toml")).observations
    assert observations is not None
    np.testing.assert_allclose(observations.direction, np.tile([0.0, 1.0, 0.0], (12, 1)), atol=1e-12)
    np.testing.assert_allclose(observations.origin, np.tile([0.1, 0.0, 0.0], (12, 1)))


def test_a_number_along_one_direction_has_its_own_noise_and_not_that_of_three() -> None:
    """Forty gauges read three times a stay along directions of their own; nothing states a sigma."""
    rng, stays = np.random.default_rng(6), 400
    unit = np.repeat(rng.normal(size=(stays, 3)), 3, axis=0)
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    n = len(unit)
    observations = Observations(
        np.full(n, READING), np.repeat(np.arange(stays) % 40, 3), tuple(f"g{k}" for k in range(40)), np.zeros((n, 3)),
        unit, rng.normal(0.0, SIGMA, n),
    )  # fmt: skip
    q = np.repeat(rng.uniform(-1.0, 1.0, (stays, 6)), 3, axis=0)
    campaign = replace(command_campaign(q, on_path=False), observations=observations)
    attained = SimpleNamespace(position=np.zeros((n, 3)), rotation=np.tile(np.eye(3), (n, 1, 1)))
    noise = estimate_noises(campaign, attained)["position"]  # type: ignore[arg-type]
    assert noise.sigma == pytest.approx(SIGMA, rel=0.08)


def test_known_distances_compare_lengths_and_their_slopes() -> None:
    known = KnownDistances(np.array([[0, 1]]), np.array([0.05]), np.array([1e-5]))
    places = np.array([[0.03, 0.0, 0.0], [0.0, 0.04, 0.0]])
    np.testing.assert_allclose(known.gap(places), [0.0], atol=1e-15)
    moved = places + np.array([[1e-6, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert known.slopes(places)[0, 0, 0] == pytest.approx(-known.gap(moved)[0] / 1e-6, rel=1e-4)


@pytest.mark.parametrize("name", LOGS)
def test_tool_and_unknown_places_follow_from_the_rows_of_a_robot_as_modelled(
    name: str, robot: Robot, tmp_path: Path
) -> None:
    log, instrument = LOGS[name](robot, tmp_path, (), 0.0)
    campaign = read_campaign(log, robot, read_instrument(instrument))
    attained = solve_model_poses(build_model(robot, campaign))
    parts = fitted_parts(campaign, ("tool",))
    frames = fit_registration(campaign, attained.position, attained.rotation, parts)
    np.testing.assert_allclose(frames.tool[0, :3, 3], TOOL, atol=2e-7)
    point = attained.position + attained.rotation @ frames.tool[0, :3, 3]
    assert np.abs(campaign_gap(campaign, point, frames)).max() < 2e-7


def test_diagnosis_explains_what_gauges_show_to_their_noise(robot: Robot, tmp_path: Path) -> None:
    log, instrument = gauge_log(robot, tmp_path)
    diagnosis = diagnose_campaign(robot, read_campaign(log, robot, read_instrument(instrument)), register=("tool",))
    assert diagnosis.gap.noise_floor == pytest.approx(SIGMA, rel=0.3)
    assert diagnosis.gap.held_out_after < 2.0 * SIGMA
    assert diagnosis.verdict.status in ("calibrated", "explained")
    assert diagnosis.delivery.kind != "nominal"


def test_a_known_distance_is_as_sure_as_its_file_says_or_a_caliper(robot: Robot, tmp_path: Path) -> None:
    rows = [f"static,{k % 2},{degrees(q)}" for k, q in enumerate(draw_poses(robot, 8, 1))]
    log, file = write_log(tmp_path / "log.csv", f"run,contact,{JOINTS}", rows), tmp_path / "known.toml"
    for said, sigma in (("sigma_mm = 0.3", 3e-4), ("", 2e-5)):
        file.write_text(f'schema = 1\n[[distance]]\nbetween = ["0", "1"]\nmm = 50.0\n{said}\n')
        known = read_campaign(log, robot, read_instrument(file)).observations.known
        assert (known.length.item(), known.sigma.item()) == pytest.approx((0.05, sigma))


def test_scale_is_said_to_be_unknown_where_contacts_alone_were_seen(robot: Robot, tmp_path: Path) -> None:
    rows = [f"static,{k % 2},{degrees(q)}" for k, q in enumerate(draw_poses(robot, 8, 1))]
    log = write_log(tmp_path / "log.csv", f"run,contact,{JOINTS}", rows)
    bare, instrument = tmp_path / "bare.toml", tmp_path / "known.toml"
    bare.write_text("schema = 1\n[instrument]\nsigma_mm = 0.02\n")
    instrument.write_text('schema = 1\n[[distance]]\nbetween = ["0", "1"]\nmm = 50.0\n')
    said = [note for note in read_campaign(log, robot, read_instrument(bare)).notes if "scale" in note]
    assert len(said) == 1
    assert not [note for note in read_campaign(log, robot, read_instrument(instrument)).notes if "scale" in note]


def test_trackers_and_contacts_go_together_in_one_log(robot: Robot, tmp_path: Path) -> None:
    rng, q = np.random.default_rng(1), draw_poses(robot, 12, 2)
    touched = touch(robot, np.array([1.0, 0.2, 0.7]), 8, rng)
    seen = see(robot, q)
    rows = [f"static,,{degrees(one)},{p[0] * 1e3},{p[1] * 1e3},{p[2] * 1e3}" for one, p in zip(q, seen, strict=True)]
    rows += [f"static,socket,{degrees(one)},,," for one in touched]
    campaign = read_campaign(write_log(tmp_path / "both.csv", f"run,contact,{JOINTS},x_mm,y_mm,z_mm", rows), robot)
    assert campaign.usable.all()
    assert campaign.measured.sum() == 12
    attained = solve_model_poses(apply_effects(build_model(robot, campaign), PLANTED))
    frames = fit_registration(campaign, attained.position, attained.rotation, fitted_parts(campaign, ("base", "tool")))
    np.testing.assert_allclose(frames.base, np.eye(4), atol=1e-4)
    np.testing.assert_allclose(frames.places, [[1.0, 0.2, 0.7]], atol=5e-5)


def test_what_gauges_leave_unexplained_counts_along_all_three_axes(robot: Robot, tmp_path: Path) -> None:
    """Readings scatter by 0.3 mm where the robot is as modelled: 0.3 mm per axis is what the tip may be off."""
    log, instrument = gauge_log(robot, tmp_path, (), 3e-4)
    diagnosis = diagnose_campaign(robot, read_campaign(log, robot, read_instrument(instrument)), register=("tool",))
    known = diagnosis.delivery.uncertainty
    assert known.unexplained == pytest.approx(np.sqrt(3.0) * 3e-4, rel=0.15)
    assert known.calibration < 1.3


def test_gauges_put_up_anywhere_leave_the_zero_of_the_first_joint_as_unknown_as_before(
    robot: Robot, tmp_path: Path
) -> None:
    small = tuple(replace(e, parameters={"offset_rad": 0.05 * e.parameters["offset_rad"]}) for e in PLANTED)
    log, instrument = gauge_log(robot, tmp_path, small)
    diagnosis = diagnose_campaign(robot, read_campaign(log, robot, read_instrument(instrument)), register=("tool",))
    known = diagnosis.delivery.uncertainty
    (zero,) = (u for u in known.unknowns if u.effect == "joint_offset" and u.joint == robot.joint_names[0])
    (before,) = (u for u in robot_uncertainty(robot).unknowns if (u.effect, u.joint) == (zero.effect, zero.joint))
    assert known.calibration * zero.deviation == pytest.approx(before.deviation, rel=1e-6)


def thin_bar_log(robot: Robot, folder: Path, kept: tuple[int, ...]) -> tuple[Path, Path]:
    """Write a log of a ball bar with so many rows about each of its centres."""
    log, instrument = bar_log(robot, folder)
    head, *rows = log.read_text().splitlines()
    return write_log(log, head, [row for k, row in enumerate(rows) if k % 50 < kept[k // 50]]), instrument


def test_places_that_few_rows_stand_at_are_dropped_or_refused_in_one_line(robot: Robot, tmp_path: Path) -> None:
    """Three distances are what an unknown centre takes; what was not read at a bar is not a contact of a socket."""
    log, instrument = thin_bar_log(robot, tmp_path, (9, 3, 4))
    head, *rows = log.read_text().splitlines()
    write_log(log, head, [*rows, rows[0].rpartition(",")[0] + ","])
    campaign = read_campaign(log, robot, read_instrument(instrument))
    assert campaign.observations is not None and campaign.observations.names == ("c0", "c2")
    assert campaign.usable.tolist() == [True] * 9 + [False] * 3 + [True] * 4 + [False]
    assert campaign.observations.contact[campaign.usable].tolist() == [0] * 9 + [1] * 4
    assert [note for note in campaign.notes if "one direction a row" in note]
    assert [note for note in campaign.notes if "contact 'c1' is in 3 rows, expected at least 4" in note]
    with pytest.raises(InputError, match="contact 'c0' is in 2 rows, expected at least 4"):
        read_campaign(*thin_bar_log(robot, tmp_path, (2, 3, 1))[:1], robot)
    gauges, _ = gauge_log(robot, tmp_path)
    head, *rows = gauges.read_text().splitlines()
    seen = read_campaign(write_log(gauges, head, [*rows[:12], rows[30]]), robot).observations
    assert seen is not None and seen.names == ("g0",)


def test_poses_left_out_are_judged_though_few_rows_fix_where_a_bar_stood(robot: Robot, tmp_path: Path) -> None:
    """Centres of four rows are open without one of them: 9 mm were once said of a robot that is .3 mm off."""
    log, instrument = thin_bar_log(robot, tmp_path, (14, 4, 4))
    diagnosis = diagnose_campaign(robot, read_campaign(log, robot, read_instrument(instrument)), register=("tool",))
    with pytest.raises(InputError, match=r"0\.325 mm on all poses and 9\.09 mm on poses left out"):
        refuse_open_frames(0.325e-3, 9.09e-3, diagnosis.fit.problem.campaign)
    refuse_open_frames(0.325e-3, 0.5e-3, diagnosis.fit.problem.campaign)
    # 22 rows, of which three centres and a tool take 12
    assert diagnosis.gap.held_out_before == pytest.approx(diagnosis.gap.before * np.sqrt(22 / 10), rel=0.5)


HEAD = f"run,contact,{JOINTS},dir_i,dir_j,dir_k,reading_mm,distance_mm"


GOOD = "1,2,3,4,5,6"


@pytest.mark.parametrize(
    ("head", "row", "message"),
    [
        (HEAD, f"static,a,{GOOD},0,0,1,5,7", "reading_mm and distance_mm"),
        (HEAD, f"static,,{GOOD},,,,,7", "without a contact"),
        (HEAD, f"static,a,{GOOD},0,0,2,5,", "unit vector"),
        (HEAD, f"static,a,{GOOD},,,,,-7", "not above zero"),
        (f"run,contact,{JOINTS},reading_mm", f"static,a,{GOOD},5", "dir_i dir_j dir_k"),
        (f"run,contact,{JOINTS}", f"static,a,{GOOD}\nstatic,b,6,5,4,3,2,1", "one row only"),
        (f"run,{JOINTS}", f"static,{GOOD}", "expected a position, or contact"),
    ],
)
def test_rows_that_contradict_themselves_are_refused(
    head: str, row: str, message: str, robot: Robot, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        read_campaign(write_log(tmp_path / "bad.csv", head, row.split("\n")), robot)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema = 1\n[instrument]\nsigma = 1.0\n", "unknown key"),
        ('schema = 1\n[[distance]]\nbetween = ["a", "a"]\nmm = 5.0\n', "itself"),
        ('schema = 1\n[[distance]]\nbetween = ["a", "b"]\nmm = -5.0\n', "mm"),
    ],
)
def test_instrument_files_with_mistakes_end_with_status_2(
    text: str, message: str, robot: Robot, tmp_path: Path, run: Run
) -> None:
    (tmp_path / "i.toml").write_text(text)
    log, _ = gauge_log(robot, tmp_path)
    given = ["--robot", robot.folder, "--instrument", tmp_path / "i.toml", "--out", tmp_path / "out"]
    result = run("diagnose", log, *given)
    assert result.status == 2
    assert message in result.err
    assert not (tmp_path / "out").exists()


def test_doctor_says_what_another_instrument_saw(robot: Robot, tmp_path: Path, run: Run) -> None:
    rows = [f"static,{k % 2},{degrees(q)}" for k, q in enumerate(draw_poses(robot, 8, 1))]
    log = write_log(tmp_path / "log.csv", f"run,contact,{JOINTS}", rows)
    result = run("doctor", log, "--json")
    assert "--instrument" in json.dumps(json.loads(result.out))


def numbers(*values: float) -> str:
    return ",".join(f"{value:.9g}" for value in values)


def stated(folder: Path) -> Path:
    (folder / "own.toml").write_text("schema = 1\n[instrument]\nsigma_mm = 0.02\n")
    return folder / "own.toml"


def position_log(robot: Robot, folder: Path) -> Logs:
    q = draw_poses(robot, 60, 9)
    seen = see(robot, q) + np.random.default_rng(1).normal(0.0, SIGMA, (60, 3))
    rows = [f"static,{degrees(a)},{numbers(*b * 1e3)}" for a, b in zip(q, seen, strict=True)]
    return write_log(folder / "positions.csv", f"run,{JOINTS},x_mm,y_mm,z_mm", rows), None


def export_log(robot: Robot, folder: Path) -> Logs:
    """The same as a tracker program exports it: its own titles, semicolons, decimal commas, nominal values beside."""
    log, _ = position_log(robot, folder)
    head = ["Point", *(f"Joint {k} [deg]" for k in range(1, 7)), "Actual X [mm]", "Actual Y [mm]", "Actual Z [mm]"]
    rows = [f"P{k};{row[7:].replace(',', ';').replace('.', ',')};0,0;"
            for k, row in enumerate(log.read_text().splitlines()[1:])]  # fmt: skip
    return write_log(folder / "export.csv", ";".join([*head, "Nominal X [mm]"]) + ";", rows), None


def probe_log(robot: Robot, folder: Path) -> Logs:
    """Readings along normals, zero where the robot as modelled would stand."""
    q, rng = draw_poses(robot, 120, 9), np.random.default_rng(2)
    place, unit = see(robot, q, ()), rng.normal(size=(120, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    off = np.einsum("ni,ni->n", unit, see(robot, q) - place) + rng.normal(0.0, SIGMA, 120)
    rows = [f"static,{degrees(q[k])},{numbers(*place[k] * 1e3, *unit[k], off[k] * 1e3)}" for k in range(120)]
    return write_log(folder / "probe.csv", f"run,{JOINTS},x_mm,y_mm,z_mm,dir_i,dir_j,dir_k,reading_mm", rows), stated(
        folder
    )


def plane_log(robot: Robot, folder: Path) -> Logs:
    """Contacts with three faces: the point lies in the plane, whose height nobody knows."""
    rng, rows = np.random.default_rng(4), []
    for face, place in enumerate(([1.0, 0.2, 0.7], [0.3, 1.0, 0.9], [0.8, -0.8, 1.1])):
        unit, middle = np.eye(3)[face], np.array(place)
        q = touch(robot, middle, 40, rng, onto=lambda p, u=unit, m=middle: p - np.outer((p - m) @ u, u))  # type: ignore[misc]
        rows += [f"static{face},f{face},{degrees(row)},{numbers(*unit)},0" for row in q]
    return write_log(folder / "plane.csv", f"run,contact,{JOINTS},dir_i,dir_j,dir_k,reading_mm", rows), stated(folder)


def sphere_log(robot: Robot, folder: Path) -> Logs:
    """Contacts with three spheres: the point is both radii, 30 mm, from a centre that nobody knows."""
    rng, rows = np.random.default_rng(4), []
    for number, place in enumerate(([1.0, 0.2, 0.7], [0.3, 1.0, 0.9], [0.8, -0.8, 1.1])):
        middle = np.array(place)

        def onto(p: Array, middle: Array = middle) -> Array:
            return middle + 0.03 * (p - middle) / np.linalg.norm(p - middle, axis=1)[:, None]

        q = touch(robot, middle, 40, rng, onto=onto)
        rows += [f"static{number},s{number},{degrees(row)},30" for row in q]
    return write_log(folder / "sphere.csv", f"run,contact,{JOINTS},distance_mm", rows), stated(folder)


KINDS: dict[str, Callable[[Robot, Path], Logs]] = {
    "positions": position_log, "export": export_log, "sockets": socket_log, "gauge": gauge_log, "ball bar": bar_log,
    "probe": probe_log, "plane": plane_log, "sphere": sphere_log,
}  # fmt: skip


def away(robot: Robot, folder: Path, run: Run, tmp_path: Path) -> tuple[float, float]:
    """Return how far a folder is from the truth at poses that nothing saw, and the robot as modelled. [m]"""
    q = draw_poses(robot, 60, 11)
    asked = write_log(tmp_path / "later.csv", f"run,contact,{JOINTS}", [f"static,later,{degrees(row)}" for row in q])
    answer = run("predict", asked, "--robot", folder, "--out", tmp_path / "p.csv")
    assert answer.status == 0, answer.err
    found = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2)) * 1e-3
    true, modelled = see(robot, q), see(robot, q, ())
    return (float(np.sqrt(np.mean(np.sum((other - true) ** 2, axis=1)))) for other in (found, modelled))  # type: ignore[return-value]


@pytest.mark.parametrize("kind", KINDS)
def test_identify_and_predict_take_every_kind_of_row(kind: str, robot: Robot, tmp_path: Path, run: Run) -> None:
    log, instrument = KINDS[kind](robot, tmp_path)
    given = [log, "--robot", robot.folder, "--register", "tool", *(["--instrument", instrument] if instrument else [])]
    answer = run("identify", *given, "--geometry", "offsets", "--out", tmp_path / "out")
    assert answer.status == 0, answer.err
    left, before = away(robot, tmp_path / "out" / "robot", run, tmp_path)
    assert before > 1e-3 and left < 0.08 * before
    answer = run("predict", *given, "--out", tmp_path / "seen.csv")
    assert answer.status == 0, answer.err


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_diagnosis_takes_every_kind_of_row(kind: str, robot: Robot, tmp_path: Path, run: Run) -> None:
    log, instrument = KINDS[kind](robot, tmp_path)
    given = ["--register", "tool", *(["--instrument", instrument] if instrument else [])]
    answer = run("diagnose", log, "--robot", robot.folder, *given, "--out", tmp_path / "out")
    assert answer.status == 0, answer.err
    left, before = away(robot, tmp_path / "out" / "robot", run, tmp_path)
    assert left < 0.15 * before


@pytest.mark.parametrize("name", ["s.ply", "s.stl", "s.xyz", "s.csv"])
@pytest.mark.parametrize("command", ["identify", "diagnose", "predict"])
def test_a_scan_is_no_log_of_poses_and_is_sent_to_learn(
    command: str, name: str, robot: Robot, tmp_path: Path, run: Run
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    if name in ("s.ply", "s.stl"):
        ball.export(tmp_path / name)
    else:
        np.savetxt(tmp_path / name, ball.vertices, delimiter=" " if name == "s.xyz" else ",")
    answer = run(command, tmp_path / name, "--robot", robot.folder, "--out", tmp_path / "out")
    assert answer.status == 2 and "is a scan" in answer.err and "compplan learn" in answer.err
    assert answer.err.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_of_poses_is_no_measurement_of_a_part_and_is_sent_to_diagnose(
    kind: str, robot: Robot, tmp_path: Path
) -> None:
    log, _ = KINDS[kind](robot, tmp_path)
    with pytest.raises(InputError, match="compplan diagnose takes a log of poses"):
        read_measured_points(log)


def test_a_gauge_whose_zero_nobody_knows_is_no_deviation(tmp_path: Path) -> None:
    head, row = "contact,x_mm,y_mm,z_mm,dir_i,dir_j,dir_k,reading_mm", "g,1,2,3,0,0,1,0.1"
    with pytest.raises(InputError, match="an unknown zero"):
        read_measured_points(write_log(tmp_path / "gauge.csv", head, [row] * 9))


def circle(radius: float = 0.15) -> Toolpath:
    turn = np.linspace(0.0, 2 * np.pi, 361)
    place = np.column_stack([1.0 + radius * np.cos(turn), radius * np.sin(turn), np.full(361, 0.5)])
    return Toolpath(place, np.tile([0.0, 0.0, 1.0], (361, 1)), np.full(361, 0.01), np.zeros(361, bool))


def test_lengths_of_a_ball_bar_are_no_points_of_a_part(tmp_path: Path) -> None:
    rows = [numbers(*place * 1e3, 150.0) for place in circle().position[5:355:3]]
    with pytest.raises(InputError, match="compplan diagnose takes a log of it"):
        read_measured_points(write_log(tmp_path / "bar.csv", "x_mm,y_mm,z_mm,distance_mm", rows))


def test_an_export_of_a_cmm_program_is_read_as_measured_points(tmp_path: Path) -> None:
    path = circle()
    rows = [";".join(f"{v * 1e3:.5f}".replace(".", ",") for v in (*place, *place[:2], place[2] + 3e-5))
            for place in path.position[5:355:3]]  # fmt: skip
    head = "Nominal X [mm];Nominal Y [mm];Nominal Z [mm];Actual X [mm];Actual Y [mm];Actual Z [mm]"
    found = match_points(
        read_measured_points(write_log(tmp_path / "cmm.txt", head, rows)), path, np.eye(4), in_base=True
    )
    np.testing.assert_allclose(found.deviation, np.tile([0, 0, 3e-5], (len(rows), 1)), atol=1e-7)
