"""The robot in MuJoCo that benchmarks share: its reader, its equilibrium and its torques."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

from benchmarks.simulated_robot.cell import Kinematics, SimulatedRobot
from benchmarks.simulated_robot.job import WRENCH, read_joints
from benchmarks.simulated_robot.robot import beam, mount_tool, read_arm
from benchmarks.simulated_robot.run import ROOT

POSTURE = np.array([0.1, 0.4, -1.8, 0.2, 0.7, -0.3])


def test_joints_csv_is_read_with_its_units_and_moves(tmp_path: Path) -> None:
    arm = read_arm(ROOT / "robots" / "kuka_kr240_rail")
    header = ["time_s", "q1_mm", *(f"q{k}_deg" for k in range(2, 8)), "x_mm", "y_mm", "z_mm", "i", "j", "k", *WRENCH]
    with (tmp_path / "joints.csv").open("w", newline="") as stream:
        row = [0.5, 1500, *[90] * 6, 1, 2, 3, 0, 0, 1, *[7] * 6, "approach"]
        csv.writer(stream).writerows([[*header, "move"], row])
    rows = read_joints(tmp_path / "joints.csv", arm)
    np.testing.assert_allclose(rows.q[0], [1.5, *[np.pi / 2] * 6])
    np.testing.assert_allclose(rows.wanted[0], [1e-3, 2e-3, 3e-3])
    assert rows.move is not None and rows.move[0] == "approach"


def test_a_clamped_tube_bends_by_the_textbook() -> None:
    stiffness = 70e9 * np.pi / 64 * (0.2**4 - 0.1**4)
    compliance = beam(1.5, 0.2, 0.1, 70e9, 26e9, axis="x")
    assert compliance[2, 2] == pytest.approx(1.5**3 / (3 * stiffness))
    assert compliance[4, 2] == pytest.approx(-(1.5**2) / (2 * stiffness))  # a push along z turns the tip about -y
    np.testing.assert_allclose(compliance, compliance.T)


def test_joint_torques_hold_the_wrench_by_virtual_work() -> None:
    arm = read_arm(ROOT / "robots" / "staubli_tx200")
    q, wrench = np.array([[0.2, 0.3, 0.4, 0.3, 0.8, -0.5]]), np.array([[100.0, -200.0, 300.0, 10.0, 20.0, -30.0]])
    _, jacobian = Kinematics(arm).frames(q)
    held = SimulatedRobot(arm).torques(q, wrench, None)
    np.testing.assert_allclose(held[0], -jacobian[0].T @ wrench[0], rtol=1e-9)


def test_a_tool_weighs_though_the_folder_has_no_gravity() -> None:
    bare = read_arm(ROOT / "robots" / "kuka_kr270")
    at_tip = {"position_mm": [0.0, 0.0, 300.0], "mass_kg": 10.0, "centre_of_mass_mm": [0.0, 0.0, 300.0]}
    cell, q = SimulatedRobot(mount_tool(bare, at_tip)), POSTURE[None]
    weight = np.array([[0.0, 0.0, -98.1, 0.0, 0.0, 0.0]])
    heavy = cell.rest(q, np.zeros((1, 6))).position
    np.testing.assert_allclose(heavy, cell.rest(q, weight, weights=False).position, atol=1e-12)
    assert np.linalg.norm(heavy - cell.rest(q, np.zeros((1, 6)), weights=False).position) > 2e-5


def test_an_accelerated_carriage_bends_the_arm_like_gravity_turned_round() -> None:
    rail = read_arm(ROOT / "robots" / "kuka_kr240_rail")
    q = np.array([[1.5, 0.3, 1.0, -1.2, 0.2, 0.7, -0.3]])
    push = np.array([[2.0, 0, 0, 0, 0, 0, 0]])
    moved = SimulatedRobot(rail).rest(q, np.zeros((1, 6)), rate=np.zeros((1, 7)), change=push).position
    pulled = SimulatedRobot(replace(rail, gravity=np.array([0.0, -2.0, 0.0]))).rest(q, np.zeros((1, 6))).position
    np.testing.assert_allclose(moved, pulled, atol=1e-10)
    assert np.linalg.norm(moved - Kinematics(rail).tip(q)[:, :3, 3]) > 1e-5
