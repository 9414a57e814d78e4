"""Pages: self-contained, thin, honest about limits; robots drawn where they stand."""

from __future__ import annotations

import base64
import gzip
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from compplan.errors import ShapeError
from compplan.io.quantities import format_length
from compplan.planning.approach import AuxiliaryMotion
from compplan.planning.compare import Comparison
from compplan.planning.result import Plan
from compplan.planning.sampling import Between
from compplan.planning.task import Command, PlanTask
from compplan.planning.timing import state_timing
from compplan.reporting.along_path import Stations, chart_lines, chart_strategies
from compplan.reporting.charts import Figure, thin_path, thin_rows
from compplan.reporting.compare import render_comparison
from compplan.reporting.page import Cell, Chart, DataTable, Section, Summary, render_page
from compplan.reporting.plan_page import mark_force, write_plan_page
from compplan.reporting.provenance import describe_robot
from compplan.reporting.scenes import draw_cell, locate_links, place_meshes, place_shapes
from compplan.robot import load_robot
from compplan.simulation.simulated_robot import EXACT_EVALUATION, Evaluation, build_simulated_robot
from compplan.statics.chain import build_chain, locate_frames
from compplan.statics.elastic import solve_equilibrium
from compplan.toolpath.toolpath import Toolpath

JOB = """\
# A small circle. Assumed: where the
# part stands. Nothing else.
schema = 1
name = "Small circle"
robot = "kuka_kr270"
[toolpath]
generator = "circle"
radius_mm = 30.0
feed_mm_s = 20.0
waypoints = 60
[part]
position_mm = [1700.0, 0.0, 900.0]
[process]
model = "constant"
force_N = [300.0, 0.0, -600.0]  # assumed
frame = "base"
"""


def make_plan(n: int = 400, name: str = "kuka_kr270") -> Plan:
    """Bend a real robot along a path in joint space; the corrections leave a ten-thousandth."""
    robot = load_robot(name)
    chain = build_chain(robot)
    angle = np.linspace(0, 2 * np.pi, n)
    q = np.tile([0.2, 0.6, -1.6, 0.1, 1.0, 0.3], (n, 1))
    q[:, 0] += 0.1 * np.sin(angle)
    q[:, 1] += 0.1 * np.cos(angle)
    frames, wrench = locate_frames(chain, q), np.tile([440.0, 1370.0, -635.0, 0.0, 0.0, 0.0], (n, 1))
    away = solve_equilibrium(chain, q, wrench).position - frames.tcp_position
    rapid, time, rotation = np.arange(n) < n // 20, np.linspace(0.0, 60.0, n), frames.tcp_rotation
    nominal = Toolpath(frames.tcp_position + away, -rotation[:, :, 2], np.full(n, 0.05), rapid, wrench, "base")
    task = PlanTask(
        robot=robot, chain=chain, nominal=nominal, rotation=rotation, wrench=wrench, compensated=~rapid, q_start=q,
        configuration={}, missed=np.zeros(n, bool), step_time=np.diff(time), velocity_limits=robot.velocity_limits,
        acceleration_limits=robot.acceleration_limits, max_correction=1e-2, tolerance=1e-4, spin_free=True,
    )  # fmt: skip
    timing = replace(state_timing(task, q, time), feed=np.full(n, 0.05), share=np.ones(n))
    before = Evaluation(nominal.position + away, rotation, away, np.zeros(n), ~rapid)
    after = replace(before, position=nominal.position + 1e-4 * away, deviation=1e-4 * away)
    nowhere = AuxiliaryMotion(*(np.zeros(shape) for shape in ((0, 6), 0, (0, 6), (0, 3), (0, 6), 0)))
    return Plan(
        name="Circle <test>", task=task, strategy="nlp", command=Command(q), timing=timing, before=before, after=after,
        approach=nowhere, retract=nowhere,
        between=Between(*np.zeros((2, n - 1))),
        motion=None,
    )  # fmt: skip


def page_data(html: str) -> dict[str, list[dict[str, object]]]:
    """Read the charts back out of a page."""
    found = re.search(r'<script type="text/plain" id="page-data">(.*?)</script>', html, re.S)
    assert found
    return json.loads(gzip.decompress(base64.b64decode(found.group(1))))


def own_part(html: str) -> str:
    """Return a page without plotly's script."""
    return re.sub(r'<script type="text/plain" id="plotly-library">.*?</script>', "", html, flags=re.S)


def draw_line(name: str = "") -> Figure:
    figure = Figure()
    figure.line([0, 1], [1, 2], name)
    return figure


LEDE = Summary("Lede.")


def test_a_page_asks_the_network_for_nothing_and_holds_plotly_once_where_there_are_charts() -> None:
    chart = Chart(draw_line(), "A line.")
    many, none = (render_page("T", LEDE, [Section("S", blocks)]) for blocks in ([chart, chart, chart], ["Text."]))
    assert not re.search(
        r'(src|href)\s*=\s*"(?!#|data:)|@import|url\(|https?://|fetch\(|XMLHttpRequest', own_part(many)
    )
    assert 0.6e6 < len(many) < 1.0e6 and len(none) < 30_000
    assert len(page_data(many)["charts"]) == 3
    assert "showSendToCloud: false" in many  # plotly.js 4 has a button that uploads a chart


def test_a_table_shows_units_digits_dashes_and_tones_and_refuses_a_row_of_another_length() -> None:
    table = DataTable(
        ["joint", "margin [deg]", "x [mm, 5]"], [["q1", Cell(1.2345, "assumed"), 1.23456], ["q2", None, 1]]
    )
    html = render_page("T", LEDE, [Section("S", [table])])
    for text in ('<span class="unit">deg</span>', "1.23</td>", "1.2346</td>", "assumed", "–</td>"):
        assert text in html
    with pytest.raises(ValueError, match="zip"):
        render_page("T", LEDE, [Section("S", [DataTable(["a"], [["x", "y"]])])])


def test_text_from_outside_cannot_become_markup() -> None:
    evil = "<script>alert(1)</script>"
    chart = Chart(draw_line(evil), evil)
    html = own_part(render_page(evil, Summary(evil), [Section(evil, [evil, DataTable([evil], [[evil]]), chart])]))
    assert evil not in html
    assert page_data(html)["charts"][0]["data"][0]["name"] == evil  # type: ignore[index]


def test_the_foot_names_grade_sources_and_what_was_assumed() -> None:
    robot = load_robot("kuka_kr270")
    html = render_page("T", LEDE, [], provenance=describe_robot(robot, assumptions=["force level assumed"]))
    assert "from published data, not measured on your robot" in html
    assert "Mamedov 2018" in html
    assert "Assumed, not measured" in html
    assert "force level assumed" in html
    assert any("masses" in line for line in describe_robot(robot).assumptions)


def test_thinning_keeps_the_ends_and_every_extreme() -> None:
    rng = np.random.default_rng(3)
    signals = rng.normal(size=(50_000, 3)).cumsum(axis=0)
    signals[31_234, 1] = 1e4
    signals[77, 2] = -1e4
    rows = thin_rows(signals, 1000)
    assert len(rows) < 1010
    assert {0, 49_999, 31_234, 77} <= set(rows.tolist())
    assert np.array_equal(signals[rows].max(axis=0), signals.max(axis=0))
    assert np.array_equal(signals[rows].min(axis=0), signals.min(axis=0))


def test_a_thinned_path_keeps_points_all_along_it() -> None:
    path = np.column_stack([np.linspace(0, 1, 9000) ** 3, np.zeros(9000), np.zeros(9000)])
    rows = thin_path(path, np.ones(9000), 300)
    assert np.diff(path[rows, 0]).max() < 0.03


def test_the_tool_of_a_job_takes_the_place_of_the_folders_tool() -> None:
    robot = load_robot("staubli_tx200")
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0.0, 0.2]
    mounted = robot.with_tool(pose)
    q = np.zeros(robot.nq)
    shapes = place_shapes(mounted, q)
    assert "tool0" in {shape.link for shape in place_shapes(robot, q)}
    assert "tool0" not in {shape.link for shape in shapes}
    tip = locate_links(mounted, q)[mounted.tcp][:3, 3]
    assert np.linalg.norm(shapes[-1].vertices - tip, axis=1).min() < 0.03


def test_a_wrong_number_of_joints_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"q has shape \(5,\), expected \(6,\)"):
        place_shapes(load_robot("kuka_kr270"), np.zeros(5))


def test_mesh_visuals_are_drawn_where_their_file_is_at_hand(tmp_path: Path) -> None:
    trimesh.creation.box((0.2, 0.2, 0.2)).export(tmp_path / "part.stl")
    robot = load_robot("kuka_kr270")
    box = '<box size="0.84 0.8 0.06"/>'
    urdf = robot.urdf.replace(f"<visual><origin xyz=\"0 0 0.03\"/><geometry>{box}", "<visual><geometry>"
                              '<mesh filename="package://any/part.stl" scale="2 2 2"/>')  # fmt: skip
    assert urdf != robot.urdf
    here = place_shapes(replace(robot, urdf=urdf, folder=tmp_path), np.zeros(6))
    gone = place_shapes(replace(robot, urdf=urdf, folder=tmp_path / "nowhere"), np.zeros(6))
    assert len(here) == len(gone) + 1
    assert np.allclose(np.ptp(here[0].vertices, axis=0), 0.4)


def test_the_page_of_a_plan_says_what_it_reaches(tmp_path: Path) -> None:
    plan = make_plan(4000)
    write_plan_page(plan, tmp_path / "report.html")
    html = (tmp_path / "report.html").read_text()
    size = plan.before.max_deviation
    for value in (size, 1e-4 * size):
        assert f">{format_length(value)}</td>" in html
    assert "Circle &lt;test&gt;" in html and len(html) < 1.5e6
    assert "Infeasible" not in own_part(html)
    assert len(page_data(html)["charts"]) >= 7


def test_a_real_plan_and_comparison_get_their_pages_with_what_their_job_assumes(tmp_path: Path) -> None:
    from compplan.job.job import load_job
    from compplan.planning.plan import plan_job
    from compplan.studies.job_study import compare_job

    (tmp_path / "job.toml").write_text(JOB)
    plan = plan_job(load_job(tmp_path / "job.toml"))
    write_plan_page(plan, tmp_path / "report.html")
    html = own_part((tmp_path / "report.html").read_text())
    assert f">{format_length(plan.after.max_deviation)}</td>" in html
    assert format_length(plan.before.max_deviation) in html
    assert "job: Assumed: where the part stands." in html
    assert "job: force_N: assumed" in html
    assert plan.task.start is not None
    assert plan.task.start.posture_choice is not None
    assert "How the tool turns along the path" in html
    assert "errors of 10 % of the wrench" in html
    assert f"<dd>{EXACT_EVALUATION}</dd>" in html
    comparison = compare_job(plan.job)
    html = own_part(render_comparison(comparison))
    for cell in comparison.cells:
        for run in comparison.evaluations[cell.name].values():
            assert f"{format_length(run.rms_deviation)}  ({format_length(run.max_deviation)})" in html


def test_deviations_on_rapid_moves_count_for_nothing(tmp_path: Path) -> None:
    plan, tables = make_plan(), []
    wild = plan.after.deviation.copy()
    wild[~plan.after.cut] = 1.0
    for one in (plan, replace(plan, after=replace(plan.after, deviation=wild))):
        write_plan_page(one, tmp_path / "report.html")
        tables.append(re.findall(r"<tr>.*?</tr>", own_part((tmp_path / "report.html").read_text())))
    assert tables[0] == tables[1] and len(tables[0]) > 20


def test_an_infeasible_plan_says_so_first_and_lists_its_waypoints(tmp_path: Path) -> None:
    plan = make_plan()
    failures = {**dict.fromkeys(range(100, 121), "position limit of joint_5"), 200: "correction limit"}
    command = replace(plan.command, status="infeasible", failures=failures)
    write_plan_page(replace(plan, command=command), tmp_path / "report.html")
    html = own_part((tmp_path / "report.html").read_text())
    assert "Infeasible: 22 of 400 waypoints fail (correction limit, position limit of joint_5)" in html
    rows = re.findall(r"<tr><td[^>]*>(\d+)</td><td[^>]*>(\d+)</td>", html)
    assert rows == [("100", "120"), ("200", "200")]


def test_every_waypoint_that_fails_is_marked_however_many_there_are() -> None:
    length, marked = np.linspace(0.0, 1.2, 3000), np.arange(0, 3000, 7)
    stations = Stations(length, np.linspace(0.0, 60.0, 3000), marked, np.zeros((0, 2)))
    figure = chart_lines(stations, {"deviation": np.ones(3000)}, "mm", "deviation", "").figure
    bands = np.array([[band["x0"], band["x1"]] for band in figure.layout["shapes"]])
    places = 1e3 * length[marked]
    covered = ((bands[:, :1] <= places + 1e-9) & (places - 1e-9 <= bands[:, 1:])).any(axis=0)
    assert covered.all()
    assert len(bands) <= 240
    few = replace(stations, marked=np.array([2999]))
    assert len(chart_lines(few, {"deviation": np.ones(3000)}, "mm", "deviation", "").figure.layout["shapes"]) == 1


def test_a_lowered_feed_is_named_with_its_place_and_the_limiting_joint(tmp_path: Path) -> None:
    plan = make_plan()
    run = plan.timing
    feed, share, velocity, limiting = run.feed.copy(), run.share.copy(), run.velocity.copy(), run.limiting.copy()
    feed[150:170], share[150:170], limiting[150:170] = 0.02, 0.4, 3
    velocity[150:170, 3] = plan.robot.velocity_limits[3]
    by_velocity = np.ones(len(feed), bool)
    slow = replace(run, feed=feed, share=share, velocity=velocity, limiting=limiting, by_velocity=by_velocity)
    write_plan_page(replace(plan, timing=slow), tmp_path / "report.html")
    html = own_part((tmp_path / "report.html").read_text())
    assert "The feed is lowered at 20 waypoints (150-169), down to 40 %" in html and "limit of joint_4" in html
    assert re.search(r">150</td><td[^>]*>169</td>", html)


def test_the_page_of_fifty_thousand_waypoints_stays_small_and_keeps_its_peak(tmp_path: Path) -> None:
    plan = make_plan(50_000)
    after = plan.after.deviation.copy()
    after[23_456] = [0.0, 0.0, 2e-4]
    write_plan_page(replace(plan, after=replace(plan.after, deviation=after)), tmp_path / "report.html")
    file = tmp_path / "report.html"
    assert file.stat().st_size < 2e6
    name = "corrected, on the model"
    chart = next(chart for chart in page_data(file.read_text())["charts"] if name in names_of(chart))
    planned = next(trace["y"] for trace in chart["data"] if trace["name"] == name)  # type: ignore[union-attr]
    values = np.frombuffer(base64.b64decode(planned["bdata"]), planned["dtype"])
    assert np.nanmax(values) == pytest.approx(0.2, rel=1e-6)


def names_of(chart: dict[str, Any]) -> set[str]:
    return {trace.get("name", "") for trace in chart["data"]}


def test_thirteen_strategies_get_thirteen_charts_on_the_same_axes() -> None:
    line = np.linspace(1.0, 2.0, 11)
    stations = Stations(line, line, np.zeros(0, int), np.zeros((0, 2)))
    panels = {f"strategy {k}": {"compliance": k * line, "wrench": 0.5 * k * line} for k in range(13)}
    figure = chart_strategies(stations, panels, 0.1).figure
    drawn = [trace["xaxis"] for trace in figure.data]
    assert len(set(drawn)) == 13 and max(map(drawn.count, drawn)) == 2
    assert sum(trace["showlegend"] for trace in figure.data) == 2
    axes = [figure.layout[key] for key in figure.layout if key.startswith("yaxis")]
    np.testing.assert_allclose([axis["range"] for axis in axes], np.tile([0.0, 1.06 * 24.0], (13, 1)))


def test_the_page_of_a_comparison_names_the_closest_strategy_in_each_cell() -> None:
    plan = make_plan(200)
    left = {
        "as modelled": {"none": 1.0, "mirror": 0.01, "nlp": 1e-5},
        "compliance x 1.2": {"none": 1.2, "mirror": 0.19, "nlp": 0.2},
    }
    away = plan.before.deviation
    runs = {cell: {name: replace(plan.before, deviation=share * away) for name, share in own.items()}
            for cell, own in left.items()}  # fmt: skip
    cells = tuple(build_simulated_robot(plan.robot, name) for name in left)
    commands = dict.fromkeys(("none", "mirror", "nlp"), plan.command)
    comparison = Comparison("Job", plan.task, cells, commands, runs)
    html = own_part(render_comparison(comparison))
    assert "Without extra sensors: plan with the strategy optimised (nlp)" in html
    rows = re.findall(r"<tr>(.*?)</tr>", html)
    closest = [row for row in rows if '<td class=" good">' in row]
    assert len(closest) == 2 and all(row.count('<td class=" good">') == 1 for row in closest)
    assert "mirror" in closest[0] and closest[0].index("good") < closest[1].index("good")  # softer cell, then the model


def test_moves_with_force_are_told_from_those_without():
    wrench = np.zeros((6, 6))
    wrench[2:4, 2] = 100.0
    cut = np.array([False, True, True, True, True, True])
    pushed = mark_force(wrench, cut)
    assert pushed.tolist() == [False, False, True, True, True, False]  # a move carries force if either end does


def test_meshes_of_a_cell_are_drawn_where_they_stand():
    robot = load_robot("kuka_kr270")
    q = np.array([0.3, -0.2, 0.4, 0.1, 0.6, 0.2])
    box, ball = trimesh.creation.box((0.2, 0.2, 0.2)), trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    part, tool = place_meshes(robot, q, [("part", "", box), ("tool", robot.flange, ball)])
    assert part.vertices == pytest.approx(np.asarray(box.vertices))
    assert tool.vertices.mean(axis=0) == pytest.approx(locate_links(robot, q)[robot.flange][:3, 3], abs=1e-9)
    kinds = np.repeat([0, 1, 2], 5)
    path = np.column_stack([np.linspace(1.0, 1.2, 15), np.zeros(15), np.ones(15)])
    figure = draw_cell(robot, np.tile(q, (15, 1)), path, around=[part, tool], kinds=kinds)
    names = [trace["name"] for trace in figure.data]
    assert names == ["kuka_kr270", "part", "tool", "cut with force", "cut without force", "rapid"]


def test_only_plot_methods_touch_the_users_figures_and_nothing_their_backend() -> None:
    """A notebook that writes a plan keeps its inline pictures."""
    root = Path(__file__).parents[2] / "compplan"
    texts = {str(file.relative_to(root)): file.read_text(encoding="utf-8") for file in root.rglob("*.py")}
    told = {"io/display.py", "io/process_settings.py", "planning/timing.py"}  # the others put it off
    assert {name for name, text in texts.items() if "pyplot" in text} == told
    assert not [name for name, text in texts.items() if "matplotlib.use(" in text]
