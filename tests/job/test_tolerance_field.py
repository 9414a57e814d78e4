"""Parts of a path have tolerances of their own, across and along the travel apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from compplan.controllers.writers.fit import fit_moves
from compplan.errors import InputError
from compplan.job.job import check_job
from compplan.job.loading import load_path
from compplan.job.tolerance import ToleranceTable
from compplan.planning.allowed import find_allowed
from compplan.planning.plan import plan_job
from compplan.reporting.writers.plan import make_program, write_moves
from compplan.robot import Array
from compplan.toolpath.events import Event
from compplan.toolpath.toolpath import Toolpath


def straight(n: int = 11, **changes: Any) -> Toolpath:
    """A straight cut along x of 10 mm, in steps of 1 mm, after a rapid move."""
    position = np.zeros((n, 3))
    position[:, 0] = 1e-3 * np.arange(n)
    rapid = np.zeros(n, bool)
    rapid[:2] = True
    return Toolpath(position, np.tile([0.0, 0, 1], (n, 1)), np.full(n, 0.01), rapid, **changes)


def lay(table: dict[str, Any], path: Toolpath, whole: float = 0.1) -> Toolpath:
    return ToleranceTable(**table).lay(path, whole)


def away(x: float, y: float) -> Array:
    return np.tile([x, y, 0.0], (11, 1)) * 1e-3


def test_a_job_without_the_table_has_one_tolerance_for_all() -> None:
    path = straight()
    assert lay({}, path) is path
    assert find_allowed(path) is None


def test_a_deviation_along_the_travel_counts_against_its_own_tolerance() -> None:
    allowed = find_allowed(lay({"tangential_mm": 2.0}, straight()))
    assert allowed is not None
    np.testing.assert_allclose(allowed.use(away(1.0, 0.05))[1:], 0.5)
    np.testing.assert_allclose(allowed.use(away(1.5, 0.05))[1:], 0.75)
    part = {"s_mm": [0.0, 10.0], "normal_mm": 0.1}
    one = find_allowed(lay({"part": [part]}, straight(), whole=0.3))
    assert one is not None
    np.testing.assert_allclose(one.use(away(0.03, 0.04))[1:], 0.5)


def test_parts_are_meant_by_length_and_by_operation() -> None:
    events = (Event(-1, "tool", 1.0, "T1"), Event(4, "tool", 2.0, "MILL D6"), Event(7, "comment", text="FINISH wall"))
    path = straight(events=events)
    for place, moves in (
        ({"s_mm": [3.0, 6.0]}, [4, 5, 6]), ({"operation": "t2"}, range(5, 11)),
        ({"operation": "mill"}, range(5, 11)), ({"operation": "finish"}, [8, 9, 10]),
    ):  # fmt: skip
        found = lay({"part": [{**place, "normal_mm": 0.5}]}, path).tolerance
        assert found is not None
        wanted = np.full(11, 1e-4)
        wanted[list(moves)] = 5e-4
        np.testing.assert_allclose(found[:, 0], wanted)


def test_between_two_parts_the_stricter_one_counts_and_of_parts_that_overlap_the_last() -> None:
    parts = [{"s_mm": [2.0, 8.0], "normal_mm": 0.5}, {"s_mm": [5.0, 8.0], "normal_mm": 0.2}]
    allowed = find_allowed(lay({"part": parts}, straight()))
    assert allowed is not None
    np.testing.assert_allclose(1e3 * allowed.normal[2:], [0.1 if k in (2, 8, 9, 10) else 0.5 if k < 5 else 0.2
                                                          for k in range(2, 11)])  # fmt: skip


def test_at_a_corner_the_whole_distance_counts() -> None:
    path = straight()
    position = path.position.copy()
    position[6:, 0], position[6:, 1] = position[5, 0], 1e-3 * np.arange(1, 6)
    allowed = find_allowed(lay({"tangential_mm": 2.0}, replace(path, position=position)))
    assert allowed is not None
    assert allowed.apart[2:].tolist() == [True, True, True, False, *[True] * 5]


def test_a_band_is_held_against_each_direction_by_itself() -> None:
    allowed = find_allowed(lay({"tangential_mm": 2.0}, straight()))
    assert allowed is not None
    along = np.tile(np.diag([1.0, 0.0, 0.0]), (11, 1, 1)) * 1e-8
    across = np.tile(np.diag([0.0, 1.0, 0.0]), (11, 1, 1)) * 1e-8
    radius = np.full(11, 2e-4)
    np.testing.assert_allclose(allowed.use_of_band(radius, along, None)[2:], 0.1, rtol=1e-3)
    np.testing.assert_allclose(allowed.use_of_band(radius, across, None)[2:], 2.0, rtol=1e-3)


@pytest.mark.parametrize(
    ("part", "said"),
    [({"s_mm": [0.0, 1.0], "normal_mm": 1.0}, "holds no cutting move"), ({"s_mm": [2.0, 5.0]}, "states no tolerance"),
     ({"normal_mm": 1.0}, "has no place"), ({"s_mm": [5.0, 3.0], "normal_mm": 1.0}, "end at 3")],
)  # fmt: skip
def test_a_part_that_says_too_little_is_refused(part: dict[str, Any], said: str) -> None:
    with pytest.raises((InputError, ValueError), match=said):
        lay({"part": [part]}, straight())


def job(**tables: Any) -> dict[str, Any]:
    return {
        "schema": 1, "robot": "staubli_tx200", "part": {"position_mm": [1300.0, 0.0, 300.0]},
        "toolpath": {"generator": "circle", "radius_mm": 20.0, "feed_mm_s": 10.0, "waypoints": 30},
        "process": {"model": "constant", "force_N": [100.0, 0.0, 300.0]},
        "plan": {"rotate_about_tool_axis": False, "strategy": "none", "tolerance_mm": 0.05}, **tables,
    }  # fmt: skip


def test_the_tolerance_stays_with_its_moves_when_they_are_divided() -> None:
    table = {"part": [{"s_mm": [0.0, 60.0], "normal_mm": 0.5}]}
    path, _ = load_path(check_job(job(tolerance=table, sampling={"max_step_mm": 1.0}), "job.toml"))
    assert path.tolerance is not None
    middle = 1e3 * (path.arc_length - 0.5 * np.r_[0.0, path.steps])
    found = path.tolerance[1:, 0] > 1e-4
    assert (found[middle[1:] < 55.0]).all()
    assert not found[middle[1:] > 65.0].any()


def test_a_plan_is_held_against_each_part_by_itself() -> None:
    """Uncorrected, the arm is off by a tenth of a millimetre or more all around: too much where that is not allowed."""
    strict = plan_job(check_job(job(), "job.toml"))
    off = 1e3 * strict.after.distance[strict.after.cut]
    assert strict.status == "not_confirmed"
    assert off.min() > 0.05
    wide = {"normal_mm": float(2.0 * off.max())}
    easy = {**job()["plan"], "tolerance_mm": wide["normal_mm"]}
    assert plan_job(check_job(job(plan=easy), "job.toml")).status == "solved"
    part = {"part": [{"s_mm": [0.0, 60.0], **wide}]}
    plan = plan_job(check_job(job(tolerance=part), "job.toml"))
    assert plan.status == "not_confirmed"
    assert plan.task.allowed is not None
    share = plan.task.use_tolerance(plan.after.deviation)[plan.after.cut]
    assert 0.1 < (share <= 1.0).mean() < 0.9
    assert f"{0.05:g} mm to {wide['normal_mm']:.3g} mm" in plan.verdict.sentence


def test_programs_are_fitted_more_coarsely_where_a_part_allows_more(tmp_path: Path) -> None:
    """Half of a circle may be off ten times as far: it has fewer lines, and the reader of the programs agrees."""
    half = {"part": [{"s_mm": [0.0, 62.8], "normal_mm": 5.0}]}
    moves = {}
    for name, tolerance in (("one", {}), ("half", half)):
        tables = job(tolerance=tolerance, output={"programs": ["val3"], "fit_tolerance_mm": 0.002})
        tables["toolpath"]["waypoints"], tables["plan"] = 240, {"strategy": "mirror", "tolerance_mm": 0.5}
        plan = plan_job(check_job(tables, tmp_path / "job.toml"))
        fitted = fit_moves(make_program(plan), arcs=False).program
        place = fitted.positions[:, 1, 3]
        moves[name] = [int((place > 0).sum()), int((place < 0).sum())]
        (tmp_path / name).mkdir()
        found, _ = write_moves(plan, tmp_path / name)
        assert not [text for text in found.breaches if "read back" in text]
    assert moves["half"][0] < 0.6 * moves["one"][0]
    assert abs(moves["half"][1] - moves["one"][1]) <= 3
