"""The CasADi kinematics against Pinocchio, its loads against the numeric ones; derivatives, and point masses."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from robot_library import over_robots

from compplan.robot import Body, load_robot
from compplan.simulation.exact import build_exact_robot, solve_exact_pose
from compplan.statics.chain import build_chain, load_elements, locate_frames
from compplan.statics.inertia import divide_body
from compplan.statics.kinematics import load_springs, locate_symbolic
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


@pytest.mark.parametrize("name", ["kuka_kr270_full", "examples/positioner/kuka_kr240_table"])
def test_symbolic_loads_of_wrench_and_weights_agree_with_the_numeric_ones(name):
    place = Path(__file__).parents[2] / name
    robot = replace(load_robot(place if place.is_dir() else name), gravity=np.array([0.3, 0.0, -9.81]))
    chain, (at, wrench) = build_chain(robot), random_poses(robot, 5, 8)
    q, w = ca.SX.sym("q", chain.nq), ca.SX.sym("wrench", 6)
    symbolic = ca.Function("load", [q, w], [load_springs(chain, locate_symbolic(chain, q), w)])
    numeric = load_elements(chain, locate_frames(chain, at), wrench)[:, chain.spring_elements]
    loads = np.array(symbolic.map(5)(at.T, wrench.T)).T
    assert loads == pytest.approx(numeric, abs=1e-8)


def test_four_points_have_the_mass_the_centre_and_the_inertia_of_their_body():
    inertia = np.array([[3.0, 0.2, -0.1], [0.2, 4.0, 0.3], [-0.1, 0.3, 5.0]])
    points = divide_body(Body("link", 20.0, np.array([0.1, -0.2, 0.3]), inertia))
    mass, centre = np.array([p.mass for p in points]), np.array([p.centre for p in points])
    assert mass.sum() == pytest.approx(20.0) and mass @ centre / 20.0 == pytest.approx([0.1, -0.2, 0.3])
    arm = centre - [0.1, -0.2, 0.3]
    about = np.einsum("k,kij->ij", mass, [r @ r * np.eye(3) - np.outer(r, r) for r in arm])
    assert about == pytest.approx(inertia)
