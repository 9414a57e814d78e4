"""What the motion of the arm and the place of the part add to the band: closed forms and independent integration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import one_joint_arm
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from compplan.job.job import check_job
from compplan.measurement.distance import band_radius
from compplan.planning.deflection import find_inside, follow_links
from compplan.planning.plan import plan_job
from compplan.robot.model import Body
from compplan.simulation.inertia import average_loads
from compplan.simulation.response import MODES, ring
from compplan.simulation.vibration import build_dynamics, find_modes
from compplan.statics.chain import locate_frames
from compplan.statics.ik import build_arm, refine_ik
from compplan.statics.inertia import build_moving_chain, divide_body, load_motion, smooth_loads
from compplan.uncertainty.motion import Push, shift_part, swing_arm

JOB: dict[str, Any] = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 100.0, "feed_mm_s": 150.0, "waypoints": 120},
    "part": {"position_mm": [1700.0, 0.0, 900.0]},
    "process": {"model": "constant", "force_N": [0.0, 0.0, 0.0], "frame": "base"},
    "plan": {"tolerance_mm": 0.1},
}


def test_four_points_have_the_mass_the_centre_and_the_inertia_of_a_body() -> None:
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    body = Body("link", 7.0, np.array([0.1, -0.2, 0.3]), turn @ np.diag([0.3, 0.4, 0.5]) @ turn.T)
    points = divide_body(body)
    assert sum(point.mass for point in points) == pytest.approx(7.0)
    assert np.mean([point.centre for point in points], axis=0) == pytest.approx(body.centre)
    arms = [point.centre - body.centre for point in points]
    inertia = sum(7.0 / 4 * (arm @ arm * np.eye(3) - np.outer(arm, arm)) for arm in arms)
    assert inertia == pytest.approx(body.inertia, abs=1e-12)


@pytest.mark.parametrize(("scale", "damping"), [(1.0, 0.03), (0.8, 0.1)])
def test_a_mass_on_a_spring_rings_as_an_integration_in_small_steps_says(
    tmp_path: Path, scale: float, damping: float
) -> None:
    """One joint, 20 kg at 1 m, C = 1e-5: w = 70.7 rad/s; a load that sets in and ends, rows far from even."""
    dynamics = build_dynamics(one_joint_arm(tmp_path, 1.0, 1e-5, mass=20.0))
    random = np.random.default_rng(3)
    time = np.sort(np.r_[0.0, random.uniform(0.0, 1.0, 200), 1.0])
    load = np.where(time < 0.5, 100.0 * np.sin(6.0 * time) ** 2, 0.0)[:, None]
    modes = find_modes(dynamics, np.zeros((1, 1)), MODES)
    omega = scale * modes[0].omega[0]
    assert modes[0].omega[0] == pytest.approx((1e-5 * 20.0) ** -0.5, rel=1e-3)
    one, share = np.ones((1, 1)), np.array([damping])
    more = ring(modes, np.array([0]), time, [load], one, np.array([scale]), share)[0]
    static = 1e-5 * load[:, 0]

    def change(t: float, x: np.ndarray) -> list[float]:
        push = 1e-5 * omega**2 * np.interp(t, time, load[:, 0])
        return [x[1], push - 2 * damping * omega * x[1] - omega**2 * x[0]]

    found = solve_ivp(change, (0.0, 1.0), [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-12, max_step=2e-3).y[0]
    assert np.abs(found).max() > 1.02 * np.abs(static).max()
    tip = np.abs(more[:, 2]) * np.sign(found - static)
    assert tip == pytest.approx(found - static, abs=2e-3 * np.abs(found).max())


def test_a_load_that_stays_adds_nothing_to_what_the_springs_give_at_once(tmp_path: Path) -> None:
    dynamics = build_dynamics(one_joint_arm(tmp_path, 1.0, 1e-5, mass=20.0))
    time = np.linspace(0.0, 1.0, 50)
    modes, one = find_modes(dynamics, np.zeros((1, 1)), MODES), np.ones(1)
    more = ring(modes, np.array([0]), time, [np.full((50, 1), 10.0)], one[None], one, 0.03 * one)
    assert np.abs(more).max() < 1e-15


def test_what_is_compensated_leaves_the_share_that_masses_and_springs_are_other_than_modelled(tmp_path: Path) -> None:
    """A slow load: the tip is k - 1 or k times the static bend, k lognormal with the width that is stated."""
    dynamics = build_dynamics(one_joint_arm(tmp_path, 1.0, 1e-5, mass=20.0))
    time, q = np.linspace(0.0, 10.0, 50), np.zeros((50, 1))
    static = np.tile([0.0, 0.0, 1e-3], (50, 1))
    moving, nothing = Push(np.full((50, 1), 100.0), static), Push(np.zeros((50, 1)), 0.0 * static)
    both = [
        swing_arm(dynamics, q, time, moving, held, width=0.2, damping=0.03, source="") for held in (moving, nothing)
    ]
    for motion, middle in zip(both, (0.0, 1e-3), strict=True):
        assert motion.mean[25, 2] == pytest.approx(middle, abs=2e-5)
        assert np.sqrt(motion.covariance[25, 2, 2]) == pytest.approx(2e-4, rel=0.1)


def test_a_drawn_arm_that_is_heavier_rings_slower(tmp_path: Path) -> None:
    dynamics = build_dynamics(one_joint_arm(tmp_path, 1.0, 1e-5, mass=20.0))
    time, load = np.linspace(0.0, 1.0, 4001), np.zeros((4001, 1))
    load[1:9] = 100.0  # a knock of 2 ms
    static = 1e-5 * np.column_stack([0.0 * load, 0.0 * load, load])
    moving, held = Push(load, static), Push(0.0 * load, 0.0 * static)
    error = swing_arm(dynamics, np.zeros((4001, 1)), time, moving, held, width=0.4, damping=2e-3, source="").error
    turns = np.array([np.count_nonzero(np.diff(np.sign(one[20:, 2]))) for one in error])
    assert (np.diff(turns) <= 0).all()  # draws go from light and stiff to heavy and soft
    level = ndtri((np.arange(len(turns)) + 0.5) / len(turns))
    assert turns[0] / turns[-1] == pytest.approx(np.exp(0.2 * np.ptp(level / np.sqrt(np.mean(level**2)))), rel=0.1)


def spike(n: int, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Return even times of one second, and loads of two springs that are nothing but at one row."""
    load = np.zeros((n, 2))
    load[row] = 100.0, -50.0
    return np.linspace(0.0, 1.0, n), load


@pytest.mark.parametrize("row", [1, 40, 199])
def test_no_correction_that_jumps_is_made_against_inertia(row: int) -> None:
    """A load at one row beside a stop, or within a run: what is compensated changes by no more than 2 max|b| / h."""
    time, load = spike(201, row)
    smooth = smooth_loads(load, time, [(0, 200)], 0.1)
    step = np.abs(np.diff(smooth, axis=0)).max(axis=0) / 0.005
    assert (step <= 2.0 * np.abs(load).max(axis=0) / 0.05).all()
    assert smooth[[0, -1]] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(smooth).max() < 0.11 * np.abs(load).max()
    if row == 40:  # what a run carries on average stays
        assert smooth.sum(axis=0) == pytest.approx(load.sum(axis=0), rel=1e-6)


def test_a_load_that_an_arm_follows_is_compensated_as_it_is_and_runs_stay_apart() -> None:
    """Where a load is linear in time its mean over a window is itself; a sine loses 1 - sinc^2(f h)."""
    time = np.sort(np.r_[0.0, np.random.default_rng(5).uniform(0.0, 2.0, 3000), 2.0])
    load = np.stack([3.0 * time, np.sin(2.0 * np.pi * 4.0 * time)], axis=1)
    smooth = smooth_loads(load, time, [(0, len(time) - 1)], 0.1)
    inner = (time > 0.1) & (time < 1.9)
    assert smooth[inner, 0] == pytest.approx(load[inner, 0], abs=1e-6)
    assert smooth[inner, 1] == pytest.approx(np.sinc(4.0 * 0.05) ** 2 * load[inner, 1], abs=2e-3)
    two = smooth_loads(load, time, [(0, 1000), (1000, 2000)], 0.1)
    assert two[1000] == pytest.approx(0.0, abs=1e-9) and two[2001:] == pytest.approx(0.0)


def test_the_judge_averages_loads_as_the_plan_does_by_a_way_of_its_own() -> None:
    random = np.random.default_rng(6)
    time = np.sort(np.r_[0.0, random.uniform(0.0, 2.0, 400), 2.0])
    load, runs = np.sin(time[:, None] * np.array([3.0, 20.0, 90.0])), [(0, 150), (150, 401)]
    load[:, 1] += np.where(np.arange(402) == 148, 20.0, 0.0)  # a jump beside a stop
    assert average_loads(load, time, runs, 0.2) == pytest.approx(smooth_loads(load, time, runs, 0.2), abs=0.02 * 20.0)
    assert average_loads(load, time, runs, 0.2)[:, ::2] == pytest.approx(
        smooth_loads(load, time, runs, 0.2)[:, ::2], abs=5e-3
    )


def test_a_nervous_path_moves_no_drive_nervously_and_what_that_leaves_is_in_the_band(tmp_path: Path) -> None:
    """Rows on a zigzag of 20 um: its inertia is out of the arm's reach, so the command does not answer to it."""
    x = np.linspace(0.0, 120.0, 121)
    rows = [f"{a:.4f},{0.02 * (k % 2):.4f},0,60" for k, a in enumerate(x)]
    (tmp_path / "path.csv").write_text("\n".join(["x_mm,y_mm,z_mm,feed_mm_s", *rows]) + "\n", encoding="utf-8")
    table = {**JOB, "toolpath": "path.csv", "sampling": {"max_step_mm": 1000.0}}
    plan = plan_job(check_job(table, tmp_path / "job.toml"))
    task, promise = plan.task, plan.promise
    assert plan.status == "solved" and task.bias is not None and promise is not None and promise.motion is not None
    raw = load_motion(build_moving_chain(task.robot), task.q_links, plan.timing.time, find_inside(task))
    middle = slice(len(task) // 3, 2 * len(task) // 3)
    jumps, smooth = (np.abs(np.diff(load[middle], axis=0)).max(axis=0) for load in (raw, task.bias))
    assert (jumps > 1.0).any() and (smooth[jumps > 1.0] < 0.3 * jumps[jumps > 1.0]).all()
    assert np.linalg.norm(promise.motion.mean[plan.task.cut], axis=1).max() > 1e-6


def test_the_radius_about_a_known_shift_holds_its_share() -> None:
    random = np.random.default_rng(4)
    for mean, spread in (([1.0, 0, 0], [1, 1, 1.0]), ([3.0, 1, 0], [1, 0.2, 0.5]), ([0, 0, 5.0], [0.1, 0.1, 1.0])):
        radius = band_radius(np.diag(np.square(spread))[None], mean=np.array([mean]))[0]
        drawn = np.array(mean) + random.standard_normal((200000, 3)) * spread
        assert np.mean(np.linalg.norm(drawn, axis=1) <= radius) == pytest.approx(0.95, abs=6e-3)
    assert band_radius(np.zeros((1, 3, 3)), mean=np.array([[3.0, 4, 0]]))[0] == pytest.approx(5.0)


def test_a_plan_that_leaves_inertia_alone_has_it_in_its_band_and_its_verdict_says_so() -> None:
    """The same path at the same feed without force: what differs is the inertia of the motion."""
    jobs = {on: check_job({**JOB, "plan": {"tolerance_mm": 0.1, "inertia": on}}, "job.toml") for on in (True, False)}
    plans = {on: plan_job(job) for on, job in jobs.items()}
    bands = {on: plan.promise for on, plan in plans.items()}
    assert plans[True].task.inertia and plans[True].status == "solved"
    for on in (True, False):
        assert bands[on] is not None and bands[on].motion is not None
    widest = {on: float(band.parts["motion"][band.cut].max()) for on, band in bands.items() if band is not None}
    assert widest[True] < 0.8 * widest[False]
    assert widest[False] > plans[False].bending.inertia
    if plans[False].verdict.largest_cause == "inertia and vibration":
        assert "inertia = true" in plans[False].verdict.change


def test_the_place_of_a_part_counts_where_it_is_stated_and_is_listed_where_not() -> None:
    plain, placed = (
        plan_job(check_job({**JOB, **more}, "job.toml"))
        for more in (
            {"part": {**JOB["part"], "touched_off": False}},
            {"noise": {"part_frame_mm": 0.5, "part_frame_deg": 0.0}},
        )
    )
    assert any("place of the part" in one for one in plain.verdict.left_out)
    assert not any("place of the part" in one for one in placed.verdict.left_out)
    assert placed.promise is not None and plain.promise is not None
    assert placed.promise.parts["placement"] == pytest.approx(2.795483 * 5e-4, rel=1e-4)
    assert placed.verdict.largest_cause == "place of the part"
    assert plain.promise.parts["placement"] == pytest.approx(0.0)


def test_a_part_that_is_turned_moves_by_the_angle_times_the_distance_from_its_frame() -> None:
    columns = shift_part(np.array([[1.0, 0.5, 0.0]]), np.array([1.0, 0.0, 0.0]), (1e-4, 2e-5))
    assert np.linalg.norm(columns[0, :, 5]) == pytest.approx(2e-5 * 0.5)
    assert columns[0, :, 4] == pytest.approx(0.0)


def test_the_links_go_where_the_command_turns_the_tool() -> None:
    """A command may use the free rotation about the tool axis: the masses that it moves so count as they move."""
    plan = plan_job(check_job(JOB, "job.toml"))
    task, cut = plan.task, plan.task.cut
    frames = locate_frames(task.chain, task.q_links)
    assert np.linalg.norm(frames.tcp_position - task.position, axis=1)[cut].max() < 1e-7
    turned = Rotation.from_rotvec(np.radians(4.0) * frames.tcp_rotation[:, :, 2])
    wanted = turned.as_matrix() @ frames.tcp_rotation
    arm = build_arm(task.robot)
    q = refine_ik(arm, task.q_links, frames.tcp_position, wanted)
    links = locate_frames(task.chain, follow_links(task, q))
    spin = Rotation.from_matrix(links.tcp_rotation @ np.swapaxes(frames.tcp_rotation, 1, 2)).magnitude()
    assert spin[cut] == pytest.approx(np.radians(4.0), rel=1e-3)
