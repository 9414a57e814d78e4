"""What a folder keeps for being looked at, the scenes made of it, and the viewer in a browser."""

from __future__ import annotations

import socket
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from montecarlo_cases import cone_job

from compplan.cli import group
from compplan.errors import InputError
from compplan.io.palette import CATEGORIES, NEUTRAL
from compplan.io.tables import write_json
from compplan.planning.plan import Plan, plan_job
from compplan.reporting.charts import SEQUENTIAL
from compplan.reporting.scenes import Shape, locate_links
from compplan.reporting.view.recording import GapRecording, PlanRecording, ViewCell, read_cell, read_recording
from compplan.reporting.view.scene import (
    ERROR_BAND,
    GapScene,
    PlanScene,
    bend_arm,
    join_rows,
    locate_chain,
    paint_names,
    paint_sizes,
    pick_point,
    read_colour,
    slope_tip,
)
from compplan.reporting.writers.plan import write_plan
from compplan.reporting.writers.recording import name_rows, summarise_cell
from compplan.robot import Robot, load_robot


@pytest.fixture(scope="module")
def plan() -> Plan:
    job = cone_job()
    return plan_job(job.model_copy(update={"plan": job.plan.model_copy(update={"rotate_about_tool_axis": False})}))


@pytest.fixture(scope="module")
def folder(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plan") / "out"
    write_plan(plan, folder)
    return folder


@pytest.fixture(scope="module")
def scene(folder: Path) -> PlanScene:
    recording = read_recording(folder)
    assert isinstance(recording, PlanRecording)
    return PlanScene(recording)


def test_a_place_in_the_list_is_named_by_its_length_along_the_path_in_mm(scene: PlanScene) -> None:
    tip, way = scene.recording.tip * 1e3, next(iter(scene.sizes))
    along = np.linalg.norm(np.diff(tip[:8], axis=0), axis=1).sum()
    assert scene.name_row(7, way).endswith(f" at {along:.4g}\u00a0mm")


def test_the_folder_tells_the_deviations_of_the_plan(plan: Plan, folder: Path, scene: PlanScene) -> None:
    record = scene.recording
    cut = record.move == "cut"
    assert record.tolerance == plan.task.tolerance
    assert np.linalg.norm(record.deviation["uncorrected"][cut], axis=1).max() == pytest.approx(
        plan.before.max_deviation, abs=1e-9
    )
    assert np.nanmax(record.error_band) == pytest.approx(plan.error_band.radius[plan.error_band.cut].max(), abs=1e-9)
    softer = np.linalg.norm(record.deviation["softer"], axis=1)
    assert np.nanmax(softer) == pytest.approx(plan.mismatch.max_deviation, abs=1e-9)
    manifest = (folder / "manifest.json").read_text()
    assert "cell.json" in manifest and "deviation.csv" in manifest


def keep_cell(name: str, folder: Path) -> tuple[Robot, ViewCell]:
    """Write what a folder keeps of a robot and read it back."""
    robot = load_robot(name)
    write_json(folder / "cell.json", summarise_cell(robot), indent=None)
    return robot, read_cell(folder / "cell.json")


@pytest.mark.parametrize("name", ["kuka_kr240_rail", "staubli_tx200", "kuka_kr240"])
def test_the_links_of_the_cell_are_where_the_robot_has_them(name: str, tmp_path: Path) -> None:
    robot, cell = keep_cell(name, tmp_path)
    q = np.random.default_rng(3).uniform(-0.5, 0.5, robot.nq)
    expected, found = locate_links(robot, q), locate_chain(cell, q)
    for link, pose in found.items():
        np.testing.assert_allclose(pose, expected[link], atol=1e-8)
    assert len(cell.solids) >= 5


def test_the_arm_bends_until_its_tip_is_where_it_is_drawn(scene: PlanScene) -> None:
    cell, q = scene.recording.cell, scene.recording.q[scene.start]
    tip = locate_chain(cell, q)[cell.tcp][:3, 3] + [0.03, -0.02, 0.05]
    bent = bend_arm(cell, q, tip)
    np.testing.assert_allclose(locate_chain(cell, bent)[cell.tcp][:3, 3], tip, atol=1e-5)
    assert np.abs(bent - q).max() < 0.2
    once, often = (scene.place("uncorrected", factor) - scene.recording.tip for factor in (1.0, 40.0))
    np.testing.assert_allclose(often, 40.0 * once, atol=1e-12)


def test_colours_go_from_none_through_the_tolerance_to_twice_of_it() -> None:
    colours = paint_sizes(np.array([0.0, 1e-4, 2e-4, 9.0, np.nan]), 1e-4)
    np.testing.assert_array_equal(colours[0], read_colour(SEQUENTIAL[0][1]))
    np.testing.assert_array_equal(colours[2], read_colour(SEQUENTIAL[-1][1]))
    np.testing.assert_array_equal(colours[3], colours[2])
    np.testing.assert_array_equal(colours[4], read_colour(NEUTRAL))
    assert colours[1, 0] > 180 and colours[1, 1] > 130 and colours[1, 2] < 100  # yellow


def test_what_is_not_known_leaves_a_gap_in_the_line() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [np.nan, 0, 0], [3, 0, 0], [4, 0, 0]])
    lines = join_rows(points, np.zeros((5, 3), np.uint8))
    assert lines.points[:, :, 0].tolist() == [[0.0, 1.0], [3.0, 4.0]]


def test_a_click_means_the_point_nearest_to_the_ray_and_nothing_behind_the_eye() -> None:
    points = np.array([[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 0.0, -1.0]])
    assert pick_point(points, np.zeros(3), np.array([0.05, 0.0, 1.0])) == 0
    assert pick_point(points, np.zeros(3), np.array([0.19, 0.0, 1.0])) == 1


def test_the_part_takes_the_colour_of_the_path_beside_it_and_keeps_its_own_elsewhere(scene: PlanScene) -> None:
    record, row = scene.recording, scene.start + 40
    corners = np.vstack([record.tip[row], record.tip[row] + [0.0, 0.0, -0.4], record.tip[row] + [0.5, 0.0, 0.0]])
    part = Shape("", corners, np.array([[0, 1, 2]]), (0.8, 0.6, 0.4, 1.0), "part")
    colours = scene.paint_solid(part, "uncorrected")
    expected = paint_sizes(scene.sizes["uncorrected"][[row]], 0.5 * scene.top("uncorrected"))[0]
    np.testing.assert_array_equal(colours[0, :3], expected)
    np.testing.assert_array_equal(colours[1:], [[204, 153, 102, 255]] * 2)


def test_rings_of_the_promise_stand_off_the_path_by_its_radius(scene: PlanScene) -> None:
    record = scene.recording
    ring = scene.draw_error_band(3.0).points[:, 0]
    distance = np.linalg.norm(ring[:, None] - record.tip[None].astype(np.float32), axis=2).min(axis=1)
    assert distance.max() <= 3.0 * np.nanmax(record.error_band) + 1e-6
    assert ERROR_BAND in scene.ways


def test_a_row_tells_joints_force_deviation_and_posture(scene: PlanScene) -> None:
    told = scene.tell(scene.start + 5)
    for word in (
        "Waypoint", "without correction", "tolerance", "joint_3", "deg", "Force on the tool", "N (x, y, z",
        "Posture: shoulder",
    ):  # fmt: skip
        assert word in told


def stretch(record: PlanRecording, rows: int) -> PlanRecording:
    """Repeat a plan until it has so many rows."""
    times = -(-rows // len(record.time))
    return replace(
        record,
        time=np.arange(times * len(record.time), dtype=float), q=np.tile(record.q, (times, 1)),
        tip=np.tile(record.tip, (times, 1)), wrench=np.tile(record.wrench, (times, 1)),
        move=np.tile(record.move, times), error_band=np.tile(record.error_band, times),
        deviation={way: np.tile(values, (times, 1)) for way, values in record.deviation.items()},
    )  # fmt: skip


def test_the_longest_paths_are_thinned_and_keep_their_ends(scene: PlanScene) -> None:
    long = PlanScene(stretch(scene.recording, 50_000))
    assert len(long.rows) < 25_000
    assert {0, long.count - 1} <= set(long.rows.tolist())


def test_a_picture_costs_the_same_on_a_long_path_as_on_a_short_one(scene: PlanScene) -> None:
    pytest.importorskip("viser")
    import viser
    from viewer_traffic import count_calls, record_traffic

    from compplan.reporting.view.server import PlanViewer

    calls = {}
    for rows in (1, 50_000):
        viewer = PlanViewer(viser.ViserServer(host="127.0.0.1", port=0, verbose=False),
                            PlanScene(stretch(scene.recording, rows)))  # fmt: skip
        viewer.running = False
        viewer.show_row(viewer.row + 1)
        with record_traffic() as sent:
            calls[rows] = count_calls(lambda viewer=viewer: viewer.show_row(viewer.row + 1))
        viewer.stop()
        assert len(sent) <= 2 * len(viewer.frames) + 5
        assert sum(sent) < 10_000  # at 30 pictures a second 300 kB/s
    assert calls[50_000] < 1.1 * calls[1] < 5_000  # some microseconds each: a fifth of 1/30 s


@pytest.mark.parametrize("name", ["kuka_kr240_rail", "ur10"])
def test_the_slope_of_the_tip_is_its_difference(name: str, tmp_path: Path) -> None:
    from compplan.robot import Mimic

    robot, cell = keep_cell(name, tmp_path)
    third = cell.actuated[2]
    joints = [replace(joint, mimic=Mimic("joint_1", -0.7, 0.1)) if joint is third else joint for joint in cell.joints]
    cell = replace(cell, joints=tuple(replace(joint, mimic=joint.mimic) for joint in joints))
    names = [joint.name for joint in cell.actuated]
    assert len(names) == robot.nq - 1
    q = np.random.default_rng(1).uniform(-1, 1, len(names))

    def locate(q: np.ndarray) -> np.ndarray:
        return np.asarray(locate_chain(cell, q)[cell.tcp][:3, 3])

    steps = 1e-6 * np.eye(len(q))
    expected = np.column_stack([(locate(q + step) - locate(q - step)) / 2e-6 for step in steps])
    np.testing.assert_allclose(slope_tip(cell, locate_chain(cell, q)), expected, atol=1e-8)


def make_gap(folder: Path) -> GapScene:
    cell = keep_cell("ur10", folder)[1]
    rng = np.random.default_rng(0)
    gap = {"nominal model": rng.normal(0, 1e-3, (6, 3)), "updated model": rng.normal(0, 1e-4, (6, 3))}
    cause = np.array(["backlash, joint_2"] * 3 + ["payload, tool"] * 2 + ["not explained"])
    return GapScene(
        GapRecording(cell, np.arange(6), np.array(["static"] * 6), rng.uniform(-1, 1, (6, 6)),
                     rng.uniform(-1, 1, (6, 3)), gap, cause, np.full(6, 0.8))
    )  # fmt: skip


def test_arrows_start_at_the_measured_points_and_wear_the_colour_of_their_cause(tmp_path: Path) -> None:
    scene = make_gap(tmp_path)
    arrows = scene.draw_arrows("nominal model", 50.0)
    np.testing.assert_allclose(arrows.points[:6, 0], scene.recording.point, atol=1e-6)
    shaft = arrows.points[:6, 1] - arrows.points[:6, 0]
    np.testing.assert_allclose(shaft, 50.0 * scene.recording.gap["nominal model"], atol=1e-5)
    np.testing.assert_array_equal(arrows.colours[0, 0], read_colour(CATEGORIES[0]))
    assert scene.legend["not explained"] == NEUTRAL
    assert "backlash, joint_2" in scene.tell(0)
    assert paint_names(scene.recording.cause)[1] == scene.legend


def test_a_row_is_named_after_the_cause_whose_motion_lies_in_its_gap() -> None:
    from types import SimpleNamespace

    gap = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    motions = {
        "a": np.array([[0.9, 0, 0], [0, 0.1, 0], [0, 0, 0]]),
        "b": np.array([[0.1, 0, 0], [0, 0.7, 0], [5, 5, 0.0]]),
    }
    names, share = name_rows(SimpleNamespace(rows=np.arange(3), gap=gap, motions=motions))  # type: ignore[arg-type]
    assert names == ["a", "b", "not explained"]
    np.testing.assert_allclose(share[:2], [0.9, 0.7])


@pytest.mark.parametrize("spoiled", ["cell.json", "deviation.csv", "joints.csv"])
def test_a_folder_without_its_parts_is_refused_in_one_line(folder: Path, tmp_path: Path, spoiled: str) -> None:
    import shutil

    part = Path(shutil.copytree(folder, tmp_path / "part"))
    (part / spoiled).unlink()
    with pytest.raises(InputError, match=spoiled):
        read_recording(part)
    (part / spoiled).write_text('{"joints": 3}' if spoiled == "cell.json" else "a,b\n1,2\n")
    with pytest.raises(InputError):
        read_recording(part)


def run(*words: str) -> str:
    result = CliRunner().invoke(group, list(words))
    assert isinstance(result.exception, InputError)
    assert "\n" not in str(result.exception)
    return str(result.exception)


def test_the_command_refuses_an_empty_folder_a_taken_port_and_a_missing_viewer(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    assert "holds no plan" in run("view", str(tmp_path), "--no-open")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert f"port {port} on 127.0.0.1 is taken" in run("view", str(folder), "--no-open", "--port", str(port))
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    assert "pip install 'compplan[view]'" in run("view", str(folder), "--no-open")


def test_the_panel_names_the_worst_places_and_marks_the_tolerance(scene: PlanScene) -> None:
    from compplan.reporting.view.server import draw_colour_bar

    record, size = scene.recording, scene.sizes["uncorrected"]
    worst = scene.worst("uncorrected")
    assert size[worst[0]] == np.nanmax(size) and len(worst) == 5
    assert all(size[a] >= size[b] for a, b in pairwise(worst))
    assert min(abs(a - b) for k, a in enumerate(worst) for b in worst[:k]) >= len(size) // 20
    assert "mm at" in scene.name_row(worst[0], "uncorrected")
    assert "tolerance" in draw_colour_bar(scene.top("uncorrected"), record.tolerance)
    small = replace(record, deviation={way: 0.02 * values for way, values in record.deviation.items()})
    seen = PlanScene(small).magnification("uncorrected") * 0.02 * np.nanmax(size)
    assert seen == pytest.approx(0.1 * np.ptp(record.tip[record.move == "cut"], axis=0).max(), rel=0.1)
    assert scene.magnification("planned") == 1.0


def test_a_spindle_and_a_block_are_drawn_where_no_mesh_is_known(scene: PlanScene) -> None:
    solids = {solid.name: solid for solid in scene.recording.cell.solids}
    cutter, spindle = solids["cutter, drawn"], solids["spindle, drawn"]
    assert cutter.link == spindle.link == scene.recording.cell.tcp
    assert cutter.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-4)  # it begins at the tip
    assert spindle.vertices[:, 2].max() < cutter.vertices[:, 2].max()
    block, tip = solids["block under the path, drawn"], scene.recording.tip[scene.recording.move == "cut"]
    assert block.vertices[:, 2].max() == pytest.approx(tip[:, 2].min(), abs=1e-4)
    assert (np.ptp(block.vertices[:, :2], axis=0) > np.ptp(tip[:, :2], axis=0)).all()
