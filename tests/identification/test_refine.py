"""A spring that the robot lacks is kept where it is surely above zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.round_trip import draw_candidates, simulate_observations
from compplan.identification import KNOWN_FRAMES, Rows, build_structure
from compplan.identification.estimate import Estimate
from compplan.identification.problem import IdentifyOptions, IdentifyProblem, select_springs
from compplan.identification.update import find_unexplained
from compplan.measurement.campaign import Campaign
from compplan.measurement.fit.intervals import distance_rms
from compplan.robot import Robot, Spring, load_robot


def every_row(log: Campaign, sigma: str = "residuals") -> Rows:
    return Rows(log, np.arange(len(log)), KNOWN_FRAMES, sigma=sigma)


def cross_springs(robot: Robot) -> tuple[Spring, ...]:
    """List springs across the own axis of every joint."""
    axes = [(joint.name, np.abs(joint.axis)) for joint in robot.actuated]
    return tuple(Spring(name, f"r{'xyz'[k]}", 0.0, actuator=False) for name, a in axes for k in range(3) if a[k] < 0.5)


def names_of(robot_springs: tuple[Spring, ...]) -> list[str]:
    return [spring.name for spring in robot_springs]


def select(robot: Robot, rows: Campaign) -> Estimate:
    problem = IdentifyProblem(robot, IdentifyOptions(), every_row(rows))
    structure = build_structure(robot, add=cross_springs(robot))
    return select_springs(problem, structure, problem.fit(structure))


def test_the_spring_that_was_left_out_is_found_and_no_other_is_added() -> None:
    # Johra's robot: the arm bends about the forearm's x axis at joint 3, which one spring a joint cannot say.
    whole = load_robot("staubli_tx200")
    lacking = replace(whole, springs=tuple(s for s in whole.springs if s.axis == "own"))
    drawn = draw_candidates(whole, 60, seed=1)
    rows = simulate_observations(whole, drawn.q, drawn.wrench, seed=2)
    assert set(select(lacking, rows).structure.names) == {*names_of(lacking.springs), "joint_3.rx"}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_nothing_is_added_to_a_model_that_is_complete(seed: int) -> None:
    robot = load_robot("kuka_kr270")
    drawn = draw_candidates(robot, 60, seed=seed)
    rows = simulate_observations(robot, drawn.q, drawn.wrench, seed=seed)
    assert select(robot, rows).structure.names == tuple(names_of(robot.springs))


@pytest.mark.parametrize("difference", [False, True])
def test_what_is_unexplained_is_left_when_the_instruments_noise_is_taken_out(*, difference: bool) -> None:
    rng, sigma, size = np.random.default_rng(5), 4e-5, 6e-5
    way = rng.normal(size=(40_000, 3))
    true = size * way / np.linalg.norm(way, axis=1, keepdims=True)
    read = true + rng.normal(0.0, sigma, true.shape)
    if difference:
        read -= rng.normal(0.0, sigma, true.shape)
    left = distance_rms(read, np.ones(len(read), bool))
    assert find_unexplained(left, sigma, difference=difference) == pytest.approx(size, rel=0.03)
