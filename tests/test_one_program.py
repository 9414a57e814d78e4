"""One program of time, posture and promise: derivatives, closed forms, limits, and what it brings on a small job."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from benchmarks.limits import sample_use
from compplan.job.job import check_job, load_job
from compplan.plan import refine
from compplan.plan.feed import FeedWish
from compplan.plan.freedom import Freedom, find_freedom
from compplan.plan.ground import drop_least, state_ground
from compplan.plan.one_program import JointProgram, Prices, build_program
from compplan.plan.plan import Plan, build_task, plan_job, prepare_job
from compplan.plan.program_step import _time_slopes, propose_step, solve_program
from compplan.plan.quadratic import StepRows, StepVariables, solve_quadratic
from compplan.plan.refine import _judge, list_windows
from compplan.plan.reversals import describe_reversals, list_reversals
from compplan.plan.run_meter import RunMeter, lead_radius, spread_tip
from compplan.plan.timing import cutting_runs, time_command
from compplan.posture.clearance import measure_margin
from compplan.posture.collision_scene import build_scene
from compplan.posture.slides import count_reversals
from compplan.reporting.writers.plan import write_plan
from compplan.statics.sensitivity import attain_pose
from compplan.uncertainty.assumed import known_uncertainty
from compplan.uncertainty.band import band_radius
from compplan.uncertainty.slopes import read_force_spread

PUSH = {"model": "constant", "force_N": [200.0, 100.0, 300.0], "frame": "base"}
CIRCLE: dict[str, Any] = {
    "schema": 1, "robot": "kuka_kr270", "process": PUSH, "part": {"position_mm": [1700.0, 0.0, 800.0]},
    "tool": {"position_mm": [0.0, 0.0, 300.0], "abc_deg": [0.0, 30.0, 0.0], "mass_kg": 8.0},
    "toolpath": {"generator": "circle", "radius_mm": 120.0, "feed_mm_s": 500.0, "waypoints": 60},
    "plan": {"tolerance_mm": 0.5, "inertia": False}, "sampling": {"chord_mm": 0.3},
}  # fmt: skip


def free(job: dict[str, Any], tube: float = 0.0, **posture: Any) -> Freedom:
    """Return what a job leaves free, by the graph's posture."""
    robot, nominal, options = prepare_job(check_job({**job, "posture": posture}, "job.toml"))
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    assert task.start is not None and task.start.stance is not None
    found = find_freedom(task, task.start.stance, nominal, np.asarray(options.tool_x, float), 100, tube)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def rail() -> Freedom:
    path = {**CIRCLE["toolpath"], "waypoints": 40}
    part = {"position_mm": [1590.0, 2000.0, 600.0]}
    job = {**CIRCLE, "robot": "kuka_kr240_rail", "toolpath": path, "part": part}
    allowed = {"normal_mm": 0.2, "tangential_mm": 1.0}
    return free({**job, "tolerance": allowed}, 0.5, lead_deg=5.0, lean_deg=5.0, spin_step_deg=60.0)


def test_joints_are_eliminated_with_their_exact_derivative_and_the_loaded_tip_stays_on_the_path(rail: Freedom) -> None:
    assert rail.names == ("spin", "lead", "lean", "ahead", "left", "up", "joint_1")
    rng = np.random.default_rng(0)
    values = rail.start + np.minimum(rail.most, 0.02) * rng.uniform(-1.0, 1.0, rail.start.shape)
    q, rate, reached = rail.pose(rail.task.q_start[rail.rows], values)
    assert reached.all()
    off = attain_pose(rail.task.chain, q, rail.wrench).position - rail.task.position[rail.rows]
    assert np.einsum("nij,ni->nj", rail.frame, off) == pytest.approx(values[:, 3:6], abs=1e-9)
    assert q[:, 0] == pytest.approx(values[:, 6])
    for k in range(7):
        step = 1e-5 * np.eye(7)[k]
        ahead, behind = (rail.pose(q, values + side * step)[0] for side in (1.0, -1.0))
        assert rate[:, :, k] == pytest.approx((ahead - behind) / 2e-5, abs=2e-5)


def test_a_tube_is_a_share_of_what_is_allowed_across_and_along_and_none_where_the_tool_rests(rail: Freedom) -> None:
    ahead, left, up = rail.most[:, 3:6].T
    cut = rail.task.cut[rail.rows]
    inner = np.flatnonzero(cut)[2:-2]
    assert ahead[inner] == pytest.approx(0.5e-3) and np.hypot(left, up)[inner] == pytest.approx(0.1e-3)
    assert not rail.most[~cut, 3:6].any() and not rail.most[[0, -1], 3:6].any()


def test_the_time_of_a_run_answers_to_the_squares_of_its_speed_as_differences_say() -> None:
    rng = np.random.default_rng(1)
    along, square = np.cumsum(rng.uniform(0.1, 0.3, 8)), rng.uniform(0.2, 1.0, 8)

    def spend(x: np.ndarray) -> float:
        return float((2.0 * np.diff(along) / (np.sqrt(x[1:]) + np.sqrt(x[:-1]))).sum())

    slope, diagonal, beside = _time_slopes(along, np.sqrt(square))
    h, unit = 1e-4, np.eye(8)
    assert slope == pytest.approx([(spend(square + h * e) - spend(square - h * e)) / (2 * h) for e in unit], rel=1e-4)
    second = [(spend(square + h * e) - 2 * spend(square) + spend(square - h * e)) / h**2 for e in unit]
    assert diagonal == pytest.approx(second, rel=1e-2)
    a, b = h * unit[2], h * unit[3]
    mixed = spend(square + a + b) - spend(square + a - b) - spend(square - a + b) + spend(square - a - b)
    assert beside[2] == pytest.approx(mixed / (4 * h**2), rel=1e-2)


def test_a_step_of_two_coefficients_goes_to_the_corner_that_rows_and_size_leave() -> None:
    rows = StepRows(StepVariables(2, 2, 0, 0))
    rows.add(np.array([0.3]), c=np.array([[1.0, 1.0]]), b=-1.0)
    rows.add(np.array([0.0]), b=1.0)
    rows.add(np.array([0.0]), c=np.array([[-1.0, 0.0]]), x=((np.array([1]), np.array([1.0])),))
    found = solve_quadratic(
        rows, slope=np.array([0.0, -1.0]), pull=np.zeros(2), fixed=np.zeros(2, bool),
        bend=[np.zeros(2), np.zeros(2)], rapid=0.0, travel=0.0, band=0.0,
        square=np.array([0.5, 0.5]), ends=np.array([0]), size=0.4,
    )  # fmt: skip
    assert found is not None  # x_1 <= c_0: as far as the size lets it, c_1 gives way
    assert found[0] == pytest.approx(0.4, abs=1e-3) and found[1] <= -0.1 + 1e-3


def test_a_posture_wins_by_what_its_preset_is_for_alone() -> None:
    assert _judge("fast", 0.8, 3.0, 3.0) == 0.8
    assert _judge("accurate", 1.0, 1.0, 0.9) == 0.95 and _judge("promise", 1.1, 0.5, 0.5) == np.inf
    assert _judge("promise", 1.0, 0.5, 1.1) == 0.5 and _judge("accurate", 1.0, 0.5, 1.1) == 0.8
    assert _judge("", 0.9, 1.0, 2.0) == pytest.approx(0.95) and _judge("", 0.5, 1.01, 0.9) == np.inf


def test_reversals_count_ways_of_a_stroke_and_more() -> None:
    way = np.sin(np.linspace(0.0, 5.0 * np.pi, 400))
    assert count_reversals(way, 0.01) == 5
    assert count_reversals(way + 1e-3 * np.sin(np.arange(400.0)), 0.01) == 5
    assert count_reversals(np.linspace(0.0, 1.0, 50), 0.01) == 0 and count_reversals(1e-3 * way, 0.01) == 0


@pytest.fixture(scope="module")
def plan() -> Plan:
    cone = {"generator": "isf_cone", "diameter_mm": 200.0, "depth_mm": 20.0, "wall_angle_deg": 60.0,
            "pitch_mm": 20.0, "feed_mm_s": 600.0, "step_mm": 12.0}  # fmt: skip
    push = {"model": "constant", "force_N": [-300.0, 200.0, 400.0], "frame": "path"}
    job = {**CIRCLE, "toolpath": cone, "process": push, "part": {"position_mm": [1750.0, 200.0, 700.0]}}
    return plan_job(check_job(job, "job.toml"))


def test_a_plan_that_is_bettered_is_solved_shorter_and_promises_no_less(plan: Plan) -> None:
    assert plan.status == "solved", plan.explain_failures()
    assert plan.task.start is not None and (found := plan.task.start.bettered) is not None
    assert found.time[1] <= 1.001 * found.time[0] and found.band[1] <= 1.001 * found.band[0]
    assert found.time[1] / found.time[0] + found.band[1] / found.band[0] < 1.95
    assert found.least_time <= found.time[1]
    assert any(note == found.sentence(plan.task.start.pace) for note in plan.notes)
    told = plan.to_dict()
    assert told["posture"]["program"]["time_s"] == {"graph": found.time[0], "program": found.time[1]}
    assert {entry["axis"] for entry in told["reversals"]} == {*plan.robot.joint_names, "spin"}


def test_its_page_and_programs_are_written(plan: Plan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "out")
    assert "widest 95 % band" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8").replace("\u00a0", " ")


def test_its_run_holds_velocity_and_acceleration_at_every_millisecond(plan: Plan) -> None:
    task = plan.task
    runs = cutting_runs(np.r_[False, task.nominal.rapid[1:]], task.rests)
    use = sample_use(plan.q, plan.timing.time, runs, task.velocity_limits, task.acceleration_limits)
    assert use["velocity"] < 1.001 and plan.timing.acceleration_ratio < 1.001
    assert use["acceleration"] < 1.04  # a spline overshoots where acceleration, free of a limit of the jerk, jumps


def test_reversals_are_priced_by_lost_motion_and_lever(plan: Plan) -> None:
    found = {entry.axis: entry for entry in list_reversals(plan.task, plan.q)}
    first = found[plan.robot.joint_names[0]]
    assert first.assumed and first.turns >= 1  # a circle turns the first axis twice
    reach = np.linalg.norm(plan.task.position[:, :2], axis=1)
    assert first.price == pytest.approx(first.lost * np.sqrt((reach**2).mean()), rel=0.05)
    assert "assumed" in describe_reversals(tuple(found.values()))


def test_knowing_more_makes_the_band_of_a_posture_narrower_in_the_program_too(plan: Plan) -> None:
    robot, rows = plan.robot, slice(10, 20)
    q, wrench, force = plan.q[rows], plan.task.wrench[rows], read_force_spread(None)
    known = known_uncertainty(robot)
    surer = replace(robot, uncertainty=replace(known, calibration=0.5 * known.calibration))
    narrow, wide = (lead_radius(each, force, q, wrench)(q, wrench) for each in (surer, robot))
    assert (narrow < 0.9 * wide).all()


def test_the_band_by_what_changes_with_the_posture_is_that_of_everything_that_is_known(plan: Plan) -> None:
    task, force = plan.task, read_force_spread(None)
    rows = np.flatnonzero(task.cut)[::3]
    lead = lead_radius(task.robot, force, task.q_start[rows], task.wrench[rows])
    turned = task.q_start + 0.1 * np.sin(np.arange(len(task)))[:, None]
    for q in (task.q_start, turned):
        whole = band_radius(spread_tip(replace(task, q_start=q), force, rows))
        assert lead(q[rows], task.wrench[rows]) == pytest.approx(whole, rel=0.02)


def test_a_tube_that_is_given_makes_a_wavy_run_shorter_and_its_deviation_is_judged(tmp_path: Path) -> None:
    u = np.linspace(0.0, 1.0, 120)
    rows = [f"{8.0 * np.sin(8.0 * np.pi * k):.6f},{500.0 * (k - 0.5):.6f},0,0,0,1,700" for k in u]
    (tmp_path / "wave.csv").write_text("x_mm,y_mm,z_mm,i,j,k,feed_mm_s\n" + "\n".join(rows) + "\n", encoding="utf-8")
    job = {**CIRCLE, "toolpath": str(tmp_path / "wave.csv"), "plan": {"tolerance_mm": 8.0, "inertia": False},
           "sampling": {"chord_mm": 1.0}, "posture": {"preset": "fast"}, "tolerance": {"tube": 0.8}}  # fmt: skip
    del job["tool"]
    plan = plan_job(check_job(job, "job.toml"))
    assert plan.status == "solved", plan.explain_failures()
    assert plan.task.start is not None and (found := plan.task.start.bettered) is not None
    assert {"left", "up"} <= set(found.names) and found.time[1] < 0.98 * found.time[0]
    assert 0.2e-3 < plan.after.max_deviation <= 6.41e-3
    off = plan.task.position - plan.task.programmed
    assert plan.after.deviation[plan.task.cut] == pytest.approx(off[plan.task.cut], abs=2e-6)
    assert plan.promise is not None and plan.promise.greatest > plan.after.max_deviation


def test_the_shipped_job_on_a_rail_is_solved_with_its_speed_eased_and_a_narrower_band_than_the_graphs_run() -> None:
    plan = plan_job(load_job(Path(__file__).parents[1] / "examples" / "rail" / "circle.toml"))
    assert (plan.status, plan.strategy) == ("solved", "nlp"), plan.explain_failures()
    assert plan.robot.prismatic[0] and plan.task.start is not None
    assert (found := plan.task.start.bettered) is not None
    assert found.time[1] <= found.time[0] and found.band[1] < 0.9 * found.band[0]


def test_an_eased_run_rings_less_and_knows_where(plan: Plan) -> None:
    assert plan.task.start is not None and (pace := plan.task.start.pace) is not None
    assert pace.slower.min() >= 1.0 and pace.slower.max() > 1.0
    assert (np.diff(pace.places) >= 0.0).all() and plan.task.pace.max() == pytest.approx(pace.slower.max(), rel=0.05)
    even = replace(plan.task, start=replace(plan.task.start, pace=None))
    assert time_command(even, plan.task.q_start).time[-1] < time_command(plan.task, plan.task.q_start).time[-1]


def test_a_mirror_strategy_keeps_the_posture_of_the_graph() -> None:
    robot, nominal, options = prepare_job(check_job(CIRCLE, "job.toml"))
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    assert task.start is not None and task.start.bettered is None


def program_of(freedom: Freedom, prices: Prices, chatter: Any = None) -> JointProgram:
    """Return the program of what is free; `chatter` stands for the judge of the cut."""
    start = freedom.task.start
    assert start is not None and start.request is not None
    meter = RunMeter(FeedWish(), read_force_spread(None), lambda _: freedom.task, 0.03)
    ground = state_ground(freedom, replace(start.request, chatter=chatter), meter, prices)
    assert ground is not None
    found = build_program(freedom, ground, prices)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def spin() -> Freedom:
    path = {**CIRCLE["toolpath"], "waypoints": 40}
    return free({**CIRCLE, "toolpath": path})


def test_work_of_the_motors_answers_to_motion_and_speed_as_differences_say(spin: Freedom) -> None:
    program = program_of(spin, Prices(most_band=np.inf, energy=1.0))
    assert program.first is not None
    q, speeds = program.first.q, program.first.speeds
    work, _, ahead, behind = next(program.work(q, speeds))
    assert work.sum() == pytest.approx(program.first.energy) and program.first.energy > 10.0
    step, at = 1e-6, len(speeds[0]) // 2
    moved = [[np.sqrt(speeds[0] ** 2 + side * step * (np.arange(len(speeds[0])) == at))] for side in (1.0, -1.0)]
    more, less = (next(program.work(q, each))[0].sum() for each in moved)
    assert (more - less) / (2 * step) == pytest.approx(ahead[at - 1].sum() + behind[at].sum(), rel=1e-3)


def test_a_price_on_work_makes_the_motors_work_less(spin: Freedom) -> None:
    free_of_it = program_of(spin, Prices(time=1.0, most_band=np.inf))
    priced = program_of(spin, Prices(time=0.0, most_band=np.inf, energy=1.0))
    assert priced.first is not None
    saved, fast = solve_program(priced), solve_program(free_of_it)
    assert saved.energy < 0.97 * priced.first.energy
    assert saved.energy < sum(part.sum() for part, *_ in priced.work(fast.q, fast.speeds))
    assert free_of_it.first is not None and free_of_it.first.energy == 0.0  # not asked for, not worked out


def test_a_post_shapes_the_motion_and_rows_for_it_bring_more_than_refusing_steps(spin: Freedom) -> None:
    post = trimesh.creation.cylinder(0.04, height=0.3).apply_translation([1.827, 0.284, 1.151])
    scene, start = build_scene(spin.task.robot, fixture=post, self_collision=False), spin.task.start
    assert start is not None and start.request is not None
    prices = Prices(time=0.0, most_band=np.inf, energy=1.0)
    request = replace(start.request, scene=scene, wanted=5e-3)
    beside = replace(spin, task=replace(spin.task, start=replace(start, request=request)))
    free_of_it, program, blind = program_of(spin, prices), program_of(beside, prices), program_of(beside, prices)
    assert blind.ground.clear is not None
    no_rows = SimpleNamespace(keeps=blind.ground.clear.keeps, linearise=lambda q, c: (np.zeros(0), c[:0, 0]))
    blind.ground = replace(blind.ground, clear=cast(Any, no_rows))
    loose, kept, refused = (solve_program(each) for each in (free_of_it, program, blind))
    assert measure_margin(scene, loose.q, 5e-3).min() < 0.0 <= measure_margin(scene, kept.q, 5e-3).min()
    assert kept.energy < 0.99 * refused.energy


class FakeChatter:
    """A cut whose depth by its limit rises as one joint turns away from where it starts."""

    source = "made up"

    def __init__(self, q: np.ndarray, joint: int) -> None:
        self.q, self.joint = q, joint

    def touches(self, waypoints: np.ndarray) -> np.ndarray:
        return np.ones(len(waypoints), bool)

    def share(self, q: np.ndarray, waypoints: np.ndarray) -> np.ndarray:
        return np.asarray(0.3 + 2.0 * np.abs(q - self.q[waypoints])[:, self.joint])

    def excess(self, q: np.ndarray, waypoints: np.ndarray, reserve: float) -> np.ndarray:
        return np.maximum(reserve * self.share(q, waypoints) - 1.0, 0.0)


def test_the_program_keeps_the_cut_at_half_of_its_limit_of_chatter(spin: Freedom) -> None:
    prices, judge = Prices(most_band=np.inf), FakeChatter(spin.task.q_start, 5)
    loose, kept = (solve_program(program_of(spin, prices, each)) for each in (None, judge))
    share = [judge.share(point.q, spin.rows).max() for point in (loose, kept)]
    assert share[0] > 0.75 and share[1] < 0.55  # judged at some stations, between them a little more
    assert kept.change.any()


def test_a_first_step_keeps_the_limits_of_a_rail_that_stands() -> None:
    path, part = {**CIRCLE["toolpath"], "waypoints": 40}, {"position_mm": [1590.0, 2000.0, 600.0]}
    slow = {"velocity_scale": 0.3, "acceleration_scale": 0.3}
    job = {**CIRCLE, "robot": "kuka_kr240_rail", "toolpath": path, "part": part, "limits": slow}
    program = program_of(free(job, lead_deg=5.0, lean_deg=5.0, spin_step_deg=60.0), Prices(most_band=np.inf))
    first = program.first
    assert first is not None and np.ptp(first.q[:, 0]) == 0.0
    for size in (0.6, 0.1):
        step = propose_step(program, first, size)
        assert step is not None and np.abs(step[:, -1]).max() > 0.09
        moved = program.evaluate(first.change + step, first.q)
        assert moved is not None and moved.time < first.time - 0.05


def test_ways_below_the_least_move_of_the_controller_are_given_up(rail: Freedom) -> None:
    program = program_of(rail, Prices(most_band=np.inf))
    assert program.first is not None
    change = np.zeros((rail.basis.shape[1], len(rail.names)))
    change[3, rail.names.index("left")] = 1e-2
    change[3, rail.names.index("spin")] = 1e-3
    point = program.evaluate(change, program.first.q)
    assert point is not None
    assert (drop_least(program, point, 1e-9).change == change).all()
    kept = drop_least(program, point, 1e-4).change
    assert not kept[:, rail.names.index("left")].any() and kept[3, rail.names.index("spin")] == 1e-3


def test_windows_cover_a_long_path_half_over_each_other_and_are_few() -> None:
    assert list_windows(8000) == [(0, 7999)]
    for count in (8001, 50_000, 1_000_000):
        windows = list_windows(count)
        assert windows[0][0] == 0 and windows[-1][1] == count - 1 and len(windows) <= 16
        assert all(later[0] < earlier[1] - 3900 for earlier, later in pairwise(windows))


def test_a_path_in_windows_becomes_shorter_and_goes_on_at_their_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    path = {**CIRCLE["toolpath"], "waypoints": 120}
    monkeypatch.setattr(refine, "WINDOW", 60)
    robot, nominal, options = prepare_job(check_job({**CIRCLE, "toolpath": path}, "job.toml"))
    task = build_task(robot, nominal, replace(options, strategy="iterated_mirror"))
    assert task.start is not None and task.start.stance is not None
    first, last = list_windows(len(task))[1]
    found = find_freedom(task, task.start.stance, nominal, np.asarray(options.tool_x), 400, 0.0, (first, last))
    assert found is not None and found.ends == (True, last < len(task) - 1) and found.rows[0] == first
    program = program_of(found, Prices(most_band=np.inf))
    point = solve_program(program)
    assert point.change.any() and program.first is not None and point.time < program.first.time
    moved = found.spread(point.change, np.arange(len(nominal), dtype=float))
    assert np.abs(moved[: int(found.task.origin[first]) + 1]).max() < 1e-9
    bettered = build_task(robot, nominal, options).start
    assert bettered is not None and bettered.bettered is not None and bettered.bettered.origin == "graph"
    assert np.abs(np.diff(bettered.q, axis=0)).max() < 1.2 * np.abs(np.diff(task.q_start, axis=0)).max()
