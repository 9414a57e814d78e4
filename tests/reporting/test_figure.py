"""Figures of pages: tables that are reached into, small charts in a grid, arrays that plotly.js reads."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
import trimesh

from compplan.reporting import figure as go
from compplan.reporting.reach_section import _fill_band
from compplan.robot.solids import triangulate_box, triangulate_rod


def test_a_key_reaches_into_its_table_and_what_is_none_is_left_out() -> None:
    figure = go.Figure(go.Scatter(y=[1.0, 2.0], marker_color="#123456", name=None))
    figure.update_xaxes(title_text="s, mm").update_layout(yaxis_title="mm", yaxis={"type": "log"})
    drawn = json.loads(figure.to_json())
    assert drawn["data"][0]["marker"] == {"color": "#123456"} and "name" not in drawn["data"][0]
    assert drawn["layout"]["xaxis"] == {"title": {"text": "s, mm"}}
    assert drawn["layout"]["yaxis"] == {"title": {"text": "mm"}, "type": "log"}


@pytest.mark.parametrize("kind", ["float32", "float64", "int8", "int16", "int32"])
def test_an_array_is_read_back_as_it_was(kind: str) -> None:
    values = np.arange(6, dtype=kind).reshape(2, 3) * (1000 if kind == "int16" else 1)
    packed = json.loads(go.Figure(go.Heatmap(z=values)).to_json())["data"][0]["z"]
    bytes_, names = base64.b64decode(packed["bdata"]), {"f4": "<f4", "f8": "<f8", "i1": "i1", "i2": "<i2", "i4": "<i4"}
    back = np.frombuffer(bytes_, names[packed["dtype"]]).reshape([int(n) for n in packed["shape"].split(", ")])
    np.testing.assert_array_equal(back, values)


def test_numbers_that_are_none_are_null_in_lists() -> None:
    drawn = json.loads(go.Figure(go.Scatter(x=["a", "b"], y=[None, float("nan")])).to_json())
    assert drawn["data"][0]["y"] == [None, None]


def test_small_charts_fill_the_page_from_the_top_left_and_do_not_overlap() -> None:
    figure = go.make_subplots(rows=2, cols=3, horizontal_spacing=0.1, vertical_spacing=0.2, subplot_titles="abcdef")
    boxes = [(figure.layout[f"xaxis{n}"].domain, figure.layout[f"yaxis{n}"].domain) for n in ("", 2, 3, 4, 5, 6)]
    assert boxes[0][0][0] == 0 and boxes[0][1][1] == 1 and boxes[5][0][1] == pytest.approx(1) and boxes[5][1][0] == 0
    assert boxes[1][0][0] - boxes[0][0][1] == pytest.approx(0.1)
    assert boxes[0][1][0] - boxes[3][1][1] == pytest.approx(0.2)
    assert [note.text for note in figure.layout.annotations] == list("abcdef")
    figure.add_trace(go.Scatter(y=[1]), row=2, col=1).add_hline(y=3.0, line={"width": 1}, row=2, col=1)
    assert figure.data[0].xaxis == "x4" and figure.layout.shapes[0].yref == "y4"


def test_charts_of_a_row_share_their_axis() -> None:
    figure = go.make_subplots(rows=2, cols=2, shared_yaxes=True)
    assert figure.layout.yaxis2.matches == "y" and figure.layout.yaxis4.matches == "y3"
    assert figure.layout.yaxis.matches is None and figure.layout.yaxis3.matches is None


def test_the_band_is_filled_where_it_is_known_alone() -> None:
    figure = go.Figure(go.Scatter(x=[0, 1, 2, 3, 4, 5], y=[2, 2, np.nan, np.nan, 3, 3], name="true tip, 95 %"))
    _fill_band(figure)
    fill = figure.data[0]
    assert fill.x.tolist() == [0, 0, 1, 1, 2, 3, 4, 4, 5, 5] and fill.y.tolist() == [0, 2, 2, 0, 0, 0, 0, 3, 3, 0]
    assert figure.data[1].showlegend is False and fill.legendgroup == figure.data[1].legendgroup


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
