"""What poses and loads cannot tell is named, with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.round_trip import draw_candidates, simulate_observations
from compplan.effects import build_model, solve_model_poses
from compplan.effects.linearization import linearize_model
from compplan.effects.requested import geometry_forms
from compplan.identification import build_structure, estimate_parameters
from compplan.measurement.fit.rows import KNOWN_FRAMES
from compplan.robot import Robot, Spring, load_robot


def held(robot: Robot, wrench: np.ndarray, q: np.ndarray, **options: object) -> dict[str, tuple[tuple[str, ...], str]]:
    rows = simulate_observations(robot, q, wrench)
    frames = replace(KNOWN_FRAMES, parts=options.pop("parts", ()))
    if not options.pop("orientation", True):
        rows = replace(rows, rotation=None)
    scene = build_model(robot, rows)
    forms = geometry_forms(linearize_model(scene, solve_model_poses(scene)), options.pop("geometry", "none"))
    structure = build_structure(robot, forms=forms, **options)
    estimate = estimate_parameters(structure, rows, registration=frames, sigma="stated")
    return {item.held: (item.together_with, item.reason) for item in estimate.held}


def test_joint_1_cannot_be_told_under_vertical_loads() -> None:
    robot = load_robot("kuka_kr240")
    drawn = draw_candidates(robot, 30, vertical=True, lever=0.0, seed=1)
    found = held(robot, drawn.wrench, drawn.q)
    assert found["joint_1"] == ((), "its axis is vertical and all loads are vertical; add loads to the side")
    assert "joint_2" not in found


def test_joint_6_cannot_be_told_by_forces_through_its_axis() -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 30, lever=0.0, seed=1)
    found = held(robot, drawn.wrench, drawn.q)
    assert list(found) == ["joint_6"]
    assert found["joint_6"][0] == ()
    assert "every force passes through its axis" in found["joint_6"][1]


def test_two_springs_about_one_axis_are_named_as_a_pair() -> None:
    robot = load_robot("kuka_kr270")
    twin = replace(robot, springs=(*robot.springs, Spring("joint_2", "ry", 1e-7)))
    drawn = draw_candidates(robot, 30, seed=1)
    found = held(twin, drawn.wrench, drawn.q)
    (name, (mates, reason)), *others = found.items()
    assert not others
    assert {name, *mates} == {"joint_2", "joint_2.ry"}
    assert "only their sum acts" in reason


def test_the_zero_of_joint_1_is_told_together_with_an_unknown_base() -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 60, seed=1)
    found = held(robot, drawn.wrench, drawn.q, geometry="offsets", parts=("base", "tool"))
    assert found["joint_1.offset"][0] == ("base.rz",)
    assert "same rigid motion" in found["joint_1.offset"][1]
