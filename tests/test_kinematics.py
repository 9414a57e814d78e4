"""The CasADi kinematics against Pinocchio, and their derivatives against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from robot_library import over_robots

from compplan.cell.judge import build_judge, judge_pose
from compplan.errors import ConvergenceError
from compplan.robot import load_robot
from compplan.statics.chain import build_chain
from compplan.statics.kinematics import build_loaded_pose_function, build_pose_function, count_equilibrium_steps
from compplan.statics.sensitivity import attain_pose


def random_poses(robot, n, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (n, robot.nq))
    return q, rng.normal(size=(n, 6)) * [700.0, 700.0, 1000.0, 60.0, 60.0, 60.0]


def run(function, n, *arguments):
    return [np.array(part).T for part in function.map(n)(*(a.T for a in arguments))]


@pytest.mark.parametrize("name", over_robots())
def test_casadi_kinematics_agree_with_pinocchio_deflections_included(name):
    robot = load_robot(name)
    chain, (q, wrench) = build_chain(robot), random_poses(robot, 100, 3)
    steps = count_equilibrium_steps(chain, q, wrench)
    position, rotation, theta = run(build_loaded_pose_function(chain, steps), 100, q, wrench)
    judged_position, judged_rotation, judged_theta = judge_pose(build_judge(robot), q, wrench)
    assert np.abs(position - judged_position).max() < 1e-10
    columns = rotation.reshape(100, 3, 3)  # three columns of the matrix side by side, transposed
    assert np.abs(columns - judged_rotation.transpose(0, 2, 1)).max() < 1e-10
    assert np.abs(theta - judged_theta).max(initial=0.0) < 1e-10


@pytest.mark.parametrize("name", ["kuka_kr270_full", "staubli_tx200"])
def test_gravity_of_links_bends_the_casadi_kinematics_as_it_bends_pinocchio(name):
    robot = replace(load_robot(name), gravity=np.array([0.0, 0.0, -9.81]))
    chain, (q, wrench) = build_chain(robot), random_poses(robot, 20, 4)
    steps = count_equilibrium_steps(chain, q, wrench)
    position, _, _ = run(build_loaded_pose_function(chain, steps), 20, q, wrench)
    assert np.abs(position - judge_pose(build_judge(robot), q, wrench)[0]).max() < 1e-10
    weightless = judge_pose(build_judge(replace(robot, gravity=None)), q, wrench)[0]
    assert np.abs(position - weightless).max() > 1e-4


def test_unloaded_pose_is_the_loaded_pose_without_load():
    chain = build_chain(load_robot("kuka_kr270"))
    q = np.array([0.1, 0.3, -0.4, 0.5, 0.6, 0.7])
    position, _ = build_pose_function(chain)(q)
    loaded, _, theta = build_loaded_pose_function(chain, 3)(q, np.zeros(6))
    assert np.array_equal(np.array(position), np.array(loaded))
    assert np.abs(np.array(theta)).max() == 0.0


@pytest.mark.parametrize("name", ["staubli_tx200", "kuka_kr240_rail"])
def test_derivatives_of_the_loaded_pose_agree_with_finite_differences(name):
    robot = load_robot(name)
    chain, (q, wrench) = build_chain(robot), random_poses(robot, 1, 5)
    function = build_loaded_pose_function(chain, count_equilibrium_steps(chain, q, wrench))
    derivative = np.array(function.jacobian()(q[0], wrench[0], 0, 0, 0)[0])
    step = 1e-6
    for j, unit in enumerate(np.eye(chain.nq)):
        ahead, behind = (np.array(function(q[0] + s * step * unit, wrench[0])[0])[:, 0] for s in (1, -1))
        assert np.allclose(derivative[:, j], (ahead - behind) / (2 * step), atol=1e-8)


@pytest.mark.parametrize("gravity", [None, np.array([0.0, 0.0, -9.81])])
@pytest.mark.parametrize("name", ["staubli_tx200", "kuka_kr270_full", "kuka_kr240_rail"])
def test_loaded_jacobian_agrees_with_finite_differences_of_the_judge(name, gravity):
    robot = replace(load_robot(name), gravity=gravity)
    chain, (q, wrench) = build_chain(robot), random_poses(robot, 4, 6)
    attained = attain_pose(chain, q, wrench)
    judge, step = build_judge(robot), 1e-5
    for j, unit in enumerate(np.eye(chain.nq)):
        ahead = judge_pose(judge, q + step * unit, wrench)
        behind = judge_pose(judge, q - step * unit, wrench)
        assert np.allclose(attained.jacobian[:, :3, j], (ahead[0] - behind[0]) / (2 * step), atol=1e-8)
        turn = (ahead[1] - behind[1]) @ attained.rotation.transpose(0, 2, 1) / (2 * step)
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        assert np.allclose(attained.jacobian[:, 3:, j], spin, atol=1e-8)


def test_softer_robots_need_more_equilibrium_steps():
    robot = load_robot("staubli_tx200")
    q, wrench = random_poses(robot, 50, 7)
    counts = [count_equilibrium_steps(build_chain(robot.scale_compliance(k)), q, wrench) for k in (0.1, 1.0, 5.0)]
    assert counts[0] < counts[1] < counts[2]


def test_a_load_beyond_buckling_is_refused():
    robot = load_robot("staubli_tx200").scale_compliance(500.0)
    q, wrench = random_poses(robot, 20, 8)
    with pytest.raises(ConvergenceError, match="needs more than 60 steps"):
        count_equilibrium_steps(build_chain(robot), q, wrench)


def test_the_last_pose_counts_for_the_equilibrium_steps_and_the_outputs_have_names():
    robot = load_robot("kuka_kr270")
    chain, (q, wrench) = build_chain(robot), random_poses(robot, 3, 5)
    wrench = wrench * np.array([[1e-3], [1e-3], [3.0]])
    alone = count_equilibrium_steps(chain, q[2:], wrench[2:])
    assert count_equilibrium_steps(chain, q, wrench) == alone > count_equilibrium_steps(chain, q[:2], wrench[:2])
    function = build_loaded_pose_function(chain, alone)
    assert [function.name_out(k) for k in range(3)] == ["position", "rotation", "theta"]
    assert [function.name_in(k) for k in range(2)] == ["q", "wrench"]
