from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from compplan.errors import InputError, ShapeError
from compplan.toolpath.reading import read_toolpath
from compplan.toolpath.toolpath import Toolpath, check_toolpath, place_toolpath, resample_toolpath, write_toolpath

HEADER = "x_mm,y_mm,z_mm,i,j,k,feed_mm_s,rapid\n"


def make(n: int = 20, seed: int = 0) -> Toolpath:
    rng = np.random.default_rng(seed)
    axis = Rotation.from_rotvec(rng.normal(scale=0.3, size=(n, 3))).apply([0.0, 0.0, 1.0])
    rapid = np.arange(n) % 7 == 0
    return Toolpath(rng.normal(size=(n, 3)), axis, np.where(rapid, 0, 0.02), rapid, rng.normal(size=(n, 6)))


def read(tmp_path: Path, text: str) -> Toolpath:
    (tmp_path / "path.csv").write_text(text)
    return read_toolpath(tmp_path / "path.csv")


def test_a_toolpath_comes_back_as_it_was_written(tmp_path: Path) -> None:
    toolpath = make()
    write_toolpath(toolpath, tmp_path / "t.csv")
    again = read_toolpath(tmp_path / "t.csv")
    for name in ("position", "axis", "feed", "rapid", "wrench"):
        assert np.abs(np.subtract(getattr(again, name), getattr(toolpath, name), dtype=float)).max() < 1e-8


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (HEADER + "0,0,0,0,0,1,5,0\n", r"toolpath has 1 waypoints, needs at least 2"),
        (HEADER + "0,0,0,0,0,1,5,0\n0,0,0,0,0,1,5,0\n", "zero length"),
        (HEADER + "0,0,0,0,0,1,5,0\n1,0,0,0,0,1,0,0\n", r"csv:3: feed is 0 mm/s, expected more than 0"),
        (HEADER + "0,0,0,0,0,1,5,0\n1,0,0,0,0,1,,0\n", r"csv:3: column 'feed_mm_s' is empty here"),
        (HEADER + "0,0,0,0,0,1,5,0\n1,0,0,0,0,2,5,0\n", r"csv:3: tool axis \(i, j, k\) has length 2"),
        (HEADER + "0,0,0,0,0,1,5,0\n1,0,0,0,0,1,5,2\n", r"csv:3: rapid is 2, expected 0 or 1"),
        (HEADER + "0,0,0,0,0,1,5,0\n1,0,0,0,0,1,5,1\n", r"zero cutting length: every move is rapid"),
        (HEADER + "0,0,nan,0,0,1,5,0\n1,0,0,0,0,1,5,1\n", r"csv:2: column 'z_mm' is empty"),
        ("x_m,y_m,z_m,feed_mm_s\n0,0,0,1\n840,0,0,1\n", r"toolpath spans 840 m; columns are read in m, name them x_mm"),
        ("x_mm,y_mm,z_mm\n0,0,0\n1,0,0\n", r"missing column feed_mm_s: cutting moves need a feed"),
    ],
)
def test_each_mistake_in_a_toolpath_has_its_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read(tmp_path, text)


def test_arrays_of_wrong_shape_are_refused_and_right_ones_are_read_only() -> None:
    with pytest.raises(ShapeError, match="toolpath axis has shape"):
        Toolpath(np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(2), np.zeros(2, bool))
    with pytest.raises(ValueError, match="read-only"):
        make().position[0, 0] = 1.0


@given(st.integers(0, 1000), st.floats(0.01, 3.0))
@settings(max_examples=25, deadline=None)
def test_dividing_keeps_corners_length_and_the_step_limit(seed: int, step: float) -> None:
    toolpath = make(8, seed)
    fine = resample_toolpath(toolpath, step)
    assert fine.steps[~fine.rapid[1:]].max() <= step * (1 + 1e-9)
    assert fine.cutting_length == pytest.approx(toolpath.cutting_length)
    for corner in toolpath.position:
        assert np.linalg.norm(fine.position - corner, axis=1).min() < 1e-12
    assert np.abs(np.linalg.norm(fine.axis, axis=1) - 1).max() < 1e-12
    assert fine.rapid.sum() == toolpath.rapid.sum()


def test_between_two_waypoints_the_tool_axis_turns_evenly() -> None:
    axis = np.array([[0, 0, 1.0], [1.0, 0, 0]])
    fine = resample_toolpath(Toolpath(np.array([[0, 0, 0], [1.0, 0, 0]]), axis, np.ones(2), np.zeros(2, bool)), 0.1)
    turns = np.degrees(np.arccos(np.sum(fine.axis[:-1] * fine.axis[1:], axis=1)))
    assert len(fine) == 11 and turns == pytest.approx(np.full(10, 9.0))


def test_dividing_by_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="must be greater than 0"):
        resample_toolpath(make(), 0.0)


def test_a_toolpath_that_is_not_from_a_file_names_the_waypoint() -> None:
    position = np.array([[0, 0, 0], [np.nan, 0, 0]])
    toolpath = Toolpath(position, np.tile([0.0, 0, 1], (2, 1)), np.ones(2), np.zeros(2, bool))
    with pytest.raises(InputError, match="position is not a finite number, at waypoint 1"):
        check_toolpath(toolpath)


def test_an_unknown_kind_of_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    with pytest.raises(InputError, match=r"by its ending '.step'; expected gcode, apt, krl"):
        read_toolpath(tmp_path / "part.step")


def test_placing_turns_positions_axes_and_wrenches_together() -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    pose[:3, 3] = [1, 2, 3]
    toolpath = Toolpath(np.eye(3), np.tile([1.0, 0, 0], (3, 1)), np.ones(3), np.zeros(3, bool), np.eye(3, 6))
    placed = place_toolpath(toolpath, pose)
    assert placed.frame == "base"
    assert placed.position[0] == pytest.approx([1, 3, 3])
    assert placed.axis[0] == pytest.approx([0, 1, 0])
    assert placed.wrench is not None and placed.wrench[0] == pytest.approx([0, 1, 0, 0, 0, 0])
