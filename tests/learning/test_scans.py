"""Scans of a cut part in `learn`, best fit, and points that cannot be of the part."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from commandline import run_command
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.job.job import load_job
from compplan.learning.alignment import fit_rigid
from compplan.learning.gathered_points import gather_points
from compplan.learning.measured_path import MeasuredPath, match_points, reach_of
from compplan.measurement.part_points import FARTHEST, read_measured_points, read_surface
from compplan.robot import Array
from compplan.toolpath.toolpath import Toolpath

PATHS = Path(__file__).parents[2] / "paths"
PLACE = np.eye(4)
PLACE[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.3]).as_matrix()
PLACE[:3, 3] = [1.5, 0.2, 0.4]


def bent_path() -> Toolpath:
    """Return a path that looks like no turned, mirrored or exchanged copy of itself, base frame. [m]"""
    t = np.linspace(0.0, 1.0, 200)
    local = np.column_stack([0.12 * t, 0.05 * t**2 + 0.01 * np.sin(7.0 * t), 0.004 * t])
    position = local @ PLACE[:3, :3].T + PLACE[:3, 3]
    return Toolpath(position, np.tile([0.0, 0, 1], (200, 1)), np.full(200, 0.05), np.zeros(200, bool), frame="base")


def surface(count: int, off: float, seed: int = 0) -> Array:
    """Return points on both sides of the path, off the surface along z, part frame. Shape (count, 3). [mm]"""
    rng, t = np.random.default_rng(seed), np.random.default_rng(seed + 1).uniform(0.0, 1.0, count)
    path = np.column_stack([0.12 * t, 0.05 * t**2 + 0.01 * np.sin(7.0 * t), 0.004 * t])
    path[:, 1] += rng.uniform(-0.006, 0.006, count)
    path[:, 2] += off
    return path * 1e3


def along_path(off: Array) -> Array:
    """Return the places of the path, off by a vector, part frame. Shape (200, 3). [mm]"""
    path = bent_path().position
    return ((path - PLACE[:3, 3]) @ PLACE[:3, :3] + off) * 1e3


def write_cloud(file: Path, points: Array) -> Path:
    if file.suffix == ".ply":
        file.write_bytes(trimesh.PointCloud(points).export(file_type="ply", encoding=file.stem))
    else:
        sign = "," if file.suffix == ".csv" else " "
        file.write_text("# a scan\n" + "\n".join(sign.join(f"{v:.5f}" for v in row) for row in points) + "\n")
    return file


@pytest.mark.parametrize("name", ["binary.ply", "ascii.ply", "a.xyz", "a.csv"])
def test_clouds_of_every_form_hold_the_same_points(name: str, tmp_path: Path) -> None:
    points = surface(300, 0.0)
    table = read_measured_points(write_cloud(tmp_path / name, points))
    np.testing.assert_allclose(table.stack(["x", "y", "z"]) * 1e3, points, atol=1e-3)


def test_a_mesh_brings_its_vertices_and_normals(tmp_path: Path) -> None:
    box = trimesh.creation.box((10.0, 20.0, 30.0)).subdivide()
    box.export(tmp_path / "box.stl")
    table = read_measured_points(tmp_path / "box.stl")
    assert len(table) == len(box.vertices)
    np.testing.assert_allclose(np.linalg.norm(table.stack(["nx", "ny", "nz"]), axis=1), 1.0, atol=1e-6)


def match(file: Path, **given: object) -> MeasuredPath:
    return match_points(read_measured_points(file), bent_path(), PLACE, in_base=False, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("off", [3e-5, -8e-5])
def test_points_of_a_surface_count_along_its_normal_and_beside_the_path_alone(off: float, tmp_path: Path) -> None:
    found = match(write_cloud(tmp_path / "a.xyz", surface(20000, off)))
    assert 0.1 < len(found) / 20000 < 0.3  # 1 mm of 6 to both sides
    np.testing.assert_allclose(found.seen[:, 2], off, atol=0.05 * abs(off))
    np.testing.assert_allclose(np.trace(found.counts, axis1=1, axis2=2), 1.0, atol=1e-9)
    assert "0.05 mm is assumed" in found.notes[-1]
    assert match(tmp_path / "a.xyz", sigma=1e-5).sigma[0] == 1e-5


def test_a_line_of_points_counts_across_the_path(tmp_path: Path) -> None:
    found = match(write_cloud(tmp_path / "line.xyz", along_path(np.array([0.0, 0.0, 5e-5]))))
    np.testing.assert_allclose(np.trace(found.counts, axis1=1, axis2=2), 2.0, atol=1e-9)
    assert np.median(found.seen[:, 2]) == pytest.approx(5e-5, rel=0.05)


@pytest.mark.parametrize("stated", [False, True])
def test_a_probe_along_normals_counts_along_them_alone(stated: bool, tmp_path: Path) -> None:
    unit, path = np.array([0.0, 0.6, 0.8]), bent_path()
    head = "x_mm,y_mm,z_mm,dir_i,dir_j,dir_k,reading_mm" + (",s_mm" if stated else "")
    columns = [along_path(np.zeros(3)), np.tile(unit, (200, 1)), np.full((200, 1), -0.04)]
    columns += [path.arc_length[:, None] * 1e3] if stated else []
    rows = [",".join(f"{v:.6f}" for v in row) for row in np.hstack(columns)]
    (tmp_path / "probe.csv").write_text("\n".join([head, *rows]) + "\n")
    found = match(tmp_path / "probe.csv")
    np.testing.assert_allclose(found.seen, np.tile(-4e-5 * PLACE[:3, :3] @ unit, (len(found), 1)), atol=2e-8)
    np.testing.assert_allclose(np.trace(found.counts, axis1=1, axis2=2), 1.0, atol=1e-9)
    bad = tmp_path / "bad.csv"
    bad.write_text("x_mm,y_mm,z_mm,reading_mm\n1,2,3,0.1\n")
    with pytest.raises(InputError, match="dir_i dir_j dir_k"):
        read_measured_points(bad)


@pytest.mark.parametrize("times", [(1, 1), (3, 1)])
def test_a_place_that_was_touched_from_two_sides_counts_in_both_directions(times: tuple[int, int]) -> None:
    """Readings of two directions at one place were all lost: their mean projector rounds to nothing."""
    off, path = np.array([0.0, 2e-4, -3e-4]), bent_path()
    rows = np.repeat(np.arange(0, 200, 10), sum(times))
    units = np.tile(np.repeat([[0.0, 0.6, 0.8], [0.0, 0.8, -0.6]], times, axis=0), (20, 1))
    counts = np.einsum("mi,mj->mij", units, units)
    deviation = np.einsum("mij,j->mi", counts, off)
    sigma = np.full(len(rows), 1e-5)
    found = gather_points(MeasuredPath(path.arc_length[rows], deviation, counts, sigma, 0), path.arc_length)
    np.testing.assert_allclose(found.deviation, np.tile(off, (20, 1)), atol=1e-12)
    np.testing.assert_allclose(np.trace(found.counts, axis1=1, axis2=2), 2.0, atol=1e-9)
    assert (found.variance >= 1e-10 / max(times)).all()


def test_a_best_fit_takes_a_shift_and_turn_off_and_says_so(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.0, 0.0, 2e-3]).as_matrix()
    file = write_cloud(tmp_path / "moved.xyz", along_path(np.zeros(3)) @ turn.T + [0.3, -0.2, 0.1])
    assert np.sqrt(np.mean(np.sum(match(file).seen ** 2, axis=1))) > 2e-4
    fitted = match(file, align="best_fit")
    assert np.sqrt(np.mean(np.sum(fitted.seen**2, axis=1))) < 2e-6
    assert fitted.motion is not None
    assert "best fit" in " ".join(fitted.notes)


def test_the_motion_of_a_best_fit_is_the_inverse_of_what_moved_the_points() -> None:
    true = np.eye(4)
    true[:3, :3], true[:3, 3] = Rotation.from_rotvec([1e-3, -2e-3, 1e-3]).as_matrix(), [3e-3, 2e-3, -3e-3]
    path = bent_path()
    motion, left = fit_rigid(path.position @ true[:3, :3].T + true[:3, 3], None, path, FARTHEST)
    assert left < 1e-6
    np.testing.assert_allclose((motion @ true)[:3, :3], np.eye(3), atol=1e-4)


EXCHANGED = {
    "another part": lambda p: p * [0.2, 3.0, 1.0] + [150.0, 40.0, 60.0],
    "metres": lambda p: p * 1e-3, "inches": lambda p: p / 25.4, "micrometres": lambda p: p * 1e3,
    "exchanged": lambda p: p[:, [1, 0, 2]], "reversed": lambda p: p * [-1.0, 1.0, 1.0],
    "turned": lambda p: p[:, [2, 0, 1]], "a fixture": lambda p: p - np.array([0.0, 0.0, 60.0]),
    "the base frame": lambda p: p @ PLACE[:3, :3].T + PLACE[:3, 3] * 1e3,
}  # fmt: skip


@pytest.mark.parametrize("name", EXCHANGED)
@pytest.mark.parametrize("form", ["points", "scan"])
def test_points_that_are_not_of_this_part_are_refused_in_words(name: str, form: str, tmp_path: Path) -> None:
    points = EXCHANGED[name](along_path(np.zeros(3)))
    file = write_cloud(tmp_path / "a.xyz", points)
    if form == "points":
        file = tmp_path / "a.csv"
        file.write_text("x_mm,y_mm,z_mm\n" + "\n".join(",".join(f"{v:.5f}" for v in row) for row in points) + "\n")
    try:
        found = match(file)
    except InputError as error:
        assert "Add --frame base" in str(error) or "are they in metres" in str(error)
        return
    # near parts of it lie within reach: what is left is far beyond any band
    assert np.median(np.linalg.norm(found.seen, axis=1)) > 5e-4


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.xyz", "1 2 3\n4 5 six\n", "a.xyz:2"),
        ("a.ply", "not a ply\n", "PLY"),
        ("a.stl", "", "no points"),
        ("a.xyz", "# nothing\n", "no points"),
        ("a.xyz", "1 2 3\nnan 5 6\n", "finite"),
    ],
)
def test_broken_scans_end_in_one_line(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_measured_points(tmp_path / name)


def test_points_farther_off_than_the_folder_allows_are_asked_about_and_learned_when_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (PATHS / "circle_10mm.toml").read_text(encoding="utf-8").replace("waypoints = 500", "waypoints = 60")
    (tmp_path / "circle.toml").write_text(text, encoding="utf-8")
    job = load_job(tmp_path / "circle.toml")
    from compplan.job.loading import load_nominal

    path = load_nominal(job).position
    local = ((path - job.T_base_part[:3, 3]) @ job.T_base_part[:3, :3] + [0.0, 0.0, 0.009]) * 1e3
    file = write_cloud(tmp_path / "part.xyz", local)
    words = ["learn", job.file, file, "--robot", "kuka_kr270", "--out", tmp_path / "out"]
    answer = run_command(words, monkeypatch, capsys)
    assert answer.status == 2
    assert "--assume-ok" in answer.err
    assert not (tmp_path / "out").exists()
    assert run_command([*words, "--align", "best_fit"], monkeypatch, capsys).status in (0, 3)


#: A wall of 120 x 20 mm, the material behind it, milled by a cutter of 10 mm whose tip runs beside its foot.
WALL = trimesh.creation.box(bounds=[[0.0, -30.0, 0.0], [120.0, 0.0, 20.0]])


def wall_points(off: float, count: int = 400) -> Array:
    """Return points of the wall, off along its normal y, and of its upper face and far end, part frame. [mm]"""
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.uniform(5, 115, count), np.full(count, off), rng.uniform(0.5, 6.0, count)])
    top = np.column_stack([rng.uniform(5, 115, count), rng.uniform(-25, -15, count), np.full(count, 20.0)])
    return np.vstack([wall, top])


def beside_the_wall(file: Path, align: str = "datum", unit: float = 1.0) -> MeasuredPath:
    mesh = WALL.copy()
    mesh.apply_scale(unit)
    mesh.export(file.with_suffix(".stl"))
    local = np.column_stack([np.linspace(2.0, 118.0, 60), np.full(60, 5.0), np.zeros(60)]) * 1e-3
    position = local @ PLACE[:3, :3].T + PLACE[:3, 3]
    path = Toolpath(position, np.tile([0.0, 0, 1], (60, 1)), np.full(60, 0.05), np.zeros(60, bool), frame="base")
    surface = read_surface(file.with_suffix(".stl"), reach_of(SimpleNamespace(diameter_mm=10.0)))
    table = read_measured_points(file)
    return match_points(table, path, PLACE, in_base=False, align=align, surface=surface)


@pytest.mark.parametrize("off", [0.03, -0.2])
def test_a_scan_is_held_against_the_nominal_mesh_where_the_cutter_made_it(off: float, tmp_path: Path) -> None:
    found = beside_the_wall(write_cloud(tmp_path / "wall.xyz", wall_points(off)))
    assert len(found) == 400  # all of the wall that the cutter made, no point of the upper face
    assert found.deviation @ PLACE[:3, :3] == pytest.approx(np.tile([0.0, off * 1e-3, 0.0], (len(found), 1)), abs=1e-8)
    assert np.trace(found.counts, axis1=1, axis2=2) == pytest.approx(1.0)
    assert found.length.min() > 0.002 and found.length.max() < 0.114


def test_a_best_fit_to_the_mesh_takes_a_shift_of_the_whole_scan_off(tmp_path: Path) -> None:
    """Points of the upper face tell the height; of the wall's, half of the shift is a true deviation of the cut."""
    turn = Rotation.from_rotvec([0.0, 0.0, 2e-4]).as_matrix()
    corner = np.column_stack([np.zeros(200), np.random.default_rng(1).uniform([-28, 1], [-2, 19], (200, 2))])
    points = np.vstack([wall_points(0.0), corner]) @ turn.T + [0.12, -0.2, 0.1]
    found = beside_the_wall(write_cloud(tmp_path / "moved.xyz", points), align="best_fit")
    assert np.linalg.norm(found.deviation, axis=1).max() < 1e-6
    assert found.motion is not None and found.motion[:3, :3] == pytest.approx(turn.T, abs=1e-7)


def test_a_mesh_in_another_unit_or_without_triangles_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nominal mesh lies .* in the part frame, in mm\?"):
        beside_the_wall(write_cloud(tmp_path / "wall.xyz", wall_points(0.0)), unit=1e-3)
    (tmp_path / "none.stl").write_text("solid none\nendsolid none\n")
    with pytest.raises(InputError, match=r"triangles|can be read"):
        read_surface(tmp_path / "none.stl", 1e-3)
    with pytest.raises(InputError, match="expected a nominal mesh"):
        read_surface(tmp_path / "part.step", 1e-3)
