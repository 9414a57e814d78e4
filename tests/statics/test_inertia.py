"""Inertial loads of the planner against Pinocchio's inverse dynamics."""

from __future__ import annotations

import numpy as np
import pytest

from compplan.robot import load_robot
from compplan.simulation.inertia import load_springs
from compplan.simulation.vibration import build_dynamics
from compplan.statics.inertia import build_moving_chain, load_motion


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr240_rail"])
def test_inertial_loads_are_those_of_inverse_dynamics(name: str) -> None:
    robot, rng = load_robot(name), np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.005, 0.05, 40))
    middle, size = 0.5 * (robot.lower + robot.upper), 0.2 * np.minimum(robot.upper - robot.lower, 3.0)
    q = middle + size * np.sin(np.outer(time, rng.uniform(2.0, 9.0, robot.nq)) + rng.uniform(0.0, 6.0, robot.nq))
    inside, rests = np.r_[False, np.ones(38, bool), False], np.zeros(40, bool)
    ours = load_motion(build_moving_chain(robot), q, time, inside)
    theirs = load_springs(build_dynamics(robot).inertial, q, time, np.ones(40, bool), rests)
    assert np.abs(theirs).max() > 100.0
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-7 * np.abs(theirs).max())
