"""The virtual cell: Pinocchio's equilibrium, other compliances, effects."""

from dataclasses import replace

import numpy as np
import pytest
from arms import one_joint_arm

from compplan.robot import load_robot
from compplan.simulation.simulated_robot import (
    AS_MODELLED,
    build_simulated_robot,
    run_simulated_robot,
    standard_variants,
)
from compplan.simulation.vibration import build_dynamics, inertial_loads, natural_frequencies

Q = np.radians([[0.0, 49.7, 89.3, 0.0, 41.0, 0.0], [5.0, 45.0, 80.0, 10.0, 41.0, 20.0]])
WRENCH = np.array([[0.0, 300.0, 1200.0, 0, 0, 0], [100.0, 0.0, 900.0, 5, 0, 0]])


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
    assert inertial_loads(dynamics, none, none, none + 3.0)[0, 0] == pytest.approx(-3.0 * inertia, rel=1e-6)
