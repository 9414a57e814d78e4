from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from montecarlo_cases import cone_study, cone_task, noise_free_robots
from scipy.special import ndtr

from compplan.effects import solve_model_poses
from compplan.effects.forward_model import own_springs
from compplan.errors import ConvergenceError, InputError
from compplan.job.job import check_job
from compplan.job.noise import NoiseTable
from compplan.planning.plan import build_task, prepare_job
from compplan.planning.posture.settings import PostureSettings
from compplan.robot import load_robot
from compplan.robot.uncertainty import Uncertainty, Unknown
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.statics.chain import build_chain
from compplan.statics.elastic import solve_equilibrium
from compplan.studies import study as judging
from compplan.studies.kernel import build_kernel, solve_tips
from compplan.studies.posterior import count_coordinates
from compplan.studies.sampling import draw_points, sample_robots
from compplan.studies.study import Study, prepare_study, run_strategy
from compplan.studies.summary import _describe_draws
from compplan.uncertainty.assumed import robot_uncertainty
from compplan.uncertainty.band import linearise_path, split_covariance
from compplan.uncertainty.sensitivities import ForceSpread, apply_wrench_to_model, build_path_model, vary_model

RNG = np.random.default_rng(11)
JOB = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 80.0, "feed_mm_s": 20.0, "waypoints": 24},
    "part": {"position_mm": [1800.0, 0.0, 800.0], "touched_off": False},
    "process": {"model": "constant", "force_N": [300.0, 200.0, 500.0]},
    "plan": {"rotate_about_tool_axis": False},
}
#: Nothing but the robot is uncertain.
REST = {
    "part_frame_mm": 0.0, "part_frame_deg": 0.0, "temperature_K": 0.0, "wrench_level": 0.0, "wrench_path": 0.0,
    "wrench_direction_deg": 0.0,
}  # fmt: skip


@pytest.mark.parametrize("name", ["staubli_tx200", "kuka_kr120_r3900", "kuka_kr240_rail", "ur10"])
def test_the_kernel_agrees_with_the_pinocchio_judge_to_a_nanometre(name: str) -> None:
    robot = load_robot(name)
    chain = build_chain(robot)
    span = np.clip(np.c_[robot.lower, robot.upper], -2.0, 2.0)
    q = RNG.uniform(span[:, 0], span[:, 1], (40, robot.nq))
    level = 100.0 if name == "ur10" else 800.0
    wrench = RNG.normal(size=(40, 6)) * level * np.array([1, 1, 1, 0.1, 0.1, 0.1])
    start = np.zeros((chain.n_springs, 40))
    tips = solve_tips(build_kernel(chain), q.T, wrench.T, np.ones_like(start), start)
    evaluated, _, _ = solve_exact_pose(build_exact_robot(robot), q, wrench)
    assert np.abs(tips.T - evaluated).max() < 1e-9


def test_a_load_beyond_buckling_is_refused() -> None:
    task = cone_task()
    n = 4
    start = np.zeros((task.chain.n_springs, n))
    wrench = np.tile([0, 0, -4e6, 0, 0, 0.0], (n, 1)).T
    with pytest.raises(ConvergenceError, match="buckling"):
        solve_tips(build_kernel(task.chain), task.q_start[:n].T, wrench, np.ones_like(start), start)


def test_in_a_cell_without_faults_every_exact_strategy_leaves_nothing() -> None:
    study = cone_study()
    robots = noise_free_robots(study, np.ones(1), np.ones(1))
    left = {name: np.linalg.norm(run_strategy(study, name, robots), axis=0)[0, study.cut] for name in study.strategies}
    for name in ("iterated_mirror", "nlp", "force_sensor"):
        assert left[name].max() < 5e-8, name
    assert left["mirror"].max() < 0.05 * left["none"].max()  # of the second order


def test_a_sensor_strategy_answers_as_exactly_as_its_solved_equation() -> None:
    """First order around the expected wrench against the exact solution for another wrench: below 2 um at 20 % more."""
    from compplan.planning.strategies import iterated_mirror

    study, task = cone_study(), cone_study().task
    robots = noise_free_robots(study, np.ones(1), np.array([1.2]))
    deviation = run_strategy(study, "force_sensor", robots)[:, 0, study.cut]
    exact = iterated_mirror.command_path(replace(task, wrench=1.2 * task.wrench)).q
    reached = solve_equilibrium(task.chain, exact, 1.2 * task.wrench).position - task.position
    assert np.abs(reached[study.cut]).max() < 1e-8
    assert np.linalg.norm(deviation, axis=0).max() < 2e-6


def spread(values: np.ndarray) -> float:
    """Root mean square: the standard deviation of what has none but zero for a mean."""
    return float(np.sqrt(np.mean(np.square(values))))


def test_every_key_of_the_noise_spreads_what_it_names_by_its_own_size() -> None:
    noise = NoiseTable(
        link_share=0.05, part_frame_mm=0.6, part_frame_deg=0.07, wrench_level=0.1, wrench_direction_deg=2.0,
        wrench_path=0.0, temperature_K=5.0, force_noise_N=40.0,
    )  # fmt: skip
    study = prepare_study(cone_task(), noise, ["none"], most_waypoints=12)
    origin = cone_task().part_origin
    assert origin is not None
    at, lever = study.context, np.linalg.norm((study.nominal - origin[:, None])[:2], axis=0)
    robots, degree, mm = sample_robots(at, draw_points(at.factors, 5, 1, range(400))), np.pi / 180, 1e-3
    rest, unsure = robots.causes, at.link_share > 0.0
    wanted = {
        "link share": (spread((robots.link_share - at.link_share[:, None])[unsure]), 0.05),
        "growth": (spread(rest[0]), 5.0 * 1.2e-5),
        "part, place": (spread(rest[1:4]) * at.shift[1, 0, 0], 0.6 * mm),
        "part, turn": (spread(rest[6]) * spread(np.linalg.norm(at.shift[6], axis=0) / lever), 0.07 * degree),
        "motor": (spread(np.array(robots.motor)), 0.0003 * degree),
        "link": (spread(np.array(robots.link)), 0.0008 * degree),
        "force": (spread(robots.force[:3]), np.hypot(40.0, 100.0)),  # the gain adds little
        "moment": (spread(robots.force[3:]), np.hypot(2.0, 10.0)),
    }
    for name, (found, size) in wanted.items():
        assert found == pytest.approx(size, rel=0.05), name
    most = int(np.linalg.norm(at.wrench[:3], axis=0).argmax())
    force, drawn = at.wrench[:3, most], robots.wrench[:3, :, most].T
    length = np.linalg.norm(force)
    assert spread(np.linalg.norm(drawn, axis=1) / length - 1.0) == pytest.approx(0.1, rel=0.05)
    across = np.cross(force / length, drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
    assert spread(np.linalg.norm(across, axis=1)) == pytest.approx(np.sqrt(2.0) * 2.0 * degree, rel=0.05)


def test_a_force_learned_from_parts_counts_in_samples_also_where_the_robot_was_not_learned() -> None:
    """Level to 4 %, in place of the 15 % that [noise] assumes."""
    learned = ForceSpread(0.04, 0.01, 0.0, "process.toml: 1 measured part")
    study = prepare_study(cone_task(), NoiseTable(), ["none"], most_waypoints=12, force=learned)
    at = study.context
    size = np.linalg.norm(sample_robots(at, draw_points(at.factors, 5, 1, range(400))).wrench[:3], axis=0)
    most = np.linalg.norm(at.wrench[:3], axis=0).max()
    assert spread(size.max(axis=1) / most - 1.0) == pytest.approx(0.04, rel=0.05)


@pytest.fixture(scope="module")
def study() -> Study:
    robot, nominal, options = prepare_job(check_job({**JOB, "noise": REST}, "job.toml"))
    task = build_task(robot, nominal, replace(options, posture=PostureSettings(search=False)))
    noise = NoiseTable(**REST)
    return prepare_study(task, noise, ["none"])


def tips(study: Study, z: np.ndarray) -> np.ndarray:
    """Return the tips of robots at coordinates z (b, r), everything else at its mean. Shape (b, n, 3). [m]"""
    columns = study.context.factors.columns
    points = np.full((len(z), len(study.context.factors.groups)), 0.5)
    points[:, columns["posterior"]] = ndtr(z)
    return np.moveaxis(run_strategy(study, "none", sample_robots(study.context, points)), 0, -1)


def test_a_drawn_robot_moves_the_tip_as_the_exact_equilibrium_of_its_parameters_does(study: Study) -> None:
    """Compliances, zeros, lost motion, gear waves, geometry and tool at once, drawn to one standard deviation."""
    task, known = study.task, robot_uncertainty(study.task.robot)
    z = np.random.default_rng(2).standard_normal((3, count_coordinates(task.robot)))
    z[:, known.factor.shape[1] :] = 0.0
    moved = tips(study, z) - tips(study, np.zeros((1, z.shape[1])))
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    rest = solve_model_poses(scene).position
    for seen, one in zip(moved, z, strict=True):
        values = known.spread @ one[: known.factor.shape[1]]
        exact = solve_model_poses(vary_model(scene, known.unknowns, values)).position - rest
        # a joint that has not moved yet is off by half its lost motion one way or the other: from the first turn on
        size = np.linalg.norm(exact, axis=1).max()
        assert np.linalg.norm((seen - exact)[12:], axis=1).max() < 0.05 * size


def test_a_joint_that_was_found_rigid_is_drawn_as_soft_as_its_deviation(monkeypatch: pytest.MonkeyPatch) -> None:
    """A diagnosed folder holds a spring of no compliance, of which a deviation is known."""
    monkeypatch.setattr("compplan.studies.sampling.ENCODERS", (0.0, 0.0))
    robot, nominal, options = prepare_job(check_job({**JOB}, "job.toml"))
    own = own_springs(robot)[1]
    springs = list(robot.springs)
    springs[own.spring] = replace(springs[own.spring], compliance=-0.0)
    soft = Unknown("joint_stiffness", "joint_2", None, ("compliance_change_rad_per_Nm",), np.array([1e-8]))
    robot = replace(robot, springs=tuple(springs), uncertainty=Uncertainty("measured", "test", (soft,), np.eye(1)))
    task = build_task(robot, nominal, replace(options, posture=PostureSettings(search=False)))
    study = prepare_study(task, NoiseTable(**REST), ["none"])
    z = np.zeros((2, count_coordinates(robot)))
    z[1, 0] = 1.0
    rest, moved = tips(study, z)
    scene = build_path_model(robot, task.q_start, task.wrench, task.step_time)
    exact = solve_model_poses(vary_model(scene, (soft,), np.array([1e-8]))).position - solve_model_poses(scene).position
    assert np.allclose(moved - rest, exact, atol=1e-7)


def test_a_force_that_was_taught_with_the_robot_goes_with_it_in_samples_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A softer joint 2 under less force: samples stand where the exact equilibrium of both has them."""
    monkeypatch.setattr("compplan.studies.sampling.ENCODERS", (0.0, 0.0))
    robot, nominal, options = prepare_job(check_job({**JOB}, "job.toml"))
    spring = 0.2 * own_springs(robot)[1].compliance
    soft = Unknown("joint_stiffness", "joint_2", None, ("compliance_change_rad_per_Nm",), np.array([spring]))
    tool = Unknown("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.zeros(3))
    known = Uncertainty("measured", "test", (soft, tool), np.eye(4))
    together = np.zeros((4, 4))
    together[0, 0] = -0.9 * 0.1 * spring
    force = ForceSpread(0.1, 0.02, 0.0, "process.toml: one part", 0.0, together)
    options = replace(options, posture=PostureSettings(search=False))
    task = build_task(replace(robot, uncertainty=known), nominal, options)
    rest = {key: value for key, value in REST.items() if key not in ("wrench_level", "wrench_direction_deg")}
    study = prepare_study(task, NoiseTable(**rest), ["none"], force=force)
    columns = study.context.factors.columns
    points = np.full((3, len(study.context.factors.groups)), 0.5)
    points[1:, columns["posterior"].start] = ndtr(1.5)  # one deviation and a half softer
    points[2:, columns["wrench_level"]] = ndtr(1.0)
    seen = np.moveaxis(run_strategy(study, "none", sample_robots(study.context, points)), 0, -1)
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    alone = np.sqrt(1.0 - 0.9**2)
    for row, (softer, level) in enumerate([(0.0, 0.0), (1.5, -0.9 * 1.5), (1.5, -0.9 * 1.5 + alone)]):
        pushed = apply_wrench_to_model(scene, np.array([level, 0.0, 0.0, 0.0]), force)
        exact = solve_model_poses(vary_model(pushed, [soft], np.array([softer * spring]))).position - task.position
        assert seen[row] == pytest.approx(exact, abs=2e-6)
    assert any("(10%, 1.1 deg) go with the robot: process.toml" in words for words in _describe_draws(study))


@pytest.mark.parametrize("key", ["robot", "joint_compliance", "geometry_mm", "backlash_deg", "repeatability_mm"])
def test_a_spread_of_the_robot_in_the_job_is_refused_in_one_line(key: str) -> None:
    value = "posterior" if key == "robot" else 0.1
    with pytest.raises(InputError, match=f"noise.{key} is no longer supported; robots are drawn from the robot folder"):
        check_job({**JOB, "noise": {key: value}}, "job.toml")


def test_joints_that_are_held_at_the_link_feel_no_drive_and_no_motor_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    """q = command + zero + g (drive - motor's encoder) - (1 - g) link's encoder; g is 1 at the motor, 0 at the link."""
    one = np.ones((2, 1, 3))
    command = SimpleNamespace(
        spring_gain=np.array([1.0, 0.0]), spring_factor=np.ones(1), theta=np.zeros((1, 3)), placements=None,
        offset=np.zeros((3, 3)),
    )  # fmt: skip
    robots = SimpleNamespace(
        zero=np.array([[0.1], [0.2]]), drive=5.0 * one, motor=2.0 * one, link=0.5 * one, factor=np.ones((1, 1)),
        link_share=np.zeros((1, 1)),
        shift=np.zeros((3, 1, 3)), repeat=np.zeros((3, 1)), wrench=np.zeros((6, 1, 3)),
    )  # fmt: skip
    asked = []
    monkeypatch.setattr(judging, "solve_tips", lambda kernel, q, *rest: asked.append(q) or np.zeros((3, 3)))
    study = SimpleNamespace(kernel=None, nominal=np.zeros((3, 3)), touch=None)
    judging._cut_part(study, command, robots, np.zeros((2, 1, 3)))  # type: ignore[arg-type]
    assert asked[0][:, 0] == pytest.approx([0.1 + 5.0 - 2.0, 0.2 - 0.5])


def test_a_touched_part_follows_gears_and_unexplained_errors_as_in_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("compplan.studies.sampling.ENCODERS", (0.0, 0.0))
    part = {**JOB["part"], "touched_off": True}  # type: ignore[dict-item]
    robot, nominal, options = prepare_job(check_job({**JOB, "part": part}, "job.toml"))
    keys, waves = ("sine_rad#0", "cosine_rad#0"), {"cycles_per_turn": [3.0]}
    gear = Unknown("transmission_error", "joint_1", None, keys, np.full(2, 2e-4), waves)
    tool = Unknown("tool_frame", None, None, ("tx_m", "ty_m", "tz_m"), np.zeros(3))
    known = Uncertainty("measured", "test", (gear, tool), np.eye(5), unexplained=3e-4, scale=0.3, repeatability=0.0)
    options = replace(options, posture=PostureSettings(search=False))
    task = build_task(replace(robot, uncertainty=known), nominal, options)
    study = prepare_study(task, NoiseTable(**REST), ["none"])
    z = np.random.default_rng(3).standard_normal((800, count_coordinates(task.robot)))
    seen = tips(study, z) - tips(study, np.zeros((1, z.shape[1])))
    scene = build_path_model(task.robot, task.q_start, task.wrench, task.step_time)
    slopes = linearise_path(scene, known, ForceSpread(0.0, 0.0, 0.0, "test"), task.cut, touched=task.touched)
    parts = split_covariance(slopes, known)
    wanted = np.sqrt(np.trace(parts["model"] + parts["unexplained"], axis1=1, axis2=2))
    assert np.sqrt(np.mean(np.sum(seen**2, axis=2), axis=0))[slopes.rows] == pytest.approx(wanted, rel=0.1)
