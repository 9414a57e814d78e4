"""What a folder keeps for being looked at, the scenes made of it, and the viewer in a browser."""

from __future__ import annotations

import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from montecarlo_cases import cone_job

from compplan.cli import group
from compplan.controllers.writers import joint_convention
from compplan.errors import InputError
from compplan.io.palette import NEUTRAL
from compplan.planning.plan import Plan, plan_job
from compplan.reporting.charts import SEQUENTIAL
from compplan.reporting.scenes import locate_links
from compplan.reporting.view.scene import (
    PlanScene,
    join_rows,
    paint_sizes,
    pick_point,
    read_colour,
)
from compplan.reporting.writers.plan import write_plan
from compplan.reporting.writers.recording import ROWS, PlanRecording, place_arm, read_recording
from compplan.robot import load_robot


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


def test_the_folder_tells_the_deviations_of_the_plan(plan: Plan, folder: Path, scene: PlanScene) -> None:
    record = scene.recording
    cut = record.move == "cut"
    assert record.tolerance == plan.task.tolerance
    assert np.linalg.norm(record.deviation["uncorrected"][cut], axis=1).max() == pytest.approx(
        plan.before.max_deviation, abs=1e-9
    )
    assert np.nanmax(record.error_band) == pytest.approx(plan.error_band.radius[plan.error_band.cut].max(), abs=1e-9)
    manifest = (folder / "manifest.json").read_text()
    assert "view.npz" in manifest and "deviation.csv" in manifest


@pytest.mark.parametrize("name", ["kuka_kr240_rail", "staubli_tx200", "kuka_kr240"])
def test_the_links_of_the_cell_are_where_the_robot_has_them(name: str) -> None:
    robot = load_robot(name)
    q = np.random.default_rng(3).uniform(-0.5, 0.5, (4, robot.nq))
    for link, poses in joint_convention.locate_links(robot, q).items():
        for row, pose in enumerate(poses):
            np.testing.assert_allclose(pose, locate_links(robot, q[row])[link], atol=1e-8)
    assert len(place_arm(robot)) >= 5


def test_the_recording_holds_the_poses_of_the_rows_of_joints_csv(plan: Plan, scene: PlanScene) -> None:
    record, row = scene.recording, scene.start + 7
    q = np.vstack([plan.approach.q, plan.q, plan.retract.q])[record.row[row]]
    for link, pose in scene.pose_links(row).items():
        np.testing.assert_allclose(pose, locate_links(plan.robot, q)[link], atol=1e-6)
    np.testing.assert_allclose(record.joints[row], np.degrees(q), atol=1e-9)


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


def test_a_row_tells_joints_force_deviation_and_posture(scene: PlanScene) -> None:
    told = scene.tell(scene.start + 5)
    for word in (
        "Row", "without correction", "tolerance", "q3", "deg", "Force on the tool", "N (x, y, z",
        "Posture: shoulder",
    ):  # fmt: skip
        assert word in told


def stretch(record: PlanRecording, rows: int) -> PlanRecording:
    """Repeat a plan until it has so many rows."""
    times = -(-rows // len(record.time))
    return replace(
        record,
        time=np.arange(times * len(record.time), dtype=float), joints=np.tile(record.joints, (times, 1)),
        tip=np.tile(record.tip, (times, 1)), force=np.tile(record.force, (times, 1)), row=np.tile(record.row, times),
        poses=np.tile(record.poses, (times, 1, 1, 1)),
        move=np.tile(record.move, times), error_band=np.tile(record.error_band, times),
        deviation={way: np.tile(values, (times, 1)) for way, values in record.deviation.items()},
    )  # fmt: skip


def test_a_picture_costs_the_same_on_a_long_path_as_on_a_short_one(scene: PlanScene) -> None:
    pytest.importorskip("viser")
    import viser
    from viewer_traffic import count_calls, record_traffic

    from compplan.reporting.view.server import PlanViewer

    calls = {}
    for rows in (1, ROWS):
        viewer = PlanViewer(viser.ViserServer(host="127.0.0.1", port=0, verbose=False),
                            PlanScene(stretch(scene.recording, rows)))  # fmt: skip
        viewer.running = False
        viewer.show_row(viewer.row + 1)
        with record_traffic() as sent:
            calls[rows] = count_calls(lambda viewer=viewer: viewer.show_row(viewer.row + 1))
        viewer.stop()
        assert len(sent) <= 2 * len(viewer.frames) + 5
        assert sum(sent) < 10_000  # at 30 pictures a second 300 kB/s
    assert calls[ROWS] < 1.1 * calls[1] < 5_000  # some microseconds each: a fifth of 1/30 s


def test_a_folder_without_its_recording_or_with_a_damaged_one_is_refused_in_one_line(
    folder: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"view\.npz"):
        read_recording(tmp_path)
    content = (folder / "view.npz").read_bytes()
    for damaged in (b"", b"a,b\n1,2\n", content[:2000], content.replace(b"facts.npy", b"fects.npy")):
        (tmp_path / "view.npz").write_bytes(damaged)
        with pytest.raises(InputError, match="is not what compplan writes"):
            read_recording(tmp_path)


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


def test_the_worst_place_is_found_and_a_deviation_is_magnified_so_that_it_is_seen(scene: PlanScene) -> None:
    record, size = scene.recording, scene.sizes["uncorrected"]
    worst = scene.find_worst("uncorrected")
    assert size[worst] == np.nanmax(size)
    assert scene.top("uncorrected") >= 2.0 * record.tolerance
    small = replace(record, deviation={way: 0.02 * values for way, values in record.deviation.items()})
    seen = PlanScene(small).magnification("uncorrected") * 0.02 * np.nanmax(size)
    assert seen == pytest.approx(0.1 * np.ptp(record.tip[record.move == "cut"], axis=0).max(), rel=0.1)
    assert scene.magnification("planned") == 1.0
