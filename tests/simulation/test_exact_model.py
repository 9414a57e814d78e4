"""The judge reads robot folders by itself; sound readings agree, and a fault in one of them shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import one_joint_arm
from robot_library import over_robots

from compplan.job.frames import ToolTable
from compplan.robot import load_robot, robot_folders
from compplan.simulation.exact import build_exact_robot, load_by_motion, solve_exact_pose
from compplan.simulation.exact_model import read_exact_robot
from compplan.simulation.simulated_robot import (
    AS_MODELLED,
    build_simulated_robot,
    run_simulated_robot,
    standard_variants,
)
from compplan.simulation.vibration import build_dynamics, natural_frequencies
from compplan.statics.chain import build_chain
from compplan.statics.stiffness import attain_pose

TOOL = {
    "position_mm": [150.0, 20.0, -300.0], "rotation_deg": [0.0, 120.0, 30.0], "mass_kg": 18.0,
    "centre_of_mass_mm": [130.0, 0.0, -70.0],
}  # fmt: skip
Q = np.radians([[0.0, 49.7, 89.3, 0.0, 41.0, 0.0], [5.0, 45.0, 80.0, 10.0, 41.0, 20.0]])
WRENCH = np.array([[0.0, 300.0, 1200.0, 0, 0, 0], [100.0, 0.0, 900.0, 5, 0, 0]])


def draw(robot, count=6):
    """Draw joint positions within the limits, and wrenches."""
    rng = np.random.default_rng(3)
    low, high = np.clip(robot.lower, -2.0, 2.0), np.clip(robot.upper, -2.0, 2.0)
    return rng.uniform(low, high, (count, robot.nq)), rng.normal(size=(count, 6)) * [200, 200, 200, 20, 20, 20]


@pytest.mark.parametrize("tool", [None, TOOL])
@pytest.mark.parametrize("name", over_robots())
def test_the_judges_own_reading_of_a_shipped_folder_agrees_with_the_planners(name, tool):
    robot = load_robot(name)
    exact_robot = read_exact_robot(robot_folders()[name], tool)
    if tool is not None:
        table = ToolTable(**tool)
        robot = robot.with_tool(table.pose, table.mass_kg, np.array(table.centre_of_mass_mm) * 1e-3)
    q, wrench = draw(robot)
    ours, theirs = solve_exact_pose(exact_robot, q, wrench), solve_exact_pose(build_exact_robot(robot), q, wrench)
    assert ours[0] == pytest.approx(theirs[0], abs=1e-12)
    assert ours[1] == pytest.approx(theirs[1], abs=1e-12)


def test_a_compliance_that_the_planner_reads_doubled_is_not_doubled_for_the_judge():
    robot = load_robot("kuka_kr270")
    q, wrench = draw(robot)
    soft = solve_exact_pose(build_exact_robot(robot.scale_compliance(2.0)), q, wrench)[0]
    assert np.linalg.norm(soft - solve_exact_pose(read_exact_robot(robot.folder), q, wrench)[0], axis=1).max() > 1e-4


def test_the_weight_of_a_tool_bends_an_arm_whose_folder_has_no_gravity_by_its_difference():
    # TX200: 5 kg hang on the flange when the springs were identified; the same tool again changes nothing.
    robot = load_robot("staubli_tx200")
    same = next(body for body in robot.bodies if body.mass == 5.0)
    pose = np.eye(4)
    q, none = draw(robot)[0], np.zeros((6, 6))
    flange = next(joint for joint in robot.joints if joint.parent == robot.flange)
    pose[:] = flange.placement
    centre = pose[:3, :3] @ same.centre + pose[:3, 3]
    rigid = solve_exact_pose(build_exact_robot(replace(robot, springs=())), q, none)[0]
    for mass, moves in ((5.0, False), (23.0, True)):
        bent = solve_exact_pose(build_exact_robot(robot.with_tool(pose, mass, centre)), q, none)[0]
        assert (np.linalg.norm(bent - rigid, axis=1).max() > 5e-5) == moves


@pytest.mark.parametrize("mass", [0.5, 3.0, 5.0, 5.001])
def test_a_tool_lighter_than_the_one_the_springs_were_identified_with_lifts_the_arm(mass):
    # Pinocchio's bodies cannot have masses below 0; the planner's chain takes each weight as a force.
    robot = load_robot("staubli_tx200")
    tool = {"position_mm": [0.0, 0.0, 150.0], "mass_kg": mass, "centre_of_mass_mm": [0.0, 10.0, 60.0]}
    table = ToolTable(**tool)
    mounted = robot.with_tool(table.pose, mass, np.array(table.centre_of_mass_mm) * 1e-3)
    q, wrench = draw(robot)
    ours = attain_pose(build_chain(mounted), q, wrench, slope=False).position
    for exact_robot in (build_exact_robot(mounted), read_exact_robot(robot.folder, tool)):
        assert solve_exact_pose(exact_robot, q, wrench)[0] == pytest.approx(ours, abs=1e-11)
    bare = attain_pose(build_chain(robot.with_tool(table.pose)), q, wrench, slope=False).position
    assert 2e-6 < np.linalg.norm(ours - bare, axis=1).max() < 4e-4


def test_standard_cells_are_labelled_and_bend_by_their_factor():
    robot = load_robot("staubli_tx200")
    cells = standard_variants(robot)
    assert [cell.name for cell in cells] == [AS_MODELLED, "compliance x 1.2", "compliance x 0.8"]
    rigid = run_simulated_robot(build_simulated_robot(robot.scale_compliance(1e-9)), Q, WRENCH).position
    sizes = [np.linalg.norm(run_simulated_robot(cell, Q, WRENCH).position - rigid, axis=1) for cell in cells]
    assert sizes[1] / sizes[0] == pytest.approx([1.2, 1.2], rel=0.01)
    assert sizes[2] / sizes[0] == pytest.approx([0.8, 0.8], rel=0.01)


def test_effects_of_the_robot_folder_act_in_the_cell():
    robot = load_robot("staubli_tx200")
    table = {"effect": "joint_offset", "joint": "joint_2", "parameters": {"offset_rad": 1e-3}}
    plain = run_simulated_robot(build_simulated_robot(robot), Q, WRENCH).position
    shifted = run_simulated_robot(build_simulated_robot(replace(robot, effects=(table,))), Q, WRENCH).position
    turned = Q + np.array([0, 1e-3, 0, 0, 0, 0])
    assert np.linalg.norm(shifted - plain, axis=1).min() > 5e-4
    assert np.abs(shifted - run_simulated_robot(build_simulated_robot(robot), turned, WRENCH).position).max() < 1e-6


def test_a_mass_on_a_torsion_spring_rings_at_its_closed_form_and_is_bent_by_its_own_motion(tmp_path):
    robot = one_joint_arm(tmp_path / "arm", length=0.8, compliance=2e-5, mass=12.0)
    dynamics, inertia, none = build_dynamics(robot), 12.0 * 0.8**2, np.zeros((1, 1))
    found = natural_frequencies(dynamics, none, 1)
    assert found[0, 0] == pytest.approx(1.0 / (2 * np.pi * np.sqrt(2e-5 * inertia)), rel=1e-6)
    assert load_by_motion(dynamics.inertial, none, none, none + 3.0)[0, 0] == pytest.approx(-3.0 * inertia, rel=1e-6)
