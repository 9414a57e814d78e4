from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from compplan.errors import InputError
from compplan.toolpath.generators import GENERATORS, CircleTable, ConeTable, SpiralTable

CONE = {"diameter_mm": 40, "depth_mm": 15, "wall_angle_deg": 45, "pitch_mm": 0.5}
PACE = {"feed_mm_s": 20, "step_mm": 0.5}


def test_a_circle_lies_on_its_circle_and_has_its_length() -> None:
    circle = CircleTable(radius_mm=500, feed_mm_s=100, waypoints=2000).generate()
    assert np.hypot(circle.position[:, 0], circle.position[:, 1]) == pytest.approx(0.5)
    assert circle.position[:, 2] == pytest.approx(0)
    assert circle.cutting_length == pytest.approx(np.pi, rel=1e-5)
    assert len(circle) == 2000


def test_a_spiral_has_the_length_that_is_asked_for() -> None:
    spiral = SpiralTable(outer_radius_mm=250, length_mm=2700, feed_mm_s=50, step_mm=1).generate()
    assert spiral.cutting_length == pytest.approx(2.7, rel=1e-4)
    radius = np.hypot(*spiral.position[:, :2].T)
    assert radius[-1] == pytest.approx(0.25)
    assert np.all(np.diff(radius) > 0)


def test_the_helical_cone_stays_on_its_wall() -> None:
    cone = ConeTable(**CONE, **PACE).generate()
    radius, depth = np.hypot(*cone.position[:, :2].T), -cone.position[:, 2]
    assert radius + depth == pytest.approx(0.02, abs=1e-12)
    assert (depth[0], depth[-1]) == pytest.approx((0, 0.015))
    assert cone.steps == pytest.approx(0.0005, rel=0.01)


def test_the_z_level_cone_runs_full_circles_at_constant_depth() -> None:
    keys = {**CONE, "wall_angle_deg": 60, "pitch_mm": 5, "feed_mm_s": 20, "step_mm": 0.2}
    cone = ConeTable(path="z_level", **keys).generate()
    radius, depth = np.hypot(*cone.position[:, :2].T), -cone.position[:, 2]
    assert radius + depth / np.tan(np.radians(60)) == pytest.approx(0.02, abs=1e-6)
    levels, counts = np.unique(depth.round(6), return_counts=True)
    assert set(levels[counts > 50]) == {0.005, 0.01, 0.015}


def test_tables_of_a_job_are_in_millimetres_degrees_and_millimetres_a_second() -> None:
    def generate(**keys: object):
        return GENERATORS[str(keys["generator"])].model_validate(keys).generate()

    # three quarters of a turn from where x is greatest, 1 mm approach: it ends where y is least
    keys = {"radius_mm": 50.0, "turns": 0.75}
    circle = generate(generator="circle", feed_mm_s=20.0, step_mm=0.5, approach_mm=1.0, **keys)
    assert circle.position[[0, 1, -2]] == pytest.approx(
        np.array([[0.05, 0.0, 0.001], [0.05, 0.0, 0.0], [0.0, -0.05, 0.0]]), abs=1e-12
    )
    assert circle.feed[5] == pytest.approx(0.02) and circle.steps[5] == pytest.approx(5e-4, rel=1e-2)
    # a wall of 60 deg against the horizontal comes in by 10 / tan 60 = 5.7735 mm over 10 mm of depth
    keys = {"diameter_mm": 40.0, "depth_mm": 10.0, "wall_angle_deg": 60.0, "pitch_mm": 2.0}
    cone = generate(generator="isf_cone", feed_mm_s=20.0, waypoints=500, **keys).position
    assert cone[[0, -1]] == pytest.approx(np.array([[0.02, 0, 0], [0.0142265, 0, -0.01]]), abs=1e-7)
    assert np.ptp(np.unwrap(np.arctan2(cone[:, 1], cone[:, 0]))) == pytest.approx(10 * np.pi, rel=1e-6)
    keys = {"outer_radius_mm": 30.0, "inner_radius_mm": 10.0, "turns": 2.0}
    spiral = generate(generator="spiral", feed_mm_s=20.0, waypoints=100, **keys).position
    radius = np.hypot(*spiral[:, :2].T)
    assert (radius[0], radius[-1]) == pytest.approx((0.01, 0.03)) and spiral[:, 2] == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: CircleTable(radius_mm=1, waypoints=9, **PACE), "exactly one of step_mm and waypoints"),
        (lambda: CircleTable(radius_mm=1, feed_mm_s=-1.0, step_mm=1.0), "greater than 0"),
        (lambda: SpiralTable(outer_radius_mm=250, **PACE).generate(), "both or none of turns and length"),
        (lambda: SpiralTable(outer_radius_mm=250, length_mm=200, **PACE).generate(), "difference of its radii"),
        (lambda: SpiralTable(outer_radius_mm=9, inner_radius_mm=9, length_mm=0.01, **PACE).generate(), "thousandth"),
        (lambda: CircleTable(radius_mm=1, turns=0, **PACE).generate(), "path without length"),
        (lambda: CircleTable(radius_mm=1, turns=1e10, **PACE).generate(), "1e\\+10 turns, at most 10000"),
        (lambda: ConeTable(**{**CONE, "pitch_mm": 1e-9, "path": "z_level"}, **PACE).generate(), "at most 10000"),
        (lambda: ConeTable(**{**CONE, "depth_mm": 30}, **PACE).generate(), "must stay below 20 mm"),
    ],
)
def test_contradicting_parameters_are_refused(call, sentence: str) -> None:
    with pytest.raises((InputError, ValidationError), match=sentence):
        call()
