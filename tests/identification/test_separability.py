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
from compplan.robot import LinkElasticity, Robot, Spring, load_robot
from compplan.robot.springs import missing_springs


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


def test_joint_1_is_told_as_soon_as_loads_have_a_side() -> None:
    robot = load_robot("kuka_kr240")
    drawn = draw_candidates(robot, 30, vertical=True, lever=0.0, seed=1)
    wrench = drawn.wrench.copy()
    wrench[:, 0] = 300.0
    assert "joint_1" not in held(robot, wrench, drawn.q)


def test_joint_6_cannot_be_told_by_forces_through_its_axis() -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 30, lever=0.0, seed=1)
    found = held(robot, drawn.wrench, drawn.q)
    assert list(found) == ["joint_6"]
    assert found["joint_6"][0] == ()
    assert "every force passes through its axis" in found["joint_6"][1]


def test_joint_6_cannot_be_told_by_positions_of_a_point_on_its_axis() -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 30, seed=1)
    found = held(robot, drawn.wrench, drawn.q, orientation=False)
    assert list(found) == ["joint_6"]
    assert "hardly moves the measured point" in found["joint_6"][1]


def test_a_link_that_twists_about_the_next_joints_axis_is_told_together_with_that_joint() -> None:
    robot = load_robot("kuka_kr270")
    soft = replace(robot, link_elasticities=(LinkElasticity("link_2", np.diag([1e-8] * 3 + [1e-7] * 3)),))
    drawn = draw_candidates(robot, 60, seed=1)
    found = held(soft, drawn.wrench, drawn.q, links="diagonal")
    # Joint 3 turns about -y of its frame; the end of link 2 carries that frame.
    assert found["link_2.ry"][0] == ("joint_3",)
    assert "same axis" in found["link_2.ry"][1]


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


def test_own_weight_alone_does_not_load_vertical_axes() -> None:
    robot = load_robot("ur10")
    q = draw_candidates(robot, 60, seed=1).q
    rigid = replace(robot, springs=tuple(replace(s, compliance=1e-5) for s in missing_springs(robot)))
    found = held(rigid, np.zeros(6), q)
    first = robot.joint_names[0]
    assert "weight of the links never acts about its axis" in found[first][1]
