"""Placement: the chosen place is at least as good as the job's own, and stands within its range."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from compplan.errors import InfeasibleError, InputError
from compplan.job.job import check_job
from compplan.planning.plan import job_robot
from compplan.planning.posture.place import place_part, rate_places, summarise_placement
from compplan.planning.posture.settings import PostureSettings
from compplan.reporting.place import draw_place_map

TABLE = {
    "schema": 1,
    "robot": "kuka_kr270",
    "toolpath": {"generator": "circle", "radius_mm": 60.0, "feed_mm_s": 20.0, "waypoints": 40},
    "part": {"position_mm": [2000.0, 0.0, 500.0]},
    "process": {"model": "constant", "force_N": [300.0, 100.0, 500.0]},
    "place": {"x_mm": [1400.0, 2200.0], "y_mm": [0.0, 0.0], "z_mm": [500.0, 900.0], "step_mm": 400.0},
}


@pytest.fixture(scope="module")
def placed():
    job = check_job(TABLE, "job.toml")
    return job, place_part(job, job_robot(job))


def test_the_chosen_place_leaves_no_more_than_the_jobs_own(placed) -> None:
    _, result = placed
    assert result.ratio < 0.95
    assert result.posture_choice.costs["sensitivity_rms_mm"] < result.before.costs["sensitivity_rms_mm"]


def test_the_chosen_place_lies_within_the_range(placed) -> None:
    _, result = placed
    assert (result.position >= [1.4, 0.0, 0.5]).all() and (result.position <= [2.2, 0.0, 0.9]).all()


def test_no_place_of_the_grid_is_better_than_its_lower_bound(placed) -> None:
    _, result = placed
    assert 1e3 * np.nanmin(result.ratings[0].bound) <= result.posture_choice.costs["sensitivity_rms_mm"] * 1.03


def test_the_result_is_plain_json_with_a_picture(placed) -> None:
    job, result = placed
    summary = json.loads(json.dumps(summarise_placement(result, job), allow_nan=False))
    assert summary["schema"] == 1 and summary["ratio"] == pytest.approx(result.ratio)
    assert [trace["type"] for trace in draw_place_map(result).data] == ["heatmap", "scatter", "scatter"] * 2


def test_places_out_of_reach_are_rated_as_such() -> None:
    job = check_job(TABLE, "job.toml")
    shifts = np.array([[0.0, 0, 0], [9.0, 0, 0]])
    bound = rate_places(job, job_robot(job), PostureSettings(), shifts)
    assert np.isfinite(bound[0]) and np.isnan(bound[1])


def test_a_turn_of_the_part_is_about_the_vertical_however_the_part_lies(placed) -> None:
    lies = check_job({**TABLE, "part": {**TABLE["part"], "rotation_deg": [90.0, 0.0, 0.0]}}, "job.toml")
    told = summarise_placement(replace(placed[1], turn=0.5 * np.pi), lies)["part"]
    turned = Rotation.from_rotvec(told["rotation_deg"], degrees=True).as_matrix()
    quarter, lying = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert turned == pytest.approx(quarter @ lying, abs=1e-9) and told["turn_deg"] == pytest.approx(90.0)


def test_a_range_without_any_place_in_reach_is_infeasible() -> None:
    table = {**TABLE, "place": {"x_mm": [8000.0, 8100.0], "y_mm": [0.0, 0.0], "z_mm": [0.0, 0.0]}}
    job = check_job(table, "job.toml")
    with pytest.raises(InfeasibleError, match="none of the places"):
        place_part(job, job_robot(job))


def test_too_fine_a_grid_is_refused() -> None:
    table = {**TABLE, "place": {"step_mm": 1.0}}
    job = check_job(table, "job.toml")
    with pytest.raises(InputError, match=r"job.toml: place.step_mm: .* places"):
        place_part(job, job_robot(job))
