"""The program of a path: its loaded pose and derivatives, exactness, bounds, and what is left of a failed solve."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from compplan.planning.dense import pick_stations, solve_path, state_problem
from compplan.planning.limits.torque import read_torques
from compplan.planning.nlp import build_nlp, explain_conflict, solve_problem
from compplan.planning.strategies import command_path
from compplan.planning.task import attain_rows
from compplan.robot import load_robot
from compplan.simulation.torque import TorqueRules
from compplan.statics.chain import build_chain
from compplan.statics.kinematics import build_loaded_function
from compplan.statics.stiffness import attain_pose
from tests.planning.test_strategies import make_path, make_task


def make_problem(task, **changes):
    stations = pick_stations(task, 40)
    return replace(state_problem(task, stations, task.q_start, task.missed), **changes)


@pytest.mark.parametrize("name", ["staubli_tx200", "kuka_kr270_full", "kuka_kr240_rail", "ur10e", "franka_fr3"])
def test_the_loaded_pose_and_its_derivative_are_those_of_the_exact_equilibrium(name):
    robot = load_robot(name)
    chain, rng = build_chain(robot), np.random.default_rng(0)
    loaded = build_loaded_function(chain, 4)
    slope = ca.Function("slope", loaded.sx_in(), [ca.jacobian(loaded(*loaded.sx_in())[0], loaded.sx_in(0))])
    for _ in range(5):
        q = rng.uniform(np.maximum(robot.lower, -1.0), np.minimum(robot.upper, 1.0))
        wrench, bias = rng.normal(scale=[100.0] * 3 + [5.0] * 3), rng.normal(size=chain.n_springs)
        numbers = (q, wrench, bias, np.zeros(chain.n_springs), 1.0)
        exact = attain_pose(chain, q[None], wrench[None], torque_bias=bias[None])
        position, rotation, theta = (np.array(each) for each in loaded(*numbers))
        assert np.abs(position[:, 0] - exact.position[0]).max() < 1e-9
        assert np.abs(rotation - exact.rotation[0]).max() < 1e-9
        assert np.abs(theta[:, 0] - exact.theta[0]).max() < 1e-9
        assert np.abs(np.array(slope(*numbers)) - exact.jacobian[0, :3]).max() < 1e-7
    assert np.abs(np.array(loaded(q, wrench, bias, np.zeros(chain.n_springs), 0.0)[2])).max() == 0.0


@pytest.mark.parametrize("spin_free", [True, False])
def test_one_solve_puts_the_loaded_tool_on_the_path(spin_free):
    task = make_task(spin_free=spin_free)
    problem = make_problem(task)
    solution = solve_problem(problem)
    assert solution.success and solution.iterations >= 1
    q = task.q_start.copy()
    q[problem.waypoint] = solution.q
    attained = attain_rows(task, q, problem.waypoint)
    assert np.abs(attained.position - problem.position).max() < 1e-8
    assert np.abs(attained.rotation[:, :, 2] - problem.rotation[:, :, 2]).max() < 1e-8
    turned = np.abs(attained.rotation[:, :, 0] - problem.rotation[:, :, 0]).max()
    assert turned < 1e-8 if not spin_free else turned > 1e-8


@pytest.mark.parametrize("spin_free", [True, False])
def test_the_command_is_the_solution_of_the_program_at_its_stations(spin_free):
    task = make_task(spin_free=spin_free, path=make_path(400))
    found = solve_path(task)
    problem = found.stations.problem
    assert len(problem) < len(task)
    assert np.abs(found.q[problem.waypoint] - found.stations.q).max() < 1e-6
    command = command_path(task, "nlp")
    assert np.array_equal(command.q, found.q)
    told = command.nlp
    assert told["solver"] == "ipopt" and told["status"] == "Solve_Succeeded" and told["stations"] == len(problem)
    every = attain_rows(task, found.q, np.arange(len(task)))
    assert np.abs(every.position - task.position).max() < 1e-9


def test_the_derivatives_of_the_program_agree_with_finite_differences():
    problem = make_problem(make_task(spin_free=True, max_correction=0.004))
    program = build_nlp(problem)
    jacobian, constraints = program.solver.get_function("nlp_jac_g"), program.solver.get_function("nlp_g")
    from compplan.planning.nlp import _pack

    x, p = problem.q_start.ravel() + 0.01, _pack(problem).ravel()
    exact, small = np.array(jacobian(x, p)[1]), 1e-6
    for column in (0, 3, 7, 100):
        unit = small * (np.arange(len(x)) == column)
        change = (np.array(constraints(x + unit, p)) - np.array(constraints(x - unit, p)))[:, 0] / (2.0 * small)
        assert np.allclose(exact[:, column], change, atol=1e-7)


def test_bounds_in_the_program_are_hard():
    task = make_task(spin_free=True)
    free = solve_problem(make_problem(task))
    top = float(free.q[:, 5].max())
    problem = make_problem(task, upper=np.where(np.arange(6) == 5, top - 0.01, free.problem.upper))
    bounded = solve_problem(problem)
    assert bounded.success and bounded.q[:, 5].max() <= top - 0.01
    assert bounded.active["joint_range"].any() and not free.active["joint_range"].any()


def test_a_failed_solve_says_which_limits_conflict_and_where():
    task = make_task(spin_free=False)
    free = solve_problem(make_problem(task))
    station = int(free.q[:, 4].argmax())
    problem = make_problem(task, upper=np.where(np.arange(6) == 4, free.q[station, 4] - 0.05, free.problem.upper))
    solution = solve_problem(problem)
    assert not solution.success and solution.status != "Solve_Succeeded" and solution.violation > 1e-6
    said = explain_conflict(solution)
    assert "pose" in said and "waypoint" in said and solution.status in said


def test_a_problem_prints_as_it_is_minimised():
    text = str(make_problem(make_task(spin_free=True)))
    assert text.startswith("minimise    sum w (q - q_start)^2")
    assert "p(q, theta) = p_wanted" in text and "q_min <= q <= q_max" in text and "10 mm" in text


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr240_rail"])
def test_torques_of_the_program_are_those_of_the_inverse_dynamics(name):
    robot, rng = load_robot(name), np.random.default_rng(3)
    q = np.clip(rng.uniform(-0.8, 0.8, (5, robot.nq)), robot.lower, robot.upper)
    rate, change, wrench = (
        rng.normal(size=(5, robot.nq)),
        rng.normal(size=(5, robot.nq)),
        rng.normal(size=(5, 6)) * 300.0,
    )
    square, half_rate = rng.uniform(0.1, 1.0, 5), rng.normal(size=5)
    limit = read_torques(SimpleNamespace(robot=robot, q_start=q, wrench=wrench))
    sizes = {"q": robot.nq, "rate": robot.nq, "change": robot.nq, "square": 1, "half_rate": 1, "wrench": 6}
    symbols = {key: ca.SX.sym(key, size) for key, size in sizes.items()}
    rows = ca.Function("rows", list(symbols.values()), [limit.rows(SimpleNamespace(**symbols))]).map(5)
    found = np.array(rows(q.T, rate.T, change.T, square[None], half_rate[None], wrench.T)).T
    a, b, held, most = TorqueRules(robot, q, wrench).rows(0, 4, rate, change)
    assert limit.most == pytest.approx(most)
    assert found * most == pytest.approx(
        a * half_rate[:, None] + b * square[:, None] + held, rel=1e-6, abs=1e-6 * abs(held).max()
    )
