"""Measurement logs: units, missing values, and what follows from the order of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_campaigns import plan_rows, write_small_robot

from compplan.errors import InputError
from compplan.measurement.campaign import Campaign
from compplan.measurement.reading import read_campaign
from compplan.robot import Robot

HEAD = "run,time_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,fx_N,fy_N,fz_N,mx_Nm,my_Nm,mz_Nm,x_mm,y_mm,z_mm\n"


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
