from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compplan.reproduce.correction_loop import LITERAL, WITHOUT_DERIVATIVE, fitted_loop, largest_pole, simulate_loops
from compplan.reproduce.johra2022 import (
    FIG_7_DEG,
    FIG_7_FORCE,
    STEPS,
    displace,
    error_over_direction,
    grid_postures,
    load_shares,
    without_side_spring,
)
from compplan.robot import load_robot

ROBOT = load_robot("staubli_tx200")


def test_the_tool_moves_along_x_only_with_the_extra_spring_and_its_shift() -> None:
    enhanced, single = (displace(r, FIG_7_DEG, [0, FIG_7_FORCE, 0]) for r in (ROBOT, without_side_spring(ROBOT)))
    assert enhanced[0] == pytest.approx(0.48e-3, rel=0.05)
    assert abs(single[0]) < 1e-5
    unshifted = replace(ROBOT, springs=tuple(replace(s, offset=np.zeros(3)) for s in ROBOT.springs))
    assert abs(displace(unshifted, FIG_7_DEG, [0, FIG_7_FORCE, 0])[0]) < 2e-5
    assert enhanced[1] > 1.3 * single[1]


def test_the_measured_error_lies_inside_what_lateral_forces_can_make() -> None:
    size = error_over_direction(ROBOT)[:, 1] * 1e3
    assert size.min() < 3.84 < size.max()
    assert size.min() == pytest.approx(1.63, rel=0.05) and size.max() == pytest.approx(6.8, rel=0.05)


def test_the_grid_has_about_two_hundred_postures_of_one_configuration() -> None:
    q = grid_postures(ROBOT)
    assert len(q) == 196
    assert (np.abs(np.diff(q.reshape(14, 14, 6), axis=1)).max(axis=(0, 1)) < 0.2).all()


def test_each_step_of_the_calibration_loads_its_own_springs_most_or_nearly() -> None:
    for q_deg, direction, springs in STEPS:
        shares = load_shares(ROBOT, q_deg, direction)
        assert sum(shares.values()) == pytest.approx(1)
        assert sum(shares[name] for name in springs) > 0.4


def test_the_literal_law_is_unstable_and_stable_without_its_derivative() -> None:
    assert largest_pole(LITERAL) == pytest.approx(2.29, abs=0.01)
    assert largest_pole(WITHOUT_DERIVATIVE) == pytest.approx(0.91, abs=0.01)


def test_the_poles_tell_how_the_simulated_loop_grows_or_dies_away() -> None:
    _, responses = simulate_loops(2.0)
    literal, pi, with_plant = responses.values()
    assert np.abs(literal[-1]) >= 10
    assert np.abs(pi[-1]) < 1e-5 and np.abs(with_plant[-20:]).max() < 1e-2
    early, late = np.abs(with_plant[60:80]).max(), np.abs(with_plant[100:120]).max()
    assert (late / early) ** (1 / 40) == pytest.approx(largest_pole(fitted_loop()), abs=0.01)


def test_the_plant_that_fits_the_gains_has_the_ultimate_gain_of_ziegler_and_nichols() -> None:
    fitted = fitted_loop()
    assert fitted.plant.lag == pytest.approx(13.5e-3, rel=0.01) and fitted.plant.delay == pytest.approx(37e-3, rel=0.02)
    assert largest_pole(fitted) < 1
    assert largest_pole(replace(fitted, gain=2.5 * fitted.gain)) > 1
