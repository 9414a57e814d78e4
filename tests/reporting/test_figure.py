"""Figures of pages: small charts in a grid, arrays that plotly.js reads, areas, drawn solids."""

from __future__ import annotations

import base64

import numpy as np
import pytest
import trimesh

from compplan.reporting.charts import Bars, Figure, add_area, draw_bars
from compplan.robot.solids import triangulate_box, triangulate_rod


@pytest.mark.parametrize("kind", ["float32", "float64", "int8", "int16", "int32"])
def test_an_array_is_read_back_as_it_was(kind: str) -> None:
    values = np.arange(6, dtype=kind).reshape(2, 3) * (1000 if kind == "int16" else 1)
    figure = Figure()
    figure.add("heatmap", z=values)
    packed = figure.to_dict()["data"][0]["z"]
    bytes_, names = base64.b64decode(packed["bdata"]), {"f4": "<f4", "f8": "<f8", "i1": "i1", "i2": "<i2", "i4": "<i4"}
    back = np.frombuffer(bytes_, names[packed["dtype"]]).reshape([int(n) for n in packed["shape"].split(", ")])
    np.testing.assert_array_equal(back, values)


def test_numbers_that_are_none_are_null_in_lists_and_keys_that_are_none_are_left_out() -> None:
    figure = Figure()
    figure.line(["a", "b"], [None, float("nan")], customdata=None)
    drawn = figure.to_dict()["data"][0]
    assert drawn["y"] == [None, None] and "customdata" not in drawn


def test_small_charts_fill_the_page_from_the_top_left_and_do_not_overlap() -> None:
    figure = Figure("abcdef", 3, gaps=(0.1, 0.2))
    layout = figure.layout
    boxes = [(layout[f"xaxis{n}"]["domain"], layout[f"yaxis{n}"]["domain"]) for n in ("", 2, 3, 4, 5, 6)]
    assert boxes[0][0][0] == 0 and boxes[0][1][1] == 1 and boxes[5][0][1] == pytest.approx(1) and boxes[5][1][0] == 0
    assert boxes[1][0][0] - boxes[0][0][1] == pytest.approx(0.1)
    assert boxes[0][1][0] - boxes[3][1][1] == pytest.approx(0.2)
    assert [note["text"] for note in layout["annotations"]] == list("abcdef")
    assert figure.line([0], [1], panel=3)["xaxis"] == "x4"
    figure.level(3.0, panel=3)
    assert layout["shapes"][0]["yref"] == "y4" and layout["shapes"][0]["xref"] == "x4 domain"


def test_charts_share_the_axes_of_their_row_or_column() -> None:
    layout = Figure("abcd", 2, shared="y").layout
    assert [layout[f"yaxis{n}"].get("matches") for n in ("", 2, 3, 4)] == [None, "y", None, "y3"]
    layout = Figure("abc", 1, shared="x").layout
    assert [layout[f"xaxis{n}"].get("matches") for n in ("", 2, 3)] == ["x3", "x3", None]


def test_the_band_is_filled_where_it_is_known_alone() -> None:
    figure = Figure()
    add_area(figure, np.arange(6.0), np.array([2, 2, np.nan, np.nan, 3, 3]), "95 % band", "red")
    assert figure.data[0]["x"].tolist() == [0, 0, 1, 1, 2, 3, 4, 4, 5, 5]
    assert figure.data[0]["y"].tolist() == [0, 2, 2, 0, 0, 0, 0, 3, 3, 0]


def test_bars_reach_to_the_ends_of_their_intervals() -> None:
    figure = draw_bars(["a", "b"], {"": Bars([1.0, 2.0], "red", [0.5, 2.0], [1.5, 4.0])}, "mm")
    spread = figure.data[0]["error_x"]
    assert spread["array"].tolist() == [0.5, 2.0] and spread["arrayminus"].tolist() == [0.5, 0.0]
    assert figure.data[0]["y"] == ["a", "b"] and figure.layout["yaxis"]["autorange"] == "reversed"


def test_drawn_boxes_and_rods_are_closed_and_face_outwards() -> None:
    low, high = np.array([-1.0, 2.0, 0.5]), np.array([3.0, 2.5, 4.0])
    box = trimesh.Trimesh(*triangulate_box(low, high), process=False)
    assert box.is_watertight and box.volume == pytest.approx(np.prod(high - low))
    assert np.allclose(box.bounds, [low, high])
    for end in ([0.4, -0.2, 1.0], [0.1, 0.2, -3.0]):
        start = np.array([0.1, 0.2, 0.3])
        rod = trimesh.Trimesh(*triangulate_rod(start, np.array(end), 0.05, sections=20), process=False)
        other = trimesh.creation.cylinder(0.05, segment=[start, end], sections=20)
        assert rod.is_watertight and rod.volume == pytest.approx(other.volume)
        assert np.allclose(rod.center_mass, other.center_mass)
