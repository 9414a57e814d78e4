"""What the motion of the arm and the place of the part add to the band: closed forms and independent integration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import one_joint_arm
from scipy.integrate import solve_ivp

from compplan.job.job import check_job
from compplan.job.noise import NoiseTable
from compplan.planning.deflection import find_inside
from compplan.planning.plan import plan_job
from compplan.simulation.vibration import MODES, build_dynamics, find_modes, ring
from compplan.statics.inertia import build_moving_chain, load_motion
from compplan.uncertainty.motion import read_placement, shift_part

JOB: dict[str, Any] = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 100.0, "feed_mm_s": 150.0, "waypoints": 120},
    "part": {"position_mm": [1700.0, 0.0, 900.0]},
    "process": {"model": "constant", "force_N": [0.0, 0.0, 0.0], "frame": "base"},
    "plan": {"tolerance_mm": 0.1},
}


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


def spike(n: int, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Return even times of one second, and loads of two springs that are nothing but at one row."""
    load = np.zeros((n, 2))
    load[row] = 100.0, -50.0
    return np.linspace(0.0, 1.0, n), load


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


def test_the_place_of_a_part_is_stated_in_mm_and_degrees() -> None:
    assert read_placement(NoiseTable(part_frame_mm=0.5, part_frame_deg=2.0)) == (5e-4, pytest.approx(np.pi / 90))
    assert read_placement(None) is None


def test_a_part_that_is_turned_moves_by_the_angle_times_the_distance_from_its_frame() -> None:
    columns = shift_part(np.array([[1.0, 0.5, 0.0]]), np.array([1.0, 0.0, 0.0]), (1e-4, 2e-5))
    assert np.linalg.norm(columns[0, :, 5]) == pytest.approx(2e-5 * 0.5)
    assert columns[0, :, 4] == pytest.approx(0.0)
