from __future__ import annotations

import numpy as np
import pytest

from compplan.errors import InputError
from compplan.path.generators import Pace, generate_circle, generate_cone, generate_spiral


def test_a_circle_lies_on_its_circle_and_has_its_length() -> None:
    circle = generate_circle(0.5, Pace(feed=0.1, waypoints=2000), centre=(1, 2, 3), plane="xz")
    away = circle.position - [1, 2, 3]
    assert np.hypot(away[:, 0], away[:, 2]) == pytest.approx(0.5)
    assert away[:, 1] == pytest.approx(0)
    assert circle.cutting_length == pytest.approx(np.pi, rel=1e-5)
    assert len(circle) == 2000


def test_a_circle_of_negative_turns_runs_the_other_way_round() -> None:
    there, back = (generate_circle(0.01, Pace(feed=0.01, waypoints=9), turns=turns) for turns in (1, -1))
    assert back.position * [1, -1, 1] == pytest.approx(there.position)
    assert there.position[1, 1] > 0


def test_a_spiral_has_the_length_that_is_asked_for() -> None:
    spiral = generate_spiral(0.25, Pace(feed=0.05, step=0.001), length=2.7)
    assert spiral.cutting_length == pytest.approx(2.7, rel=1e-4)
    radius = np.hypot(*spiral.position[:, :2].T)
    assert radius[-1] == pytest.approx(0.25)
    assert np.all(np.diff(radius) > 0)


def test_the_helical_cone_stays_on_its_wall() -> None:
    cone = generate_cone(0.04, 0.015, np.radians(45), 0.0005, Pace(feed=0.02, step=0.0005))
    radius, depth = np.hypot(*cone.position[:, :2].T), -cone.position[:, 2]
    assert radius + depth == pytest.approx(0.02, abs=1e-12)
    assert (depth[0], depth[-1]) == pytest.approx((0, 0.015))
    assert cone.steps == pytest.approx(0.0005, rel=0.01)


def test_the_z_level_cone_runs_full_circles_at_constant_depth() -> None:
    cone = generate_cone(0.04, 0.015, np.radians(60), 0.005, Pace(feed=0.02, step=0.0002), levels=True)
    radius, depth = np.hypot(*cone.position[:, :2].T), -cone.position[:, 2]
    assert radius + depth / np.tan(np.radians(60)) == pytest.approx(0.02, abs=1e-6)
    levels, counts = np.unique(depth.round(6), return_counts=True)
    assert set(levels[counts > 50]) == {0.005, 0.01, 0.015}


def test_rate_and_duration_give_the_number_of_waypoints() -> None:
    cone = generate_cone(0.04, 0.015, np.radians(45), 0.0005, Pace(duration=500.0, rate=100.0))
    assert len(cone) == 50_000
    assert cone.feed[1] * 500 == pytest.approx(cone.cutting_length, rel=1e-4)


def test_approach_and_retract_are_rapid_and_along_the_tool_axis() -> None:
    circle = generate_circle(0.1, Pace(feed=0.1, waypoints=10), axis=(0, 0, 2), approach=0.02)
    assert circle.rapid.tolist() == [True, True, *[False] * 9, True]
    assert circle.position[0] - circle.position[1] == pytest.approx([0, 0, 0.02])
    assert circle.position[-1] - circle.position[-2] == pytest.approx([0, 0, 0.02])


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: Pace(feed=1.0, duration=1.0, step=1.0), "2 of feed and duration are given"),
        (lambda: Pace(feed=1.0), "0 of step, waypoints and rate are given"),
        (lambda: Pace(feed=-1.0, step=1.0), "must be greater than 0"),
        (lambda: generate_spiral(0.25, Pace(feed=1, step=1)), "both or none of turns and length"),
        (lambda: generate_spiral(0.25, Pace(feed=1, step=1), length=0.2), "must exceed the difference of its radii"),
        (lambda: generate_cone(0.04, 0.03, np.radians(45), 0.001, Pace(feed=1, step=1)), "must stay below 20 mm"),
    ],
)
def test_contradicting_parameters_are_refused(call, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        call()
