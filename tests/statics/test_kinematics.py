"""The CasADi kinematics against Pinocchio, and their derivatives against finite differences."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from robot_library import over_robots

from compplan.robot import load_robot
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.statics.chain import build_chain
from compplan.statics.kinematics import locate_symbolic
from compplan.statics.stiffness import attain_pose


def random_poses(robot, n, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (n, robot.nq))
    return q, rng.normal(size=(n, 6)) * [700.0, 700.0, 1000.0, 60.0, 60.0, 60.0]


def build_pose_function(chain):
    q = ca.SX.sym("q", chain.nq)
    frames = locate_symbolic(chain, q)
    return ca.Function("pose", [q], [frames.position, frames.rotation])


def run(function, n, *arguments):
    return [np.array(part).T for part in function.map(n)(*(a.T for a in arguments))]


@pytest.mark.parametrize("name", over_robots())
def test_casadi_kinematics_agree_with_pinocchio(name):
    robot = load_robot(name)
    q, _ = random_poses(robot, 100, 3)
    position, rotation = run(build_pose_function(build_chain(robot)), 100, q)
    rigid = replace(robot, gravity=None)
    judged_position, judged_rotation, _ = solve_exact_pose(build_exact_robot(rigid), q, np.zeros((100, 6)))
    assert np.abs(position - judged_position).max() < 1e-10
    columns = rotation.reshape(100, 3, 3)  # three columns of the matrix side by side, transposed
    assert np.abs(columns - judged_rotation.transpose(0, 2, 1)).max() < 1e-10


@pytest.mark.parametrize("gravity", [None, np.array([0.0, 0.0, -9.81])])
@pytest.mark.parametrize("name", ["staubli_tx200", "kuka_kr270_full", "kuka_kr240_rail"])
def test_loaded_jacobian_agrees_with_finite_differences_of_the_judge(name, gravity):
    robot = replace(load_robot(name), gravity=gravity)
    chain, (q, wrench) = build_chain(robot), random_poses(robot, 4, 6)
    attained = attain_pose(chain, q, wrench)
    exact_robot, step = build_exact_robot(robot), 1e-5
    for j, unit in enumerate(np.eye(chain.nq)):
        ahead = solve_exact_pose(exact_robot, q + step * unit, wrench)
        behind = solve_exact_pose(exact_robot, q - step * unit, wrench)
        assert np.allclose(attained.jacobian[:, :3, j], (ahead[0] - behind[0]) / (2 * step), atol=1e-8)
        turn = (ahead[1] - behind[1]) @ attained.rotation.transpose(0, 2, 1) / (2 * step)
        spin = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
        assert np.allclose(attained.jacobian[:, 3:, j], spin, atol=1e-8)
