"""The program of a path: derivatives, rows, exactness, and what is left to look at when it fails."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from compplan.errors import ShapeError
from compplan.plan import nlp as program
from compplan.plan.banded import step_banded
from compplan.plan.nlp import build_nlp, solve_nlp
from compplan.plan.path_problem import PathProblem, ProgramRows, pose_data, smoothness_matrix
from compplan.plan.strategies.equations import differentiate_equations, pose_equations
from compplan.plan.strategies.nlp import find_fast_rows
from compplan.robot import load_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.sensitivity import attain_pose


def make_problem(n=40, name="staubli_tx200", **changes):
    """Build a short arc about a pose of the TX200 with a force that grows."""
    robot = load_robot(name)
    chain = build_chain(robot)
    share = np.linspace(0.0, 1.0, n)
    q = np.radians([0.0, 49.7, 89.3, 5.0, 41.0, 10.0]) + 0.05 * np.sin(np.outer(share, [3, 1, 2, 2, 1, 3]))
    if chain.nq == 7:  # on a rail that goes a little way
        q = np.column_stack([0.1 * share, q])
    frames = locate_frames(chain, q)
    wrench = np.column_stack([300 * share, 200 * share, 1200 * share, 20 * share, 0 * share, 5 * share])
    values = {
        "chain": chain,
        "position": frames.tcp_position,
        "rotation": frames.tcp_rotation,
        "wrench": wrench,
        "compensated": np.ones(n, bool),
        "q_start": q,
        "step_time": np.full(n - 1, 0.1),
        "lower": robot.lower,
        "upper": robot.upper,
        "velocity_limits": robot.velocity_limits,
        "acceleration_limits": robot.acceleration_limits,
    }
    return PathProblem(**(values | changes))


def plain_rows(problem):
    return ProgramRows(np.zeros(problem.q_start.shape, bool))


def solve(problem, rows, passes=2):
    nlp, q = build_nlp(problem, rows), problem.q_start
    for _ in range(passes):
        solution = solve_nlp(nlp, q, attain_pose(problem.chain, q, problem.wrench))
        q = solution.q
    return solution


@pytest.mark.parametrize("spin_free", [True, False])
def test_two_passes_put_the_loaded_tool_on_the_path(spin_free):
    problem = make_problem(spin_free=spin_free)
    solution = solve(problem, plain_rows(problem))
    attained = attain_pose(problem.chain, solution.q, problem.wrench)
    before = attain_pose(problem.chain, problem.q_start, problem.wrench)
    assert solution.success
    assert np.abs(before.position - problem.position).max() > 2e-3
    assert np.abs(attained.position - problem.position).max() < 1e-8
    assert np.abs(attained.rotation[:, :, 2] - problem.rotation[:, :, 2]).max() < 1e-8
    turned = np.abs(attained.rotation[:, :, 0] - problem.rotation[:, :, 0]).max()
    assert turned < 1e-8 if not spin_free else turned > 1e-8


def solve_banded(problem, steps=6):
    q, every = problem.q_start, np.arange(len(problem.q_start))
    for _ in range(steps):
        attained = attain_pose(problem.chain, q, problem.wrench)
        missed, columns = pose_equations(problem, attained, every), differentiate_equations(problem, attained, every)
        q = step_banded(problem, q, missed, columns)
    return q


@pytest.mark.parametrize("keeps_shape", [True, False])
@pytest.mark.parametrize("still", [None, True, False])
def test_banded_steps_come_to_the_answer_of_the_interior_point_solver(keeps_shape, still):
    """Six joints, and seven on a rail that stays or goes: one free direction a waypoint, or two."""
    robot = "staubli_tx200" if still is None else "kuka_kr240_rail"
    nq = 6 if still is None else 7
    stays, weight = np.arange(nq) < bool(still), np.linspace(0.5, 2.0, nq)
    hold = np.linspace(0.01, 0.1, 40)
    problem = make_problem(name=robot, keeps_shape=keeps_shape, still=stays, hold=hold, weight=weight)
    wanted, found = solve(problem, plain_rows(problem), passes=4).q, solve_banded(problem)
    assert np.abs(found - problem.q_start).max() > 1e-4
    assert np.abs(found - wanted).max() < 2e-6
    assert np.array_equal(found[:, stays], problem.q_start[:, stays])


def test_banded_steps_of_two_free_directions_a_waypoint_come_to_the_least():
    """Four equations of six joints: what is left of the objective along what the equations leave free is nothing."""
    problem = make_problem(n=30, hold=np.full(30, 1e-2))
    rng, n, nq = np.random.default_rng(0), 30, 6
    missed, columns = 1e-3 * rng.normal(size=(n, 4)), rng.normal(size=(n, 4, nq))
    q = problem.q_start + 0.01 * rng.normal(size=(n, nq))
    found = step_banded(problem, q, missed, columns)
    assert np.abs(np.einsum("nmj,nj->nm", columns, found - q) + missed).max() < 1e-12
    bend = program.smoothness_matrix(problem)
    pull = bend.T @ (bend @ found) + 1e-2 * (found - problem.q_start)
    free = np.linalg.svd(columns)[2][:, 4:]
    assert np.abs(np.einsum("nfj,nj->nf", free, pull)).max() < 1e-12 < 1e-6 < np.abs(pull).max()


def test_derivative_of_the_pose_equations_agrees_with_finite_differences():
    problem = make_problem(spin_free=False)
    residual = program._pose_residual(problem)
    derivative = program._differentiate(residual)
    attained = attain_pose(problem.chain, problem.q_start, problem.wrench)
    q, data = problem.q_start[-1] + 0.01, pose_data(problem, problem.q_start, attained)[-1]
    exact = np.array(derivative(q, data))
    for j, unit in enumerate(np.eye(6)):
        ahead, behind = (np.array(residual(q + s * 1e-6 * unit, data))[:, 0] for s in (1, -1))
        assert np.allclose(exact[:, j], (ahead - behind) / 2e-6, atol=1e-8)


def test_pose_equations_carry_value_and_slope_of_the_exact_loaded_pose():
    problem = make_problem(spin_free=False)
    residual, derivative = program._pose_residual(problem), program._differentiate(program._pose_residual(problem))
    q = problem.q_start
    data = pose_data(problem, q, attain_pose(problem.chain, q, problem.wrench))[-1]
    step, slope = 1e-5, np.array(derivative(q[-1], data))
    for j, unit in enumerate(np.eye(6)):
        sides = [attain_pose(problem.chain, q[-1:] + s * step * unit, problem.wrench[-1:]) for s in (1, -1)]
        change = (sides[0].position - sides[1].position)[0] / (2 * step)
        assert np.allclose(slope[:3, j], change, atol=1e-7)
    here = attain_pose(problem.chain, q[-1:], problem.wrench[-1:]).position[0] - problem.position[-1]
    assert np.allclose(np.array(residual(q[-1], data))[:3, 0], here, atol=1e-12)


def test_derivative_of_all_constraints_agrees_with_casadi():
    problem = make_problem(n=8, max_correction=0.004)
    rows = ProgramRows(
        np.zeros((8, 6), bool), limited=np.array([2, 3]), released=np.array([5]),
        velocity=np.array([[1, 0], [2, 5]]), acceleration=np.array([[3, 2]]),
    )  # fmt: skip
    nlp = build_nlp(problem, rows)
    assert nlp.extra == 5 + 3
    rng = np.random.default_rng(0)
    x = rng.normal(scale=0.1, size=nlp.constraints.size1_in(0))
    attained = attain_pose(problem.chain, problem.q_start, problem.wrench)
    p = np.r_[pose_data(problem, problem.q_start, attained).ravel(), problem.q_start.ravel(), 0.004]
    ours = nlp.solver.get_function("nlp_jac_g")(x, p)[1]
    theirs = nlp.constraints.jacobian()(x, p, 0)[0]
    assert float(ca.norm_inf(ca.vec(ours - theirs))) < 1e-12


def test_smoothness_does_not_cost_a_steady_motion_at_uneven_times():
    rng = np.random.default_rng(0)
    problem = replace(make_problem(n=30), step_time=rng.uniform(0.05, 0.2, 29))
    matrix, time = program.smoothness_matrix(problem), np.r_[0.0, np.cumsum(problem.step_time)]
    assert np.abs(matrix @ (3.0 + 2.0 * time)).max() < 1e-12
    assert np.abs(matrix @ time**2).min() > 1e-3


def test_rate_rows_are_velocities_and_accelerations():
    problem = make_problem(n=10)
    rows = replace(plain_rows(problem), velocity=np.array([[4, 2]]), acceleration=np.array([[5, 1]]))
    matrix, bound = program.rate_matrix(problem, rows)
    q = problem.q_start
    velocity = np.diff(q, axis=0) / 0.1
    change = matrix @ q.ravel()
    assert change == pytest.approx([q[5, 2] - q[4, 2], velocity[5, 1] - velocity[4, 1]])
    assert bound == pytest.approx([0.1 * problem.velocity_limits[2], 0.1 * problem.acceleration_limits[1]])


UNEVEN = np.array([0.5, 1.0, 3.0, 1.0, 0.25, 2.0, 0.5, 0.75, 1.5, 1.0, 2.5, 0.5, 1.0, 1.25, 0.5])


def test_rate_rows_of_a_parabola_use_the_same_share_of_their_limits_whatever_the_steps():
    # q = t^2 / 2 changes its speed by 1 rad/s every second, also between the middles of unequal steps
    time = np.r_[0.0, np.cumsum(UNEVEN)]
    problem = replace(make_problem(n=16), step_time=UNEVEN, acceleration_limits=np.full(6, 4.0))
    rows = replace(plain_rows(problem), acceleration=np.array([[k, 1] for k in range(1, 15)]))
    matrix, bound = program.rate_matrix(problem, rows)
    q = np.zeros((16, 6))
    q[:, 1] = 0.5 * time**2
    assert (matrix @ q.ravel()) / bound == pytest.approx(np.full(14, 0.25))


def test_fast_rows_are_found_by_the_speed_of_each_step_and_its_change_between_middles_of_steps():
    steps = np.array([1.0, 0.75, 1.25, 1.0, 1.0, 0.75, 1.0, 0.75, 1.5, 1.0, 1.25, 0.75, 1.0, 1.25, 1.0])
    time = np.r_[0.0, np.cumsum(steps)]
    q = np.zeros((16, 6))
    q[:, 2] = 0.1 * time + 0.9 * np.maximum(time - time[8], 0.0)  # 0.1 rad/s, and 1 rad/s after waypoint 8
    problem = replace(make_problem(n=16), step_time=steps, velocity_limits=np.full(6, 1.01))
    # waypoint 8 stands between steps of 0.75 s and 1.5 s: 0.9 rad/s in 1.125 s are 0.8 rad/s^2
    none, hard = find_fast_rows(replace(problem, acceleration_limits=np.full(6, 0.79)), q)
    assert len(none) == 0 and hard.tolist() == [[k, 2] for k in range(3, 14)]  # and five neighbours on either side
    assert not len(find_fast_rows(replace(problem, acceleration_limits=np.full(6, 0.81)), q)[1])
    slow = replace(problem, velocity_limits=np.full(6, 0.99), acceleration_limits=np.full(6, 9.0))
    assert find_fast_rows(slow, q)[0].tolist() == [[k, 2] for k in range(3, 15)]  # steps from waypoint 8 on
    steps[7] = 0.4  # less than half of the median step: it stands beside a rest, where the feed drops anyway
    assert not len(find_fast_rows(replace(problem, step_time=steps, acceleration_limits=np.full(6, 0.79)), q)[1])


def test_bounds_in_the_program_are_hard():
    free = solve(make_problem(), plain_rows(make_problem()))
    top = float(free.q[:, 5].max())
    problem = make_problem(upper=np.r_[np.full(5, 10.0), top - 0.01])
    bounded = solve(problem, ProgramRows(np.ones((40, 6), bool)))
    assert bounded.success
    assert bounded.q[:, 5].max() <= top - 0.01
    attained = attain_pose(problem.chain, bounded.q, problem.wrench)
    assert np.abs(attained.position - problem.position).max() < 1e-8


def test_a_failed_solve_can_be_looked_at():
    problem = make_problem(spin_free=False, upper=np.r_[np.full(4, 10.0), 0.70, 10.0])
    nlp = build_nlp(problem, ProgramRows(np.ones((40, 6), bool)))
    solution = solve_nlp(nlp, problem.q_start, attain_pose(problem.chain, problem.q_start, problem.wrench))
    assert not solution.success
    assert solution.status != "Solve_Succeeded"
    assert solution.violation > 1e-4
    assert nlp.solver.stats()["return_status"] == solution.status
    assert solution.q[:, 4].max() <= 0.70


def test_a_problem_of_wrong_shape_is_refused():
    with pytest.raises(ShapeError, match=r"wrench has shape \(3, 6\), expected \(40, 6\)"):
        make_problem(wrench=np.zeros((3, 6)))


def test_smoothness_of_unequal_steps_is_the_second_difference_worked_out_by_hand():
    # steps of 1 s, 2 s and 1 s about the median 1 s; q = 1, 4, 2, 7
    #   waypoint 1: slopes 3 and -1 over mean step 1.5:  -4 / 1.5 = -8/3, weighed with sqrt(1.5)
    #   waypoint 2: slopes -1 and 5 over mean step 1.5:   6 / 1.5 =  4,   weighed with sqrt(1.5)
    problem = replace(make_problem(n=4), step_time=np.array([1.0, 2.0, 1.0]))
    bent = smoothness_matrix(problem) @ np.array([1.0, 4.0, 2.0, 7.0])
    assert bent == pytest.approx(np.sqrt(1.5) * np.array([-8 / 3, 4.0]))


def test_smoothness_of_a_parabola_is_its_time_whatever_the_steps():
    # q = t^2 / 2 bends by 1 everywhere, so the objective is the time between the first and the last mean step
    steps = np.array([0.5, 1.0, 3.0, 1.0, 0.25])
    problem, time = replace(make_problem(n=6), step_time=steps), np.r_[0.0, np.cumsum(steps)]
    bent = smoothness_matrix(problem) @ (0.5 * time**2)
    assert bent**2 == pytest.approx(0.5 * (steps[1:] + steps[:-1]))
