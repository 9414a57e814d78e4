"""The vote of the second reading on the path that a job asks for."""

from pathlib import Path

import numpy as np
import pytest

from tests.oracles.forces import DrivenRows
from tests.oracles.wanted import Check, check_required_path

PROGRAM = "G21 G90 G94\nG0 X0 Y0 Z10.\nG1 Z0. F600\nG1 X20. F1200\nG1 Y20.\nM30\n"
"""A plunge of 10 mm/s and two cuts of 20 mm/s."""


def _ask(folder: Path, feed_table: dict[str, object], feed: list[float]) -> Check:
    (folder / "part.nc").write_text(PROGRAM)
    position = np.array([[0, 0, 10], [0, 0, 0], [20, 0, 0], [20, 20, 0]]) * 1e-3
    rapid, axis = np.array([True, False, False, False]), np.tile([0.0, 0.0, 1.0], (4, 1))
    rows = DrivenRows(position, axis, rapid, np.zeros(4, bool), np.arange(4.0))
    tables = {"toolpath": "part.nc", "feed": {"corner_tolerance_mm": 0.0, **feed_table}}
    return check_required_path(tables, folder, rows, np.array([0.0, *feed]))


def test_programmed_feeds_are_those_of_the_file(tmp_path: Path) -> None:
    assert not _ask(tmp_path, {}, [0.01, 0.02, 0.02]).breaches
    assert "has a feed of 600 mm/min, programmed are 1200" in _ask(tmp_path, {}, [0.01, 0.01, 0.02]).breaches[0]


@pytest.mark.parametrize("one", [0.01, 0.004])
def test_one_feed_for_the_whole_cut_may_lie_below_every_programmed_one(tmp_path: Path, one: float) -> None:
    assert not _ask(tmp_path, {"mode": "constant"}, [one] * 3).breaches


@pytest.mark.parametrize("feed", [[0.01, 0.012, 0.01], [0.02, 0.02, 0.02]])
def test_one_feed_is_one_feed_and_none_that_is_higher_than_programmed(tmp_path: Path, feed: list[float]) -> None:
    assert "not one of 10 mm/s at most" in _ask(tmp_path, {"mode": "constant"}, feed).breaches[0]


def test_a_feed_that_the_job_states_may_fall_where_the_whole_cut_keeps_one(tmp_path: Path) -> None:
    stated = {"constant_mm_s": 15.0}
    assert not _ask(tmp_path, stated, [0.015] * 3).breaches
    assert "not the feed of 15 mm/s" in _ask(tmp_path, stated, [0.012] * 3).breaches[0]
    assert not _ask(tmp_path, {**stated, "mode": "constant"}, [0.012] * 3).breaches


@pytest.mark.parametrize(("allowed", "strays"), [(0.1, False), (0.05, True), (None, True)])
def test_rows_on_chords_may_stray_from_an_arc_of_the_file_by_what_the_job_allows(
    tmp_path: Path, allowed: float | None, strays: bool
) -> None:
    """Twelve chords of a half circle of 10 mm stray by 10 (1 - cos 7.5 deg) = 0.086 mm."""
    (tmp_path / "arc.nc").write_text("G21 G90 G94\nG0 X10. Y0 Z10.\nG1 Z0. F1200\nG3 X-10. Y0. I-10. J0.\nM30\n")
    angle, half = np.linspace(0.0, np.pi, 13), np.linspace(0.0, 12.0, 25)
    arc = 1e-2 * np.column_stack([np.interp(half, range(13), turn(angle)) for turn in (np.cos, np.sin, np.zeros_like)])
    position = np.vstack([[[0.01, 0.0, 0.01]], arc])
    rapid, still = np.arange(26) == 0, np.zeros(26, bool)
    rows = DrivenRows(position, np.tile([0.0, 0.0, 1.0], (26, 1)), rapid, still, np.arange(26.0))
    tables = {"toolpath": "arc.nc", "feed": {"corner_tolerance_mm": 0.0}}
    if allowed is not None:
        tables["cam"] = {"chord_tolerance_mm": allowed}
    assert bool(check_required_path(tables, tmp_path, rows, np.where(rapid, 0.0, 0.02)).breaches) == strays
