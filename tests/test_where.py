"""Where a gap lies: an error that is put into one place is found there, and nowhere else."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from compplan.diagnose.where import Split, split_deviation
from compplan.errors import ShapeError
from compplan.measure.campaign import Campaign
from compplan.measure.registration import Registration
from compplan.robot import Array, Robot, Spring, load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium

SIGMA = 3e-5
NOISE = np.sqrt(3) * SIGMA


def make_campaign(
    seed: int = 0, poses: int = 90, robot: Robot | None = None
) -> tuple[Robot, Campaign, np.random.Generator]:
    """Visit poses in two runs, unloaded and loaded, three repeats each."""
    robot = robot or load_robot("kuka_kr270")
    rng = np.random.default_rng(seed)
    middle = np.array([0.0, 0.4, -1.4, 0.0, 0.9, 0.0])
    q = middle + rng.uniform(-1, 1, (poses, 6)) * [1.2, 0.5, 0.5, 1.5, 0.6, 1.5]
    force = rng.normal(size=(poses, 3))
    force *= rng.uniform(500, 1500, (poses, 1)) / np.linalg.norm(force, axis=1, keepdims=True)
    force[::3] = 0.0
    q, force = np.repeat(q, 3, axis=0), np.repeat(force, 3, axis=0)
    n = len(q)
    run = np.where(np.arange(n) < n // 2, "static_1", "static_2")
    wrench = np.hstack([force, np.zeros((n, 3))])
    return robot, Campaign(run, q, wrench, np.zeros((n, 3)), time=np.arange(n) * 10.0), rng


def split(robot: Robot, campaign: Campaign, attained: Array, rng: np.random.Generator, **options: object) -> Split:
    nominal = solve_equilibrium(build_chain(robot), campaign.q, campaign.wrench).position
    deviation = attained - nominal + rng.normal(scale=SIGMA, size=nominal.shape)
    return split_deviation(robot, campaign, deviation, noise=float(NOISE), **options)  # type: ignore[arg-type]


def attain(robot: Robot, campaign: Campaign, q: Array | None = None) -> Array:
    return solve_equilibrium(build_chain(robot), campaign.q if q is None else q, campaign.wrench).position


def test_a_soft_joint_is_found_at_its_joint_and_by_its_load() -> None:
    robot, campaign, rng = make_campaign()
    springs = tuple(replace(s, compliance=1.6 * s.compliance) if s.joint == "joint_3" else s for s in robot.springs)
    result = split(robot, campaign, attain(replace(robot, springs=springs), campaign), rng)
    assert result.cells == (("joint_3", "spring"),)
    assert result.by_joint["joint_3"].share > 0.9
    assert result.by_factor["load"].share > 0.9
    assert result.unexplained < 0.03


def test_a_link_that_bends_beside_its_joint_is_told_from_the_joints_own_spring() -> None:
    robot, campaign, rng = make_campaign(1)
    bent = replace(robot, springs=(*robot.springs, Spring("joint_2", "rx", 3e-7)))
    result = split(robot, campaign, attain(bent, campaign), rng)
    assert result.cells == (("joint_2", "bending"),)


def test_a_wrong_zero_is_found_at_its_joint() -> None:
    robot, campaign, rng = make_campaign(2)
    result = split(robot, campaign, attain(robot, campaign, campaign.q + np.eye(6)[2] * 2e-4), rng)
    assert result.cells == (("joint_3", "zero"),)
    assert result.by_factor["pose"].share > 0.9


def test_lost_motion_is_found_with_its_size() -> None:
    robot, campaign, rng = make_campaign(3)
    result = split(robot, campaign, attain(robot, campaign, campaign.q - 1e-4 * campaign.approach * np.eye(6)[0]), rng)
    assert result.cells == (("joint_1", "lost motion"),)
    entry = result.by_approach["joint_1"]
    assert entry["lost_motion_mrad"] == pytest.approx(0.2, abs=4 * entry["standard_error"])
    assert entry["standard_error"] < 0.01
    other = result.by_approach["joint_2"]
    assert abs(other["lost_motion_mrad"]) < 4 * other["standard_error"]


def test_an_error_periodic_in_an_angle_is_found_whatever_its_frequency() -> None:
    robot, campaign, rng = make_campaign(4, poses=150)
    q = campaign.q + np.eye(6)[1] * 2e-4 * np.sin(17 * campaign.q[:, [1]] + 0.7)
    result = split(robot, campaign, attain(robot, campaign, q), rng)
    assert result.cells[0] == ("joint_2", "periodic error")
    assert result.by_factor["joint angle"].share > 0.85


def test_a_shift_between_runs_is_found_in_the_runs() -> None:
    robot, campaign, rng = make_campaign(5)
    attained = attain(robot, campaign)
    attained[campaign.run == "static_2"] += [3e-4, 0.0, 0.0]
    result = split(robot, campaign, attained, rng)
    assert result.cells == (("runs and time", "time"),)
    assert result.by_run["static_2"]["share"] > 0.9
    assert result.by_run["static_2"]["mean_mm"][0] == pytest.approx(0.3, abs=0.02)
    assert result.by_axis["x"].share > 0.9


def test_two_errors_share_the_gap_and_their_intervals_cover_the_truth() -> None:
    robot, campaign, rng = make_campaign(6)
    springs = tuple(replace(s, compliance=1.5 * s.compliance) if s.joint == "joint_2" else s for s in robot.springs)
    soft = replace(robot, springs=springs)
    both = split(robot, campaign, attain(soft, campaign, campaign.q + np.eye(6)[4] * 5e-4), rng)
    assert set(both.cells) == {("joint_2", "spring"), ("joint_5", "zero")}
    nominal = attain(robot, campaign)
    parts = [attain(soft, campaign) - nominal, attain(robot, campaign, campaign.q + np.eye(6)[4] * 5e-4) - nominal]
    total = sum(float((part**2).sum()) for part in parts) + 2 * float((parts[0] * parts[1]).sum())
    true = float((parts[0] * (parts[0] + parts[1])).sum()) / (total + len(nominal) * NOISE**2)
    share = both.by_joint["joint_2"]
    assert share.low < true < share.high


def test_noise_alone_is_carried_by_nothing() -> None:
    quiet = 0
    for seed in range(10):
        robot, campaign, rng = make_campaign(100 + seed)
        result = split(robot, campaign, attain(robot, campaign), rng)
        quiet += not result.cells
        assert result.noise > 0.85
    assert quiet == 10


def test_after_registration_frames_are_no_explanation() -> None:
    robot, campaign, rng = make_campaign(7)
    turn = np.eye(4)
    turn[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    turn[:3, 3] = [2.0, 1.0, 0.3]
    registration = replace(Registration.identity(campaign), base=turn)
    nominal = attain(robot, campaign)
    shifted = attain(robot, campaign, campaign.q + np.eye(6)[2] * 5e-4)
    deviation = shifted - nominal + rng.normal(scale=SIGMA, size=nominal.shape)
    result = split_deviation(robot, campaign, deviation, registration=registration, noise=float(NOISE))
    assert "tool" not in result.by_joint
    assert set(result.alone["base"]) == {"bending"}
    assert result.cells == (("joint_3", "zero"),)


def test_gross_outliers_do_not_move_the_answer() -> None:
    robot, campaign, rng = make_campaign(8)
    attained = attain(robot, campaign, campaign.q + np.eye(6)[2] * 2e-4)
    attained[rng.choice(len(attained), 5, replace=False)] += 0.02
    assert split(robot, campaign, attained, rng).cells == (("joint_3", "zero"),)


def test_a_sliding_joint_is_a_place_like_any_other() -> None:
    robot = load_robot("kuka_kr240_rail")
    _, campaign, rng = make_campaign(9)
    rail = np.repeat(rng.uniform(0.2, 2.5, (len(campaign) // 3, 1)), 3, axis=0)
    campaign = replace(campaign, q=np.hstack([rail, campaign.q]))
    q = campaign.q - 1e-4 * campaign.approach * np.eye(7)[0]
    result = split(robot, campaign, attain(robot, campaign, q), rng)
    name = robot.joint_names[0]
    assert result.cells == ((name, "lost motion"),)
    assert result.by_approach[name]["lost_motion_mm"] == pytest.approx(0.2, abs=0.02)


def test_shares_of_parts_add_up_and_the_whole_is_plain_json() -> None:
    robot, campaign, rng = make_campaign(10)
    result = split(robot, campaign, attain(robot, campaign, campaign.q + 1e-4), rng)
    for entries in (result.by_run.values(), result.by_time, result.by_load, result.by_region):
        assert sum(entry["share"] for entry in entries) == pytest.approx(1.0, abs=1e-3)
    assert sum(result.by_axis[axis].share for axis in "xyz") == pytest.approx(1.0, abs=1e-9)
    written = json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert set(written["by_joint"]) >= set(robot.joint_names)
    assert all(0 <= share["low"] <= share["share"] <= share["high"] <= 1 for share in written["by_joint"].values())
    again = split_deviation(robot, campaign, locate_frames(build_chain(robot), campaign.q).tcp_position * 1e-4)
    assert again.rms > 0


def test_a_deviation_of_the_wrong_shape_is_refused() -> None:
    robot, campaign, _ = make_campaign()
    with pytest.raises(ShapeError, match=r"deviation has shape \(3, 3\), expected \(270, 3\)"):
        split_deviation(robot, campaign, np.zeros((3, 3)))
