from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from compplan.errors import InputError
from compplan.process.engagement import Cutter, Engagement
from compplan.process.engagement_search import find_engagement
from compplan.process.stock import build_block, build_height_map, read_mesh

BLOCK = np.array([[-50.0, -50.0, -20.0], [50.0, 50.0, 0.0]])  # mm
FLAT, BALL = Cutter(5e-3, 0.03), Cutter(3e-3, 0.02, 3e-3)


def straight(start: tuple[float, float, float], end: tuple[float, float, float], step: float = 1.0) -> np.ndarray:
    count = round(np.linalg.norm(np.subtract(end, start)) / step)
    return np.array(start) + np.linspace(0, 1, count + 1)[:, None] * np.subtract(end, start)


def engage(cutter: Cutter, path: np.ndarray, cutting: np.ndarray | None = None) -> Engagement:
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    every = np.ones(len(path), bool) if cutting is None else cutting
    return find_engagement(cutter, path * 1e-3, every, block)


def test_a_slot_is_engaged_on_the_whole_front() -> None:
    found = engage(FLAT, straight((-60, 0.3, -2), (0, 0.3, -2)))
    assert found.axial[-1] == pytest.approx(2e-3, rel=1e-6)
    assert found.radial[-1] == pytest.approx(10e-3, rel=1e-3)
    assert np.degrees(found.arc[-1]) == pytest.approx([-90, 90], abs=0.1)
    assert found.section[-1] == pytest.approx(20e-6, rel=2e-3)


@pytest.mark.parametrize(("y", "arc"), [(-50.0, (0.0, 90.0)), (50.0, (-90.0, 0.0)), (-54.0, (53.13, 90.0))])
def test_a_side_cut_enters_where_the_wall_stands(y: float, arc: tuple[float, float]) -> None:
    found = engage(FLAT, straight((-60, y, -3), (0, y, -3)))
    assert np.degrees(found.arc[-1]) == pytest.approx(arc, abs=0.5)
    assert found.radial[-1] == pytest.approx(5e-3 if abs(y) == 50 else 1e-3, rel=0.01)
    assert found.axial[-1] == pytest.approx(3e-3, rel=1e-6)


def test_in_the_air_above_the_stock_and_in_a_slot_that_is_cut_there_is_no_engagement() -> None:
    there = straight((-60, 0, -2), (60, 0, -2))
    path = np.vstack([straight((-60, 0, 1), (60, 0, 1)), there, there[::-1], straight((-60, 0, -2), (-60, 0, 5))])
    found = engage(FLAT, path)
    again = np.arange(len(path)) >= 2 * len(there)
    assert not found.touches[: len(there)].any()
    assert not found.touches[again].any()
    assert found.touches[len(there) : 2 * len(there)].any()


def test_a_second_pass_meets_only_what_the_first_left() -> None:
    first, second = straight((-60, 0, -2), (60, 0, -2)), straight((60, 2, -2), (-60, 2, -2))
    found = engage(FLAT, np.vstack([first, second]))
    middle = len(first) + 60
    assert found.radial[middle] == pytest.approx(2e-3, rel=0.01)
    assert np.degrees(found.arc[middle]) == pytest.approx([-90, np.degrees(np.arcsin(-3 / 5))], abs=0.5)


def test_the_volume_of_all_moves_is_the_volume_of_the_swept_pocket() -> None:
    rows, z = [(-30.0, -30.0, 2.0)], -1.5
    for number, y in enumerate(np.arange(-30, 31, 6.0)):
        rows += [(x, y, z) for x in np.arange(-30, 31, 1.0)[:: -1 if number % 2 else 1]]
    path = np.vstack([straight(rows[0], rows[1], 0.5), rows[2:]])
    found = engage(FLAT, path)
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1) * 1e-3
    swept = (60 * 60 + 4 * 60 * 5 + np.pi * 25) * 1.5e-9
    assert float((found.section[1:] * lengths).sum()) == pytest.approx(swept, rel=0.02)


def test_a_ball_cuts_the_segment_of_a_circle() -> None:
    found = engage(BALL, straight((-60, 0, -1), (0, 0, -1)))
    segment = 9 * np.arccos(2 / 3) - 2 * np.sqrt(5)
    assert found.section[-1] == pytest.approx(segment * 1e-6, rel=0.01)
    assert found.axial[-1] == pytest.approx(1e-3, rel=0.01)


def silhouette(cutter: Cutter, axis: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Lowest point [mm] of a leaning cutter that is seen along x, its tip at 0; from points of its surface."""
    u, turn = np.linspace(0, 2 * np.pi, 1001), np.linspace(0, np.pi / 2, 120)
    radius, corner = 1e3 * cutter.radius, 1e3 * cutter.corner
    rho = np.r_[np.linspace(0, radius - corner, 60), radius - corner + corner * np.sin(turn), np.full(200, radius)]
    height = np.r_[np.zeros(60), corner * (1 - np.cos(turn)), np.linspace(corner, 12.0, 200)]
    x = np.cross([0.0, 1.0, 0.0], axis) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], axis))
    side = np.cos(u)[:, None] * x + np.sin(u)[:, None] * np.cross(axis, x)
    point = rho[:, None, None] * side + height[:, None, None] * axis
    lowest = np.full(len(y), 1e3)
    at = np.rint((point[..., 1].ravel() - y[0]) / (y[1] - y[0])).astype(int)
    inside = (at >= 0) & (at < len(y))
    np.minimum.at(lowest, at[inside], point[..., 2].ravel()[inside])
    return lowest


@pytest.mark.parametrize("cutter", [FLAT, BALL, Cutter(5e-3, 0.03, 1.5e-3)], ids=["flat", "ball", "corner"])
@pytest.mark.parametrize("lean", [(-0.2, 0.1), (0.1, 0.3)])
def test_a_tool_that_leans_cuts_what_its_silhouette_shows(cutter: Cutter, lean: tuple[float, float]) -> None:
    axis = np.array([*lean, 1.0]) / np.linalg.norm([*lean, 1.0])
    path = np.vstack([straight((-60, 0, -2), (0, 0, -2)), straight((0, 2, -2), (-60, 2, -2))]) * 1e-3
    block, every = build_block(*(BLOCK * 1e-3), np.eye(3)), np.ones(len(path), bool)
    found = find_engagement(cutter, path, every, block, axis=np.tile(axis, (len(path), 1)))
    y = np.arange(-10.0, 12.0, 0.02)
    first = silhouette(cutter, axis, y) - 2.0
    second = silhouette(cutter, axis, y - 2.0) - 2.0
    slot = -0.02e-6 * np.minimum(first, 0.0).sum()
    rest = 0.02e-6 * np.maximum(np.minimum(first, 0.0) - second, 0.0).sum()
    assert found.section[20:60] == pytest.approx(np.full(40, slot), rel=0.01)
    assert found.section[75:105] == pytest.approx(np.full(30, rest), rel=0.03)


def test_a_ball_does_not_feel_how_its_axis_turns_round_its_centre() -> None:
    centre = straight((-60, 0, 2), (0, 0, 2))
    lean = 0.3 * np.sin(np.arange(len(centre)) / 5.0)
    axis = np.column_stack([np.sin(lean), 0.0 * lean, np.cos(lean)])
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    tips = (centre - 3.0 * axis) * 1e-3
    found = find_engagement(BALL, tips, np.ones(len(tips), bool), block, axis=axis)
    segment = 9 * np.arccos(2 / 3) - 2 * np.sqrt(5)
    travelled = np.linalg.norm(np.diff(tips, axis=0), axis=1)  # section is volume a length of the tip's path
    assert found.section[20:] * travelled[19:] == pytest.approx(np.full(41, segment * 1e-9), rel=0.02)


def test_rapid_moves_take_nothing_away() -> None:
    path = np.vstack([straight((-60, 0, -2), (0, 0, -2)), straight((-60, 0, -2), (0, 0, -2))])
    block = build_block(*(BLOCK * 1e-3), np.eye(3))
    found = find_engagement(FLAT, path * 1e-3, np.arange(len(path)) > 61, block)
    assert not found.touches[:61].any() and found.touches[-1]


def test_a_mesh_of_a_box_is_engaged_as_the_box() -> None:
    mesh = trimesh.creation.box(extents=[0.1, 0.1, 0.02])
    mesh.apply_translation([0, 0, -0.01])
    columns, note = build_height_map(mesh, np.eye(3), 1e-3)
    path = straight((-60, 10, -2), (0, 10, -2)) * 1e-3
    found = find_engagement(FLAT, path, np.ones(len(path), bool), columns)
    assert note == ""
    assert found.section[-1] == pytest.approx(20e-6, rel=2e-3)


def test_a_height_map_is_the_same_in_small_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    whole, _ = build_height_map(mesh, np.eye(3), 1e-3)
    monkeypatch.setattr("compplan.process.stock.CELLS_AT_ONCE", 7)
    portions, _ = build_height_map(mesh, np.eye(3), 1e-3)
    assert np.isfinite(whole.high).sum() == pytest.approx(np.pi * 50**2, rel=0.02)
    assert np.array_equal(whole.high, portions.high)
    assert np.array_equal(whole.low, portions.low)


def test_a_mesh_of_millimetres_that_is_read_in_metres_is_refused(tmp_path: Path) -> None:
    trimesh.creation.box(extents=[45.0, 30.0, 22.0]).export(tmp_path / "block.stl")
    assert read_mesh(tmp_path / "block.stl", "mm", "", tmp_path).extents == pytest.approx([0.045, 0.03, 0.022])
    with pytest.raises(InputError, match="is 45 m large as a mesh in m, at most 20 m is allowed: check the unit"):
        read_mesh(tmp_path / "block.stl", "m", "", tmp_path)


def test_hollows_of_a_mesh_are_told() -> None:
    mesh = trimesh.creation.annulus(r_min=0.02, r_max=0.03, height=0.05)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    assert "hollows and undercuts count as solid" in build_height_map(mesh, np.eye(3), 1e-3)[1]


def test_an_open_mesh_is_refused(tmp_path) -> None:
    mesh = trimesh.creation.box(extents=[10, 10, 10])
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "open.stl")
    with pytest.raises(InputError, match="is an open mesh \\(3 edges"):
        read_mesh(tmp_path / "open.stl", "mm", "process.stock.mesh", tmp_path / "job.toml")


def test_a_wall_that_the_level_above_cut_is_not_cut_again_by_the_level_below() -> None:
    top, below = straight((-60, 0, -3), (60, 0, -3)), straight((60, 0, -6), (-60, 0, -6))
    found = engage(FLAT, np.vstack([top, below]))
    inside = np.arange(len(top) + 20, len(top) + 100)
    assert found.axial[inside] == pytest.approx(np.full(80, 3e-3), rel=1e-5)
    assert found.section[inside] == pytest.approx(np.full(80, 30e-6), rel=5e-3)
