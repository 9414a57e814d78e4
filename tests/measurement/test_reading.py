"""Measurement logs: units, missing values, and what follows from the order of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2, ncx2
from simulated_campaigns import plan_rows, write_small_robot

from compplan.errors import InputError
from compplan.measurement import pooling
from compplan.measurement.campaign import Campaign
from compplan.measurement.distance import band_radius
from compplan.measurement.pooling import pool_rows
from compplan.measurement.reading import read_campaign
from compplan.measurement.registration import Registration
from compplan.robot import Robot

HEAD = "run,time_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,x_mm,y_mm,z_mm\n"
SIGMA = 2e-5


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return write_small_robot(tmp_path_factory.mktemp("small"))


def write(folder: Path, text: str) -> Path:
    file = folder / "log.csv"
    file.write_text(text)
    return file


def test_either_unit_of_a_column_reads_the_same(robot: Robot, tmp_path: Path) -> None:
    one = read_campaign(write(tmp_path, HEAD + "static_1,0,90,0,0,0,0,0,0,0,-100,0,0,0,1000,2000,500\n"), robot)
    radians = HEAD.replace("q1_deg", "q1_rad").replace("x_mm", "x_m")
    row = f"static_1,0,{np.pi / 2},0,0,0,0,0,0,0,-100,0,0,0,1,2000,500\n"
    two = read_campaign(write(tmp_path, radians + row), robot)
    assert one.q[0, 0] == pytest.approx(two.q[0, 0])
    assert one.position[0, 0] == pytest.approx(two.position[0, 0]) == 1.0


def test_a_measured_orientation_is_a_rotation_vector(robot: Robot, tmp_path: Path) -> None:
    head = HEAD.replace("z_mm", "z_mm,rx_deg,ry_deg,rz_deg")
    third = 120.0 / np.sqrt(3.0)  # a third of a turn about the diagonal of a cube takes x to y, y to z, z to x
    rows = [f"{third},{third},{third}", "0,0,90", ",,"]
    text = "".join(f"static_1,0,9,0,0,0,0,0,0,0,0,0,0,0,1,2,3,{row}\n" for row in rows)
    rotation = read_campaign(write(tmp_path, head + text), robot).rotation
    assert rotation is not None
    assert rotation[0] == pytest.approx(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]), abs=1e-12)
    assert rotation[1] == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-12)
    assert np.isnan(rotation[2]).all()


def test_a_log_without_wrench_columns_carries_no_load(robot: Robot, tmp_path: Path) -> None:
    text = "run,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm\nstatic,1,2,3,4,5,6,7,8,9\n"
    campaign = read_campaign(write(tmp_path, text), robot)
    assert not campaign.wrench.any()
    assert not campaign.load_varies


def test_positions_of_kilometres_name_the_unit(robot: Robot, tmp_path: Path) -> None:
    text = HEAD.replace("x_mm", "x_m") + "static,0,1,2,3,4,5,6,0,0,0,0,0,0,1700,8,9\n"
    with pytest.raises(InputError, match="name the columns x_mm"):
        read_campaign(write(tmp_path, text), robot)


def test_a_missing_joint_column_is_named(robot: Robot, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="q6"):
        read_campaign(write(tmp_path, HEAD.replace("q6_deg,", "") + "static,0,1,2,3,4,5,0,0,0,0,0,0,7,8,9\n"), robot)


def order(q: list[float], run: list[str]) -> Campaign:
    joints = np.zeros((len(q), 6))
    joints[:, 1] = q
    nowhere = np.zeros((len(q), 3))
    return Campaign(run=np.array(run), q=joints, wrench=np.zeros((len(q), 6)), position=nowhere)


def test_approach_is_the_sign_of_the_last_move_and_unknown_where_a_run_begins() -> None:
    campaign = order([0.0, 0.1, 0.1, 0.05, 0.3, 0.2], ["static_1"] * 4 + ["static_2"] * 2)
    assert campaign.approach[:, 1].tolist() == [0, 1, 1, -1, 0, -1]
    assert campaign.first_visit.tolist() == [True, False, False, False, True, False]


def test_runs_at_rest_that_alternate_were_taken_without_a_break() -> None:
    campaign = order([0.0, 0.0, 0.1, 0.1, 0.3, 0.2], ["static_1", "static_2"] * 2 + ["static_3"] * 2)
    assert campaign.run_index.tolist() == [0, 0, 0, 0, 1, 1]
    assert campaign.approach[:, 1].tolist() == [0, 0, 1, 1, 0, -1]
    assert campaign.stay.tolist() == [0, 0, 1, 1, 2, 3]
    between = order([0.0] * 5, ["static_1", "path_1", "path_2", "static_1", "static_1"])
    assert between.run_index.tolist() == [0, 1, 2, 3, 3]


def test_loads_and_moves_begin_beyond_what_sensor_and_encoder_scatter() -> None:
    """Assumed: 5 N and 2 N m, or a fiftieth of the log's largest force; 2e-5 rad at rest and nothing on a path."""
    campaign = order([0.0] * 4, ["static_1"] * 4)
    pulled = np.zeros((4, 6))
    pulled[:2, 0], pulled[2:, 4] = [4.9, 5.1], [1.95, 2.05]
    assert campaign.is_load(pulled).tolist() == [False, True, False, True]
    heavy = np.zeros((4, 6))
    heavy[:, 2] = 1000.0
    pulled[:2, 0] = [19.0, 21.0]
    assert replace(campaign, wrench=heavy).is_load(pulled).tolist() == [False, True, False, False]
    assert order([0.0, 1.9e-5, 4.0e-5, 4.0e-5], ["static_1"] * 4).visit.tolist() == [0, 0, 1, 1]
    assert order([0.0, 1.9e-5, 4.0e-5], ["static_1"] * 3).approach[:, 1].tolist() == [0, 0, 1]
    assert order([0.0, -1.9e-8, -1.8e-8], ["path_1"] * 3).approach[:, 1].tolist() == [0, -1, -1]


def test_speed_is_that_of_paths_and_zero_at_rest(robot: Robot) -> None:
    campaign = plan_rows(robot, 1, poses=5, path=50)
    assert not campaign.speed[~campaign.on_path].any()
    rows = np.flatnonzero(campaign.on_path)[10:40]
    assert campaign.time is not None
    slope = (campaign.q[rows + 1] - campaign.q[rows - 1]) / (campaign.time[rows + 1] - campaign.time[rows - 1])[:, None]
    np.testing.assert_allclose(campaign.speed[rows], slope, rtol=1e-6, atol=1e-9)


def repeat(poses: int, times: int, *, stays: bool, seed: int = 1) -> Campaign:
    """A campaign of poses met again and again, row after row or round after round, with noise of 20 um."""
    rng = np.random.default_rng(seed)
    q, place = rng.uniform(-1.0, 1.0, (poses, 6)), rng.uniform(-1.0, 1.0, (poses, 3))
    at = np.repeat(np.arange(poses), times) if stays else np.tile(np.arange(poses), times)
    position = place[at] + SIGMA * rng.normal(size=(len(at), 3))
    return Campaign(np.full(len(at), "static"), q[at], np.zeros((len(at), 6)), position)


@pytest.mark.parametrize("stays", [True, False])
def test_rows_of_a_pose_become_their_mean_and_its_deviation(stays: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(10, 300, stays=stays)
    pooled = pool_rows(campaign)
    assert len(pooled) < 0.2 * len(campaign)
    assert pooled.scatter == pytest.approx(SIGMA, rel=0.03)
    for first in range(10):
        of_log = np.abs(campaign.q - campaign.q[first if not stays else 300 * first]).max(1) < 1e-9
        of_means = np.abs(pooled.q - campaign.q[of_log][0]).max(1) < 1e-9
        rows, means = campaign.position[of_log], pooled.position[of_means]
        weight = np.asarray(pooled.sigma)[of_means] ** -2.0
        assert np.allclose(weight @ means / weight.sum(), rows.mean(axis=0), atol=1e-8)
        assert weight.sum() ** -0.5 == pytest.approx(SIGMA / np.sqrt(len(rows)), rel=0.05)


def test_the_direction_of_the_last_move_outlives_pooling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(7, 100, stays=False)
    pooled = pool_rows(campaign)
    for row, sign in zip(pooled.q, pooled.approach, strict=True):
        alike = (np.abs(campaign.q - row).max(1) < 1e-9) & (campaign.approach == sign).all(1)
        assert alike.any()


def test_exact_copies_and_gross_rows_are_said_and_count_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(10, 50, stays=True)
    campaign.position[3] += 1e-3
    twice = campaign.take(np.tile(np.arange(len(campaign)), 2))
    pooled, once = pool_rows(twice), pool_rows(campaign)
    assert np.allclose(pooled.position, once.position) and np.allclose(pooled.sigma, once.sigma)
    assert any("500 of 1000 rows are exact copies" in note for note in pooled.notes)
    assert any("far from the others" in note for note in pooled.notes)
    assert np.abs(pooled.position[0] - campaign.position[4]).max() < 5.0 * SIGMA


def test_short_logs_stay_as_they_are_and_of_ever_new_poses_a_part_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = repeat(10, 20, stays=True)
    assert pool_rows(campaign) is campaign
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    many = pool_rows(repeat(390, 1, stays=True))
    assert len(many) == 98 and "every 4th" in many.notes[-1]


def test_visits_are_kept_apart_only_where_they_scatter_beyond_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pooling, "FROM_ROWS", 100)
    campaign = repeat(10, 300, stays=False)
    # the first row has no last move
    assert len(pool_rows(campaign)) == 11
    campaign.position[:, 0] += np.linspace(0.0, 2.0 * SIGMA, len(campaign))
    assert len(pool_rows(campaign)) > 200


def test_targets_are_seen_from_where_the_instrument_stands(robot: Robot, tmp_path: Path) -> None:
    """A quarter of a turn about z and a shift: x of the base is y of the instrument; the target lies beside the tip."""
    campaign = read_campaign(write(tmp_path, HEAD + "static_1,0,9,0,0,0,0,0,0,0,0,0,0,0,1,2,3\n"), robot)
    base, tool = np.eye(4), np.eye(4)[None].copy()
    base[:3, :3], base[:3, 3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [0.1, 0.2, 0.3]
    tool[0, :3, 3] = [0.0, 0.0, 0.5]
    seen = Registration(base, tool).locate_targets(campaign, np.array([[1.0, 0.0, 0.0]]), np.eye(3)[None])
    assert seen[0] == pytest.approx([0.1, 1.2, 0.8])


@pytest.mark.parametrize("shift", [0.0, 1.0, 3.0])
def test_the_radius_of_an_even_error_about_a_mean_is_that_of_the_noncentral_chi_square(shift: float) -> None:
    exact = np.sqrt(ncx2.ppf(0.95, 3, shift**2)) if shift else np.sqrt(chi2.ppf(0.95, 3))
    found = band_radius(np.eye(3)[None], mean=np.array([[shift, 0.0, 0.0]]))[0]
    assert found == pytest.approx(exact, rel=2e-3)
